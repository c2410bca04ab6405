"""A simulation process without simulation: the first word of the instruction of a job selects its behaviour.

Run as a script; it uses the messages of `workers.process.messages` with the standard library alone, so it starts fast.
"""

from __future__ import annotations

import hashlib
import json
import os
import queue
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

SIZE = (2 << 20) + 321


def bundle_for(job: dict[str, Any]) -> bytes:
    """Returns bytes that replace a bundle; they depend only on the job."""
    seed = hashlib.sha256(json.dumps([job["index"], job["attempt"]]).encode()).digest()
    return (seed * (SIZE // len(seed) + 1))[:SIZE]


def tell(**report: object) -> None:
    os.write(1, json.dumps(report).encode() + b"\n")


def listen() -> queue.Queue[dict[str, Any]]:
    orders: queue.Queue[dict[str, Any]] = queue.Queue()

    def read() -> None:
        try:
            for line in os.fdopen(0, "rb", closefd=False):
                orders.put(json.loads(line))
        finally:
            os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    return orders


def finish(order: dict[str, Any]) -> None:
    data = bundle_for(order["job"])
    Path(order["bundle_path"]).write_bytes(data)
    tell(kind="success", step=12, sha256=hashlib.sha256(data).hexdigest(), size=len(data), seconds=0.1)


def serve(order: dict[str, Any], markers: Path) -> None:
    word = order["job"]["instruction"].split()[0]
    # the name of this file shows tests which attempt has started, and in which process
    (markers / f"{order['job']['index']}.{os.getpid()}").touch()
    if not Path(order["scene_path"]).is_file():
        tell(kind="failure", reason="crash", detail="no scene")
    elif word == "bundle":
        finish(order)
    elif word == "slow":
        for step in range(1, 6000):
            tell(kind="progress", step=step)
            time.sleep(0.05)
    elif word == "hang":
        time.sleep(600)
    elif word == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    elif word == "exit":
        sys.stderr.write("chatter\nEGL: the driver is missing\n")
        sys.stderr.flush()
        os._exit(3)
    elif word == "miss":
        tell(kind="failure", reason="collision", detail="stalled at 0.3 m", step=77, seconds=1.5)
    else:
        raise AssertionError(word)


def main() -> None:
    orders = listen()
    if sys.argv[2:] == ["broken"]:
        sys.exit("error: no EGL on this machine")
    os.write(1, b"a library says hello on stdout\n")
    tell(kind="ready", renderer="none")
    while True:
        serve(orders.get(), Path(sys.argv[1]))


if __name__ == "__main__":
    main()
