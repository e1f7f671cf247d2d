"""Live changes of what is exported: in a steady state without following error the force does not step."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import feeddrive as fd
from exported import LOOPS, T
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.routine import Routine
from feeddrive.loop.routine_run import run
from feeddrive.loop.routine_trace import controller_routine

FORCE, PLACE = 20.0, 0.25  # N, that acts when the loop is enabled; m, where a binary fraction is exact
SAMPLES, CHANGE, CHANGES = 120, 60, 8
# what a constant force or position asks for: limits, shares of a disturbance, the place of a table
ASKED_FOR = ("share", "limit", "safe_force", "table_start", "spacing", "most_shift", "velocity_feedforward")
EMPTY = ("linuxcnc_pid",)  # starts with empty integrals whatever force acts, and steps as LinuxCNC does
# their share rises from 0, their modes swing to the force, a force was learned over the samples, or no disturbance is
# estimated: nothing is held at rest but no force
SWINGING = (
    "cascade_ppi, plain", "cascade_ppi, recovery", "cascade_ppi, learned force", "dadsc, mode",
    "active_disturbance_rejection, 0 taylor states", "active_disturbance_rejection, hanging",
)  # fmt: skip


def held(name: str) -> fd.Loop:
    """The loop with a guard under which a force acts when it starts."""
    loop = LOOPS[name]
    assert loop.control.guard is not None
    guard = dataclasses.replace(loop.control.guard, safe_force=FORCE)
    return dataclasses.replace(loop, control=dataclasses.replace(loop.control, guard=guard))


def at_rest(routine: Routine) -> np.ndarray:
    """Inputs of an axis that rests at its setpoint."""
    there = {"enable": 1.0, **dict.fromkeys(("set_position", "reading", "reading_motor", "reading_load"), PLACE)}
    return np.tile([there.get(variable.name, 0.0) for variable in routine.inputs], (SAMPLES, 1))


def other(loop: fd.Loop, routine: Routine, random: np.random.Generator) -> dict[str, float]:
    """Other numbers of the control that it admits, from half to twice the present ones or nearer to them."""
    own = [v for v in routine.parameters if ".control." in v.path and not v.path.endswith(ASKED_FOR)]
    width = 0.7
    while True:
        factors = np.exp(random.uniform(-width, width, len(own)))
        values = {v.path: float(v.value * factor) for v, factor in zip(own, factors, strict=True)}
        try:
            tree.check_sampled(tree.vary(loop, values), T)
        except FeeddriveError:
            width *= 0.8
            continue
        return values


@pytest.mark.parametrize("name", [name for name in LOOPS if name not in (*EMPTY, *SWINGING)])
def test_the_force_of_a_steady_state_goes_on(name: str) -> None:
    """By the run that every target reproduces bit for bit."""
    loop, random = held(name), np.random.default_rng(1)
    routine = controller_routine(loop, "axis_x")
    for _ in range(CHANGES):
        force = run(routine, at_rest(routine), {CHANGE: other(loop, routine, random)})[:, 0]
        assert force[1:CHANGE] == pytest.approx(np.full(CHANGE - 1, FORCE), abs=1e-6)  # N
        assert force[CHANGE:] == pytest.approx(np.full(SAMPLES - CHANGE, FORCE), abs=1e-6)
