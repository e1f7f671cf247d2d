"""Draws docs/images/frequency_response.svg and excitation.svg: the measurement of the bundled ball screw, simulated.

Its encoders get 0.1 um of noise, so that there is something to see.

python docs/draw_frequency_response.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl

from feeddrive import plot
from feeddrive.files.machine import read_machine
from feeddrive.identification.excitation.excitation import design_excitation
from feeddrive.workflow.excite import rehearsed

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Both pictures."""
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "feeddrive"}
    loop = read_machine("ball_screw").loop(None)
    noisy = {name: replace(getattr(loop.axis, name), noise=1e-7) for name in ("encoder_motor", "encoder_load")}
    loop = replace(loop, axis=replace(loop.axis, **noisy))
    found = design_excitation(loop, band=(5.0, 500.0), amplitude=400.0)
    estimate, model = rehearsed(found)
    IMAGES.mkdir(exist_ok=True)
    pictures = {"frequency_response": plot.frequency_estimate(estimate, model), "excitation": found.plot()}
    for name, figure in pictures.items():
        figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
