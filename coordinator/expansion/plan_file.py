"""Loads plans by name or from TOML files, writes them as TOML, and reduces them. Errors name the key of every mistake.

No other module reads plan files. This module does not read scenes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w
from pydantic import ValidationError

from coordinator.expansion.builtin import BUILTIN_PLANS
from schemas.appearance.appearance_file import find_appearance
from schemas.builtin import BUILTIN_APPEARANCES, BUILTIN_RIGS
from schemas.config import CameraConfig
from schemas.errors import InvalidPlan, InvalidRig, UsageError
from schemas.layouts import with_episodes
from schemas.plan import MAX_EPISODES, Plan, ScenePlan
from schemas.rig import Rig
from schemas.rig.arrays import rig_faults
from schemas.rig.rig_file import load_rig, paper_rig
from schemas.support.apportion import apportion
from schemas.support.foreign import path_trouble
from schemas.support.suggest import did_you_mean
from schemas.support.toml_file import describe_mistakes, read_toml
from schemas.terms import ExpertName, Recording, SuccessMeasure, family_of

_MOST_ROUNDS = 5
"""Number of times that a plan is validated again without its wrong keys, to find further mistakes."""

_SET_BY_COMMANDS = {"correction": "factory correct", "extends": "factory run --extend"}
"""Keys that no file may set -> the command that sets them."""


def plan_to_toml(plan: Plan) -> str:
    """Returns the plan as TOML. Values that equal their default are omitted, except shares and success measure."""
    shares = {"tiers", "splits"}
    data = plan.model_dump(mode="json", exclude_defaults=True, exclude_none=True, exclude=shares)
    scenes = [{"file" if key == "usd" else key: value for key, value in scene.items()} for scene in data.pop("scenes")]
    data["task"] = {"success": str(plan.task.success), **data.pop("task", {})}
    data |= plan.model_dump(mode="json", include=shares)
    data["scenes"] = scenes
    return tomli_w.dumps(data)  # a template of text failed for paths with control characters


def load_plan(reference: str, success: SuccessMeasure = SuccessMeasure.SURFACE) -> Plan:
    """Returns a built-in plan by its name, or reads a TOML file.

    Args:
        reference: name of a built-in plan, or path of a file.
        success: success measure of a file without `task.success`; plan files of the first versions mean `centroid`.

    Raises:
        UsageError: neither a built-in plan nor a file has that name.
        InvalidPlan: the file has mistakes; the error lists all of them.
    """
    if reference in BUILTIN_PLANS:
        return BUILTIN_PLANS[reference]
    path = Path(reference)
    trouble = path_trouble(reference)
    if trouble:
        raise UsageError(f"cannot read plan {reference[:80]!r}: {trouble}")
    if not path.is_file():
        raise UsageError(_absent_message(reference, path))
    data = read_toml(path, "plan", InvalidPlan)
    foreign = [
        f"{key}: only `{setter}` sets this key; remove it" for key, setter in _SET_BY_COMMANDS.items() if key in data
    ]
    if foreign:
        raise InvalidPlan(f"{path} is not a valid plan", foreign)
    data.setdefault("name", _name_from(path))
    task = data.setdefault("task", {})
    if isinstance(task, dict):
        task.setdefault("success", success)
    shown = data.get("appearance")
    if isinstance(shown, str):
        data["appearance"] = find_appearance(shown if shown in BUILTIN_APPEARANCES else str(path.parent / shown))
    named = data.pop("rig") if isinstance(data.get("rig"), str) else None
    plan = parse_plan(data, str(path), base=path.parent, text=path.read_text(encoding="utf-8"))
    if named is None:
        return with_rig(plan, plan.rig)
    return with_rig(plan, load_rig(named if named in BUILTIN_RIGS else str(path.parent / named), control_hz=None))


def _absent_message(reference: str, path: Path) -> str:
    """Returns the error message for a reference that is neither a file nor a built-in plan."""
    known = f"the built-in plans are {', '.join(BUILTIN_PLANS)}"
    if path.is_dir():
        return f"no plan {reference!r}: that is a directory; give a TOML file ({known})"
    meant = did_you_mean(path.stem, BUILTIN_PLANS)
    if path.suffix or path.name != reference:
        return f"no plan {reference!r}: no such file ({known}){meant}"
    return f"no plan {reference!r}: no such file, and {known}{meant}"


def parse_plan(data: dict[str, Any], where: str, base: Path | None = None, text: str = "") -> Plan:
    """Validates a plan given as plain data.

    Args:
        data: data as parsed from TOML.
        where: name of the source for error messages.
        base: folder that relative paths are resolved against; `None` leaves the paths unchanged.
        text: the TOML text of the data, for the lines of the mistakes.

    Raises:
        InvalidPlan: the plan has mistakes; the error has one line per mistake, with its key.
    """
    try:
        plan = Plan.model_validate(data)
    except ValidationError as error:
        mistakes = _all_mistakes(data, error, text) + _implausible(data, text)
        raise InvalidPlan(f"{where} is not a valid plan", mistakes) from error
    # the models accept implausible values, because datasets may contain them
    if text and (mistakes := _implausible(data, text)):
        raise InvalidPlan(f"{where} is not a valid plan", mistakes)
    if base is None:
        return plan
    try:
        return plan.model_copy(update={"scenes": tuple(_anchored(scene, base) for scene in plan.scenes)})
    except (ValueError, OSError, RuntimeError) as error:  # a path has a NUL byte, or symbolic links form a loop
        raise InvalidPlan(f"{where} is not a valid plan", [f"a file of its scenes cannot be found: {error}"]) from error


def _all_mistakes(data: dict[str, Any], error: ValidationError, text: str) -> list[str]:
    """Returns the mistakes of a plan, including those that pydantic finds only when the first ones are corrected."""
    items: list[Any] = []
    removed: set[str] = set()
    for _ in range(_MOST_ROUNDS):
        new = [item for item in error.errors() if not any(name in str(item["msg"]) for name in removed)]
        items += [item for item in new if item["type"] != "missing" or str(item["loc"][-1]) not in removed]
        locations = [item["loc"] for item in error.errors() if item["loc"]]
        removed |= {str(location[min(2, len(location) - 1)]) for location in locations}
        data = _without(data, locations)
        if not locations or not data.get("scenes"):
            break
        try:
            Plan.model_validate(data)
        except ValidationError as found:
            error = found
        else:
            break
    return describe_mistakes(items, text, Plan)


def _without(data: dict[str, Any], locations: Sequence[tuple[str | int, ...]]) -> dict[str, Any]:
    """Returns a plan without the tables and the keys of scenes at some locations; replaces scenes without a name."""
    tables = {location[0] for location in locations if location[0] != "scenes"}
    rest = {key: value for key, value in data.items() if key not in tables}
    scenes = rest.get("scenes")
    if not isinstance(scenes, list):
        return {**rest, "scenes": []}
    kept = []
    for number, scene in enumerate(scenes):
        wrong = {at[2] if len(at) > 2 else "" for at in locations if at[:2] == ("scenes", number)}
        if not isinstance(scene, dict) or "" in wrong or ("name" in wrong and "file" not in scene):
            kept.append({"name": f"office_{number:05}", "episodes": 1})  # keeps the numbers of the other scenes
            continue
        valid = {"episodes": MAX_EPISODES // len(scenes), "name": f"scene_{number}"}
        right = {key: value for key, value in scene.items() if key not in wrong}
        kept.append({**right, **{key: value for key, value in valid.items() if key in wrong}})
    return {**rest, "scenes": kept}


class _Plausible(NamedTuple):
    """Range of a value outside which it is probably in another unit."""

    key: str
    lowest: float
    highest: float
    remark: str


_PLAUSIBLE = (
    _Plausible("camera.fov_deg", 10, 170, "degrees, not radians (90 degrees are 1.57 rad)"),
    _Plausible("camera.z_m", 0, 5, "metres, not centimetres"),
    _Plausible("camera.near_m", 0, 2, "metres, not centimetres"),
    _Plausible("camera.far_m", 1, 1000, "metres"),
    _Plausible("spawn.heading_noise_rad", 0, 3.15, "radians, not degrees (25 degrees are 0.44 rad)"),
    _Plausible("spawn.margin_m", 0, 2, "metres, not centimetres"),
    _Plausible("spawn.approach_clearance_m", 0, 2, "metres, not centimetres"),
    _Plausible("spawn.max_displacement_m", 0, 2, "metres, not centimetres"),
    _Plausible("task.success_radius_m", 0.05, 10, "metres, not centimetres"),
    _Plausible("task.control_hz", 1, 240, "steps per second, not seconds per step"),
)


def _implausible(data: Mapping[str, Any], text: str) -> list[str]:
    """Returns one sentence for each value that is probably in another unit."""
    items = []
    for key, lowest, highest, remark in _PLAUSIBLE:
        table, name = key.split(".")
        value = data[table].get(name) if isinstance(data.get(table), dict) else None
        if isinstance(value, int | float) and not isinstance(value, bool) and not lowest <= value <= highest:
            message = f"not plausible; the unit is {remark}; valid: {lowest:g} to {highest:g}"
            items.append({"loc": (table, name), "type": "implausible", "msg": message, "input": value})
    return describe_mistakes(items, text)


def _anchored(scene: ScenePlan, base: Path) -> ScenePlan:
    files = {"file": scene.file, "rules": scene.rules, "targets": scene.targets}
    named = [*files.items(), *(("models", folder) for folder in scene.models)]
    troubles = {key: path_trouble(str(base / file)) for key, file in named if file}
    if any(troubles.values()):
        lines = [f"scenes.{key}: {trouble}" for key, trouble in troubles.items() if trouble]
        raise InvalidPlan(f"scene {scene.name!r} has invalid file names", lines)
    resolved = {key: str((base / file).resolve()) for key, file in files.items() if file}
    models = tuple(str((base / folder).resolve()) for folder in scene.models)
    return scene.model_copy(update={**resolved, "models": models})


def with_rig(plan: Plan, rig: Rig | None) -> Plan:
    """Returns the plan with another rig. The rig `paper` becomes `None`, because its only sensor is recorded anyway.

    Raises:
        InvalidRig: the rates of the rig do not fit the plan, or an episode would have too many measurements.
    """
    if rig is not None:
        faults = rig_faults(rig, plan.task.control_hz, plan.task.max_steps)
        if faults:
            raise InvalidRig(f"rig {rig.name!r} does not fit plan {plan.name!r}", faults)
        if rig.sensors == paper_rig().sensors and plan.camera == CameraConfig():
            rig = None
    return plan.model_copy(update={"rig": rig})


def with_appearance(plan: Plan, reference: str) -> Plan:
    """Returns the plan with another appearance.

    Args:
        plan: plan.
        reference: name of a built-in appearance, path of a file, or `none`.

    Raises:
        UsageError: the appearance does not exist.
        InvalidAppearance: it has mistakes.
    """
    return plan.model_copy(update={"appearance": find_appearance(reference)})


def scene_of(plan: Plan, name: str) -> ScenePlan:
    """Returns the section of the plan for a scene.

    Raises:
        UsageError: the plan has no such scene.
    """
    scenes = {part.name: part for part in plan.scenes}
    if name not in scenes:
        names = f"{', '.join(scenes)}{did_you_mean(name, scenes)}"
        raise UsageError(f"plan {plan.name!r} has no scene {name!r}; its scenes: {names}")
    return scenes[name]


def scenes_named(plan: Plan, name: str) -> tuple[str, ...]:
    """Returns the single scenes that a name selects: a scene, a layout, or all layouts of a family.

    Raises:
        UsageError: the plan has no such scene.
    """
    parts = [part.name for part in plan.parts]
    if name in parts:
        return (name,)
    scene_of(plan, name)
    return tuple(part for part in parts if family_of(part) == name)


def shrink(
    plan: Plan,
    *,
    scenes: Sequence[str] = (),
    episodes: int | None = None,
    expert: ExpertName | None = None,
    seed: int | None = None,
    record: Recording | None = None,
    rig: Rig | None = None,
    appearance: str | None = None,
) -> Plan:
    """Returns the plan with fewer scenes or episodes in the same proportions, or with other values.

    Raises:
        UsageError: the plan has no such scene, or `episodes` is less than 1.
        InvalidRig: the rig does not fit the plan.
    """
    wanted = {scene_of(plan, name).name for name in scenes}
    parts = tuple(part for part in plan.scenes if part.name in wanted) or plan.scenes
    if episodes is not None:
        if episodes < 1:
            raise UsageError(f"--episodes {episodes}: must be at least 1")
        share = apportion({part.name: float(part.episodes) for part in parts}, episodes)
        parts = tuple(
            with_episodes(part, plan.splits_of(part), share[part.name]) for part in parts if share[part.name] > 0
        )
    chosen = {"expert": expert, "seed": seed, "record": record}
    changes: dict[str, Any] = {key: value for key, value in chosen.items() if value is not None}
    shrunk = plan.model_copy(update={"scenes": parts, **changes})
    shrunk = shrunk if rig is None else with_rig(shrunk, rig)
    return shrunk if appearance is None else with_appearance(shrunk, appearance)


def _name_from(path: Path) -> str:
    name = "".join(sign if sign.isalnum() else "_" for sign in path.stem.lower())
    return name if name[:1].isalpha() else f"plan_{name}"
