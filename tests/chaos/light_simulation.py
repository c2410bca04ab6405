"""A simulation without physics, of the standard library alone, so that it starts at once: `LONGEST_S KITCHEN`.

It takes its time, tells its progress, and misses where `tests.builders.small_simulation` does; its bundles it fetches.
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
from typing import Any

_MISS_EVERY = 4


def main() -> None:
    threading.Thread(target=_serve_all, daemon=True).start()
    while True:
        time.sleep(60)


def _serve_all() -> None:
    try:
        _tell(kind="ready", renderer="synthetic")
        for line in os.fdopen(0, "rb", closefd=False):
            threading.Thread(target=_serve, args=(line,)).start()
    finally:  # whatever became of the supervisor
        os._exit(0)


def _serve(line: bytes) -> None:
    order = json.loads(line)
    steps = random.randint(1, 10)
    for step in range(1, steps + 1):
        time.sleep(random.uniform(0.0, float(sys.argv[1]) / 10))
        _tell(kind="progress", step=step)
    seed = hashlib.sha256(f"{order['job']['index']} {order['job']['attempt']}".encode()).digest()[0]
    if seed % _MISS_EVERY == 0:
        _tell(kind="failure", reason="collision", detail="stalled", step=steps)
        return
    data = _fetch(line)
    part = order["bundle_path"] + ".part"
    with open(part, "wb") as file:
        file.write(data)
    os.rename(part, order["bundle_path"])
    _tell(kind="success", step=12, sha256=hashlib.sha256(data).hexdigest(), size=len(data))


def _fetch(line: bytes) -> bytes:
    with socket.socket(socket.AF_UNIX) as kitchen:
        kitchen.connect(f"\0{sys.argv[2]}")
        kitchen.sendall(line)
        return b"".join(iter(lambda: kitchen.recv(1 << 16), b""))


def _tell(**report: Any) -> None:
    os.write(1, json.dumps(report).encode() + b"\n")


if __name__ == "__main__":
    main()
