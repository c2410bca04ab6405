"""Determines the plan and the scenes of a damaged dataset from its intact files. Writes nothing into the dataset.

Missing scenes are built in the user's cache, and used only when their bytes match the recorded digest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from coordinator.expansion.catalog import Catalog, SceneEntry, read_entry
from coordinator.ledger.opening import FormerFormat, holds_run, ledger_url_of, read_info, require_plan
from coordinator.ledger.reading.reader import open_ledger
from coordinator.recovery.repair_dataset import RepairInput
from coordinator.recovery.survey import count_plans
from factory.dataset.packages import package_copy
from factory.dataset.site import Site
from factory.runs.catalog import collect_scenes, open_catalog
from factory.runs.ledger import shard_of
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.run_shard import RunShard
from schemas.errors import FactoryError, InvalidBundle, UsageError, WorldError
from schemas.plan import Plan
from schemas.scene.info import texture_file
from schemas.storage.dataset_files import SCENES
from schemas.storage.place import Place, digest_of, local_copy

MessageCallback = Callable[[str], None]


@dataclass(frozen=True)
class _Record:
    """Plan and scenes as recorded in one source, the ledger or `dataset_meta.json`."""

    plan: Plan
    scenes: Mapping[str, str]
    """Scene name -> SHA-256 of its package; empty when the source contains the plan only."""


def inspect_dataset(
    root: Place, state_dir: Path, plan: Plan | None, url: str | None, cache: Path, tell: MessageCallback
) -> RepairInput:
    """Returns the input of a repair.

    Args:
        root: Location of the dataset.
        state_dir: Directory of the ledger, unless `url` is given: the dataset directory, or the state directory of a
            dataset in object storage.
        plan: Plan given by the user; `None` uses the plan in the ledger or in `dataset_meta.json`.
        url: URL of the ledger, if it is not in `state_dir`.
        cache: Folder in which missing scenes are built.
        tell: Called with the name of each scene to be built.

    Raises:
        UsageError: The directory does not exist, or no source contains the plan.
        WorldError: A scene does not match its recorded digest and cannot be rebuilt.
    """
    if not root.is_dir():
        raise UsageError(f"directory {root} does not exist; give the --out of a run")
    ledger = ledger_url_of(state_dir, url)
    noted, described = _from_ledger(ledger), _from_meta(root)
    record, foreign_ledger = _settle_plan(root, noted, described, plan)
    if record is None:
        raise UsageError(
            f"neither the ledger nor dataset_meta.json of {root} contains a readable plan of the run: give the plan "
            "with --plan FILE.toml or --plan NAME"
        )
    catalog, troubles = _catalog(record, root, cache, tell)
    return RepairInput(
        root,
        state_dir,
        url=ledger,
        plan=record.plan,
        catalog=catalog,
        scenes=troubles,
        shard=_shard_of(Site(root, state_dir), url),
        foreign_ledger=foreign_ledger,
    )


def _settle_plan(
    root: Place, noted: _Record | None, described: _Record | None, plan: Plan | None
) -> tuple[_Record | None, str]:
    """Returns the record of the run and, if the ledger belongs to another run, a message that says so.

    The ledger, `dataset_meta.json` and the user can name different plans; the plan of most episodes is used.
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
    return record, f"belongs to run {noted.plan.run}, the episodes to run {record.plan.run}"


def _from_ledger(url: str) -> _Record | None:
    try:
        with open_ledger(url) as connection:
            info = read_info(connection) if holds_run(connection) else None
    except (WorldError, FormerFormat):
        return None
    return None if info is None else _Record(info.plan, {**info.scenes, **info.layouts})


def _shard_of(site: Site, url: str | None) -> RunShard | None:
    try:
        return shard_of(site, url)
    except FormerFormat:
        return None  # a shard has `run_shard.json` since its start


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
        package = _kept(root / SCENES / f"{name}-{sha256[:16]}.scene.zip", sha256)
        if isinstance(package, str):
            troubles[name] = package
        else:
            kept[name] = package
    troubles |= _lacking_textures(root, kept)
    if troubles:
        kept |= _built_again(record, troubles, cache, tell)
    return kept, troubles


def _kept(path: Place, sha256: str) -> SceneEntry | str:
    try:
        with local_copy(path) as package:
            entry = read_entry(package)
    except FileNotFoundError:
        return f"{path.name} is missing"
    except (InvalidBundle, OSError) as error:
        return f"{path.name} is damaged: {error}"
    if entry.sha256 != sha256:
        return f"{path.name} has SHA-256 {entry.sha256}, recorded {sha256}"
    return replace(entry, path=package_copy(path))


def _lacking_textures(root: Place, kept: Mapping[str, SceneEntry]) -> dict[str, str]:
    """Returns scenes to build so that all missing and damaged textures are created again, each with the reason.

    Layouts share textures, so not every scene that uses a missing texture must be built.
    """
    faults: dict[str, str] = {}
    for sha256 in dict.fromkeys(texture for entry in kept.values() for texture in entry.textures):
        place = root / SCENES / texture_file(sha256)
        try:
            if digest_of(place) != sha256:
                faults[sha256] = f"texture {place.name} is damaged"
        except FileNotFoundError:
            faults[sha256] = f"texture {place.name} is missing"
    troubles: dict[str, str] = {}
    for name, entry in kept.items():
        texture_faults = [faults.pop(sha256) for sha256 in entry.textures if sha256 in faults]
        if texture_faults:
            troubles[name] = "; ".join(texture_faults)
    return troubles


def _built_again(
    record: _Record, troubles: Mapping[str, str], cache: Path, tell: MessageCallback
) -> dict[str, SceneEntry]:
    try:
        made = collect_scenes(record.plan, cache / "nowhere", cache, tell, only=troubles.keys())
    except FactoryError as error:
        raise WorldError(f"{'; '.join(troubles.values())}; the scene cannot be built again: {error}") from error
    for name in troubles:
        if made[name].sha256 != record.scenes[name]:
            raise WorldError(
                f"{troubles[name]}; built again it has SHA-256 {made[name].sha256}, so another version built it: "
                f"restore the package from a backup into {SCENES}/"
            )
    return dict(made)
