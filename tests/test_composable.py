"""What goes with any law: feedforward, prefilter, filters, compensation; what makes no sense is refused."""

from __future__ import annotations

import dataclasses
from itertools import product
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.families import Feedforward, Law
from feeddrive.language.errors import FeeddriveError, StructureError
from feeddrive.loop.control import Control
from slow_share import all_but

T = 1e-4
MODEL = fd.blocks.TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)
AXIS = fd.Axis(
    plant=MODEL,
    actuator=fd.blocks.Actuator(dead_time=1e-4, current_loop=1500.0),
    friction_load=fd.blocks.Coulomb(coulomb=30.0),
    encoder_motor=fd.blocks.Encoder(resolution=1e-8),
    encoder_load=fd.blocks.Encoder(resolution=1e-8),
)
MASS, VISCOUS = 163.0, 1520.0
MOVE = fd.blocks.SnapLimitedMove(distance=0.02, velocity=0.2, acceleration=3.0, jerk=200.0, snap=2e4, dwell_after=0.1)
CUT = fd.blocks.StepForce(force=-100.0, start=0.12)

LAWS: dict[str, Law] = {
    "cascade_ppi": fd.blocks.CascadePPI(Kv=80.0, Kp=4e4, Tn=0.01),
    "dadsc": fd.blocks.DADSC(
        mass=MASS, viscous=VISCOUS, tracking_rate=120.0, reaching_rate=120.0, adaptation_rate=60.0
    ),
    "lqg": fd.blocks.LQG(model=MODEL, omega_c=120.0, omega_o=500.0, offset_rate=10.0, delay_samples=1),
    "generalized_predictive": fd.blocks.GeneralizedPredictive(
        mass=MASS, viscous=VISCOUS, omega_o=3000.0, horizon=60, encoder="motor"
    ),
    "super_twisting": fd.blocks.SuperTwisting(
        mass=MASS, viscous=VISCOUS, tracking_rate=80.0, zone_time=5e-3, disturbance_rate=5e4
    ),
    "pole_placement": fd.blocks.PolePlacement(model=MODEL, bandwidth=30.0, rigid_damping=0.6),
    "active_disturbance_rejection": fd.blocks.ActiveDisturbanceRejection(
        mass=MASS, omega_c=80.0, observer=fd.blocks.GpiObserver(mass=MASS, omega_o=150.0, taylor_states=1)
    ),
}
FEEDFORWARDS: dict[str, tuple[Feedforward, ...]] = {
    "none": (),
    "inertia": (fd.blocks.Inertia(mass=MASS, viscous=VISCOUS),),
    "inverse dynamics": (fd.blocks.InverseDynamics(model=MODEL),),
    "friction": (fd.blocks.FrictionFeedforward(coulomb_positive=30.0, coulomb_negative=30.0),),
    "compensator": (
        fd.blocks.DisturbanceCompensator(mass=MASS, viscous=VISCOUS, coulomb_positive=30, coulomb_negative=30),
    ),
}
OBSERVERS: dict[str, Any] = {
    "recovered": fd.blocks.DisturbanceRecovery(mass=MASS, viscous=VISCOUS, frequency=10.0),
    "kalman": fd.blocks.KalmanRecovery(mass=MASS, viscous=VISCOUS, resolution=1e-8, force_step=0.01),
    "gpi": fd.blocks.GpiObserver(mass=MASS, omega_o=60.0, taylor_states=1),
}
MODE = fd.blocks.MachineMode(frequency=25.0, damping_ratio=0.05, stiffness=2e7)
COMPENSATIONS: dict[str, tuple[Any, ...]] = {
    "none": (),
    **{
        f"rejection, {name}": (fd.blocks.DisturbanceRejection(observer=each, share=0.5),)
        for name, each in OBSERVERS.items()
    },
    **{
        f"mode, {name}": (fd.blocks.ModeCompensation(modes=(MODE,), observer=each),) for name, each in OBSERVERS.items()
    },
}
PREFILTERS = {"none": None, "prefilter": fd.blocks.TrajectoryPrefilter(theta1=1e-5)}


def control(law: str, feedforward: str, compensation: str, prefilter: str = "none") -> Control:
    return Control(
        law=LAWS[law],
        feedforward=FEEDFORWARDS[feedforward],
        compensation=COMPENSATIONS[compensation],
        prefilter=PREFILTERS[prefilter],
        filters=(fd.blocks.LowPass2(frequency=2000.0),),
        force_limit=9000.0,
    )


def refused(law: str, feedforward: str, compensation: str) -> str | None:
    """Why a pair makes no sense, by the one word that the message must hold; None where it does."""
    feeds = set(LAWS[law].feeds)
    for block in FEEDFORWARDS[feedforward]:
        if feeds & set(block.fed()):
            return "twice"
    if "rejection" in compensation and LAWS[law].rejects:
        return "twice"
    return None


@pytest.mark.parametrize("law", all_but(["cascade_ppi", "dadsc"], LAWS, "the same companions beside more laws"))
def test_what_goes_together_runs_and_what_does_not_says_why(law: str) -> None:
    """Stable by its poles, and the error a tenth of a second after the move is what the cut leaves, not a drift."""
    for feedforward, compensation in product(FEEDFORWARDS, COMPENSATIONS):
        what = f"{law}, {feedforward}, {compensation}"
        why = refused(law, feedforward, compensation)
        if why is not None:
            with pytest.raises(StructureError, match=why):
                fd.Loop(control=control(law, feedforward, compensation), axis=AXIS, sample_time=T)
            continue
        loop = fd.Loop(control=control(law, feedforward, compensation), axis=AXIS, sample_time=T)
        assert fd.stability(loop).stable, what
        run = fd.simulate(loop, MOVE, load=CUT)
        # 100 N on an axis of at least 1 N/um would leave 100 um; all of these hold it better in the end
        assert np.max(np.abs(run["tracking_error"][-200:])) < 1e-4, what
        assert np.all(np.isfinite(run["force"])), what


@pytest.mark.parametrize("law", LAWS)
def test_a_prefilter_goes_before_any_law(law: str) -> None:
    """Its θ1 moves the setpoint by θ1 v: at constant speed the error changes by 10 us times 0.2 m/s = 2 um."""
    move = fd.blocks.SnapLimitedMove(distance=0.1, velocity=0.2, acceleration=3.0, jerk=200.0, snap=2e4)
    axis = dataclasses.replace(AXIS, friction_load=None, encoder_motor=None, encoder_load=None)
    runs = [
        fd.simulate(fd.Loop(control=control(law, "none", "none", each), axis=axis, sample_time=T), move)
        for each in PREFILTERS
    ]
    middle = np.argmin(np.abs(runs[0]["set_position"] - 0.07))
    moved = runs[0]["tracking_error"][middle] - runs[1]["tracking_error"][middle]
    assert moved == pytest.approx(2e-6, rel=0.05)


def test_a_law_with_two_positions_is_refused_on_an_axis_with_one() -> None:
    for axis in (fd.Axis(plant=fd.blocks.Rigid(mass=MASS)), dataclasses.replace(AXIS, encoder_motor=None)):
        with pytest.raises(StructureError, match="two encoders"):
            fd.Loop(control=control("pole_placement", "none", "none"), axis=axis, sample_time=T)


def test_an_observer_too_fast_is_refused_wherever_it_stands() -> None:
    fast = fd.blocks.GpiObserver(mass=MASS, omega_o=5e4)
    for given in (
        Control(law=LAWS["cascade_ppi"], compensation=(fd.blocks.DisturbanceRejection(observer=fast),)),
        Control(law=LAWS["cascade_ppi"], compensation=(fd.blocks.ModeCompensation(modes=(MODE,), observer=fast),)),
        Control(law=fd.blocks.ActiveDisturbanceRejection(mass=MASS, omega_c=12.0, observer=fast)),
    ):
        with pytest.raises(FeeddriveError, match="too fast"):
            fd.Loop(control=given, axis=AXIS, sample_time=T)
