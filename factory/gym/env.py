"""The task as a Gymnasium environment: episodes of a dataset's specs, one action a control period.

Same physics, camera, slew limit and ends as collection and `factory eval`; stands on their simulator.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from factory.eval.driving import measure
from factory.eval.driving.odometry import odometry
from factory.eval.driving.simulator import Simulator
from factory.eval.models.spec import EvalSpec, SpecSet
from factory.eval.specs.from_dataset import Places
from factory.gym.episodes import specs_for
from factory.gym.instruction import InstructionKind, encode_instruction, instruction_space, words_for
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.errors import UsageError
from schemas.storage.place import Place, place_of
from schemas.terms import EndReason, RendererKind
from schemas.tokens import GRID_POINTS, actions_of
from workers.experts.observation import Observation
from workers.geometry.slew import Twist
from workers.render.process_wire import MAX_SIZE_PX
from workers.sim.scene_renderer import SceneRenderer

__all__ = ["MiniVLANavEnv"]

_FAR_AWAY_M = 10_000.0
_SUCCESS_REWARD = 10.0

GymObservation = dict[str, Any]
Info = dict[str, Any]


class MiniVLANavEnv(gymnasium.Env[GymObservation, NDArray[Any]]):
    """Drive to the named object and stop within the success radius.

    Observations: `rgb` (size, size, 3) uint8; `depth` (size, size) float32 metres, 0 where nothing was hit;
    `instruction`, as the argument of that name says; and with `with_pose` also `pose`, x, y in metres and yaw in
    radians in the frame of the start.

    Actions: `(v, w)` in m/s and rad/s; with `actions="scaled"` the same over their limits, in [0, 1] x [-1, 1], as
    learning libraries like them; with `actions="tokens"` two tokens 0..6. Reward: the metres come nearer to the target,
    and 10 for success. Terminated by success and collision, truncated by the limit of steps.

    A process that each environment starts renders the frames, because OpenGL's libraries crash others (triton, which
    PyTorch brings) and do not survive a fork. It uses one core, or as many threads as `LP_NUM_THREADS` says. An
    environment works in the process that made it; vector environments work with every multiprocessing context.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012 - the way of Gymnasium

    def __init__(
        self,
        data: str | Place | None = None,
        split: str = "train_id",
        specs: str | Path | SpecSet | None = None,
        actions: Literal["continuous", "scaled", "tokens"] = "continuous",
        with_pose: bool = False,
        size: int = FRAME_SIZE_PX,
        renderer: RendererKind = "auto",
        render_mode: str | None = None,
        instruction: InstructionKind = "text",
        vocabulary: Sequence[str] | None = None,
    ) -> None:
        """Starts a rendering process; scenes are loaded as episodes want them.

        Args:
            data: a dataset directory, for its scenes and, without `specs`, its episodes. Required.
            split: one or several of its splits, `a,b`.
            specs: a file of `factory eval specs`, or the set itself, in the place of `split`.
            actions: `continuous`, `scaled` or `tokens`.
            with_pose: whether observations have the pose.
            size: width and height at which `rgb` and `depth` are rendered, pixels. The field of view, the physics and
                the ends of episodes do not depend on it; small frames take a fraction of the time. They are not the
                frames of 640 pixels shrunk: each pixel shows one ray, and textures are smoothed for the size.
            renderer: `auto`, `gl` or `tiny`.
            render_mode: `rgb_array` or `None`.
            instruction: `text`, a string of up to 256 characters; `tokens`, (16,) int64 numbers of words in
                `vocabulary`: 0 pads behind the last word, 1 is a word that is not in the vocabulary; `none`, no
                instruction. Stable-Baselines3 needs `tokens` or `none`.
            vocabulary: the words by number, for `tokens`; for another dataset than that of the training, pass the
                training's. `None` is the vocabulary of `data`, which is the same for all its splits.

        Raises:
            UsageError: `data` is missing, or there is no such kind of actions or instruction, size or split.
            WorldError: the dataset cannot be read.
        """
        _require_valid(actions, size, render_mode)
        root = _root_of(data)
        self.render_mode = render_mode
        self.specs = specs_for(root, split, specs)
        self._by_id = {spec.spec_id: spec for spec in self.specs.specs}
        self._actions, self._with_pose, self._size = actions, with_pose, size
        self._instruction = instruction
        self.vocabulary: tuple[str, ...] = words_for(instruction, vocabulary, root)
        """The words by their number in `tokens`; empty for other kinds of instruction."""
        self.observation_space = self._make_observation_space(size)
        self.action_space = self._make_action_space()
        self._places = Places(root)
        self._pid = os.getpid()
        self._stage = SceneRenderer(renderer, apart=True)
        self._simulator = Simulator(self._stage, self.specs.settings)
        self._view: Observation | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[GymObservation, Info]:
        """Begins an episode: drawn by the environment's generator, or `options={"episode": ID}`.

        Raises:
            UsageError: there is no such episode, or the environment was made before this process was forked.
        """
        self._require_own_process()
        super().reset(seed=seed)
        spec = self._choose((options or {}).get("episode"))
        place = self._places.load(spec.scene, spec.scene_sha256)
        self._view = self._simulator.reset(spec, place)
        return self._observe(self._view), self._inform(self._view)

    def step(self, action: NDArray[Any]) -> tuple[GymObservation, float, bool, bool, Info]:
        """Carries one action out, within the robot's range and slew limit.

        Raises:
            ValueError: the action has another shape, or is not finite.
        """
        self._require_own_process()
        before = self._view
        if before is None:
            raise RuntimeError("step() before reset()")
        view = self._simulator.step(self._twist(action))
        self._view = view
        is_success = view.end is EndReason.SUCCESS
        reward = before.distance_m - view.distance_m + _SUCCESS_REWARD * is_success
        terminated = view.end in {EndReason.SUCCESS, EndReason.COLLISION}
        truncated = view.end is EndReason.TIMEOUT
        return self._observe(view), float(reward), terminated, truncated, self._inform(view)

    def render(self) -> NDArray[np.uint8] | None:
        """Returns what the camera sees, (640, 640, 3), in the render mode `rgb_array`."""
        if self.render_mode is None or self._view is None:
            return None
        return self._view.frame.rgb

    def close(self) -> None:
        """Frees world and renderer; closing twice is harmless."""
        self._simulator.close()
        self._stage.renderer.close()
        self._view = None

    @property
    def spec_of_episode(self) -> EvalSpec:
        """The running episode, goal and all: for evaluation, not for a policy."""
        return self._simulator.spec

    def _require_own_process(self) -> None:
        if self._pid != os.getpid():
            raise UsageError(
                f"this environment was created by process {self._pid} before a fork: create it in the process "
                "that uses it. gymnasium.make_vec(ID, num_envs=4, vectorization_mode='async', data=DIR) does so, as do "
                "AsyncVectorEnv and SubprocVecEnv with functions that call gymnasium.make"
            )

    def _make_observation_space(self, size: int) -> spaces.Dict:
        members: dict[str, spaces.Space[Any]] = {
            "rgb": spaces.Box(0, 255, (size, size, 3), np.uint8),
            "depth": spaces.Box(0.0, self.specs.settings.camera.far_m, (size, size), np.float32),
        }
        words = instruction_space(self._instruction, self.vocabulary)
        if words is not None:
            members["instruction"] = words
        if self._with_pose:
            reach = np.array((_FAR_AWAY_M, _FAR_AWAY_M, math.pi))
            members["pose"] = spaces.Box(-reach, reach, dtype=np.float64)
        return spaces.Dict(members)

    def _make_action_space(self) -> spaces.MultiDiscrete[np.int64] | spaces.Box:
        if self._actions == "tokens":
            return spaces.MultiDiscrete([GRID_POINTS, GRID_POINTS])
        v_mps, w_rps = self._limits if self._actions == "continuous" else (1.0, 1.0)
        return spaces.Box(np.array((0.0, -w_rps), np.float32), np.array((v_mps, w_rps), np.float32), dtype=np.float32)

    @property
    def _limits(self) -> tuple[float, float]:
        robot = self.specs.settings.robot
        return robot.max_speed_mps, robot.max_yaw_rate_rps

    def _choose(self, episode: str | None) -> EvalSpec:
        if episode is None:
            return self.specs.specs[int(self.np_random.integers(len(self.specs.specs)))]
        if episode not in self._by_id:
            raise UsageError(f"episode {episode!r} is not one of the {len(self._by_id)} selected episodes")
        return self._by_id[episode]

    def _twist(self, action: NDArray[Any]) -> Twist:
        numbers = np.asarray(action)
        if numbers.shape != (2,) or not np.isfinite(numbers.astype(np.float64)).all():
            raise ValueError(f"expected an action of two finite numbers, found {action!r}")
        if self._actions == "tokens":
            if not self.action_space.contains(numbers.astype(np.int64)):
                raise ValueError(f"expected two tokens 0 to {GRID_POINTS - 1}, found {action!r}")
            numbers = actions_of(numbers.astype(np.int16)[None])[0]
        elif self._actions == "scaled":
            numbers = numbers * np.array(self._limits)
        return Twist(float(numbers[0]), float(numbers[1]))

    def _observe(self, view: Observation) -> GymObservation:
        is_whole = self._size == FRAME_SIZE_PX
        frame = view.frame if is_whole else self._stage.renderer.render(view.pose, self._size)
        observation: GymObservation = {"rgb": frame.rgb, "depth": frame.depth}
        if self._instruction != "none":
            spec = self._simulator.spec
            observation["instruction"] = encode_instruction(self._instruction, spec.instruction, self.vocabulary)
        if self._with_pose:
            observation["pose"] = odometry(self._simulator.track)
        return observation

    def _inform(self, view: Observation) -> Info:
        spec, is_success = self._simulator.spec, view.end is EndReason.SUCCESS
        info: Info = {
            "episode_id": spec.spec_id,
            "instruction": spec.instruction,
            "success": is_success,
            "is_success": is_success,
            "end_reason": "" if view.end is None else str(view.end),
            "distance_m": view.distance_m,
            "spawn_dist_m": spec.spawn_dist_m,
            "is_touching": view.is_touching,
        }
        if view.end is not None:
            driven_m = measure.path_length_m(self._simulator.track)
            info["trajectory_length_m"] = driven_m
            if spec.geodesic_m is not None:
                info["spl"] = measure.spl(is_success, spec.geodesic_m, driven_m)
        return info


def _root_of(data: str | Place | None) -> Place:
    if data is None:
        raise UsageError(
            "data is missing: pass the directory of a dataset, gymnasium.make(ID, data='dataset'); "
            "create a dataset with `factory run demo --out dataset`"
        )
    return place_of(data)


def _require_valid(actions: str, size: int, render_mode: str | None) -> None:
    if actions not in {"continuous", "scaled", "tokens"}:
        raise UsageError(f"actions {actions!r}: choose continuous, scaled or tokens")
    if not 1 <= size <= MAX_SIZE_PX:
        raise UsageError(f"size {size}: choose 1 to {MAX_SIZE_PX} pixels, such as 64, 128 or {FRAME_SIZE_PX}")
    if render_mode not in {None, "rgb_array"}:
        raise UsageError(f"render_mode {render_mode!r}: choose rgb_array or None")
