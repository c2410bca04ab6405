"""Opens a USD stage and walks what it shows: every placed prim with its transform into metres, z up.

Sees instances, payloads and point instancers; skips what is invisible. Never reads geometry or materials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Tf, Usd, UsdGeom, UsdUtils

from schemas.errors import UsageError, WorldError

__all__ = ["BROKEN_PRIM", "Placement", "SceneStage", "matrix_of", "open_stage", "walk_stage"]

BROKEN_PRIM = (ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RuntimeError)
"""What a malformed prim raises, from USD (`Tf.ErrorException` is a RuntimeError) or from numpy."""

_Y_UP_TO_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
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
class Placement:
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
        UsageError: there is no such file.
        WorldError: USD cannot read it, or its units make no sense.
    """
    if not path.is_file():
        raise UsageError(f"no USD file at {path}; give the path of the stage's root layer")
    listener = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = _one_line(str(error)).rpartition(" : ")[2].strip("'")
        raise WorldError(f"{path.name} is no readable USD stage ({reason}); check it with usdchecker") from error
    notes += [_one_line(diagnostic.commentary) for diagnostic in listener.TakeUncoalescedDiagnostics()]
    metres = float(UsdGeom.GetStageMetersPerUnit(stage))
    if not (np.isfinite(metres) and _SANE_METRES[0] <= metres <= _SANE_METRES[1]):
        raise WorldError(
            f"{path.name} says metersPerUnit = {metres:g}; author the length of its unit on the root layer, "
            "such as 1 (metres), 0.01 (centimetres) or 0.0254 (inches)"
        )
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        notes.append(f"no metersPerUnit authored; taken as {metres} metres")
    if not stage.HasDefaultPrim():
        roots = ", ".join(str(prim.GetPath()) for prim in stage.GetPseudoRoot().GetChildren()) or "none"
        notes.append(f"no defaultPrim authored; all root prims are taken: {roots[:200]}")
    notes += _foreign_units(stage, metres)
    notes += _foreign_layers(stage, path)
    return SceneStage(stage, metres, _to_metres(stage, metres))


def _one_line(text: str) -> str:
    return " ".join(text.split())[:300]


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
            yield f"layer {layer.GetDisplayName()} lies outside of the stage's folder; read from where it is"


def walk_stage(scene: SceneStage, notes: list[str]) -> Iterator[Placement]:
    """Yields every visible imageable prim once per place, in the order of the stage.

    Args:
        scene: the opened stage.
        notes: receives what had to be skipped.
    """
    walk = _Walk(scene.stage, notes)
    yield from _walk_below(walk, scene.stage.GetPseudoRoot(), str, scene.to_metres)


def _walk_below(walk: _Walk, root: Any, name: Callable[[Any], str], frame: Matrix) -> Iterator[Placement]:
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
                yield Placement(prim, path, place)
        except BROKEN_PRIM as error:
            walk.notes.append(f"{path}: skipped, {_one_line(str(error))}")


def _walk_copies(walk: _Walk, prim: Any, path: str, frame: Matrix) -> Iterator[Placement]:
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
