"""The table of `factory`'s commands: module, section and one-line summary of each. Data only.

A summary is the first paragraph of the command's help; a test compares them.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

__all__ = ["VERBS", "CommandEntry"]


class CommandEntry(NamedTuple):
    """One command as `factory --help` lists it."""

    module: str
    """Module below `factory.cli` whose attribute `command` is the command."""
    section: str
    """Section heading in the help."""
    summary: str
    """One sentence that fits in one line of 80 columns."""


_MAKE, _INSPECT, _USE, _LEARN = "Generate", "Inspect", "Export", "Train and evaluate"
_FARM, _OTHER = "Multiple hosts", "Other"

VERBS = MappingProxyType(
    {
        "run": CommandEntry("run.run", _MAKE, "Generate a dataset from a plan, or continue an interrupted run."),
        "render": CommandEntry("run.render", _MAKE, "Render a states dataset into a dataset that stores frames."),
        "plan": CommandEntry("run.plan", _MAKE, "Show a plan's episode counts; find the nearest feasible plan."),
        "scene": CommandEntry("scene.command", _MAKE, "Build, import, inspect and render scenes."),
        "gate": CommandEntry("run.gate", _MAKE, "Measure the success rate of first attempts in one scene."),
        "status": CommandEntry("inspect.status", _INSPECT, "Show the progress of a run and its workers."),
        "jobs": CommandEntry("inspect.jobs", _INSPECT, "List, show, retry and cancel jobs; release barred hosts."),
        "verify": CommandEntry("inspect.verify", _INSPECT, "Check the files, tables and hashes of a dataset."),
        "repair": CommandEntry("inspect.repair", _INSPECT, "Repair a damaged dataset, its ledger and its tables."),
        "replay": CommandEntry("inspect.replay", _INSPECT, "Simulate one episode again and compare its content."),
        "stats": CommandEntry("inspect.stats", _INSPECT, "Print the statistics of a dataset."),
        "report": CommandEntry("inspect.report", _INSPECT, "Write an HTML report with figures of a dataset."),
        "show": CommandEntry("inspect.show", _INSPECT, "Write one episode as a contact sheet or a video."),
        "view": CommandEntry("inspect.view", _INSPECT, "Open one episode in the Rerun viewer."),
        "export": CommandEntry("publish.export", _USE, "Convert a dataset to another format."),
        "push": CommandEntry("publish.push", _USE, "Upload a dataset or an export to the Hugging Face Hub."),
        "train": CommandEntry("learn.train", _LEARN, "Train baseline policies. Requires the extra `train`."),
        "eval": CommandEntry("eval.command", _LEARN, "Evaluate policies in closed loop on the episodes of a dataset."),
        "coordinator": CommandEntry(
            "farm.coordinator", _FARM, "Start the coordinator of a run whose workers are on other hosts."
        ),
        "gateway": CommandEntry("farm.gateway", _FARM, "Start a gateway between workers and a coordinator."),
        "worker": CommandEntry("farm.worker", _FARM, "Simulate jobs of a coordinator on this host."),
        "gather": CommandEntry("farm.gather", _FARM, "Copy the episodes stored by gateways into one dataset."),
        "keys": CommandEntry("farm.keys", _FARM, "Create and list the TLS certificates of hosts."),
        "bench": CommandEntry("other.bench", _OTHER, "Measure the performance of this machine."),
        "completion": CommandEntry("other.completion", _OTHER, "Print the completion script of a shell."),
    }
)
"""Command by name, in the order of the help."""
