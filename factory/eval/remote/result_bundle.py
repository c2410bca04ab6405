"""Reply of a worker to an evaluation task: the result and the note of its policy, as a bundle of one member.

Reads and writes open files; limits sizes before allocating memory. Does not check the content of a result.
"""

from __future__ import annotations

from typing import BinaryIO

from pydantic import ValidationError

from factory.eval.models.result import EpisodeResult
from factory.eval.policies.note import PolicyNote
from schemas.base import Model
from schemas.encoding.container import ContainerLimits, ContainerReader, ContainerWriter
from schemas.errors import InvalidBundle

_MEMBER = "driven.json"
_LIMITS = ContainerLimits(members=1, member_bytes=4 << 20)


class ResultBundle(Model):
    """Result of one episode with the metadata of its policy."""

    result: EpisodeResult
    note: PolicyNote


def write_result_bundle(driven: ResultBundle, file: BinaryIO) -> None:
    """Writes the bundle."""
    with ContainerWriter(file) as container:
        container.add(_MEMBER, driven.model_dump_json().encode())


def read_result_bundle(file: BinaryIO) -> ResultBundle:
    """Reads a bundle.

    Raises:
        InvalidBundle: The file is not a valid bundle.
    """
    text = ContainerReader(file, _LIMITS).read(_MEMBER)
    try:
        return ResultBundle.model_validate_json(text)
    except ValidationError as error:
        places = [f"{'.'.join(map(str, item['loc']))}: {item['msg']}" for item in error.errors()[:20]]
        raise InvalidBundle(f"{_MEMBER} is not valid", places) from error
