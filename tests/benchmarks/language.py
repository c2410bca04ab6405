"""Measures language in built-in scenes: instructions per second of CPU time, and how well the verifier works.

The verifier must reject instructions that a changed word has made false or ambiguous.

python -m tests.benchmarks.language office hospital full_warehouse warehouse_multiple_shelves home_00001

Packages are kept in MINIVLA_CACHE if it is set.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from factory.scenes.build import build_scene
from schemas.language.compose import Composer
from schemas.language.expression import Family
from schemas.language.generator.minimal import minimal_expressions
from schemas.language.graph.scene_graph import build_graph
from schemas.language.graph.view import look
from schemas.language.language_file import LanguageSpec
from schemas.language.scene import SceneLanguage
from schemas.language.sentence.grammar import grammar
from schemas.language.sentence.reading import reader
from schemas.scene import CompiledScene, read_geometry
from schemas.terms import family_of, layout_number
from tests.builders.language import CAMERA, changed, is_false_or_ambiguous, search_of

_STARTS, _CHANGED = 200, 500
_PLAIN = dict.fromkeys((each for each in Family if each is not Family.COLOUR), 0.0)
_SPECS = {
    "relational, 1 per drive": LanguageSpec(features={"colour": 0.0}),
    "relational, 4 per drive": LanguageSpec(features={"colour": 0.0}, per_episode=4),
    "simple (category, colour)": LanguageSpec(features=_PLAIN, fit="any", per_episode=4),
}
LanguageStart = tuple[int, tuple[float, float, float]]


def starts_of(scene: CompiledScene, language: SceneLanguage, rng: np.random.Generator) -> list[LanguageStart]:
    """Returns targets (object numbers) and start poses 1.5 to 7 m away that roughly face them, as in real episodes."""
    found: list[LanguageStart] = []
    while len(found) < _STARTS:
        place = int(rng.integers(len(scene.info.targets)))
        target = scene.info.targets[place]
        offset = np.array(target.centroid_m[:2]) - scene.spawns
        distance = np.hypot(offset[:, 0], offset[:, 1])
        near = np.flatnonzero((scene.spawn_sees[:, place] > 0) & (distance > 1.5) & (distance < 7))
        if len(near):
            spawn = near[int(rng.integers(len(near)))]
            yaw = math.atan2(offset[spawn, 1], offset[spawn, 0]) + float(rng.uniform(-0.43, 0.43))
            x, y = scene.spawns[spawn].tolist()
            found.append((language.graph.number_of[target.target_id], (x, y, yaw)))
    return found


def rate(spec: LanguageSpec, language: SceneLanguage, starts: list[LanguageStart]) -> tuple[float, int]:
    """Returns the instructions per second of CPU time and the number of starts without an instruction.

    The CPU time includes the views.
    """
    composer, rng, best, without = Composer(spec), np.random.default_rng(0), 0.0, 0
    for _ in range(3):  # the first round also fills caches, so the best round counts
        begin, count, without = time.process_time(), 0, 0
        for number, pose in starts:
            view = look(language.graph, pose, CAMERA) if spec.needs_view else None
            found = composer.write(language, view, number, False, rng)
            count, without = count + len(found), without + (not found)
        best = max(best, count / (time.process_time() - begin))
    return best, without


def rejected_changes(language: SceneLanguage, starts: list[LanguageStart]) -> tuple[int, int]:
    """Changes one word of each sentence, so that the sentence becomes false or ambiguous.

    Returns the number of changed sentences that the verifier rejects, and the number of all changed sentences.
    """
    rng, source, seen, rejected = np.random.default_rng(1), grammar("en"), 0, 0
    patterns = [each for each in source.sentences if each.case == "nom"]
    for number, pose in starts * 3:
        view = look(language.graph, pose, CAMERA)
        search = search_of(view, number, language)
        options = minimal_expressions(search, rng)
        if not options or seen >= _CHANGED:
            continue
        variants = list(changed(options[int(rng.integers(len(options)))]))
        for place in rng.permutation(len(variants))[:3].tolist():
            if is_false_or_ambiguous(variants[place], search):
                text = source.sentence(patterns[seen % len(patterns)], variants[place])
                rejected += bool(language.verifier.check(text, reader("en"), view, number))
                seen += 1
    return rejected, seen


def measure(name: str, folder: Path) -> tuple[int, int]:
    """Prints the rows of one scene."""
    called = None if layout_number(name) is None else name
    scene = read_geometry(build_scene(family_of(name), layout_number(name) or 0, folder, called=called))
    begin = time.process_time()
    language = SceneLanguage(build_graph(scene))
    said = f"{name}: {len(language.graph.objects)} objects, graph in {time.process_time() - begin:.2f} s"
    sys.stdout.write(said + "\n")
    starts = starts_of(scene, language, np.random.default_rng(0))
    for title, spec in _SPECS.items():
        found, without = rate(spec, language, starts)
        sys.stdout.write(f"  {title:28} {found:7.0f} per second; {without} of {len(starts)} drives without text\n")
    rejected, seen = rejected_changes(language, starts)
    sys.stdout.write(f"  rejected changed words       {rejected} of {seen}\n")
    return rejected, seen


def main() -> None:
    """Measures the scenes given as arguments."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(os.environ.get("MINIVLA_CACHE", folder))
        total = Counter[str]()
        for name in sys.argv[1:] or ["office"]:
            rejected, seen = measure(name, cache)
            total.update(rejected=rejected, seen=seen)
    share = 100 * total["rejected"] / max(total["seen"], 1)
    sys.stdout.write(f"rejected changed words: {total['rejected']} of {total['seen']}, {share:.2f} %\n")


if __name__ == "__main__":
    main()
