"""Exporter of format `vlnce`: evaluation episodes of VLN-CE and Habitat, `<split>/<split>.json.gz`, with driven paths.

Writes no frames: a simulator renders them from the scene mesh, a binary glTF 2.0 file with unlit colours and textures,
without the baked light, because glTF has no light maps. `vlnce.episode` documents the axes.
"""

from __future__ import annotations

import functools
import gzip
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, Exporter, ExportPiece, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.options import Options
from factory.export.origin import origin_of
from factory.export.output import Output
from factory.export.vlnce.actions import discrete_actions
from factory.export.vlnce.episode import (
    EpisodeText,
    from_habitat,
    scene_file,
    to_habitat,
    tokens_of_text,
    vlnce_episode,
    vocabulary_of,
    words_of,
)
from factory.runs.scene_packages import find_package
from schemas.scene import DRAWN, CompiledScene, SceneInfo, read_info, read_scene
from schemas.storage.place import Place

PIECE_FILE = "episode.json"
_GZIP_LEVEL = 6
_CARD = """
- `<split>/<split>.json.gz`: `episodes` and `instruction_vocab`, in the form that Habitat's VLN datasets have;
  `<split>/<split>_gt.json.gz`: the driven path of each episode (`locations`, every 1/{hz} s), for nDTW and SDTW, and
  `actions` of VLN-CE that follow it: 0 stop, 1 forward 0.25 m, 2 left 15 degrees, 3 right 15 degrees.
- Positions are in Habitat's world: x right, y up, z backward. A point (x, y, z) of our world (x forward, y left, z up)
  is (x, z, -y) there. `start_rotation` is a quaternion (x, y, z, w); an agent looks along its own -z.
- `goals` has the target's centroid, projected to the floor, with the success radius; in a dataset with `task.success =
  "surface"`, points every 0.25 m or less along the edge of the target's footprint, the one nearest to the end first.
  `reference_path` is the driven track, a point every 0.25 m. `info.geodesic_distance` is the distance along the
  floor to the success region (null where it is unknown).
- `info.sub_instructions` of a dataset with routes has the text of each step and its span of `locations`, from `start`
  to before `end`.
- `instruction_tokens` are indices into `instruction_vocab.word_list`, padded with 0 to {length}; one vocabulary for all
  splits. Models with their own vocabulary use `instruction_text`.
- `scene_id` is `minivla/<scene>/<scene>.glb` below Habitat's folder of scenes: `scene_datasets/` here. The
  meshes have textures and colours, but not the baked light; Habitat computes the navigation mesh.
"""
_UNLIT = "KHR_materials_unlit"
_COLOUR = "COLOR_0"


class VlnceExporter(Exporter[Options, EpisodeFacts]):
    """Exporter of format `vlnce`. A piece is the JSON entry of its episode; split files are written entry by entry."""

    name = "vlnce"
    about = "VLN-CE / Habitat episodes (json.gz) of every split, in Habitat's axes; no frames"
    version = 6
    requires = ("trimesh",)
    assembles = True
    renders = False
    options = Options
    facts = EpisodeFacts

    def write_episode(self, episode: Episode, options: Options, folder: Path) -> EpisodeFacts:  # noqa: ARG002
        """Writes the entry, the path and the discrete actions of one episode."""
        job = episode.meta.job
        info = _scene_of(episode.path.parents[1], job.scene, job.scene_sha256)
        text = EpisodeText(episode.instruction, episode.summary.template_id, episode.steps)
        origin = origin_of(episode)
        entry = vlnce_episode(episode.meta, episode.poses, info.floor_height_m, text, origin)
        locations = [to_habitat(point) for point in episode.poses[:, :3].tolist()]
        goals = [from_habitat(goal["position"])[:2] for goal in entry["goals"]]
        actions = discrete_actions(episode.poses, goals, job.task.success_radius_m)
        content = {"entry": entry, "locations": locations, "actions": actions}
        (folder / PIECE_FILE).write_text(json.dumps(content), encoding="utf-8")
        return EpisodeFacts(frames=len(episode))

    def finish(self, export: Finish[Options, EpisodeFacts]) -> None:
        """Writes the files of every split, the scene meshes and the card."""
        texts = export.dataset.column("instruction").unique().to_pylist()
        words = vocabulary_of(texts)
        length = max(len(words_of(text)) for text in texts)
        for split in dict.fromkeys(piece.split for piece in export.pieces):
            pieces = [piece for piece in export.pieces if piece.split == split]
            _write_once(export.out, f"{split}/{split}.json.gz", _episodes_json(pieces, words, length))
            _write_once(export.out, f"{split}/{split}_gt.json.gz", _paths_json(pieces))
        positions = [piece.position for piece in export.pieces]
        columns = (export.dataset.column(name).take(positions).to_pylist() for name in ("scene", "scene_sha256"))
        for scene, sha256 in sorted(set(zip(*columns, strict=True))):
            _write_scene(export.out, export.dataset.root, scene, sha256)
        card = export_card(
            export.dataset.meta,
            None,
            len(export.pieces),
            _CARD.format(length=length, hz=export.dataset.meta.plan.task.control_hz),
            tags=("vln-ce",),
        )
        export.out.write_text(CARD_FILE, card)


def _write_once(out: Output, name: str, parts: Iterator[str]) -> None:
    if out.has(name):
        return
    with (
        out.replacing(name) as part,
        part.open("wb") as file,
        # the gzip header has no name and no time, so equal episodes give equal files
        gzip.GzipFile(filename="", mode="wb", fileobj=file, compresslevel=_GZIP_LEVEL, mtime=0) as packed,
    ):
        for text in parts:
            packed.write(text.encode())


def _episodes_json(pieces: Sequence[ExportPiece[EpisodeFacts]], words: list[str], length: int) -> Iterator[str]:
    """Yields the JSON of a split in parts, in bounded memory."""
    index = {word: number for number, word in enumerate(words)}
    yield '{"episodes": ['
    for number, piece in enumerate(pieces):
        entry = _read_piece(piece)["entry"]
        instruction = entry["instruction"]
        instruction["instruction_tokens"] = tokens_of_text(instruction["instruction_text"], index, length)
        yield ("\n" if number == 0 else ",\n") + json.dumps(entry)
    yield '\n], "instruction_vocab": ' + json.dumps({"word_list": words, "num_words": len(words)}) + "}\n"


def _paths_json(pieces: Sequence[ExportPiece[EpisodeFacts]]) -> Iterator[str]:
    yield "{"
    for number, piece in enumerate(pieces):
        piece_data = _read_piece(piece)
        path = {name: piece_data[name] for name in ("locations", "actions")}
        yield (
            "\n" if number == 0 else ",\n"
        ) + f"{json.dumps(str(piece_data['entry']['episode_id']))}: {json.dumps(path)}"
    yield "\n}\n"


def _read_piece(piece: ExportPiece[EpisodeFacts]) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((piece.folder / PIECE_FILE).read_text(encoding="utf-8"))
    return content


def _write_scene(out: Output, root: Place, name: str, sha256: str) -> None:
    target = f"scene_datasets/{scene_file(name)}"
    if out.has(target):
        return
    scene = read_scene(find_package(root, name, sha256).path)
    with out.replacing(target) as part:
        part.write_bytes(encode_glb(scene))


@functools.lru_cache(maxsize=64)
def _scene_of(root: Place, name: str, sha256: str) -> SceneInfo:
    return read_info(find_package(root, name, sha256).path)


def encode_glb(scene: CompiledScene) -> bytes:
    """Returns the visible triangles of a scene as .glb: one mesh per texture and one for plain colours."""
    # not pygltflib, which installs eight packages and does not write meshes
    from trimesh import Scene
    from trimesh.exchange.gltf import export_glb

    content = Scene(base_frame=scene.info.name)
    for layer in np.unique(scene.part_texture).tolist():
        name = f"texture_{layer}" if layer >= 0 else "colours"
        content.add_geometry(_mesh_of(scene, layer, name), node_name=name, geom_name=name)
    data: bytes = export_glb(content, include_normals=False, tree_postprocessor=_complete)
    return data


def _mesh_of(scene: CompiledScene, layer: int, name: str) -> Any:
    from trimesh import Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    vertices = _vertices_of(scene, layer)
    x, y, z = scene.positions[vertices].T
    texture = Image.fromarray(scene.textures[layer]) if layer >= 0 else None
    if texture is not None and layer in scene.masks:
        texture.putalpha(Image.fromarray(scene.masks[layer]))
    cut_out = {"alphaMode": "MASK", "alphaCutoff": DRAWN / 255} if layer in scene.masks else {}
    material = PBRMaterial(name=name, metallicFactor=0.0, roughnessFactor=1.0, baseColorTexture=texture, **cut_out)
    return Trimesh(
        np.column_stack([x, z, -y]),
        np.arange(len(vertices)).reshape(-1, 3),
        visual=TextureVisuals(scene.uvs[vertices] if layer >= 0 else None, material),
        vertex_attributes={_COLOUR: _colours_of(scene, vertices)},
        process=False,
    )


def _complete(tree: dict[str, Any]) -> None:
    """Adds unlit materials and 16-bit vertex colours, which trimesh does not write.

    trimesh writes the colours as the application-specific attribute `_COLOR_0`, without the flag `normalized`.
    """
    tree["extensionsUsed"] = [_UNLIT]
    for material in tree["materials"]:
        material["extensions"] = {_UNLIT: {}}
    for mesh in tree["meshes"]:
        attributes = mesh["primitives"][0]["attributes"]
        attributes[_COLOUR] = attributes.pop(f"_{_COLOUR}")
        tree["accessors"][attributes[_COLOUR]]["normalized"] = True


def _vertices_of(scene: CompiledScene, layer: int) -> NDArray[np.int64]:
    parts = np.flatnonzero(scene.part_texture == layer)
    runs = [np.arange(scene.part_first[part], scene.part_first[part] + scene.part_count[part]) for part in parts]
    return np.concatenate(runs).astype(np.int64)


def _colours_of(scene: CompiledScene, vertices: NDArray[np.int64]) -> NDArray[np.uint16]:
    colours = np.full((len(vertices), 4), 65535, np.uint16)
    colours[:, :3] = np.rint(_linear(scene.colours[vertices]) * 65535)
    return colours


def _linear(colours: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Converts sRGB to linear 0..1; glTF vertex colours are linear, glTF textures are sRGB."""
    values = colours / 255.0
    curve: NDArray[np.float64] = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return curve
