"""Downloads of one episode: its bundle, a film and an MCAP file, made by the exporters in a temporary folder."""

from __future__ import annotations

import shutil
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

from starlette.background import BackgroundTask
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response

from factory.dataset.bundle import EpisodeBundle
from factory.dataset.episode import Episode
from factory.dataset.packages import find_package_file
from factory.export.mcap.exporter import McapExporter, McapOptions
from factory.visualize.film import draw_film, film_rate, write_mp4
from factory.web.context import context_of
from factory.web.pages.find import find_episode
from schemas.scene import decode_scene

_AT_ONCE = 1
"""Number of downloads that are made at a time; further ones wait."""
_WAIT_S = 60.0
_making = threading.BoundedSemaphore(_AT_ONCE)


def download(request: Request) -> Response:
    """Answers with a file of the episode."""
    kind = request.path_params["kind"]
    if kind not in DOWNLOADS:
        raise HTTPException(404, f"{kind[:40]!r} is not a download; valid: {', '.join(DOWNLOADS)}")
    episode = find_episode(context_of(request), request.path_params["episode_id"])
    if not _making.acquire(timeout=_WAIT_S):
        raise HTTPException(503, "another download is being made; try again", {"retry-after": "30"})
    folder = Path(tempfile.mkdtemp(prefix="factory-web-"))
    try:
        path = DOWNLOADS[kind](episode, folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        _making.release()
    after = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
    return FileResponse(path, filename=path.name, media_type="application/octet-stream", background=after)


def _copy_bundle(episode: Episode, folder: Path) -> Path:
    path = folder / f"{episode.episode_id}.zip"
    path.write_bytes(episode.path.read_bytes())
    return path


def _make_film(episode: Episode, folder: Path) -> Path:
    root = episode.path.parents[1]
    with episode.path.open("rb") as file, EpisodeBundle(file, root, ranges=episode.ranges) as bundle:
        with find_package_file(*bundle.package).open("rb") as package:
            scene = decode_scene(package)
        stride, rate = film_rate(bundle.meta.job.task.control_hz)
        path = folder / f"{episode.episode_id}.mp4"
        write_mp4(path, draw_film(bundle, scene, stride), rate)
    return path


def _make_mcap(episode: Episode, folder: Path) -> Path:
    McapExporter().write_episode(episode, McapOptions(), folder)
    return folder / "episodes" / f"{episode.episode_id}.mcap"


DOWNLOADS: MappingProxyType[str, Callable[[Episode, Path], Path]] = MappingProxyType(
    {"mp4": _make_film, "mcap": _make_mcap, "zip": _copy_bundle}
)
"""Function that makes a file in a folder, by kind."""
