"""Error for a frame that differs from the recorded one. Does not render."""

from __future__ import annotations

from schemas.episode import EpisodeMeta
from schemas.errors import WorldError


def differing_frame(meta: EpisodeMeta, t: int, renderer: str) -> WorldError:
    """Returns the error for a rendered frame whose digest is not the recorded one.

    Args:
        meta: metadata of the episode.
        t: step of the frame.
        renderer: description of the renderer that rendered it.
    """
    return WorldError(
        f"{meta.episode_id}: frame {t} differs from the recorded digest; recorded with "
        f"{meta.provenance.fingerprint.renderer}, rendered with {renderer}: render with the recording's version of Mesa"
    )
