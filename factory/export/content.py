"""States what each export format contains of an episode and what it loses: the table in docs/formats/README.md.

A test exports a dataset to every format and compares the names that the files contain with this table, in both
directions. Reads and writes no file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Fact(NamedTuple):
    """Part of a dataset."""

    title: str
    """Name in the table."""
    pattern: str
    """Regular expression for the names of it in an export, for the formats that lose it: no name may match."""


class Kept(NamedTuple):
    """Place of a fact in a format."""

    place: str
    """Name as the test lists it: `file:`, `column:`, `key:`, `member:`, `topic:`, `pickle:` or `feature:`; `*` is any
    text."""
    note: str = "yes"
    """Entry in the table, a word or two: `yes` if the values are exact."""


FACTS: Mapping[str, Fact] = MappingProxyType(
    {
        "colour": Fact("colour images", r"rgb|images\.front|image$|\.jpg"),
        "depth": Fact("depth images", r"(^|[/:.])depth(_front)?([/.]|$)|images\.depth"),
        "ids": Fact("id images", r"(^|[/:.])(ids|seg|seg_front)([/.]|$)"),
        "id_names": Fact("names of the ids", r"instances\.|/ids/"),
        "camera": Fact("camera of the image", r"camera_matrix|camera_pose|calibration|camera_info|camera_intrinsic"),
        "pose": Fact("poses in the world", r"(^|[/:.])(poses?|position|odom)([/.]|$)|locations"),
        "twist": Fact("measured twist", r"observation\.state|state$|/odom"),
        "action": Fact("commands v, w", r"v_mps|topic:/(action|cmd_vel)|actions_continuous|/action$|commands"),
        "tokens": Fact("action tokens", r"(^|[/:])(tokens|v_token|actions_tokens|action_tokens)|topic:/action"),
        "discrete": Fact("discrete actions", r"#\.actions$"),
        "outcome": Fact("success at the end", r"next\.|reward|is_terminal|end_reason"),
        "instruction": Fact("instruction", r"instruction|task$|tasks$"),
        "steps": Fact("sub-instructions", r"language_persistent|sub_instructions"),
        "questions": Fact("questions", r"language_events|questions"),
        "target": Fact("target id and category", r"target_id|target_category|job\.target"),
        "centroid": Fact("centroid of the target", r"centroid|goal_x_m|goals\.position"),
        "footprint": Fact("footprint of the target", r"footprint"),
        "radius": Fact("success radius", r"radius"),
        "shortest": Fact("length of the shortest path", r"geodesic"),
        "collisions": Fact("number of collisions", r"collision"),
        "split": Fact("split", r"split|file:(train|val|test)_"),
        "digest": Fact("digest of the episode", r"digest"),
        "origin": Fact("origin, to simulate it again", r"origin"),
        "scene": Fact("scene", r"\.glb|pointcloud|topic:/map|scenes/.*\.scene"),
        "attempts": Fact("failed attempts", r"attempts\.parquet"),
    }
)
"""Parts of a dataset, in the order of the table."""

_LEROBOT: Mapping[str, Kept] = {
    "camera": Kept("column:camera_matrix.front"),
    "pose": Kept("column:pose"),
    "twist": Kept("column:observation.state"),
    "action": Kept("column:action"),
    "tokens": Kept("column:tokens"),
    "outcome": Kept("column:next.success"),
    "origin": Kept("column:origin"),
}
_MCAP: Mapping[str, Kept] = {
    "id_names": Kept("key:instances.prim_path"),
    "pose": Kept("topic:/odom"),
    "twist": Kept("topic:/odom"),
    "outcome": Kept("key:rollout.end_reason"),
    "instruction": Kept("topic:/instruction"),
    "target": Kept("key:target_id"),
    "centroid": Kept("key:target_centroid_m"),
    "footprint": Kept("key:target_footprint_m"),
    "radius": Kept("key:job.task.success_radius_m"),
    "shortest": Kept("key:route.geodesic_m"),
    "collisions": Kept("key:rollout.collision_count"),
    "split": Kept("key:split"),
    "digest": Kept("key:states_digest"),
    "origin": Kept("key:origin"),
    "scene": Kept("topic:/map", "map"),
}
_INTERNNAV: Mapping[str, Kept] = {
    "instruction": Kept("key:tasks"),
    "questions": Kept("file:questions.jsonl"),
    "split": Kept("key:split"),
    "origin": Kept("key:origin"),
}
CONTENT: Mapping[str, Mapping[str, Kept]] = MappingProxyType(
    {
        "paper": {
            "colour": Kept("file:episodes/ep_#/rgb_front/#.png"),
            "depth": Kept("file:episodes/ep_#/depth_front/#.npy"),
            "ids": Kept("file:episodes/ep_#/seg_front/#.png"),
            "id_names": Kept("key:instances.prim_path"),
            "camera": Kept("key:job.camera.fov_deg", "of the plan"),
            "pose": Kept("file:episodes/ep_#/poses.npy"),
            "action": Kept("file:episodes/ep_#/actions_continuous.npy"),
            "tokens": Kept("file:episodes/ep_#/actions_tokens.npy"),
            "outcome": Kept("column:end_reason"),
            "instruction": Kept("column:instruction"),
            "questions": Kept("file:questions.jsonl"),
            "target": Kept("column:target_id"),
            "centroid": Kept("key:target_centroid_m"),
            "footprint": Kept("key:target_footprint_m"),
            "radius": Kept("key:job.task.success_radius_m"),
            "shortest": Kept("column:geodesic_m"),
            "collisions": Kept("column:collision_count"),
            "split": Kept("column:split"),
            "digest": Kept("column:content_digest"),
            "origin": Kept("file:episodes/ep_#/origin.json"),
        },
        "lerobot": {
            **_LEROBOT,
            "colour": Kept("file:videos/observation.images.front/*.mp4", "H.264"),
            "depth": Kept("file:extra/videos/depth.front/*.mp4", "12 bit"),
            "ids": Kept("column:ids.front"),
            "instruction": Kept("column:task"),
            "steps": Kept("column:language_persistent"),
            "questions": Kept("column:language_events"),
            "target": Kept("column:target_id"),
            "centroid": Kept("column:goal_x_m"),
            "shortest": Kept("column:geodesic_m"),
            "collisions": Kept("column:collision_count"),
            "split": Kept("column:split"),
            "digest": Kept("column:states_digest"),
        },
        "lerobot-v2.1": {
            **_LEROBOT,
            "colour": Kept("file:videos/chunk-#/observation.images.front/episode_#.mp4", "H.264"),
            "instruction": Kept("key:task"),
            "target": Kept("key:target_id"),
            "centroid": Kept("key:goal_x_m"),
            "shortest": Kept("key:geodesic_m"),
            "collisions": Kept("key:collision_count"),
            "split": Kept("key:split"),
            "digest": Kept("key:states_digest"),
        },
        "webdataset": {
            "colour": Kept("member:rgb.png"),
            "depth": Kept("member:depth.npy.gz"),
            "ids": Kept("member:seg.npy.gz"),
            "camera": Kept("key:cameras.front.camera_matrix"),
            "pose": Kept("key:pose"),
            "action": Kept("key:v_mps"),
            "tokens": Kept("key:v_token"),
            "instruction": Kept("key:instruction"),
            "questions": Kept("file:questions.jsonl"),
            "target": Kept("key:target_id"),
            "centroid": Kept("key:target_centroid_m"),
            "split": Kept("key:split"),
            "origin": Kept("key:origin"),
        },
        "mcap": {
            **_MCAP,
            "colour": Kept("topic:/camera/rgb"),
            "depth": Kept("topic:/camera/depth"),
            "ids": Kept("topic:/camera/ids"),
            "camera": Kept("topic:/camera/calibration"),
            "action": Kept("topic:/action"),
            "tokens": Kept("topic:/action"),
        },
        "mcap --ros2": {
            **_MCAP,
            "colour": Kept("topic:/camera/rgb/image_raw/compressed"),
            "depth": Kept("topic:/camera/depth/image_raw"),
            "ids": Kept("topic:/camera/ids/image_raw"),
            "camera": Kept("topic:/camera/depth/camera_info"),
            "action": Kept("topic:/cmd_vel"),
            "tokens": Kept("topic:/action_tokens"),
            "id_names": Kept("topic:/ids/instances"),
        },
        "gnm": {
            "colour": Kept("file:minivla_nav/ep_#/#.jpg", "JPEG"),
            "pose": Kept("pickle:position", "x, y, yaw"),
            "questions": Kept("file:questions.jsonl"),
            "split": Kept("file:data_splits/minivla_nav/train_id/traj_names.txt"),
            "origin": Kept("file:minivla_nav/ep_#/origin.json"),
        },
        "vlnce": {
            "pose": Kept("key:#.locations", "x, y, z"),
            "discrete": Kept("key:#.actions", "follow the path"),
            "instruction": Kept("key:episodes.instruction.instruction_text"),
            "steps": Kept("key:episodes.info.sub_instructions.text"),
            "target": Kept("key:episodes.info.target_id"),
            "centroid": Kept("key:episodes.info.target_centroid"),
            "radius": Kept("key:episodes.goals.radius"),
            "shortest": Kept("key:episodes.info.geodesic_distance"),
            "split": Kept("key:episodes.info.split"),
            "origin": Kept("key:episodes.info.origin"),
            "scene": Kept("file:scene_datasets/*.glb", "mesh"),
        },
        "coco": {
            "colour": Kept("file:images/ep_#/#.png"),
            "ids": Kept("key:annotations.segmentation.counts", "of objects"),
            "id_names": Kept("key:categories.name", "category"),
            "instruction": Kept("key:images.instruction"),
            "target": Kept("key:annotations.is_target"),
            "split": Kept("file:annotations/instances_*.json"),
            "origin": Kept("file:images/ep_#/origin.json"),
        },
        "navdp": {
            **_INTERNNAV,
            "colour": Kept("file:data/*/observation.images.rgb/*.jpg", "JPEG"),
            "depth": Kept("file:data/*/observation.images.depth/*.png", "to 6.55 m"),
            "camera": Kept("column:observation.camera_intrinsic"),
            "pose": Kept("column:action", "of the camera"),
            "scene": Kept("file:data/*/meta/pointcloud.ply", "points"),
        },
        "internnav": {
            **_INTERNNAV,
            "colour": Kept("file:data/*/observation.images.rgb.*.jpg", "keyframes, JPEG"),
            "depth": Kept("file:data/*/observation.images.depth.*.png", "keyframes, mm"),
            "pose": Kept("column:pose.*", "of the camera"),
            "discrete": Kept("column:action", "of keyframes"),
        },
        "rlds": {
            "colour": Kept("feature:steps/observation/image", "256 px"),
            "depth": Kept("feature:steps/observation/depth", "256 px"),
            "ids": Kept("feature:steps/observation/ids", "256 px"),
            "id_names": Kept("key:instances.prim_path"),
            "camera": Kept("feature:episode_metadata/camera_matrix"),
            "pose": Kept("feature:steps/camera_pose", "of the camera"),
            "twist": Kept("feature:steps/observation/state"),
            "action": Kept("feature:steps/action"),
            "tokens": Kept("feature:steps/action_tokens"),
            "outcome": Kept("feature:steps/is_terminal"),
            "instruction": Kept("feature:steps/language_instruction"),
            "target": Kept("feature:episode_metadata/target_id"),
            "centroid": Kept("feature:episode_metadata/target_centroid_m"),
            "split": Kept("feature:episode_metadata/split"),
            "digest": Kept("feature:episode_metadata/states_digest"),
            "origin": Kept("feature:episode_metadata/origin"),
        },
        "robomimic": {
            "colour": Kept("feature:obs/image", "256 px"),
            "depth": Kept("feature:obs/depth", "256 px"),
            "ids": Kept("feature:obs/ids", "256 px"),
            "id_names": Kept("key:instances.prim_path"),
            "camera": Kept("feature:camera_matrix"),
            "pose": Kept("feature:camera_pose", "of the camera"),
            "twist": Kept("feature:obs/state"),
            "action": Kept("feature:commands"),
            "tokens": Kept("feature:action_tokens"),
            "outcome": Kept("feature:rewards"),
            "instruction": Kept("feature:language_instruction"),
            "target": Kept("feature:target_id"),
            "centroid": Kept("feature:target_centroid_m"),
            "split": Kept("feature:split"),
            "digest": Kept("feature:states_digest"),
            "origin": Kept("feature:origin"),
        },
    }
)
"""Format, with its options, -> fact -> place. A fact that is not listed is lost."""


def losses_of(name: str) -> tuple[str, ...]:
    """Returns the titles of the facts that a format loses."""
    return tuple(fact.title for key, fact in FACTS.items() if key not in CONTENT[name])


def contradictions(name: str, found: frozenset[str]) -> list[str]:
    """Compares the table with the names that an export contains.

    Args:
        name: format, as in `CONTENT`.
        found: names that the export contains.

    Returns:
        A sentence for each fact that the table states but the export lacks, or that the export has, but not the table.
    """
    lines = []
    for key, fact in FACTS.items():
        kept = CONTENT[name].get(key)
        if kept is not None:
            pattern = re.escape(kept.place).replace(r"\*", ".*")
            if not any(re.fullmatch(pattern, each) for each in found):
                lines.append(f"{name} has no {kept.place}, the place of: {fact.title}")
        elif seen := sorted(each for each in found if re.search(fact.pattern, each)):
            lines.append(f"{name} contains {', '.join(seen[:3])}, but the table states as lost: {fact.title}")
    return lines


def content_markdown() -> str:
    """Returns the table of docs/formats/README.md: a row for each fact, a column for each format."""
    names = list(CONTENT)
    rows = [
        [fact.title, *(CONTENT[name][key].note if key in CONTENT[name] else "-" for name in names)]
        for key, fact in FACTS.items()
    ]
    lines = [["of an episode", *(f"`{name}`" for name in names)], ["---"] * (len(names) + 1), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines).replace("| --- |", "|---|").replace(" --- |", "---|")
