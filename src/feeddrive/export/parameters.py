"""Files of the target `parameters`: a text file per maker, halcmd lines, a CSV, and a README."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from feeddrive.analysis.stability import stability
from feeddrive.export.design import Design
from feeddrive.export.drive_quantities import (
    SAFETY,
    Cascade,
    DriveTrain,
    LostPart,
    drive_train,
    kv_lines,
    lost,
    numbers,
    read_cascade,
)
from feeddrive.export.linuxcnc_pid import COEFFICIENTS, GAINS, left_out, period, stock_law, stock_loop
from feeddrive.export.makers import NOT_CHECKED, ODRIVE, SINUMERIK, TWINCAT, Line, Maker, csv_text, lines_of
from feeddrive.export.manifest import readme, write_bundle
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.loop import Loop

MAKERS = {maker.key: maker for maker in (SINUMERIK, TWINCAT, ODRIVE)}
OTHERS = ("linuxcnc", "csv")

Row = TypeVar("Row", Line, LostPart)


class Part(NamedTuple):
    """A section of the README: the file of a maker, what it holds and lacks, or why it is absent."""

    title: str
    file: str = ""
    warning: Sequence[str] = ()
    lines: Sequence[Line] = ()
    missing: Sequence[LostPart] = ()
    absent: str = ""

    @property
    def unread(self) -> list[str]:
        """Names whose manual was not read, or whose unit is only the one in common use."""
        marks = ("NOT CHECKED", "in common use")
        return [line.name for line in self.lines if line.name and any(mark in line.source for mark in marks)]


def write_parameters(
    design: Design,
    out: Path,
    *,
    makers: Sequence[str] = (),
    lead: float | None = None,
    gear: float | None = None,
) -> Path:
    """Write the files, completely or not at all, and return the README.

    makers      of sinumerik, twincat, odrive, linuxcnc, csv; default: all that fit the axis
    lead, gear  of the screw (m, and turns of the motor in one turn of the screw), where the machine file does not
                state them

    Raises StructureError for another law than `cascade_ppi`; ParameterError for an unknown maker, for an axis whose
    motor is not known where a maker's units are those of its shaft, and for a linear motor where a maker has none;
    FileError as `new_directory`.
    """
    wanted = list(makers) or [*MAKERS, *OTHERS]
    for wanted_maker in wanted:
        if wanted_maker not in (*MAKERS, *OTHERS):
            raise ParameterError(f"maker '{wanted_maker}' is not known; there are {', '.join((*MAKERS, *OTHERS))}")
    cascade = read_cascade(design.loop)
    at_motor = [wanted_maker for wanted_maker in wanted if wanted_maker in MAKERS]
    train = drive_train(design.loop, lead, gear) if at_motor or lead is not None or gear is not None else None
    files: dict[str, str] = {}
    parts: list[Part] = []
    for wanted_maker in wanted:
        if wanted_maker in MAKERS:
            assert train is not None
            maker = MAKERS[wanted_maker]
            if maker.rotary and not train.rotary:
                reason = (
                    f"{wanted_maker} counts in turns of a motor, and axis.actuator.motor is direct: a linear motor, or "
                    f"a screw whose lead is not stated; give lead, or leave {wanted_maker} out"
                )
                reason = tree.in_paths(cascade.loop, reason)
                if makers:
                    raise ParameterError(reason)
                parts.append(Part(maker.title, absent=reason))
                continue
            lines, missing = lines_of(maker, cascade, train)
            lines, missing = _in_paths(cascade.loop, lines), _in_paths(cascade.loop, [*missing, *_lost(maker, cascade)])
            kept = tuple(b for i, b in enumerate(cascade.loop.control.filters) if not maker.filters(b, i).why)
            bare = replace(cascade.loop, control=replace(cascade.loop.control, filters=kept))
            warning = _warning(bare, cascade.loop)
            head = [maker.title, *warning, *_head(design, cascade, train), *maker.notes]
            files[f"{wanted_maker}.txt"] = _text(head, lines, maker.comment, maker.key)
            parts.append(Part(maker.title, f"{wanted_maker}.txt", warning, lines, missing))
        elif wanted_maker == "linuxcnc":
            lines, missing = halcmd_lines(cascade)
            lines, missing = _in_paths(cascade.loop, lines), _in_paths(cascade.loop, missing)
            title = "LinuxCNC's pid, as lines of halcmd"
            warning = _warning(stock_loop(cascade, stock_law(cascade, units=STOCK_UNITS)), cascade.loop)
            head = [title, *warning, *_head(design, cascade, None)]
            files["linuxcnc.txt"] = _text(head, lines, "#", wanted_maker)
            parts.append(Part(title, "linuxcnc.txt", warning, lines, missing))
        else:
            files["parameters.csv"] = csv_text(cascade, train, _head(design, cascade, train))
    files["README.md"] = readme(
        "parameters.md.j2",
        design,
        head=_head(design, cascade, train),
        parts=parts,
        not_checked=NOT_CHECKED.split(":")[0],
    )
    return write_bundle(design, "parameters", out, files, makers=wanted, lead=lead, gear=gear)


def _in_paths(loop: Loop, rows: Sequence[Row]) -> list[Row]:
    """Return lines or losses with the paths of the machine file."""
    return [row._replace(path=tree.in_paths(loop, row.path)) for row in rows]


def _head(design: Design, cascade: Cascade, train: DriveTrain | None) -> list[str]:
    """Return the head of each file: title, safety, Kv in four units, and the drive train."""
    lines = [f"{design.title}.", design.made_by, "", *SAFETY, "", *kv_lines(cascade.law.Kv)]
    if train is not None and train.lead is not None:
        lines.append(
            f"At the motor's shaft: lead {1e3 * train.lead:.6g} mm, gear {train.gear:.6g}, from {train.source}; "
            f"1 m of the table is {train.radians_per_metre:.6g} rad there"
        )
    elif train is not None:
        lines.append(f"Numbers are those of a linear motor: {train.source}.  For a screw give its lead.")
    return [*lines, ""]


def _text(head: Sequence[str], lines: Sequence[Line], comment: str, key: str) -> str:
    """Return the file of a maker: one number a line, with its meaning and source in comments above."""
    out = [f"{comment} {line}".rstrip() for line in head]
    before = "setp " if key == "linuxcnc" else ""
    join = " " if key == "linuxcnc" else " = "
    for line in lines:
        unit = f" [{line.unit}]" if line.unit else ""
        out += ["", f"{comment} {line.meaning}{unit}"]
        if line.path:
            out.append(f"{comment} from {line.path} = {line.si}" if line.si else f"{comment} from {line.path}")
        if line.source:
            out.append(f"{comment} {line.source}")
        if line.name:
            out.append(f"{before}{line.name}{join}{line.text}")
    return "\n".join(out) + "\n"


def _lost(maker: Maker, cascade: Cascade) -> list[LostPart]:
    """Return the parts of the design that a maker cannot represent: filters one by one, the rest by kind."""
    parts = list(lost(cascade, (*maker.held, "filters"), maker.outside))
    for i, block in enumerate(cascade.loop.control.filters):
        why = maker.filters(block, i).why
        if why:
            parts += [
                part._replace(why=why)
                for part in lost(cascade, maker.held, maker.outside)
                if part.path == f"control.filters.{i}"
            ]
    return [*parts, *maker.always]


def _warning(bare: Loop, whole: Loop) -> list[str]:
    """Return a warning if the loop is stable as designed but unstable with the numbers of a file alone."""
    if bare is whole or not stability(whole).stable:
        return []
    verdict = stability(bare)
    if verdict.stable:
        return []
    return [
        f"UNSTABLE WITH THESE NUMBERS ALONE: {verdict.sentence()!s}.  Filters of the design are missing: see README.md."
    ]


STOCK_UNITS = 1000.0  # machine units in a meter: mm
_SOURCE = "LinuxCNC manual page pid(9); tested bit for bit against the component of LinuxCNC 2.9"
_BIQUAD = "LinuxCNC manual page biquad(9); tested as the pids; it stands between two sum2, see the target linuxcnc-pid"
_MEANINGS = {
    "position.Pgain": ("1/s, that is (mm/s)/mm", "position gain", "control.law.Kv"),
    "position.FF1": ("(mm/s)/(mm/s)", "share of the set velocity", "control.law.velocity_feedforward"),
    "velocity.Pgain": ("output/(mm/s)", "velocity gain", "control.law.Kp"),
    "velocity.Igain": ("output/mm", "velocity gain over integral time", "control.law.Kp / control.law.Tn"),
    "velocity.FF0": ("output/(mm/s)", "compensation of the viscous friction by the law", "control.law.viscous"),
    "velocity.maxoutput": ("output", "limit of the output", "control.force_limit"),
}


def halcmd_lines(cascade: Cascade) -> tuple[list[Line], list[LostPart]]:
    """Return the settings of the two pids and of their bias; zeros that are the default are left out."""
    law = stock_law(cascade, units=STOCK_UNITS)
    assert law.velocity is not None
    lines = list(_gains(cascade, "position", law.position)) + list(_gains(cascade, "velocity", law.velocity))
    for name, value, unit, quantity in (
        ("forward.gain0", law.acceleration_gain, "output/(mm/s^2)", "mass"),
        ("forward.gain1", law.velocity_gain, "output/(mm/s)", "viscous"),
    ):
        if value:
            meaning = f"gain of sum2 at velocity.bias: {quantity} that is fed forward"
            si = f"{cascade.values[quantity] or 0.0!r} {'kg' if quantity == 'mass' else 'N s/m'}"
            lines.append(Line(name, f"{value:.9g}", unit, meaning, f"control.feedforward, {quantity}", si, _SOURCE))
    if law.velocity.bias:
        si = f"{cascade.values['weight']!r} N"
        meaning = "offset of the same sum2: the weight of a hanging axis"
        value = f"{law.velocity.bias:.9g}"
        lines.append(Line("forward.offset", value, "output", meaning, "control.guard.safe_force", si, _SOURCE))
    for i, (block, design) in enumerate(zip(law.filters, cascade.loop.control.filters, strict=True)):
        for name in COEFFICIENTS:
            meaning = f"biquad {i}, type 0, at a period of {1e3 * period(cascade.loop):.6g} ms: {numbers(design)}"
            value = getattr(block, name)
            lines.append(Line(f"filter{i}.{name}", f"{value:.17g}", "", meaning, f"control.filters.{i}", "", _BIQUAD))
    output = f"The output is in {_unit(cascade)}; 1 of it is {float(law.force_per_output):.6g} N at the table."
    lines.insert(0, Line("", "", "", output, "", "", ""))
    return lines, list(left_out(cascade))


def _gains(cascade: Cascade, name: str, pid: object) -> Iterator[Line]:
    for gain in GAINS:
        value, key = getattr(pid, gain), f"{name}.{gain}"
        if value and key in _MEANINGS:
            unit, meaning, path = _MEANINGS[key]
            yield Line(key, f"{value:.9g}", unit, meaning, path, _si(cascade, path), _SOURCE)
    yield Line(f"{name}.error-previous-target", "0", "bit", "error against the present command", "", "", _SOURCE)


def _si(cascade: Cascade, path: str) -> str:
    """Return the value in the machine file, in SI."""
    values = {
        "control.law.Kv": ("Kv", "1/s"),
        "control.law.velocity_feedforward": ("velocity_feedforward", ""),
        "control.law.Kp": ("Kp", "N s/m"),
        "control.law.Kp / control.law.Tn": ("Kp/Tn", "N/m"),
        "control.force_limit": ("force_limit", "N"),
    }
    if path == "control.law.viscous":
        return f"{cascade.law.viscous!r} N s/m"
    quantity, unit = values[path]
    return f"{cascade.values[quantity]!r} {unit}".rstrip()


def _unit(cascade: Cascade) -> str:
    motor = cascade.loop.axis.actuator.motor
    return "N" if motor is None else motor.unit
