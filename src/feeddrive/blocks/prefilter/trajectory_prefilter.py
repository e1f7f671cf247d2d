"""A setpoint prefilter that cancels the remaining tracking error of a loop."""

from feeddrive.blocks.families import Law, Nothing, Prefilter
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, parameter


class TrajectoryPrefilter(Prefilter):
    """A prefilter that adds weighted higher derivatives, up to the snap, to the set motion.

        x_out = x + θ1 v + θ2 a + θ3 j + θ4 s
        v_out = v + θ1 a + θ2 j + θ3 s
        a_out = a + θ1 j + θ2 s
        j_out = j + θ1 s
        s_out = s

    No signal is differenced, since the snap of a snap-limited motion has steps, which would become impulses.
    A loop with the tracking error e = θ(s) x for a set motion x, θ(s) = θ1 s + θ2 s² + θ3 s³ + θ4 s⁴, has only the
    error θ(s)² x with this block.  `fit_prefilter` computes θ from one run.
    When to use: together with feedforward, on moves whose errors repeat.  Not suitable for a loop without feedforward,
    for which θ is not small, or for references without derivatives.
    Source: Gordon & Erkorkmaz 2013, section 2 (trajectory prefilter).
    """

    title = "prefilter"

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True for a law that models the spring between motor and table, as in Gordon & Erkorkmaz 2013."""
        return law.encoders == 2

    theta1: Number = parameter("s", "part of the velocity", default=0)
    theta2: Number = parameter("s2", "part of the acceleration", default=0)
    theta3: Number = parameter("s3", "part of the jerk", default=0)
    theta4: Number = parameter("s4", "part of the snap", default=0)

    def start(self, setpoint: Setpoint) -> Nothing:
        return Nothing()

    def step(self, state: Nothing, setpoint: Setpoint, T: Number) -> tuple[Nothing, Setpoint]:
        x, v, a, j, s = setpoint
        t1, t2, t3, t4 = self.theta1, self.theta2, self.theta3, self.theta4
        return state, Setpoint(
            x + (t1 * v + t2 * a + t3 * j + t4 * s),
            v + (t1 * a + t2 * j + t3 * s),
            a + (t1 * j + t2 * s),
            j + t1 * s,
            s,
        )
