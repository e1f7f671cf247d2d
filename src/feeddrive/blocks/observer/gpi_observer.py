"""The observer of generalized proportional integral (GPI) control, with a Taylor polynomial in time as disturbance."""

import operator
from collections.abc import Iterator
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import Observer
from feeddrive.blocks.signals import Estimate, Reading
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, Rule, choice, parameter
from feeddrive.language.matrix import Matrix, Row
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class GpiObserver(Observer):
    """An observer of position, velocity and disturbance of a rigid axis q'' = u + ξ, with ξ a polynomial in time.

        x̂1' = x̂2 + λ ε,   x̂2' = u + ẑ1 + λ ε,   ẑ1' = ẑ2 + λ ε,  ...,  ẑn' = λ ε         ε = y - x̂1,  u = applied / mass
        velocity = x̂2,   disturbance = mass · ẑ1

    The polynomial ξ has the degree taylor_states - 1.  The gains λ, a different one for each state, place the poles of
    the error; with order = 2 + taylor_states the characteristic polynomial is

        (s + p0) (s² + 2 zeta_o omega_o s + omega_o²)^((order - 1)/2)     order odd
                 (s² + 2 zeta_o omega_o s + omega_o²)^(order/2)           order even, without the real pole

    The sampled form is exact, with u held and y linear between its samples (first-order hold: the estimate at kT uses
    the reading at kT), in coordinates z_i = x̂_i / omega_o^i, in which all entries are of order one:

        z(k) = F z(k-1) + Gu u(k-1) + Gy0 y(k-1) + Gy1 y(k),    F = e^(A T)

    A constant reading leaves z = (y, 0, ...) unchanged, so F, Gy0 and Gy1 together reproduce it; hence only the
    change of y enters, and z_0 is stored relative to y. No precision is lost far from zero, not even in float32.

    When to use: friction, cutting and gravity on a stiff axis, well below omega_o.  Do not use it to reject
    disturbances near or above omega_o: their estimate has the wrong amplitude and phase, and subtracting it increases
    the error, 4 times at 1.3 omega_o with 5 states, 2.6 times with 3, 1.4 times with one.  Do not use it with an axis
    mode near omega_o either. `hold = "zero_order"` holds the reading constant instead, for comparison: the sample time
    must then be 15 times shorter.
    Source: Beltrán-Carbajal et al. 2013, eqs. (13)-(18); the sampled form is specific to this library.
    Raises ParameterError for an omega_o too high for the sample time.
    """

    tunables = ("omega_o", "zeta_o")

    mass: Number = parameter("kg", "all that moves, as the observer believes; rather too large than too small", above=0)
    taylor_states: int = choice("states of the disturbance: it and its derivatives", default=5, least=0, most=10)
    omega_o: Number = parameter("rad/s", "own frequency of the pairs of poles", above=0)
    zeta_o: Number = parameter("", "their damping ratio", above=0, default=0.7071)
    p0: Number | None = parameter("rad/s", "the real pole of an odd order; absent: as omega_o", above=0, default=None)
    hold: str = choice(
        "the reading between two samples: a straight line, or kept",
        options=("first_order", "zero_order"),
        default="first_order",
    )
    encoder: str = choice("encoder whose reading is observed", options=("load", "motor"), default="load")
    delay_samples: int = choice("samples of dead time until a command acts", default=0, least=0, most=64)
    start_disturbance: Number | None = parameter(
        "N", "disturbance at a start, as the weight of a hanging axis; absent: what balances the force", default=None
    )

    class Prepared(NamedTuple):
        """F, and the input columns for u (including 1/mass) and for the change of y."""

        F: Matrix
        Gu: Row
        Gy: Row

    class State(NamedTuple):
        """z (m), z_0 relative to the last reading; the last reading (m); commands not yet acting (N, newest first).

        `brake` is the force in N with which a brake held the axis before the start; it is 0 afterwards.
        """

        z: tuple[Number, ...]
        position: Number
        pending: tuple[Number, ...]
        brake: tuple[Number, ...] = ()

    def polynomial(self) -> Row:
        """Return the characteristic polynomial of the error in s / omega_o, highest power (coefficient 1) first."""
        order = 2 + self.taylor_states
        made: Row = (1.0,)
        for _ in range(order // 2):
            made = _product(made, (1.0, 2.0 * self.zeta_o, 1.0))
        if order % 2:
            made = _product(made, (1.0, 1.0 if self.p0 is None else self.p0 / self.omega_o))
        return made

    def gains(self) -> Row:
        """Return the gains λ, that of x̂1 first: the coefficients of the polynomial in s, in 1/s, 1/s², ..."""
        rate, gains = self.omega_o, []
        for coefficient in self.polynomial()[1:]:
            gains.append(coefficient * rate)
            rate = rate * self.omega_o
        return tuple(gains)

    def prepare(self, T: Number) -> Prepared:
        """Compute the exact sampled form by one matrix exponential, with u and the slope of y as constant inputs."""
        return self._sampled(matrix.expm1(self._rate(T)), 1.0)

    def _rate(self, T: Number) -> Matrix:
        """Return A T, where A is extended by u and by the change of y over a sample as constant inputs."""
        order = 2 + self.taylor_states
        turn = self.omega_o * T
        rate = matrix.zeros(order + 2, order + 2)
        for i, coefficient in enumerate(self.polynomial()[1:]):
            rate[i][0] = -(turn * coefficient)
            if i + 1 < order:
                rate[i][i + 1] = turn
        rate[1][order] = turn  # of u / omega_o²
        # z_0 is relative to y, so that a change of y in a sample is subtracted from it
        rate[0][order + 1] = -1.0
        return tuple(map(tuple, rate))

    def _sampled(self, change: Matrix, share: Number) -> Prepared:
        """Return the sampled form for a sample of length `share` · T, from `change` = e^(share A T) - 1."""
        order = 2 + self.taylor_states
        F = tuple(tuple(x + 1.0 if i == j else x for j, x in enumerate(row[:order])) for i, row in enumerate(change))
        per_force = 1.0 / (self.mass * self.omega_o * self.omega_o)
        Gu = tuple(row[order] * per_force for row in change[:order])
        Gy = tuple(row[order + 1] if matrix.is_one(share) else row[order + 1] / share for row in change[:order])
        if self.hold == "zero_order":
            # y jumps at kT, and no state has responded yet
            Gy = (-1.0, *(0.0,) * (order - 1))
        return self.Prepared(F[:order], Gu, Gy)

    def start(self, prepared: Prepared, reading: Reading) -> State:
        """Return the state of steady motion; the disturbance is `start_disturbance` if given, otherwise it balances the
        force.
        """
        position = reading.position(self.encoder)
        z = [ops.zero(position)] * (2 + self.taylor_states)
        z[1] = reading.velocity / self.omega_o
        if self.taylor_states:
            balance = -reading.applied if self.start_disturbance is None else self.start_disturbance
            z[2] = balance / (self.mass * self.omega_o * self.omega_o)
        # a brake held the part of the given disturbance that the force did not balance
        brake = () if self.start_disturbance is None else (-self.start_disturbance - reading.applied,)
        return self.State(tuple(z), position, (reading.applied,) * self.delay_samples, brake)

    def step(self, prepared: Prepared, state: State, reading: Reading, T: Number) -> tuple[State, Estimate]:
        """Evaluate the equations in the class docstring; u is the last sample's acting force, after the limit."""
        y = reading.position(self.encoder)
        commands = (reading.applied, *state.pending)
        acted = commands[-1] + state.brake[0] if state.brake else commands[-1]
        moved = (*state.z, acted, y - state.position)
        z = tuple(
            matrix.dot((*row, of_force, of_change), moved)
            for row, of_force, of_change in zip(prepared.F, prepared.Gu, prepared.Gy, strict=True)
        )
        disturbance = self.mass * self.omega_o * self.omega_o * z[2] if self.taylor_states else ops.zero(y)
        state = self.State(z, y, commands[:-1], tuple(ops.zero(y) for _ in state.brake))
        return state, Estimate(y + z[0], self.omega_o * z[1], disturbance)

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Rescale z so that z_1 omega_o, the velocity, and mass · z_i omega_o^i (i >= 2) stay unchanged."""
        slower, lighter = old.omega_o / self.omega_o, old.mass / self.mass
        z, scale = [state.z[0], slower * state.z[1]], lighter * slower * slower
        for held in state.z[2:]:
            z.append(scale * held)
            scale = scale * slower
        return state._replace(z=tuple(z))

    def lag(self, prepared: Prepared, T: Number) -> Number:
        """Return the delay in s of the estimate of a ramp disturbance: 0.0, except for a single Taylor state."""
        coefficients = self.polynomial()
        return coefficients[-2] / (coefficients[-1] * self.omega_o) if self.taylor_states == 1 else 0.0

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rule that omega_o is slow enough for the sample time.

        A rigid axis from which the estimated disturbance is subtracted must be stable at T and also at T/2, T/4, ...:
        if it is unstable at shorter sample times, its stability at T is accidental.
        """
        if self.taylor_states:
            halved, squarings = matrix.expm1_doubled(self._rate(T))
            # T/2ˢ: the doubling of the exponential has computed these samples anyway
            shares = (ops.power_of_two(ops.minimum(float(s), squarings) - squarings) for s in range(len(halved)))
            rejecting = (
                self._rejecting(self._sampled(change, share), share * T)
                for change, share in zip(halved, shares, strict=True)
            )
            yield Rule(
                matrix.all_decay(rejecting),
                "omega_o is slow enough for the sample time: with the disturbance subtracted a rigid axis is stable",
                lambda: self._refusal(T),
            )

    def _refusal(self, T: float) -> str:
        """Return the error message, which states by how much omega_o is too fast, and the nearest admissible values."""
        real = 1.0 if self.p0 is None else self.p0 / self.omega_o
        most = _fastest(self.taylor_states, self.zeta_o, real, self.hold, self.delay_samples)
        turn = self.omega_o * T
        return Text(
            f"{self.kind}.omega_o = {Quantity(self.omega_o, 'rad/s'):6} is too fast for a sample time of "
            f"{Quantity(T, 's'):6 SI}: omega_o T = {Quantity(turn)} is {Quantity(turn - most):3} over the limit "
            f"{Quantity(most)} of this observer with hold = '{self.hold}'. Take omega_o <= "
            f"{Quantity(most / T, 'rad/s')}, or sample every {Quantity(most / self.omega_o, 's'):SI} or faster"
        )

    def growth(self, T: Number) -> Any:
        """Return the spectral radius of the loop u = -ẑ1 around q'' = u, including the dead time."""
        return matrix.growth(self._rejecting(self.prepare(T), T))

    def _rejecting(self, made: Prepared, T: Number) -> list[list[Any]]:
        """Return the transition matrix of the loop u = -ẑ1 around q'' = u over one sample, including the dead time.

        With z_0 relative to q and z_1 relative to q', the observer is autonomous.  The two other poles of the loop,
        which lie at 1 without a position controller, are thus left out.
        """
        order, late = 2 + self.taylor_states, self.delay_samples
        square = self.omega_o * self.omega_o
        rows: list[list[Any]] = [[*row, *(0.0,) * late] for row in made.F] + matrix.zeros(late, order + late)
        # u = -omega_o² z_2, through the commands that have not acted yet
        for i in range(late):
            rows[order + i][2 if i == 0 else order + i - 1] = -square if i == 0 else 1.0
        acting, size = (order + late - 1, 1.0) if late else (2, -square)
        for i in range(order):
            # u moves q by u T²/2, seen as a change of y, and q' by u T
            effect = made.Gu[i] * self.mass + made.Gy[i] * 0.5 * T * T - (T / self.omega_o if i == 1 else 0.0)
            rows[i][acting] = rows[i][acting] + size * effect
        return rows


@cache
def _fastest(taylor_states: int, zeta_o: float, p0: float, hold: str, delay_samples: int) -> float:
    """Return the smallest omega_o T at which the loop of `growth` is unstable; stability beyond it is accidental."""
    shape = GpiObserver(
        mass=1.0, omega_o=1.0, p0=p0, taylor_states=taylor_states, zeta_o=zeta_o, hold=hold, delay_samples=delay_samples
    )

    # 1e-3 to 97 in steps of 20 %; `edge` refines the first one that fails
    turns = list(accumulate((1.2,) * 63, operator.mul, initial=1e-3))
    most = matrix.edge(lambda turn: shape.growth(turn) < 1.0, turns)
    return turns[-1] if most is None else most


def _product(a: Row, b: Row) -> Row:
    """Return the coefficients of the product of two polynomials."""
    coefficients: list[Any] = [0.0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            term = y if matrix.is_one(x) else x if matrix.is_one(y) else x * y
            coefficients[i + j] = term if matrix.is_zero(coefficients[i + j]) else coefficients[i + j] + term
    return tuple(coefficients)
