"""Opens the requested renderer, or the best renderer of this machine.

Logs a warning when it falls back to another renderer. Does not render.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, get_args

from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import UsageError, WorldError
from schemas.support.extras import require_package
from schemas.support.stage_timer import StageTimer, no_stage_timer
from schemas.terms import RendererKind
from workers.render import Renderer
from workers.render.prepared_scenes import KEPT_SCENES

if TYPE_CHECKING:
    from workers.render.process import ProcessRenderer

_REMEDY = "20 times slower than OpenGL; on Debian: apt-get install libegl1 libgl1-mesa-dri"


def open_renderer(
    kind: RendererKind = "auto",
    size: int = FRAME_SIZE_PX,
    timer: StageTimer = no_stage_timer,
    apart: bool = False,
    kept_scenes: int = KEPT_SCENES,
) -> Renderer:
    """Opens a renderer; the caller closes it.

    Args:
        kind: type of the renderer.
        size: width and height of the frames, pixels.
        timer: called at the end of the stages `render` and `read-back` of every frame.
        apart: whether the renderer runs in a separate process. This is necessary if this process loads libraries of the
            user, which may crash together with those of OpenGL, or if it may be forked; the frames are the same.
        kept_scenes: number of scenes that stay prepared.

    Raises:
        UsageError: no renderer of that type exists.
        WorldError: `kind` is `gl` and this machine has no usable EGL driver.
    """
    if apart:
        return open_apart(kind, size, timer, kept_scenes)
    _require_kind(kind)
    if kind == "tiny":
        return _open_tiny(size, timer, kept_scenes)
    open_gl = functools.partial(_open_gl, kept_scenes=kept_scenes)
    return open_gl(size, timer) if kind == "gl" else open_first(open_gl, size, timer, kept_scenes)


def open_apart(
    kind: RendererKind = "auto",
    size: int = FRAME_SIZE_PX,
    timer: StageTimer = no_stage_timer,
    kept_scenes: int = KEPT_SCENES,
) -> ProcessRenderer:
    """Opens a renderer in a separate process; for arguments and errors see `open_renderer`."""
    _require_kind(kind)
    from workers.render.process import ProcessRenderer

    return ProcessRenderer(kind, size, timer, kept_scenes)


def open_first(
    preferred: Callable[[int, StageTimer], Renderer],
    size: int,
    timer: StageTimer = no_stage_timer,
    kept_scenes: int = KEPT_SCENES,
) -> Renderer:
    """Opens the preferred renderer; if it has no driver, logs a warning and opens TinyRenderer."""
    try:
        return preferred(size, timer)
    except WorldError as error:
        import structlog  # not at the top, where it would slow down the start of each simulation

        log = structlog.get_logger(__name__)
        log.warning("renderer_fallback", renderer="tiny", reason=str(error), remedy=_REMEDY)
        return _open_tiny(size, timer, kept_scenes)


def _require_kind(kind: RendererKind) -> None:
    if kind not in get_args(RendererKind):
        raise UsageError(f"unknown renderer {kind!r}; valid renderers: {', '.join(get_args(RendererKind))}")


def _open_gl(size: int, timer: StageTimer, kept_scenes: int) -> Renderer:
    require_package("moderngl", "the renderer gl")
    from workers.render.gl import GlRenderer

    return GlRenderer(size, timer, kept_scenes)


def _open_tiny(size: int, timer: StageTimer, kept_scenes: int = KEPT_SCENES) -> Renderer:
    require_package("pybullet", "the renderer tiny")
    from workers.render.tiny import TinyRenderer

    return TinyRenderer(size, timer, kept_scenes)
