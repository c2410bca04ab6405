"""Extends a finished dataset: plans the additional episodes as a separate run, and adds them when it is over.

The run has its directory inside the dataset until its episodes are added, so an interruption leaves the dataset as it
was. Existing episodes keep their numbers and bytes. Simulates nothing.

Design: docs/design/data.md#extended-datasets.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ValidationError

from coordinator.archive.opening import open_archive
from coordinator.archive.staging import is_held
from coordinator.expansion.cells import cells, marginal
from coordinator.expansion.plan_file import load_plan
from coordinator.ledger.opening import plan_differences
from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.merge.merge import MergedPart, add_episodes, add_scenes, write_joined
from factory.runs.plan_changes import PlanChanges
from factory.runs.start import shrunk_plan
from schemas.dataset.meta import DatasetMeta, read_dataset_meta
from schemas.errors import UsageError, WorldError
from schemas.layouts import unseen_layouts
from schemas.plan import Plan, ScenePlan
from schemas.storage.dataset_files import EXTENSION, FORMER_LEDGERS, RUN_SHARD_FILE, is_ledger_file
from schemas.storage.disk import sync_directory, translated
from schemas.support.apportion import apportion
from schemas.support.shell import quoted
from schemas.terms import Split, Tier

_EXTEND_STREAM = 5
_BASE = "base"


@dataclass(frozen=True)
class Extension:
    """Additional episodes of a dataset."""

    root: Path
    """Directory of the dataset."""
    base: DatasetMeta
    """Description of the dataset as it is."""
    whole: Plan
    """Plan of the extended dataset."""
    added: Plan
    """Plan of the additional episodes."""

    @property
    def site(self) -> Site:
        """Location of the run of the additional episodes."""
        return Site(self.root / EXTENSION, self.root / EXTENSION)


def plan_extension(name: str | None, site: Site, changes: PlanChanges) -> Extension | None:
    """Returns the additional episodes of a dataset; `None` if it has all requested episodes already.

    Args:
        name: name or file of the plan with more episodes; `None` uses the plan of the dataset.
        site: location of the dataset.
        changes: changes of the plan; without a name, only the number of episodes.

    Raises:
        UsageError: the dataset is unfinished, a shard, relabelled, merged or in object storage, or the plan differs in
            more than the numbers of episodes.
        WorldError: the location contains no dataset, or a coordinator uses it.
    """
    if site.store is not None:
        raise UsageError(
            f"--extend supports dataset directories only, not {site}: copy the dataset to a directory first"
        )
    meta, root = read_dataset_meta(site.place), site.state_dir
    _require_extensible(root, meta)
    recorded, begun = meta.plan, _begun(root)
    if name is not None:
        whole = shrunk_plan(load_plan(name, recorded.task.success), changes)
    else:
        _require_only_episodes(changes)
        if changes.episodes is None and begun is None:
            raise UsageError("--extend needs the new number of episodes: give --episodes N, or PLAN")
        whole = _continued(recorded, begun) if changes.episodes is None and begun else _grown(recorded, changes)
    _require_same_keys(recorded, whole, root)
    if whole.digest == recorded.digest:
        _remove(root / EXTENSION)  # an interruption can leave it after the episodes were added
        return None
    added = _added(meta, whole)
    if begun is not None and begun.digest != added.digest:
        raise UsageError(
            f"{root} has an unfinished extension by {begun.episodes} episodes, but {added.episodes} were requested: "
            f"finish it first with `factory run --extend --out {quoted(root)}`, or delete {quoted(root / EXTENSION)}"
        )
    return Extension(root, meta, whole, added)


def _require_extensible(root: Path, meta: DatasetMeta) -> None:
    if (root / RUN_SHARD_FILE).is_file():
        raise UsageError(f"{root} is a shard of a run: join the shards with `factory gather`, and extend the result")
    if meta.relabelling is not None:
        raise UsageError(f"{root} is relabelled: extend the dataset with its recorded instructions, and relabel that")
    if is_held(root):
        raise WorldError(f"{root} is in use by a coordinator: stop it, or wait for its end")
    if any(not source.extends for source in meta.sources[1:]):
        raise UsageError(f"{root} is a merged dataset: extend one of its sources, or run a plan and merge the result")
    if not meta.complete:
        raise UsageError(
            f"{root} has {meta.episodes} of {meta.planned} episodes: finish it with `factory run --out {quoted(root)}` "
            "first"
        )


def _begun(root: Path) -> Plan | None:
    """Returns the plan of an unfinished extension."""
    from factory.runs.ledger import plan_of

    site = Site(root / EXTENSION, root / EXTENSION)
    return plan_of(site) if site.state_dir.is_dir() else None


def _require_only_episodes(changes: PlanChanges) -> None:
    given = [name for name, value in vars(changes).items() if value and name != "episodes"]
    if given:
        raise UsageError(f"--extend keeps the plan of the dataset, so omit: {', '.join(f'--{one}' for one in given)}")


def _grown(plan: Plan, changes: PlanChanges) -> Plan:
    episodes = changes.episodes or plan.episodes
    share = apportion({scene.name: float(scene.episodes) for scene in plan.scenes}, episodes)
    if any(share[scene.name] < scene.episodes for scene in plan.scenes):
        raise UsageError(
            f"--episodes {episodes}: the dataset has {plan.episodes} episodes, and an extension removes none"
        )
    return _with_numbers(plan, share)


def _continued(plan: Plan, begun: Plan) -> Plan:
    added = {scene.name: scene.episodes for scene in begun.scenes}
    return _with_numbers(plan, {scene.name: scene.episodes + added.get(scene.name, 0) for scene in plan.scenes})


def _with_numbers(plan: Plan, numbers: Mapping[str, int]) -> Plan:
    scenes = tuple(scene.model_copy(update={"episodes": numbers[scene.name]}) for scene in plan.scenes)
    return plan.model_copy(update={"scenes": scenes})


def _require_same_keys(recorded: Plan, whole: Plan, root: Path) -> None:
    had = {scene.name: scene.episodes for scene in recorded.scenes}
    unchanged = _with_numbers(whole, {scene.name: had.get(scene.name, scene.episodes) for scene in whole.scenes})
    if unchanged.digest != recorded.digest:
        raise UsageError(
            f"{root} contains run {recorded.run}, and an extension changes numbers of episodes only: leave PLAN out to "
            "use the recorded plan (`--extend --episodes N`), or run the other plan into another --out and join both "
            "with `factory merge`" + "".join(f"\n  - {line}" for line in plan_differences(recorded, unchanged))
        )
    fewer = [scene for scene in whole.scenes if scene.episodes < had[scene.name]]
    if fewer:
        lines = "".join(
            f"\n  - {scene.name}: recorded {had[scene.name]}, requested {scene.episodes}" for scene in fewer
        )
        raise UsageError(f"an extension removes no episodes:{lines}")


def _added(meta: DatasetMeta, whole: Plan) -> Plan:
    """Returns the plan of the additional episodes.

    Each scene gets the difference of the quotas of its splits, and of its tiers, which Webster's method never makes
    negative. The seed derives from that of the dataset and its number of episodes, so no start is drawn twice.
    """
    recorded = meta.plan
    former = {scene.name: scene for scene in recorded.scenes}
    scenes = tuple(
        _difference(recorded, former[scene.name], whole, scene)
        for scene in whole.scenes
        if scene.episodes > former[scene.name].episodes
    )
    state = np.random.SeedSequence((recorded.seed, _EXTEND_STREAM, recorded.episodes)).generate_state(1, np.uint64)
    root = meta.sources[0].plan if meta.sources else recorded
    values = {
        "scenes": scenes,
        "seed": int(state[0]) >> 1,
        "extends": root.model_dump_json() if recorded.disjoint_instances else None,
    }
    try:
        return Plan.model_validate_json(whole.model_copy(update=values).model_dump_json())
    except ValidationError as error:
        lines = "".join(f"\n  - {each['msg']}" for each in error.errors())
        raise UsageError(f"the additional episodes have no valid plan; request more episodes:{lines}") from error


def _difference(recorded: Plan, former: ScenePlan, whole: Plan, scene: ScenePlan) -> ScenePlan:
    count = scene.episodes - former.episodes
    had, wanted = cells(recorded, former), cells(whole, scene)
    changes: dict[str, object] = {"episodes": count}
    axes: tuple[tuple[Literal[0, 1], str], ...] = ((0, "splits"), (1, "tiers"))
    for axis, key in axes:
        less, more = marginal(had, axis), marginal(wanted, axis)
        assert less <= more, (less, more)
        changes[key] = {name: number / count for name, number in (more - less).items()}
    if scene.layouts is not None:
        # the same layouts must stay unseen, even if the difference has other shares
        changes["unseen_layouts"] = unseen_layouts(former, recorded.splits_of(former)) or None
        _require_all_layouts(former, marginal(had, 0), marginal(wanted, 0), recorded)
    return scene.model_copy(update=changes)


def _require_all_layouts(
    scene: ScenePlan, had: Counter[Split | Tier], wanted: Counter[Split | Tier], plan: Plan
) -> None:
    unseen = unseen_layouts(scene, plan.splits_of(scene))
    for layouts, is_unseen in ((unseen, True), ((scene.layouts or 0) - unseen, False)):
        more = sum(wanted[split] - had[split] for split in Split if split.is_unseen_scene is is_unseen)
        if more < layouts:
            kind = "test_unseen_scene*" if is_unseen else "other"
            raise UsageError(
                f"{scene.name}: an extension uses all layouts of the family again, so its {kind} splits need at least "
                f"{layouts} more episodes, not {more}: request more episodes"
            )


def add_extension(extension: Extension, now: datetime) -> DatasetMeta:
    """Adds the episodes of the finished run of an extension to its dataset; a repetition continues an interruption.

    Raises:
        WorldError: the disk is full, or another process uses the dataset; existing episodes are unchanged.
    """
    root = extension.root
    base = MergedPart(_BASE, Dataset(root), 0)
    added = MergedPart(f"extension-{len(base.sources)}", Dataset(extension.site.place), extension.base.planned)
    sources = [*base.sources, *(each.model_copy(update={"extends": True}) for each in added.sources)]
    with open_archive(root) as archive:
        add_scenes(archive, added.dataset)
        for _ in add_episodes(archive, added):
            pass
        _retire_ledger(root, extension.base)
        meta = write_joined(archive, (base, added), plan=extension.whole, sources=sources, now=now)
    _remove(extension.site.state_dir)
    return meta


def _retire_ledger(root: Path, base: DatasetMeta) -> None:
    """Moves the ledger of the first run to a hidden folder, because no run of the whole dataset exists."""
    files = [path for path in root.iterdir() if is_ledger_file(path.name)]
    folder = root / FORMER_LEDGERS / base.run
    with translated("write", folder):
        for path in files:
            folder.mkdir(parents=True, exist_ok=True)
            path.rename(folder / path.name)
        if files:
            sync_directory(folder)
            sync_directory(root)


def _remove(folder: Path) -> None:
    with translated("delete", folder):
        if folder.is_dir():
            shutil.rmtree(folder)
