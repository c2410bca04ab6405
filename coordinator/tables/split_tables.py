"""Writes and checks the split tables, `data/<split>-<number>.parquet`: rows of `metadata.parquet` with thumbnails.

`datasets.load_dataset` reads the splits from these files. The module generates them from `metadata.parquet` and the
episode files at the end of a run, in `factory repair` and in `factory gather`. It does not rewrite current files.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from enum import StrEnum
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import structlog
import xxhash
from numpy.typing import NDArray
from PIL import Image

from coordinator.archive.contract import Archive
from coordinator.tables.card import split_configs, splits_at, with_configs
from schemas.bundle import BundleReader
from schemas.dataset.meta import read_dataset_meta
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import ArchiveCorrupt, InvalidBundle, WorldError
from schemas.storage.dataset_files import CARD_FILE, METADATA_FILE, SPLITS_FOLDER
from schemas.storage.place import Place, children, table_of
from schemas.terms import Recording, Split

THUMBNAIL = "thumbnail"
"""Name of the last column: frame 0 in the format of `datasets.Image`; null if the episode's file was not available. A
dataset of states has no such column until `factory push --thumbnails` has rendered it."""
DIGEST_KEY, PICTURES_KEY = b"minivla_rows", b"minivla_thumbnails"
"""Keys of the file metadata: digest of the rows and number of thumbnails."""
UNREADABLE = (pa.ArrowException, OSError, KeyError, ValueError)
"""Exceptions of reading a damaged table."""
_SHARD_EPISODES = 10_000
"""Number of planned episodes per shard. A split with 60 % of the episodes has 6000 rows per file, about 30 MB."""
# if the validator made the thumbnails, those of a million episodes would pass 4 GB through the ledger


class SplitTable(NamedTuple):
    """Expected split table of a dataset."""

    name: str
    """Path relative to the root of the dataset."""
    rows: pa.Table
    """Rows of `metadata.parquet`, in its order."""

    @property
    def digest(self) -> str:
        """XXH3-128 of the rows, hexadecimal."""
        sink = pa.BufferOutputStream()
        whole = self.rows.replace_schema_metadata().combine_chunks()
        with pa.ipc.new_stream(sink, whole.schema) as stream:
            stream.write_table(whole)
        return xxhash.xxh3_128_hexdigest(sink.getvalue())

    def sources(self) -> list[dict[str, Any]]:
        """Returns id, content digest, file name and length of the episode of each row."""
        sources: list[dict[str, Any]] = self.rows.select(
            ["episode_id", "content_digest", "file_name", "num_steps"]
        ).to_pylist()
        return sources


def split_tables_of(root: Place, shard_episodes: int = _SHARD_EPISODES) -> Iterator[SplitTable]:
    """Yields the split tables of a dataset by range of episode numbers.

    Args:
        root: root of the dataset.
        shard_episodes: number of planned episodes per shard.

    Raises:
        ArchiveCorrupt: `metadata.parquet` cannot be read, or its episodes are not in ascending order.
    """
    try:
        with pq.ParquetFile(table_of(root / METADATA_FILE)) as file:
            for shard, rows in _ranges(file, shard_episodes):
                for split in Split:
                    chosen = rows.filter(pc.equal(rows["split"], str(split)))
                    if chosen.num_rows:
                        yield SplitTable(f"{SPLITS_FOLDER}/{split}-{shard:05d}.parquet", chosen)
    except UNREADABLE as error:
        raise ArchiveCorrupt(f"{root / METADATA_FILE} cannot be read: {error}; run `factory repair`") from error


def _ranges(file: pq.ParquetFile, shard_episodes: int) -> Iterator[tuple[int, pa.Table]]:
    last = -1
    for shard, slices in groupby(_slices(file, shard_episodes), lambda indices: indices[0]):
        if shard <= last:
            raise ArchiveCorrupt(f"{METADATA_FILE}: episodes are not in ascending order; run `factory repair`")
        last = shard
        yield shard, pa.concat_tables([rows for _, rows in slices])


def _slices(file: pq.ParquetFile, shard_episodes: int) -> Iterator[tuple[int, pa.Table]]:
    for batch in file.iter_batches():
        start = 0
        for shard, run in groupby((index - 1) // shard_episodes for index in batch["index"].to_pylist()):
            count = len(list(run))
            yield shard, pa.Table.from_batches([batch.slice(start, count)])
            start += count


def has_pictures(root: Place) -> bool:
    """Returns whether the episodes store frames, from which thumbnails are made."""
    try:
        return read_dataset_meta(root).plan.record is Recording.FRAMES
    except WorldError:
        return True


def lacks_pictures(path: Place) -> bool:
    """Returns whether a split table has rows without thumbnails; `False` if it does not exist or is unreadable."""
    try:
        metadata = pq.read_metadata(table_of(path))
    except UNREADABLE:
        return False
    return bool(int((metadata.metadata or {}).get(PICTURES_KEY, b"0")) < metadata.num_rows)


def read_pictures(path: Place) -> dict[str, bytes]:
    """Returns the thumbnails of a split table by content digest of the episode; empty if the table is unreadable."""
    columns = ["content_digest", THUMBNAIL]
    try:
        pictures = pq.read_table(table_of(path), columns=columns, page_checksum_verification=True).to_pylist()
    except UNREADABLE:
        return {}
    # tables of states datasets have no such column before they are rendered
    return {row["content_digest"]: row[THUMBNAIL]["bytes"] for row in pictures if row.get(THUMBNAIL) is not None}


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
    metadata = pq.read_metadata(table_of(root / table.name)).metadata or {}
    if metadata.get(DIGEST_KEY, b"").decode() != table.digest:
        return _OTHER_ROWS
    if int(metadata.get(PICTURES_KEY, b"0")) == table.rows.num_rows:
        return ""
    return _missing_thumbnails(root, table, read_pictures(root / table.name))


def _check_rows(root: Place, table: SplitTable) -> str:
    stored = pq.read_table(table_of(root / table.name), page_checksum_verification=True)
    rows = stored.select([name for name in stored.column_names if name != THUMBNAIL])
    if not rows.replace_schema_metadata().equals(table.rows.replace_schema_metadata()):
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


_READERS = 8
_THUMBNAIL_PX = 160
"""Width and height of a thumbnail, pixels: a quarter of the size of a frame."""
_QUALITY = 85
_IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
_FEATURES = json.dumps({"info": {"features": {THUMBNAIL: {"_type": "Image"}}}}).encode()

FrameSource = Callable[[str], NDArray[np.uint8]]

log = structlog.get_logger(__name__)


def write_split_tables(
    archive: Archive, seconds: float | None = None, deep: bool = False, draw: FrameSource | None = None
) -> None:
    """Writes the split tables that are missing, damaged or outdated, then lists them in the card.

    Args:
        archive: archive of the dataset, with a current `metadata.parquet`.
        seconds: time limit for thumbnails, seconds; thumbnails that are not made in time are null until the next call.
            `None` sets no limit.
        deep: whether to check every row and thumbnail for damage, instead of the metadata of each file only.
        draw: function that renders frame 0 of an episode, given its id, for the thumbnails of a dataset without stored
            frames; `None` renders no thumbnails.

    Raises:
        WorldError: the disk is full or unavailable; each file is complete, either the previous or the new version.
        ArchiveCorrupt: `metadata.parquet` cannot be read.
    """
    deadline = float("inf") if seconds is None else time.monotonic() + seconds
    wanted, written = set(), 0
    for table in split_tables_of(archive.root):
        wanted.add(table.name)
        fault = fault_of(archive.root, table, deep)
        if fault or (draw is not None and lacks_pictures(archive.root / table.name)):
            is_damaged = fault is not None and fault.kind is FaultKind.DAMAGED
            _write(archive, table, {} if is_damaged else read_pictures(archive.root / table.name), deadline, draw)
            written += 1
    for place in surplus_tables(archive.root, wanted):
        archive.quarantine(place, SURPLUS)
    _name_in_card(archive)
    log.info("split_tables_written", files=written, of=len(wanted))


def _write(
    archive: Archive, table: SplitTable, former: Mapping[str, bytes], deadline: float, draw: FrameSource | None
) -> None:
    rows, are_stored = table.sources(), has_pictures(archive.root)

    def picture_of(row: Mapping[str, Any]) -> bytes | None:
        kept = former.get(row["content_digest"])
        if kept is not None or not (are_stored or draw) or time.monotonic() > deadline:
            return kept
        if draw is not None and not are_stored:
            return _shrink_frame(draw(row["episode_id"]))
        return _read_thumbnail(archive.root / row["file_name"], row["num_steps"])

    with ThreadPoolExecutor(_READERS) as readers:
        made = list(readers.map(picture_of, rows))
    pictures = [
        None if picture is None else {"bytes": picture, "path": f"{row['episode_id']}.jpg"}
        for row, picture in zip(rows, made, strict=True)
    ]
    count = sum(picture is not None for picture in pictures)
    metadata = {DIGEST_KEY: table.digest.encode(), PICTURES_KEY: str(count).encode()}
    full = table.rows
    if are_stored or count:  # an empty column would look like missing pictures
        metadata[b"huggingface"] = _FEATURES
        full = full.append_column(pa.field(THUMBNAIL, _IMAGE), pa.array(pictures, _IMAGE))
    with archive.replacing(table.name) as part:
        pq.write_table(full.replace_schema_metadata(metadata), part, compression="zstd", write_page_checksum=True)


def _read_thumbnail(bundle: Place, steps: int) -> bytes | None:
    """Returns the thumbnail of an episode, or `None` if its file is absent or its first frame cannot be read.

    Args:
        bundle: the episode's file.
        steps: number of steps of the episode.

    Raises:
        WorldError: the store does not answer.
    """
    try:
        with bundle.open("rb") as file, BundleReader(file, steps) as reader:
            return _shrink_frame(reader.rgb(0))
    except (InvalidBundle, OSError):
        return None


def _shrink_frame(rgb: NDArray[np.uint8]) -> bytes:
    """Returns a (640, 640, 3) sRGB frame as a JPEG of 160 x 160 pixels, each the mean of 4 x 4 pixels."""
    small = Image.fromarray(rgb).reduce(FRAME_SIZE_PX // _THUMBNAIL_PX)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=_QUALITY)
    return buffer.getvalue()


def _name_in_card(archive: Archive) -> None:
    try:
        card = (archive.root / CARD_FILE).read_text(encoding="utf-8")
        meta = read_dataset_meta(archive.root)
    except (FileNotFoundError, WorldError):
        return  # when the card is written, it will list the existing tables
    named = with_configs(card, split_configs(splits_at(archive.root), meta.episodes, meta.failed_attempts))
    if named != card:
        with archive.replacing(CARD_FILE) as part:
            part.write_text(named, encoding="utf-8")
