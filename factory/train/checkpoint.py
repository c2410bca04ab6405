"""Reads and writes checkpoints: tensors and JSON metadata in one file. Reading executes no code from the file."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from factory.train.input_size import PREPROCESS_VERSION
from factory.train.options import CHECKPOINT_FORMAT, CheckpointMeta
from factory.train.torch_import import load_torch
from schemas.errors import UsageError, WorldError
from schemas.storage.disk import replacing

MAX_BYTES = 1 << 30
"""Maximum size of a checkpoint file, bytes."""
POLICY, STATE = "policy.pt", "state.pt"
"""File names in a training folder: the weights of the policy, and the state from which a training resumes."""


class Checkpoint(NamedTuple):
    """Content of a checkpoint file."""

    meta: CheckpointMeta
    tensors: dict[str, Any]
    """Groups of tensors by name: `model` holds the weights of the policy; the others resume the training."""


def checkpoint_path(path: Path) -> Path:
    """Returns the checkpoint file for the path after `bc:`, which may be a training folder."""
    return path / POLICY if path.is_dir() else path


def parse_meta(text: object, path: Path) -> CheckpointMeta:
    """Parses the metadata of a checkpoint.

    Raises:
        UsageError: The text is not the metadata of a checkpoint, or its version is not supported.
    """
    if not isinstance(text, str):
        raise UsageError(f"{path} is not a checkpoint of `factory train`: the text `meta` is missing")
    found = re.match(r'\{"format":\s*(\d{1,9}),', text)  # newer metadata can have fields that this version refuses
    if found and int(found[1]) > CHECKPOINT_FORMAT:
        raise UsageError(
            f"{path} was written by another version (format {found[1]}; this version reads formats up to "
            f"{CHECKPOINT_FORMAT}): train the policy again"
        )
    try:
        meta = CheckpointMeta.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        what = f"{'.'.join(map(str, first['loc'])) or 'the text'}: {first['msg']}"
        raise UsageError(f"{path} is not a checkpoint that this version reads ({what})") from error
    if meta.look != PREPROCESS_VERSION:
        versions = f"preprocessing {meta.look}; this version reads preprocessing {PREPROCESS_VERSION}"
        raise UsageError(f"{path} was written by another version ({versions}): train the policy again")
    return meta


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Writes a checkpoint atomically and durably.

    Raises:
        WorldError: The file cannot be written.
    """
    torch = load_torch()
    buffer = io.BytesIO()
    torch.save({"meta": checkpoint.meta.model_dump_json(), **checkpoint.tensors}, buffer)
    write_atomically(path, buffer.getvalue())


def read_checkpoint(path: Path) -> Checkpoint:
    """Reads a checkpoint; loads tensors and plain values only and executes no code.

    Raises:
        UsageError: The file does not exist, or it is not a checkpoint.
        WorldError: The file cannot be read, or is damaged.
    """
    torch = load_torch()
    path = checkpoint_path(path)
    if not path.is_file():
        raise UsageError(f"checkpoint {path} does not exist; `factory train bc DIR -o OUT` creates OUT/{POLICY}")
    if path.stat().st_size > MAX_BYTES:
        raise UsageError(f"{path} has {path.stat().st_size} bytes; the maximum size of a checkpoint is {MAX_BYTES}")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the unpickler raises many exception types for invalid files
        first = (str(error).splitlines() or ["no reason given"])[0][:200]
        raise WorldError(f"{path} is damaged or not a checkpoint ({type(error).__name__}: {first})") from error
    if not isinstance(content, dict):
        raise UsageError(f"{path} is not a checkpoint of `factory train`: it contains a {type(content).__name__}")
    return Checkpoint(parse_meta(content.pop("meta", None), path), content)


def write_atomically(path: Path, data: bytes) -> None:
    """Writes a file atomically and durably: to a temporary file, synced, then renamed."""
    with replacing(path, durable=True) as part:
        part.write_bytes(data)
