"""Draws the pictures of the pages on pole placement and on the prefilter, from the experiments of the paper.

python docs/draw_gordon2013.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

from feeddrive.papers.gordon2013 import frequency, motion
from feeddrive.plot.drawing import drawn

IMAGES = Path(__file__).parent / "images"
WANTED = {"stiffness": "pole-placement", "ablation": "ablation", "prefilter": "trajectory-prefilter"}


def draw() -> None:
    """Three of their pictures."""
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "feeddrive", "path.simplify_threshold": 0.3}
    for part in (frequency.loop_figures(), motion.ablation(), frequency.frequency_view()):
        for shown in part.pictures:
            if shown.key in WANTED:
                drawn(shown.chart()).savefig(IMAGES / f"{WANTED[shown.key]}.svg", metadata={"Date": None})


if __name__ == "__main__":
    draw()
