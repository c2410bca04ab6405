"""Instruction templates and the English names of categories (paper Table III). Makes no random choice."""

from __future__ import annotations

from types import MappingProxyType

from schemas.terms import Split

_TRAIN = (
    "Go to the {object}.",
    "Drive to the {object} and stop.",
    "Approach the {object}.",
    "Move toward the {object}.",
    "Navigate to the {object}.",
    "Go to the {color} {object}.",
    "Drive to the {color} {object} and stop.",
    "Approach the {color} {object}.",
    "Head to the {object}.",
    "Move to the {object} and halt.",
    "Go to the {object} in front of you.",
    "Drive toward the {object} until you reach it.",
    "Get to the {object}.",
    "Your destination is the {object}.",
    "Locate the {object} and stop in front of it.",
    "Go over to the {color} {object}.",
    "Move all the way to the {object}.",
    "Stop next to the {object}.",
)
_OOD = (
    "Make your way to the {object}.",
    "Proceed to the {object}.",
    "Find the {object} and come to a stop.",
    "Roll over to the {color} {object}.",
    "Go straight to the {object}.",
    "Close in on the {object}.",
    "Reach the {object} and stop there.",
    "Move until you're beside the {object}.",
    "Find your way to the {object}.",
    "Head toward the {color} {object} and stop.",
    "Get closer to the {object}.",
    "Park next to the {object}.",
)

TRAIN_TEMPLATES = MappingProxyType({f"train_{n:02d}": text for n, text in enumerate(_TRAIN, 1)})
"""T1-T18 of the paper, as `train_01` ... `train_18`."""
OOD_TEMPLATES = MappingProxyType({f"ood_{n:02d}": text for n, text in enumerate(_OOD, 1)})
"""O1-O12 of the paper, as `ood_01` ... `ood_12`; only `test_paraphrase_ood` uses them."""
TEMPLATES = MappingProxyType({**TRAIN_TEMPLATES, **OOD_TEMPLATES})
FROM_START = "from_start"
"""Template id of episodes whose instruction the worker writes at the start (docs/language.md#plans)."""


def needs_colour(template_id: str) -> bool:
    """Returns whether a template has a colour slot."""
    return template_id != FROM_START and "{color}" in TEMPLATES[template_id]


def says_in_front(template_id: str) -> bool:
    """Returns whether a template says that the target is in front of the robot; false for an unknown template."""
    return "in front of you" in TEMPLATES.get(template_id, "")


def templates_for(split: Split, colour: str) -> tuple[str, ...]:
    """Returns the ids of the templates that a split may use for a target of this colour, in the paper's order.

    Args:
        split: split of the episode, which selects training or paraphrased templates.
        colour: a colour word, or `unknown`, which excludes the templates with a colour slot.
    """
    pool = OOD_TEMPLATES if split.is_paraphrased else TRAIN_TEMPLATES
    return tuple(key for key in pool if colour != "unknown" or not needs_colour(key))


def say_category(category: str) -> str:
    """Returns the English name of a category: `trash can` for `trash_can`."""
    return category.replace("_", " ")


def instruction(template_id: str, category: str, colour: str) -> str:
    """Returns the instruction that a template gives for a category and a colour.

    Raises:
        KeyError: no template has that id.
        ValueError: the template has a colour slot and the colour is unknown.
    """
    if template_id == FROM_START:
        return f"{say_category(category)}: the sentence is written at the start"
    if colour == "unknown" and needs_colour(template_id):
        raise ValueError(f"template {template_id} names a colour, but the target's colour is unknown")
    return TEMPLATES[template_id].format(object=say_category(category), color=colour)
