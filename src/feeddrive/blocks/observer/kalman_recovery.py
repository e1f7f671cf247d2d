"""Disturbance estimate by a Kalman filter for a rigid axis."""

from typing import NamedTuple, Self

from feeddrive.blocks.families import Observer
from feeddrive.blocks.signals import Estimate, Reading
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.matrix import Matrix, Row

# of ρ: the gain is nearly that without noise; above it the Riccati equation loses digits
LARGEST_RATIO = 1e5
# of the Riccati equation: 2²⁴ samples of the filter, more than the slowest one needs to settle
DOUBLINGS = 24


class KalmanRecovery(Observer):
    """Disturbance recovery by a steady-state Kalman filter of position, velocity and a random-walk force.

        predict   x̂⁻ = Φ x̂(k-1) + Γ F_m(k-1),   zero-order hold of m x'' + b x' = F_m + F_d over the sample
        correct   x̂(k) = x̂⁻ + L (x(k) - x̂⁻₁),    x̂ = (x, v, F_d)
        L = P Cᵀ/(C P Cᵀ + R),   P = Φ (P⁻¹ + Cᵀ R⁻¹ C)⁻¹ Φᵀ + diag(0, 0, force_step²),   R = resolution²/12

    The gain follows from the Riccati equation, which is solved by doubling, with lengths in units of the resolution and
    times in units set by the filter's bandwidth, so that coarse and fine encoders are treated alike.  In these units
    the gain depends on one ratio, ρ = force_step T² √12/(m resolution): the filter's bandwidth is about ∛ρ/T rad/s.

    When to use: in place of `DisturbanceRecovery` where quantization by the encoder dominates.  Not suitable for forces
    that change faster than `force_step` per sample, or if the resolution is unknown.
    Source: Altintas & Okwudire 2009, section 3 (exact recovery); Kalman 1960 (the filter); Anderson & Moore 1979,
    section 6.7 (doubling).
    """

    tunables = ("force_step",)

    mass: Number = parameter("kg", "m: all that moves", above=0)
    viscous: Number = parameter("N s/m", "b: viscous friction that does not count as disturbance", least=0, default=0)
    resolution: Number = parameter("m", "length of one count of the encoder", above=0)
    force_step: Number = parameter("N", "standard deviation of what the disturbance changes in a sample", above=0)
    delay_samples: int = choice("samples of dead time until a command acts", default=0, least=0, most=64)
    encoder: str = choice("encoder whose reading is filtered", options=("load", "motor"), default="load")

    class Prepared(NamedTuple):
        """The entries of Φ - 1 above its diagonal and at (v, v), and the gain L, in SI units."""

        x_of_v: Number  # s
        x_of_force: Number  # m/N
        v_of_v: Number
        v_of_force: Number  # (m/s)/N
        gain: Row

    class State(NamedTuple):
        """The estimated position (m), velocity (m/s) and disturbance (N), and commands that have not acted yet (N)."""

        position: Number
        velocity: Number
        disturbance: Number
        pending: tuple[Number, ...]

    def prepare(self, T: Number) -> Prepared:
        """Compute the discretized model and Kalman gain in normalized units: position noise 1, force steps w = ∛ρ."""
        # 1/√12: the standard deviation of a rounding to counts
        noise = 0.2886751345948129 * self.resolution
        ratio = ops.minimum(self.force_step * T * T / (self.mass * noise), LARGEST_RATIO)
        # cube root, in operations that a trace records
        w = ops.exp(ops.log(ratio) / 3.0)
        rate = ((0.0, w, 0.0), (0.0, -self.viscous * T / self.mass, w), (0.0, 0.0, 0.0))
        change = matrix.expm1(rate)
        a, b, c, d = change[0][1], change[0][2], change[1][1], change[1][2]
        steady = riccati(((1.0, a, b), (0.0, 1.0 + c, d), (0.0, 0.0, 1.0)), w * w)
        gain = tuple(row[0] / (steady[0][0] + 1.0) for row in steady)
        # back to SI: v is in units of noise w/T, the force in m noise w²/T²
        v, force = w / T, self.mass * w * w / (T * T)
        return self.Prepared(a / v, b / force, c, d * v / force, (gain[0], gain[1] * v, gain[2] * force))

    def start(self, prepared: Prepared, reading: Reading) -> State:
        """Return the state of steady motion through the measured position; the disturbance balances the force."""
        held = self.viscous * reading.velocity - reading.applied
        return self.State(
            reading.position(self.encoder), reading.velocity, held, (reading.applied,) * self.delay_samples
        )

    def step(self, prepared: Prepared, state: State, reading: Reading, T: Number) -> tuple[State, Estimate]:
        """Predict with the command that acted, and correct with the reading."""
        commands = (reading.applied, *state.pending)
        force = state.disturbance + commands[-1]
        position = state.position + (prepared.x_of_v * state.velocity + prepared.x_of_force * force)
        velocity = state.velocity + (prepared.v_of_v * state.velocity + prepared.v_of_force * force)
        missed = reading.position(self.encoder) - position
        position = position + prepared.gain[0] * missed
        velocity = velocity + prepared.gain[1] * missed
        disturbance = state.disturbance + prepared.gain[2] * missed
        after = self.State(position, velocity, disturbance, commands[: self.delay_samples])
        return after, Estimate(position, velocity, disturbance)

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Return the state unchanged: it holds a position, a velocity and forces."""
        return state

    def lag(self, prepared: Prepared, T: Number) -> Number:
        """Return the delay in s: the steady-state error under a ramp force, divided by the slope of the ramp."""
        x, v, force = prepared.gain
        share = prepared.v_of_v / prepared.x_of_v
        return T * (v - share * x) / (force * (prepared.v_of_force - share * prepared.x_of_force))


def riccati(transition: Matrix, walk: Number) -> Matrix:
    """Return the steady covariance before a correction, for position noise 1 and a random walk of the third state.

    P = Φ (P⁻¹ + Cᵀ C)⁻¹ Φᵀ + Q, C = (1 0 0), Q = diag(0, 0, walk), by doubling, which covers 2ⁿ samples in n steps:

        W = (1 + Y P)⁻¹,   P <- P + A P W Aᵀ,   Y <- Y + Aᵀ W Y A,   A <- A Wᵀ A

    with the initial values A = Φ, Y = Cᵀ C, P = Q. 1 + Y P has a determinant >= 1, and its inverse is computed
    explicitly.
    """
    a: Matrix = transition
    y: Matrix = ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    p: Matrix = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, walk))
    for _ in range(DOUBLINGS):
        w = _inverse(matrix.add(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), matrix.multiply(y, p)))
        turned, after = _transposed(a), _transposed(w)
        p_next = matrix.add(p, matrix.multiply(a, matrix.multiply(p, matrix.multiply(w, turned))))
        y = matrix.add(y, matrix.multiply(turned, matrix.multiply(w, matrix.multiply(y, a))))
        a, p = matrix.multiply(a, matrix.multiply(after, a)), p_next
    return p


def _transposed(a: Matrix) -> Matrix:
    return tuple(zip(*a, strict=True))


def _inverse(a: Matrix) -> Matrix:
    """Return the inverse of a 3 x 3 matrix, by cofactors and without pivoting."""

    def cofactor(i: int, j: int) -> Number:
        up, down, left, right = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return a[up][left] * a[down][right] - a[up][right] * a[down][left]

    # a trace cannot choose pivots; the determinant is at least 1, see `riccati`
    determinant = matrix.dot(a[0], tuple(cofactor(0, j) for j in range(3)))
    return tuple(tuple(cofactor(j, i) / determinant for j in range(3)) for i in range(3))
