"""Format `coco`: images with instance masks in the annotation format of COCO, for detection and segmentation.

Keys and run lengths are those that `pycocotools` reads. Only objects with a category have masks; walls, floors and
clutter have none. Does not contain depth, poses or actions.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, Exporter, ExportPiece, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.options import CocoOptions, stride_of
from factory.export.origin import FILE as ORIGIN_FILE
from factory.export.origin import write_origin
from schemas.encoding.image_sizes import FRAME_SIZE_PX

_IMAGES, _LINES = "images", "frames.jsonl"
_CARD = """
Images with instance masks in the format of COCO:

- `images/<episode>/<frame>.png`, and `annotations/instances_<split>.json`, whose `file_name` is relative to `images/`.
- `images` also have `episode_id`, `frame` (of the recording) and `instruction`.
- `annotations` have `segmentation` (compressed run lengths), `area`, `bbox` (x, y, width, height; pixels), and also
  `instance_id`, the same in all frames of an episode, and `is_target`, whether the instruction means this object.
- `categories` are the same in all splits: {names}.
- Walls, floors and clutter have no category and no annotation.

This export has {fps} images per second of an episode.
"""


class CocoFacts(EpisodeFacts):
    """Facts of a piece for the list of categories."""

    categories: tuple[str, ...]
    """Categories of the objects that the frames show."""


class CocoExporter(Exporter[CocoOptions, CocoFacts]):
    """Exporter of format `coco`. A piece has the images of an episode and a line of annotations for each."""

    name = "coco"
    about = "PNG images and instance masks in COCO's annotation format"
    assembles = True
    options = CocoOptions
    facts = CocoFacts

    def write_episode(self, episode: Episode, options: CocoOptions, folder: Path) -> CocoFacts:
        """Writes the images, the origin and the annotations of one episode."""
        steps = range(0, len(episode), stride_of(options.fps, episode.meta.job.task.control_hz))
        names = {each.id: each.category for each in episode.instances if each.category is not None}
        seen: set[str] = set()
        with (folder / _LINES).open("w", encoding="utf-8") as lines:
            for t in steps:
                (folder / f"{t:06d}.png").write_bytes(episode.stored(f"rgb_front/{t:06d}.png"))
                objects = [each for each in masks_of(episode.ids(t)) if each["instance_id"] in names]
                seen |= {names[each["instance_id"]] for each in objects}
                for each in objects:
                    each["category"] = names[each["instance_id"]]
                lines.write(json.dumps({"frame": t, "objects": objects}) + "\n")
        write_origin(episode, folder)
        return CocoFacts(frames=len(steps), categories=tuple(sorted(seen)))

    def finish(self, export: Finish[CocoOptions, CocoFacts]) -> None:
        """Writes the images, the annotations of each split and the card."""
        names = sorted({name for piece in export.pieces for name in piece.facts.categories})
        for piece in export.pieces:
            for file in (*(f"{t:06d}.png" for t in _frames_of(piece)), ORIGIN_FILE):
                name = f"{_IMAGES}/{piece.episode_id}/{file}"
                if not export.out.has(name):
                    export.out.link(piece.folder / file, name)
        for split in dict.fromkeys(piece.split for piece in export.pieces):
            name = f"annotations/instances_{split}.json"
            if export.out.has(name):
                continue
            pieces = [piece for piece in export.pieces if piece.split == split]
            with export.out.replacing(name) as part, part.open("w", encoding="utf-8") as written:
                written.writelines(_annotations_json(pieces, {each: number for number, each in enumerate(names, 1)}))
        text = _CARD.format(names=", ".join(names), fps=export.options.fps or export.dataset.meta.plan.task.control_hz)
        card = export_card(export.dataset.meta, None, len(export.pieces), text, tags=("coco", "image-segmentation"))
        export.out.write_text(CARD_FILE, card)


def masks_of(ids: NDArray[np.uint16]) -> list[dict[str, Any]]:
    """Returns the masks of all instances in an id image (H, W), except 0, by ascending id.

    Each has `instance_id`, `area` (pixels), `bbox` (x, y, width, height; pixels) and `segmentation`, as COCO has them.
    """
    masks = []
    for number in np.unique(ids).tolist():
        if number == 0:
            continue
        mask = ids == number
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        top, left = int(rows[0]), int(columns[0])
        masks.append(
            {
                "instance_id": number,
                "area": int(mask.sum()),
                "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
                "segmentation": {"size": list(mask.shape), "counts": compressed_runs(mask)},
            }
        )
    return masks


def compressed_runs(mask: NDArray[np.bool_]) -> str:
    """Returns the run lengths of a mask (H, W), column by column, as the text that COCO's `rleToString` defines.

    The first run is outside of the mask. From the fourth on, a run is the difference to the one before the previous. A
    number is written in groups of 5 bits from the lowest, each a character from code 48; bit 6 means that more follow.
    """
    flat = mask.ravel(order="F")
    edges = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    runs = np.diff(np.concatenate([[0], edges, [flat.size]])).tolist()
    if flat[0]:
        runs.insert(0, 0)
    text = []
    for place, run in enumerate(runs):
        value, has_more = run - runs[place - 2] if place > 2 else run, True
        while has_more:
            bits = value & 0x1F
            value >>= 5
            has_more = value != (-1 if bits & 0x10 else 0)
            text.append(chr(48 + (bits | 0x20 if has_more else bits)))
    return "".join(text)


def _lines_of(piece: ExportPiece[CocoFacts]) -> Iterator[dict[str, Any]]:
    with (piece.folder / _LINES).open(encoding="utf-8") as lines:
        yield from map(json.loads, lines)


def _frames_of(piece: ExportPiece[CocoFacts]) -> Iterator[int]:
    return (line["frame"] for line in _lines_of(piece))


def _annotations_json(pieces: Sequence[ExportPiece[CocoFacts]], categories: Mapping[str, int]) -> Iterator[str]:
    """Yields the JSON of a split in parts, in bounded memory; images and annotations are numbered from 1."""
    yield '{"info": {}, "licenses": [], "images": ['
    number = 0
    for piece in pieces:
        about = {"episode_id": piece.episode_id, "instruction": piece.episode.instruction}
        for frame in _frames_of(piece):
            number += 1
            file = f"{piece.episode_id}/{frame:06d}.png"
            size = {"width": FRAME_SIZE_PX, "height": FRAME_SIZE_PX}
            yield _item(number, {"id": number, "file_name": file, **size, **about, "frame": frame})
    yield '\n], "annotations": ['
    image = number = 0
    for piece in pieces:
        target = piece.episode.meta.target_instance_id
        for line in _lines_of(piece):
            image += 1
            for each in line["objects"]:
                number += 1
                kind = categories[each.pop("category")]
                named = {"id": number, "image_id": image, "category_id": kind, "iscrowd": 0}
                yield _item(number, named | each | {"is_target": each["instance_id"] == target})
    listed = [{"id": number, "name": name, "supercategory": "object"} for name, number in categories.items()]
    yield '\n], "categories": ' + json.dumps(listed) + "}\n"


def _item(number: int, values: dict[str, Any]) -> str:
    return ("\n" if number == 1 else ",\n") + json.dumps(values, ensure_ascii=False)
