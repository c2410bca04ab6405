"""`factory render`: turns a states dataset into a frames dataset on this machine; continues interrupted runs."""

from __future__ import annotations

import os

import click

from coordinator.settings import CoordinatorSettings
from factory.cli.common.options import out_option, place_argument, renderer_option, verbose_option, workers_option
from factory.cli.common.output import json_option, print_result
from factory.cli.common.summary import print_summary, say_missing, summarise
from factory.cli.run.run import RunBar
from factory.dataset.site import Site
from factory.runs.local import LocalRun, run_locally
from factory.runs.render import prepare_rendering
from factory.support.logs import configure_logs
from schemas.storage.place import Place
from schemas.support.extras import require_package
from schemas.terms import RendererKind
from workers.client.stopping import stop_on_signals


@click.command("render")
@place_argument
@out_option
@workers_option("Number of rendering processes")
@renderer_option
@json_option
@verbose_option
def command(root: Place, site: Site, workers: int | None, renderer: RendererKind, as_json: bool, verbose: bool) -> int:
    """Render a states dataset into a dataset that stores frames.

    The result has the episodes and the digest that `factory run --record frames` gives. After Ctrl-C or a crash, the
    same command continues. Exits with 1 if episodes are missing at the end.
    """
    configure_logs(verbose)
    require_package("pybullet", "`factory render`")
    rendering = prepare_rendering(root, site, renderer)
    run = LocalRun(
        rendering.plan,
        rendering.catalog,
        site.home,
        workers or os.cpu_count() or 1,
        renderer,
        verbose,
        rendering.dataset.meta.gate,
        site.store,
        rendering.states,
        root,
    )
    with stop_on_signals() as (stop, _), RunBar(rendering.plan) as bar:
        progress = run_locally(run, CoordinatorSettings(), stop, bar.tell)
    if not progress.finished:
        click.echo(f"interrupted; continue with: {run.command}", err=True)
        return 130
    summary = summarise(site.place, progress)
    print_result(summary, as_json, print_summary)
    say_missing(site, progress)
    return 1 if progress.missing else 0
