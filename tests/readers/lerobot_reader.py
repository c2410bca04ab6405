"""Opens exports with LeRobot's loader and compares them with the paper's tree of the same dataset.

Runs in a separate environment (Python 3.12, `lerobot[dataset]==0.6.1`, see `make test-formats`), does not import this
project, and exits with code 1 at the first failed check.

    python tests/readers/lerobot_reader.py PAPER EXPORT [EXPORT ...]

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to lerobot`, with any
of `--fps`, `--depth` and `--ids`; or as `--to lerobot-v2.1`, which LeRobot's converter first converts to v3.0.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

import torch
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.dataset_tools import delete_episodes, split_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts.convert_dataset_v21_to_v30 import convert_dataset
from lerobot.utils.feature_utils import dataset_to_policy_features
from lerobot_frames import RGB, Listed, check_batches, check_frames
from paper_tree import Paper
from result import named, print_row
from snippets import run_snippets

DOCUMENT = Path(__file__).parents[2] / "docs/formats/lerobot.md"


def main() -> None:
    paper, reader = Paper(Path(sys.argv[1])), named("lerobot")
    for export in map(Path, sys.argv[2:]):
        if json.loads((export / "meta/info.json").read_text())["codebase_version"] == "v2.1":
            print_row(export, f"{reader}, pyav", f"converted to v3.0 by LeRobot: {check_conversion(paper, export)}")
            continue
        for backend in backends():
            print_row(export, f"{reader}, {backend}", check_export(paper, export, backend))
        print_row(export, reader, check_policy(export))
        print_row(export, reader, check_snippets(export))
        print_row(export, reader, check_parts(export))
        print_row(export, reader, check_aggregate(export))
        print_row(export, reader, check_tools(export))


def check_snippets(export: Path) -> str:
    """Runs the snippets that the export and the documents print."""
    count = run_snippets(export / "README.md", export, "lerobot")
    if not (export / "extra").exists():  # a snippet of the document needs depth
        return f"{count} printed snippet runs"
    with tempfile.TemporaryDirectory() as place:
        (Path(place) / "out").symlink_to(export.resolve())
        count += run_snippets(DOCUMENT, Path(place), "lerobot")
    return f"{count} printed snippets run"


def backends() -> list[str]:
    """Returns the working video decoders; torchcodec needs FFmpeg's shared libraries."""
    try:
        import torchcodec  # noqa: F401
    except (ImportError, RuntimeError, OSError):
        sys.stderr.write("torchcodec does not load here (FFmpeg's libraries?); tested with pyav only\n")
        return ["pyav"]
    return ["pyav", "torchcodec"]


def check_export(paper: Paper, export: Path, backend: str) -> str:
    data = LeRobotDataset("test/nav", root=export, video_backend=backend)
    listed = [
        Listed(found["episode_id"], found["episode_index"], found["length"], found["split"], found["tasks"])
        for found in data.meta.episodes
    ]
    starts = [found["dataset_from_index"] for found in data.meta.episodes]
    assert starts == [sum(one.length for one in listed[:number]) for number in range(len(listed))]
    extra = export / "extra"
    second = LeRobotDataset("test/extra", root=extra, video_backend=backend) if extra.exists() else None
    return check_frames(paper, data, listed, second)


def check_policy(export: Path) -> str:
    """Checks which features a policy of LeRobot takes by itself: those that are known while it drives."""
    taken = dataset_to_policy_features(LeRobotDataset("test/nav", root=export).meta.features)
    assert {name: feature.type.name for name, feature in taken.items()} == {
        RGB: "VISUAL",
        "observation.state": "STATE",
        "action": "ACTION",
    }
    assert taken[RGB].shape == (3, 640, 640)
    return "a policy takes colour, state and action only"


def check_parts(export: Path) -> str:
    """Checks chunks and batches, and that the index range of a split and a filter by split select the same episodes."""
    lengths = LeRobotDataset("test/nav", root=export).meta.episodes["length"]
    data, result = check_batches(export, lengths[0])
    splits = json.loads((export / "meta/info.json").read_text())["splits"]
    for split, span in splits.items():
        start, stop = map(int, span.split(":"))
        chosen = data.meta.filter_episodes(lambda episode, wanted=split: episode["split"] == wanted)
        assert chosen == list(range(start, stop)), (split, span, chosen)
        part = LeRobotDataset("test/nav", root=export, episodes=chosen)
        assert len(part) == sum(lengths[start:stop])
    return f"{result}, {len(splits)} splits by range and filter"


def check_conversion(paper: Paper, export: Path) -> str:
    """Converts an export of version 2.1 to version 3.0 with LeRobot and compares the content."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "export"
        shutil.copytree(export, copy)
        convert_dataset("test/nav", root=copy, push_to_hub=False)
        return check_export(paper, copy, "pyav")


def check_aggregate(export: Path) -> str:
    """Aggregates two copies of the export with LeRobot; the second half must equal the export."""
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "joined"
        aggregate_datasets(["test/a", "test/b"], "test/joined", roots=[export, export], aggr_root=target)
        joined, one = LeRobotDataset("test/joined", root=target), LeRobotDataset("test/nav", root=export)
        assert len(joined) == 2 * len(one)
        for index in (0, len(one) - 1):
            assert torch.equal(joined[index + len(one)][RGB], one[index][RGB])
    return f"aggregate_datasets joined two copies to {len(joined)} frames"


def check_tools(export: Path) -> str:
    """Splits the export and deletes an episode with LeRobot's tools; every remaining episode must keep its origin."""
    data = LeRobotDataset("test/nav", root=export, video_backend="pyav")
    wanted = origins_of(data)
    assert all(json.loads(text)["job"]["plan_digest"] for text in wanted)
    count = len(wanted)
    with tempfile.TemporaryDirectory() as place:
        parts = split_dataset(data, {"a": [0], "b": [*range(1, count)]}, output_dir=Path(place) / "split")
        assert [*origins_of(parts["a"]), *origins_of(parts["b"])] == wanted
        assert "episode_id" not in parts["a"].meta.episodes.column_names
        left = delete_episodes(data, [0], output_dir=Path(place) / "left", repo_id="test/left")
        assert origins_of(left) == wanted[1:]
    return f"split_dataset and delete_episodes kept the origins of {count} episodes"


def origins_of(data: LeRobotDataset) -> list[str]:
    """Returns the origin of each episode, which its first frame has."""
    return [data.hf_dataset[start]["origin"] for start in data.meta.episodes["dataset_from_index"]]


if __name__ == "__main__":
    main()
