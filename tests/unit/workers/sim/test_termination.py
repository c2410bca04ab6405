"""How an episode ends, determined from its poses and commands."""

from __future__ import annotations

from schemas.config import TaskConfig
from schemas.terms import EndReason
from workers.sim.closed_loop import Termination

TASK = TaskConfig()


def test_success_needs_five_stationary_frames_inside_the_radius():
    termination = Termination(TASK)
    assert termination.evaluate(0.1, 0.0, 0.9, False, 0.5) is None
    ends = [termination.evaluate(0.2, 0.0, 0.9, False, 0.0) for _ in range(6)]
    assert ends == [None, None, None, None, None, EndReason.SUCCESS]


def test_a_stop_outside_the_radius_is_not_a_success():
    termination = Termination(TASK)
    assert all(termination.evaluate(0.0, 0.0, 1.01, False, 0.0) is None for _ in range(50))


def test_motion_inside_the_radius_restarts_the_hold():
    termination = Termination(TASK)
    for _ in range(4):
        assert termination.evaluate(0.0, 0.0, 0.9, False, 0.0) is None
    assert termination.evaluate(0.1, 0.0, 0.9, False, 0.0) is None
    assert [termination.evaluate(0.1, 0.0, 0.9, False, 0.0) for _ in range(5)][-1] is EndReason.SUCCESS


def test_a_stall_needs_a_command_an_obstacle_and_no_progress():
    def run(commanded: float, blocked: bool) -> EndReason | None:
        termination = Termination(TASK)
        ends = [termination.evaluate(0.0, 0.0, 5.0, blocked, commanded) for _ in range(40)]
        return next((verdict for verdict in ends if verdict), None)

    assert run(0.3, True) is EndReason.COLLISION
    assert run(0.3, False) is None
    assert run(0.0, True) is None


def test_motion_of_more_than_a_centimetre_in_the_window_is_progress():
    termination = Termination(TASK)
    assert all(termination.evaluate(0.001 * t, 0.0, 5.0, True, 0.3) is None for t in range(60))


def test_the_step_limit_is_a_timeout():
    termination = Termination(TaskConfig(max_steps=3))
    ends = [termination.evaluate(float(t), 0.0, 5.0, False, 1.0) for t in range(3)]
    assert ends == [None, None, EndReason.TIMEOUT]
