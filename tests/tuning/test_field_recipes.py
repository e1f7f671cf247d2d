"""Rules of the trade on the axes of the field's laws: what Kessler's optimum, makers and reference models promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import StructureError
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.tuning.recipes import half_antiresonance, makers_rule, symmetric_optimum
from field_laws import R, T, W, judged, loop

ANY = CascadePPI(Kv=100.0, Kp=4e4, Tn=0.01)
DEAD = 2.0 * T  # s: one sample, half a hold, half a difference


def with_law(given: Loop, law: CascadePPI) -> Loop:
    return replace(given, control=replace(given.control, law=law))


def optimum(a: float, mass: float = 40.0, lag: float = DEAD) -> CascadePPI:
    return CascadePPI(Kv=1.0 / (4.0 * a * lag), Kp=mass / (a * lag), Tn=a * a * lag)


def test_golden_symmetric_optimum() -> None:
    """Kp 1e5, Tn 0.8 ms, Kv 625 for a = 2; mass and lag are read off the axis to 1.2 %."""
    law = symmetric_optimum(loop(ANY), a=2.0).law
    assert (law.Kp, law.Tn, law.Kv) == pytest.approx((1e5, 8e-4, 625.0), rel=0.012)
    assert symmetric_optimum(loop(ANY)).law.Tn == pytest.approx(9.0 * DEAD, rel=0.012)


@pytest.mark.parametrize(("a", "inner", "outer"), [(2.0, 1.960, 2.61), (3.0, 1.418, 1.56), (4.0, 1.274, 1.33)])
def test_what_a_costs(a: float, inner: float, outer: float) -> None:
    """13.b: Ms of the velocity loop alone, and with the position loop closed; the sum of the delays is right."""
    law = optimum(a)
    assert judged(loop(replace(law, Kv=1e-6))).peak == pytest.approx(inner, rel=2e-3)
    assert judged(loop(law)).peak == pytest.approx(outer, rel=5e-3)


def test_the_makers_rule() -> None:
    """13.c: ISE^½ 3.31e-10 at Ms 2 with ωv = 2533.9 rad/s, 3.69e-10 with Kv = ωv/6 at Ms 2.

    The recipe reads mass and lag off the axis to 1 %.
    """
    rate = 2533.9
    law = CascadePPI(Kv=rate / 4.0, Kp=40.0 * rate, Tn=4.0 / rate)
    found = judged(loop(law))
    assert found.peak == pytest.approx(2.0, rel=1e-3)
    assert found.ise == pytest.approx(3.31e-10, rel=2e-3)
    faster = 2710.6
    slow = judged(loop(CascadePPI(Kv=faster / 6.0, Kp=40.0 * faster, Tn=4.0 / faster)))
    assert (slow.peak, slow.ise) == pytest.approx((2.0, 3.69e-10), rel=2e-3)
    made = makers_rule(loop(ANY))
    assert made.law.Kp / made.mass == pytest.approx(rate, rel=0.015)
    assert judged(with_law(loop(ANY), made.law)).peak == pytest.approx(2.0, rel=0.02)


def test_on_two_masses() -> None:
    """13.d: the optimum is unstable (1.024), half of the antiresonance has Ms 1.324, all of it is unstable.

    The maker's rule is lowered until Ms is 2, and is stable.
    """
    for mass in (163.0, 130.0):
        assert stability(loop(optimum(2.0, mass), on=W)).growth == pytest.approx(1.024, abs=2e-3)
    rate = 369.3
    law = CascadePPI(Kv=rate / 4.0, Kp=163.0 * rate, Tn=4.0 / rate)
    found = judged(loop(law, on=W))
    assert found.peak == pytest.approx(1.324, rel=2e-3)
    assert found.ise == pytest.approx(1.35e-8, rel=5e-3)
    twice = CascadePPI(Kv=rate / 2.0, Kp=326.0 * rate, Tn=2.0 / rate)
    assert not stability(loop(twice, on=W)).stable
    assert half_antiresonance(loop(ANY, on=W)).law.Kv == pytest.approx(rate / 4.0, rel=3e-3)
    made = makers_rule(loop(ANY, on=W))
    assert "lowered" in made.reason
    assert judged(loop(made.law, on=W)).peak == pytest.approx(2.0, rel=0.025)
    assert stability(loop(made.law, on=W)).stable


@pytest.mark.parametrize("dead", [1, 2, 3])
def test_delay_symmetry(dead: int) -> None:
    """13.e: 100 mm in 0.4 s on R: the feedback sees 4e-6 um where its set motion is late by the dead time.

    Late by one sample more it sees 0.012 um, and on time 0.012 um for each sample.
    """
    law = CascadePPI(Kv=133.0, Kp=36e3, Tn=7.5e-3)
    move = Polynomial7(distance=0.1, travel_time=0.4)

    def error(late: float | None) -> float:
        forward = (Inertia(mass=40.0, viscous=60.0),)
        given = loop(law, dead_samples=float(dead), feedforward=forward, feedback_delay=late)
        found = simulate(given, move, record=["position_load"])["position_load"]
        wanted = move.at(np.arange(found.size) * T - (late or 0.0)).position
        return 1e6 * float(np.max(np.abs(found - wanted)))

    assert error(dead * T) < 5e-6
    assert error(None) == pytest.approx(0.0123 * dead, rel=0.02)
    assert error((dead + 1) * T) == pytest.approx(0.0122, rel=0.02)


def test_delay_symmetry_needs_a_law_that_feeds_nothing_forward() -> None:
    from feeddrive.blocks.controller.dadsc import DADSC

    law = DADSC(mass=40.0, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)
    with pytest.raises(StructureError, match="feedback_delay delays the set motion of dadsc"):
        Control(law=law, feedback_delay=1e-4)


def velocity_step(law: CascadePPI, count: int = 400) -> np.ndarray:
    """The velocity of 40 kg without friction, one sample of dead time, after a step of the set velocity by 1."""
    control = Control(law=law)
    prepared = control.prepare(T)
    state = control.start(prepared, Setpoint(0.0), 0.0, 0.0)
    x, v, force, found = 0.0, 0.0, 0.0, []
    for k in range(count):
        state, command = control.step(prepared, state, Setpoint(k * T, 1.0), x, x, 1.0, T)
        x, v = x + T * v + 0.5 * T * T * force / 40.0, v + T * force / 40.0
        force = float(command.applied)
        found.append(v)
    return np.array(found)


def test_the_reference_model_takes_the_overshoot() -> None:
    """13.f: a = 3: PI overshoots by 23.1 %; with the model by nothing, and it takes 0.3 ms longer to 90 %."""
    law = replace(optimum(3.0), Kv=1e-9)
    plain, modelled = velocity_step(law), velocity_step(replace(law, model_mass=40.0))
    assert 100.0 * (np.max(plain) - 1.0) == pytest.approx(23.1, abs=0.05)
    assert 100.0 * (np.max(modelled) - 1.0) < 1e-10
    assert int(np.argmax(modelled > 0.9)) - int(np.argmax(plain > 0.9)) == 3


def test_the_reference_model_leaves_the_velocity_loop_as_it_is() -> None:
    """L of the velocity loop is the same; with the position loop closed Ms is 1.52 in place of 1.56."""
    free = Rigid(mass=40.0, viscous=R.viscous)
    law = optimum(3.0)
    inner, both = (
        [judged(loop(replace(law, Kv=Kv, model_mass=m), on=free)).peak for m in (None, 40.0)] for Kv in (1e-9, law.Kv)
    )
    assert inner[1] == pytest.approx(inner[0], rel=1e-9)
    assert both == pytest.approx([1.556, 1.523], abs=2e-3)
    with pytest.raises(StructureError, match="reference model in the integral, and there is none without Tn"):
        CascadePPI(Kv=1.0, Kp=1.0, model_mass=40.0)
