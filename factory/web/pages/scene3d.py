"""3D view of a scene: the page, and the mesh of the scene as binary glTF, which is kept for the next request."""

from __future__ import annotations

import functools
import threading

import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.dataset.episode import Episode
from factory.dataset.packages import ScenePackage
from factory.export.vlnce.exporter import encode_glb
from factory.web.context import context_of, page
from factory.web.pages.find import find_episode
from factory.web.pages.scenes import package_named
from schemas.errors import UsageError
from schemas.support.geometry import yaw_of

_KEPT = 2
"""Number of meshes that are kept; one has up to 30 MB."""
_making = threading.Lock()


def routes() -> list[Route]:
    return [Route("/scenes/{name}/3d", show), Route("/scenes/{name}/scene.glb", mesh)]


def show(request: Request) -> Response:
    """Answers with the page; `?episode=ID` adds the trajectory and the robot of an episode."""
    # the page has a separate reader of the mesh: GLTFLoader of three.js needs an import map, which is an inline script,
    # and the content security policy forbids these
    context, name = context_of(request), request.path_params["name"]
    package = package_named(context, name)
    given = request.query_params.get("episode")
    episode = find_episode(context, given) if given else None
    if episode is not None and episode.meta.job.scene != name:
        raise UsageError(f"{episode.episode_id} is in scene {episode.meta.job.scene}, not in {name}")
    return page(
        request,
        "scene3d",
        f"{name} in 3D",
        name=name,
        version=package.sha256[:16],
        floor_m=package.info().floor_height_m,
        episode=episode,
        poses="" if episode is None else _poses(episode),
        hz=60 if episode is None else episode.meta.job.task.control_hz,
    )


def mesh(request: Request) -> Response:
    """Answers with the mesh of a scene; its URL on the page contains a version, so browsers can cache it."""
    package = package_named(context_of(request), request.path_params["name"])
    with _making:  # encoding takes a second; other requests for the same mesh wait
        data = _encode(package)
    return Response(data, media_type="model/gltf-binary", headers={"cache-control": "private, max-age=86400"})


def _poses(episode: Episode) -> str:
    """Returns `x,y,yaw` of each step in metres and radians, separated by spaces."""
    rows = np.column_stack([episode.poses[:, :2], yaw_of(episode.poses)])
    return " ".join(f"{x:.3f},{y:.3f},{yaw:.4f}" for x, y, yaw in rows.tolist())


@functools.lru_cache(maxsize=_KEPT)
def _encode(package: ScenePackage) -> bytes:
    return encode_glb(package.scene())
