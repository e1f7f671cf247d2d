"""A control for every law, observer and filter, on 40 kg, rigid or with the mode of a screw."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from feeddrive import Axis, Control, Loop
from feeddrive.blocks import (
    DADSC,
    LQG,
    ActiveDisturbanceRejection,
    CascadePPI,
    DisturbanceRecovery,
    DisturbanceRejection,
    GeneralizedPredictive,
    GpiObserver,
    Inertia,
    KalmanRecovery,
    LinearADRC,
    LowPass,
    LowPass2,
    MachineMode,
    ModeCompensation,
    Notch,
    PolePlacement,
    RepetitiveControl,
    Rigid,
    SecondOrder,
    SuperTwisting,
    TrajectoryPrefilter,
    TwoMass,
)

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
    "cascade, smoothed": Control(law=replace(PPI, velocity_samples=2, velocity_lag=5e-4)),
    "cascade, model": Control(law=replace(PPI, model_mass=MASS), feedforward=(Inertia(mass=MASS),)),
    "filters": Control(law=PPI, filters=FILTERS, feedforward=(Inertia(mass=MASS),)),
    "prefilter": Control(law=PPI, prefilter=TrajectoryPrefilter(theta2=1e-5)),
    "dadsc": Control(law=DADSC(mass=MASS, tracking_rate=300.0, reaching_rate=300.0, adaptation_rate=300.0)),
    "super-twisting": Control(law=SuperTwisting(mass=MASS, tracking_rate=200.0, zone_time=1e-3, disturbance_rate=5e4)),
    "predictive": Control(law=GeneralizedPredictive(mass=MASS, omega_o=2000.0, horizon=60)),
    "lqg": Control(law=LQG(model=Rigid(mass=MASS), omega_c=100.0, omega_o=400.0)),
    "lqg, two masses": Control(law=LQG(model=SCREW, omega_c=100.0, omega_o=400.0, offset_rate=5.0)),
    "adr": Control(law=ActiveDisturbanceRejection(mass=MASS, omega_c=50.0, observer=GPI)),
    "adr, recovery": Control(law=ActiveDisturbanceRejection(mass=MASS, omega_c=30.0, observer=RECOVERY)),
    "pole placement": Control(law=PolePlacement(model=SCREW, bandwidth=40.0)),
    "pole placement, exact": Control(law=PolePlacement(model=SCREW, bandwidth=40.0, commands="exact")),
    "pole placement, rigid": Control(law=PolePlacement(model=SCREW, bandwidth=40.0, commands="rigid")),
    "exact recovery": rejection(DisturbanceRecovery(mass=MASS, form="exact")),
    "one pole": rejection(DisturbanceRecovery(mass=MASS, form="one_pole")),
    "butterworth": rejection(RECOVERY),
    "integral and two poles": Control(
        law=PPI, filters=FILTERS, compensation=(DisturbanceRejection(observer=replace(RECOVERY, form="two_poles")),)
    ),
    "repetitive": Control(law=PPI, compensation=(RepetitiveControl(period_samples=40, lead_samples=3, passes=4),)),
    "ladrc": Control(law=LinearADRC(mass=MASS, omega_c=50.0, omega_o=300.0, delay_samples=1)),
    "kalman": rejection(KalmanRecovery(mass=MASS, resolution=1e-8, force_step=20.0)),
    "gpi": rejection(GPI),
    "modes": Control(law=PPI, compensation=(ModeCompensation(observer=RECOVERY, modes=(MODE,)),)),
}


def loop_of(control: Control, **others: Any) -> Loop:
    two = control.law.positions() == 2
    return Loop(control=control, axis=Axis(plant=SCREW if two else Rigid(mass=MASS), **others), sample_time=T)
