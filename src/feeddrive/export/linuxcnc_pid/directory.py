"""The target `linuxcnc-pid`: .hal and .ini fragments, and a README that says how the axis will differ."""

from __future__ import annotations

from pathlib import Path

from feeddrive.blocks.controller.linuxcnc_pid import LinuxcncPid
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.export.cascade.beside import table
from feeddrive.export.cascade.quantities import read_cascade
from feeddrive.export.cascade.safety import SAFETY, kv_lines
from feeddrive.export.design import MACHINE_FILE, Design
from feeddrive.export.identifiers import HAL_LENGTH
from feeddrive.export.linuxcnc import names
from feeddrive.export.linuxcnc_pid.comparison import Difference, difference, require_stable_pids
from feeddrive.export.linuxcnc_pid.fragments import hal_fragment, ini_fragment
from feeddrive.export.linuxcnc_pid.mapping import left_out, stock_law, stock_loop
from feeddrive.export.manifest import FILE, manifest_text
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import ParameterError

JOINTS = 16  # of a LinuxCNC
_LONGEST = ".velocity.do-pid-calcs.tmax-increased"  # name behind the axis's


def write_linuxcnc_pid(design: Design, out: Path, *, route: str = "two", units: float = 1000.0, joint: int = 0) -> Path:
    """Write the fragments, whole or not at all; the README is returned.

    route  "two" pids in cascade, or "one"
    units  machine units in a meter: 1000 for mm
    joint  number of the joint in LinuxCNC

    Raises StructureError for a law that is no `cascade_ppi` and for a design that one pid cannot hold, ParameterError
    for a sample time that no thread can have, UnstableError if the pids do not hold the axis, and FileError as
    `new_directory`.
    """
    if not 0 <= joint < JOINTS:
        raise ParameterError(f"joint = {joint} must be 0 to {JOINTS - 1}: LinuxCNC has {JOINTS} joints")
    cascade, period = read_cascade(design.loop), names.period(design.routine)
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
        MACHINE_FILE: design.machine.file.text,
    }
    lost = table(left_out(cascade, route))
    files["README.md"] = _readme(design, name, law, cascade.law.Kv, difference(cascade, stock), lost)
    files[FILE] = manifest_text(design, "linuxcnc-pid", files, route=route, units=units, joint=joint)
    with new_directory(out) as folder:
        for each, content in files.items():
            (folder / each).write_text(content, encoding="utf-8")
    return out / "README.md"


def _checked(name: str) -> str:
    """The name. Raises ParameterError if a name in HAL that begins with it is too long."""
    most = HAL_LENGTH - len(_LONGEST)
    if len(name) > most:
        raise ParameterError(
            f"'{name}' has {len(name)} characters, and '{name}{_LONGEST}' may have {HAL_LENGTH} in LinuxCNC's HAL: "
            f"take a name of at most {most}"
        )
    return name


def _readme(design: Design, name: str, law: LinuxcncPid, gain: float, differs: Difference, lost: str) -> str:
    move, beyond = differs.move, differs.saturating
    and_beyond = "" if beyond is None else f"; the one beyond the force limit is {_sentence(beyond)}, without a trip"
    pids = "one `pid`" if law.velocity is None else "two `pid`s in cascade, `ddt` for the motor's velocity"
    pids += f", a `biquad` for each of the {len(law.filters)} filter(s)" if law.filters else ""
    return f"""\
# {design.title}

{design.made_by}

By components that every LinuxCNC has: {pids}, and `sum2` for what is fed forward.
`{name}.hal` loads, orders, wires and sets them; `{name}.ini` holds the numbers.  Take both into the files of your
machine; what is yours to connect is said in `{name}.hal`.  Nothing is compiled.

{chr(10).join(SAFETY)}

## How it differs from the design

The pids are simulated as they are, bit for bit, on the axis of the machine file, beside the control that was designed.
The move is {_sentence(move)}{and_beyond}.
Margins are those of the loop opened at the actuator, sliding at 50 mm/s.

{differs.markdown()}
## What is not held

{lost}
## Traps of this component

- `error-previous-target` is on in a fresh HAL: the error is then taken against the command of one period before.  The
  fragment switches it off.
- At a limit the integral stands still while the error points into it, judged by the output of one period before; what
  it holds is not taken back.  See the row after the move beyond the limit.
- A limit of 0 is no limit.
- `maxerror` acts before `deadband`, and the D term sees neither: it is the command's rate less the feedback's.
- A NaN in the feedback stays in the integral until `enable` falls.
- `ddt` differences its input from 0 in its first period: enable comes later than that in a running machine.
- An index pulse moves the encoder's position in one period: `ddt` shows that as a speed, and a pid whose
  `index-enable` is not wired does too.  Home at low torque.
- A disabled pid gives 0, while filters and what is fed forward go on: let the enable of the joint switch the drive off.

## Kv

{chr(10).join(f"- {line}" for line in kv_lines(gain))}
"""


def _sentence(move: JerkLimitedMove) -> str:
    limits = f"{move.velocity:.3g} m/s, {move.acceleration:.3g} m/s², {move.jerk:.0f} m/s³"
    return f"{1e3 * move.distance:g} mm{' and back' if move.back else ''} at {limits}"
