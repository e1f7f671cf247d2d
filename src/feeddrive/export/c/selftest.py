"""A program that tries exported C with stored samples: no Python, no files, an exit status; for a host or a target."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feeddrive.export.c.expressions import number
from feeddrive.export.layout import Layout
from feeddrive.export.layout_run import LayoutRun
from feeddrive.export.trial import Trial, trial
from feeddrive.loop.routine_run import run

SAMPLES, CHANGES, BROKEN = 400, 4, 2e-3


def self_test(layout: Layout, seed: int = 0) -> tuple[str, str]:
    """The program `P_selftest.c` and its samples `P_vectors.h`.

    In double precision the expected outputs are the simulator's; in single precision those of the same operations in
    Python, each rounded to single precision.  The tolerance is none: all bits count.
    """
    routine, P = layout.routine, layout.routine.name
    tried = trial(routine, SAMPLES, seed, changes=CHANGES, broken=BROKEN)
    double = layout.precision == "double"
    expected = run(routine, tried.inputs, tried.changes) if double else stepped(layout, tried)
    retuned = _parameter_rows(layout, tried)
    program = _PROGRAM.format(
        P=P, real=layout.precision, bits="uint64_t" if layout.precision == "double" else "uint32_t",
        inputs=_filled("inputs", [v.name for v in routine.inputs], "samples[k]"),
        outputs=_compared([v.name for v in routine.outputs]),
        parameters=_filled("parameters", [v.name for v in routine.parameters], "changes[change].parameters", 12),
    )  # fmt: skip
    vectors = _VECTORS.format(
        P=P.upper(), real=layout.precision, count=len(tried.inputs), inputs=len(routine.inputs), seed=seed,
        outputs=len(routine.outputs), parameters=len(routine.parameters), changes=max(1, len(retuned)),
        held=len(retuned), samples=_rows(tried.inputs, layout.precision), expected=_rows(expected, layout.precision),
        rows=",\n".join(f"    {{{sample}, {{{_row(values)}}}}}" for sample, values in retuned) or "    {0, {0.0}}",
    )  # fmt: skip
    return program, vectors


def stepped(layout: Layout, tried: Trial) -> np.ndarray:
    """The outputs of a trial by the layout's own operations in Python."""
    held = LayoutRun(layout)
    held.reset(tried.inputs[0])
    found = []
    for k, inputs in enumerate(tried.inputs):
        if k in tried.changes:
            held.retune(tried.changes[k])
        found.append([float(x) for x in held.step(inputs)])
    return np.array(found)


def _parameter_rows(layout: Layout, tried: Trial) -> list[tuple[int, list[float]]]:
    """All parameters after each change."""
    values = {v.path: v.value for v in layout.routine.parameters}
    rows = []
    for sample in sorted(tried.changes):
        values |= tried.changes[sample]
        rows.append((sample, list(values.values())))
    return rows


def _row(values: Sequence[float], real: str = "double") -> str:
    return ", ".join("NOT_A_NUMBER" if x != x else number(float(x), real) for x in values)


def _rows(values: np.ndarray, real: str) -> str:
    with np.errstate(over="ignore"):
        return ",\n".join(f"    {{{_row(row, real)}}}" for row in values)


def _filled(struct: str, names: Sequence[str], source: str, indent: int = 8) -> str:
    return "\n".join(f"{' ' * indent}{struct}.{name} = {source}[{i}];" for i, name in enumerate(names))


def _compared(names: Sequence[str]) -> str:
    return "\n".join(
        f'        wrong += differs(k, "{name}", outputs.{name}, expected[k][{i}]);' for i, name in enumerate(names)
    )


_VECTORS = """\
/* Random samples, seed {seed}, and the answers of the simulator: see the README. */
#ifndef {P}_VECTORS_H
#define {P}_VECTORS_H

#include <math.h>

#define NOT_A_NUMBER (({real})NAN)
#define SAMPLES {count}
#define CHANGES {held}

static const {real} samples[SAMPLES][{inputs}] = {{
{samples}
}};

static const {real} expected[SAMPLES][{outputs}] = {{
{expected}
}};

/* Other parameters, from a sample on. */
static const struct {{ int sample; double parameters[{parameters}]; }} changes[{changes}] = {{
{rows}
}};

#endif
"""

_PROGRAM = """\
/* Runs the stored samples and compares every output with the stored answer, bit for bit. Exit status 0 if all agree. */
#include "{P}.h"
#include "{P}_vectors.h"

#include <stdio.h>
#include <string.h>

/* Is the number another one than expected? All NaN count as one. */
static int differs(int sample, const char *name, {real} found, {real} wanted)
{{
    {bits} a, b;
    memcpy(&a, &found, sizeof a);
    memcpy(&b, &wanted, sizeof b);
    if (a == b || (found != found && wanted != wanted)) {{
        return 0;
    }}
    printf("sample %d: %s is %.17g, not %.17g\\n", sample, name, (double)found, (double)wanted);
    return 1;
}}

int main(void)
{{
    static {P}_controller controller;
    {P}_parameters parameters;
    {P}_inputs inputs;
    {P}_outputs outputs;
    int wrong = 0, change = 0;
    const uint64_t mode = {P}_flush_begin();
    {P}_defaults(&parameters);
    {P}_configure(&controller, &parameters);
    for (int k = 0; k < SAMPLES; k++) {{
{inputs}
        if (k == 0) {{
            {P}_reset(&controller, &inputs);
        }}
        if (change < CHANGES && changes[change].sample == k) {{
{parameters}
            {P}_retune(&controller, &parameters);
            change++;
        }}
        {P}_step(&controller, &inputs, &outputs);
{outputs}
    }}
    {P}_flush_end(mode);
    printf("%d samples, %d changes of parameters: %d outputs differ\\n", SAMPLES, change, wrong);
    return wrong == 0 ? 0 : 1;
}}
"""
