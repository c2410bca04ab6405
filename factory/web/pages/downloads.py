"""Downloads of one episode: bundle, video, MCAP, LeRobot and Rerun, made by the exporters in a temporary folder."""

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
from factory.dataset.packages import ScenePackage
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.lerobot.v30 import LeRobotExporter
from factory.export.mcap.exporter import McapExporter
from factory.export.options import McapOptions
from factory.visualize.film import draw_film, film_rate, write_mp4
from factory.web.context import context_of
from factory.web.pages.find import find_episode
from schemas.errors import UsageError
from schemas.support.extras import require_package

_AT_ONCE = 1
"""Number of downloads that are made at a time; other requests wait."""
_WAIT_S = 60.0
_RERUN_STRIDE = 2
"""Stride of the frames in a Rerun recording, as in `factory view`."""
_making = threading.BoundedSemaphore(_AT_ONCE)


def download(request: Request) -> Response:
    """Answers with a file of the episode."""
    kind = request.path_params["kind"]
    if kind not in DOWNLOADS:
        raise HTTPException(404, f"{kind[:40]!r} is not a download; valid: {', '.join(DOWNLOADS)}")
    episode = find_episode(context_of(request), request.path_params["episode_id"])
    if obstacle := download_obstacles()[kind]:
        raise HTTPException(503, obstacle)
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
        bundle.name = episode.episode_id
        scene = bundle.package.geometry()
        stride, rate = film_rate(bundle.meta.job.task.control_hz)
        path = folder / f"{episode.episode_id}.mp4"
        write_mp4(path, draw_film(bundle, scene, stride, episode.instruction), rate)
    return path


def _make_mcap(episode: Episode, folder: Path) -> Path:
    McapExporter().write_episode(episode, McapOptions(), folder)
    return folder / "episodes" / f"{episode.episode_id}.mcap"


def _make_rerun(episode: Episode, folder: Path) -> Path:
    from factory.visualize.rerun import view_episode  # the package is an extra

    job = episode.meta.job
    package = ScenePackage(episode.path.parents[1], job.scene, job.scene_sha256)
    path = folder / f"{episode.episode_id}.rrd"
    view_episode(episode, package.geometry(), path, _RERUN_STRIDE)
    return path


def _make_lerobot(episode: Episode, folder: Path) -> Path:
    name = f"{episode.episode_id}_lerobot"
    root = episode.path.parents[1]
    order = ExportOrder(root, folder / name, "lerobot", LeRobotExporter.options(), episodes=(episode.episode_id,))
    run_export(order)
    return Path(shutil.make_archive(str(folder / name), "zip", folder, name))


DOWNLOADS: MappingProxyType[str, Callable[[Episode, Path], Path]] = MappingProxyType(
    {"mp4": _make_film, "mcap": _make_mcap, "lerobot": _make_lerobot, "rerun": _make_rerun, "zip": _copy_bundle}
)
"""Function that makes a file in a folder, by kind."""
_NEEDED = MappingProxyType({"rerun": "rerun"})
"""Module of an optional package that a download needs, by kind."""


def download_obstacles() -> dict[str, str]:
    """Returns for each kind of download why it cannot be made here, or an empty text."""
    obstacles = dict.fromkeys(DOWNLOADS, "")
    for kind, module in _NEEDED.items():
        try:
            require_package(module, f"the download {kind}")
        except UsageError as error:
            obstacles[kind] = str(error)
    return obstacles
