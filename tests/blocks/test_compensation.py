"""What acts on estimates beside a law: rejection of disturbances, compensation of the machine's modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blocks.test_dadsc import law
from feeddrive.analysis.stability import stability
from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.compensation.machine_mode import MachineMode
from feeddrive.blocks.compensation.mode_compensation import ModeCompensation
from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Compensation, Law, Plant
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.load.force_sum import ForceSum
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.observer.kalman_recovery import KalmanRecovery
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.papers.altintas2009.recovery import swing

REST = Polynomial7(distance=0.0, travel_time=1.0)


def fast(mass: float = 40.0, rate: float = 600.0) -> Law:
    return law(mass=mass, tracking_rate=rate, reaching_rate=rate, adaptation_rate=rate)


def loop(
    control: Law, compensation: tuple[Compensation, ...] = (), plant: Plant | None = None, T: float = 1e-4
) -> Loop:
    forward = () if "acceleration" in control.feeds else (Inertia(mass=40.0, viscous=60.0),)
    rigid = plant is None
    axis = Axis(
        plant=Rigid(mass=40.0, viscous=60.0) if plant is None else plant, encoder_motor=None if rigid else Encoder()
    )
    return Loop(control=Control(law=control, feedforward=forward, compensation=compensation), axis=axis, sample_time=T)


PPI = CascadePPI(Kv=60.0, Kp=12e3, Tn=0.02)


@pytest.mark.parametrize(
    "observer",
    [
        DisturbanceRecovery(mass=40.0, viscous=60.0),
        DisturbanceRecovery(mass=40.0, viscous=60.0, form="one_pole", frequency=200.0),
        KalmanRecovery(mass=40.0, viscous=60.0, resolution=1e-8, force_step=20.0),
        GpiObserver(mass=40.0, omega_o=1500.0),
    ],
    ids=lambda o: o.kind,
)
def test_any_observer_stiffens_a_cascade(observer: DisturbanceRecovery) -> None:
    load = StepForce(force=200.0, start=0.05)
    peaks = []
    for compensation in ((), (DisturbanceRejection(observer=observer),)):
        made = loop(PPI, compensation)
        assert stability(made).stable
        peaks.append(np.max(np.abs(simulate(made, REST, load=load, duration=0.3)["tracking_error"])))
    assert peaks[1] < 0.5 * peaks[0]


def test_half_the_share_takes_out_half_the_force_at_first() -> None:
    """A P velocity loop: the static error under a force is (1 - share) of that without rejection."""
    soft = CascadePPI(Kv=60.0, Kp=12e3)
    observer = DisturbanceRecovery(mass=40.0, viscous=60.0)
    ends = []
    for share in (0.0, 0.5):
        made = loop(soft, (DisturbanceRejection(observer=observer, share=share),))
        run = simulate(made, REST, load=StepForce(force=200.0), duration=1.0)
        ends.append(run["tracking_error"][-1])
    assert ends[0] == pytest.approx(-200.0 / (60.0 * 12e3), rel=1e-3)
    assert ends[1] == pytest.approx(0.5 * ends[0], rel=1e-3)


def test_a_rejection_is_blended_in() -> None:
    observer = DisturbanceRecovery(mass=40.0, viscous=60.0)
    made = loop(PPI, (DisturbanceRejection(observer=observer, blend_time=0.1),))
    force = simulate(made, REST, load=StepForce(force=200.0), duration=0.5)["compensation"]
    assert abs(force[5]) < 1.0
    assert np.max(np.abs(np.diff(force))) < 5.0  # without blending the first recovered samples jump by tens of N
    assert force[-1] == pytest.approx(-200.0, abs=0.5)


def test_a_linear_model_has_the_whole_share_of_a_rejection_that_blends_in() -> None:
    observer = DisturbanceRecovery(mass=40.0, viscous=60.0)
    at_once, slowly = (
        stability(loop(PPI, (DisturbanceRejection(observer=observer, blend_time=time),))) for time in (None, 0.1)
    )
    np.testing.assert_array_equal(slowly.model.poles(), at_once.model.poles())
    assert len(at_once.model.poles()) > len(stability(loop(PPI)).model.poles())


def test_a_disturbance_is_not_rejected_twice() -> None:
    observer = GpiObserver(mass=40.0, omega_o=700.0)
    twice = ActiveDisturbanceRejection(mass=40.0, observer=observer, omega_c=100.0)
    with pytest.raises(StructureError, match="subtracts the disturbance of its own observer already"):
        loop(twice, (DisturbanceRejection(observer=observer),))


def mode(frequency: float = 35.0, **changes: object) -> MachineMode:
    return replace(MachineMode(frequency=frequency, damping_ratio=0.03, stiffness=2e7), **changes)  # type: ignore[arg-type]


def test_a_mode_takes_stiffness_or_mass() -> None:
    with pytest.raises(ParameterError, match="both are given of stiffness and mass"):
        MachineMode(frequency=35.0, stiffness=2e7, mass=400.0)
    with pytest.raises(ParameterError, match="neither is given"):
        MachineMode(frequency=35.0)
    by_mass = MachineMode(frequency=35.0, mass=2e7 / (2 * np.pi * 35.0) ** 2)
    assert by_mass.modal_mass() == pytest.approx(mode().modal_mass(), rel=1e-14)


def test_a_compensation_without_modes_or_above_nyquist_is_refused() -> None:
    observer = DisturbanceRecovery(mass=40.0)
    with pytest.raises(ParameterError, match="modes is empty"):
        ModeCompensation(modes=(), observer=observer)
    with pytest.raises(ParameterError, match=r"modes\.1\.frequency = 6000 Hz must be below half the sample rate"):
        loop(PPI, (ModeCompensation(modes=(mode(), mode(6000.0)), observer=observer),))


def tool_error(
    control: Law,
    compensation: tuple[Compensation, ...],
    modes: tuple[MachineMode, ...],
    load: SineForce | ForceSum,
    T: float = 1e-4,
) -> float:
    """RMS in m of the error at the tool in the second half of 2 s."""
    run = simulate(loop(control, compensation, T=T), REST, load=load, duration=2.0)
    error = run["position_load"] - sum(swing(each, -run["load_force"], T) for each in modes)
    return float(np.sqrt(np.mean(error[error.size // 2 :] ** 2)))


def test_a_lead_over_which_a_mode_cannot_be_predicted_is_refused() -> None:
    """Drawn by the battery: with 1.7 kHz over 1 s the mode's exponential overflowed, and the set position was NaN."""
    fast = MachineMode(frequency=1757.0, damping_ratio=0.7, mass=3.0)
    slow = GpiObserver(mass=5.0, omega_o=20.0, taylor_states=1)
    given = ModeCompensation(modes=(fast,), observer=slow, lead_time=0.98)
    own = replace(given, lead_time=None)
    assert slow.lag(slow.prepare(1e-4), 1e-4) > 0.05  # s
    for block, said in ((given, "lead_time = 0.98 s is 1722 periods"), (own, "lag of its observer, = .* periods")):
        with pytest.raises(ParameterError, match=rf"{said} of modes.0 with its 1757 Hz: at most 0\.01364 s can be"):
            tree.check_sampled(block, 1e-4)
    kept = replace(given, lead_time=0.0136)
    tree.check_sampled(kept, 1e-4)
    assert np.all(np.isfinite(kept.prepare(1e-4).lead))
    base = replace(own, modes=(replace(fast, place="base"),))
    tree.check_sampled(base, 1e-4)  # driven by the applied force itself, which has no delay


@pytest.mark.parametrize("T", [5e-5, 1e-4, 2.5e-4])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_any_number_of_modes_is_compensated_at_any_sample_time(count: int, T: float) -> None:
    modes = (mode(25.0), mode(40.0, stiffness=5e7), mode(15.0, stiffness=4e7, damping_ratio=0.05))[:count]
    load = ForceSum(loads=tuple(SineForce(amplitude=60.0, frequency=each.frequency) for each in modes))
    observer = DisturbanceRecovery(mass=40.0, viscous=60.0)
    model = ModeCompensation(modes=modes, observer=observer)
    none = tool_error(fast(), (), modes, load, T)
    left = tool_error(fast(), (model,), modes, load, T)
    assert left < none / 30.0
    later = tool_error(fast(), (replace(model, lead_time=0.0),), modes, load, T)
    assert later > 3.0 * left


def test_modes_are_compensated_under_a_cascade_and_with_another_observer() -> None:
    control = CascadePPI(Kv=260.0, Kp=64e3, Tn=0.004)
    load = SineForce(amplitude=100.0, frequency=35.0)
    none = tool_error(control, (), (mode(),), load)
    for observer in (
        DisturbanceRecovery(mass=40.0, viscous=60.0),
        KalmanRecovery(mass=40.0, viscous=60.0, resolution=1e-8, force_step=20.0),
    ):
        model = ModeCompensation(modes=(mode(),), observer=observer)
        assert tool_error(control, (model,), (mode(),), load) < none / 15.0


def test_rejection_and_modes_go_together() -> None:
    """The modes take the slow cascade's own compliance as their bound; rejection moves that bound."""
    observer = DisturbanceRecovery(mass=40.0, viscous=60.0)
    load = SineForce(amplitude=100.0, frequency=35.0)
    model = ModeCompensation(modes=(mode(),), observer=observer)
    alone = tool_error(PPI, (model,), (mode(),), load)
    both = tool_error(PPI, (DisturbanceRejection(observer=observer), model), (mode(),), load)
    assert both < 0.3 * alone


@pytest.mark.parametrize("frequency", [10.0, 25.0])
@pytest.mark.parametrize("control", [fast(), CascadePPI(Kv=100.0, Kp=24e3, Tn=0.01)], ids=lambda each: each.kind)
def test_a_base_that_the_drive_shakes_no_longer_shows(frequency: float, control: Law) -> None:
    """The truth is a plant: the base's mode is driven by the motor, and the scale moves with it."""
    base = Mode(frequency=frequency, damping_ratio=0.03, mass=400.0, motor=-1.0, load=0.0)
    plant = Modal(mass=40.0, viscous=60.0, modes=(base,))
    machine = MachineMode(frequency=frequency, damping_ratio=0.03, mass=400.0, place="base")
    model = ModeCompensation(modes=(machine,), observer=DisturbanceRecovery(mass=40.0, viscous=60.0))
    move = Polynomial7(distance=0.05, travel_time=0.2)
    errors = []
    for compensation in ((), (model,)):
        made = loop(control, compensation, plant)
        assert stability(made).stable
        run = simulate(made, move, duration=1.0)
        errors.append(np.sqrt(np.mean(run["tracking_error"] ** 2)))
    assert errors[1] < errors[0] / 25.0


def test_a_workpiece_fixture_is_compensated_for_slow_forces_only() -> None:
    """The truth is a plant of table and workpiece. An observer that is fast for the fixture makes the loop unstable."""
    k = 5.0 * (2.0 * np.pi * 150.0) ** 2
    damping = 2.0 * 0.03 * 5.0 * 2.0 * np.pi * 150.0
    plant = TwoMass(mass_motor=40.0, mass_load=5.0, stiffness=k, damping=damping, viscous_motor=60.0)
    machine = MachineMode(frequency=150.0, damping_ratio=0.03, mass=5.0, place="fixture")

    def made(frequency: float | None) -> Loop:
        control = fast(45.0, 300.0)
        if frequency is None:
            return loop(control, (), plant)
        observer = DisturbanceRecovery(mass=45.0, viscous=60.0, frequency=frequency)
        return loop(control, (ModeCompensation(modes=(machine,), observer=observer),), plant)

    load = SineForce(amplitude=100.0, frequency=1.0)
    errors = [
        np.sqrt(np.mean(simulate(made(each), REST, load=load, duration=3.0)["tracking_error"][10_000:] ** 2))
        for each in (None, 20.0)
    ]
    assert errors[1] < errors[0] / 5.0
    assert not stability(made(500.0)).stable
