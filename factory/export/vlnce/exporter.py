"""Exporter of format `vlnce`: evaluation episodes of VLN-CE and Habitat, `<split>/<split>.json.gz`, with driven paths.

Writes no frames: a simulator renders them from the scene mesh. `vlnce.episode` documents the axes.
"""

from __future__ import annotations

import functools
import gzip
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, Exporter, ExportPiece, Finish, Options
from factory.export.card import CARD_FILE, export_card
from factory.export.output import Output
from factory.export.vlnce.episode import scene_file, to_habitat, tokens_of_text, vlnce_episode, vocabulary_of, words_of
from factory.export.vlnce.glb import encode_glb
from factory.runs.catalog import find_package
from schemas.scene import SceneInfo, decode_scene
from schemas.storage.place import Place

__all__ = ["VlnceExporter"]

PIECE_FILE = "episode.json"
_GZIP_LEVEL = 6
_CARD = """
- `<split>/<split>.json.gz`: `episodes` and `instruction_vocab`, as habitat's VLN datasets are parsed;
  `<split>/<split>_gt.json.gz`: the driven path of each episode (`locations`, every 1/60 s), for nDTW and SDTW.
- Positions are in Habitat's world: x right, y up, z backward. A point (x, y, z) of our world (x forward, y left, z up)
  is (x, z, -y) there. `start_rotation` is a quaternion (x, y, z, w); an agent looks along its own -z.
- `goals` has the target's centroid, put on the floor, with the success radius; in a dataset with `task.success =
  "surface"`, points every 0.25 m or less along the edge of the target's footprint, the one nearest to the end first.
  `reference_path` is the driven track, a point every 0.25 m. `info.geodesic_distance` goes to the success region, along
  the floor (null where it is unknown).
- `instruction_tokens` are indices into `instruction_vocab.word_list`, padded with 0 to {length}; one vocabulary for all
  splits. Models with their own vocabulary use `instruction_text`.
- `scene_id` is `minivla/<scene>/<scene>.glb` below Habitat's folder of scenes: `scene_datasets/` here. The
  meshes have textures and colours, but not the baked light; Habitat computes the navigation mesh.
"""


class VlnceExporter(Exporter[Options, EpisodeFacts]):
    """Exporter of format `vlnce`. A piece is the JSON entry of its episode; split files are written entry by entry."""

    name = "vlnce"
    about = "VLN-CE / Habitat episodes (json.gz) of every split, in Habitat's axes; no frames"
    version = 2
    requires = ("trimesh",)
    assembles = True
    options = Options
    facts = EpisodeFacts

    def write_episode(self, episode: Episode, options: Options, folder: Path) -> EpisodeFacts:  # noqa: ARG002
        """Writes the entry and the path of one episode."""
        job = episode.meta.job
        info = _scene_of(episode.path.parents[1], job.scene, job.scene_sha256)
        entry = vlnce_episode(episode.meta, episode.poses, info.floor_height_m)
        locations = [to_habitat(point) for point in episode.poses[:, :3].tolist()]
        (folder / PIECE_FILE).write_text(json.dumps({"entry": entry, "locations": locations}), encoding="utf-8")
        return EpisodeFacts(frames=len(episode))

    def finish(self, export: Finish[Options, EpisodeFacts]) -> None:
        """Writes the files of every split, the scene meshes and the card."""
        texts = export.dataset.metadata["instruction"].unique().to_pylist()
        words = vocabulary_of(texts)
        length = max(len(words_of(text)) for text in texts)
        for split in dict.fromkeys(piece.split for piece in export.pieces):
            pieces = [piece for piece in export.pieces if piece.split == split]
            _write_once(export.out, f"{split}/{split}.json.gz", _episodes_json(pieces, words, length))
            _write_once(export.out, f"{split}/{split}_gt.json.gz", _paths_json(pieces))
        rows = export.dataset.metadata.take([piece.position for piece in export.pieces])
        for row in rows.group_by(["scene", "scene_sha256"]).aggregate([]).sort_by("scene").to_pylist():
            _write_scene(export.out, export.dataset.root, row["scene"], row["scene_sha256"])
        card = export_card(export.dataset.meta, len(export.pieces), _CARD.format(length=length), tags=("vln-ce",))
        export.out.write_text(CARD_FILE, card)


def _write_once(out: Output, name: str, parts: Iterator[str]) -> None:
    if out.has(name):
        return
    with (
        out.replacing(name) as part,
        part.open("wb") as file,
        # no name and time in the header, so that equal episodes give equal files
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
        said = entry["instruction"]
        said["instruction_tokens"] = tokens_of_text(said["instruction_text"], index, length)
        yield ("\n" if number == 0 else ",\n") + json.dumps(entry)
    yield '\n], "instruction_vocab": ' + json.dumps({"word_list": words, "num_words": len(words)}) + "}\n"


def _paths_json(pieces: Sequence[ExportPiece[EpisodeFacts]]) -> Iterator[str]:
    yield "{"
    for number, piece in enumerate(pieces):
        found = _read_piece(piece)
        path = {"locations": found["locations"]}
        yield ("\n" if number == 0 else ",\n") + f"{json.dumps(str(found['entry']['episode_id']))}: {json.dumps(path)}"
    yield "\n}\n"


def _read_piece(piece: ExportPiece[EpisodeFacts]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((piece.folder / PIECE_FILE).read_text(encoding="utf-8"))
    return found


def _write_scene(out: Output, root: Place, name: str, sha256: str) -> None:
    target = f"scene_datasets/{scene_file(name)}"
    if out.has(target):
        return
    with find_package(root, name, sha256).path.open("rb") as package:
        scene = decode_scene(package)
    with out.replacing(target) as part:
        part.write_bytes(encode_glb(scene))


@functools.lru_cache(maxsize=64)
def _scene_of(root: Place, name: str, sha256: str) -> SceneInfo:
    with find_package(root, name, sha256).path.open("rb") as package:
        return decode_scene(package).info
