"""Generalized Maxwell slip: friction as parallel springs, each of which sticks or slips independently."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from feeddrive.blocks.families import Friction
from feeddrive.blocks.friction.curve import levels, stribeck_level
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, parameter, table
from feeddrive.language.errors import ParameterError


class GeneralizedMaxwellSlip(Friction):
    """Friction that depends on earlier reversals: element i has stiffness k_i and bears the share α_i of the level.

        sticking   F_i' = k_i v,   until |F_i| = α_i s(v)
        slipping   F_i' = sgn(v) attraction (α_i - |F_i|/s(v)),   until v changes its sign
        F = -Σ F_i - viscous v,    s(v) = coulomb + (breakaway - coulomb) e^-(v/v_s)²

    Over a substep h, with s evaluated at the velocity at its start, F_i is a clipped linear function of the velocity v
    at its end.  Thus v = v_free + mobility F is a monotone, piecewise linear equation, which is solved exactly:

        sticking   F_i + k_i h v, limited to ±α_i s
        slipping   A = a F_i + (1 - a) sgn(v) α_i s,  a = e^-(attraction h/s);  A + k_i h v if v turns in the substep

    With breakaway = coulomb the model is a sum of elastic-plastic stops (Masing, Prandtl-Ishlinskii) for any
    attraction: after a reversal the force follows the initial loading curve, scaled by two.  In steady sliding the
    force is that of the Stribeck curve.

    When to use: for quadrant errors of a few micrometers, where the motion of the table after a reversal depends on its
    history.  Do not use it if presliding does not matter (`Stribeck` costs a tenth as much) or if exact standstill is
    needed.  A mass m vibrates in presliding at ω = √(Σ k_i/m), 78 Hz for 9.6 N/um and 40 kg: substeps should be at most
    a fifth of 1/ω.
    Source: Lampaert, Al-Bender & Swevers 2003; Al-Bender, Lampaert & Swevers 2005. The implicit step is specific to
    this library.
    """

    coulomb: Number = parameter("N", "level at speed", above=0)
    breakaway: Number = parameter("N", "level at standstill", above=0)
    stribeck_velocity: Number = parameter("m/s", "velocity at which the extra level has fallen to 1/e", above=0)
    stiffness: Any = table("N/m", "stiffness of each element", above=0)
    share: Any = table("", "share of the level that it bears, relative to the sum of all", above=0)
    attraction: Number = parameter("N/s", "C: how fast a slipping element comes to its share", above=0, default=1e4)
    viscous: Number = parameter("N s/m", "viscous part", least=0, default=0)

    class State(NamedTuple):
        """The force of each element against the motion (N), and the direction in which it slips, 0 where it sticks."""

        force: tuple[Any, ...]
        slips: tuple[Any, ...]

    def check(self) -> None:
        """Raise ParameterError unless both tables have one entry per element."""
        if ops.length(self.stiffness) != ops.length(self.share):
            raise ParameterError(
                f"{self.kind}: stiffness has {ops.length(self.stiffness)} entries and share {ops.length(self.share)}: "
                f"give one of each for every element"
            )

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rule that the breakaway level is not below the Coulomb level."""
        yield from levels(self.kind, "coulomb", self.coulomb, "breakaway", self.breakaway)

    def start(self, velocity: Number = 0.0) -> State:
        """Return the state in which every element slips at its share of the level; at rest all forces are 0."""
        going, level = ops.sign(velocity), self.level(velocity)
        elements = range(ops.length(self.stiffness))
        return self.State(tuple(self._most(i, level) * going for i in elements), tuple(going for _ in elements))

    def linear(self) -> Number:
        return self.viscous

    def level(self, velocity: Number) -> Number:
        """Return the value of the Stribeck curve, in N, at a velocity in m/s."""
        return stribeck_level(velocity, self.coulomb, self.breakaway, self.stribeck_velocity)

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[State, Number, Any]:
        """Evaluate the equations in the class docstring; the body is never stuck."""
        lines = [
            self._line(i, step, force, slips, velocity)
            for i, (force, slips) in enumerate(zip(state.force, state.slips, strict=True))
        ]
        end = _end(lines, free_velocity, mobility)
        forces = tuple(ops.clip(base + slope * end, low, high) for base, slope, low, high, _, _ in lines)
        slips = tuple(
            ops.where(ops.absolute(force) >= most, ops.sign(force), ops.where(going * end > 0.0, going, 0.0))
            for force, (*_, most, going) in zip(forces, lines, strict=True)
        )
        total: Any = 0.0
        for i, force in enumerate(forces):
            # no sum with a literal 0.0, which would be an operation of the traced step
            total = force if i == 0 else total + force
        return self.State(forces, slips), -total, False

    def _line(self, i: int, h: Number, force: Number, slips: Number, velocity: Number) -> tuple[Any, ...]:
        """Return F_i at v = 0, its slope versus v, its two bounds, α_i s, and sgn(v) if it slips (otherwise 0)."""
        level = self.level(velocity)
        most = self._most(i, level)
        slope = ops.gather(self.stiffness, float(i)) * h
        going = ops.where(slips * velocity > 0.0, slips, 0.0)
        eased = force + (1.0 - ops.exp(-(self.attraction * h / level))) * (going * most - force)
        slides = ops.no(ops.equal(going, 0.0))
        base = ops.where(slides, eased, force)
        high = ops.where(going > 0.0, eased, most)
        low = ops.where(going < 0.0, eased, -most)
        return base, slope, low, high, most, going

    def _most(self, i: int, level: Number) -> Any:
        """Return α_i s, the largest force of element i, N."""
        whole: Any = 0.0
        for j in range(ops.length(self.share)):
            whole = whole + ops.gather(self.share, float(j))
        # normalized here: fitted or tuned shares need not add up to 1
        return ops.gather(self.share, float(i)) / whole * level

    def steady(self, velocity: Number) -> Number:
        """Return level(v) · sign(v) + viscous · v."""
        return self.level(velocity) * ops.sign(velocity) + self.viscous * velocity


def _end(lines: list[tuple[Any, ...]], free: Number, mobility: Number) -> Any:
    """Return the unique root v of v = free - mobility Σ clip(base + slope v, low, high).

    miss(v) = v - free + mobility Σ ... increases with v. Its graph is piecewise linear: the root lies between the last
    corner with miss <= 0 and the first with miss >= 0; beyond all corners every element is at its bound.
    """

    def total(values: list[Any]) -> Any:
        found = values[0]
        for value in values[1:]:
            found = found + value
        return found

    # the force lies between the sums of all lower and of all upper bounds: these two velocities bracket the root
    last = free - mobility * total([high for _, _, _, high, _, _ in lines])
    first = free - mobility * total([low for _, _, low, _, _, _ in lines])
    below, above = ops.minimum(first, last), ops.maximum(first, last)
    under, over = _miss(lines, below, free, mobility), _miss(lines, above, free, mobility)
    for base, slope, low, high, _, _ in lines:
        for bound in (low, high):
            corner = (bound - base) / slope
            miss = _miss(lines, corner, free, mobility)
            nearer = ops.both(miss <= 0.0, corner > below)
            below, under = ops.where(nearer, corner, below), ops.where(nearer, miss, under)
            nearer = ops.both(miss >= 0.0, corner < above)
            above, over = ops.where(nearer, corner, above), ops.where(nearer, miss, over)
    # both ends are one corner where the root lies on it
    wide = over - under
    return below - under * ((above - below) / ops.where(wide > 0.0, wide, 1.0))


def _miss(lines: list[tuple[Any, ...]], v: Any, free: Number, mobility: Number) -> Any:
    """Return v - free + mobility Σ clip(base + slope v, low, high), the residual in m/s at the velocity v."""
    force: Any = 0.0
    for i, (base, slope, low, high, _, _) in enumerate(lines):
        each = ops.clip(base + slope * v, low, high)
        force = each if i == 0 else force + each
    return (v - free) + mobility * force
