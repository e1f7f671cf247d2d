"""Gains of LinuxCNC's `pid` that realize a P-PI design, by one pid or by two, and what they cannot realize.

With c = units · force_per_output (machine units in a meter, N per unit of the output), α = velocity_feedforward, b the
law's own `viscous`, and m, d the mass and viscous friction that are fed forward:

    two pids   position  Pgain = Kv, FF1 = α                       its output is a velocity
               velocity  Pgain = (Kp - b)/c, FF0 = b/c, Igain = Kp/(c Tn), maxoutput = force_limit / force_per_output
                         bias = (m + d T/2)/c · joint acceleration + d/c · joint velocity      by sum2
    one pid    Pgain = (Kp Kv + Kp/Tn)/c, Igain = Kp Kv/(c Tn), Dgain = (Kp - b)/c, FF1 = (α - 1) Kp/c + b/c + d/c,
               FF2 = m/c; with filters d and m go by `bias`, as with two pids, so that they bypass them
    filters    a biquad each, with the coefficients of the design's own step
    weight     of a hanging axis, the guard's safe_force: bias of the last pid, by the same sum2

One pid takes one encoder, since its D differences what P reads.  The integral of the velocity error is then that of the
position error plus the position error itself, which needs α = 1 where there is a Tn.
"""

from __future__ import annotations

from dataclasses import replace

from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.controller.stock_biquad import StockBiquad
from feeddrive.blocks.controller.stock_pid import StockPid
from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.biquad import Section
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.export.parameters.quantities import Cascade
from feeddrive.export.parameters.unsupported import Lost, lost
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

ROUTES = ("two", "one")
_PER_PERIOD = "a pid differences over one period"
HELD = (
    "inertia",
    "viscous_feedforward",
    "viscous",
    "force_limit",
    "following_error_limit",
    "travel",
    "filters",
)
OUTSIDE = {
    "velocity_samples": (_PER_PERIOD, ""),
    "velocity_encoder": ("the second pid is wired to the motor's encoder", "wire the load's encoder to ddt by hand"),
    "position_every": ("both pids run in one thread", "the position loop runs every sample: margins are larger"),
    "back_calculation": (
        "a pid stops its integral while the last output was at the limit and the error has its sign",
        "",
    ),
    "half_sample": (
        "the joint's acceleration and velocity are those of the sample",
        "the force for the acceleration comes half a sample late: an error of mass · jerk · T/2 in N",
    ),
    "safe_force": (
        "a pid that runs carries the weight by its bias, but one that is disabled gives 0",
        "the brake must hold before the joint is disabled",
    ),
    "velocity_limit": ("LinuxCNC limits what it commands, not what is measured", ""),
    "broken_readings": (
        "a pid computes with whatever it reads",
        "a NaN stays in the integral until the axis is disabled: let the encoder's fault disable it",
    ),
    "alignment": (
        "the pids read two encoders side by side",
        "home both encoders to one zero, or the offset acts as a following error",
    ),
}
_LATE = (
    "FF2 differences the command twice",
    "the force for the acceleration comes one and a half samples late: an error of mass · jerk · 3T/2 in N",
)


def stock_law(cascade: Cascade, *, route: str = "two", units: float = 1000.0) -> LinuxcncPid:
    """The pids of a design.

    route  "two" pids in cascade or "one"
    units  machine units in a meter: 1000 for mm, 1/0.0254 for inches

    Raises ParameterError for an unknown route and for a law that gives back more friction than its velocity gain, and
    StructureError where one pid cannot hold the design.
    """
    if route not in ROUTES:
        raise ParameterError(f"route = '{route}' must be one of {', '.join(ROUTES)}")
    law, control, value = cascade.law, cascade.loop.control, cascade.values
    motor = cascade.loop.axis.actuator.motor
    per_output = 1.0 if motor is None else float(motor.force_per_unit())
    c = units * per_output
    back = law.viscous or 0.0
    if back >= law.Kp:
        raise ParameterError(
            f"control.law.viscous = {back:g} N s/m must be below Kp = {law.Kp:g} N s/m: their difference is the gain "
            f"of a pid, which may not be negative"
        )
    bias = (value["weight"] or 0.0) / per_output
    mass, viscous = value["mass"] or 0.0, value["viscous"] or 0.0
    integral = value["Kp/Tn"] or 0.0
    limit = 0.0 if control.force_limit is None else control.force_limit / per_output
    filters = tuple(biquad(block, period(cascade.loop)) for block in control.filters)
    if route == "two":
        position = StockPid(Pgain=law.Kv, FF1=law.velocity_feedforward, error_previous_target=False)
        velocity = StockPid(
            Pgain=(law.Kp - back) / c,
            Igain=integral / c,
            FF0=back / c,
            maxoutput=limit,
            bias=bias,
            error_previous_target=False,
        )
    else:
        _check_one(cascade)
        own = ((law.velocity_feedforward - 1.0) * law.Kp + back) / c
        velocity = None
        position = StockPid(
            Pgain=(law.Kp * law.Kv + integral) / c,
            Igain=law.Kv * integral / c,
            Dgain=(law.Kp - back) / c,
            FF1=own if filters else own + viscous / c,
            FF2=0.0 if filters else mass / c,
            maxoutput=limit,
            bias=bias,
            error_previous_target=False,
        )
    by_bias = velocity is not None or bool(filters)
    half = 0.5 * cascade.loop.sample_time
    return LinuxcncPid(
        position=position,
        velocity=velocity,
        filters=filters,
        units=units,
        force_per_output=per_output,
        acceleration_gain=(mass + half * viscous) / c if by_bias else None,
        velocity_gain=viscous / c if by_bias else None,
    )


def biquad(block: Filter, T: float) -> StockBiquad:
    """A filter of the design as coefficients of LinuxCNC's biquad, at a period of T s."""
    made = block.prepare(T)
    if isinstance(made, Section):
        return StockBiquad(n0=made.b0, n1=made.b1, n2=made.b2, d1=made.b1 if made.a1 is None else made.a1, d2=made.a2)
    if isinstance(made, LowPass.Prepared):
        return StockBiquad(n0=made.b, n1=made.b, d1=made.a)
    raise StructureError(f"control.filters: {block.kind} is no biquad of LinuxCNC; take the target linuxcnc")


def period(loop: Loop) -> float:
    """The sample time in HAL, s: whole nanoseconds times 1e-9."""
    return round(loop.sample_time * 1e9) * 1e-9


def _check_one(cascade: Cascade) -> None:
    """One pid can hold the design. Raises StructureError that says why it cannot."""
    law = cascade.law
    if cascade.loop.axis.encoders() == 2:
        raise StructureError(
            "the axis has two encoders, and one pid differences what it reads: the velocity loop would close on the "
            "table; take route = two"
        )
    if law.Tn is not None and law.velocity_feedforward != 1.0:
        raise StructureError(
            f"control.law.velocity_feedforward = {law.velocity_feedforward:g} under an integral needs FF0, which pulls "
            f"the axis towards position 0: take route = two, or velocity_feedforward = 1"
        )


def stock_loop(cascade: Cascade, law: LinuxcncPid) -> Loop:
    """The loop with LinuxCNC's pids in the place of its control, on the same axis at HAL's period.

    Its guard stays, but for the force on a disabled axis: a disabled pid gives 0.
    """
    guard = cascade.loop.control.guard
    control = Control(law=law, guard=None if guard is None else replace(guard, safe_force=0.0))
    return replace(cascade.loop, control=control, sample_time=period(cascade.loop))


def left_out(cascade: Cascade, route: str = "two") -> tuple[Lost, ...]:
    """What LinuxCNC's pids do not hold of a design."""
    late = route == "one" and not cascade.loop.control.filters
    outside = OUTSIDE | {"half_sample": _LATE} if late else OUTSIDE
    return tuple(row._replace(path=tree.in_paths(cascade.loop, row.path)) for row in lost(cascade, HELD, outside))
