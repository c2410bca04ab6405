"""`mcap`: one chunked, indexed MCAP file an episode, in Foxglove's schemas, for Foxglove, Rerun and ROS tools.

The door to the `mcap` library. Frames, transforms, odometry, actions, map, target, paths and instruction; lossless.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from coordinator.archive.place import Place
from factory.catalog import find_package
from factory.episode import Episode
from factory.export.base import Exporter, Facts, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.mcap_messages import (
    TOPICS,
    Said,
    measured_twists,
    say_depth,
    say_ids,
    say_motion,
    say_rgb,
    say_still,
    stamp_of,
)
from factory.export.mcap_protobuf import descriptor_set, encode
from factory.export.options import Decimated, stride_of
from schemas.scene import CompiledScene, decode_scene

__all__ = ["McapExporter", "McapOptions"]

_CHUNK_BYTES = 4 << 20
_LIBRARY = "minivla-factory"
_CARD = """
One MCAP file an episode, `episodes/ep_000001.mcap`, chunked, zstd, indexed; times count from frame 0.

| topic | schema |
|---|---|
| `/camera/rgb` | foxglove.CompressedImage, PNG 640 x 640 |
| `/camera/depth` | foxglove.RawImage, 32FC1, metres along the optical axis, 0 where nothing was hit |
| `/camera/ids` | foxglove.RawImage, 16UC1, instance ids; the attachment `meta.json` names them |
| `/camera/calibration` | foxglove.CameraCalibration |
| `/tf` | foxglove.FrameTransforms: world -> base_link -> front_optical |
| `/odom` | foxglove.Odometry: pose in the world, twist measured from the poses |
| `/action` | minivla.Action: commanded v_mps, w_rps and their tokens |
| `/instruction`, `/target`, `/map` | foxglove.Log, SceneUpdate, Grid; at frame 0 |
| `/path/driven`, `/path/planned` | foxglove.PosesInFrame; at frame 0 |
"""


class McapOptions(Decimated):
    """What can be chosen; the rate is that of the images, all else keeps the dataset's."""


class McapExporter(Exporter[McapOptions, Facts]):
    """Writes message by message; memory is one chunk and one frame."""

    name = "mcap"
    about = "one MCAP file an episode in Foxglove's schemas, for Foxglove, Rerun and ROS; lossless"
    requires = ("mcap",)
    options = McapOptions
    facts = Facts

    def write_episode(self, episode: Episode, options: McapOptions, folder: Path) -> Facts:
        """Writes `episodes/<id>.mcap`."""
        job = episode.meta.job
        stride = stride_of(options.fps, job.task.control_hz)
        scene = _scene_of(episode.path.parents[1], job.scene, job.scene_sha256)
        path = folder / "episodes" / f"{episode.episode_id}.mcap"
        path.parent.mkdir()
        with path.open("wb") as file:
            out = _Recording(file, episode)
            for said in say_still(episode.meta, episode.poses, scene):
                out.add(0, said)
            twists = measured_twists(episode.poses, job.task.control_hz)
            for t in range(len(episode)):
                for said in _at(episode, t, t % stride == 0, twists[t]):
                    out.add(stamp_of(t, job.task.control_hz), said)
            out.finish()
        return Facts(frames=-(-len(episode) // stride))

    def finish(self, export: Finish[McapOptions, Facts]) -> None:
        """Writes the card."""
        card = export_card(export.dataset.meta, len(export.pieces), _CARD, tags=("mcap", "foxglove"))
        export.out.write_text(CARD_FILE, card)


def _at(episode: Episode, t: int, with_images: bool, twist: NDArray[np.float64]) -> Iterator[Said]:
    job = episode.meta.job
    stamp = stamp_of(t, job.task.control_hz)
    yield from say_motion(t, job.camera, stamp, episode.poses[t], twist, episode.actions[t], episode.tokens[t])
    if with_images:
        yield say_rgb(stamp, episode.stored(f"rgb_front/{t:06d}.png"))
        yield say_depth(stamp, episode.depth(t))
        yield say_ids(stamp, episode.ids(t))


class _Recording:
    """An MCAP file being written: channels are registered as topics come up."""

    def __init__(self, file: IO[bytes], episode: Episode) -> None:
        from mcap.writer import CompressionType, Writer

        self._out: Any = Writer(file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._out.start(profile="", library=_LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        row = episode.summary
        facts = {
            "episode_id": row.episode_id,
            "instruction": row.instruction,
            "split": row.split,
            "scene": row.scene,
            "tier": row.spawn_tier,
            "target_category": row.target_category,
            "target_id": row.target_id,
            "template_id": row.template_id,
            "content_digest": row.content_digest,
        }
        self._out.add_metadata("episode", {name: str(value) for name, value in facts.items()})
        self._out.add_attachment(0, 0, "meta.json", "application/json", episode.stored("meta.json"))

    def add(self, stamp_ns: int, said: Said) -> None:
        """Appends a message."""
        schema = TOPICS[said.topic]
        if said.topic not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = self._out.register_schema(schema, "protobuf", descriptor_set(schema))
            self._channels[said.topic] = self._out.register_channel(said.topic, "protobuf", self._schemas[schema])
        number = self._counts[said.topic] = self._counts.get(said.topic, -1) + 1
        data = encode(schema, said.values)
        self._out.add_message(self._channels[said.topic], stamp_ns, data, stamp_ns, number)

    def finish(self) -> None:
        """Writes indexes and the end; the file stays open."""
        self._out.finish()


@functools.lru_cache(maxsize=2)
def _scene_of(root: Place, name: str, sha256: str) -> CompiledScene:
    with find_package(root, name, sha256).path.open("rb") as package:
        return decode_scene(package)
