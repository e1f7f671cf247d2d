"""The published table of laws at equal Ms, delay margin and noise, on a rigid and on a two-mass axis, row by row; and
that no other optimizer finds anything better."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import minimize

from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.analysis.stiffness import force_noise, rope_snap, stiffness
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.controller.generalized_predictive import GeneralizedPredictive
from feeddrive.blocks.controller.linear_adrc import LinearADRC
from feeddrive.blocks.controller.super_twisting import SuperTwisting
from feeddrive.blocks.families import Compensation, Law
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.evaluation.robustness import Rule
from feeddrive.figures.of_loops import FORCE_NOISE
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, UnstableError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, candidates
from feeddrive.tuning.closed_loop import answer, encircles, unstable
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.tuning.tune import assess, law_tunables, tune_control

T = 1e-4
ON = {
    "R": Limits(sensitivity_peak=2.0, delay_margin_samples=2.0, force_noise_N=1.5e9, reading_noise=(1.0, 1.0)),
    "W": Limits(sensitivity_peak=2.0, delay_margin_samples=2.0, force_noise_N=1.2e9, reading_noise=(1.0, 1.0)),
}
TOLD = {"R": {"mass": 40.0, "viscous": 60.0}, "W": {"mass": 163.0, "viscous": 1520.0}}


def loop(on: str, law: Law, *beside: Compensation) -> Loop:
    """R: 40 kg, 60 N s/m, one encoder.  W: 130 and 33 kg on 18 N/um, both encoders.  One sample of dead time."""
    if on == "R":
        axis = Axis(plant=Rigid(mass=40.0, viscous=60.0), actuator=Actuator(dead_time=T), encoder_load=Encoder())
    else:
        plant = TwoMass(
            mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
        )
        axis = Axis(plant=plant, actuator=Actuator(dead_time=T), encoder_motor=Encoder(), encoder_load=Encoder())
    return Loop(control=Control(law=law, compensation=beside), axis=axis, sample_time=T)


def observed(on: str, form: str, rate: float) -> DisturbanceRejection:
    encoder = "load" if on == "R" else "motor"
    observer = DisturbanceRecovery(
        **TOLD[on], form=form, frequency=rate / (2.0 * math.pi), delay_samples=1, encoder=encoder
    )
    return DisturbanceRejection(observer=observer)


def gpi(on: str, states: int, omega_c: float, omega_o: float, zeta_o: float, encoder: str = "load", **more: Any) -> Law:
    mass = more.pop("mass", TOLD[on]["mass"])
    observer = GpiObserver(
        mass=mass, taylor_states=states, omega_o=omega_o, zeta_o=zeta_o, delay_samples=1, encoder=encoder, **more
    )
    return ActiveDisturbanceRejection(mass=mass, omega_c=omega_c, zeta_c=1.0, observer=observer)


RATES = ("law.omega_c", "law.observer.omega_o")


class Row(NamedTuple):
    """A row of the table: where its search begins, what is turned, and ISE^½ in m s^½/N as published.

    `share`: by which part ours may differ.  5 % where the row is the same law; what differs is said where it stands.
    """

    name: str
    on: str
    law: Law
    published: float
    beside: tuple[Compensation, ...] = ()
    turned: tuple[str, ...] | None = None
    share: float = 0.05


CASCADE = CascadePPI(Kv=300.0, Kp=5e4, Tn=3e-3)
ROWS = [
    Row("P-PI", "R", CASCADE, 3.216e-10),
    Row("DADSC", "R", DADSC(**TOLD["R"], tracking_rate=400.0, reaching_rate=400.0, adaptation_rate=400.0), 5.32e-10),
    Row("P-P + observer, one pole", "R", CascadePPI(Kv=300.0, Kp=4e4), 2.81e-10, (observed("R", "one_pole", 400.0),)),
    Row("P-P + observer, two poles", "R", CascadePPI(Kv=300.0, Kp=2e4), 2.40e-10, (observed("R", "two_poles", 1e3),)),
    # the observer's reading is a straight line between its samples, that of the table is held
    Row("GPI, 1 Taylor state", "R", gpi("R", 1, 300.0, 1200.0, 1.0), 3.05e-10, turned=RATES, share=0.10),
    Row("GPI, 3 Taylor states", "R", gpi("R", 3, 300.0, 500.0, 0.7071), 4.44e-10, turned=RATES),
    Row("GPI, 5 Taylor states", "R", gpi("R", 5, 300.0, 300.0, 0.7071), 7.72e-10, turned=RATES),
    Row("LADRC", "R", LinearADRC(mass=40.0, omega_c=300.0, omega_o=1200.0, delay_samples=1), 3.05e-10),
    Row("super-twisting", "R",
        SuperTwisting(mass=40.0, viscous=60.0, tracking_rate=300.0, zone_time=1.2e-3, disturbance_rate=5e4), 2.54e-10),
    # the table's search stopped short of the bound on the noise, at 1.36e9 of 1.5e9 N/m
    Row("GPC", "R",
        GeneralizedPredictive(mass=40.0, viscous=60.0, omega_o=2000.0, horizon=15, delay_samples=1), 2.80e-10,
        share=0.06),
    Row("P-PI", "W", CascadePPI(Kv=60.0, Kp=4e4, Tn=8e-3), 7.07e-9),
    Row("P-P + observer, one pole", "W", CascadePPI(Kv=100.0, Kp=3e4), 6.77e-9, (observed("W", "one_pole", 100.0),)),
    Row("P-PI + observer, two poles", "W", CascadePPI(Kv=60.0, Kp=4e4, Tn=8e-3), 6.92e-9,
        (observed("W", "two_poles", 60.0),)),
    Row("GPI, 1 Taylor state, observer on the motor, mass * 0.81", "W",
        gpi("W", 1, 100.0, 500.0, 1.0, "motor", mass=0.81 * 163.0), 7.09e-9, turned=RATES),
    Row("super-twisting", "W",
        SuperTwisting(mass=163.0, viscous=1520.0, tracking_rate=100.0, zone_time=5e-3, disturbance_rate=5e4), 6.78e-9),
    Row("LADRC on the load", "W", LinearADRC(mass=163.0, omega_c=60.0, omega_o=200.0, delay_samples=1), 43.8e-9),
    Row("LADRC, observer on the motor, mass * 0.81", "W",
        LinearADRC(mass=0.81 * 163.0, omega_c=100.0, omega_o=500.0, delay_samples=1, encoder="motor", position="load"),
        7.09e-9),
]  # fmt: skip


@pytest.mark.slow(reason="a search over the whole range for each law of the published table")
@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.on}: {row.name}")
def test_the_published_table_row_by_row(row: Row) -> None:
    found = tune_control(loop(row.on, row.law, *row.beside), limits=ON[row.on], filters="kept", tunables=row.turned)
    assert found.settled
    assert found.proven, found.proof
    assert found.after[0].rope_snap == pytest.approx(row.published, rel=row.share)


@pytest.mark.slow(reason="two searches of the whole range")
@pytest.mark.parametrize(
    ("law", "beside", "ise", "noise"),
    [
        (CascadePPI(Kv=300.0, Kp=4e4), (observed("R", "one_pole", 400.0),), 1.65e-10, 4.1e9),
        (LinearADRC(mass=40.0, omega_c=300.0, omega_o=1200.0, delay_samples=1), (), 2.68e-10, 2.5e9),
    ],
    ids=["P-P + observer, one pole", "LADRC"],
)
def test_without_a_bound_on_the_noise_an_observer_buys_recovery_with_it(
    law: Law, beside: tuple[Compensation, ...], ise: float, noise: float
) -> None:
    found = tune_control(
        loop("R", law, *beside), limits=Limits(sensitivity_peak=2.0, delay_margin_samples=2.0), filters="kept"
    )
    assert found.after[0].rope_snap == pytest.approx(ise, rel=0.03)
    exact = force_noise(loop_model(found.loops[0]).closed, 0.0, 1.0, shared=True)
    assert exact == pytest.approx(noise, rel=0.03)


def test_the_judge_gives_the_figures_of_the_table_at_its_own_gains() -> None:
    """P-PI at the published gains: 3.216e-10, noise 1.44e9 N/m, 712 and 118 N/um at 10 and 100 Hz; to their digits."""
    both = loop_model(loop("R", CascadePPI(Kv=688.0, Kp=93825.0, Tn=1.456e-3)))
    assert rope_snap(both.closed) == pytest.approx(3.216e-10, rel=1e-3)
    assert force_noise(both.closed, 0.0, 1.0, shared=True) == pytest.approx(1.44e9, rel=5e-3)
    found = stiffness(both.closed.response(np.array([10.0, 100.0]), "position_load", "load_force"))
    assert 1e-6 * found.magnitude == pytest.approx([712.0, 118.0], rel=5e-3)


def test_one_encoder_is_one_noise_in_both_readings() -> None:
    """The search's sum over lines against the sum over all samples of the closed loop; two noises would give 0.97."""
    given = loop("R", CascadePPI(Kv=1432.0, Kp=52320.0), observed("R", "one_pole", 2208.0))
    found = assess(given.control, given, rule="as it is", limits=ON["R"])
    exact = force_noise(loop_model(given).closed, 0.0, 1.0, shared=True)
    assert found.after[0].force_noise == pytest.approx(exact, rel=2e-3)
    assert not found.holds  # 2.05e9 N/m, where 1.5e9 is the bound


def test_a_symmetric_optimum_that_is_unstable_is_refused_whatever_its_Ms() -> None:
    """a = 2 for the motor's 130 kg on the two-mass axis: Ms 1.95 on the lines, and an eigenvalue of 1.024."""
    lag = 2.0 * T
    given = loop("W", CascadePPI(Kv=1.0 / (8.0 * lag), Kp=130.0 / (2.0 * lag), Tn=4.0 * lag))
    both = loop_model(given)
    shown = margins(both.loop_gain(both.lines(200)))
    assert shown.sensitivity_peak == pytest.approx(1.95, abs=0.01)
    assert stability(given).growth == pytest.approx(1.024, abs=1e-3)
    with pytest.raises(UnstableError, match="unstable with these gains"):
        assess(given.control, given, rule="symmetric optimum", limits=ON["W"])


def test_the_rule_of_a_comparison_says_what_is_broken() -> None:
    rule = Rule(2.0, 2.0, 1.05, 0.05, 2, noise=1e9)
    fine = {"sensitivity_peak": 2.0, "delay_margin_samples": 2.0, "noise_gain_N_per_m": 1e9}
    assert rule.broken(fine) == ""
    assert "1.2 N per nm" in rule.broken(fine | {"noise_gain_N_per_m": 1.2e9})
    assert "Ms 2.1" in rule.broken(fine | {"sensitivity_peak": 2.1})
    assert "1.9 samples" in rule.broken(fine | {"delay_margin_samples": 1.9})
    for said in ("Ms <= 2", "2 samples", "1 N RMS of force per nm", "eigenvalues", "told the same"):
        assert said in rule.sentence


# three Taylor states behind the spring: the observer leaves the control a resonance of its own at 0.1 to 0.2 Hz
SLOW = ((130.0, 54.0), (175.4, 68.37), (172.0, 74.0), (400.0, 68.0), (120.0, 300.0))


def test_a_slow_resonance_of_the_control_hides_no_stable_loop() -> None:
    """Where only a part of it is on the lines, the slope of the gain said "unstable" of loops that are not."""
    given = loop("W", gpi("W", 3, 130.0, 54.0, 0.7071))
    point = modelled_point(given)
    response = ControlResponse(given.control, T, RATES)
    said: list[bool] = []
    for rates in SLOW:
        there = tree.vary(given, {f"axis.x.control.{name}": value for name, value in zip(RATES, rates, strict=True)})
        found = answer(point, response.at(rates, point.frequency))
        said.append(stability(there).stable)
        assert unstable(found) is not said[-1], rates
        assert encircles(found) is not said[-1], rates
    assert said == [True, True, True, False, False]


@pytest.mark.slow(reason="three searches of a law of 5,000 operations")
def test_three_taylor_states_on_two_masses_settle_at_the_optimum_of_a_fine_grid() -> None:
    """104 nm √s/N, where searches ended at 177; the grid is judged by the model of the whole loop."""
    given = loop("W", gpi("W", 3, 130.0, 54.0, 0.7071))
    found = tune_control(given, limits=ON["W"], filters="kept", tunables=RATES)
    assert found.settled, found.unsettled
    best = math.inf
    for omega_c in np.geomspace(100.0, 300.0, 12):
        for omega_o in np.geomspace(40.0, 120.0, 12):
            there = loop("W", gpi("W", 3, float(omega_c), float(omega_o), 0.7071))
            if not stability(there).stable:
                continue
            both = loop_model(there)
            shown = margins(both.loop_gain(both.lines(60)))
            noise = force_noise(both.closed, 1.0, 1.0)
            if shown.sensitivity_peak <= 2.0 and (shown.delay_margin_samples or 9.0) >= 2.0 and noise <= 1.2e9:
                best = min(best, rope_snap(both.closed))
    assert found.after[0].rope_snap == pytest.approx(1.0423e-7, rel=1e-3)
    # the grid's nodes are 10 % apart: its best lies above the optimum, and by less than a third
    assert found.after[0].rope_snap <= best <= 1.35 * found.after[0].rope_snap


MACHINES = ("linear_motor", "ball_screw", "mill", "emps", "xy_table")


def crude(given: Loop, limits: Limits, velocity: float, begun: dict[str, float]) -> float:
    """ISE^½ by Nelder-Mead over the same tunables, goal and limits, computed from the model of the whole loop."""
    names = list(begun)
    most = limits.bound(FORCE_NOISE)
    assert most is not None
    one, bound = given.axis.one_encoder(), most / limits.reading_noise[0]

    def cost(x: np.ndarray) -> float:
        values = dict(zip(names, np.exp(x).tolist(), strict=True))
        try:
            there = Loop(control=tree.vary(given.control, values), axis=given.axis, sample_time=given.sample_time)
            if not stability(there, velocity=velocity).stable:
                return 1e3
            both = loop_model(there, velocity=velocity)
            m = margins(both.loop_gain(both.lines(60)))
            noise = force_noise(both.closed, 0.0 if one else 1.0, 1.0, shared=one)
            ise = rope_snap(both.closed)
        except (FeeddriveError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return 1e3
        if not math.isfinite(ise):
            return 1e3
        delay = math.inf if m.delay_margin_samples is None else m.delay_margin_samples
        broken = max(math.log(m.sensitivity_peak / 2.0), math.log(noise / bound), math.log(2.0 / max(delay, 1e-9)), 0.0)
        return math.log(ise) + 30.0 * broken

    best = math.inf
    random = np.random.default_rng(5)
    x = np.log(list(begun.values()))
    for size in (0.0, 0.7, 0.7):
        start = x + random.uniform(-size, size, x.size)
        best = min(best, minimize(cost, start, method="Nelder-Mead", options={"maxfev": 150 * x.size}).fun)
    return math.exp(min(best, 700.0))


@lru_cache(maxsize=8)
def rule_of(machine: str) -> Rule:
    """The rule with the noise that P-PI makes on a machine."""
    rule, loop = Rule(2.0, 2.0, 1.05, 0.05, 2), next(iter(read_machine(machine).loops.values()))
    plain = next(each for each in candidates(loop)[0] if each.name == PLAIN)
    return rule.with_noise_of(tune_control(plain.loop, limits=UNBOUND, filters="kept"))


UNBOUND = Limits(
    sensitivity_peak=2.0, delay_margin_samples=2.0, force_noise_N=1e6, reading_noise=(1e-9, 1e-9)
)  # noise of 1e15 N/m
LAWS = (
    PLAIN,
    "P-PI + recovery",
    "P-PI + Kalman recovery",
    "P-PI + GPI recovery",
    "GPI, 5 Taylor states",
    "GPI, 3 Taylor states",
    "GPI, 1 Taylor state",
    "DADSC",
    "DADSC + recovery",
    "DADSC + Kalman recovery",
    "DADSC + GPI recovery",
    "pole placement",
)


@pytest.mark.slow(reason="every law on every bundled machine, searched twice by independent optimizers")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("machine", MACHINES)
def test_a_crude_search_finds_nothing_better(machine: str, law: str) -> None:
    """Nelder-Mead from the law's own start and twice from beside it: by no more than 5 % below what was found."""
    given = next(iter(read_machine(machine).loops.values()))
    made, refused = candidates(given)
    candidate = next((each for each in made if each.name == law), None)
    if candidate is None:
        assert law in {each.name for each in refused}
        return
    rule = rule_of(machine)
    limits = UNBOUND if law == PLAIN else rule.limits()
    found = tune_control(candidate.loop, limits=limits, filters="kept")
    begun = {name: float(tree.get(candidate.loop.control, name)) for name in law_tunables(candidate.loop.control)}
    ise = crude(candidate.loop, limits, rule.velocity, begun)
    assert not found.settled or ise > 0.95 * found.after[0].rope_snap
