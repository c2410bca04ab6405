"""Reads an export in the format `paper`, with which other exports are compared. Does not import this project."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image


class Paper:
    """A dataset as `factory export --to paper` writes it; arrays are read with numpy or Pillow."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.episodes = root / "episodes"

    def meta(self, name: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.episodes / name / "meta.json").read_text())
        return found

    def rgb(self, name: str, t: int) -> NDArray[np.uint8]:
        return np.asarray(Image.open(self.episodes / name / f"rgb_front/{t:06d}.png"))

    def depth(self, name: str, t: int) -> NDArray[np.float32]:
        found: NDArray[np.float32] = np.load(self.episodes / name / f"depth_front/{t:06d}.npy")
        return found

    def ids(self, name: str, t: int) -> NDArray[np.uint16]:
        return np.asarray(Image.open(self.episodes / name / f"seg_front/{t:06d}.png"))

    def array(self, name: str, kind: str) -> NDArray[Any]:
        found: NDArray[Any] = np.load(self.episodes / name / f"{kind}.npy")
        return found


def psnr(one: NDArray[Any], two: NDArray[Any]) -> float:
    """Returns the PSNR of two 8-bit images, dB."""
    return float(10 * np.log10(255.0**2 / np.mean((one.astype(np.float64) - two) ** 2)))


def shrunk(image: NDArray[Any], side: int) -> NDArray[Any]:
    """Returns an image of `side` pixels: colours averaged over squares, depth and ids of the pixel in the middle."""
    if len(image) == side:
        return image
    if image.ndim == 3:
        return np.asarray(Image.fromarray(image).resize((side, side), Image.Resampling.BOX))
    middle = ((np.arange(side) + 0.5) * len(image) / side).astype(int)
    return image[middle[:, None], middle]


def mean_commands(actions: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """Returns (N, 2) mean commands, each from one kept frame to the next."""
    return np.stack([actions[t : t + stride].mean(axis=0) for t in range(0, len(actions), stride)])
