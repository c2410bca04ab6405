"""Fuzz targets: each parser of external bytes, with valid files as corpus."""

from __future__ import annotations

import functools
import io
import random
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from coordinator.expansion.plan_file import load_plan
from coordinator.protocol.protocol import parse
from coordinator.protocol.relay_handlers import RELAY_MESSAGES
from coordinator.tables.table_reader import read_column, read_failed_attempts
from coordinator.validation.messages import ValidationTask
from coordinator.validation.validator_child import verdict_of
from factory.dataset.reader import Dataset
from factory.scenes.formats import extract_scene
from factory.scenes.importer.extract import extract_stage
from factory.scenes.limits import StageLimits
from factory.scenes.stage_file import kind_of_file
from factory.verify.dataset import verify
from schemas.encoding.container import ContainerLimits, ContainerReader, ContainerWriter
from schemas.errors import InvalidBundle
from schemas.protocol.keys import Verb
from schemas.scene import decode_scene, read_scene_info
from schemas.storage.dataset_files import EPISODES, SHARDS_FILE
from schemas.storage.episode_list import list_episodes
from schemas.storage.packed_path import PackedPath
from schemas.storage.shard_index import ShardIndex, open_shard, read_index, write_index
from schemas.storage.shards import MAX_SHARD_EPISODES, read_shard, write_shard
from tests.builders.bundle import bundle_bytes, job_for
from tests.builders.dataset import chair, make_dataset, office_package
from tests.builders.formats import write_room
from tests.builders.stage import StageText, room_body
from tests.fuzz.mutate import mutate, mutate_members
from workers.process.messages import read_report

CORPUS = Path(__file__).parent / "corpus"
Mutate = Callable[[random.Random, bytes, Sequence[bytes]], bytes]
_VERBS = tuple(Verb)
_SHARD = "shard_000001-001000-01234567.zip"
_ZIPFILE_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    NotImplementedError,
    RuntimeError,
    OSError,
    EOFError,
    struct.error,
)
"""Exceptions of `zipfile` on damaged files."""


class Target(NamedTuple):
    """A parser to fuzz, with its valid input files."""

    run: Callable[[bytes, Path], object]
    """Parses bytes, and may use a private folder; may raise a `FactoryError` only."""
    seeds: Callable[[Path], list[bytes]]
    """Function that makes valid files in a folder, in addition to those of the corpus."""
    mutate: Mutate = mutate


def _read_message(data: bytes, _folder: Path) -> None:
    """Parses a message; the first byte selects its verb."""
    verb, payload = _VERBS[(data or b"\0")[0] % len(_VERBS)], data[1:]
    parse(verb, "host", payload)
    parse(verb, "host", payload, RELAY_MESSAGES)
    read_report(payload)


def _messages(_folder: Path) -> list[bytes]:
    return [bytes([number]) + b"{}" for number in range(len(_VERBS))]


def _read_plan(data: bytes, folder: Path) -> None:
    path = folder / "plan.toml"
    path.write_bytes(data)
    load_plan(str(path))


def _plans(_folder: Path) -> list[bytes]:
    page = (Path(__file__).parents[2] / "docs" / "plans.md").read_text()
    return [page.partition("```toml\n")[2].partition("```")[0].encode()]


def _read_container(data: bytes, _folder: Path) -> None:
    """Reads every member; if `zipfile` also reads the file, both must return the same bytes."""
    reader = ContainerReader(io.BytesIO(data), ContainerLimits(members=16, member_bytes=1 << 16))
    ours = [_or_none(reader.read, name) for name in reader.names]
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as other:
            theirs = [_or_none(other.read, info) for info in other.infolist()]
    except _ZIPFILE_ERRORS:
        return
    assert len(ours) == len(theirs), f"{len(ours)} members, zipfile finds {len(theirs)}"
    for name, one, two in zip(reader.names, ours, theirs, strict=True):
        assert one is None or two is None or one == two, f"{name!r} differs from what zipfile reads"


def _or_none(read: Callable[[Any], bytes], member: object) -> bytes | None:
    try:
        return read(member)
    except (InvalidBundle, *_ZIPFILE_ERRORS):
        return None


def _containers(_folder: Path) -> list[bytes]:
    """Returns a container that this project writes, and a file with the same members that `zipfile` writes."""
    members = {"meta.json": b"{}", "rgb_front/000000.png": bytes(range(64)), "ö.npy": b"", "last": b"PK\x05\x06" * 4}
    ours, theirs = io.BytesIO(), io.BytesIO()
    with ContainerWriter(ours) as writer, zipfile.ZipFile(theirs, "w") as stored:
        for name, data in members.items():
            writer.add(name, data)
            stored.writestr(zipfile.ZipInfo(name), data)
    return [ours.getvalue(), theirs.getvalue()]


def _read_shards(data: bytes, folder: Path) -> None:
    """Reads the bytes as a shard, by its directory or its headers, and as the index of an intact shard."""
    root = folder / "packed"
    (root / EPISODES).mkdir(parents=True, exist_ok=True)
    (root / EPISODES / _SHARD).write_bytes(data)
    (root / SHARDS_FILE).write_bytes(data)
    shard, _ = open_shard(root / EPISODES / _SHARD)
    for number, path in ShardIndex.of(root / EPISODES, [shard]):
        _or_none(PackedPath.read_bytes, path)
        assert 1 <= number <= MAX_SHARD_EPISODES, f"episode {number} is outside of the range"
    list_episodes(root)
    index = read_index(root)
    for _, path in index or ():
        _or_none(PackedPath.read_bytes, path)


def _shards(folder: Path) -> list[bytes]:
    """Returns a shard and its index."""
    file, index = io.BytesIO(), folder / "seed.parquet"
    write_shard(file, ((number, bytes([number]) * 40 * number) for number in (1, 2, 5)))
    write_index(index, ShardIndex.of(folder / EPISODES, [read_shard(file, _SHARD)]))
    return [file.getvalue(), index.read_bytes()]


def _read_bundle(data: bytes, folder: Path) -> None:
    path = folder / "bundle.zip"
    path.write_bytes(data)
    with path.open("rb") as file:
        verdict_of(ValidationTask(job=job_for(), candidates=(chair(),)), file)


def _bundles(_folder: Path) -> list[bytes]:
    return [bundle_bytes()]


def _read_scene(data: bytes, _folder: Path) -> None:
    read_scene_info(io.BytesIO(data))
    decode_scene(io.BytesIO(data))


def _read_tables(data: bytes, folder: Path) -> None:
    """Reads a dataset whose tables are all replaced by the bytes."""
    root = _dataset(folder)
    (root / "metadata.parquet").write_bytes(data)
    (root / "attempts.parquet").write_bytes(data)
    read_column(root / "metadata.parquet", "episode_id")
    read_failed_attempts(root / "attempts.parquet")
    verify(root)
    dataset = Dataset(root)
    len(dataset.filter(split="train_id"))
    list(dataset)


@functools.cache
def _dataset(folder: Path) -> Path:
    root = folder / "dataset"
    if not (root / EPISODES).is_dir():
        make_dataset(root, 2)
    return root


def _tables(folder: Path) -> list[bytes]:
    root = folder / "seeds"
    make_dataset(root, 2)
    return [(root / name).read_bytes() for name in ("metadata.parquet", "attempts.parquet")]


def _read_stage(data: bytes, folder: Path) -> None:
    path = folder / "stage.usda"
    path.write_bytes(data)
    extract_stage(path)


def _stages(folder: Path) -> list[bytes]:
    text = StageText()
    bodies = (room_body(text), text.box("Box", (0, 0, 0), (1, 1, 1)))
    return [text.write(folder / "seed.usda", body).read_bytes() for body in bodies]


_SUFFIXES = (".glb", ".gltf", ".obj", ".stl", ".ply", ".dae", ".sdf", ".urdf")


def _read_formats(data: bytes, folder: Path) -> None:
    """Reads a scene file; the first byte selects its suffix."""
    suffix = _SUFFIXES[(data or b"\0")[0] % len(_SUFFIXES)]
    path = folder / f"scene{suffix}"
    path.write_bytes(data[1:])
    states_units = suffix not in (".sdf", ".urdf") and kind_of_file(path) not in ("SDF", "URDF", "MJCF", "USD")
    extract_scene(path, StageLimits(100_000, unit="m", up="z") if states_units else StageLimits(100_000))


def _formats(folder: Path) -> list[bytes]:
    return [bytes([number]) + write_room(folder, suffix).read_bytes() for number, suffix in enumerate(_SUFFIXES)]


TARGETS: Mapping[str, Target] = MappingProxyType(
    {
        "messages": Target(_read_message, _messages),
        "plans": Target(_read_plan, _plans),
        "containers": Target(_read_container, _containers),
        "shards": Target(_read_shards, _shards),
        "bundles": Target(_read_bundle, _bundles, mutate_members),
        "scenes": Target(_read_scene, lambda _folder: [office_package()], mutate_members),
        "tables": Target(_read_tables, _tables),
        "stages": Target(_read_stage, _stages),
        "formats": Target(_read_formats, _formats),
    }
)
