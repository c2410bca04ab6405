"""`factory scene survey --family`: builds layouts of a family and prints how much they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from factory.commands.common.output import print_json, print_table, print_text, stderr
from factory.support.settings import scene_cache
from schemas.errors import UsageError, WorldError
from schemas.scene import read_geometry
from schemas.support.suggest import did_you_mean
from schemas.terms import layout_name

if TYPE_CHECKING:
    from factory.scenes.survey.diversity import Distribution, LayoutFacts
    from schemas.support.numpy_types import Bools

_TRIES_PER_LAYOUT = 3


def survey_family(family: str, layouts: int, first_seed: int, as_json: bool) -> int:
    """Measures layouts of consecutive seeds; layouts in the scene cache are not built again.

    Returns:
        The exit status: 0, or 1 if too many seeds have no layout.

    Raises:
        UsageError: the family is unknown.
    """
    from factory.scenes.author.scene import BUILTIN_SCENES, lay_out_scene
    from factory.scenes.build import build_scene
    from factory.scenes.survey.diversity import coarse_map, measure_layout, nearest_neighbours, spreads

    if family not in BUILTIN_SCENES:
        known = ", ".join(BUILTIN_SCENES)
        raise UsageError(f"{family!r} is not a family; families: {known}{did_you_mean(family, BUILTIN_SCENES)}")
    facts: list[LayoutFacts] = []
    maps: dict[int, Bools] = {}
    failed: dict[int, str] = {}
    seeds = iter(range(first_seed, first_seed + _TRIES_PER_LAYOUT * layouts))
    with stderr.status(f"surveying {family}") as progress:
        while len(facts) < layouts and (seed := next(seeds, None)) is not None:
            progress.update(f"surveying {family}: {len(facts)} of {layouts} layouts, seed {seed}")
            try:
                scene = read_geometry(build_scene(family, seed, scene_cache(), called=layout_name(family, seed)))
            except WorldError as error:
                failed[seed] = str(error)
                continue
            facts.append(measure_layout(seed, lay_out_scene(BUILTIN_SCENES[family], seed), scene))
            maps[seed] = coarse_map(scene)
    nearest, spread = nearest_neighbours(maps), spreads(facts)
    if as_json:
        print_json(
            {
                "family": family,
                "layouts": [asdict(each) for each in facts],
                "distributions": {name: asdict(each) for name, each in spread.items()},
                "nearest": [{"seed": own, "other": other, "distance": far} for own, (other, far) in nearest.items()],
                "failed": [{"seed": seed, "reason": reason} for seed, reason in failed.items()],
            }
        )
    else:
        _show(family, facts, spread, nearest)
    for seed, reason in failed.items():
        click.echo(f"note: seed {seed} has no layout: {reason}", err=True)
    if len(facts) < layouts:
        click.echo(f"error: {len(facts)} of {layouts} layouts were built; use another --seed", err=True)
    return 0 if len(facts) == layouts else 1


def _show(
    family: str,
    facts: Sequence[LayoutFacts],
    spread: Mapping[str, Distribution],
    nearest: Mapping[int, tuple[int, float]],
) -> None:
    rows = [(name, each.least, each.median, each.greatest, each.deviation) for name, each in spread.items()]
    print_table(f"{family}: {len(facts)} layouts", ("property", "least", "median", "greatest", "deviation"), rows)
    if nearest:
        click.echo("")
        distances = sorted(far for _, far in nearest.values())
        own, (other, far) = min(nearest.items(), key=lambda item: item[1][1])
        print_text(
            f"distance to the nearest other layout (share of occupied cells not in common): median "
            f"{distances[len(distances) // 2]:.2f}, minimum {far:.2f} (seeds {own} and {other})"
        )
