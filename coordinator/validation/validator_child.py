"""Sandboxed child process of the validator: receives orders and open files from a socket, and writes verdicts as JSON.

The process writes no file and opens no socket. It may be killed at any time.
"""

from __future__ import annotations

import hashlib
import io
import os
import resource
import socket
import sys
from typing import BinaryIO

import numpy.ma
import numpy.random  # noqa: F401 - for the sampled frames of a states recording

from coordinator.validation.messages import (
    HEADER,
    MAX_FINDING_CHARS,
    MAX_FINDINGS,
    MAX_TASKS,
    ValidationOrder,
    ValidationTask,
    ValidatorLimits,
    Verdict,
    Verdicts,
)
from coordinator.validation.sandbox import confine
from coordinator.validation.validate import validate
from schemas.bundle import MAX_BUNDLE_BYTES, BundleReader
from schemas.dataset.rows import summary_of
from schemas.errors import InvalidBundle
from schemas.language.sentence.grammar import LANGUAGES, grammar
from schemas.scene.complete import require_sound


def verdict_of(task: ValidationTask, file: BinaryIO) -> Verdict:
    """Validates an open bundle in the current process."""
    try:
        sha256 = task.sha256 or hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
        size = file.seek(0, os.SEEK_END)
        if size > MAX_BUNDLE_BYTES:
            return Verdict(findings=(f"{size} bytes, more than {MAX_BUNDLE_BYTES}",))
        if task.job is None:
            require_sound(file)
            return Verdict()
        with BundleReader(file) as bundle:
            findings = validate(bundle, task.job, task.candidates, scope=task.scope)
            if not findings:
                return Verdict(summary=summary_of(bundle.meta, sha256, size), language=bundle.meta.language)
    except InvalidBundle as error:
        findings = list(error.findings)
    except OSError as error:
        findings = [f"cannot be read: {error}"]
    return Verdict(findings=tuple(finding[:MAX_FINDING_CHARS] for finding in findings[:MAX_FINDINGS]))


def _verdict_and_close(task: ValidationTask, file: BinaryIO) -> Verdict:
    with file:
        return verdict_of(task, file)


def _allow_cpu(limits: ValidatorLimits) -> None:
    """Raises the CPU time limit by the time of one order; the limit applies to the total time of the process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + 1 + limits.cpu_s, hard))


def _receive(orders: socket.socket) -> tuple[ValidationOrder, list[BinaryIO]] | None:
    """Returns the next order and its files, or `None` at the end of the input."""
    header, descriptors, _, _ = socket.recv_fds(orders, HEADER.size, MAX_TASKS)
    if len(header) < HEADER.size or not descriptors:
        return None
    (length,) = HEADER.unpack(header)
    text = bytearray()
    while len(text) < length:
        part = orders.recv(length - len(text))
        if not part:
            return None
        text += part
    return ValidationOrder.model_validate_json(bytes(text)), [_open(descriptor) for descriptor in descriptors]


def _open(descriptor: int) -> BinaryIO:
    return io.BufferedReader(io.FileIO(descriptor, "rb"), os.fstat(descriptor).st_blksize)


def main(arguments: list[str]) -> int:
    """Executes orders from standard input, a socket, until it is closed."""
    limits = ValidatorLimits.model_validate_json(arguments[0])
    orders = socket.socket(fileno=0)
    for code in LANGUAGES:
        grammar(code)  # checking a job needs the grammars, and the sandbox forbids opening files
    layers = confine(limits.memory_bytes)
    sys.stdout.write(f"ready {' '.join(layers)}\n")
    sys.stdout.flush()
    while (received := _receive(orders)) is not None:
        order, files = received
        _allow_cpu(limits)
        verdicts = Verdicts(verdicts=tuple(map(_verdict_and_close, order.tasks, files)))
        sys.stdout.write(f"{verdicts.model_dump_json()}\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
