"""Format `webdataset`: tar shards for streaming from disk, HTTP or the Hub; one sample per frame, shards per split.

Members are copies of the bundle's bytes if readers support their type. Readers: `webdataset` and `datasets`.
"""

from __future__ import annotations

import json
import tarfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from isal import igzip
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.base import Exporter, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.lerobot.columns import frame_columns, kept_frames
from factory.export.options import WebdatasetOptions, stride_of
from factory.export.origin import COLUMN as ORIGIN
from factory.export.origin import origin_of
from factory.export.questions import ask_questions, not_asked, questions_text
from factory.export.rig.description import intrinsics_of, optical_poses, rig_table
from factory.export.rig.reader import SensorReader, arrays_of, shown_rig
from factory.export.shards import Shard, ShardFacts, join_files, shards_of
from schemas.encoding.ndarray import encode_npy
from schemas.encoding.png import encode_png
from schemas.rig import CameraOutput, Imu, Sensor, WheelOdometry

_GZIP_LEVEL = 3
# a depth image of a warehouse takes 83 kB at level 3 of isal (2.7 ms), and 199 kB at level 1 (0.7 ms)
MEMBERS_TEXT = """\
| `<camera>.rgb.png` | 8 bit |
| `<camera>.depth.npy.gz` | float32 metres, axial or radial as `rig.json` has it, 0 where nothing was hit |
| `<camera>.ids.npy.gz` | uint16 instance ids; 0 is background |
| `<camera>.normals.npy.gz`, `<camera>.flow.npy.gz` | float32 unit normals; flow to the camera's next image, pixels |
| `<lidar>.ranges.npy.gz`, `<lidar>.ids.npy.gz` | float32 metres (lines, samples), 0 without a return; uint16 ids |
| `<imu>.motion.json` | `steps`, `angular_velocity` rad/s, `specific_force` m/s2 since the last sample |
| `<odometry>.motion.json` | `steps`, `ticks`, `poses` x, y, heading, `twists` since the last sample |
| `sensors.json` | sensor -> control step of its measurement: the latest at or before `step` |
"""
"""Rows of the card's table of members."""


def rig_members(reader: SensorReader, steps: Sequence[int]) -> Callable[[Episode, int], Iterator[tuple[str, bytes]]]:
    """Returns a function that yields suffix and bytes of each member of the sample of an exported step.

    All samples have the same suffixes, which the streaming readers require.
    """
    before = dict(zip(steps[1:], steps[:-1], strict=True))

    def members(_episode: Episode, t: int) -> Iterator[tuple[str, bytes]]:
        for sensor in reader.rig.sensors:
            yield from _members(reader, sensor, before.get(t, -1), t)
        seen = (one.name for one in reader.rig.sensors if one.name not in reader.motion)
        yield "sensors.json", json_member({name: reader.latest_step(name, t) for name in seen})

    return members


def _members(reader: SensorReader, sensor: Sensor, previous: int, t: int) -> Iterator[tuple[str, bytes]]:
    if isinstance(sensor, Imu | WheelOdometry):
        stride = reader.strides[sensor.name]
        numbers = range(previous // stride + 1, t // stride + 1)
        values = {
            name: array[numbers.start : numbers.stop] for name, array in arrays_of(reader.motion[sensor.name]).items()
        }
        steps = [stride * number for number in numbers]
        listed = {name: array.tolist() for name, array in values.items()}
        yield f"{sensor.name}.motion.json", json_member({"steps": steps} | listed)
        return
    for name, array in reader.arrays(sensor, t).items():
        if name == CameraOutput.RGB:
            yield f"{sensor.name}.{name}.png", encode_png(array)
        else:
            yield f"{sensor.name}.{name}.npy.gz", array_member(array)


def array_member(array: NDArray[np.generic]) -> bytes:
    """Returns an array as gzipped `.npy`.

    Ids are stored in this form, too, because the decoder "rgb" of webdataset converts 16-bit PNG to 8 bits and clips
    ids at 255.
    """
    return igzip.compress(encode_npy(array), _GZIP_LEVEL, mtime=0)


def json_member(values: dict[str, Any]) -> bytes:
    """Returns values as compact JSON."""
    return json.dumps(values, ensure_ascii=False, separators=(",", ":")).encode()


MEMBERS_FILE = "members.tar"
SHARDS_FILE = "shards.json"
_MEMBER_MODE = 0o644
_CARD = """
One sample per frame, in tar shards of one split each; episodes are spread over the shards of their split in a fixed
random order, and the frames of an episode are adjacent. Shuffle with a buffer of a few thousand samples.

| member | what |
|---|---|
{members}\
| `action.json` | `v_mps`, `w_rps` until the next sample (mean of the commands in between), `v_token`, `w_token` |
| `json` | instruction, episode, step, time, pose, target, split, `cameras`; `origin`: JSON from which \
`factory replay --from` simulates the episode again |

```python
import webdataset
for sample in webdataset.WebDataset("{shards}", shardshuffle=100).shuffle(2000).decode("rgb"):
    {images}, sample["json"]["instruction"], sample["action.json"]["v_mps"]
```

`cameras` of `json` has for each camera `camera_matrix` (9 values, row by row; the centre of the first pixel is 0, 0)
and `pose`, x, y, z, qw, qx, qy, qz of its optical frame (x right, y down, z forward) in the world, when it took the
image. `rig.json` has the cameras before the changes of an appearance. `shards.json` lists every shard with its samples,
episodes and bytes.
"""
_RECORDED_MEMBERS = """\
| `rgb.png` | 640 x 640, 8 bit |
| `depth.npy.gz` | float32 metres along the optical axis, 0 where nothing was hit; readers unpack it to an array |
| `seg.npy.gz` | uint16 instance ids; 0 is background |
"""
_RECORDED_IMAGES = 'sample["rgb.png"], sample["depth.npy.gz"]'


class WebdatasetExporter(Exporter[WebdatasetOptions, ShardFacts]):
    """Exporter of format `webdataset`. A piece is a tar file without the end-of-archive blocks; pieces form a shard."""

    name = "webdataset"
    about = "tar shards, one sample per frame, for webdataset and datasets streaming; lossless images"
    version = 4
    asks = True
    assembles = True
    takes_rig = True
    options = WebdatasetOptions
    facts = ShardFacts

    def write_episode(self, episode: Episode, options: WebdatasetOptions, folder: Path) -> ShardFacts:
        """Writes the members of every exported frame, in order."""
        hz = episode.meta.job.task.control_hz
        stride = stride_of(options.fps, hz)
        steps = kept_frames(len(episode), stride)
        columns = frame_columns(episode.actions, episode.poses, hz, stride)
        origin = origin_of(episode).to_json()
        reader = None if episode.rig is None else SensorReader(episode)
        members = recorded_members if reader is None else rig_members(reader, steps)
        cameras = camera_facts(episode, reader, steps)
        size = 0
        with (folder / MEMBERS_FILE).open("wb") as file:
            rows = zip(steps, columns.action.tolist(), columns.tokens.tolist(), cameras, strict=True)
            for t, action, tokens, seen_by in rows:
                facts = {**_facts(episode, t), "cameras": seen_by, ORIGIN: origin}
                for suffix, data in (*members(episode, t), *_facts_members(facts, action, tokens)):
                    write_member(file, f"{episode.episode_id}_{t:06d}.{suffix}", data)
                    size += member_bytes(len(data))
        stem = episode.episode_id
        questions = (
            ask_questions(episode, steps, lambda _, t: f"{stem}_{t:06d}.rgb.png")
            if reader is None
            else not_asked(episode)
        )
        return ShardFacts(frames=len(steps), member_bytes=size, questions=questions)

    def finish(self, export: Finish[WebdatasetOptions, ShardFacts]) -> None:
        """Joins the pieces of each split into shards; writes the list of shards and the card."""
        listed: list[dict[str, Any]] = []
        splits = list(dict.fromkeys(piece.split for piece in export.pieces))
        for split in splits:
            pieces = [piece for piece in export.pieces if piece.split == split]
            for number, shard in enumerate(shards_of(pieces, export.options.shard_mb * 1_000_000)):
                name = f"{split}-{number:06d}.tar"
                if not export.out.has(name):
                    with export.out.replacing(name) as part:
                        join_files((piece.folder / MEMBERS_FILE for piece in shard.pieces), part, _end_of_archive)
                listed.append({"name": name, "split": split, "samples": shard.samples, **_contents(shard)})
        export.out.write_text(SHARDS_FILE, json.dumps({"shards": listed}, indent=1) + "\n")
        files = {split: f"{split}-*.tar" for split in splits}
        configs = {"default": files} | {split: {"train": path} for split, path in files.items()}
        plan, rig = export.dataset.meta.plan, export.dataset.rig
        hz, shards = plan.task.control_hz, _pattern([str(one["name"]) for one in listed if one["split"] == splits[0]])
        if rig is None:
            text = _CARD.format(members=_RECORDED_MEMBERS, images=_RECORDED_IMAGES, shards=shards)
        else:
            text = _CARD.format(members=MEMBERS_TEXT, images='sample["json"]["step"]', shards=shards)
            text += rig_table(rig, hz)
        asked = questions_text(export.questions, self.asks)
        card = export_card(
            export.dataset.meta, rig, len(export.pieces), text, configs, tags=("webdataset",), questions=asked
        )
        export.out.write_text(CARD_FILE, card)


def _pattern(shards: Sequence[str]) -> str:
    """Returns the names of the shards of one split as a pattern that webdataset expands."""
    stem, _, first = shards[0].removesuffix(".tar").rpartition("-")
    last = shards[-1].removesuffix(".tar").rpartition("-")[2]
    return shards[0] if len(shards) == 1 else f"{stem}-{{{first}..{last}}}.tar"


def _contents(shard: Shard) -> dict[str, Any]:
    return {"episodes": [piece.episode_id for piece in shard.pieces], "member_bytes": shard.size}


def recorded_members(episode: Episode, t: int) -> Iterator[tuple[str, bytes]]:
    """Yields suffix and bytes of the images of the recorded camera; all frames have the same suffixes."""
    # ids and depth are not 16-bit PNG, because decode("rgb") of webdataset reduces it to 8 bits without a warning
    yield "rgb.png", episode.stored(f"rgb_front/{t:06d}.png")
    yield "depth.npy.gz", array_member(episode.depth(t))
    yield "seg.npy.gz", array_member(episode.ids(t))


def _facts_members(facts: dict[str, Any], action: list[float], tokens: list[int]) -> Iterator[tuple[str, bytes]]:
    (v, w), (v_token, w_token) = action, tokens
    yield "action.json", json_member({"v_mps": v, "w_rps": w, "v_token": v_token, "w_token": w_token})
    yield "json", json_member(facts)


def camera_facts(episode: Episode, reader: SensorReader | None, steps: Sequence[int]) -> list[dict[str, Any]]:
    """Returns for each step the matrix and the pose of each camera, at the step of its measurement."""
    facts: list[dict[str, Any]] = [{} for _ in steps]
    for camera in shown_rig(episode).cameras:
        seen = [t if reader is None else reader.latest_step(camera.name, t) for t in steps]
        intrinsics = intrinsics_of(camera)
        matrix = {} if intrinsics is None else {"camera_matrix": intrinsics.matrix}
        for fact, pose in zip(facts, optical_poses(episode.poses[seen], camera.mount).tolist(), strict=True):
            fact[camera.name] = {**matrix, "pose": pose}
    return facts


def _facts(episode: Episode, t: int) -> dict[str, Any]:
    meta, job = episode.meta, episode.meta.job
    return {
        "episode_id": episode.episode_id,
        "step": t,
        "num_steps": len(episode),
        "time_s": t / job.task.control_hz,
        "instruction": meta.instruction,
        "split": str(job.split),
        "scene": job.scene,
        "tier": str(job.tier),
        "template_id": meta.template_id,
        "target_category": job.category,
        "target_id": job.target_id,
        "target_instance_id": meta.target_instance_id,
        "target_centroid_m": list(meta.target_centroid_m),
        "pose": episode.poses[t].tolist(),
    }


def write_member(file: BinaryIO, name: str, data: bytes) -> None:
    """Appends one member without owner and time, and not the end of the archive."""
    info = tarfile.TarInfo(name)
    info.size, info.mode = len(data), _MEMBER_MODE
    file.write(info.tobuf(tarfile.USTAR_FORMAT))
    file.write(data)
    file.write(b"\0" * (-len(data) % tarfile.BLOCKSIZE))


def member_bytes(size: int) -> int:
    """Returns the space that a member with `size` bytes of content needs in an archive, bytes."""
    return tarfile.BLOCKSIZE + size + -size % tarfile.BLOCKSIZE


def _end_of_archive(size: int) -> bytes:
    """Returns the blocks that end an archive whose members take `size` bytes."""
    end = 2 * tarfile.BLOCKSIZE
    return b"\0" * (end + -(size + end) % tarfile.RECORDSIZE)
