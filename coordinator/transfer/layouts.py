"""Stores the packages of layouts that workers have built, and inserts the episodes of each layout into the ledger.

The module transfers nothing. A package that cannot fulfil the plan is refused, and the next seed
is tried.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import structlog

from coordinator.archive.contract import Archive
from coordinator.expansion.catalog import SceneEntry, add_files, read_entry
from coordinator.expansion.draw import expand_layout
from coordinator.expansion.possible import faults_of
from coordinator.expansion.scene_cells import scene_cells
from coordinator.ledger import outcomes
from coordinator.ledger.database.writer import Writer
from coordinator.protocol.bundles import BuildJob, IncomingBundle
from coordinator.protocol.protocol import Terms, fail_attempt
from schemas.errors import InvalidBundle
from schemas.plan import Plan
from schemas.protocol.messages import Fail, cut_detail
from schemas.scene.complete import split_package
from schemas.scene.files import faulty_textures
from schemas.scene.info import TEXTURES, texture_file
from schemas.storage.dataset_files import SCENES
from schemas.storage.disk import replacing, translated
from schemas.terms import FailReason, family_of

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

    def receive(self, bundle: IncomingBundle, build: BuildJob) -> None:
        """Stores a package and inserts the episodes of its layout, or refuses the seed.

        Args:
            bundle: bundle of the package, with its complete part file.
            build: job of the package.

        Raises:
            InvalidBundle: the file is not a package of the layout, or not the announced one.
            WorldError: the disk is full or unavailable; nothing has been recorded.
        """
        part = bundle.open_part
        if part.is_linked and part.sha256 != bundle.sha256:
            raise InvalidBundle("bundle refused", [f"SHA-256 {part.sha256}, {bundle.sha256} was announced"])
        self.check(part.path)
        with unpacked(part.path) as package:
            entry = read_entry(package)
            if entry.info.name != build.layout:
                raise InvalidBundle("bundle refused", [f"package of {entry.info.name}, expected {build.layout}"])
            self._require_textures(package)
            faults = list(layout_faults(self.terms.plan, build.layout, entry))
            if faults:
                self._refuse(bundle, build, "; ".join(faults))
            else:
                self._store(bundle, build, entry)

    def _require_textures(self, package: Path) -> None:
        """Checks that each texture of a layout is in its bundle or in the dataset."""
        absent = [one for one in faulty_textures(package) if not self.archive.texture_path(one.sha256).exists()]
        if absent:
            raise InvalidBundle("bundle refused", [f"texture {one.file} is missing" for one in absent])

    def _refuse(self, bundle: IncomingBundle, build: BuildJob, detail: str) -> None:
        report = Fail(sid=bundle.sid, lease=bundle.lease, reason=FailReason.LAYOUT, detail=cut_detail(detail))
        log.info("layout_refused", layout=build.layout, worker=bundle.sid, detail=detail)
        self.writer.call(lambda connection: fail_attempt(connection, report, self.terms, self.clock()))

    def _store(self, bundle: IncomingBundle, build: BuildJob, staged: SceneEntry) -> None:
        plan, layout = self.terms.plan, build.layout
        entry = replace(staged, path=self._keep(layout, staged))
        planned = tuple(expand_layout(plan, build.number, plan.spans[layout][0], entry))
        add_files(self.packages, entry)
        # set before the commit, because workers can claim the episodes immediately after the commit
        self.catalog[layout] = entry
        if self.writer.call(
            lambda connection: outcomes.record_package(
                connection,
                bundle.lease,
                announced=bundle.sha256,
                package=entry.sha256,
                planned=planned,
                now=self.clock(),
            )
        ):
            self._remove_others(layout, entry)
            family = family_of(layout)
            self.terms.textures[family] = self.terms.textures.get(family, frozenset()).union(entry.textures)
            log.info("layout_stored", layout=layout, worker=bundle.sid, episodes=len(planned))
        elif self.catalog[layout] is entry:  # the lease was lost meanwhile
            del self.catalog[layout]

    def _keep(self, layout: str, staged: SceneEntry) -> Path:
        """Stores a package in the dataset, and returns the path of a local copy."""
        stored = self.archive.add_scene(staged.path, layout, staged.sha256, staged.textures)
        if isinstance(stored, Path):
            return stored
        copy = self.state_dir / SCENES / stored.name
        with translated("write", copy.parent):
            (copy.parent / TEXTURES).mkdir(parents=True, exist_ok=True)
            for sha256 in staged.textures:
                texture = copy.parent / texture_file(sha256)
                if not texture.exists():
                    with replacing(texture) as part:
                        part.write_bytes(self.archive.texture_path(sha256).read_bytes())
            shutil.copyfile(staged.path, copy)
        return copy

    def _remove_others(self, layout: str, entry: SceneEntry) -> None:
        """Removes packages of the layout whose builds were not recorded.

        Such packages can exist because the bytes of a package depend on the processor that builds it.
        """
        for path in (self.state_dir / SCENES).glob(f"{layout}-*.scene.zip"):
            if path != entry.path:
                path.unlink()


@contextmanager
def unpacked(bundle: Path) -> Iterator[Path]:
    """Yields the package in the bundle of a build, with the textures of the bundle beside it, in a temporary folder.

    Raises:
        InvalidBundle: the bundle is damaged.
        WorldError: the disk is full or unavailable.
    """
    with bundle.open("rb") as file:
        parts = split_package(file)
    with translated("write", bundle.parent):
        folder = Path(tempfile.mkdtemp(prefix="layout-", dir=bundle.parent))
    try:
        with translated("write", folder):
            package = folder / "layout.scene.zip"
            package.write_bytes(parts.package)
            (folder / TEXTURES).mkdir()
            for texture, data in parts.textures.items():
                (folder / texture.file).write_bytes(data)
        yield package
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def layout_faults(plan: Plan, layout: str, entry: SceneEntry) -> Iterator[str]:
    """Yields the reasons why a package cannot be the layout of a plan, one line each."""
    cells = scene_cells(plan, plan.part(layout), entry)
    findings = list(faults_of(cells, f"package of {layout}"))
    if not findings and plan.language is not None:
        from coordinator.expansion.sentences import find_missing_instructions  # loads the grammars

        findings = find_missing_instructions(plan, (cells,))
    yield from findings
