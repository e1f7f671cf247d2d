"""The force figure of the paper: one turn of the tool, its checks, and what the printed data would mean."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.papers.beltran2013.mill import CHIP, SPINDLE

# (feed, normal, axial) in N at angles in rad, from an independent program
GOLDEN = {
    0.0: (204.1755, 284.1650, 68.9547),
    0.5: (-17.8345, 59.4484, 36.7252),
    1.0: (-326.8796, 124.8485, 68.9547),
    2.0: (-250.7488, 674.0345, 143.4674),
    3.0: (216.9431, 376.2670, 86.0768),
}
PRINTED_CHIP = 1e-3  # m, as the paper's paragraph on the force has it


@dataclass(frozen=True, eq=False)
class Turn:
    """One turn of the spindle: angle in rad, three forces in N and the torque in N m, each of shape (n,)."""

    angle: np.ndarray
    feed: np.ndarray
    normal: np.ndarray
    axial: np.ndarray
    torque: np.ndarray

    @property
    def power(self) -> float:
        """Mean torque times speed, W."""
        return float(np.mean(self.torque)) * SPINDLE / 60.0 * 2.0 * np.pi


def turn(cutter: HelicalCutter, chip_load: float, points: int = 7200) -> Turn:
    """Closed form over a turn, at the middles of equal pieces: the mean is then that of a smooth periodic curve."""
    angle: Any = 2.0 * np.pi * (np.arange(points) + 0.5) / points
    feed, normal, axial = cutter.forces(angle, chip_load)
    return Turn(angle, *(np.asarray(each) for each in (feed, normal, axial, cutter.torque(angle, chip_load))))


def golden_error(cutter: HelicalCutter) -> float:
    """Largest difference in N from the five angles that were computed elsewhere."""
    return max(
        abs(float(got) - expected)
        for angle, row in GOLDEN.items()
        for got, expected in zip(cutter.forces(angle, CHIP), row, strict=True)
    )


def integrated(cutter: HelicalCutter, angle: float, chip_load: float, pieces: int = 20_000) -> np.ndarray:
    """The three forces in N of a tool in a slot, added up over thin slices of each edge."""
    height = (np.arange(pieces) + 0.5) / pieces * cutter.axial_depth
    total = np.zeros(3)
    for tooth in range(cutter.teeth):
        v = angle + 2.0 * np.pi * tooth / cutter.teeth - 2.0 * np.tan(cutter.helix_angle) / cutter.diameter * height
        chip = chip_load * np.maximum(np.sin(v), 0.0)
        tangential = cutter.specific_energy * chip * cutter.axial_depth / pieces
        radial = cutter.radial_ratio * tangential
        total += [
            -np.sum(tangential * np.cos(v) + radial * np.sin(v)),
            np.sum(tangential * np.sin(v) - radial * np.cos(v)),
            cutter.axial_ratio * np.sum(tangential),
        ]
    return total


def integration_error(cutter: HelicalCutter) -> float:
    """Largest difference in N of closed form and slices, at 24 angles."""
    angles = 2.0 * np.pi * np.arange(24) / 24.0 + 0.01
    off = [integrated(cutter, angle, CHIP) - np.array(cutter.forces(angle, CHIP)) for angle in angles]
    return float(np.max(np.abs(off)))


def removed_power(cutter: HelicalCutter, chip_load: float) -> float:
    """u_s times the volume removed per second in a slot, W."""
    feed = chip_load * cutter.teeth * SPINDLE / 60.0
    return cutter.specific_energy * feed * cutter.diameter * cutter.axial_depth


def as_printed() -> Turn:
    """With the data of the force paragraph taken literally."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it warns is the point of the preset
        return turn(HelicalCutter.beltran2013_as_printed(), PRINTED_CHIP)
