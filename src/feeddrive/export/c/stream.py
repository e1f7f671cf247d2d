"""Exported C, compiled on this machine and run on any number of samples."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.export.layout import Layout
from feeddrive.export.toolchain import compiled, version
from feeddrive.export.trial import Trial
from feeddrive.language.errors import FileError

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")


@dataclass(frozen=True, eq=False)
class Streamed:
    """What exported C answered, shape (n, outputs), by which compiler and with which flags."""

    outputs: np.ndarray
    compiler: str
    flags: tuple[str, ...]


def streamed(
    layout: Layout, files: Mapping[str, str], tried: Trial, *, flags: Sequence[str] = FLAGS, command: str | None = None
) -> Streamed:
    """Compile `P.h` and the C files of an export and run a trial of a controller through them.

    Raises MissingProgramError without a compiler, and FileError if it refuses, or if the program does not end well.
    """
    routine, P = layout.routine, layout.routine.name
    program = _PROGRAM.format(
        P=P, real=layout.precision, inputs=len(routine.inputs), outputs=len(routine.outputs),
        parameters=max(1, len(routine.parameters)),
        filled=_filled("inputs", [v.name for v in routine.inputs], "row", f"({layout.precision})"),
        retuned=_filled("parameters", [v.name for v in routine.parameters], "values", ""),
        answered=_answered([v.name for v in routine.outputs]),
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        place = Path(folder)
        for name, text in {**files, f"{P}_stream.c": program}.items():
            (place / name).write_text(text, encoding="utf-8")
        sources = [f"{P}_stream.c", *(name for name in (f"{P}.c", f"{P}_configure.c") if name in files)]
        binary = compiled(place, sources, flags, command)
        (place / "in").write_bytes(_packed(layout, tried))
        with open(place / "in", "rb") as given, open(place / "out", "wb") as answers:
            done = subprocess.run([str(binary)], stdin=given, stdout=answers, check=False)
        if done.returncode != 0:
            raise FileError(f"{P}: the compiled program ended with status {done.returncode}")
        found = np.fromfile(place / "out", dtype=np.float64).reshape(-1, len(routine.outputs))
    if len(found) != len(tried.inputs):
        raise FileError(f"{P}: the compiled program answered {len(found)} of {len(tried.inputs)} samples")
    return Streamed(found, version(command), tuple(flags))


def _packed(layout: Layout, tried: Trial) -> bytes:
    """What the program reads: pieces of samples, and between them all parameters."""
    values = {v.path: v.value for v in layout.routine.parameters}
    pieces, start = [], 0
    for place in [*sorted(tried.changes), len(tried.inputs)]:
        pieces += [np.array([float(place - start)]), tried.inputs[start:place].ravel()]
        start = place
        if place in tried.changes:
            values |= tried.changes[place]
            pieces += [np.array([-1.0]), np.array(list(values.values()) or [0.0])]
    return np.concatenate(pieces).astype(np.float64).tobytes()


def _answered(names: Sequence[str]) -> str:
    return "\n".join(f"                out[{i}] = (double)outputs.{name};" for i, name in enumerate(names))


def _filled(struct: str, names: Sequence[str], source: str, cast: str) -> str:
    return "\n".join(f"                {struct}.{name} = {cast}{source}[{i}];" for i, name in enumerate(names))


_PROGRAM = """\
#include "{P}.h"

#include <stdio.h>

/* Reads doubles: a count and as many rows of inputs, or -1 and all parameters. Writes outputs for each sample. */
int main(void)
{{
    static {P}_controller controller;
    {P}_parameters parameters;
    {P}_inputs inputs;
    {P}_outputs outputs;
    double count, row[{inputs}], values[{parameters}], out[{outputs}];
    bool begun = false;
    const uint64_t mode = {P}_flush_begin();
    {P}_defaults(&parameters);
    {P}_configure(&controller, &parameters);
    while (fread(&count, sizeof count, 1, stdin) == 1) {{
        if (count < 0.0) {{
            if (fread(values, sizeof values, 1, stdin) != 1) {{
                return 2;
            }}
            {{
{retuned}
            }}
            {P}_retune(&controller, &parameters);
        }} else {{
            for (double k = 0.0; k < count; k += 1.0) {{
                if (fread(row, sizeof row, 1, stdin) != 1) {{
                    return 3;
                }}
{filled}
                if (!begun) {{
                    {P}_reset(&controller, &inputs);
                    begun = true;
                }}
                {P}_step(&controller, &inputs, &outputs);
{answered}
                if (fwrite(out, sizeof out, 1, stdout) != 1) {{
                    return 4;
                }}
            }}
        }}
    }}
    {P}_flush_end(mode);
    return 0;
}}
"""
