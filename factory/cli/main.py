"""Entry point of `factory`: loads commands when they are used and translates errors to exit codes.

Exit codes: 0 success, 1 failure caused by the data or the environment, 2 wrong usage or a missing package of an
extra, 3 bug in this software, 130 interrupted.
"""

from __future__ import annotations

import errno
import importlib
import itertools
import os
import sys
import traceback
from itertools import groupby
from types import MappingProxyType
from typing import NamedTuple

import click
from click.shell_completion import CompletionItem

from factory.cli.groups import CommandGroup, no_option_error
from schemas.errors import FactoryError, UsageError
from schemas.support.child import SAFE_PATH
from schemas.support.extras import EXTRA_OF, missing_package
from workers.process.one_core import one_core

_MAKE, _INSPECT, _USE, _LEARN = "Generate", "Inspect", "Export", "Train and evaluate"
_FARM, _OTHER = "Multiple hosts", "Other"
_MEASURED = {("bench", "rollout"), ("bench", "render")}
"""Benchmark commands that simulate in this process, and therefore need the environment variables of a simulation
process."""


class CommandEntry(NamedTuple):
    """One command as `factory --help` lists it."""

    section: str
    """Section heading in the help."""
    summary: str
    """One sentence that fits in one line of 80 columns."""


VERBS = MappingProxyType(
    {
        "run": CommandEntry(_MAKE, "Generate a dataset from a plan, or continue an interrupted run."),
        "merge": CommandEntry(_MAKE, "Merge datasets, also of different plans, into a new one."),
        "render": CommandEntry(_MAKE, "Render the frames and sensors of a states dataset."),
        "plan": CommandEntry(_MAKE, "Write, explain and check plans; find a feasible plan."),
        "scene": CommandEntry(_MAKE, "Build, import, inspect and render scenes."),
        "rig": CommandEntry(_MAKE, "List, show and check sensor rigs."),
        "gate": CommandEntry(_MAKE, "Measure the success rate of first attempts in one scene."),
        "status": CommandEntry(_INSPECT, "Show the progress of a run and its workers."),
        "jobs": CommandEntry(_INSPECT, "List, retry and cancel jobs; release hosts; pause a run."),
        "verify": CommandEntry(_INSPECT, "Check the files, tables and hashes of a dataset."),
        "repair": CommandEntry(_INSPECT, "Repair a damaged dataset, its ledger and its tables."),
        "pack": CommandEntry(_INSPECT, "Pack the episodes of a states dataset into shards."),
        "replay": CommandEntry(_INSPECT, "Simulate one episode again and compare its content."),
        "stats": CommandEntry(_INSPECT, "Print the statistics of a dataset."),
        "report": CommandEntry(_INSPECT, "Write an HTML report with figures of a dataset."),
        "show": CommandEntry(_INSPECT, "Write one episode as a contact sheet or a video."),
        "serve": CommandEntry(_INSPECT, "Serve the web page of a dataset, or of all datasets in a folder."),
        "view": CommandEntry(_INSPECT, "Open one episode in the Rerun viewer."),
        "export": CommandEntry(_USE, "Convert a dataset to another format."),
        "relabel": CommandEntry(_USE, "Write new verified instructions for a dataset."),
        "push": CommandEntry(_USE, "Upload a dataset or an export to the Hugging Face Hub."),
        "correct": CommandEntry(_LEARN, "Record the planner's corrections of a policy that drives."),
        "train": CommandEntry(_LEARN, "Train baseline policies. Requires the extra `train`."),
        "eval": CommandEntry(_LEARN, "Evaluate policies in closed loop on the episodes of a dataset."),
        "coordinator": CommandEntry(_FARM, "Start the coordinator of a run whose workers are on other hosts."),
        "gateway": CommandEntry(_FARM, "Start a gateway between workers and a coordinator."),
        "worker": CommandEntry(_FARM, "Simulate jobs of a coordinator on this host."),
        "gather": CommandEntry(_FARM, "Copy the episodes of gateways or shards into one dataset."),
        "submit": CommandEntry(_FARM, "Submit a run to a batch system."),
        "keys": CommandEntry(_FARM, "Create and list the TLS certificates of hosts."),
        "bench": CommandEntry(_OTHER, "Measure the performance of this machine."),
        "completion": CommandEntry(_OTHER, "Print the completion script of a shell."),
    }
)
"""Command by name, in the order of the help. The attribute `command` of the module of that name is the command."""


class _Commands(CommandGroup):
    """The commands of the table `VERBS`. A command's module is imported only when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Returns the names of the commands."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Imports a command's module and returns the command."""
        if cmd_name not in VERBS:
            return None
        command: click.Command = importlib.import_module(f"factory.cli.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Writes the commands of each section to the help."""
        width = max(map(len, VERBS))
        for section, names in groupby(VERBS, lambda name: VERBS[name].section):
            with formatter.section(section):
                formatter.write_dl([(name.ljust(width), VERBS[name].summary) for name in names])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Returns the commands whose names begin with `incomplete`; imports none of them."""
        if incomplete.startswith("-"):
            return click.Command.shell_complete(self, ctx, incomplete)
        return [CompletionItem(name, help=VERBS[name].summary) for name in VERBS if name.startswith(incomplete)]


def _print_version(ctx: click.Context, _parameter: click.Parameter, is_given: bool) -> None:
    if is_given:
        from schemas.support.product import product_version

        click.echo(f"factory, version {product_version()}")
        ctx.exit()


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_print_version,
    help="Print the version: the release and a digest of the source.",
)
def cli() -> None:
    """A distributed data factory for language-conditioned robot navigation.

    \b
    Start here:   factory run demo --out dataset
    Then:         factory status dataset; factory verify dataset --deep
    """


def main() -> None:
    """Runs the command line and exits with the exit code of the command."""
    _set_environment()
    os.environ[SAFE_PATH] = "1"  # inherited by the processes that multiprocessing starts
    sys.exit(_run())


def _set_environment() -> None:
    """Restarts this process with the environment of a simulation process; glibc reads its settings only at start."""
    if tuple(sys.argv[1:3]) in _MEASURED and (wanted := one_core(os.environ)) != dict(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], wanted)  # noqa: S606 - executes this program


def _run() -> int:
    try:
        outcome = cli.main(prog_name="factory", standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _say("interrupted; finished work is kept; run the same command again to continue", 130)
    except click.NoSuchOption as error:
        no_option_error(error).show()
        return 2
    except click.ClickException as error:
        error.show()
        return 2
    except UsageError as error:
        return _say(f"error: {error}", 2)
    except FactoryError as error:
        return _say(f"error: {error}", 1)
    except BrokenPipeError:
        return 1
    except OSError as error:
        if error.errno not in (errno.ENAMETOOLONG, errno.ELOOP):
            return _report_bug()
        return _say(f"error: {str(error.filename)[:80]!r} is not a valid path: {error.strerror}", 2)
    except ModuleNotFoundError as error:
        return _report_missing(error)
    except Exception:  # noqa: BLE001 - any other exception is a bug in this software
        return _report_bug()
    return outcome if isinstance(outcome, int) else 0


def _report_missing(error: ModuleNotFoundError) -> int:
    """Prints which extra installs a missing package; any other missing module is a bug in this software."""
    module = (error.name or "").partition(".")[0]
    if module not in EXTRA_OF:
        return _report_bug()
    command = " ".join(("factory", *itertools.takewhile(str.isalpha, sys.argv[1:3])))
    return _say(f"error: {missing_package(module, f'`{command}`')}", 2)


def _report_bug() -> int:
    traceback.print_exc()
    return _say("error: this is a bug in minivla-factory; please report it with the traceback above", 3)


def _say(text: str, code: int) -> int:
    click.echo(text, err=True)
    return code


if __name__ == "__main__":
    main()
