"""The sandboxed side of validation: reads tasks as JSON lines, writes verdicts; holds itself to its limits.

Writes no file, opens no socket, and is expected to be killed at any moment.
"""

from __future__ import annotations

import hashlib
import resource
import sys
from pathlib import Path

from coordinator.check.validate import validate
from coordinator.check.validator import MAX_FINDING_CHARS, MAX_FINDINGS, Limits, Task, Verdict
from coordinator.summary import summary_of
from schemas.bundle import MAX_BUNDLE_BYTES, BundleReader
from schemas.errors import InvalidBundle

__all__ = ["judge", "main"]


def judge(task: Task) -> Verdict:
    """Validates one bundle in this very process."""
    try:
        with Path(task.path).open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
            if size > MAX_BUNDLE_BYTES:
                return Verdict(findings=(f"{size} bytes, more than {MAX_BUNDLE_BYTES}",))
            with BundleReader(file) as bundle:
                findings = validate(bundle, task.job, task.target)
                if not findings:
                    return Verdict(summary=summary_of(bundle.meta, sha256, size))
    except InvalidBundle as error:
        findings = list(error.findings)
    except OSError as error:
        findings = [f"cannot be read: {error}"]
    return Verdict(findings=tuple(finding[:MAX_FINDING_CHARS] for finding in findings[:MAX_FINDINGS]))


def _confine(limits: Limits) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes, limits.memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))


def _allow_cpu(limits: Limits) -> None:
    """Grants the CPU time of one more task; the limit counts over the whole life of the process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + 1 + limits.cpu_s, hard))


def main(arguments: list[str]) -> int:
    """Serves tasks from standard input until it ends."""
    limits = Limits.model_validate_json(arguments[0])
    _confine(limits)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        _allow_cpu(limits)
        verdict = judge(Task.model_validate_json(line))
        sys.stdout.write(f"{verdict.model_dump_json()}\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
