"""`factory push` from the command line against a Hub on loopback, with the real client library over HTTP."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.acceptance.factory_cli import FactoryCli
from tests.builders.dataset import make_dataset
from tests.builders.fake_hub import TOKEN, FakeHub

REPOSITORY = "my-lab/office-navigation"
Push = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def hub() -> Iterator[FakeHub]:
    with FakeHub() as fake:
        yield fake


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("push") / "dataset"
    make_dataset(root, 2)
    (root / "ledger.db").write_bytes(b"names of hosts")
    return root


@pytest.fixture
def push(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Push:
    """Returns a function that runs `factory push` with a token; `token=None` runs it without a token.

    It starts a process, because `huggingface_hub` reads the variables of its cache and of Xet at its import only.
    """
    for name in os.environ:
        if name.startswith(("HF_", "HUGGING")):
            monkeypatch.delenv(name)

    def run(*words: object, token: str | None = TOKEN) -> subprocess.CompletedProcess[str]:
        variables = {"HF_HOME": str(tmp_path / "hf"), "HF_HUB_DISABLE_XET": "1"}
        variables |= {} if token is None else {"HF_TOKEN": token}
        return FactoryCli(tmp_path, tmp_path / "cache", variables).run("push", *words)

    return run


def test_push_uploads_every_file_of_a_dataset_and_no_private_file(push, hub, dataset):
    done = push(dataset, REPOSITORY, "--endpoint", hub.url, "--private", "--json")
    assert done.returncode == 0, done.stderr
    repository = hub.repositories[REPOSITORY]
    assert repository.private
    expected = {
        path.relative_to(dataset).as_posix(): path.read_bytes()
        for path in dataset.rglob("*")
        if path.is_file() and not path.name.startswith(".") and path.name != "ledger.db"
    }
    assert repository.files == expected
    assert {"README.md", "metadata.parquet", "dataset_meta.json", "episodes/ep_000001.zip"} <= expected.keys()
    result = json.loads(done.stdout)
    assert (result["files"], result["total_bytes"]) == (len(expected), sum(map(len, expected.values())))
    assert repository.tags == {}


def test_a_repeated_push_uploads_no_large_file_twice(push, hub, dataset):
    assert push(dataset, REPOSITORY, "--endpoint", hub.url).returncode == 0
    sent = len(hub.uploads)
    assert push(dataset, REPOSITORY, "--endpoint", hub.url).returncode == 0
    assert len(hub.uploads) == sent > 0


def test_push_resumes_after_a_failure_of_the_hub(push, hub, dataset):
    hub.fail_at_commit = 1
    failed = push(dataset, REPOSITORY, "--endpoint", hub.url)
    assert failed.returncode == 1
    assert "run the same command again" in failed.stderr
    assert push(dataset, REPOSITORY, "--endpoint", hub.url).returncode == 0
    assert "episodes/ep_000002.zip" in hub.repositories[REPOSITORY].files


def test_push_tags_a_lerobot_export_and_moves_an_old_tag(push, hub, tmp_path):
    export = tmp_path / "export"
    (export / "meta").mkdir(parents=True)
    (export / "export.json").write_text("{}")
    (export / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0"}))
    for expected in (1, 2):
        done = push(export, REPOSITORY, "--endpoint", hub.url)
        assert done.returncode == 0, done.stderr
        assert "tagged v3.0" in done.stdout
        assert hub.repositories[REPOSITORY].tags == {"v3.0": expected}


def test_a_dry_run_shows_the_size_without_a_request(push, hub, dataset):
    done = push(dataset, REPOSITORY, "--endpoint", hub.url, "--dry-run", "--json", token=None)
    assert done.returncode == 0, done.stderr
    plan = json.loads(done.stdout)
    assert plan["folders"]["episodes"]["files"] == 2
    assert plan["total_bytes"] > 0
    assert hub.requests == []


def test_push_without_a_token_explains_how_to_get_one(push, hub, dataset):
    done = push(dataset, REPOSITORY, "--endpoint", hub.url, token=None)
    assert done.returncode == 1
    assert "hf auth login" in done.stderr
    assert hub.requests == []


@pytest.mark.parametrize(("token", "repository"), [("hf_wrong" + "x" * 20, REPOSITORY), (TOKEN, "another-user/data")])
def test_a_refused_token_is_explained_and_never_shown(push, hub, dataset, token, repository):
    done = push(dataset, repository, "--endpoint", hub.url, token=token)
    assert done.returncode == 1
    assert "write access" in done.stderr
    assert token not in done.stderr + done.stdout + " ".join(hub.requests)
    assert not hub.repositories


def test_a_token_is_not_sent_unencrypted_to_another_machine(push, dataset):
    done = push(dataset, REPOSITORY, "--endpoint", "http://192.0.2.1:80")
    assert done.returncode == 2
    assert "https://" in done.stderr


def test_a_wrong_repository_name_is_a_usage_error(push, dataset):
    done = push(dataset, "office", "--dry-run")
    assert done.returncode == 2
    assert "OWNER/NAME" in done.stderr


def test_a_folder_that_is_neither_dataset_nor_export_is_refused(push, tmp_path):
    (tmp_path / "secrets.txt").write_text("secret")
    done = push(tmp_path, REPOSITORY, "--dry-run")
    assert done.returncode == 2
    assert "neither" in done.stderr
