"""Links in the built site that lead nowhere: a hook of mkdocs, and `python docs/check_links.py site` by itself.

mkdocs looks at the sources and says nothing of a link to a file that it leaves out of the site, nor of links that
themes and generated pages make.  This reads every page that was written: each link must name a file that was written,
and each anchor an element that the page has.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

OUTSIDE = ("https", "mailto", "data", "javascript")


class Page(HTMLParser):
    """The links of a page, and the names of its elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.names: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect them."""
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.names.add(value)
            elif name in ("href", "src") and value:
                self.links.append(value)


def dead_links(site: Path) -> Iterator[str]:
    """Page and link of each that leads nowhere; the page that a server shows for a missing address is left out."""
    site = site.resolve()
    pages = {file: Page(file.read_text(encoding="utf-8")) for file in site.rglob("*.html") if file.name != "404.html"}
    for file, page in sorted(pages.items()):
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            if parts.scheme in OUTSIDE:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            target = target / "index.html" if target.is_dir() else target
            if parts.scheme or parts.netloc or not target.is_relative_to(site) or not target.is_file():
                yield f"{file.relative_to(site)}: {link} leads nowhere"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].names:
                yield f"{file.relative_to(site)}: {link} leads to a place that {target.relative_to(site)} does not have"


def on_post_build(config: Any) -> None:
    """A warning for each; with `strict` the build fails."""
    for each in dead_links(Path(config.site_dir)):
        logging.getLogger("mkdocs.hooks.check_links").warning(each)


if __name__ == "__main__":
    found = list(dead_links(Path(sys.argv[1])))
    sys.stdout.write("".join(f"{each}\n" for each in found))
    sys.exit(bool(found))
