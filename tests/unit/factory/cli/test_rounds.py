"""Commands of the rounds of a training."""

from __future__ import annotations

from pathlib import Path

from factory.cli.rounds import steps_of


def test_each_round_corrects_the_latest_policy_and_trains_on_all_corrections() -> None:
    steps = steps_of(Path("data"), Path("out"), 2, ("bc", "--epochs", "5"), ("--episodes", "9"), ("--split", "val_id"))
    lines = [" ".join(step.arguments) for step in steps]
    assert lines == [
        "train bc data --epochs 5 -o out/policy_0",
        "eval data --split val_id --policy round_0=bc:out/policy_0 -o out/evaluation",
        "correct data --policy bc:out/policy_0 --round 1 -o out/corrections_1 --episodes 9",
        "train bc data --correction out/corrections_1 --epochs 5 -o out/policy_1",
        "eval data --split val_id --policy round_0=bc:out/policy_0 --policy round_1=bc:out/policy_1 -o out/evaluation",
        "correct data --policy bc:out/policy_1 --round 2 -o out/corrections_2 --episodes 9",
        "train bc data --correction out/corrections_1 --correction out/corrections_2 --epochs 5 -o out/policy_2",
        "eval data --split val_id --policy round_0=bc:out/policy_0 --policy round_1=bc:out/policy_1 "
        "--policy round_2=bc:out/policy_2 -o out/evaluation",
    ]
    assert [step.title for step in steps[:3]] == ["training 0 of 2", "evaluation 0 of 2", "corrections 1 of 2"]


def test_rounds_without_evaluation_only_train_and_correct() -> None:
    steps = steps_of(Path("data"), Path("out"), 1, ("bc",), (), ())
    assert [step.arguments[0] for step in steps] == ["train", "correct", "train"]
