"""The proof of a tuning: its figures computed anew in other ways, and a run of the loop itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from feeddrive.analysis.margins import margins
from feeddrive.analysis.opened import opened
from feeddrive.analysis.recovery import rope_snap_of_lines
from feeddrive.analysis.stability import stability
from feeddrive.blocks.families import Sensor
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.linearize import compliance, loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.tuning.robustness import Judge, Robustness
from feeddrive.tuning.tuned import Checked

_DENSE = 600  # lines a decade
_LONGEST = 400_000  # samples of a run that proves
_DECAYS = 10.0  # time constants of the slowest motion that the run covers: e^-20 of the squares is left out


def proven(
    loop: Loop,
    found: Robustness,
    admits: Callable[[Robustness], bool],
    judge: Judge,
    best: np.ndarray,
    velocity: float,
) -> tuple[Checked, ...]:
    """Poles, margins, rope-snap error by lines and by a run, and the neighborhood of the optimum."""
    poles = stability(loop, velocity=velocity)
    lines = opened(loop, velocity=velocity).lines(_DENSE)
    dense = margins(loop_gain(loop, lines, velocity=velocity))
    delay = math.inf if dense.delay_margin_samples is None else dense.delay_margin_samples
    anew = found._replace(sensitivity_peak=dense.sensitivity_peak, delay_margin_samples=delay, growth=poles.growth)
    said = f"Ms {dense.sensitivity_peak:.4f}, delay margin {delay:.3f} samples on {lines.size} lines"
    by_lines = rope_snap_of_lines(lines, compliance(loop, lines, velocity=velocity).response, loop.sample_time)
    return (
        Checked("poles", poles.stable, f"largest |z| {poles.growth:.6f}"),
        Checked("margins on dense lines", admits(anew), said),
        _compared("rope snap by frequency", found.rope_snap, by_lines, 0.01),
        _run(loop, found, velocity, poles.time_constant),
        _neighbors(judge, admits, best),
    )


def _compared(what: str, expected: float, got: float, tolerance: float) -> Checked:
    off = got / expected - 1.0
    return Checked(what, abs(off) <= tolerance, f"{got:.4g}, {100.0 * off:+.2f} %")


def _neighbors(judge: Judge, admits: Callable[[Robustness], bool], best: np.ndarray) -> Checked:
    """No admissible neighbor at 2 % of each knob is better by more than a thousandth."""
    here = judge(best).rope_snap
    steps = 0.02 * np.eye(best.size)
    around = [judge(best + step) for step in (*steps, *-steps)]
    inside = [found.rope_snap / here - 1.0 for found in around if admits(found)]
    least = min(inside, default=0.0)
    return Checked(
        "no better neighbor", least > -1e-3, f"{len(inside)} of {len(around)} admissible, best {100.0 * least:+.3f} %"
    )


def _run(loop: Loop, found: Robustness, velocity: float, slowest: float | None) -> Checked:
    """A force switched on while the axis slides: the loop itself, with its friction, against its model.

    Without counts and noise, which two runs do not share and a slow law adds up over its whole tail.
    """
    what, T = "rope snap in a run", float(loop.sample_time)
    settle = 1 if slowest is None else math.ceil(_DECAYS * slowest / T) + 1
    count = 2 * settle  # what the start of the slide excites must have died out first
    if not math.isfinite(found.rope_snap):
        return Checked(what, None, "no integral action")
    if count > _LONGEST:
        return Checked(what, None, f"it would take {count} samples")
    # two runs alike but for the force: what they differ by is the answer to the force alone
    t = np.arange(count) * T
    slide = Recorded(position=velocity * t, velocity=np.full(count, velocity), sample_time=T)
    limit = loop.control.force_limit
    force = 100.0 if limit is None else 0.01 * limit
    axis = replace(
        loop.axis, encoder_motor=_smooth(loop.axis.encoder_motor), encoder_load=_smooth(loop.axis.encoder_load)
    )
    free = replace(loop, control=replace(loop.control, guard=None, force_limit=None), axis=axis)
    try:
        moved, still = (
            simulate(free, slide, load=load, start=(0.0, velocity), record=["position_load"])["position_load"]
            for load in (StepForce(force=force, start=settle * T), StepForce(force=0.0))
        )
    except FeeddriveError as error:
        return Checked(what, False, str(error))
    got = float(np.sqrt(T * np.sum((moved - still) ** 2))) / force
    return _compared(what, found.rope_snap, got, 0.02)


def _smooth(encoder: Sensor | None) -> Sensor | None:
    """The encoder without counts and noise."""
    return replace(encoder, resolution=None, noise=None, jitter=None) if isinstance(encoder, Encoder) else encoder
