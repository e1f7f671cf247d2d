"""Links in the built site that lead nowhere: a hook of mkdocs, and `python docs/check_links.py site` by itself.

mkdocs looks at the sources and says nothing of a link to a file that it leaves out of the site, nor of links that
themes and generated pages make.  This reads every page that was written: each link must name a file that was written,
and each anchor an element that the page has.
"""

from __future__ import annotations

import logging
import os
import re
import sys
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

OUTSIDE = ("https", "mailto", "data", "javascript")

# Patterns and not a parser, which takes a quarter of the time of the whole build for the navigation of a hundred pages.
SILENT = re.compile(r"<!--.*?-->|(?<=<script)>.*?(?=</script)|(?<=<style)>.*?(?=</style)", re.DOTALL)
TAG = re.compile(r"""<[a-zA-Z](?:[^>"']|"[^"]*"|'[^']*')*>""")
ATTRIBUTE = re.compile(r"""\s(id|name|href|src)=["']?((?<=")[^"]*|(?<=')[^']*|[^\s"'>]*)""")


class Page:
    """The links of a page, and the names of its elements."""

    def __init__(self, text: str) -> None:
        tags = "".join(TAG.findall(SILENT.sub("", text)))
        found = [(name, unescape(value)) for name, value in ATTRIBUTE.findall(tags)]
        self.links = [value for name, value in found if name in ("href", "src") and value]
        self.names = {value for name, value in found if name in ("id", "name") and value}


def dead_links(site: Path) -> Iterator[str]:
    """Page and link of each that leads nowhere; the page that a server shows for a missing address is left out."""
    site = site.resolve()
    files = {str(file) for file in site.rglob("*") if file.is_file()}
    texts = {name: Path(name).read_text(encoding="utf-8") for name in files if name.endswith(".html")}
    pages = {name: Page(text) for name, text in texts.items() if Path(name).name != "404.html"}
    for file, page in sorted(pages.items()):
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            if parts.scheme in OUTSIDE:
                continue
            target = os.path.normpath(os.path.join(os.path.dirname(file), unquote(parts.path))) if parts.path else file
            target = target if target in files else os.path.join(target, "index.html")
            if parts.scheme or parts.netloc or target not in files:
                yield f"{os.path.relpath(file, site)}: {link} leads nowhere"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].names:
                there = os.path.relpath(target, site)
                yield f"{os.path.relpath(file, site)}: {link} leads to a place that {there} does not have"


def on_post_build(config: Any) -> None:
    """A warning for each; with `strict` the build fails."""
    for each in dead_links(Path(config.site_dir)):
        logging.getLogger("mkdocs.hooks.check_links").warning(each)


if __name__ == "__main__":
    found = list(dead_links(Path(sys.argv[1])))
    sys.stdout.write("".join(f"{each}\n" for each in found))
    sys.exit(bool(found))
