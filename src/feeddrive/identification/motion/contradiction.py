"""Inverse dynamics and closed loop on the same log: which one is taken where they contradict each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from feeddrive.identification.motion.counts import count_of, drawn
from feeddrive.identification.motion.delay import CLEAR, DelayFit
from feeddrive.identification.motion.law_check import SURE
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.output_error import Refinement, dead_time, refine
from feeddrive.identification.motion.preparation import Preparation, prepare
from feeddrive.identification.motion.rigid import RigidFit, identify_rigid
from feeddrive.language.errors import DivergedError, LogError, NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop

_RUNS = 16  # of the closed loop with its counts: one log in 17 leaves more than the worst of them by chance


def agreed(
    log: MotionLog, loop: Loop, found: Refinement, delay: DelayFit, known: float, remarks: list[str]
) -> Refinement:
    """Return the closed loop with the dead time to be taken: its own, unless the inverse dynamics speak more clearly.

    Each has a dead time that leaves it least: the inverse dynamics of the force, the closed loop of the position.
    Where they differ, and the inverse dynamics leave a tenth more of the force with that of the closed loop, the one
    is taken whose residual grows more with the dead time of the other.
    """
    own = beyond(delay, known)
    grows = delay.left(known + found.delay) / delay.left(known + own)
    if own == found.delay or grows < 1.0 / CLEAR:
        return found
    try:
        other = refine(loop, log, tuple(each.name for each in found.estimates), delays=[own])
    except DivergedError:
        return found
    left, without = other.by_delay[own], found.by_delay[found.delay]
    value, error = dead_time(other, log)
    apart = abs(delay.dead_time - known - value)
    joint = SURE * math.hypot(error, delay.error)
    first = grows > left / without
    ways = delay.left(known + own), delay.left(known + found.delay)
    remarks.append(
        Text(
            "dead time in samples beyond the stated one: the inverse dynamics say "
            f"{Quantity(delay.dead_time - known, error=delay.error)} and leave {Quantity(ways[0], 'share'):3} of the "
            f"force with {own}, {Quantity(ways[1], 'share'):3} with {found.delay}; the closed loop says "
            f"{Quantity(value, error=error)} and leaves {log.distance(left)} of the position with {own}, "
            f"{log.distance(without)} with {found.delay}. They "
            f"{'contradict each other' if apart > joint else 'agree within three errors'}; that of the "
            f"{'inverse dynamics' if first else 'closed loop'} is taken, whose residual grows more with the other one"
        )
    )
    return other if first else found


def better(
    log: MotionLog, rigid: RigidFit, found: Refinement, how: Preparation, remarks: list[str]
) -> Refinement | None:
    """Return the output-error fit, or None if its mass contradicts the inverse dynamics and they leave less force.

    Both are compared in the same rows, those of the inverse dynamics, and contradict each other beyond three joint
    standard errors.
    """
    mass = next((each for each in found.estimates if each.name.endswith("plant.mass")), None)
    own = rigid["mass"]
    if mass is None or abs(mass.value - own.value) < SURE * math.hypot(mass.error, own.error):
        return found
    rows = prepare(log, how)
    residual = log.force - found.replay.run["force"][: log.force.size]
    left = float(np.linalg.norm(rows.force_with(residual, how.delay)) / np.linalg.norm(rows.force))
    first = rigid.residuals.relative < left
    remarks.append(
        Text(
            f"the inverse dynamics say a mass of {own.quantity} and leave "
            f"{Quantity(rigid.residuals.relative, 'share'):3} of the force in motion, the closed loop says "
            f"{Quantity(mass.value, own.unit, mass.error)} and leaves {Quantity(left, 'share'):3} of it: they "
            "contradict each other, as where a force acts that the model lacks; the "
            f"{'inverse dynamics' if first else 'closed loop'}, which leave{'' if first else 's'} less, "
            f"{'are' if first else 'is'} taken"
        )
    )
    return None if first else found


def with_counts(log: MotionLog, rigid: RigidFit, found: Refinement, how: Preparation) -> RigidFit:
    """Return the inverse dynamics with what counts make of their residual, from runs of the closed loop that has them.

    Through a velocity gain coarse counts shake the axis, and its readings do not show it: more than the errors of
    readings alone make of a residual.  Runs of the fitted loop with the counts of the log leave as much, the
    worst of them, if they are the reason.
    """
    count = count_of(log.position)
    if count == 0.0:
        return rigid
    used, unused = [], []
    for position, force in drawn(found.loop, log, 0, count, _RUNS, seed=3):
        try:
            run = identify_rigid(
                MotionLog(name=log.name, position=position, force=force, sample_time=log.sample_time),
                friction=rigid.friction,
                how=how,
            )
        except (LogError, NotIdentifiableError):
            return rigid
        used.append(run.residuals.relative)
        unused.append(run.validation.relative)
    return replace(rigid, counts=(max(rigid.counts[0], *used), max(rigid.counts[1], *unused)))


def beyond(delay: DelayFit, known: float) -> int:
    """Return the whole samples of dead time beyond a known one that the inverse dynamics clearly ask for, or 0."""
    own = max(0, round(delay.dead_time - known))
    return own if delay.left(known + own) < CLEAR * delay.left(known) else 0
