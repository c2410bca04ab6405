"""Hashes of policies: modules beside a class, named files, server greetings, and the refusal of mixed results."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from factory.eval.models.messages import PolicyLimits
from factory.eval.policies.made_from import another_policy, changes, describe, hashes_now, hashes_of
from factory.eval.policies.registry import PolicyNote, make_policy
from factory.eval.policies.user_class import source_folder
from schemas.errors import UsageError
from tests.builders.eval_results import result_of
from tests.unit.factory.eval.results.test_store import store_in

QUICK = PolicyLimits(act_timeout_s=0.5, load_timeout_s=2.0, reconnect_s=0.3)
POLICY = """
from beside_module import SPEED
class Mine:
    files = {files!r}
    def reset(self, instruction, info): ...
    def act(self, observation): return SPEED, 0.0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "mine_module.py").write_text(POLICY.format(files=("weights.bin",)))
    (tmp_path / "beside_module.py").write_text("SPEED = 0.5\n")
    (tmp_path / "unrelated.py").write_text("")
    (tmp_path / "weights.bin").write_bytes(b"1")
    monkeypatch.chdir(tmp_path)
    path = list(sys.path)
    yield tmp_path
    sys.path[:] = path
    for name in ("mine_module", "beside_module"):
        sys.modules.pop(name, None)


def made(name: str) -> dict[str, str]:
    return hashes_of(name, make_policy(name, QUICK), None)


def test_a_class_is_its_module_those_it_imports_from_beside_it_and_its_files(folder: Path) -> None:
    hashes = made("mine_module:Mine")
    assert list(hashes) == ["beside_module.py", "mine_module.py", "weights.bin"]
    assert describe(hashes).startswith("3 files ")
    assert hashes_now(hashes, source_folder("mine_module:Mine")) == hashes
    (folder / "beside_module.py").write_text("SPEED = 0.9\n")
    now = hashes_now(hashes, folder)
    assert [text.partition(":")[0] for text in changes(hashes, now)] == ["beside_module.py"]
    (folder / "weights.bin").unlink()
    assert any(
        text.startswith("weights.bin: ") and "now absent" in text
        for text in changes(hashes, hashes_now(hashes, folder))
    )
    with pytest.raises(UsageError, match=r"names the file weights.bin, which does not exist"):
        made("mine_module:Mine")


def test_results_of_another_policy_are_refused_with_both_hashes_and_the_remedy(folder: Path) -> None:
    former = made("mine_module:Mine")
    assert another_policy("m:P", former, former, folder) is None
    assert another_policy("m:P", {}, former, folder) is None, "older results have no hashes"
    error = another_policy("m:P", former, {**former, "mine_module.py": "f" * 64}, folder)
    assert error is not None
    for part in (former["mine_module.py"][:12], "f" * 12, "--restart", "mine_module.py"):
        assert part in str(error)


def test_restarting_keeps_the_former_results_beside_the_new_ones(tmp_path: Path) -> None:
    with store_in(tmp_path / "out") as store:
        assert store.set_aside("m:P") is None
        store.note(
            PolicyNote(policy="m:P", knows="", reads_instruction=True, renderer="", software={}, made_from={"a": "1"})
        )
        store.add(result_of(1, policy="m:P"))
        former = store.set_aside("m:P")
        assert former is not None
        assert former.parent == tmp_path / "out/former"
        assert (former / "policy.json").exists()
        assert store.note_of("m:P") is None
        assert store.results("m:P") == []


@pytest.mark.parametrize("name", ["random", "stop", "expert"])
def test_a_built_in_policy_with_the_name_of_a_module_has_no_hashes(name: str) -> None:
    assert made(name) == {}
