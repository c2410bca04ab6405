"""Checks the workflows in `.github`: they parse, call existing targets, and have few permissions and pinned actions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent
WORKFLOWS = {path.stem: path for path in sorted((ROOT / ".github" / "workflows").iterdir())}
PINNED = re.compile(r"^\s+- uses: [\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+$")
"""An action is named by its commit, because a tag can be moved; the comment names the release."""
TARGETS = set(re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))

every_workflow = pytest.mark.parametrize("name", WORKFLOWS)


def load(name: str) -> dict[str, Any]:
    parsed = yaml.safe_load(WORKFLOWS[name].read_text(encoding="utf-8"))
    return {"on" if key is True else key: value for key, value in parsed.items()}  # YAML 1.1 reads `on` as true


def steps_of(name: str) -> list[dict[str, Any]]:
    return [step for job in load(name)["jobs"].values() for step in job["steps"]]


def targets_of(name: str) -> list[str]:
    said = "\n".join(step.get("run", "") for step in steps_of(name))
    return re.findall(r"^make ([a-z-]+)", said, re.MULTILINE)


def test_the_workflows_run_tests_documents_and_the_release() -> None:
    assert {name: targets_of(name) for name in WORKFLOWS} == {
        "docs": ["docs"],
        "publish": ["release"],
        "tests": ["check", "test", "test-slow"],
    }


@every_workflow
def test_a_workflow_is_complete_and_calls_existing_targets(name: str) -> None:
    workflow = load(name)
    assert workflow["name"] == name
    assert workflow.keys() >= {"on", "permissions", "jobs"}
    assert set(targets_of(name)) <= TARGETS
    for job in workflow["jobs"].values():
        assert job["timeout-minutes"] <= 60
        assert set(job.get("needs", "").split()) <= workflow["jobs"].keys()
        assert job["runs-on"] == "ubuntu-24.04"
    for step in steps_of(name):
        assert ("uses" in step) != ("run" in step)
        if step.get("uses", "").startswith("actions/setup-python@"):
            assert step["with"]["python-version"] == (ROOT / ".python-version").read_text().strip()
        if step.get("uses", "").startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False


@every_workflow
def test_actions_are_pinned_to_commits_and_no_secret_is_used(name: str) -> None:
    text = WORKFLOWS[name].read_text(encoding="utf-8")
    used = [line for line in text.splitlines() if "uses:" in line]
    assert [line for line in used if not PINNED.match(line)] == []
    assert "secrets." not in text
    assert "pull_request_target" not in text


def test_only_the_job_that_publishes_has_more_than_the_permission_to_read() -> None:
    for name in ("tests", "docs"):
        workflow = load(name)
        assert workflow["permissions"] == {"contents": "read"}
        assert all("permissions" not in job for job in workflow["jobs"].values())
    publish = load("publish")
    assert publish["on"] == {"push": {"tags": ["v*"]}}
    assert publish["permissions"] == {}
    assert {name: job["permissions"] for name, job in publish["jobs"].items()} == {
        "build": {"contents": "read"},
        "publish": {"id-token": "write"},
    }


def test_the_publishing_job_uploads_the_tested_files_and_runs_no_other_code() -> None:
    jobs = load("publish")["jobs"]
    assert jobs["publish"]["needs"] == "build"
    assert [step["uses"].partition("@")[0] for step in jobs["publish"]["steps"]] == [
        "actions/download-artifact",
        "pypa/gh-action-pypi-publish",
    ]
    sent, received = (
        next(step["with"] for step in jobs[job]["steps"] if f"actions/{action}-artifact" in step.get("uses", ""))
        for job, action in (("build", "upload"), ("publish", "download"))
    )
    assert (sent["name"], sent["path"]) == (received["name"], received["path"])
