"""Verification of a tuned controller by methods independent of the search, including a simulation."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.loop_model import LoopModel, delay_edge, gain_edge, loop_model
from feeddrive.analysis.stability import stability
from feeddrive.analysis.stiffness import rope_snap, rope_snap_of_run
from feeddrive.blocks.families import Sensor
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.figures.of_loops import DELAY_MARGIN, GAIN_MARGIN, SENSITIVITY_PEAK, LinearLoop
from feeddrive.figures.slopes import JudgedLoop
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import Lifted
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.tuning.closed_loop import Figures
from feeddrive.tuning.criteria import Limits, judged
from feeddrive.tuning.operating_point import OperatingPoint

_DENSE = 400  # lines per decade
ROOM = 2e-3  # of a bound: tolerance for other frequency lines
_LONGEST = 400_000  # largest number of samples of a run
# time constants of the slowest motion that the run covers: e⁻¹⁰ of it is left
_DECAYS = 10.0
# share by which run and linear model may differ, since only the run has friction, counts and guard
_APART = 0.1
_RUN = "run with friction, counts and limit"
_USUAL_FORCE = 100.0  # N on the table, if the limits do not state a force


class Checked(NamedTuple):
    """One line of a proof: the check, its result (None if it could not be made), and the figures in words."""

    what: str
    holds: bool | None
    text: str


def of_measurement(loops: Sequence[Figures], limits: Limits) -> tuple[Checked, ...]:
    """Check measured loops: L must not encircle -1, and the limits must be satisfied on all frequency lines."""
    checks: list[Checked] = []
    for loop in loops:
        verdict = "-1 is not encircled" if loop.stable else "-1 is encircled"
        checks.append(
            Checked(f"{loop.point}: Nyquist", loop.stable, f"{verdict}, {loop.loop_gain.frequency.size} lines")
        )
        if loop.stable:
            what = f"{loop.point}: limits on all lines"
            checks.append(_within(what, limits, loop))
    return tuple(checks)


def of_known(point: OperatingPoint, control: Control, limits: Limits, velocity: float) -> tuple[Checked, ...]:
    """Check the controller in simulation, on an axis model that agrees with a measured axis (`known_as`).

    The poles of that loop are checked, and a simulation with friction, encoder counts and force limit. The limits apply
    to the measurement and are not checked here, since the model agrees with the measurement only approximately.
    """
    if point.known_as is None:
        reason = (
            "no loop is known that agrees with the response: give the machine file that identify writes as --baseline"
        )
        return (Checked(f"{point.name}: {_RUN}", None, reason),)
    loop, name = replace(point.known_as, control=control), f"{point.name}, on the baseline's axis"
    poles = stability(loop, velocity=velocity)
    checks = [Checked(f"{name}: poles", poles.stable, f"largest |z| {Quantity(poles.growth):.6f}")]
    if poles.stable:
        checks.append(_run(name, loop, loop_model(loop, velocity=velocity), limits, velocity, poles.time_constant))
    return tuple(checks)


def _within(what: str, limits: Limits, loop: JudgedLoop) -> Checked:
    """Check all limits in one line of the proof, which always states Ms."""
    judgments = judged(limits, loop, ROOM)
    texts = [verdict.text for verdict in judgments if verdict.figure != SENSITIVITY_PEAK]
    peak = f"{SENSITIVITY_PEAK.title} {SENSITIVITY_PEAK.quantity(SENSITIVITY_PEAK.read(loop))}"
    return Checked(what, all(verdict.keeps for verdict in judgments), joined(", ", [peak, *texts]))


def of_model(name: str, loop: Loop, limits: Limits, velocity: float) -> tuple[Checked, ...]:
    """Check a loop whose axis is a model.

    The checks are the poles of the whole loop, the limits on frequency lines other than those of the search, and a
    simulation with friction, encoder counts and force limit.
    """
    poles = stability(loop, velocity=velocity)
    checks = [Checked(f"{name}: poles", poles.stable, f"largest |z| {Quantity(poles.growth):.6f}")]
    if not poles.stable:
        return tuple(checks)
    both = loop_model(loop, velocity=velocity)
    dense = LinearLoop(loop, velocity, both, _DENSE, 0.0, limits.reading_noise)
    checks.append(_within(f"{name}: limits on {dense.lines.size} other lines", limits, dense))
    if isinstance(both.open, Lifted):
        checks.append(_of_two_rates(name, both.open, limits))
    checks.append(_run(name, loop, both, limits, velocity, poles.time_constant))
    return tuple(checks)


def _of_two_rates(name: str, model: Lifted, limits: Limits) -> Checked:
    """Check gain margin and delay margin of a multirate loop by its poles over one period.

    Unlike a frequency response, the poles are exact for a multirate loop, in which a sine produces several frequencies.
    """
    gain, delay = gain_edge(model), delay_edge(model)
    least = 10.0 ** ((limits.bound(GAIN_MARGIN) or 0.0) * (1.0 - ROOM) / 20.0)
    later = limits.bound(DELAY_MARGIN)
    # the poles give the delay margin in whole samples only
    keeps = (gain is None or gain >= least) and (delay is None or later is None or delay >= math.floor(later))
    rises = "at will" if gain is None else Text(f"by {Quantity(20.0 * math.log10(gain), 'dB')}")
    longer = "however long" if delay is None else f"{delay} to {delay + 1} samples"
    N, T = len(model.samples), model.sample_time
    what = Text(f"{name}: both rates, {Quantity(T, 's'):6} and {Quantity(N * T, 's'):6}")
    return Checked(what, keeps, f"until the edge by poles over {N} samples: gain {rises}, dead time {longer} more")


def _run(name: str, loop: Loop, both: LoopModel, limits: Limits, velocity: float, slowest: float | None) -> Checked:
    """Simulate the loop with a force step on the table of a sliding axis, with friction, guard and force limit.

    The response is the difference of two runs, with and without the force step. Both are made without encoder
    quantization and noise, which would differ between them. A third run includes quantization and noise; it must
    neither trip the guard nor request a force above the limit.

    If the motor encoder is the only one, the response of the motor is evaluated: the table keeps an offset equal to the
    deflection of the spring under the force.
    """
    what, T = f"{name}: {_RUN}", float(loop.sample_time)
    place = "motor" if loop.axis.encoder_load is None else "load"
    if place == "motor":
        both = loop_model(loop, velocity=velocity, position="position_motor")
    expected = rope_snap(both.closed, f"position_{place}")
    settle = 1 if slowest is None else math.ceil(_DECAYS * slowest / T) + 1
    if not math.isfinite(expected):
        return Checked(what, None, "without integral action an offset remains")
    if 2 * settle > _LONGEST:
        return Checked(what, None, f"it would take {2 * settle} samples")
    period = loop.control.law.period()
    # the force starts at the beginning of a period, as in the model
    settle += -settle % period
    t = np.arange(2 * settle) * T
    slide = Recorded(position=velocity * t, velocity=np.full(t.size, velocity), sample_time=T)
    limit = loop.control.force_limit
    # without a stated force, one that leaves the command far from its limit
    force = limits.snap_force or (_USUAL_FORCE if limit is None else min(_USUAL_FORCE, 0.02 * limit))
    guard = loop.control.guard
    # the ends of the travel, and how fast the axis may go, are not part of a tuning: it slides as its model was made
    if guard is not None:
        guard = replace(guard, travel_least=None, travel_most=None, velocity_limit=None)
    free = replace(loop, control=replace(loop.control, guard=guard))
    axis = free.axis
    smooth = replace(
        free,
        axis=replace(axis, encoder_motor=_smooth(axis.encoder_motor), encoder_load=_smooth(axis.encoder_load)),
    )
    step, position = StepForce(force=force, start=settle * T), f"position_{place}"
    try:
        runs = [
            simulate(version, slide, load=load, start=(0.0, velocity), record=[position, "requested", "trip"])
            for version, load in ((free, step), (smooth, step), (smooth, StepForce(force=0.0)))
        ]
    except FeeddriveError as error:
        return Checked(what, False, Text(f"{error}"))
    tripped = np.flatnonzero(runs[0]["trip"])
    if tripped.size:
        late = float(tripped[0] - settle) * T
        when = (
            f"{Quantity(late, 's')} after the force"
            if late >= 0.0
            else "already before the force, as the axis moves off"
        )
        return Checked(what, False, f"the guard trips {when}")
    largest = float(np.max(np.abs(runs[0]["requested"][settle:])))
    if limit is not None and largest > limit:
        return Checked(
            what,
            False,
            Text(
                f"{Quantity(force, 'N'):6} on the table need {Quantity(largest, 'N')}, the limit is "
                f"{Quantity(limit, 'N'):6}"
            ),
        )
    # the difference removes the sliding motion, and what friction does as the axis moves off
    moved = runs[1][position] - runs[2][position]
    got = rope_snap_of_run(moved, force, T)
    off = got / expected - 1.0
    noise = float(np.std(runs[0]["requested"][settle // 2 : settle]))
    summary = Text(
        f"{Quantity(force, 'N'):6}: rope snap{' of the motor' if place == 'motor' else ''} {Quantity(got, 'm √s/N')}, "
        f"{Quantity(abs(off), 'share'):.1f} off; the "
        f"command swings by {Quantity(noise, 'N'):3} RMS, at most {Quantity(largest, 'N')}"
    )
    return Checked(what, abs(off) <= _APART, summary)


def _smooth(encoder: Sensor | None) -> Sensor | None:
    """Return the encoder without quantization, noise and jitter."""
    return replace(encoder, resolution=None, noise=None, jitter=None) if isinstance(encoder, Encoder) else encoder
