"""The four layouts of the paper; `build_scene` uses them for seed 0. Their packages must not change."""
