"""Proofs over a box of plants: sharp against dense grids and draws by other means, and refused where they do not hold.

`draws` is the check of `benchmarks/box.py`: it shares neither the model of the plant nor that of the law.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.certificate import box_proof
from feeddrive.certificate.box_proof import Cells, Family, Line, Prover, prove_over_box
from feeddrive.certificate.systems import deployed
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop
from independent_box import box_draws


@pytest.fixture(scope="module")
def draws() -> ModuleType:
    return box_draws()


@pytest.fixture(scope="module")
def motor() -> Loop:
    return fd.read_machine("linear_motor").loop("x")


@pytest.fixture(scope="module")
def table() -> Loop:
    """An axis of two masses, under P-PI gains with which the worst plant of a box lies between its corners."""
    loop = fd.read_machine("machining_center").loop("x")
    law = replace(loop.control.law, Kv=150.0, Kp=37_240.0, Tn=0.0485)
    return replace(loop, control=replace(loop.control, law=law))


def with_gain(loop: Loop, Kp: float) -> Loop:
    return replace(loop, control=replace(loop.control, law=replace(loop.control.law, Kp=Kp)))


def peak_of(loop: Loop) -> float:
    return float(
        margins(loop_model(loop).loop_gain(np.geomspace(1.0, 0.499 / float(loop.sample_time), 4000))).sensitivity_peak
    )


def prover(loop: Loop, box: Box, least: float = 0.5) -> Prover:
    model = deployed(loop.control, float(loop.sample_time)).model
    assert isinstance(model, StateSpace)
    return Prover(loop, box, model, least)


def test_the_bound_of_a_rigid_axis_is_that_of_its_worst_end(motor: Loop) -> None:
    """One mass: Ms over the box is that at an end of it or between; here a grid of plants tells it to 0.1 %."""
    box = Box(0.0, 0.3, 1)
    worst = max(peak_of(box.plant(motor, Corner((u,), late))) for u in np.linspace(-1.0, 1.0, 7) for late in (0, 1))
    proof = prove_over_box(motor, box, sensitivity_peak=1.002 * worst)
    assert proof.proven is True
    refuted = prove_over_box(motor, box, sensitivity_peak=0.998 * worst)
    assert refuted.proven is False
    assert refuted.plant is not None
    assert peak_of(box.plant(motor, refuted.plant)) > 0.998 * worst
    assert "|S| is" in refuted.reason


def test_a_worst_plant_between_the_corners_is_neither_proven_nor_overlooked(table: Loop, draws: ModuleType) -> None:
    box = Box(0.0, 0.3, 1)
    drawn = draws.Draws(table, box, 400, seed=3).under(table.control)
    assert prove_over_box(table, box, sensitivity_peak=1.01 * drawn.peak).proven is True
    below = prove_over_box(table, box, sensitivity_peak=0.995 * drawn.peak)
    assert below.proven is False
    assert below.plant is not None
    assert peak_of(box.plant(table, below.plant)) > 0.994 * drawn.peak


def test_a_bound_that_only_a_plant_between_the_corners_violates(table: Loop) -> None:
    """All corners keep it, so the violation is found by halving alone."""
    box = Box(0.0, 0.3, 1)
    corners = max(peak_of(box.plant(table, corner)) for corner in box.corners(table.axis))
    inside = peak_of(box.plant(table, Corner((-1.0, 0.8), 1)))
    between = with_gain(table, 37_240.0)
    bound = max(corners, inside) * 0.9995
    found = prove_over_box(between, box, sensitivity_peak=bound)
    assert found.proven is False


def test_stability_is_proven_up_to_the_gain_at_which_a_corner_is_lost(motor: Loop) -> None:
    box = Box(0.0, 0.3, 1)
    light = Corner((-1.0,), 1)
    low, high = 20_000.0, 400_000.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        stable = stability(box.plant(with_gain(motor, middle), light)).stable
        low, high = (middle, high) if stable else (low, middle)
    assert prove_over_box(with_gain(motor, 0.999 * low), box).proven is True
    lost = prove_over_box(with_gain(motor, 1.001 * low), box)
    assert lost.proven is False
    assert lost.plant == light
    assert "unstable at mass -30 %, 1 sample later: a pole at |z| = 1.00" in lost.reason


def chain(stiffness: float, dead_samples: float, bandwidth: float | None, T: float = 2e-4) -> Loop:
    plant = TwoMass(mass_motor=40.0, mass_load=90.0, stiffness=stiffness, damping=900.0, viscous_load=50.0)
    axis = Axis(
        plant=plant,
        actuator=Actuator(dead_time=dead_samples * T, current_loop=bandwidth),
        encoder_motor=Encoder(),
        encoder_load=Encoder(),
    )
    law = CascadePPI(Kv=40.0, Kp=20_000.0, Tn=0.03)
    return Loop(control=Control(law=law), axis=axis, sample_time=T)


@pytest.mark.parametrize(("dead", "bandwidth"), [(0.0, None), (1.0, 800.0), (0.37, 1500.0), (2.6, None)])
def test_the_sum_over_images_is_the_sampled_plant(dead: float, bandwidth: float | None) -> None:
    """The term of k = 0 differs from the exact hold by no more than the bound of all others, also up to Nyquist."""
    loop, box = chain(5e7, dead, bandwidth), Box(0.2, 0.3, 1)
    tested = prover(loop, box)
    family = Family(loop.axis, box, ("reading_motor", "reading_load"))
    f = np.linspace(0.002, 0.999, 150) * 0.5 / float(loop.sample_time)
    shares: list[float] = []
    for corner in (Corner((0.0, 0.0, 0.0), 0), Corner((0.6, -0.7, 0.9), 1)):
        model = linearize(box.plant(loop, corner), ["cut"], ["reading_motor", "reading_load"])
        place = np.tile(corner.place, (f.size, 1))
        cells = Cells(2.0 * np.pi * f, np.zeros(f.size), place, place, np.full(f.size, float(corner.late)))
        polynomials = family.corners(place, place)[:, 0]
        den, *nums = np.sum(polynomials * ((2j * np.pi * f)[:, None] ** tested.powers)[:, None], axis=2).T
        G = tested.drive(cells.omega, cells.delta, cells.late).value
        tails = tested.tails(family.corners(place, place)[:, :1], cells)
        for i, name in enumerate(("reading_motor", "reading_load")):
            apart = np.abs(model.response(f, name, "cut").response - G * nums[i] / den)
            assert np.all(apart <= tails[:, i] * (1.0 + 1e-6) + 1e-9 * np.abs(G * nums[i] / den))
            shares.append(float(np.max(apart / tails[:, i])))
    # a bound that no image comes near would be of no use
    assert max(shares) > 0.5


def test_lines_bound_every_product() -> None:
    random = np.random.default_rng(8)
    delta = np.array([0.3])
    for _ in range(200):
        a, b, slope_a, slope_b = random.normal(size=4) + 1j * random.normal(size=4)
        rests = np.abs(random.normal(size=2))
        product_ = Line(a, slope_a, rests[0]).times(Line(b, slope_b, rests[1]), delta)
        for t in np.linspace(-0.3, 0.3, 7):
            turn = np.exp(2j * np.pi * random.random(2)) * random.random(2)
            true = (a + slope_a * t + rests[0] * turn[0]) * (b + slope_b * t + rests[1] * turn[1])
            assert abs(true - product_.value - product_.slope * t) <= product_.rest * (1.0 + 1e-12)
            assert abs(true) <= product_.most(delta) * (1.0 + 1e-12)
            assert np.real(true * 1j) >= product_.least_along(np.array(1j), delta) - 1e-12


def test_polynomials_hold_on_their_interval(table: Loop) -> None:
    """Control and plant, at frequencies drawn within intervals, against their values there."""
    tested = prover(table, Box())
    random = np.random.default_rng(2)
    omega = np.array([0.5, 30.0, 2e3, 1.2e4])
    delta = omega * np.array([1.0, 0.3, 0.05, 0.1])
    lines = tested.control.on(omega, delta)
    cube = -np.ones((4, 3)), np.ones((4, 3))
    corners = tested.family.corners(*cube)
    plant = tested.polynomials(corners, omega, delta)
    G = tested.drive(omega, delta, np.ones(4))
    for t in random.uniform(-1.0, 1.0, 20):
        there, none = omega + t * delta, np.zeros(4)
        exact = [*tested.control.on(there, none), tested.drive(there, none, np.ones(4))]
        for line, point in zip([*lines, G], exact, strict=True):
            assert np.all(np.abs(point.value - line.value - line.slope * t * delta) <= line.rest + point.rest)
        for line, point in zip(plant, tested.polynomials(corners, there, none), strict=True):
            apart = np.abs(point.value - line.value - line.slope * (t * delta)[:, None])
            assert np.all(apart <= line.rest + point.rest)


def test_corners_of_cells_are_those_of_the_plant(table: Loop) -> None:
    """Polynomials between the corners of the box, against those of the plant itself: each parameter enters alone."""
    box = Box()
    family = Family(table.axis, box, ("reading_load",))
    low, high = np.array([[-0.3, 0.1, -1.0]]), np.array([[0.5, 0.4, 0.2]])
    found = family.corners(low, high)[0]
    for k, ends in enumerate(product((0, 1), repeat=3)):
        place = [float((low, high)[end][0, i]) for i, end in enumerate(ends)]
        assert found[k] == pytest.approx(Family.at(table.axis, box, place, ("reading_load",))[0], rel=1e-12)


def test_used_up_work_is_undecided(table: Loop, draws: ModuleType) -> None:
    drawn = draws.Draws(table, Box(), 300, seed=3).under(table.control)
    found = prove_over_box(table, Box(), sensitivity_peak=1.02 * drawn.peak, work=4000)
    assert found.proven is None
    assert found.verdict == "undecided"
    assert found.corners <= 4000
    assert "as many as are allowed" in found.reason


def test_cells_that_are_too_small_to_be_halved_are_undecided(motor: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    """At a bound that is proven with narrow intervals, and not with wide ones."""
    box = Box(0.0, 0.3, 1)
    bound = 1.01 * max(peak_of(box.plant(motor, corner)) for corner in box.corners(motor.axis))
    assert prove_over_box(motor, box, sensitivity_peak=bound).proven is True
    monkeypatch.setattr(box_proof, "_NARROW", 0.05)
    found = prove_over_box(motor, box, sensitivity_peak=bound)
    assert found.proven is None
    assert "too near to the bound" in found.reason


def test_a_plant_within_the_bound_of_the_images_is_undecided_at_once(motor: Loop) -> None:
    """The images of this axis take 1e-4 of Ms, and halving does not lower them: no million cells are tried."""
    box = Box(0.0, 0.0, 0)
    found = prove_over_box(motor, box, sensitivity_peak=peak_of(motor) * (1.0 + 2e-5))
    assert found.proven is None
    assert "the model is too near to the bound at 318" in found.reason
    assert found.cells < 5000
    assert prove_over_box(motor, box, sensitivity_peak=peak_of(motor) * (1.0 + 1e-3)).proven is True


def refused(loop: Loop, match: str, box: Box | None = None, **asked: Any) -> None:
    with pytest.raises(ParameterError, match=match):
        prove_over_box(loop, box or Box(), **asked)


def test_what_cannot_be_proven_is_refused(motor: Loop, table: Loop) -> None:
    modal = Modal(
        mass=40.0, viscous=10.0, modes=(Mode(frequency=80.0, damping_ratio=0.02, mass=50.0, motor=1.0, load=1.0),)
    )
    refused(
        replace(motor, axis=replace(motor.axis, plant=modal, friction_load=None)),
        "the plant 'modal' cannot be proven over a box: the frequency of a mode changes its damping as well",
    )
    coupled = replace(table.axis.plant, coupling_mass=10.0)
    refused(replace(table, axis=replace(table.axis, plant=coupled)), "enters in another way than as a mass or a spring")
    slow = replace(motor, control=replace(motor.control, law=replace(motor.control.law, position_every=4)))
    refused(slow, "a law with two rates is not proven over a box: set position_every = 1")
    refused(table, "max_ms = 0.9 must be above 1", sensitivity_peak=0.9)
    refused(table, r"box of 3 parameters: the first pass alone takes .* corners", work=1000)


def test_friction_that_is_not_viscous_is_refused(table: Loop) -> None:
    """At 5 mm/s the friction of this axis falls with velocity, which no viscous coefficient says."""
    assert table.axis.friction_load is not None
    refused(
        table, "the sampled model of the axis is not that of its masses, springs and viscous friction", velocity=5e-4
    )


def test_viscous_friction_is_part_of_the_damping() -> None:
    """The friction of the EMPS axis is its only damping: without it the sum over images is another plant."""
    loop = fd.read_machine("emps").loop("x")
    assert prove_over_box(loop, Box()).proven is True


@pytest.mark.slow(reason="10,000 draws for each of three machines against the proven bound, by other means, 60 s")
@pytest.mark.parametrize(("machine", "box"), [
    ("linear_motor", Box()), ("machining_center", Box()), ("ball_screw", Box(0.1, 0.1, 1)),
])  # fmt: skip
def test_no_plant_of_ten_thousand_exceeds_what_is_proven(machine: str, box: Box, draws: ModuleType) -> None:
    loop = next(iter(fd.read_machine(machine).loops.values()))
    drawn = draws.Draws(loop, box, 10_000, seed=21).under(loop.control)
    assert drawn.growth < 1.0
    assert prove_over_box(loop, box).proven is True
    assert prove_over_box(loop, box, sensitivity_peak=1.02 * drawn.peak).proven is True
    assert prove_over_box(loop, box, sensitivity_peak=0.999 * drawn.peak).proven is False


def test_a_loop_has_no_standard_errors_and_none_is_no_box(motor: Loop) -> None:
    with pytest.raises(ParameterError, match="--box identified takes the standard errors of a machine file"):
        fd.certify(motor, box="identified")
    assert type(fd.certify(motor, box=" none ")).__name__ == "Certificate"
