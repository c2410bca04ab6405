"""`factory eval specs`: writes evaluation episodes to a file, those of a dataset or newly sampled ones."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import click

from factory.commands.common.bars import one_bar
from factory.commands.common.output import print_json, print_table
from factory.commands.eval.campaign import splits_of
from factory.dataset.reader import Dataset
from factory.eval.models.spec import SpecSet, write_specs
from factory.eval.specs.from_dataset import specs_of_dataset
from factory.eval.specs.unfiltered import unfiltered_specs
from factory.support.logs import configure_logs
from schemas.storage.place import Place
from schemas.terms import Split
from workers.sim.context import SceneRenderer


def execute(
    root: Place,
    splits: tuple[str, ...] | None,
    unfiltered: bool,
    episodes: int | None,
    seed: int,
    out: Path,
    as_json: bool,
) -> int:
    """Executes `factory eval specs`."""
    configure_logs()
    dataset = Dataset(root)
    chosen = splits_of(dataset, splits)
    with one_bar("start states") as tell:
        if unfiltered:
            with SceneRenderer() as stage:
                found = unfiltered_specs(dataset, chosen, episodes or 100, seed, stage, tell)
        else:
            found = specs_of_dataset(dataset, chosen, tell, episodes)
    write_specs(found, out)
    if as_json:
        print_json(_summary(found, out))
    else:
        _print(found, out)
    return 0


def _summary(found: SpecSet, out: Path) -> dict[str, object]:
    return {
        "file": str(out),
        "digest": found.digest,
        "source": found.source,
        "episodes": len(found.specs),
        "splits": dict(Counter(str(spec.split) for spec in found.specs)),
        "tiers": dict(Counter(str(spec.tier) for spec in found.specs)),
        "scenes": dict(Counter(spec.scene for spec in found.specs)),
        "starts": dict(Counter(spec.spawn_source for spec in found.specs)),
        "target_in_view": sum(spec.is_target_in_view for spec in found.specs),
        "two_or_more_categories_in_view": sum(len(spec.categories_in_view) > 1 for spec in found.specs),
        "without_way": sum(spec.geodesic_m is None for spec in found.specs),
    }


def _print(found: SpecSet, out: Path) -> None:
    summary = _summary(found, out)
    rows = [
        (split, sum(spec.split == split for spec in found.specs))
        for split in Split
        if any(spec.split == split for spec in found.specs)
    ]
    print_table("", ("split", "episodes"), rows)
    click.echo(f"{len(found.specs)} episodes: {found.source}")
    click.echo(
        f"target in view at the start: {summary['target_in_view']}; two or more categories in view: "
        f"{summary['two_or_more_categories_in_view']}; no path on the floor: {summary['without_way']}"
    )
    click.echo(f"written to {out}, digest {found.digest[:16]}")
