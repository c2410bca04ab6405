"""Selects and sorts the episodes of a dataset by columns, without reading rows. Imports no web framework.

The first rows are read alone for a page that is requested before the whole table is read.
"""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from factory.dataset.reader import Dataset, with_layouts
from schemas.errors import ArchiveCorrupt, UsageError
from schemas.storage.dataset_files import METADATA_FILE
from schemas.storage.place import Place, table_of
from schemas.support.foreign import PARSER_ERRORS
from schemas.support.suggest import did_you_mean
from schemas.terms import family_of


class FirstRows(NamedTuple):
    """First rows of a table."""

    rows: list[dict[str, Any]]
    """Values of `ROW_COLUMNS`, in the order of the episodes."""
    total: int
    """Number of rows of the table."""


def read_first_rows(root: Place, count: int) -> FirstRows | None:
    """Returns the first rows of a table; `None` if it cannot be read. The error is reported when all rows are read."""
    try:
        file = pq.ParquetFile(table_of(root / METADATA_FILE))
        batch = next(file.iter_batches(count, columns=list(ROW_COLUMNS)), None)
        return FirstRows(batch.to_pylist() if batch else [], file.metadata.num_rows)
    except (OSError, pa.ArrowException, *PARSER_ERRORS):
        return None


FILTERS = MappingProxyType(
    {
        "scene": "scene",
        "split": "split",
        "tier": "spawn_tier",
        "category": "target_category",
        "target": "target_id",
        "template": "template_id",
        "end": "end_reason",
    }
)
"""Column by name of the filter."""
SORTED = (
    "episode_id",
    "scene",
    "split",
    "spawn_tier",
    "target_category",
    "num_steps",
    "trajectory_length_m",
    "final_ne_m",
    "final_surface_m",
)
"""Columns that the table can be sorted by."""
ROW_COLUMNS = (*SORTED, "instruction")
"""Columns that the table shows."""
_READ = tuple(dict.fromkeys(("index", "instruction", *SORTED, *FILTERS.values())))
"""Columns that are read in advance: for the page, for sorting and for the filters."""
_OTHERS = ("q", "sort", "order", "page", "flagged")
_MOST_TEXT = 200
_MOST_CHOICES = 300
_KEPT = 16

Indices = NDArray[np.int32]


@dataclass(frozen=True)
class TableQuery:
    """Selection and order of a table."""

    filters: Mapping[str, str] = field(default_factory=dict)
    """Wanted value by name of the filter."""
    text: str = ""
    """Text that the instruction contains; letter case is ignored."""
    sort: str = "episode_id"
    """Column to sort by."""
    descending: bool = False
    """Whether the largest value is first."""
    page: int = 0
    """Number of the page, from 0."""
    flagged: bool = False
    """Whether only flagged episodes are listed."""


def parse_query(given: Mapping[str, str]) -> TableQuery:
    """Returns the query of a URL.

    Raises:
        UsageError: a name or a value is not valid.
    """
    unknown = sorted({*given} - {*FILTERS, *_OTHERS})
    if unknown:
        near = did_you_mean(unknown[0], (*FILTERS, *_OTHERS))
        raise UsageError(f"unknown filter {unknown[0][:40]!r}; valid filters: {', '.join((*FILTERS, *_OTHERS))}{near}")
    sort, page, text = given.get("sort") or "episode_id", page_number(given), given.get("q", "").strip()
    if sort not in SORTED:
        raise UsageError(f"sort={sort[:40]!r} is not a column; valid columns: {', '.join(SORTED)}")
    if len(text) > _MOST_TEXT:
        raise UsageError(f"q has {len(text)} characters, at most {_MOST_TEXT} are allowed")
    filters = {name: given[name] for name in FILTERS if given.get(name)}
    return TableQuery(
        filters, text, sort=sort, descending=given.get("order") == "desc", page=page, flagged=bool(given.get("flagged"))
    )


def page_number(given: Mapping[str, str]) -> int:
    """Returns the number of the page in the query of a URL; the first page has the number 0.

    Raises:
        UsageError: the value is not a page number.
    """
    page = given.get("page") or "0"
    if not page.isascii() or not page.isdigit() or len(page) > 9:
        raise UsageError(f"page={page[:40]!r} is not a page number; valid numbers: 0, 1, 2, ...")
    return int(page)


class EpisodeTable:
    """Rows of a dataset, selected and sorted; thread-safe. Keeps the orders and the selections of recent queries.

    Args:
        dataset: the dataset.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        """The dataset."""
        self._found: OrderedDict[object, Indices] = OrderedDict()
        self._orders: dict[str, Indices] = {}
        self._lock, self._sorting = threading.Lock(), threading.Lock()

    def __len__(self) -> int:
        return len(self.dataset)

    def load(self) -> None:
        """Reads the columns of the table in advance of the first request. Requests report the errors."""
        for name in _READ:
            with contextlib.suppress(ArchiveCorrupt):
                self.dataset.column(name)

    def sort_all(self) -> None:
        """Computes the order of the rows for each sortable column in advance, so no request must wait for it."""
        for column in SORTED:
            with contextlib.suppress(ArchiveCorrupt):
                self._order_by(column)

    def values(self, column: str) -> list[str]:
        """Returns the values of a text column, sorted; empty if there are too many to choose from."""
        held = self.dataset.column(column)
        distinct = held.dictionary if pa.types.is_dictionary(held.type) else pc.unique(held)
        names = set(map(str, distinct.to_pylist()))
        if column == "scene":
            families = {family_of(name) for name in names}
            names = names | families if len(names | families) <= _MOST_CHOICES else families
        return sorted(names) if len(names) <= _MOST_CHOICES else []

    def select(self, query: TableQuery, flagged: Iterable[str] = ()) -> Indices:
        """Returns the positions of the selected episodes, in order.

        Args:
            query: selection and order.
            flagged: ids of the flagged episodes.
        """
        key = (tuple(sorted(query.filters.items())), query.text, query.sort, query.descending)
        sorted_rows = self._kept(key, lambda: self._sorted(query))
        if not query.flagged:
            return sorted_rows
        wanted = pc.is_in(self.dataset.column("episode_id").cast(pa.string()), pa.array(list(flagged), pa.string()))
        return sorted_rows[_as_mask(wanted)[sorted_rows]]

    def rows(self, positions: Indices) -> list[dict[str, Any]]:
        """Returns the values of the columns that the table shows, for some rows."""
        taken = [self.dataset.column(name).take(pa.array(positions)).to_pylist() for name in ROW_COLUMNS]
        return [dict(zip(ROW_COLUMNS, values, strict=True)) for values in zip(*taken, strict=True)]

    def _sorted(self, query: TableQuery) -> Indices:
        order = self._order_by(query.sort)
        order = order[::-1] if query.descending else order
        mask = self._mask(query)
        return order if mask is None else order[mask[order]]

    def _order_by(self, column: str) -> Indices:
        """Returns the positions of all episodes in ascending order of a column."""
        with self._sorting:
            if column not in self._orders:
                self._orders[column] = self._order(column)
            return self._orders[column]

    def _order(self, column: str) -> Indices:
        held = self.dataset.column("index" if column == "episode_id" else column)
        if pa.types.is_dictionary(held.type):  # rank the few distinct values instead of all rows
            ranks = pc.rank(held.dictionary.cast(pa.string())).to_numpy()
            numbers = ranks[held.indices.to_numpy(zero_copy_only=False)]
        else:
            numbers = held.to_numpy(zero_copy_only=False)
        if np.all(numbers[1:] >= numbers[:-1]):  # already sorted, as the column `index` is
            return np.arange(len(numbers), dtype=np.int32)
        return np.argsort(numbers, kind="stable").astype(np.int32)

    def _mask(self, query: TableQuery) -> NDArray[np.bool_] | None:
        masks = [
            _matches(
                self.dataset.column(FILTERS[name]),
                lambda held, value=value, name=name: pc.is_in(held, _values_of(name, value, held)),
            )
            for name, value in query.filters.items()
        ]
        if query.text:
            search = self.dataset.column("instruction")
            masks.append(_matches(search, lambda held: pc.match_substring(held, query.text, ignore_case=True)))
        return np.logical_and.reduce(masks) if masks else None

    def _kept(self, key: object, compute: Any) -> Indices:
        with self._lock:
            if key in self._found:
                self._found.move_to_end(key)
                return self._found[key]
        result: Indices = compute()
        with self._lock:
            self._found[key] = result
            while len(self._found) > _KEPT:
                self._found.popitem(last=False)
        return result


def _values_of(name: str, value: str, held: pa.Array) -> pa.Array:
    """Returns the values that a filter selects: for a scene also the layouts of the family of that name."""
    chosen = pa.array([value], pa.string())
    return with_layouts(chosen, held) if name == "scene" else chosen


def _matches(column: pa.Array, match: Any) -> NDArray[np.bool_]:
    """Returns which rows match. In a dictionary-encoded column, each distinct value is searched once."""
    if not pa.types.is_dictionary(column.type):
        return _as_mask(match(column.cast(pa.string())))
    held = _as_mask(match(column.dictionary.cast(pa.string())))
    matches: NDArray[np.bool_] = np.append(held, False)[
        column.indices.fill_null(len(held)).to_numpy(zero_copy_only=False)
    ]
    return matches


def _as_mask(values: pa.Array | pa.ChunkedArray) -> NDArray[np.bool_]:
    mask: NDArray[np.bool_] = pc.fill_null(values, False).to_numpy(zero_copy_only=False).astype(bool)
    return mask
