"""The target `linuxcnc-pid`: a P-PI design built from LinuxCNC's stock pid components, and remaining differences."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import require_stable, stability
from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.controller.stock_biquad import StockBiquad
from feeddrive.blocks.controller.stock_pid import StockPid
from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.biquad import Section
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.export.design import Design, require_alone
from feeddrive.export.drive_quantities import SAFETY, Cascade, LostPart, kv_lines, lost, numbers, read_cascade
from feeddrive.export.identifiers import HAL_LENGTH
from feeddrive.export.linuxcnc import servo_period
from feeddrive.export.targets import readme, write_bundle
from feeddrive.language import tree
from feeddrive.language.block import declarations
from feeddrive.language.errors import DivergedError, ParameterError, StructureError, UnstableError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate

# LinuxCNC's stock pids for a P-PI design: the gains that realize it, and the remaining differences.
#
# With c = units · force_per_output (machine units per meter, N per unit of the output), α = velocity_feedforward, b
# the law's `viscous`, and m, d the feedforward mass and viscous friction:
#
#     two pids   position  Pgain = Kv, FF1 = α                       its output is a velocity
#                velocity  Pgain = (Kp - b)/c, FF0 = b/c, Igain = Kp/(c Tn), maxoutput = force_limit / force_per_output
#                          bias = (m + d T/2)/c · joint acceleration + d/c · joint velocity      by sum2
#     one pid    Pgain = (Kp Kv + Kp/Tn)/c, Igain = Kp Kv/(c Tn), Dgain = (Kp - b)/c, FF1 = (α - 1) Kp/c + b/c + d/c,
#                FF2 = m/c; with filters d and m go by `bias`, as with two pids, so that they bypass them
#     filters    a biquad each, with the coefficients of the design's own step
#     weight     of a hanging axis, the guard's safe_force: bias of the last pid, by the same sum2
#
# One pid uses one encoder, since D differentiates the reading of P.  The integral of the velocity error is then that of
# the position error plus the position error itself, which needs α = 1 where there is a Tn.

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
    "velocity_lag": ("a pid does not smooth its velocity", ""),
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
    "velocity_limit": ("LinuxCNC limits the commanded, not the measured velocity", ""),
    "broken_readings": (
        "a pid does not check its input",
        "a NaN stays in the integral until the axis is disabled: let the encoder's fault disable it",
    ),
    "alignment": (
        "each pid reads its own encoder",
        "home both encoders to one zero, or the offset acts as a following error",
    ),
}
_LATE = (
    "FF2 differences the command twice",
    "the force for the acceleration comes one and a half samples late: an error of mass · jerk · 3T/2 in N",
)


def stock_law(cascade: Cascade, *, route: str = "two", units: float = 1000.0) -> LinuxcncPid:
    """Return the pid components of LinuxCNC that represent a design.

    route  "two" pids in cascade, or "one"
    units  machine units per meter: 1000 for mm, 1/0.0254 for inches

    Raises ParameterError for an unknown route and for a law whose `viscous` is not below its velocity gain, and
    StructureError if one pid cannot represent the design.
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
            f"control.law.viscous = {Quantity(back, 'N s/m'):6} must be below Kp = {Quantity(law.Kp, 'N s/m'):6}: "
            "their difference is the gain of a pid, which may not be negative"
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
    # the design feeds the velocity in the middle of the sample forward, v + a T/2, so that a carries d T/2
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
    """Return the coefficients of LinuxCNC's biquad for a filter of the design at sample time T in s."""
    prepared = block.prepare(T)
    if isinstance(prepared, Section):
        return StockBiquad(
            n0=prepared.b0,
            n1=prepared.b1,
            n2=prepared.b2,
            d1=prepared.b1 if prepared.a1 is None else prepared.a1,
            d2=prepared.a2,
        )
    if isinstance(prepared, LowPass.Prepared):
        return StockBiquad(n0=prepared.b, n1=prepared.b, d1=prepared.a)
    raise StructureError(
        f"control.filters: {block.kind} cannot be represented by a biquad of LinuxCNC; take the target linuxcnc"
    )


def period(loop: Loop) -> float:
    """Return the sample time in HAL, in s: a whole number of nanoseconds times 1e-9."""
    return round(loop.sample_time * 1e9) * 1e-9


def _check_one(cascade: Cascade) -> None:
    """Raise StructureError, with the reason, if one pid cannot represent the design."""
    law = cascade.law
    if cascade.loop.axis.encoders() == 2:
        raise StructureError(
            "the axis has two encoders, and one pid differences what it reads: the velocity loop would close on the "
            "table; take route = two"
        )
    if law.Tn is not None and law.velocity_feedforward != 1.0:
        raise StructureError(
            f"control.law.velocity_feedforward = {Quantity(law.velocity_feedforward):6} under an integral needs FF0, "
            "which pulls the axis towards position 0: take route = two, or velocity_feedforward = 1"
        )


def stock_loop(cascade: Cascade, law: LinuxcncPid) -> Loop:
    """Return the loop with LinuxCNC's pids in place of its controller, on the same axis, with the sample time of HAL.

    The guard is unchanged, except that a disabled axis gets zero force, which is the output of a disabled pid.
    """
    guard = cascade.loop.control.guard
    control = Control(law=law, guard=None if guard is None else replace(guard, safe_force=0.0))
    return replace(cascade.loop, control=control, sample_time=period(cascade.loop))


def left_out(cascade: Cascade, route: str = "two") -> tuple[LostPart, ...]:
    """Return the parts of a design that LinuxCNC's pids cannot represent."""
    late = route == "one" and not cascade.loop.control.filters
    outside = OUTSIDE | {"half_sample": _LATE} if late else OUTSIDE
    return tuple(row._replace(path=tree.in_paths(cascade.loop, row.path)) for row in lost(cascade, HELD, outside))


# half as many lines, or ten times as many, change no digit that the README prints
LINES = 1500  # number of frequencies of the loop gain, from 1 Hz to half the sample rate
_DWELL = 0.3  # s after a move, in which overshoot becomes visible


class Figure(NamedTuple):
    """A figure of merit of the design and of the stock pids; a value that is undefined is None."""

    what: str
    unit: str
    design: float | None
    stock: float | None


@dataclass(frozen=True)
class Difference:
    """The figures of merit of the design and of the stock pids, and the two test moves."""

    figures: tuple[Figure, ...]
    move: JerkLimitedMove
    saturating: JerkLimitedMove | None


def require_stable_pids(cascade: Cascade, stock: Loop, route: str, units: float) -> None:
    """Raise UnstableError if the loop with the pids is unstable; the message states stable gains if there are any."""
    require_stable(cascade.loop, where="the design")
    verdict = stability(stock)
    if verdict.stable:
        return
    hint = ""
    for share in np.linspace(0.95, 0.05, 19):
        # gains and integral frequency together: a slower loop of the same shape
        law = replace(
            cascade.law,
            Kv=cascade.law.Kv * share,
            Kp=cascade.law.Kp * share,
            Tn=None if cascade.law.Tn is None else cascade.law.Tn / share,
        )
        slower = replace(cascade.loop, control=replace(cascade.loop.control, law=law))
        values = {**cascade.values, "Kv": law.Kv, "Kp": law.Kp, "Tn": law.Tn}
        values["Kp/Tn"] = None if law.Tn is None else law.Kp / law.Tn
        trial = Cascade(slower, law, values)
        if stability(stock_loop(trial, stock_law(trial, route=route, units=units))).stable:
            integral = "" if law.Tn is None else f" and Tn = {Quantity(law.Tn, 's'):SI}"
            hint = (
                f"; with Kv = {Quantity(law.Kv, '1/s')}, Kp = {Quantity(law.Kp, 'N s/m')}{integral} "
                f"({Quantity(share, 'share'):.0f}) it would be at the limit of stability"
            )
            break
    raise UnstableError(
        f"this axis is unstable with LinuxCNC's pid, but not with the design: {verdict.sentence()}{hint}; see which "
        "parts it cannot represent, or export with the target linuxcnc, which computes the design itself"
    )


def difference(cascade: Cascade, stock: Loop) -> Difference:
    """Compare the design and the stock pids on the same axis in the same test moves."""
    move, saturating = moves(cascade.loop)
    figures = [*_margins(cascade.loop, stock)]
    designed, by_pid = (_run(loop, move) for loop in (cascade.loop, stock))
    figures += _along("a move", designed, by_pid)
    if saturating is not None:
        both = [_run(_free(loop), saturating) for loop in (cascade.loop, stock)]
        figures += _along("a move beyond the force limit", *both)
        figures.append(
            Figure(
                "largest following error after that move has ended",
                "um",
                *(_after(run, saturating) for run in both),
            )
        )
    return Difference(tuple(figures), move, saturating)


def moves(loop: Loop) -> tuple[JerkLimitedMove, JerkLimitedMove | None]:
    """Return a move that needs 40 % of the force limit and, if there is a limit, one that needs 150 %.

    The velocity is half of the velocity limit, at most 0.3 m/s; the acceleration rises in 20 ms, or in 5 ms for the
    second move; both moves stay within the travel.
    """
    guard, motor = loop.control.guard, loop.axis.actuator.motor
    mass, limit = float(loop.axis.plant.rigid_mass()), loop.control.force_limit
    speeds = [None if guard is None else guard.velocity_limit, None if motor is None else motor.velocity_limit()]
    velocity = min([0.3, *(0.5 * float(speed) for speed in speeds if speed is not None)])
    acceleration = 2.0 if limit is None else min(0.4 * limit / mass, 20.0)
    ends = (None, None) if guard is None else (guard.travel_least, guard.travel_most)
    first, distance = 0.0, 0.1
    if ends[0] is not None and ends[1] is not None:
        first, distance = 0.75 * ends[0] + 0.25 * ends[1], min(distance, 0.5 * (ends[1] - ends[0]))
    elif ends[0] is not None:
        first = ends[0] + 0.1
    elif ends[1] is not None:
        first = ends[1] - 0.2

    def move(acceleration: float, rise: float, *, back: bool) -> JerkLimitedMove:
        return JerkLimitedMove(
            distance=distance,
            start=first,
            velocity=velocity,
            acceleration=acceleration,
            jerk=acceleration / rise,
            back=back,
            dwell_after=_DWELL,
        )

    beyond = None if limit is None else move(1.5 * limit / mass, 0.005, back=False)
    return move(acceleration, 0.02, back=True), beyond


def _free(loop: Loop) -> Loop:
    """Return the loop without the guard's limit of the following error, which a saturated axis would exceed."""
    guard = loop.control.guard
    if guard is None:
        return loop
    return replace(loop, control=replace(loop.control, guard=replace(guard, following_error_limit=None)))


def _run(loop: Loop, move: JerkLimitedMove) -> Run | None:
    """Return the simulated run of a move; None if it diverges."""
    try:
        return simulate(loop, move, record=("set_velocity", "following_error", "force"))
    except DivergedError:
        return None


def _along(what: str, *runs: Run | None) -> list[Figure]:
    """Return the peak and RMS following errors and the peak forces of a move, run with the design and with the pids."""
    errors = [None if run is None else run["following_error"] for run in runs]
    peaks = [None if e is None else 1e6 * float(np.max(np.abs(e))) for e in errors]
    means = [None if e is None else 1e6 * float(np.sqrt(np.mean(e * e))) for e in errors]
    forces = [None if run is None else float(np.max(np.abs(run["force"]))) for run in runs]
    return [
        Figure(f"largest following error along {what}", "um", *peaks),
        Figure(f"RMS following error along {what}", "um", *means),
        Figure(f"largest force along {what}", "N", *forces),
    ]


def _after(run: Run | None, move: JerkLimitedMove) -> float | None:
    if run is None:
        return None
    ended = run.time >= move.dwell_before + move.leg_time
    return 1e6 * float(np.max(np.abs(run["following_error"][ended])))


def _margins(*loops: Loop) -> list[Figure]:
    """Return the crossover and margins of each loop, opened at the actuator and linearized for a sliding axis."""
    figures = []
    for loop in loops:
        frequency = np.geomspace(1.0, 0.5 / loop.sample_time, LINES)
        result = margins(loop_gain(loop, frequency))
        figures.append((result.crossover, result.phase_margin_deg, result.gain_increase_dB, result.sensitivity_peak))
    names = (("crossover", "Hz"), ("phase margin", "degrees"), ("gain may rise by", "dB"), ("Ms", "1"))
    return [Figure(name, unit, *pair) for (name, unit), pair in zip(names, zip(*figures, strict=True), strict=True)]


# Files of the target `linuxcnc-pid`: .hal and .ini fragments, and a README with the expected differences.

# EMCMOT_MAX_JOINTS of LinuxCNC 2.9
JOINTS = 16
_LONGEST = ".velocity.do-pid-calcs.tmax-increased"  # name after the axis name


def write_linuxcnc_pid(design: Design, out: Path, *, route: str = "two", units: float = 1000.0, joint: int = 0) -> Path:
    """Write the .hal and .ini fragments atomically and return the path of the README.

    route  "two" pids in cascade, or "one"
    units  machine units per meter: 1000 for mm
    joint  number of the joint in LinuxCNC

    Raises StructureError for a law other than `cascade_ppi` and for a design that one pid cannot represent,
    ParameterError for a sample time that no thread supports, UnstableError if the loop with the pids is unstable, and
    FileError as `new_directory` does.
    """
    if not 0 <= joint < JOINTS:
        raise ParameterError(f"joint = {joint} must be 0 to {JOINTS - 1}: LinuxCNC has {JOINTS} joints")
    require_alone(design, "linuxcnc-pid, to judge its pids,")
    cascade, period = read_cascade(design.loop), servo_period(design.routine)
    name = _checked(design.name.replace("_", "-"))
    law = stock_law(cascade, route=route, units=units)
    stock = stock_loop(cascade, law)
    require_stable_pids(cascade, stock, route, units)
    head = [
        f"{design.title}, by LinuxCNC's own components.",
        design.made_by,
        f"Servo thread: {period} ns.  Machine units in a meter: {units:g}.",
        "",
        *SAFETY,
    ]
    files = {
        f"{name}.hal": hal_fragment(cascade, law, name, joint, head),
        f"{name}.ini": ini_fragment(cascade, law, joint, head),
    }
    files["README.md"] = _readme(
        design, name, law, cascade.law.Kv, difference(cascade, stock), left_out(cascade, route)
    )
    return write_bundle(design, "linuxcnc-pid", out, files, route=route, units=units, joint=joint)


def _checked(name: str) -> str:
    """Return the name unchanged. Raises ParameterError if a HAL name with this prefix would be too long."""
    most = HAL_LENGTH - len(_LONGEST)
    if len(name) > most:
        raise ParameterError(
            f"'{name}' has {len(name)} characters, and '{name}{_LONGEST}' may have {HAL_LENGTH} in LinuxCNC's HAL: "
            f"take a name of at most {most}"
        )
    return name


def _readme(
    design: Design, name: str, law: LinuxcncPid, gain: float, differs: Difference, lost: Sequence[LostPart]
) -> str:
    pids = "one `pid`" if law.velocity is None else "two `pid`s in cascade, `ddt` for the motor's velocity"
    pids += f", a `biquad` for each of the {len(law.filters)} filter(s)" if law.filters else ""
    return readme(
        "linuxcnc_pid.md.j2",
        design,
        name=name,
        pids=pids,
        safety=SAFETY,
        differs=differs,
        lost=lost,
        kv=kv_lines(gain),
    )


COEFFICIENTS = tuple(declarations(StockBiquad))
GAINS = tuple(name for name in declarations(StockPid) if name not in ("error_previous_target", "bias"))


def ini_fragment(cascade: Cascade, law: LinuxcncPid, joint: int, head: Sequence[str]) -> str:
    """Return the .ini fragment of a joint: gains, limits and following error."""
    guard, units = cascade.loop.control.guard, float(law.units)
    lines = [*(f"# {line}".rstrip() for line in head), "", f"[JOINT_{joint}]"]
    if guard is not None and guard.following_error_limit is not None:
        limit = guard.following_error_limit * units
        lines += [
            "# Following error that trips, in machine units: the limit of the design, at rest and at full speed",
            f"FERROR = {limit!r}",
            f"MIN_FERROR = {limit!r}",
        ]
    if guard is not None:
        for name, end in (("MIN_LIMIT", guard.travel_least), ("MAX_LIMIT", guard.travel_most)):
            lines += [] if end is None else [f"{name} = {end * units!r}"]
    for prefix, pid in _pids(law):
        lines += ["", f"# pid on the {prefix.lower()}; limits of 0 are none"]
        lines += [f"{prefix}_{name.upper()} = {getattr(pid, name)!r}" for name in GAINS]
    lines += ["", "# gains of sum2 at the pin bias of the last pid: per joint acceleration, per joint velocity; offset"]
    last = law.position if law.velocity is None else law.velocity
    lines += [
        f"FORWARD_ACCELERATION = {law.acceleration_gain or 0.0!r}",
        f"FORWARD_VELOCITY = {law.velocity_gain or 0.0!r}",
        f"FORWARD_OFFSET = {last.bias!r}",
    ]
    for i, block in enumerate(law.filters):
        lines += ["", f"# biquad {i}: {numbers(cascade.loop.control.filters[i])}"]
        lines += [f"FILTER_{i}_{name.upper()} = {getattr(block, name)!r}" for name in COEFFICIENTS]
    if law.filters:
        # 0 is no limit to a pid, but a limit of 0 to limit1
        lines += ["", "# limit of filtered feedback plus feedforward", f"LIMIT = {last.maxoutput or 1e20!r}"]
    return "\n".join(lines) + "\n"


def hal_fragment(cascade: Cascade, law: LinuxcncPid, name: str, joint: int | None, head: Sequence[str]) -> str:
    """Return the .hal fragment of an axis: components, wiring and settings, without the pins of the drive.

    Without a joint (None) the signals of its pins have no source, and the settings are those of `[JOINT_0]`.
    """
    of_joint = "" if joint is None else f"joint.{joint}."

    def planner(pin: str) -> str:
        return of_joint and f"{of_joint}{pin} "

    two, encoders = law.velocity is not None, cascade.loop.axis.encoders()
    pids = [f"{name}.position", *[f"{name}.velocity"] * two]
    motor = cascade.loop.axis.actuator.motor
    unit = "N" if motor is None else motor.unit
    last = pids[-1]
    wires = [
        f"net {name}-enable  {planner('amp-enable-out')}=> {' '.join(f'{pid}.enable' for pid in pids)}",
        f"net {name}-set     {planner('motor-pos-cmd')}=> {name}.position.command",
        f"net {name}-set-v   {planner('vel-cmd')}=> {name}.forward.in1",
        f"net {name}-set-a   {planner('acc-cmd')}=> {name}.forward.in0",
        f"net {name}-forward {name}.forward.out => {last}.bias",
        f"net {name}-load    {planner('motor-pos-fb')}=> {name}.position.feedback",
        f"net {name}-{'motor' if encoders == 2 else 'load'}   => {name}.speed.in" if two else "",
        f"net {name}-speed   {name}.speed.out => {name}.velocity.feedback" if two else "",
        f"net {name}-wanted  {name}.position.output => {name}.velocity.command" if two else "",
        f"net {name}-index   {planner('index-enable')}=> {name}.position.index-enable" if of_joint else "",
        *_filter_wires(law, name, last),
    ]
    filters = [f"{name}.filter{i}" for i in range(len(law.filters))]
    sums = [f"{name}.forward", *([f"{name}.feedback", f"{name}.total"] if filters else [])]
    end = f"{name}.limit.out" if filters else f"{last}.output"
    lines = [
        *(f"# {line}".rstrip() for line in head),
        "",
        "# HAL loads all instances of a component by one command: join these names with those of other axes.",
        f"loadrt pid names={','.join(pids)}",
        *([f"loadrt ddt names={name}.speed"] if two else []),
        f"loadrt sum2 names={','.join(sums)}",
        *([f"loadrt biquad names={','.join(filters)}", f"loadrt limit1 names={name}.limit"] if filters else []),
        "",
        "# In this order: after reading the encoders and motion-controller, before writing to the drive:",
        *([f"addf {name}.speed servo-thread"] if two else []),
        f"addf {name}.forward servo-thread",
        *(f"addf {pid}.do-pid-calcs servo-thread" for pid in pids),
        *(
            f"addf {function} servo-thread"
            # in the order of the signal: any other would add a period of dead time
            for function in (sums[1:2] + filters + sums[2:] + [f"{name}.limit"] * bool(filters))
        ),
        "",
        *(wire for wire in wires if wire),
        "",
        "# Connect by hand, with the names of your card; positions in machine units, seen at the table:",
        f"#   {name}-load     is written by the encoder {'at the table' if encoders == 2 else 'of the axis'}",
        *([f"#   {name}-motor    is written by the motor's encoder, scaled to travel of the table"] * (encoders == 2)),
        f"#   {name}-output   goes to the drive, in {unit}",
        f"#   {of_joint}amp-fault-in   is written by the drive's fault, so that it disables the pids",
        f"#   {of_joint}index-enable   goes to the encoder too, if it has an index",
        f"net {name}-output  {end}",
        "",
        *_settings(law, name, joint or 0),
    ]
    return "\n".join(lines) + "\n"


def _filter_wires(law: LinuxcncPid, name: str, last: str) -> Iterator[str]:
    """Yield the wiring from the last pid through the filters to the sum with the feedforward."""
    if not law.filters:
        return
    ends = [f"{name}.feedback.out", *(f"{name}.filter{i}.out" for i in range(len(law.filters)))]
    starts = [*(f"{name}.filter{i}.in" for i in range(len(law.filters))), f"{name}.total.in0"]
    yield f"net {name}-forward => {name}.feedback.in1 {name}.total.in1"
    yield f"net {name}-unfiltered {last}.output => {name}.feedback.in0"
    yield from (
        f"net {name}-filter{i} {end} => {start}" for i, (end, start) in enumerate(zip(ends, starts, strict=True))
    )
    yield f"net {name}-total {name}.total.out => {name}.limit.in"


def _pids(law: LinuxcncPid) -> Iterator[tuple[str, StockPid]]:
    """Yield each pid with the prefix of its keys in the .ini file, as (prefix, pid)."""
    yield "POSITION", law.position
    if law.velocity is not None:
        yield "VELOCITY", law.velocity


def _settings(law: LinuxcncPid, name: str, joint: int) -> Iterator[str]:
    """Yield the HAL lines that set the parameters of pids, sums, filters and limit."""
    for prefix, pid in _pids(law):
        whole = f"{name}.{prefix.lower()}"
        yield from (f"setp {whole}.{gain} [JOINT_{joint}]{prefix}_{gain.upper()}" for gain in GAINS)
        yield "# 0: the error uses the present command; with 1, the default, that of the period before"
        yield f"setp {whole}.error-previous-target {int(pid.error_previous_target)}"
    yield f"setp {name}.forward.gain0 [JOINT_{joint}]FORWARD_ACCELERATION"
    yield f"setp {name}.forward.gain1 [JOINT_{joint}]FORWARD_VELOCITY"
    yield f"setp {name}.forward.offset [JOINT_{joint}]FORWARD_OFFSET"
    for i in range(len(law.filters)):
        filter_ = f"{name}.filter{i}"
        yield f"setp {filter_}.type 0"
        yield from (
            f"setp {filter_}.{coefficient} [JOINT_{joint}]FILTER_{i}_{coefficient.upper()}"
            for coefficient in COEFFICIENTS
        )
        yield f"setp {filter_}.enable 1"
    if law.filters:
        yield f"setp {name}.feedback.gain1 -1"
        yield f"setp {name}.limit.max [JOINT_{joint}]LIMIT"
        yield f"setp {name}.limit.min -[JOINT_{joint}]LIMIT"
