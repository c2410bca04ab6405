"""Simulation without physics that starts fast, because it uses only the standard library.

Arguments: `LONGEST_S BUNDLE_MAKER`. An attempt takes a random time, reports progress, and fetches its bundle from the
`BundleMaker`. The same attempts fail as in `tests.builders.small_simulation`.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

_MISS_EVERY = 4


def main(damage: Callable[[bytes], tuple[bytes, str]] | None = None) -> None:
    """Serves orders until stdin ends.

    Args:
        damage: (bundle) -> bytes to write to the disk and SHA-256 to report; `None` for a host without faults.
    """
    threading.Thread(target=_serve_all, args=(damage or _keep,), daemon=True).start()
    while True:
        time.sleep(60)


def _keep(bundle: bytes) -> tuple[bytes, str]:
    return bundle, hashlib.sha256(bundle).hexdigest()


def _serve_all(damage: Callable[[bytes], tuple[bytes, str]]) -> None:
    try:
        _report(kind="ready", renderer="synthetic")
        for line in os.fdopen(0, "rb", closefd=False):
            threading.Thread(target=_serve, args=(line, damage)).start()
    finally:  # stdin also ends when the supervisor is killed
        os._exit(0)


def _serve(line: bytes, damage: Callable[[bytes], tuple[bytes, str]]) -> None:
    order = json.loads(line)
    steps = random.randint(1, 10)
    for step in range(1, steps + 1):
        time.sleep(random.uniform(0.0, float(sys.argv[1]) / 10))
        _report(kind="progress", step=step)
    if misses(order["job"]["index"], order["job"]["attempt"]):
        _report(kind="failure", reason="collision", detail="stalled", step=steps)
        return
    data, sha256 = damage(_fetch(line))
    part = order["bundle_path"] + ".part"
    with open(part, "wb") as file:
        file.write(data)
    os.rename(part, order["bundle_path"])
    _report(kind="success", step=12, sha256=sha256, size=len(data))


def misses(index: int, attempt: int) -> bool:
    """Returns whether an attempt at an episode fails; the result is the same on every host."""
    return hashlib.sha256(f"{index} {attempt}".encode()).digest()[0] % _MISS_EVERY == 0


def _fetch(line: bytes) -> bytes:
    with socket.socket(socket.AF_UNIX) as bundle_maker:
        bundle_maker.connect(f"\0{sys.argv[2]}")
        bundle_maker.sendall(line)
        return b"".join(iter(lambda: bundle_maker.recv(1 << 16), b""))


def _report(**report: Any) -> None:
    os.write(1, json.dumps(report).encode() + b"\n")


if __name__ == "__main__":
    main()
