"""Renders the dataset card, the `README.md` of a dataset, in the format of the Hugging Face Hub. Writes no file.

Its section `configs` maps files to configurations and splits; splits without files are omitted, because readers require
files for every listed split.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import yaml

from coordinator.tables.aggregates import EpisodeSums, TableAggregates
from schemas.appearance import Appearance
from schemas.config import RobotConfig, TaskConfig
from schemas.dataset.meta import DatasetMeta
from schemas.instruction.templates import TEMPLATES
from schemas.rig import Rig
from schemas.storage.dataset_files import SPLITS_FOLDER
from schemas.storage.place import Place, children
from schemas.terms import Recording, Split, SuccessMeasure, Tier

_BEGIN, _END = "configs:", "---\n"

Configs = Mapping[str, Mapping[str, str]]
"""Mapping of configuration name to split to path or pattern of its files; the first configuration is the default."""


def split_configs(splits: Collection[str], episodes: int, failed_attempts: int) -> Configs:
    """Returns the configurations of a dataset that have rows; `datasets` cannot load a configuration without rows.

    Args:
        splits: splits with split tables; if empty, the default is `metadata.parquet` with all rows as `train`.
        episodes: number of rows of `metadata.parquet`.
        failed_attempts: number of rows of `attempts.parquet`.
    """
    everything = {"train": "metadata.parquet"}
    files = {split: f"{SPLITS_FOLDER}/{split}-*.parquet" for split in splits} or everything
    configs = {"default": files, "metadata": everything} if episodes else {}
    return configs | ({"attempts": {"train": "attempts.parquet"}} if failed_attempts else {})


def splits_at(root: Place) -> tuple[str, ...]:
    """Returns the splits with split tables in a dataset, in the order of `Split`."""
    names = [place.name for place in children(root / SPLITS_FOLDER)]
    return tuple(str(split) for split in Split if any(name.startswith(f"{split}-") for name in names))


def configs_to_yaml(configs: Configs) -> str:
    """Returns the configurations as YAML for the card's front matter."""
    entries: list[dict[str, Any]] = []
    for name, files in configs.items():
        first = {} if entries else {"default": True}
        data_files = [{"split": split, "path": path} for split, path in files.items()]
        entries.append({"config_name": name, **first, "data_files": data_files})
    return yaml.safe_dump({"configs": entries}, sort_keys=False)


def with_configs(card: str, configs: Configs) -> str:
    """Returns a card with its configurations replaced; a card without configurations is returned unchanged."""
    before, begin, rest = card.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    return before + configs_to_yaml(configs) + end + after if begin and end else card


def names_split_tables(card: str) -> bool:
    """Returns whether a card's configurations name split tables."""
    configs = card.partition(_BEGIN)[2].partition(_END)[0]
    return f"path: {SPLITS_FOLDER}/" in configs


_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_SPLITS = {
    Split.TRAIN_ID: "seen categories, training phrases",
    Split.VAL_ID: "the same, for validation",
    Split.TEST_ID: "the same, held out for testing",
    Split.TEST_PARAPHRASE_OOD: "seen categories, phrases that training lacks",
    Split.TEST_OOD_OBJ: "categories that training lacks, training phrases",
    Split.TEST_UNSEEN_SCENE: "as `test_id`, in layouts without an episode of the splits above",
    Split.TEST_UNSEEN_SCENE_PARAPHRASE_OOD: "as `test_paraphrase_ood`, in these layouts",
    Split.TEST_UNSEEN_SCENE_OOD_OBJ: "as `test_ood_obj`, in these layouts",
    Split.TEST_FALSE_PREMISE: "the named object does not exist, and the robot stops at its start",
}

_CARD = """\
---
license: cc-by-4.0
language:
{languages}
pretty_name: {pretty}
task_categories:
- robotics
tags:
- robotics
- navigation
- imitation-learning
- vision-language-action
- simulation
- pybullet
- nova-carter
- differential-drive
- language-conditioned
- depth
- segmentation
size_categories:
- {size}
{configs}---
# {run}

{episodes} of {planned} planned episodes{state} of language-conditioned robot navigation. {robot} gets an
instruction{english} that names an object, sees colour, depth and instance ids at {hz} Hz, drives to the object and
stops {goal}.

## How it was made
With minivla-factory {version}, simulated in PyBullet and rendered by
{renderers}. Plan `{plan}`, seed {seed}. The `{expert}` expert drove with the true pose of its target; no people were
recorded. Every planned cell of scene, split and tier is filled exactly; an attempt that fails is repeated and recorded
in `attempts.parquet`. Plan, versions and digests are in `dataset_meta.json`: with the same software, `factory replay`
generates any episode again, byte for byte.

{software}

## Content
{scenes}

{tiers}

Categories: {categories}.

{splits}

## Files
- `metadata.parquet`: one row for each episode: `episode_id`, `split`, `scene`, `instruction`, `target_category`,
  `target_id`, `spawn_tier`, `spawn_dist_m`, `num_steps`, `trajectory_length_m`, `final_ne_m`, `collision_count`,
  `template_id`, then colour, expert, draw, attempt, start and goal, digests, file name and size, software and renderer,
  `geodesic_m` (the shortest path on the floor to the success region, the l of SPL), `spawn_surface_m` and
  `final_surface_m` (distance to the target's footprint at the start and at the end; `spawn_dist_m` and `final_ne_m` are
  to its centroid), `target_in_view` (at the end), and `instance_side` (see Splits).
- `episodes/ep_000001.zip`: an episode of T frames at {hz} Hz, members stored: {frames}`actions_continuous.npy` (v in
  m/s, w in rad/s), `actions_tokens.npy` (7 x 7 grid), `poses.npy` (exact x, y, z, qw, qx, qy, qz of base_link in the
  world), `meta.json`. Frame t is the view before action t.{rendered}
- `data/<split>-*.parquet`: the same rows by split{thumbnail}, written when the run ends.
- `attempts.parquet`: every failed attempt ({failed}) with its reason.
- `scenes/`: the compiled scenes. `dataset_meta.json`: plan, seed, versions, digest.

## How to load it
Rows by split, without minivla-factory:

```python
from datasets import load_dataset

splits = load_dataset("PATH_OR_REPOSITORY")  # train_id, val_id, test_id, ...: each split that has episodes
splits["train_id"][0]["instruction"]{picture}
```

Before the run has ended once, `datasets` finds one table, which it names `train`; the column `split` has the splits.
`load_dataset(PATH, "metadata")` loads that table at any time, and `"attempts"` the failed attempts. All frames are in
`episodes/`; `factory export --to webdataset` writes them for `datasets`. With frames and actions, where minivla-factory
is installed:

```python
from minivla import Dataset

for episode in Dataset(".").filter(split="train_id"):
    print(episode.instruction, episode.rgb(0).shape, episode.actions.shape)
```

`factory verify . --deep` checks every byte; `factory stats .` prints all tables.

## Limitations
- Simulated: no people, and no noise in the images of the recorded camera and in the poses{light}; expect a gap to real
  robots.
- Every episode is a success. Failed attempts are in `attempts.parquet`, so that selection by the expert can be
  corrected for; there are no recoveries from errors in the data.
- {expert_limit}
- {wording}
- Distances follow the tiers' ranges as far as rooms allow: objects without a long free line have short starts only.

## Licence
The data are under [CC-BY-4.0](https://creativecommons.org/licenses/by/4.0/).
"""
_TEMPLATES = "Instructions come from {} English templates; `phrase_is_unique` is true if the words fit one object only."
_WRITTEN = (
    "Instructions were written at the start of each episode. A verifier accepted each of them. `meta.json` of an\n"
    "  episode has the instruction with its meaning; `phrase_is_unique` is true if it fits one object only."
)
_RELABELLED = (
    "Instructions were written by `factory relabel` after the drives; `instructions.parquet` has all of them\n"
    "  with their meaning. A verifier accepted each of them. `meta.json` of an episode has the recorded instruction."
)
_FRAMES = """`rgb_front/*.png` (640 x 640, 8 bit),
  `depth_front/*.npy.zst` (float32 metres along the optical axis, 0 where no surface was hit),
  `seg_front/*.png` (16-bit instance ids, table in `meta.json`), """
_SENSORS = """`sensors/*` (measurements of the rig `{}`, see
  `plan.rig` in `dataset_meta.json`), """
_RENDERED = """ This dataset records states:
  minivla-factory renders the frames from `poses.npy` and `scenes/` when they are read, byte for byte as the robot saw
  them with the same renderer (see `dataset_meta.json`); `factory render . -o OUT` writes them as files."""
_DRAWN_THUMBNAIL = "; `factory push --thumbnails` adds a `thumbnail` (frame 0, JPEG, 160 x 160)"
_THUMBNAIL = ", with a `thumbnail` (frame 0, JPEG, 160 x 160)"
_PICTURE = ', splits["train_id"][0]["thumbnail"]  # a PIL image'
_SHARDS = "- `episodes/shard_*.zip`: "
_GOALS = {SuccessMeasure.CENTROID: "its centre", SuccessMeasure.SURFACE: "its footprint on the floor"}
_BODY_FIELDS = {"wheel_radius_m", "track_m", "max_speed_mps", "max_yaw_rate_rps"}
_NOVA_CARTER_RIGS = ("paper", "nova-carter")


def goal_words(task: TaskConfig) -> str:
    """Returns where the robot stops in a success: `within 1 m of its centre`, by the success measure of the plan."""
    return f"within {task.success_radius_m:g} m of {_GOALS[task.success]}"


def robot_name(robot: RobotConfig, rig: Rig | None) -> str:
    """Returns `nova_carter`, or `differential_drive` if the plan changes the drive, or the name of another rig."""
    if rig is not None and rig.name not in _NOVA_CARTER_RIGS:
        return rig.name
    is_standard = robot.model_dump(include=_BODY_FIELDS) == RobotConfig().model_dump(include=_BODY_FIELDS)
    return "nova_carter" if is_standard else "differential_drive"


def robot_words(robot: RobotConfig, rig: Rig | None) -> str:
    """Returns the robot as the subject of a sentence.

    Args:
        robot: robot of the plan.
        rig: sensors of the frames; `None` for the recorded camera.
    """
    name = robot_name(robot, rig)
    known = {"nova_carter": "A Nova Carter", "differential_drive": "A robot with two driven wheels"}
    return known.get(name, f"A robot with two driven wheels and the sensors of rig `{name}`")


_STRAIGHT = (
    "The expert knows where its target is and drives straight, so the data contain no detours around obstacles; its "
    "starts are screened by `spawn.screening` of the plan: {}."
)
_PLANNED = "The expert knows the floor plan; its actions near corners cannot always be predicted from the images."


def dataset_card(meta: DatasetMeta, aggregates: TableAggregates, with_tables: Collection[str] = ()) -> str:
    """Returns the text of the card.

    Args:
        meta: metadata of the dataset.
        aggregates: aggregates of all rows of its tables.
        with_tables: splits with split tables.
    """
    stores_frames = meta.plan.record is Recording.FRAMES
    rig = meta.plan.rig if stores_frames else None
    languages, wording = _instructions(meta)
    return _CARD.format(
        configs=configs_to_yaml(split_configs(with_tables, meta.episodes, meta.failed_attempts)),
        size=next((name for limit, name in _SIZES if meta.episodes < limit), "n>1M"),
        pretty=f"MiniVLA-Nav, {meta.plan.name}",
        run=meta.run,
        plan=meta.plan.name,
        episodes=meta.episodes,
        planned=meta.planned,
        state="" if meta.complete else " so far",
        seed=meta.seed,
        expert=meta.plan.expert,
        version=meta.software.get("minivla-factory", "(not installed)"),
        renderers=" and ".join(meta.renderers) or "no renderer yet",
        software=_software_part(aggregates, stores_frames),
        robot=robot_words(meta.plan.robot, rig),
        goal=goal_words(meta.plan.task),
        hz=meta.plan.task.control_hz,
        failed=meta.failed_attempts,
        scenes=_scene_table(aggregates),
        tiers=_tier_table(aggregates),
        splits=_split_part(meta, aggregates),
        categories=", ".join(f"{name} {n}" for name, n in sorted(aggregates.categories.items())) or "none yet",
        frames=(_FRAMES if stores_frames else "") + ("" if rig is None else _SENSORS.format(rig.name)),
        rendered="" if stores_frames else _RENDERED,
        thumbnail=_THUMBNAIL if stores_frames else _DRAWN_THUMBNAIL,
        picture=_PICTURE if stores_frames else "",
        expert_limit=_PLANNED if meta.plan.expert == "planner" else _STRAIGHT.format(meta.plan.screening),
        languages="\n".join(f"- {code}" for code in languages),
        english=" in English" if languages == ("en",) else "",
        wording=wording,
        light="" if _varies_light(meta.plan.appearance) else ", and each scene has one light",
    )


def languages_of(meta: DatasetMeta) -> tuple[str, ...]:
    """Returns the codes of the languages of the instructions."""
    return _instructions(meta)[0]


def _instructions(meta: DatasetMeta) -> tuple[tuple[str, ...], str]:
    """Returns the languages of the instructions, and how they were written."""
    if meta.relabelling is not None:
        return meta.relabelling.languages, _RELABELLED
    if meta.plan.language is not None:
        return tuple(meta.plan.language.languages), _WRITTEN
    return ("en",), _TEMPLATES.format(len(TEMPLATES))


def _varies_light(appearance: Appearance | None) -> bool:
    return appearance is not None and appearance.light is not None


def with_shards(card: str, shards: int) -> str:
    """Returns the card with the current number of shards. Without shards, the line is removed."""
    lines = [line for line in card.splitlines(keepends=True) if not line.startswith(_SHARDS)]
    at = next((number for number, line in enumerate(lines) if line.startswith("- `data/")), len(lines))
    text = f"{_SHARDS}ZIP files of episodes, {shards} in total; `shards.parquet` lists the place of each episode.\n"
    return "".join([*lines[:at], text, *lines[at:]] if shards else lines)


def _software_part(aggregates: TableAggregates, stores_frames: bool) -> str:
    """Returns the part of the card that lists the software and machines that make the same frames, byte for byte."""
    rows = set()
    for renderer, software, cpu in aggregates.makers:
        versions = json.loads(software)
        machine = cpu.rpartition("(")[2].rstrip(")")
        rows.add((renderer, versions.get("minivla-factory", "-"), versions.get("libc", "-"), machine))
    if not rows:
        return ""
    what = "make" if stores_frames else "make and read"
    return (
        f"Machines with this software {what} the same frames, byte for byte; `deploy/Dockerfile` of minivla-factory\n"
        "installs fixed versions. `factory verify . --render all` measures how far pixels of another machine differ.\n"
        "\n" + _table(("renderer", "minivla-factory", "C library", "machine"), sorted(rows))
    )


def _scene_table(aggregates: TableAggregates) -> str:
    rows = []
    for scene in sorted(aggregates.scenes.keys() | aggregates.refused.keys()):
        totals, refused = aggregates.scenes[scene], aggregates.refused[scene]
        share = f"{100 * totals.episodes / (totals.episodes + refused):.0f} %" if totals.episodes + refused else "-"
        rows.append((scene, *_means(totals), str(totals.episodes + refused), share))
    head = ("scene", "episodes", "steps", "start m", "TL m", "NE m", "attempts", "succeeded")
    return "Means over the archived episodes; attempts that crashed or lost their lease are not counted.\n\n" + _table(
        head, rows
    )


def _tier_table(aggregates: TableAggregates) -> str:
    rows = [(str(tier), *_means(aggregates.tiers[str(tier)])) for tier in Tier if str(tier) in aggregates.tiers]
    return _table(("spawn tier", "episodes", "steps", "start m", "TL m", "NE m"), rows)


def _split_part(meta: DatasetMeta, aggregates: TableAggregates) -> str:
    scenes = sorted({scene for scene, _, _ in aggregates.counts})
    count: Counter[tuple[str, str]] = Counter()
    for (scene, split, _), number in aggregates.counts.items():
        count[scene, split] += number
    rows = []
    for split, meaning in _SPLITS.items():
        numbers = [count[scene, str(split)] for scene in scenes]
        if sum(numbers):
            rows.append((str(split), meaning, *map(str, [*numbers, sum(numbers)])))
    return "## Splits\n" + _table(("split", "what", *scenes, "all"), rows) + "\n\n" + _side_paragraph(meta)


def _side_paragraph(meta: DatasetMeta) -> str:
    if meta.shared_instances is None:
        return "Training and evaluation may name the same instances; `factory stats` counts how many they share."
    kept = "No instance that `train_id` names is named by `val_id`, `test_id` or `test_paraphrase_ood`"
    shared = [f"{scene}: {', '.join(names)}" for scene, names in meta.shared_instances.items() if names]
    if not shared:
        return f"{kept}."
    places = "; ".join(shared)
    return f"{kept}, except in categories with too few instances ({places}); their `instance_side` is `shared`."


def _means(sums: EpisodeSums) -> tuple[str, ...]:
    n = sums.episodes
    if n == 0:
        return ("0", "-", "-", "-", "-")
    lengths = f"{sums.spawn_dist_m / n:.2f}", f"{sums.trajectory_length_m / n:.2f}", f"{sums.final_ne_m / n:.3f}"
    return (str(n), f"{sums.steps / n:.1f}", *lengths)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])
