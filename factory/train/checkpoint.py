"""Checkpoints: tensors and one JSON text in a file, written whole or not at all, read without running any of it."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from factory.train.options import CHECKPOINT_FORMAT, CheckpointMeta
from factory.train.preprocess import PREPROCESS_VERSION
from factory.train.torch_door import load_torch
from schemas.errors import UsageError, WorldError
from schemas.storage.disk import sync_directory, translated

__all__ = ["Checkpoint", "checkpoint_path", "parse_meta", "read_checkpoint", "write_atomically", "write_checkpoint"]

MAX_BYTES = 1 << 30
"""Largest checkpoint that is opened."""
POLICY, STATE = "policy.pt", "state.pt"
"""Names within a training's folder: what drives, and what a resumed training goes on from."""


class Checkpoint(NamedTuple):
    """A file's content."""

    meta: CheckpointMeta
    tensors: dict[str, Any]
    """Groups of tensors by name: `model` is the weights that drive; others are for going on with the training."""


def checkpoint_path(path: Path) -> Path:
    """Returns the file meant by what stands after `bc:`, which may be a training's folder."""
    return path / POLICY if path.is_dir() else path


def parse_meta(text: object, path: Path) -> CheckpointMeta:
    """Returns the words of a checkpoint.

    Raises:
        UsageError: they are not a checkpoint's, or of a newer version.
    """
    if not isinstance(text, str):
        raise UsageError(f"{path} is not a checkpoint of `factory train`: the text `meta` is missing")
    try:
        meta = CheckpointMeta.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        what = f"{'.'.join(map(str, first['loc'])) or 'the text'}: {first['msg']}"
        raise UsageError(f"{path} is not a checkpoint that this version reads ({what})") from error
    if meta.format > CHECKPOINT_FORMAT or meta.look != PREPROCESS_VERSION:
        found = f"format {meta.format}, pictures of version {meta.look}"
        mine = f"format {CHECKPOINT_FORMAT}, pictures of version {PREPROCESS_VERSION}"
        raise UsageError(
            f"{path} was written by another version ({found}; this version reads {mine}): train the policy again"
        )
    return meta


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Writes a checkpoint beside its place, makes it durable and renames it.

    Raises:
        WorldError: the disk refuses.
    """
    torch = load_torch()
    buffer = io.BytesIO()
    torch.save({"meta": checkpoint.meta.model_dump_json(), **checkpoint.tensors}, buffer)
    write_atomically(path, buffer.getvalue())


def read_checkpoint(path: Path) -> Checkpoint:
    """Returns a checkpoint; only tensors and plain values are read, never code.

    Raises:
        UsageError: there is none, or it is none.
        WorldError: it cannot be read, or is damaged.
    """
    torch = load_torch()
    path = checkpoint_path(path)
    if not path.is_file():
        raise UsageError(f"checkpoint {path} does not exist; `factory train bc DIR -o OUT` creates OUT/{POLICY}")
    if path.stat().st_size > MAX_BYTES:
        raise UsageError(f"{path} has {path.stat().st_size} bytes; checkpoints have at most {MAX_BYTES}")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the unpickler raises a dozen types for what is no checkpoint
        first = (str(error).splitlines() or ["no reason given"])[0][:200]
        raise WorldError(f"{path} is damaged or not a checkpoint ({type(error).__name__}: {first})") from error
    if not isinstance(content, dict):
        raise UsageError(f"{path} is not a checkpoint of `factory train`: it contains a {type(content).__name__}")
    return Checkpoint(parse_meta(content.pop("meta", None), path), content)


def write_atomically(path: Path, data: bytes) -> None:
    """Writes a file beside its place, makes it durable and renames it."""
    part = path.with_name(f".{path.name}.part")
    with translated("write", path):
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        sync_directory(path.parent)
