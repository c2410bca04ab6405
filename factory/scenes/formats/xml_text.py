"""Parses XML of scenes without entities and external references, and with a limit of depth.

Repairs two faults that the parsers of the simulators (tinyxml) accept: a bare `&`, and a prefix that is not declared.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import defusedxml.ElementTree
from defusedxml import DefusedXmlException

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_DEEPEST = 200
_BARE = re.compile(rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|&(?!(?:amp|lt|gt|quot|apos|#\d+|#x[0-9A-Fa-f]+);)", re.DOTALL)
_PREFIX = re.compile(rb"[<\s]([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*")
_ROOT = re.compile(rb"<(?![!?])[^\s/>]+")


def parse_xml(data: bytes, notes: list[str] | None = None) -> Element:
    """Returns the root element.

    Args:
        data: text of the file.
        notes: receives a note for each kind of repair; `None` repairs nothing.

    Raises:
        ValueError: the text is not XML, contains entities, or is nested too deeply.
    """
    try:
        try:
            root: Element = defusedxml.ElementTree.fromstring(data)
        except SyntaxError:
            if notes is None or b"<!DOCTYPE" in data:
                raise
            root = defusedxml.ElementTree.fromstring(_repaired(data, notes))
    except DefusedXmlException as error:
        raise ValueError(f"it declares XML entities or external references, which are not read ({error})") from error
    except (SyntaxError, LookupError) as error:  # ParseError is a SyntaxError; LookupError is an unknown encoding
        raise ValueError(f"it is not valid XML: {error}") from error
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > _DEEPEST:
            raise ValueError(f"its elements are nested more than {_DEEPEST} deep")
    return root


def _repaired(data: bytes, notes: list[str]) -> bytes:
    """Returns the text with bare `&` as text, and with a declaration for each prefix that has none."""
    bare = sum(found[0] == b"&" for found in _BARE.finditer(data))
    if bare:
        data = _BARE.sub(lambda found: b"&amp;" if found[0] == b"&" else found[0], data)
        notes.append(f"{bare} bare & read as text")
    prefixes = dict.fromkeys(found[1] for found in _PREFIX.finditer(data))
    unknown = [name for name in prefixes if name not in (b"xml", b"xmlns") and b"xmlns:" + name not in data]
    if unknown:
        declared = b"".join(b' xmlns:%s="%s"' % (name, name) for name in unknown)
        data = _ROOT.sub(lambda found: found[0] + declared, data, count=1)
        notes.append(f"prefixes without declaration: {', '.join(name.decode() for name in unknown)}")
    return data


def text_of(element: Element, tag: str, default: str = "") -> str:
    """Returns the text of a child without spaces around it."""
    return (element.findtext(tag) or default).strip()
