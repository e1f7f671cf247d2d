"""The gains of a P-PI cascade from a log of what it read and what it commanded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.identification.covariance import errors, ols_covariance, robust_covariance
from feeddrive.identification.estimate import NORMAL, Estimate, estimates_table
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.table import Result, Table

MOST_DELAY = 3  # samples between reading and command that are tried
MOST_SAMPLES = 8  # over which a velocity may be differenced
LARGEST = 0.05  # share of the force that a law may leave and still count as found
_START = 20  # samples that a difference over the past needs


@dataclass(frozen=True, eq=False, repr=False)
class ControlFit(Result):
    """A cascade that explains the logged force: Kv (1/s), Kp, velocity feedforward (1), and how they were found.

    delay      samples between the reading that the law used and the command
    residual   share of the force that the law leaves
    tried      (velocity samples, delay) -> residual
    """

    name: str
    estimates: tuple[Estimate, ...]
    velocity_samples: int
    delay: int
    residual: float
    tried: dict[tuple[int, int], float]

    def __getitem__(self, parameter: str) -> Estimate:
        return next(each for each in self.estimates if each.name == parameter)

    def table(self) -> Table:
        """Gains with their errors."""
        title = (
            f"{self.name}: P-PI cascade, velocity over {self.velocity_samples} samples, {self.delay} samples of delay; "
            f"{100.0 * self.residual:.3g} % of the force is left"
        )
        return estimates_table(title, self.estimates)

    def law(self) -> CascadePPI:
        """The cascade as a block; a feedforward that is 0 or 1 within its error is written as that."""
        share = self["velocity_feedforward"]
        near = next((whole for whole in (0.0, 1.0) if abs(share.value - whole) < max(0.01, NORMAL * share.error)), None)
        return CascadePPI(
            Kv=self["Kv"].value,
            Kp=self["Kp"].value,
            velocity_feedforward=max(0.0, share.value) if near is None else near,
            velocity_samples=self.velocity_samples,
        )


def identify_control(log: MotionLog) -> ControlFit:
    """The gains of the loop that ran a log, by least squares on its own law.

        force(k) = Kp (Kv (x_set - x) + share v_set - v),   v = (x - x n samples before) / n T,   all d samples old

    n from 1 to 8 and d from 0 to 3 are tried; the pair that leaves least is taken.  Samples at the force limit are left
    out.  Raises NotIdentifiableError where no such cascade leaves less than 5 %: an integral part, filters or another
    law are at work, whose parameters the user must state.
    """
    if log.set_position is None:
        raise NotIdentifiableError(
            f"{log.name}: the gains of the loop are not identifiable without the set position: record it next, on the "
            f"same clock"
        )
    free = np.abs(log.force) < 0.999 * np.max(np.abs(log.force))
    tried: dict[tuple[int, int], float] = {}
    for n in range(1, MOST_SAMPLES + 1):
        for d in range(MOST_DELAY + 1):
            columns, force = _rows(log, n, d, free)
            off = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
            tried[n, d] = float(np.linalg.norm(off) / np.linalg.norm(force))
    n, d = min(tried, key=lambda pair: tried[pair])
    if tried[n, d] > LARGEST:
        raise NotIdentifiableError(
            f"{log.name}: no P-PI cascade without an integral part explains the force: the best leaves "
            f"{100.0 * tried[n, d]:.3g} %, at most {100.0 * LARGEST:g} % are admitted; state the law in a machine file"
        )
    return _found(log, n, d, tried, *_rows(log, n, d, free))


def _rows(log: MotionLog, n: int, d: int, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns for Kp Kv, Kp · share and Kp, shape (rows, 3), and the force."""
    assert log.set_position is not None
    k = np.arange(_START, log.force.size - 1)
    k = k[free[k]]
    x, set_position, T = log.position, log.set_position, log.sample_time
    error = set_position[k - d] - x[k - d]
    velocity = (x[k - d] - x[k - d - n]) / (n * T)
    set_velocity = (set_position[k - d + (1 if d else 0)] - set_position[k - d - 1]) / ((2 if d else 1) * T)
    return np.column_stack([error, set_velocity, -velocity]), log.force[k]


def _found(
    log: MotionLog, n: int, d: int, tried: dict[tuple[int, int], float], columns: np.ndarray, force: np.ndarray
) -> ControlFit:
    values = np.linalg.lstsq(columns, force, rcond=None)[0]
    off = force - columns @ values
    covariances = robust_covariance(columns, off), ols_covariance(columns, off)
    Kp = values[2]
    # to first order: d(a / b) = da / b - a db / b²
    turned = np.array([[1.0 / Kp, 0.0, -values[0] / Kp**2], [0.0, 1.0 / Kp, -values[1] / Kp**2], [0.0, 0.0, 1.0]])
    robust, ols = (errors(turned @ each @ turned.T) for each in covariances)
    names, units = ("Kv", "velocity_feedforward", "Kp"), ("1/s", "", log.frame.viscous)
    shown = (values[0] / Kp, values[1] / Kp, Kp)
    found = tuple(Estimate(*each) for each in zip(names, map(float, shown), units, robust, ols, strict=True))
    return ControlFit(log.name, found, n, d, tried[n, d], tried)
