"""The physics of one axis: linear mechanics, friction, other forces, actuator with dead time, and encoders."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Force, Friction, Mechanics, Nothing, Plant, Sensor
from feeddrive.blocks.signals import Motion, Noise
from feeddrive.language import matrix, ops
from feeddrive.language.block import Block, Number, Rule, choice, declarations, part
from feeddrive.language.errors import StructureError
from feeddrive.language.matrix import Matrix, Row
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.text import Text
from feeddrive.loop.hold import Hold, Port, Rows, Timing, hold, samples_of

# noise channels of the encoders; each can carry several kinds of noise
CHANNEL_MOTOR, CHANNEL_LOAD = 0.0, 16.0


class Axis(Block):
    """One axis, from the command of its drive, a force or a velocity, to the encoder readings.

    Over each substep h = T/substeps, the linear mechanics are integrated exactly for constant forces.  Forces that
    depend on the motion are evaluated at the predicted midpoint, x + v h/2.  The friction force is consistent with the
    velocity at the end of the substep.  The order of accuracy in h is 2 without friction and 1 with it.
    """

    plant: Plant = part("the linear mechanics")
    actuator: Actuator = part("dead time, current loop and motor", default=Actuator())
    friction_motor: Friction | None = part("friction of bearings and nut, on the motor's body", default=None)
    friction_load: Friction | None = part("friction of the guideway, on the load's body", default=None)
    forces: tuple[Force, ...] = part("forces that depend on motion, drive force or time", default=())
    encoder_motor: Sensor | None = part("encoder on the motor's body", default=None)
    encoder_load: Sensor | None = part("encoder on the load's body", default=None)
    substeps: int = choice("substeps of the exact hold in a sample", default=1, least=1, most=256)
    rotary: bool = choice("the axis turns: positions in rad, forces in N m, masses in kg m2", default=False)

    class State(NamedTuple):
        """Positions (m) and velocities (m/s) of the coordinates, drive force (N) if the drive has a lag, and states of
        friction, forces, encoders and the drive's velocity loop.
        """

        position: tuple[Number, ...]
        velocity: tuple[Number, ...]
        drive: tuple[Number, ...]
        pending: tuple[Number, ...]  # commands still on their way, newest first, N or m/s
        friction_motor: Any
        friction_load: Any
        encoder_motor: Any
        encoder_load: Any
        forces: tuple[Any, ...]
        velocity_loop: Any = Nothing()

    class Step(NamedTuple):
        """The friction and drive forces (N) over the last substep of a sample, to be recorded with the run."""

        friction_motor: Number
        friction_load: Number
        drive: Number

    def check(self) -> None:
        """Check that a rotary axis has no screw, that a one-body plant has only one friction model, and that the plant
        supports all forces.
        """
        of_screw = "lead" in declarations(type(self.plant)) or (
            self.actuator.motor is not None and "lead" in declarations(type(self.actuator.motor))
        )
        if self.rotary and of_screw:
            raise StructureError(
                "axis.rotary: a screw moves along its lead: leave out rotary, or take a plant and a motor without one"
            )
        shape = self.plant.mechanics()
        if shape.motor == shape.load and self.friction_motor is not None:
            raise StructureError(
                f"axis.friction_motor: the plant '{self.plant.kind}' has one body; give its friction as friction_load"
            )
        for i, force in enumerate(self.forces):
            force.fits(self.plant, self.forces[:i] + self.forces[i + 1 :])

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the conditions on the substep length under which the exact discretization and the forces are valid."""
        h = T / self.substeps
        # at the substep: more substeps allow faster modes
        yield from slow_enough(self.mechanics(), self.actuator.current_loop, h)
        for force in self.forces:
            yield from force.substep_rules(h)

    def timing(self, T: float) -> Timing:
        """Return the dead time as a number of whole samples, and whether a fraction of a sample remains. Raises
        StructureError if the variants of a batch differ in the number of whole samples, or if it exceeds 1000.
        """
        samples = samples_of(self.actuator.dead_time, T)
        whole = ops.floor(samples)
        least, most = -ops.most(-whole, 0.0), ops.most(whole, 0.0)
        if least != most:
            raise StructureError(
                "axis.actuator.dead_time: variants of one batch need the same number of whole samples, not "
                f"{span(least, most, '', '6')} at a sample time of {Quantity(T, 's'):6 SI}: run them as "
                "separate batches"
            )
        # each whole sample is one more number of the state, in every trace and export
        if most > 1000:
            raise StructureError(
                f"axis.actuator.dead_time is {Quantity(most):6} samples of {Quantity(T, 's'):6 SI}; the longest that "
                "is simulated is 1000 samples"
            )
        return Timing(int(most), ops.most(samples - whole, 0.0) > 0.0)

    def mechanics(self) -> Mechanics:
        """Return the mechanics of the plant, with the viscous part of the friction in the damping matrix."""
        plain = self.plant.mechanics()
        damping: Any = plain.damping
        for friction, body in ((self.friction_motor, plain.motor), (self.friction_load, plain.load)):
            if friction is not None:
                damping = matrix.add(damping, self.viscous(friction, plain.shape[body]))
        return plain._replace(damping=damping)

    def viscous(self, friction: Friction, row: Row) -> Matrix:
        """Return the damping matrix (N s/m) due to the viscous part of a friction model; the body is at x = row · q."""
        return matrix.multiply([[x] for x in matrix.scale(friction.linear(), (row,))[0]], (row,))

    def prepare(self, T: Number, timing: Timing) -> Hold:
        """Compute the exact discretization of the linear mechanics with lag and dead time of the drive."""
        mechanics = self.mechanics()
        shape = mechanics.shape
        rows = Rows(shape[mechanics.drive], shape[mechanics.motor], shape[mechanics.load])
        joint = hold(mechanics, (self.port(rows, timing),), T, self.substeps)
        return Hold(joint.change, *joint.axes[0])

    def port(self, rows: Rows, timing: Timing) -> Port:
        """Return the shape-matrix rows through which the forces of the axis act on the mechanics, together with the lag
        and dead time of its drive.
        """
        bandwidth = self.actuator.current_loop
        lag = None if bandwidth is None else 2.0 * ops.pi * bandwidth
        return Port(rows, lag, self.actuator.dead_time, timing)

    def start(self, position: Number, velocity: Number, timing: Timing) -> State:
        """Return the state of an axis that moves as a rigid body at `velocity` (m/s), with the load at `position` (m),
        relaxed springs and no drive force.
        """
        along, loop = self.plant.mechanics().rigid_motion(), self.actuator.velocity_loop
        rigid = Motion(position, position, velocity, velocity)
        return self.State(
            position=tuple(_part(share, position) for share in along),
            velocity=tuple(_part(share, velocity) for share in along),
            drive=() if self.actuator.current_loop is None else (ops.zero(position),),
            pending=(ops.zero(position),) * timing.memory(),
            friction_motor=Nothing() if self.friction_motor is None else self.friction_motor.start(velocity),
            friction_load=Nothing() if self.friction_load is None else self.friction_load.start(velocity),
            encoder_motor=Nothing() if self.encoder_motor is None else self.encoder_motor.start(position),
            encoder_load=Nothing() if self.encoder_load is None else self.encoder_load.start(position),
            forces=tuple(force.start(self.plant, rigid) for force in self.forces),
            velocity_loop=Nothing() if loop is None else loop.start(ops.zero(position)),
        )

    def motion(self, state: State) -> Motion:
        """Return the true position and velocity of the motor body and the load body."""
        mechanics = self.plant.mechanics()
        motor, load = mechanics.shape[mechanics.motor], mechanics.shape[mechanics.load]
        return Motion(
            position_motor=matrix.dot(motor, state.position),
            position_load=matrix.dot(load, state.position),
            velocity_motor=matrix.dot(motor, state.velocity),
            velocity_load=matrix.dot(load, state.velocity),
        )

    def read(self, state: State, motion: Motion, noise: Noise, T: Number) -> tuple[State, Number, Number]:
        """Return the new state and the readings of the motor and load encoders at t = kT; a single encoder gives both
        readings.
        """
        state_motor, motor = state.encoder_motor, motion.position_motor
        state_load, load = state.encoder_load, motion.position_load
        if self.encoder_motor is not None:
            state_motor, motor = self.encoder_motor.step(
                state_motor, motor, motion.velocity_motor, noise.on(CHANNEL_MOTOR), T
            )
        if self.encoder_load is not None:
            state_load, load = self.encoder_load.step(state_load, load, motion.velocity_load, noise.on(CHANNEL_LOAD), T)
        return state._replace(encoder_motor=state_motor, encoder_load=state_load), *self._readings(motor, load)

    def still(self, position: Number) -> tuple[Number, Number]:
        """Return the noise-free readings of the motor and load encoders for an axis at rest at `position`."""
        motor = position if self.encoder_motor is None else self.encoder_motor.still(position)
        load = position if self.encoder_load is None else self.encoder_load.still(position)
        return self._readings(motor, load)

    def encoders(self) -> int:
        """Return the number of distinct positions that the controller reads: 1 if there is one body or one encoder,
        otherwise 2.
        """
        shape = self.plant.mechanics()
        return 1 if self.one_encoder() or shape.motor == shape.load else 2

    def one_encoder(self) -> bool:
        """True if a single encoder gives both readings, so both contain the same noise."""
        return (self.encoder_motor is None) != (self.encoder_load is None)

    def _readings(self, motor: Number, load: Number) -> tuple[Number, Number]:
        """Return the readings of the motor and the load; if there is only one encoder, it gives both."""
        if self.encoder_motor is None and self.encoder_load is not None:
            return load, load
        if self.encoder_load is None and self.encoder_motor is not None:
            return motor, motor
        return motor, load


def require_force(axis: Axis, what: str) -> None:
    """Raise StructureError for a drive that is commanded by velocities, for what knows only forces."""
    if axis.actuator.commanded != "force":
        raise StructureError(
            f"axis.actuator.velocity_loop: {what} is for axes that take a force, and the drive of this one is "
            "commanded by velocities"
        )


def _part(share: Any, x: Any) -> Any:
    """Return share · x; if `share` is the constant 0, the result is a zero of the type of x."""
    return ops.zero(x) if matrix.is_zero(share) else x if matrix.is_one(share) else share * x


# Beyond these a substep's exponential loses the digits that are promised: rad a mode turns, and how often a decay by e
# passes.  A lag that decays by e^-100 in a substep is an ideal one.
MOST_TURN, MOST_DECAY = 1000.0, 100.0


def slow_enough(
    mechanics: Mechanics, current_loop: Number | None, h: Number, what: str = "axis.plant"
) -> Iterator[Rule]:
    """Yield the conditions under which the current loop, the damping and the modes are slow enough for a substep h (s).
    `current_loop` is its bandwidth in Hz; `what` names the plant in messages.
    """
    whose = "the axis" if what == "axis.plant" else what
    if current_loop is not None:
        yield Rule(
            2.0 * math.pi * current_loop * h <= MOST_DECAY,
            "the actuator's current_loop is slow enough for a substep",
            lambda: Text(
                f"axis.actuator.current_loop = {Quantity(current_loop, 'Hz'):6} is over within a substep of "
                f"{Quantity(h, 's'):6 SI}: leave it out for an ideal current loop, or keep it below "
                f"{Quantity(MOST_DECAY / (2.0 * math.pi * h), 'Hz'):6}"
            ),
        )
    # ω² are the eigenvalues of M⁻¹ K: a scaled spectral radius below 1 can be tested in a trace, too
    squares = matrix.solve(mechanics.mass, mechanics.stiffness)
    turn = h / MOST_TURN
    yield Rule(
        matrix.decays(matrix.scale(turn * turn, squares)),
        f"the fastest mode of {whose} is slow enough for a substep: masses are not too small, nor springs too stiff",
        lambda: _too_fast_a_mode(math.sqrt(matrix.growth(squares)), h, what),
    )
    decays = matrix.solve(mechanics.mass, mechanics.damping)
    yield Rule(
        matrix.decays(matrix.scale(turn, decays)),
        f"the fastest motion of {whose} dies out slowly enough for a substep: masses are not too small, nor damping "
        "too large",
        lambda: Text(
            f"{what}: its fastest motion dies out in {Quantity(1.0 / matrix.growth(decays), 's'):SI}, more than "
            f"{Quantity(MOST_TURN):6} times within a substep of {Quantity(h, 's'):6 SI}: check masses and damping, or "
            "raise substeps"
        ),
    )


def _too_fast_a_mode(mode: float, h: float, what: str) -> str:
    return Text(
        f"{what}: its fastest mode, {Quantity(mode / (2.0 * math.pi), 'Hz')}, turns {Quantity(mode * h, 'rad')} in a "
        f"substep of {Quantity(h, 's'):6 SI}, more than {Quantity(MOST_TURN):6}: check masses and stiffnesses, or "
        "raise substeps"
    )
