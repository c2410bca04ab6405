"""Draws sheets of random instructions, routes and questions for inspection: the image of the start and two maps.

python -m tests.benchmarks.language_sheets OUT --seed 0 --goals 40 --episodes 12 DATASET [DATASET|PACKAGE ...]

Draws all scenes of the datasets, and the scenes whose packages are given. A sheet has eight tiles. Each tile shows one
text with the image of the start, a map of the surroundings and a map of the whole scene. The target is red, objects of
the named kind are blue, landmarks are green. The magenta line is the heading; the two light orange lines limit the
field of view; the dark orange line is the path. SCENE.tsv lists the tiles of a scene, with the features of the
expressions. The texts of a scene depend only on its name and the seed.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import textwrap
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from factory.dataset.reader import Dataset
from schemas.config import CameraConfig
from schemas.language.compose import Composer
from schemas.language.expression import Expression
from schemas.language.graph.scene_graph import SceneGraph, build_graph
from schemas.language.graph.view import look
from schemas.language.language_file import LanguageSpec
from schemas.language.question.compose import AskedEpisode, QuestionComposer
from schemas.language.route.compose import RouteComposer
from schemas.language.route.meaning import DrivenPath
from schemas.language.route.steps import SceneRoutes
from schemas.language.scene import SceneLanguage
from schemas.scene import CompiledScene, read_scene
from workers.geometry.pose import Pose
from workers.render.choose import open_renderer

SIDE, HEAD, COLUMNS, ROWS = 380, 56, 2, 4
CAMERA = CameraConfig()
RARE = dict.fromkeys(("between", "count", "material", "size", "state", "superclass", "support", "view"), 8.0)
"""Feature that few targets have -> weight of the feature. The default weight is 1."""
SPEC = LanguageSpec(
    languages={"en": 3.0, "de": 1.0, "es": 1.0, "zh": 1.0}, features={"colour": 0.5, **RARE}, redundant=0.15
)
GREY, RED, BLUE, GREEN, MAGENTA = (170, 170, 170), (255, 0, 0), (0, 0, 255), (0, 140, 0), (255, 0, 255)
WIDE = 3 * SIDE + 26
"""Width of a tile, pixels."""
SHEET = (COLUMNS * WIDE, ROWS * (SIDE + HEAD))
"""Width and height of a sheet, pixels."""


class Shown(NamedTuple):
    """A text, and the data that its tile shows."""

    kind: str
    text: str
    pose: tuple[float, float, float]
    number: int | None
    """Number of the object drawn in red; `None` for no object."""
    named: tuple[Expression, ...] = ()
    path: tuple[tuple[float, float], ...] = ()
    marks: tuple[tuple[float, float], ...] = ()
    """Points at which the steps of a route end, metres."""


class SceneSheets:
    """Draws the tiles of one scene.

    Args:
        scene: compiled scene.
        rng: random generator for targets, starts and sentences.
        font_file: font of the texts; `None` for the default font of Pillow, which has no Chinese characters.
    """

    def __init__(self, scene: CompiledScene, rng: np.random.Generator, font_file: Path | None) -> None:
        self.name, self.scene, self.rng, self.font_file = scene.info.name, scene, rng, font_file
        self.language = SceneLanguage(build_graph(scene))
        self.place, self.composer = SceneRoutes(self.language, CAMERA), Composer(SPEC)

    @property
    def graph(self) -> SceneGraph:
        return self.language.graph

    def goals(self, count: int) -> Iterator[Shown]:
        """Yields instructions for random targets from random starts; every eighth instruction has a false premise.

        For three of four instructions, the start is drawn from the points that see the target.
        """
        targets, found = self.scene.info.targets, 0
        while found < count:
            place = int(self.rng.integers(len(targets)))
            number = self.graph.number_of[targets[place].target_id]
            x, y = self.middle(number)
            distance = np.hypot(*(self.scene.spawns - (x, y)).T)
            is_seen = (self.scene.spawn_sees[:, place] > 0) | (found % 4 == 3)
            near = self.scene.spawns[(distance > 1.5) & (distance < 7) & is_seen]
            if not len(near):
                continue
            start = near[self.rng.integers(len(near))].tolist()
            pose = (*start, math.atan2(y - start[1], x - start[0]) + float(self.rng.uniform(-0.7, 0.7)))
            view, held_out = look(self.graph, pose, CAMERA), bool(self.rng.random() < 0.2)
            is_false = found % 8 == 7
            if is_false:
                one = self.composer.write_false_premise(self.language, view, number, held_out, self.rng)
            else:
                one = next(iter(self.composer.write(self.language, view, number, held_out, self.rng)), None)
            if one is not None:
                found += 1
                meaning = (Expression.model_validate_json(one.expression),)
                yield Shown(str(one.kind), one.text, pose, None if is_false else number, meaning)

    def of_episode(self, poses: np.ndarray, target_id: str, questions: int) -> Iterator[Shown]:
        """Yields the route description and up to `questions` questions of a recorded episode."""
        number, path = self.graph.number_of[target_id], DrivenPath(poses)
        track = tuple((float(x), float(y)) for x, y in path.xy[::5])
        for route in RouteComposer(SPEC).write(self.place, poses, number, False, self.rng):
            marks = tuple((float(x), float(y)) for x, y in path.xy[[each.end - 1 for each in route.steps]])
            named = tuple(each.step.named for each in route.steps if each.step.named is not None)
            yield Shown("route", route.text, path.pose(0), number, named, track, marks)
        goals = tuple(
            self.composer.write(self.language, look(self.graph, path.pose(0), CAMERA), number, False, self.rng)
        )
        asked = QuestionComposer(self.composer).write(self.place, AskedEpisode(poses, number, goals), False, self.rng)
        for place in self.rng.permutation(len(asked))[:questions].tolist():
            one = asked[place]
            text = f"{one.question} | {one.answer} | {one.reason or ''} [{one.start}:{one.end}]"
            named = () if one.meaning.named is None else (one.meaning.named,)
            yield Shown(f"question {one.meaning.kind}", text, path.pose(one.start), number, named, track)

    def font(self, size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
        return ImageFont.truetype(str(self.font_file), size) if self.font_file else ImageFont.load_default(size)

    def middle(self, number: int) -> tuple[float, float]:
        each = self.graph.objects[number]
        return (each.low_m[0] + each.high_m[0]) / 2, (each.low_m[1] + each.high_m[1]) / 2

    def surroundings(self, shown: Shown) -> tuple[np.ndarray, float]:
        """Returns the centre of a map around start, target and path, and half the side length of the map, metres."""
        points = np.array(
            [shown.pose[:2], *([self.middle(shown.number)] if shown.number is not None else []), *shown.path]
        )
        return (points.min(0) + points.max(0)) / 2, max(4.5, float(np.ptp(points, axis=0).max()) / 2 + 2)

    def whole(self) -> tuple[np.ndarray, float]:
        """Returns the centre of a map of all objects, and half the side length of the map, metres."""
        corners = np.array([(each.low_m[:2], each.high_m[:2]) for each in self.graph.objects])
        low, high = corners[:, 0].min(0), corners[:, 1].max(0)
        return (low + high) / 2, float((high - low).max()) / 2 + 0.5

    def map_of(self, shown: Shown, middle: np.ndarray, half: float) -> Image.Image:
        """Draws a map of walls, objects, start and path."""
        axis = (np.arange(SIDE) + 0.5) / SIDE * 2 * half - half
        x, y = np.meshgrid(middle[0] + axis, middle[1] - axis)
        cells = self.graph.sight_grid.at(np.stack((x, y), -1)).astype(int)
        image = Image.fromarray(np.array([(255, 255, 255), (235, 235, 235), (90, 90, 90)], np.uint8)[cells])
        draw = ImageDraw.Draw(image)

        def at(point: Sequence[float]) -> tuple[float, float]:
            return (point[0] - middle[0] + half) / (2 * half) * SIDE, (half - point[1] + middle[1]) / (2 * half) * SIDE

        kinds = {kind for each in shown.named for kind in self.graph.kinds.kinds_of(each.kind)}
        near = {mark.kind for each in shown.named for clause in each.clauses for mark in clause.landmarks}
        marks = {kind for name in near for kind in self.graph.kinds.kinds_of(name)}
        for number, each in enumerate(self.graph.objects):
            colour = (
                RED if number == shown.number else BLUE if each.kind in kinds else GREEN if each.kind in marks else GREY
            )
            draw.polygon([at(point) for point in each.outline_m], outline=colour)
            if colour != GREY or half < 6:
                said = f"{each.kind[:9]} {each.colour[:4] if each.colour != 'unknown' else ''}"
                draw.text(at(self.middle(number)), said, fill=colour, font=self.font(9), anchor="mm")
        draw.line([at(point) for point in shown.path], fill=(255, 140, 0), width=2)
        for number, point in enumerate(shown.marks, 1):
            draw.text(at(point), str(number), fill=(0, 0, 0), font=self.font(12), anchor="mm")
        px, py, yaw = shown.pose
        for angle, length, colour in (
            (0.0, 0.8, MAGENTA),
            (math.pi / 4, 3.0, (255, 180, 0)),
            (-math.pi / 4, 3.0, (255, 180, 0)),
        ):
            draw.line(
                [at((px, py)), at((px + length * math.cos(yaw + angle), py + length * math.sin(yaw + angle)))], colour
            )
        return image

    def tile(self, shown: Shown, rgb: np.ndarray, ids: np.ndarray, number: int) -> Image.Image:
        """Draws a tile: text, image with the outline of the target, and two maps."""
        image = rgb.copy()
        if shown.number is not None and shown.kind != "question visible":
            mask = np.isin(ids, self.graph.objects[shown.number].ids)
            inner = np.logical_and.reduce([np.roll(mask, step, axis) for step in (3, -3) for axis in (0, 1)])
            image[mask & ~inner] = RED
        tile = Image.new("RGB", (WIDE, SIDE + HEAD), "white")
        tile.paste(Image.fromarray(image).resize((SIDE, SIDE)), (0, HEAD))
        tile.paste(self.map_of(shown, *self.surroundings(shown)), (SIDE + 8, HEAD))
        tile.paste(self.map_of(shown, *self.whole()), (2 * SIDE + 16, HEAD))
        lines = textwrap.wrap(f"{number} {self.name} {shown.kind}: {shown.text}", 160)
        for place, line in enumerate(lines[:3]):
            ImageDraw.Draw(tile).text((2, 1 + place * 18), line, fill="black", font=self.font(13))
        return tile


def main() -> None:
    """Draws the sheets of all scenes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("sources", type=Path, nargs="+", help="Dataset or package of a scene.")
    for name, default, text in (
        ("seed", 0, "Random seed."),
        ("goals", 40, "Goals and false premises of each scene."),
        ("episodes", 12, "Largest number of episodes of each scene whose routes are drawn."),
        ("questions", 2, "Questions of each episode."),
        ("width", SHEET[0], "Width of a sheet, pixels."),
        ("quality", 80, "Quality of the JPEG files."),
    ):
        parser.add_argument(f"--{name}", type=int, default=default, help=text)
    parser.add_argument("--font", type=Path, help="TrueType font with Chinese characters.")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for file, dataset in _scenes(given.sources):
        scene = read_scene(file)
        rng = np.random.default_rng((given.seed, *scene.info.name.encode()))
        sheets = SceneSheets(scene, rng, given.font)
        shown = list(sheets.goals(given.goals))
        if dataset is not None:
            shown += _episodes(sheets, dataset, given.episodes, given.questions)
        write_texts(shown, given.out / f"{sheets.name}.tsv")
        write_sheets(sheets, shown, given)


def write_texts(shown: Collection[Shown], file: Path) -> None:
    with file.open("w", encoding="utf-8") as texts:
        for number, each in enumerate(shown, 1):
            parts = " ".join(sorted({family for one in each.named for family in one.families}))
            texts.write(f"{number}\t{each.kind}\t{parts}\t{each.text}\n")


def write_sheets(sheets: SceneSheets, shown: Collection[Shown], given: argparse.Namespace) -> None:
    tiles, per, size = _drawn(sheets, shown), COLUMNS * ROWS, (given.width, given.width * SHEET[1] // SHEET[0])
    for begin in range(0, len(tiles), per):
        sheet = Image.new("RGB", SHEET, "white")
        for place, tile in enumerate(tiles[begin : begin + per]):
            sheet.paste(tile, (place % COLUMNS * WIDE, place // COLUMNS * (SIDE + HEAD)))
        file = given.out / f"{sheets.name}_{begin // per + 1}.jpg"
        sheet.resize(size, Image.Resampling.LANCZOS).save(file, quality=given.quality)


def _scenes(sources: Sequence[Path]) -> Iterator[tuple[Path, Dataset | None]]:
    """Yields each package, with its dataset or, if the package itself was given, with `None`."""
    for source in sources:
        if source.is_file():
            yield source, None
        else:
            for file in sorted((source / "scenes").glob("*.scene.zip")):
                yield file, Dataset(source)


def _episodes(sheets: SceneSheets, dataset: Dataset, count: int, questions: int) -> Iterator[Shown]:
    if sheets.name not in dataset.column("scene").to_pylist():
        return
    chosen = dataset.filter(scene=sheets.name)
    for place in sheets.rng.permutation(len(chosen))[:count].tolist():
        with chosen[place] as episode:
            yield from sheets.of_episode(episode.poses, episode.summary.target_id, questions)


def _drawn(sheets: SceneSheets, shown: Collection[Shown]) -> list[Image.Image]:
    found = []
    with contextlib.closing(open_renderer()) as renderer:
        renderer.load(sheets.scene, CAMERA)
        for number, each in enumerate(shown, 1):
            x, y, yaw = each.pose
            frame = renderer.render(Pose.planar(x, y, yaw, z=sheets.scene.info.floor_height_m))
            found.append(sheets.tile(each, np.array(frame.rgb), frame.ids, number))
    return found


if __name__ == "__main__":
    main()
