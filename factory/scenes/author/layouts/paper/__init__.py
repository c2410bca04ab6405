"""The four layouts of the paper, whose packages keep their bytes: only seed 0 of a scene without number uses them."""
