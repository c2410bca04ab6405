"""Questions about an episode with computed answers and reasons (docs/language.md#questions)."""
