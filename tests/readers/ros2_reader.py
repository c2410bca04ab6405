"""Decodes an export for ROS 2 with `rosbags` and compares it with the paper's tree and the published messages.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/ros2_reader.py PAPER EXPORT

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to mcap --ros2`.
"""

import io
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from paper_tree import Paper
from PIL import Image
from result import named, print_row
from rosbags.highlevel import AnyReader

COLOUR, DEPTH, IDS = "/camera/rgb/image_raw/compressed", "/camera/depth/image_raw", "/camera/ids/image_raw"


def main() -> None:
    paper, export = Paper(Path(sys.argv[1])), Path(sys.argv[2])
    files = sorted((export / "episodes").iterdir())
    assert [file.name for file in files] == sorted(path.name for path in paper.episodes.iterdir())
    messages = sum((check_file(paper, file) for file in files), Counter[str]())
    result = f"{messages.total()} messages, {messages[COLOUR]} frames equal to the paper's tree"
    print_row(export, named("rosbags"), f"{len(files)} bags, {result}")


def check_file(paper: Paper, path: Path) -> Counter[str]:
    """Decodes every message of a bag and compares frames, poses and commands."""
    counts: Counter[str] = Counter()
    poses, actions = (paper.array(path.stem, name) for name in ("poses", "actions_continuous"))
    with AnyReader([path]) as bag:
        for connection, _, data in bag.messages():
            t = counts[connection.topic]
            counts[connection.topic] += 1
            message: Any = bag.deserialize(data, connection.msgtype)
            if connection.topic == COLOUR:
                found = np.asarray(Image.open(io.BytesIO(message.data.tobytes())))
                np.testing.assert_array_equal(found, paper.rgb(path.stem, t))
            elif connection.topic == DEPTH:
                depth = message.data.view("<f4").reshape(message.height, message.width)
                np.testing.assert_array_equal(np.where(np.isinf(depth), 0, depth), paper.depth(path.stem, t))
            elif connection.topic == IDS:
                ids = message.data.view("<u2").reshape(message.height, message.width)
                np.testing.assert_array_equal(ids, paper.ids(path.stem, t))
            elif connection.topic == "/odom":
                place = message.pose.pose.position
                np.testing.assert_array_equal([place.x, place.y, place.z], poses[t, :3])
            elif connection.topic == "/cmd_vel":
                np.testing.assert_array_equal(np.float32([message.linear.x, message.angular.z]), actions[t])
    assert {counts[topic] for topic in (COLOUR, DEPTH, IDS, "/odom", "/cmd_vel", "/tf")} == {len(poses)}
    return counts


if __name__ == "__main__":
    main()
