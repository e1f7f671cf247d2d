"""Cross-coupled control against closed forms: contour transfer, equal axes, the largest gain, circles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.analysis.contour_control import (
    MatchedDynamics,
    _largest,
    contour_gain,
    contour_gains,
    matched_dynamics,
)
from feeddrive.analysis.stability import require_stable, stability
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.cross_coupled import CrossCoupled
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.circle import Circle
from feeddrive.blocks.signals import Setpoint
from feeddrive.files.job import read_job
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.language.errors import ParameterError, StructureError, UnstableError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate


def axis(mass: float = 120.0, viscous: float = 400.0, T: float = 2.5e-4, Kv: float = 40.0) -> Loop:
    """The axes of the closed forms, without feedforward."""
    law = CascadePPI(Kv=Kv, Kp=4.5e4, Tn=0.015, velocity_feedforward=0.0)
    return Loop(control=Control(law=law), axis=Axis(plant=Rigid(mass=mass, viscous=viscous)), sample_time=T)


def crossed(*axes: Loop, gain: float = 40.0) -> Machine:
    """Axes under cross-coupled control."""
    loops = dict(zip("xyz", axes, strict=False))
    return Machine.of(loops, (CrossCoupled(contour_axes=tuple(loops), contour_gain=gain),))


def transfer(T: float, degrees: float, frequency: float) -> float:
    """|contour error with / without| along a line, for a force across it, of the linear models."""
    angle = np.radians(degrees)
    n = np.array([-np.sin(angle), np.cos(angle)])
    velocity = {"x": 0.05 * np.cos(angle), "y": 0.05 * np.sin(angle)}
    with_it = crossed(axis(T=T), axis(180.0, 500.0, T=T))
    found = []
    for machine in (with_it, Machine.of(with_it.loops())):
        forces, tables = ([f"{name}.{what}" for name in "xy"] for what in ("load_force", "position_load"))
        model = linearize(machine, forces, tables, velocity=velocity)
        P = [[model.response(np.array([frequency]), row, col).response[0] for col in forces] for row in tables]
        found.append(n @ np.array(P) @ n)
    return float(abs(found[0] / found[1]))


@pytest.mark.parametrize(
    ("degrees", "golden"),
    [(0.0, (0.5045088908, 0.5824924201, 0.9625599442)), (45.0, (0.5045176834, 0.5840465477, 0.9416262755))],
)
def test_the_contour_transfer_is_that_of_the_closed_form(degrees: float, golden: tuple[float, ...]):
    """Extrapolated to a sample time of 0, of which the error is of first order: what is left is of second order."""
    for frequency, value in zip((1.0, 5.0, 20.0), golden, strict=True):
        found = 2.0 * transfer(1e-5, degrees, frequency) - transfer(2e-5, degrees, frequency)
        assert found == pytest.approx(value, abs=2e-7)


def test_equal_axes_have_kv_along_the_path_and_kv_and_the_gain_across():
    """The poles of the machine are those of an axis with Kv and those of one with Kv + gain."""
    machine = crossed(axis(), axis(), gain=40.0)
    ends = [f"{name}.{what}" for name in "xy" for what in ("set_position", "position_load")]
    model = linearize(machine, ends[::2], ends[1::2], velocity={"x": 0.04, "y": 0.03})
    alone = [stability(axis(Kv=Kv)).model.poles() for Kv in (40.0, 80.0)]
    found, wanted = (np.sort_complex(each) for each in (model.poles(), np.concatenate(alone)))
    assert np.max(np.abs(found - wanted)) < 1e-9  # of |z|, eigenvalues of two different matrices


def test_the_largest_gain_is_the_largest_kv_less_kv():
    low, high = 6000.0, 6200.0
    assert stability(axis(Kv=low)).stable
    assert not stability(axis(Kv=high)).stable
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stability(axis(Kv=middle)).stable else (low, middle)
    found = contour_gain(crossed(axis(), axis()), directions=4)
    assert found.largest == pytest.approx(low - 40.0, rel=3e-6)  # two bisections
    assert found.stable
    # across the path of equal axes 1 + L is what the position loop with Kv + 40 leaves of the one with Kv: S80/S40
    model = [linearize(axis(Kv=Kv), ["reading_load"], ["position_load"]) for Kv in (40.0, 80.0)]
    f = np.geomspace(0.2, 2000.0, 600)
    ratio = [1.0 + each.response(f).response for each in model]
    assert found.peak == pytest.approx(max(1.0, float(np.max(np.abs(ratio[1] / ratio[0])))), rel=1e-3)
    slow = axis(300.0, 500.0)  # the axis whose velocity loop is slowest decides, where the path runs across it
    mixed = contour_gain(crossed(axis(), slow, axis(180.0)), directions=4)
    alone = contour_gain(crossed(slow, slow), directions=1)
    assert mixed.largest <= alone.largest * (1.0 + 1e-6)
    assert abs(mixed.direction["y"]) < 0.3
    wild = crossed(axis(), axis(), gain=7000.0)
    assert not contour_gains(wild)[0].stable
    with pytest.raises(UnstableError, match=r"contour_gain|unstable"):
        require_stable(wild)


def round_and_round(machine: Machine) -> tuple[float, float]:
    """Radius error and lag along the path in the mean over a turn, m, of a circle of 20 mm at 0.1 m/s."""
    given: dict[str, Any] = {"radius": 0.02, "feed": 0.1, "turns": 2.0, "run_up_time": 0.1}
    run = simulate(machine, {"x": Circle(**given, phase=90), "y": Circle(**given, phase=0)}, duration=2.0)
    turn = round(0.4 * np.pi / machine.sample_time)
    last = slice(run.samples - turn, run.samples)
    at, wanted = (run[f"x.{s}"][last] + 1j * run[f"y.{s}"][last] for s in ("position_load", "set_position"))
    lag = np.abs(np.angle(at / wanted)) * 0.02
    return float(np.mean(np.abs(at)) - 0.02), float(np.mean(lag))


def test_a_circle_shrinks_by_a_quarter_of_it():
    """P-PI 60/18000/15 ms on 40 kg: -68.9 um without; with 3 Kv the fixed point of z = G (R - 3 outward(z)).

    Koren & Lo's circular estimate would leave -17.30 um: theirs is exact for a lag on the circle, here e_t^4/8R^3 =
    0.12 um is counted too much.  The lag along the path stays.
    """
    law = CascadePPI(Kv=60.0, Kp=18_000.0, Tn=0.015, velocity_feedforward=0.0)
    physics = Axis(plant=Rigid(mass=40.0, viscous=60.0), actuator=Actuator(dead_time=1e-4))
    loop = Loop(control=Control(law=law), axis=physics, sample_time=1e-4)
    without = round_and_round(Machine.of({"x": loop, "y": loop}))
    found = round_and_round(crossed(loop, loop, gain=180.0))
    R, model = 0.02, linearize(loop, ["set_position"], ["position_load"])
    G = model.response(np.array([0.1 / (2.0 * np.pi * R)])).response[0]
    z = G * R
    for _ in range(200):
        z = 0.8 * z + 0.2 * G * (R + 3.0 * ((R - z.real) - z.imag**2 / (2.0 * R)))
    assert 1e6 * without[0] == pytest.approx(-68.9, abs=0.05)  # digits given
    assert 1e6 * found[0] == pytest.approx(1e6 * (abs(z) - R), abs=1e-3)
    assert 1e6 * found[0] == pytest.approx(-17.30, abs=0.2)
    assert 1e6 * found[1] == pytest.approx(1660.0, abs=5.0)
    assert 1e6 * without[1] == pytest.approx(1660.0, abs=5.0)


def test_axes_that_differ_and_axes_that_stick_on_a_circle():
    """docs/reference/laws/field.md, 11.b, 11.c: RMS contour errors, Kv of y a tenth lower, and dry friction.

    Stated for a form that shifts set positions (100.5 to 25.3 um, and 12.9 um without); here a velocity is added: 4 %.
    """

    def axes(Kv: float, coulomb: float, feedforward: float) -> Loop:
        law = CascadePPI(Kv=Kv, Kp=18_000.0, Tn=0.015, velocity_feedforward=feedforward)
        fed = (Inertia(mass=40.0, viscous=60.0),) if feedforward else ()
        dry = Coulomb(coulomb=coulomb) if coulomb else None
        physics = Axis(plant=Rigid(mass=40.0, viscous=60.0), actuator=Actuator(dead_time=1e-4), friction_load=dry)
        return Loop(control=Control(law=law, feedforward=fed), axis=physics, sample_time=1e-4)

    def rms(machine: Machine) -> float:
        given: dict[str, Any] = {"radius": 0.02, "feed": 0.1, "turns": 2.0, "run_up_time": 0.1}
        run = simulate(machine, {"x": Circle(**given, phase=90), "y": Circle(**given, phase=0)})
        turn = slice(14_000, 14_000 + round(0.4 * np.pi / 1e-4))  # the second one
        away = np.hypot(run["x.position_load"][turn], run["y.position_load"][turn]) - 0.02
        return 1e6 * float(np.sqrt(np.mean(away**2)))

    slow = axes(60.0, 0.0, 0.0), axes(54.0, 0.0, 0.0)
    assert rms(Machine.of(dict(zip("xy", slow, strict=True)))) == pytest.approx(100.5, rel=0.04)
    assert rms(crossed(*slow, gain=180.0)) == pytest.approx(25.3, rel=0.04)
    dry = axes(60.0, 60.0, 1.0), axes(60.0, 90.0, 1.0)
    without = rms(Machine.of(dict(zip("xy", dry, strict=True))))
    assert without == pytest.approx(12.9, rel=0.04)
    assert rms(crossed(*dry, gain=180.0)) < 0.35 * without  # 3.2 um stated, 4.1 here


def test_the_contour_error_is_of_second_order():
    """On a circle of 20 mm at 30 deg, e = (30, 10) um: -30.9797573041 um outward, linear -30.9807621135."""
    angle, V, R = np.radians(30.0), 0.1, 0.02
    out, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    bend = -out * V * V / R
    setpoints = {name: Setpoint(R * out[i], V * along[i], bend[i]) for i, name in enumerate("xy")}
    error = np.array([30e-6, 10e-6])
    positions = {name: setpoints[name].position - error[i] for i, name in enumerate("xy")}
    for estimate, golden in (("second_order", -30.9797573041), ("linear", -30.9807621135)):
        block = CrossCoupled(contour_axes=("x", "y"), contour_gain=1.0, estimate=estimate)
        _, added = block.correct(block.listen(setpoints), setpoints, positions)
        outward = -float(np.dot(out, [added["x"], added["y"]]))
        assert 1e6 * outward == pytest.approx(golden, abs=1e-9)  # um; rounding of positions of 20 mm
        assert abs(np.dot(along, [added["x"], added["y"]])) < 1e-17


def test_it_keeps_its_direction_at_rest_and_has_none_before():
    block = CrossCoupled(contour_axes=("x", "y"), contour_gain=2.0)
    rest, moving = ({"x": Setpoint(0.0, v), "y": Setpoint(0.0)} for v in (0.0, 0.1))
    aside = {"x": -3e-6, "y": -1e-6}
    state = block.listen(rest)
    state, added = block.correct(state, rest, aside)
    assert added == {"x": 0.0, "y": 0.0}
    state, added = block.correct(state, moving, aside)
    assert added == {"x": 0.0, "y": 2e-6}
    state, added = block.correct(state, {name: each._replace(velocity=0.0) for name, each in moving.items()}, aside)
    assert added == {"x": 0.0, "y": 2e-6}


def test_an_axis_without_a_reading_moves_no_other():
    """x is switched off while y runs: y does what it does without the coupling, to the bit."""
    law = CascadePPI(Kv=40.0, Kp=4.5e4, Tn=0.015)
    guarded = replace(axis(), control=Control(law=law, guard=Guard()))
    path = {"x": Circle(radius=0.02, feed=0.1, turns=0.3, phase=90), "y": Circle(radius=0.02, feed=0.1, turns=0.3)}
    off = {"x": np.zeros(2), "y": np.ones(2)}
    crossed_run = simulate(crossed(guarded, guarded), path, enable=off, duration=0.2)
    alone = simulate(Machine.of({"x": guarded, "y": guarded}), path, enable=off, duration=0.2)
    assert np.max(np.abs(crossed_run["x.following_error"])) > 1e-4  # m: there would be something to add
    assert np.array_equal(crossed_run["y.force"], alone["y.force"])


def test_what_axes_differ_in_shows_on_a_line():
    """Kv 40 and 38 leave a line at 45 deg by 65.789 um at 100 mm/s; a lag of phase has an error of (2πf/Kv)²/3."""
    found = matched_dynamics(Machine.of({"x": axis(), "y": axis(Kv=38.0)}))
    assert 1e6 * found.line("x", "y") == pytest.approx(65.7894736842, abs=1e-3)
    assert found.remarks()[0].startswith("x Kv 40, y 38: 65.8 um off a 45 deg line at 100 mm/s")
    assert matched_dynamics(Machine.of({"x": axis(), "y": axis()})).remarks() == []
    heavy = matched_dynamics(Machine.of({"x": axis(), "y": axis(180.0, 500.0)}))  # equal Kv: the lag is alike
    assert heavy.line("x", "y") < 1e-9
    assert heavy.circle("x", "y") > 1e-7  # m: the velocity loops differ
    with pytest.raises(ParameterError, match="must be > 0"):
        matched_dynamics(crossed(axis(), axis()), feed=0.0)


def test_a_file_holds_it_and_names_what_does_not_fit(tmp_path: Path):
    machine = read_machine("xy_table").machine(CrossCoupled(contour_axes=("x", "y"), contour_gain=30.0))
    path = tmp_path / "table.toml"
    path.write_text(machine_toml(machine, "table"))
    again = read_machine(path)
    assert isinstance(again.couplings[0], CrossCoupled)
    assert again.coupled("x")
    for old, new, said in (
        ('contour_axes = ["x", "y"]', 'contour_axes = ["x", "b"]', "acts on axis 'b', which is not there"),
        ('contour_axes = ["x", "y"]', 'contour_axes = ["x", "x"]', "two or three axes, each once"),
        ("contour_gain = 30.0", "contour_gain = -30.0", "contour_gain"),
    ):
        assert old in path.read_text()
        wrong = tmp_path / "wrong.toml"
        wrong.write_text(path.read_text().replace(old, new))
        with pytest.raises((StructureError, ParameterError), match=said) as error:
            read_machine(wrong)
        assert "wrong.toml:" in str(error.value)
    turning = replace(axis(), axis=replace(axis().axis, rotary=True))
    with pytest.raises(StructureError, match="axis 'y' turns"):
        crossed(axis(), turning)


def test_a_row_of_a_job_takes_another_gain(tmp_path: Path):
    """The same motion with and without the coupling, in one comparison; other couplings are no part of the control."""
    machine = read_machine("xy_table").machine(CrossCoupled(contour_axes=("x", "y"), contour_gain=60.0))
    (tmp_path / "table.toml").write_text(machine_toml(machine, "table"))
    job = (
        'machine = "table.toml"\naxis = "x"\n[reference]\nkind = "circle"\nradius_mm = 10\nfeed_mm_per_s = 50\n'
        '[others.y.reference]\nkind = "circle"\nradius_mm = 10\nfeed_mm_per_s = 50\nphase = 90\n'
        '[[law]]\nname = "without"\nset = {{ "couplings.0.{}" = 0.0 }}\n'
    )
    (tmp_path / "job.toml").write_text(job.format("contour_gain"))
    rows = read_job(tmp_path / "job.toml").machines
    assert [float(each.couplings[0].contour_gain) for each in rows.values()] == [60.0, 0.0]  # type: ignore[attr-defined]
    (tmp_path / "job.toml").write_text(job.format("gain"))
    with pytest.raises(ParameterError, match="contour_gain"):
        read_job(tmp_path / "job.toml")


def falling(extra: float, velocity: float) -> Regularised:
    """Coulomb friction of 100 N, and an extra level at standstill that falls with the speed."""
    return Regularised(
        coulomb=100.0, breakaway=100.0 + extra, stribeck_velocity=velocity, transition_velocity=1e-3, viscous=0.0
    )


def slope(friction: Regularised, v: float = 0.05, step: float = 1e-6) -> float:
    return float(friction.steady(v + step) - friction.steady(v - step)) / (2.0 * step)


def test_of_friction_its_slope_at_50_mm_per_second_counts():
    """Two frictions that fall differently, with the same slope there, have the same largest gain.

    0.5 %: the level within a sample is that of its middle, which is a little slower.
    """
    steep = falling(400.0, 0.03)
    wide = falling(400.0 * slope(steep) / slope(falling(400.0, 0.05)), 0.05)
    thick = axis(1200.0, 2e4, T=5e-5)
    loops = (replace(thick, axis=replace(thick.axis, friction_load=friction)) for friction in (steep, wide))
    first, second = (contour_gain(crossed(loop, loop), directions=1).largest for loop in loops)
    assert first == pytest.approx(second, rel=5e-3)


def test_the_peak_of_the_contour_loop_is_found_on_its_lines():
    """Across the path of equal axes 1/(1 + L) is the ratio of two position loops: the peak to 0.1 %, near the edge."""
    peak = contour_gain(crossed(axis(), axis(), gain=2000.0), directions=1).peak
    model = [linearize(axis(Kv=Kv), ["reading_load"], ["position_load"]) for Kv in (40.0, 2040.0)]
    f = np.geomspace(100.0, 2000.0, 4000)
    low, high = (1.0 + position.response(f).response for position in model)
    assert peak == pytest.approx(float(np.max(np.abs(high / low))), rel=1e-3)


@pytest.mark.parametrize(("edge", "expected"), [(8e5, 8e5), (1.5e6, np.inf)])
def test_a_gain_of_a_million_per_second_is_no_edge_of_a_sampled_loop(edge: float, expected: float):
    assert _largest(lambda gain: gain < edge) == pytest.approx(expected, rel=1e-5)


def test_a_lag_is_that_of_constant_velocity():
    """1/Kv without velocity feedforward; a sine of any frequency f lags by a share of (2πf/Kv)² less."""
    lag = matched_dynamics(crossed(axis(), axis(180.0, 500.0))).lag
    assert list(lag.values()) == pytest.approx([1.0 / 40.0, 1.0 / 40.0], rel=2e-6)


@pytest.mark.parametrize(("off", "said"), [(0.7e-6, False), (1.5e-6, True)])
def test_a_mismatch_of_a_micrometer_is_said(off: float, said: bool):
    lag = {"x": 0.02, "y": 0.02 + 2.0 * off / 0.1}
    matched = MatchedDynamics(0.1, 0.02, lag, {"x": 50.0, "y": 50.0}, {"x": 1.0 + 0j, "y": 1.0 + 0j})
    assert matched.line("x", "y") == pytest.approx(off)
    assert bool(matched.remarks()) is said
