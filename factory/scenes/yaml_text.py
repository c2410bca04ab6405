"""Reads YAML files of users; rejects duplicate keys and aliases. Does not validate the content."""

from __future__ import annotations

from collections import Counter
from typing import Any

import yaml

_MOST_CHARS = 4 << 20


class _Loader(yaml.SafeLoader):
    """YAML loader that rejects duplicate keys, which result when a missing line merges two rows.

    It also rejects aliases, because a few lines of nested aliases expand to more values than memory can hold.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases (*name) are not allowed; write the value", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        twice = sorted(key for key, count in keys.items() if count > 1)
        if twice:
            problem = f"{', '.join(twice)} duplicated in one entry; check for a missing line"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return super().construct_mapping(node, deep)


def read_yaml(text: str) -> Any:
    """Parses a YAML text into plain data.

    Raises:
        YAMLError: the text is not valid YAML, is too large or too deeply nested, or has aliases or duplicate keys.
    """
    if len(text) > _MOST_CHARS:
        raise yaml.YAMLError(f"it has {len(text)} characters; at most {_MOST_CHARS} are read")
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - `_Loader` is a SafeLoader
    except RecursionError as error:
        raise yaml.YAMLError("its values are nested too deeply") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise yaml.YAMLError(f"a value is not valid: {error}") from error


def os_reason(error: OSError) -> str:
    """Returns the reason of an OS error in lower case, without its number."""
    return (error.strerror or "it cannot be read").lower()
