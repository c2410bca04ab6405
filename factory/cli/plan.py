"""`factory plan`: shows the episodes of a plan, and finds the nearest plan that its scenes support."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import json_option, plan_argument, shrink_options
from schemas.errors import InvalidPlan, UsageError, WorldError
from schemas.support.shell import quoted
from schemas.support.suggest import did_you_mean

if TYPE_CHECKING:
    from factory.runs.plan_changes import PlanChanges
    from schemas.plan import Plan


@click.group("plan", cls=CommandGroup)
def command() -> None:
    """Write, explain and check plans; find a feasible plan."""


@command.command("show")
@plan_argument(default="demo")
@shrink_options
@json_option
def show(plan_name: str, changes: PlanChanges, as_json: bool) -> None:
    """Show a plan's quotas, categories, templates and ambiguity.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: demo. Files named in the
    plan must exist. Categories, templates, ambiguity, expected features of verified instructions and the share of far
    starts around a corner are shown only if all scenes are built and support the plan. Of layouts, those that are
    built count.
    """
    from coordinator.expansion.balance import planned_categories
    from coordinator.expansion.plan_file import load_plan
    from coordinator.expansion.possible import find_impossible
    from coordinator.expansion.scene_cells import each_scene
    from coordinator.expansion.sentences import find_missing_instructions, forecast_language, sample_instructions
    from coordinator.expansion.summary import offer_rows, summarise
    from factory.runs import plan_text
    from factory.runs.catalog import find_built, require_files
    from factory.runs.estimate import estimate_run
    from factory.runs.start import shrunk_plan, warn_of_empty_splits
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_json, print_text, stderr

    plan = shrunk_plan(load_plan(plan_name), changes)
    require_files(plan)
    catalog, fixed = find_built(plan, scene_cache()), _without_families(plan)
    unknown = [scene.name for scene in fixed.scenes if scene.name not in catalog]
    mistakes = None if unknown else find_impossible(fixed, catalog)
    is_known = mistakes == [] and bool(catalog)
    content = summarise(plan, catalog) if is_known else None
    forecast = forecast_language(plan, catalog) if is_known and plan.language is not None else None
    offers = offer_rows(plan, catalog) if is_known else []
    in_layouts = dict(planned_categories(plan).most_common())
    mistakes = find_missing_instructions(fixed, each_scene(fixed, catalog)) if mistakes == [] else mistakes
    samples = [] if content is None else sample_instructions(plan, catalog)
    corners = {} if content is None else plan_text.corner_shares(plan, catalog)
    if as_json:
        quotas = {"plan": plan.model_dump(mode="json"), "digest": plan.digest, "cells": plan_text.cell_rows(plan)}
        drawn = None if content is None else plan_text.content_data(content) | {"far_corner_shares": corners}
        checks = {"categories_in_layouts": in_layouts, "mistakes": mistakes, "not_built": unknown, "samples": samples}
        features = None if plan.language is None else plan_text.feature_data(plan.language, forecast)
        expected = {"features": features, "offers": [asdict(row) for row in offers]}
        print_json(quotas | {"content": drawn, "estimate": asdict(estimate_run(plan))} | checks | expected)
        return
    plan_text.print_plan(plan)
    if content is not None:
        plan_text.print_content(plan, content)
    if plan.language is not None:
        plan_text.print_language(plan, plan.language, content, forecast)
    if any(row.objects < row.reachable or row.groups is not None for row in offers):
        plan_text.print_offers(offers)
    plan_text.print_samples(plan, samples)
    if len(fixed.scenes) < len(plan.scenes):
        plan_text.print_built_layouts(plan, catalog)
        plan_text.print_layout_categories(in_layouts)
    if corners:
        plan_text.print_corners(corners)
    warn_of_empty_splits(plan)
    for line in mistakes or ():
        print_text(f"impossible: {line}")
    nearest = f"`factory plan nearest {quoted(plan_name)}`"
    if mistakes and content is None:
        print_text(f"find the nearest feasible plan with {nearest}")
    elif unknown:
        print_text(
            f"note: the plan was not checked against its scenes, because these are not built: {', '.join(unknown)}; "
            f"{nearest} builds them and checks the plan",
            stderr,
        )


@command.command("new")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@json_option
def new(file: Path, as_json: bool) -> None:
    """Write a commented starter plan to FILE, which must not exist."""
    from factory.runs.plan_keys import STARTER
    from factory.support.terminal import print_json, print_text

    if file.exists():
        raise UsageError(f"{file} exists: give another name")
    _write(file, STARTER)
    if as_json:
        print_json({"file": str(file)})
        return
    print_text(f"plan written to {file}; edit it, then check it with: factory plan show {quoted(file)}")


@command.command("keys")
@click.argument("table", default="")
@click.option("--markdown", is_flag=True, help="Print the table of the documentation.")
@json_option
def keys(table: str, markdown: bool, as_json: bool) -> None:
    """Explain the keys of a plan file.

    TABLE limits the list to keys that begin with it, such as camera or scenes.
    """
    from factory.runs.plan_keys import describe_key, keys_as_markdown, list_keys
    from factory.support.terminal import print_json, print_text

    listed = [key for key in list_keys() if key.key.startswith(table)]
    if not listed:
        tables = sorted({key.key.partition(".")[0].removesuffix("[]") for key in list_keys()})
        raise UsageError(
            f"no key begins with {table!r}{did_you_mean(table, tables)}; keys and tables: {', '.join(tables)}"
        )

    if as_json:
        print_json({"keys": [key._asdict() for key in listed]})
    elif markdown:
        click.echo(keys_as_markdown(listed))
    else:
        for key in listed:
            print_text(describe_key(key, width=shutil.get_terminal_size().columns))


@command.command("nearest")
@plan_argument(default="demo")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="TOML file to write the plan to. Default: no file.",
)
@shrink_options
@json_option
def nearest(plan_name: str, out: Path | None, changes: PlanChanges, as_json: bool) -> None:
    """Find the nearest plan that the scenes support.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: demo. Scenes that are not in
    the cache are built or imported. Layouts are not checked: if a layout cannot fulfil the plan, the run uses the
    layout of another seed.
    """
    from coordinator.expansion.nearest import find_nearest
    from coordinator.expansion.plan_file import load_plan, plan_to_toml
    from coordinator.expansion.possible import find_impossible
    from factory.runs.catalog import collect_scenes
    from factory.runs.plan_text import cell_rows, print_nearest
    from factory.runs.start import shrunk_plan
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_building, print_json, print_text

    plan = shrunk_plan(load_plan(plan_name), changes)
    fixed = _without_families(plan)
    with tempfile.TemporaryDirectory(prefix="plan-") as folder:
        catalog = collect_scenes(fixed, Path(folder), scene_cache(), print_building)
    mistakes, result = find_impossible(fixed, catalog), find_nearest(plan, catalog)
    if result.plan is None:
        raise InvalidPlan(f"the scenes of plan {plan.name!r} support neither it nor any similar plan", mistakes)
    if out is not None:
        _write(out, plan_to_toml(result.plan))
    if as_json:
        differences: dict[str, Any] = {"possible": not mistakes, "mistakes": mistakes, "changes": result.changes}
        quotas = {"plan": result.plan.model_dump(mode="json"), "cells": cell_rows(result.plan)}
        print_json(differences | {"moved": result.moved} | quotas | {"file": None if out is None else str(out)})
        return
    print_nearest(plan, result, mistakes)
    if out is not None:
        print_text(f"plan written to {out}; generate the dataset with: factory run {quoted(out)} --out DIR")


def _without_families(plan: Plan) -> Plan:
    return plan.model_copy(update={"scenes": tuple(scene for scene in plan.scenes if scene.layouts is None)})


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise WorldError(f"cannot write {path} ({error.strerror}); choose another file with -o") from error
