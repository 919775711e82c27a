"""What a page holds, read by the standard library's parser, and that it needs nothing but itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser


@dataclass
class Page(HTMLParser):
    """Tags with their attributes in order, and the text between them."""

    tags: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len(dict(attrs)) == len(attrs), attrs
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def every(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def read(content: bytes) -> Page:
    page = Page()
    page.feed(content.decode("utf-8"))
    page.close()
    return page


def check_self_contained(page: Page, links: int = 0) -> None:
    """Asserts that pictures have texts, that nothing is fetched, that names are unique, and no script hides in one."""
    for attributes in page.every("img"):
        assert attributes.get("alt"), attributes
        assert (attributes["src"] or "").startswith("data:image/")
    for _, attributes in page.tags:
        assert not [name for name in attributes if name.startswith("on") or name == "style"]
    addresses = [str(value) for _, found in page.tags for key, value in found.items() if key in ("src", "href")]
    outside = [value for value in addresses if not value.startswith("data:")]
    assert len(outside) == links
    assert not [value for value in outside if ":" in value or value.startswith("/")]
    names = [str(found["id"]) for _, found in page.tags if "id" in found]
    assert len(set(names)) == len(names)
    assert len(page.every("script")) == 1
    assert len(page.every("h1")) == len(page.every("title")) == 1
    assert page.every("html") == [{"lang": "en"}]
    described = {str(found[key]) for _, found in page.tags for key in ("for", "aria-labelledby") if key in found}
    assert described <= set(names)
