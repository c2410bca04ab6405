"""Parses XML of scenes without entities and external references, and with a limit of depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import defusedxml.ElementTree
from defusedxml import DefusedXmlException

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_DEEPEST = 200


def parse_xml(data: bytes) -> Element:
    """Returns the root element.

    Raises:
        ValueError: the text is not XML, contains entities, or is nested too deeply.
    """
    try:
        root: Element = defusedxml.ElementTree.fromstring(data)
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


def text_of(element: Element, tag: str, default: str = "") -> str:
    """Returns the text of a child without spaces around it."""
    return (element.findtext(tag) or default).strip()
