"""Loads appearances: built-in ones by name, others from TOML files. Errors name the key of every mistake."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from schemas.appearance.factors import Appearance
from schemas.builtin import BUILTIN_APPEARANCES, NO_APPEARANCE
from schemas.errors import InvalidAppearance
from schemas.support.toml_file import find_toml, mistakes_of, read_toml

_FOLDER = Path(__file__).parent / "builtin"


def find_appearance(reference: str) -> Appearance | None:
    """Returns the result of `load_appearance`, or `None` for the name `none`."""
    return None if reference == NO_APPEARANCE else load_appearance(reference)


def load_appearance(reference: str) -> Appearance:
    """Returns a built-in appearance by its name, or reads a TOML file.

    Args:
        reference: name of a built-in appearance, or path of a file.

    Raises:
        UsageError: neither a built-in appearance nor a file has that name.
        InvalidAppearance: the file has mistakes; the error lists all of them.
    """
    path = find_toml(reference, "appearance", _FOLDER, BUILTIN_APPEARANCES)
    data = read_toml(path, "appearance", InvalidAppearance)
    data.setdefault("name", path.stem)
    try:
        return Appearance.model_validate(data)
    except ValidationError as error:
        raise InvalidAppearance(f"{path} is not a valid appearance", mistakes_of(error)) from error
