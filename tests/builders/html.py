"""Parses HTML pages for tests."""

from __future__ import annotations

from html.parser import HTMLParser

_VOID = {"meta", "img", "br", "link", "input"}
_LINKS = {"href", "src", "poster", "xlink:href"}


class Outline(HTMLParser):
    """Parses a page; checks that its tags are balanced, and collects IDs, links, tags and attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[tuple[str, dict[str, str | None]]] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.table_parents: list[tuple[str, dict[str, str | None]]] = []
        """For each table, the `class` and all attributes of its parent element."""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.add(tag)
        self.attributes |= found.keys()
        self.ids += [found["id"]] if found.get("id") else []
        self.links += [value for key, value in attrs if value and key in _LINKS]
        if tag == "table":
            parent = self.open[-1][1]
            self.table_parents.append((parent.get("class") or "", parent))
        if tag not in _VOID:
            self.open.append((tag, found))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in _VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop()[0] == tag
