"""Contract suite of archives: a directory, and a bucket of a real S3 server."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place
from tests.builders.layout_package import make_layout
from tests.builders.object_server import ObjectServer

_HOLD = """
import sys
from pathlib import Path
from coordinator.archive.opening import open_archive
from schemas.storage.object_path import ObjectPath
archive = open_archive(Path(sys.argv[1]), ObjectPath.at(sys.argv[2]) if len(sys.argv) > 2 else None)
"""


@dataclass(frozen=True)
class Kind:
    """A kind of archive, to whose files the tests have direct access."""

    home: Path
    store: ObjectPath | None

    def open(self) -> Archive:
        return open_archive(self.home, self.store)

    @property
    def root(self) -> Place:
        return self.store or self.home

    def lay(self, name: str, data: bytes) -> None:
        """Writes a file directly, not through the archive."""
        if self.store is not None:
            self.store.objects.put(name, data)
            return
        path = self.home / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)

    def names(self, folder: str) -> list[str]:
        return sorted(path.name for path in (self.root / folder).iterdir())

    def run(self, text: str) -> subprocess.CompletedProcess[str]:
        arguments = [self.home] if self.store is None else [self.home, str(self.store)]
        command = [sys.executable, "-c", _HOLD + text, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(params=["directory", "bucket"])
def kind(request: pytest.FixtureRequest, tmp_path: Path) -> Kind:
    if request.param == "directory":
        return Kind(tmp_path / "data", None)
    new_bucket: Callable[[], str] = request.getfixturevalue("bucket_url")
    return Kind(tmp_path / "home", ObjectPath.at(f"{new_bucket()}/run"))


def publish(archive: Archive, index: int, data: bytes) -> Place:
    with archive.stage(index) as staged:
        staged.write(data)
        return archive.publish(staged, index)


def parts_of(kind: Kind) -> list[Path]:
    return list((kind.home / ".staging").iterdir())


def test_published_episode_has_the_written_bytes_and_its_file_name(kind: Kind) -> None:
    with kind.open() as archive:
        place = publish(archive, 123, b"bundle")
        assert str(place) == f"{kind.root}/episodes/ep_000123.zip"
        assert place.read_bytes() == b"bundle"
        assert archive.present() == {123: place}
        assert archive.present()[123].stat().st_size == 6
        assert parts_of(kind) == []


def test_a_file_on_the_same_disk_is_linked_and_stays_unchanged(kind: Kind) -> None:
    with kind.open() as archive:
        source = kind.home / "elsewhere.zip"
        source.write_bytes(b"bundle")
        with archive.stage(5) as staged:
            staged.link(source)
            assert (staged.size, staged.sha256) == (6, hashlib.sha256(b"bundle").hexdigest())
            place = archive.publish(staged, 5)
        assert place.read_bytes() == source.read_bytes() == b"bundle"
        with archive.stage(6) as dropped:
            dropped.link(source)
        assert source.read_bytes() == b"bundle"
        with archive.stage(6) as staged:
            with pytest.raises(FileNotFoundError):
                staged.link(kind.home / "gone.zip")
            staged.write(b"grown")
            assert archive.publish(staged, 6).read_bytes() == b"grown"
        assert parts_of(kind) == []


def test_episodes_are_listed_in_ascending_order(kind: Kind) -> None:
    with kind.open() as archive:
        for index in (1_000_000, 2, 10):
            publish(archive, index, b"x")
        assert list(archive.present()) == [2, 10, 1_000_000]


def test_nothing_is_published_before_commit(kind: Kind) -> None:
    with kind.open() as archive:
        with archive.stage(1) as staged:
            staged.write(b"half")
            assert archive.present() == {}
        assert archive.present() == {}
        assert not archive.path_of(1).exists()
        assert parts_of(kind) == []


def test_archived_episode_is_never_overwritten(kind: Kind) -> None:
    with kind.open() as archive:
        place = publish(archive, 1, b"first")
        with pytest.raises(ArchiveCorrupt, match="already exists and is not overwritten"):
            publish(archive, 1, b"other")
        assert place.read_bytes() == b"first"
        assert parts_of(kind) == []


def test_several_episodes_are_published_together_and_one_that_is_stored_already_is_reported(kind: Kind) -> None:
    with kind.open() as archive:
        publish(archive, 2, b"first")
        parts = {index: archive.stage(index) for index in (1, 2, 3)}
        for index, staged in parts.items():
            staged.write(b"%d" % index)
        failed = archive.publish_all(parts)
        assert list(failed) == [2]
        assert "already exists and is not overwritten" in str(failed[2])
        assert {index: path.read_bytes() for index, path in archive.present().items()} == {
            1: b"1",
            2: b"first",
            3: b"3",
        }
        assert parts_of(kind) == []


def test_unpublishing_deletes_an_episode_and_may_be_repeated(kind: Kind) -> None:
    with kind.open() as archive:
        place = publish(archive, 1, b"late")
        archive.unpublish(1)
        archive.unpublish(1)
        assert archive.present() == {}
        assert not place.exists()
        publish(archive, 1, b"again")


def test_quarantined_file_is_kept_with_its_reason(kind: Kind) -> None:
    with kind.open() as archive:
        place = archive.quarantine(publish(archive, 1, b"torn"), "5 bytes; in the ledger 9")
        assert place.read_bytes() == b"torn"
        reason = (place.parent / f"{place.name}.reason.txt").read_text(encoding="utf-8")
        assert "ep_000001.zip" in reason
        assert "5 bytes; in the ledger 9" in reason
        assert archive.present() == {}


def test_two_episodes_of_the_same_name_are_both_kept_in_quarantine(kind: Kind) -> None:
    with kind.open() as archive:
        places = [archive.quarantine(publish(archive, 1, data), "torn") for data in (b"one", b"two")]
        assert [place.read_bytes() for place in places] == [b"one", b"two"]


def test_foreign_files_are_distinguished_from_episodes(kind: Kind) -> None:
    with kind.open() as archive:
        publish(archive, 2, b"two")
        kind.lay("episodes/notes.txt", b"mine")
        kind.lay("episodes/ep_0000001.zip", b"too many digits")
        assert list(archive.present()) == [2]
        foreign = archive.foreign()
        assert [path.name for path in foreign] == ["ep_0000001.zip", "notes.txt"]
        for path in foreign:
            archive.quarantine(path, "its name is not that of an episode")
        assert archive.foreign() == []


def test_leftover_part_files_are_removed_at_the_next_start(kind: Kind) -> None:
    with kind.open():
        (kind.home / ".staging/ep_000001.00.part").write_bytes(b"half")
    with kind.open():
        assert parts_of(kind) == []


def test_scene_is_kept_once_under_its_digest(kind: Kind, tmp_path: Path) -> None:
    source = tmp_path / "office.scene"
    source.write_bytes(b"package")
    sha256 = hashlib.sha256(b"package").hexdigest()
    with kind.open() as archive:
        place = archive.add_scene(source, "office", sha256)
        source.unlink()
        assert archive.add_scene(source, "office", sha256) == place
        assert place.read_bytes() == b"package"
        assert place.name == f"office-{sha256[:16]}.scene.zip"


def test_scenes_share_their_textures_which_are_stored_once(kind: Kind, tmp_path: Path) -> None:
    one, other = make_layout("home_00001", shades=(40, 200)), make_layout("home_00002", shades=(90, 200))
    with kind.open() as archive:
        archive.add_scene(one.write(tmp_path / "one/home.scene.zip"), "home_00001", one.sha256, one.names)
        sent = other.write(tmp_path / "other/home.scene.zip")
        shared = next(texture for texture in other.textures if texture in one.textures)
        (sent.parent / shared.file).unlink()  # the archive already has this texture
        archive.add_scene(sent, "home_00002", other.sha256, other.names)
        names = [f"{texture.sha256}.npy.zst" for texture in {*one.textures, *other.textures}]
        assert kind.names("scenes/textures") == sorted(names)
        assert archive.texture_path(shared.sha256).read_bytes() == one.textures[shared]
        assert parts_of(kind) == []


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(b"x")], ids=["missing", "damaged"])
def test_scene_with_a_missing_or_damaged_texture_is_not_stored(
    kind: Kind, tmp_path: Path, damage: Callable[[Path], object]
) -> None:
    layout = make_layout("home_00001")
    source = layout.write(tmp_path / "home.scene.zip")
    damage(tmp_path / list(layout.textures)[1].file)
    with kind.open() as archive:
        with pytest.raises(ArchiveCorrupt, match="build the scene again"):
            archive.add_scene(source, "home_00001", layout.sha256, layout.names)
        assert not archive.scene_path("home_00001", layout.sha256).exists()
        assert parts_of(kind) == []


def test_textures_that_no_scene_needs_are_deleted(kind: Kind, tmp_path: Path) -> None:
    layout = make_layout("home_00001")
    source = layout.write(tmp_path / "home.scene.zip")
    needed, surplus = layout.textures
    with kind.open() as archive:
        archive.add_scene(source, "home_00001", layout.sha256, layout.names)
        archive.sweep_textures({needed.sha256})
        assert archive.texture_path(needed.sha256).exists()
        assert not archive.texture_path(surplus.sha256).exists()


def test_scene_with_another_digest_is_refused(kind: Kind, tmp_path: Path) -> None:
    source = tmp_path / "office.scene"
    source.write_bytes(b"package")
    with kind.open() as archive:
        with pytest.raises(ArchiveCorrupt, match="expected 0000"):
            archive.add_scene(source, "office", "0" * 64)
        assert kind.names("scenes") == []
        assert parts_of(kind) == []


def test_table_is_replaced_whole_or_not_at_all(kind: Kind) -> None:
    with kind.open() as archive:
        with archive.replacing("metadata.parquet") as path:
            path.write_bytes(b"old")
        with pytest.raises(TypeError), archive.replacing("metadata.parquet") as path:
            path.write_bytes("no bytes")  # type: ignore[arg-type]
        assert (kind.root / "metadata.parquet").read_bytes() == b"old"
        with archive.replacing("metadata.parquet") as path:
            path.write_bytes(b"new")
        assert (kind.root / "metadata.parquet").read_bytes() == b"new"
        assert parts_of(kind) == []


def test_the_error_of_a_second_coordinator_names_the_holder_of_the_lock(kind: Kind) -> None:
    with kind.open():
        other = kind.run("")
    assert other.returncode == 1
    assert f"another coordinator works on {kind.root} (pid {os.getpid()})" in other.stderr
    with kind.open():
        pass


def test_the_lock_is_released_when_its_holder_is_killed(kind: Kind) -> None:
    killed = kind.run("import os; os.kill(os.getpid(), 9)")
    assert killed.returncode == -9, killed.stderr
    with kind.open():
        pass


def test_episode_whose_writer_was_killed_after_publishing_is_stored_completely(kind: Kind) -> None:
    killed = kind.run(
        "staged = archive.stage(7); staged.write(b'x' * 100_000); archive.publish(staged, 7);"
        "other = archive.stage(8); other.write(b'half'); import os; os.kill(os.getpid(), 9)"
    )
    assert killed.returncode == -9, killed.stderr
    with kind.open() as archive:
        assert [(index, place.read_bytes()) for index, place in archive.present().items()] == [(7, b"x" * 100_000)]
        assert parts_of(kind) == []


def test_free_space_is_that_of_the_disk_to_which_part_files_are_written(kind: Kind) -> None:
    with kind.open() as archive:
        status = os.statvfs(kind.home)
        assert 0 < archive.free_bytes() <= status.f_blocks * status.f_frsize


def test_file_in_place_of_the_directory_is_refused_with_the_reason(kind: Kind) -> None:
    kind.home.write_text("a file")
    with pytest.raises(WorldError, match=r"cannot open .*; the path is a file, not a directory"):
        kind.open()


def test_the_bucket_fixture_uses_a_private_server(object_store: ObjectServer) -> None:
    assert object_store.endpoint.startswith("http://127.0.0.1:")
