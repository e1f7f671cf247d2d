"""Files of the target `linuxcnc-pid`: .hal and .ini fragments, and a README with the expected differences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.controller.stock_biquad import StockBiquad
from feeddrive.blocks.controller.stock_pid import StockPid
from feeddrive.export.design import Design, require_alone
from feeddrive.export.identifiers import HAL_LENGTH
from feeddrive.export.linuxcnc import component
from feeddrive.export.manifest import readme, write_bundle
from feeddrive.export.parameters.quantities import SAFETY, Cascade, LostPart, kv_lines, numbers, read_cascade
from feeddrive.export.stock_pids import Difference, difference, left_out, require_stable_pids, stock_law, stock_loop
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import ParameterError

JOINTS = 16  # of a LinuxCNC
_LONGEST = ".velocity.do-pid-calcs.tmax-increased"  # name behind the axis's


def write_linuxcnc_pid(design: Design, out: Path, *, route: str = "two", units: float = 1000.0, joint: int = 0) -> Path:
    """Write the fragments, completely or not at all; returns the README.

    route  "two" pids in cascade, or "one"
    units  machine units in a meter: 1000 for mm
    joint  number of the joint in LinuxCNC

    Raises StructureError for another law than `cascade_ppi` and for a design that one pid cannot hold, ParameterError
    for a sample time that no thread can have, UnstableError if the loop with the pids is unstable, and FileError as
    `new_directory`.
    """
    if not 0 <= joint < JOINTS:
        raise ParameterError(f"joint = {joint} must be 0 to {JOINTS - 1}: LinuxCNC has {JOINTS} joints")
    require_alone(design, "linuxcnc-pid, to judge its pids,")
    cascade, period = read_cascade(design.loop), component.period(design.routine)
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
    """The name itself. Raises ParameterError if a HAL name that begins with it is too long."""
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
        "linuxcnc_pid.md.j2", design, name=name, pids=pids, safety=SAFETY, differs=differs, lost=lost,
        kv=kv_lines(gain),
    )  # fmt: skip


COEFFICIENTS = tuple(declarations(StockBiquad))
GAINS = tuple(name for name in declarations(StockPid) if name not in ("error_previous_target", "bias"))


def ini_fragment(cascade: Cascade, law: LinuxcncPid, joint: int, head: Sequence[str]) -> str:
    """Gains, limits and following error of a joint, for its .ini file."""
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
        lines += ["", "# limit of filtered feedback plus feedforward", f"LIMIT = {last.maxoutput or 1e20!r}"]
    return "\n".join(lines) + "\n"


def hal_fragment(cascade: Cascade, law: LinuxcncPid, name: str, joint: int, head: Sequence[str]) -> str:
    """The components of an axis, their wiring and settings; the user connects the pins of the drive."""
    two, encoders = law.velocity is not None, cascade.loop.axis.encoders()
    pids = [f"{name}.position", *[f"{name}.velocity"] * two]
    motor = cascade.loop.axis.actuator.motor
    unit = "N" if motor is None else motor.unit
    last = pids[-1]
    wires = [
        f"net {name}-enable  joint.{joint}.amp-enable-out => {' '.join(f'{pid}.enable' for pid in pids)}",
        f"net {name}-set     joint.{joint}.motor-pos-cmd => {name}.position.command",
        f"net {name}-set-v   joint.{joint}.vel-cmd => {name}.forward.in1",
        f"net {name}-set-a   joint.{joint}.acc-cmd => {name}.forward.in0",
        f"net {name}-forward {name}.forward.out => {last}.bias",
        f"net {name}-load    joint.{joint}.motor-pos-fb => {name}.position.feedback",
        f"net {name}-{'motor' if encoders == 2 else 'load'}   => {name}.speed.in" if two else "",
        f"net {name}-speed   {name}.speed.out => {name}.velocity.feedback" if two else "",
        f"net {name}-wanted  {name}.position.output => {name}.velocity.command" if two else "",
        f"net {name}-index   joint.{joint}.index-enable => {name}.position.index-enable",
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
        *(f"addf {each} servo-thread" for each in (sums[1:2] + filters + sums[2:] + [f"{name}.limit"] * bool(filters))),
        "",
        *(wire for wire in wires if wire),
        "",
        "# Connect by hand, with the names of your card; positions in machine units, seen at the table:",
        f"#   {name}-load     is written by the encoder {'at the table' if encoders == 2 else 'of the axis'}",
        *([f"#   {name}-motor    is written by the motor's encoder, scaled to travel of the table"] * (encoders == 2)),
        f"#   {name}-output   goes to the drive, in {unit}",
        f"#   joint.{joint}.amp-fault-in   is written by the drive's fault, so that it disables the pids",
        f"#   joint.{joint}.index-enable   goes to the encoder too, if it has an index",
        f"net {name}-output  {end}",
        "",
        *_settings(law, name, joint),
    ]
    return "\n".join(lines) + "\n"


def _filter_wires(law: LinuxcncPid, name: str, last: str) -> Iterator[str]:
    """The output of the last pid without feedforward goes through the filters; then the feedforward is added."""
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
    """Prefix of the keys in the .ini file, and the pid."""
    yield "POSITION", law.position
    if law.velocity is not None:
        yield "VELOCITY", law.velocity


def _settings(law: LinuxcncPid, name: str, joint: int) -> Iterator[str]:
    """The lines that give the pids their numbers."""
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
        yield from (f"setp {filter_}.{each} [JOINT_{joint}]FILTER_{i}_{each.upper()}" for each in COEFFICIENTS)
        yield f"setp {filter_}.enable 1"
    if law.filters:
        yield f"setp {name}.feedback.gain1 -1"
        yield f"setp {name}.limit.max [JOINT_{joint}]LIMIT"
        yield f"setp {name}.limit.min -[JOINT_{joint}]LIMIT"
