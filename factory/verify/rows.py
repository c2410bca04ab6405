"""Checks the rows of `metadata.parquet` one by one. Opens no episode."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from pydantic import ValidationError

from factory.dataset.reader import Dataset
from factory.verify.report import Kind, VerifyReport
from schemas.dataset.rows import EpisodeSummary
from schemas.job import episode_id
from schemas.storage.dataset_files import METADATA_FILE
from schemas.terms import Split, Tier


class RowCheck:
    """Checks the rows of a dataset one by one, and adds what it finds to a report. Keeps no row.

    Args:
        dataset: Dataset to check.
        report: Report of the verification.
    """

    def __init__(self, dataset: Dataset, report: VerifyReport) -> None:
        self._dataset, self._report = dataset, report
        self.names: set[str] = set()
        """Ids of the episodes with a valid row."""
        self.cells: Counter[tuple[str, Split, Tier]] = Counter()
        """Number of valid rows by scene, split and tier."""
        self.plans: set[str] = set()
        """Digests of the plans in valid rows."""

    def __iter__(self) -> Iterator[EpisodeSummary]:
        """Yields the first valid row of each episode."""
        return (row for row in map(self._parse, self._dataset.rows()) if row is not None)

    def _parse(self, values: dict[str, Any]) -> EpisodeSummary | None:
        try:
            row = EpisodeSummary.model_validate(values)
        except ValidationError as error:
            where = sorted({str(item["loc"][0]) for item in error.errors() if item["loc"]})
            self._report.add(
                Kind.DAMAGED, METADATA_FILE, f"{values.get('episode_id')}: wrong values in {', '.join(where)}"
            )
            return None
        if row.episode_id != episode_id(row.index):
            self._report.add(Kind.CONTRADICTION, METADATA_FILE, f"{row.episode_id} has index {row.index}")
        if row.episode_id in self.names:
            self._report.add(Kind.CONTRADICTION, METADATA_FILE, f"{row.episode_id} has more than one row")
            return None
        self.names.add(row.episode_id)
        self.cells[row.scene, row.split, row.spawn_tier] += 1
        self.plans.add(row.plan_digest)
        return row
