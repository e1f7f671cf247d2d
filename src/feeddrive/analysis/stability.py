"""Stability of a linear model by its poles, and what to do about a loop that has none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, UnstableError
from feeddrive.language.table import Result, Table
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

_ROUNDING = 1e-9  # of |z|: what eigenvalues of a small matrix are uncertain by


@dataclass(frozen=True, eq=False, repr=False)
class Stability(Result):
    """The pole of largest size of a sampled model: it decides. `sample_time` in s.

    `growth` is |z|: the motion is multiplied by it from sample to sample, below 1 it dies out.
    """

    model: StateSpace
    pole: complex

    @property
    def growth(self) -> float:
        """|z| of the deciding pole."""
        return abs(self.pole)

    @property
    def stable(self) -> bool:
        """Whether all motions die out; a motion that neither grows nor dies out is not stable."""
        return self.growth < 1.0 - _ROUNDING

    @property
    def frequency(self) -> float:
        """Of the deciding pole, Hz; 0 for a motion that does not oscillate."""
        return float(abs(np.angle(self.pole)) / (2.0 * np.pi * self.model.sample_time))

    @property
    def time_constant(self) -> float | None:
        """s in which the motion grows or falls to e times its size or an e-th of it; None at the edge or for z = 0."""
        if self.growth == 0.0 or abs(self.growth - 1.0) <= _ROUNDING:
            return None
        return float(self.model.sample_time / abs(np.log(self.growth)))

    def sentence(self) -> str:
        """What the deciding pole does, in words."""
        motion = f"an oscillation of {self.frequency:.4g} Hz" if self.frequency > 0.0 else "a drift"
        time = self.time_constant
        if self.stable:
            rate = "at once" if time is None else f"to 1/e in {1e3 * time:.4g} ms"
            return f"the loop is stable: its slowest motion, {motion}, falls {rate}"
        if time is None:
            return f"the loop is at the edge of stability: {motion} neither grows nor dies out"
        return f"the loop is unstable: {motion} grows by the factor e every {1e3 * time:.4g} ms"

    def table(self) -> Table:
        """The verdict and the poles."""
        poles = self.model.table()
        return Table(self.sentence(), poles.heads, poles.rows)


def stability(system: StateSpace | Loop, *, velocity: float = 0.05) -> Stability:
    """Stability of a sampled model, or of a loop that moves with `velocity` (m/s; 0: the axis sticks).

    A loop is judged by all states that setpoint or load force reach and position or force show.
    """
    model = system
    if isinstance(model, Loop):
        model = linearize(
            model,
            ["set_position", "load_force"],
            ["position_motor", "position_load", "force"],
            velocity=velocity,
        )
    poles = model.poles()
    return Stability(model, complex(poles[0]) if poles.size else 0j)


def require_stable(system: StateSpace | Loop, *, velocity: float = 0.05, where: str = "") -> Stability:
    """The same, or UnstableError with frequency, growth, what to do, and the nearest stable gains of a loop.

    `where` names the loop in the message.
    """
    found = stability(system, velocity=velocity)
    if found.stable:
        return found
    law = system.control.law if isinstance(system, Loop) else None
    nyquist = 0.5 / found.model.sample_time
    tunables = "Kp and Kv, or lengthen Tn" if law is None or law.kind == "cascade_ppi" else " and ".join(law.tunables)
    if found.frequency == 0.0:
        remedy = "check the signs of the gains and that the position loop is closed"
    elif found.frequency > 0.45 * nyquist:
        remedy = (
            f"this is close to Nyquist ({nyquist:g} Hz), so the gain is too high for the mass and the sample "
            f"time: lower {tunables.split(',')[0]}, or sample faster"
        )
    else:
        remedy = (
            f"lower {tunables}; shorten dead time and filters; if the axis has a resonance there, put a "
            f"notch at {found.frequency:.4g} Hz"
        )
    nearest = _nearest_stable(system, velocity) if isinstance(system, Loop) else ""
    raise UnstableError(
        f"{where + ': ' if where else ''}{found.sentence()} (|z| = {found.growth:.7g}, must be < 1): {remedy}{nearest}"
    )


def _nearest_stable(loop: Loop, velocity: float) -> str:
    """The gains of the law slowed down in one proportion until the loop is stable, as a clause; empty if none is."""
    law = loop.control.law
    values = dict(tree.leaves(law))
    units = {name: tree.declaration(law, name).unit for name in law.tunables if isinstance(values.get(name), float)}
    # a time is slowed down by making it longer; a ratio such as a damping is no speed and stays
    powers = {name: -1.0 if unit == "s" else 1.0 for name, unit in units.items() if unit}

    def slowed(factor: float) -> dict[str, float]:
        return {name: values[name] * factor**power for name, power in powers.items()}

    def holds(factor: float) -> bool:
        changes = {tree.path_of(loop, f"control.law.{name}"): value for name, value in slowed(factor).items()}
        try:
            return stability(tree.vary(loop, changes), velocity=velocity).stable
        except FeeddriveError:
            return False

    halves = next((n for n in range(1, 11) if powers and holds(0.5**n)), None)
    if halves is None:
        return ""
    low, high = 0.5**halves, 0.5 ** (halves - 1)
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    listed = ", ".join(f"{name} = {value:.4g} {units[name]}" for name, value in slowed(low).items())
    return f"; in the same proportion it is stable up to {listed}, which is {100.0 * low:.3g} % of the speed"
