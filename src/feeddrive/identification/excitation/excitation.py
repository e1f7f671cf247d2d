"""Design of a multisine excitation for a drive, with the simulated response of the axis."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from feeddrive.analysis.stability import require_stable
from feeddrive.blocks.families import Reference
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.derivatives import Derivatives, product
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.smooth_step import window
from feeddrive.identification.excitation.frequency_estimate import Record
from feeddrive.language import tree
from feeddrive.language.errors import DivergedError, ParameterError
from feeddrive.language.quantity import Quantity, span, unit_name
from feeddrive.language.table import Cell, Result, Table
from feeddrive.language.text import Text
from feeddrive.language.units import turning
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

# A designed excitation: the signal to send to the drive, and the simulated response of the axis to it.

OUTPUTS = {"reading_load": "m", "reading_motor": "m"}
_TRIALS = 5  # simulations to find an amplitude that keeps the limits
# times the limit: an amplitude that keeps such a limit is too small to measure with
_HOPELESS = 100.0


def readable(value: float, unit: str) -> Quantity:
    """Return a figure in a convenient unit: lengths in um or, from 1 mm, in mm; angles in urad."""
    shown = {"m": "mm" if abs(value) >= 1e-3 else "um", "rad": "urad", "rad/s": "mrad/s"}.get(unit, "")
    return Quantity(value, unit, form=shown)


@dataclass(frozen=True)
class Limit:
    """A limit and the value reached in the simulation; `most` is None if no limit was stated."""

    what: str
    got: float
    most: float | None
    unit: str

    @property
    def holds(self) -> bool:
        """True if the limit is not exceeded, or if none was stated."""
        return self.most is None or self.got <= self.most

    def cells(self) -> list[Cell]:
        """Return the table row: name, value, limit and verdict."""
        limit = "not stated" if self.most is None else readable(self.most, self.unit)
        verdict = "–" if self.most is None else "holds" if self.holds else "BROKEN"
        return [self.what, readable(self.got, self.unit), limit, verdict]


@dataclass(frozen=True, eq=False)
class Drawing:
    """One realization of an excitation: the signal itself and the results of its simulation, all of shape (n,).

    excitation    signal added to the force command (N) or to the set position (m)
    set_position  set position of the underlying motion, without excitation, m
    signals       `set_position`, `force` (excitation and command together), readings and velocities, as simulated
    """

    time: np.ndarray
    excitation: np.ndarray
    set_position: np.ndarray
    signals: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Result):
    """A multisine for a measurement, in one or several realizations, and the limits that were checked.

    loop             the axis with its controller, for which the excitation was designed and simulated
    where            "force" (added to the command, N) or "setpoint" (added to the set position, m)
    period           samples per period; `periods` whole periods in steady state, with `fade` samples of fade-in before
                     and fade-out after them
    first            sample at which the first whole period begins
    offset_velocity  velocity of the underlying motion, which keeps the friction in the sliding regime, m/s
    least_velocity   smallest velocity in the direction of the underlying motion, m/s; negative if the axis reversed
    """

    name: str
    loop: Loop
    where: str
    amplitude: float
    crest: float
    period: int
    periods: int
    fade: int
    first: int
    lines: np.ndarray
    grid: str
    offset_velocity: float
    least_velocity: float
    drawings: tuple[Drawing, ...]
    limits: tuple[Limit, ...]
    remarks: tuple[str, ...] = ()

    @property
    def rotary(self) -> bool:
        """True for a rotary axis: torques in N m, angles in rad."""
        return self.loop.axis.rotary

    @property
    def sample_time(self) -> float:
        """The sample time of the loop, s."""
        return float(self.loop.sample_time)

    @property
    def frequency(self) -> np.ndarray:
        """The frequencies of the excited lines, Hz."""
        return self.lines / (self.period * self.sample_time)

    @property
    def unit(self) -> str:
        """The unit of the excitation."""
        unit = "N" if self.where == "force" else "m"
        return turning(unit) if self.rotary else unit

    def records(self, output: str = "reading_load") -> list[Record]:
        """Return the simulated records, cut to whole periods; `estimate_frf` predicts the measurement from them."""
        if output not in OUTPUTS:
            raise ParameterError(f"output = {output!r} must be one of {', '.join(OUTPUTS)}")
        kept = slice(self.first, self.first + self.periods * self.period)
        return [
            Record(
                input=drawn.signals["force"][kept],
                output=drawn.signals[output][kept],
                references=(drawn.excitation[kept],),
                sample_time=self.sample_time,
                input_name="force",
                output_name=output,
                unit=f"{OUTPUTS[output]}/N",
                name=f"{self.name} {i + 1}",
            )
            for i, drawn in enumerate(self.drawings)
        ]

    def table(self) -> Table:
        """Return a table of the limits and the values reached in the simulation."""
        title = Text(
            f"{self.name}: {self.lines.size} lines {span(self.frequency[0], self.frequency[-1], 'Hz', between='..')} "
            f"on {self.where}, peak {readable(self.amplitude, self.unit)}, crest factor {Quantity(self.crest):.3f}, "
            f"{self.periods} periods of {Quantity(self.period * self.sample_time, 's'):SI}, {len(self.drawings)} "
            "realisation(s)"
        )
        return Table(title, ["in the simulation", "got", "limit", ""], [limit.cells() for limit in self.limits])


def limits(
    loop: Loop, drawings: list[Drawing], travel: float | None, speed: float | None, force: float | None
) -> list[Limit]:
    """Compare the peaks of all realizations with limits, by default with those of guard, controller and motor."""
    guard, motor = loop.control.guard, loop.axis.actuator.motor
    peak, continuous = (None, None) if motor is None else motor.limits()
    if force is None:
        stated = [float(bound) for bound in (loop.control.force_limit, peak) if bound is not None]
        force = min(stated) if stated else None
    if guard is not None:
        speed = guard.velocity_limit if speed is None else speed
        if travel is None and guard.travel_least is not None and guard.travel_most is not None:
            travel = guard.travel_most - guard.travel_least
    forces = [drawn.signals["force"] for drawn in drawings]
    speeds = [np.abs(drawn.signals[name]) for drawn in drawings for name in ("velocity_load", "velocity_motor")]
    stroke = max(float(np.ptp(drawn.signals["reading_load"])) for drawn in drawings)
    rms = max(float(np.sqrt(np.mean(signal**2))) for signal in forces)
    return [
        Limit("travel", stroke, travel, "m"),
        Limit("speed, peak", max(float(np.max(signal)) for signal in speeds), speed, "m/s"),
        Limit("force, peak", max(float(np.max(np.abs(signal))) for signal in forces), force, "N"),
        Limit("force, RMS", rms, None if continuous is None else float(continuous), "N"),
    ]


def _worst(excitation: Excitation) -> tuple[Limit, float]:
    """Return the limit that is exceeded by the largest factor, and this factor."""
    shares = {limit: limit.got / limit.most if limit.most else np.inf for limit in excitation.limits if not limit.holds}
    worst = max(shares, key=lambda limit: shares[limit])
    return worst, shares[worst]


def broken(excitation: Excitation) -> str:
    """Return the start of an error message, which states the limit exceeded most and the value reached."""
    worst, share = _worst(excitation)
    assert worst.most is not None
    got, may = readable(worst.got, worst.unit), readable(worst.most, worst.unit)
    text = Text(f"{worst.what} reaches {got} in the simulation, the limit is {may}")
    if not np.isfinite(share):
        return text
    return (
        Text(f"{text}, {Quantity((share - 1.0), 'share'):3} too much")
        if share < 3.0
        else Text(f"{text}, {Quantity(share):3} times as much")
    )


def advice(excitation: Excitation, drawn: Callable[[float], Excitation]) -> str:
    """Return a remedy for an exceeded limit: an amplitude that satisfies all limits in a simulation, or another one."""
    other = ""
    worst, share = _worst(excitation)
    # the travel grows with the duration at the offset speed: fewer periods need less of it
    if worst.what == "travel" and excitation.offset_velocity:
        fitting = int(excitation.periods / share)
        other = f"{fitting} periods" if fitting >= 2 else "a smaller offset velocity"
    tried = excitation
    for _ in range(_TRIALS):
        _, share = _worst(tried)
        if share > _HOPELESS:
            break
        # 2 % in reserve: because of friction the peaks are not proportional to the amplitude
        tried = drawn(0.98 * tried.amplitude / share)
        if all(limit.holds for limit in tried.limits):
            keeps = Text(f"an amplitude of {readable(tried.amplitude, excitation.unit)} keeps it")
            return Text(f"{keeps}, or {other}") if other else keeps
    return f"take {other}" if other else "no amplitude keeps it; check the underlying motion and the limits"


# Design of a multisine for an axis: lines, phases and the motion underneath, checked in a simulation.

WHERE = ("force", "setpoint")
FLAT = ("position", "velocity", "acceleration")
_CLEAR = 1.5  # offset speed over the peak of the excited speed
# at three Stribeck velocities at most 5 % (e⁻³) of the extra level of friction is left
_SLIDING = 3.0
# half of the time, s, in which the underlying motion reaches its speed
_RAMP = 0.15
_LONGEST_FADE = 0.25  # s
# of the periods of one realization: some 1 GB while it is simulated
_MOST_SAMPLES = 4_000_000
_RECORD = ("force", "set_position", "reading_load", "reading_motor", "velocity_load", "velocity_motor", "trip")
GRIDS = ("full", "odd", "random_odd", "odd_odd")
_GROUP = 4  # odd lines of which a random one stays empty
_CLIPPINGS = 300
_OVERSAMPLING = 4  # grid points per sample of the highest line, for peaks between the samples


class _Timeline(NamedTuple):
    """The durations, in samples, of run-up and stop (`ramp`), fade-in and fade-out (`fade`), and one period."""

    ramp: int
    fade: int
    period: int
    periods: int

    @property
    def first(self) -> int:
        return self.ramp + self.fade

    @property
    def moving(self) -> int:
        return 2 * self.fade + self.periods * self.period

    @property
    def samples(self) -> int:
        return 2 * self.ramp + self.moving + 1


def design_excitation(
    loop: Loop,
    *,
    band: tuple[float, float],
    amplitude: float,
    where: str = "force",
    resolution: float = 1.0,
    periods: int = 8,
    realisations: int = 1,
    grid: str = "random_odd",
    flat: str = "acceleration",
    offset_velocity: float | None = None,
    travel: float | None = None,
    speed: float | None = None,
    force: float | None = None,
    seed: int = 0,
    name: str = "excitation",
    advised: bool = True,
) -> Excitation:
    """Design a multisine, and check by simulating the whole loop that travel, speed and force stay within limits.

        x(t) = Σ aₖ cos(2π k t/period + φₖ),   max |x| = amplitude,   φ: low-crest phases

    band             lowest and highest frequency, Hz; lines are the multiples of the resolution within this band
    amplitude        peak, N (force) or m (setpoint)
    where            "force": added to the command after the controller's limit; "setpoint": to the set position
    resolution       inverse of the period, Hz; the period is rounded to whole samples
    periods          number of periods in steady state, in addition to fade-in and fade-out of at most 0.25 s each
    realisations     number of realizations with different phases: two or more separate nonlinear distortion from
                     noise on every line
    grid             pattern of excited lines, see `grid_lines`
    flat             for a setpoint: the signal that has equal amplitudes on all lines, such as the acceleration
    offset_velocity  velocity of the underlying motion, which keeps the axis from sticking, m/s; 0: no such motion;
                     default: 1.5 times the peak speed of the linear model, or this peak speed plus three Stribeck
                     velocities if that is larger. Every second realization moves in the opposite direction
    travel, speed, force   limits in m, m/s, N; default: those of the guard, the controller and the motor
    seed             random seed of grid, phases and the noise of the encoders
    advised          False for a caller that tries other amplitudes itself: to search an admissible one takes longer
                     than the design

    Raises ParameterError for an exceeded limit (the message gives an admissible amplitude or number of periods), for a
    band beyond Nyquist, for periods with more than four million samples in total, and for a loop that trips or
    diverges; UnstableError for a loop that is unstable without excitation.
    """
    _check(loop, band, amplitude, where, resolution, periods, realisations, flat)
    require_stable(loop)

    def drawn(height: float) -> Excitation:
        return _drawn(
            loop,
            band,
            height,
            where,
            resolution,
            periods,
            realisations,
            grid,
            flat,
            offset_velocity,
            (travel, speed, force),
            seed,
            name,
        )

    excitation = drawn(amplitude)
    if all(limit.holds for limit in excitation.limits):
        return excitation
    raise ParameterError(f"{broken(excitation)}: {advice(excitation, drawn) if advised else 'take a smaller one'}")


def _drawn(
    loop: Loop,
    band: tuple[float, float],
    amplitude: float,
    where: str,
    resolution: float,
    periods: int,
    realisations: int,
    grid: str,
    flat: str,
    offset_velocity: float | None,
    stated: tuple[float | None, float | None, float | None],
    seed: int,
    name: str,
) -> Excitation:
    """Return the excitation with its simulations, even if limits are exceeded."""
    T = float(loop.sample_time)
    period = max(round(1.0 / (resolution * T)), 16)
    lines = grid_lines(*band, period * T, grid, seed)
    powers = FLAT.index(flat) if where == "setpoint" else 0
    sizes = (lines / lines[0]) ** -float(powers)
    phases = _phases(lines, sizes, realisations, seed)
    waves = [_scaled(lines, sizes, start_phases, amplitude) for start_phases in phases]
    offset = _offset(loop, where, lines, sizes, phases, waves, period) if offset_velocity is None else offset_velocity
    fade = int(min(period, max(round(_LONGEST_FADE / T), 1)))
    times = _Timeline(max(round(2.0 * _RAMP / T), 1) if offset else 0, fade, period, periods)
    drawings: list[Drawing] = []
    for i, (phase, scale) in enumerate(zip(phases, waves, strict=True)):
        # there and back, so that two realizations need the travel of one
        way = offset if i % 2 == 0 else -offset
        drawings.append(_simulated(loop, where, times, lines, scale * sizes, phase, way, seed + i))
    kept = slice(times.first, times.first + periods * period)
    crest = max(crest_factor(drawing.excitation[kept]) for drawing in drawings)
    least = _least(drawings, kept)
    checked = limits(loop, drawings, *stated)
    remarks: list[str] = []
    if least <= 0.0:
        remarks.append(
            "the axis turns round or stands still during the measurement: friction sticks, and the response is "
            "partly that of the stuck axis; give a larger offset velocity"
        )
    return Excitation(
        name,
        loop,
        where,
        amplitude,
        crest,
        period,
        periods,
        fade,
        times.first,
        lines,
        grid,
        offset,
        least,
        tuple(drawings),
        tuple(checked),
        tuple(remarks),
    )


def _check(
    loop: Loop,
    band: tuple[float, float],
    amplitude: float,
    where: str,
    resolution: float,
    periods: int,
    drawn: int,
    flat: str,
) -> None:
    nyquist = 0.5 / float(loop.sample_time)
    if not 0.0 < band[0] <= band[1] < nyquist:
        raise ParameterError(
            f"band {span(*band, 'Hz', '6', between='..')} must be above 0 Hz, rise, and end below "
            f"Nyquist, {Quantity(nyquist, 'Hz'):6}"
        )
    if where not in WHERE or flat not in FLAT:
        raise ParameterError(
            f"where = {where!r} must be one of {', '.join(WHERE)}, flat = {flat!r} of {', '.join(FLAT)}"
        )
    for name, value, unit in (
        ("amplitude", amplitude, "N" if where == "force" else "m"),
        ("resolution", resolution, "Hz"),
    ):
        if not (np.isfinite(value) and value > 0.0):
            raise ParameterError(
                f"{name} = {Quantity(value, unit):6 SI} must be finite and > 0 {unit_name(unit, 'SI')}"
            )
    if resolution > band[1]:
        raise ParameterError(
            f"resolution = {Quantity(resolution, 'Hz'):6} must be <= {Quantity(band[1], 'Hz'):6}, the upper end of the "
            "band"
        )
    if periods < 2 or drawn < 1:
        raise ParameterError(f"periods = {periods} must be >= 2 and realisations = {drawn} >= 1")
    if periods / (resolution * float(loop.sample_time)) > _MOST_SAMPLES:
        fitting = periods / (_MOST_SAMPLES * float(loop.sample_time))
        raise ParameterError(
            f"resolution = {Quantity(resolution, 'Hz'):6} asks for periods of {Quantity(1.0 / resolution, 's'):SI}, "
            f"{periods} of which are {Quantity(periods / (resolution * float(loop.sample_time))):3} samples (at most "
            f"{_MOST_SAMPLES:,}): take {Quantity(fitting, 'Hz'):3} or more, or fewer periods"
        )


def _phases(lines: np.ndarray, sizes: np.ndarray, count: int, seed: int) -> list[np.ndarray]:
    """Return phases of low crest factor for each realization, optimized from Schroeder's phases for the first
    realization and from random phases for the others.
    """
    return list(_of_low_crest(tuple(lines.tolist()), tuple(sizes.tolist()), count, seed))


# the same lines are designed for with many amplitudes
@lru_cache(maxsize=8)
def _of_low_crest(lines: tuple[int, ...], sizes: tuple[float, ...], count: int, seed: int) -> tuple[np.ndarray, ...]:
    rng, at, heights = np.random.default_rng(seed), np.array(lines), np.array(sizes)
    starts = [schroeder_phases(at, heights)]
    starts += [2.0 * np.pi * rng.random(at.size) for _ in range(count - 1)]
    found = tuple(low_crest_phases(at, heights, start) for start in starts)
    for phases in found:
        phases.flags.writeable = False
    return found


def _scaled(lines: np.ndarray, sizes: np.ndarray, phases: np.ndarray, amplitude: float) -> float:
    """Return the factor that scales the sum to the peak `amplitude`, using 16 points per period of the highest line."""
    count = int(2 ** np.ceil(np.log2(16 * (lines[-1] + 1))))
    return amplitude / float(np.max(np.abs(summed(lines, sizes, phases, count))))


def _offset(
    loop: Loop,
    where: str,
    lines: np.ndarray,
    sizes: np.ndarray,
    phases: list[np.ndarray],
    waves: list[float],
    period: int,
) -> float:
    """Return a speed at which the excited linear model neither reverses nor enters the Stribeck range."""
    source = "added_force" if where == "force" else "set_position"
    model = linearize(loop, [source], ["velocity_load", "velocity_motor"])
    frequency = lines / (period * float(loop.sample_time))
    peak = 0.0
    for output in ("velocity_load", "velocity_motor"):
        response = model.response(frequency, output).response
        for phase, scale in zip(phases, waves, strict=True):
            # four points a sample, since a peak may lie between two samples
            wave = summed(lines, scale * sizes * np.abs(response), phase + np.angle(response), 4 * period)
            peak = max(peak, float(np.max(np.abs(wave))))
    axis = loop.axis
    frictions = (axis.friction_motor, axis.friction_load)
    slow = [
        float(v) for friction in frictions for name, v in tree.leaves(friction) if name.endswith("stribeck_velocity")
    ]
    return max(_CLEAR * peak, peak + _SLIDING * max(slow, default=0.0))


def _simulated(
    loop: Loop,
    where: str,
    times: _Timeline,
    lines: np.ndarray,
    sizes: np.ndarray,
    phases: np.ndarray,
    offset: float,
    seed: int,
) -> Drawing:
    """Simulate one realization of the excitation."""
    T = float(loop.sample_time)
    t = np.arange(times.samples) * T
    under = _underneath(times, offset, T).at(t)
    tau = t - times.ramp * T
    k = np.arange(times.samples) - times.first

    # exact derivatives up to snap for the feedforward: differences of the sum would be wrong near Nyquist
    def turn(order: int) -> np.ndarray:
        return summed(lines, sizes, phases, times.period, order)[k % times.period] / (times.period * T) ** order

    turns: Derivatives = (turn(0), turn(1), turn(2), turn(3), turn(4))
    moving = times.moving * T
    swelling = window(np.clip(tau, 0.0, moving), moving, times.fade * T)
    inside = (tau >= 0.0) & (tau <= moving)
    wave = [np.where(inside, wave_row, 0.0) for wave_row in product(swelling, turns)]
    rows: list[Any] = [np.asarray(wave_row) for wave_row in under]
    added = None
    if where == "setpoint":
        rows = [row + wave_row for row, wave_row in zip(rows, wave, strict=True)]
    else:
        added = RecordedForce(force=wave[0], sample_time=T)
    names = ("position", "velocity", "acceleration", "jerk", "snap")
    reference = Recorded(**dict(zip(names, rows, strict=True)), sample_time=T)
    try:
        run = simulate(loop, reference, added_force=added, seed=seed, record=_RECORD)
    except DivergedError as error:
        raise ParameterError(f"the excited loop does not hold: {error}") from None
    tripped = np.flatnonzero(run["trip"])
    if tripped.size:
        raise ParameterError(
            f"the guard trips by {TRIPS[float(run['trip'][tripped[0]])]} at t = {Quantity(t[tripped[0]], 's'):SI} of "
            "the simulation: take less amplitude or a higher band, or widen the guard"
        )
    signals = dict(run.signals)
    del signals["trip"]
    # the excitation enters behind the control, so that its force does not contain it
    if added is not None:
        signals["force"] = signals["force"] + wave[0]
    return Drawing(t, wave[0], np.asarray(under.position), signals)


def _underneath(times: _Timeline, offset: float, T: float) -> Reference:
    """Return the underlying motion: run-up, constant speed during the excitation, and stop."""
    if offset == 0.0:
        return Recorded(position=np.zeros(times.samples), sample_time=T)
    ramp, moving = times.ramp * T, times.moving * T
    acceleration = 1.5 * abs(offset) / ramp
    # with jerk = 3 a / ramp the speed is reached after v/a + a/j = ramp
    return JerkLimitedMove(
        distance=offset * (ramp + moving),
        velocity=abs(offset),
        acceleration=acceleration,
        jerk=3.0 * acceleration / ramp,
    )


def _least(drawings: list[Drawing], kept: slice) -> float:
    """Return the smallest velocity of the motor and the load in the direction of the underlying motion."""
    least = np.inf
    for drawn in drawings:
        way = np.sign(drawn.set_position[-1] - drawn.set_position[0])
        for name in ("velocity_load", "velocity_motor"):
            least = min(least, float(np.min(way * drawn.signals[name][kept])))
    return least


def grid_lines(lowest: float, highest: float, period: float, grid: str = "random_odd", seed: int = 0) -> np.ndarray:
    """Return the indices k of the excited lines k/period in the band.

        full        all lines: largest power, no empty lines in the band
        odd         1, 3, 5 ...: even distortion is detected on the even lines
        odd_odd     1, 5, 9 ...: odd distortion is also detected, on 3, 7, 11 ...
        random_odd  odd lines, except for a random one of every four (default): both kinds of distortion are detected,
                    although most odd lines are excited

    Raises ParameterError for an unknown grid and a band without a line.
    Source: Pintelon & Schoukens 2012, section 4.3.1; Schoukens, Lataire, Pintelon & Vandersteen 2008.
    """
    if grid not in GRIDS:
        raise ParameterError(f"grid = {grid!r} must be one of {', '.join(GRIDS)}")
    if not 0.0 < lowest <= highest:
        raise ParameterError(f"band {span(lowest, highest, 'Hz', '6', between='..')} must be above 0 Hz and rise")
    # rounding must not lose a line on the edge of the band
    every = np.arange(max(1, int(np.ceil(lowest * period * (1 - 1e-12)))), int(highest * period * (1 + 1e-12)) + 1)
    if grid == "odd_odd":
        chosen = every[every % 4 == 1]
    elif grid == "full":
        chosen = every
    else:
        chosen = every[every % 2 == 1]
    if grid == "random_odd":
        groups = chosen.size // _GROUP
        out = np.arange(groups) * _GROUP + np.random.default_rng(seed).integers(0, _GROUP, groups)
        chosen = np.delete(chosen, out)
    if not chosen.size:
        raise ParameterError(
            f"no line of the grid '{grid}' lies in {span(lowest, highest, 'Hz', '6', between='..')} at a resolution of "
            f"{Quantity(1.0 / period, 'Hz'):6}: make the period longer"
        )
    return chosen


def schroeder_phases(lines: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
    """Return Schroeder's phases φₖ = -2π Σ over lines i < k of (k - i) pᵢ / d, with relative powers p (Schroeder 1970).

    d is the median spacing of frequency lines: a sum over every d-th line repeats d times per period, up to a phase
    shift, so that the sweep produced by Schroeder's phases must fit into one of these d parts.
    """
    steps = lines / (np.median(np.diff(lines)) if lines.size > 1 else 1.0)
    shares = amplitudes**2 / np.sum(amplitudes**2)
    below = np.concatenate([[0.0], np.cumsum(shares)[:-1]])
    moments = np.concatenate([[0.0], np.cumsum(shares * steps)[:-1]])
    return -2.0 * np.pi * (steps * below - moments)


def crest_factor(values: np.ndarray) -> float:
    """Return the crest factor, peak over RMS."""
    return float(np.max(np.abs(values)) / np.sqrt(np.mean(values**2)))


def low_crest_phases(lines: np.ndarray, amplitudes: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Return phases with a lower peak, by repeatedly clipping the sum and restoring its amplitudes.

    The clipping level rises from 75 to 99 % of the peak over 300 rounds; the best phases of all rounds are returned.
    The crest factor is about 1.45 for hundreds of frequency lines, where Schroeder's phases give 1.7 and random ones 3
    to 4.
    Source: Van der Ouderaa, Schoukens & Renneboog 1988.
    """
    count = int(2 ** np.ceil(np.log2(2 * _OVERSAMPLING * (lines[-1] + 1))))
    best, lowest = phases, np.inf
    for level in np.linspace(0.75, 0.99, _CLIPPINGS):
        wave = summed(lines, amplitudes, phases, count)
        peak = float(np.max(np.abs(wave)))
        if peak < lowest:
            best, lowest = phases, peak
        spectrum = np.fft.rfft(np.clip(wave, -level * peak, level * peak))
        phases = np.angle(spectrum[lines])
    return best


def summed(lines: np.ndarray, amplitudes: np.ndarray, phases: np.ndarray, count: int, order: int = 0) -> np.ndarray:
    """Return one period of Σ aₖ cos(2π k t/period + φₖ) at `count` points, or a derivative of this sum.

    order  order of the derivative with respect to t/period; 0: the sum itself
    """
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    spectrum[lines] = 0.5 * count * amplitudes * np.exp(1j * phases) * (2j * np.pi * lines) ** order
    return np.fft.irfft(spectrum, count)
