"""Routes: the driven path of an episode as sub-instructions with frame spans (docs/language.md#routes)."""
