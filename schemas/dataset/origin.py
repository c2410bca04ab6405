"""Model of an episode's origin: what an export stores of each episode so that it can be simulated again without it.

Reads and writes no file.
"""

from __future__ import annotations

from schemas.base import Line, Model, Name
from schemas.job import Job

PACKAGE = "minivla-factory"
NOT_RECORDED = "unknown"


class EpisodeOrigin(Model):
    """Origin of an exported episode.

    The job states the digest of the scene package (`scene_sha256`), the digest of the plan (`plan_digest`), the root
    seed (`root_seed`), the number of the episode in its run (`index`), the draw and the attempt.
    """

    format: int = 1
    """Version of the model."""
    episode: Name
    """Id of the episode in the exported dataset; in a merged dataset, its number differs from `job.index`."""
    version: Line
    """Version of minivla-factory that simulated the episode."""
    states_digest: Line
    """Digest of the actions, poses and metadata, which a replay must reach."""
    job: Job
    """All inputs of the attempt."""

    def to_json(self) -> str:
        """Returns the origin as one line of JSON."""
        return self.model_dump_json()
