"""Friction in an axis against truths that share nothing with it: event-driven runs, stiff solvers for smooth laws."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from axis_runs import Dry, EventDriven, matrices, move
from feeddrive.blocks.families import Friction, Plant
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.lugre import Lugre
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.language import tree
from feeddrive.loop.axis import Axis
from feeddrive.loop.core import advance
from slow_share import all_but

T = 1e-3
SAMPLES = 25
SUBSTEPS = np.array([1, 2, 4, 8])
Case = tuple[Plant, dict[str, Friction], list[Dry]]


def curve(coulomb: float, breakaway: float, v_s: float, extra: float = 0.0) -> Callable[[float], float]:
    """A level over |v|, with a viscous part beyond that of the linear core."""
    return lambda v: coulomb + (breakaway - coulomb) * float(np.exp(-((v / v_s) ** 2))) + extra * abs(v)


def coulomb(rng: np.random.Generator, body: int) -> tuple[Friction, Dry]:
    level = rng.uniform(20.0, 100.0)
    flat = curve(level, level, 1.0)
    return Coulomb(coulomb=level, viscous=rng.uniform(0, 500)), Dry(body, flat, flat)


def stribeck(rng: np.random.Generator, body: int) -> tuple[Friction, Dry]:
    level, v_s = rng.uniform(20.0, 100.0), 10.0 ** rng.uniform(-2.5, -1.0)
    breakaway = level * rng.uniform(1.0, 1.5)
    made = Stribeck(coulomb=level, breakaway=breakaway, stribeck_velocity=v_s, viscous=rng.uniform(0, 500))
    return made, Dry(body, curve(level, breakaway, v_s), curve(level, breakaway, v_s))


def directional(rng: np.random.Generator, body: int) -> tuple[Friction, Dry]:
    up, down = rng.uniform(20.0, 100.0, 2)
    more, less = rng.uniform(0.0, 800.0, 2)
    made = Directional(coulomb_positive=up, coulomb_negative=down, viscous_positive=more, viscous_negative=less)
    linear = min(more, less)  # what the linear core holds
    return made, Dry(body, curve(up, up, 1.0, more - linear), curve(down, down, 1.0, less - linear))


def directional_stribeck(rng: np.random.Generator, body: int) -> tuple[Friction, Dry]:
    up, down = rng.uniform(20.0, 100.0, 2)
    rise_up, rise_down = rng.uniform(1.0, 1.5, 2)
    v_s = 10.0 ** rng.uniform(-2.5, -1.0)
    made = DirectionalStribeck(
        coulomb_positive=up,
        coulomb_negative=down,
        breakaway_positive=rise_up * up,
        breakaway_negative=rise_down * down,
        stribeck_velocity=v_s,
        viscous=rng.uniform(0, 500),
    )
    return made, Dry(body, curve(up, rise_up * up, v_s), curve(down, rise_down * down, v_s))


Law = Callable[[np.random.Generator, int], tuple[Friction, Dry]]
LAWS: list[Law] = [coulomb, stribeck, directional, directional_stribeck]


def rigid(rng: np.random.Generator, law: Law) -> Case:
    friction, dry = law(rng, 0)
    return Rigid(mass=10.0 ** rng.uniform(1.0, 2.5)), {"friction_load": friction}, [dry]


def two_mass(rng: np.random.Generator, law: Law) -> Case:
    m1 = 10.0 ** rng.uniform(1.0, 2.5)
    m2 = m1 * rng.uniform(0.2, 1.0)
    k = (2 * np.pi * rng.uniform(40.0, 150.0)) ** 2 * m1 * m2 / (m1 + m2)
    plant = TwoMass(mass_motor=m1, mass_load=m2, stiffness=k, damping=0.04 * float(np.sqrt(k * m2)))
    friction, dry = law(rng, 0)
    level = rng.uniform(5.0, 30.0)
    other = Dry(1, curve(level, level, 1.0), curve(level, level, 1.0))
    return plant, {"friction_motor": friction, "friction_load": Coulomb(coulomb=level)}, [dry, other]


def errors(case: Case, commands: np.ndarray) -> np.ndarray:
    """RMS position error of the load in m against the event-driven truth, for each number of substeps."""
    plant, frictions, dry = case
    M, C, K = matrices(Axis(plant=plant, **frictions))
    n = len(M)
    forces = np.zeros((len(commands), n))
    forces[:, 0] = commands
    true = EventDriven(M, C, K, dry).run(T, forces, np.zeros(2 * n))[:, n - 1]
    found = [move(Axis(plant=plant, substeps=int(s), **frictions), T, commands).position[:, -1] for s in SUBSTEPS]
    return np.array([np.sqrt(np.mean((x - true) ** 2)) for x in found])


def excitation(rng: np.random.Generator, level: float) -> np.ndarray:
    """A sine with noise that sticks and slips: 1 to 3 times the breakaway level in N."""
    k = np.arange(SAMPLES)
    wave = rng.uniform(1.0, 3.0) * np.sin(2 * np.pi * rng.uniform(30.0, 120.0) * k * T + rng.uniform(0, 6))
    return level * (wave + rng.normal(0.0, 0.2, SAMPLES))


@pytest.mark.parametrize(
    ("plant", "law"),
    all_but(
        [*((rigid, law) for law in LAWS), (two_mass, LAWS[-1])],
        [(plant, law) for plant in (rigid, two_mass) for law in LAWS],
        "the same contact on two masses, for more friction laws",
    ),
    ids=lambda each: each.__name__,
)
def test_error_falls_with_the_first_order_of_the_substep(
    plant: Callable[[np.random.Generator, Law], Case], law: Law
) -> None:
    rng = np.random.default_rng([LAWS.index(law), plant is rigid])
    logs = []
    while len(logs) < 10:
        case = plant(rng, law)
        found = errors(case, excitation(rng, case[2][0].positive(0.0)))
        if found[0] > 1e-12:  # else the load has not moved at all, and there is no order to see
            logs.append(np.log(found))
    slope = float(np.polyfit(np.log(SUBSTEPS), np.mean(logs, axis=0), 1)[0])
    # Order 1 at every stop and break-away, 2 in between: the mean over cases lies from 1 to 2.  Where the events fall
    # within a substep is chance: the slope of a single case scatters by ±0.6, the mean over ten by ±0.2.
    assert -2.0 < slope < -0.8


def test_stick_slip_stays_within_100_nm_of_the_truth_at_20_kHz() -> None:
    # A heavy slide pulls a table at 2 mm/s over a spring: the classic case, 60 % of the time stuck, 160 µm of travel.
    level = curve(60.0, 100.0, 4e-3)
    plant = TwoMass(mass_motor=1e5, mass_load=33.0, stiffness=2e6, damping=200.0)
    friction = Stribeck(coulomb=60.0, breakaway=100.0, stribeck_velocity=4e-3)
    M, C, K = matrices(Axis(plant=plant, friction_load=friction))
    true = EventDriven(M, C, K, [Dry(1, level, level)]).run(5e-5, np.zeros((2000, 2)), np.array([0, 0, 2e-3, 0.0]))
    assert 0.4 < np.mean(true[:, 3] == 0.0) < 0.8
    rms = []
    for substeps in (1, 2):
        x = _pulled(Axis(plant=plant, friction_load=friction, substeps=substeps))
        rms.append(float(np.sqrt(np.mean((x - true[:, 1]) ** 2))))
    # each slip begins up to one substep late: 50 µs at 2 mm/s are 100 nm
    assert rms[0] < 100e-9
    assert rms[1] < 0.6 * rms[0]


def _pulled(axis: Axis) -> np.ndarray:
    """Positions of the load when the motor's body starts at 2 mm/s and the load at rest."""
    axis = tree.rebuild(axis, (np.float64(value) for _, value in tree.leaves(axis)))
    step, timing = np.float64(5e-5), axis.timing(5e-5)
    prepared = axis.prepare(step, timing)
    state = axis.start(np.float64(0.0), np.float64(0.0), timing)._replace(velocity=(np.float64(2e-3), np.float64(0.0)))
    found = [0.0]
    for _ in range(2000):
        state, _ = advance(axis, prepared, state, np.float64(0.0), None, np.float64(0.0), step)
        found.append(float(state.position[1]))
    return np.array(found)


Slope = Callable[[float, np.ndarray, float], list[float]]


def smooth_truth(slope: Slope, states: int, commands: Sequence[float], step: float) -> np.ndarray:
    """Positions at kT by an implicit Runge-Kutta method of order 5 at 1e-9."""
    y = np.zeros(states)
    rows = [0.0]
    for force in commands:
        done = solve_ivp(slope, (0.0, step), y, method="Radau", rtol=1e-9, atol=1e-13, args=(force,))
        y = done.y[:, -1]
        rows.append(float(y[0]))
    return np.array(rows)


def order(mass: float, friction: Friction, commands: np.ndarray, step: float, true: np.ndarray) -> tuple[float, float]:
    """Slope of the RMS error over substeps, and the RMS error at one substep as a share of the RMS travel."""
    rms = []
    for substeps in (1, 2, 4, 8):
        found = move(Axis(plant=Rigid(mass=mass), friction_load=friction, substeps=substeps), step, commands)
        rms.append(float(np.sqrt(np.mean((found.position[:, 0] - true) ** 2))))
    return float(np.polyfit(np.log([1, 2, 4, 8]), np.log(rms), 1)[0]), rms[0] / float(np.sqrt(np.mean(true**2)))


@pytest.mark.parametrize("seed", range(3))
def test_lugre_converges_to_its_differential_equations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, level, v_s = rng.uniform(20, 150), rng.uniform(20, 100), 10.0 ** rng.uniform(-2.5, -1.5)
    breakaway, s0, s2 = level * rng.uniform(1.0, 1.5), 10.0 ** rng.uniform(6.0, 7.0), rng.uniform(0, 300)
    s1 = 2.0 * 0.7 * float(np.sqrt(s0 * m)) * rng.uniform(0, 1)

    def slope(_t: float, y: np.ndarray, force: float) -> list[float]:
        _, v, z = y
        rate = v - s0 * abs(v) * z / (level + (breakaway - level) * np.exp(-((v / v_s) ** 2)))
        return [v, (force - s2 * v - s0 * z - s1 * rate) / m, rate]

    step = 5e-4
    commands = 1.5 * breakaway * np.sin(2 * np.pi * 40.0 * step * np.arange(50))
    friction = Lugre(
        coulomb=level, breakaway=breakaway, stribeck_velocity=v_s, bristle_stiffness=s0, bristle_damping=s1, viscous=s2
    )
    found, share = order(m, friction, commands, step, smooth_truth(slope, 3, commands, step))
    # backward Euler in a smooth problem: clean order 1, and at h = 0.2 √(m/σ0) an error of a tenth
    assert -1.1 < found < -0.9
    assert share < 0.15


@pytest.mark.parametrize(("v_t", "curved"), [(2e-4, False), (2e-4, True), (1e-5, False), (3e-3, True)])
def test_regularised_converges_to_its_differential_equation(v_t: float, curved: bool) -> None:
    m, level, breakaway, v_s = 60.0, 60.0, 90.0, 0.01

    def slope(_t: float, y: np.ndarray, force: float) -> list[float]:
        _, v = y
        extra = (breakaway - level) * np.exp(-((v / v_s) ** 2)) if curved else 0.0
        return [v, (force - 200.0 * v - (level + extra) * np.tanh(v / v_t)) / m]

    step = 5e-4
    commands = 130.0 * np.sin(2 * np.pi * 40.0 * step * np.arange(50))
    friction = Regularised(
        coulomb=level,
        transition_velocity=v_t,
        viscous=200.0,
        breakaway=breakaway if curved else None,
        stribeck_velocity=v_s if curved else None,
    )
    found, share = order(m, friction, commands, step, smooth_truth(slope, 2, commands, step))
    # order 1; the reversal of a steep tanh is an event, which bends the slope as with set-valued friction
    assert -1.4 < found < -0.75
    assert share < 0.05
