"""Pages taken apart: what a person reads, what a page refers to, the pictures inside."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from urllib.parse import unquote_to_bytes
from xml.etree import ElementTree

VOID = {"meta", "img", "br"}
NAMESPACES = ("http://www.w3.org/", "http://purl.org/", "http://creativecommons.org/")
"""Names in SVG that nothing loads."""


class Parsed(HTMLParser):
    """A page taken apart; raises where a tag is closed that is not open."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag; one that has an end waits for it."""
        self.seen.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """The innermost open tag is the one that ends."""
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Note text, but for the style."""
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        """What a person reads."""
        return " ".join(" ".join(self.words).split())

    def attributes(self, name: str) -> list[str]:
        """All values of an attribute."""
        return [value for _, attrs in self.seen if (value := attrs.get(name)) is not None]

    @property
    def pictures(self) -> list[bytes]:
        """The figures, decoded."""
        return [unquote_to_bytes(source.partition(",")[2]) for source in self.attributes("src")]


def loads_nothing(page: str) -> Parsed:
    """The page taken apart: whole, each section led to, no script, no address but of what is inside."""
    parsed = Parsed(page)
    assert parsed.open == []
    assert parsed.attributes("href") == [f"#{name}" for name in parsed.attributes("id")]
    assert all(source.startswith("data:image/svg+xml,") for source in parsed.attributes("src"))
    assert {"script", "link"}.isdisjoint(tag for tag, _ in parsed.seen)
    own = re.sub(r'src="[^"]*"', "", page)
    assert "http" not in own
    assert "url(" not in own
    return parsed


def picture_loads_nothing(picture: bytes) -> None:
    """Well-formed SVG; what it refers to is within it."""
    root = ElementTree.fromstring(picture)  # noqa: S314  # made by ourselves a moment ago
    for element in root.iter():
        for name, value in element.attrib.items():
            if name.endswith("href"):
                assert value.startswith(("#", "data:image/png;base64,"))
    text = picture.decode()
    assert all(address.startswith(NAMESPACES) for address in re.findall(r"https?://[^\s\"'<]*", text))
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))
