"""`factory train rounds`: trains a policy, records corrections, and trains again: commands one after the other."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import click

from factory.cli.options import (
    count_option,
    dataset_argument,
    input_size_option,
    json_option,
    workers_option,
    write_option,
)
from schemas.errors import UsageError, WorldError
from schemas.support.child import child_environment, python_module
from schemas.support.shell import quoted
from schemas.terms import Split

_STOPPED = 130


class RoundStep(NamedTuple):
    """One command of the rounds."""

    title: str
    arguments: tuple[str, ...]
    """Arguments of `factory`."""


@click.command("rounds")
@dataset_argument
@write_option("DIR", "Output directory. The same command continues the rounds.", required=True)
@click.option(
    "--train",
    "trainer",
    type=click.Choice(["bc", "policy"]),
    default="bc",
    show_default=True,
    help="Training of each round: `factory train bc` or `factory train policy`.",
)
@count_option("--rounds", 3, "Number of rounds of corrections.", most=100)
@count_option("--episodes", None, "Episodes of each round. Default: half of the training episodes of DIR.")
@count_option("--epochs", 30, "Number of epochs of each training.", most=10_000)
@input_size_option
@count_option(
    "--antialias", None, "Samples per pixel of rendered frames, along each axis. Default: 640 / SIZE.", most=10
)
@count_option("--seed", 0, "Random seed of each training.", least=0, most=2**32 - 1)
@click.option(
    "--split",
    type=click.Choice([str(split) for split in Split]),
    metavar="SPLIT",
    default=str(Split.VAL_ID),
    show_default=True,
    help="Split on which the policy of each round is evaluated.",
)
@count_option("--evaluations", 100, "Number of evaluation episodes of each policy; 0 evaluates none.", least=0)
@workers_option("Number of simulation processes")
@json_option
def rounds(
    root: Path,
    out: Path,
    trainer: str,
    rounds: int,
    episodes: int | None,
    epochs: int,
    size: str,
    antialias: int | None,
    seed: int,
    split: str,
    evaluations: int,
    workers: int | None,
    as_json: bool,
) -> int:
    """Train a policy in rounds: train, correct, train on both, and so on.

    OUT gets policy_0 (demonstrations only), corrections_1, policy_1, and so on, and `evaluation` with all policies.
    Each step is a command of `factory`, which is printed; the same command continues after an interruption.
    OUT/index.html has the success rate and the failures by round.

    \b
    Then:  open OUT/index.html
    """
    from factory.support.terminal import print_result

    processes = () if workers is None else ("--workers", str(workers))
    training: tuple[str, ...] = (trainer, "--epochs", str(epochs), "--size", size, "--seed", str(seed))
    training += () if antialias is None else ("--antialias", str(antialias))
    correcting = processes if episodes is None else ("--episodes", str(episodes), *processes)
    evaluating = () if not evaluations else ("--split", split, "--episodes", str(evaluations), *processes)
    for step in steps_of(root, out, rounds, training=training, correcting=correcting, evaluating=evaluating):
        click.echo(f"\n{step.title}: factory {' '.join(map(quoted, step.arguments))}", err=True)
        status = _run(step.arguments, as_json)
        if status == _STOPPED:
            click.echo(f"interrupted; the same command continues with {step.title}", err=True)
            return _STOPPED
        if status == 2:
            raise UsageError(f"{step.title} was refused; the message is above")
        # a round with missing episodes is as useful as its number of episodes
        if status and not (status == 1 and step.arguments[0] == "correct"):
            raise WorldError(f"{step.title} ended with exit status {status}; the message is above")
    if evaluating:
        _write_page(out, rounds)
    result = {
        "policies": [str(out / f"policy_{number}") for number in range(rounds + 1)],
        "corrections": [str(out / f"corrections_{number}") for number in range(1, rounds + 1)],
        "page": str(out / "index.html") if evaluating else None,
    }
    print_result(result, as_json, lambda it: click.echo(f"page:    {it['page']}") if it["page"] else None)
    return 0


def steps_of(
    root: Path,
    out: Path,
    rounds: int,
    training: tuple[str, ...],
    correcting: tuple[str, ...],
    evaluating: tuple[str, ...],
) -> list[RoundStep]:
    """Returns the commands of all rounds, in order.

    Args:
        root: dataset of demonstrations.
        out: output directory.
        rounds: number of rounds of corrections.
        training: command of each training, `bc` or `policy`, and its options.
        correcting: options of each round of corrections.
        evaluating: options of each evaluation; empty for none.
    """
    steps: list[RoundStep] = []
    corrections: tuple[str, ...] = ()
    policies: tuple[str, ...] = ()
    for number in range(rounds + 1):
        if number:
            place = str(out / f"corrections_{number}")
            former = f"bc:{out / f'policy_{number - 1}'}"
            options = ("--policy", former, "--round", str(number), "-o", place, *correcting)
            steps.append(RoundStep(f"corrections {number} of {rounds}", ("correct", str(root), *options)))
            corrections += ("--correction", place)
        policy = out / f"policy_{number}"
        trainer, *options_of_training = training
        arguments = ("train", trainer, str(root), *corrections, *options_of_training, "-o", str(policy))
        steps.append(RoundStep(f"training {number} of {rounds}", arguments))
        policies += ("--policy", f"round_{number}=bc:{policy}")
        if evaluating:
            arguments = ("eval", str(root), *evaluating, *policies, "-o", str(out / "evaluation"))
            steps.append(RoundStep(f"evaluation {number} of {rounds}", arguments))
    return steps


def _write_page(out: Path, rounds: int) -> None:
    """Writes the page of all rounds from the results of their evaluation."""
    from factory.eval.results.publish import RESULTS_FILE
    from factory.eval.results.rounds_page import write_rounds_page
    from factory.eval.results.score import Evaluation
    from schemas.storage.disk import replacing

    results = out / "evaluation" / RESULTS_FILE
    evaluation = Evaluation.model_validate_json(results.read_bytes())
    links = [("evaluation of all rounds", "evaluation/index.html")]
    links += [(f"training of round {number}", f"policy_{number}/index.html") for number in range(rounds + 1)]
    page = write_rounds_page(f"{out.resolve().name}: training in rounds", evaluation, links)
    with replacing(out / "index.html") as part:
        part.write_text(page, encoding="utf-8")


def _run(arguments: tuple[str, ...], as_json: bool) -> int:
    """Runs a command and returns its exit status; a signal to this process ends the command first.

    Args:
        arguments: arguments of `factory`.
        as_json: whether its output goes to stderr, because stdout gets JSON.
    """
    out = sys.stderr if as_json else None
    command, environment = python_module("factory", *arguments), child_environment(os.environ)
    with subprocess.Popen(command, env=environment, stdout=out) as process:
        former = {number: signal.signal(number, lambda *_: None) for number in (signal.SIGINT, signal.SIGTERM)}
        signal.signal(signal.SIGTERM, lambda *_: process.send_signal(signal.SIGTERM))
        try:
            return process.wait()
        finally:
            for number, handler in former.items():
                signal.signal(number, handler)
