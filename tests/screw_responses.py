"""Responses of one ball screw by its own mechanics, with noise."""

from __future__ import annotations

import numpy as np

from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.identification.response.plant_response import Asked, PlantResponse
from feeddrive.loop.frequency_response import FRF

SCREW = TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)
F = np.linspace(5.0, 250.0, 246)


def responses(plant, frequency=F, noise=0.0, seed=0, late=0.0, variance=False) -> tuple[FRF, FRF]:
    """Motor and load in m/N with relative complex noise of a standard deviation, by the mechanics themselves."""
    random = np.random.default_rng(seed)
    asked = [Asked(frequency, sensor) for sensor in ("motor", "load")]
    found = []
    for sensor, (exact, _) in zip(
        ("motor", "load"), PlantResponse(plant, [], asked, {"dead_time": late})(np.array([])), strict=True
    ):
        rough = random.standard_normal((2, frequency.size)) * noise / np.sqrt(2.0)
        known = (noise * np.abs(exact)) ** 2 if variance else None
        found.append(FRF(frequency, exact * (1.0 + rough[0] + 1j * rough[1]), "force", sensor, "m/N", variance=known))
    return found[0], found[1]
