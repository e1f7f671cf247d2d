"""The axis of all experiments, its laws under the comparison rules, its cutting force, and the paper's ideal loop.

In the ideal loop the force depends on the reading of the same sample, while `Loop` simulates a real machine, where the
force acts after the reading.  The ideal loop uses the law's own step, which is affine in the reading, so that two
evaluations of it suffice to solve a sample.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.families import Compensation, Feedforward, Friction, Law
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

MASS, VISCOUS, T = 40.0, 60.0, 1e-4
PLANT = "rigid axis m = 40 kg, b = 60 N s/m, T = 0.1 ms"
REST = Polynomial7(distance=0.0, travel_time=1.0)


def dadsc(rate: float, mass: float = MASS) -> DADSC:
    """Return the DADSC law with three equal rates: λ = K = ω_d = rate."""
    return DADSC(mass=mass, viscous=VISCOUS, tracking_rate=rate, reaching_rate=rate, adaptation_rate=rate)


def cascade(rate: float, mass: float = MASS) -> CascadePPI:
    """Return the cascade with k_d = 3 · mass · rate, as in `dadsc(rate)`, and the largest integral gain that real poles
    allow.

    s³ + a (s + Kv)(s + 1/Tn) with a = Kp/m has its double real root at Kv = 1/Tn = a/6.75 = 4/9 · rate.
    """
    gain = 4.0 * rate / 9.0
    return CascadePPI(Kv=gain, Kp=3.0 * mass * rate, Tn=1.0 / gain, viscous=VISCOUS)


def continuous_compliance(name: str, rate: float, frequency: np.ndarray) -> np.ndarray:
    """Return the compliance x/F_d of the PID that equals `dadsc` or `cascade` in continuous time, m/N, complex.

    DADSC: s/(m (s + p)³); the cascade: s/(m (s³ + 3 p (s + 4 p/9)²)), since Kv = 1/Tn at its double root.
    """
    s = 2j * np.pi * np.asarray(frequency, dtype=float)
    if name == "DADSC":
        return s / (MASS * (s + rate) ** 3)
    return s / (MASS * (s**3 + 3.0 * rate * (s + 4.0 * rate / 9.0) ** 2))


def loop(
    law: Law,
    *,
    mass: float = MASS,
    resolution: float | None = None,
    dead_time: float = 0.0,
    compensation: tuple[Compensation, ...] = (),
    friction: Friction | None = None,
) -> Loop:
    """Return the loop of a law on the axis; a law without its own acceleration feedforward gets one with `mass`
    in kg.
    """
    feedforward = () if "acceleration" in law.feeds else (Inertia(mass=mass),)
    return Loop(
        control=Control(law=law, feedforward=feedforward, compensation=compensation),
        axis=Axis(
            plant=Rigid(mass=MASS, viscous=VISCOUS),
            actuator=Actuator(dead_time=dead_time),
            friction_load=friction,
            encoder_load=None if resolution is None else Encoder(resolution=resolution),
        ),
        sample_time=T,
    )


def milling(duration: float, rms: float = 161.0) -> RecordedForce:
    """Return the force of interrupted milling along the feed: four straight teeth, 3000 rpm, up-milling from 0 to 90
    degrees, K_r = 0.3.

    The tooth passing frequency is 200 Hz; the force is scaled to the RMS in N.
    """
    t = np.arange(round(duration / T) + 1) * T
    force = np.zeros(t.size)
    for tooth in range(4):
        angle = (2.0 * np.pi * 50.0 * t + 0.5 * np.pi * tooth) % (2.0 * np.pi)
        chip = np.where(angle <= 0.5 * np.pi, np.sin(angle), 0.0)
        force -= chip * (np.cos(angle) + 0.3 * np.sin(angle))
    return RecordedForce(force=force * (rms / np.sqrt(np.mean(force**2))), sample_time=T)


_PROBE = 1.0  # m between the two readings from which the slope of an affine law is computed


class Column(NamedTuple):
    """The coefficients r1 ... r5 of a law in the general transfer function (8), a column of the paper's table 1."""

    r1: float
    r2: float
    r3: float
    r4: float
    r5: float


def dadsc_column(law: DADSC, T: float) -> Column:
    """Return the coefficients of DADSC: (λT + 1, mK, λT + 1, g1, g2)."""
    g1, g2 = law.prepare(T)
    rate = law.tracking_rate * T + 1.0
    return Column(rate, law.mass * law.reaching_rate, rate, g1, g2)


def cascade_column(Kv: float, Kp: float, Tn: float, T: float) -> Column:
    """Return the coefficients of the cascade: (1, Kp, Kv T + 1, Kp T/Tn, 0)."""
    return Column(1.0, Kp, Kv * T + 1.0, Kp * T / Tn, 0.0)


class Fraction(NamedTuple):
    """A transfer function: numerator and denominator in descending powers of z."""

    numerator: np.ndarray
    denominator: np.ndarray

    def response(self, frequency: np.ndarray, T: float) -> np.ndarray:
        """Return the frequency response at z = e^(j2πfT)."""
        z = np.exp(2j * np.pi * frequency * T)
        return np.polyval(self.numerator, z) / np.polyval(self.denominator, z)

    def impulse(self, count: int) -> np.ndarray:
        """Return the first samples of the impulse response."""
        top = np.concatenate([np.zeros(self.denominator.size - self.numerator.size), self.numerator])
        top = np.concatenate([top, np.zeros(count)])
        response = np.zeros(count)
        for k in range(count):
            past = sum(self.denominator[i] * response[k - i] for i in range(1, min(k, self.denominator.size - 1) + 1))
            response[k] = (top[k] - past) / self.denominator[0]
        return response


def transfer(column: Column, mass: float, T: float, *, printed: bool = False) -> Fraction:
    """Return x/F_d by (8).

        T² z² (z - 1) / {m (z - 1)² (r1 z - 1) + r2 T (z² - z)(r3 z - 1) + T z (r4 z - r5)(r3 z - 1)}

    `printed` uses z² - 1 in the second term, as printed in the paper.
    """
    r1, r2, r3, r4, r5 = column
    second = [1.0, 0.0, -1.0] if printed else [1.0, -1.0, 0.0]
    first = mass * np.polymul([1.0, -2.0, 1.0], [r1, -1.0])
    rest = T * np.polymul(r2 * np.array(second) + np.array([r4, -r5, 0.0]), [r3, -1.0])
    return Fraction(T * T * np.array([1.0, -1.0, 0.0, 0.0]), np.polyadd(first, rest))


def closed_form_poles(law: DADSC, T: float) -> np.ndarray:
    """Return the poles of (8) with g2 = g1/Q: 1/(1 + λT), 1/Q, Q/(Q + g1 T/m)."""
    Q = 1.0 + law.reaching_rate * T
    g1 = law.prepare(T).g1
    return np.array([1.0 / (1.0 + law.tracking_rate * T), 1.0 / Q, Q / (Q + g1 * T / law.mass)])


def continuous(poles: np.ndarray, T: float) -> np.ndarray:
    """Return the equivalent continuous-time poles ln z / T, rad/s."""
    return np.log(poles.astype(complex)) / T


@dataclass(frozen=True, eq=False)
class Ideal:
    """The signals of a run in the ideal loop, each of shape (n,): position (m), errors, force and disturbance (N),
    and law states.
    """

    position: np.ndarray
    position_error: np.ndarray
    velocity_error: np.ndarray
    force: np.ndarray
    disturbance: np.ndarray
    states: Sequence[Any]


def run_ideal(
    law: Law,
    mass: float,
    viscous: float,
    T: float,
    disturbance: np.ndarray,
    *,
    setpoint: np.ndarray | None = None,
    feedforward: Feedforward | None = None,
) -> Ideal:
    """Simulate the law with the plant of (1) by backward Euler, with force and reading in the same sample.

        v(k) = v(k-1) + (T/m) (F_m(k) + F_d(k) - b v(k)),    x(k) = x(k-1) + T v(k)

    setpoint  set position at kT, m, shape (n,), at rest before its first sample; default: 0
    """
    n = disturbance.size
    x_r = np.zeros(n) if setpoint is None else setpoint
    v_r = np.diff(x_r, prepend=x_r[0]) / T
    a_r = np.diff(v_r, prepend=0.0) / T
    # the law takes the backward difference of a setpoint with this acceleration back to v_r
    setpoints = [Setpoint(x, v + 0.5 * T * a, a) for x, v, a in zip(x_r, v_r, a_r, strict=True)]
    prepared = law.prepare(T)
    state = law.start(prepared, setpoints[0], Reading(x_r[0], x_r[0]))
    before, speed = float(x_r[0]), 0.0
    rows: list[tuple[float, float]] = []
    states: list[Any] = []
    for k, target in enumerate(setpoints):
        forward = 0.0 if feedforward is None else feedforward.step(feedforward.start(target), target, T)[1]

        def answer(
            x: float, target: Setpoint = target, forward: float = forward, held: Any = state
        ) -> tuple[Any, float]:
            after, force = law.step(prepared, held, target, Reading(x, x), T)
            return after, force + forward

        x, speed = _solved(answer, before, speed, mass, viscous, T, float(disturbance[k]))
        state, force = answer(x)
        before = x
        rows.append((x, force))
        states.append(state)
    position, force = np.array(rows).T
    velocity = np.diff(position, prepend=x_r[0]) / T
    return Ideal(position, x_r - position, v_r - velocity, force, disturbance, states)


def _solved(
    answer: Callable[[float], tuple[Any, float]],
    before: float,
    speed: float,
    mass: float,
    viscous: float,
    T: float,
    load: float,
) -> tuple[float, float]:
    """Return the position and velocity at the end of a sample, for F = c + d x, (m/T + b) v = m v(k-1)/T + F + F_d."""
    at = before + T * speed
    here = answer(at)[1]
    # the law is affine in the reading: a difference of any width is exact
    slope = (answer(at + _PROBE)[1] - here) / _PROBE
    inertia = mass / T + viscous
    # with x = before + T v and F = here + slope (x - at)
    v = (mass * speed / T + here + slope * (before - at) + load) / (inertia - slope * T)
    return before + T * v, v


@dataclass(frozen=True, eq=False)
class IdealModel:
    """The state-space model of the ideal loop with a shipped law, from F_d(k) to all states: z(k) = A z(k-1) + b
    F_d(k), initially at rest.

    names   names of the states: x, v, and those of the law
    """

    A: np.ndarray
    b: np.ndarray
    names: tuple[str, ...]

    def poles(self) -> np.ndarray:
        """Return the poles ln z / T in rad/s, without those of states that only store a reading."""
        eigenvalues = np.linalg.eigvals(self.A)
        return continuous(eigenvalues[np.abs(eigenvalues) > 1e-6], T)

    def response(self, frequency: np.ndarray, name: str, sample_time: float = T) -> np.ndarray:
        """Return the frequency response from F_d to a state, at z = e^(j2πfT)."""
        z = np.exp(2j * np.pi * np.asarray(frequency) * sample_time)
        size = self.A.shape[0]
        states = np.linalg.solve(
            z[:, None, None] * np.eye(size) - self.A, np.broadcast_to(self.b, (z.size, size))[..., None]
        )
        # F_d(k) acts in sample k already: z (z - A)⁻¹ b
        return z * states[:, self.names.index(name), 0]


def ideal_model(law: Law, sample_time: float = T, mass: float = MASS, viscous: float = VISCOUS) -> IdealModel:
    """Build the model from one step of the law per state, which suffices since the law is affine."""
    prepared = law.prepare(sample_time)
    template = law.start(prepared, Setpoint(0.0), Reading(0.0, 0.0))
    leaves = [(name, value) for name, value in tree.leaves(template)]

    def after(z: Sequence[float], load: float) -> np.ndarray:
        held = tree.rebuild(template, iter(z[2:]))

        def answer(x: float) -> tuple[Any, float]:
            return law.step(prepared, held, Setpoint(0.0), Reading(x, x), sample_time)

        x, v = _solved(answer, z[0], z[1], mass, viscous, sample_time, load)
        return np.array([x, v, *(value for _, value in tree.leaves(answer(x)[0]))])

    still = [0.0, 0.0, *(value for _, value in leaves)]
    # an affine map: its constant part is subtracted from every column
    rest = after(still, 0.0)
    columns = []
    for i in range(len(still)):
        moved = list(still)
        moved[i] += 1.0
        columns.append(after(moved, 0.0) - rest)
    return IdealModel(np.column_stack(columns), after(still, 1.0) - rest, ("x", "v", *(name for name, _ in leaves)))
