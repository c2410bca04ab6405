"""A renderer in a separate process: same bytes, no graphics library in the caller, failures and shutdown."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from schemas.config import CameraConfig
from schemas.errors import UsageError, WorldError
from schemas.frame import Frame
from schemas.terms import RendererKind
from tests.builders.fresh_process import in_fresh_process
from tests.builders.process_state import children_of, is_gone
from tests.builders.scene import Box, box_room, build_scene
from workers.geometry.pose import Pose
from workers.render import Renderer
from workers.render.choose import open_renderer

CAMERA = CameraConfig()
POSES = [Pose.planar(0.1 * k - 0.3, 0.05 * k, 0.9 * k) for k in range(6)]
KINDS = [pytest.param("gl", marks=pytest.mark.gl), pytest.param("tiny")]
LIBRARIES = ("libEGL", "libLLVM", "_dri.so", "libgallium")
REMEDIES = "'spawn' or 'forkserver'|open it in the process that uses it"


def digest(frame: Frame) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in (frame.rgb, frame.depth, frame.ids))).hexdigest()


@contextmanager
def opened_with_pid(kind: RendererKind = "tiny") -> Iterator[tuple[Renderer, int]]:
    """Opens a renderer in a separate process; yields the renderer and its process id."""
    before = children_of(os.getpid())
    with open_renderer(kind, apart=True) as renderer:
        (pid,) = children_of(os.getpid()) - before
        yield renderer, pid


def wait_until(is_so: Callable[[], bool]) -> bool:
    for _ in range(600):
        if is_so():
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_bit_identical_to_those_of_the_in_process_renderer(kind: RendererKind) -> None:
    boxes = [Box((2, -1, 0), (3, 1, 1), (200, 30, 30)), Box((1, 0, 0), (2, 1, 2), (30, 30, 200))]
    scenes = [box_room(), *(build_scene([box]) for box in boxes)]
    with open_renderer(kind) as here, open_renderer(kind, apart=True) as apart:
        assert apart.description == here.description
        for scene in (*scenes, *scenes):  # more scenes than the cache keeps
            for renderer in (here, apart):
                renderer.load(scene, CAMERA)
            for pose in POSES[:3]:
                assert digest(apart.render(pose)) == digest(here.render(pose))
                assert digest(apart.render(pose, 48)) == digest(here.render(pose, 48))
                found, wanted = apart.render_depth_and_ids(pose), here.render_depth_and_ids(pose)
                np.testing.assert_array_equal(found.depth, wanted.depth)
                np.testing.assert_array_equal(found.ids, wanted.ids)


@pytest.mark.gl
@pytest.mark.parametrize(("apart", "loaded"), [(True, False), (False, True)])
def test_only_an_in_process_renderer_loads_the_graphics_driver(apart: bool, loaded: bool) -> None:
    """A driver that this process has not loaded cannot conflict with other libraries and cannot break in a fork."""
    program = f"""
from schemas.config import CameraConfig
from tests.builders.scene import box_room
from workers.geometry.pose import Pose
from workers.render.choose import open_renderer
with open_renderer("gl", apart={apart}) as renderer:
    renderer.load(box_room(), CameraConfig())
    renderer.render(Pose.planar(0.0, 0.0, 0.0))
    mapped = open("/proc/self/maps").read()
print(any(name in mapped for name in {LIBRARIES}))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(loaded)]


def test_a_process_that_dies_is_reported_with_its_signal() -> None:
    with opened_with_pid() as (renderer, pid):
        renderer.load(box_room(), CAMERA)
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(WorldError, match="rendering process died: killed by SIGKILL"):
            renderer.render(POSES[0])
        with pytest.raises(UsageError, match="closed: open another one"):
            renderer.render(POSES[0])


def test_close_ends_the_process_and_later_requests_are_refused() -> None:
    with opened_with_pid() as (renderer, pid):
        renderer.load(box_room(), CAMERA)
        renderer.close()
        assert is_gone(pid)
        renderer.close()
        with pytest.raises(UsageError, match="closed"):
            renderer.render(POSES[0])


def test_the_process_of_an_unclosed_renderer_ends_when_its_last_reference_is_deleted() -> None:
    before = children_of(os.getpid())
    renderer = open_renderer("tiny", apart=True)
    (pid,) = children_of(os.getpid()) - before
    del renderer
    assert is_gone(pid)


@pytest.mark.parametrize("forks", [False, True])
def test_the_process_ends_when_its_caller_is_killed_even_if_a_fork_survives(forks: bool) -> None:
    program = f"""
import os, time
from workers.render.choose import open_renderer
renderer = open_renderer("tiny", apart=True)
fork = os.fork() if {forks} else 0
if {forks} and fork == 0:
    time.sleep(600)
print(fork, flush=True)
time.sleep(600)
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as caller:
        assert caller.stdout is not None
        fork = int(caller.stdout.readline())
        (pid,) = children_of(caller.pid) - {fork}
        caller.kill()
        try:
            assert wait_until(lambda: is_gone(pid))
            assert not forks or not is_gone(fork)
        finally:
            for each in {pid, fork} - {0}:
                if not is_gone(each):
                    os.kill(each, signal.SIGKILL)


def test_a_missing_driver_is_an_error_for_gl_and_selects_the_fallback_for_auto(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nowhere.json")
    with pytest.raises(WorldError, match=r"OpenGL 4\.5 with EGL is not available"):
        open_renderer("gl", apart=True)
    with open_renderer("auto", apart=True) as renderer:
        assert "Tiny" in renderer.description


@pytest.mark.parametrize("size", [0, -1, 2049])
def test_an_invalid_frame_size_is_refused(size: int) -> None:
    with pytest.raises(UsageError, match=f"frame size {size} is not valid: choose 1 to 2048"):
        open_renderer("tiny", size, apart=True)


def test_an_interrupted_frame_is_not_returned_for_the_next_request() -> None:
    def interrupt(_signal: int, _frame: Any) -> None:
        raise KeyboardInterrupt

    former = signal.signal(signal.SIGALRM, interrupt)
    try:
        with open_renderer("tiny", apart=True) as renderer, open_renderer("tiny") as here:
            for each in (renderer, here):
                each.load(box_room(), CAMERA)
            signal.setitimer(signal.ITIMER_REAL, 0.02)
            with pytest.raises(KeyboardInterrupt):
                renderer.render(POSES[1], 2048)  # takes seconds
            assert digest(renderer.render(POSES[2], 96)) == digest(here.render(POSES[2], 96))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, former)


def in_a_fork(act: Callable[[], object]) -> str:
    """Returns the exception or the result of an action in a fork of this process."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)

    def run() -> None:
        try:
            theirs.send(str(act()))
        except Exception as error:  # noqa: BLE001 - returned to the test
            theirs.send(f"{type(error).__name__}: {error}")

    process = context.Process(target=run)
    process.start()
    assert ours.poll(120), "hangs"
    said = str(ours.recv())
    process.join(30)
    assert process.exitcode == 0
    return said


@pytest.mark.parametrize("apart", [True, pytest.param(False, marks=pytest.mark.gl)])
def test_a_renderer_is_refused_in_a_fork_and_works_in_the_parent(apart: bool) -> None:
    with open_renderer("tiny" if apart else "gl", apart=apart) as renderer:
        renderer.load(box_room(), CAMERA)
        before = digest(renderer.render(POSES[1]))
        for act in (
            lambda: renderer.render(POSES[1]),
            lambda: renderer.render_depth_and_ids(POSES[1]),
            lambda: renderer.load(box_room(), CAMERA),
        ):
            said = in_a_fork(act)
            assert said.startswith("UsageError: this renderer was opened by process"), said
            assert any(remedy in said for remedy in REMEDIES.split("|"))
        assert in_a_fork(renderer.close) == "None"
        assert digest(renderer.render(POSES[1])) == before


def render_here_and_in_forks() -> None:
    with open_renderer("gl") as renderer:
        renderer.load(box_room(), CAMERA)
        before = digest(renderer.render(POSES[1]))

    def draw(apart: bool) -> str:
        with open_renderer("gl", apart=apart) as mine:
            mine.load(box_room(), CAMERA)
            return digest(mine.render(POSES[1]))

    assert "multiprocessing context 'spawn'" in in_a_fork(lambda: draw(apart=False))
    assert in_a_fork(lambda: draw(apart=True)) == before


@pytest.mark.gl
def test_a_fork_of_a_process_that_has_rendered_can_render_only_in_a_separate_process() -> None:
    in_fresh_process(render_here_and_in_forks)
