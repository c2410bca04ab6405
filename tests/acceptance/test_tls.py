"""Certificates, and a coordinator, a worker and an operator with TLS, from the command line."""

from __future__ import annotations

import pytest

from tests.acceptance.factory_cli import Command, FactoryCli, wait_for
from tests.builders.ports import free_endpoint


@pytest.mark.slow
def test_only_admitted_workers_can_finish_a_run_with_tls(factory: FactoryCli, command: Command, plan, tmp_path):
    pki, out = tmp_path / "pki", tmp_path / "out"
    command("keys", "ca", pki)
    command("keys", "host", pki, "hub", "--role", "coordinator", "--address", "127.0.0.1")
    command("keys", "host", pki, "node-1")
    command("keys", "host", pki, "boss", "--role", "operator")
    command("keys", "host", pki, "gone")
    assert "gone is revoked" in command("keys", "revoke", pki, "gone").stdout
    assert [host["admitted"] for host in command.json("keys", "list", pki)] == [True, False, True, True]

    endpoint = free_endpoint().replace("tcp/", "tls/")
    start = ("coordinator", "start", plan, "--out", out, "--listen", endpoint, "--scene", "hospital", "--episodes", 2)
    assert "--tls" in command(*start, expect=2).stderr
    hub = factory.start(*start, "--tls", pki / "hub")
    wait_for(lambda: (out / ".coordinator.json").exists())
    outsider = ("worker", "--connect", endpoint, "--connect-timeout", 1, "--spool", tmp_path / "spool")
    assert (
        "cannot be combined"
        in command("worker", "--tls", pki / "gone", "--connect", endpoint[:1] + "cp/" + endpoint[4:], expect=2).stderr
    )
    assert "hosts.txt" in command(*outsider, "--tls", pki / "gone", expect=1).stderr
    assert command.json("status", "--connect", endpoint, "--tls", pki / "boss")["planned"] == 2
    command("status", "--connect", endpoint, "--tls", pki / "gone", expect=1)
    command("jobs", "cancel", out, "2", "--tls", pki / "boss")
    factory("worker", "--connect", endpoint, "--tls", pki / "node-1", "--spool", tmp_path / "spool")
    _, said = hub.communicate(timeout=60)
    assert hub.returncode == 1  # because the cancelled episode is missing
    assert "1 of 2 episodes are missing (1 cancelled)" in said
    assert [line.split(".")[0] for line in said.splitlines() if " joined with " in line] == ["worker node-1"]
    # a worker that starts after the run reads from the run folder that the run is finished
    factory("worker", "--connect", f"@{out}", "--tls", pki / "node-1", "--spool", tmp_path / "spool")
    progress = command.json("status", out)
    assert (progress["jobs"]["archived"], progress["jobs"]["cancelled"]) == (1, 1)
    assert progress["workers"][0]["host"] == "node-1"
