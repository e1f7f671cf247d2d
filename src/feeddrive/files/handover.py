"""Files for other tools: an FRF, a linear model, a run or a log as a MATLAB or CSV file; LinuxCNC compensation tables.

    fd.files.write_mat("model.mat", fd.linearize(loop, ["set_position"], ["position_load"]))
    >> m = load("model.mat");  sys = ss(m.A, m.B, m.C, m.D, m.sample_time_s);

All numbers are in SI units and are preserved bit for bit.
"""

import io
import re
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.files.frf import write_frf
from feeddrive.files.log import Log
from feeddrive.files.run_files import write_run_csv
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.simulate import Run

Handed: TypeAlias = FRF | StateSpace | Run | Log
_NAME = 63  # letters of a name in MATLAB


def write_mat(path: str | Path, source: Handed) -> None:
    """Write a MATLAB file (version 5), completely or not at all.

        FRF          frequency_Hz, response (complex), input, output, unit; coherence, variance, sample_time_s if known
        StateSpace   A, B, C, D, sample_time_s, states, inputs, outputs
        Run, Log     time_s, sample_time_s, a column for each signal, units.SIGNAL

    Characters that MATLAB does not allow in a name become _.  Raises FileError, or ParameterError for any other type.
    """
    from scipy.io import savemat

    # Into memory first, so that a failure of savemat leaves no partial file.
    content = io.BytesIO()
    savemat(content, _variables(source), oned_as="column", long_field_names=True)
    write_whole(path, content.getvalue())


def write_csv(path: str | Path, source: Handed) -> None:
    """Write a CSV file, completely or not at all, with the fewest digits that reproduce each number exactly.

        FRF          the format of `write_frf`
        StateSpace   matrix, row, column, value; names and sample time in comments
        Run, Log     time and signals with their units in the headers

    Raises FileError, or ParameterError for any other type.
    """
    if isinstance(source, FRF):
        write_frf(path, source)
    elif isinstance(source, StateSpace):
        write_whole(path, _matrices(source))
    elif isinstance(source, Run):
        write_run_csv(path, source.time, source.signals, source.units)
    elif isinstance(source, Log):  # pyright: ignore[reportUnnecessaryIsInstance]
        write_run_csv(path, source.time, source.channels, source.units)
    else:
        raise _refused(source)


def _matrices(model: StateSpace) -> str:
    lines = [f"# {name}: {', '.join(getattr(model, name))}" for name in ("states", "inputs", "outputs")]
    lines += [f"# sample_time_s: {model.sample_time!r}", "matrix,row,column,value"]
    for name in "ABCD":
        for (i, j), value in np.ndenumerate(getattr(model, name)):
            lines.append(f"{name},{i + 1},{j + 1},{float(value)!r}")
    return "\n".join(lines) + "\n"


def _variables(source: Any) -> dict[str, Any]:
    if isinstance(source, FRF):
        known = {"coherence": source.coherence, "variance": source.variance, "sample_time_s": source.sample_time}
        named = {"input": source.input, "output": source.output, "unit": source.unit}
        return {
            "frequency_Hz": source.frequency,
            "response": source.response,
            **named,
            **{name: value for name, value in known.items() if value is not None},
        }
    if isinstance(source, StateSpace):
        # an array of objects becomes a cell array; one of texts a char matrix, padded with blanks
        names = {name: np.array(getattr(source, name), dtype=object) for name in ("states", "inputs", "outputs")}
        return {**{name: getattr(source, name) for name in "ABCD"}, "sample_time_s": source.sample_time, **names}
    if isinstance(source, Run | Log):
        columns = source.signals if isinstance(source, Run) else source.channels
        taken = {"time_s": source.time, "sample_time_s": source.sample_time}
        units: dict[str, str] = {}
        for column, values in columns.items():
            name = _free(column, taken)
            taken[name], units[name] = values, source.units.get(column, "")
        return {**taken, "units": units}
    raise _refused(source)


def _free(column: str, taken: dict[str, Any]) -> str:
    """Return a unique variable name that is valid in MATLAB."""
    name = re.sub(r"\W", "_", column, flags=re.ASCII)
    # A name in MATLAB must begin with a letter.
    name = (name if name[:1].isalpha() else f"x{name}")[:_NAME]
    free, count = name, 2
    while free in taken or free == "units":
        # room for an underscore and a count of five digits within the limit
        free, count = f"{name[: _NAME - 6]}_{count}", count + 1
    return free


def _refused(source: Any) -> ParameterError:
    kinds = "an FRF, a StateSpace (fd.linearize), a Run or a Log"
    return ParameterError(f"{kinds} can be written, not a {type(source).__name__}: take its part that is one of these")


MOST = 256  # rows that LinuxCNC reads
_MOST_BYTES = 1_000_000


def comp_text(block: PitchCompensation, *, units: float = 1000.0, file_type: int = 0) -> str:
    """Return the text of a compensation file; each row gives nominal, forward and reverse values in machine units.

    units      machine units per meter: 1000 for mm
    file_type  COMP_FILE_TYPE of the joint. 0: positions actually reached in forward and in reverse motion;
               1: corrections to be added
    Raises ParameterError for any other `file_type` and for more rows than LinuxCNC reads.
    """
    if file_type not in (0, 1):
        raise ParameterError(f"file_type = {file_type} must be 0 (positions reached) or 1 (what is added)")
    count = len(block.forward)
    if count > MOST:
        raise ParameterError(f"the compensation has {count} entries, and LinuxCNC reads {MOST}: learn a coarser one")
    nominal = block.table_start + block.spacing * np.arange(count)
    columns = [nominal, block.forward, block.backward]
    if file_type == 0:
        # LinuxCNC subtracts the positions of type 0 from the nominal one, so that the added correction is their
        # difference.
        columns = [nominal, nominal - block.forward, nominal - block.backward]
    return "".join(" ".join(f"{units * float(x):.9f}" for x in row) + "\n" for row in zip(*columns, strict=True))


def write_comp_file(block: PitchCompensation, path: str | Path, *, units: float = 1000.0, file_type: int = 0) -> Path:
    """Write a compensation file, completely or not at all. Raises FileError, and ParameterError as `comp_text` does."""
    place = Path(path)
    write_whole(place, comp_text(block, units=units, file_type=file_type))
    return place


def read_comp_file(path: str | Path, *, units: float = 1000.0, file_type: int = 0) -> PitchCompensation:
    """Read a compensation file in machine units; `units` is the number of machine units per meter.

    LinuxCNC accepts any increasing positions; this function requires evenly spaced ones, as written by
    `write_comp_file`. Raises FileError, with the line, for a row without three numbers, for positions that do not
    increase by a constant spacing and for fewer than two rows; raises ParameterError for any other `file_type`.
    """
    if file_type not in (0, 1):
        raise ParameterError(f"file_type = {file_type} must be 0 (positions reached) or 1 (what is added)")
    place, rows = Path(path), list[list[float]]()
    for line, text in enumerate(read_whole(place, _MOST_BYTES).decode("utf-8", "replace").splitlines(), 1):
        if not text.strip():
            continue
        try:
            row = [float(word) for word in text.split()]
        except ValueError:
            row = []
        if len(row) != 3 or not np.all(np.isfinite(row)):
            raise FileError(
                f"{place}:{line}: '{text.strip()[:60]}' is no row of three numbers: nominal forward reverse"
            )
        if rows and row[0] <= rows[-1][0]:
            raise FileError(
                f"{place}:{line}: nominal {Quantity(row[0]):6} does not lie above {Quantity(rows[-1][0]):6}: sort the "
                "rows by the position"
            )
        rows.append(row)
    if len(rows) < 2:
        raise FileError(f"{place}: has {len(rows)} rows: a table needs two at least")
    table = np.array(rows) / units
    steps = np.diff(table[:, 0])
    spacing = float(table[-1, 0] - table[0, 0]) / (len(rows) - 1)
    # rows have nine decimals, so that their rounding stays far below a thousandth of the spacing
    uneven = np.flatnonzero(np.abs(steps - spacing) > 1e-3 * spacing)
    if uneven.size:
        raise FileError(
            f"{place}: rows {uneven[0] + 1} and {uneven[0] + 2} are {Quantity(units * steps[uneven[0]]):6} apart, not "
            f"{Quantity(units * spacing):6} as in the mean: give rows at one spacing"
        )
    added = table[:, 1:] if file_type == 1 else table[:, :1] - table[:, 1:]
    return PitchCompensation(
        forward=added[:, 0].copy(), backward=added[:, 1].copy(), table_start=float(table[0, 0]), spacing=spacing
    )
