"""Entry point of the rendering process (`python -P -m workers.render.process_child`), which serves one caller.

The process exits when its caller exits. It does not simulate and imports no code of the user.
"""

from __future__ import annotations

import argparse
import faulthandler
import functools
import io
import os
import sys
import traceback
from typing import Annotated

from pydantic import Field, TypeAdapter

from schemas.errors import FactoryError, UsageError
from schemas.rig import Camera
from schemas.scene import decode_scene
from workers.process.pipes import listen, take_stdout
from workers.render import Renderer
from workers.render.choose import open_renderer
from workers.render.process_wire import FrameMemory, RenderRequest, Reply, ReplyKind, RequestKind, to_line

_CAMERAS: TypeAdapter[Camera] = TypeAdapter(Annotated[Camera, Field(discriminator="model")])


def main() -> int:
    """Serves requests until the caller closes the connection or dies; returns the exit code."""
    parser = argparse.ArgumentParser(prog="workers.render.process_child", description="Renders frames for one process.")
    parser.add_argument("--renderer", choices=("auto", "gl", "tiny"), required=True)
    parser.add_argument("--size", type=int, required=True, help="Default width and height of frames, pixels.")
    parser.add_argument("--kept-scenes", type=int, required=True, help="Number of scenes that stay prepared.")
    parser.add_argument("--frames", type=int, required=True, help="File descriptor of the frame memory.")
    parser.add_argument("--scenes", type=int, required=True, help="File descriptor of the scene memory.")
    arguments = parser.parse_args()
    faulthandler.enable()
    out, lines = take_stdout(), listen(0)
    try:
        with open_renderer(arguments.renderer, arguments.size, kept_scenes=arguments.kept_scenes) as renderer:
            server = _Server(renderer, FrameMemory(arguments.frames), arguments.scenes)
            out.write(to_line(Reply(number=0, detail=renderer.description)))
            while True:
                out.write(to_line(server.serve(RenderRequest.model_validate_json(lines.get()))))
    except (BrokenPipeError, ConnectionResetError):
        return 0  # the caller has exited
    except FactoryError as error:
        out.write(to_line(_failure(0, error)))
        return 1


class _Server:
    """Server of requests; stores the packages of scenes, which are small, until the caller drops them."""

    def __init__(self, renderer: Renderer, frames: FrameMemory, scene_descriptor: int) -> None:
        self._renderer, self._frames, self._scene_descriptor = renderer, frames, scene_descriptor
        self._packages: dict[int, bytes] = {}

    def serve(self, request: RenderRequest) -> Reply:
        """Executes a request and returns its reply, which contains the error if there was one."""
        try:
            self._execute(request)
        except Exception as error:  # noqa: BLE001 - the worker loop: the caller raises it
            if not isinstance(error, FactoryError):
                traceback.print_exc()
            return _failure(request.number, error)
        return Reply(number=request.number)

    def _execute(self, request: RenderRequest) -> None:
        match request.kind:
            case RequestKind.STORE:
                self._packages[request.scene] = self._read_package()
            case RequestKind.DROP:
                self._packages.pop(request.scene, None)
            case RequestKind.LOAD:
                package = self._packages[request.scene]
                self._renderer.load_by_key(request.scene, lambda: decode_scene(io.BytesIO(package)), request.camera)
            case RequestKind.RENDER:
                self._frames.put(self._renderer.render(request.pose, request.size))
            case RequestKind.DEPTH_AND_IDS:
                self._frames.put(self._renderer.render_depth_and_ids(request.pose))
            case RequestKind.CAMERA:
                self._frames.put(self._renderer.render_camera(_parse_camera(request.sensor), request.pose))

    def _read_package(self) -> bytes:
        with os.fdopen(self._scene_descriptor, "rb", closefd=False) as file:
            file.seek(0)
            return file.read()


@functools.lru_cache(maxsize=64)
def _parse_camera(text: str) -> Camera:
    return _CAMERAS.validate_json(text)


def _failure(number: int, error: Exception) -> Reply:
    if not isinstance(error, FactoryError):
        detail = traceback.format_exception_only(error)[-1].strip()
        return Reply(number=number, kind=ReplyKind.DEFECT, detail=detail)
    kind = ReplyKind.USAGE if isinstance(error, UsageError) else ReplyKind.WORLD
    return Reply(number=number, kind=kind, detail=str(error))


if __name__ == "__main__":
    status = main()
    sys.stderr.flush()
    os._exit(status)  # a normal exit would wait for the thread that reads requests
