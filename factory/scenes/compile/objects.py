"""Visible parts of a scene, with their textures and the object (target, model or single prim) each belongs to.

Objects are numbered by path. Computes no grid and no light.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from factory.scenes.compile.surfaces import materials_of, target_colour, triangle_areas
from factory.scenes.compile.textures import DrawFunction, TextureBook, load_textures
from factory.scenes.importer import Extraction, Part, TextureRecipe
from factory.scenes.rules import RuleBook
from factory.scenes.targets.candidates import Candidate, find_candidates, find_copies, find_sections, joined
from factory.scenes.targets.target_edits import apply_candidate_edits
from factory.scenes.targets.target_list import TargetList
from schemas.errors import WorldError
from schemas.scene import Instance
from schemas.support.numpy_types import Floats

MAX_INSTANCES = 65535


def assign_objects(parts: Sequence[Part], things: Iterable[str], models: Iterable[str]) -> tuple[str, ...]:
    """Returns the path of the object that each part belongs to.

    Args:
        parts: visible parts.
        things: paths of target candidates; they take precedence.
        models: paths of instances and components; the outermost applies.
    """
    first, second = frozenset(things), frozenset(models)
    owners = [_owner(part.path, first) or _owner(part.path, second) or part.path for part in parts]
    depth = max((path.count("/") for path in owners), default=0)
    while len(set(owners)) > MAX_INSTANCES:
        depth -= 1
        if depth < 1:
            raise WorldError(
                f"the scene has more than {MAX_INSTANCES} instances, the limit of the 16-bit id image; split the scene"
            )
        owners = [path if path in first else "/".join(path.split("/")[: depth + 1]) for path in owners]
    return tuple(owners)


def _owner(path: str, known: frozenset[str]) -> str:
    """Returns the outermost known ancestor of a path, else the path itself if it is known, else an empty string."""
    steps = path.split("/")
    prefixes = ("/".join(steps[:count]) for count in range(2, len(steps) + 1))
    return next((prefix for prefix in prefixes if prefix in known), "")


def number_objects(owners: Iterable[str]) -> dict[str, int]:
    """Returns the instance ids 1, 2, ... of the objects in the order of their paths."""
    return {path: number for number, path in enumerate(sorted(set(owners)), 1)}


_SEE_THROUGH = 0.3


@dataclass(frozen=True)
class ShownScene:
    """Visible parts, and the object that each belongs to."""

    parts: tuple[Part, ...]
    candidates: tuple[Candidate, ...]
    owners: tuple[str, ...]
    ids: dict[str, int]
    book: TextureBook
    chosen: TargetList | None
    """Target list of the user, if given."""
    uncoloured: frozenset[str]
    """Categories whose colour is never named."""
    has_materials: bool
    """Whether materials are recorded."""

    def triangles(self) -> Floats:
        """Returns all triangles (T, 3, 3), world metres."""
        return np.concatenate([part.triangles for part in self.parts])

    def shapes(self) -> dict[str, Floats]:
        """Returns the triangles (T, 3, 3) of each object by its path, world metres."""
        groups: dict[str, list[Floats]] = {}
        for part, owner in zip(self.parts, self.owners, strict=True):
            groups.setdefault(owner, []).append(part.triangles)
        return {owner: np.concatenate(triangles) for owner, triangles in groups.items()}


def show_parts(
    file: str,
    extraction: Extraction,
    parts: Sequence[Part],
    selection: tuple[RuleBook, TargetList | None],
    has_materials: bool,
    notes: list[str],
    draw: DrawFunction | None,
) -> ShownScene:
    """Finds the objects among the parts of a scene and loads the textures of the visible ones.

    Args:
        file: file name of the root layer, for messages.
        extraction: content of the stage.
        parts: parts of the stage, and the floor and ceiling that were added.
        selection: category rules, and the target list of the user if there is one.
        has_materials: whether to record the materials of objects.
        notes: notes of the compilation, to which this function adds.
        draw: function that returns the pixels of the textures of an authored scene.

    Raises:
        UsageError: the target list names prims that the stage does not have.
        WorldError: no part is visible.
    """
    visible = tuple(part for part in parts if not part.is_collider and part.surface.opacity >= _SEE_THROUGH)
    clear = sum(not part.is_collider for part in parts) - len(visible)
    if clear:
        notes.append(f"{clear} transparent parts are not rendered, but the robot cannot pass them")
    if not visible:
        raise WorldError(f"{file} contains no visible mesh except {clear} transparent ones; check their opacity")
    rules, chosen = selection
    users = {part.surface.picture: part.path for part in reversed(visible)}
    cutouts = {part.surface.picture: part.surface for part in visible if part.surface.cutout}
    book = load_textures(_texture_areas(visible), partial(_read_texture, extraction), users, draw, cutouts)
    notes += book.notes
    found_candidates = find_candidates(
        extraction, visible, rules, lambda parts_of_target: target_colour(parts_of_target, book)
    )
    candidates = apply_candidate_edits(found_candidates, visible, chosen)
    owners = assign_objects(visible, [candidate.path for candidate in candidates], extraction.models)
    candidates, owners = _joined(candidates, owners, chosen, notes)
    ids = number_objects(owners)
    return ShownScene(
        visible,
        candidates,
        owners=owners,
        ids=ids,
        book=book,
        chosen=chosen,
        uncoloured=rules.uncoloured,
        has_materials=has_materials,
    )


def _joined(
    candidates: tuple[Candidate, ...], owners: tuple[str, ...], chosen: TargetList | None, notes: list[str]
) -> tuple[tuple[Candidate, ...], tuple[str, ...]]:
    """Returns the candidates and owners, with one object for several that are drawn at one place or are its parts.

    Candidates that the user's list names remain separate.
    """
    listed = set() if chosen is None else {entry.prim_path for entry in chosen.targets}
    copies = find_copies([candidate for candidate in candidates if candidate.path not in listed])
    notes += [f"{copy}: drawn at the place of {first}, one object" for copy, first in copies.items()]
    kept = tuple(candidate for candidate in candidates if candidate.path not in copies)
    sections = find_sections([candidate for candidate in kept if candidate.path not in listed])
    notes += [f"{section}: touches {first}, one object" for section, first in sections.items()]
    first_of = copies | sections
    owned = (sections.get(first, first) for first in (copies.get(owner, owner) for owner in owners))
    return joined(kept, first_of), tuple(owned)


def _read_texture(extraction: Extraction, name: str) -> bytes | TextureRecipe | None:
    """Returns a texture from the content of the stage or, if it is not there, from a file."""
    if name in extraction.images:
        return extraction.images[name]
    from factory.scenes.importer.assets import read_asset  # imports OpenUSD

    return read_asset(name)


def _texture_areas(parts: Sequence[Part]) -> dict[str, float]:
    areas: dict[str, float] = {}
    for part in parts:
        if part.surface.texture:
            known = areas.get(part.surface.picture, 0.0)
            areas[part.surface.picture] = known + float(triangle_areas(part.triangles).sum())
    return areas


def instances_of(shown: ShownScene) -> tuple[Instance, ...]:
    """Returns the objects with number, category and materials, in the order of their paths."""
    categories = {candidate.path: candidate.category for candidate in shown.candidates}
    materials = materials_of(shown.parts, shown.owners) if shown.has_materials else {}
    return tuple(
        Instance(id=number, prim_path=path, category=categories.get(path), materials=materials.get(path, ()))
        for path, number in shown.ids.items()
    )
