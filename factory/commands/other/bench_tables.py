"""Prints the results of benchmarks: tables of medians with their range. Computes nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from factory.bench.results import (
    CollectBench,
    CoordinatorBench,
    Machine,
    Memory,
    MemoryBench,
    ReadBench,
    RenderBench,
    RolloutBench,
    Spread,
    StageCost,
)
from factory.support.terminal import print_table

if TYPE_CHECKING:
    from factory.bench.reading.dataset import DatasetBench
    from factory.bench.reading.serve import RequestCost, ServeBench


def show_serve(report: ServeBench) -> None:
    """Prints the times of pages and frames, and the cost of open tabs."""
    _print_machine(report.machine)
    pages: dict[str, RequestCost] = {"/": report.first_page, **report.table_page, "first frame": report.first_frame}
    rows = [
        (path, *(round(value, 1) for value in (cost.first_ms, cost.wall_ms.median)), _range(cost.wall_ms), cost.cpu_ms)
        for path, cost in pages.items()
    ]
    columns = ("request", "first, ms", "median, ms", "range", "CPU, ms")
    print_table(f"Web page of {report.episodes} episodes", columns, rows)
    click.echo(f"\nplayback: {report.frames_per_s:.1f} frames/s, {report.frame_cpu_ms:.1f} ms of CPU time per frame")
    share, idle = 100 * report.tabs_core_share, 100 * report.idle_core_share
    click.echo(f"{report.tabs} open tabs for {report.tabs_s:.0f} s: {share:.2f} % of a core, {idle:.2f} % without tabs")


def show_rollout(report: RolloutBench) -> None:
    """Prints the speed of collection in each scene, the time of each stage, and the size of the output."""
    _print_machine(report.machine, report.renderer)
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
            *(name, _round(found.wall.median), _range(found.wall), _round(found.cpu.median), _range(found.cpu)),
            *(_range(found.by_job), found.episodes, found.frames, found.failed_attempts),
            *(None if found.plain is None else round(found.plain.frames_per_s, 2), found.ratio),
        )
        for name, found in report.scenes.items()
    ]
    work = f"{report.repeats} runs of the same jobs of plan {report.plan}, screening {report.screening}"
    print_table(f"Collection on one core, {work}", columns, rows)
    _print_stages("by stage", {name: found.stages for name, found in report.scenes.items()})
    _print_stages("in the coordinator", {name: found.delivery for name, found in report.scenes.items()})
    kinds = list(dict.fromkeys(kind for found in report.scenes.values() for kind in found.kb_per_frame))
    sizes = [
        (name, *(found.kb_per_frame.get(kind, 0.0) for kind in kinds), sum(found.kb_per_frame.values()))
        for name, found in report.scenes.items()
    ]
    print_table("\nkB per frame, by bundle member", ("scene", *kinds, "all"), sizes)
    memory = [
        (name, found.memory.start_mib, found.memory.end_mib, found.memory.peak_mib)
        for name, found in report.scenes.items()
    ]
    print_table("\nResident memory, MiB", ("scene", "after 1 episode", "at the end", "peak"), memory)


def show_collect(report: CollectBench) -> None:
    """Prints the pace of whole runs."""
    _print_machine(report.machine)
    rows = [
        (
            *(name, pace.episodes, pace.attempts),
            *(round(pace.episodes_per_hour.median), _range(pace.episodes_per_hour)),
            *(_round(pace.cpu_s_per_episode.median), _range(pace.cpu_s_per_episode)),
        )
        for name, pace in report.variants.items()
    ]
    work = f"screening {report.screening}, {report.workers} workers, {report.repeats} runs each"
    columns = ("variant", "episodes", "attempts", "episodes/h", "range", "CPU s/episode", "range")
    print_table(f"Runs of plan {report.plan}, {work}", columns, rows)


def show_render(report: RenderBench) -> None:
    """Prints the speed of rendering in each scene and the time of each stage."""
    _print_machine(report.machine, report.renderer)
    rows = [
        (
            *(name, _round(found.frames_per_s.median), _range(found.frames_per_s)),
            *(found.frames, found.triangles, round(found.triangles_in_view)),
        )
        for name, found in report.scenes.items()
    ]
    print_table(
        f"Rendering only, {_describe_size(report.size, report.antialias)}, {report.repeats} runs",
        ("scene", "frames/s", "range", "frames", "triangles", "in view"),
        rows,
    )
    _print_stages("by stage", {name: found.stages for name, found in report.scenes.items()})
    if all(found.without_colour for found in report.scenes.values()):
        _print_stages("without colour", {name: found.without_colour for name, found in report.scenes.items()})


def show_memory(report: MemoryBench) -> None:
    """Prints the memory of a simulation process over many short episodes."""
    _print_machine(report.machine, report.renderer)
    rows = [
        ("episodes", report.episodes),
        ("successful episodes, the others ended early", report.succeeded),
        ("frames", report.frames),
        ("before the first episode, MiB", report.memory.start_mib),
        ("second tenth of the episodes, MiB", report.settled_mib),
        ("last tenth of the episodes, MiB", report.last_mib),
        ("peak, MiB", report.memory.peak_mib),
    ]
    print_table(f"Resident memory, alternating scenes: {', '.join(report.scenes)}", ("quantity", "value"), rows)


def show_dataset(report: DatasetBench) -> None:
    """Prints the costs of a large dataset."""
    _print_machine(report.machine)
    reader, verification, checkpoint = report.reader, report.verification, report.checkpoint
    rows = [
        ("generating, s", report.generate_s, ""),
        ("opening, s", reader.open_s, _peak(reader.opened)),
        ("selecting a split and a tier, s", reader.filter_s, ""),
        ("first episode, s", reader.first_episode_s, ""),
        ("random episodes/s", reader.episodes_per_s, _peak(reader.memory)),
        ("random episodes/CPU s", reader.episodes_per_cpu_s, ""),
        ("digest, s", reader.digest_s, ""),
        (f"verification, {verification.findings} findings, s", verification.seconds, _peak(verification.memory)),
        ("status, s", report.ledger.status_s, ""),
        ("audit at the start of a coordinator, s", report.ledger.audit_s, ""),
        ("first checkpoint of a process, s", checkpoint.rewrite_s, _peak(checkpoint.memory)),
        ("checkpoint after 50 changes, s", checkpoint.changed_s, ""),
        ("checkpoint without changes, s", checkpoint.unchanged_s, ""),
    ]
    title = f"{report.episodes} states episodes, {report.files} files, {report.gigabytes:.2f} GB"
    print_table(title, ("quantity", "value", "memory"), rows)


def _peak(memory: Memory) -> str:
    return f"peak {memory.peak_mib:.0f} MiB"


def show_coordinator(report: CoordinatorBench) -> None:
    """Prints the results of the coordinator benchmark."""
    _print_machine(report.machine)
    rows = [
        ("lease + announce + archive, cycles/s", report.cycles_per_s.median, _range(report.cycles_per_s)),
        ("reopening the ledger, s", report.reopen_s.median, _range(report.reopen_s)),
        ("reading the progress, s", report.progress_s.median, _range(report.progress_s)),
        ("validation, ms per frame", report.validate_ms_per_frame.median, _range(report.validate_ms_per_frame)),
        (
            f"validation by {report.pullers} pullers, frames/s",
            report.validated_frames_per_s.median,
            _range(report.validated_frames_per_s),
        ),
        ("archiving, MB/s", report.archive_mb_per_s.median, _range(report.archive_mb_per_s)),
        ("filling the ledger, s", report.fill_s, ""),
        ("resident memory at the end, MiB", report.memory.end_mib, f"peak {report.memory.peak_mib:.0f}"),
    ]
    title = f"{report.jobs} jobs, {report.workers} requests in flight"
    print_table(title, ("quantity", "median", "range"), rows)
    wire, sessions, deliveries = report.wire, report.wire.session_load, report.wire.delivery_load
    rows = [
        ("claim + announcement over zenoh, cycles/s", wire.cycles_per_s.median, _range(wire.cycles_per_s)),
        ("small bundles archived during these cycles, 1/s", wire.archived_per_s.median, _range(wire.archived_per_s)),
        (
            "CPU time of the coordinator, ms per cycle",
            _round(wire.coordinator_cpu_ms.median),
            f"on a dedicated core: {1000 / wire.coordinator_cpu_ms.median:.0f} cycles/s",
        ),
        ("CPU time of the workers, ms per cycle", _round(wire.workers_cpu_ms.median), _range(wire.workers_cpu_ms)),
        ("start-up until it listens, s", wire.start_s.median, _range(wire.start_s)),
        (
            f"memory with {sessions.sessions} sessions, MiB",
            sessions.memory.end_mib,
            f"peak {sessions.memory.peak_mib:.0f}",
        ),
        (
            f"{deliveries.workers} workers send {deliveries.bundle_mb:.0f} MB each, MB/s",
            deliveries.mb_per_s,
            f"{deliveries.seconds:.1f} s in total",
        ),
        ("peak memory during these deliveries, MiB", deliveries.memory.peak_mib, ""),
        (
            "claim of another worker during these deliveries, p99 ms",
            deliveries.claim_p99_ms,
            f"p50 {deliveries.claim_p50_ms:.1f}, n {deliveries.claims}",
        ),
    ]
    print_table("the same coordinator in a separate process", ("quantity", "value", "details"), rows)


def show_read(report: ReadBench) -> None:
    """Prints the results of the reader benchmark."""
    _print_machine(report.machine)
    rows = [
        (
            "random frames, all three images, frames/s",
            report.random_frames_per_s.median,
            _range(report.random_frames_per_s),
        ),
        *(
            ("random frames, all three images, frames/CPU s", found.median, _range(found))
            for found in (report.random_frames_per_cpu_s,)
            if found is not None
        ),
        *((f"only {name}, frames/s", found.median, _range(found)) for name, found in report.by_image.items()),
        ("opening an episode, ms", report.open_ms.median, _range(report.open_ms)),
    ]
    loaders = {
        "one thread": report.one_thread_frames_per_s,
        "threads on all cores": report.threads_frames_per_s,
        f"{report.loader_workers} workers": report.loader_frames_per_s,
    }
    rows += [
        (f"shuffled DataLoader, {name}, frames/s", found.median, _range(found))
        for name, found in loaders.items()
        if found is not None
    ]
    pictures = _describe_size(report.size, report.antialias)
    title = f"{report.frames} random frames, {pictures}, of {report.episodes} episodes, {report.repeats} runs"
    print_table(title, ("quantity", "median", "range"), rows)
    if report.loader_frames_per_s is None:
        click.echo("note: torch is not installed; the DataLoader was not measured", err=True)


def _describe_size(size: int, antialias: int) -> str:
    return f"{size} x {size} pixels" + (f", {antialias} x {antialias} samples each" if antialias > 1 else "")


def _print_machine(machine: Machine, renderer: str | None = None) -> None:
    click.echo(f"{machine.cpu}, {machine.cores} cores, {machine.memory_gib:g} GiB; initial load {machine.load_1m:g}")
    if renderer is not None:
        click.echo(renderer)
    click.echo()


def _print_stages(where: str, scenes: dict[str, tuple[StageCost, ...]]) -> None:
    names = list(dict.fromkeys(cost.stage for costs in scenes.values() for cost in costs))
    by_scene = [{cost.stage: cost.cpu_ms.median for cost in costs} for costs in scenes.values()]
    rows = [(name, *(found.get(name, 0.0) for found in by_scene)) for name in names]
    rows.append(("all", *(sum(found.values()) for found in by_scene)))
    print_table(f"\nCPU time per frame, ms, {where}", ("stage", *scenes), rows)


def _range(spread: Spread) -> str:
    return f"{_round(spread.low)} to {_round(spread.high)}"


def _round(value: float) -> float:
    return float(f"{value:.3g}")
