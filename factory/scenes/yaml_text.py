"""Reads what users write as YAML; refuses what YAML would take in silence. Knows no file's meaning."""

from __future__ import annotations

from collections import Counter
from typing import Any

import yaml

__all__ = ["read_yaml", "say_absence"]


_MOST_CHARS = 4 << 20


class _Loader(yaml.SafeLoader):
    """Refuses a key that stands twice in one mapping: the last would win, and a lost line would join two rows.

    Refuses aliases as well: a few lines of them stand for more values than a computer has memory.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Returns the next node."""
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases (*name) are not allowed; write the value", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Returns the mapping of a node."""
        keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        twice = sorted(key for key, count in keys.items() if count > 1)
        if twice:
            problem = f"{', '.join(twice)} duplicated in one entry; check for a missing line"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return super().construct_mapping(node, deep)


def read_yaml(text: str) -> Any:
    """Returns what a YAML text says, plain data only.

    Raises:
        YAMLError: it is no YAML, is too large or nested too deeply, has aliases, or a key stands twice.
    """
    if len(text) > _MOST_CHARS:
        raise yaml.YAMLError(f"it has {len(text)} characters; at most {_MOST_CHARS} are read")
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader
    except RecursionError as error:
        raise yaml.YAMLError("its values are nested too deeply") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise yaml.YAMLError(f"a value is not valid: {error}") from error


def say_absence(error: OSError) -> str:
    """Returns why a file could not be read, without the number of the error."""
    return (error.strerror or "it cannot be read").lower()
