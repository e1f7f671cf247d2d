"""Generalized predictive control of a rigid axis in polynomial form."""

from collections.abc import Iterable
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start, begun
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import StructureError
from feeddrive.language.matrix import Row
from feeddrive.language.text import Text

# horizon per sample from a reading to the end of its force: the best at Ms = 2 on a rigid axis
_HORIZON = 7.5


class GeneralizedPredictive(Law):
    """Generalized predictive control: apply the first force of the sequence that minimizes the predicted error.

        A y(k) = q B u(k-1) + C ξ(k)/Δ,   Δ = 1 - q,   q = one sample of delay;   y'' m + y' b = u, held, d samples late
        C = (1 - e^(-omega_o T) q)²       the observer of the prediction
        min Σ (w(k+j) - y(k+j))², j = d + 2 .. horizon,  + move_weight Σ Δu(k+i)², i = 0 .. moves - 1
        S Δu(k) = -R y(k) + C Σ g_j w(k+j),   u(k) = applied(k-1) + Δu(k)

    With the divisions C = E_j A Δ + q^j F_j and E_j B = G_j C + q^j H_j, and g, the first row of
    (GᵀG + move_weight)⁻¹ Gᵀ (G_ji = step response of the axis after j - i samples), R = Σ g_j F_j and
    S = C + q Σ g_j H_j.  The set path is extrapolated by its derivatives up to snap: Σ g_j w(k+j) = Σ τ_i w⁽ⁱ⁾,
    τ_i = Σ g_j (jT)ⁱ/i!.  The last Δu is computed from the limited force, which prevents windup.

    Tune `horizon` and omega_o: a short horizon makes the loop fast, a slow observer makes it quiet.  One move without a
    weight is enough; three moves leave too little delay margin.
    When to use: an axis whose mass and dead time are known and whose set path is smooth.  Not suitable for single
    precision, since R, about 9e6 N/m, is a difference of numbers near 2e9 N/m; for a mode below three times the
    crossover; or with C = 1 (a very fast observer), which is neither robust nor quiet.
    Source: Clarke, Mohtadi & Tuffs 1987 (the law, with T for C); Boucher & Dumur 1996 (the three polynomials, on feed
    drives).
    """

    feeds = ("acceleration", "velocity")
    rejects = True
    tunables = ("omega_o",)
    title = "GPC"

    mass: Number = parameter("kg", "m: all that moves", above=0)
    viscous: Number = parameter("N s/m", "b: viscous friction of the guideway", least=0, default=0)
    omega_o: Number = parameter("rad/s", "both poles of the observer of the prediction", above=0)
    move_weight: Number = parameter(
        "m2/N2", "weight of a change of the force against that of an error", least=0, default=0
    )
    horizon: int = choice("last sample whose error counts", least=3, most=200)
    moves: int = choice("changes of the force that are planned", default=1, least=1, most=3)
    delay_samples: int = choice("samples of dead time until a command acts", default=0, least=0, most=64)
    encoder: str = choice("encoder whose reading is predicted", options=("load", "motor"), default="load")

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return two variants: with a short horizon, which is best for a rigid axis, and with one twice as long.

        Both variants start with a slow observer.
        """
        shorter = min(max(round(_HORIZON * (axis.delay_samples + 1)), 12), 100)
        return tuple(
            Start(
                f"{cls.title}, {what} horizon",
                begun(cls, axis, omega_o=4.0 * axis.rate, horizon=horizon, encoder=axis.velocity_encoder),
                Text(f"{horizon} samples ahead; {axis.sentence()}"),
            )
            for what, horizon in (("short", shorter), ("long", 2 * shorter))
        )

    class Prepared(NamedTuple):
        """The sample time, R and S (from q⁰ on; S begins with 1), the coefficients of C after its leading 1, and τ."""

        T: Number  # s
        R: Row  # N/m
        S: Row
        C: Row
        preview: Row  # N/m, N s/m, ..

    class State(NamedTuple):
        """The past readings (m), changes of the force (N) and previews Σ g_j w (N), newest first."""

        positions: tuple[Number, Number]
        changes: tuple[Number, ...]
        previews: tuple[Number, ...]

    def check(self) -> None:
        """Raise StructureError if the horizon beyond the dead time contains fewer weighted errors than moves."""
        least = self.delay_samples + 1 + self.moves
        if self.horizon < least:
            raise StructureError(
                f"{self.kind}.horizon = {self.horizon} must be at least {least}: the first error that counts comes "
                f"{self.delay_samples + 2} samples after its reading, and moves = {self.moves} needs as many errors"
            )

    def prepare(self, T: Number) -> Prepared:
        """Compute R, S and τ; the divisions for all j are done in one pass.

        F_j is the remainder of C after j steps; each step adds a term to E_j and G_j.
        """
        A, B = self._model(T)
        pole = ops.exp(-self.omega_o * T)
        C = (1.0, -2.0 * pole, pole * pole)
        left: Row = C
        quotients, rests = list[Any](), [left]
        for _ in range(self.horizon):
            quotients.append(left[0])
            left = (left[1] - left[0] * A[1], left[2] - left[0] * A[2], -left[0] * A[3])
            rests.append(left)
        steps = _series(B, A, self.horizon)
        first = self.delay_samples + 2
        counted = range(first, self.horizon + 1)
        g = self._first_row(steps, counted)
        R = tuple(matrix.dot(g, [rests[j][i] for j in counted]) for i in range(3))
        S: list[Any] = [*C, *((0.0,) * (len(B) - 3))]
        for i in range(1, len(S)):
            S[i] = S[i] + matrix.dot(g, [_rest(quotients, steps, B, C, j, i - 1) for j in counted])
        preview, weights = list[Any](), g
        # τ of position to snap, all that a setpoint holds
        for i in range(5):
            preview.append(matrix.dot(weights, (1.0,) * len(weights)))
            # (jT)ⁱ/i! from the previous power: laws have neither powers nor factorials
            weights = [weight * (T * (float(j) / (i + 1.0))) for j, weight in enumerate(weights, first)]
        return self.Prepared(T, R, tuple(S), C[1:], tuple(preview))

    def _model(self, T: Number) -> tuple[Row, Row]:
        """Return A Δ and B from the zero-order-hold discretization of the mass; B begins with one zero per sample of
        dead time.
        """
        change = matrix.expm1(((0.0, T, 0.0), (0.0, -self.viscous * T / self.mass, T / self.mass), (0.0, 0.0, 0.0)))
        x_of_v, x_of_u, kept, v_of_u = change[0][1], change[0][2], 1.0 + change[1][1], change[1][2]
        A = (1.0, -(2.0 + kept), 1.0 + 2.0 * kept, -kept)
        B = (*((0.0,) * self.delay_samples), x_of_u, x_of_v * v_of_u - kept * x_of_u)
        return A, B

    def _first_row(self, steps: list[Any], counted: Iterable[int]) -> list[Any]:
        """Return the weights g_j of the predicted errors in the first move, for the samples j in `counted`."""
        G = [[_at(steps, j - 1 - i, j) for i in range(self.moves)] for j in counted]
        columns = list(zip(*G, strict=True))
        normal = [[matrix.dot(a, b) for b in columns] for a in columns]
        for i in range(self.moves):
            normal[i][i] = normal[i][i] + self.move_weight
        ahead = matrix.solve(normal, [[1.0 if i == 0 else 0.0] for i in range(self.moves)])
        return [matrix.dot(row, [each[0] for each in ahead]) for row in G]

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state for motion at constant velocity and force.

        The actual and the set path both pass through the measured position.
        """
        here, speed = reading.position(self.encoder), reading.velocity
        before = here - prepared.T * speed
        previews = tuple(prepared.preview[0] * x + prepared.preview[1] * speed for x in (here, before))
        return self.State((here, before), (ops.zero(here),) * (len(prepared.S) - 1), previews)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """Solve S Δu = -R y + C Σ g_j w for Δu, and return the new state and the force."""
        here = reading.position(self.encoder)
        changes = (state.changes[0] + (reading.applied - reading.requested), *state.changes[1:])
        preview = matrix.dot(prepared.preview, setpoint)
        wanted = preview + matrix.dot(prepared.C, state.previews)
        found = matrix.dot(prepared.R, (here, *state.positions))
        # S begins with 1, so that nothing is divided
        change = wanted - found - matrix.dot(prepared.S[1:], changes)
        after = self.State((here, state.positions[0]), (change, *changes[:-1]), (preview, state.previews[0]))
        return after, reading.applied + change

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Convert the previews to the new weights, keeping position and velocity of the set path.

        Position and velocity are computed from the last two previews.
        """
        before, now = old_prepared.preview, prepared.preview
        ratio = now[0] / before[0]
        speed = (state.previews[0] - state.previews[1]) / (before[0] * prepared.T)
        more = (now[1] - ratio * before[1]) * speed
        return state._replace(previews=(ratio * state.previews[0] + more, ratio * state.previews[1] + more))


def _series(B: Row, A: Row, count: int) -> list[Any]:
    """Return the first coefficients of the series B/A, A[0] = 1; this is the step response if A has the factor Δ."""
    coefficients = list[Any]()
    for j in range(count):
        total: Any = B[j] if j < len(B) else 0.0
        for i in range(1, min(j, len(A) - 1) + 1):
            total = total - A[i] * coefficients[j - i]
        coefficients.append(total)
    return coefficients


def _at(row: list[Any], place: int, count: int) -> Any:
    """Return `row[place]` if `place` is in 0 .. count - 1, otherwise 0.0."""
    return row[place] if 0 <= place < count else 0.0


def _rest(quotients: list[Any], steps: list[Any], B: Row, C: Row, j: int, i: int) -> Any:
    """Return the coefficient of qⁱ of H_j = (E_j B - G_j C) / q^j, with E_j and G_j of degree j - 1."""
    made = matrix.dot(B[i + 1 :], [_at(quotients, j + i - n, j) for n in range(i + 1, len(B))])
    taken = matrix.dot(C[i + 1 :], [_at(steps, j + i - n, j) for n in range(i + 1, len(C))])
    return made - taken
