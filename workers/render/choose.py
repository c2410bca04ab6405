"""Opens the requested renderer, or the best renderer of this machine.

Logs a warning when it falls back to another renderer. Does not render.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.errors import UsageError, WorldError
from schemas.support.extras import require_package
from schemas.support.stage_timer import StageTimer, no_stage_timer
from schemas.terms import RendererKind
from workers.render import Renderer

_REMEDY = "20 times slower than OpenGL; on Debian: apt-get install libegl1 libgl1-mesa-dri"


def open_renderer(
    kind: RendererKind = "auto", size: int = FRAME_SIZE_PX, lap: StageTimer = no_stage_timer, apart: bool = False
) -> Renderer:
    """Opens a renderer; the caller closes it.

    Args:
        kind: type of the renderer.
        size: width and height of the frames, pixels.
        lap: called at the end of the stages `render` and `read-back` of every frame.
        apart: whether the renderer runs in a separate process. This is necessary if this process loads libraries of the
            user, which may crash together with those of OpenGL, or if it may be forked; the frames are the same.

    Raises:
        UsageError: no renderer of that type exists.
        WorldError: `kind` is `gl` and this machine has no usable EGL driver.
    """
    if kind not in get_args(RendererKind):
        raise UsageError(f"unknown renderer {kind!r}; valid renderers: {', '.join(get_args(RendererKind))}")
    if apart:
        return _open_apart(kind, size, lap)
    if kind == "tiny":
        return _open_tiny(size, lap)
    if kind == "gl":
        return _open_gl(size, lap)
    return open_first(_open_gl, size, lap)


def open_first(
    preferred: Callable[[int, StageTimer], Renderer], size: int, lap: StageTimer = no_stage_timer
) -> Renderer:
    """Opens the preferred renderer; if it has no driver, logs a warning and opens TinyRenderer."""
    try:
        return preferred(size, lap)
    except WorldError as error:
        import structlog  # not at the start of each simulation, which it would slow down

        log = structlog.get_logger(__name__)
        log.warning("renderer_fallback", renderer="tiny", reason=str(error), remedy=_REMEDY)
        return _open_tiny(size, lap)


def _open_apart(kind: RendererKind, size: int, lap: StageTimer) -> Renderer:
    from workers.render.process import ProcessRenderer

    return ProcessRenderer(kind, size, lap)


def _open_gl(size: int, lap: StageTimer) -> Renderer:
    require_package("moderngl", "the renderer gl")
    from workers.render.gl import GlRenderer

    return GlRenderer(size, lap)


def _open_tiny(size: int, lap: StageTimer) -> Renderer:
    from workers.render.tiny import TinyRenderer

    return TinyRenderer(size, lap)
