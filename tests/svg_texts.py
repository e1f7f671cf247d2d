"""The texts of a picture of a page with the rectangles that they cover, by the widths of a wide font."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import NamedTuple

from feeddrive.plot.placing import LINE, shared, width

SLACK = 1.0  # points²: rectangles touch by less than a hairline of a letter


class Written(NamedTuple):
    """A text with its rectangle: left, top, right, bottom; `over` if it may lie over curves; `turn` in degrees."""

    text: str
    box: tuple[float, float, float, float]
    over: bool
    turn: float


def tag(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def texts(picture: str) -> list[Written]:
    """All texts of an SVG element."""
    found = list[Written]()
    for element in ET.fromstring(picture).iter():
        if tag(element) != "text":
            continue
        lines = [element.text or "", *(line.text or "" for line in element)]
        x, y, size = (float(element.attrib[name]) for name in ("x", "y", "font-size"))
        wide = max(width(line, size) for line in lines)
        anchor = element.attrib.get("text-anchor", "start")
        left = {"start": 0.0, "middle": -0.5 * wide, "end": -wide}[anchor]
        # from the height of a capital to that of a descender
        up, down = -0.73 * size, 0.2 * size + LINE * size * (len(lines) - 1)
        turn = float(re.match(r"rotate\((-?[\d.]+)", element.attrib.get("transform", "rotate(0"))[1])  # type: ignore[index]
        box = x + left, y + up, x + left + wide, y + down
        if turn == -90.0:
            box = x + up, y - left - wide, x + down, y - left
        found.append(Written("\n".join(lines), box, "paint-order" in element.attrib, turn))
    return found


def overlapping(picture: str) -> list[tuple[str, str]]:
    """Pairs of texts of the layout that cover each other; those on curves and slanted ones are left out."""
    there = [written for written in texts(picture) if not written.over and written.turn in (0.0, -90.0)]
    return [
        (first.text, second.text)
        for i, first in enumerate(there)
        for second in there[:i]
        if shared(first.box, second.box) > SLACK
    ]


def outside(picture: str) -> list[str]:
    """Texts of the layout that leave the picture."""
    _, _, wide, tall = map(float, ET.fromstring(picture).attrib["viewBox"].split())
    there = [written for written in texts(picture) if written.turn in (0.0, -90.0) and not written.over]
    return [
        text for text, (left, top, right, bottom), _, _ in there if min(left, top, wide - right, tall - bottom) < -SLACK
    ]
