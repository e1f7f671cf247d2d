"""The axis, the two laws and the motions of the experiments, and the figures of a run."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.families import Feedforward, Friction, Reference
from feeddrive.blocks.feedforward.inverse_dynamics import InverseDynamics
from feeddrive.blocks.plant.two_bodies import two_bodies
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import read_machine
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.learning.trajectory_prefilter import PrefilterFit, tune_prefilter
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, root_mean_square, simulate
from feeddrive.papers.claims import Claim, stated
from feeddrive.report.report import Picture

MODEL = TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)
DESIGN = PolePlacement(model=MODEL, bandwidth=50.0, rigid_damping=0.45, axial_damping=0.1)
# softer gains, with which the ablation was made
SOFTER = PolePlacement(
    model=MODEL,
    bandwidth=45.0,
    rigid_damping=0.6,
    axial_damping=0.1,
    axial_frequency=0.98 * float(two_bodies("", MODEL).mode) / (2.0 * np.pi),
)
FULL, RIGID = InverseDynamics(model=MODEL), InverseDynamics(model=MODEL, order="rigid")
LONG = SnapLimitedMove(distance=0.3, velocity=1.0, acceleration=10.0, jerk=800.0, snap=8e4, dwell_after=0.1)
SHORT = SnapLimitedMove(distance=0.1, velocity=0.3, acceleration=5.0, jerk=400.0, snap=4e4, dwell_after=0.1)

PLACED, CASCADE = "pole placement", "P-PI"
TRUTH = (
    "three-mass axis of the machine file ball_screw, one sample of computation, current loop 1.5 kHz, 10 nm encoders"
)
GAINS = f"{TRUTH}; pole placement at 50 Hz (ζ 0.45; 0.10) against P-PI Kv 100, Kp 6.8e4, Tn 5.4 ms; same filter pack"


@dataclass(frozen=True)
class Part:
    """The results of one group of experiments."""

    claims: Sequence[Claim]
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()


def placed(law: PolePlacement = DESIGN, feedforward: tuple[Feedforward, ...] = (FULL,)) -> Loop:
    """Return the axis under pole-placement control, with inverse dynamics and without friction."""
    today = cascade()
    return replace(today, control=replace(today.control, law=law, feedforward=feedforward))


def cascade() -> Loop:
    """Return the machine's P-PI cascade with velocity and acceleration feedforward, without friction."""
    return with_friction(read_machine("ball_screw").loop("x"), None)


def with_friction(loop: Loop, friction: Friction | None) -> Loop:
    """Return the loop with a different friction model of the screw."""
    return replace(loop, axis=replace(loop.axis, friction_motor=friction))


def with_prefilter(loop: Loop, fit: PrefilterFit) -> Loop:
    """Return the loop with a fitted prefilter."""
    return replace(loop, control=replace(loop.control, prefilter=fit.prefilter))


def follow(loop: Loop, reference: Reference, name: str) -> Run:
    """Simulate a reference; record the following error, to which a prefilter is fitted, and the true tracking error."""
    return simulate(loop, reference, name=name, record=("following_error", "tracking_error", "requested", "force"))


def fits(loop: Loop, reference: Reference, runs: int = 1) -> tuple[PrefilterFit, ...]:
    """Fit prefilters by least squares, each to a run with the previous prefilter."""
    return tune_prefilter(loop, reference, runs=runs)


def rms(values: np.ndarray) -> float:
    """Return the RMS in µm of values in m."""
    return 1e6 * root_mean_square(values)


def peak(values: np.ndarray) -> float:
    """Return the peak in µm of values in m."""
    return 1e6 * float(np.max(np.abs(values)))


def figures(run: Run) -> Text:
    """Return peak and RMS of the tracking error without their unit, for a table."""
    largest, usual = (stated(size(run["tracking_error"]), "µm", "3", bare=True) for size in (peak, rms))
    return Text(f"{largest} / {usual}")
