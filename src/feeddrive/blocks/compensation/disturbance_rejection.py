"""Disturbance rejection: an estimated disturbance is subtracted from the force of any law."""

from dataclasses import replace
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Beside, begun
from feeddrive.blocks.families import Compensation, Law, Observer
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.observer.kalman_recovery import KalmanRecovery
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import StructureError

# √12: rounding to counts of this length has a standard deviation of 1
_COUNT = 3.4641016151377544
# only against 0/0: no share between 0 and this has a meaning
_LEAST = 1e-30


class DisturbanceRejection(Compensation):
    """Subtraction of an observer's disturbance estimate from the force, after the filters of the law.

        force = -share · F̂d(k),    share rises linearly from 0 over blend_time after the start

    The law then sees an axis with the observer's mass, and only the disturbances that are too fast for the observer.
    With a share of 1 the rejection has integral action.  Stability then depends on the law and the observer together:
    check the whole loop with `require_stable`.

    When to use: under a P or P-PI law whose gains are limited by something other than the delay of the force.  Not
    suitable for a law that subtracts an observer's estimate itself, or for an axis mode inside the observer's band.
    Source: Altintas & Okwudire 2009, section 3 (recovery); Ohnishi 1987 (the disturbance observer as an inner loop).
    """

    title = "recovery"

    @classmethod
    def goes_beside(cls, law: type[Law]) -> bool:
        """Return True for a law designed for one rigid mass that does not subtract a disturbance estimate itself."""
        return not law.rejects and law.encoders == 1

    @classmethod
    def begin(cls, axis: AxisModel) -> tuple[Beside, ...]:
        """Return four variants with different observers.

        Two observers invert the rigid axis (DOB), one with a Butterworth filter and one with two equal poles; the
        others are a Kalman filter and the observer of GPI control.

        The random walk of the force in the Kalman filter starts at the value that gives this filter the bandwidth of
        the other observers.
        """
        encoder, noise = axis.velocity_encoder, axis.reading_noise
        gpi = begun(GpiObserver, axis, taylor_states=1, omega_o=1.5 * axis.rate, zeta_o=1.5, encoder=encoder)
        inverse = DisturbanceRecovery.begin(axis)
        twice = replace(inverse, form="two_poles")
        forms = [Beside(cls.title, cls(observer=inverse)), Beside("DOB", cls(observer=twice))]
        if noise > 0.0:
            slow = 1.2 * axis.rate * axis.sample_time
            # the walk per sample for which the steady filter has the bandwidth `slow`, see KalmanRecovery
            walk = slow * slow * slow * axis.mass * noise / (axis.sample_time * axis.sample_time)
            filtered = begun(KalmanRecovery, axis, resolution=_COUNT * noise, force_step=walk, encoder=encoder)
            forms.append(Beside("Kalman recovery", cls(observer=filtered)))
        else:
            remark = "a Kalman filter weighs the disturbance against the noise of the encoder, and none is stated"
            forms.append(Beside("Kalman recovery", None, remark))
        return (*forms, Beside("GPI recovery", cls(observer=gpi)))

    observer: Observer = part("what estimates the disturbance")
    share: Number = parameter("", "part of the estimate that is subtracted", least=0, most=1, default=1)
    blend_time: Number | None = parameter(
        "s", "time in which the share rises after the start; absent: at once", above=0, default=None
    )

    class Prepared(NamedTuple):
        """The prepared values of the observer, and the increase of the share per sample."""

        observer: Any
        rise: tuple[Number, ...]

    class State(NamedTuple):
        """The observer's state, and the share reached so far."""

        observer: Any
        reached: tuple[Number, ...]

    def suits(self, law: Law) -> None:
        """Raise StructureError for a law that subtracts a disturbance estimate itself."""
        if law.subtracts():
            raise StructureError(
                f"control.compensation: disturbance_rejection under {law.kind}, which subtracts the disturbance of its "
                f"own observer already: the force would act twice; leave the rejection out"
            )

    def settled(self) -> Self:
        """Return the block as it acts after blending in, that is, without `blend_time`."""
        return self if self.blend_time is None else replace(self, blend_time=None)

    def prepare(self, T: Number) -> Prepared:
        return self.Prepared(self.observer.prepare(T), () if self.blend_time is None else (T / self.blend_time,))

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the observer's state at rest at the measured position; the share starts at 0 with a `blend_time`."""
        zero = ops.zero(reading.applied)
        return self.State(self.observer.start(prepared.observer, reading), () if self.blend_time is None else (zero,))

    def carries(self, reading: Reading) -> Number:
        """Return the part of the acting force that the estimate provides at the start, N; 0 with a `blend_time`."""
        return self.share * reading.applied if self.blend_time is None else 0.0

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Setpoint, Number]:
        observer, estimate = self.observer.step(prepared.observer, state.observer, reading, T)
        force = -(self.share * estimate.disturbance)
        if not state.reached:
            return self.State(observer, ()), setpoint, force
        reached = ops.minimum(state.reached[0] + prepared.rise[0], 1.0)
        return self.State(observer, (reached,)), setpoint, state.reached[0] * force

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Convert the state: the share rises to a larger value within `blend_time` but drops to a smaller one at once.

        The rise starts from the share reached so far. Without a `blend_time` the new share acts at once.
        """
        observer = self.observer.retune(state.observer, old.observer, old_prepared.observer, prepared.observer)
        if not state.reached:
            return self.State(observer, ())
        # an unchanged share must not change a bit, and old/new need not be exactly 1
        ratio = ops.where(ops.equal(old.share, self.share), 1.0, old.share / ops.maximum(self.share, _LEAST))
        return self.State(observer, (ops.minimum(ratio * state.reached[0], 1.0),))
