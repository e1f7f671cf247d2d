"""Draws docs/images/dadsc.svg, recovery.svg and modes.svg: the pictures of three law pages, from the paper's runs.

python docs/draw_recovery.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from feeddrive import plot
from feeddrive.analysis.replay import observe
from feeddrive.analysis.stiffness import stiffness
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.loop.linearize import compliance
from feeddrive.loop.simulate import simulate
from feeddrive.papers.altintas2009.recovery import OBSERVERS, OWN, adaptation, compensated, tool_error
from feeddrive.papers.altintas2009.testbed import REST, T, cascade, dadsc, loop, milling
from feeddrive.plot.curves import Row, curves

IMAGES = Path(__file__).parent / "images"
FREQUENCY = np.geomspace(0.1, 1000.0, 200)


def laws() -> Any:
    """Dynamic stiffness of DADSC and cascade at equal velocity gain."""
    named = {"DADSC": dadsc(300.0), "P-PI cascade": cascade(300.0)}
    return plot.stiffness({name: stiffness(compliance(loop(law), FREQUENCY)) for name, law in named.items()})


def recovery() -> Any:
    """Estimates of a milling force."""
    run = simulate(loop(dadsc(300.0), resolution=1e-8), REST, load=milling(0.4), duration=0.4)
    seen = {OWN: adaptation(dadsc(300.0), run)}
    for name in ("recovery, 500 Hz", "Kalman"):
        seen[name] = observe(OBSERVERS[name], run["reading_load"], run["force"], T)
    return plot.disturbance(seen, run["load_force"], (0.3, 0.312))


def modes() -> Any:
    """Error at the tool without and with compensation."""
    sine = SineForce(amplitude=100.0, frequency=35.0)
    named = {
        "no compensation (µm)": tool_error(600.0, (), sine),
        "compensated, with lead (µm)": tool_error(600.0, compensated(), sine),
    }
    part = slice(0, round(0.4 / T), 20)
    time = 1e3 * T * np.arange(round(0.4 / T))[::20]
    return curves("time (ms)", time, [Row(name, {name: 1e6 * error[part]}) for name, error in named.items()])


if __name__ == "__main__":
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "feeddrive"}
    for name, figure in (("dadsc", laws()), ("recovery", recovery()), ("modes", modes())):
        figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None})
