"""Every law, filter, feedforward, observer, compensation and prefilter in a loop that is exported: for all targets."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

import feeddrive as fd
from feeddrive.blocks.catalogue import members
from feeddrive.blocks.families import Feedforward, Law
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, parameter
from feeddrive.language.ring import History
from feeddrive.tuning.candidates import control_with

T = 1e-4
MASS, VISCOUS = 163.0, 1520.0
MODEL = fd.blocks.TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)
MOTOR = fd.blocks.Screw(torque_constant=1.2, lead=0.02, peak_current=24.0, continuous_current=9.0)
TWO = fd.Axis(
    plant=MODEL,
    actuator=fd.blocks.Actuator(dead_time=1e-4, current_loop=1500.0, motor=MOTOR),
    friction_load=fd.blocks.Coulomb(coulomb=30.0),
    encoder_motor=fd.blocks.Encoder(resolution=1e-8),
    encoder_load=fd.blocks.Encoder(resolution=1e-8),
)
ONE = fd.Axis(
    plant=fd.blocks.Rigid(mass=MASS),
    friction_load=fd.blocks.Stribeck(coulomb=30.0, breakaway=50.0, stribeck_velocity=2e-3),
    encoder_load=fd.blocks.Encoder(resolution=1e-8),
)
GUARD = fd.Guard(following_error_limit=2e-3, velocity_limit=2.0, travel_least=-0.5, travel_most=0.5, safe_force=20.0)
GPI = fd.blocks.GpiObserver(mass=MASS, omega_o=150.0)
PPI = fd.blocks.CascadePPI(Kv=80.0, Kp=4e4, Tn=0.01)


class LateInertia(Feedforward):
    """F = mass · a(t - late), from a history of the set acceleration: a control with a ring."""

    mass: Number = parameter("kg", "moving mass", least=0)
    late: Number = parameter("s", "delay", least=0)

    def start(self, setpoint: Setpoint) -> History:
        """It has always been so."""
        return History.start(12, setpoint.acceleration)

    def step(self, state: History, setpoint: Setpoint, T: Number) -> tuple[History, Any]:
        """The equation above."""
        state = state.push(setpoint.acceleration)
        return state, self.mass * state.ago(self.late / T)

    def retune(self, state: History, old: LateInertia) -> History:
        """Past accelerations stay."""
        return state


def loop(axis: fd.Axis, law: object, **parts: object) -> fd.Loop:
    control = {"force_limit": 9000.0, "guard": GUARD, **parts}
    return fd.Loop(control=fd.Control(law=law, **control), axis=axis, sample_time=T)  # type: ignore[arg-type]


def mode_compensation(observer: object) -> fd.blocks.ModeCompensation:
    mode = fd.blocks.MachineMode(frequency=25.0, damping_ratio=0.05, stiffness=2e7)
    return fd.blocks.ModeCompensation(modes=(mode,), observer=observer)  # type: ignore[arg-type]


DADSC = fd.blocks.DADSC(mass=MASS, viscous=VISCOUS, tracking_rate=120.0, reaching_rate=120.0, adaptation_rate=60.0)
SUPER_TWISTING = fd.blocks.SuperTwisting(  # a narrow zone, which is left
    mass=MASS, viscous=VISCOUS, tracking_rate=120.0, zone_time=2e-3, disturbance_rate=2e3
)
GPC = fd.blocks.GeneralizedPredictive(mass=MASS, viscous=VISCOUS, omega_o=500.0, horizon=40, delay_samples=1)
LQG_TWO = fd.blocks.LQG(model=MODEL, omega_c=100.0, omega_o=400.0, offset_rate=5.0, delay_samples=1)
LINUXCNC_PID = fd.blocks.LinuxcncPid(
    position=fd.blocks.StockPid(Pgain=60.0, FF1=1.0, maxoutput=3000.0),
    velocity=fd.blocks.StockPid(Pgain=40.0, Igain=400.0, maxoutput=9000.0),
)
FILTERS = (
    fd.blocks.Notch(frequency=460.0, damping_zero=0.06, damping_pole=0.6),
    fd.blocks.LowPass2(frequency=2500.0),
    fd.blocks.LowPass(frequency=3000.0),
    fd.blocks.SecondOrder(frequency_zero=150.0, damping_zero=0.3, frequency_pole=180.0, damping_pole=0.5),
)
# the plain laws of the papers, and then all that can stand beside them
LAWS: dict[str, fd.Loop] = {
    "cascade_ppi": loop(TWO, PPI),
    "pole_placement": loop(TWO, fd.blocks.PolePlacement(model=MODEL, bandwidth=30.0, rigid_damping=0.6)),
    "dadsc": loop(ONE, DADSC),
    "active_disturbance_rejection": loop(
        ONE, fd.blocks.ActiveDisturbanceRejection(mass=MASS, omega_c=80.0, observer=GPI)
    ),
}
LOOPS: dict[str, fd.Loop] = {
    **LAWS,
    # the guard lets the axis travel from -0.5 to 0.5 m: on it lie the slope and both held ends; two payloads at a place
    "gain_schedule": loop(
        ONE,
        fd.blocks.GainSchedule(
            payload=70.0,
            places=tuple(
                fd.blocks.SchedulePlace(
                    position=position,
                    loads=(
                        fd.blocks.ScheduleLoad(payload=0.0, law=law),
                        fd.blocks.ScheduleLoad(
                            payload=200.0, law=dataclasses.replace(law, mass=2.0 * MASS, tracking_rate=70.0)
                        ),
                    ),
                )
                for position, law in (
                    (-0.3, DADSC),
                    (0.4, dataclasses.replace(DADSC, tracking_rate=90.0, reaching_rate=140.0, adaptation_rate=45.0)),
                )
            ),
        ),
    ),
    "super_twisting": loop(ONE, SUPER_TWISTING),
    "lqg": loop(ONE, fd.blocks.LQG(model=fd.blocks.Rigid(mass=MASS, viscous=VISCOUS), omega_c=80.0, omega_o=300.0)),
    "lqg, two masses": loop(TWO, LQG_TWO),
    "generalized_predictive": loop(ONE, GPC),
    "generalized_predictive, three moves": loop(
        ONE, dataclasses.replace(GPC, moves=3, move_weight=1e-17, delay_samples=4, horizon=60)
    ),
    "super_twisting, implicit": loop(ONE, dataclasses.replace(SUPER_TWISTING, form="implicit", zone_time=None)),
    "super_twisting, explicit": loop(ONE, dataclasses.replace(SUPER_TWISTING, form="explicit", zone_time=None)),
    "cascade_ppi, guard without bounds": loop(TWO, PPI, guard=fd.Guard()),
    "cascade_ppi, guard without parts": loop(
        TWO,
        PPI,
        guard=fd.Guard(velocity_limit=2.0, checks_setpoint=False, holds=False, aligns=False, starts_moving=False),
    ),
    "cascade_ppi, plain": loop(ONE, fd.blocks.CascadePPI(Kv=80.0, Kp=4e4), force_limit=None, guard=fd.Guard()),
    "cascade_ppi, reference model": loop(
        ONE, dataclasses.replace(PPI, model_mass=MASS, model_samples=2), feedback_delay=2.5e-4
    ),
    "cascade_ppi, slow position loop": loop(
        ONE, fd.blocks.CascadePPI(Kv=30.0, Kp=2e4, Tn=0.02, position_every=4, velocity_samples=3, viscous=200.0)
    ),
    "cascade_ppi, filters and inertia": loop(
        TWO,
        PPI,
        filters=FILTERS,
        feedforward=(
            fd.blocks.Inertia(mass=MASS, viscous=VISCOUS),
            fd.blocks.ReversalPulse(force=20.0, decay_time=0.01),
        ),
    ),
    "cascade_ppi, inverse dynamics, friction and prefilter": loop(
        TWO,
        PPI,
        feedforward=(
            fd.blocks.InverseDynamics(model=MODEL),
            fd.blocks.FrictionFeedforward(
                coulomb_positive=30.0, coulomb_negative=28.0, breakaway=45.0, stribeck_velocity=2e-3, smoothing=1e-4
            ),
        ),
        prefilter=fd.blocks.TrajectoryPrefilter(theta1=1e-5, theta2=1e-7, theta3=1e-10, theta4=1e-13),
    ),
    "cascade_ppi, compensator": loop(
        ONE,
        PPI,
        feedforward=(
            fd.blocks.DisturbanceCompensator(
                mass=MASS, viscous=VISCOUS, coulomb_positive=30.0, coulomb_negative=30.0, stribeck=10.0,
                stribeck_velocity=2e-3, jerk_feedforward=0.1, snap_feedforward=1e-4,
            ),
        ),
    ),
    "cascade_ppi, stops": loop(
        ONE,
        PPI,
        feedforward=(
            fd.blocks.FrictionStops(
                width=np.array([5e-6, 2e-5, 1e-4]), stiffness=np.array([4e6, 1e6, 2e5]),
                residual_velocity=np.array([-0.1, 0.0, 0.1]), residual_force=np.array([4.0, -9.0, 3.0]),
                residual_width=0.1, residual_limit=8.0,
            ),
        ),
    ),
    "cascade_ppi, rings and reversals": loop(
        ONE,
        PPI,
        feedforward=(LateInertia(mass=MASS, late=3.3e-4), fd.blocks.ReversalPulse(force=25.0, decay_time=0.004)),
    ),
    "cascade_ppi, pitch tables": loop(
        TWO,
        PPI,
        compensation=(
            fd.blocks.PitchCompensation(
                forward=np.array([0.0, 2e-6, -1e-6]), backward=np.array([3e-6, 4e-6, 0.0]), table_start=-0.2,
                spacing=0.2,
            ),
        ),
    ),
    "cascade_ppi, repetitive": loop(
        ONE,
        PPI,
        compensation=(fd.blocks.RepetitiveControl(period_samples=40, lead_samples=3, passes=4, learning_gain=0.5),),
    ),
    "cascade_ppi, recovery": loop(
        ONE,
        PPI,
        compensation=(
            fd.blocks.DisturbanceRejection(
                observer=fd.blocks.DisturbanceRecovery(mass=MASS, viscous=VISCOUS, frequency=10.0),
                share=0.5,
                blend_time=0.1,
            ),
        ),
    ),
    "cascade_ppi, kalman": loop(
        ONE,
        PPI,
        compensation=(
            fd.blocks.DisturbanceRejection(
                observer=fd.blocks.KalmanRecovery(mass=MASS, viscous=VISCOUS, resolution=1e-8, force_step=0.01),
                share=0.5,
            ),
        ),
    ),
    "cascade_ppi, learned force": loop(
        ONE, PPI, compensation=(fd.blocks.LearnedForce(force=np.concatenate([50.0 * np.sin(np.arange(300.0)), [0.0]])),)
    ),
    "cascade_ppi, rejection": loop(
        ONE,
        PPI,
        compensation=(fd.blocks.DisturbanceRejection(observer=dataclasses.replace(GPI, omega_o=600.0), share=0.5),),
    ),
    "cascade_ppi, disturbance observer": loop(
        ONE,
        PPI,
        filters=FILTERS[:1],
        compensation=(
            fd.blocks.DisturbanceRejection(
                observer=fd.blocks.DisturbanceRecovery(
                    mass=MASS, viscous=VISCOUS, form="two_poles", frequency=30.0, delay_samples=1
                )
            ),
        ),
    ),
    "linear_adrc": loop(ONE, fd.blocks.LinearADRC(mass=MASS, omega_c=100.0, omega_o=500.0, delay_samples=1)),
    "linear_adrc, two encoders": loop(
        TWO, fd.blocks.LinearADRC(mass=MASS, omega_c=100.0, omega_o=500.0, encoder="motor", position="load")
    ),
    "linuxcnc_pid": loop(ONE, LINUXCNC_PID),
    "dadsc, mode": loop(
        ONE, DADSC, compensation=(mode_compensation(fd.blocks.DisturbanceRecovery(mass=MASS, frequency=10.0)),)
    ),
    "pole_placement, exact commands": loop(
        TWO, fd.blocks.PolePlacement(model=MODEL, bandwidth=30.0, commands="exact"), filters=FILTERS[:1]
    ),
    "pole_placement, series commands": loop(
        TWO,
        fd.blocks.PolePlacement(model=MODEL, bandwidth=30.0, commands="series"),
    ),
    **{
        f"active_disturbance_rejection, {states} taylor states": loop(
            ONE,
            fd.blocks.ActiveDisturbanceRejection(
                mass=MASS, omega_c=60.0, observer=dataclasses.replace(GPI, taylor_states=states, omega_o=100.0)
            ),
        )
        for states in (0, 1, 2, 3)
    },
    "active_disturbance_rejection, hanging": loop(
        ONE,
        fd.blocks.ActiveDisturbanceRejection(
            mass=MASS, omega_c=60.0,
            observer=dataclasses.replace(
                GPI, start_disturbance=-300.0, delay_samples=2, hold="zero_order", omega_o=9.0
            ),
        ),
    ),
}  # fmt: skip
# a law that stands in none of them is exported with its start values: a new law needs its own file only
# (one that commands a velocity needs another axis, and is exported by the commissioning in csv)
FORCED = {kind for kind, law in members(Law).items() if law.commanded == "force"}
for kind in sorted(FORCED - {each.control.law.kind for each in LOOPS.values()}):
    begun = control_with(LOOPS["cascade_ppi, plain"], kind).law
    LOOPS[kind] = loop(TWO if begun.positions() == 2 else ONE, begun)
