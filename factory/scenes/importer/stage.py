"""Opens a USD stage and walks what it shows: every placed prim with its transform into metres, z up.

Sees instances, payloads and point instancers; skips what is invisible. Never reads geometry or materials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Tf, Usd, UsdGeom, UsdUtils

from factory.scenes.importer.diagnostics import say_complaint, say_refusal, text_of
from factory.scenes.stage_file import require_stage
from schemas.errors import WorldError

__all__ = ["BROKEN_PRIM", "PrimPlacement", "SceneStage", "find_unseen", "matrix_of", "open_stage", "walk_stage"]

BROKEN_PRIM = (ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RuntimeError)
"""What a malformed prim raises, from USD (`Tf.ErrorException` is a RuntimeError) or from numpy."""

_Y_UP_TO_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_MOST_UNSEEN = 3
_SANE_METRES = (1e-6, 1e3)
_LATEST_START = Usd.TimeCode.EarliestTime()

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class SceneStage:
    """An opened stage and how its units become metres, z up."""

    stage: Any
    metres_per_unit: float
    to_metres: Matrix
    """(4, 4) stage -> world, column vectors."""


@dataclass(frozen=True)
class PrimPlacement:
    """One prim at one place."""

    prim: Any
    path: str
    """Unique in the scene; a copy of a point instancer reads `/instancer/prototype[k]/...`."""
    to_world: Matrix
    """(4, 4) prim -> world metres, column vectors."""


@dataclass
class _Walk:
    stage: Any
    notes: list[str]
    inside: tuple[str, ...] = ()
    """Point instancers that are being copied just now, outermost first."""
    transforms: Any = field(default_factory=lambda: UsdGeom.XformCache(_LATEST_START))

    def matrix(self, prim: Any) -> Matrix:
        """Returns (4, 4) prim -> stage, column vectors."""
        return matrix_of(self.transforms.GetLocalToWorldTransform(prim))


def matrix_of(gf_matrix: Any) -> Matrix:
    """Returns a Gf matrix (row vectors) as a numpy matrix for column vectors."""
    return np.array(gf_matrix, dtype=np.float64).T


def open_stage(path: Path, notes: list[str]) -> SceneStage:
    """Opens a stage with all its payloads.

    Args:
        path: the root layer: .usd, .usda, .usdc or .usdz.
        notes: receives what USD complained about, one line each.

    Raises:
        UsageError: there is no such file, or it is another format.
        WorldError: USD cannot read it, or its units make no sense.
    """
    require_stage(path)
    listener = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = say_refusal(text_of(error.__str__))
        raise WorldError(f"{path.name} is no readable USD stage ({reason}); check it with usdchecker") from error
    complaints = (
        say_complaint(text_of(partial(getattr, diagnostic, "commentary")))
        for diagnostic in listener.TakeUncoalescedDiagnostics()
    )
    notes += sorted(complaints)  # USD's threads complain in any order
    metres = float(UsdGeom.GetStageMetersPerUnit(stage))
    if not (np.isfinite(metres) and _SANE_METRES[0] <= metres <= _SANE_METRES[1]):
        raise WorldError(
            f"{path.name} says metersPerUnit = {metres:g}; author the length of its unit on the root layer, "
            "such as 1 (metres), 0.01 (centimetres) or 0.0254 (inches)"
        )
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        notes.append(
            f"no metersPerUnit authored; taken as {metres} metres; author it on the root layer if that is wrong"
        )
    if not stage.GetDefaultPrim():
        notes.append(_say_roots(stage))
    notes += _foreign_units(stage, metres)
    notes += _foreign_layers(stage, path)
    return SceneStage(stage, metres, _to_metres(stage, metres))


def _say_roots(stage: Any) -> str:
    """Which prims are taken where none is said to be the scene."""
    wanted = stage.GetRootLayer().defaultPrim
    found = f"defaultPrim {wanted!r} is not there" if wanted else "no defaultPrim authored"
    return f"{found}; all root prims are taken: {_roots(stage)}; deactivate those that are not of the scene"


def _roots(stage: Any) -> str:
    return ", ".join(str(prim.GetPath()) for prim in stage.GetPseudoRoot().GetChildren())[:200] or "none"


def _to_metres(stage: Any, metres: float) -> Matrix:
    scale = np.diag([metres, metres, metres, 1.0])
    is_y_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    return scale @ _Y_UP_TO_Z_UP if is_y_up else scale


def _foreign_units(stage: Any, metres: float) -> Iterator[str]:
    """USD does not convert the units of references; says which layers have others than the stage."""
    for layer in sorted(stage.GetUsedLayers(), key=lambda layer: str(layer.GetDisplayName())):
        if layer == stage.GetRootLayer() or not layer.pseudoRoot.HasInfo("metersPerUnit"):
            continue
        found = float(layer.pseudoRoot.GetInfo("metersPerUnit"))
        if abs(found - metres) > 1e-9:
            yield f"{layer.GetDisplayName()} has metersPerUnit {found}, the stage {metres}; taken as authored"


def _foreign_layers(stage: Any, root: Path) -> Iterator[str]:
    """Says which layers lie outside of the stage's folder: the scene changes when they do."""
    folder = root.resolve().parent
    for layer in sorted(stage.GetUsedLayers(), key=lambda layer: str(layer.GetDisplayName())):
        file = Path(str(layer.realPath).partition("[")[0])
        if layer.realPath and not file.resolve().is_relative_to(folder):
            yield (
                f"{_user_of(stage, layer)}: layer {layer.GetDisplayName()} lies outside of the stage's folder; read "
                "from where it is; move it below the folder to keep the scene as it is"
            )


def _user_of(stage: Any, layer: Any) -> str:
    """The first prim that has an opinion of a layer."""
    prims = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
    users = (prim for prim in prims if any(spec.layer == layer for spec in prim.GetPrimStack()))
    return next((str(prim.GetPath()) for prim in users), "/")


def find_unseen(scene: SceneStage) -> list[str]:
    """Returns what may be why a stage shows nothing: the first prims that are switched off, hidden or no scenery.

    Args:
        scene: the opened stage.
    """
    unseen = list(islice(_unseen(scene), _MOST_UNSEEN))
    return unseen or [f"no mesh or basic solid at or below {_roots(scene.stage)}"]


def _unseen(scene: SceneStage) -> Iterator[str]:
    for prim in Usd.PrimRange(scene.stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)):
        if not prim.IsActive():
            yield f"{prim.GetPath()} is not active"
        elif prim.IsA(UsdGeom.Gprim):
            shape = UsdGeom.Imageable(prim)
            if shape.ComputeVisibility(_LATEST_START) == UsdGeom.Tokens.invisible:
                yield f"{prim.GetPath()} is invisible"
            elif shape.ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
                yield f"{prim.GetPath()} has purpose {shape.ComputePurpose()}"


def walk_stage(scene: SceneStage, notes: list[str]) -> Iterator[PrimPlacement]:
    """Yields every visible imageable prim once per place, in the order of the stage.

    Args:
        scene: the opened stage.
        notes: receives what had to be skipped.
    """
    walk = _Walk(scene.stage, notes)
    yield from _walk_below(walk, scene.stage.GetPseudoRoot(), str, scene.to_metres)


def _walk_below(walk: _Walk, root: Any, name: Callable[[Any], str], frame: Matrix) -> Iterator[PrimPlacement]:
    prims = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))
    for prim in prims:
        if not prim.IsA(UsdGeom.Imageable):
            continue
        path = name(prim.GetPath())
        try:
            if UsdGeom.Imageable(prim).GetVisibilityAttr().Get(_LATEST_START) == UsdGeom.Tokens.invisible:
                prims.PruneChildren()
            elif prim.IsA(UsdGeom.PointInstancer):
                prims.PruneChildren()
                yield from list(_walk_copies(walk, prim, path, frame))
            else:
                with np.errstate(all="ignore"):  # what is not finite is refused where points are placed
                    place = frame @ walk.matrix(prim)
                yield PrimPlacement(prim, path, place)
        except BROKEN_PRIM as error:
            walk.notes.append(f"{path}: skipped, {say_refusal(text_of(error.__str__))}")


def _walk_copies(walk: _Walk, prim: Any, path: str, frame: Matrix) -> Iterator[PrimPlacement]:
    """The prims of every visible copy of a point instancer."""
    if str(prim.GetPath()) in walk.inside:
        raise ValueError("a point instancer that copies itself; take it out of its own prototypes")
    walk = replace(walk, inside=(*walk.inside, str(prim.GetPath())))
    instancer = UsdGeom.PointInstancer(prim)
    prototypes = [walk.stage.GetPrimAtPath(target) for target in instancer.GetPrototypesRel().GetForwardedTargets()]
    indices = instancer.GetProtoIndicesAttr().Get(_LATEST_START) or []
    if len(indices) and not 0 <= min(indices) <= max(indices) < len(prototypes):
        raise ValueError(f"protoIndices {min(indices)} to {max(indices)}, but {len(prototypes)} prototypes")
    mask = list(instancer.ComputeMaskAtTime(_LATEST_START))
    copies = instancer.ComputeInstanceTransformsAtTime(
        _LATEST_START, _LATEST_START, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
    )
    if len(copies) != len(indices):
        raise ValueError(f"{len(indices)} copies but {len(copies)} transforms")
    here = frame @ walk.matrix(prim)
    for k, (index, copy) in enumerate(zip(indices, copies, strict=True)):
        if mask and not mask[k]:
            continue
        prototype = prototypes[index]
        old, new = str(prototype.GetPath()), f"{path}/{prototype.GetName()}[{k}]"
        place = here @ matrix_of(copy) @ np.linalg.inv(walk.matrix(prototype))

        def rename(found: Any, old: str = old, new: str = new) -> str:
            return new + str(found)[len(old) :]

        yield from _walk_below(walk, prototype, rename, place)
