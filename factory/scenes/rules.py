"""Category rules: a YAML table that maps prim names to categories, with plausible sizes.

Reads the table. Does not read stages.
"""

from __future__ import annotations

import re
import shlex
from functools import cached_property
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import AfterValidator, TypeAdapter, ValidationError

from factory.scenes.yaml_text import read_yaml, say_absence
from schemas.base import Model, Name, NonNegative, Positive
from schemas.errors import UsageError

__all__ = ["BUILTIN_RULES", "CategoryRule", "RuleBook", "load_rules", "split_name"]

BUILTIN_RULES = Path(__file__).with_name("rules.yaml")


def _compiles(pattern: str) -> str:
    try:
        re.compile(pattern)
    except re.error as error:
        raise ValueError(f"{pattern!r} is not a valid regular expression: {error}") from error
    return pattern


Pattern = Annotated[str, AfterValidator(_compiles)]


class CategoryRule(Model):
    """Rule that assigns a category to prims by name and size."""

    category: Name
    include: tuple[Pattern, ...]
    """Regular expressions; at least one must match within the split name."""
    exclude: tuple[Pattern, ...] = ()
    """Regular expressions; none may match within the split name."""
    smallest_m: NonNegative = 0.05
    """Minimum plausible length of the longest side, metres."""
    largest_m: Positive = 40.0
    """Maximum plausible length of the longest side, metres."""
    has_colour: bool = True
    """Whether instructions may name the colour. False for racks and monitors: their content has the colour."""


class RuleBook(Model):
    """Ordered category rules; the first match applies."""

    rules: tuple[CategoryRule, ...]

    @property
    def uncoloured(self) -> frozenset[str]:
        """Categories whose colour is never named."""
        return frozenset(rule.category for rule in self.rules if not rule.has_colour)

    @cached_property
    def _patterns(self) -> tuple[tuple[CategoryRule, re.Pattern[str], re.Pattern[str] | None], ...]:
        return tuple(
            (rule, re.compile("|".join(rule.include)), re.compile("|".join(rule.exclude)) if rule.exclude else None)
            for rule in self.rules
        )

    def match(self, name: str) -> CategoryRule | None:
        """Returns the first rule that matches a prim name or label, or `None`."""
        words = split_name(name)
        for rule, include, exclude in self._patterns:
            if include.search(words) and not (exclude and exclude.search(words)):
                return rule
        return None


def split_name(name: str) -> str:
    """Splits a name at case changes and digits: `SM_BarelPlastic_A01` becomes `sm_barel_plastic_a_01`."""
    spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name)
    spaced = re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1_\2", spaced)
    spaced = re.sub(r"([A-Za-z])(\d)", r"\1_\2", spaced)
    return "_".join(word for word in re.split(r"[^a-z0-9]+", spaced.lower()) if word)


def load_rules(path: Path = BUILTIN_RULES) -> RuleBook:
    """Reads a table of category rules.

    Raises:
        UsageError: the file does not exist or is not a valid table of rules.
    """
    try:
        table = read_yaml(path.read_text(encoding="utf-8"))
        return RuleBook(rules=TypeAdapter(tuple[CategoryRule, ...]).validate_python(table))
    except OSError as error:
        command = f"cp {shlex.quote(str(BUILTIN_RULES))} {shlex.quote(str(path))}"
        raise UsageError(
            f"cannot read category rules from {path} ({say_absence(error)}); use the built-in rules without --rules, "
            "or start "
            f"with a copy of them: `{command}`"
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is not valid YAML: {error}") from error
    except ValidationError as error:
        mistakes = [f"  - {'.'.join(map(str, item['loc'])) or 'file'}: {item['msg']}" for item in error.errors()]
        raise UsageError("\n".join([f"{path} is not a valid list of category rules:", *mistakes])) from error
