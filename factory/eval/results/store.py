"""Directory of an evaluation: its specs, its options, and every finished episode. The only writer of these files.

Each finished episode is appended and synced, so an interrupted evaluation can be resumed. Runs no episodes.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, NamedTuple

from pydantic import Field, ValidationError

from factory.eval.models.result import RESULTS_FORMAT, EpisodeResult, Latency, Variant
from factory.eval.models.spec import SpecSet, read_specs, write_specs
from factory.eval.policies.registry import PolicyNote
from schemas.base import Model, NonNegative, Sha256
from schemas.errors import UsageError, WorldError
from schemas.storage.disk import replacing, translated
from schemas.support.closing import Closing
from schemas.view import ViewSettings
from workers.client.host_lock import FOLDER_LOCK, sole_use

_FORMER = "former"
"""Folder of the results of former versions of policies."""
_MANIFEST, _SPECS, _POLICIES, _LOG, _NOTE = "evaluation.json", "specs.json", "policies", "episodes.jsonl", "policy.json"


class EvalManifest(Model):
    """Options of an evaluation directory; a run with other options raises an error."""

    format: int = RESULTS_FORMAT
    run: str
    """Run name of the dataset."""
    specs_digest: Sha256
    with_pose: bool
    act_timeout_s: NonNegative
    latency: Latency | None = Field(default=None, exclude_if=lambda it: it is None)
    """Latency of the policies; `None` and omitted without one."""
    view: ViewSettings = Field(default=ViewSettings(), exclude_if=lambda view: view == ViewSettings())
    """View settings of the observations; omitted for the recorded camera."""


class Store(Closing):
    """Evaluation directory, open for writing."""

    def __init__(self, root: Path, specs: SpecSet, manifest: EvalManifest) -> None:
        """Opens or creates the directory.

        Raises:
            UsageError: The directory contains an evaluation with other specs or other options.
            WorldError: The directory cannot be written, another evaluation writes to it, or its format is newer than
                this software.
        """
        self.root = root
        self._specs = specs
        self._logs: dict[str, IO[bytes]] = {}
        with ExitStack() as held:
            with translated("write", root):
                root.mkdir(parents=True, exist_ok=True)
                held.enter_context(sole_use(root, "evaluation"))
                self._agree(manifest)
            self._held = held.pop_all()

    def close(self) -> None:
        for log in self._logs.values():
            log.close()
        self._held.close()

    def results(self, policy: str) -> list[EpisodeResult]:
        """Returns the finished episodes of a policy in the order of the specs; truncates an incomplete last line."""
        return _in_order(_read_log(self.folder_of(policy) / _LOG, cut=True), self._specs)

    def add(self, result: EpisodeResult) -> None:
        """Appends a result durably.

        Raises:
            WorldError: The file cannot be written.
        """
        with translated("write to", self.root):
            log = self._log(result.policy)
            log.write(result.model_dump_json().encode() + b"\n")
            log.flush()
            os.fsync(log.fileno())

    def folder_of(self, policy: str) -> Path:
        """Returns the folder of a policy's results; if it is deleted, the policy is evaluated again."""
        return self.root / _POLICIES / folder_name(policy)

    def note(self, note: PolicyNote) -> None:
        folder = self.folder(note.policy)
        _write(folder / _NOTE, note)

    def note_of(self, policy: str) -> PolicyNote | None:
        """Returns the metadata of a policy, or `None`."""
        path = self.folder_of(policy) / _NOTE
        return PolicyNote.model_validate_json(path.read_bytes()) if path.exists() else None

    def set_aside(self, policy: str) -> Path | None:
        """Moves the results of a policy to the folder `former`; returns their place, or `None` without results."""
        folder = self.folder_of(policy)
        if not folder.exists():
            return None
        former = self.root / _FORMER
        with translated("write", former):
            former.mkdir(exist_ok=True)
            number = next(n for n in itertools.count(1) if not (former / f"{folder.name}-{n}").exists())
            folder.rename(former / f"{folder.name}-{number}")
        return former / f"{folder.name}-{number}"

    def _log(self, policy: str) -> IO[bytes]:
        if policy not in self._logs:
            self._logs[policy] = (self.folder(policy) / _LOG).open("ab")
        return self._logs[policy]

    def folder(self, policy: str) -> Path:
        """Returns the folder of a policy; creates it if needed."""
        folder = self.folder_of(policy)
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _agree(self, manifest: EvalManifest) -> None:
        if not (self.root / _MANIFEST).exists():
            if {path.name for path in self.root.iterdir()} - {FOLDER_LOCK}:
                raise UsageError(f"{self.root} is not empty and not an evaluation; choose another -o")
            self._begin(manifest)
            return
        stored = read_manifest(self.root)
        different = [
            f"{name} {_short(getattr(stored, name))}, now {_short(getattr(manifest, name))}"
            for name in EvalManifest.model_fields
            if name != "format" and getattr(stored, name) != getattr(manifest, name)
        ]
        if different and self._has_results():
            raise UsageError(f"{self.root} contains another evaluation ({'; '.join(different)}); choose another -o")
        if different:
            self._begin(manifest)

    def _has_results(self) -> bool:
        """Returns whether any episode was run, on this machine or by remote workers."""
        others = {path.name for path in self.root.iterdir()} - {_MANIFEST, _SPECS, _POLICIES, FOLDER_LOCK}
        return bool(others) or any((self.root / _POLICIES).glob(f"*/{_LOG}"))

    def _begin(self, manifest: EvalManifest) -> None:
        write_specs(self._specs, self.root / _SPECS)
        _write(self.root / _MANIFEST, manifest)


def _short(value: object) -> str:
    """Returns the text of a manifest entry; shortens digests and settings."""
    if isinstance(value, ViewSettings):
        return value.describe()
    return f"{value[:12]}..." if isinstance(value, str) and len(value) == 64 else repr(value)


def read_manifest(root: Path) -> EvalManifest:
    """Reads the manifest of an evaluation directory.

    Raises:
        WorldError: The manifest is missing or damaged, or its format is newer than this software.
    """
    path = root / _MANIFEST
    try:
        manifest = EvalManifest.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise WorldError(
            f"{root} is not an evaluation: {_MANIFEST} is missing; give the -o of `factory eval`"
        ) from error
    except (OSError, ValidationError) as error:
        raise WorldError(f"{path} is damaged: {error}") from error
    if manifest.format > RESULTS_FORMAT:
        raise WorldError(
            f"{path} has format {manifest.format}, this software reads formats up to {RESULTS_FORMAT}: upgrade "
            "minivla-factory"
        )
    return manifest


class PolicyResults(NamedTuple):
    """Stored results of a policy."""

    policy: str
    results: list[EpisodeResult]
    specs: SpecSet


def read_policies(paths: Sequence[Path]) -> list[PolicyResults]:
    """Reads the results of several policies, in order.

    Args:
        paths: folders of policies, see `read_policy_folder`; a single path is a folder OUT with all its policies.

    Raises:
        UsageError: There are fewer than two policies, or two have the same name.
        WorldError: The results are damaged.
    """
    folders = folders_in(paths[0]) if len(paths) == 1 and (paths[0] / _MANIFEST).exists() else paths
    runs = [read_policy_folder(folder) for folder in folders]
    if len(runs) < 2:
        raise UsageError(f"{paths[0]} has the results of {len(runs)} policy; a comparison needs two: give two folders")
    for name, count in Counter(run.policy for run in runs).items():
        if count > 1:
            raise UsageError(
                f"{count} of the folders have results of a policy with the name {name}; evaluate one of them again "
                "with `--policy NAME=POLICY`, which gives it another name"
            )
    return runs


def read_policy_folder(path: Path) -> PolicyResults:
    """Reads the results of one policy.

    Args:
        path: `OUT/policies/NAME` with the name of the folder or of the policy, or `OUT` if it contains one policy only.

    Raises:
        UsageError: The folder contains several policies, or none.
        WorldError: The results are damaged.
    """
    folder = path
    if (path / _MANIFEST).exists():
        folders = folders_in(path)
        if len(folders) != 1:
            there = ", ".join(str(entry) for entry in folders) or "none"
            raise UsageError(f"{path} contains {len(folders)} policies; give the folder of one of them: {there}")
        folder = folders[0]
    elif not path.exists():
        folder = path.with_name(folder_name(path.name))
    if not (folder / _LOG).exists():
        raise UsageError(f"{path} contains no results; give OUT or OUT/{_POLICIES}/NAME of `factory eval`")
    out = folder.parent.parent
    read_manifest(out)
    specs = read_specs(out / _SPECS)
    results = _in_order(_read_log(folder / _LOG, cut=False), specs)
    if not results:
        raise UsageError(f"{path} contains no finished episode")
    return PolicyResults(results[0].policy, results, specs)


def folders_in(root: Path) -> list[Path]:
    """Returns the folders of the policies of an evaluation directory that have results, sorted."""
    return sorted(entry.parent for entry in (root / _POLICIES).glob(f"*/{_LOG}"))


def folder_name(policy: str) -> str:
    """Returns the folder name of a policy: its name if valid as a folder name, else a readable form and a digest."""
    plain = re.sub(r"[^a-z0-9_.]+", "-", policy.lower()).strip("-.")[:60]
    return plain if plain == policy else f"{plain}-{hashlib.sha256(policy.encode()).hexdigest()[:8]}"


def _in_order(results: Iterator[EpisodeResult], specs: SpecSet) -> list[EpisodeResult]:
    place = {spec.spec_id: number for number, spec in enumerate(specs.specs)}
    once = {(result.spec_id, result.variant): result for result in results if result.spec_id in place}
    variants = list(Variant)
    return sorted(once.values(), key=lambda result: (variants.index(result.variant), place[result.spec_id]))


def _read_log(path: Path, cut: bool) -> Iterator[EpisodeResult]:
    if not path.exists():
        return
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if cut and len(whole) < len(data):
        os.truncate(path, len(whole))
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            yield EpisodeResult.model_validate_json(line)
        except ValidationError as error:
            raise WorldError(
                f"{path} is damaged in line {number}; delete the line and run the same command again"
            ) from error


def _write(path: Path, model: Model) -> None:
    with replacing(path) as part:
        part.write_text(model.model_dump_json(indent=1) + "\n", encoding="utf-8")
