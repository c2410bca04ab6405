"""Mistakes in the arguments of `factory eval`: an error names each of them before an episode runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.cli.main import cli
from schemas.errors import UsageError, WorldError
from tests.builders.dataset import make_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "dataset"
    make_dataset(root)
    return root


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--policy is missing"),
        (("--listen", "tcp/127.0.0.1:0"), "require -o DIR"),
        (("--listen", "tcp/127.0.0.1:0", "-o", "out", "--workers", "2"), "start `factory worker` on each host"),
        (("--tls", "pki"), "give one of them, or remove --tls"),
        (("--connect", "tcp/127.0.0.1:1"), "require -o DIR"),
        (("--connect", "tcp/10.0.0.1:1", "-o", "out"), "only loopback"),
        (("--connect", "tcp/127.0.0.1:1", "--tls", "pki", "-o", "out"), "write tls/127.0.0.1:1"),
        (("--connect", "tls/h:1", "--tls", "/nowhere", "-o", "out"), "lacks ca.pem"),
        (
            ("--connect", "tls/h:1", "--listen", "tls/h:2", "--tls", "pki", "-o", "out"),
            "a certificate has one role: give one of them",
        ),
        (("--policy", "oracle"), "unknown policy 'oracle'; built-in policies: expert"),
        (("--policy", "expert:best"), "unknown expert 'best'; valid experts: "),
        (("--policy", "expert:plannr"), "unknown expert 'plannr'; .*; did you mean 'planner'"),
        (("--policy", "nowhere_pilot:Policy"), "no module 'nowhere_pilot'; looked in"),
        (("--policy", "random=expert"), "random is a built-in policy; choose another name for expert"),
        (
            ("--policy", "a=stop", "--policy", "a=random"),
            "is given for stop and for random; choose two names",
        ),
        (("--policy", "a=exprt"), "unknown policy 'exprt'; .*; did you mean 'expert'"),
        (("--policy", "stop", "--restart"), "--restart requires -o DIR"),
        (("--policy", "exprt"), "unknown policy 'exprt'; .*; did you mean 'expert'"),
        (("--policy", "stop"), "has no episodes in test splits; evaluate on its other splits with --split all"),
        (("--policy", "stop", "--split", "val_id"), "no episodes in val_id; splits with episodes: train_id"),
        (("--policy", "stop", "--specs", "/nowhere.json"), "factory eval specs"),
    ],
)
def test_mistakes_are_named(dataset: Path, words: tuple[str, ...], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        cli.main(["eval", str(dataset), *words], standalone_mode=False)


def test_an_unknown_split_is_a_usage_error(dataset: Path) -> None:
    import click

    with pytest.raises(click.UsageError, match="unknown split 'test'; valid values: train_id"):
        cli.main(["eval", str(dataset), "--policy", "stop", "--split", "test"], standalone_mode=False)


def test_a_directory_that_is_not_a_dataset_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="is not a dataset"):
        cli.main(["eval", str(tmp_path), "--policy", "stop"], standalone_mode=False)


def test_replay_refuses_newly_drawn_episodes() -> None:
    from factory.eval.specs.campaign import require_recordings
    from tests.builders.eval_results import spec_of, specs_of

    drawn = specs_of(spec_of(1, source_episode=None, spawn_source="drawn"))
    with pytest.raises(UsageError, match="newly sampled"):
        require_recordings("replay", drawn)
