"""Live changes of parameters: no bump that the change does not ask for, and the same bits whoever runs them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feeddrive import (
    DADSC,
    ActiveDisturbanceRejection,
    Axis,
    CascadePPI,
    Control,
    DisturbanceRecovery,
    DisturbanceRejection,
    Encoder,
    GpiObserver,
    Guard,
    Inertia,
    KalmanRecovery,
    Loop,
    LowPass,
    LowPass2,
    MachineMode,
    ModeCompensation,
    Notch,
    PolePlacement,
    Recorded,
    Rigid,
    SecondOrder,
    SnapLimitedMove,
    StepForce,
    TrajectoryPrefilter,
    TwoMass,
    simulate,
)
from feeddrive.language import tree

T = 1e-4
MASS = 40.0
SCREW = TwoMass(mass_motor=25.0, mass_load=15.0, stiffness=2e7, damping=800.0)
PPI = CascadePPI(Kv=100.0, Kp=24e3, Tn=0.01)
GPI = GpiObserver(mass=MASS, omega_o=500.0)
RECOVERY = DisturbanceRecovery(mass=MASS)
MODE = MachineMode(frequency=35.0, stiffness=2e7, damping_ratio=0.2)
FILTERS = (
    Notch(frequency=700.0),
    LowPass2(frequency=900.0),
    LowPass(frequency=1500.0),
    SecondOrder(frequency_zero=1200.0, frequency_pole=1000.0),
)


def rejection(observer: Any) -> Control:
    law = CascadePPI(Kv=100.0, Kp=24e3)  # without an integral: the rejection alone holds the load
    return Control(law=law, compensation=(DisturbanceRejection(observer=observer),))


CONTROLS = {
    "cascade": Control(law=PPI),
    "cascade over 4": Control(law=replace(PPI, velocity_samples=4, position_every=4)),
    "filters": Control(law=PPI, filters=FILTERS, feedforward=(Inertia(mass=MASS),)),
    "prefilter": Control(law=PPI, prefilter=TrajectoryPrefilter(theta2=1e-5)),
    "dadsc": Control(law=DADSC(mass=MASS, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)),
    "adr": Control(law=ActiveDisturbanceRejection(mass=MASS, omega_c=50.0, observer=GPI)),
    "adr, recovery": Control(law=ActiveDisturbanceRejection(mass=MASS, omega_c=30.0, observer=RECOVERY)),
    "pole placement": Control(law=PolePlacement(model=SCREW, bandwidth=40.0)),
    "pole placement, exact": Control(law=PolePlacement(model=SCREW, bandwidth=40.0, commands="exact")),
    "pole placement, rigid": Control(law=PolePlacement(model=SCREW, bandwidth=40.0, commands="rigid")),
    "exact recovery": rejection(DisturbanceRecovery(mass=MASS, form="exact")),
    "one pole": rejection(DisturbanceRecovery(mass=MASS, form="one_pole")),
    "butterworth": rejection(RECOVERY),
    "kalman": rejection(KalmanRecovery(mass=MASS, resolution=1e-8, force_step=20.0)),
    "gpi": rejection(GPI),
    "modes": Control(law=PPI, compensation=(ModeCompensation(observer=RECOVERY, modes=(MODE,)),)),
}
every_control = pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)

# a steady motion or load asks for these: their change must show in the force; and a ratio that no other value fits
ASKED_FOR = ("share", "viscous", "velocity_feedforward", "modes.0.stiffness", "adaptation_ratio")


def loop_of(control: Control, **others: Any) -> Loop:
    two = control.law.encoders == 2
    return Loop(control=control, axis=Axis(plant=SCREW if two else Rigid(mass=MASS), **others), sample_time=T)


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
        loop_of(control), way, load=StepForce(force=300.0, start=0.01), start=(0.3, speed),
        changes={10_000: moved(control, factor)},
    )  # fmt: skip
    assert run["force"][9_999] == pytest.approx(-300.0, abs=1e-3)  # N: settled, and the controls hold the load
    assert np.max(np.abs(run["force"][9_990:] + 300.0)) < 0.01  # N, 1/30000 of what would be lost
    assert np.max(np.abs(run["tracking_error"][10_000:] - run["tracking_error"][9_999])) < 1e-9  # m


@every_control
def test_the_same_numbers_change_no_bit(control: Control) -> None:
    """While it moves, under noise, at its force limit and under a guard."""
    limited = replace(control, force_limit=250.0, guard=Guard())
    loop = loop_of(limited, encoder_load=Encoder(resolution=1e-8, noise=1e-8), encoder_motor=Encoder(resolution=1e-8))
    move = SnapLimitedMove(distance=0.02, velocity=0.2, acceleration=8.0, jerk=800.0, snap=2e5)
    same = dict.fromkeys([*range(40), 500, 900], limited)
    plain, changed = (simulate(loop, move, changes=changes) for changes in (None, same))
    assert np.any(np.abs(plain["requested"]) > 250.0)
    for name in plain.signals:
        assert plain[name].tobytes() == changed[name].tobytes(), name
