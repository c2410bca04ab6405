"""A run with two gateways and `factory gather` from the command line, with real physics."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from tests.acceptance.factory_cli import Command, FactoryCli, wait_for
from tests.builders.ports import free_endpoint


@pytest.mark.slow
def test_episodes_of_two_gateways_are_gathered_into_the_dataset_of_one_worker(
    factory: FactoryCli, command: Command, plan: Path, reference: Path, tmp_path: Path
):
    out, core, doors = tmp_path / "out", free_endpoint(), [free_endpoint(), free_endpoint()]
    hub = factory.start("coordinator", "start", plan, "--out", out, "--listen", core)
    gateways = []
    for name, door in zip(("gw1", "gw2"), doors, strict=True):
        words = ("--connect", core, "--out", tmp_path / name, "--listen", door, "--name", name, "--http", "127.0.0.1:0")
        gateways.append(factory.start("gateway", "start", *words))
        wait_for(lambda name=name: (tmp_path / name / "gateway.json").exists())  # the gateway has joined
    factory("worker", "--connect", ",".join(doors), "--spool", tmp_path / "spool", "--connect-timeout", 60)
    assert hub.wait(180) == 0
    progress = command.json("status", out)
    assert sum(progress["by_gateway"].values()) == progress["jobs"]["archived"] == 5
    assert "factory gather" in command("status", out).stdout
    assert list((out / "episodes").iterdir()) == []
    for gateway in gateways:
        gateway.terminate()
        assert gateway.wait(60) == 0

    assert "has no episodes" in command("gather", out, tmp_path, expect=2).stderr
    kept = [tmp_path / name for name in ("gw1", "gw2")]
    nothing = command.json("gather", out, expect=1)
    assert (nothing["gathered"], len(nothing["missing"])) == (0, 5)
    whole = command.json("gather", out, *kept)
    assert (whole["gathered"], whole["missing"], whole["episodes"]) == (5, [], 5)
    verdict = command.json("verify", out, "--deep")
    assert verdict["digest"] == command.json("verify", reference)["digest"]
    assert command.json("status", out)["by_gateway"] == {}


def test_a_gateway_without_a_coordinator_waits_until_it_is_stopped(factory: FactoryCli, tmp_path: Path):
    words = ("--connect", free_endpoint(), "--out", tmp_path / "gw", "--listen", free_endpoint(), "--name", "gw1")
    waiting = factory.start("gateway", "start", *words)
    wait_for(lambda: (tmp_path / "gw" / "episodes").exists())
    waiting.terminate()
    _, err = waiting.communicate(timeout=60)
    assert (waiting.returncode, "stopped before the coordinator at" in err) == (130, True), err


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("is_finished", [False, True])
def test_coordinator_and_gateway_exit_with_130_if_they_are_stopped_before_the_run_is_finished(
    factory: FactoryCli, plan: Path, reference_copy: Path, tmp_path: Path, number: signal.Signals, is_finished: bool
):
    core, kept = free_endpoint(), tmp_path / "gw"
    run = ("--out", reference_copy) if is_finished else (plan, "--out", tmp_path / "out", "--gate", "skip")
    hub = factory.start("coordinator", "start", *run, "--listen", core, "--stay")
    words = ("--connect", core, "--out", kept, "--listen", free_endpoint(), "--name", "gw1")
    gateway = factory.start("gateway", "start", *words)
    wait_for((kept / "gateway.json").exists, 400)  # the coordinator builds the scenes first
    time.sleep(1.0)  # the gateway asks for orders four times a second
    for process, end in ((gateway, f"the episodes of this gateway are in {kept}"), (hub, "factory coordinator start")):
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
        assert process.returncode == (0 if is_finished else 130), said
        assert ("stopped" in said) != is_finished
        assert is_finished or end in said


def test_without_certificates_a_gateway_listens_on_loopback_only(command: Command, tmp_path: Path):
    words = ("--connect", "tcp/127.0.0.1:7447", "--out", tmp_path / "gw", "--listen", "tcp/0.0.0.0:7448")
    assert "--tls" in command("gateway", "start", *words, expect=2).stderr
