"""Contouring by several axes: how well their dynamics match, and the largest stable gain of cross-coupled control."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from feeddrive.blocks.coupling.cross_coupled import CrossCoupled
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.linearize import StateSpace, linearize, tracking
from feeddrive.loop.machine import Machine

_SLOW = 1e-2  # Hz: where a lag in s is read from the response; its square is lost in rounding
_FEED = 0.05  # m/s along the path, for friction
# eigenvalues of a small matrix are uncertain by some 1e-12
_EDGE = 1.0 - 1e-9  # of |z|
_WORTH_SAYING = 1e-6  # m off a line at 45 degrees


@dataclass(frozen=True, eq=False, repr=False)
class MatchedDynamics(Result):
    """The mismatch of axis dynamics, on a line at 45 degrees and on a circle; `feed` is in m/s, `radius` in m.

    lag      lag in s of each axis behind its setpoint at constant velocity
    answer   complex response of each axis at the circle's frequency, from the set position and its derivatives to the
             table position
    """

    feed: float
    radius: float
    lag: dict[str, float]
    gain: dict[str, float | None]
    answer: dict[str, complex]

    def line(self, a: str, b: str) -> float:
        """Return the contour error on a line at 45 degrees to two axes, m: feed/2 · |difference of their lags|."""
        return 0.5 * self.feed * abs(self.lag[a] - self.lag[b])

    def circle(self, a: str, b: str) -> float:
        """Return the contour error of two axes on a circle, m: radius/2 · |difference of their responses|."""
        first, second = self.answer[a], self.answer[b]
        return 0.5 * self.radius * abs(first - second)

    def remarks(self) -> list[str]:
        """Return a sentence for each pair of axes whose mismatch causes a relevant contour error."""
        remarks = []
        for a, b in combinations(self.lag, 2):
            off = self.line(a, b)
            if off <= _WORTH_SAYING:
                continue
            first, second = self.gain[a], self.gain[b]
            named = f"{a} lags {Quantity(self.lag[a], 's')}, {b} {Quantity(self.lag[b], 's')}"
            if first is not None and second is not None and first != second:
                named = f"{a} Kv {Quantity(first, '1/s', bare=True):6}, {b} {Quantity(second, '1/s', bare=True):6}"
            remarks.append(
                Text(
                    f"{named}: {Quantity(off, 'm'):.1f} off a 45 deg line at {Quantity(self.feed, 'm/s'):6}: give both "
                    "axes the same position gain and feedforward, that of the slower one"
                )
            )
        return remarks

    def table(self) -> Table:
        """Return a table with one row for each pair of axes."""
        rows = [
            [f"{a}, {b}", self.lag[a], self.lag[b], self.line(a, b), self.circle(a, b)]
            for a, b in combinations(self.lag, 2)
        ]
        title = Text(f"Matched dynamics at {Quantity(self.feed, 'm/s'):6}, circle of {Quantity(self.radius, 'm'):6 mm}")
        columns = [
            "axes",
            Column("lag of first", "s"),
            Column("lag of second", "s"),
            Column("45 deg line", "m", "3"),
            Column("circle", "m", "3"),
        ]
        return Table(title, columns, rows)


def matched_dynamics(
    machine: Machine, axes: Sequence[str] | None = None, *, feed: float = 0.1, radius: float = 0.02
) -> MatchedDynamics:
    """Compare the dynamics of contouring axes; default: all linear axes.

    Each axis is linearized alone, without couplings.  Raises ParameterError for an unknown axis, or a feed or radius
    that is not positive.
    """
    if feed <= 0.0 or radius <= 0.0:
        raise ParameterError(
            f"feed = {Quantity(feed, 'm/s'):6 SI} and radius = {Quantity(radius, 'm'):6 SI} must be > 0"
        )
    names = [name for name, loop in machine.axes().items() if not loop.axis.rotary] if axes is None else list(axes)
    loops = {name: machine.loop(name) for name in names}
    circle = feed / (2.0 * np.pi * radius)
    answers = {name: tracking(loop, np.array([_SLOW, circle])).response for name, loop in loops.items()}
    gains = {name: loop.control.law.position_gain() for name, loop in loops.items()}
    return MatchedDynamics(
        feed,
        radius,
        {name: float(-np.angle(response[0]) / (2.0 * np.pi * _SLOW)) for name, response in answers.items()},
        {name: None if gain is None else float(gain) for name, gain in gains.items()},
        {name: complex(response[1]) for name, response in answers.items()},
    )


@dataclass(frozen=True, eq=False, repr=False)
class ContourGain(Result):
    """The largest stable gain of cross-coupled control in 1/s, for the critical direction of the path.

    direction   path direction along which a gain above `largest` is unstable: components of a unit vector by axis
    gain        the present gain of the machine
    peak        Ms of the contour loop at this gain, that is, the maximum of 1/|1 + L| over all directions, where
                L = gain · n (G/Kv) n, n is the unit normal of the path, and G contains the responses of the axes from
                set position to reading; for three axes, the largest singular value in the plane normal to the path
    """

    place: str
    largest: float
    direction: dict[str, float]
    gain: float
    peak: float

    @property
    def stable(self) -> bool:
        """True if the gain is below the largest stable one."""
        return self.gain < self.largest

    @property
    def gain_margin(self) -> float:
        """The ratio of the largest stable gain to the present gain; infinite for a gain of 0."""
        return self.largest / self.gain if self.gain > 0.0 else float("inf")

    def sentence(self) -> str:
        """Return the verdict as a sentence."""
        along = ", ".join(f"{name} {Quantity(share):.3f}" for name, share in self.direction.items())
        verdict = "stable" if self.stable else "unstable"
        return Text(
            f"{self.place}.contour_gain = {Quantity(self.gain, '1/s')} is {verdict}: at most "
            f"{Quantity(self.largest, '1/s')}, along the direction {along}"
        )

    def table(self) -> Table:
        """Return a table of the present gain and the largest stable gain."""
        rows = [
            ["given", Quantity(self.gain, "1/s")],
            ["largest", Quantity(self.largest, "1/s")],
            ["gain margin", Quantity(self.gain_margin, form="3")],
            ["Ms across the path", Quantity(self.peak, form="3")],
        ]
        return Table(self.sentence(), ["gain", ""], rows)


_LINES = 600  # of a response
_MOST = 1e6  # 1/s: no sampled loop is stable beyond


def contour_gain(machine: Machine, place: int = 0, *, directions: int = 72) -> ContourGain:
    """Return the largest stable gain of a `CrossCoupled` coupling of a machine, for the worst direction of the path.

    Let A, B, C be the model of the machine without this coupling, from set positions to readings.  With the coupling,
    the state matrix is A - gain (B/Kv) N C, where N = I - t tᵀ, t is the path direction and Kv the position gain of
    each axis; its eigenvalues determine stability.  For each direction, the gain is found by bisection with a relative
    accuracy of 1e-6.  For equal axes, it is the difference between the largest stable Kv and the actual Kv.  On a
    path of radius R with feed V, the path direction rotates at V/R.  This rotation is neglected, which is permissible
    if V/R is far below Kv.
    Raises ParameterError if that coupling is not a `CrossCoupled`.
    """
    coupling = machine.couplings[place] if 0 <= place < len(machine.couplings) else None
    if not isinstance(coupling, CrossCoupled):
        raise ParameterError(f"couplings.{place} is no cross_coupled: name the place of one")
    names = coupling.axes()
    others = tuple(coupling for i, coupling in enumerate(machine.couplings) if i != place)
    bare = Machine.of(machine.loops(), others)
    inputs, outputs = ([f"{name}.{what}" for name in names] for what in ("set_position", "reading_load"))
    model = linearize(bare, inputs, outputs, velocity=_FEED)
    gains = np.array([float(machine.loop(name).control.law.position_gain()) for name in names])

    def stable(gain: float, frame: np.ndarray) -> bool:
        closed = model.A - gain * (model.B / gains) @ frame @ model.C
        return bool(np.max(np.abs(np.linalg.eigvals(closed))) < _EDGE)

    gain = float(coupling.contour_gain)
    loop = gain * _responses(model) / gains
    crossings: list[tuple[float, np.ndarray]] = []
    peak = 1.0
    for tangent in _directions(len(names), directions):
        frame = np.eye(len(names)) - np.outer(tangent, tangent)
        crossings.append((_largest(lambda gain, frame=frame: stable(gain, frame)), tangent))
        # the projection has one singular value 0, along the path: it is the last
        across = np.linalg.svd(frame)[0][:, :-1]
        opened = np.eye(len(names) - 1) + across.T @ loop @ across
        peak = max(peak, float(1.0 / np.min(np.linalg.svd(opened, compute_uv=False))))
    largest, worst = min(crossings, key=lambda crossing: crossing[0])
    shares = dict(zip(names, map(float, worst), strict=True))
    return ContourGain(f"couplings.{place}", largest, shares, gain, peak)


def _responses(model: StateSpace) -> np.ndarray:
    """Return the frequency responses from every input to every output, shape (lines, outputs, inputs)."""
    nyquist = 0.5 / model.sample_time
    z = np.exp(2j * np.pi * np.geomspace(1e-4 * nyquist, nyquist, _LINES) * model.sample_time)
    inner = np.linalg.solve(z[:, None, None] * np.eye(len(model.A)) - model.A, model.B.astype(complex)[None])
    return model.C @ inner + model.D


def _largest(stable) -> float:  # type: ignore[no-untyped-def]
    """Return the gain up to which the loop is stable for all gains from 0, with a relative accuracy of 1e-6.

    It is 0 if the loop is unstable even at zero gain.
    """
    low = 0.0
    if not stable(0.0):
        return 0.0
    # upward in steps of a quarter, not down from above: beyond an unstable range a loop may be stable again
    high = 1e-2
    while stable(high):
        low, high = high, 1.25 * high
        if high > _MOST:
            return float("inf")
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def _directions(axes: int, count: int) -> list[np.ndarray]:
    """Return unit vectors spread over a half circle or, for three axes, over a hemisphere and along the axes."""
    if axes == 2:
        angle = np.pi * np.arange(count) / count
        return [np.array([np.cos(component), np.sin(component)]) for component in angle]
    i = np.arange(count)
    height = (i + 0.5) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * i  # a spiral of equal areas
    # equal steps of height have equal areas on a sphere (Archimedes)
    flat = np.sqrt(1.0 - height**2)
    spiral = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    # the axes themselves, since parts move along them most of the time
    return [*np.eye(3), *spiral]


def contour_gains(machine: Machine) -> list[ContourGain]:
    """Return the largest stable gain of each `CrossCoupled` coupling of a machine."""
    there = (i for i, coupling in enumerate(machine.couplings) if isinstance(coupling, CrossCoupled))
    return [contour_gain(machine, place) for place in there]
