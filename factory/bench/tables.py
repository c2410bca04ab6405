"""Prints the progress and the results of benchmarks: tables of medians with their range. Computes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

from factory.bench.results import (
    CollectBench,
    Machine,
    ReadBench,
    RenderBench,
    RolloutBench,
    Spread,
    StageCost,
)
from factory.support.terminal import Bars, print_table


@contextmanager
def progress_bar(name: str, total: int) -> Iterator[Callable[[], None]]:
    """Shows a progress bar; yields the function that advances it by one."""
    with Bars(refresh_per_second=1) as bar:
        task = bar.add_task(f"bench {name}", total=total)
        yield lambda: bar.advance(task)


def show_rollout(report: RolloutBench) -> None:
    """Prints the speed of collection in each scene, the time of each stage, and the size of the output."""
    print_machine(report.machine, report.renderer)
    columns = (
        "scene",
        "frames/s",
        "range",
        "frames/CPU s",
        "range",
        "by episode",
        "episodes",
        "frames",
        "failed",
        "plain",
        "ratio",
    )
    rows = [
        (
            *(
                name,
                round_digits(rates.wall.median),
                range_text(rates.wall),
                round_digits(rates.cpu.median),
                range_text(rates.cpu),
            ),
            *(range_text(rates.by_job), rates.episodes, rates.frames, rates.failed_attempts),
            *(None if rates.plain is None else round(rates.plain.frames_per_s, 2), rates.ratio),
        )
        for name, rates in report.scenes.items()
    ]
    work = f"{report.repeats} runs of the same jobs of plan {report.plan}, screening {report.screening}"
    print_table(f"Collection on one core, {work}", columns, rows)
    _print_stages("by stage", {name: rates.stages for name, rates in report.scenes.items()})
    _print_stages("in the coordinator", {name: rates.delivery for name, rates in report.scenes.items()})
    kinds = list(dict.fromkeys(kind for rates in report.scenes.values() for kind in rates.kb_per_frame))
    sizes = [
        (name, *(rates.kb_per_frame.get(kind, 0.0) for kind in kinds), sum(rates.kb_per_frame.values()))
        for name, rates in report.scenes.items()
    ]
    print_table("\nkB per frame, by bundle member", ("scene", *kinds, "all"), sizes)
    memory = [
        (name, rates.memory.start_mib, rates.memory.end_mib, rates.memory.peak_mib)
        for name, rates in report.scenes.items()
    ]
    print_table("\nResident memory, MiB", ("scene", "after 1 episode", "at the end", "peak"), memory)


def show_collect(report: CollectBench) -> None:
    """Prints the pace of whole runs."""
    print_machine(report.machine)
    rows = [
        (
            *(name, pace.episodes, pace.attempts),
            *(round(pace.episodes_per_hour.median), range_text(pace.episodes_per_hour)),
            *(round_digits(pace.cpu_s_per_episode.median), range_text(pace.cpu_s_per_episode)),
        )
        for name, pace in report.variants.items()
    ]
    work = f"screening {report.screening}, {report.workers} workers, {report.repeats} runs each"
    columns = ("variant", "episodes", "attempts", "episodes/h", "range", "CPU s/episode", "range")
    print_table(f"Runs of plan {report.plan}, {work}", columns, rows)


def show_render(report: RenderBench) -> None:
    """Prints the speed of rendering in each scene and the time of each stage."""
    print_machine(report.machine, report.renderer)
    rows = [
        (
            *(name, round_digits(rates.frames_per_s.median), range_text(rates.frames_per_s)),
            *(rates.frames, rates.triangles, round(rates.triangles_in_view)),
        )
        for name, rates in report.scenes.items()
    ]
    print_table(
        f"Rendering only, {_describe_size(report.size, report.antialias)}, {report.repeats} runs",
        ("scene", "frames/s", "range", "frames", "triangles", "in view"),
        rows,
    )
    _print_stages("by stage", {name: rates.stages for name, rates in report.scenes.items()})
    if all(rates.without_colour for rates in report.scenes.values()):
        _print_stages("without colour", {name: rates.without_colour for name, rates in report.scenes.items()})


def show_read(report: ReadBench) -> None:
    """Prints the results of the reader benchmark."""
    print_machine(report.machine)
    rows = [
        (
            "random frames, all three images, frames/s",
            report.random_frames_per_s.median,
            range_text(report.random_frames_per_s),
        ),
        *(
            ("random frames, all three images, frames/CPU s", rate.median, range_text(rate))
            for rate in (report.random_frames_per_cpu_s,)
            if rate is not None
        ),
        *((f"only {name}, frames/s", rate.median, range_text(rate)) for name, rate in report.by_image.items()),
        ("opening an episode, ms", report.open_ms.median, range_text(report.open_ms)),
    ]
    loaders = {
        "one thread": report.one_thread_frames_per_s,
        "threads on all cores": report.threads_frames_per_s,
        f"{report.loader_workers} workers": report.loader_frames_per_s,
    }
    rows += [
        (f"shuffled DataLoader, {name}, frames/s", rate.median, range_text(rate))
        for name, rate in loaders.items()
        if rate is not None
    ]
    pictures = _describe_size(report.size, report.antialias)
    title = f"{report.frames} random frames, {pictures}, of {report.episodes} episodes, {report.repeats} runs"
    print_table(title, ("quantity", "median", "range"), rows)
    if report.loader_frames_per_s is None:
        click.echo("note: torch is not installed; the DataLoader was not measured", err=True)


def _describe_size(size: int, antialias: int) -> str:
    return f"{size} x {size} pixels" + (f", {antialias} x {antialias} samples each" if antialias > 1 else "")


def print_machine(machine: Machine, renderer: str | None = None) -> None:
    """Prints the machine and its load, and the renderer of the measurement."""
    click.echo(f"{machine.cpu}, {machine.cores} cores, {machine.memory_gib:g} GiB; initial load {machine.load_1m:g}")
    if renderer is not None:
        click.echo(renderer)
    click.echo()


def _print_stages(where: str, scenes: dict[str, tuple[StageCost, ...]]) -> None:
    names = list(dict.fromkeys(cost.stage for costs in scenes.values() for cost in costs))
    by_scene = [{cost.stage: cost.cpu_ms.median for cost in costs} for costs in scenes.values()]
    rows = [(name, *(stages.get(name, 0.0) for stages in by_scene)) for name in names]
    rows.append(("all", *(sum(stages.values()) for stages in by_scene)))
    print_table(f"\nCPU time per frame, ms, {where}", ("stage", *scenes), rows)


def range_text(spread: Spread) -> str:
    """Returns the range of a spread, with three digits."""
    return f"{round_digits(spread.low)} to {round_digits(spread.high)}"


def round_digits(value: float) -> float:
    """Returns a value with three significant digits."""
    return float(f"{value:.3g}")
