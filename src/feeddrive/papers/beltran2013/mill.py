"""The small mill of the paper: its three axes, the simulation of each case in the table, and the limits of its
observer.
"""

import dataclasses
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from feeddrive.analysis.replay import observe
from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.families import Friction, Load, Reference
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.load.force_sum import ForceSum
from feeddrive.blocks.load.milling_force import MillingForce
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.plant.milling_axis import MillingAxis
from feeddrive.blocks.reference.bezier10 import Bezier10
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, simulate

AXES = ("x", "y", "z")
# the paper's table of parameters is not available: chosen numbers
CARRIAGE = {"x": 60.0, "y": 100.0, "z": 40.0}  # kg
C_B = {"x": 40.0, "y": 60.0, "z": 30.0}  # N s/m
COULOMB = {"x": 60.0, "y": 90.0, "z": 40.0}  # N
INERTIA, LEAD, C_T = 2e-4, 0.010, 2e-4  # kg m², m, N m s/rad
GRAVITY = 9.81  # m/s²
TRANSITION = 10e-6  # m/s, of the tanh that replaces the sign function
# 2 mm and not 80: the errors repeat with each tooth, so that a short leg shows the same (claim 3.q)
FEED, LEG = 3e-3, 2e-3  # m/s, m; the paper's legs are 80 mm long
SPINDLE, CHIP = 1800.0, 5e-5  # rpm, m per tooth
OMEGA_C, OMEGA_O, ZETA = 12.0, 700.0, 0.7071  # rad/s, rad/s
T = 1e-4  # s
# The observer starts without the weight of z; the claims are about the cut.
SKIPPED = 0.3  # s, in which the observer converges to the weight


@dataclass(frozen=True)
class Case:
    """A row of the table, stated as differences from the paper's law on its linear reference.

    gain      ratio of true to assumed input gain, a M̂ / (a M)
    friction  "tanh", or "set" for Coulomb friction with a true standstill
    chip      "actual": from the motion of the tool and the table over the last tooth period; "constant" as in the
              paper's table
    radial_depth  radial depth of cut, m; None for slotting
    opposite  True if the cutting force on y is that of a second leg towards -x
    """

    name: str
    reference: str = "linear"
    share: float = 1.0
    hold: str = "first_order"
    taylor_states: int = 5
    gain: float = 1.0
    resolution: float | None = None
    friction: str = "tanh"
    chip: str = "actual"
    leg: float = LEG
    radial_depth: float | None = None
    opposite: bool = False


def plant(axis: str) -> MillingAxis:
    """Return the model of the carriage on its screw."""
    return MillingAxis(inertia=INERTIA, lead=LEAD, carriage_mass=CARRIAGE[axis], c_b=C_B[axis], c_t=C_T)


def mass(axis: str) -> float:
    """Return the total mass M = m + J/a², kg."""
    return float(plant(axis).rigid_mass())


def law(axis: str, case: Case) -> ActiveDisturbanceRejection:
    """Return the law with the paper's gains."""
    believed = case.gain * mass(axis)
    observer = GpiObserver(
        mass=believed, omega_o=OMEGA_O, zeta_o=ZETA, taylor_states=case.taylor_states, hold=case.hold
    )
    return ActiveDisturbanceRejection(mass=believed, omega_c=OMEGA_C, zeta_c=ZETA, share=case.share, observer=observer)


def loop(axis: str, case: Case, *, dry: bool = True, sample_time: float = T) -> Loop:
    """Return the loop of one axis with the law; without `dry` it has no Coulomb friction."""
    friction: Friction | None = None
    if dry and case.friction == "tanh":
        friction = Regularised(coulomb=COULOMB[axis], transition_velocity=TRANSITION)
    elif dry:
        friction = Coulomb(coulomb=COULOMB[axis])
    return Loop(
        control=Control(law=law(axis, case)),
        axis=Axis(
            plant=plant(axis),
            friction_load=friction,
            forces=(Gravity(force=-CARRIAGE[axis] * GRAVITY),) if axis == "z" else (),
            encoder_load=None if case.resolution is None else Encoder(resolution=case.resolution),
        ),
        sample_time=sample_time,
    )


def legs(kind: str, leg: float) -> dict[str, Reference]:
    """Return the motions by axis: from point 1 to point 2 along y, then to point 3 along x; z is at rest."""
    move, time = (LinearMove if kind == "linear" else Bezier10), leg / FEED
    return {
        "x": move(distance=leg, travel_time=time, dwell_before=time),
        "y": move(distance=leg, travel_time=time, dwell_after=time),
        "z": move(distance=0.0, travel_time=time, dwell_after=time),
    }


def tool(case: Case) -> HelicalCutter:
    """Return the paper's tool, for slotting or side milling."""
    return dataclasses.replace(HelicalCutter.beltran2013(), radial_depth=case.radial_depth)


def cutting(axis: str, case: Case) -> Load:
    """Return the cutting force on an axis, in N."""
    cutter = tool(case)
    if case.opposite:
        time = case.leg / FEED
        first, second = (0.0, 0.5 * np.pi, time), (time, np.pi, 2.0 * time)
        return ForceSum(
            loads=tuple(
                MillingForce(
                    cutter=cutter,
                    spindle_speed=SPINDLE,
                    component=axis,
                    chip_load=CHIP,
                    direction=direction,
                    start=start,
                    end=end,
                )
                for start, direction, end in (first, second)
            )
        )
    path = legs("linear", case.leg)
    return MillingForce(cutter=cutter, spindle_speed=SPINDLE, component=axis, references=(path["x"], path["y"]))


def machine(case: Case, *, dry: bool = True) -> Machine:
    """Return the machine with three axes, coupled by the cut if the chip thickness follows the actual motion."""
    # a tooth period of 16.7 ms is 167 substeps
    cut = MillingCut(cutter=tool(case), spindle_speed=SPINDLE, along_z="z", remembered=512)
    return Machine.of({axis: loop(axis, case, dry=dry) for axis in AXES}, (cut,) if case.chip == "actual" else ())


def run(case: Case, *, cut: bool = True, dry: bool = True) -> dict[str, Run]:
    """Simulate the three axes along their legs together, from rest; return the runs by axis."""
    loads = {axis: cutting(axis, case) for axis in AXES} if cut and case.chip == "constant" else None
    # a machine without a cut has no coupling, which "constant" leaves out
    case = case if cut else dataclasses.replace(case, chip="constant")
    # from rest: by default an axis starts with the velocity of its reference
    outcome = simulate(
        machine(case, dry=dry), legs(case.reference, case.leg), load=loads, start=dict.fromkeys(AXES, (0.0, 0.0))
    )
    return {
        axis: Run(
            f"{axis}, {case.name}", {name: outcome[f"{axis}.{name}"] for name in Signals._fields}, T, outcome.samples
        )
        for axis in AXES
    }


def errors(outcome: Run) -> tuple[float, float]:
    """Return the largest and the RMS tracking error in µm after the first 0.3 s."""
    counted = 1e6 * outcome["tracking_error"][outcome.time >= SKIPPED]
    return float(np.max(np.abs(counted))), float(np.sqrt(np.mean(counted**2)))


def disturbances(axis: str, case: Case, outcome: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return the true ξ over the sample before each row, and its estimate, both in m/s²."""
    mechanics = loop(axis, case).axis.mechanics()
    weight = CARRIAGE[axis] * GRAVITY if axis == "z" else 0.0
    # an estimate at kT knows the force up to kT: that of the sample before
    cut = np.concatenate([[0.0], outcome["load_force"][:-1]])
    viscous = mechanics.damping[0][0] * outcome["velocity_load"]
    true = (cut + outcome["friction_load"] - viscous - weight) / mass(axis)
    seen = observe(law(axis, case).observer, outcome["reading_load"], outcome["force"], T)
    return true, seen.disturbance / (case.gain * mass(axis))


class Predicted(NamedTuple):
    """RMS errors after the first 0.3 s: of the estimated disturbance in m/s² and velocity in µm/s, and of the position
    in µm.
    """

    disturbance: float
    velocity: float
    position: float


def predicted(axis: str, case: Case, outcome: Run) -> Predicted:
    """Predict the errors of the continuous law and observer from the disturbance ξ of a run, without their blocks.

    With the polynomial p(s) = s⁷ + λ6 s⁶ + ... of five Taylor states and e1 = s⁵ ξ/p(s):

        v - v̂ = (s + λ6) e1,   ξ - ξ̂ = (s² + λ6 s + λ5) e1,   e'' + α1 e' + α0 e = ξ - share ξ̂ + α1 (v - v̂)

    A linear reference adds e' = -3 mm/s where it starts and +3 mm/s where it ends.
    """
    true = disturbances(axis, case, outcome)[0]
    # four times as long, with zeros: what rings on after the run must not come round to its beginning
    size = 4 * true.size
    s = 2j * np.pi * np.fft.rfftfreq(size, T)
    # over ω_o: in 1/s the coefficients reach 1e20
    pair = np.roots([1.0, 2.0 * ZETA, 1.0])
    polynomial = np.poly([*pair, *pair, *pair, -1.0]).real
    q = s / OMEGA_O
    first = q**5 / np.polyval(polynomial, q) / OMEGA_O**2
    velocity = OMEGA_O * (q + polynomial[1]) * first
    left = OMEGA_O**2 * (q**2 + polynomial[1] * q + polynomial[2]) * first
    a1, a0 = 2.0 * ZETA * OMEGA_C, OMEGA_C**2
    driven = (1.0 - case.share) + case.share * left + a1 * velocity
    responses = np.array([left, velocity, driven / (s**2 + a1 * s + a0)])
    disturbance, speed, position = np.fft.irfft(np.fft.rfft(true, size) * responses, size)[:, : true.size]
    time, way = outcome.time[: true.size], case.leg / FEED
    starts = {"x": way, "y": 0.0}
    if case.reference == "linear" and axis in starts:
        w = OMEGA_C * np.sqrt(1.0 - ZETA**2)
        for instant, jump in ((starts[axis], -FEED), (starts[axis] + way, FEED)):
            since = np.maximum(time - instant, 0.0)
            position = position + jump / w * np.exp(-ZETA * OMEGA_C * since) * np.sin(w * since)
    counted = time >= SKIPPED
    rms = [float(np.sqrt(np.mean(signal[counted] ** 2))) for signal in (disturbance, speed, position)]
    return Predicted(rms[0], 1e6 * rms[1], 1e6 * rms[2])


# (feed, normal, axial) in N at angles in rad, from an independent program
GOLDEN = {
    0.0: (204.1755, 284.1650, 68.9547),
    0.5: (-17.8345, 59.4484, 36.7252),
    1.0: (-326.8796, 124.8485, 68.9547),
    2.0: (-250.7488, 674.0345, 143.4674),
    3.0: (216.9431, 376.2670, 86.0768),
}
PRINTED_CHIP = 1e-3  # m, as printed in the paper's paragraph on the force


@dataclass(frozen=True, eq=False)
class Turn:
    """One revolution of the spindle: angle in rad, three forces in N and the torque in N m, each of shape (n,)."""

    angle: np.ndarray
    feed: np.ndarray
    normal: np.ndarray
    axial: np.ndarray
    torque: np.ndarray

    @property
    def power(self) -> float:
        """The mean torque times speed, W."""
        return float(np.mean(self.torque)) * SPINDLE / 60.0 * 2.0 * np.pi


def turn(cutter: HelicalCutter, chip_load: float, points: int = 7200) -> Turn:
    """Evaluate the closed form over one revolution at the midpoints of equal intervals.

    For a smooth periodic curve the mean of these values is exact.
    """
    # midpoints: at 0 the teeth enter, where the curve has a corner
    angle: Any = 2.0 * np.pi * (np.arange(points) + 0.5) / points
    feed, normal, axial = cutter.forces(angle, chip_load)
    return Turn(angle, *(np.asarray(column) for column in (feed, normal, axial, cutter.torque(angle, chip_load))))


def golden_error(cutter: HelicalCutter) -> float:
    """Return the largest difference in N between the forces and those of an independent program, at five angles."""
    return max(
        abs(float(got) - expected)
        for angle, row in GOLDEN.items()
        for got, expected in zip(cutter.forces(angle, CHIP), row, strict=True)
    )


def integrated(cutter: HelicalCutter, angle: float, chip_load: float, pieces: int = 20_000) -> np.ndarray:
    """Integrate the three forces in N of a slotting tool over thin slices of each edge."""
    height = (np.arange(pieces) + 0.5) / pieces * cutter.axial_depth
    total = np.zeros(3)
    for tooth in range(cutter.teeth):
        v = angle + 2.0 * np.pi * tooth / cutter.teeth - 2.0 * np.tan(cutter.helix_angle) / cutter.diameter * height
        chip = chip_load * np.maximum(np.sin(v), 0.0)
        tangential = cutter.specific_energy * chip * cutter.axial_depth / pieces
        radial = cutter.radial_ratio * tangential
        total += [
            -np.sum(tangential * np.cos(v) + radial * np.sin(v)),
            np.sum(tangential * np.sin(v) - radial * np.cos(v)),
            cutter.axial_ratio * np.sum(tangential),
        ]
    return total


def integration_error(cutter: HelicalCutter) -> float:
    """Return the largest difference in N between closed form and slices, at 24 angles."""
    # beside the angles at which a tooth enters or leaves: slices are least exact there
    angles = 2.0 * np.pi * np.arange(24) / 24.0 + 0.01
    off = [integrated(cutter, angle, CHIP) - np.array(cutter.forces(angle, CHIP)) for angle in angles]
    return float(np.max(np.abs(off)))


def removed_power(cutter: HelicalCutter, chip_load: float) -> float:
    """Return the specific cutting energy u_s times the volume removed per second in a slot, W."""
    feed = chip_load * cutter.teeth * SPINDLE / 60.0
    return cutter.specific_energy * feed * cutter.diameter * cutter.axial_depth


def as_printed() -> Turn:
    """Evaluate one revolution with the data of the paper's force paragraph taken literally."""
    with warnings.catch_warnings():
        # the preset warns that its data are contradictory, which is the claim here
        warnings.simplefilter("ignore")
        return turn(HelicalCutter.beltran2013_as_printed(), PRINTED_CHIP)


RIGID = Case("", share=1.0)


def left_over(observer: GpiObserver, frequency: np.ndarray) -> np.ndarray:
    """Return 1 - H = (ξ - ξ̂)/ξ of the paper's continuous observer: the three leading terms of its polynomial over
    the whole polynomial.
    """
    # over ω_o, as the polynomial is: in 1/s its coefficients reach 1e20
    s = 2j * np.pi * np.asarray(frequency, dtype=float) / observer.omega_o
    coefficients = [float(coefficient) for coefficient in observer.polynomial()]
    first = np.polyval(coefficients[:3], s) * s ** (len(coefficients) - 3)
    return first / np.polyval(coefficients, s)


def observer_of(taylor_states: int) -> GpiObserver:
    """Return the paper's observer on x, with a different number of Taylor states."""
    observer = law("x", dataclasses.replace(RIGID, taylor_states=taylor_states)).observer
    assert isinstance(observer, GpiObserver)
    return observer


def sine_test(frequency: float, taylor_states: int = 5, share: float = 1.0) -> tuple[complex, complex]:
    """Measure (ξ - ξ̂)/ξ and position/ξ (s²) by simulation of the loop on x, with a 200 N sine force on the axis at
    standstill.

    The force is held over each sample, hence delayed by half a sample; the axis has no dry friction, so that it is
    linear.
    """
    case = dataclasses.replace(RIGID, taylor_states=taylor_states, share=share)
    # long enough for the window to separate the sine from what rings, at low frequencies as well
    periods = int(np.ceil(max(20.0, 1.5 * frequency)))
    settled = int(np.ceil(frequency))  # a second
    outcome = simulate(
        loop("x", case, dry=False),
        legs("linear", LEG)["z"],
        load=SineForce(amplitude=200.0, frequency=frequency),
        duration=(periods + settled) / frequency,
        start=(0.0, 0.0),
    )
    seen = observe(law("x", case).observer, outcome["reading_load"], outcome["force"], T)
    counted = outcome.time >= settled / frequency
    # a Hann window: the response has not quite settled, and its rest must not leak into the line
    wave = np.exp(-2j * np.pi * frequency * outcome.time[counted]) * np.hanning(int(np.sum(counted)))
    true, estimate, position = (
        np.sum(wave * signal[counted]) for signal in (outcome["load_force"], seen.disturbance, outcome["position_load"])
    )
    # the hold of the force delays it by half a sample, which is none of the observer's
    late = np.exp(-1j * np.pi * frequency * T)
    return complex(1.0 - estimate / (true * late)), complex(position / (true * late) * mass("x"))


def noise_gain(sample_time: float) -> float:
    """Return σ(ξ̂)/σ(y) in 1/s² for white noise of the reading: root of the sum of squares of the impulse response."""
    # 1 s, in which the impulse response of an observer at 700 rad/s has decayed
    position = np.zeros(round(1.0 / sample_time))
    # not at 0, where the observer starts at its first reading
    position[1] = 1.0
    observer = law("x", RIGID).observer
    seen = observe(observer, position, np.zeros_like(position), sample_time)
    return float(np.sqrt(np.sum((seen.disturbance / mass("x")) ** 2)))


def _edge(holds: Callable[[float], bool], good: float, bad: float) -> float:
    """Find by bisection the value between `good` and `bad` at which a condition ceases to hold."""
    # to a four thousandth of the interval: the claims are about the second digit
    for _ in range(12):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good


def gain_limits() -> tuple[float, float]:
    """Return the least and the largest ratio of true to assumed input gain for which the loop on x is stable."""

    def stable(gain: float) -> bool:
        return stability(loop("x", dataclasses.replace(RIGID, gain=gain))).stable

    return _edge(stable, 1.0, 0.3), _edge(stable, 1.0, 4.0)


def sample_time_limit(hold: str) -> float:
    """Return the longest sample time in s for which the law is accepted."""

    def admitted(sample_time: float) -> bool:
        try:
            tree.check_sampled(law("x", dataclasses.replace(RIGID, hold=hold)), sample_time)
        except ParameterError:
            return False
        return True

    return _edge(admitted, 1e-4, 4e-3 if hold == "first_order" else 4e-4)
