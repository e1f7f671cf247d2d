"""Chatter: the stability lobes of a milling cut, and the signs of chatter in a signal.

In addition to the exact method there are two published ones: zero-order lobes, a quick estimate, and
semi-discretization.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from feeddrive.analysis.spectrum import Spectrum, spectrum
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, signal_unit
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.machining.regeneration import Regeneration, ToothPassage, regeneration
from feeddrive.machining.tool_point import ToolPoint, tool_point

_SIDE_LINES = 2  # of the spectrum to each side of a harmonic that belong to it: the width of the window
_TEETH = 16  # least number of teeth in a record
_STILL = 0.01  # of the swing within a tooth: samples that spread by less are one dot
_PLACES = 64  # candidate angles of the samples within a tooth
_FALLS = 0.5  # of the spread of the first half: a second half that spreads by less dies out
_APART = 0.25  # of their spread: every second sample that spreads by less is one of two dots


@dataclass(frozen=True, eq=False, repr=False)
class ChatterSigns(Result):
    """The spectrum and once-per-tooth samples of a signal, for the detection of chatter.

    harmonic   True for lines at harmonics of the tooth passing frequency or, with run-out, the spindle frequency
    passing    tooth passing frequency, Hz
    samples    value at the same angle of each tooth (of each turn, with run-out), SI
    swing      peak-to-peak value within a tooth, mean over the teeth, SI
    dots       1: all samples agree, the cut is stable; 2: every second one agrees, flip chatter; 0: a ring, Hopf
               chatter
    """

    spectrum: Spectrum
    harmonic: np.ndarray
    passing: float
    samples: np.ndarray
    swing: float
    dots: int

    @property
    def chatter(self) -> float:
        """The frequency of the strongest line that is not a harmonic, Hz, which is meaningless for a stable cut."""
        beside = np.where(self.harmonic, 0.0, self.spectrum.amplitude)
        return float(self.spectrum.frequency[np.argmax(beside)])

    def sentence(self) -> str:
        """Return the interpretation of the samples as a sentence."""
        spread = float(np.std(self.samples)) / self.swing if self.swing else 0.0
        phrase = {
            1: "no chatter: samples once per tooth agree",
            2: Text(f"flip chatter at {Quantity(self.chatter, 'Hz')}: every second tooth cuts deeper"),
            0: Text(
                f"chatter at {Quantity(self.chatter, 'Hz')}, beside the harmonics of the teeth: samples once per tooth "
                "run round"
            ),
        }[self.dots]
        return Text(f"{phrase} (they spread by {Quantity(spread, 'share'):2} of the swing within a tooth)")

    def table(self) -> Table:
        """Return a table of the strongest lines and their origin."""
        rows: list[list[str | float]] = []
        for frequency, amplitude in self.spectrum.largest():
            line = int(np.searchsorted(self.spectrum.frequency, frequency))
            times = Text(f"{Quantity(frequency / self.passing):3} x teeth")
            belongs = times if self.harmonic[line] else "chatter" if self.dots != 1 else "beside"
            rows.append([frequency, amplitude, belongs])
        amplitudes = Column("amplitude", self.spectrum.unit, f"4 {signal_unit(self.spectrum.unit)}")
        return Table(self.sentence(), [Column("line", "Hz", "5"), amplitudes, "belongs to"], rows)


def chatter_signs(
    values: np.ndarray,
    sample_time: float,
    *,
    speed: float,
    teeth: int,
    name: str = "signal",
    unit: str = "",
    start: float | None = None,
    runout: bool = False,
) -> ChatterSigns:
    """Detect chatter in equidistant samples of a force, an error or a sound of an established cut.

    speed   spindle speed in rpm, constant; teeth: number of teeth of the tool
    start   time of the first once-per-tooth sample after the first value, s; None: where the samples spread the most
    runout  True for a tool with run-out: harmonics of the spindle are not chatter, and samples are taken once per turn

    A stable cut is periodic with the teeth: all its lines are harmonics, and samples once per tooth are one dot, or
    converge to one.  After a flip bifurcation they are two dots, otherwise a ring.
    Raises ParameterError for fewer than 16 teeth (turns, with run-out) and for fewer than four samples per tooth.
    """
    signal = np.asarray(values, float)
    if not speed > 0.0 or teeth < 1:
        raise ParameterError(f"speed = {Quantity(speed, 'rpm'):6} must be > 0 and teeth = {teeth} must be 1 or more")
    passing = teeth * speed / 60.0
    period = 60.0 / speed if runout else 1.0 / passing
    count = int(((signal.size - 1) * sample_time - (start or 0.0)) / period)
    if 1.0 / passing < 4.0 * sample_time:
        raise ParameterError(
            f"a tooth passes every {Quantity(1.0 / passing, 's')}, and {name} has a sample every "
            f"{Quantity(sample_time, 's')}: four samples a tooth are needed, sample faster"
        )
    if count < _TEETH:
        what = "turns" if runout else "teeth"
        raise ParameterError(f"{name} lasts {max(count, 0)} {what}: at least {_TEETH} are needed, give a longer record")
    lines = spectrum(signal, sample_time, name=name, unit=unit)
    width = lines.frequency[1] - lines.frequency[0]
    times = lines.frequency * period
    # half a line more, since a harmonic may lie between two lines
    harmonic = np.abs(times - np.round(times)) <= (_SIDE_LINES + 0.5) * width * period
    # Deferred: commands that only read files do not need it.
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(sample_time * np.arange(signal.size), signal)
    at = (start or 0.0) + period * np.arange(count)
    inside = curve(at[:-1, None] + period / _PLACES * np.arange(_PLACES))
    samples = curve(at) if start is not None else inside[:, np.argmax(np.std(inside, axis=0))]
    swing = float(np.mean(np.ptp(inside, axis=1)))
    return ChatterSigns(lines, harmonic, passing, samples, swing, _dots(samples, swing))


def _dots(samples: np.ndarray, swing: float) -> int:
    """Return the number of dots, 1 or 2, or 0 for a ring."""
    spread, half = float(np.std(samples)), samples.size // 2
    if spread <= _STILL * swing or np.std(samples[half:]) < _FALLS * np.std(samples[:half]):
        return 1
    return 2 if max(np.std(samples[::2]), np.std(samples[1::2])) <= _APART * spread else 0


_RESPONSE_LINES = 4000  # of a modeled response over its band


@dataclass(frozen=True)
class ZeroOrder:
    """Zero-order limits: axial depth in m and chatter frequency in Hz by spindle speed in rpm; NaN where there is none.

    `least` is the depth below which this theory predicts no chatter at any speed, m.
    """

    spindle_speed: np.ndarray
    depth: np.ndarray
    frequency: np.ndarray
    least: float


def zero_order(tool: ToolPoint | FRF | Any, cutter: Any, spindle_speeds: Any = ()) -> ZeroOrder:
    """Compute the zero-order solution of Altintas and Budak, with the mean of the directional matrix over a turn.

        λ an eigenvalue of G(jω) mean(H),  L = -1/λ,  a = |L|²/(2 Re L) if Re L > 0,  ωτ = -arg(1 - L/a) + 2πk

    tool   a `ToolPoint`, or the measured response of the tool's position to a force on it, m/N: an `FRF` along the
           feed, or a pair of them for feed and normal

    The solution is exact where H is constant; elsewhere it is not a bound: in down milling at low radial immersion it
    is too high by up to a factor of two, and it has no flip lobes.  A measured response needs no model; its frequency
    lines are interpolated linearly.
    Raises ParameterError for a response that is not in m/N.
    Source: Altintas & Budak 1995, Analytical Prediction of Stability Lobes in Milling, CIRP Annals 44.
    """
    cut = regeneration(cutter)
    frequency, response, directions = _lines(tool)
    mean = cut.mean()[np.ix_(directions, directions)]
    eigenvalues = np.linalg.eigvals(response @ mean)
    speeds = np.atleast_1d(np.asarray(spindle_speeds, float))
    periods = np.array([cut.period(float(speed)) for speed in speeds])
    depth, chatter = np.full(speeds.size, np.nan), np.full(speeds.size, np.nan)
    least = np.inf
    for branch in _tracked(eigenvalues).T:
        # An eigenvalue may be 0: modes that all lie in one direction.
        with np.errstate(all="ignore"):
            L = -1.0 / branch
            a = np.where(L.real > 0.0, np.abs(L) ** 2 / (2.0 * L.real), np.nan)
            turn = -np.angle(1.0 - L / a)
        if np.all(np.isnan(a)):
            continue
        least = min(least, float(np.nanmin(a)))
        for i, period in enumerate(periods):
            # whole waves between two teeth: where ωτ - turn crosses a multiple of 2π
            phase = (2.0 * np.pi * frequency * period - turn) / (2.0 * np.pi)
            phase = phase - np.round(phase)
            # the jump of the rounded phase from 0.5 to -0.5 changes the sign, too, and is no crossing
            there = (phase[:-1] * phase[1:] <= 0.0) & (np.abs(phase[:-1] - phase[1:]) < 0.5)
            places = np.flatnonzero(there & np.isfinite(phase[:-1]) & np.isfinite(phase[1:]))
            for k in places:
                share = phase[k] / (phase[k] - phase[k + 1]) if phase[k] != phase[k + 1] else 0.0
                limit = float(a[k] + share * (a[k + 1] - a[k]))
                if not limit >= depth[i]:
                    depth[i], chatter[i] = limit, float(frequency[k] + share * (frequency[k + 1] - frequency[k]))
    return ZeroOrder(speeds, depth, chatter, least)


def _lines(tool: Any) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return frequencies in Hz, responses (n, q, q) in m/N and their directions."""
    if isinstance(tool, ToolPoint):
        poles = np.linalg.eigvals(tool.A)
        sizes = np.abs(poles) / (2.0 * np.pi)
        lines = [np.geomspace(0.02 * sizes.min(), 4.0 * sizes.max(), _RESPONSE_LINES)]
        for pole in poles[poles.imag > 0.0]:
            width, middle = abs(pole.real) / (2.0 * np.pi), pole.imag / (2.0 * np.pi)
            # a resonance changes over its half width: most lines lie within a few of them, and the outermost 548 away
            lines.append(middle + width * np.sinh(np.linspace(-7.0, 7.0, _RESPONSE_LINES)))
        frequency = np.unique(np.concatenate(lines))
        frequency = frequency[frequency > 0.0]
        kept = tool.directions()
        return frequency, tool.response(frequency)[np.ix_(range(frequency.size), kept, kept)], kept
    responses: list[Any] = [tool] if isinstance(tool, FRF) else list(tool)
    if not responses or len(responses) > 2 or not all(isinstance(part, FRF) for part in responses):
        raise ParameterError("zero_order takes a ToolPoint, an FRF along the feed, or a pair of FRFs: feed and normal")
    for measured in responses:
        if measured.unit not in ("", "m/N"):
            raise ParameterError(
                f"the response from {measured.input} to {measured.output} is in {measured.unit}: the lobes need m/N, "
                f"the position of the tool over a force on it"
            )
        if not np.array_equal(measured.frequency, responses[0].frequency):
            raise ParameterError("the responses along feed and normal must have the same frequencies")
    response = np.zeros((responses[0].frequency.size, len(responses), len(responses)), complex)
    for i, frf in enumerate(responses):
        response[:, i, i] = frf.response
    return responses[0].frequency, response, list(range(len(responses)))


def _tracked(eigenvalues: np.ndarray) -> np.ndarray:
    """Reorder eigenvalues so that each is continuous from line to line."""
    if eigenvalues.shape[1] == 1:
        return eigenvalues
    tracked = eigenvalues.copy()
    for k in range(1, len(tracked)):
        straight = np.abs(tracked[k] - tracked[k - 1]).sum()
        if np.abs(tracked[k, ::-1] - tracked[k - 1]).sum() < straight:
            tracked[k] = tracked[k, ::-1]
    return tracked


def semi_discretisation(
    tool: ToolPoint, cutter: Any, speed: float, depth: float, *, steps: int = 40, order: int = 1
) -> np.ndarray:
    """Return all multipliers µ of a cut by semi-discretization, the largest first, for a speed in rpm and an axial
    depth in m.

    The tooth period is divided into `steps`.  In each step the coefficients are averaged, and the delayed displacement
    is replaced by the mean of its values at both ends (order 0) or by a line between them (order 1).  The error is
    inversely proportional to steps²; with the usual 40 the error of |µ| is 6 % if a mode oscillates 5 times between two
    teeth, and an error of 2e-4 requires ω τ / steps <= 0.05.
    As in the source, only straight edges without process damping are supported; others raise ParameterError.
    Source: Insperger & Stépán 2002 and 2004, Semi-discretization method for delayed systems.
    """
    cut: Regeneration = regeneration(cutter)
    if cut.lag or cut.process_damping or order not in (0, 1) or steps < 2:
        raise ParameterError(
            "semi_discretisation is for straight edges without process damping, order 0 or 1 and 2 steps or more: take "
            "stability_lobes for all else"
        )
    # Deferred: commands that only read files do not need it.
    from scipy.linalg import expm

    A, B, C = tool.moving()
    d, q = A.shape[0], B.shape[1]
    h = cut.period(speed) / steps
    width = d + steps * q
    state, past = np.eye(d, width), [np.eye(q, width, d + k * q) for k in range(steps)]  # the newest first
    directions = np.ix_(tool.directions(), tool.directions())
    for i in range(steps):
        H = cut.averaged(i / steps * cut.pitch, (i + 1) / steps * cut.pitch)[directions]
        # y' = (A - a B H C) y + a B H (u0 + (u1 - u0) t/h): the exponential with the line as two more rows of states
        whole = np.zeros((d + 2 * q, d + 2 * q))
        whole[:d, :d], whole[:d, d : d + q] = A - depth * B @ H @ C, depth * B @ H
        whole[d : d + q, d + q :] = np.eye(q) / h
        moved = expm(whole * h)
        level, ramp = moved[:d, d : d + q], moved[:d, d + q :]
        first, second = (level - ramp, ramp) if order else (0.5 * level, 0.5 * level)
        past.insert(0, C @ state)
        state = moved[:d, :d] @ state + first @ past[steps] + second @ past[steps - 1]
        past.pop()
    multipliers = np.linalg.eigvals(np.vstack([state, *past]))
    return multipliers[np.argsort(-np.abs(multipliers), kind="stable")]


Dynamics: TypeAlias = "ToolPoint | Loop | Machine | StateSpace"

_RATIO = 1.15  # from depth to depth of the scan for the first border
_CHUNK = 6  # depths at a time
_BEGIN = 0.5  # of the least zero-order limit: where the scan begins
_LOWER = 0.01  # of that, if the cut is already unstable there
_REACH = 12.0  # of the least zero-order limit: default end of the scan
_DIGITS = 1e-10  # relative accuracy of a limit
POCKETS = 5  # pockets in a table


@dataclass(frozen=True, eq=False, repr=False)
class CutStability(Result):
    """The stability of one cut: the largest multiplier µ over a tooth at `speed` (rpm) and axial `depth` (m).

    limit       lowest axial depth in m at which chatter begins at this speed; infinite: none up to `deepest`
    frequency   frequency of the dominant vibration at the limit, or at `depth` if there is no limit, Hz
    """

    speed: float
    depth: float
    multiplier: complex
    limit: float
    limit_multiplier: complex
    frequency: float
    deepest: float

    @property
    def growth(self) -> float:
        """The growth factor |µ| of a vibration per tooth; below 1 it decays."""
        return abs(self.multiplier)

    @property
    def stable(self) -> bool:
        """True if all vibrations decay."""
        return self.growth < 1.0

    @property
    def kind(self) -> str:
        """The bifurcation at the limit: "hopf", quasi-periodic chatter; "flip", period doubling; or "none"."""
        return kind_of(self.limit_multiplier) if np.isfinite(self.limit) else "none"

    def sentence(self) -> str:
        """Return the verdict as a sentence."""
        at = Text(f"at {Quantity(self.speed, 'rpm'):6} and {Quantity(self.depth, 'm'):mm}")
        behavior = "does not chatter" if self.stable else Text(f"chatters at {Quantity(self.frequency, 'Hz')}")
        limit = (
            Text(f"the limit there is {Quantity(self.limit, 'm'):mm} ({self.kind}, {Quantity(self.frequency, 'Hz')})")
            if np.isfinite(self.limit)
            else Text(f"no limit was found up to {Quantity(self.deepest, 'm'):mm}")
        )
        growth = Quantity(self.growth)
        return Text(f"{at} the cut {behavior}: a vibration is multiplied by {growth} from tooth to tooth; {limit}")

    def table(self) -> Table:
        """Return a table of the figures, with the verdict as its title."""
        limit = self.limit if np.isfinite(self.limit) else _over(self.deepest)
        columns = [_SPEED, Column("depth", "m", "4 mm"), Column("|mu|", "", "5"), _LIMIT, "kind", _CHATTER]
        row = [self.speed, self.depth, self.growth, limit, self.kind, self.frequency]
        return Table(self.sentence(), columns, [row])


@dataclass(frozen=True, eq=False, repr=False)
class Lobes(Result):
    """The largest axial depth in m without chatter, by spindle speed in rpm; all arrays of shape (n,).

    depth       infinite where no limit was found up to `deepest`
    frequency   chatter frequency at the limit, Hz; NaN if there is no limit
    multiplier  µ at the limit: -1 for a flip bifurcation, another number of magnitude 1 for a Hopf bifurcation
    islands     stable ranges above the limit: speed in rpm, lower and upper depth in m; searched on request only
    natural     natural frequencies of the tool point that can resonate with the teeth, Hz
    own         the current cut of the machine, if stated
    missed      error of the linear model, relative to its largest compliance (see `ToolPoint`)
    """

    spindle_speed: np.ndarray
    depth: np.ndarray
    frequency: np.ndarray
    multiplier: np.ndarray
    deepest: float
    teeth: int
    natural: np.ndarray
    islands: tuple[tuple[float, float, float], ...] = ()
    own: CutStability | None = None
    missed: float = 0.0

    @property
    def flip(self) -> np.ndarray:
        """True where the stability limit is a flip (period-doubling) bifurcation."""
        return np.array([kind_of(m) == "flip" for m in self.multiplier]) & np.isfinite(self.depth)

    def pockets(self, count: int = POCKETS) -> list[int]:
        """Return the indices of the speeds at local maxima of the limit, the highest first."""
        depth = np.where(np.isfinite(self.depth), self.depth, self.deepest)
        around = np.concatenate([[-np.inf], depth, [-np.inf]])
        peaks = np.flatnonzero((depth >= around[:-2]) & (depth > around[2:]))
        return [int(i) for i in peaks[np.argsort(-depth[peaks], kind="stable")][:count]]

    def passing(self) -> list[tuple[float, float, int]]:
        """Return the resonant speeds in the range, one tooth per k periods of a mode, f·60/(k teeth): rpm, Hz and k."""
        low, high = float(self.spindle_speed.min()), float(self.spindle_speed.max())
        passing_speeds: list[tuple[float, float, int]] = []
        for f in self.natural:
            for k in range(1, 1 + int(60.0 * f / (self.teeth * low))):
                speed = 60.0 * f / (k * self.teeth)
                if low <= speed <= high:
                    passing_speeds.append((speed, float(f), k))
        return sorted(passing_speeds)

    def sentence(self) -> str:
        """Return the lowest limit and the best pocket as a sentence."""
        i, best = int(np.argmin(self.depth)), self.pockets(1)[0]
        if not np.isfinite(self.depth[i]):
            return Text(f"no chatter up to {Quantity(self.deepest, 'm'):mm} at any of these speeds")
        limited = bool(np.isfinite(self.depth[best]))
        highest = Text(f"{'' if limited else 'over '}{Quantity(self.depth[best] if limited else self.deepest, 'm'):mm}")
        return Text(
            f"the cut is free of chatter up to {Quantity(self.depth[i], 'm'):mm} at every one of these speeds (least "
            f"at {Quantity(self.spindle_speed[i], 'rpm'):6}); at {Quantity(self.spindle_speed[best], 'rpm'):6} up to "
            f"{highest}"
        )

    def table(self) -> Table:
        """Return a table of the best pockets and the lowest limit."""
        rows: list[list[float | str | None]] = []
        least = int(np.argmin(self.depth))
        for i in [*(pocket for pocket in self.pockets() if pocket != least), least]:
            speed, limited = float(self.spindle_speed[i]), bool(np.isfinite(self.depth[i]))
            rows.append(
                [
                    Text(f"{Quantity(speed, 'rpm', bare=True):6} (least)") if i == least else speed,
                    float(self.depth[i]) if limited else _over(self.deepest),
                    kind_of(self.multiplier[i]) if limited else "none",
                    float(self.frequency[i]) if limited else None,
                ]
            )
        return Table(self.sentence(), [_SPEED, _LIMIT, "kind", _CHATTER], rows)


_SPEED, _LIMIT, _CHATTER = Column("speed", "rpm", "6"), Column("limit", "m", "5 mm"), Column("chatter", "Hz", "5")


def _over(deepest: float) -> str:
    """Return the table entry for a limit above the largest depth that was searched."""
    return Text(f"over {Quantity(deepest, 'm', bare=True):mm}")


def kind_of(multiplier: complex) -> str:
    """Return the type of bifurcation: "flip" for negative real µ, "fold" for positive real µ, otherwise "hopf"."""
    if abs(multiplier.imag) > 1e-6 * abs(multiplier):
        return "hopf"
    return "flip" if multiplier.real < 0.0 else "fold"


def stability_lobes(
    tool: Dynamics | Any,
    cutter: Any,
    spindle_speeds: Sequence[float] | np.ndarray,
    *,
    deepest: float | None = None,
    islands: bool = False,
    speed: float | None = None,
    depth: float | None = None,
    progress: Progress | None = None,
    **changes: float,
) -> Lobes:
    """Compute the stability limits of a milling cut over spindle speeds in rpm, exactly for a linear tool point.

    tool      modes (`tool_modes`), or a loop, machine or sampled model, which `tool_point` converts
    cutter    a tool of `feeddrive.blocks`, or a `Regeneration`; `changes` such as process_damping = 2e4 replace fields
    deepest   axial depth in m up to which a limit is searched for; default: 12 times the lowest zero-order limit
    islands   True to search for stable ranges above the limit as well, up to `deepest`
    speed, depth   spindle speed and axial depth of the machine's current cut, in rpm and m; its |µ| is reported

    The method is that of `ToothPassage`. The first depth with |µ| = 1 is bracketed by a scan from below in steps of 15
    % and refined to a relative accuracy of 1e-10.
    Raises UnstableError for a tool point that is unstable without a cut, ParameterError for a measured response, for
    speeds that are not above 0, and the errors of `ToothPassage`.
    """
    point, cut = as_tool_point(tool), regeneration(cutter, **changes)
    speeds = np.atleast_1d(np.asarray(spindle_speeds, float))
    if not speeds.size or not np.all(np.isfinite(speeds) & (speeds > 0.0)):
        raise ParameterError(
            "spindle_speeds must be one or more numbers > 0, in rpm: a spindle that stands does not mill"
        )
    first, most = _range(point, cut, deepest)
    limits_by_speed: list[tuple[float, complex, float]] = []
    ranges: list[tuple[float, float, float]] = []
    for n in speeds:
        if progress is not None:
            progress.step(Text(f"{Quantity(n, 'rpm'):6}"))
        borders = list(_borders(point, cut, float(n), first, most, every=islands))
        limits_by_speed.append(_at(ToothPassage(point, cut, float(n)), point, borders[0] if borders else np.inf))
        ends = [*borders[1:], *([most] if len(borders) % 2 == 0 and borders else [])]
        ranges += [(float(n), low, high) for low, high in zip(ends[::2], ends[1::2], strict=False)]
    limits, multipliers, frequencies = zip(*limits_by_speed, strict=True)
    own = None if speed is None or depth is None else cut_stability(point, cut, speed, depth, deepest=deepest)
    return Lobes(
        speeds,
        np.array(limits),
        np.array(frequencies),
        np.array(multipliers),
        most,
        cut.teeth,
        _natural(point),
        tuple(ranges),
        own,
        point.missed,
    )


def cut_stability(
    tool: Dynamics | Any, cutter: Any, speed: float, depth: float, *, deepest: float | None = None, **changes: float
) -> CutStability:
    """Compute |µ| of one cut at a spindle speed in rpm and an axial depth in m, and the limit at this speed.

    Raises the same errors as `stability_lobes`, and ParameterError for a depth that is not above 0.
    """
    if not (depth > 0.0 and np.isfinite(depth)):
        raise ParameterError(f"depth = {Quantity(depth, 'm'):6 SI} must be > 0: the axial depth of the cut")
    point, cut = as_tool_point(tool), regeneration(cutter, **changes)
    first, most = _range(point, cut, deepest)
    passage = ToothPassage(point, cut, speed)
    limit, at_limit, frequency = _at(passage, point, next(_borders(point, cut, speed, first, most), np.inf))
    multiplier = complex(passage.multipliers([depth])[0])
    if abs(multiplier) >= 1.0 or not np.isfinite(limit):
        frequency = passage.frequency(depth, point)
    return CutStability(speed, depth, multiplier, limit, at_limit, frequency, most)


def as_tool_point(tool: Dynamics | Any) -> ToolPoint:
    """Return the tool point of a machine, loop or tool. Raises ParameterError for a measured response."""
    if isinstance(tool, ToolPoint):
        return tool
    if isinstance(tool, FRF):
        raise ParameterError(
            "lobes need modes, not a measured response: zero_order takes it as it is; for the exact limits fit modes "
            "to it (identification.fit_modes) and give them as tool_modes(ToolMode(...), ...)"
        )
    return tool_point(tool)


def _range(point: ToolPoint, cut: Regeneration, deepest: float | None) -> tuple[float, float]:
    """Return the depths at which the scan starts and ends, m. Raises UnstableError for an unstable tool point."""
    point.moving()
    poles = np.linalg.eigvals(point.A)
    worst = poles[np.argmax(poles.real)]
    if worst.real >= 0.0:
        raise UnstableError(
            f"the tool point is unstable without any cut: a pole at {Quantity(abs(worst) / (2.0 * np.pi), 'Hz')} grows "
            f"with {Quantity(worst.real, '1/s')}; damp the mode, or close the position loop"
        )
    least = zero_order(point, cut).least
    if not np.isfinite(least):
        frequency = _natural(point)
        # Small gain: with the earlier surface in antiphase, the cut feeds back at most 2 |G| |H| a.
        size = np.abs(point.response(frequency if frequency.size else np.array([1.0]))).max()
        least = 1.0 / (2.0 * float(size) * float(np.abs(cut.mean()).max()))
    if deepest is not None and not (deepest > 0.0 and np.isfinite(deepest)):
        raise ParameterError(
            f"deepest = {Quantity(deepest, 'm'):6 SI} must be > 0: the axial depth up to which a limit is looked for"
        )
    most = _REACH * least if deepest is None else deepest
    return min(_BEGIN * least, 0.5 * most), most


def _borders(
    point: ToolPoint, cut: Regeneration, speed: float, first: float, most: float, *, every: bool = False
) -> Iterator[float]:
    """Yield the axial depths in m at which |µ| crosses 1, in ascending order: the first, or all up to `most`.

    A coarse passage is scanned in steps of _RATIO, on both sides of every flip and at maxima between steps; the limit
    is then refined with all points.
    """
    coarse, fine = ToothPassage(point, cut, speed, share=0.6), ToothPassage(point, cut, speed)

    def growth(passage: ToothPassage, depth: float) -> float:
        return float(np.log(np.abs(passage.multipliers([depth])[0])))

    def root(low: float, high: float) -> float:
        # The coarse grid brackets the root cheaply; the fine one is evaluated only next to it.
        near = _root(lambda a: growth(coarse, a), low, high, 1e-5)
        exact = fine.flips()
        exact = exact[np.abs(exact - near) < 1e-3 * near]
        if exact.size and kind_of(complex(coarse.multipliers([near])[0])) == "flip":
            return float(exact[np.argmin(np.abs(exact - near))])
        for reach in (1e-3, 0.02, 0.1):
            ends = (near * (1.0 - reach), near * (1.0 + reach))
            if growth(fine, ends[0]) * growth(fine, ends[1]) < 0.0:
                return _root(lambda a: growth(fine, a), *ends, _DIGITS)
        raise ParameterError(
            f"at {Quantity(speed, 'rpm'):6} the limit near {Quantity(near, 'm'):mm} is lost between two grids of "
            "points: leave out modes that are far above the teeth"
        )

    # Deferred: commands that only read files do not need it.
    from scipy.optimize import minimize_scalar

    # zero-order limits are no bound: in narrow down milling the exact limit may be half of them, or less
    begin = first if growth(coarse, first) < 0.0 else _LOWER * first
    # flip lobes may be narrower than any step: their depths follow from eigenvalues, and both sides of each are scanned
    flips = coarse.flips()
    steps = np.geomspace(begin, most, int(np.ceil(np.log(most / begin) / np.log(_RATIO))) + 2)
    sides = [flips * (1.0 - 1e-6), flips * (1.0 + 1e-6)]
    depths = np.unique(np.concatenate([steps, *sides]))
    depths = depths[(depths >= begin) & (depths <= most)]
    past = [(0.5 * begin, -1.0)]  # depth and growth before
    for start in range(0, depths.size, _CHUNK):
        chunk = depths[start : start + _CHUNK]
        for depth, multiplier in zip(chunk, coarse.multipliers(chunk), strict=True):
            now = float(np.log(np.abs(multiplier)))
            last, before = past[-1]
            # a lobe whose tip reaches between two steps shows as a maximum of the growth below 0
            if len(past) > 1 and before < 0.0 and now < before > past[-2][1]:
                top: Any = minimize_scalar(
                    lambda a: -growth(coarse, a),
                    bounds=(past[-2][0], float(depth)),
                    method="bounded",
                    options={"xatol": 1e-4 * last},
                )
                if top.fun < 0.0:
                    yield root(past[-2][0], float(top.x))
                    if not every:
                        return
                    yield root(float(top.x), float(depth))
            if (now >= 0.0) != (before >= 0.0):
                yield root(last, float(depth))
                if not every:
                    return
            past = [past[-1], (float(depth), now)]


def _root(growth: Callable[[float], float], low: float, high: float, digits: float) -> float:
    # Deferred: commands that only read files do not need it.
    from scipy.optimize import brentq

    root: Any = brentq(growth, low, high, xtol=digits * high, rtol=np.float64(max(digits, 1e-14)))
    return float(root)


def _at(passage: ToothPassage, point: ToolPoint, limit: float) -> tuple[float, complex, float]:
    """Return a limit with its multiplier µ and its chatter frequency."""
    if not np.isfinite(limit):
        return np.inf, complex(np.nan), np.nan
    return limit, complex(passage.multipliers([limit])[0]), passage.frequency(limit, point)


def _natural(point: ToolPoint) -> np.ndarray:
    """Return the natural frequencies of modes damped below 30 %, which can resonate with the teeth, Hz."""
    poles = np.linalg.eigvals(point.A)
    upper = poles[(poles.imag > 0.0) & (-poles.real < 0.3 * np.abs(poles))]
    return np.unique(np.round(np.abs(upper) / (2.0 * np.pi), 9))
