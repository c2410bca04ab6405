"""The table of `factory`'s verbs: section, name and one-line summary. Data only.

The command of verb NAME is the attribute `command` of `factory.cli.NAME`. A summary is the first paragraph of the
command's help; a test compares them.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

__all__ = ["VERBS", "Verb"]


class Verb(NamedTuple):
    """One verb as `factory --help` lists it."""

    section: str
    """Heading above it."""
    summary: str
    """One sentence that fits one line of 80 columns."""


_MAKE, _INSPECT, _USE, _LEARN, _FARM, _OTHER = "Make", "Inspect", "Use", "Train and evaluate", "Farm", "Other"

VERBS = MappingProxyType(
    {
        "run": Verb(_MAKE, "Make a dataset from a plan, or continue an interrupted run."),
        "plan": Verb(_MAKE, "Show the episodes of a plan; find the nearest feasible plan."),
        "scene": Verb(_MAKE, "Build, import, inspect and draw scenes."),
        "gate": Verb(_MAKE, "Measure the success rate of first attempts in one scene."),
        "status": Verb(_INSPECT, "Show the progress of a run and its workers."),
        "jobs": Verb(_INSPECT, "List, show, retry and cancel jobs; release barred hosts."),
        "verify": Verb(_INSPECT, "Check the files, tables and hashes of a dataset."),
        "repair": Verb(_INSPECT, "Repair a damaged dataset, its ledger and its tables."),
        "replay": Verb(_INSPECT, "Simulate one episode again and compare its content."),
        "stats": Verb(_INSPECT, "Print the statistics of a dataset."),
        "report": Verb(_INSPECT, "Draw the figures of a dataset and an HTML page."),
        "show": Verb(_INSPECT, "Write one episode as a contact sheet or as a film."),
        "view": Verb(_INSPECT, "Open one episode in the Rerun viewer."),
        "export": Verb(_USE, "Write a dataset in another format."),
        "push": Verb(_USE, "Upload a dataset or an export to the Hugging Face Hub."),
        "train": Verb(_LEARN, "Train the baseline policies; needs the extra `train`."),
        "eval": Verb(_LEARN, "Evaluate policies in closed loop on episodes of a dataset."),
        "coordinator": Verb(_FARM, "Run the coordinator of a run with workers on other hosts."),
        "gateway": Verb(_FARM, "Run a gateway between workers and a coordinator."),
        "worker": Verb(_FARM, "Simulate jobs of a coordinator on this host."),
        "gather": Verb(_FARM, "Copy the episodes that gateways keep into one dataset."),
        "keys": Verb(_FARM, "Create and list the TLS certificates of hosts."),
        "bench": Verb(_OTHER, "Measure the performance of this machine."),
        "completion": Verb(_OTHER, "Print the completion script of a shell."),
    }
)
"""Verb by name, in the order of the help."""
