"""Opens a `vlnce` export with Habitat's VLN loader and compares it with the paper's tree of the same dataset.

Runs in a separate environment (Python 3.11, habitat-lab 0.3.3, trimesh; see `make test-formats`), does not import this
project, and exits with code 1 at the first failed check. The simulator has no wheel. Empty modules replace the three
modules of habitat-lab that cannot be imported without the simulator; none of them reads episodes. trimesh opens the
scenes. VLN-CE's `VLNCEDatasetV1` parses files like the loader tested here.

    python tests/readers/habitat_reader.py PAPER EXPORT

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to vlnce`.
"""

import gzip
import json
import math
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from omegaconf import DictConfig
from paper_tree import Paper
from result import named, print_row


def stand_in(module: str, **names: Any) -> None:
    sys.modules[module] = types.ModuleType(module)
    vars(sys.modules[module]).update(names)


stand_in("habitat.sims.habitat_simulator.object_state_machine", ObjectStateMachine=object)
stand_in("habitat.core.vector_env", ThreadedVectorEnv=object, VectorEnv=object)
stand_in("habitat.tasks.rearrange", _try_register_rearrange_task=lambda: None)
from habitat.datasets.utils import VocabDict  # noqa: E402
from habitat.datasets.vln.r2r_vln_dataset import VLNDatasetV1  # noqa: E402
from habitat.tasks.nav.nav import PointGoalSensor  # noqa: E402
from habitat.utils.geometry_utils import quaternion_from_coeff, quaternion_rotate_vector  # noqa: E402

FLOOR_M = 0.1
"""Maximum vertical distance of a start from the lowest point of its scene, metres."""


def main() -> None:
    paper, export = Paper(Path(sys.argv[1])), Path(sys.argv[2])
    scenes: dict[str, list[Any]] = {}
    for folder in sorted(path.parent for path in export.glob("*/*_gt.json.gz")):
        data = load(export, folder.name)
        paths = json.loads(gzip.decompress((folder / f"{folder.name}_gt.json.gz").read_bytes()))
        for episode in data.episodes:
            check_episode(paper, episode, data.instruction_vocab, folder.name)
            check_paths(paper, episode, paths)
            check_actions(episode, paths)
            scenes.setdefault(episode.scene_id, []).append(episode)
        check_choice(export, folder.name, data)
        print_row(
            export,
            named("habitat-lab"),
            f"{len(data.episodes)} episodes of {folder.name} with starts, goals, paths and actions",
        )
    names = {episode.info["minivla_episode_id"] for found in scenes.values() for episode in found}
    assert names == {path.name for path in paper.episodes.iterdir()}
    for path, episodes in scenes.items():
        print_row(export, named("trimesh"), check_scene(Path(path), episodes))


def load(export: Path, split: str, scenes: tuple[str, ...] = ("*",)) -> VLNDatasetV1:
    return VLNDatasetV1(configuration(export, split, scenes))


def configuration(export: Path, split: str, scenes: tuple[str, ...] = ("*",)) -> DictConfig:
    return DictConfig(
        {
            "data_path": str(export / "{split}/{split}.json.gz"),
            "scenes_dir": str(export / "scene_datasets"),
            "split": split,
            "content_scenes": list(scenes),
        }
    )


def check_episode(paper: Paper, episode: Any, words: VocabDict, split: str) -> None:
    """Checks start, goal and instruction of the episode with Habitat's geometry."""
    meta = paper.meta(episode.info["minivla_episode_id"])
    x, y, _ = meta["target_centroid_m"]
    pose = paper.array(meta["episode_id"], "poses")[0].astype(np.float64)
    yaw = math.atan2(2 * (pose[3] * pose[6] + pose[4] * pose[5]), 1 - 2 * (pose[5] ** 2 + pose[6] ** 2))
    turn = quaternion_from_coeff(episode.start_rotation)
    ahead = quaternion_rotate_vector(turn, np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(ahead, (math.cos(yaw), 0.0, -math.sin(yaw)), atol=1e-6)
    (goal,) = episode.goals
    sensor = PointGoalSensor.__new__(PointGoalSensor)
    sensor._goal_format, sensor._dimensionality = "POLAR", 2
    distance, bearing = sensor._compute_pointgoal(np.array(episode.start_position), turn, np.array(goal.position))
    assert abs(distance - math.hypot(x - pose[0], y - pose[1])) < 1e-4
    expected = math.atan2(y - pose[1], x - pose[0]) - yaw
    assert abs(math.remainder(bearing - expected, 2 * math.pi)) < 1e-4, f"{bearing} rad, expected {expected}"
    assert goal.radius == meta["job"]["task"]["success_radius_m"]
    assert episode.info["split"] == split == meta["job"]["split"]
    instruction = episode.instruction
    assert instruction.instruction_text == meta["job"]["instruction"]
    read = words.token_idx_2_string(instruction.instruction_tokens).removesuffix(" ?")
    assert read.replace(" .", ".") == instruction.instruction_text.lower(), read


def check_paths(paper: Paper, episode: Any, paths: dict[str, Any]) -> None:
    """Checks that the nDTW path contains every pose, and that the reference path has the same start and end."""
    poses = paper.array(episode.info["minivla_episode_id"], "poses").astype(np.float64)
    expected = np.column_stack([poses[:, 0], poses[:, 2], -poses[:, 1]])
    locations = np.array(paths[str(episode.episode_id)]["locations"])
    np.testing.assert_allclose(locations, expected, atol=1e-6)
    np.testing.assert_allclose(np.array(episode.reference_path)[[0, -1]], expected[[0, -1]], atol=1e-6)


def check_actions(episode: Any, paths: dict[str, Any]) -> None:
    """Executes the discrete actions with Habitat's rotations; the agent must end in the success region."""
    place, turn = np.array(episode.start_position), quaternion_from_coeff(episode.start_rotation)
    actions = paths[str(episode.episode_id)]["actions"]
    assert actions[-1] == 0
    assert 0 not in actions[:-1]
    for action in actions[:-1]:
        if action == 1:
            place = place + quaternion_rotate_vector(turn, np.array([0.0, 0.0, -0.25]))
        else:
            half = math.radians(7.5 if action == 2 else -7.5)  # about y, which is up
            turn = turn * quaternion_from_coeff([0.0, math.sin(half), 0.0, math.cos(half)])
    distances = [math.hypot(*(np.array(goal.position) - place)[[0, 2]]) for goal in episode.goals]
    assert min(distances) <= episode.goals[0].radius, f"{min(distances):.3f} m"


def check_choice(export: Path, split: str, data: VLNDatasetV1) -> None:
    """Checks that Habitat loads the episodes of single scenes and iterates over all episodes."""
    names = VLNDatasetV1.get_scenes_to_load(configuration(export, split))
    parts = [load(export, split, (name,)) for name in names]
    assert sorted(len(part.episodes) for part in parts) == sorted(
        len(data.get_scene_episodes(s)) for s in data.scene_ids
    )
    assert sum(len(part.episodes) for part in parts) == len(data.episodes)
    iterator = data.get_episode_iterator(cycle=False, shuffle=False)
    assert len({episode.episode_id for episode in iterator}) == len(data.episodes)


def check_scene(path: Path, episodes: list[Any]) -> str:
    """Checks that the mesh loads with its textures, that starts are on the floor and paths are within the walls."""
    scene = trimesh.load(path, force="scene")
    meshes = list(scene.geometry.values())
    triangles = sum(len(mesh.faces) for mesh in meshes)
    textured = [mesh for mesh in meshes if "uv" in mesh.visual.vertex_attributes]
    assert triangles > 1000
    assert all(mesh.visual.material.baseColorTexture is not None for mesh in textured)
    low, high = scene.bounds
    for episode in episodes:
        for point in (episode.start_position, episode.goals[0].position, *episode.reference_path):
            assert low[0] < point[0] < high[0], point
            assert low[2] < point[2] < high[2], point
        assert abs(episode.start_position[1] - low[1]) < FLOOR_M, f"start at {episode.start_position}, floor {low[1]}"
    return f"{path.name}: {triangles} triangles, {len(textured)} textures, {len(episodes)} starts on its floor"


if __name__ == "__main__":
    main()
