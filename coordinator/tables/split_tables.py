"""Writes the split tables, `data/<split>-<number>.parquet`: rows of `metadata.parquet` with thumbnails.

`datasets.load_dataset` reads the splits from these files. The module generates them from `metadata.parquet` and the
episode files at the end of a run, in `factory repair` and in `factory gather`. It does not rewrite current files.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import structlog
from numpy.typing import NDArray
from PIL import Image

from coordinator.archive.contract import Archive
from coordinator.tables.card_configs import split_configs, splits_at, with_configs
from coordinator.tables.split_faults import SURPLUS, FaultKind, fault_of, surplus_tables
from coordinator.tables.split_layout import (
    DIGEST_KEY,
    PICTURES_KEY,
    THUMBNAIL,
    SplitTable,
    has_pictures,
    lacks_pictures,
    read_pictures,
    split_tables_of,
)
from schemas.bundle import BundleReader
from schemas.dataset.meta import read_dataset_meta
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import InvalidBundle, WorldError
from schemas.storage.dataset_files import CARD_FILE
from schemas.storage.place import Place

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
    said = {
        b"huggingface": _FEATURES,
        DIGEST_KEY: table.digest.encode(),
        PICTURES_KEY: str(sum(picture is not None for picture in pictures)).encode(),
    }
    full = table.rows.append_column(pa.field(THUMBNAIL, _IMAGE), pa.array(pictures, _IMAGE))
    with archive.replacing(table.name) as part:
        pq.write_table(full.replace_schema_metadata(said), part, compression="zstd", write_page_checksum=True)


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
