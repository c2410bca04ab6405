"""`factory render`: renders a states dataset, with the sensors of rigs, on this machine; continues interrupted runs."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

import click

from coordinator.defaults import usable_cores
from factory.cli.options import (
    appearance_option,
    json_option,
    out_option,
    place_argument,
    renderer_option,
    rig_option,
    verbose_option,
    workers_option,
)
from factory.dataset.site import Site, site_of
from schemas.errors import UsageError

if TYPE_CHECKING:
    from schemas.storage.place import Place
    from schemas.terms import RendererKind


@click.command("render")
@place_argument
@out_option
@rig_option(
    "Sensors to store: a built-in rig or a TOML file; `paper` is the recorded camera, which is always stored. With "
    "several rigs, the dataset of each rig is OUT/NAME. Default: the plan's rig.",
    multiple=True,
)
@appearance_option("Default: the plan's.")
@workers_option("Number of rendering processes")
@renderer_option
@json_option
@verbose_option
def command(
    root: Place,
    site: Site,
    rigs: tuple[str, ...],
    appearance: str | None,
    workers: int | None,
    renderer: RendererKind,
    as_json: bool,
    verbose: bool,
) -> int:
    """Render the frames and sensors of a states dataset.

    The result has the episodes and the digest that `factory run --record frames` gives. After Ctrl-C or a crash, the
    same command continues. Exits with 1 if episodes are missing at the end.
    """
    from coordinator.settings import CoordinatorSettings
    from factory.runs.local import LocalRun, run_locally
    from factory.runs.render import prepare_rendering
    from factory.runs.summary import RunBar, print_missing, print_summary, summarise
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_json
    from schemas.support.extras import require_package
    from workers.client.stopping import stop_on_signals

    configure_logs(verbose)
    require_package("pybullet", "`factory render`")
    summaries = {}
    with stop_on_signals() as (stop, _):
        for rig, out in _outputs(site, rigs):
            rendering = prepare_rendering(root, out, renderer, rig=rig, appearance=appearance)
            run = LocalRun(
                plan=rendering.plan,
                catalog=rendering.catalog,
                root=out.state_dir,
                workers=workers or usable_cores(),
                renderer=renderer,
                verbose=verbose,
                gate=rendering.dataset.meta.gate,
                store=out.store,
                find_states=rendering.states,
                states=root,
                rig=rig,
                appearance=appearance,
            )
            with RunBar(run.plan) as bar:
                progress = run_locally(run, CoordinatorSettings(), stop, bar.show)
            if not progress.finished:
                click.echo(f"interrupted; continue with: {_command_of(root, site, rigs, appearance)}", err=True)
                return 130
            summaries[str(out)] = summarise(out.place, progress)
            if not as_json:
                print_summary(summaries[str(out)])
            print_missing(out, progress)
    if as_json:
        print_json(list(summaries.values()) if len(rigs) > 1 else summaries[str(site)])
    return 1 if any(summary["missing"] for summary in summaries.values()) else 0


def _command_of(root: Place, site: Site, rigs: tuple[str, ...], appearance: str | None) -> str:
    """Returns the command line that continues the rendering."""
    options = [word for rig in rigs for word in ("--rig", rig)]
    options += ["--appearance", appearance] if appearance else []
    return shlex.join(["factory", "render", str(root), *options, "-o", str(site)])


def _outputs(site: Site, rigs: tuple[str, ...]) -> list[tuple[str | None, Site]]:
    """Returns the location of the dataset of each rig: --out for a single rig, --out/NAME for several.

    Raises:
        UsageError: a rig does not exist, or two rigs have the same name.
    """
    from schemas.rig.rig_file import load_rig

    if len(rigs) < 2:
        return [(rigs[0] if rigs else None, site)]
    names = [load_rig(rig, control_hz=None).name for rig in rigs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--rig: two rigs are named {twice!r}, so their datasets would have the same name: rename one")
    return [(rig, site_of(site.place / name)) for rig, name in zip(rigs, names, strict=True)]
