"""The picture of the benchmark: what each law wins and loses against P-PI, plant by plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from feeddrive.plot import style
from feeddrive.plot.picture import Picture


def scores(laws: Sequence[str], panels: Mapping[str, Sequence[tuple[Sequence[float], float | None]]]) -> Any:
    """A panel a figure and a line a law: a small dot for each plant, a large one for the geometric mean.

    panels  by headline, for each law its ratios to P-PI and their mean
    """
    figure = Picture(figsize=(style.WIDTH, 1.0 + 0.2 * len(laws)), layout="constrained", facecolor=style.PAPER)
    for ax, (head, rows) in zip(figure.subplots(1, len(panels), sharey=True), panels.items(), strict=True):
        for place, (ratios, mean) in enumerate(reversed(rows)):
            ax.plot(ratios, [place] * len(ratios), ".", color=style.MUTED, markersize=3.0)
            if mean:
                ax.plot(mean, place, "o", color=style.color(0), markersize=4.5)
        ax.axvline(1.0, color=style.INK, linewidth=0.8)
        ax.set_xscale("log")
        ax.set_title(head, fontsize=style.TEXT)
        ax.set_yticks(range(len(laws)), laws[::-1])
        ax.grid(True, axis="x", color=style.GRID, linewidth=0.6)
        ax.tick_params(labelsize=style.SMALL, length=0)
        ax.tick_params(axis="x", which="minor", labelbottom=False)
        for side in ("top", "right", "left"):
            ax.spines[side].set_visible(False)
    return figure
