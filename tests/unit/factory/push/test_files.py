"""Selection of files for the Hub."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.push.files import PushFile, batches_of, plan_push, require_repository
from factory.push.hub import require_safe_endpoint
from schemas.errors import UsageError
from tests.builders.dataset import make_dataset


def files(*sizes: int) -> list[PushFile]:
    return [PushFile(Path(f"f{i}"), f"f{i}", size) for i, size in enumerate(sizes)]


def test_batches_hold_every_file_once_in_order_and_keep_the_limits():
    wanted = files(5, 5, 5, 20, 1, 1, 1, 1)
    batches = list(batches_of(wanted, most_files=3, most_bytes=10))
    assert [file for batch in batches for file in batch] == wanted
    assert [len(batch) for batch in batches] == [2, 1, 1, 3, 1]


def test_a_file_above_the_limit_is_in_a_separate_batch():
    assert [len(batch) for batch in batches_of(files(100, 1), most_bytes=10)] == [1, 1]


def test_ledger_quarantine_hidden_and_part_files_are_not_pushed(tmp_path):
    root = tmp_path / "dataset"
    make_dataset(root, 1)
    for name in ("ledger.db", "ledger.db-wal", ".lock", "quarantine/ep_000009.zip", "episodes/x.part", "notes.txt"):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_bytes(b"x")
    (root / "private").mkdir()
    (root / "private/key.json").write_text("{}")
    names = {file.name for file in plan_push(root, "export.json").files}
    assert "episodes/ep_000001.zip" in names
    assert not names & {"ledger.db", "ledger.db-wal", ".lock", "quarantine/ep_000009.zip", "episodes/x.part"}
    assert not {name for name in names if name.startswith("private") or name == "notes.txt"}


def test_symbolic_links_are_not_followed_and_are_named(tmp_path):
    root = tmp_path / "dataset"
    make_dataset(root, 1)
    outside = tmp_path / "secret.json"
    outside.write_text("secret")
    (root / "leak.json").symlink_to(outside)
    (root / "scenes/inside").symlink_to(tmp_path, target_is_directory=True)
    plan = plan_push(root, "export.json")
    assert not {"leak.json", "scenes/inside/secret.json"} & {file.name for file in plan.files}
    assert {remark.split()[0] for remark in plan.remarks} == {"leak.json", "scenes/inside"}


def test_an_incomplete_dataset_gives_a_warning(tmp_path):
    root = tmp_path / "dataset"
    make_dataset(root, 1, planned=3)
    assert any("1 of 3" in remark for remark in plan_push(root, "export.json").remarks)


def test_descriptions_are_pushed_last(tmp_path):
    root = tmp_path / "dataset"
    make_dataset(root, 2)
    names = [file.name for file in plan_push(root, "export.json").files]
    first_description = min(index for index, name in enumerate(names) if "/" not in name)
    assert all("/" not in name for name in names[first_description:])


def test_repositories_have_an_owner_and_a_name():
    assert require_repository("my-lab/office_navigation.v1") == "my-lab/office_navigation.v1"


@pytest.mark.parametrize("name", ["office", "a/b/c", "my lab/x", "../x/y", "a/b--c", "a/..", "/x", "a/", "a/b\n"])
def test_other_names_are_refused(name):
    with pytest.raises(UsageError):
        require_repository(name)


@pytest.mark.parametrize(
    "endpoint", ["https://huggingface.co", "http://127.0.0.1:5000", "http://localhost", "http://[::1]:1"]
)
def test_a_token_is_sent_encrypted_or_over_loopback(endpoint):
    require_safe_endpoint(endpoint)


@pytest.mark.parametrize(
    "endpoint", ["http://hub.example", "http://192.0.2.1", "ftp://localhost", "huggingface.co", "https://"]
)
def test_a_token_is_not_sent_to_other_endpoints(endpoint):
    with pytest.raises(UsageError):
        require_safe_endpoint(endpoint)
