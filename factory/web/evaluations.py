"""Reads directories of `factory eval -o` for the web page, and keeps them while they do not change. Runs no policy."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from factory.eval.models.result import EpisodeResult, Variant
from factory.eval.results.publish import RESULTS_FILE, VIDEOS
from factory.eval.results.score import Evaluation
from factory.eval.results.store import folders_in, read_manifest, read_policy_folder
from schemas.errors import UsageError, WorldError


@dataclass(frozen=True)
class PolicyRun:
    """Results of one policy."""

    name: str
    """Name of the policy."""
    folder: Path
    """Folder of its results."""
    results: tuple[EpisodeResult, ...]
    """Finished episodes, all variants."""

    @property
    def failures(self) -> list[EpisodeResult]:
        """Failed episodes with the original instruction."""
        return [row for row in self.results if row.variant is Variant.ORIGINAL and not row.success]

    def video(self, spec_id: str, suffix: str) -> Path | None:
        """Returns the video (`.mp4`) of a failure or its last picture (`.jpg`); `None` if the file was not written."""
        known = next((row.spec_id for row in self.failures if row.spec_id == spec_id), None)
        path = self.folder / VIDEOS / f"{known}{suffix}"
        return path if known is not None and path.is_file() else None


@dataclass(frozen=True)
class EvaluationReading:
    """Content of an evaluation directory."""

    run: str
    """Run name of the dataset."""
    evaluation: Evaluation | None
    """All tables; `None` until the evaluation has ended."""
    policies: tuple[PolicyRun, ...]
    """Policies with results."""
    folder: Path
    """Evaluation directory."""

    def policy(self, name: str) -> PolicyRun:
        """Returns a policy by name; raises `UsageError` for another name."""
        run = next((policy for policy in self.policies if policy.name == name), None)
        if run is None:
            valid = ", ".join(policy.name for policy in self.policies)
            raise UsageError(f"the evaluation has no policy {name[:80]!r}; valid policies: {valid}")
        return run


class Evaluations:
    """Evaluation directories of one server; thread-safe.

    Args:
        folders: directories of `factory eval -o`.
    """

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        self._lock = threading.Lock()
        self._kept: dict[str, tuple[object, EvaluationReading]] = {}
        self._folders: dict[str, Path] = {}
        # named directories only, because a search below the dataset would read unrelated ones
        for folder in folders:
            name = folder.resolve().name
            self._folders[name if name not in self._folders else f"{name}_{len(self._folders) + 1}"] = folder

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._folders)

    def read(self, name: str) -> EvaluationReading:
        """Returns an evaluation.

        Raises:
            KeyError: no evaluation has the name.
            WorldError: the directory is not an evaluation, or it is damaged.
        """
        folder = self._folders[name]
        with self._lock:
            stamp = _stamp(folder)
            kept = self._kept.get(name)
            if kept is None or kept[0] != stamp:
                kept = self._kept[name] = stamp, _read(folder)
            return kept[1]


def _read(folder: Path) -> EvaluationReading:
    manifest = read_manifest(folder)
    policies = []
    for place in folders_in(folder):
        if (place / "episodes.jsonl").stat().st_size:
            run = read_policy_folder(place)
            policies.append(PolicyRun(run.policy, place, tuple(run.results)))
    return EvaluationReading(manifest.run, _published(folder / RESULTS_FILE), tuple(policies), folder)


def _published(path: Path) -> Evaluation | None:
    try:
        return Evaluation.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise WorldError(f"{path} is damaged; run the same `factory eval` again") from error


def _stamp(folder: Path) -> object:
    files = [folder / RESULTS_FILE, *(place / "episodes.jsonl" for place in folders_in(folder))]
    return tuple((path, path.stat().st_mtime_ns, path.stat().st_size) for path in files if path.exists())
