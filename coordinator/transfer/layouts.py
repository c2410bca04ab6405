"""Stores the packages of layouts that workers have built, and inserts the episodes of each layout into the ledger.

The module transfers nothing. A package that cannot fulfil the plan is refused, and the next seed follows.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, MutableMapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import structlog

from coordinator.archive.contract import Archive, Staged
from coordinator.expansion.catalog import SceneEntry, read_entry
from coordinator.expansion.draw import expand_layout
from coordinator.expansion.possible import faults_of
from coordinator.expansion.scene_cells import scene_cells
from coordinator.ledger import outcomes
from coordinator.ledger.database.writer import Writer
from coordinator.protocol.protocol import Terms, fail_attempt
from coordinator.protocol.pulls import BuildJob, Pull
from schemas.errors import InvalidBundle
from schemas.plan import Plan
from schemas.protocol.messages import Fail, cut_detail
from schemas.storage.dataset_files import SCENES
from schemas.storage.disk import translated
from schemas.terms import FailReason

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class LayoutStore:
    """Receiver of built packages."""

    archive: Archive
    """Archive of the dataset, which stores the packages."""
    state_dir: Path
    """Directory of the run; with a dataset in object storage, it keeps a copy of each package for the workers."""
    writer: Writer
    """Writer of the ledger."""
    terms: Terms
    """Terms of the run."""
    catalog: MutableMapping[str, SceneEntry]
    """Scenes of the run, to which stored layouts are added."""
    packages: MutableMapping[str, Path]
    """Packages by SHA-256 that workers can fetch, to which stored layouts are added."""
    check: Callable[[Path], None]
    """Function that decodes a package in a sandbox, or raises `InvalidBundle`."""
    clock: Callable[[], datetime]
    """Wall clock."""

    def receive(self, pull: Pull, build: BuildJob, staged: Staged) -> None:
        """Stores a package and inserts the episodes of its layout, or refuses the seed.

        Args:
            pull: announcement of the package.
            build: job of the package.
            staged: complete part file.

        Raises:
            InvalidBundle: the file is not a package of the layout, or not the announced one.
            WorldError: the disk is full or unavailable; nothing has been recorded.
        """
        self.check(staged.path)
        entry = read_entry(staged.path)
        if (entry.info.name, entry.sha256) != (build.layout, pull.sha256):
            raise InvalidBundle(
                "bundle refused",
                [f"package {entry.sha256[:16]} of {entry.info.name}, expected {pull.sha256[:16]} of {build.layout}"],
            )
        faults = list(layout_faults(self.terms.plan, build.layout, entry))
        if faults:
            self._refuse(pull, build, "; ".join(faults))
        else:
            self._store(pull, build, entry)

    def _refuse(self, pull: Pull, build: BuildJob, detail: str) -> None:
        report = Fail(sid=pull.sid, lease=pull.lease, reason=FailReason.LAYOUT, detail=cut_detail(detail))
        log.info("layout_refused", layout=build.layout, worker=pull.sid, detail=detail)
        self.writer.call(lambda connection: fail_attempt(connection, report, self.terms, self.clock()))

    def _store(self, pull: Pull, build: BuildJob, staged: SceneEntry) -> None:
        plan, layout = self.terms.plan, build.layout
        entry = replace(staged, path=self._keep(layout, staged))
        planned = tuple(expand_layout(plan, build.number, plan.spans[layout][0], entry))
        self.packages[entry.sha256] = entry.path
        self.catalog[layout] = entry  # before the commit, after which workers claim the episodes
        if self.writer.call(
            lambda connection: outcomes.record_package(connection, pull.lease, entry.sha256, planned, self.clock())
        ):
            self._remove_others(layout, entry)
            log.info("layout_stored", layout=layout, worker=pull.sid, episodes=len(planned))
        elif self.catalog[layout] is entry:  # the lease was lost meanwhile
            del self.catalog[layout]

    def _keep(self, layout: str, staged: SceneEntry) -> Path:
        """Stores a package in the dataset, and returns the path of a local file with it."""
        stored = self.archive.add_scene(staged.path, layout, staged.sha256)
        if isinstance(stored, Path):
            return stored
        copy = self.state_dir / SCENES / stored.name
        with translated("write", copy.parent):
            copy.parent.mkdir(exist_ok=True)
            shutil.copyfile(staged.path, copy)
        return copy

    def _remove_others(self, layout: str, entry: SceneEntry) -> None:
        """Removes packages of the layout whose build was not recorded; another processor may give other bytes."""
        for path in (self.state_dir / SCENES).glob(f"{layout}-*.scene.zip"):
            if path != entry.path:
                path.unlink()


def layout_faults(plan: Plan, layout: str, entry: SceneEntry) -> Iterator[str]:
    """Yields the reasons why a package cannot be the layout of a plan, one line each."""
    found = list(faults_of(scene_cells(plan, plan.part(layout), entry), f"package of {layout}"))
    if not found and plan.language is not None:
        from coordinator.expansion.sentences import find_missing_instructions  # other plans do not import the grammars

        found = find_missing_instructions(plan, {layout: entry})
    yield from found
