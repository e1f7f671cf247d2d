"""Active disturbance rejection: a PD law for the acceleration with compensation of an estimated disturbance."""

import operator
from collections.abc import Callable, Iterator
from itertools import accumulate
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start, begun
from feeddrive.blocks.families import Law, Observer
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import matrix, tree
from feeddrive.language.block import Number, Rule, parameter, part
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined

# largest growth of a proposed remedy: closer to 1 rounding decides about stability
_SURE = 1.0 - 1e-9


class ActiveDisturbanceRejection(Law):
    """A PD law for a mass with a disturbance, q'' = u + ξ: u cancels ξ and places two poles.

        u     = a_set - α1 (v̂ - v_set) - α0 (x - x_set) - share · disturbance / mass
        force = mass · u,        α1 = 2 zeta_c omega_c,  α0 = omega_c²

    The observer estimates v̂ and the disturbance; it receives the force after the limit, which prevents windup.  With
    the exact disturbance the error obeys e'' + α1 e' + α0 e = 0.  Without it (share = 0) a constant disturbance ξ, in
    m/s², leaves the error ξ / omega_c²: 23 mm for the paper's vertical axis at 12 rad/s.
    The set acceleration acts over the whole sample and is evaluated at its middle.

    When to use: a stiff axis with friction and cutting forces for which there is no model.  Not suitable for a
    structural mode below about three times the observer's frequency, or for disturbances near that frequency, which the
    observer amplifies (see `GpiObserver`).
    At the paper's gains the loop is stable for a true mass of 0.50 to 1.34 times `mass`: when in doubt, set `mass` too
    large.  The poles lie where `omega_c` places them only if the observer is about ten times faster.
    Source: Beltrán-Carbajal et al. 2013, eqs. (9)-(12), with torque divided by a = lead / 2π as the force.
    Raises ParameterError for gains with which the loop on a rigid axis of this mass is not stable.
    """

    feeds = ("acceleration", "velocity")
    rejects = True
    tunables = ("omega_c", "zeta_c")
    title = "GPI"

    mass: Number = parameter("kg", "moving mass in the model of the law; when in doubt too large", above=0)
    omega_c: Number = parameter("rad/s", "own frequency of the tracking error", above=0)
    zeta_c: Number = parameter("", "its damping ratio", above=0, default=0.7071)
    share: Number = parameter("", "share of the estimated disturbance that is subtracted", least=0, default=1.0)
    observer: Observer = part("estimates velocity and disturbance")

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return three variants whose observers model the disturbance by five, three and one Taylor states.

        The observer's poles start well damped and thus far apart, since a fast observer amplifies disturbances near its
        own frequency.
        """
        starts = []
        for states, slower, damping in ((5, 1.0, 3.0), (3, 1.0, 3.0), (1, 0.5, 1.5)):
            observer = begun(
                GpiObserver,
                axis,
                taylor_states=states,
                omega_o=3.0 * slower * axis.rate,
                zeta_o=damping,
                encoder=axis.velocity_encoder,
            )
            law = begun(cls, axis, omega_c=slower * axis.rate, zeta_c=0.5, observer=observer)
            starts.append(Start(f"{cls.title}, {states} Taylor state{'s' * (states > 1)}", law, axis.sentence()))
        return tuple(starts)

    class State(NamedTuple):
        """The state of the observer."""

        observer: Any

    def position_gain(self) -> Number:
        """Return the position gain α0/α1, 1/s."""
        return self.omega_c / (2.0 * self.zeta_c)

    def prepare(self, T: Number) -> Any:
        return self.observer.prepare(T)

    def start(self, prepared: Any, setpoint: Setpoint, reading: Reading) -> State:
        """Return the observer's state at rest at the measured position, with a disturbance that balances the force."""
        return self.State(self.observer.start(prepared, reading))

    def step(
        self, prepared: Any, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        observer, estimate = self.observer.step(prepared, state.observer, reading, T)
        acceleration = setpoint.shifted(0.5 * T).acceleration
        slower = 2.0 * self.zeta_c * self.omega_c * (estimate.velocity - setpoint.velocity)
        nearer = self.omega_c * self.omega_c * (reading.position_load - setpoint.position)
        force = self.mass * (acceleration - slower - nearer) - self.share * estimate.disturbance
        return self.State(observer), force

    def retune(self, state: State, old: Self, old_prepared: Any, prepared: Any) -> State:
        return self.State(self.observer.retune(state.observer, old.observer, old_prepared, prepared))

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rule: the loop with a rigid axis of this mass and the observer's dead time is stable."""
        yield Rule(
            matrix.decays(self._sample(T)),
            "the loop on a rigid axis of this mass is stable, with the dead time that the observer knows of",
            lambda: self._refusal(T),
        )

    def _refusal(self, T: float) -> str:
        """Return the error message: how far the limit is exceeded, and the nearest admissible values."""
        growth, remedies = self._growth(T), list[str]()
        slowest = _nearest(self._growth, T)
        if slowest is not None:
            remedies.append(Text(f"sample every {Quantity(slowest, 's'):SI} or faster"))
        values = dict(tree.leaves(self))
        tuned = (*self.tunables, *(f"observer.{name}" for name in self.observer.tunables))
        for name in (name for name in tuned if name in values):
            nearest = _nearest(lambda value, name=name: self._with(name, value)._growth(T), values[name])
            if nearest is not None:
                unit = tree.declaration(self, name).unit
                now = Quantity(values[name], unit, bare=True)
                remedies.append(f"take {name} <= {Quantity(nearest, unit):SI} in place of {now:6 SI}")
        return Text(
            f"{self.kind} is not stable on a rigid axis of {Quantity(self.mass, 'kg'):6} at a sample time of "
            f"{Quantity(T, 's'):6 SI}: its motion grows by the factor {Quantity(growth):7} a sample, which is "
            f"{Quantity(growth - 1.0):3} over the limit 1; {joined(', or ', remedies) or 'take another observer'}"
        )

    def _with(self, path: str, value: Any) -> Self:
        """Return a copy of the law in which the parameter at `path` is `value`, a number or a batch of numbers."""
        return tree.rebuild(self, (value if path == name else old for name, old in tree.leaves(self)))

    def _growth(self, T: Number) -> Any:
        """Return the spectral radius of the closed loop of law, observer, dead time and free mass."""
        return matrix.growth(self._sample(T))

    def _sample(self, T: Number) -> list[list[Any]]:
        """Return the transposed transition matrix of the loop of `_growth` over one sample.

        Transposition leaves the eigenvalues unchanged.
        """
        prepared = self.prepare(T)
        rest = Setpoint(0.0)
        start = self.start(prepared, rest, Reading(0.0, 0.0))
        # an observer of a user need not model a dead time
        late = int(getattr(self.observer, "delay_samples", 0))
        first = [0.0] * (3 + late) + [value for _, value in tree.leaves(start)]

        def after(x: list[Any]) -> list[Any]:
            """Return the position, velocity, commands (newest first) and states one sample later."""
            position, velocity, *commands = x[: 3 + late]
            state = tree.rebuild(start, iter(x[3 + late :]))
            reading = Reading(position, position, commands[0], commands[0])
            state, force = self.step(prepared, state, rest, reading, T)
            commands = [force, *commands[:late]]
            push = commands[late] / self.mass
            moved = (position + T * velocity + 0.5 * T * T * push, velocity + T * push)
            return [*moved, *commands, *(leaf for _, leaf in tree.leaves(state))]

        still = after(first)
        rows: list[list[Any]] = []
        for i in range(len(first)):
            # the sample is affine in its state, so that a step of 1 gives the column without a truncation error
            moved = after([value + 1.0 if i == j else value for j, value in enumerate(first)])
            rows.append([a if matrix.is_zero(b) else a - b for a, b in zip(moved, still, strict=True)])
        return rows


def _nearest(growth: Callable[[Any], Any], refused: float) -> float | None:
    """Return the largest admissible value below `refused`, or None; the search takes small, then large steps."""
    # 0.7²⁰ covers three decades closely; a value that is wrong by its unit lies further off
    steps = accumulate((*(0.7,) * 20, *(0.01,) * 20), operator.mul, initial=refused)
    return matrix.edge(lambda value: growth(value) < _SURE, list(steps))
