"""Lists everything that an export contains by name: files, columns, keys, members of shards, topics. Reads all formats.

A name is `file:PATTERN`, `column:NAME`, `key:a.b`, `member:SUFFIX`, `topic:NAME`, `pickle:KEY` or `feature:NAME`, a
feature of TFRecord or a member of HDF5. Numbers in paths are replaced by `#`. Descriptions of the export (`README.md`,
`export.json`, `rig.json`, statistics, schemas) are not listed, and an origin is one name, because it is the description
of a job.
"""

from __future__ import annotations

import gzip
import json
import pickle
import re
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import pyarrow.parquet as pq

from tests.builders.tfrecord import examples_in

_DESCRIPTIONS = {"README.md", "export.json", "info.json", "stats.json", "modality.json", "shards.json"}
_DESCRIPTIONS |= {"features.json", "dataset_info.json"}
_DESCRIPTIONS |= {"episodes_stats.jsonl"}
ORIGIN = "origin"


def names_in(out: Path) -> set[str]:
    """Returns the names of everything in an export."""
    return {name for path in sorted(out.rglob("*")) if path.is_file() for name in _names(path, out)}


def _names(path: Path, out: Path) -> Iterator[str]:
    if path.name in _DESCRIPTIONS:
        return
    yield "file:" + re.sub(r"(?<![a-z])\d+", "#", str(path.relative_to(out)))
    if path.name.endswith(".parquet"):
        yield from _columns(path)
    elif path.name.endswith((".jsonl", ".json", ".json.gz")) and path.name not in ("rig.json", "origin.json"):
        yield from _texts(path)
    elif path.suffix == ".tar":
        yield from _members(path)
    elif path.suffix == ".mcap":
        yield from _records(path)
    elif ".tfrecord-" in path.name:
        yield from _features(path)
    elif path.suffix == ".hdf5":
        yield from _demonstrations(path)
    elif path.suffix == ".pkl":
        yield from (f"pickle:{key}" for key in pickle.loads(path.read_bytes()))


def _columns(path: Path) -> Iterator[str]:
    for name in pq.read_schema(path).names:
        if not name.startswith(("stats/", "videos/")):
            yield f"column:{name}"


def _texts(path: Path) -> Iterator[str]:
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    for text in data.decode().splitlines() if path.suffix == ".jsonl" else [data.decode()]:
        yield from _keys(json.loads(text))


def _keys(value: Any, prefix: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        for key, inner in value.items():
            name = re.sub(r"^\d+$", "#", key)
            if name == ORIGIN:
                yield f"key:{prefix}{ORIGIN}"
            elif isinstance(inner, dict | list) and inner:
                yield from _keys(inner, f"{prefix}{name}.")
            elif inner not in (None, {}, []):
                yield f"key:{prefix}{name}"
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for inner in value:
            yield from _keys(inner, prefix)
    elif prefix:
        yield f"key:{prefix[:-1]}"


def _members(path: Path) -> Iterator[str]:
    with tarfile.open(path) as archive:
        for member in archive:
            suffix = member.name.partition(".")[2]
            yield f"member:{suffix}"
            if suffix.endswith("json"):
                file = archive.extractfile(member)
                assert file is not None
                yield from _keys(json.load(file))


def _features(path: Path) -> Iterator[str]:
    for example in examples_in(path):
        yield from (f"feature:{name}" for name in example)
        yield from _keys({"instances": json.loads(example["episode_metadata/instances"][0])})


def _demonstrations(path: Path) -> Iterator[str]:
    with h5py.File(path) as file:
        for demo in file["data"].values():
            names: list[str] = [*demo.attrs]
            demo.visititems(lambda name, item, names=names: names.append(name) if hasattr(item, "shape") else None)
            yield from (f"feature:{name}" for name in names)
            yield from _keys({"instances": json.loads(demo["instances"][()])})


def _records(path: Path) -> Iterator[str]:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        yield from (f"topic:{channel.topic}" for channel in summary.channels.values())
        for record in reader.iter_metadata():
            yield from (f"key:{key}" for key in record.metadata)
        for attachment in reader.iter_attachments():
            yield from _keys(json.loads(attachment.data))
