"""Textures shared by layouts, in all functions that copy, list, check or repair the packages of a dataset."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from coordinator.recovery.repair_dataset import repair
from coordinator.validation.validator import Validator
from factory.dataset.packages import ScenePackage, find_package_file
from factory.push.files import plan_push
from factory.relabel.relabel_dataset import relabel
from factory.runs.catalog import open_catalog
from factory.scenes.build import package_path
from factory.submit.slurm import copy_scenes
from factory.verify.dataset import verify
from factory.verify.findings import Kind
from factory.verify.repair_input import inspect_dataset
from schemas.errors import ArchiveCorrupt
from schemas.language.language_file import LanguageSpec
from schemas.scene import TextureFile, encode_layout, read_geometry, read_scene
from schemas.scene.files import faulty_textures
from schemas.scene.info import texture_file
from schemas.storage.object_path import ObjectPath
from tests.builders.dataset import make_dataset, office_scene
from tests.builders.layout_package import MadeLayout, make_layout
from tests.builders.wire_worker import WireWorker, until
from tests.integration.test_layout_builds import FIRST, PLAN, SECOND, build_claim, coordinator, deliver

FOREIGN = texture_file("a" * 64)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns the dataset of a run with two layouts and no episode; both layouts are also in the scene cache."""
    monkeypatch.setenv("MINIVLA_CACHE", str(tmp_path))
    for layout, seed in ((FIRST, 5), (SECOND, 6)):
        make_layout(layout).write(package_path("office", seed, tmp_path / "scenes", called=layout))
    with coordinator(tmp_path / "data") as core, WireWorker(core.endpoints, core.run) as worker:
        for done in (1, 2):
            claim = build_claim(worker)
            assert claim.build is not None
            deliver(worker, claim, make_layout(claim.build.layout).complete(claim.build.textures))
            until(lambda done=done: core.progress().layouts.get("archived") == done)  # type: ignore[misc]
    return tmp_path / "data"


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Returns a dataset with episodes in one scene of format 4."""
    made = encode_layout(office_scene())
    make_dataset(tmp_path / "small/data", package=MadeLayout(made.data, made.textures).complete())
    return tmp_path / "small/data"


def textures(root: Path) -> list[Path]:
    return sorted((root / "scenes/textures").iterdir())


def found(root: Path) -> list[tuple[Kind, str]]:
    return sorted({(finding.kind, finding.file) for finding in verify(root).findings})


def test_verify_names_missing_damaged_and_surplus_textures(run: Path) -> None:
    assert verify(run).ok
    missing, damaged = textures(run)
    missing.unlink()
    damaged.write_bytes(b"x")
    (run / "scenes" / FOREIGN).write_bytes(b"x")
    assert found(run) == sorted(
        [
            (Kind.MISSING, f"scenes/textures/{missing.name}"),
            (Kind.DAMAGED, f"scenes/textures/{damaged.name}"),
            (Kind.FOREIGN, f"scenes/{FOREIGN}"),
        ]
    )


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(b"x")], ids=["missing", "damaged"])
def test_repair_restores_textures_from_a_layout_that_is_built_again(
    run: Path, tmp_path: Path, harm: Callable[[Path], object]
) -> None:
    before = {path: path.read_bytes() for path in textures(run)}
    for path in before:
        harm(path)
    given = inspect_dataset(run, run, None, None, tmp_path / "scenes", lambda _: None)
    assert list(given.scenes) == [FIRST]  # one layout is enough, because the layouts share all textures
    with Validator() as checker:
        repair(given, checker, datetime.now(UTC), apply=True)
    assert {path: path.read_bytes() for path in textures(run)} == before
    assert verify(run).ok
    assert len(list((run / "quarantine").glob("*.zst.*[0-9a-f]"))) == (0 if harm is Path.unlink else 2)


def test_repair_removes_textures_that_no_scene_needs(run: Path, tmp_path: Path) -> None:
    (run / "scenes" / FOREIGN).write_bytes(b"x")
    given = inspect_dataset(run, run, None, None, tmp_path / "scenes", lambda _: None)
    with Validator() as checker:
        repair(given, checker, datetime.now(UTC), apply=True)
    assert verify(run).ok


def test_a_run_does_not_start_without_a_texture(run: Path, tmp_path: Path) -> None:
    textures(run)[0].unlink()
    with pytest.raises(ArchiveCorrupt, match=f"{textures(run)[0].parent}.* is missing .*factory repair"):
        open_catalog(PLAN, run, tmp_path / "scenes", only=())


def test_packages_in_another_folder_require_the_textures_in_that_folder(run: Path, tmp_path: Path) -> None:
    catalog = open_catalog(PLAN, tmp_path / "new", tmp_path / "scenes", packages=run / "scenes")
    assert set(catalog) == {FIRST, SECOND}
    textures(run)[0].unlink()
    with pytest.raises(ArchiveCorrupt, match="copy the folder textures with the packages"):
        open_catalog(PLAN, tmp_path / "new", tmp_path / "scenes", packages=run / "scenes")


def test_a_batch_run_copies_the_textures_once(run: Path, tmp_path: Path) -> None:
    copy_scenes(open_catalog(PLAN, run, tmp_path / "scenes"), tmp_path / "batch/scenes")
    packages = sorted((tmp_path / "batch/scenes").glob("*.scene.zip"))
    assert [read_scene(path).info.name for path in packages] == [FIRST, SECOND]
    assert len(textures(tmp_path / "batch")) == 2


def test_a_push_uploads_the_textures(run: Path) -> None:
    names = {file.name for file in plan_push(run, "export.json").files}
    assert {f"scenes/textures/{path.name}" for path in textures(run)} <= names


def test_a_relabelled_dataset_links_the_textures(dataset: Path, tmp_path: Path) -> None:
    relabel(dataset, tmp_path / "new", LanguageSpec(per_episode=1))
    assert verify(tmp_path / "new", deep=True).findings == verify(dataset, deep=True).findings
    assert [path.stat().st_ino for path in textures(tmp_path / "new")] == [
        path.stat().st_ino for path in textures(dataset)
    ]


def test_readers_that_need_no_pixels_do_not_read_textures(dataset: Path) -> None:
    for path in textures(dataset):
        path.unlink()
    (package,) = (dataset / "scenes").glob("*.scene.zip")
    assert read_geometry(package).info.texture_count == 2


def upload(root: Path, place: ObjectPath) -> None:
    for path in root.rglob("*"):
        if path.is_file() and not path.name.startswith("."):
            place.objects.put((place / str(path.relative_to(root))).key, path.read_bytes())


def test_a_remote_dataset_is_read_with_its_textures_which_are_downloaded_once(
    dataset: Path, tmp_path: Path, bucket_url: Callable[[], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINIVLA_CACHE", str(tmp_path / "cache"))
    place = ObjectPath.at(f"{bucket_url()}/data")
    upload(dataset, place)
    made = encode_layout(office_scene())
    package = ScenePackage(place, "office", MadeLayout(made.data, made.textures).sha256)
    assert len(package.scene().textures) == 2
    assert faulty_textures(find_package_file(*package)) == []
    texture: TextureFile = next(iter(made.textures))
    place.objects.delete((place / "scenes" / texture.file).key)
    assert len(package.scene().textures) == 2
    assert found_remote(place) == [(Kind.MISSING, f"scenes/{texture.file}")]
    (tmp_path / "cache/packages" / texture.file).unlink()
    with pytest.raises(ArchiveCorrupt, match=r"texture s3://.*\.npy\.zst .* is missing; restore it"):
        package.scene()


def found_remote(place: ObjectPath) -> list[tuple[Kind, str]]:
    return sorted({(finding.kind, finding.file) for finding in verify(place).findings})
