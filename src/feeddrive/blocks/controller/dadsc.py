"""Discrete-time adaptive sliding-mode control with a disturbance estimate."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Self

from feeddrive.blocks.controller.polynomial_stability import is_stable, largest_share, product
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined


class DADSC(Law):
    """Discrete-time adaptive sliding-mode control of a rigid axis, with an estimate F̂d of the disturbance.

        m x'' + b x' = F_m + F_d                                                                  (1)
        e_v(k) = e_v(k-1) + (T/m) [m x_r''(k) + b x'(k) - F_m(k) - F_d(k)]       (2), as corrected
        s(k)   = λ e_x(k) + e_v(k),   e_x = x_r - x,   e_v = x_r' - x'                            (3)
        F_m(k) = m x_r''(k) + m K s(k) - F̂d(k) + b x'(k) + m λ e_v(k)                            (4)
        F̂d(k)  = F̂d(k-1) - g1 s(k) + g2 s(k-1)                                                   (5)

    From (2) and (4) follows Q s(k) = s(k-1) + (T/m) (F̂d(k) - F_d(k)) with Q = 1 + K T.  The paper sets
    g2 = g1/Q and leaves g1 free; here the third design frequency determines g1, and a ratio keeps g2 general,

        g1 = m Q ω_d,   g2 = adaptation_ratio · g1/Q

    With the paper's ratio of 1 the estimate does not depend on s: F_d - F̂d falls by 1/(1 + ω_d T) each sample.  The
    poles of the ideal loop, the denominator of the corrected (8), are then 1/(1 + λT), 1/(1 + KT), 1/(1 + ω_d T): real
    for all positive frequencies.  The law is thus a PID with k_d = m (λ + K + ω_d), k_i = m λ K ω_d.

    Additions to the paper: x' is the backward difference, and x_r' is differenced likewise; x_r'' is evaluated in the
    middle of the sample over which the force acts; the force cut off by the limit in the last sample enters F̂d
    (back-calculation through `applied` and `requested`).  With two encoders x is read at the load and x' at the motor.

    When to use: linear motors and stiff drives under cutting forces, tuned by three frequencies; with all of them equal
    to p, p <= 0.19/((d + 1) T) keeps Ms <= 2 at d samples of dead time.  Not suitable for an axis mode below three
    times the crossover.  It is not stiffer than a P-PI of equal margins: both are PIDs.
    Source: Altintas & Okwudire 2009, eq. (1)-(8); in (2) the mass in front of x_r'' is missing, in (8) z² - 1 must read
    z² - z.
    """

    feeds = ("acceleration", "velocity")
    tunables = ("tracking_rate", "reaching_rate", "adaptation_rate")
    title = "DADSC"

    mass: Number = parameter("kg", "m: all that moves", above=0)
    viscous: Number = parameter("N s/m", "b: viscous friction of the guideway", least=0, default=0)
    tracking_rate: Number = parameter("1/s", "λ: rate at which the position error falls on the sliding line", above=0)
    reaching_rate: Number = parameter("1/s", "K: rate at which the sliding line is reached", above=0)
    adaptation_rate: Number = parameter("1/s", "ω_d: rate at which the estimate follows the disturbance", above=0)
    adaptation_ratio: Number = parameter("", "g2 Q / g1; other than 1 couples the estimate to s", least=0, default=1)
    velocity_encoder: str = choice("encoder of the velocity", options=("motor", "load"), default="motor")

    class Prepared(NamedTuple):
        """The gains g1 and g2 of equation (5), N s/m."""

        g1: Number
        g2: Number

    class State(NamedTuple):
        """The last position of the velocity encoder (m), s(k-1) (m/s) and F̂d (N)."""

        position: Number
        sliding: Number
        estimate: Number

    def position_gain(self) -> Number:
        """Return the position gain λ in 1/s, as in s = λ e_x + e_v."""
        return self.tracking_rate

    def prepare(self, T: Number) -> Prepared:
        """Return g1 = m Q ω_d and g2 = adaptation_ratio · g1/Q."""
        # m ω_d first, so that g1/Q needs no division
        g2 = self.mass * self.adaptation_rate
        return self.Prepared(g2 * (1.0 + self.reaching_rate * T), self.adaptation_ratio * g2)

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state at rest at the measured position, with s = 0 and a disturbance that balances the force."""
        position = reading.position(self.velocity_encoder)
        return self.State(position, ops.zero(position), -reading.applied)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """Evaluate equations (3) to (5) of the class docstring."""
        m, b = self.mass, self.viscous
        position = reading.position(self.velocity_encoder)
        v = (position - state.position) / T
        e_x = setpoint.position - reading.position_load
        e_v = setpoint.backward_velocity(T) - v
        s = self.tracking_rate * e_x + e_v
        # the estimate enters the force with a minus sign: the force that the limit cut off is added to it
        held = state.estimate + (reading.requested - reading.applied)
        estimate = held - prepared.g1 * s + prepared.g2 * state.sliding
        acceleration = setpoint.shifted(0.5 * T).acceleration
        force = m * (acceleration + self.reaching_rate * s + self.tracking_rate * e_v) - estimate + b * v
        return self.State(position, s, estimate), force

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Keep the integral in (5), the force F̂d + g2 s(k); the remaining term -g2 s(k) then uses the new g2."""
        return state._replace(estimate=state.estimate + (old_prepared.g2 - prepared.g2) * state.sliding)

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rule: the sampled loop with the plant m x'' = F and no dead time is stable at T."""
        rates = (self.tracking_rate, self.reaching_rate, self.adaptation_rate)
        yield Rule(
            _stable(rates, self.adaptation_ratio, T),
            "the loop around a free mass, without any dead time, is stable with these rates and this ratio",
            lambda: self._refusal(rates, T),
        )

    def _refusal(self, rates: tuple[Number, Number, Number], T: Number) -> str:
        """Return the error message, with the violated bounds and the nearest admissible values."""
        ratio = self.adaptation_ratio
        if ratio != 1.0 and _stable(rates, 1.0, T):
            nearest = 1.0 + (ratio - 1.0) * largest_share(lambda part: _stable(rates, 1.0 + part * (ratio - 1.0), T))
            side, why = (
                ("most", "above it g2 cancels the correction by g1, and the estimate drifts away")
                if ratio > 1.0
                else (
                    "least",
                    "below it g1 drives the estimate faster than the approach to the sliding line damps it",
                )
            )
            return Text(
                f"dadsc.adaptation_ratio = {Quantity(ratio):6} must be at {side} {Quantity(nearest):6} at these rates: "
                f"{why}; 1 is g2 = g1/Q"
            )
        share = largest_share(lambda part: _stable((part * rates[0], part * rates[1], part * rates[2]), 1.0, T))
        bounds = joined(
            ", ",
            (
                f"{name} = {Quantity(rate, '1/s'):6} (must be below {Quantity(share * rate, '1/s', bare=True)})"
                for name, rate in zip(self.tunables, rates, strict=True)
            ),
        )
        # the share is 0 for absurd rates, such as 1e300 1/s
        excess = Text(f"{Quantity((1.0 / share - 1.0), 'share'):3}") if share > 0.0 else "far"
        return Text(
            f"dadsc: {bounds}: {excess} too fast for the sample time {Quantity(T, 's'):6 SI}, since the loop is then "
            "unstable without any dead time. Stay below these bounds, in the same ratios, or sample faster; with d "
            f"samples of dead time 0.19/((d + 1) T) = {Quantity(0.19 / T)}/(d + 1) 1/s for each keeps Ms <= 2"
        )


def _stable(rates: tuple[Number, Number, Number], ratio: Number, T: Number) -> Any:
    """Return True if the loop with the plant m x'' = F, with F held over the sample, is stable with `rates` = λ, K,
    ω_d.

    With q = z⁻¹ and D = 1 - q its characteristic equation is
    D³ + q (1 + q)/2 · [(k D + (1 + k) w - ratio w q)(l + D) + l D²] = 0, where
    l = λT, k = KT, w = ω_d T; friction is omitted, since the law compensates it.  With q = (1 - y)/(1 + y) the inside
    of the unit circle becomes the half plane Re y < 0; y is in units of the fastest rate, so that slow loops lose no
    precision.
    """
    fastest = ops.maximum(ops.maximum(rates[0], rates[1]), rates[2]) * T
    l, k, w = (rate * T / fastest for rate in rates)  # noqa: E741
    adapting = [w * ((1.0 - ratio) / fastest + k), 2.0 * k + w * (1.0 + fastest * k + ratio)]
    inner = product(adapting, [l, 2.0 + fastest * l])
    outer = product([1.0, -fastest], [inner[0], inner[1], inner[2] + 4.0 * l])
    return is_stable([*outer[:3], outer[3] + 8.0, 8.0 * fastest])
