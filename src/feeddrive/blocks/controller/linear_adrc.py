"""Linear active disturbance rejection with two bandwidths, those of the controller and of a third-order observer."""

from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start, begun
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, choice, parameter


class LinearADRC(Law):
    """Linear ADRC of a rigid axis m x'' = F + F_d; F_d, the sum of all other forces, is estimated and canceled.

        predict   f = (F(k-1-d) + F̂d)/m,   x⁻ = x̂ + T v̂ + ½T² f,   v⁻ = v̂ + T f,   d = delay_samples
        correct   e = y(k) - x⁻,   (x̂, v̂, F̂d) = (x⁻, v⁻, F̂d) + l e,   β = e^(-omega_o T)
                  l = [1 - β³, 3 (1 - β)² (1 + β)/(2T), m (1 - β)³/T²]
        force     m (a_set(t + T/2) + 2 zeta_c omega_c (v_set - v̂) + omega_c² (x_set - x̂)) - F̂d

    All poles of the observer's error lie at β.  F is the `applied` force, which prevents windup.  x̂ - y is stored
    instead of x̂, so that no precision is lost far from zero.  With `position` = "load" the load's reading replaces x̂
    in x_set - x̂; use this if an axis has two encoders and the observer reads the motor's.

    When to use: slow friction and gravity for which there is no model, one encoder, a stiff axis.  Not suitable with
    the observer on a load encoder behind a spring, where it performs six times worse than P-PI.  With omega_c fixed a
    faster observer improves margins and stiffness, but force noise grows with omega_o².  Disturbances near omega_o are
    amplified by 1.3.
    The law equals `ActiveDisturbanceRejection` with `GpiObserver(taylor_states=1, zeta_o=1)`, with two exceptions: the
    observer here needs no reading between samples, and the feedback uses x̂ in place of the reading.
    Source: Gao 2003 (bandwidths) and Miklosovic, Radke & Gao 2006 (the current form of the observer).
    """

    feeds = ("acceleration", "velocity")
    rejects = True
    tunables = ("omega_c", "omega_o")
    title = "LADRC"

    mass: Number = parameter("kg", "m in the model of the law and of its observer; 1/b0", above=0)
    omega_c: Number = parameter("rad/s", "bandwidth of the control", above=0)
    omega_o: Number = parameter("rad/s", "bandwidth of the observer; 4 to 10 times omega_c", above=0)
    zeta_c: Number = parameter("", "damping ratio of the tracking error", above=0, default=1.0)
    delay_samples: int = choice("samples of dead time until a command acts", default=0, least=0, most=64)
    encoder: str = choice("encoder of the observer", options=("load", "motor"), default="load")
    position: str = choice("position that is controlled", options=("estimate", "load"), default="estimate")

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return one variant: its observer uses the velocity encoder and is four times as fast as the controller."""
        encoder = axis.velocity_encoder
        position = "load" if axis.encoders == 2 and encoder == "motor" else "estimate"
        law = begun(cls, axis, omega_c=0.5 * axis.rate, omega_o=2.0 * axis.rate, encoder=encoder, position=position)
        return (Start(cls.title, law, axis.sentence()),)

    class Prepared(NamedTuple):
        """The gains l (dimensionless, in 1/s and in N/m) and β³."""

        gain: tuple[Number, Number, Number]
        kept: Number

    class State(NamedTuple):
        """x̂ - y (m), v̂ (m/s), F̂d (N), the last reading (m), and pending commands (N, newest first)."""

        behind: Number
        velocity: Number
        disturbance: Number
        reading: Number
        pending: tuple[Number, ...]

    def position_gain(self) -> Number:
        """Return the position gain omega_c/(2 zeta_c), 1/s."""
        return self.omega_c / (2.0 * self.zeta_c)

    def prepare(self, T: Number) -> Prepared:
        """Compute the observer's gains."""
        turn = self.omega_o * T
        # expm1: 1 - β and 1 - β³ as differences would lose the digits of a slow observer
        kept, faded = ops.exp(-turn), -ops.expm1(-turn)
        square = faded * faded
        gain = (-ops.expm1(-3.0 * turn), 1.5 * square * (1.0 + kept) / T, self.mass * square * faded / (T * T))
        return self.Prepared(gain, kept * kept * kept)

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state of steady motion through the measured position; the disturbance balances the force."""
        y, force = reading.position(self.encoder), reading.applied
        return self.State(ops.zero(y), reading.velocity, -force, y, (force,) * self.delay_samples)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """Evaluate the equations in the class docstring, with x⁻ relative to the last reading."""
        y = reading.position(self.encoder)
        commands: tuple[Any, ...] = (reading.applied, *state.pending)
        gained = T * ((commands[-1] + state.disturbance) / self.mass)
        missed = (y - state.reading) - (state.behind + T * (state.velocity + 0.5 * gained))
        behind = -(prepared.kept * missed)
        velocity = state.velocity + gained + prepared.gain[1] * missed
        disturbance = state.disturbance + prepared.gain[2] * missed
        nearer = setpoint.position - reading.position_load
        if self.position == "estimate":
            # the difference of the two large positions first: it is exact where they are close
            nearer = (setpoint.position - y) - behind
        damped = 2.0 * self.zeta_c * self.omega_c * (setpoint.velocity - velocity)
        wanted = setpoint.shifted(0.5 * T).acceleration + damped + self.omega_c * self.omega_c * nearer
        after = self.State(behind, velocity, disturbance, y, commands[: self.delay_samples])
        return after, self.mass * wanted - disturbance

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Return the state unchanged: it holds a distance, a velocity and forces."""
        return state
