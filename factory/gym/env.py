"""Gymnasium environment of the task: episodes of a dataset or of evaluation specs, one action in each control period.

Uses the simulator of collection and `factory eval`, with the same physics, camera, slew limit and end conditions.
Contains no physics itself.
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

from factory.dataset.reader import Dataset
from factory.eval.driving import measure
from factory.eval.driving.live_view import (
    RigSensors,
    SensorArrays,
    live_appearance,
    live_arrays,
    live_state,
    require_live,
)
from factory.eval.driving.measure import odometry
from factory.eval.driving.simulator import Simulator
from factory.eval.models.spec import EvalSpec, SpecSet, read_specs
from factory.eval.specs.from_dataset import LoadedScenes, specs_of_dataset, splits_of
from factory.gym.instruction import InstructionKind, encode_instruction, instruction_space, words_for
from schemas.appearance import Appearance
from schemas.encoding.arrays import ArraySpec
from schemas.encoding.image_sizes import FRAME_SIZE_PX, MAX_SIZE_PX
from schemas.errors import UsageError
from schemas.rig import Rig
from schemas.rig.rig_file import load_rig
from schemas.storage.place import Place, place_of
from schemas.support.geometry import STATE_NAMES
from schemas.support.suggest import did_you_mean
from schemas.terms import EndReason, RendererKind, Split
from schemas.tokens import GRID_POINTS, actions_of
from workers.experts.observation import Observation
from workers.geometry.slew import Twist
from workers.sim.context import SimulationContext

_UNBOUNDED = {"f": 1e9, "i": 2**53}
"""Bound of a box for values without a limit, by kind of NumPy type. Gymnasium's checker warns of infinite bounds."""


def live_rig(rig: str | Path | Rig, control_hz: int) -> Rig:
    """Returns a rig that can be measured during a drive.

    Raises:
        UsageError: The rig does not exist, has optical flow, or a package of a sensor is not installed.
        InvalidRig: The rig has mistakes, or a rate does not divide the control rate.
    """
    chosen = rig if isinstance(rig, Rig) else load_rig(str(rig), control_hz)
    require_live(chosen, control_hz)
    return chosen


def rig_spaces(rig: Rig) -> dict[str, spaces.Space[Any]]:
    """Returns the box of each array of a rig; arrays of instance ids are omitted."""
    return {spec.name: _box(spec) for sensor in rig.sensors for spec in live_arrays(sensor).values()}


def flat(measured: SensorArrays) -> dict[str, NDArray[Any]]:
    """Returns the arrays of all sensors by the keys of `rig_spaces`."""
    return {f"{sensor}/{name}": array for sensor, arrays in measured.items() for name, array in arrays.items()}


def _box(spec: ArraySpec) -> spaces.Box:
    dtype = np.dtype(spec.dtype)
    most: float = np.iinfo(dtype).max if dtype.kind == "u" else _UNBOUNDED[dtype.kind]
    low, high = spec.low, spec.high
    assert not isinstance(low, tuple)
    assert not isinstance(high, tuple)
    least = 0 if dtype.kind == "u" else -most
    shape = tuple(side for side in spec.shape if side is not None)
    return spaces.Box(least if low is None else low, most if high is None else high, shape, dtype.type)


def specs_for(root: Place, split: str, specs: str | Path | SpecSet | None) -> SpecSet:
    """Returns the episodes of an environment.

    Args:
        root: Location of the dataset.
        split: One or more splits of the dataset, separated by commas; `all` for all splits with episodes.
        specs: File of specs, or a spec set, used instead of `split`.

    Raises:
        UsageError: The split does not exist, or it has no episodes.
        WorldError: The dataset or the file cannot be read.
    """
    if isinstance(specs, SpecSet):
        return specs
    if specs is not None:
        return read_specs(Path(specs))
    names = [name.strip() for name in split.split(",")]
    if names == ["all"]:
        dataset = Dataset(root)
        return specs_of_dataset(dataset, splits_of(dataset, ()))
    unknown = [name for name in names if name not in set(Split)]
    if unknown:
        raise UsageError(
            f"unknown split {', '.join(unknown)}; valid splits: {', '.join(Split)}, or all"
            f"{did_you_mean(unknown[0], Split)}"
        )
    return specs_of_dataset(Dataset(root), [Split(name) for name in names])


_FAR_AWAY_M = 10_000.0
_SUCCESS_REWARD = 10.0
"""Reward of a success, in metres of progress."""
# progress over an episode is at most the start distance (3.5 m in the tier near, 7 m in the tier mid), so a success is
# worth more than the approach to the target

GymObservation = dict[str, Any]
Info = dict[str, Any]


class MiniVLANavEnv(gymnasium.Env[GymObservation, NDArray[Any]]):
    """Gymnasium environment: drive to the object named in the instruction and stop within the success radius.

    Observations: `rgb` (size, size, 3) uint8; `depth` (size, size) float32 metres, 0 where the ray hits nothing;
    `state` (5,) float32: x, y in metres and unwrapped yaw in radians in the frame of the start pose, measured v in m/s
    and w in rad/s, as `observation.state` of exports; `instruction`, in the form given by the argument of that name;
    and, if `with_pose` is set, `pose`: x, y in metres and yaw in radians in the frame of the start pose.

    With `rig`, the latest measurement of each of its sensors replaces `rgb` and `depth`, with the key `SENSOR/ARRAY`,
    such as `front/rgb` or `scan/ranges` (docs/rigs.md#policies).

    Actions: `(v, w)` in m/s and rad/s; with `actions="scaled"`, both divided by their limits, in [0, 1] x [-1, 1], the
    range that learning libraries expect; with `actions="tokens"`, two tokens 0..6. The reward is the decrease of the
    distance to the target in metres, plus 10 for success. Success and collision terminate the episode; the step limit
    truncates it.

    Each environment starts a process that renders the frames, because the OpenGL libraries conflict with others
    (triton, a dependency of PyTorch) and do not work after a fork. It uses one core, or `LP_NUM_THREADS` threads. An
    environment works only in the process that created it; vector environments work with every multiprocessing context.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012 - required by Gymnasium
    _sensors: RigSensors | None = None
    _view: Observation | None = None

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
        rig: str | Path | Rig | None = None,
        appearance: str | Path | Appearance | None = None,
        with_state: bool = True,
    ) -> None:
        """Starts the rendering process; scenes are loaded when an episode needs them.

        Args:
            data: Dataset directory, used for its scenes and, without `specs`, its episodes. Required.
            split: One or more splits of the dataset, separated by commas; `all` for all splits with episodes.
            specs: File written by `factory eval specs`, or a spec set, used instead of `split`.
            actions: `continuous`, `scaled` or `tokens`.
            with_pose: Whether observations contain the pose.
            size: Width and height of `rgb` and `depth`, pixels. Small frames render faster. They differ from downscaled
                frames of 640 pixels: each pixel samples one ray, and texture filtering depends on the size.
            renderer: `auto`, `gl` or `tiny`.
            render_mode: `rgb_array` or `None`.
            instruction: `text`, a string of up to 256 characters; `tokens`, (16,) int64 indices of words in
                `vocabulary`, where 0 is padding after the last word and 1 is an unknown word; `none`, no
                instruction. Stable-Baselines3 requires `tokens` or `none`.
            vocabulary: Words by index, for `tokens`. Pass the vocabulary of the training to evaluate on another
                dataset. `None` uses the vocabulary of `data`, which is the same for all its splits.
            rig: Sensors of the robot: a rig, the name of a built-in one, or a TOML file. `None` is the recorded camera.
            appearance: Appearance of the scenes, drawn for each episode: ranges, the name of a built-in appearance, or
                a TOML file, without clutter. `None` shows the scenes as they were compiled.
            with_state: Whether observations contain `state`.

        Raises:
            UsageError: `data` is missing, or the value of another argument is not valid.
            InvalidRig: The rig has mistakes, or a rate does not divide the control rate.
            WorldError: The dataset cannot be read.
        """
        _require_valid(actions, size, render_mode)
        root = _root_of(data)
        self.render_mode = render_mode
        self.specs = specs_for(root, split, specs)
        self._by_id = {spec.spec_id: spec for spec in self.specs.specs}
        self._actions, self._size, self._instruction = actions, size, instruction
        self._with_pose, self._with_state = with_pose, with_state
        self.vocabulary: tuple[str, ...] = words_for(instruction, vocabulary, root)
        """Words by their index in `tokens`; empty for other kinds of instruction."""
        self.rig = None if rig is None else live_rig(rig, self.specs.settings.task.control_hz)
        """Sensors of the robot; `None` for the recorded camera."""
        self.appearance = None if appearance is None else live_appearance(appearance)
        """Appearance of the scenes."""
        self.observation_space = self._make_observation_space(size)
        self.action_space = self._make_action_space()
        self._places = LoadedScenes(root)
        self._pid = os.getpid()
        self._stage = SimulationContext(renderer, apart=True)
        self._simulator = Simulator(self._stage, self.specs.settings, self.appearance)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[GymObservation, Info]:
        """Starts an episode: a random one, or the one given by `options={"episode": ID}`.

        Raises:
            UsageError: The episode does not exist, or the environment was created before this process was forked.
        """
        self._require_own_process()
        super().reset(seed=seed)
        spec = self._choose((options or {}).get("episode"))
        with_light = self.appearance is not None and self.appearance.light is not None
        loaded = self._places.load(spec.scene, spec.scene_sha256, with_light)
        self._view = self._simulator.reset(spec, loaded)
        self._sensors = None if self.rig is None else RigSensors(self.rig, self._simulator)
        return self._observe(self._view), self._inform(self._view)

    def step(self, action: NDArray[Any]) -> tuple[GymObservation, float, bool, bool, Info]:
        """Executes one action, limited to the action range and slew limit of the robot.

        Raises:
            ValueError: The action has the wrong shape, or is not finite.
        """
        self._require_own_process()
        before = self._view
        if before is None:
            raise RuntimeError("step() was called before reset()")
        view = self._simulator.step(self._twist(action))
        self._view = view
        is_success = view.end is EndReason.SUCCESS
        reward = before.distance_m - view.distance_m + _SUCCESS_REWARD * is_success
        terminated = view.end in {EndReason.SUCCESS, EndReason.COLLISION}
        truncated = view.end is EndReason.TIMEOUT
        return self._observe(view), float(reward), terminated, truncated, self._inform(view)

    def render(self) -> NDArray[np.uint8] | None:
        """Returns the camera image, (640, 640, 3), in the render mode `rgb_array`; otherwise `None`."""
        if self.render_mode is None or self._view is None:
            return None
        return self._view.frame.rgb

    def close(self) -> None:
        """Closes the simulation and the renderer; can be called more than once."""
        self._simulator.close()
        self._stage.renderer.close()
        self._view = None

    @property
    def spec_of_episode(self) -> EvalSpec:
        """Spec of the current episode, including the goal: for evaluation, not for a policy."""
        return self._simulator.spec

    def _require_own_process(self) -> None:
        if self._pid != os.getpid():
            raise UsageError(
                f"this environment was created by process {self._pid} before a fork: create it in the process "
                "that uses it. gymnasium.make_vec(ID, num_envs=4, vectorization_mode='async', data=DIR) does so, as do "
                "AsyncVectorEnv and SubprocVecEnv with functions that call gymnasium.make"
            )

    def _make_observation_space(self, size: int) -> spaces.Dict:
        members: dict[str, spaces.Space[Any]] = {} if self.rig is None else rig_spaces(self.rig)
        if self.rig is None:
            members["rgb"] = spaces.Box(0, 255, (size, size, 3), np.uint8)
            members["depth"] = spaces.Box(0.0, self.specs.settings.camera.far_m, (size, size), np.float32)
        words = instruction_space(self._instruction, self.vocabulary)
        if words is not None:
            members["instruction"] = words
        if self._with_state:
            members["state"] = spaces.Box(-_FAR_AWAY_M, _FAR_AWAY_M, (len(STATE_NAMES),), np.float32)
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
        observation: GymObservation
        sensors = None if self._sensors is None else self._sensors.measure()
        if sensors is not None:
            observation = dict(flat(sensors))
        else:
            is_whole = self._size == FRAME_SIZE_PX
            frame = view.frame if is_whole else self._simulator.shown.renderer.render(view.pose, self._size)
            observation = {"rgb": frame.rgb, "depth": frame.depth}
        if self._instruction != "none":
            spec = self._simulator.spec
            observation["instruction"] = encode_instruction(self._instruction, spec.instruction, self.vocabulary)
        if self._with_state:
            observation["state"] = live_state(self._simulator, self.rig, sensors)
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
