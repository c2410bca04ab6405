"""Declares `factory bench sessions`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.options import count_option, json_option, number_option


@click.command("sessions")
@count_option("--sessions", 10_000, "Number of workers, each with one session.", most=10_000)
@count_option("--cores", 1, "Number of simulations of each worker.", most=256)
@number_option("SECONDS", "--attempt", 10.0, "Mean duration of an attempt, seconds.", "episode_s", least=0.1)
@number_option(
    "SECONDS", "--lease", 15.0, "Lease time, seconds; a worker sends four heartbeats per lease.", "lease_s", least=1.0
)
@number_option("SECONDS", "--seconds", 30.0, "Simulated time after the start of all workers, seconds.", least=1.0)
@json_option
def sessions(**options: Any) -> None:
    """Simulate thousands of workers against one coordinator.

    The requests of the workers run through the real handlers and a ledger on disk, in virtual time. Measures the CPU
    time, the messages and the commits. `factory bench coordinator` and `factory bench delivery` measure network and
    bundles.
    """
    from factory.commands.other.bench_sessions import sessions

    sessions(**options)
