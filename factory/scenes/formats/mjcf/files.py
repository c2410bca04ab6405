"""Checks the files that an MJCF model names, with those of its includes, before MuJoCo opens them.

Finds the files where MuJoCo does: relative to the main file, in the folders of `<compiler>`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from factory.scenes.formats.files import SceneFiles, place_of
from factory.scenes.formats.xml_text import parse_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_FOLDER_OF = {"mesh": "meshdir", "skin": "meshdir", "hfield": "assetdir", "texture": "texturedir"}
_MOST_FILES = 20_000


def require_files(path: Path, files: SceneFiles) -> None:
    """Reads an MJCF file with its includes, and checks that its assets are inside the folders of the import.

    Args:
        path: main file.
        files: files of the import; receives the digests.

    Raises:
        ValueError: a file is malformed, contains entities or includes itself.
        WorldError: files are missing, outside of the folders, or too large; the message names all.
    """
    elements: list[Element] = []
    _collect(path, path.parent, files, elements, ())
    folders = {"assetdir": "", "strippath": "false"}
    for element in elements:
        if element.tag == "compiler":
            folders |= element.attrib
    for element in elements:
        for key, value in element.attrib.items():
            if key.startswith("file") and element.tag not in ("include", "mujoco") and value:
                folder = folders.get(_FOLDER_OF.get(element.tag, ""), folders["assetdir"])
                name = Path(value).name if folders["strippath"] == "true" else value
                place = place_of(path.parent, str(Path(folder) / name))
                if files.is_usable(place, f"{element.tag} {element.get('name', '')}".strip()):
                    files.read(place)
    files.require_all(may_skip=False)


def _collect(path: Path, folder: Path, files: SceneFiles, found: list[Element], above: tuple[Path, ...]) -> None:
    """Adds the elements of a file and of its includes."""
    if path in above:
        raise ValueError(f"{path.name} includes itself")
    if len(above) > 50 or len(files.digests) > _MOST_FILES:
        raise ValueError("its includes are nested too deeply")
    root = parse_xml(files.read(path))
    found += list(root.iter())
    for include in root.iter("include"):
        place = place_of(folder, str(include.get("file") or ""))
        if files.is_usable(place, path.name):
            _collect(place, folder, files, found, (*above, path))
