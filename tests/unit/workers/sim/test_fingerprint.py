"""The fingerprint of this process."""

from __future__ import annotations

import numpy as np

from workers.sim.context import make_fingerprint


def test_fingerprint_names_the_software_that_determines_the_bytes() -> None:
    software = make_fingerprint("some renderer").software
    assert software["numpy"] == np.__version__
    assert {"minivla-factory", "python", "pybullet", "moderngl", "zstandard", "isal"} <= set(software)


def test_fingerprint_is_the_same_every_time() -> None:
    assert make_fingerprint("some renderer") == make_fingerprint("some renderer")


def test_the_fingerprint_contains_the_renderer_description() -> None:
    assert make_fingerprint("llvmpipe").renderer == "llvmpipe"
