"""Category rules: a YAML table that maps prim names to categories, with plausible sizes, shapes and colours.

Reads the table. Does not read stages.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import AfterValidator, TypeAdapter, ValidationError, model_validator

from factory.scenes.yaml_text import os_reason, read_yaml
from schemas.base import Model, Name, NonNegative, Positive
from schemas.errors import UsageError
from schemas.support.shell import quoted
from schemas.terms import COLOUR_NAMES

BUILTIN_RULES = Path(__file__).with_name("rules.yaml")


def _compiles(pattern: str) -> str:
    try:
        re.compile(pattern)
    except re.error as error:
        raise ValueError(f"{pattern!r} is not a valid regular expression: {error}") from error
    return pattern


def _is_colour(name: str) -> str:
    if name not in COLOUR_NAMES:
        raise ValueError(f"{name!r} is not a colour name; colour names: {', '.join(COLOUR_NAMES)}")
    return name


Pattern = Annotated[str, AfterValidator(_compiles)]
Colour = Annotated[str, AfterValidator(_is_colour)]


_FURNITURE = (
    "cup_?board|cabinet|wardrobe|closet|dresser|drawer|shelf|book_?case|kitchen|fridge|oven|table|desk|bed|sofa|stair"
)
_OTHER_THINGS = {
    # in code and not in the table, whose text is part of the digest of every package
    "whiteboard": re.compile(rf"(?:^|_)(?:{_FURNITURE})s?_(?:\w+_)?board"),
    "cabinet": re.compile(r"(?:^|_)(?:cup_?board|cabinet)s?_(?:left|right|top|bottom|back)_(?:board|panel)"),
    "bench": re.compile(r"(?:^|_)(?:cooking|cook|hob|test|tool|optical|lab)_?bench"),
    "rack": re.compile(r"rac(?:k|qu)et"),
    "plant": re.compile(r"egg_?plant"),
    "table": re.compile(r"(?:sui|prin|comfor|accep|no|cons|execu|mu|rota|detec)table"),
    "chair": re.compile(r"chair_?(?:man|lift)"),
}
"""Names of other things that contain the word of a category: a board of a cupboard, and a bench with a hob."""
_MORE_NAMES = {"cabinet": re.compile(r"storage(?:_(?:unit|furniture))?(?:_\d+)*")}
"""Whole names of a category that are not in the table: `Storage0` of Apple's RoomPlan."""
_NUMBER = re.compile(r"\d+[a-z]?|[a-z]")
_PART = re.compile(
    "legs?|foot|feet|handles?|knob|hinge|cushions?|pillows?|armrest|backrest|headrest|cast[eo]r|screw|bolt|cable|cord|plug|panels?|"
    "shadow|decal"
)
"""Last words of names of parts: `TableLeg_01` is not a table."""


class CategoryRule(Model):
    """Rule that assigns a category to prims by name, size, shape and colour."""

    # names alone mislead: a plank with the name `Board_01` became a whiteboard

    category: Name
    """Category that the rule assigns; several rules may assign the same category."""
    words: tuple[Pattern, ...] = ()
    """Names and synonyms; each matches as whole words of the split name, in singular or plural."""
    include: tuple[Pattern, ...] = ()
    """Regular expressions that are searched within the split name. One of them or of `words` must match."""
    exclude: tuple[Pattern, ...] = ()
    """Regular expressions; none may match within the split name."""
    smallest_m: NonNegative = 0.05
    """Minimum plausible length of the longest side, metres."""
    largest_m: Positive = 40.0
    """Maximum plausible length of the longest side, metres."""
    height_m: tuple[NonNegative, Positive] = (0.0, 40.0)
    """Plausible vertical extents, from and to, metres."""
    thickest_m: Positive | None = None
    """Maximum plausible width of the footprint at any rotation, metres; for thin panels. `None` permits any width."""
    colours: tuple[Colour, ...] = ()
    """Plausible dominant colours; empty permits any colour."""
    has_colour: bool = True
    """Whether instructions may name the colour. False for racks and monitors, which show colours of their content."""

    @model_validator(mode="after")
    def _has_a_pattern(self) -> CategoryRule:
        if not (self.words or self.include):
            raise ValueError(f"the rule of {self.category} needs `words` or `include`")
        return self

    @cached_property
    def _patterns(self) -> tuple[re.Pattern[str], ...]:
        whole = (f"(?:^|_)(?:{word})(?:s|es)?(?:_|$)" for word in self.words)
        return tuple(map(re.compile, (*whole, *self.include)))

    @cached_property
    def _included(self) -> re.Pattern[str]:
        return re.compile("|".join(pattern.pattern for pattern in self._patterns))

    @cached_property
    def _excluded(self) -> re.Pattern[str] | None:
        return re.compile("|".join(self.exclude)) if self.exclude else None

    def names(self, words: str) -> bool:
        """Returns whether the patterns of the rule match a split name."""
        other = _OTHER_THINGS.get(self.category)
        if (self._excluded and self._excluded.search(words)) or (other and other.search(words)) or _is_part(words):
            return False
        more = _MORE_NAMES.get(self.category)
        return bool(self._included.search(words) or (more and more.fullmatch(words)))

    def last_of(self, words: str) -> tuple[int, int]:
        """Returns the end and the length of the last match in a split name, the longest of those; zeros without one."""
        found = (match for pattern in self._patterns for match in pattern.finditer(words))
        ends = ((match.end() - match[0].endswith("_"), len(match[0].strip("_"))) for match in found)
        return max(ends, default=(0, 0))


def _is_part(words: str) -> bool:
    """Returns whether the last word of a split name, without numbers and letters, is a part such as a leg."""
    named = [word for word in words.split("_") if not _NUMBER.fullmatch(word)]
    return len(named) > 1 and _PART.fullmatch(named[-1]) is not None


class RuleBook(Model):
    """Ordered category rules; the first match applies."""

    rules: tuple[CategoryRule, ...]

    @property
    def uncoloured(self) -> frozenset[str]:
        """Categories whose colour is never named."""
        return frozenset(rule.category for rule in self.rules if not rule.has_colour)

    def only(self, categories: Collection[str]) -> RuleBook:
        return RuleBook(rules=tuple(rule for rule in self.rules if rule.category in categories))

    def matches(self, name: str) -> Iterator[CategoryRule]:
        """Yields the rules whose patterns match a prim name or label: the last thing of the name first.

        A `sink_area_dish_washer` is a dishwasher, and a `microwave_oven` a microwave. Rules of the same words are in
        their order.
        """
        words = split_name(name)
        found = [rule for rule in self.rules if rule.names(words)]
        return iter(sorted(found, key=lambda rule: rule.last_of(words), reverse=True))

    def match(self, name: str) -> CategoryRule | None:
        """Returns the first rule whose patterns match a prim name or label, or `None`."""
        return next(self.matches(name), None)


def split_name(name: str) -> str:
    """Splits a name at case changes and digits: `SM_BarelPlastic_A01` becomes `sm_barel_plastic_a_01`."""
    spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name)
    spaced = re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1_\2", spaced)
    spaced = re.sub(r"([A-Za-z])(\d)", r"\1_\2", spaced)
    return "_".join(word for word in re.split(r"[^a-z0-9]+", spaced.lower()) if word)


@cache
def builtin_rules() -> RuleBook:
    """Returns the built-in category rules; reads them once in a process."""
    return load_rules(BUILTIN_RULES)


def load_rules(path: Path) -> RuleBook:
    """Reads a table of category rules.

    Raises:
        UsageError: the file does not exist or is not a valid table of rules.
    """
    try:
        table = read_yaml(path.read_text(encoding="utf-8"))
        return RuleBook(rules=TypeAdapter(tuple[CategoryRule, ...]).validate_python(table))
    except OSError as error:
        command = f"cp {quoted(BUILTIN_RULES)} {quoted(path)}"
        raise UsageError(
            f"cannot read category rules from {path} ({os_reason(error)}); use the built-in rules without --rules, "
            "or start "
            f"with a copy of them: `{command}`"
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is not valid YAML: {error}") from error
    except ValidationError as error:
        mistakes = [f"  - {'.'.join(map(str, item['loc'])) or 'file'}: {item['msg']}" for item in error.errors()]
        raise UsageError("\n".join([f"{path} is not a valid list of category rules:", *mistakes])) from error
