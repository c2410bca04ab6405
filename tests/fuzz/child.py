"""Fuzzes one target in a separate process. Arguments: `TARGET SEED SECONDS COUNT FOLDER`.

Writes each input to the disk before parsing it, so a crash of the interpreter leaves the input on disk. Exits with 0
without findings and with 1 after a finding.
"""

from __future__ import annotations

import faulthandler
import hashlib
import logging
import random
import resource
import signal
import sys
import time
import traceback
from pathlib import Path

import structlog

from schemas.errors import FactoryError
from tests.fuzz.targets import CORPUS, TARGETS, Target

LAST = "last-input"
MEMORY_BYTES = 4 << 30
INPUT_S = 20


class _Hang(BaseException):
    """An input took too long. Not an `Exception`, so no parser catches it."""


def main() -> int:
    """Runs until the time limit or the maximum number of inputs is reached."""
    name, seed, seconds, count, where = sys.argv[1:]
    faulthandler.enable()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    folder, target = Path(where), TARGETS[name]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, _raise_hang)
    seeds = target.seeds(folder) + [path.read_bytes() for path in sorted((CORPUS / name).glob("*"))]
    rng, done, end = random.Random(int(seed)), 0, time.monotonic() + float(seconds)
    while done < int(count) and time.monotonic() < end:
        data = seeds[done] if done < len(seeds) else target.mutate(rng, rng.choice(seeds), seeds)
        if not _is_sound(target, data, folder):
            return 1
        done += 1
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    sys.stdout.write(f"{name}: {done} inputs, peak {peak_mib} MiB\n")
    return 0


def _is_sound(target: Target, data: bytes, folder: Path) -> bool:
    (folder / LAST).write_bytes(data)
    signal.alarm(INPUT_S)
    try:
        target.run(data, folder)
    except FactoryError:
        return True
    except (Exception, _Hang):  # noqa: BLE001 - any undocumented exception is a finding
        signal.alarm(0)
        traceback.print_exc()
        place = folder / f"finding-{hashlib.sha256(data).hexdigest()[:12]}"
        place.write_bytes(data)
        sys.stderr.write(f"finding: {place}\n")
        return False
    finally:
        signal.alarm(0)
    return True


def _raise_hang(*_: object) -> None:
    raise _Hang(f"an input took more than {INPUT_S} s")


if __name__ == "__main__":
    sys.exit(main())
