"""Linear-quadratic-Gaussian control of a rigid axis."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.families import Law, Plant
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_bodies import TwoBodies, series, two_bodies, two_mass_model
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.matrix import Matrix, Row

# 2¹⁴ samples: exact to rounding where a motion decays by e in less than a thousand of them
DOUBLINGS = 14


def steady(transition: Matrix, measured: Matrix, added: Matrix) -> Matrix:
    """Solve the Riccati equation P = A (P⁻¹ + Y)⁻¹ Aᵀ + Q for the covariance P of a filter before its correction.

    For a filter A = Φ, Y = Cᵀ R⁻¹ C, and Q is the covariance of the process noise. With A = Φᵀ, Y = Γ R⁻¹ Γᵀ and Q the
    weight of the states, P is the cost matrix of a controller. The doubling algorithm covers 2ⁿ samples in n steps and
    starts from A, Y and P = Q:

        N = 1 + P Y,   P <- P + A N⁻¹ P Aᵀ,   Y <- Y + Aᵀ Y N⁻¹ A,   A <- A N⁻¹ A

    P and Y are symmetric, and only one half of each symmetric product is computed. Elimination in N needs no pivots:
    its eigenvalues are real and at least 1.

    Source: Anderson & Moore 1979, section 6.7.
    """
    a, y, p = transition, measured, added
    n = len(a)
    one = tuple(tuple(1.0 if i == j else 0.0 for j in range(n)) for i in range(n))
    for _ in range(DOUBLINGS):
        turned = _transposed(a)
        # N⁻¹ A and N⁻¹ P Aᵀ in one elimination
        both = matrix.solve(
            matrix.add(one, matrix.multiply(p, y)),
            [[*row, *other] for row, other in zip(a, matrix.multiply(p, turned), strict=True)],
        )
        u, v = tuple(row[:n] for row in both), tuple(row[n:] for row in both)
        p = matrix.add(p, _symmetric(a, v))
        y = matrix.add(y, _symmetric(turned, matrix.multiply(y, u)))
        a = matrix.multiply(a, u)
    return p


def outer(column: Row, factor: Any = 1.0) -> Matrix:
    """Return the matrix factor · c cᵀ of a column c."""
    scaled = [factor * x if not matrix.is_zero(x) else 0.0 for x in column]
    return tuple(tuple(0.0 if matrix.is_zero(x) or matrix.is_zero(y) else x * y for y in column) for x in scaled)


def _transposed(a: Matrix) -> Matrix:
    return tuple(zip(*a, strict=True))


def _symmetric(a: Sequence[Row], b: Sequence[Row]) -> Matrix:
    """Return the product A·B, which must be symmetric: only one half is computed."""
    columns = list(zip(*b, strict=True))
    n = len(a)
    upper = [[matrix.dot(a[i], columns[j]) if j >= i else 0.0 for j in range(n)] for i in range(n)]
    return tuple(tuple(upper[min(i, j)][max(i, j)] for j in range(n)) for i in range(n))


# offset_rate over the rate of the loop: slow enough to cost less than a tenth of the error
_GIVE = 0.03
# velocity noise of two masses over omega_o² T, so that the filter does not rely on the spring alone
_STRAY = 1e-3


class LQG(Law):
    """Linear-quadratic state feedback with a Kalman filter that estimates the disturbance as an additional state.

        predict   z⁻ = Φ z + Γ F(k-1-d),   z = (x, v, F̂),  F̂ a random walk           zero-order hold of `model`
        correct   z  = z⁻ + L (y - C z⁻)
        force     = F* - F̂ - K (x̂ - x*) - Σ Kᵢ (F(k-i) + F̂ - F*(k-i)),   i = 1 .. d = delay_samples
        K         minimizes Σ (m omega_c²)² e_load² + (F + F̂)²,   Kᵢ = K Φⁱ⁻¹ Γ and K <- K Φᵈ for the dead time
        L         minimizes the error variance, relative to the noise of the reading: the process noise is
                  m omega_o³ T per sample in F̂, recovery m omega_o² in the drive's force, and, with two masses,
                  0.001 omega_o² T in each velocity

    m is the total mass.  x* and F* are the set motion and its force: for one mass (x_r, v_r) and m a_r + b v_r in the
    middle of the sample; for two masses the motor leads the load by the deflection of the spring under that motion
    (`series` in blocks/plant/two_bodies.py) and under F̂, which acts on the load.  F(k-i) is `applied`, which prevents
    windup.  Without `recovery` the poles are a pair at omega_c with a damping ratio of 0.707 and those of a third-order
    Butterworth filter at omega_o.

    With two readings but one disturbance, a wrong spring stiffness, friction at the motor or misaligned encoders leave
    a steady-state error.  With `offset_rate` the motor's reading is shifted until the spring balances:

        y1 = reading - offset,   offset <- offset + offset_rate T (y1 - y2 - lead(set motion) - (F - F*)/k)

    Tune omega_c, omega_o and recovery as two frequencies and a ratio; more recovery makes the loop more robust and
    noisier.
    When to use: two encoders and an identified spring, where it halves the error of a P-PI cascade of the same Ms.
    Not suitable for an unknown spring, or without recovery for a lightly damped plant.  Optimality does not guarantee
    margins: check them for every plant that the law must control.
    Source: Kalman 1960; Åström & Wittenmark 1997 (sampled, delay as states); Doyle & Stein 1979 (recovery); the
    estimated offset is specific to this library.
    """

    feeds = ("acceleration", "velocity")
    rejects = True
    tunables = ("omega_c", "omega_o", "recovery")
    title = "LQG"

    model: Plant = part("the axis as the law believes it to be: one mass, or two with the spring between them")
    omega_c: Number = parameter("rad/s", "own frequency of the tracking error", above=0)
    omega_o: Number = parameter("rad/s", "own frequency of the filter", above=0)
    recovery: Number = parameter("", "noise of the drive's force in the filter's model", least=0, default=1.0)
    offset_rate: Number | None = parameter(
        "1/s",
        "rate at which the motor's encoder of two masses gives in to the model; absent: never",
        above=0,
        default=None,
    )
    delay_samples: int = choice("samples of dead time until a command acts", default=0, least=0, most=64)
    encoder: str = choice("encoder that one mass is read by", options=("load", "motor"), default="load")

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return one variant: with two masses and two encoders if the axis has them, otherwise with one mass."""
        model: Plant = Rigid(mass=axis.mass, viscous=axis.viscous)
        model_text = ""
        if axis.encoders > 1:
            try:
                model, model_text = two_mass_model(axis.plant), "two masses and two encoders, "
            except StructureError:
                model_text = "one mass, since its plant has no spring between two masses, "
        law = cls(
            model=model,
            omega_c=axis.rate,
            omega_o=4.0 * axis.rate,
            delay_samples=axis.delay_samples,
            encoder=axis.velocity_encoder,
            offset_rate=_GIVE * axis.rate if len(model.mechanics().mass) > 1 else None,
        )
        return (Start(cls.title, law, model_text + axis.sentence()),)

    class Prepared(NamedTuple):
        """Φ - 1, Γ of drive and load, L, K and Kᵢ in SI units."""

        change: Matrix  # of positions (m), then velocities (m/s)
        drive: Row  # per N
        load: Row
        gain: Matrix  # of positions, velocities and force, a column for each reading
        feedback: Row  # N/m, N s/m
        pending: Row

    class State(NamedTuple):
        """The estimated positions, velocities, disturbance; encoder offset; pending and planned forces (m, m/s, N)."""

        motion: tuple[Number, ...]
        disturbance: Number
        offset: Number
        pending: tuple[Number, ...]
        planned: tuple[Number, ...]

    def check(self) -> None:
        """Raise StructureError unless the model has one or two masses."""
        self._bodies()

    def positions(self) -> int:
        """Return the number of masses of the model."""
        return 1 if self._bodies() is None else 2

    def _bodies(self) -> TwoBodies | None:
        """Return the matrices of a two-mass model; None for one mass."""
        return None if len(self.model.mechanics().mass) == 1 else two_bodies(self.kind, self.model)

    def prepare(self, T: Number) -> Prepared:
        """Solve both Riccati equations in normalized units, so that the gains depend on ωT alone.

        The units are 1 m for lengths, 1/omega for times and m omega² for forces.
        """
        hold = self._hold(T)
        n = len(hold)
        feedback, pending = self._feedback(hold, T)
        change, drive, load = _split(_in_units(hold, T, T * T / self.model.rigid_mass()), n)
        return self.Prepared(change, drive, load, self._gain(hold, T), feedback, pending)

    def _hold(self, T: Number) -> Matrix:
        """Return [Φ - 1, Γ of the drive, Γ of the load], with T as unit of time and the total mass as unit of mass."""
        mechanics, total = self.model.mechanics(), self.model.rigid_mass()
        bodies = len(mechanics.mass)
        n = 2 * bodies
        right = [
            [
                *(_times(k, -T * T) for k in mechanics.stiffness[i]),
                *(_times(c, -T) for c in mechanics.damping[i]),
                *(total if i == place and bodies > 1 else 0.0 for place in (0, bodies - 1)),
            ]
            for i in range(bodies)
        ]
        moves = [tuple(1.0 if j == bodies + i else 0.0 for j in range(n + 2)) for i in range(bodies)]
        still = [(0.0,) * (n + 2)] * 2
        pulled = matrix.solve(mechanics.mass, right)
        # the mass divided by itself: a literal 1 costs no operation, a quotient does
        if bodies == 1:
            pulled = [(*pulled[0][:n], 1.0, 1.0)]
        # a force scaled by the total mass acts on the lighter mass: the norm is at least 2
        return matrix.expm1([*moves, *pulled, *still], at_least=2)[:n]

    def _feedback(self, hold: Matrix, T: Number) -> tuple[Row, Row]:
        """Return K for positions and velocities (N/m, N s/m), and the gains of the commands that have not acted yet."""
        n = len(hold)
        w = self.omega_c * T
        change, drive, _ = _split(_in_units(hold, w, w * w), n)
        transition = matrix.add(change, _one(n))
        at_load = tuple(1.0 if i == n // 2 - 1 else 0.0 for i in range(n))
        cost = steady(tuple(zip(*transition, strict=True)), outer(drive), outer(at_load))
        pulled = matrix.multiply([drive], cost)
        # the force has the weight 1 in these units
        share = 1.0 + matrix.dot(pulled[0], drive)
        row: Row = tuple(x / share for x in matrix.multiply(pulled, transition)[0])
        pending = list[Any]()
        for _ in range(self.delay_samples):
            pending.append(matrix.dot(row, drive))
            row = matrix.multiply([row], transition)[0]
        slow = self.model.rigid_mass() * self.omega_c
        return tuple(x * (slow * self.omega_c if i < n // 2 else slow) for i, x in enumerate(row)), tuple(pending)

    def _gain(self, hold: Matrix, T: Number) -> Matrix:
        """Return L: one row for each position (1), velocity (1/s) and the force (N/m), one column for each reading."""
        n, w = len(hold), self.omega_o * T
        bodies = n // 2
        change, drive, load = _split(_in_units(hold, w, w * w), n)
        transition = (*((*row, x) for row, x in zip(matrix.add(change, _one(n)), load, strict=True)), (*_NONE[:n], 1.0))
        stray = (_STRAY * w) * (_STRAY * w)
        walks = (*_NONE[:bodies], *((stray if bodies > 1 else 0.0,) * bodies), w * w)
        added = matrix.add(_diagonal(walks), outer((*drive, 0.0), self.recovery * self.recovery))
        variance = steady(transition, _diagonal((*((1.0,) * bodies), *_NONE[: bodies + 1])), added)
        read = matrix.add([row[:bodies] for row in variance[:bodies]], _one(bodies))
        gains = zip(*matrix.solve(read, variance[:bodies]), strict=True)
        pull = self.model.rigid_mass() * self.omega_o * self.omega_o
        units = (*((1.0,) * bodies), *((self.omega_o,) * bodies), pull)
        return tuple(matrix.scale(unit, [row])[0] for unit, row in zip(units, gains, strict=True))

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state of steady motion, with a disturbance that balances the acting force across the spring."""
        bodies = self._bodies()
        speed, steady_force = reading.velocity, self._dragged() * reading.velocity
        disturbance = steady_force - reading.applied
        late = self.delay_samples
        offset, positions = ops.zero(reading.position_load), (reading.position(self.encoder),)
        if bodies is not None:
            positions = (reading.position_load + _stretch(bodies, speed, disturbance), reading.position_load)
            offset = reading.position_motor - positions[0]
        motion = (*positions, *((speed,) * len(positions)))
        return self.State(motion, disturbance, offset, (reading.applied,) * late, (steady_force,) * (late + 1))

    def _dragged(self) -> Number:
        """Return the total viscous coefficient of the model, N s/m."""
        damping = self.model.mechanics().damping
        ones = (1.0,) * len(damping)
        return matrix.dot([matrix.dot(row, ones) for row in damping], ones)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """Predict, correct and compute the force."""
        bodies = self._bodies()
        commands = (reading.applied, *state.pending)
        moved = [
            x + (matrix.dot(row, state.motion) + drive * commands[self.delay_samples] + load * state.disturbance)
            for x, row, drive, load in zip(state.motion, prepared.change, prepared.drive, prepared.load, strict=True)
        ]
        readings = (reading.position(self.encoder),)
        if bodies is not None:
            readings = (reading.position_motor - state.offset, reading.position_load)
        # not strict: the positions are the first entries of the state, the velocities follow
        missed = [y - x for y, x in zip(readings, moved, strict=False)]
        *motion, disturbance = (
            x + matrix.dot(row, missed) for x, row in zip((*moved, state.disturbance), prepared.gain, strict=True)
        )
        targets, planned = self._targets(bodies, setpoint, disturbance, T)
        away = [x - target for x, target in zip(motion, targets, strict=True)]
        force = planned - disturbance - matrix.dot(prepared.feedback, away)
        for gain, command, plan in zip(prepared.pending, commands, state.planned, strict=False):
            force = force - gain * (command + disturbance - plan)
        late, offset = self.delay_samples, state.offset
        if bodies is not None and self.offset_rate is not None:
            pulled = (commands[late] - state.planned[late]) / bodies.k
            stretch = reading.position_motor - state.offset - reading.position_load
            lead = series(bodies, setpoint).position
            offset = offset + self.offset_rate * T * (stretch - lead - pulled)
        plans = (planned, *state.planned)[: late + 1]
        return self.State(tuple(motion), disturbance, offset, commands[:late], plans), force

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Convert the state so that the force is continuous.

        A change of the friction parameter is not mistaken for a disturbance, and the deflection of the spring follows
        its new stiffness.
        """
        speed = state.motion[-1]
        more = (self._dragged() - old._dragged()) * speed
        after = state._replace(
            disturbance=state.disturbance + more, planned=tuple(plan + more for plan in state.planned)
        )
        bodies, before = self._bodies(), old._bodies()
        if bodies is None or before is None:
            return after
        longer = _stretch(bodies, speed, after.disturbance) - _stretch(before, speed, state.disturbance)
        return after._replace(motion=(state.motion[0] + longer, *state.motion[1:]), offset=state.offset - longer)

    def _targets(
        self, bodies: TwoBodies | None, setpoint: Setpoint, disturbance: Number, T: Number
    ) -> tuple[tuple[Number, ...], Number]:
        """Return x* and F*: the set motion of each mass, and its force."""
        middle = setpoint.shifted(0.5 * T)
        if bodies is None:
            force = self.model.rigid_mass() * middle.acceleration + self._dragged() * middle.velocity
            return (setpoint.position, setpoint.velocity), force
        now, ahead = series(bodies, setpoint), series(bodies, middle)
        motor = setpoint.position + now.position - disturbance / bodies.k
        targets = (motor, setpoint.position, setpoint.velocity + now.velocity, setpoint.velocity)
        force = (
            (bodies.m11 + bodies.m12) * (middle.acceleration + ahead.acceleration)
            + (bodies.c11 + bodies.c12) * (middle.velocity + ahead.velocity)
            + bodies.led * middle.acceleration
            + bodies.dragged * middle.velocity
        )
        return targets, force


_NONE = (0.0,) * 8


def _stretch(bodies: TwoBodies, speed: Number, disturbance: Number) -> Number:
    """Return the lead of the motor over the load in m, in steady motion with the force `disturbance` on the load."""
    return (bodies.dragged * speed - disturbance) / bodies.k


def _one(n: int) -> Matrix:
    return _diagonal((1.0,) * n)


def _diagonal(values: Row) -> Matrix:
    return tuple(tuple(value if i == j else 0.0 for j in range(len(values))) for i, value in enumerate(values))


def _times(x: Any, factor: Any) -> Any:
    return x if matrix.is_zero(x) or matrix.is_one(factor) else factor * x


def _in_units(hold: Matrix, velocity: Number, force: Number) -> Matrix:
    """Return [Φ - 1, Γ, Γ] after multiplying the units of velocity and force by these factors."""
    n = len(hold)
    still = n // 2
    over: Row = (1.0,) * still + (velocity,) * still + (force,) * 2
    moving: Row = (1.0 / velocity,) * still + (1.0,) * still + (force / velocity,) * 2
    return tuple(
        tuple(_times(x, column) for x, column in zip(row, over if i < still else moving, strict=True))
        for i, row in enumerate(hold)
    )


def _split(hold: Matrix, n: int) -> tuple[Matrix, Row, Row]:
    """Split [Φ - 1, Γ, Γ] into Φ - 1 and both Γ."""
    return tuple(row[:n] for row in hold), tuple(row[n] for row in hold), tuple(row[n + 1] for row in hold)
