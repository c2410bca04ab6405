"""The four layouts of the paper, for seed 0 of a scene name without number. Their packages must not change."""
