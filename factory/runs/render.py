"""Prepares a run that renders a states dataset: its frames plan, scenes and failed attempts, and the recorded states.

The run uses the ledger, workers and validation of any run. A worker that gets the recorded states of its job renders
them; an episode without usable states is simulated, which gives the same content.
"""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import NamedTuple

import structlog

from coordinator.expansion.catalog import Catalog, read_entry
from coordinator.ledger.opening import require_plan
from factory.dataset.packages import find_package_file
from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.runs.ledger import plan_of
from schemas.dataset_files import ATTEMPTS_FILE, META_FILE
from schemas.dataset_meta import DatasetMeta
from schemas.errors import UsageError
from schemas.job import Job
from schemas.plan import Plan
from schemas.storage.disk import replacing, translated
from schemas.storage.place import Place
from schemas.storage.shard_index import episode_place
from schemas.terms import Recording
from schemas.wire import MAX_STATES_CHARS

log = structlog.get_logger(__name__)


class Rendering(NamedTuple):
    """Run that renders the episodes of a states dataset."""

    plan: Plan
    """Plan of the recording, which records frames."""
    catalog: Catalog
    """Scenes of the recording."""
    states: StatesSource
    """Recorded states."""
    meta: DatasetMeta
    """Description of the states dataset."""


def prepare_rendering(root: Place, site: Site) -> Rendering:
    """Reads a states dataset, and prepares the directory of the frames dataset if it is new.

    The directory gets the failed attempts of the recording, so that the ledger continues with the attempt that
    succeeded.

    Raises:
        UsageError: the dataset stores frames already, or the directory contains another run.
        ArchiveCorrupt: a table or a scene of the dataset is damaged or missing.
        WorldError: the directory cannot be written.
    """
    dataset = Dataset(root)
    if dataset.meta.plan.record is not Recording.STATES:
        raise UsageError(f"{root} stores frames already: give a dataset of `factory run --record states`")
    if site.store is not None:
        raise UsageError(f"-o {site}: rendering into object storage is not supported; choose a directory")
    plan = dataset.meta.plan.model_copy(update={"record": Recording.FRAMES})
    begun = plan_of(site)
    if begun is not None:
        require_plan(begun, plan)
    packages = {name: find_package_file(root, name, sha256) for name, sha256 in dataset.meta.scenes.items()}
    catalog = {name: read_entry(path) for name, path in packages.items()}
    if begun is None:
        _write_tables(dataset, plan, site.home)
    return Rendering(plan, catalog, StatesSource(dataset), dataset.meta)


def _write_tables(dataset: Dataset, plan: Plan, folder: Path) -> None:
    """Writes the failed attempts and a description of a dataset without episodes, which name the run to resume."""
    meta = dataset.meta.model_copy(
        update={
            "run": plan.run,
            "plan_digest": plan.digest,
            "plan": plan,
            "episodes": 0,
            "complete": False,
            "dataset_digest": None,
        }
    )
    attempts, described = (dataset.root / ATTEMPTS_FILE).read_bytes(), meta.model_dump_json(indent=1).encode()
    with translated("write", folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, data in ((ATTEMPTS_FILE, attempts), (META_FILE, described)):  # the description makes it a run
        with replacing(folder / name) as part:
            part.write_bytes(data)


class StatesSource:
    """Function that returns the states recording of a job, base64, or `None` if the dataset has none that is whole."""

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
            return _refuse(job, f"{path} has another SHA-256 than the metadata")
        text = base64.b64encode(data).decode()
        return text if len(text) <= MAX_STATES_CHARS else _refuse(job, f"{path} is larger than a message")


def _refuse(job: Job, reason: str) -> str | None:
    log.warning("states_unusable", episode=job.episode_id, reason=reason, remedy="the episode is simulated again")
    return None
