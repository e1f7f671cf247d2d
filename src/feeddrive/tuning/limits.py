"""Limits of a tuning that hold at every operating point; each becomes a constraint with slack and gradient."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.filter.notch import Notch
from feeddrive.figures.catalogue import limitable
from feeddrive.figures.figure import Figure, Limit
from feeddrive.figures.slopes import JudgedLoop, SlopedLoop
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control


@dataclass(frozen=True, init=False)
class Limits:
    """Limits of a tuned loop, at every operating point: `Limits(sensitivity_peak=1.7, gain_margin_dB=6.0)`.

    limits         in the order of the catalogue of figures
    reading_noise  errors of the two readings, white, m RMS, from which the force noise follows
    snap_force     N: a step of this force on the table must not drive the command to its limit, in the proof's run

    The bounds are given by the keys of figures (`figures.limitable`), in SI, or as `Limit`s. A figure with a usual
    limit has it unless another one or None is given: `sensitivity_peak=None`.
    Raises ParameterError for a figure that no tuning can limit, and for a bound out of its range.
    """

    limits: tuple[Limit, ...]
    reading_noise: tuple[float, float]
    snap_force: float | None

    def __init__(
        self,
        limits: Iterable[Limit] = (),
        *,
        reading_noise: tuple[float, float] = (0.0, 0.0),
        snap_force: float | None = None,
        **bounds: float | None,
    ) -> None:
        known = {figure.key: figure for figure in limitable()}
        for key in bounds:
            if key not in known:
                raise ParameterError(f"no tuning can limit '{key}'{nearest(key, known)}; it can {', '.join(known)}")
        stated = {limit.figure.key: limit.bound for limit in limits} | bounds
        chosen = {
            key: stated.get(key, None if figure.limit is None else figure.limit.usual) for key, figure in known.items()
        }
        effective = tuple(Limit(known[key], bound) for key, bound in chosen.items() if bound is not None)
        for limit in effective:
            if limit.declared.noise and not any(value > 0.0 for value in reading_noise):
                raise ParameterError(f"{limit.figure.key} needs reading_noise: the errors of the two readings in m RMS")
        if snap_force is not None and not (np.isfinite(snap_force) and snap_force > 0.0):
            raise ParameterError(f"snap_force = {Quantity(snap_force, 'N'):6 SI} must be a finite number > 0")
        object.__setattr__(self, "limits", effective)
        object.__setattr__(self, "reading_noise", reading_noise)
        object.__setattr__(self, "snap_force", snap_force)

    def limit(self, figure: Figure) -> Limit | None:
        """Return the limit of a figure; None if it has none."""
        return next((limit for limit in self.limits if limit.figure == figure), None)

    def bound(self, figure: Figure) -> float | None:
        """Return the bound of a figure in SI; None if it has no limit."""
        limit = self.limit(figure)
        return None if limit is None else limit.bound

    def having(self, *limits: Limit, reading_noise: tuple[float, float] | None = None) -> Limits:
        """Return these limits with others in place of those of the same figures."""
        bounds: dict[str, float | None] = {figure.key: self.bound(figure) for figure in limitable()}
        bounds |= {limit.figure.key: limit.bound for limit in limits}
        noise = self.reading_noise if reading_noise is None else reading_noise
        return Limits((), reading_noise=noise, snap_force=self.snap_force, **bounds)

    def eased(self, figure: Figure, factor: float) -> Limits:
        """Return the same limits with that of a figure wider by a factor."""
        limit = self.limit(figure)
        return self if limit is None else self.having(limit.eased(factor))

    def sentence(self) -> Text:
        """All limits, as a clause."""
        return joined(", ", map(self.text, self.limits)) or Text("stability alone")

    def text(self, limit: Limit) -> Text:
        """One limit, as a clause."""
        return Text(f"{limit.text} at {self._readings()}") if limit.declared.noise else limit.text

    def _readings(self) -> str:
        motor, load = (Quantity(noise, "m", form="nm") for noise in self.reading_noise)
        return f"{motor} of white noise in the readings" if motor == load else f"{motor} (motor) and {load} (load)"


class Judged(NamedTuple):
    """A figure of a loop against its limit.

    value  in SI; None if it does not occur, such as a margin without a crossover: it then keeps every limit
    """

    limit: Limit
    value: float | None
    keeps: bool

    @property
    def figure(self) -> Figure:
        """What is limited."""
        return self.limit.figure

    @property
    def used(self) -> float:
        """How much of its limit the figure uses up: more than 1 exceeds it, 0 if the figure does not occur."""
        return self.limit.used(self.value)

    @property
    def text(self) -> Text:
        """The figure in words."""
        if self.value is None:
            return Text(f"no {self.figure.title}, there is no crossover")
        return Text(f"{self.figure.title} {Quantity(self.value, self.figure.unit)}")

    def __str__(self) -> str:
        return str(self.text)


def judged(limits: Limits, loop: JudgedLoop, room: float) -> tuple[Judged, ...]:
    """Return the figures of a stable loop against each limit, `room` a share of the limit as tolerance.

    A force noise that is not known is not checked.  A phase margin counts by its size: in a stable loop a negative one
    says that L passes -1 on its other side, as near as a positive one.
    """
    values = ((limit, limit.figure.read(loop)) for limit in limits.limits)
    return tuple(
        Judged(limit, value, limit.keeps(value, room))
        for limit, value in values
        if value is not None or not limit.declared.noise
    )


NOTCH = "notch"  # the bound that prevents a notch from amplifying


class Bound(NamedTuple):
    """One bound at one frequency of one point: its slack, slope, and standard deviation from the measurement.

    figure  what is limited; None for the bound that a notch attenuates
    """

    figure: Figure | None
    point: int
    frequency: float
    slack: float
    slope: np.ndarray
    deviation: float
    key: tuple[str, int, int]

    @property
    def kind(self) -> str:
        """What is limited, in words."""
        return NOTCH if self.figure is None else self.figure.title


def bounds_of(i: int, loop: SlopedLoop, limits: Limits) -> list[Bound]:
    """Return all bounds of a point that are near; without slopes only the nearest along the lines."""
    bounds: list[tuple[tuple[int, int], Bound]] = []
    for figure, bound in ((limit.figure, limit.bound) for limit in limits.limits):
        assert figure.limit is not None
        for place in figure.limit.places(loop, bound, limits.reading_noise):
            frequency, slack, slope, deviation, line = place
            key = (figure.key, i, line)
            order = (figure.limit.order, line)
            bounds.append((order, Bound(figure, i, frequency, slack, slope, deviation, key)))
    return [bound for _, bound in sorted(bounds, key=lambda pair: pair[0])]


def notches_stay_notches(control: Control, tunables: Sequence[str], x: np.ndarray) -> list[Bound]:
    """The bound that a notch attenuates: damping_zero <= damping_pole, at the logarithms x of the tunables."""
    bounds: list[Bound] = []
    for i, block in enumerate(control.filters):
        names = [f"filters.{i}.{field}" for field in ("damping_zero", "damping_pole")]
        if not isinstance(block, Notch) or not set(names) & set(tunables) or not block.damping_zero > 0.0:
            continue
        slope, values = np.zeros(x.size), [np.log(block.damping_zero), np.log(block.damping_pole)]
        for k, (name, sign) in enumerate(zip(names, (-1.0, 1.0), strict=True)):
            if name in tunables:
                place = list(tunables).index(name)
                slope[place], values[k] = sign, x[place]
        bounds.append(Bound(None, 0, 0.0, float(values[1] - values[0]), slope, 0.0, (NOTCH, i, 0)))
    return bounds
