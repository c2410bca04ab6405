"""Runs a benchmark as a command: environment of one core, logs, signals and exit codes. Measures nothing."""

from __future__ import annotations

import os
import signal
import sys

import click

from factory.support.logs import configure_logs
from schemas.errors import FactoryError, UsageError
from workers.process.one_core import ONE_THREAD


def run(command: click.Command) -> None:
    """Runs the command and exits with the exit codes of `factory`; restarts this program if a variable is not set."""
    wanted = {**ONE_THREAD, **os.environ}  # numpy has read these variables already, when it was imported
    if wanted != dict(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], wanted)
    configure_logs(verbose=False)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the measured processes, too
    sys.exit(_exit_code(command))


def _exit_code(command: click.Command) -> int:
    try:
        command.main(standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        return 130
    except click.ClickException as error:
        error.show()
        return 2
    except FactoryError as error:
        click.echo(f"error: {error}", err=True)
        return 2 if isinstance(error, UsageError) else 1
    return 0
