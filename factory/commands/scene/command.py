"""`factory scene build` and `factory scene import`: make the package of a scene."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from factory.commands.common.output import print_json, print_result, stderr
from factory.commands.scene.choice import BuiltInLayout, built_in_layout
from factory.commands.scene.package import describe_package, next_steps, print_others, print_package, print_steps
from factory.scenes.limits import StageLimits, Unit, UpAxis
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache


def build(
    name: str, seed: int, rules: Path | None, targets: Path | None, cache: Path | None, as_json: bool, verbose: bool
) -> None:
    """Executes `factory scene build`."""
    from factory.scenes.build import build_scene, load_edits

    configure_logs(verbose)
    book, chosen = load_edits(rules, targets, name)
    layout = built_in_layout(name, seed) or BuiltInLayout(name, seed, None)
    with stderr.status(f"building {layout.name}, seed {layout.seed}"):
        path = build_scene(layout.name, layout.seed, cache or scene_cache(), book, chosen, called=layout.called)
    facts = describe_package(path)
    print_result(facts, as_json, print_package)


def import_(
    file: Path,
    name: str | None,
    max_triangles: int,
    max_file_mb: int,
    unit: Unit | None,
    up: UpAxis | None,
    models: tuple[Path, ...],
    skip_missing: bool,
    allow_outside: bool,
    floor: float | None,
    ceiling: float | None,
    rules: Path | None,
    targets: Path | None,
    cache: Path | None,
    as_json: bool,
    verbose: bool,
) -> None:
    """Executes `factory scene import`."""
    from factory.scenes.build import import_scene, load_edits  # needs usd-core

    configure_logs(verbose)
    called = name or file.stem.lower()
    book, chosen = load_edits(rules, targets, called)
    limits = StageLimits(max_triangles, allow_outside, ceiling, unit, up, models, max_file_mb, floor, skip_missing)
    with stderr.status(f"importing {file}"):
        path = import_scene(file, called, cache or scene_cache(), book, chosen, limits)
    facts = describe_package(path)
    made_with = {"rules": rules, "targets": targets}
    used: dict[str, object] = {key: str(edit.resolve()) for key, edit in made_with.items() if edit is not None}
    searched = tuple(str(folder.resolve()) for folder in models)
    options = {"allow_outside": allow_outside, "ceiling_m": ceiling, "unit": unit, "up": up, "models": searched}
    options["skip_missing"] = skip_missing
    if floor is not None:
        used["floor_m"] = floor
    used |= {key: value for key, value in options.items() if value}
    steps = next_steps(path, file, cache is None, used)
    if as_json:
        print_json(facts | asdict(steps))
    else:
        print_package(facts)
        print_others(facts)
        print_steps(steps)
