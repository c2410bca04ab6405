"""Entry point of `factory`: the tree of commands, loaded when used, and the one place where errors become exit codes.

Exit codes: 0 done, 1 the data or the world said no, 2 wrong usage, 3 our bug, 130 interrupted.
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
"""What measures the work of a simulation process in its own process."""


class _Verbs(CommandGroup):
    """The verbs of the table; a verb's module is imported when the verb is called, not for help or completion."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Returns the names of the verbs."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Imports a verb and returns its command."""
        if cmd_name not in VERBS:
            return None
        command: click.Command = importlib.import_module(f"factory.cli.{VERBS[cmd_name].module}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Writes the sections of the table."""
        width = max(map(len, VERBS))
        for section, names in groupby(VERBS, lambda name: VERBS[name].section):
            with formatter.section(section):
                formatter.write_dl([(name.ljust(width), VERBS[name].summary) for name in names])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Returns the verbs that begin with a word; imports none of them."""
        if incomplete.startswith("-"):
            return click.Command.shell_complete(self, ctx, incomplete)
        return [CompletionItem(name, help=VERBS[name].summary) for name in VERBS if name.startswith(incomplete)]


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="minivla-factory", prog_name="factory")
def cli() -> None:
    """A distributed data factory for language-conditioned robot navigation.

    \b
    Start here:   factory run demo --out dataset
    Then:         factory status dataset; factory verify dataset --deep
    """


def main() -> None:
    """Runs the command line and exits with the code of what happened."""
    _take_surroundings()
    os.environ[SAFE_PATH] = "1"  # for the processes that multiprocessing starts
    sys.exit(_run())


def _take_surroundings() -> None:
    """Starts again as a simulation process would, where one is measured: glibc reads its settings only then."""
    if tuple(sys.argv[1:3]) in _MEASURED and (wanted := one_core(os.environ)) != dict(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], wanted)  # noqa: S606 - this very program


def _run() -> int:
    try:
        outcome = cli.main(prog_name="factory", standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _say("interrupted; nothing that was done is lost: run the same command again to go on", 130)
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
        return _say(f"error: {str(error.filename)[:80]!r} cannot be a path: {error.strerror}", 2)
    except ModuleNotFoundError as error:
        return _report_missing(error)
    except Exception:  # noqa: BLE001 - the last door: everything else is our bug and says so
        return _report_bug()
    return outcome if isinstance(outcome, int) else 0


def _report_missing(error: ModuleNotFoundError) -> int:
    """Names the extra that brings a missing package; any other module that is missing is our bug."""
    module = (error.name or "").partition(".")[0]
    if module not in EXTRA_OF:
        return _report_bug()
    command = " ".join(("factory", *itertools.takewhile(str.isalpha, sys.argv[1:3])))
    return _say(f"error: {missing_package(module, f'`{command}`')}", 2)


def _report_bug() -> int:
    traceback.print_exc()
    return _say("this is a bug in minivla-factory; please report the lines above", 3)


def _say(text: str, code: int) -> int:
    click.echo(text, err=True)
    return code


if __name__ == "__main__":
    main()
