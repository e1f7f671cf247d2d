"""Draws docs/images/measured_margins.svg: the loop gain of a measured axis with all its margins.

The responses are those of the bundled ball screw with 2 % of noise.

python docs/draw_measured_margins.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

import feeddrive as fd

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """The picture."""
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "feeddrive"}
    loop = fd.read_machine("ball_screw").loop("x")
    lines = np.geomspace(3.0, 3000.0, 500)
    random = np.random.default_rng(4)

    def measured(reading: str) -> fd.FRF:
        true = fd.linearize(loop, ["cut"], [reading]).response(lines)
        a, b = random.standard_normal((2, lines.size)) * 0.02 * true.magnitude / np.sqrt(2.0)
        return true + fd.FRF(lines, a + 1j * b)

    found = fd.measured_loop(loop.control, float(loop.sample_time), measured("reading_load"), measured("reading_motor"))
    IMAGES.mkdir(exist_ok=True)
    found.plot().savefig(IMAGES / "measured_margins.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
