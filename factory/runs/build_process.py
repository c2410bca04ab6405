"""Entry point of the process that builds layouts (`python -m factory.runs.build_process`): reads orders from stdin,
reports to stdout.

The process exits when its supervisor exits. It keeps textures between builds, and packages in the scene cache.
"""

from __future__ import annotations

import os

# numpy reads these variables when it is imported; each process uses one core
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import errno
import faulthandler
import hashlib
import sys
import tempfile
import time
import traceback
from collections.abc import Collection
from pathlib import Path

from factory.scenes.build import build_scene
from factory.scenes.rules import RuleBook, load_rules
from factory.support.settings import scene_cache
from schemas.errors import FactoryError, LayoutError
from schemas.protocol.messages import BuildOrder
from schemas.scene.complete import complete_package
from schemas.scene.files import read_texture
from schemas.terms import FailReason
from workers.process.messages import BuildTask, SimulationReport, SimulationReportKind, failure, to_line
from workers.process.pipes import listen, take_stdout

_DISK_FULL = {errno.ENOSPC, errno.EDQUOT}


def main() -> int:
    """Serves orders until stdin closes. Returns 3 after an unexpected exception, which may leave an invalid state."""
    faulthandler.enable()
    out, orders, is_valid = take_stdout(), listen(0), True
    try:
        out.write(to_line(SimulationReport(kind=SimulationReportKind.READY)))
        while is_valid:
            report, is_valid = _serve(BuildTask.model_validate_json(orders.get()))
            out.write(to_line(report))
    except BrokenPipeError:
        return 0  # the supervisor has exited
    return 3


def _serve(task: BuildTask) -> tuple[SimulationReport, bool]:
    """Executes one order; returns the report, and whether the process can serve another order."""
    started, part = time.monotonic(), Path(f"{task.bundle_path}.part")
    try:
        data = _complete(_build(task.order), task.order.textures)
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.rename(task.bundle_path)
    except LayoutError as error:
        return failure(FailReason.LAYOUT, str(error), seconds=time.monotonic() - started), True
    except FactoryError as error:
        return failure(FailReason.CRASH, str(error), seconds=time.monotonic() - started), True
    except OSError as error:
        reason = FailReason.RELEASED if error.errno in _DISK_FULL else FailReason.CRASH
        return failure(reason, str(error), seconds=time.monotonic() - started), True
    except Exception as error:  # noqa: BLE001 - worker loop: the error is reported and the process exits
        traceback.print_exc()
        return failure(FailReason.CRASH, repr(error), seconds=time.monotonic() - started), False
    finally:
        part.unlink(missing_ok=True)
    sha256, seconds = hashlib.sha256(data).hexdigest(), time.monotonic() - started
    return SimulationReport(kind=SimulationReportKind.SUCCESS, sha256=sha256, size=len(data), seconds=seconds), True


def _build(order: BuildOrder) -> Path:
    rules = None if order.rules is None else _rules_of(order.rules)
    return build_scene(order.family, order.seed, scene_cache(), rules, called=order.layout)


def _complete(package: Path, known: Collection[str]) -> bytes:
    """Returns the package of a layout with the textures that the coordinator does not have."""
    return complete_package(package.read_bytes(), lambda texture: read_texture(package, texture), known)


def _rules_of(text: str) -> RuleBook:
    with tempfile.TemporaryDirectory(prefix="rules-") as folder:
        path = Path(folder) / "rules.yaml"
        path.write_text(text, encoding="utf-8")
        return load_rules(path)


if __name__ == "__main__":
    status = main()
    sys.stderr.flush()
    os._exit(status)  # a normal exit would wait for the thread that reads orders
