"""Order of `factory eval`: builds the campaign and opens the result store from the options, with progress bars."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.progress import MofNCompleteColumn, ProgressColumn, TimeElapsedColumn, TimeRemainingColumn

from coordinator.defaults import usable_cores
from factory.dataset.reader import Dataset
from factory.eval.driving.live_view import live_appearance, require_live
from factory.eval.models.messages import EvalSetup
from factory.eval.models.result import Latency, Variant
from factory.eval.models.spec import SpecSet, read_specs
from factory.eval.policies.made_from import GREETING, another_policy, greeting_now, hashes_now
from factory.eval.policies.registry import check_name, file_of, is_user_class, named, require_available
from factory.eval.policies.user_class import source_folder
from factory.eval.process.local_campaign import Pace
from factory.eval.results.publish import publish
from factory.eval.results.score import Evaluation
from factory.eval.results.store import EvalManifest, Store
from factory.eval.specs.campaign import ABLATIONS, Campaign
from factory.eval.specs.from_dataset import specs_of_dataset, splits_of
from factory.support.terminal import Bars, one_bar
from schemas.appearance import Appearance
from schemas.errors import UsageError
from schemas.rig.rig_file import load_rig
from schemas.terms import RendererKind, Split
from schemas.view import ViewSettings

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EvalOptions:
    """The values of the options of `factory eval`; see the help of the command."""

    root: Path
    splits: tuple[str, ...] | None
    policies: tuple[str, ...]
    specs_path: Path | None
    ablate_language: bool
    episodes: int | None
    workers: int | None
    act_timeout: float
    load_timeout: float
    with_pose: bool
    renderer: RendererKind
    rig: str | None = None
    appearance: str | None = None
    latency: Latency | None = None


def make_campaign(options: EvalOptions, drives_here: bool = True) -> Campaign:
    """Returns the campaign that the options describe.

    Args:
        options: values of the options.
        drives_here: True if this machine runs the episodes, so the policies must be installed here.

    Raises:
        UsageError: a policy, a split, the specs file or the rig does not exist, a package of a policy or of a sensor is
            not installed, or the rig cannot be measured during a drive.
    """
    if not options.policies:
        raise UsageError("--policy is missing; example: factory eval DIR --policy expert")
    references = _references(options.policies)
    for reference in references.values():
        check_name(reference)
        if drives_here:
            require_available(reference)
    specs = _specs(Dataset(options.root), options)
    rig = None if options.rig is None else load_rig(options.rig, specs.settings.task.control_hz)
    if rig is not None:
        require_live(rig, specs.settings.task.control_hz)
    setup = EvalSetup(
        settings=specs.settings,
        renderer=options.renderer,
        act_timeout_s=options.act_timeout,
        load_timeout_s=options.load_timeout,
        latency=options.latency,
        view=ViewSettings(rig=rig, appearance=_appearance(options.appearance)),
    )
    return Campaign(
        specs=specs,
        root=options.root,
        policies=tuple(references),
        references=references,
        variants=(Variant.ORIGINAL, *ABLATIONS) if options.ablate_language else (Variant.ORIGINAL,),
        setup=setup,
        processes=min(options.workers or usable_cores(), len(specs.specs)),
        with_pose=options.with_pose,
    )


def _references(policies: tuple[str, ...]) -> dict[str, str]:
    """Returns name -> reference of the policies.

    Raises:
        UsageError: Two policies have one name.
    """
    references: dict[str, str] = {}
    for text in policies:
        name, reference = named(text)
        if references.setdefault(name, reference) != reference:
            raise UsageError(f"--policy {name} is given for {references[name]} and for {reference}; choose two names")
    return references


def _appearance(reference: str | None) -> Appearance | None:
    return None if reference is None else live_appearance(reference)


def open_store(campaign: Campaign, folder: Path) -> Store:
    """Opens a new or existing results directory."""
    manifest = EvalManifest(
        run=Dataset(campaign.root).meta.run,
        specs_digest=campaign.specs.digest,
        with_pose=campaign.with_pose,
        act_timeout_s=campaign.setup.act_timeout_s,
        latency=campaign.setup.latency,
        view=campaign.setup.view,
    )
    return Store(folder, campaign.specs, manifest)


def require_same_policies(campaign: Campaign, store: Store) -> None:
    """Compares files and greetings of the policies with those of the stored results, before any episode is run.

    Raises:
        UsageError: a policy has changed; the message contains the hashes and the remedy.
    """
    for name in campaign.policies:
        note = store.note_of(name)
        if note is None or not store.results(name):
            continue
        former = note.reference or note.policy
        if former != campaign.reference(name):
            raise UsageError(
                f"the results of {name} in {store.root} are those of {former}, not of {campaign.reference(name)}: give "
                "another name or another -o, or --restart, which keeps the former results in the folder `former`"
            )
        reference = campaign.reference(name)
        file = file_of(reference)
        folder = source_folder(reference) if is_user_class(reference) else None if file is None else file.parent
        known = {entry: value for entry, value in note.made_from.items() if entry != GREETING}
        now = hashes_now(known, folder)
        if GREETING in note.made_from:
            known, now = note.made_from, greeting_now(reference)
            if not now:
                _log.warning(
                    "%s cannot be reached, so its stored results are not compared with its greeting", reference
                )
                continue
        if error := another_policy(name, known, now, store.root):
            raise error


@contextmanager
def pace_bars(campaign: Campaign) -> Iterator[Callable[[Pace], None]]:
    """Shows one progress bar per policy; yields the function that updates them."""
    with Bars(*_counts()) as bar:
        tasks = {name: bar.add_task(name, total=None) for name in campaign.policies}

        def show(pace: Pace) -> None:
            note = f"{pace.successes} succeeded"
            if pace.waiting:
                bar.console.print(f"{pace.policy}: {pace.waiting}")
            bar.update(tasks[pace.policy], completed=pace.done, total=pace.total, note=note)

        yield show


def published(campaign: Campaign, store: Store, videos: int) -> Evaluation:
    """Writes all results and returns them."""
    with one_bar("videos of failures", *_counts()) as on_progress:
        return publish(campaign, store, videos, on_progress)


def _specs(dataset: Dataset, options: EvalOptions) -> SpecSet:
    """Returns the specs in the file, or creates them from the dataset."""
    if options.specs_path is not None:
        splits = frozenset(map(Split, options.splits)) if options.splits else None
        return read_specs(options.specs_path).only(splits, options.episodes)
    chosen = splits_of(dataset, options.splits)
    with one_bar("start states", *_counts()) as on_progress:
        return specs_of_dataset(dataset, chosen, on_progress, options.episodes)


def _counts() -> tuple[ProgressColumn, ...]:
    return MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
