"""Returns the origin of an episode, and finds it in the export of any format. Unpickles nothing, decodes no frame.

The place in each format is one that the tools of its readers keep (docs/formats/README.md#origin-of-an-episode).
"""

from __future__ import annotations

import gzip
import json
import tarfile
import zlib
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from factory.dataset.episode import Episode
from factory.dataset.episode_names import episode_index
from factory.export.registry import EXPORTERS
from factory.export.source import as_frames
from factory.export.tfrecord import read_examples
from schemas.dataset.origin import NOT_RECORDED, PACKAGE, EpisodeOrigin
from schemas.errors import UsageError, WorldError
from schemas.job import episode_id
from schemas.support.extras import require_package
from schemas.support.foreign import PARSER_ERRORS
from schemas.terms import Recording

COLUMN = "origin"
"""Name of the column, key or metadata field with the origin as JSON."""
FILE = "origin.json"
DEMOS = "data"
"""Group of the demonstrations in an export for robomimic; each has the origin as the dataset `origin`."""
_TFDS_FEATURE = f"episode_metadata/{COLUMN}"
_MAX_BYTES = 1 << 20
"""Largest size of one origin, bytes."""
_MAX_UNPACKED = 1 << 30
_NAMED = 5


def origin_of(episode: Episode) -> EpisodeOrigin:
    """Returns the origin; equal for both recordings of an episode, as exports are."""
    stored = episode.meta.job.record is Recording.FRAMES
    meta = episode.meta if stored else as_frames(episode, 0)
    return EpisodeOrigin(
        episode=episode.episode_id,
        version=meta.provenance.fingerprint.software.get(PACKAGE, NOT_RECORDED),
        states_digest=episode.states_digest,
        job=meta.job,
    )


def write_origin(episode: Episode, folder: Path) -> None:
    """Writes the origin to `origin.json` in the folder of an episode."""
    (folder / FILE).write_text(origin_of(episode).to_json() + "\n", encoding="utf-8")


class Found(NamedTuple):
    """Origin in an export."""

    episode: str
    """Id of the episode."""
    text: str
    """The origin as JSON; empty if it was not read, because another episode is requested."""


def find_origin(export: Path, name: str) -> EpisodeOrigin:
    """Returns the origin of an episode of an export.

    Args:
        export: directory of the export, or one of its files: a tar shard, an MCAP file, a Parquet file of LeRobot, a
            file of Habitat, a TFRecord file, or an HDF5 file.
        name: id of the episode, such as `ep_000001` or 1.

    Raises:
        UsageError: the path is not an export, states no origins, or has no such episode or several.
        WorldError: a file is damaged.
    """
    if not export.exists():
        raise UsageError(f"{export} does not exist; give the --out of `factory export`")
    wanted = episode_id(episode_index(name))
    seen: dict[str, None] = {}
    texts: dict[str, None] = {}
    try:
        for episode, text in _origins(export, wanted):
            seen[episode] = None
            if episode == wanted and text:
                texts[text] = None
    except (pa.ArrowException, tarfile.TarError, EOFError, zlib.error, *PARSER_ERRORS) as error:
        raise WorldError(f"{export} cannot be read as an export: {error}; export the dataset again") from error
    if len(texts) > 1:
        raise UsageError(
            f"{export} has {len(texts)} episodes called {wanted}, from several datasets: give one of its files"
        )
    if texts:
        return _parse(export, next(iter(texts)))
    if seen and wanted not in seen:
        some = ", ".join(sorted(seen)[:_NAMED]) + (", ..." if len(seen) > _NAMED else "")
        raise UsageError(f"{export} has no episode {wanted}; it has {some}")
    raise UsageError(
        f"{export} states no origins of episodes: give an export of {', '.join(EXPORTERS)} that this version of "
        "`factory export` or a later one has written"
    )


def _parse(export: Path, text: str) -> EpisodeOrigin:
    if len(text) > _MAX_BYTES:
        raise WorldError(
            f"{export}: an origin of {len(text)} bytes is larger than {_MAX_BYTES}: export the dataset again"
        )
    try:
        return EpisodeOrigin.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise WorldError(
            f"{export}: the origin of the episode is damaged or newer at {where!r}: {first['msg']}; use the version of "
            "minivla-factory that wrote the export"
        ) from error


def _origins(export: Path, wanted: str) -> Iterator[Found]:
    """Yields the origins of all formats that a path contains; some readers yield that of the wanted episode only."""
    files = [export] if export.is_file() else sorted(path for path in export.rglob("*") if path.is_file())
    for path in files:
        for pattern, read in _READERS:
            if fnmatch(path.name, pattern):
                yield from read(path, wanted)


def _in_lerobot(path: Path, wanted: str) -> Iterator[Found]:  # noqa: ARG001
    with pq.ParquetFile(path) as file:
        if COLUMN not in file.schema_arrow.names:
            return
        for batch in file.iter_batches(columns=[COLUMN]):
            for text in batch[COLUMN].to_pylist():
                if text:
                    yield _found(text)


def _in_tar(path: Path, wanted: str) -> Iterator[Found]:
    with tarfile.open(path, "r:") as archive:
        for member in archive:
            stem, _, suffix = member.name.partition(".")
            if suffix != "json" or not member.isfile() or member.size > _MAX_BYTES:
                continue
            name = stem.rpartition("_")[0]
            file = archive.extractfile(member) if name == wanted else None
            sample = {} if file is None else json.loads(file.read())
            yield Found(name, sample.get(COLUMN, "") if isinstance(sample, dict) else "")


def _in_mcap(path: Path, wanted: str) -> Iterator[Found]:  # noqa: ARG001
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with path.open("rb") as file:
        try:
            for record in make_reader(file).iter_metadata():
                if record.name == "episode" and COLUMN in record.metadata:
                    yield _found(record.metadata[COLUMN])
        except McapError as error:
            raise ValueError(f"{path}: {error}") from error


def _in_file(path: Path, wanted: str) -> Iterator[Found]:  # noqa: ARG001
    if path.stat().st_size <= _MAX_BYTES:
        yield _found(path.read_text(encoding="utf-8"))


def _in_habitat(path: Path, wanted: str) -> Iterator[Found]:  # noqa: ARG001
    with gzip.open(path) as packed:
        data = json.loads(_bounded(packed))
    for entry in data.get("episodes", ()) if isinstance(data, dict) else ():
        origin = entry.get("info", {}).get(COLUMN)
        if origin:
            yield _found(json.dumps(origin))


def _bounded(file: gzip.GzipFile) -> bytes:
    data = file.read(_MAX_UNPACKED + 1)
    if len(data) > _MAX_UNPACKED:
        raise ValueError(f"it unpacks to more than {_MAX_UNPACKED} bytes")
    return data


def _in_lines(path: Path, wanted: str) -> Iterator[Found]:  # noqa: ARG001
    with path.open(encoding="utf-8") as file:
        while line := file.readline(_MAX_BYTES):
            entry = json.loads(line)
            if isinstance(entry, dict) and isinstance(entry.get(COLUMN), dict):
                yield _found(json.dumps(entry[COLUMN]))


def _in_tfrecord(path: Path, wanted: str) -> Iterator[Found]:  # noqa: ARG001
    for features in read_examples(path, {_TFDS_FEATURE}, _MAX_BYTES):
        if text := features.get(_TFDS_FEATURE):
            yield _found(text.decode())


def _in_hdf5(path: Path, wanted: str) -> Iterator[Found]:  # noqa: ARG001
    require_package("h5py", f"an origin in {path.name}")
    import h5py

    with h5py.File(path, "r") as file:
        demos = _member(file, DEMOS, h5py.Group)
        for name in demos or ():
            demo = _member(demos, name, h5py.Group)
            text = None if demo is None else _member(demo, COLUMN, h5py.Dataset)
            if text is None or text.shape != () or text.dtype.kind != "S":
                continue
            if text.dtype.itemsize > _MAX_BYTES:
                raise ValueError(f"an origin of {text.dtype.itemsize} bytes is larger than {_MAX_BYTES}")
            yield _found(text[()].decode())


def _member(group: Any, name: str, kind: type) -> Any:
    """Returns a member of an HDF5 group, or `None` if it is of another kind, or a link that may leave the file."""
    import h5py

    member = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    return member if isinstance(member, kind) else None


def _found(text: str) -> Found:
    data = json.loads(text)
    return Found(str(data.get("episode", "")) if isinstance(data, dict) else "", text)


Reader = Callable[[Path, str], Iterator[Found]]
_READERS: tuple[tuple[str, Reader], ...] = (
    ("*.parquet", _in_lerobot),
    ("*.tar", _in_tar),
    ("*.mcap", _in_mcap),
    (f"*{FILE}", _in_file),
    ("*.json.gz", _in_habitat),
    ("*episodes.jsonl", _in_lines),
    ("*.tfrecord-*", _in_tfrecord),
    ("*.hdf5", _in_hdf5),
)
