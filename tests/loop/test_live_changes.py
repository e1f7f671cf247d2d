"""Live changes of parameters: no bump that the change does not ask for, and the same bits whoever runs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feeddrive import Control, FeeddriveError, Guard, simulate, stream
from feeddrive.blocks import (
    DADSC,
    CascadePPI,
    DisturbanceRejection,
    Encoder,
    LowPass,
    LowPass2,
    Notch,
    PolePlacement,
    Recorded,
    SecondOrder,
    SnapLimitedMove,
    StepForce,
)
from feeddrive.blocks.signals import Noise, Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.loop import Signals
from feeddrive.loop.trace import concrete
from loop.controls import CONTROLS, GPI, MASS, PPI, RECOVERY, SCREW, T, loop_of

MOVE = SnapLimitedMove(distance=0.02, velocity=0.2, acceleration=8.0, jerk=800.0, snap=2e5)
every_control = pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)

# a steady motion or load asks for these: their change must show in the force; and a ratio that no other value fits
ASKED_FOR = ("share", "viscous", "velocity_feedforward", "modes.0.stiffness", "adaptation_ratio")


def moved(control: Control, factor: float) -> Control:
    """All numbers but those in ASKED_FOR times a factor."""
    values = (value if name.endswith(ASKED_FOR) else factor * value for name, value in tree.leaves(control))
    return tree.rebuild(control, values)


@pytest.mark.parametrize("speed", [0.0, 0.1], ids=["at standstill", "in even motion"])
@pytest.mark.parametrize("factor", [0.8, 1.1])
@every_control
def test_other_numbers_make_no_bump_in_a_steady_state(control: Control, factor: float, speed: float) -> None:
    """Under 300 N: a law whose integral, observer or filter kept its old units would jump by tens of N."""
    rows = np.arange(12_001)
    way = Recorded(position=0.3 + speed * T * rows, velocity=np.full(rows.size, speed), sample_time=T)
    run = simulate(
        loop_of(control),
        way,
        load=StepForce(force=300.0, start=0.01),
        start=(0.3, speed),
        changes={10_000: moved(control, factor)},
    )
    assert run["force"][9_999] == pytest.approx(-300.0, abs=1e-3)  # N: settled, and the controls hold the load
    assert np.max(np.abs(run["force"][9_990:] + 300.0)) < 0.01  # N, 1/30000 of what would be lost
    assert np.max(np.abs(run["tracking_error"][10_000:] - run["tracking_error"][9_999])) < 1e-9  # m


@every_control
def test_the_same_numbers_change_no_bit(control: Control) -> None:
    """While it moves, under noise, at its force limit and under a guard."""
    limited = replace(control, force_limit=250.0, guard=Guard())
    loop = loop_of(limited, encoder_load=Encoder(resolution=1e-8, noise=1e-8), encoder_motor=Encoder(resolution=1e-8))
    same = dict.fromkeys([*range(40), 500, 900], limited)
    plain, changed = (simulate(loop, MOVE, changes=changes) for changes in (None, same))
    assert np.any(np.abs(plain["requested"]) > 250.0)
    for name in plain.signals:
        assert plain[name].tobytes() == changed[name].tobytes(), name


def test_without_its_hook_a_block_would_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test above can fail: pole placement whose Σ T e kept its metre seconds loses what Ki changed."""
    monkeypatch.setattr(PolePlacement, "retune", lambda _, state, *__: state)
    control = CONTROLS["pole placement"]
    with pytest.raises(AssertionError):
        test_other_numbers_make_no_bump_in_a_steady_state(control, 1.1, 0.0)


@pytest.mark.parametrize(
    "name", ["cascade", "filters", "dadsc", "adr", "pole placement, exact", "butterworth", "modes"]
)
def test_a_changed_run_has_the_bits_of_plain_python(name: str) -> None:
    """Sample by sample on numbers, with `retune` called by hand, against the native code; and in pieces."""
    control = CONTROLS[name]
    loop = loop_of(replace(control, force_limit=400.0, guard=Guard()))
    later = loop_of(replace(moved(control, 0.9), force_limit=350.0, guard=Guard(reading_limit=900.0)))
    load = StepForce(force=50.0, start=0.01)
    changes = {120: later.control, 0.0131: {"axis.x.control.force_limit": 300.0}}
    last = replace(later, control=replace(later.control, force_limit=300.0))
    count = 200
    run = simulate(loop, MOVE, load=load, duration=(count - 1) * T, changes=changes)

    setpoints = np.array([np.broadcast_to(x, count) for x in MOVE.at(np.arange(count) * T)])
    rows = [Setpoint(*row) for row in setpoints.T]
    forces = load.at(np.arange(count) * T)
    now, timing = concrete(loop), loop.timing()
    with np.errstate(all="ignore"):
        prepared = now.prepare(timing)
        state = now.start(prepared, timing, rows[0], rows[0].position, rows[0].velocity)
        for k in range(count):
            if k in (120, 131):
                new = concrete(later if k == 120 else last)
                made = new.prepare(timing)
                state = state._replace(
                    control=new.control.retune(state.control, now.control, prepared.control, made.control)
                )
                now, prepared = new, made
            noise, time = Noise(np.float64(0.0), np.float64(k)), np.float64(k) * np.float64(T)
            state, signals = now.step(prepared, state, rows[k], np.float64(forces[k]), noise, 1.0, time)
            for signal in Signals._fields:
                assert float(getattr(signals, signal)).hex() == float(run[signal][k]).hex(), (k, signal)
    pieces = list(stream(loop, MOVE, load=load, duration=(count - 1) * T, changes=changes, chunk=23))
    assert np.concatenate([piece["force"] for piece in pieces]).tobytes() == run["force"].tobytes()


def test_a_change_before_the_first_sample_is_the_other_control() -> None:
    loop, other = loop_of(Control(law=PPI)), loop_of(Control(law=replace(PPI, Kv=60.0, Kp=9e3)))
    changed = simulate(loop, MOVE, changes={0: other.control})
    assert changed["force"].tobytes() == simulate(other, MOVE)["force"].tobytes()


def test_values_by_name_build_on_the_control_as_it_is_then() -> None:
    by_name = {300: {"axis.x.control.law.Kv": 60.0}, 0.05: {"axis.x.control.law.Kp": 9e3}}
    whole = {300: Control(law=replace(PPI, Kv=60.0)), 500: Control(law=replace(PPI, Kv=60.0, Kp=9e3))}
    first, second = (simulate(loop_of(Control(law=PPI)), MOVE, changes=changes) for changes in (by_name, whole))
    assert first["force"].tobytes() == second["force"].tobytes()


class TestInMotion:
    """Closed forms of what a change does while the error is not 0, on readings that are given."""

    t = T * np.arange(400)
    x = 0.2 * t + 0.3 * np.sin(9.0 * t) * t  # where the axis is
    set_x = 0.2 * t + 0.3 * np.sin(9.1 * t + 0.01) * t  # and should be: up to 0.3 mm apart

    def forces(self, law: Any, other: Any, change: int = 250) -> np.ndarray:
        """The forces of a law that is retuned to another before sample `change`."""
        set_v = np.gradient(self.set_x, T)
        prepared = law.prepare(T)
        found = []
        state = law.start(prepared, Setpoint(self.set_x[0], set_v[0]), Reading(self.x[0], self.x[0]))
        for k, x in enumerate(self.x):
            if k == change:
                made = other.prepare(T)
                state = other.retune(state, law, prepared, made)
                law, prepared = other, made
            state, force = law.step(prepared, state, Setpoint(self.set_x[k], set_v[k]), Reading(x, x), T)
            found.append(force)
        return np.array(found)

    def pid(self, gains: list[tuple[float, float, float]]) -> np.ndarray:
        """kp e + ki Σ T e + kd (v_set - v) with gains by sample: the sum is of forces."""
        set_v = np.gradient(self.set_x, T)
        v = np.diff(self.x, prepend=self.x[0]) / T
        found, held = [], 0.0
        for k, (kp, ki, kd) in enumerate(gains):
            e, e_v = self.set_x[k] - self.x[k], set_v[k] - v[k]
            held += ki * T * e
            found.append(kp * e + kd * e_v + held)
        return np.array(found)

    def test_p_pi_is_a_pid_with_a_sum_of_forces(self) -> None:
        laws = [CascadePPI(Kv=80.0, Kp=2e4, Tn=0.02), CascadePPI(Kv=50.0, Kp=3e4, Tn=0.01)]
        found = self.forces(*laws)
        set_v, v = np.gradient(self.set_x, T), np.diff(self.x, prepend=self.x[0]) / T
        held, wanted = 0.0, []
        for k in range(len(self.t)):
            law = laws[k >= 250]
            e = law.Kv * (self.set_x[k] - self.x[k]) + set_v[k] - v[k]
            held += law.Kp * T / law.Tn * e
            wanted.append(law.Kp * e + held)
        assert np.max(np.abs(wanted)) > 100.0
        assert found == pytest.approx(np.array(wanted), abs=1e-8)  # N

    def test_dadsc_is_a_pid_with_a_sum_of_forces(self) -> None:
        """With the estimate -g2 s - m ω K T Σ s its force is m (K s + λ e_v) + m ω s + m ω K T Σ s."""
        laws = [
            DADSC(mass=MASS, tracking_rate=200.0, reaching_rate=300.0, adaptation_rate=250.0),
            DADSC(mass=30.0, tracking_rate=260.0, reaching_rate=210.0, adaptation_rate=400.0),
        ]
        found = self.forces(*laws)
        set_v, v = np.gradient(self.set_x, T), np.diff(self.x, prepend=self.x[0]) / T
        held, wanted = 0.0, []
        for k in range(len(self.t)):
            law = laws[k >= 250]
            m, rate, reach, adapt = law.mass, law.tracking_rate, law.reaching_rate, law.adaptation_rate
            e_v = set_v[k] - v[k]
            s = rate * (self.set_x[k] - self.x[k]) + e_v
            held += m * adapt * reach * T * s
            wanted.append(m * (reach * s + rate * e_v) + m * adapt * s + held)
        assert np.max(np.abs(wanted)) > 100.0
        assert found == pytest.approx(np.array(wanted), abs=1e-7)  # N

    def test_pole_placement_keeps_the_force_of_its_integral(self) -> None:
        """Rigid commands, both encoders at one place: K1 + K2 and K3 + K4 act on the error, Ki on its sum."""
        laws = [PolePlacement(model=SCREW, bandwidth=f, commands="rigid") for f in (30.0, 36.0)]
        gains = [laws[k >= 250].gains() for k in range(len(self.t))]
        wanted = self.pid([(g.K1 + g.K2, g.Ki, g.K3 + g.K4) for g in gains])
        assert np.max(np.abs(wanted)) > 100.0
        assert self.forces(*laws) == pytest.approx(wanted, abs=1e-6)  # N

    def test_what_an_observer_believes_goes_on(self) -> None:
        """Velocity, disturbance and its derivatives of a GPI observer in their own units, whatever omega_o and mass."""
        old, new = GPI, replace(GPI, mass=55.0, omega_o=900.0)
        prepared, made = old.prepare(T), new.prepare(T)
        state = old.start(prepared, Reading(self.x[0], self.x[0]))
        for k in range(200):
            state, _ = old.step(prepared, state, Reading(self.x[k], self.x[k], 100.0 * np.sin(0.1 * k)), T)
        after = new.retune(state, old, prepared, made)
        for i in range(1, len(state.z)):
            share = 1.0 if i == 1 else old.mass
            believed = share * state.z[i] * old.omega_o**i
            assert (1.0 if i == 1 else new.mass) * after.z[i] * new.omega_o**i == pytest.approx(believed, rel=1e-13)
            assert believed != 0.0
        assert after.z[0] == state.z[0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (Notch(frequency=700.0), Notch(frequency=500.0, damping_zero=0.2, damping_pole=0.3)),
        (Notch(frequency=700.0, damping_zero=0.4, damping_pole=0.4), Notch(frequency=700.0)),
        (LowPass2(frequency=900.0), LowPass2(frequency=300.0, damping=1.0)),
        (LowPass(frequency=1500.0), LowPass(frequency=200.0)),
        (
            SecondOrder(frequency_zero=1200.0, frequency_pole=1000.0),
            SecondOrder(frequency_zero=900.0, frequency_pole=300.0),
        ),
    ],
    ids=["notch", "notch switched on", "low pass 2", "low pass", "second order"],
)
def test_the_output_of_a_filter_goes_on(old: Any, new: Any) -> None:
    """At rest for ever; and after any input the next output is the old one, if the input equals the last output."""
    before, after = old.prepare(T), new.prepare(T)
    steady = new.retune(old.start(before, 250.0), old, before, after)
    for wanted, found in zip(new.start(after, 250.0), steady, strict=True):
        assert found == pytest.approx(wanted, abs=1e-12)
    state, y = old.start(before, 0.0), 0.0
    for x in 100.0 * np.sin(0.3 * np.arange(50)):
        state, y = old.step(before, state, x)
    goes_on = old.step(before, state, y)[1]
    assert abs(goes_on - y) > 0.1 or isinstance(old, Notch)  # N: it is in motion
    assert new.step(after, new.retune(state, old, before, after), y)[1] == pytest.approx(goes_on, abs=1e-11)


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_share_that_grows_blends_in_and_one_that_falls_acts_at_once(share: float) -> None:
    old = DisturbanceRejection(observer=RECOVERY, share=0.5, blend_time=0.01)
    new = replace(old, share=share)
    before, after = old.prepare(T), new.prepare(T)
    at_rest = Reading(0.0, 0.0, -200.0, -200.0)
    state = old.start(before, Setpoint(0.0), at_rest)
    for _ in range(150):
        state, _, force = old.step(before, state, Setpoint(0.0), at_rest, T)
    assert force == pytest.approx(-100.0, rel=1e-9)  # N: half of the 200 N that push
    state = new.retune(state, old, before, after)
    forces = []
    for _ in range(150):
        state, _, force = new.step(after, state, Setpoint(0.0), at_rest, T)
        forces.append(force)
    assert forces[0] == pytest.approx(-100.0 if share > 0.5 else -60.0, rel=1e-9)
    assert forces[-1] == pytest.approx(-200.0 * share, rel=1e-9)
    assert np.max(np.abs(np.diff(forces))) <= 200.0 * share * T / 0.01 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("changes", "kind", "told"),
    [
        ({-1: {}}, ParameterError, "sample -1 is outside"),
        ({5000: {}}, ParameterError, "1401 samples|samples, 0"),
        ({9.0: {}}, ParameterError, "9 s is outside"),
        ({np.nan: {}}, ParameterError, "must be a sample"),
        ({True: {}}, ParameterError, "must be a sample"),
        ({"soon": {}}, ParameterError, "must be a sample"),
        ({10: {}, 1e-3: {}}, ParameterError, "two at sample 10"),
        ({10: 3.0}, ParameterError, "must be a Control"),
        ({10: {"axis.x.plant.mass": 3.0}}, ParameterError, "axis.x.plant.mass.*does not change live"),
        ({10: {"axis.x.control.law.Kw": 3.0}}, ParameterError, "at sample 10: there is no parameter .*law.Kw'; did"),
        ({10: {"axis.x.control.law.Kv": -3.0}}, ParameterError, "axis.x.control.law.Kv = -3 1/s .* must be > 0"),
        ({10: {"axis.x.control.law.Kv": np.array([1.0, 2.0])}}, ParameterError, "must be one number"),
        ({10: Control(law=replace(PPI, Kv=np.array([1.0, 2.0])))}, ParameterError, "arrays of variants"),
        ({10: Control(law=replace(PPI, Tn=None))}, StructureError, "axis.x.control.law.Tn would be left out: a live"),
        ({10: Control(law=PPI, force_limit=3.0)}, StructureError, "axis.x.control.force_limit would come in"),
        ({10: Control(law=replace(PPI, velocity_samples=2))}, StructureError, "velocity_samples would go from 1 to 2"),
        ({10: Control(law=PPI, guard=Guard())}, StructureError, "axis.x.control.guard would go from nothing to guard"),
        ({10: Control(law=PPI, filters=(LowPass(frequency=9.0),))}, StructureError, "would go from 0 blocks to 1"),
        (
            {10: Control(law=DADSC(mass=1.0, tracking_rate=9.0, reaching_rate=9.0, adaptation_rate=9.0))},
            StructureError,
            "axis.x.control.law would go from cascade_ppi to dadsc",
        ),
    ],
    ids=str,
)
def test_a_bad_change_is_named(changes: Mapping[Any, Any], kind: type[FeeddriveError], told: str) -> None:
    with pytest.raises(kind, match=told):
        simulate(loop_of(Control(law=PPI)), MOVE, duration=0.14, changes=changes)
