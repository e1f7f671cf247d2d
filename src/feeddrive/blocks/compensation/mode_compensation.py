"""Compensation of low-frequency machine modes by the motion of the axis."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Beside
from feeddrive.blocks.compensation.machine_mode import MachineMode
from feeddrive.blocks.families import Compensation, Friction, Law, Observer
from feeddrive.blocks.filter.biquad import below_nyquist
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, Rule, parameter, part
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.matrix import Matrix, Row
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text


class ModeCompensation(Compensation):
    """Active compensation of structural modes: the axis follows the tool as the cutting force deflects it.

        F_c(k)  = -(F̂d(k) - F_friction)                the force on the tool side, from the observer
        ξ(k+1)  = Φ(T) (ξ(k), F_c(k)),   ξ = (x_s, v_s): zero-order hold of `MachineMode`, one for each mode
        p       = Φ(τ) (ξ(k), F_c(k))                   the present state; the observer's estimate is delayed by τ
        x_r += p₁,   v_r += p₂,   a_r += F_c/m_s - 2ζω p₂ - ω² p₁

    This formulation needs no differentiation.  Friction does not act on the tool side: a friction model, evaluated at
    the noise-free velocity of the shifted setpoint, removes it from the `applied` force that the observer receives.  A
    mode of the base is driven by the applied force itself, without observer and delay, and its motion is subtracted
    from the setpoint.  The motion of a workpiece fixture, which is driven by F_cut/m_w - x_r'', is subtracted as well.

    When to use: modes well inside the bandwidth of the position loop, whose frequency is known within about 1 %.  At
    resonance an error of 5 % cancels the benefit; for steps and broadband forces the benefit falls slowly with this
    error.  Not suitable for modes of the axis itself.  A fixture closes a loop through the workpiece, since the
    observer also sees the workpiece's inertia.  This loop is unstable unless the observer's band ends below about a
    quarter of the mode's frequency; only slow forces are then compensated.
    Source: Altintas & Okwudire 2009, end of section 3; the formulation is this library's.
    """

    title = "mode compensation"

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True for a law designed for one rigid mass that does not subtract a disturbance estimate itself."""
        return not law.rejects and law.encoders == 1

    @classmethod
    def begin(cls, axis: AxisModel) -> tuple[Beside, ...]:
        """Return one untuned variant: the modes of the machine file, with the observer of `DisturbanceRejection`.

        It is not tuned because a comparison evaluates the motion of the table, whereas this block improves the path of
        the tool.
        """
        if not axis.machine_modes:
            raise StructureError(
                "the machine file states no mode of the machine beside the axis (modes of a mode_compensation)"
            )
        compensation = cls(modes=axis.machine_modes, observer=DisturbanceRecovery.begin(axis))
        return (
            Beside(cls.title, compensation, "it moves the table with the tool; figures are of the table", tuned=False),
        )

    modes: tuple[MachineMode, ...] = part("modes of the machine")
    observer: Observer = part("what recovers the disturbance")
    friction: Friction | None = part(
        "friction of the axis beyond the observer's viscous part; absent: none is subtracted", default=None
    )
    lead_time: Number | None = parameter(
        "s", "time by which the modes are predicted; absent: the observer's own lag", least=0, default=None
    )

    class Prepared(NamedTuple):
        """The observer's values; for each mode Φ - 1 and Γ over a sample and over the lead τ; 1/m_s, 2ζω, ω²."""

        observer: Any
        sample: tuple[Matrix, ...]
        lead: tuple[Matrix, ...]
        mode: tuple[Row, ...]

    class State(NamedTuple):
        """The observer's state, x_s (m) and v_s (m/s) of each mode, and the set velocity (m/s) if there is friction."""

        observer: Any
        modes: tuple[tuple[Number, Number], ...]
        velocity: tuple[Number, ...]

    def check(self) -> None:
        """Raise ParameterError if there is no mode."""
        if not self.modes:
            raise ParameterError("mode_compensation.modes is empty: give at least one mode, or no compensation")

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rules: all modes lie below half the sample rate, and the lead time is not too long."""
        for i, mode in enumerate(self.modes):
            yield below_nyquist(self.kind, f"modes.{i}.frequency", mode.frequency, T)
        lead = self._lead(self.observer.prepare(T), T)
        for i, mode in enumerate(self.modes):
            if mode.place != "base" and not matrix.is_zero(lead):
                yield self._predictable(i, lead)

    def _lead(self, made: Any, T: Number) -> Number:
        return self.observer.lag(made, T) if self.lead_time is None else self.lead_time

    def _predictable(self, i: int, lead: Number) -> Rule:
        """Return the rule that the lead (s) is short enough for `matrix.expm1` to predict the motion of mode `i`."""
        mode = self.modes[i]
        # 2 (1 + ζ) ω lead is the largest row sum of the matrix in `_hold`
        most = matrix.LARGEST_NORM / (2.0 * (1.0 + mode.damping_ratio) * mode.omega())
        whose = "lead_time, the lag of its observer," if self.lead_time is None else "lead_time"
        return Rule(
            lead <= most,
            f"modes.{i} can be predicted over the lead_time, or over the lag of the observer",
            lambda: Text(
                f"{self.kind}.{whose} = {Quantity(lead, 's'):6 SI} is {Quantity(lead * mode.frequency)} periods of "
                f"modes.{i} with its {Quantity(mode.frequency, 'Hz'):6}: at most {Quantity(most, 's'):SI} can be "
                "predicted; give a shorter lead_time, or leave out a mode so far above the band of the observer"
            ),
        )

    def prepare(self, T: Number) -> Prepared:
        """Compute the zero-order-hold discretization of each mode over a sample and over the lead time."""
        made = self.observer.prepare(T)
        lead = self._lead(made, T)
        samples, leads, modes = [], [], []
        for mode in self.modes:
            w = mode.omega()
            samples.append(_hold(mode, T))
            # the base is driven by the force that has acted, which is not late
            leads.append(() if mode.place == "base" or matrix.is_zero(lead) else _hold(mode, lead))
            modes.append((1.0 / mode.modal_mass(), 2.0 * mode.damping_ratio * w, w * w))
        return self.Prepared(made, tuple(samples), tuple(leads), tuple(modes))

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state with the modes at rest and unloaded."""
        zero = ops.zero(reading.applied)
        velocity = () if self.friction is None else (reading.velocity,)
        return self.State(self.observer.start(prepared.observer, reading), ((zero, zero),) * len(self.modes), velocity)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Setpoint, Number]:
        seen = reading
        if self.friction is not None:
            seen = reading._replace(applied=reading.applied - self.friction.steady(state.velocity[0]))
        observer, estimate = self.observer.step(prepared.observer, state.observer, seen, T)
        moved, after = setpoint, []
        for mode, before, sample, lead, numbers in zip(
            self.modes, state.modes, prepared.sample, prepared.lead, prepared.mode, strict=True
        ):
            # the reaction of the drive is known without an observer: the force that has acted since the last sample
            if mode.place == "base":
                force = -reading.applied
                now = held = _moved(sample, before, force)
            else:
                force = -estimate.disturbance
                if mode.place == "fixture":
                    force = estimate.disturbance - mode.modal_mass() * setpoint.acceleration
                now = _moved(lead, before, force) if lead else before
                held = _moved(sample, before, force)
            after.append(held)
            bent = numbers[0] * force - numbers[1] * now[1] - numbers[2] * now[0]
            way = (*now, bent) if mode.place == "tool" else (-now[0], -now[1], -bent)
            moved = moved._replace(
                position=moved.position + way[0],
                velocity=moved.velocity + way[1],
                acceleration=moved.acceleration + way[2],
            )
        velocity = () if self.friction is None else (moved.velocity,)
        return self.State(observer, tuple(after), velocity), moved, 0.0

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Convert the state of the observer; the modes keep their positions and velocities."""
        observer = self.observer.retune(state.observer, old.observer, old_prepared.observer, prepared.observer)
        return state._replace(observer=observer)


def _hold(mode: MachineMode, span: Number) -> Matrix:
    """Return the two rows (Φ - 1, Γ) of x'' + 2ζω x' + ω² x = F/m over `span` in s, using velocities scaled by 1/ω."""
    w = mode.omega()
    turn = w * span
    # all entries are of the order of ω span; in SI the ω² of a fast mode would dominate the norm
    change = matrix.expm1(((0.0, turn, 0.0), (-turn, -2.0 * mode.damping_ratio * turn, turn), (0.0, 0.0, 0.0)))
    give = 1.0 / (mode.modal_mass() * w * w)
    (a, b, c), (d, e, f) = change[0], change[1]
    return (a, b / w, c * give), (d * w, e, f * (give * w))


def _moved(hold: Matrix, before: tuple[Number, Number], force: Number) -> tuple[Number, Number]:
    """Return the position and velocity of a mode after an interval of constant force."""
    (a, b, c), (d, e, f) = hold
    x, v = before
    # Φ - 1 is added to the state: Φ itself would lose the digits of the small change in a sample
    return x + (a * x + b * v + c * force), v + (d * x + e * v + f * force)
