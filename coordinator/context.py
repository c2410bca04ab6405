"""Shared parts of a running coordinator, opened in order. Starts no network and leases no job."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import structlog

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import add_files
from coordinator.expansion.draw import expand_layout
from coordinator.ledger.builds import number_of_layout, open_builds
from coordinator.ledger.opening import ledger_url_of, note_opened, note_version, open_run, record_ledger
from coordinator.ledger.repair import adopt_package
from coordinator.ledger.run_ledger import RunLedger
from coordinator.meters import Meters
from coordinator.options import CoordinatorOptions
from coordinator.protocol.protocol import Terms
from coordinator.recovery.reconcile import reconcile, replace_unusable_ledger
from coordinator.settings import CoordinatorSettings
from coordinator.tables.checkpoint import is_checkpoint_due
from coordinator.transfer.contract import BundleValidator
from coordinator.validation.validator import Validator
from schemas.terms import family_of

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class RunContext:
    """Archive, ledger and validator of one run; ledger and archive are reconciled."""

    terms: Terms
    """Terms of the run."""
    settings: CoordinatorSettings
    """Operational settings, which do not affect the contents of the dataset."""
    archive: Archive
    """Exclusively opened dataset: no other coordinator can open it."""
    ledger: RunLedger
    """Ledger whose writer has been started."""
    checker: BundleValidator
    """Validator of bundles."""
    clock: Callable[[], datetime]
    """Wall clock."""
    meters: Meters
    """Counters of the running coordinator."""
    packages: dict[str, Path]
    """Files that workers fetch by SHA-256; layouts are added when they are built."""
    are_tables_owed: bool
    """Whether the dataset's tables are older than the ledger."""


def open_context(stack: ExitStack, root: Path, terms: Terms, options: CoordinatorOptions) -> RunContext:
    """Opens the validator, the archive and the ledger of a run, and reconciles the ledger with the archive.

    Args:
        stack: exit stack that closes them.
        root: directory of the run.
        terms: terms of the run.
        options: options of the coordinator.

    Raises:
        UsageError: the directory contains a run of another plan or another shard.
        WorldError: another coordinator uses the directory, or the disk cannot be written.
    """
    url = ledger_url_of(root, options.ledger_url)
    packages: dict[str, Path] = {}
    for entry in terms.catalog.values():
        add_files(packages, entry)
    checker = options.checker or Validator(options.settings.pullers, packages=packages)
    stack.callback(checker.close)
    archive = stack.enter_context(open_archive(root, options.store, take_over=options.take_over))
    replace_unusable_ledger(archive, url, terms.catalog)
    ledger = stack.enter_context(RunLedger(url, terms.plan.run, options.clock, options.settings.ledger_outage_s))
    record_ledger(root, url)
    are_tables_owed = _reconcile(archive, ledger, terms=terms, checker=checker, options=options)
    return RunContext(
        terms,
        options.settings,
        archive=archive,
        ledger=ledger,
        checker=checker,
        clock=options.clock,
        meters=Meters(),
        packages=packages,
        are_tables_owed=are_tables_owed,
    )


def _adopt_layouts(ledger: RunLedger, terms: Terms, now: datetime) -> None:
    """Records in the ledger the layouts that were stored, but not recorded, when the run was interrupted."""
    plan = terms.plan
    with ledger.engine.begin() as connection:
        for build in open_builds(connection) if terms.evaluation is None else ():
            entry = terms.catalog.get(build.scene)
            if entry is not None:
                number, first = number_of_layout(plan, build), plan.spans[build.scene][0]
                planned = tuple(expand_layout(plan, number, first, entry))
                adopt_package(connection, build, sha256=entry.sha256, size=entry.size, planned=planned, now=now)


def _note_version(ledger: RunLedger, version: str) -> None:
    with ledger.engine.begin() as connection:
        former = note_version(connection, version)
    if former:
        log.warning(
            "version_changed",
            run_by=former,
            now=version,
            remedy="episodes of two versions may differ: if the digest of the dataset matters, stop, and continue with "
            "the former version",
        )


def _reconcile(
    archive: Archive, ledger: RunLedger, terms: Terms, checker: BundleValidator, options: CoordinatorOptions
) -> bool:
    planned = terms.evaluation.planned if terms.evaluation is not None else None
    is_new = open_run(
        ledger.engine,
        terms.plan,
        catalog=terms.catalog,
        lease_ttl_s=terms.lease_ttl_s,
        now=options.clock(),
        planned=planned,
        shard=options.shard,
    )
    _note_version(ledger, terms.version)
    for name, entry in terms.catalog.items():
        archive.add_scene(entry.path, name, entry.sha256, entry.textures)
        if entry.textures:
            family = family_of(name)
            terms.textures[family] = terms.textures.get(family, frozenset()).union(entry.textures)
    archive.sweep_textures(frozenset().union(*terms.textures.values()))
    _adopt_layouts(ledger, terms, options.clock())
    reconciled = reconcile(archive, ledger.engine, terms=terms, checker=checker, now=options.clock())
    if reconciled.adopted:
        with ledger.engine.begin() as connection:
            note_opened(connection, options.clock())  # the rate does not count adopted episodes
    ledger.start_writer()
    with ledger.reading() as connection:
        is_owed = is_checkpoint_due(archive, connection)
    return bool(is_new or reconciled.adopted or reconciled.requeued or is_owed)
