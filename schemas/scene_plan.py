"""Entry of a plan for one scene, or for the layouts of a family; and the taxonomy of object categories.

The taxonomy (superclass and synonyms of each category) is read from `taxonomy.toml` once. Does not check the content
of scenes.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    AliasChoices,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from schemas.base import Fraction, Model, Name
from schemas.support.suggest import did_you_mean
from schemas.terms import (
    BUILTIN_CATEGORIES,
    CATEGORIES,
    SceneCategories,
    Screening,
    Split,
    Tier,
    family_of,
    layout_number,
)

MAX_EPISODES = 9_999_999
MAX_LAYOUTS = 100_000
_LATER_KEYS = frozenset(
    {"rules", "targets", "allow_outside", "ceiling_m", "tiers", "splits", "ambiguous", "screening"}
    | {"unit", "up", "models", "skip_missing", "floor_m", "layouts", "unseen_layouts"}
)
"""Keys added after the first version; they are omitted from the digest if unused, so older digests stay valid."""


def _is_given(value: object) -> bool:
    """Returns whether a serialised value is neither null, false nor empty; the number 0 is a value."""
    return bool(value) or (isinstance(value, int | float) and not isinstance(value, bool))


class ScenePlan(Model):
    """Entry of a plan for one scene."""

    file: str | None = Field(default=None, validation_alias=AliasChoices("file", "usd"))
    """Path of the root file of a custom scene, relative to the plan file; null for a built-in scene. Serialised as
    `usd`, its earlier name, so older digests stay valid."""
    name: Name
    """Name of a built-in scene, or the name of a custom scene in the dataset."""
    episodes: Annotated[int, Field(ge=1, le=MAX_EPISODES)]
    """Number of episodes in this scene."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Layout seed of a built-in scene; with `layouts`, seed of the first layout. The default is the number in a name
    such as `home_00017`, else 0."""
    layouts: Annotated[int, Field(ge=1, le=MAX_LAYOUTS)] | None = None
    """Number of layouts of a built-in scene; each layout is a scene with a different seed. Null means a single scene
    with the name of the entry."""
    unseen_layouts: Annotated[int, Field(ge=1, le=MAX_LAYOUTS)] | None = None
    """Number of layouts that only the splits `test_unseen_scene*` use; null derives it from the share of these splits,
    at least one layout."""
    seen: tuple[Name, ...] = ()
    """Categories of the in-distribution splits; empty selects those of the paper."""
    held_out: tuple[Name, ...] = ()
    """Categories of the split `test_ood_obj` only; empty selects those of the paper."""
    rules: str | None = None
    """Path of a custom table of category rules, relative to the plan file."""
    targets: str | None = None
    """Path of an edited `targets_<scene>.yaml`, relative to the plan file."""
    allow_outside: bool = False
    """Whether files of a custom scene may be stored outside its folder."""
    unit: Literal["m", "cm", "mm", "in"] | Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    """Unit of a custom scene, by name or as its length in metres; null is the unit that the file states."""
    up: Literal["y", "z"] | None = None
    """Axis of a custom scene that points up; null is the axis that the file states."""
    models: tuple[str, ...] = ()
    """Folders in which `model://` and `package://` names are searched, relative to the plan file."""
    skip_missing: bool = False
    """Whether a custom scene is read without the models and meshes that are missing."""
    floor_m: Annotated[float, Field(ge=-1000, le=1000)] | None = None
    """Height of a flat floor that is added to a custom scene without one, metres; null adds none."""
    ceiling_m: Annotated[float, Field(ge=1, le=100)] | None = None
    """Height above the floor of a flat ceiling that is added to a custom scene, metres; null adds none."""
    screening: Screening | None = None
    """Selection of the starts in this scene; null selects `spawn.screening` of the plan."""
    ambiguous: tuple[Name, ...] = ()
    """Categories whose instructions may fit several objects, although `instructions.unique` requires one."""
    tiers: dict[Tier, Fraction] = Field(default_factory=dict)
    """Fraction of episodes in each tier of this scene; empty selects the plan's fractions."""
    splits: dict[Split, Fraction] = Field(default_factory=dict)
    """Fraction of episodes in each split of this scene; empty selects the plan's fractions."""

    @model_serializer(mode="wrap")
    def _leave_out_unused(self, serialize: SerializerFunctionWrapHandler) -> dict[str, object]:
        data: dict[str, object] = serialize(self)
        used = {key: value for key, value in data.items() if key not in _LATER_KEYS or _is_given(value)}
        return {"usd" if key == "file" else key: value for key, value in used.items()}

    @property
    def categories(self) -> SceneCategories:
        """Seen and held-out categories that apply to this scene."""
        none = SceneCategories((), ())
        seen, held_out = BUILTIN_CATEGORIES.get(family_of(self.name), none) if self.file is None else none
        return SceneCategories(self.seen or seen, self.held_out or held_out)

    @model_validator(mode="before")
    @classmethod
    def _seed_of_its_name(cls, data: Any) -> Any:
        name = data.get("name") if isinstance(data, dict) else None
        number = layout_number(name) if isinstance(name, str) else None
        return data if number is None else {"seed": number, **data}

    @field_validator("name")
    @classmethod
    def _is_a_known_scene(cls, name: str, others: ValidationInfo) -> str:
        if others.data.get("file") is None and family_of(name) not in BUILTIN_CATEGORIES:
            known, meant = ", ".join(BUILTIN_CATEGORIES), did_you_mean(name, BUILTIN_CATEGORIES)
            raise ValueError(f"not a built-in scene ({known}); for a scene of a file give `file = PATH`{meant}")
        return name

    @field_validator("seen", "held_out")
    @classmethod
    def _are_known_categories(cls, categories: tuple[str, ...], others: ValidationInfo) -> tuple[str, ...]:
        scene = others.data.get("name", "")
        known = {*CATEGORIES, *(name for group in BUILTIN_CATEGORIES.get(family_of(scene), ()) for name in group)}
        unknown = [name for name in categories if name not in known]
        if unknown and others.data.get("file") is None:
            meant = {name: category_of(name) for name in unknown}
            hints = [f"{name} is a synonym of {category}" for name, category in meant.items() if category in known]
            text = f"unknown categories {', '.join(unknown)}; categories of {scene}: {', '.join(sorted(known))}"
            raise ValueError("; ".join([text, *hints]))
        return categories

    @field_validator("ceiling_m", "floor_m")
    @classmethod
    def _is_for_a_stage(cls, height_m: float | None, others: ValidationInfo) -> float | None:
        if height_m is not None and others.data.get("file") is None:
            key = str(others.field_name)
            part = key.removesuffix("_m")
            raise ValueError(f"a built-in scene has a {part}; `{key}` is for a scene of a file (`file = PATH`)")
        return height_m

    @model_validator(mode="after")
    def _layouts_make_sense(self) -> ScenePlan:
        if self.layouts is None:
            if self.unseen_layouts is not None:
                raise ValueError("`unseen_layouts` needs `layouts`, the number of all layouts")
            return self
        if self.file is not None or self.name != family_of(self.name):
            raise ValueError(f"{self.name!r} is one fixed scene; `layouts` is for {', '.join(BUILTIN_CATEGORIES)}")
        if self.targets is not None:
            raise ValueError("`targets` edits one layout; remove it, or remove `layouts`")
        if self.layouts > self.episodes:
            raise ValueError(f"{self.layouts} layouts need at least {self.layouts} episodes, not {self.episodes}")
        return self

    @model_validator(mode="after")
    def _categories_are_consistent(self) -> ScenePlan:
        seen, held_out = self.categories
        both = sorted(set(seen) & set(held_out))
        if both:
            raise ValueError(f"categories both seen and held out: {', '.join(both)}")
        unnamed = sorted(set(self.ambiguous) - {*seen, *held_out})
        if unnamed:
            raise ValueError(f"`ambiguous` lists categories that are neither seen nor held out: {', '.join(unnamed)}")
        if not seen:
            raise ValueError("a scene with `file` needs `seen = [...]`, the categories to train on")
        return self


_FILE = Path(__file__).with_name("taxonomy.toml")


class CategoryKind(NamedTuple):
    """Place of a category in the taxonomy."""

    superclass: str
    """Name of the superclass, such as `seat` for a chair."""
    synonyms: tuple[str, ...]
    """Other English names of the category, in singular."""


@cache
def load_taxonomy() -> Mapping[str, CategoryKind]:
    """Returns the place of every category by its name."""
    table = tomllib.loads(_FILE.read_text(encoding="utf-8"))
    return MappingProxyType(
        {
            category: CategoryKind(superclass, tuple(synonyms))
            for superclass, categories in table.items()
            for category, synonyms in categories.items()
        }
    )


def category_of(name: str) -> str | None:
    """Returns the category with a name or synonym, in any case, with spaces or underscores; `None` for other names."""
    words = name.lower().replace("_", " ")
    for category, kind in load_taxonomy().items():
        if words == category.replace("_", " ") or words in kind.synonyms:
            return category
    return None
