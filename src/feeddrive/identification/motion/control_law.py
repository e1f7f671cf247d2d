"""The gains of a P-PI cascade, identified from its logged inputs and its logged command."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.identification.estimate import NORMAL, Estimate, estimates_table
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.regression import TracedForce, errors, ols_covariance, robust_covariance
from feeddrive.language.block import Number
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text

MOST_DELAY = 3  # samples between reading and command that are tried
MOST_SAMPLES = 8  # over which a velocity may be computed by differences
LARGEST = 0.05  # largest unexplained share of the force for which a law counts as identified
_START = 20  # samples that a difference over the past needs
_FIRST = _START - MOST_DELAY  # first sample whose reading counts
_GAINS = ("Kv", "velocity_feedforward", "Kp")
_PLAIN = {
    "Kv": 0.0,
    "velocity_feedforward": 0.0,
    "Kp": 1.0,
}  # here the slopes are those to Kp Kv, Kp share and Kp


@dataclass(frozen=True, eq=False, repr=False)
class ControlFit(Result):
    """A cascade that explains the logged force: Kv (1/s), Kp, velocity feedforward (1), and how they were found.

    delay      samples between the reading that the law used and the command
    residual   share of the force that the law does not explain
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
        title = Text(
            f"{self.name}: P-PI cascade, velocity over {self.velocity_samples} samples, {self.delay} samples of delay; "
            f"{Quantity(self.residual, 'share'):3} of the force is left"
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
    """The gains of the loop that produced a log, by least squares on the law of the cascade.

        force(k) = Kp (Kv (x_set - x) + share v_set - v),   v = (x - x n samples before) / n T,   all d samples old

    It is the step of `CascadePPI`, traced; its slopes to the gains are the columns.  n from 1 to 8 and d from 0 to 3
    are tried; the pair with the least residual is taken. Samples at the force limit are left
    out.  Raises NotIdentifiableError if every such cascade leaves 5 % or more. Then the loop has an integral part,
          filters or another law, whose parameters the user must state.
    """
    if log.set_position is None:
        raise NotIdentifiableError(
            f"{log.name}: the gains of the loop are not identifiable without the set position: record it next, on the "
            f"same clock"
        )
    free = np.abs(log.force) < 0.999 * np.max(np.abs(log.force))
    rows = np.arange(_START, log.force.size - 1)
    rows = rows[free[rows]]
    tried: dict[tuple[int, int], float] = {}
    for n in range(1, MOST_SAMPLES + 1):
        slopes = _slopes(_traced(n), _PLAIN, log, n)
        for d in range(MOST_DELAY + 1):
            columns, force = slopes[rows - d], log.force[rows]
            off = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
            tried[n, d] = float(np.linalg.norm(off) / np.linalg.norm(force))
    n, d = min(tried, key=lambda pair: tried[pair])
    if tried[n, d] > LARGEST:
        raise NotIdentifiableError(
            f"{log.name}: no P-PI cascade without an integral part explains the force: the best leaves "
            f"{Quantity(tried[n, d], 'share'):3}, at most {Quantity(LARGEST, 'share'):6} is allowed; state the law in "
            "a machine file"
        )
    law, force = _traced(n), log.force[rows]
    columns = _slopes(law, _PLAIN, log, n)[rows - d]
    linear = dict(zip(_GAINS, map(float, np.linalg.lstsq(columns, force, rcond=None)[0]), strict=True))
    off = force - columns @ np.array(list(linear.values()))
    # the force of a plain cascade is linear in these three; the first two are gains times Kp
    gains = {name: value if name == "Kp" else value / linear["Kp"] for name, value in linear.items()}
    columns = _slopes(law, gains, log, n)[rows - d]
    robust, ols = errors(robust_covariance(columns, off)), errors(ols_covariance(columns, off))
    units = ("1/s", "", log.frame.viscous)
    found = tuple(Estimate(*each) for each in zip(_GAINS, gains.values(), units, robust, ols, strict=True))
    return ControlFit(log.name, found, n, d, tried[n, d], tried)


def _traced(samples: int) -> TracedForce[CascadePPI]:
    """The force of the cascade from its set position, reading and earlier readings, each a column over the log."""
    block = CascadePPI(Kv=1.0, Kp=1.0, velocity_samples=samples)
    earlier = tuple(f"position_{i + 1}" for i in range(samples))

    def force(law: CascadePPI, given: Mapping[str, Number]) -> Number:
        T, position = given["T"], given["position"]
        setpoint = Setpoint(given["set_position"], given["set_velocity"], 0.0, 0.0, 0.0)
        state = law.State(tuple(given[name] for name in earlier), 0.0)
        return law.step(law.prepare(T), state, setpoint, Reading(position, position), T)[1]

    return TracedForce(block, ("T", "set_position", "set_velocity", "position", *earlier), force)


def _slopes(law: TracedForce[CascadePPI], gains: Mapping[str, float], log: MotionLog, n: int) -> np.ndarray:
    """Slopes of the law's force to `_GAINS` at these gains, shape (samples, 3); 0 before `_START`."""
    assert log.set_position is not None
    x, wanted, T = log.position, log.set_position, log.sample_time
    before = {f"position_{i + 1}": x[_FIRST - 1 - i : x.size - 1 - i] for i in range(n)}
    # the set velocity as the law differences it; without an acceleration it is taken unchanged
    velocity = np.diff(wanted[_FIRST - 1 :]) / T
    _, slopes = law.at(
        gains, T=np.array(T), set_position=wanted[_FIRST:], set_velocity=velocity, position=x[_FIRST:], **before
    )
    found = np.zeros((x.size, len(_GAINS)))
    found[_FIRST:] = slopes[:, [law.names.index(name) for name in _GAINS]]
    return found
