"""Compares the table of contents and losses with the exports of every format, and with the documents."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import factory.export.lerobot.common as lerobot
from factory.dataset.episode import Episode
from factory.export.content import CONTENT, FACTS, content_markdown, contradictions, losses_of
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.registry import EXPORTERS, find_exporter
from schemas.language.question.meaning import AnswerKind, Question, QuestionKind, QuestionMeaning
from schemas.language.route.meaning import RouteStep, SubInstruction
from schemas.terms import Recording
from tests.builders.export_content import names_in

pytestmark = pytest.mark.gl
PAGE = Path(__file__).parents[2] / "docs" / "formats" / "README.md"
BEGIN, END = "<!-- content: begin -->\n", "<!-- content: end -->\n"
SLOW: dict[str, Any] = {"fps": 2}
OPTIONS: dict[str, dict[str, Any]] = {
    "lerobot": SLOW | {"depth": True, "ids": True},
    "mcap --ros2": SLOW | {"ros2": True},
    **dict.fromkeys(("lerobot-v2.1", "webdataset", "mcap", "gnm", "coco", "navdp", "rlds", "robomimic"), SLOW),
}
STEP = SubInstruction(number=1, text="Turn left.", step=RouteStep(kind="forward", metres=1), start=0, end=30)
QUESTION = Question(
    question="What next?",
    answer="Stop.",
    reason=None,
    language="en",
    template_id="en_next_001",
    held_out=False,
    start=0,
    end=30,
    meaning=QuestionMeaning(kind=QuestionKind.NEXT, answer=AnswerKind.STOP),
)


@pytest.fixture
def dataset(recordings: dict[Recording, Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """A dataset whose episodes also have a sub-instruction and a question."""
    monkeypatch.setattr(Episode, "steps", property(lambda _: (STEP,)))
    monkeypatch.setattr(Episode, "questions", property(lambda _: (QUESTION,)))
    monkeypatch.setattr(lerobot, "has_routes", lambda _root: True)
    monkeypatch.setattr(lerobot, "has_questions", lambda _root, _meta: True)
    return recordings[Recording.FRAMES]


def test_the_table_has_every_format() -> None:
    assert {name.partition(" ")[0] for name in CONTENT} == EXPORTERS.keys()
    assert {fact for kept in CONTENT.values() for fact in kept} <= FACTS.keys()
    assert [name for name in CONTENT if not losses_of(name)] == []


@pytest.mark.parametrize("name", sorted(CONTENT))
def test_an_export_contains_what_the_table_states_and_nothing_that_it_states_as_lost(
    dataset: Path, tmp_path: Path, name: str
) -> None:
    export = name.partition(" ")[0]
    options = find_exporter(export).options.model_validate(OPTIONS.get(name, {}))
    order = ExportOrder(dataset, tmp_path / "out", export, options, episodes=("ep_000001",))
    assert run_export(order).complete
    found = frozenset(names_in(tmp_path / "out"))
    assert contradictions(name, found) == []
    kept = next(iter(CONTENT[name].values()))
    assert contradictions(name, found - {each for each in found if each.partition(":")[2] in kept.place}) != []


def test_a_wrong_table_is_noticed() -> None:
    found = frozenset({"key:target_footprint_m", "member:rgb.png"})
    lines = contradictions("webdataset", found)
    assert "webdataset contains key:target_footprint_m, but the table states as lost: footprint of the target" in lines
    assert "webdataset has no member:depth.npy.gz, the place of: depth images" in lines


def test_the_documents_have_the_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    shown = text.partition(BEGIN)[2].partition(END)[0]
    assert shown == content_markdown(), "replace the table by the output of factory.export.content.content_markdown()"
