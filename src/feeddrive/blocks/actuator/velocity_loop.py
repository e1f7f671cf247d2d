"""The velocity loop of a drive that is commanded by velocities."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, Rule, parameter
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class VelocityLoop(Block):
    """A PI velocity loop in the drive, which turns a commanded velocity into a force on the motor's body.

        e  = w - v_motor                                      w: the commanded velocity, after the dead time
        u  = clip(Kp e + I, ±most_force)
        I' = (Kp/Tn) e                                        held while u is at its limit and e drives it further
        f' = (u - f)/lag                                      f acts on the motor's body

    It belongs to the physics: it is identified, and neither tuned nor exported.  It runs once a substep, with the
    velocity at the beginning of it, and its lag is exact for a constant u: `substeps` of the axis is its sample rate.
    A real one is sampled, too, smooths its velocity and has a current loop; `lag` stands for all delays within it.

    An axis with one takes its command in m/s, and so a law that commands a velocity (`position_loop`).
    """

    Kp: Number = parameter("N s/m", "velocity gain of the drive", above=0)
    Tn: Number | None = parameter(
        "s", "integral time of the drive's velocity loop; absent for none", above=0, default=None
    )
    lag: Number | None = parameter(
        "s",
        "time constant of the force: current loop, smoothed velocity, sampling; absent for none",
        above=0,
        default=None,
    )
    most_force: Number | None = parameter("N", "largest force of the drive; absent for no limit", above=0, default=None)
    held_force: Number = parameter("N", "with which it begins: what holds a hanging axis", default=0)

    class State(NamedTuple):
        """The integral and the force that acts, N."""

        integral: Number
        force: Number

    def start(self, zero: Number) -> State:
        """Return the state of an axis at rest; `zero` is a zero of the kind of its numbers."""
        return self.State(zero + self.held_force, zero + self.held_force)

    def step(self, state: State, command: Number, velocity: Number, h: Number) -> tuple[State, Number]:
        """Compute a substep of h seconds: the new state, and the mean force (N) on the motor's body.

        command   mean commanded velocity of the substep, m/s
        velocity  of the motor's body at its beginning, m/s
        """
        error = command - velocity
        wanted = self.Kp * error + state.integral
        made = wanted if self.most_force is None else ops.clip(wanted, -self.most_force, self.most_force)
        integral = state.integral
        if self.Tn is not None:
            moved = integral + (self.Kp * h / self.Tn) * error
            integral = ops.where((wanted - made) * error <= 0.0, moved, integral)
        if self.lag is None:
            return self.State(integral, made), made
        left = ops.exp(-h / self.lag)
        after = made + left * (state.force - made)
        mean = made + (self.lag / h) * (1.0 - left) * (state.force - made)
        return self.State(integral, after), mean

    def equivalent(self, force: Any, sample_time: float) -> Any:
        """Return the velocities (m/s) that act as forces added to those of the loop do, N; both of shape (n,).

            force = Kp w + (Kp/Tn) Σ T w     so that   w(k) = (force(k) - I(k))/Kp,   I(k+1) = I(k) + (Kp T/Tn) w(k)

        It is exact while the loop is not at its limit: the loop makes the same u of either.
        """
        found, held = force.astype(float), 0.0
        share = 0.0 if self.Tn is None else float(sample_time / self.Tn)
        for k, added in enumerate(force.tolist()):
            found[k] = (added - held) / float(self.Kp)
            held += share * float(self.Kp) * float(found[k])
        return found

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the condition that the integral is slower than a sample."""
        if self.Tn is not None:
            Tn = self.Tn
            yield Rule(
                Tn >= T,
                "the integral time of the drive's velocity loop is at least a sample",
                lambda: Text(
                    f"axis.actuator.velocity_loop.Tn = {Quantity(Tn, 's'):6 SI} is less than the sample time of "
                    f"{Quantity(T, 's'):6 SI}: raise it, or shorten the sample time"
                ),
            )
