"""Size and time of a run before it starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.plan_file import shrink
from factory.runs import estimate
from factory.runs.estimate import describe_estimate, estimate_run, require_disk
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.terms import Recording

PAPER = BUILTIN_PLANS["paper"]


def test_the_estimate_of_the_paper_plan_has_its_measured_size() -> None:
    expected = estimate_run(PAPER)
    assert expected.episodes == 1174
    assert expected.bytes["frames"] / 1174 == pytest.approx(130e6, rel=0.1)  # docs/performance.md
    assert 10_000 <= expected.bytes["states"] / 1174 <= 30_000
    first, second = describe_estimate(PAPER, expected)
    assert first.startswith("record = frames: about 15")
    assert second.startswith("  --record states: about 2")


def test_layouts_count_in_size_and_time() -> None:
    scenes = [{"name": "home", "layouts": 100, "episodes": 100}]
    homes = Plan.model_validate({"name": "x", "record": "states", "splits": {"train_id": 1}, "scenes": scenes})
    one = Plan.model_validate(homes.model_dump(mode="json") | {"scenes": [{"name": "home", "episodes": 100}]})
    assert estimate_run(homes).bytes["states"] - estimate_run(one).bytes["states"] > 50e6
    assert estimate_run(homes).core_hours["states"] > estimate_run(one).core_hours["states"]


def test_a_disk_that_is_too_small_is_refused_with_what_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimate, "free_bytes", lambda _: 41 * 10**9)
    with pytest.raises(
        WorldError, match=r"41[.]0 GB free, .* about 15[0-9.]+ GB: use `--record states`.* or `--episodes 2\d\d`"
    ):
        require_disk(PAPER, tmp_path / "new folder")
    require_disk(shrink(PAPER, record=Recording.STATES), tmp_path)
    require_disk(shrink(PAPER, episodes=250), tmp_path)
    require_disk(PAPER, tmp_path, archived=900)
