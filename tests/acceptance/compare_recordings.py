"""`make compare-recordings`: records a plan as states and as frames, renders the states, and compares the datasets.

Prints the comparisons and the values that differ. Exits with 1 if a value differs that should not depend on the
recording or the run.

    python -m tests.acceptance.compare_recordings PLAN [--episodes N] [--scene NAME] [--exported N] [--root DIR]
"""

from __future__ import annotations

import argparse
import filecmp
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from factory.dataset.reader import Dataset
from factory.export.execution.manifest import MANIFEST_FILE
from factory.export.output import WORK_FOLDER

OF_RUN = frozenset({"created_at", "updated_at", "worker", "at", "seconds", "file_sha256", "file_bytes"})
"""Values that can differ between two runs of one plan: times, workers, and digest and size of the episode files."""
OF_RECORDING = frozenset({"run", "plan_digest", "content_digest", "dataset_digest", "steps_visible"})
"""Values that can differ between a frames and a states recording: the plan digest, the digests that include the frames,
and the number of steps with the target in view. That number is null in a states recording of an expert that uses no
images."""
EXPORTS: Mapping[str, tuple[str, ...]] = {
    "paper": (),
    "lerobot": ("--depth", "--ids"),
    "lerobot-v2.1": (),
    "webdataset": (),
    "mcap": (),
    "mcap --ros2": ("--ros2",),
    "gnm": (),
    "coco": ("--fps", "20"),
    "navdp": ("--fps", "20"),
    "internnav": (),
    "vlnce": (),
    "rlds": ("--fps", "20"),
    "robomimic": ("--fps", "20"),
}
"""Export -> options."""


class Difference(NamedTuple):
    """A difference between two datasets."""

    what: str
    """File, and column or field."""
    text: str
    """Description of the difference."""
    is_expected: bool
    """Whether the value may differ, because it depends on the recording or the run."""


def compare_datasets(one: Path, other: Path, *, same_recording: bool) -> list[Difference]:
    """Compares two datasets of one plan: tables, `dataset_meta.json`, dataset card and every episode.

    Args:
        one: dataset directory.
        other: dataset directory.
        same_recording: whether both datasets have the same recording; if so, the values of `OF_RECORDING` must be
            equal too.
    """
    free = OF_RUN if same_recording else OF_RUN | OF_RECORDING
    found = [*_compare_meta(one, other, free), *_compare_episodes(one, other, same_recording)]
    for name in ("metadata.parquet", "attempts.parquet"):
        found += _compare_tables(name, pq.read_table(one / name), pq.read_table(other / name), free)
    if same_recording:
        if (one / "README.md").read_bytes() != (other / "README.md").read_bytes():
            found.append(Difference("README.md", "other text", is_expected=False))
        for path in sorted((one / "data").iterdir()):
            name = f"data/{path.name}"
            found += _compare_tables(name, pq.read_table(path), pq.read_table(other / name), free)
    return found


def compare_trees(one: Path, other: Path) -> list[Difference]:
    """Returns a difference for each file that differs between two exports or is in one export only.

    The manifests of exports of a frames and a states recording may name different recordings, runs and digests.
    """
    files = [_files(root) for root in (one, other)]
    found = [Difference(name, "in one export only", is_expected=False) for name in sorted(files[0] ^ files[1])]
    for name in sorted(files[0] & files[1]):
        if filecmp.cmp(one / name, other / name, shallow=False):
            continue
        if name != MANIFEST_FILE or _without_recording(one / name) != _without_recording(other / name):
            found.append(Difference(name, "other bytes", is_expected=False))
    return found


def _without_recording(path: Path) -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads(path.read_bytes())
    source = manifest.get("source", {})
    return manifest | {"source": {key: source[key] for key in source if key not in {"run", "record", "dataset_digest"}}}


def _files(root: Path) -> set[str]:
    names = (path.relative_to(root) for path in root.rglob("*") if path.is_file())
    return {str(name) for name in names if name.parts[0] != WORK_FOLDER}


def _compare_tables(name: str, one: pa.Table, other: pa.Table, free: frozenset[str]) -> Iterator[Difference]:
    if one.schema.names != other.schema.names or one.num_rows != other.num_rows:
        text = f"{one.num_rows} and {other.num_rows} rows, {one.num_columns} and {other.num_columns} columns"
        yield Difference(name, text, is_expected=False)
        return
    for column in one.schema.names:
        pairs = zip(one[column].to_pylist(), other[column].to_pylist(), strict=True)
        unequal = [pair for pair in pairs if pair[0] != pair[1]]
        if unequal:
            text = (
                f"{len(unequal)} of {one.num_rows} rows differ, first: {unequal[0][0]!s:.80} and {unequal[0][1]!s:.80}"
            )
            yield Difference(f"{name}: {column}", text, is_expected=column in free)


def _compare_meta(one: Path, other: Path, free: frozenset[str]) -> Iterator[Difference]:
    first, second = (json.loads((root / "dataset_meta.json").read_text()) for root in (one, other))
    if "run" in free:
        for meta in (first, second):
            meta["plan"].pop("record", None)
    for key in sorted(first.keys() | second.keys()):
        if first.get(key) != second.get(key):
            text = f"{first.get(key)!s:.80} and {second.get(key)!s:.80}"
            yield Difference(f"dataset_meta.json: {key}", text, is_expected=key in free)


def _compare_episodes(one: Path, other: Path, same_recording: bool) -> Iterator[Difference]:
    """Yields a difference for each episode whose actions, poses, metadata or, with one recording, frames differ."""
    for first, second in zip(Dataset(one), Dataset(other), strict=True):
        with first, second:
            values: list[tuple[str, Any, Any]] = [("states", first.states_digest, second.states_digest)]
            values.append(("instances", first.instances, second.instances))
            if same_recording:
                values.append(("frames", first.meta.frame_digests, second.meta.frame_digests))
        unequal = [name for name, a, b in values if a != b]
        if unequal:
            yield Difference(first.episode_id, f"other {' and '.join(unequal)}", is_expected=False)


def _report(title: str, found: list[Difference]) -> bool:
    """Prints the differences; returns whether all are expected."""
    unexpected = [one for one in found if not one.is_expected]
    print(f"{title}: {'DIFFERENT' if unexpected else 'equal'}")  # noqa: T201 - the result of the command
    for one in (*unexpected, *(one for one in found if one.is_expected)):
        print(f"  {'recording or run' if one.is_expected else 'UNEXPECTED'}: {one.what}: {one.text}")  # noqa: T201
    return not unexpected


def _factory(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "factory", *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def _compare_exports(format_name: str, roots: Sequence[Path], episodes: int) -> bool:
    """Exports the first episodes of the datasets and compares the files with those of the first dataset."""
    words = ("--to", format_name.split()[0], *EXPORTS[format_name], "--episode", f"1-{episodes}", "--workers", 1)
    with tempfile.TemporaryDirectory() as folder:
        outs = [Path(folder) / root.name for root in roots]
        for root, out in zip(roots, outs, strict=True):
            _factory("export", root, "-o", out, *words)
        first, *others = outs
        title = f"{format_name} from {first.name} and from"
        results = [_report(f"{title} {out.name}", compare_trees(first, out)) for out in others]
        return all(results)


def _record(root: Path, plan: str, words: Sequence[object]) -> tuple[Path, Path, Path]:
    """Generates or continues the three datasets: frames, states, and rendered states."""
    frames, states, rendered = (root / name for name in ("frames", "states", "rendered"))
    for record in (states, frames):
        _factory("run", plan, "--record", record.name, "--out", record, *words)
    _factory("render", states, "-o", rendered)
    return frames, states, rendered


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plan", help="Built-in plan or TOML file.")
    parser.add_argument("--episodes", type=int, help="Number of episodes. Default: the plan's.")
    parser.add_argument("--scene", help="Only this scene. Default: all scenes of the plan.")
    parser.add_argument("--exported", type=int, default=2, help="Number of exported episodes (default 2).")
    parser.add_argument("--root", type=Path, help="Folder that keeps the datasets. Default: a temporary folder.")
    return parser.parse_args()


def main() -> int:
    """Generates the three datasets and prints the comparisons."""
    options = _arguments()
    words = [
        word for name in ("episodes", "scene") if (value := getattr(options, name)) for word in (f"--{name}", value)
    ]
    with tempfile.TemporaryDirectory() as folder:
        frames, states, rendered = _record(options.root or Path(folder), options.plan, words)
        results = [
            _report("frames and rendered", compare_datasets(frames, rendered, same_recording=True)),
            _report("frames and states", compare_datasets(frames, states, same_recording=False)),
        ]
        results += [_compare_exports(name, (frames, states, rendered), options.exported) for name in EXPORTS]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
