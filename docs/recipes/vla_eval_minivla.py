"""MiniVLA-Nav as a benchmark of allenai's vla-eval, whose orchestrator runs the simulator and whose model servers act.

pip install vla-eval 'PATH_OF_A_CLONE[eval]'; then, from the folder of this file (vla_eval.yaml names the dataset):

    vla-eval run --config vla_eval.yaml --no-docker

Each evaluation episode is a task, so the results name episodes. A model server gets `images["front"]`, `depth` and
`task_description`, and answers with `actions` (v, w). If a model returns several actions, its server sends them
one at a time.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, DimSpec

from factory.gym.env import MiniVLANavEnv

__all__ = ["MiniVLANav"]


class MiniVLANav(StepBenchmark):
    """Evaluation episodes of a dataset, one after the other in one process.

    Args:
        data: directory of the dataset.
        split: one or more splits, separated by commas.
        specs: file of `factory eval specs`, used instead of `split`.
        size: width and height of the images, pixels.
        send_depth: whether observations contain depth.
    """

    render_backends: ClassVar[frozenset[str]] = frozenset({"cpu", "gpu"})

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:  # noqa: ARG003
        """Returns no settings, because the renderer uses the first device of EGL (a GPU or llvmpipe)."""
        return {}

    def __init__(
        self,
        data: str,
        split: str = "test_id",
        specs: str | None = None,
        size: int = 320,
        send_depth: bool = True,
    ) -> None:
        super().__init__()
        self._env = MiniVLANavEnv(data, split=split, specs=specs, size=size)
        self._send_depth = send_depth

    def get_tasks(self) -> list[dict[str, Any]]:
        """Returns one task for each evaluation episode."""
        return [
            {"name": spec.spec_id, "suite": str(spec.split), "scene": spec.scene, "category": spec.category}
            for spec in self._env.specs.specs
        ]

    def reset(self, task: dict[str, Any]) -> dict[str, Any]:
        """Starts the episode of a task and returns its first observation."""
        observation, self._info = self._env.reset(options={"episode": task["name"]})
        return observation

    def step(self, action: dict[str, Any]) -> StepResult:
        """Executes one action (v, w)."""
        twist = np.asarray(action["actions"], np.float32).reshape(-1)[:2]
        observation, reward, terminated, truncated, self._info = self._env.step(twist)
        return StepResult(obs=observation, reward=reward, done=terminated or truncated, info=self._info)

    def make_obs(self, raw_obs: dict[str, Any], task: dict[str, Any]) -> dict[str, Any]:  # noqa: ARG002
        """Returns the observation for a model server."""
        sent = {"images": {"front": raw_obs["rgb"]}, "task_description": raw_obs["instruction"]}
        return {**sent, "depth": raw_obs["depth"]} if self._send_depth else sent

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:  # noqa: ARG002
        """Returns the measures of an episode; `spl` is 0 if the episode did not end."""
        info = self._info
        return {
            "success": bool(info["success"]),
            "spl": float(info.get("spl", 0.0)),
            "navigation_error_m": float(info["distance_m"]),
            "collision": info["end_reason"] == "collision",
        }

    def get_metric_keys(self) -> dict[str, str]:
        """Returns the function with which vla-eval aggregates each measure over episodes."""
        return {"success": "mean", "spl": "mean", "navigation_error_m": "mean", "collision": "mean"}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Returns the action specification."""
        about = "v in m/s, 0 to 1, and w in rad/s, -1.5 to 1.5, at 60 Hz"
        return {"base": DimSpec("base", 2, "twist_v_mps_w_rps", (-1.5, 1.5), description=about)}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Returns the observation specification."""
        return {"image": IMAGE_RGB, "language": LANGUAGE}

    def get_metadata(self) -> dict[str, Any]:
        """Returns the step limit of the task, after which the environment ends an episode itself."""
        return {"max_steps": self._env.specs.settings.task.max_steps}

    def get_hold_action(self, last_action: dict[str, Any] | None) -> dict[str, Any]:  # noqa: ARG002
        """Returns the action that stops the robot, because repeating the last one would continue the motion."""
        return {"actions": np.zeros(2, np.float32)}

    def cleanup(self) -> None:
        """Closes simulator and renderer."""
        self._env.close()
