"""Labels from recorded commands: the frame at which stopping begins, and the command at the end of the hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factory.train.frames import (
    JoinedPictures,
    Pictures,
    chosen_frames,
    corrected_frames,
    label_corrections,
    label_episode,
    stop_frame,
)
from schemas.bundle import Corrections
from schemas.config import RobotConfig
from schemas.measure import StopLabel

HZ, BRAKING = 60, RobotConfig().max_braking_mps2


def drive() -> NDArray[np.float32]:
    """Returns a drive that accelerates at 2.5 m/s2, slows down with the distance, brakes at 8 m/s2 and stops for six
    steps."""
    up = np.arange(1, 24) * 2.5 / HZ
    sinking = np.linspace(up[-1], 0.70, 60)
    braking = np.clip(0.70 - np.arange(1, 7) * 8 / HZ, 0, None)
    speed = np.concatenate([up, sinking, braking, np.zeros(6)])
    return np.stack([speed, np.linspace(0.5, 0.0, len(speed))], axis=1).astype(np.float32)


def test_stop_begins_with_the_braking() -> None:
    assert stop_frame(drive(), BRAKING, HZ) == 23 + 60


def test_an_episode_that_never_stops_has_no_stop_label() -> None:
    assert stop_frame(drive()[:50], BRAKING, HZ) == 50


def test_a_halt_during_the_drive_is_not_labelled_as_a_stop() -> None:
    twice = np.concatenate([drive(), drive()])
    assert stop_frame(twice, BRAKING, HZ) == len(drive()) + 23 + 60


def test_a_stationary_episode_is_labelled_as_a_stop_throughout() -> None:
    assert stop_frame(np.zeros((8, 2), np.float32), BRAKING, HZ) == 0


def test_frames_are_denser_at_the_end() -> None:
    frames = chosen_frames(100, 6)
    assert frames[:3].tolist() == [0, 6, 12]
    assert {70, 72, 74, 98} <= set(frames.tolist())
    assert len(set(frames.tolist())) == len(frames)
    assert frames.max() < 100


def goals(steps: int) -> NDArray[np.float32]:
    """Returns places of the target whose distances are the numbers of the steps."""
    return np.stack([np.arange(steps), np.zeros(steps)], axis=1).astype(np.float32)


def test_short_episodes_use_every_frame() -> None:
    assert chosen_frames(5, 6).tolist() == [0, 2, 4]


def test_a_label_is_the_command_at_the_end_of_the_hold() -> None:
    actions = drive()
    frames = np.array([0, 12, 80, 84])
    labels = label_episode(actions, frames, stop=83, hold=6, goal=goals(len(actions)))
    assert labels.is_stop.tolist() == [False, False, False, True]
    assert labels.goal[:, 0].tolist() == frames.tolist(), "the place of the target at the frame itself"
    assert np.array_equal(labels.actions[0], actions[5])
    assert np.array_equal(labels.actions[1], actions[17])
    assert np.array_equal(labels.actions[2], actions[82]), "the hold ends before the braking"
    assert labels.actions[3].tolist() == [0.0, 0.0]


def test_stops_by_success_replace_those_of_the_expert() -> None:
    actions, frames = drive(), np.array([0, 60, 80, 84, 90])
    when = np.zeros(len(actions), np.uint8)
    when[70:85], when[85:] = StopLabel.EITHER, StopLabel.STOP
    labels = label_episode(actions, frames, stop=83, hold=6, goal=goals(len(actions)), when=when)
    assert labels.is_stop.tolist() == [False, False, False, False, True]
    assert labels.has_stop.tolist() == [True, True, False, False, True]
    assert labels.has_twist.tolist() == [True, True, True, False, False], "a braking expert gives no label"
    assert not labels.actions[4].any()


def test_corrections_have_the_labels_of_the_planner_and_more_stops_at_the_end() -> None:
    steps = 60
    wanted = np.full((steps, 2), np.nan, np.float32)
    wanted[::6] = (0.5, -0.25)
    wanted[54] = 0.0
    when = np.zeros(steps, np.uint8)
    when[42:50], when[50:] = StopLabel.EITHER, StopLabel.STOP
    corrections = Corrections(wanted, np.ones(steps, np.uint8), np.zeros(steps, np.float32))
    frames = corrected_frames(corrections, when)
    assert frames.tolist() == [0, 6, 12, 18, 24, 30, 32, 34, 36, 38, 40, 42, 48, 50, 52, 54, 56, 58]
    labels = label_corrections(corrections, frames, when, goals(steps))
    assert np.isfinite(labels.actions).all()
    by_frame = {int(frame): row for row, frame in enumerate(frames)}
    assert labels.has_twist[by_frame[0]]
    assert labels.has_stop[by_frame[0]]
    assert not labels.has_twist[by_frame[32]], "no label of the planner"
    assert labels.has_twist[by_frame[48]]
    assert not labels.has_stop[by_frame[48]], "both answers are right"
    assert labels.is_stop[by_frame[54]]
    assert not labels.has_twist[by_frame[54]]


def test_joined_pictures_return_the_rows_of_their_parts_in_the_requested_order() -> None:
    def part(count: int, first: int) -> Pictures:
        pictures = Pictures.empty(count, 8)
        for row in range(count):
            pictures.rgb[row], pictures.depth[row], pictures.mask[row] = first + row, first + row, first + row
        return pictures

    joined = JoinedPictures([(part(3, 0), 3), (part(4, 3), 4), (part(2, 7), 2)])
    for rows in ([8, 0, 3, 6, 2, 7], [4], [1, 0]):
        taken = joined.take(np.array(rows))
        assert taken.depth[:, 0, 0].tolist() == rows
        assert taken.rgb[:, 0, 0, 0].tolist() == rows
