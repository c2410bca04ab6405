"""Format `robomimic`: one HDF5 file of demonstrations, as robomimic's `SequenceDataset` reads it.

Chunks are compressed by isal and not by HDF5, whose deflate is several times slower.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.dataset.episode_names import episode_index
from factory.export.base import EpisodeFacts, Exporter, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.lerobot.columns import kept_frames
from factory.export.options import RobomimicOptions, stride_of
from factory.export.origin import COLUMN, DEMOS
from factory.export.rlds import Step, rlds_metadata, rlds_steps
from schemas.terms import Split

if TYPE_CHECKING:
    import h5py

FILE = "dataset.hdf5"
_PIECE = "demo.hdf5"
_LEVEL = 3
_IMAGES = ("image", "depth", "ids")
_LONG_TEXTS = (COLUMN, "instances")
"""Texts that may be larger than an attribute of HDF5, 64 kB."""
_MASKS = {str(Split.TRAIN_ID): "train", str(Split.VAL_ID): "valid"}
_ENV_ARGS = {"env_name": "minivla_nav", "type": 2, "env_kwargs": {}}
"""Environment of the demonstrations. robomimic does not start it unless its rollouts are enabled; 2 is Gym."""
_CARD = """
`{file}` has the episodes as demonstrations for robomimic's `SequenceDataset`; `demo_1` is `ep_000001`.

| in `data/demo_1` | content |
|---|---|
| `actions` | float32 (N, 2): mean command until the next step, v and w divided by the attribute `action_scale`, the \
largest v and w of the robot, so that they are in [-1, 1] |
| `commands` | float32 (N, 2): the same command in m/s and rad/s; `action_tokens`: 0..6 on the 7 x 7 grid |
| `obs/state` | float32 (N, 5): x, y, yaw relative to the first pose; measured v and w |
| `obs/image` | uint8 (N, {side}, {side}, 3): sRGB |
| `obs/depth` | float32 (N, {side}, {side}, 1): metres along the optical axis, 0 where nothing was hit |
| `obs/ids` | uint16 (N, {side}, {side}, 1): instance ids, 0 is background; `instances` names them as JSON |
| `rewards`, `dones` | 1 at the last step: every archived episode is a success |
| `camera_pose` | float32 (N, 7): x, y, z, qw, qx, qy, qz of the optical frame in the world |
| attributes | `num_samples`, `language_instruction`, `camera_matrix` (3, 3), `camera_in_base`, target, scene, split |

Steps have {hz} frames per second. `mask` has a filter key for each split: {masks}. Name the observations in the
configuration: `low_dim` `state`, `rgb` `image`; robomimic clips the modality `depth` at 1, so metres need a modality of
their own. There are no `next_obs`: set `hdf5_load_next_obs` to false. Rollouts need the environment, so set
`experiment.rollout.enabled` to false, and evaluate policies with `factory eval`.
"""


class RobomimicExporter(Exporter[RobomimicOptions, EpisodeFacts]):
    """Exporter of format `robomimic`. A piece is an HDF5 file of one group, which is copied into that of the export."""

    name = "robomimic"
    about = "HDF5 demonstrations with images, state and actions, for robomimic"
    requires = ("h5py",)
    assembles = True
    options = RobomimicOptions
    facts = EpisodeFacts

    def write_episode(self, episode: Episode, options: RobomimicOptions, folder: Path) -> EpisodeFacts:
        """Writes the demonstration; one frame is in memory at a time."""
        frames = len(kept_frames(len(episode), stride_of(options.fps, episode.meta.job.task.control_hz)))
        with _new_file(folder / _PIECE) as file:
            demo = file.create_group("demo")
            _write_steps(demo, rlds_steps(episode, options.fps, options.image_px), frames)
            robot = episode.meta.job.robot
            scale = np.array((robot.max_speed_mps, robot.max_yaw_rate_rps), np.float32)
            _write(demo, "actions", np.clip(demo["commands"][:] / scale, -1, 1))
            about = rlds_metadata(episode, options.image_px)
            for name in _LONG_TEXTS:
                _write(demo, name, np.bytes_(about.pop(name).encode()))
            about |= {"num_samples": frames, "language_instruction": episode.instruction, "action_scale": scale}
            for name, value in sorted(about.items()):
                demo.attrs[name] = value if isinstance(value, str) else np.asarray(value)
        return EpisodeFacts(frames=frames)

    def finish(self, export: Finish[RobomimicOptions, EpisodeFacts]) -> None:
        """Copies the demonstrations into one file; writes the filter keys and the card."""
        masks: dict[str, list[str]] = {}
        for piece in export.pieces:
            name = f"demo_{episode_index(piece.episode_id)}"
            for mask in filter(None, (piece.split, _MASKS.get(piece.split))):
                masks.setdefault(mask, []).append(name)
        if not export.out.has(FILE):
            with export.out.replacing(FILE) as part:
                _join(part, export, masks)
        text = _CARD.format(
            file=FILE,
            side=export.options.image_px,
            hz=export.options.fps or export.dataset.meta.plan.task.control_hz,
            masks=", ".join(f"`{name}`" for name in sorted(masks)),
        )
        card = export_card(export.dataset.meta, None, len(export.pieces), text, tags=("robomimic",))
        export.out.write_text(CARD_FILE, card)


@contextlib.contextmanager
def _new_file(path: Path) -> Iterator[h5py.File]:
    """Yields a new HDF5 file; raises OSError with the errno of the system, which HDF5 states in its texts only."""
    import h5py

    file = h5py.File(path, "w")
    try:
        yield file
        file.close()
    except (OSError, RuntimeError) as error:
        stated = re.search(r"errno = (\d+)", str(error))
        if stated is None:
            raise
        raise OSError(int(stated[1]), os.strerror(int(stated[1])), str(path)) from error
    finally:
        with contextlib.suppress(OSError, RuntimeError):  # after an error, closing fails again
            file.close()


def _join(path: Path, export: Finish[RobomimicOptions, EpisodeFacts], masks: dict[str, list[str]]) -> None:
    import h5py

    with _new_file(path) as file:
        data, total = file.create_group(DEMOS), 0
        for piece in export.pieces:
            with h5py.File(piece.folder / _PIECE, "r") as source:
                source.copy("demo", data, name=f"demo_{episode_index(piece.episode_id)}")
            total += piece.facts.frames
        data.attrs["total"] = total
        data.attrs["env_args"] = json.dumps(_ENV_ARGS)
        for name, demos in sorted(masks.items()):
            _write(file, f"mask/{name}", np.array(demos, "S"))


def _write_steps(demo: h5py.Group, steps: Iterator[Step], frames: int) -> None:
    """Writes the datasets that have one row for each step, except the scaled actions."""
    images: dict[str, h5py.Dataset] = {}
    columns: dict[str, list[Any]] = {}
    for number, step in enumerate(steps):
        for name, value in step["observation"].items():
            if name not in _IMAGES:
                columns.setdefault(f"obs/{name}", []).append(value)
                continue
            image: NDArray[Any] = np.ascontiguousarray(value)
            if name not in images:
                images[name] = _images(demo, f"obs/{name}", frames, image)
            chunk = isal_zlib.compress(image.tobytes(), _LEVEL)
            images[name].id.write_direct_chunk((number, 0, 0, 0), chunk)
        columns.setdefault("commands", []).append(step["action"])
        columns.setdefault("action_tokens", []).append(step["action_tokens"])
        columns.setdefault("rewards", []).append(np.float32(step["reward"]))
        columns.setdefault("dones", []).append(np.int64(step["is_last"]))
        columns.setdefault("camera_pose", []).append(step["camera_pose"])
    for name, values in columns.items():
        _write(demo, name, np.stack(values))


def _images(demo: h5py.Group, name: str, frames: int, first: NDArray[Any]) -> h5py.Dataset:
    """Creates a dataset of images with one compressed chunk for each frame."""
    return demo.create_dataset(
        name,
        shape=(frames, *first.shape),
        dtype=first.dtype,
        chunks=(1, *first.shape),
        compression="gzip",
        track_times=False,
    )


def _write(group: h5py.Group, name: str, values: Any) -> None:
    group.create_dataset(name, data=values, track_times=False)
