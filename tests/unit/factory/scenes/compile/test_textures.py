"""Textures become layers, or plain colours with a note."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from factory.scenes.compile.textures import MAX_LAYERS, load_textures


def png(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, "PNG")
    return buffer.getvalue()


def flat(red: int, green: int, blue: int) -> bytes:
    return png(np.full((4, 4, 3), (red, green, blue), np.uint8))


def test_an_image_keeps_its_rows_and_colours() -> None:
    halves = np.zeros((8, 8, 3), np.uint8)
    halves[:4], halves[4:] = (200, 0, 0), (0, 0, 200)
    book = load_textures({"a.png": 1.0}, {"a.png": png(halves)}.get)
    (layer,) = book.layers
    assert layer.shape == (512, 512, 3)
    assert layer[10, 10].tolist() == [200, 0, 0]
    assert layer[-10, 10].tolist() == [0, 0, 200]


def test_equal_images_share_a_layer() -> None:
    book = load_textures({"a.png": 1.0, "b.png": 1.0}, lambda path: flat(1, 2, 3))
    assert len(book.layers) == 1
    assert book.layer_of["a.png"] == book.layer_of["b.png"] == 0


@pytest.mark.parametrize("data", [None, b"no picture", flat(0, 0, 0)[:40]], ids=["missing", "garbage", "cut off"])
def test_an_unreadable_texture_is_noted(data: bytes | None) -> None:
    book = load_textures({"dir/a.png": 1.0}, lambda path: data)
    assert book.layers == ()
    assert "a.png" in book.notes[0]
    assert "dir/" not in book.notes[0]


def test_the_largest_textures_get_the_layers() -> None:
    areas = {f"{number:03d}": float(number) for number in range(MAX_LAYERS + 6)}
    book = load_textures(areas, lambda path: flat(int(path), 0, 0))
    assert len(book.layers) == MAX_LAYERS
    assert "000" not in book.layer_of
    assert "005" not in book.layer_of
    assert "006" in book.layer_of
    assert "000" in book.mean_of
    assert len(book.notes) == 1


def test_sixteen_bit_gray_and_palettes_become_eight_bit_colour() -> None:
    deep = png(np.full((4, 4), 0x8080, np.uint16))
    palette = io.BytesIO()
    Image.new("P", (4, 4), 0).save(palette, "PNG")
    book = load_textures({"deep": 1.0, "palette": 1.0}, {"deep": deep, "palette": palette.getvalue()}.get)
    assert book.layers[book.layer_of["deep"]][0, 0].tolist() == [128, 128, 128]
    assert not book.notes


def test_mean_colour_is_linear() -> None:
    book = load_textures({"a": 1.0}, lambda path: flat(188, 188, 188))
    assert book.mean_of["a"][0] == pytest.approx(0.5, abs=0.01)
