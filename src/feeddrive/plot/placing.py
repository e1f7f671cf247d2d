"""Widths of texts on a page whose font is not known, and places of labels where they cover least."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

Extent: TypeAlias = tuple[float, float, float, float]
"""A rectangle in points: left, low, right, high."""

# widths of characters in em, those of DejaVu Sans rounded up: the fonts of other systems are narrower
_CLASSES = {
    0.32: " ,.IJijl'·",
    0.40: "/:;\\f|()-[]t²³⁰¹⁴⁵⁶⁷⁸⁹",
    0.52: '!r"*_`°⁻',
    0.60: "?LcszFkvxy",
    0.64: "$0123456789EPSTYabdeghnopqu{}µσΔ€",
    0.76: "KABCRVXZHNU",
    0.84: "&DGOQ#+<=>^w~\u2212×≤≥",
    1.00: "%M@Wm…—",
}
_WIDTHS = {character: width for width, characters in _CLASSES.items() for character in characters}
_OTHER, _WIDE = 0.72, 1.0  # em: other letters; those of East Asian scripts and symbols
LINE = 1.25  # em: distance of lines

_SPOTS = tuple(
    (reach * dx, reach * dy)
    for reach in (1.0, 1.9, 2.9, 4.0)
    for dx, dy in ((1, 0), (-1, 0), (0.7, 0.8), (-0.7, 0.8), (0.7, -0.8), (-0.7, -0.8), (0, 1), (0, -1))
)  # possible label positions, in steps of 9 points right and up
STEP = 9.0  # points


def width(text: str, size: float) -> float:
    """Return the width of a text in points at a font size in points; of several lines that of the widest."""
    return size * max(sum(map(_width, line)) for line in text.split("\n"))


def _width(character: str) -> float:
    if (known := _WIDTHS.get(character)) is not None:
        return known
    return _OTHER if character < "\u2e80" else _WIDE


def wrapped(text: str, size: float, room: float) -> str:
    """Break a text into lines no wider than `room` points, between words; a longer word keeps its line."""
    lines = list[str]()
    for paragraph in text.split("\n"):
        line = ""
        for word in paragraph.split(" "):
            longer = f"{line} {word}" if line else word
            if line and width(longer, size) > room:
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
    return "\n".join(lines)


def free_spot(
    place: tuple[float, float], size: tuple[float, float], taken: Sequence[Extent], edge: Sequence[float]
) -> Extent:
    """Return the label box of a size near a point that overlaps least with other boxes and the edge, preferably a
    close one. y points up.
    """
    (px, py), (wide, tall) = place, size
    best: tuple[float, Extent] | None = None
    for i, (dx, dy) in enumerate(_SPOTS):
        left = px + STEP * dx - wide * (0.0 if dx > 0 else 1.0 if dx < 0 else 0.5)
        low = py + STEP * dy - 0.5 * tall
        box = (left, low, left + wide, low + tall)
        # leaving the axes is worse than covering a label; the index lets the closest of equal positions win
        cost = sum(shared(box, other) for other in taken) + 20.0 * outside(box, edge) + 3.0 * i
        if best is None or cost < best[0]:
            best = cost, box
    assert best is not None
    return best[1]


def outside(box: Extent, edge: Sequence[float]) -> float:
    """Return how far a box reaches over an edge, summed over its sides."""
    beyond = edge[0] - box[0], box[2] - edge[2], edge[1] - box[1], box[3] - edge[3]
    return sum(max(length, 0.0) for length in beyond)


def shared(a: Extent, b: Extent) -> float:
    """Return the area of the overlap of two boxes."""
    return max(min(a[2], b[2]) - max(a[0], b[0]), 0.0) * max(min(a[3], b[3]) - max(a[1], b[1]), 0.0)
