"""A law whose numbers depend on the position: the law itself at the places, between them without a bump."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks import DADSC, GainSchedule, LinearADRC, PolePlacement, ScheduleLoad, SchedulePlace, TwoMass
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.block import choice, parameter
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.linearize import linearize

T = 2.5e-4
MODEL = TwoMass(mass_motor=1400.0, mass_load=500.0, stiffness=1.31e8, damping=1.3e4)
PPI = fd.blocks.CascadePPI(Kv=35.0, Kp=2.6e5, Tn=0.028)
# of every kind of state: an integral in N, one that a gain multiplies, an observer, one with a past of the set position
LAWS: dict[str, Law] = {
    "cascade_ppi": PPI,
    "pole_placement": PolePlacement(model=MODEL, bandwidth=25.0),
    "linear_adrc": LinearADRC(mass=1900.0, omega_c=60.0, omega_o=300.0, delay_samples=1),
    "dadsc": DADSC(mass=1900.0, tracking_rate=60.0, reaching_rate=60.0, adaptation_rate=30.0),
    "adr": fd.blocks.ActiveDisturbanceRejection(
        mass=1900.0, omega_c=30.0, share=0.5, observer=fd.blocks.DisturbanceRecovery(mass=1900.0, frequency=20.0)
    ),
    "super_twisting": fd.blocks.SuperTwisting(mass=1900.0, tracking_rate=60.0, zone_time=0.02, disturbance_rate=50.0),
}
POSITIONS = (0.25, 1.0, 2.5)  # m: binary fractions, so that their differences are exact


def scaled(law: Law, factor: float) -> Law:
    """The law with all numbers but ratios times a factor: another share of a disturbance asks for another force."""
    values = (factor * v if tree.declaration(law, name).unit else v for name, v in tree.leaves(law))
    return tree.rebuild(law, values)


def scheduled(law: Law, *factors: float, positions: tuple[float, ...] = POSITIONS) -> GainSchedule:
    """The law with other numbers at each of the three places."""
    places = zip(positions, factors, strict=True)
    return GainSchedule(places=tuple(SchedulePlace(position=x, law=scaled(law, factor)) for x, factor in places))


def loop_of(law: Law, **plant: Any) -> fd.Loop:
    axis = fd.Axis(plant=replace(MODEL, **plant), actuator=fd.blocks.Actuator(dead_time=T))
    return fd.Loop(control=fd.Control(law=law), axis=axis, sample_time=T)


@pytest.mark.parametrize("name", LAWS)
def test_equal_numbers_at_all_places_give_the_bits_of_the_law(name: str) -> None:
    law = LAWS[name]
    move = fd.blocks.SnapLimitedMove(distance=0.1, velocity=0.5, acceleration=2.5, jerk=200.0, snap=2e4)
    runs = [
        fd.simulate(loop_of(each), move, start=(0.95, 0.95), record=["force", "position_load"])
        for each in (law, scheduled(law, 1.0, 1.0, 1.0))
    ]
    for signal in ("force", "position_load"):
        assert np.array_equal(runs[0][signal], runs[1][signal]), signal


def forces(law: Law, positions: np.ndarray, errors: np.ndarray, applied: float = 400.0) -> np.ndarray:
    """The forces of a law along measured positions, which lie `errors` behind the set positions."""
    prepared = law.prepare(np.float64(T))
    speeds = np.gradient(positions) / T
    read = [Reading(x, x, applied, applied, v) for x, v in zip(positions, speeds, strict=True)]
    state = law.start(prepared, Setpoint(positions[0], speeds[0]), read[0])
    out = []
    for x, v, e, reading in zip(positions[1:], speeds[1:], errors[1:], read[1:], strict=True):
        state, force = law.step(prepared, state, Setpoint(x + e, v), reading, np.float64(T))
        out.append(float(force))
    return np.array(out)


@pytest.mark.parametrize("name", LAWS)
def test_at_a_place_and_beyond_the_ends_the_numbers_of_the_place_hold(name: str) -> None:
    schedule = scheduled(LAWS[name], 1.0, 1.2, 0.8)
    random = np.random.default_rng(5)
    errors = 1e-5 * random.standard_normal(40)
    for place, position in zip(schedule.places, POSITIONS, strict=True):
        at = forces(schedule, np.full(40, position), errors)
        alone = forces(place.law, np.full(40, position), errors)
        # rounding of the interpolation, through the gains: some ulp of the largest term
        assert np.allclose(at, alone, rtol=1e-9, atol=1e-9 * np.max(np.abs(alone)))
    below = forces(schedule, np.full(40, -3.0), errors)
    assert np.array_equal(below, forces(schedule.places[0].law, np.full(40, -3.0), errors))
    beyond = forces(schedule, np.full(40, 8.0), errors)
    assert np.allclose(beyond, forces(schedule.places[2].law, np.full(40, 8.0), errors), rtol=1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_an_axis_that_moves_through_the_places_under_load_sees_no_bump(name: str) -> None:
    """400 N act, the axis follows exactly, and all numbers change by 20 and 33 % within 250 mm: the force stays."""
    law = LAWS[name]
    positions = 0.125 + 2.0**-12 * np.arange(2048)  # m: 0.125 to 0.625 m at 0.98 m/s
    found = forces(scheduled(law, 1.0, 1.2, 0.8, positions=(0.25, 0.375, 0.5)), positions, np.zeros(2048))
    alone = forces(law, positions, np.zeros(2048))
    # 1 N of 400 N: without the conversion of the state an integral of Σ T e jumps by 20 %, 80 N
    assert np.max(np.abs(found - alone)) < 1.0


def test_between_two_places_a_number_is_linear_in_the_position() -> None:
    """At 1.75 m, halfway between 1.0 and 2.5 m, the gains of a cascade are the means of both places."""
    schedule = scheduled(PPI, 1.0, 1.2, 0.8)
    signals = ["cut", "load_force"], ["force", "position_load"]
    halfway = linearize(loop_of(schedule), ["load_force"], signals[1], position=1.75)
    mean = linearize(loop_of(scaled(PPI, 1.0)), ["load_force"], signals[1], position=1.75)
    f = np.geomspace(1.0, 1900.0, 60)
    for output in signals[1]:
        assert np.allclose(halfway.response(f, output).response, mean.response(f, output).response, rtol=1e-9)
    elsewhere = linearize(loop_of(schedule), ["load_force"], signals[1], position=1.0)
    assert not np.allclose(elsewhere.response(f).response, mean.response(f).response, rtol=1e-2)


def test_a_change_of_a_schedule_in_a_running_loop_converts_the_state_where_the_axis_is() -> None:
    schedule = scheduled(LAWS["pole_placement"], 1.0, 1.2, 0.8)
    loop = replace(loop_of(schedule), name="x")
    hold = fd.blocks.StepForce(force=-300.0, start=0.05)
    changes = {0.6: {f"axis.x.control.law.places.{i}.law.bandwidth": 20.0 + i for i in range(3)}}
    still = fd.blocks.LinearMove(distance=1e-9, start=1.5, travel_time=0.1)
    run = fd.simulate(loop, still, load=hold, duration=1.2, start=(1.5, 1.5), changes=changes, record=["force"])
    late = run["force"][int(0.5 / T) :]
    # after 0.45 s the integral carries the load; the remaining creep is far below 1 N
    assert np.max(np.abs(late - 300.0)) < 1.0


def test_the_tunables_are_those_of_the_law_at_each_place() -> None:
    adr = LAWS["adr"]
    assert scheduled(adr, 1.0, 1.2, 0.8).tuned() == tuple(f"places.{i}.law.{n}" for i in range(3) for n in adr.tuned())
    assert scheduled(LAWS["pole_placement"], 1.0, 1.0, 1.0).positions() == 2
    assert scheduled(LAWS["dadsc"], 1.0, 1.0, 1.0).fed() == DADSC.feeds


PAYLOADS = (0.0, 200.0, 800.0)  # kg


def loaded(law: Law, payload: float, random: np.random.Generator) -> tuple[GainSchedule, np.ndarray]:
    """A schedule over three positions and three payloads with drawn factors of all numbers, and these factors."""
    factors = random.uniform(0.7, 1.4, (3, 3))
    places = tuple(
        SchedulePlace(
            position=x,
            loads=tuple(
                ScheduleLoad(payload=m, law=scaled(law, float(factor))) for m, factor in zip(PAYLOADS, row, strict=True)
            ),
        )
        for x, row in zip(POSITIONS, factors, strict=True)
    )
    return GainSchedule(payload=payload, places=places), factors


@pytest.mark.parametrize("name", ["cascade_ppi", "dadsc"])
def test_with_a_payload_the_numbers_are_linear_in_both_between_measured_pairs(name: str) -> None:
    """At any payload the schedule is the one over the position with the numbers for this payload, drawn by the test."""
    random = np.random.default_rng(41)
    law = LAWS[name]
    for payload in (*PAYLOADS, *random.uniform(0.0, 800.0, 4)):
        schedule, factors = loaded(law, float(payload), random)
        own = [float(np.interp(payload, PAYLOADS, row)) for row in factors]
        errors = 1e-5 * random.standard_normal(30)
        positions = np.cumsum(random.uniform(-0.2, 0.25, 30))
        there, alone = (forces(each, positions, errors) for each in (schedule, scheduled(law, *own)))
        # rounding of the numbers, through the gains
        assert np.allclose(there, alone, rtol=1e-9, atol=1e-9 * np.max(np.abs(alone)))


def test_a_payload_that_is_set_in_a_running_loop_moves_the_numbers_without_a_bump() -> None:
    schedule, _ = loaded(LAWS["pole_placement"], 0.0, np.random.default_rng(8))
    loop = replace(loop_of(schedule), name="x")
    hold = fd.blocks.StepForce(force=-300.0, start=0.05)
    still = fd.blocks.LinearMove(distance=1e-9, start=1.5, travel_time=0.1)
    given = {"load": hold, "duration": 1.2, "start": (1.5, 1.5), "record": ["force"]}
    run = fd.simulate(loop, still, changes={0.6: {"axis.x.control.law.payload": 700.0}}, **given)
    late = run["force"][int(0.5 / T) :]
    # after 0.45 s the integral carries the load; the remaining creep is far below 1 N
    assert np.max(np.abs(late - 300.0)) < 1.0
    with pytest.raises(ParameterError, match=r"payload = 801 kg must be between 0 kg and 800 kg, the payloads of plac"):
        fd.simulate(loop, still, changes={0.6: {"axis.x.control.law.payload": 801.0}}, **given)


def test_payloads_that_do_not_fit_their_places_are_refused() -> None:
    load = [ScheduleLoad(payload=m, law=PPI) for m in (0.0, 300.0)]
    place = SchedulePlace(position=0.0, loads=tuple(load))
    other = SchedulePlace(position=1.0, law=PPI)
    for given, said in (
        (
            {"places": (place, replace(place, position=1.0))},
            "payload is absent: a schedule over the payload needs both",
        ),
        ({"payload": 10.0, "places": (other, replace(other, position=2.0))}, "places.0 has one law for all payloads"),
        ({"payload": 10.0, "places": (place, other)}, "places.1"),
        ({"payload": 301.0, "places": (place, replace(place, position=1.0))}, "must be between 0 kg and 300 kg"),
    ):
        with pytest.raises((ParameterError, StructureError), match=said):
            GainSchedule(**given)  # type: ignore[arg-type]
    for given, said in (
        ({"loads": tuple(load), "law": PPI}, "needs either law or loads, and has both"),
        ({"loads": tuple(load[:1])}, "holds 1 payloads; it must be 2 to 10"),
        (
            {"loads": tuple(load[::-1])},
            r"loads\.1\.payload = 0 kg must be > 300 kg, the payload of loads\.0: list the lo",
        ),
        ({"loads": (load[0], ScheduleLoad(payload=9.0, law=LAWS["dadsc"]))}, "from cascade_ppi to dadsc with the payl"),
    ):
        with pytest.raises((ParameterError, StructureError), match=said):
            SchedulePlace(position=0.0, **given)  # type: ignore[arg-type]


MACHINE = """\
sample_time_us = 250
[axis.x.plant]
kind = "rigid"
mass_kg = 1900
[axis.x.control.law]
kind = "gain_schedule"
[[axis.x.control.law.places]]
position_mm = 400
law = { kind = "cascade_ppi", Kv = 45, Kp = 3.0e5, Tn_ms = 24 }
[[axis.x.control.law.places]]
position_mm = 1500
law = { kind = "cascade_ppi", Kv = 35, Kp = 2.6e5, Tn_ms = 28 }
[[axis.x.control.law.places]]
position_mm = 2700
law = { kind = "cascade_ppi", Kv = 30, Kp = 2.3e5, Tn_ms = 31 }
"""
SECOND = 'position_mm = 1500\nlaw = { kind = "cascade_ppi", Kv = 35, Kp = 2.6e5, Tn_ms = 28 }'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "position_mm = 1500",
            "position_mm = 400",
            r"places\.1\.position = 0\.4 m must be > 0\.4 m, the position of places\.0: list the places in ascending",
        ),
        ("2.6e5", "-2.6e5", r"axis\.x\.control\.law\.places\.1\.law\.Kp = -260000 N s/m .*must be > 0"),
        ("Tn_ms = 28", "Tn_ms = 28, velocity_samples = 2", r"velocity_samples would go from 1 to 2 along the travel"),
        (", Tn_ms = 28", "", r"places\.1\.law\.Tn would be left out along the travel"),
        ("2.6e5", "[2.6e5, 3e5]", r"places\.1\.law\.Kp .* must be a number"),
        (
            SECOND,
            "position_mm = 1500",
            r"places\.1: schedule_place needs either law or loads, and has neither: give the law",
        ),
        (SECOND, SECOND.replace("position_mm = 1500\n", ""), r"places\.1: schedule_place needs position"),
        (
            SECOND,
            'position_mm = 1500\nlaw = { kind = "linear_adrc", mass_kg = 9, omega_c = 9, omega_o = 9 }',
            r"would go from cascade_ppi to linear_adrc along the travel",
        ),
    ],
)
def test_bad_input_is_refused_with_line_key_value_and_what_to_do(tmp_path: Path, old: str, new: str, said: str) -> None:
    file = tmp_path / "m.toml"
    assert MACHINE.count(old) >= 1
    file.write_text(MACHINE.replace(old, new, 1), encoding="utf-8")
    with pytest.raises((ParameterError, StructureError), match=rf"m\.toml:\d+: .*{said}"):
        fd.read_machine(file)


def test_a_schedule_needs_two_to_ten_places_of_a_law_that_can_be_converted() -> None:
    place = SchedulePlace(position=0.0, law=PPI)
    with pytest.raises(StructureError, match="holds 1 places; it must be 2 to 10"):
        GainSchedule(places=(place,))
    with pytest.raises(StructureError, match="holds 11 places"):
        GainSchedule(places=tuple(replace(place, position=float(i)) for i in range(11)))
    pid = fd.blocks.LinuxcncPid(position=fd.blocks.StockPid(Pgain=60.0))
    with pytest.raises(StructureError, match="the force of linuxcnc_pid jumps at every change"):
        SchedulePlace(position=0.0, law=pid)
    with pytest.raises(StructureError, match="gain_schedule is itself a schedule"):
        SchedulePlace(position=0.0, law=scheduled(PPI, 1.0, 1.0, 1.0))


PREDICTIVE = fd.blocks.GeneralizedPredictive(mass=1900.0, omega_o=400.0, horizon=60)  # thousands
GPI = fd.blocks.GpiObserver(mass=1900.0, omega_o=200.0, taylor_states=0)  # 870


@pytest.mark.parametrize(
    "law",
    [PREDICTIVE, fd.blocks.ActiveDisturbanceRejection(mass=1900.0, omega_c=50.0, observer=GPI)],
    ids=lambda law: law.kind,
)
def test_a_law_that_computes_its_gains_by_many_operations_is_refused(law: Law) -> None:
    with pytest.raises(StructureError, match=f"{law.kind} computes its gains by more than 500 operations"):
        SchedulePlace(position=0.0, law=law)


class _Computing(Law):
    """A law whose `prepare` takes 500 or 501 operations."""

    gain: float = parameter("N/m", "gain")
    steps: int = choice("operations", least=1, most=10_000)

    def prepare(self, T: float) -> tuple[float, ...]:
        value = self.gain
        for i in range(self.steps):
            value = value + (2.0 + float(i))
        return (value,)

    def start(self, prepared: Any, setpoint: Setpoint, reading: Reading) -> tuple[float, ...]:
        return ()

    def step(self, prepared: Any, state: Any, setpoint: Setpoint, reading: Reading, T: float) -> Any:
        return (), prepared[0] * (setpoint.position - reading.position_load)


def test_five_hundred_operations_are_admitted_and_no_more() -> None:
    SchedulePlace(position=0.0, law=_Computing(gain=1.0, steps=500))
    for steps in (501, 5000):
        with pytest.raises(StructureError, match="more than 500 operations"):
            SchedulePlace(position=0.0, law=_Computing(gain=1.0, steps=steps))
