"""A safe start law for an axis with an unknown control law: a P-PI cascade computed from mass and dead time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.language.errors import DivergedError, NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

RULE = 0.25  # wc times the delay of the velocity loop: at most 0.25 keeps Ms below 1.4 for masses within 20 %
RATIO = 4.0  # wc over Kv, and over 1/Tn: at 3 the stiffest law with the same Ms is less than a tenth stiffer
PEAK = 1.4  # largest Ms of a start law, for each mass
SPREAD = 0.2  # relative error of the mass that the law must bear at least
_TWO_MASSES = 0.26  # of 2 ζ ωr m_motor/m_load: peak gain of the resonance at most 1 - 1/1.4, whatever its phase
_LOWER, _TIMES = 0.85, 24  # factor of wc while a check fails, and how often at most: down to 2 %
_RAGGED = 0.05  # of the largest force, that one count of the encoder may make through the velocity gain
_MOST_SAMPLES = 8  # over which the velocity is differenced
_RAMP = 0.03  # s to the full acceleration of the simulated move
_REST, _RESETS = 0.6, 12.0  # s and integral times after the simulated move, of which the longer one counts
_LAST = 0.2  # s at its end, in which the axis must not hunt
_SETTLED = 0.02  # of the largest following error, within which it then stays, or two counts


@dataclass(frozen=True, eq=False, repr=False)
class StartLaw(Result):
    """A safe start law with the results of its checks.

    spread    relative error of the mass up to which it was checked
    peaks     Ms for the mass minus this error, for the mass, and for the mass plus this error
    error     largest following error of the simulated move, m
    left      remaining motion of the table at the end of the rest after the move, m
    """

    loop: Loop
    law: CascadePPI
    spread: float
    peaks: tuple[float, float, float]
    error: float
    left: float

    def table(self) -> Table:
        """Return a table of the gains and of the results of the checks."""
        within = Quantity(self.spread, "share", form="2")
        rows = [
            ["Kv", Quantity(self.law.Kv, "1/s"), UNIT],
            ["Kp", Quantity(self.law.Kp, "N s/m"), UNIT],
            ["Tn", Quantity(RATIO / self._rate, "s"), UNIT],
            [
                Text(f"Ms for the mass - {within}, as it is, + {within}"),
                ", ".join(f"{Quantity(p):.2f}" for p in self.peaks),
                "",
            ],
            ["largest following error of a simulated move", Quantity(self.error, "m"), UNIT],
        ]
        return Table("safe start law, which is not what ran", ["what", Column("value", form="4 SI"), "unit"], rows)

    @property
    def _rate(self) -> float:
        """The crossover wc of the velocity loop, 1/s."""
        return RATIO * float(self.law.Kv)

    @property
    def sentence(self) -> str:
        """A sentence with the gains of the law and its checks, stating that it is not the law of the log."""
        law, low = self.law, max(self.peaks)
        return Text(
            f"the control is a safe start law from the identified plant, NOT the law that ran: Kv "
            f"{Quantity(law.Kv, '1/s'):3}, Kp {Quantity(law.Kp, 'N s/m'):3}, Tn {Quantity(RATIO / self._rate, 's'):3}, "
            f"Ms {Quantity(low):.2f} at most for masses within {Quantity(self.spread, 'share'):2}, simulated with "
            f"friction without hunting; tune it next (feeddrive tune), or state the law that ran"
        )


def start_law(
    axis: Axis,
    sample_time: float,
    *,
    count: float = 0.0,
    force_limit: float | None = None,
    force: float = math.inf,
    motion: tuple[float, float, float] = (0.05, 0.1, 1.0),
    spread: float = SPREAD,
) -> StartLaw:
    """Return a P-PI cascade for an axis with an unknown law, after checking its margins and a simulated move.

        th = delay of the actuator + (n + 1) T/2,   wc = 0.25 / th,   Kp = m wc,   Kv = wc/4,   Tn = 4/wc

    The velocity is differenced over n samples, n being the smallest number for which one encoder count causes at most 5
    % of `force`. For a two-mass plant wc is also limited to 0.26 · 2 ζ ωr m_motor / m_load. wc is reduced until Ms <=
    1.4 for the mass and for masses that differ by `spread`, and until the axis with its friction comes to rest after a
    move.

    count   encoder resolution, m; 0 if it is negligible
    force   largest force in the log, N
    motion  travel (m), speed (m/s) and acceleration (m/s2) of the simulated move
    spread  relative error of the mass

    Source: own, from Ms of the loop gain (wc/s)(1 + κ wc/s)(1 + ν wc/s) e^(-s th) at κ = ν = 1/4.
    Raises NotIdentifiableError if no crossover passes the checks.
    """
    T, mass = sample_time, float(axis.plant.rigid_mass())
    n, late = 1, T
    for n in range(1, _MOST_SAMPLES + 1):
        late = float(axis.actuator.delay()) + 0.5 * (n + 1) * T
        if mass * RULE / late * count / (n * T) <= _RAGGED * force:
            break
    wc = min(RULE / late, _resonant(axis, spread))
    for _ in range(_TIMES):
        law = CascadePPI(Kv=wc / RATIO, Kp=mass * wc, Tn=RATIO / wc, velocity_samples=n)
        control = Control(law=law, force_limit=force_limit)
        loop = Loop(control=control, axis=axis, sample_time=T)
        peaks = tuple(_peak(_heavier(loop, factor)) for factor in (1.0 - spread, 1.0, 1.0 + spread))
        if max(peaks) <= PEAK:
            error, left = _moved(_counted(loop, count), motion, max(_REST, _RESETS * RATIO / wc))
            if left <= max(_SETTLED * error, 2.0 * count):
                return StartLaw(loop, law, spread, (peaks[0], peaks[1], peaks[2]), error, left)
        wc *= _LOWER
    raise NotIdentifiableError(
        f"no start law has a sensitivity of {Quantity(PEAK):.2f} at most for masses within "
        f"{Quantity(spread, 'share'):2} and comes to rest: state the law that ran in a machine file"
    )


def _resonant(axis: Axis, spread: float) -> float:
    """Return the largest wc, in 1/s, for which the resonance of a two-mass plant cannot destabilize the loop."""
    plant = axis.plant
    if not isinstance(plant, TwoMass):
        return math.inf
    motor, load = float(plant.mass_motor), float(plant.mass_load)
    joint = 1.0 / motor + 1.0 / load
    rate = math.sqrt(float(plant.stiffness) * joint)
    zeta = 0.5 * float(plant.damping) * joint / rate
    return _TWO_MASSES * 2.0 * zeta * rate * motor / ((1.0 + spread) * load)


def _heavier(loop: Loop, factor: float) -> Loop:
    """Return the loop with all masses of the plant multiplied by a factor."""
    place = f"{loop.place_of('axis')}.plant."
    masses = {
        name: factor * float(value)
        for name, value in tree.parameters(loop).items()
        if name.startswith(f"{place}mass") and isinstance(value, float)
    }
    return tree.vary(loop, masses)


def _peak(loop: Loop) -> float:
    """Return Ms, or infinity for an unstable loop."""
    return margins(loop).sensitivity_peak if stability(loop).stable else math.inf


def _counted(loop: Loop, count: float) -> Loop:
    """Return the loop with an encoder of this resolution in m, unless its axis already has encoders."""
    axis = loop.axis
    if count == 0.0 or axis.encoder_motor is not None or axis.encoder_load is not None:
        return loop
    return replace(loop, axis=replace(axis, encoder_load=Encoder(resolution=count)))


def _moved(loop: Loop, motion: tuple[float, float, float], wait: float) -> tuple[float, float]:
    """Return the largest following error of a simulated move, and the remaining motion of the table at its end, m."""
    distance, velocity, acceleration = motion
    move = JerkLimitedMove(
        distance=distance,
        velocity=velocity,
        acceleration=acceleration,
        jerk=acceleration / _RAMP,
        back=True,
        dwell_after=wait,
    )
    try:
        run = simulate(loop, move)
    except DivergedError:
        return 0.0, math.inf
    error = run["following_error"]
    last = run["position_load"][-max(2, round(_LAST / float(loop.sample_time))) :]
    return float(np.max(np.abs(error))), float(np.ptp(last))
