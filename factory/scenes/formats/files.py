"""Reads the files of a scene that is not USD: within its folder and the folders of models, up to a size.

Collects missing files, so one error names all. Does not parse files.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from factory.scenes.formats.xml_text import parse_xml
from factory.scenes.importer.assets import ReadableFolder, read_asset
from factory.scenes.importer.collect import Collector
from factory.scenes.importer.content import Part, Surface
from schemas.errors import WorldError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_TEXTURES = Path("materials", "textures")
_OUTSIDE = "files outside of the scene's folder (move them below it, or allow them with --allow-outside)"


@dataclass
class SceneFiles:
    """Files of one import."""

    root: Path
    scene: Collector
    """Scene that is read; has the limits, and receives notes."""
    digests: dict[str, str] = field(default_factory=dict)
    """SHA-256 of each file that was read, by its path relative to the folder of the root file."""
    images: dict[str, bytes] = field(default_factory=dict)
    """Encoded images inside other files, by name."""
    _faults: dict[str, dict[str, str]] = field(default_factory=dict)
    """Reason -> unusable reference -> first node that uses it."""

    @property
    def readable(self) -> ReadableFolder:
        """Folders from which files may be read."""
        return ReadableFolder(self.root, self.scene.limits.allow_outside, self.scene.limits.models)

    def read(self, path: Path) -> bytes:
        """Returns the content of a file.

        Raises:
            ValueError: the file is missing and `skip_missing` is set, so the caller can skip it.
            WorldError: the file is missing and `skip_missing` is not set, or it is outside of the folders or too large.
        """
        if not self.is_usable(path, self.root.name):
            self.require_all()
            raise ValueError(f"{path.name} is missing")
        limit = self.scene.limits.max_file_mb * 1_000_000
        size = path.stat().st_size
        if size > limit:
            raise WorldError(
                f"{path.name} has {size / 1e6:.0f} MB; the limit of one file is {self.scene.limits.max_file_mb} MB; "
                "reduce its meshes and textures, or raise --max-file-mb if memory allows"
            )
        data = path.read_bytes()
        self.digests[self.shown(path)] = hashlib.sha256(data).hexdigest()
        return data

    def read_xml(self, path: Path) -> Element:
        """Returns the root element of an XML file; a fault that simulators accept is repaired with a note.

        Raises:
            ValueError: the file is not valid; the message names it, unless it is the root file. For others, see `read`.
        """
        data, repairs = self.read(path), list[str]()
        try:
            root = parse_xml(data, repairs)
        except ValueError as error:
            raise ValueError(f"{error}" if path == self.root else f"{self.shown(path)}: {error}") from error
        self.scene.notes += [f"{self.shown(path)}: {repair}" for repair in repairs]
        return root

    def is_usable(self, path: Path, user: str) -> bool:
        """Returns whether a file exists inside the folders. If not, `require_all` raises an error that names it."""
        if path != self.root and not self.readable.encloses(str(path)):
            self.add_fault(_OUTSIDE, path, user)
        elif not path.is_file():
            reason = "files missing beside the file that names them and in the folders of --model-dir DIR"
            self.add_fault(reason, path, user)
        else:
            return True
        return False

    def add_fault(self, reason: str, reference: Path | str, user: str) -> None:
        """Records a reference that cannot be used."""
        seen = self.shown(reference) if isinstance(reference, Path) else reference
        self._faults.setdefault(reason, {}).setdefault(seen, user)

    def require_all(self, may_skip: bool = True) -> None:
        """Checks that all references can be used. With `may_skip` and --skip-missing, a missing file only adds a note.

        Raises:
            WorldError: some references cannot be used; the message names all of them.
        """
        # missing files are skipped on request only: the robot would drive through a missing wall
        for reason in self._faults.keys() - {_OUTSIDE} if may_skip and self.scene.limits.skip_missing else ():
            lost = self._faults.pop(reason)
            self.scene.notes += [f"{user}: {name} is missing, skipped" for name, user in lost.items()]
        if self._faults:
            listed = {
                reason: ", ".join(f"{name} (of {user})" for name, user in names.items())
                for reason, names in self._faults.items()
            }
            lines = "; ".join(f"{reason}: {names}" for reason, names in listed.items())
            remedy = (
                "" if not may_skip or self._faults.keys() == {_OUTSIDE} else "; import without them with --skip-missing"
            )
            raise WorldError(f"{self.root.name} refers to files that cannot be read; {lines}{remedy}")

    def textured(self, surface: Surface, folder: Path, reference: str, user: str) -> Surface:
        """Returns a surface with a texture. If its file is outside of the folders, omits the texture and adds a note.

        Args:
            surface: appearance without texture.
            folder: folder to which the reference is relative.
            reference: path or URI of the image, as authored.
            user: node that uses the texture, for the note.
        """
        place = self.find_texture(folder, reference)
        return self.readable.kept_inside(replace(surface, texture=str(place)), user, self.scene.notes)

    def find_texture(self, folder: Path, reference: str) -> Path:
        """Returns the path of a texture, which may not exist; `folder` as for `textured`.

        If there is no such file, a file of its name is searched where Gazebo searches the textures of a model: beside
        the file that names it, and in `materials/textures` of its folder and of the two above.
        """
        place = place_of(folder, reference)
        if place.is_file() or not place.name:
            return place
        models = (folder, folder.parent, folder.parent.parent)
        others = (folder / place.name, *(model / _TEXTURES / place.name for model in models))
        absolute = (place_of(other, "") for other in others)
        return next((other for other in absolute if other.is_file() and self.readable.encloses(str(other))), place)

    def digests_with_textures(self, parts: list[Part]) -> dict[str, str]:
        """Returns the digests of all files, with those of the textures of parts."""
        names = frozenset().union(*(part.surface.images for part in parts)) - self.images.keys()
        shas = {self.shown(Path(name)): hashlib.sha256(read_asset(name) or b"").hexdigest() for name in names}
        return self.digests | shas

    def shown(self, path: Path) -> str:
        """Returns the path of a file relative to the folder of the root file, for messages."""
        return os.path.relpath(path, self.root.parent)


def place_of(folder: Path, reference: str) -> Path:
    """Returns the absolute path of a reference: a relative path, or a URI without scheme or with `file://`."""
    plain = unquote(reference.removeprefix("file://")).replace("\\", "/")
    return Path(os.path.normpath(Path.cwd() / folder / plain))  # absolute, because `read_asset` reads no relative path
