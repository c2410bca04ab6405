"""Entry point of `factory`: loads commands when they are used and translates errors to exit codes.

Exit codes: 0 success, 1 failure caused by the data or the environment, 2 wrong usage, 3 bug in this software,
130 interrupted.
"""

from __future__ import annotations

import errno
import importlib
import itertools
import os
import sys
import traceback
from itertools import groupby

import click
from click.shell_completion import CompletionItem

from factory.cli.common.groups import CommandGroup, say_no_option
from factory.cli.verbs import VERBS
from schemas.errors import FactoryError, UsageError
from schemas.support.child import SAFE_PATH
from schemas.support.extras import EXTRA_OF, missing_package
from workers.process.one_core import one_core

__all__ = ["cli", "main"]

_MEASURED = {("bench", "rollout"), ("bench", "render"), ("bench", "memory")}
"""Commands that measure the work of a simulation in this process, and so need its environment variables."""


class _Commands(CommandGroup):
    """The commands of the table `VERBS`. A command's module is imported only when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Returns the names of the commands."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Imports a command's module and returns the command."""
        if cmd_name not in VERBS:
            return None
        command: click.Command = importlib.import_module(f"factory.cli.{VERBS[cmd_name].module}").command
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


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="minivla-factory", prog_name="factory")
def cli() -> None:
    """A distributed data factory for language-conditioned robot navigation.

    \b
    Start here:   factory run demo --out dataset
    Then:         factory status dataset; factory verify dataset --deep
    """


def main() -> None:
    """Runs the command line and exits with the exit code of the command."""
    _set_environment()
    os.environ[SAFE_PATH] = "1"  # for the processes that multiprocessing starts
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
        say_no_option(error).show()
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
