"""Draws docs/images/left_over.svg and milling_force.svg: what an observer leaves over, and a turn of a tool.

python docs/draw_left_over.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("svg")
import numpy as np

import feeddrive as fd
from feeddrive.papers.beltran2013 import mill
from feeddrive.plot import curves as draw

IMAGES = Path(__file__).parent / "images"
STATES = (1, 3, 5)


def left_over() -> Any:
    """|1 - H| of the continuous observer, and as sine forces in the running loop show it."""
    frequency = np.geomspace(3.0, 500.0, 300)
    sines = np.array([10.0, 20.0, 40.0, 60.0, 90.0, 144.0, 240.0])
    names = {n: f"{n} Taylor state{'s' if n > 1 else ''}" for n in STATES}
    curves = {name: (frequency, np.abs(mill.left_over(mill.observer_of(n), frequency))) for n, name in names.items()}
    marks = {name: (sines, np.array([abs(mill.sine_test(f, n)[0]) for f in sines])) for n, name in names.items()}
    return draw.left_over(curves, marks, "part of the disturbance that is left", (60.0, "teeth pass"))


def turn() -> Any:
    """Three forces over a turn of the spindle, in a slot."""
    angle: Any = np.linspace(0.0, 2.0 * np.pi, 361)
    feed, normal, axial = fd.blocks.HelicalCutter.beltran2013().forces(angle, 5e-5)
    named = {"along the feed": np.asarray(feed), "normal": np.asarray(normal), "axial": np.asarray(axial)}
    return draw.turn(angle, named)


if __name__ == "__main__":
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "feeddrive"}):
        left_over().savefig(IMAGES / "left_over.svg", metadata={"Date": None})
        turn().savefig(IMAGES / "milling_force.svg", metadata={"Date": None})
