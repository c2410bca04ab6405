"""Prepares a scene for instructions: the verifier, the doorways, and facts for the generator. Opens no file."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

from schemas.language.generator.facts import SceneFacts
from schemas.language.generator.parts import SceneParts
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.route.doorways import RoomPassage, find_doorways
from schemas.language.verifier.verify import Verifier


@dataclass
class SceneLanguage:
    """Prepared scene: the verifier, and facts for the generator.

    Args:
        graph: scene graph.
    """

    graph: SceneGraph
    rejected: Counter[str] = field(default_factory=Counter)
    """Number of sentences that the verifier rejected, by reason."""

    def __post_init__(self) -> None:
        self.facts = SceneFacts(self.graph)
        self.parts = SceneParts(self.facts)
        self.verifier = Verifier(self.graph)
        self._of_kind = Counter(each.kind for each in self.graph.objects)

    def distractors(self, number: int) -> int:
        """Returns the number of other objects that have the kind of an object."""
        return self._of_kind[self.graph.objects[number].kind] - 1

    @cached_property
    def doorways(self) -> tuple[RoomPassage, ...]:
        return find_doorways(self.graph)
