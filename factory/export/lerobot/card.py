"""Text of the dataset card of a LeRobot export. Pure."""

from __future__ import annotations

from factory.export.lerobot.features import DEPTH, IDS, LeRobotOptions

__all__ = ["card_text"]

_TEXT = """\
A [LeRobot](https://github.com/huggingface/lerobot) dataset, version {version}, {fps} frames a second{decimated}.

```python
{example}
```

| column | what |
|---|---|
| `observation.images.front` | 640 x 640 RGB video (H.264, a key frame every other frame) |
{images}| `observation.state` | x, y, yaw since the first frame in its frame (m, rad), measured v and w (m/s, rad/s) |
| `action` | commanded v in m/s, w in rad/s{mean} |
| `tokens` | the action on the 7 x 7 grid, 0..6 each |
| `pose` | x, y, z, qw, qx, qy, qz of base_link in the world frame |
| `task` | the instruction |

Frame t is what the robot saw before action t. Splits: {splits} (ranges of `episode_index`); {where}.
{hub}"""
_MEAN = ", the mean of the {stride} commands until the next frame"
_EXAMPLES = {
    "v3.0": "from lerobot.datasets.lerobot_dataset import LeRobotDataset\n\n"
    'dataset = LeRobotDataset("me/nav", root=".")',
    "v2.1": "from lerobot.datasets.lerobot_dataset import LeRobotDataset  # LeRobot 0.3; Isaac-GR00T, openpi\n\n"
    'dataset = LeRobotDataset("me/nav", root=".")',
}
_WHERE = {
    "v3.0": "`meta/episodes` also has split, scene, tier, target, template, goal and errors of every episode",
    "v2.1": "`meta/episodes.jsonl` also has split, scene, tier, target, template, goal and errors of every episode",
}
_IMAGES = {
    DEPTH: "metric depth along the optical axis as lossless 12-bit video; 0 where nothing was hit",
    IDS: "instance ids as 16-bit PNG; their meaning is listed in the original dataset's `meta.json`",
}


def card_text(version: str, options: LeRobotOptions, fps: int, stride: int, splits: dict[str, str]) -> str:
    """Returns the text of the card below the title."""
    chosen = [key for key, there in ((DEPTH, options.depth), (IDS, options.ids)) if there]
    hub = (
        f"\nOn the Hub the repository needs a tag equal to the version, or LeRobot will not load it: "
        f'`HfApi().create_tag(REPO, tag="{version}", repo_type="dataset")`.\n'
    )
    return _TEXT.format(
        version=version,
        fps=fps,
        decimated="" if stride == 1 else f", every {stride}th of the recorded ones",
        example=_EXAMPLES[version],
        images="".join(f"| `{key}` | {_IMAGES[key]} |\n" for key in chosen),
        mean="" if stride == 1 else _MEAN.format(stride=stride),
        splits=", ".join(f"{name} {span}" for name, span in splits.items()),
        where=_WHERE[version],
        hub=hub,
    )
