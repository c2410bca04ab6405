"""`factory show`: writes one episode as a contact sheet or a video."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import click
from PIL import Image

from factory.commands.common.bars import Bars
from factory.commands.common.episode_names import episode_path
from factory.commands.common.output import print_json
from factory.dataset.bundle import EpisodeBundle
from factory.dataset.steps import read_steps
from factory.runs.scene_packages import find_package
from factory.visualize.film import draw_film, film_rate, require_mp4, write_gif, write_mp4
from factory.visualize.panels import draw_contact_sheet
from factory.visualize.rig_sheet import draw_rig_sheet
from schemas.bundle import BundleReader
from schemas.errors import UsageError
from schemas.rig import Imu, WheelOdometry
from schemas.rig.rig_file import load_rig
from schemas.scene import CompiledScene, read_geometry
from schemas.storage.disk import translated
from schemas.storage.place import Place

_GIF_FPS = 15
_KINDS = (".png", ".mp4", ".gif")


def execute(root: Place, episode: str, out: Path | None, columns: int, rig: str | None, as_json: bool) -> None:
    """Executes `factory show`."""
    path = episode_path(root, episode)
    target = out or Path(f"{path.stem}.png")
    kind = target.suffix.lower()
    if kind not in _KINDS:
        raise UsageError(
            f"-o {target}: {f'suffix {kind!r} is not supported' if kind else 'the suffix is missing'}; supported "
            f"suffixes: {', '.join(_KINDS)}"
        )
    if rig is not None and kind != ".png":
        raise UsageError(f"-o {target}: --rig draws a contact sheet: choose a file that ends in .png")
    if kind == ".mp4":
        require_mp4()
    with path.open("rb") as file, EpisodeBundle(file, root) as bundle:
        job = bundle.meta.job
        scene = read_geometry(find_package(root, job.scene, job.scene_sha256).path)
        with translated("create", target.parent):
            target.parent.mkdir(parents=True, exist_ok=True)
        facts: dict[str, object] = {
            "file": str(target),
            "kind": kind[1:],
            "episode": job.episode_id,
            "frames": bundle.length,
        }
        steps = read_steps(root, job.episode_id)
        if steps:
            facts["steps"] = [{"text": each.text, "start": each.start, "end": each.end} for each in steps]
        if kind == ".png":
            sheet = draw_contact_sheet(bundle, scene, columns) if rig is None else _rig_sheet(bundle, rig, columns)
            with translated("write", target):
                sheet.save(target)
        else:
            facts |= {"fps": float(_save_film(target, bundle, scene))}
    if as_json:
        print_json(facts | {"bytes": target.stat().st_size})
    else:
        click.echo(str(target))
        for each in steps:
            click.echo(f"{each.number}. frames {each.start} to {each.end - 1}: {each.text}")


def _rig_sheet(bundle: EpisodeBundle, reference: str, columns: int) -> Image.Image:
    rig = load_rig(reference, bundle.meta.job.task.control_hz)
    if all(isinstance(sensor, Imu | WheelOdometry) for sensor in rig.sensors):
        raise UsageError(f"rig {rig.name!r} has no camera and no lidar to show")
    return draw_rig_sheet(bundle, rig, columns)


def _save_film(target: Path, bundle: BundleReader, scene: CompiledScene) -> Fraction:
    is_gif = target.suffix.lower() == ".gif"
    hz = bundle.meta.job.task.control_hz
    stride, rate = film_rate(hz, _GIF_FPS) if is_gif else film_rate(hz)
    write = write_gif if is_gif else write_mp4
    with Bars(transient=True) as bar:
        pictures = bar.track(draw_film(bundle, scene, stride), total=-(-(bundle.length - 1) // stride) + 1)
        write(target, pictures, rate)
    return rate
