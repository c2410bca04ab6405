"""A simulation process without physics: returns the smallest valid bundle of each job, or a failure.

As in the real simulation, outcome and content depend only on the job. The duration is random.
"""

from __future__ import annotations

import hashlib
import os
import random
import sys
import threading
import time

from schemas.terms import FailReason
from tests.builders.bundle import parts_for
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind, failure, to_line

_MISS_EVERY = 4


def main() -> None:
    threading.Thread(target=_serve_all, daemon=True).start()
    while True:
        time.sleep(60)


def _serve_all() -> None:
    try:
        _tell(SimulationReport(kind=SimulationReportKind.READY, renderer="synthetic"))
        for line in os.fdopen(0, "rb", closefd=False):
            threading.Thread(target=_serve, args=(SimulationOrder.model_validate_json(line),)).start()
    finally:  # stdin also ends when the supervisor is killed
        os._exit(0)


def _serve(order: SimulationOrder) -> None:
    longest = float(sys.argv[1])
    steps = random.randint(1, 10)
    for step in range(1, steps + 1):
        time.sleep(random.uniform(0.0, longest / 10))
        _tell(SimulationReport(kind=SimulationReportKind.PROGRESS, step=step))
    seed = hashlib.sha256(f"{order.job.index} {order.job.attempt}".encode()).digest()[0]
    if seed % _MISS_EVERY == 0:
        _tell(failure(FailReason.COLLISION, "stalled", step=steps))
        return
    parts = parts_for(order.job)
    worker = parts.meta.provenance.model_copy(update={"worker": order.sid})
    data = parts.with_meta(provenance=worker).write()
    part = order.bundle_path.with_name(f"{order.bundle_path.name}.part")
    part.write_bytes(data)
    part.rename(order.bundle_path)
    digest = hashlib.sha256(data).hexdigest()
    _tell(SimulationReport(kind=SimulationReportKind.SUCCESS, step=12, sha256=digest, size=len(data)))


def _tell(report: SimulationReport) -> None:
    os.write(1, to_line(report))


if __name__ == "__main__":
    main()
