"""Export to other tools: MATLAB and CSV files of an FRF, a linear model, a run or a log.

    fd.files.write_mat("model.mat", fd.linearize(loop, ["set_position"], ["position_load"]))
    >> m = load("model.mat");  sys = ss(m.A, m.B, m.C, m.D, m.sample_time_s);

All numbers are in SI and are preserved bit for bit.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from feeddrive.files.atomic_io import write_whole
from feeddrive.files.frf import write_frf
from feeddrive.files.log import Log
from feeddrive.files.run_files import write_run_csv
from feeddrive.language.errors import ParameterError
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

    Characters that MATLAB does not allow in a name become _.  Raises FileError; ParameterError for any other type.
    """
    from scipy.io import savemat

    content = io.BytesIO()
    savemat(content, _variables(source), oned_as="column", long_field_names=True)
    write_whole(path, content.getvalue())


def write_csv(path: str | Path, source: Handed) -> None:
    """Write a CSV file, completely or not at all, with the fewest digits that reproduce each number exactly.

        FRF          as `write_frf`
        StateSpace   matrix, row, column, value; names and sample time in comments
        Run, Log     time and signals with their units in the headers

    Raises FileError; ParameterError for any other type.
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
    """Return a unique name that is valid in MATLAB."""
    name = re.sub(r"\W", "_", column, flags=re.ASCII)
    name = (name if name[:1].isalpha() else f"x{name}")[:_NAME]
    free, count = name, 2
    while free in taken or free == "units":
        free, count = f"{name[: _NAME - 6]}_{count}", count + 1
    return free


def _refused(source: Any) -> ParameterError:
    kinds = "an FRF, a StateSpace (fd.linearize), a Run or a Log"
    return ParameterError(f"{kinds} can be written, not a {type(source).__name__}: take its part that is one of these")
