"""Exports in the format of COCO, read by its own library."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image
from pycocotools import mask as library
from pycocotools.coco import COCO

from factory.dataset.reader import Dataset
from factory.export.coco import compressed_runs, masks_of
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.registry import find_exporter

# pycocotools 2.0.11 was written for NumPy 1
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
STRIDE = 3
SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 40))


@pytest.fixture(scope="module")
def out(varied: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("coco") / "out"
    assert run_export(ExportOrder(varied, place, "coco", find_exporter("coco").options(fps=60 // STRIDE))).complete
    return place


@given(SHAPES.flatmap(lambda shape: arrays.arrays(bool, shape)))
def test_run_lengths_equal_those_of_pycocotools(mask: np.ndarray) -> None:
    encoded = library.encode(np.asfortranarray(mask.astype(np.uint8)))
    assert compressed_runs(mask) == encoded["counts"].decode()


@given(st.integers(0, 2000), st.integers(1, 2000))
def test_long_runs_equal_those_of_pycocotools(start: int, length: int) -> None:
    mask = np.zeros((640, 9), bool)
    mask.ravel()[start : start + length] = True
    encoded = library.encode(np.asfortranarray(mask.astype(np.uint8)))
    assert compressed_runs(mask) == encoded["counts"].decode()


@given(SHAPES.flatmap(lambda shape: arrays.arrays(np.uint16, shape, elements=st.integers(0, 3))))
def test_areas_and_boxes_equal_those_of_pycocotools(ids: np.ndarray) -> None:
    masks = masks_of(ids)
    assert [each["instance_id"] for each in masks] == [number for number in np.unique(ids).tolist() if number]
    for each in masks:
        assert np.array_equal(library.decode(each["segmentation"]), ids == each["instance_id"])
        assert each["area"] == library.area(each["segmentation"])
        assert each["bbox"] == library.toBbox(each["segmentation"]).tolist()


@pytest.mark.parametrize("split", ["train_id", "test_id", "test_paraphrase_ood"])
def test_pycocotools_reads_the_masks_of_every_object(out: Path, varied: Path, split: str) -> None:
    data, coco = Dataset(varied), COCO(str(out / f"annotations/instances_{split}.json"))
    episodes = {episode.episode_id: episode for episode in data if episode.summary.split == split}
    assert len(coco.imgs) == sum(-(-len(episode) // STRIDE) for episode in episodes.values())
    assert {image["episode_id"] for image in coco.imgs.values()} == episodes.keys()
    for image in coco.imgs.values():
        episode = episodes[image["episode_id"]]
        shown = np.asarray(Image.open(out / "images" / image["file_name"]))
        assert np.array_equal(shown, episode.rgb(image["frame"]))
        assert (image["width"], image["height"], image["instruction"]) == (640, 640, episode.instruction)
        categories = {each.id: each.category for each in episode.instances if each.category}
        ids, found = episode.ids(image["frame"]), coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
        assert {each["instance_id"] for each in found} == set(np.unique(ids).tolist()) & categories.keys()
        for each in found:
            assert np.array_equal(coco.annToMask(each), ids == each["instance_id"])
            assert coco.cats[each["category_id"]]["name"] == categories[each["instance_id"]]
            assert each["is_target"] == (each["instance_id"] == episode.meta.target_instance_id)


def test_some_annotations_are_of_the_target_and_categories_are_the_same_in_every_split(out: Path) -> None:
    files = sorted((out / "annotations").iterdir())
    contents = [json.loads(file.read_text()) for file in files]
    assert len(files) == 3
    assert len({json.dumps(content["categories"]) for content in contents}) == 1
    assert any(each["is_target"] for content in contents for each in content["annotations"])
