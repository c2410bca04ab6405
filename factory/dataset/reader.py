"""Reads a dataset: metadata rows without opening a bundle; episodes by position, id or filter. Writes nothing."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pydantic import ValidationError

from factory.dataset.columns import NAMES, Columns
from factory.dataset.episode import Episode
from factory.dataset.questions import recorded_questions
from factory.dataset.steps import has_routes, read_text_table
from factory.dataset.vocabulary import require_known
from schemas.appearance import Appearance
from schemas.appearance.appearance_file import find_appearance
from schemas.dataset.meta import DatasetMeta, read_dataset_meta
from schemas.dataset.rows import EpisodeSummary, file_name_of
from schemas.encoding.table_digest import table_digest
from schemas.errors import ArchiveCorrupt, UsageError
from schemas.frame import Frame
from schemas.job import index_of_file
from schemas.plan import Plan
from schemas.rig import Rig
from schemas.rig.rig_file import load_rig, require_rates
from schemas.storage.dataset_files import INSTRUCTIONS_FILE, METADATA_FILE, QUESTIONS_FILE, STEPS_FILE
from schemas.storage.place import Place, place_of
from schemas.storage.shard_index import packed_place
from schemas.support.suggest import did_you_mean
from schemas.terms import Recording, family_of

__all__ = ["Dataset", "Episode", "Frame"]

_FILTERS = {
    "split": "split",
    "scene": "scene",
    "tier": "spawn_tier",
    "category": "target_category",
    "target": "target_id",
    "template": "template_id",
    "colour": "colour",
    "expert": "expert",
    "episode": "episode_id",
}


class Dataset:
    """Dataset in a directory or at a URL, or a filtered part of it; a sequence of episodes in the order of the plan.

    Args:
        path: Directory or URL.
        rig: Sensors of `Episode.observe`: a rig, the name of a built-in one, or a TOML file. Default: the rig of the
            dataset's plan.

        appearance: Appearance of frames that are rendered: ranges, the name of a built-in appearance, a TOML file, or
            `none`. Default: the appearance of the dataset's plan.

    >>> data = Dataset("dataset").filter(split="train_id", tier=("near", "mid"))  # doctest: +SKIP
    >>> data[0].instruction, data["ep_000007"].rgb(0).shape  # doctest: +SKIP

    Raises:
        WorldError: The directory contains no dataset, or its format is newer than this software.
        ArchiveCorrupt: The tables are damaged.
        UsageError: The rig does not exist, has mistakes, or has a rate that does not divide the control rate; or
            `appearance` does not exist, has mistakes, or is given for a dataset that stores frames.
    """

    def __init__(
        self,
        path: str | Place,
        rig: str | Path | Rig | None = None,
        appearance: str | Path | Appearance | None = None,
    ) -> None:
        self.root = place_of(path)
        self.meta: DatasetMeta = read_dataset_meta(self.root)
        """Description of the dataset and of the software that generated it."""
        plan = self.meta.plan
        self.rig = plan.rig if rig is None else _rig(rig, plan.task.control_hz)
        """Rig of `Episode.observe`."""
        self.appearance = _appearance(self.root, plan, appearance)
        """Appearance of frames that are rendered; `None` shows the scenes as they were compiled."""
        self._columns = Columns(self.root)
        self._chosen: NDArray[np.int64] | None = None
        """Ascending rows of the table that are part of this dataset; `None` for all."""

    @cached_property
    def metadata(self) -> pa.Table:
        """Table with one row for each episode; the columns are the fields of `EpisodeSummary`.

        Text columns whose values repeat are dictionaries. The table of a million episodes takes about 0.5 GB; `column`
        reads one column.
        """
        return pa.table({name: self.column(name) for name in NAMES})

    def column(self, name: str) -> pa.Array:
        """Returns one column of `metadata`.

        Raises:
            ArchiveCorrupt: The column is damaged.
        """
        whole = self._columns[name]
        part = whole if self._chosen is None else whole.take(pa.array(self._chosen))
        return part.cast(pa.int64()) if pa.types.is_integer(part.type) else part

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yields the values of each row of `metadata`, which are not validated; keeps one row in memory.

        Raises:
            ArchiveCorrupt: A column is damaged.
        """
        return map(self._columns.row, range(len(self)) if self._chosen is None else self._chosen.tolist())

    def row(self, position: int) -> EpisodeSummary:
        """Returns one validated row of `metadata`.

        Args:
            position: position in this dataset, from 0.

        Raises:
            ArchiveCorrupt: The row is damaged.
        """
        return _parse(self.root, self._columns.row(position if self._chosen is None else int(self._chosen[position])))

    @cached_property
    def instructions(self) -> pa.Table:
        """Table with one row for each instruction of these episodes, written by `factory relabel` (docs/language.md).

        Raises:
            UsageError: The dataset has its recorded instructions only.
            ArchiveCorrupt: The table is damaged.
        """
        if self.meta.relabelling is None:
            raise UsageError(f"{self.root} has its recorded instructions only: `factory relabel` writes new ones")
        return self._own_rows(read_text_table(self.root / INSTRUCTIONS_FILE))

    @cached_property
    def steps(self) -> pa.Table:
        """Table with one row for each sub-instruction of the routes of these episodes (docs/language.md#routes).

        `start` is its first frame, and `end` the frame after its last one.

        Raises:
            UsageError: The dataset has no routes.
            ArchiveCorrupt: The table is damaged.
        """
        if not has_routes(self.root):
            raise UsageError(f'{self.root} has no routes: `factory relabel` with kinds = ["route"] writes them')
        return self._own_rows(read_text_table(self.root / STEPS_FILE))

    @cached_property
    def questions(self) -> pa.Table:
        """Table with one row for each question about these episodes (docs/language.md#questions).

        `factory relabel` writes the table; questions of a plan are read from the metadata of every episode.

        Raises:
            UsageError: The dataset has no questions.
            ArchiveCorrupt: The table or an episode is damaged.
        """
        if (self.root / QUESTIONS_FILE).is_file():
            return self._own_rows(read_text_table(self.root / QUESTIONS_FILE))
        language = self.meta.plan.language
        if language is None or not language.questions:
            raise UsageError(f"{self.root} has no questions: `factory relabel` with questions = true writes them")
        return recorded_questions(self)

    def _own_rows(self, table: pa.Table) -> pa.Table:
        return table.filter(pc.is_in(table["episode_id"], self.column("episode_id").cast(pa.string())))

    @property
    def digest(self) -> str:
        """SHA-256 over the content digests of these episodes; equal content gives an equal digest."""
        return table_digest(pa.table({name: self.column(name) for name in ("episode_id", "content_digest")}))

    def filter(self, **wanted: str | Iterable[str]) -> Dataset:
        """Returns the episodes that match all conditions; an empty dataset when a valid value matches no episode.

        Args:
            wanted: One or more values for `split`, `scene`, `tier`, `category`, `target`, `template`, `colour`,
                `expert` or `episode`. A family as `scene` selects all its layouts.

        Raises:
            UsageError: The filter does not exist, or a value is not valid for it.
        """
        chosen = self._chosen
        for name, values in wanted.items():
            if name not in _FILTERS:
                raise UsageError(
                    f"unknown filter {name!r}; valid filters: {', '.join(_FILTERS)}{did_you_mean(name, _FILTERS)}"
                )
            values_wanted, column = _as_strings(values), self._columns[_FILTERS[name]]
            held = column.dictionary if pa.types.is_dictionary(column.type) else column
            if name == "scene":
                values_wanted = with_layouts(values_wanted, held)
            unheld = values_wanted.filter(pc.invert(pc.is_in(values_wanted, held)))
            require_known(name, unheld.to_pylist(), held.to_pylist, self.meta.plan)
            matching = pc.is_in(column, values_wanted).to_numpy(zero_copy_only=False)
            chosen = np.flatnonzero(matching) if chosen is None else chosen[matching[chosen]]
        return self._with(chosen)

    def _with(self, chosen: NDArray[np.int64] | None) -> Dataset:
        part = object.__new__(Dataset)
        part.root, part.meta, part._columns, part._chosen = self.root, self.meta, self._columns, chosen
        part.rig, part.appearance = self.rig, self.appearance
        return part

    def __len__(self) -> int:
        return self._columns.rows if self._chosen is None else len(self._chosen)

    def __iter__(self) -> Iterator[Episode]:
        return (self[position] for position in range(len(self)))

    def __getitem__(self, key: int | str) -> Episode:
        """Returns an episode by its position in this dataset or by its id.

        Raises:
            IndexError: The position is out of range.
            KeyError: This dataset has no episode with that id.
        """
        position = self._position(key) if isinstance(key, str) else key
        if not -len(self) <= position < len(self):
            raise IndexError(f"{self.root}: index {position} is out of range for {len(self)} episodes")
        summary = self.row(position % len(self))
        place = packed_place(self.root, summary.index)
        return Episode(place or self.root / file_name_of(summary.episode_id), summary, self.rig, self.appearance)

    def _position(self, episode_id: str) -> int:
        row = self._row_of(episode_id)
        position = row if self._chosen is None else int(np.searchsorted(self._chosen, row))
        if row < 0 or (self._chosen is not None and (position == len(self) or self._chosen[position] != row)):
            raise KeyError(f"{episode_id} is not one of the {len(self)} selected episodes of {self.root}")
        return position

    def _row_of(self, episode_id: str) -> int:
        """Returns the row of an episode in the table, or -1."""
        names, numbers = self._columns["episode_id"], self._columns["index"].to_numpy(zero_copy_only=False)
        row = bisect_left(numbers, index_of_file(f"{episode_id}.zip") or 0)
        if row < len(names) and names[row].as_py() == episode_id:
            return row
        # the id is unknown, or the rows of a damaged table are unordered
        return int(pc.index(names, episode_id).as_py())

    def __repr__(self) -> str:
        return f"Dataset({str(self.root)!r}, {len(self)} episodes)"


def _appearance(root: Place, plan: Plan, chosen: str | Path | Appearance | None) -> Appearance | None:
    stores_frames = plan.record is Recording.FRAMES
    if chosen is None:
        return None if stores_frames else plan.appearance
    if stores_frames:
        raise UsageError(
            f"{root} stores frames, whose appearance is fixed: give a dataset of `factory run --record states`"
        )
    if isinstance(chosen, Appearance):
        return chosen
    return find_appearance(str(chosen))


def _rig(rig: str | Path | Rig, control_hz: int) -> Rig:
    if not isinstance(rig, Rig):
        return load_rig(str(rig), control_hz)
    require_rates(rig, control_hz)
    return rig


def with_layouts(chosen: pa.Array, held: pa.Array) -> pa.Array:
    """Returns the requested scenes, with all layouts of each requested family."""
    wanted = set(chosen.to_pylist())
    layouts = [name for name in held.unique().to_pylist() if name not in wanted and family_of(name) in wanted]
    return pa.concat_arrays([chosen, pa.array(layouts, pa.string())])


def _as_strings(values: str | Iterable[str]) -> pa.Array:
    texts = [values] if isinstance(values, str) else list(values)
    return pa.array([value.value if isinstance(value, StrEnum) else value for value in texts], pa.string())


def _parse(root: Place, row: dict[str, Any]) -> EpisodeSummary:
    try:
        return EpisodeSummary.model_validate(row)
    except ValidationError as error:
        problem = f"{error.error_count()} wrong values, first at {error.errors()[0]['loc']}"
        raise ArchiveCorrupt(f"{root / METADATA_FILE} is damaged ({problem}): resume the run to rewrite it") from error
