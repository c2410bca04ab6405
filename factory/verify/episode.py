"""Verifies one episode file against its row, its scene and its own digests. Changes no files."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from coordinator.expansion.catalog import SceneEntry
from coordinator.validation.instruction_check import said_findings
from coordinator.validation.validate import validate
from factory.dataset.bundle import EpisodeBundle
from factory.dataset.episode import Episode
from factory.verify.findings import Finding, Kind
from factory.verify.rendering import RenderDifference, compare_rendered
from schemas.bundle import BundleReader
from schemas.dataset.rows import EpisodeSummary, renumbered, summary_of
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.job import Job, episode_id
from schemas.scene import Target
from schemas.storage.dataset_files import METADATA_FILE
from schemas.storage.place import Place, opened
from schemas.storage.shard_index import episode_place

_OF_THE_FILE = frozenset({"file_sha256", "file_bytes"})
_RELABELLED = frozenset({"instruction", "template_id"})
"""Columns that `factory relabel` changes."""


@dataclass(frozen=True)
class EpisodeCheck:
    """Arguments of the check of one episode; picklable."""

    root: Place
    row: EpisodeSummary
    candidates: tuple[Target, ...]
    """Possible targets of the episode, the target of the row first; empty if the scene cannot be read."""
    deep: bool
    render: bool = False
    """Whether to render frames again and compare them with their digests."""
    reference: Episode | None = None
    """The same episode in a frames recording, to measure how far pixels differ."""
    package: Path | None = None
    """Package of the scene; `None` where it cannot be read."""
    relabelled: bool = False
    """Whether the row has a new instruction, which differs from that of the episode."""
    own_index: int | None = None
    """Number that the file of the episode must have recorded; `None` for the number in the row. It differs in a merged
    dataset."""


class EpisodeFindings(NamedTuple):
    """Result of the check of one episode."""

    findings: list[Finding]
    difference: RenderDifference
    """Comparison of rendered frames; empty if none were rendered."""


def check_episode(check: EpisodeCheck) -> EpisodeFindings:
    """Returns all findings of an episode file, and the comparison of its rendered frames.

    The check compares size and SHA-256. With `deep`, it also checks every frame, the motion and the row; with `render`,
    it renders frames again.

    Raises:
        WorldError: frames are to be rendered, and this machine cannot.
    """
    row, difference = check.row, RenderDifference()
    findings: list[Finding] = []
    try:
        with opened(episode_place(check.root, row.index)) as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.seek(0, os.SEEK_END)
            if size != row.file_bytes:
                findings.append(Finding(Kind.TRUNCATED, row.file_name, f"{size} bytes, recorded {row.file_bytes}"))
            elif sha256 != row.file_sha256:
                findings.append(Finding(Kind.CHANGED, row.file_name, f"SHA-256 {sha256}, recorded {row.file_sha256}"))
            if check.deep:
                with BundleReader(file) as bundle:
                    violations = validate(bundle, candidates=_candidates(check, bundle.meta.job))
                    violations += [] if violations else said_findings(bundle, check.package)
                    differences = _differences(row, _row_of(check, bundle, sha256, size), check.relabelled)
                findings += [Finding(Kind.INVALID, row.file_name, text) for text in violations]
                findings += [Finding(Kind.CONTRADICTION, row.file_name, text) for text in differences]
            if check.render:
                with EpisodeBundle(file, check.root) as episode:
                    candidates = _candidates(check, episode.meta.job)
                    texts = compare_rendered(episode, difference, check.reference, candidates)
                findings += [Finding(Kind.RENDERED, row.file_name, text) for text in texts]
    except FileNotFoundError:
        findings.append(Finding(Kind.MISSING, row.file_name, "is missing"))
    except InvalidBundle as error:
        findings += [Finding(Kind.INVALID, row.file_name, text) for text in error.findings]
    except ArchiveCorrupt as error:
        findings.append(Finding(Kind.DAMAGED, row.file_name, f"cannot be rendered: {error}"))
    except OSError as error:
        findings.append(Finding(Kind.DAMAGED, row.file_name, f"cannot be read: {error}"))
    return EpisodeFindings(findings, difference)


def _row_of(check: EpisodeCheck, bundle: BundleReader, sha256: str, size: int) -> EpisodeSummary:
    """Returns the row that the dataset should have for a file; in a merged dataset, the row has another number."""
    row = summary_of(bundle.meta, sha256, size)
    if check.own_index is None or row.index != check.own_index:
        return row
    return renumbered(row, check.row.index, episode_id(check.row.index))


def _candidates(check: EpisodeCheck, job: Job) -> tuple[Target, ...]:
    """Returns the possible targets of an episode according to its job."""
    if job.choice is None:
        return check.candidates[:1]
    return tuple(each for each in check.candidates if each.instance_id in job.choice.among)


def targets_of(
    row: EpisodeSummary, scene: SceneEntry | None, is_drawn: bool = False
) -> tuple[tuple[Target, ...], list[Finding]]:
    """Returns the possible targets of a row, as its scene defines them, and contradictions as findings.

    Args:
        row: Row of the episode.
        scene: Scene package; `None` where it cannot be read, which is a separate finding.
        is_drawn: Whether the target was drawn at the start; if so, the other targets of its category are returned too.
    """
    if scene is None:
        return (), []
    if scene.sha256 != row.scene_sha256:
        text = f"its scene has SHA-256 {row.scene_sha256}, but the package of {row.scene} has {scene.sha256}"
        return (), [Finding(Kind.CONTRADICTION, row.file_name, text)]
    try:
        target = scene.info.target(row.target_id)
    except KeyError:
        text = f"target {row.target_id} is not in the scene {row.scene}"
        return (), [Finding(Kind.CONTRADICTION, row.file_name, text)]
    others = [each for each in scene.info.targets if each.category == target.category and each != target]
    return (target, *(others if is_drawn else ())), []


def _differences(row: EpisodeSummary, differences: EpisodeSummary, relabelled: bool) -> list[str]:
    ignored = _OF_THE_FILE | _RELABELLED if relabelled else _OF_THE_FILE
    return [
        f"{name}: {METADATA_FILE} has {getattr(row, name)}, the episode has {getattr(differences, name)}"
        for name in EpisodeSummary.model_fields
        if name not in ignored and getattr(row, name) != getattr(differences, name)
    ]
