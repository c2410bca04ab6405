"""Model of the planned content of an episode: scene, target and instruction. Makes no random choice.

`Job` and `EvalSpec` inherit it, so their JSON stays flat; planned draws and ledger records contain one; the rows
of a dataset's tables take its values under their published column names.
"""

from __future__ import annotations

from typing import Any

from schemas.base import Line, Model, Name
from schemas.terms import Split, Tier

_COLUMN_NAMES = {"tier": "spawn_tier", "category": "target_category"}
"""Fields whose column in a dataset's tables has a different name."""


class EpisodeSpec(Model):
    """Planned content of one draw of an episode."""

    scene: Name
    tier: Tier
    """Class of the distance from the start to the target."""
    split: Split
    category: Name
    """Category of the target."""
    target_id: Name
    colour: Name
    """Colour word that the instruction may use, or `unknown`."""
    template_id: Name
    instruction: Line

    @property
    def is_false_premise(self) -> bool:
        """Whether the instruction names an object that does not exist, so success is to stop at the start."""
        return self.split is Split.TEST_FALSE_PREMISE

    @staticmethod
    def of(source: object, **changes: object) -> EpisodeSpec:
        """Returns the spec of an object that has the same fields, such as a job, an evaluation spec or a ledger row.

        Args:
            source: object with the values.
            changes: values that replace those of `source`, by field name.

        Raises:
            ValidationError: a value is not valid.
        """
        return EpisodeSpec(**{name: getattr(source, name) for name in _FIELDS} | changes)


_FIELDS = tuple(EpisodeSpec.model_fields)


def columns_of(source: object, row: type[Model]) -> dict[str, Any]:
    """Returns the values of an episode spec by the published names of their table columns.

    Args:
        source: object with those fields of `EpisodeSpec` that are columns of the table.
        row: model of the table's rows.
    """
    columns = {_COLUMN_NAMES.get(name, name): name for name in _FIELDS}
    return {column: getattr(source, name) for column, name in columns.items() if column in row.model_fields}
