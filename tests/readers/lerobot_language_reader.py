"""Opens an export with routes and questions with LeRobot's loader, and compares every text and span with the dataset.

Runs in a separate environment (Python 3.12, `lerobot[dataset]==0.6.1`, see `make test-language`), does not import this
project, and exits with code 1 at the first failed check.

    python tests/readers/lerobot_language_reader.py DATASET EXPORT

DATASET: a relabelled dataset. EXPORT: its export with `--to lerobot`, at the recorded rate.
"""

import sys
from pathlib import Path

from lerobot.datasets.language import column_for_style, validate_camera_field
from lerobot.datasets.language_render import active_at
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from relabelled import RelabelledTables, counted
from result import named, print_row


def main() -> None:
    tables, export = RelabelledTables(Path(sys.argv[1])), Path(sys.argv[2])
    data = LeRobotDataset("test/nav", root=export, video_backend="pyav")
    names = [found["episode_id"] for found in data.meta.episodes]
    assert sorted(names) == sorted(tables.first)
    for found in data.meta.episodes:
        check_episode(tables, data, found["episode_id"], found["dataset_from_index"], found["length"])
    asked = sum(len(each) for name in names for each in tables.questions(name).values()) // 2
    assert asked, "no episode has a question"
    result = f"{len(names)} instructions, {counted(map(tables.steps, names))}, active subtask of every frame"
    print_row(export, named("lerobot"), f"{result}, {asked} questions")


def check_episode(tables: RelabelledTables, data: LeRobotDataset, name: str, first: int, length: int) -> None:
    """Checks the task, the active subtask of every frame as found by LeRobot's function, and the questions."""
    steps = tables.steps(name)
    assert data[first]["task"] == tables.first[name], name
    rows = data.hf_dataset.select(range(first, first + length)).with_format(None)
    found = []
    for t, row in enumerate(rows):
        active = active_at(row["timestamp"], persistent=row["language_persistent"], style="subtask")
        if active is not None and (not found or found[-1]["text"] != active["content"]):
            found.append({"text": active["content"], "start": t, "end": t})
        if active is not None:
            found[-1]["end"] = t + 1
    joined = []
    for each in steps:  # `found` has one span for consecutive steps with equal texts
        if joined and joined[-1]["text"] == each["text"]:
            joined[-1] = {**joined[-1], "end": each["end"]}
        else:
            joined.append(each)
    assert found == joined, (name, found, joined)
    assert data[first]["language_persistent"] == data[first + length - 1]["language_persistent"]
    asked = {}
    for t, row in enumerate(rows):
        for each in row["language_events"]:
            validate_camera_field(each["style"], each["camera"])
            assert column_for_style(each["style"]) == "language_events"
            assert each["camera"] in data.meta.camera_keys
            asked.setdefault(t, []).append((each["role"], each["content"]))
    assert asked == tables.questions(name), (name, asked)


if __name__ == "__main__":
    main()
