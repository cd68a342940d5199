"""Reading pages, for the tests of reports."""

import base64
from html.parser import HTMLParser

PNG = b"\x89PNG"


class Page(HTMLParser):
    """Collects links and text, and fails where tags do not match."""

    def __init__(self, markup: str):
        super().__init__()
        self.open, self.links, self.words = [], [], []
        self.feed(markup)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.links += [value for name, value in attributes if name in ("src", "href", "poster")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    @property
    def pictures(self) -> list[bytes]:
        """Those inside the page; everything else that it links to must lie beside it."""
        inside = [link for link in self.links if link.startswith("data:image/png;base64,")]
        assert all(link.startswith("films/") for link in self.links if link not in inside)
        return [base64.b64decode(link.removeprefix("data:image/png;base64,")) for link in inside]
