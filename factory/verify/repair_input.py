"""Finds out what a damaged dataset directory was: its plan and its scenes, from what is still whole. Writes nothing.

What is missing is built again in the user's cache, and used only when it comes out bit for bit as recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from coordinator.expansion.catalog import Catalog, SceneEntry, read_entry
from coordinator.ledger.opening import holds_run, ledger_url_of, read_info, require_plan
from coordinator.ledger.reading.reader import open_ledger
from coordinator.recovery.repair_dataset import RepairInput
from coordinator.recovery.stray_files import count_plans
from factory.dataset.packages import package_file
from factory.runs.catalog import open_catalog
from schemas.dataset_files import SCENES
from schemas.dataset_meta import read_dataset_meta
from schemas.errors import FactoryError, InvalidBundle, UsageError, WorldError
from schemas.plan import Plan
from schemas.storage.place import Place, at_hand

__all__ = ["inspect_dataset"]

MessageCallback = Callable[[str], None]


@dataclass(frozen=True)
class _Record:
    """What some witness says of the run."""

    plan: Plan
    scenes: Mapping[str, str]
    """Scene name -> SHA-256 of its package; empty when only the plan is known."""


def inspect_dataset(
    root: Place, home: Path, plan: Plan | None, url: str | None, cache: Path, tell: MessageCallback
) -> RepairInput:
    """Returns what a repair has to know.

    Args:
        root: of the dataset.
        home: where its ledger lies, unless `url` says so: the directory itself, or the home of one in object storage.
        plan: as the user gives it; `None` takes what ledger or `dataset_meta.json` say.
        url: of the ledger, when not in the directory.
        cache: where missing scenes are built.
        tell: told the name of a scene that has to be built.

    Raises:
        UsageError: there is no such directory, or nothing says what was planned.
        WorldError: a scene is not as recorded and cannot be built so again.
    """
    if not root.is_dir():
        raise UsageError(f"directory {root} does not exist; give the --out of a run")
    ledger = ledger_url_of(home, url)
    noted, described = _from_ledger(ledger), _from_meta(root)
    record, stranger = _settle_plan(root, noted, described, plan)
    if record is None:
        raise UsageError(
            f"neither the ledger nor dataset_meta.json of {root} contains the plan of the run: give the plan "
            "with --plan FILE.toml or --plan NAME"
        )
    catalog, troubles = _catalog(record, root, cache, tell)
    return RepairInput(root, home, ledger, record.plan, catalog, troubles, stranger)


def _settle_plan(
    root: Place, noted: _Record | None, described: _Record | None, plan: Plan | None
) -> tuple[_Record | None, str]:
    """Returns what the run was, and why the ledger is not of it where it names another plan.

    Ledger, description and user may name different plans; which one is right, the episodes say.
    """
    records = [record for record in (noted, described) if record is not None]
    if plan is not None and all(record.plan.digest != plan.digest for record in records):
        records.insert(0, _Record(plan, {}))
    if len({record.plan.digest for record in records}) <= 1:
        return (records[0] if records else None), ""
    counts, wanted = count_plans(root), None if plan is None else plan.digest
    record = max(records, key=lambda one: (counts[one.plan.digest], one.plan.digest == wanted))
    if plan is not None and record.plan.digest != plan.digest:
        require_plan(record.plan, plan)
    if noted is None or noted.plan.digest == record.plan.digest:
        return record, ""
    return record, f"is of run {noted.plan.run}, the episodes of run {record.plan.run}"


def _from_ledger(url: str) -> _Record | None:
    try:
        with open_ledger(url) as connection:
            info = read_info(connection) if holds_run(connection) else None
    except WorldError:
        return None
    return None if info is None else _Record(info.plan, info.scenes)


def _from_meta(root: Place) -> _Record | None:
    try:
        meta = read_dataset_meta(root)
    except WorldError:
        return None
    return _Record(meta.plan, meta.scenes)


def _catalog(record: _Record, root: Place, cache: Path, tell: MessageCallback) -> tuple[Catalog, Mapping[str, str]]:
    if not record.scenes:
        return open_catalog(record.plan, root, cache, tell), {}
    kept: dict[str, SceneEntry] = {}
    troubles: dict[str, str] = {}
    for name, sha256 in record.scenes.items():
        found = _kept(root / SCENES / f"{name}-{sha256[:16]}.scene.zip", sha256)
        if isinstance(found, str):
            troubles[name] = found
        else:
            kept[name] = found
    if troubles:
        kept |= _built_again(record, troubles, cache, tell)
    return kept, troubles


def _kept(path: Place, sha256: str) -> SceneEntry | str:
    try:
        with at_hand(path) as package:
            entry = read_entry(package)
    except FileNotFoundError:
        return f"{path.name} is not there"
    except (InvalidBundle, OSError) as error:
        return f"{path.name} is damaged: {error}"
    if entry.sha256 != sha256:
        return f"{path.name} has SHA-256 {entry.sha256}, recorded {sha256}"
    return replace(entry, path=package_file(path))


def _built_again(
    record: _Record, troubles: Mapping[str, str], cache: Path, tell: MessageCallback
) -> dict[str, SceneEntry]:
    wanted = tuple(scene for scene in record.plan.scenes if scene.name in troubles)
    try:
        made = open_catalog(record.plan.model_copy(update={"scenes": wanted}), cache / "nowhere", cache, tell)
    except FactoryError as error:
        raise WorldError(f"{'; '.join(troubles.values())}; the scene cannot be built again: {error}") from error
    for name in troubles:
        if made[name].sha256 != record.scenes[name]:
            raise WorldError(
                f"{troubles[name]}; built again it has SHA-256 {made[name].sha256}, so another version built it: "
                "restore "
                f"the package from a backup into {SCENES}/"
            )
    return dict(made)
