"""`factory run --extend`: existing episodes keep their bytes, and kills change nothing."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.merge.extend import plan_extension
from factory.runs.plan_changes import PlanChanges
from tests.acceptance.factory_cli import Command, FactoryCli, episodes_in, kill_group, wait_for

pytestmark = pytest.mark.gl


def digests(root: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted((root / "episodes").iterdir())}


@pytest.fixture(scope="module")
def extended(factory: FactoryCli, states: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of `states`, extended from 5 to 8 episodes without interruption; tests only read it."""
    root = Path(shutil.copytree(states, tmp_path_factory.mktemp("extended") / "data"))
    factory("run", "--extend", "--episodes", 8, "--out", root, "--workers", 1)
    return root


def test_an_extension_keeps_numbers_ids_and_bytes(command: Command, states: Path, extended: Path) -> None:
    assert digests(states).items() <= digests(extended).items()
    report = command.json("verify", extended, "--deep")
    assert (report["ok"], report["complete"], report["episodes"]) == (True, True, 8)
    before, after = Dataset(states), Dataset(extended)
    assert after.column("content_digest").to_pylist()[:5] == before.column("content_digest").to_pylist()
    assert after.meta.plan.episodes == 8
    assert [(each.name, each.first, each.extends) for each in after.meta.sources] == [
        ("base", 1, False),
        ("extension-1", 6, True),
    ]
    assert command.json("replay", extended, 7)["identical"]


def test_a_repeated_extension_does_nothing_and_an_ordinary_run_is_refused(command: Command, extended: Path) -> None:
    before = digests(extended)
    done = command("run", "--extend", "--episodes", 8, "--out", extended)
    assert "has all requested episodes; nothing was run" in done.stdout
    refused = command("run", "--out", extended, expect=2).stderr
    assert "was extended to 8 episodes (more: `factory run --extend --episodes N --out" in refused
    changed = command("run", "demo", "--extend", "--episodes", 12, "--out", extended, expect=2).stderr
    assert "  - name: recorded" in changed
    assert digests(extended) == before


def test_a_killed_extension_leaves_the_dataset_as_it_was_and_continues(
    factory: FactoryCli, command: Command, states: Path, extended: Path, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(states, tmp_path / "data"))
    words = ("run", "--extend", "--episodes", 8, "--out", root, "--workers", 1)
    started = factory.start(*words)
    wait_for(lambda: len(episodes_in(root / ".extension")) >= 1)
    kill_group(started)
    assert digests(root) == digests(states)
    assert command.json("verify", root, "--deep")["ok"]
    refused = command("run", "--out", root, expect=2).stderr
    assert f"has an unfinished extension: finish it with `factory run --extend --out {root}`" in refused
    other = command("run", "--extend", "--episodes", 9, "--out", root, expect=2).stderr
    assert "has an unfinished extension by 3 episodes, but 4 were requested" in other
    factory("run", "--extend", "--out", root, "--workers", 1)
    assert Dataset(root).digest == Dataset(extended).digest
    assert not (root / ".extension").exists()
    assert command.json("verify", root, "--deep")["ok"]


@pytest.mark.parametrize("stage", ["episodes", "ledger", "tables"])
def test_an_interruption_while_episodes_are_added_is_continued(
    factory: FactoryCli, command: Command, states: Path, extended: Path, tmp_path: Path, stage: str
) -> None:
    """Repeats the steps of the addition up to a point, as a killed process leaves them."""
    root = Path(shutil.copytree(states, tmp_path / "data"))
    assert plan_extension(None, Site(root, root), PlanChanges(episodes=8)) is not None
    done = factory("run", "--extend", "--episodes", 8, "--out", Path(shutil.copytree(states, tmp_path / "twin")))
    assert "3 episodes added" in done.stdout
    former = root / "dataset_meta.json"
    described = former.read_bytes()
    own = tmp_path / "twin"
    assert Dataset(own).digest == Dataset(extended).digest
    for name in ("metadata.parquet", "attempts.parquet", "README.md", "data") if stage == "tables" else ():
        _replace(own / name, root / name)
    if stage != "episodes":
        (root / ".ledgers").mkdir()
        for path in root.glob("ledger.*"):
            path.rename(root / ".ledgers" / path.name)
    shutil.copyfile(own / "episodes/ep_000006.zip", root / "episodes/ep_000006.zip")
    assert former.read_bytes() == described
    factory("run", "--extend", "--episodes", 8, "--out", root, "--workers", 1)
    assert command.json("verify", root, "--deep")["ok"]
    assert Dataset(root).digest == Dataset(extended).digest


def _replace(source: Path, target: Path) -> None:
    if target.is_dir():
        shutil.rmtree(target)
        shutil.copytree(source, target)
    else:
        shutil.copyfile(source, target)


def test_a_second_extension_continues_the_numbers(
    factory: FactoryCli, command: Command, extended: Path, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(extended, tmp_path / "data"))
    factory("run", "--extend", "--episodes", 9, "--out", root, "--workers", 1)
    meta = Dataset(root).meta
    assert [each.first for each in meta.sources] == [1, 6, 9]
    assert digests(extended).items() <= digests(root).items()
    assert command.json("verify", root, "--deep")["ok"]
