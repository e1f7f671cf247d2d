"""Live changes of what is exported: in a steady state without following error the force does not step."""

from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest

import feeddrive as fd
from export.test_export_c import WHY, files, laid_out, same_bits
from exported import LOOPS
from feeddrive.blocks import GeneralizedPredictive, PolePlacement
from feeddrive.export.c_bundle import streamed
from feeddrive.export.design import Trial
from feeddrive.language import tree
from feeddrive.loop.routine import Routine, controller_routine, run
from fresh_draws import Seeded, mixed
from slow_share import all_but

FORCE, PLACE = 20.0, 0.25  # N, that acts when the loop is enabled; m, where a binary fraction is exact
SAMPLES, CHANGE, CHANGES = 100, 50, 3
# what a constant force or position asks for: limits, shares of a disturbance, the place of a table
ASKED_FOR = ("share", "limit", "safe_force", "table_start", "spacing", "most_shift", "velocity_feedforward")
# nothing is held at rest but no force: without an integral or an estimate, or with empty integrals at a start, as
# LinuxCNC has them; a share rises from 0, modes swing to the force, a learned force is one of time; and the implicit
# sliding mode holds a force by an error only
UNHELD = (
    "cascade_ppi, plain",
    "active_disturbance_rejection, 0 taylor states",
    "linuxcnc_pid",
    "cascade_ppi, recovery",
    "active_disturbance_rejection, hanging",
    "dadsc, mode",
    "cascade_ppi, learned force",
    "super_twisting, implicit",
)
HELD = [name for name in LOOPS if name not in UNHELD]
SHIFTS = {"cascade_ppi, pitch tables": -0.5e-6}  # m, by which the reading of a steady state is beside the set position


def held(name: str) -> fd.Loop:
    """The loop with a guard under which a force acts when it starts."""
    loop = LOOPS[name]
    assert loop.control.guard is not None
    guard = dataclasses.replace(loop.control.guard, safe_force=FORCE)
    return dataclasses.replace(loop, control=dataclasses.replace(loop.control, guard=guard))


def at_rest(routine: Routine, name: str) -> np.ndarray:
    """Inputs of an axis that rests at its setpoint."""
    readings = dict.fromkeys(("reading", "reading_motor", "reading_load"), PLACE + SHIFTS.get(name, 0.0))
    there = {"enable": 1.0, "set_position": PLACE, **readings}
    return np.tile([there.get(variable.name, 0.0) for variable in routine.inputs], (SAMPLES, 1))


def other(loop: fd.Loop, routine: Routine, random: np.random.Generator) -> dict[str, float]:
    """Other numbers of the control that it admits, from half to twice the present ones or nearer to them."""
    own = [v for v in routine.parameters if ".control." in v.path and not v.path.endswith(ASKED_FOR)]
    width, T = 0.7, np.float64(loop.sample_time)
    while True:
        values = {v.path: float(v.value * np.exp(random.uniform(-width, width))) for v in own}
        numbers = (values.get(tree.path_of(loop, name), value) for name, value in tree.leaves(loop))
        varied = tree.rebuild(loop, map(np.float64, numbers))
        with np.errstate(all="ignore"):
            rules = (rule for block in tree.blocks(varied) for rule in (*block.rules(), *block.sampled_rules(T)))
            if all(v.declared.admits(values[v.path]) for v in own if v.declared) and all(rule.holds for rule in rules):
                return values
        width *= 0.8


def goes_on(force: np.ndarray) -> None:
    """A twenty-thousandth: the gains of three moves of the predictive law leave the fifth digit of 20 N to rounding."""
    assert force[1:] == pytest.approx(np.full(SAMPLES - 1, FORCE), abs=1e-3)  # N


@pytest.mark.parametrize("name", HELD)
def test_the_force_of_a_steady_state_goes_on(name: str, seeded: Seeded) -> None:
    """In the run that every target reproduces bit for bit."""
    loop, random = held(name), np.random.default_rng(seeded(1))
    routine = controller_routine(loop, "axis_x")
    for _ in range(CHANGES):
        goes_on(run(routine, at_rest(routine, name), {CHANGE: other(loop, routine, random)})[:, 0])


@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
@pytest.mark.parametrize("name", all_but(["cascade_ppi", "pole_placement, exact commands"], HELD, WHY))
def test_the_force_of_exported_c_goes_on(name: str, seeded: Seeded) -> None:
    made = laid_out(held(name))
    changed = {CHANGE: other(held(name), made.routine, np.random.default_rng(seeded(2)))}
    tried = Trial(at_rest(made.routine, name), changed)
    found = streamed(made, files(made), tried).outputs
    goes_on(found[:, 0])
    assert same_bits(found, run(made.routine, tried.inputs, tried.changes))


@pytest.mark.parametrize("law", [PolePlacement, GeneralizedPredictive])
def test_without_its_hook_the_force_would_step(law: type, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test above can fail."""
    monkeypatch.setattr(law, "retune", lambda _, state, *__: state)
    with pytest.raises(AssertionError):
        test_the_force_of_a_steady_state_goes_on(law.kind, mixed(None))
