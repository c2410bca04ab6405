"""The dataset card (`README.md` of a dataset): what it holds, how to read it, in the form of the hubs. Text only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from coordinator.dataset_meta import DatasetMeta

__all__ = ["CARD_FILE", "dataset_card"]

CARD_FILE = "README.md"

_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))

_CARD = """\
---
license: cc-by-4.0
task_categories:
- robotics
tags:
- navigation
- vision-language-action
- imitation-learning
- simulation
size_categories:
- {size}
configs:
- config_name: default
  data_files:
  - split: all
    path: metadata.parquet
---
# {run}

{episodes} of {planned} planned episodes{state} of language-conditioned robot navigation, made with
[minivla-factory](https://pypi.org/project/minivla-factory/) from seed {seed} with the `{expert}` expert. A Nova Carter
is told in English which object to drive to; it stops within {radius:g} m of it.

{counts}

## Files
- `metadata.parquet`: one row an episode. `episode_id`, `split`, `scene`, `instruction`, `target_category`, `target_id`,
  `spawn_tier`, `spawn_dist_m`, `num_steps`, `trajectory_length_m`, `final_ne_m`, `collision_count`, `template_id`, then
  colour, expert, draw, attempt, start and goal, digests, file name and size, software and renderer,
  and `geodesic_m`, the shortest way along the floor to the success circle (the l of SPL).
- `episodes/ep_000001.zip`: an episode of T frames at {hz} Hz, members stored: `rgb_front/*.png` (640 x 640, 8 bit),
  `depth_front/*.npy.zst` (float32 metres along the optical axis, 0 is nothing), `seg_front/*.png` (16-bit instance ids,
  table in `meta.json`), `actions_continuous.npy` (v in m/s, w in rad/s), `actions_tokens.npy` (7 x 7 grid), `poses.npy`
  (x, y, z, qw, qx, qy, qz of base_link in the world), `meta.json`. Frame t is what the robot saw before action t.
- `attempts.parquet`: every failed attempt ({failed}) with its reason.
- `scenes/`: the compiled scenes. `dataset_meta.json`: plan, seed, versions, digest.

```python
from factory import Dataset

for episode in Dataset("."):
    print(episode.instruction, episode.rgb(0).shape, episode.actions.shape)
```

`factory verify . --deep` checks every byte. Every successful episode is kept whole; how many attempts each took is in
`attempts.parquet`, so that selection by the expert can be corrected for.

## Licence
The data are under [CC-BY-4.0](https://creativecommons.org/licenses/by/4.0/).
"""


def dataset_card(meta: DatasetMeta, counts: Mapping[tuple[str, str, str], int]) -> str:
    """Returns the card.

    Args:
        meta: of the dataset.
        counts: episodes by (scene, split, tier).
    """
    return _CARD.format(
        size=next((name for limit, name in _SIZES if meta.episodes < limit), "n>1M"),
        run=meta.run,
        episodes=meta.episodes,
        planned=meta.planned,
        state="" if meta.complete else " so far",
        seed=meta.seed,
        expert=meta.plan.expert,
        radius=meta.plan.task.success_radius_m,
        hz=meta.plan.task.control_hz,
        failed=meta.failed_attempts,
        counts=_count_table(counts),
    )


def _count_table(counts: Mapping[tuple[str, str, str], int]) -> str:
    splits = list(dict.fromkeys(split for _, split, _ in sorted(counts)))
    by_scene: Counter[tuple[str, str]] = Counter()
    for (scene, split, _), number in counts.items():
        by_scene[scene, split] += number
    lines = [f"| scene | {' | '.join([*splits, 'all'])} |", "|---" * (len(splits) + 2) + "|"]
    for scene in sorted({scene for scene, _ in by_scene}):
        numbers = [by_scene[scene, split] for split in splits]
        lines.append(f"| {scene} | {' | '.join(map(str, [*numbers, sum(numbers)]))} |")
    tiers = Counter[str]()
    for (_, _, tier), number in counts.items():
        tiers[tier] += number
    shown = ", ".join(f"{tier} {number}" for tier, number in sorted(tiers.items())) or "none yet"
    return "\n".join([*lines, "", f"By spawn tier: {shown}."])
