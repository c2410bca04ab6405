"""Free space of the disk is checked before anything is created."""

from __future__ import annotations

import pytest

from schemas.errors import WorldError
from schemas.storage.disk import require_room


def test_a_disk_below_the_reserve_is_refused_before_anything_is_created(tmp_path):
    root = tmp_path / "not" / "yet"
    with pytest.raises(WorldError, match="free some space or choose another --out"):
        require_room(root, 1 << 60)
    assert not (tmp_path / "not").exists()


def test_a_disk_with_room_is_accepted_for_a_directory_that_does_not_exist_yet(tmp_path):
    require_room(tmp_path / "not" / "yet", 0)
