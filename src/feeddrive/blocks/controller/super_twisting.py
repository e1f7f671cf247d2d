"""Super-twisting sliding-mode control in three sampled forms."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple, Self

from feeddrive.blocks.axis_model import AxisModel, Start, begun
from feeddrive.blocks.controller.polynomial_stability import is_stable, largest_share, product
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

_QUIET = 3.0  # standard deviations of the noise in s that stay inside the zone
# m/s³: a disturbance that changes by 5 g in a millisecond
_USUAL = 5e4


class SuperTwisting(Law):
    """Super-twisting control: a continuous force brings the axis to a sliding line in finite time.

        s     = e_v + λ e_x,   e_x = x_r - x,   e_v = x_r' - x'
        force = m (x_r'' + λ e_v + u) + b x'
        u     = k1 √|s| sgn s + w,   w' = k2 sgn s,      k1 = root_factor √L,   k2 = sign_factor L

    L is the largest rate of change of the disturbance divided by the mass, |dF_d/dt| / m; it must stay below k2.
    `form` selects how the law is sampled:

        explicit   u and w as written, w(k+1) = w + T k2 sgn s
        implicit   β = s - T w:  w⁺ = w + c/T,      u = w⁺ + k1 y sgn β       c, y of β with h = T
        zone                     w⁺ = w + T c/h²,   u = w + c/h + k1 y sgn s  c, y of s with h = zone_time
        c = s limited to ±h² k2,   y = ½ (√(h² k1² + 4 (|s| - |c|)) - h k1)

    The zone is |s| <= h² k2.  Inside it this form is linear, a PID with a pole at -λ and a pair with the frequency 1/h
    and damping ½; outside it the gains fall, so the loop is never faster.  The form solves s ∈ z + h k1 √|z| sgn z
    + h² k2 Sgn z, u = (s - z)/h + w.  Without L the zone is unbounded, and the law is this PID.

    Additions to the papers: x' is the backward difference, and x_r' is differenced likewise; x_r'' is evaluated in the
    middle of the sample over which the force acts; the force cut off by the limit in the last sample enters w
    (back-calculation through `applied` and `requested`).  With two encoders x is read at the load and x' at the motor.

    Tune λ and 1/h like two frequencies; zone_time = 3.75 (d + 1) T at d samples of dead time gives Ms = 2 on a rigid
    axis.  Then choose L from the disturbance, and large enough that noise stays inside the zone, h² k2 >= 3 σ(s).
    When to use: to bound the rate of the force of a stiff PID.  Do not use it to gain more robustness than that of a
    PID of equal delay margin; a well-tuned loop hardly ever leaves the zone.  The explicit form always chatters.  The
    implicit form keeps an error of T F_d/(m λ), and chatters with a dead time of one sample or more.  A linear model
    shows neither effect: linearization is refused for the explicit form, and for the implicit form it is valid inside
    the zone only.
    Source: Levant 1993 (the law, and L); Brogliato, Polyakov & Efimov 2020 (the implicit form); the zone is specific to
    this library.
    """

    feeds = ("acceleration", "velocity")
    tunables = ("tracking_rate", "zone_time")
    title = "super-twisting"

    mass: Number = parameter("kg", "m: all that moves", above=0)
    viscous: Number = parameter("N s/m", "b: viscous friction of the guideway", least=0, default=0)
    tracking_rate: Number = parameter("1/s", "λ: rate at which the position error falls on the sliding line", above=0)
    zone_time: Number | None = parameter(
        "s",
        "h: inside the zone the force answers with the frequency 1/h; absent in the other forms",
        above=0,
        default=None,
    )
    disturbance_rate: Number | None = parameter(
        "m/s3", "L: largest rate of the disturbance over the mass; absent: a zone without end", above=0, default=None
    )
    root_factor: Number = parameter("", "k1/√L", above=0, default=1.5)
    sign_factor: Number = parameter("", "k2/L", above=0, default=1.1)
    form: str = choice("how the law is sampled", options=("zone", "implicit", "explicit"), default="zone")
    velocity_encoder: str = choice("encoder of the velocity", options=("motor", "load"), default="motor")

    @classmethod
    def begin(cls, axis: AxisModel, present: Law) -> tuple[Start, ...]:
        """Return one variant, in the zone form with slow starting values.

        L, and thus the width of the zone, is chosen for disturbances that change by 50 m/s² per millisecond, and is
        larger if the reading noise requires it.
        """
        zone_time = 0.6 / axis.rate
        # √2: the velocity is a difference of two readings
        noise = 1.4142135623730951 * axis.reading_noise / axis.sample_time
        # the tuning may make the zone narrower
        fastest = 0.25 * zone_time
        # h² k2 >= 3 σ(s), with k2 = 1.1 L
        rate = max(_USUAL, _QUIET * noise / (1.1 * fastest * fastest))
        law = begun(cls, axis, zone_time=zone_time, disturbance_rate=rate)
        return (Start(cls.title, law, Text(f"{axis.sentence()}; L = {Quantity(rate, 'm/s3')}")),)

    class Prepared(NamedTuple):
        """h (the sample time if `zone_time` is not specified), k1 and k2."""

        h: Number  # s
        k1: Number  # (m/s)^½ / s
        k2: Number  # m/s³

    class State(NamedTuple):
        """The last position of the velocity encoder (m), and w (m/s²)."""

        position: Number
        twist: Number

    def check(self) -> None:
        """Raise StructureError unless the form has the parameters that it needs, and no others."""
        if self.form == "zone" and self.zone_time is None:
            raise StructureError(f"{self.kind}.zone_time is missing: form = 'zone' needs it, in s")
        if self.form != "zone" and self.zone_time is not None:
            raise StructureError(
                f"{self.kind}.zone_time has no meaning with form = '{self.form}', whose step is the sample time: leave "
                f"it out, or take form = 'zone'"
            )
        if self.form == "explicit" and self.disturbance_rate is None:
            raise StructureError(f"{self.kind}.disturbance_rate is missing: form = 'explicit' needs it, in m/s3")

    def position_gain(self) -> Number:
        """Return the position gain λ in 1/s, as in s = λ e_x + e_v."""
        return self.tracking_rate

    def settled(self) -> Self:
        """Return the law with an unbounded zone."""
        return self if self.form == "explicit" else replace(self, disturbance_rate=None)

    def prepare(self, T: Number) -> Prepared:
        """Compute h, k1 and k2; without L, k1 and k2 are not used."""
        h = T if self.zone_time is None else self.zone_time
        if self.disturbance_rate is None:
            return self.Prepared(h, 0.0, 0.0)
        return self.Prepared(
            h, self.root_factor * ops.sqrt(self.disturbance_rate), self.sign_factor * self.disturbance_rate
        )

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state at rest at the measured position, with s = 0 and the acting force provided by w."""
        return self.State(reading.position(self.velocity_encoder), reading.applied / self.mass)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        position = reading.position(self.velocity_encoder)
        v = (position - state.position) / T
        e_v = setpoint.backward_velocity(T) - v
        s = self.tracking_rate * (setpoint.position - reading.position_load) + e_v
        w = state.twist + (reading.applied - reading.requested) / self.mass
        if self.form == "explicit":
            twist = w + T * prepared.k2 * ops.sign(s)
            u = prepared.k1 * ops.sqrt(ops.absolute(s)) * ops.sign(s) + w
        elif self.form == "implicit":
            held, beyond = self._split(prepared, s - T * w)
            twist = w + held / T
            u = twist + beyond
        else:
            held, beyond = self._split(prepared, s)
            twist = w + T * (held / prepared.h) / prepared.h
            u = w + held / prepared.h + beyond
        acceleration = setpoint.shifted(0.5 * T).acceleration
        force = self.mass * (acceleration + self.tracking_rate * e_v + u) + self.viscous * v
        return self.State(position, twist), force

    def _split(self, prepared: Prepared, s: Number) -> tuple[Number, Number]:
        """Return the part of s inside the zone (m/s) and the acceleration k1 y sgn s of the part beyond it (m/s²)."""
        if self.disturbance_rate is None:
            return s, 0.0
        h, k1, k2 = prepared
        zone = h * h * k2
        held = ops.clip(s, -zone, zone)
        beyond = ops.absolute(s) - ops.absolute(held)
        root = h * k1
        # ½ (√(root² + 4 beyond) - root), without the difference of two large numbers
        y = 2.0 * beyond / (root + ops.sqrt(root * root + 4.0 * beyond))
        return held, k1 * y * ops.sign(s)

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Rescale w so that the force m w stays continuous."""
        return state._replace(twist=state.twist * (old.mass / self.mass))

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the validity rule: inside the zone, the loop with the plant m x'' = F and no dead time is stable."""
        if self.form != "explicit":
            yield Rule(
                self._stable(1.0, T),
                "inside the zone the loop around a free mass, without any dead time, is stable with this rate and time",
                lambda: self._refusal(T),
            )

    def _stable(self, slower: Number, T: Number) -> Any:
        """Return True if the loop with the plant m x'' = F (F held) is stable with λ and 1/h multiplied by `slower`.

        In q = z⁻¹ and D = 1 - q, with l = λT and η = T/h, its polynomial is
        D³ + q (1 + q)/2 · [l D² + (D + l)(η D + η² q)]; for the implicit form it is D² + q (1 + q)/2 · [l D + D + l].
        With q = (1 - y)/(1 + y) the inside of the unit circle becomes the half plane Re y < 0.
        """
        l = slower * self.tracking_rate * T  # noqa: E741
        line, late = [l, 2.0 + l], [1.0, -1.0]
        if self.zone_time is None:
            inner = product(late, [line[0], line[1] + 2.0 * l])
            return is_stable([inner[0], inner[1], inner[2] + 4.0, 4.0])
        n = slower * T / self.zone_time
        inner = product(line, [n * n, 2.0 * n - n * n])
        outer = product(late, [inner[0], inner[1], inner[2] + 4.0 * l])
        return is_stable([*outer[:3], outer[3] + 8.0, 8.0])

    def _refusal(self, T: float) -> str:
        """Return the error message, which states how much slower the law must be."""
        share = largest_share(lambda slower: bool(self._stable(slower, T)))
        most = Quantity(share * self.tracking_rate, "1/s", bare=True)
        bounds = Text(f"tracking_rate = {Quantity(self.tracking_rate, '1/s'):6} (must be below {most})")
        if self.zone_time is not None:
            least = f"{Quantity(self.zone_time / share, 's', bare=True):SI}" if share > 0.0 else "a longer time"
            bounds += f", zone_time = {Quantity(self.zone_time, 's'):6 SI} (must be above {least})"
        return Text(
            f"{self.kind}: {bounds}: inside its zone the loop is unstable without any dead time at the sample time "
            f"{Quantity(T, 's'):6 SI}. Stay within these bounds together, or sample faster; zone_time = "
            f"{Quantity(3.75 * T, 's'):SI} times d + 1, with d samples of dead time, keeps Ms <= 2"
        )
