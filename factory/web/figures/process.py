"""Process that draws the figures of a dataset: `python -m factory.web.figures.process DATASET`.

It writes one `Message` on each line of its output. It has a low priority, so it does not slow a run on the same
machine.
"""

from __future__ import annotations

import os
import sys
import time

from factory.dataset.site import site_of
from factory.support.logs import configure_logs
from factory.web.figures.model import Message
from schemas.errors import FactoryError

_NICENESS = 10
"""Niceness of the process, which gets a tenth of the CPU time of a process with the default priority."""
_PAUSE_S = 0.5
"""Minimum time between two messages of progress, seconds."""


def main(name: str) -> None:
    """Draws the figures; ends without a message if the server has ended."""
    os.nice(_NICENESS)
    configure_logs()
    told_s = -float("inf")

    def tell(done: int, total: int) -> None:
        nonlocal told_s
        if time.monotonic() - told_s >= _PAUSE_S:
            told_s = time.monotonic()
            _write(Message(done=done, total=total))

    try:
        from factory.web.figures.drawing import draw_statistics  # needs packages that may not be installed

        for drawn in draw_statistics(site_of(name).place, tell):
            _write(Message(drawn=drawn))
    except FactoryError as error:
        _write(Message(trouble=str(error)))


def _write(message: Message) -> None:
    sys.stdout.write(f"{message.model_dump_json()}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except BrokenPipeError:  # the server has ended
        os._exit(0)  # closing the standard output would fail again
