"""Stability of a loop by the poles of its model, or by the Nyquist criterion on its loop gain."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.analysis.contour_control import contour_gains
from feeddrive.analysis.conversion import as_frf
from feeddrive.blocks.families import Law
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError, UnstableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System, check_system

_ROUNDING = 1e-9  # of |z|: the uncertainty of eigenvalues of a small matrix


@dataclass(frozen=True, eq=False, repr=False)
class Stability(Result):
    """The dominant pole of a sampled model, which decides its stability.

    `growth` is |z|, the growth factor of the motion per sample; below 1 the motion decays.
    """

    model: StateSpace
    pole: complex

    @property
    def growth(self) -> float:
        """The magnitude |z| of the dominant pole."""
        return abs(self.pole)

    @property
    def stable(self) -> bool:
        """True if all motions decay; a motion that neither grows nor decays is not stable."""
        return self.growth < 1.0 - _ROUNDING

    @property
    def frequency(self) -> float:
        """The frequency of the dominant pole, Hz; 0 for a motion that does not oscillate."""
        return float(abs(np.angle(self.pole)) / (2.0 * np.pi * self.model.sample_time))

    @property
    def time_constant(self) -> float | None:
        """The time constant of growth or decay in s; None at the stability limit or for z = 0."""
        if self.growth == 0.0 or abs(self.growth - 1.0) <= _ROUNDING:
            return None
        return float(self.model.sample_time / abs(np.log(self.growth)))

    def sentence(self) -> str:
        """Return a sentence on the motion of the dominant pole."""
        motion = Text(f"an oscillation of {Quantity(self.frequency, 'Hz')}") if self.frequency > 0.0 else "a drift"
        time = self.time_constant
        if self.stable:
            rate = "at once" if time is None else Text(f"to 1/e in {Quantity(time, 's')}")
            return Text(f"the loop is stable: its slowest motion, {motion}, falls {rate}")
        if time is None:
            return Text(f"the loop is at the edge of stability: {motion} neither grows nor dies out")
        return Text(f"the loop is unstable: {motion} grows by the factor e every {Quantity(time, 's')}")

    def table(self) -> Table:
        """Return a table of the poles, with the verdict as its title."""
        poles = self.model.table()
        return Table(self.sentence(), poles.columns, poles.rows)


def stability(system: StateSpace | System, *, velocity: float = 0.05) -> Stability:
    """Assess the stability of a sampled model, or of a loop or machine moving with `velocity` (m/s; 0: the axes stick).

    The test covers all states that are reachable from setpoint or load force and observable in position or force.
    Under a gain schedule it is made at each of its places, axis by axis, and the least stable one counts.
    """
    if isinstance(system, StateSpace):
        return _of_model(system)
    check_system(system)
    inputs, outputs = ("set_position", "load_force"), ("position_motor", "position_load", "force")
    excited, seen = ([f"{port}{name}" for port in system.ports() for name in names] for names in (inputs, outputs))
    places = {axis: loop.control.law.scheduled_at() for axis, loop in system.loops().items()}
    first = {axis: float(found[0]) for axis, found in places.items() if found}
    positions = [first | {axis: float(place)} for axis, found in places.items() for place in found] or [first]
    models = (linearize(system, excited, seen, velocity=velocity, position=position) for position in positions)
    return max(map(_of_model, models), key=lambda verdict: verdict.growth)


def _of_model(model: StateSpace) -> Stability:
    poles = model.poles()
    return Stability(model, complex(poles[0]) if poles.size else 0j)


def require_stable(system: StateSpace | System, *, velocity: float = 0.05, where: str = "") -> Stability:
    """Return the stability, or raise UnstableError if the system is unstable.

    The message states frequency, growth factor, a remedy and the nearest stable gains; `where` names the loop.

    For a machine, the gain of cross-coupled control is checked in all directions of the path.
    """
    verdict = stability(system, velocity=velocity)
    if verdict.stable:
        # the poles are those of the one direction of the path in which the machine was linearized
        for gain in contour_gains(system) if isinstance(system, Machine) else ():
            if not gain.stable:
                raise UnstableError(
                    f"{where + ': ' if where else ''}{gain.sentence()}: lower it, to half of that at most"
                )
        return verdict
    law = system.control.law if isinstance(system, Loop) else None
    nyquist = 0.5 / verdict.model.sample_time
    tunables = "Kp and Kv, or lengthen Tn" if law is None else _slower(law)
    if verdict.frequency == 0.0:
        remedy = "check the signs of the gains and that the position loop is closed"
    # a pole near z = -1 alternates from sample to sample: that is the sampled loop, not a resonance of the axis
    elif verdict.frequency > 0.45 * nyquist:
        remedy = Text(
            f"this is close to Nyquist ({Quantity(nyquist, 'Hz'):6}), so the gain is too high for the mass and the "
            f"sample time: lower {tunables.split(',')[0]}, or sample faster"
        )
    else:
        remedy = Text(
            f"lower {tunables}; shorten dead time and filters; if the axis has a resonance there, put a notch at "
            f"{Quantity(verdict.frequency, 'Hz')}"
        )
    nearest = _nearest_stable(system, velocity) if isinstance(system, Loop) else ""
    raise UnstableError(
        f"{where + ': ' if where else ''}{verdict.sentence()} (|z| = {Quantity(verdict.growth):7}, must be < 1): "
        f"{remedy}{nearest}"
    )


def _slower(law: Law) -> str:
    """Return a phrase with the gains to reduce and the time constants to increase: `Kp and Kv, or lengthen Tn`."""
    there = dict(tree.leaves(law))
    units = {name: tree.declaration(law, name).unit for name in law.tuned() if name in there}
    gains = [name for name, unit in units.items() if unit not in ("", "s")]
    times = [name for name, unit in units.items() if unit == "s"]
    return (" and ".join(reversed(gains)) or "the gains") + (f", or lengthen {' and '.join(times)}" if times else "")


def _nearest_stable(loop: Loop, velocity: float) -> str:
    """Return a phrase that states stable gains, or an empty string if none are found.

    They are found by reducing the bandwidth of the law by a common factor: gains decrease, time constants increase.
    """
    law = loop.control.law
    values = dict(tree.leaves(law))
    units = {name: tree.declaration(law, name).unit for name in law.tuned() if isinstance(values.get(name), float)}
    # a time constant is made longer; a ratio such as a damping stays
    powers = {name: -1.0 if unit == "s" else 1.0 for name, unit in units.items() if unit}

    def slowed(factor: float) -> dict[str, float]:
        return {name: values[name] * factor**power for name, power in powers.items()}

    def holds(factor: float) -> bool:
        changes = {tree.path_of(loop, f"control.law.{name}"): value for name, value in slowed(factor).items()}
        try:
            return stability(tree.vary(loop, changes), velocity=velocity).stable
        except FeeddriveError:
            return False

    # downward from the present gains: a conditionally stable loop may have other stable gains far below
    halves = next((n for n in range(1, 11) if powers and holds(0.5**n)), None)
    if halves is None:
        return ""
    low, high = 0.5**halves, 0.5 ** (halves - 1)
    # eight halvings of a factor of 2 find the edge to 0.4 %: enough for a proposal
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    listed = ", ".join(f"{name} = {Quantity(value, units[name]):SI}" for name, value in slowed(low).items())
    return Text(
        f"; in the same proportion it is stable up to {listed}, which is {Quantity(low, 'share'):3} of the speed"
    )


# at 180 deg the direction of a turn is lost; a third of it leaves room for curvature between the lines
_COARSE = np.radians(60.0)  # turn of 1 + L between two lines from which the curve between them is uncertain
_DISC = 2.4477  # √χ²(95 %, 2): deviations of the real part within which 95 % of a complex normal variable lie


@dataclass(frozen=True, eq=False, repr=False)
class Encirclement(Result):
    """The stability of the closed loop according to its Nyquist curve.

    turns          number of counterclockwise encirclements of -1 by L, over all frequencies from -∞ to ∞
    unstable       number of unstable poles of the closed loop: `unstable_poles` of the open loop minus `turns`
    arc            assumed phase change of L between 0 Hz and the first line, degrees
    rounding       difference between the computed turns and the nearest whole number
    doubts         possible reasons for a wrong count: lines too far apart, noise that covers -1, a gain above 1 at
                   the last line
    """

    loop_gain: FRF
    turns: int
    unstable: int
    unstable_poles: int
    arc: float
    rounding: float
    doubts: tuple[str, ...]

    @property
    def stable(self) -> bool:
        """True if the closed loop has no unstable pole; `certain` is True if the frequency lines suffice for that."""
        return self.unstable == 0

    @property
    def certain(self) -> bool:
        """True if there is no doubt about the count."""
        return not self.doubts

    def sentence(self) -> str:
        """Return the verdict as a sentence."""
        verdict = "stable" if self.stable else f"unstable, with {self.unstable} growing poles"
        if self.unstable < 0:
            verdict = "not possible: it turns more often than the open loop has unstable poles"
        open_loop = f"{self.unstable_poles} unstable poles" if self.unstable_poles else "no unstable pole"
        return f"the closed loop is {verdict}: L turns {self.turns} times round -1, the open loop has {open_loop}"

    def table(self) -> Table:
        """Return a table of the encirclements, with the doubts about the count."""
        rows = [
            ["turns round -1, counterclockwise", self.turns],
            ["unstable poles of the open loop", self.unstable_poles],
            ["unstable poles of the closed loop", self.unstable],
            ["assumed arc below the first line", Quantity(self.arc, "deg", form=".0f")],
            *(["doubt", doubt] for doubt in self.doubts),
        ]
        return Table(self.sentence(), ["what", ""], rows)


def encirclement(
    loop_gain: FRF | Any,
    frequency: np.ndarray | None = None,
    *,
    unstable_poles: int = 0,
    integrators: int | None = None,
) -> Encirclement:
    """Assess the stability of the closed loop by the change of arg(1 + L) from line to line (Nyquist 1932).

        unstable = unstable_poles - turns,   turns = (2/2π) [arc + Σ arg((1 + Lₖ₊₁)/(1 + Lₖ)) + closing]

    unstable_poles  number of open-loop poles outside the left half plane (or the unit circle), without integrators
    integrators     number of poles of L at the origin (z = 1); None: from the slope of its lowest lines

    Below the first line L is assumed to start at +∞, or at -∞ for a negative gain, and to follow the arc of its
    integrators, -90° for each, to the nearest branch of its measured phase. The exact path there does not matter as
    long as |L| > 1. A sampled L ends at Nyquist, where it is real; the magnitude of any other L must be below 1 at its
    last line and above it. `closing` is the angle of 1 + L from the last line to this end of the curve.
    Raises ParameterError for fewer than two frequency lines and for an L of exactly -1.
    """
    L = as_frf(loop_gain, frequency)
    if L.frequency.size < 2:
        raise ParameterError(f"a Nyquist curve needs at least two lines, not {L.frequency.size}")
    if unstable_poles < 0 or (integrators is not None and integrators < 0):
        raise ParameterError("unstable_poles and integrators must be >= 0")
    response = L.response
    distance = 1.0 + response
    if np.any(distance == 0.0):
        raise ParameterError(
            f"the loop gain is exactly -1 at {Quantity(L.frequency[np.argmin(np.abs(distance))], 'Hz'):6}"
        )
    doubts: list[str] = []
    count = _integrators(L) if integrators is None else integrators
    if count == 0:
        # without integrators L begins at a real value; a straight line leads from there
        way = np.linspace(float(np.real(response[0])), response[0], 2001)
        begin, arc = 0.0, 0.0
    else:
        begin, arc = _arc(float(np.angle(response[0])), count)
        way = np.abs(response[0]) * np.exp(1j * (begin + np.linspace(0.0, arc, 4001)))
    first = _turned(1.0 + way)
    if count > 0 and np.abs(response[0]) <= 1.0:
        doubts.append(
            Text(
                f"|L| is {Quantity(np.abs(response[0])):3} at the first line, {Quantity(L.frequency[0], 'Hz'):3}: "
                f"below 1 the unmeasured arc of its {count} integrators may pass on either side of -1; measure from a "
                "lower frequency"
            )
        )
    steps = np.angle(distance[1:] / distance[:-1])
    coarse = np.flatnonzero(np.abs(steps) > _COARSE)
    if coarse.size:
        i = int(coarse[np.argmax(np.abs(steps[coarse]))])
        doubts.append(
            Text(
                f"1 + L turns by {Quantity(np.degrees(abs(steps[i])), 'deg'):.0f} between "
                f"{Quantity(L.frequency[i], 'Hz', bare=True):5} and {Quantity(L.frequency[i + 1], 'Hz'):5}, more than "
                f"{Quantity(np.degrees(_COARSE), 'deg'):.0f}: measure lines between them"
            )
        )
    # from the last line on L shrinks to 0, so that 1 + L ends at 1, with the angle 0
    closing = -float(np.angle(distance[-1]))
    if L.sample_time is not None and L.frequency[-1] * L.sample_time >= 0.5 * (1.0 - 1e-9):
        # real at Nyquist, on either side of zero
        if float(np.real(distance[-1])) < 0.0:
            closing += float(np.copysign(np.pi, np.angle(distance[-1])))
    elif np.abs(response[-1]) >= 1.0:
        doubts.append(
            Text(
                f"|L| is {Quantity(np.abs(response[-1])):3} at the last line, {Quantity(L.frequency[-1], 'Hz')}, and "
                "may turn round -1 beyond it: measure to where it stays below 1"
            )
        )
    # half of the curve, over positive frequencies: the other half is its mirror image and turns as often
    total = (first + float(np.sum(steps)) + closing) / np.pi
    turns = round(total)
    if L.variance is not None:
        near = np.abs(distance) / np.maximum(np.sqrt(0.5 * L.variance), 1e-300)
        place = int(np.argmin(near))
        if near[place] < _DISC:
            doubts.append(
                Text(
                    f"-1 lies within the 95 % disc of L at {Quantity(L.frequency[place], 'Hz'):5} (|1 + L| = "
                    f"{Quantity(np.abs(distance[place])):3}): measure longer there"
                )
            )
    # rounding gives 1e-12; a tenth of a turn is a part of the curve that is missing
    if abs(total - turns) > 0.1:
        doubts.append(
            Text(f"the turns come out as {Quantity(total):.3f}, not a whole number: the curve of L does not close")
        )
    return Encirclement(
        L, turns, unstable_poles - turns, unstable_poles, float(np.degrees(arc)), abs(total - turns), tuple(doubts)
    )


def _turned(curve: np.ndarray) -> float:
    """Return the total angle in rad by which a curve turns around the origin."""
    return float(np.sum(np.angle(curve[1:] / curve[:-1])))


def _integrators(L: FRF) -> int:
    """Return the number of integrators, from the slope of ln |L| over ln f on the lowest octave (>= 5 lines)."""
    # an octave: enough lines to average their noise, and still near 0 Hz
    many = max(int(np.searchsorted(L.frequency, 2.0 * L.frequency[0])), min(5, L.frequency.size))
    x, y = np.log(L.frequency[:many]), np.log(np.maximum(np.abs(L.response[:many]), 1e-300))
    # 1/f^n has the slope -n
    slope = float(np.polyfit(x, y, 1)[0])
    return max(round(-slope), 0)


def _arc(angle: float, integrators: int) -> tuple[float, float]:
    """Return the phase at which L starts, 0 (at +∞) or, for a negative gain, π (at -∞), and its turn to `angle`, rad.

    Of all turns that lead to this angle, the one nearest to -90° per integrator is selected.
    """
    wanted = -0.5 * np.pi * integrators
    turns = [wanted + (angle - begin - wanted + np.pi) % (2.0 * np.pi) - np.pi for begin in (0.0, np.pi)]
    positive = abs(turns[0] - wanted) <= 0.5 * np.pi
    return (0.0, turns[0]) if positive else (np.pi, turns[1])
