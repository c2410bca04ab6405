"""Entry point of `factory`: the tree of commands, loaded when used, and the one place where errors become exit codes.

Exit codes: 0 done, 1 the data or the world said no, 2 wrong usage, 3 our bug, 130 interrupted.
"""

from __future__ import annotations

import errno
import importlib
import os
import sys
import traceback
from collections.abc import Mapping
from types import MappingProxyType

import click

from schemas.errors import FactoryError, UsageError
from workers.one_core import one_core

__all__ = ["cli", "main"]

_COMMANDS: Mapping[str, str] = MappingProxyType(
    {
        "run": "factory.cli.run",
        "plan": "factory.cli.plan",
        "coordinator": "factory.cli.coordinator",
        "gateway": "factory.cli.gateway",
        "gather": "factory.cli.gather",
        "worker": "factory.cli.worker",
        "status": "factory.cli.status",
        "jobs": "factory.cli.jobs",
        "keys": "factory.cli.keys",
        "verify": "factory.cli.verify",
        "repair": "factory.cli.repair",
        "replay": "factory.cli.replay",
        "show": "factory.cli.show",
        "gate": "factory.cli.gate",
        "stats": "factory.cli.stats",
        "report": "factory.cli.report",
        "push": "factory.cli.push",
        "view": "factory.cli.view",
        "export": "factory.cli.export",
        "bench": "factory.cli.bench",
        "scene": "factory.cli.scene",
        "eval": "factory.cli.eval",
        "train": "factory.cli.train",
        "completion": "factory.cli.completion",
    }
)
"""Verb -> module; each module holds a click command named `command`."""
_MEASURED = {("bench", "rollout"), ("bench", "render"), ("bench", "memory")}
"""What measures the work of a simulation process in its own process."""


class _LazyGroup(click.Group):
    """A group that imports a verb only when it is called, so that `factory --help` stays quick."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        module = _COMMANDS.get(cmd_name)
        if module is None:
            return None
        command: click.Command = importlib.import_module(module).command
        return command


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
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
    sys.exit(_run())


def _take_surroundings() -> None:
    """Starts again as a simulation process would, where one is measured: glibc reads its settings only then."""
    if tuple(sys.argv[1:3]) in _MEASURED and (wanted := one_core(os.environ)) != dict(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], wanted)  # noqa: S606 - this very program


def _run() -> int:
    try:
        outcome = cli.main(standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _say("interrupted; nothing that was done is lost: run the same command again to go on", 130)
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
            return _bug()
        return _say(f"error: {str(error.filename)[:80]!r} cannot be a path: {error.strerror}", 2)
    except Exception:  # noqa: BLE001 - the last door: everything else is our bug and says so
        return _bug()
    return outcome if isinstance(outcome, int) else 0


def _bug() -> int:
    traceback.print_exc()
    return _say("this is a bug in minivla-factory; please report the lines above", 3)


def _say(text: str, code: int) -> int:
    click.echo(text, err=True)
    return code


if __name__ == "__main__":
    main()
