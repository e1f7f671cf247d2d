"""Responses of an axis by the closed form of its mechanics, with noise: an oracle that shares nothing with the fits."""

from __future__ import annotations

import numpy as np

from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.loop.frequency_response import FRF

SCREW = TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)
F = np.linspace(5.0, 250.0, 246)


def closed_form(plant: Plant, frequency: np.ndarray, late: float = 0.0, lag: float | None = None) -> list[np.ndarray]:
    """x/f = e^(-s late) / (1 + s/2πlag) · Sᵢ (M s² + C s + K)⁻¹ S_driveᵀ of both encoders; `late` in s, `lag` in Hz."""
    made = plant.mechanics()
    M, C, K, S = (np.array(each, float) for each in (made.mass, made.damping, made.stiffness, made.shape))
    s = 2j * np.pi * frequency
    line = s[:, None, None]
    moved = np.linalg.solve((line * M + C) * line + K, np.broadcast_to(S[made.drive], (s.size, len(M)))[:, :, None])
    factor = np.exp(-s * late) / (1.0 if lag is None else 1.0 + s / (2.0 * np.pi * lag))
    return [(moved[:, :, 0] @ S[row]) * factor for row in (made.motor, made.load)]


def responses(
    plant: Plant,
    frequency: np.ndarray = F,
    noise: float = 0.0,
    seed: int = 0,
    late: float = 0.0,
    variance: bool = False,
) -> tuple[FRF, FRF]:
    """Motor and load in m/N with relative complex noise of a standard deviation."""
    random = np.random.default_rng(seed)
    found = []
    for sensor, exact in zip(("motor", "load"), closed_form(plant, frequency, late), strict=True):
        rough = random.standard_normal((2, frequency.size)) * noise / np.sqrt(2.0)
        known = (noise * np.abs(exact)) ** 2 if variance else None
        found.append(FRF(frequency, exact * (1.0 + rough[0] + 1j * rough[1]), "force", sensor, "m/N", variance=known))
    return found[0], found[1]
