"""`factory show`: writes one episode as a contact sheet or a video."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import count_option, episode_argument, json_option, place_argument, rig_option, write_option
from schemas.errors import UsageError

if TYPE_CHECKING:
    from schemas.storage.place import Place

_KINDS = (".png", ".mp4", ".gif", ".webp")


@click.command("show")
@place_argument
@episode_argument
@write_option("FILE", "Output file: .png, .mp4, .gif or .webp. Default: EPISODE.png.", dir_okay=False)
@count_option("--columns", 6, "Number of frames per row of a contact sheet.", least=2, most=24)
@rig_option("Show the cameras and lidars of a rig, a row for each. Default: the recorded camera.")
@click.option("--outside", is_flag=True, help="Film the robot from outside, beside its camera image.")
@json_option
def command(
    root: Place, episode: str, out: Path | None, columns: int, rig: str | None, outside: bool, as_json: bool
) -> None:
    """Write one episode as a contact sheet or a video.

    EPISODE is a name or number: ep_000001 or 1. A .png file is a contact sheet. An .mp4, .gif or .webp file is a
    real-time video of colour, depth, instance ids and a map with the trajectory, with the instruction below. RIG is a
    built-in rig or a TOML file, see `factory rig list`. The sub-instructions of an episode with a route are printed
    with their frames.
    """
    from factory.dataset.bundle import EpisodeBundle
    from factory.dataset.episode_names import episode_path
    from factory.dataset.steps import read_instruction, read_steps
    from factory.runs.scene_packages import find_package
    from factory.support.terminal import print_json
    from factory.visualize.film import draw_film, require_mp4, save_film
    from factory.visualize.outside import draw_outside_film
    from factory.visualize.panels import draw_contact_sheet
    from factory.visualize.rig_sheet import draw_rig_sheet
    from schemas.rig.rig_file import load_rig
    from schemas.scene import read_geometry
    from schemas.storage.disk import translated
    from workers.render.choose import open_renderer

    path = episode_path(root, episode)
    target = out or Path(f"{path.stem}.png")
    kind = _kind_of(target, rig, outside)
    if kind == ".mp4":
        require_mp4()
    with path.open("rb") as file, EpisodeBundle(file, root) as bundle:
        job, bundle.name = bundle.meta.job, path.stem
        scene = read_geometry(find_package(root, job.scene, job.scene_sha256).path)
        with translated("create", target.parent):
            target.parent.mkdir(parents=True, exist_ok=True)
        facts: dict[str, object] = {
            "file": str(target),
            "kind": kind[1:],
            "episode": bundle.episode_id,
            "frames": bundle.length,
        }
        steps, instruction = read_steps(root, path.stem), read_instruction(root, path.stem)
        if steps:
            facts["steps"] = [{"text": each.text, "start": each.start, "end": each.end} for each in steps]
        if kind == ".png":
            sheet = (
                draw_contact_sheet(bundle, scene, columns, instruction)
                if rig is None
                else draw_rig_sheet(bundle, load_rig(rig, job.task.control_hz), columns)
            )
            with translated("write", target):
                sheet.save(target)
        elif outside:
            caption = instruction or bundle.meta.instruction
            with open_renderer("gl") as renderer:
                draw = functools.partial(draw_outside_film, bundle, scene, renderer, instruction=caption)
                facts["fps"] = float(save_film(target, bundle.length, job.task.control_hz, draw))
        else:
            draw = functools.partial(draw_film, bundle, scene, instruction=instruction)
            facts["fps"] = float(save_film(target, bundle.length, job.task.control_hz, draw))
    if as_json:
        print_json(facts | {"bytes": target.stat().st_size})
    else:
        click.echo(str(target))
        for each in steps:
            click.echo(f"{each.number}. frames {each.start} to {each.end - 1}: {each.text}")


def _kind_of(target: Path, rig: str | None, outside: bool) -> str:
    """Returns the suffix of the output file in lower case.

    Raises:
        UsageError: the suffix is not supported, or not supported with a rig or from outside.
    """
    kind = target.suffix.lower()
    if kind not in _KINDS:
        raise UsageError(
            f"-o {target}: {f'suffix {kind!r} is not supported' if kind else 'the suffix is missing'}; supported "
            f"suffixes: {', '.join(_KINDS)}"
        )
    if rig is not None and kind != ".png":
        raise UsageError(f"-o {target}: --rig draws a contact sheet: choose a file that ends in .png")
    if outside and kind == ".png":
        raise UsageError(f"-o {target}: --outside makes a film: choose a file that ends in .mp4, .gif or .webp")
    return kind
