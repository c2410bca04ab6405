"""Exporter of format `mcap`: one chunked, indexed MCAP file per episode, for Foxglove and Rerun, or for ROS 2 tools.

Contains frames, transforms, odometry, actions, map, target, paths and instruction; lossless. The only module that
imports `mcap`.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import IO, Any

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from factory.dataset.episode import Episode
from factory.export.base import Decimated, EpisodeFacts, Exporter, Finish, stride_of
from factory.export.card import CARD_FILE, export_card
from factory.export.mcap.messages import TopicMessage, measured_twists, stamp_of
from factory.export.mcap.profile import FOXGLOVE, ROS2, Profile
from factory.export.source import describe_episode, to_json
from factory.runs.catalog import find_package
from schemas.dataset_meta import DatasetMeta
from schemas.errors import UsageError
from schemas.scene import CompiledScene, decode_scene
from schemas.storage.place import Place
from schemas.support.extras import require_package

START_TIME_S = 1_767_225_600
"""Default start time of ROS 2 stamps, 2026-01-01 00:00 UTC, seconds since 1970."""
_SPACING_S = 60
"""Interval between the starts of consecutive episodes, seconds; an episode of 1000 frames at 60 Hz takes 17 s."""
_LATEST_S = 2**31 - 1
"""Maximum of the 32-bit seconds of a ROS time."""
_NANOSECONDS = 1_000_000_000
_CHUNK_BYTES = 4 << 20
_LIBRARY = "minivla-factory"
_FOXGLOVE_CARD = """
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
_ROS2_CARD = """
One MCAP file an episode, `episodes/ep_000001.mcap`, of profile `ros2` (CDR), chunked, zstd, indexed; for `ros2 bag`,
`rosbags` and Foxglove. Episode n starts {spacing} (n - 1) s after {start} s since 1970.

| topic | message |
|---|---|
| `/camera/rgb/image_raw/compressed` | sensor_msgs/CompressedImage, PNG 640 x 640 |
| `/camera/depth/image_raw` | sensor_msgs/Image, 32FC1, metres along the optical axis, +Inf where nothing was hit |
| `/camera/ids/image_raw` | sensor_msgs/Image, mono16, instance ids; the attachment `meta.json` names them |
| `/camera/rgb/camera_info`, `/camera/depth/camera_info` | sensor_msgs/CameraInfo |
| `/tf`, `/tf_static` | map -> odom -> base_link -> front_camera_link -> front_camera_optical_frame |
| `/odom` | nav_msgs/Odometry: pose in odom, which is exact here, twist measured from the poses |
| `/cmd_vel` | geometry_msgs/Twist: the command |
| `/action_tokens` | std_msgs/UInt8MultiArray: the command on the 7 x 7 grid |
| `/instruction`, `/target`, `/map` | std_msgs/String, visualization_msgs/MarkerArray, nav_msgs/OccupancyGrid; once |
| `/path/driven`, `/path/planned` | nav_msgs/Path; once |
"""


class McapOptions(Decimated):
    """Options of format `mcap`. The rate applies to images; all other topics keep the recorded rate."""

    ros2: bool = Field(default=False, description="Write ROS 2 messages (extra `ros2`). Default: Foxglove messages.")
    start_time: int | None = Field(
        default=None,
        ge=1,
        le=_LATEST_S,
        description=f"Unix time of frame 0 of the first episode, seconds; with --ros2 only. Default: {START_TIME_S}.",
    )

    @model_serializer(mode="wrap")
    def _leave_out_unused(self, spell: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Omits unused options, so that the manifests of exports without them do not change."""
        data: dict[str, object] = spell(self)
        return {key: value for key, value in data.items() if value or key not in ("ros2", "start_time")}

    def check(self, meta: DatasetMeta) -> None:
        """Validates the rate, the start time (ROS 2 only, 32 bits) and the package for ROS 2."""
        super().check(meta)
        if self.start_time is not None and not self.ros2:
            raise UsageError("--start-time requires --ros2: the times of Foxglove messages start at 0")
        latest = _LATEST_S - _SPACING_S * meta.planned
        if self.ros2 and self.start_s > latest:
            raise UsageError(
                f"--start-time {self.start_s}: {meta.planned} episodes, {_SPACING_S} s apart, exceed the 32 bits of a "
                f"ROS time in 2038; give at most {latest}"
            )
        if self.ros2:
            require_package("rosbags", "format mcap with --ros2")

    @property
    def start_s(self) -> int:
        """Time of frame 0 of the first episode, seconds since 1970."""
        return START_TIME_S if self.start_time is None else self.start_time


class McapExporter(Exporter[McapOptions, EpisodeFacts]):
    """Exporter of format `mcap`. Memory use is one chunk and one frame."""

    name = "mcap"
    about = "one MCAP file per episode, for Foxglove and Rerun, with --ros2 for ROS 2; lossless"
    version = 3
    requires = ("mcap", "mcap_protobuf", "foxglove_schemas_protobuf")
    options = McapOptions
    facts = EpisodeFacts

    def write_episode(self, episode: Episode, options: McapOptions, folder: Path) -> EpisodeFacts:
        """Writes `episodes/<id>.mcap`."""
        job = episode.meta.job
        stride = stride_of(options.fps, job.task.control_hz)
        scene = _scene_of(episode.path.parents[1], job.scene, job.scene_sha256)
        profile = ROS2 if options.ros2 else FOXGLOVE
        start_ns = (options.start_s + _SPACING_S * (job.index - 1)) * _NANOSECONDS if options.ros2 else 0
        path = folder / "episodes" / f"{episode.episode_id}.mcap"
        path.parent.mkdir()
        with path.open("wb") as file:
            out = _Recording(file, episode, profile, start_ns)
            for message in profile.static_messages(episode, scene, start_ns):
                out.add(start_ns, message)
            twists = measured_twists(episode.poses, job.task.control_hz)
            for t in range(len(episode)):
                stamp_ns = start_ns + stamp_of(t, job.task.control_hz)
                for message in profile.frame_messages(episode, t, stamp_ns, twists[t], t % stride == 0):
                    out.add(stamp_ns, message)
            out.finish()
        return EpisodeFacts(frames=-(-len(episode) // stride))

    def finish(self, export: Finish[McapOptions, EpisodeFacts]) -> None:
        """Writes the card."""
        meta, pieces, options = export.dataset.meta, len(export.pieces), export.options
        if options.ros2:
            text = _ROS2_CARD.format(spacing=_SPACING_S, start=options.start_s)
            card = export_card(meta, pieces, text, tags=("mcap", "ros2"))
        else:
            card = export_card(meta, pieces, _FOXGLOVE_CARD, tags=("mcap", "foxglove"))
        export.out.write_text(CARD_FILE, card)


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
        }
        self._out.add_metadata("episode", {name: str(value) for name, value in facts.items()})
        described = to_json(describe_episode(episode)).encode()
        self._out.add_attachment(start_ns, start_ns, "meta.json", "application/json", described)

    def add(self, stamp_ns: int, message: TopicMessage) -> None:
        """Appends a message."""
        profile = self._profile
        schema = profile.topics[message.topic]
        if message.topic not in self._channels:
            if schema not in self._schemas:
                data = profile.schema_of(schema)
                self._schemas[schema] = self._out.register_schema(schema, profile.schema_encoding, data)
            number, facts = self._schemas[schema], profile.facts_of_topic(message.topic)
            self._channels[message.topic] = self._out.register_channel(
                message.topic, profile.message_encoding, number, facts
            )
        number = self._counts[message.topic] = self._counts.get(message.topic, -1) + 1
        data = profile.encode(schema, message.values)
        self._out.add_message(self._channels[message.topic], stamp_ns, data, stamp_ns, number)

    def finish(self) -> None:
        """Writes the indexes and the footer; the file stays open."""
        self._out.finish()


@functools.lru_cache(maxsize=2)
def _scene_of(root: Place, name: str, sha256: str) -> CompiledScene:
    with find_package(root, name, sha256).path.open("rb") as package:
        return decode_scene(package)
