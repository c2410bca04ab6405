"""Builds the dataset card (`README.md`) of an export in the format of the Hugging Face Hub. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence

from coordinator.tables.card import Configs, configs_to_yaml, goal_words, languages_of, robot_words
from schemas.dataset.meta import DatasetMeta
from schemas.rig import Rig

CARD_FILE = "README.md"
TAGS = (
    "robotics",
    "navigation",
    "imitation-learning",
    "vision-language-action",
    "language-conditioned",
    "differential-drive",
    "simulation",
)
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_FRONT = """\
---
license: cc-by-4.0
language:
{languages}
pretty_name: {title}
task_categories:
- robotics
tags:
{tags}
size_categories:
- {size}
{configs}---
# {title}

"""


def export_card(
    meta: DatasetMeta,
    rig: Rig | None,
    episodes: int,
    text: str,
    configs: Configs | None = None,
    tags: Sequence[str] = (),
    questions: str = "",
) -> str:
    """Returns the text of the card.

    Args:
        meta: metadata of the dataset.
        rig: exported sensors; `None` for the recorded camera.
        episodes: number of episodes in the export.
        text: Markdown below the title.
        configs: name -> split -> path or pattern of its files, for the dataset viewer; the first is the default.
        tags: additional tags.
        questions: section about questions, see `factory.export.questions.questions_text`.
    """
    languages = languages_of(meta)
    english = " in English" if languages == ("en",) else ""
    front = _FRONT.format(
        title=meta.run,
        languages="\n".join(f"- {code}" for code in languages),
        tags="\n".join(f"- {tag}" for tag in (*tags, *TAGS)),
        size=next((name for limit, name in _SIZES if episodes < limit), "n>1M"),
        configs=configs_to_yaml(configs) if configs else "",
    )
    origin = (
        f"{episodes} episodes of language-conditioned robot navigation, made with minivla-factory from seed "
        f"{meta.seed} with the `{meta.plan.expert}` expert. {robot_words(meta.plan.robot, rig)} gets an "
        f"instruction{english} that names an object; it stops {goal_words(meta.plan.task)}.\n\n"
    )
    return front + origin + text.strip() + "\n" + questions
