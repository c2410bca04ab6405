"""Prepares a run that renders a states dataset: frames plan, rig, scenes and failed attempts, and the recorded states.

The run uses the ledger, workers and validation of any run. A worker that gets the recorded states of its job renders
them; an episode without usable states is simulated, which gives the same content.
"""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import NamedTuple

import structlog

from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import Catalog, read_entry
from coordinator.expansion.plan_file import shrink, with_appearance
from coordinator.ledger.opening import require_plan
from factory.dataset.episode import Episode
from factory.dataset.packages import find_package_file
from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.runs.catalog import with_light
from factory.runs.ledger import plan_of, require_outside_datasets
from schemas.dataset.meta import DatasetMeta, described_by
from schemas.encoding.digest import frame_digest
from schemas.episode import BUNDLE_FORMAT
from schemas.errors import UsageError, WorldError
from schemas.job import Job
from schemas.plan import Plan
from schemas.protocol.messages import MAX_STATES_CHARS
from schemas.rig.rig_file import load_rig
from schemas.storage.dataset_files import ATTEMPTS_FILE, EPISODES, META_FILE
from schemas.storage.disk import free_bytes
from schemas.storage.place import Place, children
from schemas.storage.shard_index import episode_place
from schemas.terms import Recording, RendererKind
from workers.geometry.pose import Pose
from workers.render.choose import open_apart
from workers.render.differing import differing_frame

_LEAST_FRAME_BYTES = 150_000
"""Lower bound of the size of a frame, bytes: the size in the scene whose frames compress best."""

log = structlog.get_logger(__name__)


class Rendering(NamedTuple):
    """Run that renders the episodes of a states dataset."""

    plan: Plan
    """Plan of the recording, changed to record frames with the chosen rig and appearance."""
    catalog: Catalog
    """Scenes of the recording."""
    states: StatesSource
    """Recorded states."""
    dataset: Dataset
    """States dataset."""


def prepare_rendering(
    root: Place,
    site: Site,
    renderer: RendererKind | None = None,
    rig: str | None = None,
    appearance: str | None = None,
) -> Rendering:
    """Reads a states dataset, and prepares the location of the frames dataset if it is new.

    The location gets the failed attempts of the recording, so the ledger continues with the attempt that
    succeeded.

    Args:
        root: location of the states dataset.
        site: location of the frames dataset.
        renderer: renderer of this machine, whose frame 0 is compared with the recorded one; `None` compares nothing.
        rig: name or file of the rig whose measurements are stored; `None` uses that of the plan.
        appearance: name or file of the appearance of the frames, or `none`; `None` uses that of the plan.

    Raises:
        UsageError: the dataset stores frames already, the location contains another run, or the rig does not exist.
        InvalidRig: the rig has mistakes or does not fit the plan.
        ArchiveCorrupt: a table or a scene of the dataset is damaged or missing.
        WorldError: the episodes have a newer format, frame 0 of the renderer differs from the recorded one, the frames
            do not fit on the disk, or the location cannot be written.
    """
    dataset = Dataset(root)
    if dataset.meta.plan.record is not Recording.STATES:
        raise UsageError(f"{root} stores frames already: give a dataset of `factory run --record states`")
    if dataset.meta.sources:
        raise UsageError(
            f"{root} has episodes of {len(dataset.meta.sources)} runs, and frames are stored run by run: render the "
            "source "
            "datasets before `factory merge`, or use the frames that readers and `factory export` render from states"
        )
    _require_known_format(dataset)
    plan = shrink(dataset.meta.plan, record=Recording.FRAMES, rig=None if rig is None else load_rig(rig, None))
    if appearance is not None:
        plan = with_appearance(plan, appearance)
    meta = described_by(dataset.meta, plan)
    recorded = plan_of(site)
    if recorded is None:
        require_outside_datasets(site)
    else:
        require_plan(recorded, plan)
    packages = {name: find_package_file(root, name, sha256) for name, sha256 in dataset.meta.scenes.items()}
    catalog = with_light(plan, {name: read_entry(path) for name, path in packages.items()})
    if renderer is not None and len(dataset):
        _require_recorded_frame(dataset[0], renderer)
    if site.store is None:
        _require_room(dataset, site.state_dir)
    if missing := plan.episodes - len(dataset):
        log.warning(
            "states_missing",
            episodes=missing,
            remedy="finish the recording first; otherwise the missing episodes are simulated",
        )
    if recorded is None:
        _write_tables(dataset, meta, site)
    return Rendering(plan, catalog, StatesSource(dataset), dataset)


def _require_recorded_frame(episode: Episode, kind: RendererKind) -> None:
    """Raises `WorldError` if frame 0 of a renderer differs from the recorded one."""
    with episode, open_apart(kind) as renderer:
        meta, package = episode.meta, episode.package
        renderer.load_package(package.sha256, package.read, meta.job.camera)
        frame = renderer.render(Pose.of(episode.poses[0]))
        if frame_digest(frame.rgb, frame.depth, frame.ids) != meta.sampled_digests[0]:
            raise differing_frame(meta, 0, renderer.description)


def _require_known_format(dataset: Dataset) -> None:
    newest = max(dataset.metadata["format"].to_pylist(), default=0)
    if newest > BUNDLE_FORMAT:
        raise WorldError(
            f"{dataset.root} has episodes of bundle format {newest}, this software reads up to {BUNDLE_FORMAT}: "
            "upgrade minivla-factory"
        )


def _require_room(dataset: Dataset, folder: Path) -> None:
    """Raises `WorldError` if the frames that are not rendered yet cannot fit on the disk of a directory."""
    steps = dict(zip(*(dataset.metadata[name].to_pylist() for name in ("episode_id", "num_steps")), strict=True))
    for place in children(folder / EPISODES):
        steps.pop(place.stem, None)
    needed = sum(steps.values()) * _LEAST_FRAME_BYTES
    free = free_bytes(folder)
    if free < needed:
        raise WorldError(
            f"{sum(steps.values())} frames need at least {needed / 1e9:.2f} GB, and {folder} has {free / 1e9:.2f} GB "
            "free: free some space or choose another --out"
        )


def _write_tables(dataset: Dataset, meta: DatasetMeta, site: Site) -> None:
    """Writes the table of failed attempts, and metadata without episodes, from which the run is resumed."""
    meta = meta.model_copy(update={"episodes": 0, "complete": False, "dataset_digest": None})
    attempts, described = (dataset.root / ATTEMPTS_FILE).read_bytes(), meta.model_dump_json(indent=1).encode()
    with open_archive(site.state_dir, site.store) as archive:
        # META_FILE is last, because it marks a run
        for name, data in ((ATTEMPTS_FILE, attempts), (META_FILE, described)):
            with archive.replacing(name) as part:
                part.write_bytes(data)


class StatesSource:
    """Function that returns the recorded states of a job as base64, or `None` if the dataset has no intact file of the
    episode."""

    def __init__(self, dataset: Dataset) -> None:
        self._root = dataset.root
        columns = dataset.metadata.select(["index", "draw", "attempt", "file_sha256"]).to_pydict()
        self._files = {
            index: (draw, attempt, bytes.fromhex(sha256))
            for index, draw, attempt, sha256 in zip(*columns.values(), strict=True)
        }

    def __call__(self, job: Job) -> str | None:
        """Reads and checks the file of the job's episode."""
        draw, attempt, sha256 = self._files.get(job.index, (-1, -1, b""))
        if (draw, attempt) != (job.draw, job.attempt):
            return None
        path = episode_place(self._root, job.index)
        try:
            data = path.read_bytes()
        except OSError as error:
            return _refuse(job, f"{path} cannot be read: {error}")
        if hashlib.sha256(data).digest() != sha256:
            return _refuse(job, f"{path} differs from the SHA-256 in the metadata")
        text = base64.b64encode(data).decode()
        return text if len(text) <= MAX_STATES_CHARS else _refuse(job, f"{path} is too large for a message")


def _refuse(job: Job, reason: str) -> str | None:
    log.warning("states_unusable", episode=job.episode_id, reason=reason, remedy="the episode is simulated again")
    return None
