"""The four layouts of the paper, which scene names without a number have at seed 0. Their packages must not change."""
