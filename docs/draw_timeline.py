"""Draws docs/images/timeline.svg: three samples of the loop, with 1.3 samples of dead time and two substeps.

python docs/draw_timeline.py
"""

from __future__ import annotations

from pathlib import Path

TARGET = Path(__file__).parent / "images" / "timeline.svg"

LEFT, SAMPLE, COUNT = 150.0, 190.0, 4  # px; samples k-1 .. k+2
DEAD = 1.3  # samples
COMMANDS = (0.2, 0.9, 0.35, 0.7)  # of the samples k-1 .. k+2, shares of a row's height
ROWS = {"position": 60.0, "command": 150.0, "acting force": 240.0, "substeps": 320.0}
HEIGHT, WIDTH = 400.0, LEFT + COUNT * SAMPLE + 30.0
BLUE, RED, GREY, INK = "#1f5fa8", "#b8341b", "#8a8f98", "#22262b"


def at(sample: float) -> float:
    """Place of a time in samples after k - 1."""
    return LEFT + sample * SAMPLE


def line(x1: float, y1: float, x2: float, y2: float, color: str, width: float = 1.5, dash: str = "") -> str:
    """One straight line."""
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{color}" stroke-width="{width}"{dashed}/>'


def text(x: float, y: float, words: str, color: str = INK, anchor: str = "middle", size: int = 13) -> str:
    """One line of text."""
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" font-size="{size}" text-anchor="{anchor}">{words}</text>'


def drawing() -> str:
    """The whole picture."""
    parts = [f'<rect width="{WIDTH:.0f}" height="{HEIGHT:.0f}" fill="#ffffff" rx="6"/>']
    for sample, name in enumerate(("(k-1)T", "kT", "(k+1)T", "(k+2)T")):
        parts.append(line(at(sample), 26, at(sample), ROWS["substeps"] + 18, GREY, 1, "3 4"))
        parts.append(text(at(sample), 18, name))
    for name, y in ROWS.items():
        parts.append(text(LEFT - 16, y + 4, name, anchor="end"))
    parts += _position() + _command() + _acting() + _substeps()
    parts.append(
        text(at(0), HEIGHT - 18, "Row k of a record: what holds at t = kT, and the forces from kT on.", GREY, "start")
    )
    body = "\n".join(parts)
    size = f'viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="{WIDTH:.0f}" height="{HEIGHT:.0f}"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" role="img" '
        f'aria-label="Timeline of one sample">\n{body}\n</svg>\n'
    )


def _position() -> list[str]:
    y = ROWS["position"]
    curve = (
        f"M {at(0):.1f} {y + 24:.1f} C {at(1.2):.1f} {y + 22:.1f}, {at(1.8):.1f} {y - 16:.1f}, {at(4):.1f} {y - 18:.1f}"
    )
    parts = [f'<path d="{curve}" fill="none" stroke="{INK}" stroke-width="1.5"/>']
    for sample, height in enumerate((24.0, 12.6, -4.9, -14.0)):
        parts.append(f'<circle cx="{at(sample):.1f}" cy="{y + height:.1f}" r="5" fill="{BLUE}"/>')
    parts.append(text(at(1) + 10, y + 30, "encoders read", BLUE, "start"))
    return parts


def _command() -> list[str]:
    y = ROWS["command"]
    parts = []
    for sample, share in enumerate(COMMANDS):
        top = y + 24 - 44 * share
        parts.append(line(at(sample), y + 24, at(sample), top, BLUE, 3))
        parts.append(text(at(sample) + 8, top + 5, ("u(k-1)", "u(k)", "u(k+1)", "u(k+2)")[sample], BLUE, "start"))
    return parts


def _acting() -> list[str]:
    y = ROWS["acting force"]
    level = [y + 24 - 44 * share for share in COMMANDS]
    first = y + 24
    parts = [line(at(0), first, at(DEAD), first, RED, 2.5)]
    for i in range(2):
        start = i + DEAD
        before = first if i == 0 else level[i - 1]
        parts.append(line(at(start), before, at(start), level[i], RED, 2.5))
        parts.append(line(at(start), level[i], at(start + 1), level[i], RED, 2.5))
        parts.append(text(at(start + 0.5), level[i] - 7, ("u(k-1)", "u(k)")[i], RED))
    end = 2 + DEAD
    parts.append(line(at(end), level[1], at(end), level[2], RED, 2.5))
    parts.append(line(at(end), level[2], at(COUNT), level[2], RED, 2.5))
    low = y + 40
    parts.append(line(at(1), low, at(1 + DEAD), low, INK, 1))
    parts.append(line(at(1), low - 4, at(1), low + 4, INK, 1))
    parts.append(line(at(1 + DEAD), low - 4, at(1 + DEAD), low + 4, INK, 1))
    parts.append(text(at(1 + DEAD / 2), low + 15, "dead time of u(k)"))
    return parts


def _substeps() -> list[str]:
    y = ROWS["substeps"]
    parts = [line(at(0), y, at(COUNT), y, INK, 1.5)]
    parts += [line(at(half / 2), y - 6, at(half / 2), y + 6, INK, 1.5) for half in range(2 * COUNT + 1)]
    parts.append(line(at(1 + DEAD), y - 12, at(1 + DEAD), y + 12, RED, 2))
    parts.append(text(at(1 + DEAD), y + 28, "old and new column", RED))
    parts.append(text(at(0.25), y + 28, "exact hold", INK))
    return parts


if __name__ == "__main__":
    TARGET.parent.mkdir(exist_ok=True)
    TARGET.write_text(drawing(), encoding="utf-8")
