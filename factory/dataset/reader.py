"""Reads a dataset: metadata rows without opening a bundle; episodes by position, id or filter. Writes nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import ValidationError

from factory.dataset.episode import Episode, Frame
from factory.dataset.table import read_table
from factory.dataset.vocabulary import require_known
from schemas.dataset import EpisodeSummary, file_name_of
from schemas.dataset_files import METADATA_FILE
from schemas.dataset_meta import DatasetMeta, read_dataset_meta
from schemas.encoding.digest import dataset_digest
from schemas.errors import ArchiveCorrupt, UsageError
from schemas.rig import Rig
from schemas.rig.file import load_rig, require_rates
from schemas.storage.place import Place, place_of
from schemas.storage.shard_index import packed_place
from schemas.support.foreign import PARSER_ERRORS
from schemas.support.suggest import did_you_mean

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
_COLUMNS = list(EpisodeSummary.model_fields)
_LATER = pa.schema(
    [("spawn_surface_m", pa.float64()), ("final_surface_m", pa.float64()), ("target_in_view", pa.bool_())]
)


class Dataset:
    """Dataset in a directory or at a URL, or a filtered part of it; a sequence of episodes in the order of the plan.

    Args:
        path: Directory or URL.
        rig: Sensors that `Episode.observe` renders: a rig, the name of a built-in one, or a TOML file.

    >>> data = Dataset("dataset").filter(split="train_id", tier=("near", "mid"))  # doctest: +SKIP
    >>> data[0].instruction, data["ep_000007"].rgb(0).shape  # doctest: +SKIP

    Raises:
        WorldError: The directory holds no dataset, or its format is newer than this software.
        ArchiveCorrupt: The tables are damaged.
        UsageError: The rig does not exist, has mistakes, or has a rate that does not divide the control rate.
    """

    def __init__(self, path: str | Place, rig: str | Path | Rig | None = None) -> None:
        self.root = place_of(path)
        self.meta: DatasetMeta = read_dataset_meta(self.root)
        """Description of the dataset and of the software that generated it."""
        self.rig = None if rig is None else _rig(rig, self.meta.plan.task.control_hz)
        """Rig of `Episode.observe`."""
        self.metadata: pa.Table = _read_table(self.root / METADATA_FILE)
        """One row for each episode; the columns are the fields of `EpisodeSummary`."""
        self._targets: list[str] = pc.unique(self.metadata["target_id"]).to_pylist()

    @property
    def digest(self) -> str:
        """SHA-256 over the content digests of these episodes; equal content gives an equal digest."""
        names = self.metadata["episode_id"].to_pylist()
        return dataset_digest(zip(names, self.metadata["content_digest"].to_pylist(), strict=True))

    def filter(self, **wanted: str | Iterable[str]) -> Dataset:
        """Returns the episodes that match all conditions; an empty dataset when a valid value matches no episode.

        Args:
            wanted: One or more values for `split`, `scene`, `tier`, `category`, `target`, `template`, `colour`,
                `expert` or `episode`.

        Raises:
            UsageError: The filter does not exist, or a value is not valid for it.
        """
        table = self.metadata
        for name, values in wanted.items():
            if name not in _FILTERS:
                raise UsageError(
                    f"unknown filter {name!r}; valid filters: {', '.join(_FILTERS)}{did_you_mean(name, _FILTERS)}"
                )
            asked, column = _as_strings(values), _FILTERS[name]
            held = self._targets if name == "target" else pc.unique(self.metadata[column]).to_pylist()
            require_known(name, asked.to_pylist(), held, self.meta.plan)
            table = table.filter(pc.field(column).isin(asked))
        return self._with(table)

    def _with(self, table: pa.Table) -> Dataset:
        part = object.__new__(Dataset)
        part.root, part.meta, part.metadata, part._targets = self.root, self.meta, table, self._targets
        part.rig = self.rig
        return part

    def __len__(self) -> int:
        return int(self.metadata.num_rows)

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
        (row,) = self.metadata.slice(position % len(self), 1).to_pylist()
        summary = _parse(self.root, row)
        place = packed_place(self.root, summary.index)
        return Episode(place or self.root / file_name_of(summary.episode_id), summary, self.rig)

    def _position(self, episode_id: str) -> int:
        position = int(pc.index(self.metadata["episode_id"], episode_id).as_py())
        if position < 0:
            raise KeyError(f"{episode_id} is not one of the {len(self)} selected episodes of {self.root}")
        return position

    def __repr__(self) -> str:
        return f"Dataset({str(self.root)!r}, {len(self)} episodes)"


def _rig(rig: str | Path | Rig, control_hz: int) -> Rig:
    if not isinstance(rig, Rig):
        return load_rig(str(rig), control_hz)
    require_rates(rig, control_hz)
    return rig


def _as_strings(values: str | Iterable[str]) -> pa.Array:
    found = [values] if isinstance(values, str) else list(values)
    return pa.array([value.value if isinstance(value, StrEnum) else value for value in found], pa.string())


def _read_table(path: Place) -> pa.Table:
    try:
        return read_table(path, _COLUMNS, _LATER)
    except FileNotFoundError as error:
        raise ArchiveCorrupt(f"{path} is missing: resume the run to rewrite it") from error
    except (pa.ArrowException, *PARSER_ERRORS) as error:
        raise ArchiveCorrupt(f"{path} is damaged ({error}): resume the run to rewrite it") from error


def _parse(root: Place, row: dict[str, Any]) -> EpisodeSummary:
    try:
        return EpisodeSummary.model_validate(row)
    except ValidationError as error:
        found = f"{error.error_count()} wrong values, first at {error.errors()[0]['loc']}"
        raise ArchiveCorrupt(f"{root / METADATA_FILE} is damaged ({found}): resume the run to rewrite it") from error
