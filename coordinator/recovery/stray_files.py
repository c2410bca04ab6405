"""Classifies episode files without a ledger record: determines to which attempt of the plan each file belongs.

The module reads and validates files; it does not move or write files.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType

from sqlalchemy import select
from sqlalchemy.engine import Connection

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand, redraw, to_job
from coordinator.ledger.opening import planned_of
from coordinator.ledger.repair import obstacle_to
from coordinator.ledger.tables import jobs
from coordinator.transfer.contract import EpisodeValidator
from schemas.bundle import BundleReader
from schemas.dataset.rows import EpisodeSummary, summary_of
from schemas.errors import InvalidBundle
from schemas.exchangeable import candidates_of
from schemas.job import Job, episode_id
from schemas.plan import Plan
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, Place, digest_of, local_copy

_SAMPLE = 25


class ForeignEpisode(str):
    """Reason for rejecting a file: it is an episode of another run."""


class PlannedDraws:
    """Draws of the episodes of a plan.

    Args:
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        ledger: connection to an intact ledger of the run, which avoids expanding the plan; `None` without a ledger.
    """

    def __init__(self, plan: Plan, catalog: Catalog, ledger: Connection | None = None) -> None:
        self.plan, self.catalog = plan, catalog
        self._ledger = ledger
        self._first: Mapping[int, PlannedJob] | None = None

    def planned(self, index: int, draw: int) -> PlannedJob | None:
        """Returns a draw of an episode, or `None` if the plan has no such draw."""
        planned = self._first_of(index)
        if planned is None or not 0 <= draw < self.plan.budget.draws:
            return None
        for _ in range(draw):
            planned = redraw(self.plan, self.catalog, planned)
        return planned

    def job(self, index: int, draw: int, attempt: int) -> Job | None:
        """Returns the job of an attempt, or `None` if the plan has no such draw."""
        planned = self.planned(index, draw)
        return None if planned is None else to_job(self.plan, self.catalog, planned, attempt)

    def _first_of(self, index: int) -> PlannedJob | None:
        if self._ledger is not None:
            row = self._ledger.execute(select(jobs).where(jobs.c.idx == index, jobs.c.draw == 0)).first()
            return None if row is None else planned_of(row)
        if self._first is None:
            self._first = {planned.index: planned for planned in expand(self.plan, self.catalog)}
        return self._first.get(index)


class StrayClassifier:
    """Classifier of episode files.

    Args:
        draws: draws of the plan.
        checker: validator of bundles.
        ledger: connection to the ledger of the run; `None` if it is lost.
        validated: mapping of episode number to the SHA-256 of its validated file, from `metadata.parquet`. A file with
            this digest is not validated again.
    """

    def __init__(
        self,
        draws: PlannedDraws,
        checker: EpisodeValidator,
        ledger: Connection | None,
        validated: Mapping[int, str] = MappingProxyType({}),
    ) -> None:
        self._draws, self._checker, self._ledger, self._validated = draws, checker, ledger, validated

    def classify(self, path: FilePlace, index: int, *, replaces: bool = False) -> EpisodeSummary | str:
        """Returns the row of the episode that a file contains, or the reason why it is rejected.

        Args:
            path: path of the file.
            index: episode number in the file name.
            replaces: whether the file may replace the file that the ledger records.

        Raises:
            TransientError: no bundle can be validated on this machine now.
        """
        try:
            with local_copy(path) as local:
                with local.open("rb") as file, BundleReader(file) as bundle:
                    meta = bundle.meta
                said, plan = meta.job, self._draws.plan
                if said.plan_digest != plan.digest:
                    return ForeignEpisode(f"an episode of run {said.run}, which has a different plan than {plan.run}")
                job = self._draws.job(index, said.draw, said.attempt)
                if job is None:
                    return f"the plan has no draw {said.draw} of {episode_id(index)}"
                if self._ledger is not None:
                    obstacle = obstacle_to(self._ledger, index, said.draw, said.attempt, replaces=replaces)
                    if obstacle:
                        return obstacle
                sha256 = self._validated.get(index)
                if job == said and sha256 is not None and digest_of(local) == sha256:
                    return summary_of(meta, sha256, local.stat().st_size)
                return self._checker.check(local, job, candidates_of(job, self._draws.catalog[job.scene].info))
        except InvalidBundle as error:
            return str(error)
        except OSError as error:
            return f"cannot be read: {error.strerror}"


def count_plans(root: Place) -> Counter[str]:
    """Returns the number of episodes per plan digest in a sample of a dataset; damaged files are skipped."""
    files = list(list_episodes(root).episodes.values())
    found: Counter[str] = Counter()
    for path in files[:: max(1, len(files) // _SAMPLE)]:
        try:
            with local_copy(path) as local, local.open("rb") as file, BundleReader(file) as bundle:
                found[bundle.meta.job.plan_digest] += 1
        except (InvalidBundle, OSError):
            continue
    return found
