"""Finds faults in the split tables of a dataset. Reads files only."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import NamedTuple

import pyarrow.parquet as pq
from PIL import Image

from coordinator.tables.split_layout import (
    DIGEST_KEY,
    PICTURES_KEY,
    THUMBNAIL,
    UNREADABLE,
    SplitTable,
    has_pictures,
    read_pictures,
    split_tables_of,
)
from schemas.storage.dataset_files import METADATA_FILE, SPLITS_FOLDER
from schemas.storage.place import Place, children, table_of

SURPLUS = f"{METADATA_FILE} has no rows for it"
_OTHER_ROWS = f"its rows differ from {METADATA_FILE}"


class FaultKind(StrEnum):
    """Kind of a split table fault."""

    ABSENT = "absent"  # `metadata.parquet` has rows for the file, which is missing
    SURPLUS = "surplus"  # the file exists, but `metadata.parquet` has no rows for it
    DAMAGED = "damaged"  # the file or one of its thumbnails is unreadable
    OUTDATED = "outdated"  # rows differ from `metadata.parquet`, or lack the thumbnail of an existing episode file


class SplitFault(NamedTuple):
    """Fault of a split table."""

    name: str
    """Path relative to the root of the dataset."""
    kind: FaultKind
    """Kind of the fault."""
    text: str
    """Description of the fault."""


def find_faults(root: Place, deep: bool = False) -> Iterator[SplitFault]:
    """Yields the faults of the split tables.

    Args:
        root: root of the dataset.
        deep: whether to read every row and decode every thumbnail, instead of the metadata of each file only.

    Raises:
        ArchiveCorrupt: `metadata.parquet` cannot be read.
    """
    wanted = set()
    for table in split_tables_of(root):
        wanted.add(table.name)
        fault = fault_of(root, table, deep)
        if fault:
            yield fault
    for place in surplus_tables(root, wanted):
        yield SplitFault(f"{SPLITS_FOLDER}/{place.name}", FaultKind.SURPLUS, SURPLUS)


def surplus_tables(root: Place, wanted: set[str]) -> list[Place]:
    """Returns the paths in the folder of split tables whose names are not expected."""
    return [place for place in children(root / SPLITS_FOLDER) if f"{SPLITS_FOLDER}/{place.name}" not in wanted]


def fault_of(root: Place, table: SplitTable, deep: bool = False) -> SplitFault | None:
    """Returns the fault of a split table, or `None`; for the arguments see `find_faults`."""
    try:
        text = _check_rows(root, table) if deep else _check_footer(root, table)
        damage = _check_thumbnails(root, table) if deep and not text else ""
    except FileNotFoundError:
        return SplitFault(table.name, FaultKind.ABSENT, "is missing")
    except UNREADABLE as error:
        return SplitFault(table.name, FaultKind.DAMAGED, f"cannot be read: {' '.join(str(error).split())}")
    if damage:
        return SplitFault(table.name, FaultKind.DAMAGED, damage)
    return SplitFault(table.name, FaultKind.OUTDATED, text) if text else None


def _check_footer(root: Place, table: SplitTable) -> str:
    said = pq.read_metadata(table_of(root / table.name)).metadata or {}
    if said.get(DIGEST_KEY, b"").decode() != table.digest:
        return _OTHER_ROWS
    if int(said.get(PICTURES_KEY, b"0")) == table.rows.num_rows:
        return ""
    return _missing_thumbnails(root, table, read_pictures(root / table.name))


def _check_rows(root: Place, table: SplitTable) -> str:
    found = pq.read_table(table_of(root / table.name), page_checksum_verification=True)
    if not found.drop_columns([THUMBNAIL]).replace_schema_metadata().equals(table.rows.replace_schema_metadata()):
        return _OTHER_ROWS
    return _missing_thumbnails(root, table, read_pictures(root / table.name))


def _check_thumbnails(root: Place, table: SplitTable) -> str:
    pictures = read_pictures(root / table.name)
    names = {row["content_digest"]: row["episode_id"] for row in table.sources()}
    broken = [names[digest] for digest, picture in pictures.items() if not _is_image(picture)]
    return f"the thumbnail of {broken[0]} is not an image" if broken else ""


def _missing_thumbnails(root: Place, table: SplitTable, pictures: Mapping[str, bytes]) -> str:
    """Returns a message about thumbnails that are missing although the episode file exists; empty if there are none.

    A thumbnail may be missing if the episode file is not in the dataset, because a gateway may store that file.
    """
    if not has_pictures(root):
        return ""
    lacking = [row for row in table.sources() if row["content_digest"] not in pictures]
    names = [row["episode_id"] for row in lacking if (root / row["file_name"]).is_file()]
    return f"no thumbnail of {names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}" if names else ""


def _is_image(data: bytes) -> bool:
    try:
        with Image.open(io.BytesIO(data)) as image:
            image.load()
    except (OSError, SyntaxError):
        return False
    return True
