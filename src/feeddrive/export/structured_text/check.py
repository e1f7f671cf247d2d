"""A function block that tests the controller on the PLC against stored samples of the simulator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feeddrive.export.c.programs import stepped
from feeddrive.export.identifiers import bare
from feeddrive.export.layout import Layout
from feeddrive.export.structured_text.controller import Program
from feeddrive.export.structured_text.expressions import decimal, literal
from feeddrive.export.structured_text.units import CONSTANTS, INDENT, OUTPUTS, VARIABLES, Declared, Unit
from feeddrive.export.trial import Trial, trial
from feeddrive.loop.routine_run import run

SAMPLES = 100
_SAID = """\
Tries {name} on this PLC: call it in any task until done. It gives {samples} stored samples to the controller, with
a live change of parameters in between, and compares every output with the simulator's, all bits.
wrong = 0 says that this PLC computes what was simulated; where it is not, first_wrong is the first such sample."""


def check(layout: Layout, program: Program, seed: int = 0) -> Unit:
    """The function block `axis_x_check`."""
    routine, name = layout.routine, layout.routine.name
    real = "LREAL" if layout.precision == "double" else "REAL"
    tried = trial(routine, SAMPLES, seed, changes=1, broken=0.0)
    changes = {
        sample: {path: value for path, value in changed.items() if path in program.names}
        for sample, changed in tried.changes.items()
    }
    tried = Trial(tried.inputs, changes)
    expected = run(routine, tried.inputs, changes) if real == "LREAL" else stepped(layout, tried)
    given = {v.name: tried.inputs[:, i] for i, v in enumerate(routine.inputs)}
    wanted = {v.name: expected[:, i] for i, v in enumerate(routine.outputs)}
    constants = [_array(f"given_{each}", each, row, real) for each, row in given.items()]
    constants += [_array(f"wanted_{each}", each, row, real) for each, row in wanted.items()]
    retunes = [f"(k = {sample})" for sample in changes]
    calls = [f"{each} := given_{each}[k]" for each in given]
    calls += [f"retune := {' OR '.join(retunes) or 'FALSE'}", "parameters := parameters"]
    differs = " OR ".join(f"(tried.{each} <> wanted_{each}[k])" for each in wanted)
    body = [
        "IF NOT done THEN",
        *(INDENT + line for line in _changes(changes, program)),
        f"{INDENT}tried(",
        *(f"{INDENT * 2}{call}{',' if call != calls[-1] else ');'}" for call in calls),
        f"{INDENT}IF {differs} THEN",
        f"{INDENT * 2}IF wrong = 0 THEN",
        f"{INDENT * 3}first_wrong := k;",
        f"{INDENT * 2}END_IF;",
        f"{INDENT * 2}wrong := wrong + 1;",
        f"{INDENT}END_IF;",
        f"{INDENT}k := k + 1;",
        f"{INDENT}done := k >= {SAMPLES};",
        "END_IF;",
    ]
    return Unit(
        f"{name}_check", _SAID.format(name=name, samples=SAMPLES),
        sections={
            OUTPUTS: [
                Declared("done", "BOOL", "FALSE"), Declared("wrong", "DINT", "0", "samples with another answer"),
                Declared("first_wrong", "DINT", "-1"),
            ],
            VARIABLES: [
                Declared("tried", name), Declared("parameters", f"{name}_parameters"), Declared("k", "DINT", "0")
            ],
            CONSTANTS: constants,
        },
        body=body,
    )  # fmt: skip


def _changes(changes: dict[int, dict[str, float]], program: Program) -> list[str]:
    lines: list[str] = []
    for sample, changed in changes.items():
        lines.append(f"IF k = {sample} THEN")
        lines += [f"{INDENT}parameters.{program.names[path]} := {bare(literal(v))};" for path, v in changed.items()]
        lines += ["END_IF;"] if changed else [f"{INDENT};", "END_IF;"]
    return lines


def _array(name: str, signal: str, row: Sequence[float] | np.ndarray, real: str) -> Declared:
    """A signal over the samples, as an array in the type of the controller's border."""
    if signal in ("enable", "enabled"):
        kind, texts = "BOOL", ["TRUE" if x > 0.5 else "FALSE" for x in row]
    elif signal == "trip":
        kind, texts = "INT", [f"{x:.0f}" for x in row]
    else:
        kind, texts = real, [decimal(float(x), real) for x in row]
    return Declared(name, f"ARRAY[0..{len(texts) - 1}] OF {kind}", f"[{', '.join(texts)}]")
