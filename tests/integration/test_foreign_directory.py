"""Commands in a folder with files named like modules of the product and its libraries: no such file is executed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from coordinator.validation.validator import Validator
from tests.builders.bundle import bundle_bytes, job_for
from tests.builders.dataset import chair, make_dataset
from workers.client.settings import WorkerSettings
from workers.process.messages import SimulationReportKind
from workers.process.simulation import Simulation

MODULES = (
    *("isal", "numpy", "zstandard", "xxhash", "pydantic", "click", "zenoh", "pybullet", "pyarrow", "structlog"),
    *("random", "socket", "tempfile", "pickle", "multiprocessing", "concurrent", "subprocess"),
)
PACKAGES = ("coordinator", "workers", "schemas")
TRAP = """
import os
open(os.path.join({folder!r}, "executed-" + __name__), "w").close()
raise ImportError("a file of the working directory was imported: " + __name__)
"""


@pytest.fixture
def traps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Working directory with such files; checks at the end that none of them was executed."""
    folder = tmp_path / "dataset"
    make_dataset(folder, 2)
    text = TRAP.format(folder=str(tmp_path))
    for name in MODULES:
        (folder / f"{name}.py").write_text(text)
    for name in PACKAGES:
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(text)
    monkeypatch.chdir(folder)
    yield folder
    assert sorted(path.name for path in tmp_path.glob("executed-*")) == []


def factory(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "factory", *words]
    return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, timeout=240)


def test_a_validator_started_in_a_foreign_directory_imports_only_product_modules(traps: Path, tmp_path: Path) -> None:
    bundle = tmp_path / "x.part"
    bundle.write_bytes(bundle_bytes())
    with Validator() as validator:
        assert validator.check(bundle, job_for(), (chair(),)).episode_id == "ep_000001"


def test_a_simulation_started_in_a_foreign_directory_imports_only_product_modules(traps: Path) -> None:
    simulation = Simulation(WorkerSettings(connect=(), renderer="tiny").simulation_command, 60.0)
    simulation.start()
    report = simulation.receive(60.0)
    simulation.kill()
    assert getattr(report, "kind", report) is SimulationReportKind.READY


@pytest.mark.parametrize("path", ["", ":", ".:"])
def test_a_command_in_a_foreign_directory_imports_product_modules_with_any_pythonpath(traps: Path, path: str) -> None:
    done = factory("verify", ".", PYTHONPATH=path + os.environ.get("PYTHONPATH", ""))
    assert "2 episodes" in done.stdout, done.stderr


def test_a_deep_verification_in_several_processes_imports_only_product_modules(traps: Path) -> None:
    done = factory("verify", ".", "--deep", "--workers", "2")
    assert "2 episodes" in done.stdout, done.stderr


def test_a_policy_of_the_working_directory_does_not_replace_product_modules(traps: Path) -> None:
    (traps / "own_pilot.py").write_text(
        "import own_helper\nclass Pilot:\n  def reset(self, instruction, info): import own_later\n"
        "  def act(self, observation): return own_helper.V, 0.0\n"
    )
    (traps / "own_helper.py").write_text("V = 0.5")
    (traps / "own_later.py").write_text("")
    code = (
        "from factory.eval.policies.user_class import load_class\n"
        "pilot = load_class('own_pilot:Pilot'); pilot.reset('', None)\n"
        "import isal, zstandard\nprint(pilot.act({}), isal.__file__)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith("(0.5, 0.0)"), done.stderr
    assert str(traps) not in done.stdout
