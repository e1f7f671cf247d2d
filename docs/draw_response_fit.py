"""Draws docs/images/response_fit.svg: two masses over the noisy responses of both encoders of an axis.

python docs/draw_response_fit.py
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
    plant = fd.blocks.TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0)
    control = fd.Control(law=fd.blocks.CascadePPI(Kv=1.0, Kp=1.0, Tn=1.0))
    loop = fd.Loop(control=control, axis=fd.Axis(plant=plant), sample_time=2e-4)
    model = fd.linearize(loop, ["cut"], ["position_motor", "position_load"], velocity=0.05)
    f = np.geomspace(5.0, 400.0, 80)
    random = np.random.default_rng(2)

    def measured(output: str) -> fd.FRF:
        exact = model.response(f, output=output).response
        size = 2e-10 + 0.02 * np.abs(exact)
        rough = size * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size)) / np.sqrt(2.0)
        name = output.replace("position_", "")
        return fd.FRF(f, exact + rough, "force", name, "m/N", sample_time=2e-4, variance=size**2)

    found = fd.identification.fit_two_mass(measured("position_motor"), measured("position_load"))
    IMAGES.mkdir(exist_ok=True)
    found.plot().savefig(IMAGES / "response_fit.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
