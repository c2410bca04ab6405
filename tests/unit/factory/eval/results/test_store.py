"""The evaluation directory: durable rows, recovery of a torn tail, refusal of other specs."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.eval.models.result import RESULTS_FORMAT, Variant
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.store import EvalManifest, Store, folder_name, read_policy_folder
from schemas.errors import UsageError, WorldError
from tests.builders.eval_results import result_of, spec_of, specs_of

SET = specs_of(*(spec_of(n) for n in range(1, 4)))
MANIFEST = EvalManifest(run="test-00000000", specs_digest=SET.digest, with_pose=False, act_timeout_s=10.0)


def store_in(root: Path, manifest: EvalManifest = MANIFEST) -> Store:
    return Store(root, SET, manifest)


def log_of(root: Path) -> Path:
    return root / "policies" / "expert" / "episodes.jsonl"


def test_rows_are_read_back_in_spec_order_by_variant(tmp_path: Path) -> None:
    with store_in(tmp_path / "out") as store:
        for number in (3, 1):
            store.add(result_of(number))
        store.add(result_of(2, variant=Variant.EMPTY))
    with store_in(tmp_path / "out") as store:
        rows = store.results("expert")
    assert [(row.spec_id, row.variant) for row in rows] == [
        ("ep_000001", "original"),
        ("ep_000003", "original"),
        ("ep_000002", "empty"),
    ]


def test_a_torn_last_row_is_cut_off_and_the_next_one_is_whole(tmp_path: Path) -> None:
    with store_in(tmp_path) as store:
        store.add(result_of(1))
    with log_of(tmp_path).open("ab") as log:
        log.write(result_of(2).model_dump_json().encode()[:100])
    with store_in(tmp_path) as store:
        assert len(store.results("expert")) == 1
        store.add(result_of(3))
        assert [row.spec_id for row in store.results("expert")] == ["ep_000001", "ep_000003"]


def test_a_damaged_row_is_named(tmp_path: Path) -> None:
    with store_in(tmp_path) as store:
        store.add(result_of(1))
    log_of(tmp_path).write_bytes(b"{}\n" + log_of(tmp_path).read_bytes())
    with store_in(tmp_path) as store, pytest.raises(WorldError, match=r"episodes.jsonl is damaged in line 1"):
        store.results("expert")


def test_a_directory_with_other_specs_is_refused(tmp_path: Path) -> None:
    with store_in(tmp_path) as store:
        store.add(result_of(1))
    with pytest.raises(UsageError, match=r"another evaluation .*with_pose False, now True"):
        store_in(tmp_path, MANIFEST.model_copy(update={"with_pose": True}))
    with pytest.raises(UsageError, match=r"specs_digest [0-9a-f]{12}\.\.\., now 000000000000\.\.\."):
        store_in(tmp_path, MANIFEST.model_copy(update={"specs_digest": "0" * 64}))


def test_a_directory_without_results_accepts_other_specs(tmp_path: Path) -> None:
    asked = MANIFEST.model_copy(update={"with_pose": True})
    store_in(tmp_path)
    with store_in(tmp_path, asked) as store:
        store.add(result_of(1))
    with pytest.raises(UsageError, match="another evaluation"):
        store_in(tmp_path)


def test_a_directory_with_claimed_jobs_keeps_its_specs(tmp_path: Path) -> None:
    store_in(tmp_path)
    (tmp_path / "ledger.db").touch()
    with pytest.raises(UsageError, match="another evaluation"):
        store_in(tmp_path, MANIFEST.model_copy(update={"with_pose": True}))


def test_an_unrelated_directory_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(UsageError, match="not empty"):
        store_in(tmp_path)


def test_the_error_of_a_newer_format_names_its_number(tmp_path: Path) -> None:
    store_in(tmp_path)
    path = tmp_path / "evaluation.json"
    path.write_text(path.read_text().replace(f'"format": {RESULTS_FORMAT}', f'"format": {RESULTS_FORMAT + 1}'))
    with pytest.raises(WorldError, match=f"format {RESULTS_FORMAT + 1}.*upgrade"):
        store_in(tmp_path)


def test_a_file_instead_of_the_directory_is_reported(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(WorldError, match="cannot write"):
        store_in(tmp_path / "out")


@pytest.mark.parametrize("policy", ["my.module:Class", "ws://127.0.0.1:8000", "expert:depth", "../../x", "Expert"])
def test_the_folder_of_a_policy_has_a_unique_plain_name(policy: str) -> None:
    name = folder_name(policy)
    assert name == Path(name).name
    assert name not in {"", ".", "..", "expert"}


def test_a_comparison_uses_the_only_policy_or_requires_a_name(tmp_path: Path) -> None:
    with store_in(tmp_path) as store:
        store.add(result_of(1))
        assert read_policy_folder(tmp_path)[0] == "expert"
        store.add(result_of(1, policy="stop"))
        store.add(result_of(1, policy="bc:out"))
    with pytest.raises(UsageError, match="contains 3 policies; give the folder of one"):
        read_policy_folder(tmp_path)
    assert read_policy_folder(tmp_path / "policies" / "stop")[0] == "stop"
    assert read_policy_folder(tmp_path / "policies" / "bc:out")[0] == "bc:out"
    with pytest.raises(UsageError, match="no results"):
        read_policy_folder(tmp_path / "policies" / "random")


def test_a_note_of_a_policy_is_read_back(tmp_path: Path) -> None:
    note = PolicyNote(policy="stop", knows="nothing", reads_instruction=False, renderer="x", software={"a": "1"})
    with store_in(tmp_path) as store:
        assert store.note_of("stop") is None
        store.note(note)
        assert store.note_of("stop") == note


def test_a_second_evaluation_of_the_same_folder_is_refused(tmp_path: Path) -> None:
    with store_in(tmp_path), pytest.raises(WorldError, match="is in use by another evaluation: wait for its end"):
        store_in(tmp_path)
    store_in(tmp_path).close()
