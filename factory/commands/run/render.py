"""`factory render`: renders a states dataset, with the sensors of rigs, on this machine; continues interrupted runs."""

from __future__ import annotations

import os
import shlex

import click

from coordinator.settings import CoordinatorSettings
from factory.commands.common.output import print_json
from factory.commands.common.summary import print_missing, print_summary, summarise
from factory.commands.run.run import RunBar
from factory.dataset.site import Site, site_of
from factory.runs.local import LocalRun, run_locally
from factory.runs.render import prepare_rendering
from factory.support.logs import configure_logs
from schemas.errors import UsageError
from schemas.rig.rig_file import load_rig
from schemas.storage.place import Place
from schemas.support.extras import require_package
from schemas.terms import RendererKind
from workers.client.stopping import stop_on_signals


def execute(
    root: Place,
    site: Site,
    rigs: tuple[str, ...],
    appearance: str | None,
    workers: int | None,
    renderer: RendererKind,
    as_json: bool,
    verbose: bool,
) -> int:
    """Executes `factory render`."""
    configure_logs(verbose)
    require_package("pybullet", "`factory render`")
    summaries = {}
    with stop_on_signals() as (stop, _):
        for rig, out in _outputs(site, rigs):
            run = _prepared(root, out, rig, appearance, workers, renderer, verbose)
            with RunBar(run.plan) as bar:
                progress = run_locally(run, CoordinatorSettings(), stop, bar.tell)
            if not progress.finished:
                options = [word for each in rigs for word in ("--rig", each)]
                options += ["--appearance", appearance] if appearance else []
                again = shlex.join(["factory", "render", str(root), *options, "-o", str(site)])
                click.echo(f"interrupted; continue with: {again}", err=True)
                return 130
            summaries[str(out)] = summarise(out.place, progress)
            if not as_json:
                print_summary(summaries[str(out)])
            print_missing(out, progress)
    if as_json:
        print_json(list(summaries.values()) if len(rigs) > 1 else summaries[str(site)])
    return 1 if any(summary["missing"] for summary in summaries.values()) else 0


def _outputs(site: Site, rigs: tuple[str, ...]) -> list[tuple[str | None, Site]]:
    """Returns the location of the dataset of each rig: --out for a single rig, --out/NAME for several.

    Raises:
        UsageError: a rig does not exist, or two rigs have the same name.
    """
    if len(rigs) < 2:
        return [(rigs[0] if rigs else None, site)]
    names = [load_rig(rig, control_hz=None).name for rig in rigs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--rig: two rigs are named {twice!r}, so their datasets would have the same name: rename one")
    return [(rig, site_of(site.place / name)) for rig, name in zip(rigs, names, strict=True)]


def _prepared(
    root: Place,
    out: Site,
    rig: str | None,
    appearance: str | None,
    workers: int | None,
    renderer: RendererKind,
    verbose: bool,
) -> LocalRun:
    rendering = prepare_rendering(root, out, renderer, rig, appearance)
    return LocalRun(
        rendering.plan,
        rendering.catalog,
        out.state_dir,
        workers or os.cpu_count() or 1,
        renderer,
        verbose,
        rendering.dataset.meta.gate,
        out.store,
        rendering.states,
        root,
        rig,
        appearance,
    )
