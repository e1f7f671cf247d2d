"""Learned friction feedforward: parallel stop elements driven by the set position, and a residual force."""

from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Feedforward, Law
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, table
from feeddrive.language.errors import ParameterError, StructureError

# dry friction is not 0 at any speed: a slow one shows whether there is some
_CREEP = 1e-4  # m/s
# widths of a bell, beyond which there was no data to learn from
_WIDTHS = 3.0


class FrictionStops(Feedforward):
    """Friction with presliding, from elastic-plastic stops of width δ_i and stiffness k_i driven by the set position.

        e_i(k) = clip(e_i(k-1) + x(k) - x(k-1), ±δ_i),    x = x_set(t + T/2)
        force  = c Σ k_i e_i + c r(v),    c = clip(travel/(2 δ_max) - 1, 0, 1)

    A stop forgets its initial state once the axis has moved by 2 δ_i.  `travel` is the largest minus the smallest set
    position since the start.  Over the first 2 δ_max of travel, where the state of the friction is unknown, no friction
    is fed forward; beyond 4 δ_max all of it is. Viscous friction is not included; it belongs to `Inertia`.

    The residual r, for instance a Stribeck curve, is a sum of bell curves over the set velocity.  A polynomial would
    reach thousands of newtons at twice the velocity range of its data.

        r(v) = clip(Σ w_j e^-½((v - v_j)/residual_width)², ±residual_limit),   0 beyond 3 widths outside of all v_j

    When to use: reversals and quadrant glitches of an axis whose friction repeats; `learned_stops` fits the block to a
    log.
    Not suitable for friction that drifts with temperature or load (widths wrong by 30 % cause seven times the error of
    correct ones), or for set positions spaced wider than the smallest width.
    Source: the sum of stops as the limit of the Maxwell slip model: Al-Bender, Lampaert & Swevers 2004; Lampaert et al.
    2003 (its feedforward).
    """

    feeds = ("friction",)
    title = "learned stops"

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True for the P-PI cascade: the stops reduce its reversal errors and are learned from its log."""
        return issubclass(law, CascadePPI)

    @classmethod
    def begin(cls, axis: AxisModel) -> Self:
        """Return stops of zero stiffness; learning replaces their widths and stiffnesses.

        Raises StructureError if the axis has no dry friction.
        """
        if abs(axis.dry_friction(_CREEP)) + abs(axis.dry_friction(-_CREEP)) == 0.0:
            raise StructureError("the axis has no dry friction to be fed forward: leave the stops out")
        # without stiffness the widths have no effect, and learning replaces both
        return cls(width=(1e-6, 1e-5), stiffness=(0.0, 0.0))

    width: Any = table("m", "δ: travel from the middle of a stop to its end", above=0)
    stiffness: Any = table("N/m", "k of each stop", least=0)
    residual_velocity: Any = table("m/s", "speeds at which the bells stand; absent: no residual", default=None)
    residual_force: Any = table("N", "height of each bell", default=None)
    residual_width: Number | None = parameter("m/s", "standard width of a bell", above=0, default=None)
    residual_limit: Number | None = parameter("N", "largest residual ever seen", least=0, default=None)

    class State(NamedTuple):
        """The set position in the middle of the last sample, the ends of the travel so far, and e of each stop (m)."""

        position: Number
        lowest: Number
        highest: Number
        stretch: tuple[Any, ...]

    def check(self) -> None:
        """Raise ParameterError unless paired tables have equal lengths and a residual has all four parts or none."""
        if ops.length(self.width) != ops.length(self.stiffness):
            raise ParameterError(
                f"{self.kind}: width has {ops.length(self.width)} entries and stiffness {ops.length(self.stiffness)}: "
                f"give one of each for every stop"
            )
        names = ("residual_velocity", "residual_force", "residual_width", "residual_limit")
        missing = [name for name in names if getattr(self, name) is None]
        if 0 < len(missing) < len(names):
            raise ParameterError(
                f"{self.kind}: a residual needs all of {', '.join(names)}; missing: {', '.join(missing)}"
            )
        if not missing and ops.length(self.residual_velocity) != ops.length(self.residual_force):
            raise ParameterError(
                f"{self.kind}: residual_velocity has {ops.length(self.residual_velocity)} entries and residual_force "
                f"{ops.length(self.residual_force)}: give one of each for every bell"
            )

    def start(self, setpoint: Setpoint) -> State:
        """Return the state at rest, with no travel yet."""
        x = setpoint.position
        return self.State(x, x, x, (ops.zero(x),) * ops.length(self.width))

    def step(self, state: State, setpoint: Setpoint, T: Number) -> tuple[State, Number]:
        middle = setpoint.shifted(0.5 * T)
        x = middle.position
        moved, force, widest = x - state.position, ops.zero(x), ops.zero(x)
        stretch: list[Any] = []
        for i, e in enumerate(state.stretch):
            width = ops.gather(self.width, float(i))
            e = ops.clip(e + moved, -width, width)
            force = force + ops.gather(self.stiffness, float(i)) * e
            widest = ops.maximum(widest, width)
            stretch.append(e)
        lowest, highest = ops.minimum(state.lowest, x), ops.maximum(state.highest, x)
        known = ops.clip((highest - lowest) / (2.0 * widest) - 1.0, 0.0, 1.0)
        if self.residual_velocity is not None:
            force = force + self.residual(middle.velocity)
        return self.State(x, lowest, highest, tuple(stretch)), known * force

    def retune(self, state: State, old: Self) -> State:
        """Return the state unchanged: it holds positions and distances in m."""
        return state

    def residual(self, v: Number) -> Number:
        """Return r(v) in N, without the factor c."""
        assert self.residual_width is not None
        assert self.residual_limit is not None
        total: Any = 0.0
        # without any bell nothing was learned: outside
        nearest: Any = _WIDTHS + 1.0
        for j in range(ops.length(self.residual_velocity)):
            away = (v - ops.gather(self.residual_velocity, float(j))) / self.residual_width
            total = total + ops.gather(self.residual_force, float(j)) * ops.exp(-0.5 * (away * away))
            nearest = ops.minimum(nearest, ops.absolute(away))
        return ops.where(nearest <= _WIDTHS, ops.clip(total, -self.residual_limit, self.residual_limit), 0.0)
