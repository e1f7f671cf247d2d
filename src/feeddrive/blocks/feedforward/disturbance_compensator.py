"""Feedforward of inertia and friction, linear in its parameters, for tuning by iterative learning."""

from collections.abc import Sequence
from typing import Any, Self

from feeddrive.blocks.axis_model import AxisModel, begun
from feeddrive.blocks.families import Feedforward, Law
from feeddrive.blocks.friction.curve import check_pair
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter
from feeddrive.language.errors import StructureError

# m/s, e^8.006... = 3000: from creeping to a fast feed, as many points in each decade
_SPEEDS = tuple(1e-4 * ops.exp(8.006367567650246 * i / 59.0) for i in range(60))
# above the rounding of steady(v) - viscous v, and far below the friction of any axis
_NO_FRICTION = 1e-9  # N


class DisturbanceCompensator(Feedforward):
    """The force that a set motion requires, as a weighted sum of regressors evaluated in the middle of the sample.

        force = φᵀ θ,   all of the setpoint at t + T/2, since the force acts over [kT, (k+1)T]
        θ = [mass, viscous, coulomb_positive, coulomb_negative, stribeck, jerk_feedforward, snap_feedforward]
        φ = [a, v, 1(v > 0), -1(v < 0), sgn(v) e^-(v / stribeck_velocity)², j, s]

    `coulomb_negative` is positive if friction opposes the motion towards smaller positions.  Within the dead band the
    axis counts as at rest, and the three friction regressors are 0.  An omitted parameter has no regressor.  Only the
    parameters that are present, even those with the value 0, are fed forward and are tuned by `iterate`.  In units of
    the drive's command, the parameters are divided by the force constant k: a = mass / k in A s²/m, b = viscous / k.

    When to use: together with `iterate` and any law that does not feed the same parts of the motion forward.  Not
    suitable for friction that drifts from part to part, or for an axis that creeps and sticks, where the set velocity
    is not that of the axis.
    Source: Wu, Han, Xiong & Ding 2017, eq. (1) to (7) and the regressors of the disturbance compensator.
    """

    feeds = ("acceleration", "velocity", "friction")
    title = "compensator"
    learned = "learned compensator"

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True for a law designed for one rigid mass that feeds nothing forward itself."""
        return not law.feeds and law.encoders == 1

    @classmethod
    def begin(cls, axis: AxisModel) -> Self:
        """Return starting values: the axis's mass and viscous friction, and dry friction fitted to its friction curve.

        The least-squares fit uses speeds from 0.1 mm/s to 0.3 m/s, evenly spaced on a logarithmic scale and equal in
        both directions; of the Stribeck velocities tried, the one with the smallest residual is used. Raises
        StructureError for a curve without dry friction.
        """
        forces = [tuple(sign * axis.dry_friction(sign * speed) for speed in _SPEEDS) for sign in (1.0, -1.0)]
        if max(abs(force) for row in forces for force in row) < _NO_FRICTION:
            raise StructureError("the axis has no dry friction to be fed forward: leave the compensator out")
        levels = [sum(row) / len(row) for row in forces]
        best, fitted = _left(forces, levels, (0.0,) * len(_SPEEDS), 0.0), (levels, None, None)
        # levels that fit within 0.1 % (RMS) need no Stribeck column
        enough = 1e-6 * max(level * level for level in levels) * len(_SPEEDS)
        for place in _SPEEDS if best > enough else ():
            extra = tuple(ops.exp(-(speed / place) * (speed / place)) for speed in _SPEEDS)
            mean = sum(extra) / len(extra)
            # centered, so that the share and the two levels are fitted independently of each other
            moved = [e - mean for e in extra]
            across = sum(m * force for row in forces for m, force in zip(moved, row, strict=True))
            share = across / (2.0 * sum(m * m for m in moved))
            under = [level - share * mean for level in levels]
            left = _left(forces, under, extra, share)
            # a level below 0 would push the axis
            if left < best and min(under) >= 0.0:
                best, fitted = left, (under, share, place)
        (up, down), share, place = fitted
        return begun(
            cls,
            axis,
            coulomb_positive=ops.maximum(up, 0.0),
            coulomb_negative=ops.maximum(down, 0.0),
            stribeck=share,
            stribeck_velocity=place,
        )

    mass: Number | None = parameter("kg", "mass that is fed forward; absent for none", least=0, default=None)
    viscous: Number | None = parameter(
        "N s/m", "viscous friction that is fed forward; absent for none", least=0, default=None
    )
    coulomb_positive: Number | None = parameter("N", "level at speed for v > 0; absent for none", least=0, default=None)
    coulomb_negative: Number | None = parameter("N", "level at speed for v < 0; absent for none", least=0, default=None)
    stribeck: Number | None = parameter(
        "N", "excess of the level at standstill over that at speed; absent for no Stribeck curve", default=None
    )
    stribeck_velocity: Number | None = parameter(
        "m/s", "velocity at which the extra level has fallen to 1/e", above=0, default=None
    )
    jerk_feedforward: Number | None = parameter("N s3/m", "force per set jerk; absent for none", default=None)
    snap_feedforward: Number | None = parameter("N s4/m", "force per set snap; absent for none", default=None)
    dead_band: Number = parameter("m/s", "speed below which the axis counts as at rest", least=0, default=1e-9)

    def check(self) -> None:
        """Raise ParameterError if only one of `stribeck` and `stribeck_velocity` is specified."""
        check_pair(self.kind, "stribeck", self.stribeck, "stribeck_velocity", self.stribeck_velocity)

    def fed(self) -> tuple[str, ...]:
        """Return the parts of the set motion that the specified parameters feed forward."""
        friction = (self.coulomb_positive, self.coulomb_negative, self.stribeck)
        present = (
            any(value is not None for value in (self.mass, self.jerk_feedforward, self.snap_feedforward)),
            self.viscous is not None,
            any(value is not None for value in friction),
        )
        return tuple(name for name, is_there in zip(self.feeds, present, strict=True) if is_there)

    def parameters(self) -> dict[str, Number]:
        """Return θ by name: the specified parameters, in the order of the regressors."""
        named = {
            "mass": self.mass,
            "viscous": self.viscous,
            "coulomb_positive": self.coulomb_positive,
            "coulomb_negative": self.coulomb_negative,
            "stribeck": self.stribeck,
            "jerk_feedforward": self.jerk_feedforward,
            "snap_feedforward": self.snap_feedforward,
        }
        return {name: value for name, value in named.items() if value is not None}

    def regressors(self, setpoint: Setpoint, T: Number) -> dict[str, Number]:
        """Return φ by name for the specified parameters; values may be floats, symbols or arrays over time."""
        middle = setpoint.shifted(0.5 * T)
        v = middle.velocity
        forward, backward = v > self.dead_band, v < -self.dead_band
        regressors: dict[str, Number] = {}
        if self.mass is not None:
            regressors["mass"] = middle.acceleration
        if self.viscous is not None:
            regressors["viscous"] = v
        if self.coulomb_positive is not None:
            regressors["coulomb_positive"] = ops.where(forward, 1.0, 0.0)
        if self.coulomb_negative is not None:
            regressors["coulomb_negative"] = ops.where(backward, -1.0, 0.0)
        if self.stribeck is not None and self.stribeck_velocity is not None:
            ratio = v / self.stribeck_velocity
            extra = ops.exp(-(ratio * ratio))
            regressors["stribeck"] = ops.where(forward, extra, ops.where(backward, -extra, 0.0))
        if self.jerk_feedforward is not None:
            regressors["jerk_feedforward"] = middle.jerk
        if self.snap_feedforward is not None:
            regressors["snap_feedforward"] = middle.snap
        return regressors

    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Number]:
        """Return the unchanged state and the force φᵀ θ."""
        columns, parameters = self.regressors(setpoint, T), self.parameters()
        terms = [columns[name] * value for name, value in parameters.items()]
        if not terms:
            return state, ops.zero(setpoint.velocity)
        total = terms[0]
        for term in terms[1:]:
            total = total + term
        return state, total


def _left(
    forces: Sequence[Sequence[Number]], levels: Sequence[Number], extra: Sequence[Number], share: Number
) -> Number:
    """Return the residual sum of squares when each row of forces is modeled by level + share · extra."""
    return sum(
        (force - level - share * e) * (force - level - share * e)
        for row, level in zip(forces, levels, strict=True)
        for force, e in zip(row, extra, strict=True)
    )
