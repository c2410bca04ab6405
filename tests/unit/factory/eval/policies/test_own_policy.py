"""Messages about a missing module, class or package of a policy, before an episode runs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from factory.eval.driving.policy import PrivilegedPolicy, uses_camera
from factory.eval.models.messages import PolicyLimits
from factory.eval.policies.registry import describe_knowledge, make_policy, require_available
from factory.eval.policies.user_class import load_class
from schemas.errors import UsageError

ROOT = Path(__file__).parents[5]
MODULE = """
from pathlib import Path
class _Base: pass
class Pilot(_Base): pass
class Driver(_Base): pass
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory; its modules are unloaded at the end."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    return tmp_path


def test_a_missing_module_is_reported_with_the_search_path(folder: Path) -> None:
    said = f"no module 'nowhere_pilot'; looked in {folder}, on PYTHONPATH .*docs/evaluation/my_policy.py is an example"
    for check in (require_available, load_class):
        with pytest.raises(UsageError, match=said) as caught:
            check("nowhere_pilot:Policy")
        assert "frozen" not in str(caught.value)


def test_a_missing_class_is_reported_with_the_classes_of_the_module(folder: Path) -> None:
    (folder / "own_pilots.py").write_text(MODULE)
    with pytest.raises(UsageError, match=r"no class 'pilot'; .*own_pilots.py has Pilot, Driver; did you mean 'Pilot'"):
        load_class("own_pilots:pilot")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import nowhere_torch", r"cannot be created: ModuleNotFoundError: .*'nowhere_torch' \(broken_pilot.py:1\)"),
        ("class Policy:\n  def act(self) return 1\n", r"cannot be created: SyntaxError: .*\(broken_pilot.py:2\)"),
    ],
)
def test_an_import_error_names_the_line_of_the_module(folder: Path, text: str, said: str) -> None:
    (folder / "broken_pilot.py").write_text(text)
    require_available("broken_pilot:Policy")
    with pytest.raises(UsageError, match=said):
        load_class("broken_pilot:Policy")


def test_a_module_of_the_working_directory_is_found_without_importing_it(folder: Path) -> None:
    (folder / "loud_pilot.py").write_text("raise SystemExit('imported')")
    require_available("loud_pilot:Policy")


def test_every_page_names_an_existing_class_of_the_example(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT / "docs" / "evaluation")
    pages = [ROOT / "README.md", ROOT / "docs" / "evaluation" / "README.md", Path("my_policy.py")]
    named = {name for page in pages for name in re.findall(r"my_policy:\w+", page.read_text())}
    assert named
    for name in named:
        make_policy(name, PolicyLimits())


PRIVILEGED = """
from factory.eval.policies.simple import ExpertPolicy
class Oracle(ExpertPolicy):
    def __init__(self): super().__init__("planner")
"""
NAMES = """
class Pilot:
    knows, looks, privileged = "goal", False, True
    def enter(self, state): self.state = state
    def reset(self, instruction, info): pass
    def act(self, observation): return 0.0, 0.0
"""


def test_a_users_class_cannot_declare_itself_privileged(folder: Path) -> None:
    (folder / "oracle_pilot.py").write_text(PRIVILEGED)
    with pytest.raises(UsageError, match="oracle_pilot:Oracle derives from PrivilegedPolicy"):
        make_policy("oracle_pilot:Oracle", PolicyLimits())


def test_attributes_of_a_users_class_do_not_change_its_declared_inputs(folder: Path) -> None:
    (folder / "named_pilot.py").write_text(NAMES)
    policy = make_policy("named_pilot:Pilot", PolicyLimits())
    assert uses_camera(policy)
    assert not isinstance(policy, PrivilegedPolicy)
    assert describe_knowledge(policy) == "camera, instruction and odometry"


@pytest.mark.parametrize(
    ("name", "is_privileged", "knows"),
    [
        ("stop", False, "nothing"),
        ("random", False, "nothing"),
        ("expert", True, "goal, map and instance ids"),
        ("planner", True, "goal, map and instance ids"),
        ("replay", True, "the episode's recorded actions"),
        ("playback", True, "another episode's recorded actions"),
    ],
)
def test_built_in_policies_declare_their_inputs(name: str, is_privileged: bool, knows: str) -> None:
    policy = make_policy(name, PolicyLimits())
    assert isinstance(policy, PrivilegedPolicy) == is_privileged
    assert not uses_camera(policy)
    assert describe_knowledge(policy) == knows
