"""The scenes that a renderer keeps."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from schemas.scene import encode_scene
from tests.builders.scene import Box, box_room
from workers.sim.context import SimulationContext


def test_a_renderer_of_one_scene_frees_it_before_it_loads_another(tmp_path: Path) -> None:
    digests = []
    with SimulationContext("tiny", kept_scenes=1) as stage:
        for number in range(2):
            data = encode_scene(box_room([Box((number, -1.0, 0.0), (number + 0.5, 1.0, 1.0))]))
            path = tmp_path / f"{number}.scene"
            path.write_bytes(data)
            digests.append(hashlib.sha256(data).hexdigest())
            stage.load(path, digests[-1])
        assert stage.loaded(digests[1]).compiled.info is not None
        with pytest.raises(KeyError):
            stage.loaded(digests[0])
