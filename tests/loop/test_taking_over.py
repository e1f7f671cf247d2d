"""An axis that moves is taken over without a bump: by every law, observer and compensation, enabled or begun so."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive import Axis, Control, Guard, Loop, simulate
from feeddrive.blocks import (
    DADSC,
    ActiveDisturbanceRejection,
    CascadePPI,
    DisturbanceRecovery,
    DisturbanceRejection,
    Encoder,
    GpiObserver,
    KalmanRecovery,
    MachineMode,
    ModeCompensation,
    PolePlacement,
    Recorded,
    Rigid,
    TwoMass,
)

T = 1e-4
SPEED = 0.1  # m/s
MASS = 40.0  # kg, without friction: it needs no force to move on
SCREW = TwoMass(mass_motor=25.0, mass_load=15.0, stiffness=2e7, damping=800.0)

PPI = CascadePPI(Kv=100.0, Kp=24e3, Tn=0.01)
GPI = GpiObserver(mass=MASS, omega_o=500.0)
RECOVERY = DisturbanceRecovery(mass=MASS)
MODE = MachineMode(frequency=35.0, stiffness=2e7)


def rejection(observer):
    return Control(law=PPI, compensation=(DisturbanceRejection(observer=observer),))


CONTROLS = {
    "cascade": Control(law=PPI),
    "dadsc": Control(law=DADSC(mass=MASS, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)),
    "adr": Control(law=ActiveDisturbanceRejection(mass=MASS, omega_c=50.0, observer=GPI)),
    "pole placement": Control(law=PolePlacement(model=SCREW, bandwidth=40.0)),
    "exact recovery": rejection(DisturbanceRecovery(mass=MASS, form="exact")),
    "one pole": rejection(DisturbanceRecovery(mass=MASS, form="one_pole")),
    "butterworth": rejection(RECOVERY),
    "kalman": rejection(KalmanRecovery(mass=MASS, resolution=1e-8, force_step=20.0)),
    "gpi": rejection(GPI),
    "modes": Control(law=PPI, compensation=(ModeCompensation(observer=RECOVERY, modes=(MODE,)),)),
}


def run(control: Control, *, guarded: bool, resolution: float | None = None, speed: float = SPEED):
    """0.1 s of an even motion far from 0; under a guard the first 20 ms are without control."""
    two = control.law.encoders == 2
    encoder = Encoder(resolution=resolution)
    motor = Encoder(resolution=resolution, offset=5e-3 if guarded else None) if two else None
    axis = Axis(plant=SCREW if two else Rigid(mass=MASS), encoder_motor=motor, encoder_load=encoder)
    guard = Guard() if guarded else None
    loop = Loop(
        control=Control(law=control.law, compensation=control.compensation, guard=guard), axis=axis, sample_time=T
    )
    rows = np.arange(1001)
    way = Recorded(position=0.3 + speed * T * rows, velocity=np.full(rows.size, speed), sample_time=T)
    enable = np.where(rows < 200, 0.0, 1.0) if guarded else None
    return simulate(loop, way, enable=enable, start=(0.3, speed))


@pytest.mark.parametrize("guarded", [False, True], ids=["begun", "enabled"])
@pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)
def test_a_moving_axis_is_taken_over_without_a_bump(control: Control, guarded: bool) -> None:
    """Started at rest the recovery took the speed for 40 kN; what is left are the digits of 0.3 m over T."""
    found = run(control, guarded=guarded)
    assert np.max(np.abs(found["force"])) < 1e-3  # N
    assert np.max(np.abs(found["tracking_error"])) < 1e-9  # m


@pytest.mark.parametrize("name", ["adr", "butterworth", "gpi", "modes"])
def test_a_coarse_encoder_at_enable_is_no_motion(name: str) -> None:
    """A creep of 0.1 mm/s toggles a count of 1 um, 10 mm/s in a sample; what is smoothed is 1/32 of that."""
    found = run(CONTROLS[name], guarded=True, resolution=1e-6, speed=1e-4)
    assert np.max(np.abs(found["tracking_error"])) < 10e-6  # m
