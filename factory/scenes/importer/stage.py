"""Opens a USD stage and traverses its visible prims, with their transforms to metres, z up.

Expands instances, payloads and point instancers. Does not read geometry or materials.
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

from factory.scenes.importer.diagnostics import format_error, format_warning, summarise, text_of
from factory.scenes.stage_file import require_stage
from schemas.errors import WorldError

BROKEN_PRIM = (ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RuntimeError)
"""Exceptions that a malformed prim causes, in USD (`Tf.ErrorException` is a RuntimeError) or in numpy."""

_Y_UP_TO_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_MOST_UNSEEN = 3
_SANE_METRES = (1e-6, 1e3)
_LATEST_START = Usd.TimeCode.EarliestTime()

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class SceneStage:
    """Opened stage with its transform to metres, z up."""

    stage: Any
    metres_per_unit: float
    to_metres: Matrix
    """(4, 4) transform stage -> world, for column vectors."""


@dataclass(frozen=True)
class PrimPlacement:
    """Instance of a prim with its world transform."""

    prim: Any
    path: str
    """Path that is unique in the scene; for copies of a point instancer, `/instancer/prototype[k]/...`."""
    to_world: Matrix
    """(4, 4) transform prim -> world metres, for column vectors."""


@dataclass
class _Walk:
    stage: Any
    notes: list[str]
    inside: tuple[str, ...] = ()
    """Point instancers on the current path, outermost first."""
    transforms: Any = field(default_factory=lambda: UsdGeom.XformCache(_LATEST_START))

    def matrix(self, prim: Any) -> Matrix:
        """Returns the transform (4, 4) prim -> stage, for column vectors."""
        return matrix_of(self.transforms.GetLocalToWorldTransform(prim))


def matrix_of(gf_matrix: Any) -> Matrix:
    """Converts a Gf matrix (row vectors) to a numpy matrix for column vectors."""
    return np.array(gf_matrix, dtype=np.float64).T


def open_stage(path: Path, notes: list[str]) -> SceneStage:
    """Opens a stage with all its payloads.

    Args:
        path: root layer: .usd, .usda, .usdc or .usdz.
        notes: list that receives the warnings of USD, one line each.

    Raises:
        UsageError: the file does not exist or is not USD.
        WorldError: USD cannot read the file, or its units are not valid.
    """
    require_stage(path)
    listener = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = format_error(text_of(error.__str__))
        raise WorldError(
            f"{path.name} is not a readable USD stage ({reason}); save it again with the program that wrote it"
        ) from error
    notes += take_warnings(listener)
    metres = float(UsdGeom.GetStageMetersPerUnit(stage))
    if not (np.isfinite(metres) and _SANE_METRES[0] <= metres <= _SANE_METRES[1]):
        raise WorldError(
            f"{path.name} has metersPerUnit = {metres:g}; set the length of its unit on the root layer, "
            "e.g. 1 (metres), 0.01 (centimetres) or 0.0254 (inches)"
        )
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        notes.append(
            f"no metersPerUnit authored; taken as {metres} metres; author it on the root layer if that is wrong"
        )
    if not stage.GetDefaultPrim():
        notes.append(_root_prims_note(stage))
    notes += _foreign_units(stage, metres)
    notes += _foreign_layers(stage, path)
    return SceneStage(stage, metres, _to_metres(stage, metres))


def take_warnings(listener: Any, ignored: str | None = None) -> list[str]:
    """Returns the warnings that a diagnostic delegate of USD has collected: a line with a count for each kind.

    Args:
        listener: delegate; it is emptied.
        ignored: word of warnings to omit.
    """
    texts = (text_of(partial(getattr, one, "commentary")) for one in listener.TakeUncoalescedDiagnostics())
    # USD's threads emit warnings in any order
    return summarise(sorted(format_warning(text) for text in texts if ignored is None or ignored not in text))


def _root_prims_note(stage: Any) -> str:
    """Returns the note on the imported prims of a stage without a valid defaultPrim."""
    wanted = stage.GetRootLayer().defaultPrim
    problem = f"defaultPrim {wanted!r} does not exist" if wanted else "no defaultPrim authored"
    return f"{problem}; all root prims are taken: {_roots(stage)}; deactivate those that are not of the scene"


def _roots(stage: Any) -> str:
    return ", ".join(str(prim.GetPath()) for prim in stage.GetPseudoRoot().GetChildren())[:200] or "none"


def _to_metres(stage: Any, metres: float) -> Matrix:
    scale = np.diag([metres, metres, metres, 1.0])
    is_y_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    return scale @ _Y_UP_TO_Z_UP if is_y_up else scale


def _foreign_units(stage: Any, metres: float) -> Iterator[str]:
    """Yields notes on layers with a different unit than the stage; USD does not convert the units of references."""
    for layer in sorted(stage.GetUsedLayers(), key=lambda layer: str(layer.GetDisplayName())):
        if layer == stage.GetRootLayer() or not layer.pseudoRoot.HasInfo("metersPerUnit"):
            continue
        unit_m = float(layer.pseudoRoot.GetInfo("metersPerUnit"))
        if abs(unit_m - metres) > 1e-9:
            yield f"{layer.GetDisplayName()} has metersPerUnit {unit_m}, the stage {metres}; taken as authored"


def _foreign_layers(stage: Any, root: Path) -> Iterator[str]:
    """Yields notes on layers outside the folder of the stage; a change of these files changes the scene."""
    folder = root.resolve().parent
    for layer in sorted(stage.GetUsedLayers(), key=lambda layer: str(layer.GetDisplayName())):
        file = Path(str(layer.realPath).partition("[")[0])
        if layer.realPath and not file.resolve().is_relative_to(folder):
            yield (
                f"{_user_of(stage, layer)}: layer {layer.GetDisplayName()} is outside of the stage's folder; read "
                "from where it is; move it below the folder to keep the scene as it is"
            )


def _user_of(stage: Any, layer: Any) -> str:
    """Returns the first prim that has an opinion in a layer."""
    prims = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
    users = (prim for prim in prims if any(spec.layer == layer for spec in prim.GetPrimStack()))
    return next((str(prim.GetPath()) for prim in users), "/")


def find_unseen(scene: SceneStage) -> list[str]:
    """Returns possible reasons why a stage is empty: the first prims that are inactive, invisible, guides or proxies.

    Args:
        scene: opened stage.
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
    """Yields each placement of every visible imageable prim, in the order of the stage.

    Args:
        scene: opened stage.
        notes: list that receives a note for each skipped prim.
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
                with np.errstate(all="ignore"):  # points that are not finite are rejected when they are transformed
                    place = frame @ walk.matrix(prim)
                yield PrimPlacement(prim, path, place)
        except BROKEN_PRIM as error:
            walk.notes.append(f"{path}: skipped, {format_error(text_of(error.__str__))}")


def _walk_copies(walk: _Walk, prim: Any, path: str, frame: Matrix) -> Iterator[PrimPlacement]:
    """Yields the prims of every visible copy of a point instancer."""
    if str(prim.GetPath()) in walk.inside:
        raise ValueError("a point instancer that copies itself; remove it from its own prototypes")
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

        def rename(walk_copies: Any, old: str = old, new: str = new) -> str:
            return new + str(walk_copies)[len(old) :]

        yield from _walk_below(walk, prototype, rename, place)
