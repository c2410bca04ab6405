"""Exporter of format `mcap`: one chunked, indexed MCAP file per episode, for Foxglove and Rerun, or for ROS 2 tools.

Contains frames, transforms, odometry, actions, map, target, paths and instruction; lossless. The only module that
imports `mcap`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, Exporter, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.mcap.messages import TopicMessage, measured_twists, stamp_of
from factory.export.mcap.profile import FOXGLOVE, ROS2, BagTopic, Profile, bag_metadata, foxglove_card, ros2_card
from factory.export.mcap.sensor_frames import require_different_frames
from factory.export.options import SPACING_S, McapOptions, stride_of
from factory.export.origin import COLUMN as ORIGIN
from factory.export.origin import origin_of
from factory.export.rig.description import RIG_FILE, rig_json
from factory.export.rig.reader import SensorReader
from factory.export.source import describe_episode, to_json
from factory.runs.scene_packages import find_package
from schemas.rig import Camera, Rig
from schemas.scene import CompiledScene, read_geometry
from schemas.storage.place import Place

_NANOSECONDS = 1_000_000_000
_CHUNK_BYTES = 4 << 20
_LIBRARY = "minivla-factory"


class McapExporter(Exporter[McapOptions, EpisodeFacts]):
    """Exporter of format `mcap`. Memory use is one chunk and one frame."""

    name = "mcap"
    about = "one MCAP file per episode, for Foxglove and Rerun, with --ros2 a bag of ROS 2; lossless images"
    version = 5
    requires = ("mcap", "mcap_protobuf", "foxglove_schemas_protobuf")
    takes_rig = True
    options = McapOptions
    facts = EpisodeFacts

    def check_rig(self, rig: Rig, options: McapOptions) -> None:  # noqa: ARG002 - no frame name depends on options
        """Checks that no two coordinate frames of sensors have the same name."""
        require_different_frames(rig)

    def write_episode(self, episode: Episode, options: McapOptions, folder: Path) -> EpisodeFacts:
        """Writes `episodes/<id>.mcap`, or the bag `episodes/<id>/`: `<id>.mcap` and `metadata.yaml`."""
        job = episode.meta.job
        stride = stride_of(options.fps, job.task.control_hz)
        scene = _scene_of(episode.path.parents[1], job.scene, job.scene_sha256)
        profile = ROS2 if options.ros2 else FOXGLOVE
        start_ns = (options.start_s + SPACING_S * (episode.summary.index - 1)) * _NANOSECONDS if options.ros2 else 0
        place = folder / "episodes" / (episode.episode_id if options.ros2 else "")
        path = place / f"{episode.episode_id}.mcap"
        place.mkdir(parents=True)
        with path.open("wb") as file:
            out = _Recording(file, episode, profile, start_ns)
            for message in profile.static_messages(episode, scene, start_ns):
                out.add(start_ns, message)
            reader = None if episode.rig is None else SensorReader(episode)
            twists = measured_twists(episode.poses, job.task.control_hz)
            for t in range(len(episode)):
                stamp_ns = start_ns + stamp_of(t, job.task.control_hz)
                has_images = t % stride == 0
                for message in profile.frame_messages(episode, t, stamp_ns, twists[t], has_images and reader is None):
                    out.add(stamp_ns, message)
                if reader is not None:
                    for message in _measured(reader, profile, t, stamp_ns, has_images):
                        out.add(stamp_ns, message)
            out.finish()
        if options.ros2:
            (place / "metadata.yaml").write_text(out.bag_metadata(path.name), encoding="utf-8")
        return EpisodeFacts(frames=-(-len(episode) // stride))

    def finish(self, export: Finish[McapOptions, EpisodeFacts]) -> None:
        """Writes the card."""
        meta, pieces, options, rig = export.dataset.meta, len(export.pieces), export.options, export.dataset.rig
        hz = meta.plan.task.control_hz
        text = ros2_card(SPACING_S, options.start_s, rig, hz) if options.ros2 else foxglove_card(rig, hz)
        card = export_card(meta, rig, pieces, text, tags=("mcap", "ros2" if options.ros2 else "foxglove"))
        export.out.write_text(CARD_FILE, card)


def _measured(
    reader: SensorReader, profile: Profile, t: int, stamp_ns: int, with_cameras: bool
) -> Iterator[TopicMessage]:
    """Yields the messages of the sensors that measure at step t."""
    for sensor in reader.rig.sensors:
        if t % reader.strides[sensor.name] == 0 and (with_cameras or not isinstance(sensor, Camera)):
            yield from profile.sensor_messages(reader, sensor, t, stamp_ns)


class _Recording:
    """Writer of an MCAP file; registers channels when their topic first occurs."""

    def __init__(self, file: IO[bytes], episode: Episode, profile: Profile, start_ns: int) -> None:
        from mcap.writer import CompressionType, Writer

        self._out: Any = Writer(file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._out.start(profile=profile.name, library=_LIBRARY)
        self._profile = profile
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._kinds: dict[str, str] = {}
        self._first_ns, self._last_ns = start_ns, start_ns
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
            "states_digest": episode.states_digest,
            ORIGIN: origin_of(episode).to_json(),
        }
        self._out.add_metadata("episode", {name: str(value) for name, value in facts.items()})
        described = to_json(describe_episode(episode)).encode()
        self._out.add_attachment(start_ns, start_ns, "meta.json", "application/json", described)
        if episode.rig is not None:
            text = rig_json(episode.rig, episode.meta.job.task.control_hz)
            self._out.add_attachment(start_ns, start_ns, RIG_FILE, "application/json", text.encode())

    def add(self, stamp_ns: int, message: TopicMessage) -> None:
        profile = self._profile
        schema = message.kind or profile.topics[message.topic]
        if message.topic not in self._channels:
            if schema not in self._schemas:
                data = profile.schema_of(schema)
                self._schemas[schema] = self._out.register_schema(schema, profile.schema_encoding, data)
            self._kinds[message.topic] = schema
            number, facts = self._schemas[schema], profile.facts_of_topic(message.topic)
            self._channels[message.topic] = self._out.register_channel(
                message.topic, profile.message_encoding, number, facts
            )
        number = self._counts.get(message.topic, 0)
        self._counts[message.topic] = number + 1
        self._last_ns = max(self._last_ns, stamp_ns)
        data = profile.encode(schema, message.values)
        self._out.add_message(self._channels[message.topic], stamp_ns, data, stamp_ns, number)

    def finish(self) -> None:
        """Writes the indexes and the footer; the file stays open."""
        self._out.finish()

    def bag_metadata(self, file: str) -> str:
        """Returns `metadata.yaml` of the bag that has this recording as its only file."""
        topics = [BagTopic(name, self._kinds[name], count) for name, count in self._counts.items()]
        return bag_metadata(file, self._first_ns, self._last_ns, topics)


@functools.lru_cache(maxsize=2)
def _scene_of(root: Place, name: str, sha256: str) -> CompiledScene:
    return read_geometry(find_package(root, name, sha256).path)
