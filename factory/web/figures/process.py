"""Process that draws the figures of a dataset: `python -m factory.web.figures.process DATASET`.

It writes one `Message` on each line of its output, and keeps figures in the cache by the tables of the dataset. It has
a low priority, so it does not slow a run on the same machine. A thread of the server would hold the interpreter lock
and delay other pages.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from pydantic import ValidationError

import factory.report
import factory.stats
from factory.dataset.site import site_of
from factory.html.palette import css_variables, with_variables
from factory.report.drawing.figure import Figure
from factory.report.figures.registry import DRAW_FUNCTIONS
from factory.report.gather import gather
from factory.scenes.cached import write_whole
from factory.stats.rows import MOST_OPENED
from factory.support.logs import configure_logs
from factory.support.settings import cache_directory, read_renderer
from factory.web.figures.store import DrawnStatistics, FigureCard, Message
from schemas.errors import FactoryError
from schemas.storage.dataset_files import ATTEMPTS_FILE, INSTRUCTIONS_FILE, META_FILE, METADATA_FILE
from schemas.storage.place import Place

FIRST_OPENED = 200
"""Number of episodes that are opened for the first figures of a larger dataset."""
_KEPT_FILES = 20
"""Maximum number of cached results; older results are removed."""
_TABLES = (META_FILE, METADATA_FILE, ATTEMPTS_FILE, INSTRUCTIONS_FILE)
_CODE = (Path(factory.report.__file__).parent, Path(factory.stats.__file__).parent)


def draw_statistics(
    root: Place, on_progress: Callable[[int, int], None], first_opened: int = FIRST_OPENED
) -> Iterator[DrawnStatistics]:
    """Yields the figures of a dataset; for a large dataset, first from `first_opened` episodes, then as in the report.

    Complete figures are cached by the content of the tables. The files of the episodes are not part of the key.

    Args:
        root: root of the dataset.
        on_progress: callback with the number of episodes read and the total.
        first_opened: number of episodes that are opened for the first figures.

    Raises:
        WorldError: the dataset does not exist, this machine cannot render its frames, or the cache cannot be written.
        ArchiveCorrupt: the metadata or the table of episodes cannot be read.
    """
    key = _key_of(root)
    path = cache_directory() / "statistics" / f"{key[:32]}.json"
    with suppress(OSError, ValidationError):  # not drawn yet, or not written completely
        yield DrawnStatistics.model_validate_json(path.read_bytes())
        return
    for most in (first_opened, MOST_OPENED):
        drawn = _draw(root, key, most, on_progress)
        if drawn.is_complete:
            _remember(path, drawn)
        yield drawn
        if drawn.is_complete:
            return


def _draw(root: Place, key: str, most: int, on_progress: Callable[[int, int], None]) -> DrawnStatistics:
    material = gather(root, on_progress, samples=0, most_opened=most)
    figures = [figure for draw in DRAW_FUNCTIONS if (figure := draw(material)).panels]
    episodes = len(material.episodes)
    return DrawnStatistics(
        cards=tuple(map(_card, figures)),
        images={panel.name: _themed(panel.svg) for figure in figures for panel in figure.panels},
        key=hashlib.sha256(f"{key} {most}".encode()).hexdigest(),
        episodes=episodes,
        opened=min(episodes, most),
        is_complete=most >= min(episodes, MOST_OPENED),
    )


def _card(figure: Figure) -> FigureCard:
    panels = tuple((panel.name, panel.alt) for panel in figure.panels)
    return FigureCard(name=figure.name, title=figure.title, caption=figure.caption, panels=panels)


def _themed(svg: str) -> str:
    """Returns a drawing as a separate image with the light or dark colours that the browser requests."""
    style = (
        f"<style>:root {{ {css_variables(dark=False)} }} @media (prefers-color-scheme: dark) {{ :root "
        f"{{ {css_variables(dark=True)} }} }}</style>"
    )
    return re.sub(r"(<svg [^>]*>)", lambda match: match[1] + style, with_variables(svg), count=1)


def _key_of(root: Place) -> str:
    """Returns the SHA-256 of the tables, of the code of the figures and of the type of the renderer."""
    hasher = hashlib.sha256(read_renderer().encode())
    for name in _TABLES:
        with suppress(FileNotFoundError):
            hasher.update(name.encode() + hashlib.sha256((root / name).read_bytes()).digest())
    for path in sorted(path for folder in _CODE for path in folder.rglob("*.py")):
        hasher.update(path.read_bytes())
    return hasher.hexdigest()


def _remember(path: Path, drawn: DrawnStatistics) -> None:
    write_whole(path, drawn.model_dump_json().encode())
    with suppress(OSError):  # another process removed the same file
        for old in sorted(path.parent.glob("*.json"), key=lambda old: old.stat().st_mtime)[:-_KEPT_FILES]:
            old.unlink()


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
