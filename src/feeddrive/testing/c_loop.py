"""A plan as C99 text: the time loop of one variant, to be read, compiled and compared.

Signature, memory and bits are those of the native code:

    void name(int64_t count, int64_t first, const double *constants, const double *inputs, double *states,
              double *outputs, const double *const *tables)

An operation that is used once stands inside the expression that uses it; all others have a name.  Of the library only
`fabs`, `floor` and `sqrt` are called, which IEEE 754 fixes to the bit, unless the plan asks for "libm".
"""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from feeddrive.export.c_code import CALLS, FLUSH, FUNCTIONS, RESERVED, WIDTH, expression, number
from feeddrive.export.identifiers import bare
from feeddrive.language.graph import arguments
from feeddrive.loop.engine.plan import Plan


class _Writer:
    """Writes the text of nodes, and collects the lines of the part in progress."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.lines: list[str] = []
        self.texts: dict[int, str] = {}
        self.names = {*RESERVED, *CALLS.values(), *FUNCTIONS}
        self.uses = Counter(i for index in plan.order for i in arguments(plan.graph.nodes[index]))
        self.uses.update(node for _, node in plan.outputs)
        self.uses.update(2 * [state.after for state in plan.states])  # what is carried on has a name

    def name(self, wanted: str) -> str:
        """Return a unique C name."""
        text = re.sub(r"\W", "_", wanted, flags=re.ASCII)
        while text in self.names:
            text += "_"
        self.names.add(text)
        return text

    def declare(self, index: int, wanted: str, text: str) -> None:
        """Add a line that names a value."""
        self.texts[index] = self.name(wanted)
        kind = "int" if self.plan.kinds.truth[index] else "double"
        self.lines.append(f"const {kind} {self.texts[index]} = {text};")

    def node(self, index: int) -> None:
        """Write one operation: inside the expression that uses it if there is a single one in the same part of the
        text.
        """
        node = self.plan.graph.nodes[index]
        if node[0] in ("input", "table", "ring"):
            return
        if node[0] == "const":
            self.texts[index] = number(float.fromhex(node[1]))
            return
        if node[0] == "truth":
            self.texts[index] = "1" if node[1] else "0"
            return
        if node[0] == "put":
            ring, place, value = (self.texts[i] for i in node[1:])
            self.lines.append(f"{ring}[(int64_t){place}] = {bare(value)};")
            self.texts[index] = ring
            return
        text = expression(node[0], [self.texts[i] for i in arguments(node)])
        if node[0] == "get":  # read where it stands in the order, before the ring is written
            self.declare(index, f"v{index}", text)
            return
        hoisted = not self.plan.kinds.moving[index]  # may be used inside the loop: worth a name
        if self.uses[index] > 1 or len(text) > WIDTH or hoisted:
            self.declare(index, f"v{index}", bare(text))
        else:
            self.texts[index] = text


def text(plan: Plan, name: str) -> str:
    """Return the C text of a plan of one variant, with `name` as its only visible function."""
    assert plan.lanes == 1, "C text is written for one variant"
    writer = _Writer(plan)
    writer.name(name)
    order = sorted(plan.order) if not plan.rings else plan.order  # that of the law's text
    needed, moving = set(order), plan.kinds.moving
    for i, (title, node) in enumerate(plan.tables):
        writer.texts[node] = writer.name(title)
        writer.lines.append(f"const double *{writer.texts[node]} = tables[{i}];")
    for i, (title, node) in enumerate(plan.constants):
        if node in needed:
            writer.declare(node, title, f"constants[{i}]")
    first = len(plan.states)
    for title, node, length in plan.rings:
        writer.texts[node] = writer.name(title)
        writer.lines.append(f"double *const {writer.texts[node]} = states + {first};")
        first += length
    for i, state in enumerate(plan.states):
        still = "const " if state.before == state.after else ""
        writer.texts[state.before] = writer.name(state.name)
        writer.lines.append(f"{still}double {writer.texts[state.before]} = states[{i}];")
    for index in order:
        if not moving[index]:
            writer.node(index)
    entry, writer.lines = writer.lines, []

    for i, (title, node) in enumerate(plan.inputs):
        if node in needed:
            writer.declare(node, title, f"inputs[{len(plan.inputs)} * k + {i}]")
    if plan.sample is not None and plan.sample in needed:
        writer.declare(plan.sample, "sample", "(double)(first + k)")
    for index in order:
        if moving[index]:
            writer.node(index)
    for i, (title, node) in enumerate(plan.outputs):
        writer.lines.append(f"outputs[{len(plan.outputs)} * k + {i}] = {writer.texts[node]}; /* {title} */")
    carried = [state for state in plan.states if state.before != state.after]
    held = {}  # a state that takes over another one's value takes it before that one changes
    for before in sorted({s.before for s in carried} & {s.after for s in carried}):
        held[before] = writer.name(f"last_{writer.texts[before]}")
        writer.lines.append(f"const double {held[before]} = {writer.texts[before]};")
    for state in carried:
        writer.lines.append(f"{writer.texts[state.before]} = {held.get(state.after, writer.texts[state.after])};")
    body, writer.lines = writer.lines, []
    done = [f"states[{i}] = {writer.texts[s.before]};" for i, s in enumerate(plan.states) if s.before != s.after]

    used = {plan.graph.nodes[index][0] for index in plan.order}
    lines = [
        "#include <math.h>",
        "#include <stdint.h>",
        "#include <string.h>",
        "",
        *([] if plan.arithmetic == "fma" else ["#pragma STDC FP_CONTRACT OFF /* gcc: -ffp-contract=off */", ""]),
        FLUSH,
        *(FUNCTIONS[function] for function in sorted(used & set(FUNCTIONS))),
        f"void {name}(int64_t count, int64_t first, const double *constants, const double *inputs, double *states,",
        f"{' ' * (6 + len(name))}double *outputs, const double *const *tables)",
        "{",
        *(f"    (void){unused};" for unused in ("first", "constants", "inputs", "outputs", "tables")),
        *("    " + line for line in ("const uint64_t mode = flush();", *entry)),
        "    for (int64_t k = 0; k < count; k++) {",
        *("        " + line for line in body),
        "    }",
        *("    " + line for line in (*done, "restore(mode);")),
        "}",
        "",
    ]
    return "\n".join(lines)


def compiled(source: str, folder: Path, *flags: str) -> ctypes.CDLL:
    """Compile C text with warnings as errors and load it; skips without a compiler."""
    compiler = next(filter(None, map(shutil.which, ("gcc", "clang", "cc"))), None)
    if compiler is None:
        pytest.skip("no C compiler (gcc, clang or cc) on this machine: the C text was NOT compiled and NOT compared")
    text, library = folder / "loop.c", folder / "loop.so"
    text.write_text(source, encoding="utf-8")
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unknown-pragmas"]
    done = subprocess.run(
        [
            compiler,
            *strict,
            "-O2",
            "-ffp-contract=off",
            *flags,
            "-shared",
            "-fPIC",
            "-o",
            str(library),
            str(text),
            "-lm",
        ],
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    assert done.returncode == 0, done.stderr[:3000]
    return ctypes.CDLL(str(library))
