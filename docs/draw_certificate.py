"""Draws docs/images/certificate.svg: the certified margin of the ball screw from noisy responses.

Run it in this directory: python draw_certificate.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import feeddrive as fd


def responses(loop: fd.Loop) -> list[fd.FRF]:
    """Of the encoders of load and motor, with 1 % of noise on each line."""
    f = np.arange(2.0, 2001.0)
    model = fd.linearize(loop, ["cut"], ["reading_motor", "reading_load"])
    random = np.random.default_rng(1)
    found: list[fd.FRF] = []
    for reading in ("reading_load", "reading_motor"):
        true = model.response(f, output=reading).response
        a, b = random.standard_normal((2, f.size))
        noise = 0.01 * np.abs(true) * (a + 1j * b) / np.sqrt(2.0)
        variance = (0.01 * np.abs(true)) ** 2
        found.append(fd.FRF(f, true + noise, "force", reading, "m/N", loop.sample_time, variance=variance))
    return found


def main() -> None:
    """Certify and draw."""
    loop = fd.read_machine("ball_screw").loop("x")
    found = fd.certificate.certify_loop(loop, {"measured": responses(loop)}, arithmetic="float32")
    print(found)
    found.plot().savefig(Path(__file__).parent / "images" / "certificate.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
