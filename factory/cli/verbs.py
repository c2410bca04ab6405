"""The table of `factory`'s verbs: module, section and one-line summary of each. Data only.

A summary is the first paragraph of the command's help; a test compares them.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

__all__ = ["VERBS", "Verb"]


class Verb(NamedTuple):
    """One verb as `factory --help` lists it."""

    module: str
    """Module below `factory.cli` whose attribute `command` is the command."""
    section: str
    """Heading above it."""
    summary: str
    """One sentence that fits one line of 80 columns."""


_MAKE, _INSPECT, _USE, _LEARN, _FARM, _OTHER = "Make", "Inspect", "Use", "Train and evaluate", "Farm", "Other"

VERBS = MappingProxyType(
    {
        "run": Verb("run.run", _MAKE, "Make a dataset from a plan, or continue an interrupted run."),
        "plan": Verb("run.plan", _MAKE, "Show the episodes of a plan; find the nearest feasible plan."),
        "scene": Verb("scene.command", _MAKE, "Build, import, inspect and draw scenes."),
        "gate": Verb("run.gate", _MAKE, "Measure the success rate of first attempts in one scene."),
        "status": Verb("inspect.status", _INSPECT, "Show the progress of a run and its workers."),
        "jobs": Verb("inspect.jobs", _INSPECT, "List, show, retry and cancel jobs; release barred hosts."),
        "verify": Verb("inspect.verify", _INSPECT, "Check the files, tables and hashes of a dataset."),
        "repair": Verb("inspect.repair", _INSPECT, "Repair a damaged dataset, its ledger and its tables."),
        "replay": Verb("inspect.replay", _INSPECT, "Simulate one episode again and compare its content."),
        "stats": Verb("inspect.stats", _INSPECT, "Print the statistics of a dataset."),
        "report": Verb("inspect.report", _INSPECT, "Draw the figures of a dataset and an HTML page."),
        "show": Verb("inspect.show", _INSPECT, "Write one episode as a contact sheet or as a film."),
        "view": Verb("inspect.view", _INSPECT, "Open one episode in the Rerun viewer."),
        "export": Verb("publish.export", _USE, "Write a dataset in another format."),
        "push": Verb("publish.push", _USE, "Upload a dataset or an export to the Hugging Face Hub."),
        "train": Verb("learn.train", _LEARN, "Train the baseline policies; needs the extra `train`."),
        "eval": Verb("eval.command", _LEARN, "Evaluate policies in closed loop on episodes of a dataset."),
        "coordinator": Verb("farm.coordinator", _FARM, "Run the coordinator of a run with workers on other hosts."),
        "gateway": Verb("farm.gateway", _FARM, "Run a gateway between workers and a coordinator."),
        "worker": Verb("farm.worker", _FARM, "Simulate jobs of a coordinator on this host."),
        "gather": Verb("farm.gather", _FARM, "Copy the episodes that gateways keep into one dataset."),
        "keys": Verb("farm.keys", _FARM, "Create and list the TLS certificates of hosts."),
        "bench": Verb("other.bench", _OTHER, "Measure the performance of this machine."),
        "completion": Verb("other.completion", _OTHER, "Print the completion script of a shell."),
    }
)
"""Verb by name, in the order of the help."""
