"""A routine as C99 text: header, step and reset, the functions outside the interrupt; or all in one header.

P.h            structs with units and meanings, and the functions
P.c            reset and step: what runs in the interrupt
P_configure.c  defaults, configure and retune: what runs outside it

A step has no loop, no branch that skips work, no heap, no globals and no recursion, so that it takes the same
operations for every input.  Of <math.h> it calls `fabs`, `floor` and `sqrt` only, which IEEE 754 fixes to the last bit.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from feeddrive.export.c.arithmetic import CODE, exact
from feeddrive.export.c.header import comment, header, mark
from feeddrive.export.c.statements import FUNCTIONS, Body, expression, helpers, number, wrapped
from feeddrive.export.identifiers import ascii_text, bare
from feeddrive.export.layout import Layout
from feeddrive.language.block import Block
from feeddrive.language.declaration import LARGEST
from feeddrive.language.graph import reachable
from feeddrive.loop.routine import Routine, Variable, off_outputs


@dataclass(frozen=True)
class Texts:
    """The three files of a routine."""

    header: str
    source: str
    configure: str


def texts(layout: Layout, title: str, made_by: str) -> Texts:
    """The C text of a routine; `title` says what it is, `made_by` which program made it from which file."""
    made = (header(layout, title, made_by), _source(layout, title, made_by), _configure(layout, title, made_by))
    return Texts(*map(ascii_text, made))


def _source(layout: Layout, title: str, made_by: str) -> str:
    routine, real, P = layout.routine, layout.precision, layout.routine.name
    held = routine.memory
    functions = []
    used: set[str] = set()
    for name, function in (("reset", layout.reset), ("step", layout.step)):
        leaves = _leaves(layout, {"state": "state->", "input": "inputs->"})
        leaves |= {field.node: f"design->{field.name}" for field in layout.design}
        body = Body(layout.graph, layout.truth, leaves, layout.names, layout.makers, real, _titles(routine))
        ends = (*function.states, *function.outputs)
        body.compute(layout.order(ends, moving=True), ends)
        body.lines.append("")
        outputs = [(f"outputs->{v.name}", i) for v, i in zip(routine.outputs, function.outputs, strict=False)]
        body.assign([(f"state->{v.name}", i) for v, i in zip(routine.states, function.states, strict=True)] + outputs)
        used |= body.used
        text = "\n".join(body.lines)
        wanted = [
            (f"const {P}_design *const design = &{held}->design;", "design->" in text),
            (f"{P}_state *const state = &{held}->state;", "state->" in text),
            ("(void)inputs;", "inputs->" not in text),
        ]
        wanted.insert(
            0, (f"if ({held}->configured != {mark(P)}) {{\n{_off(layout, bool(outputs))}    return;\n}}", True)
        )
        more = f", {P}_outputs *outputs" if outputs else ""
        signature = f"void {P}_{name}({P}_{held} *{held}, const {P}_inputs *inputs{more})"
        functions.append(_function(signature, [line for line, needed in wanted if needed], body.lines))
    tables = _tables(routine, functions, real)
    said = comment(f"{title}: reset and step.\n\n{made_by}\n\n{_laws(routine)}")
    check = exact(f"bool {P}_exact(void)", real)
    return _joined([*said, f'#include "{P}.h"', "", *_needed(used, real), *tables, check, *functions])


def _configure(layout: Layout, title: str, made_by: str) -> str:
    routine, P = layout.routine, layout.routine.name
    held = routine.memory
    defaults = [_assigned(f"parameters->{v.name}", v.value) for v in routine.parameters]
    designed, used = _designed(layout)
    both = f"{P}_exact() && designs_exactly()"  # each file may be compiled with flags of its own
    functions = [
        exact("static bool designs_exactly(void)", "double"),
        _function(f"void {P}_defaults({P}_parameters *parameters)", [], defaults or ["(void)parameters;"]),
        designed,
        _function(
            f"int {P}_broken_rule(const {P}_parameters *parameters)", [],
            [f"{P}_design design;", f"return ({both}) ? designed(&design, parameters) : {CODE};"],
        ),
        _function(
            f"bool {P}_configure({P}_{held} *{held}, const {P}_parameters *parameters)", [],
            [
                f"{held}->configured = 0U;",
                *wrapped(f"if (!({both}) || (designed(&{held}->design, parameters) != 0)) {{"),
                "    return false;", "}",
                f"{held}->parameters = *parameters;", f"{held}->configured = {mark(P)};", "return true;",
            ],
        ),
    ]  # fmt: skip
    if routine.retune is not None:
        text, more = _retune(layout)
        functions.append(text)
        used |= more
    said = comment(f"{title}: what is done once, and outside the interrupt.\n\n{made_by}")
    includes = [f'#include "{P}.h"', "", *_needed(used, "double")]
    return _joined([*said, *includes, *_tables(routine, functions, "double", _DESIGN), *functions])


def _off(layout: Layout, answers: bool) -> str:
    """The outputs after a refused configure: the safe force of the machine file for a control, nothing for an axis."""
    routine = layout.routine
    if routine.memory != "controller" or not answers:
        return ""
    cast = "(float)" if layout.precision == "float" else ""
    values = off_outputs(routine)
    return "".join(f"    outputs->{v.name} = {cast}{number(values[v.name])};\n" for v in routine.outputs)


def _designed(layout: Layout) -> tuple[str, set[str]]:
    """The design that parameters make, if they keep all conditions; and the operations that this takes."""
    routine, P = layout.routine, layout.routine.name
    leaves = _leaves(layout, {"parameter": "parameters->"}, _DESIGN)
    for index, node in enumerate(layout.graph.nodes):
        if node == ("const", LARGEST.hex()) or node == ("const", (-LARGEST).hex()):
            leaves[index] = "DBL_MAX" if node[1] == LARGEST.hex() else "-DBL_MAX"
    body = Body(layout.graph, layout.truth, leaves, layout.names, layout.makers, "double", _titles(routine))
    said, bounds = routine.sentences, len(routine.parameters)
    lines: list[str] = []
    for code, node in enumerate(layout.conditions[:bounds], 1):
        lines += _refused(_inline(layout, node, body), code, said[code])
    rules = layout.conditions[bounds:]
    nodes = [*rules, *(field.node for field in layout.design)]
    body.compute(layout.order(nodes, moving=False), nodes)
    lines += body.lines
    for code, node in enumerate(rules, bounds + 1):
        lines += _refused(bare(body.text(node)), code, said[code])
    for field in layout.design:
        cast = "(float)" if layout.precision == "float" and not field.truth else ""
        lines.append(f"design->{field.name} = {cast}{body.text(field.node)};")
    text = "\n".join(lines)
    first = [f"(void){name};" for name in ("design", "parameters") if f"{name}->" not in text]
    said = "/* What is computed once, and 0; or the code of the first rule that the parameters break, and nothing. */\n"
    function = _function(
        f"static int designed({P}_design *design, const {P}_parameters *parameters)", first, [*lines, "return 0;"]
    )
    return said + function, body.used


def _inline(layout: Layout, index: int, body: Body) -> str:
    """The comparisons of a bound in a line."""
    name, *values = layout.graph.nodes[index]
    if name == "and":
        return " && ".join(_inline(layout, i, body) for i in values)
    return f"({bare(expression(name, [body.text(i) for i in values]))})"


def _refused(holds: str, code: int, sentence: str) -> list[str]:
    """Return the code of a condition that does not hold."""
    return [*comment(sentence), *wrapped(f"if (!({holds})) {{"), f"    return {code};", "}"]


def _assigned(place: str, value: float) -> str:
    """`place = number;`, with the number as people write it where its bits hide it."""
    text = number(value)
    return f"{place} = {text};" + (f" /* {value!r} */" if "0x" in text else "")


def _retune(layout: Layout) -> tuple[str, set[str]]:
    """The state follows the parameters: `retune` of the blocks, between the design before and after; in double."""
    routine, P, real = layout.routine, layout.routine.name, layout.precision
    assert layout.retune is not None
    graph, truth = layout.retune.graph, layout.retune_truth
    wide = "(double)" if real == "float" else ""
    fields = {field.node: field.name for field in layout.design}
    leaves: dict[int, str] = {}
    for node, (kind, i) in layout.retune.leaves.items():
        if kind == "state":
            leaves[node] = f"{wide}state->{routine.states[i].name}"
        elif kind in ("old", "new"):
            name = routine.parameters[i].name
            leaves[node] = f"before.parameters.{name}" if kind == "old" else f"parameters->{name}"
        else:
            made = layout.prepared[routine.prepared_leaves.index(i)][1]
            held = "before.design." if kind == "old_prepared" else "controller->design."
            constant = graph_constant(layout, made)
            leaves[node] = constant if constant is not None else f"{wide}{held}{fields[made]}"
    body = Body(graph, truth, leaves, layout.retune.names, layout.retune.makers, "double", _titles(routine))
    pairs = zip((f"state->{v.name}" for v in routine.states), layout.retune.states, strict=True)
    targets = [(place, i) for place, i in pairs if body.texts.get(i) != f"{wide}{place}"]
    ends = [i for _, i in targets]
    order = [i for i in reachable(graph, ends) if graph.nodes[i][0] not in ("const", "truth")]
    body.compute(order, ends)
    body.assign(targets, "(float)" if real == "float" else "")
    body.lines.append("return true;")
    text = "\n".join(body.lines)
    first = [
        *([f"const {P}_controller before = *controller;"] if "before." in text else []),
        *([f"{P}_state *const state = &controller->state;"] if "state->" in text else []),
        f"if (controller->configured != {mark(P)} || designed(&controller->design, parameters) != 0) {{",
        "    return false;",
        "}",
        "controller->parameters = *parameters;",
    ]
    signature = f"bool {P}_retune({P}_controller *controller, const {P}_parameters *parameters)"
    return _function(signature, first, body.lines), body.used


def graph_constant(layout: Layout, index: int) -> str | None:
    """The text of a node that is a number of the law's text; None for any other."""
    node = layout.graph.nodes[index]
    return number(float.fromhex(node[1])) if node[0] == "const" else None


_DESIGN = "DESIGN_"  # tables of `configure`, which are in double where those of the step are not


def _leaves(layout: Layout, prefixes: Mapping[str, str], tables: str = "") -> dict[int, str]:
    """The text of what is there already: members of structs, tables, the sample time."""
    routine = layout.routine
    members: Mapping[str, Sequence[Variable]] = {
        "parameter": routine.parameters, "input": routine.inputs, "state": routine.states
    }  # fmt: skip
    found: dict[int, str] = {}
    for node, (kind, i) in layout.leaves.items():
        if kind == "table":
            found[node] = _table(routine.tables[i][0], tables)
        elif kind == "sample_time":
            found[node] = f"{routine.name.upper()}_SAMPLE_TIME"
        elif kind in prefixes:
            found[node] = f"{prefixes[kind]}{members[kind][i].name}"
    return found


def _table(name: str, of: str = "") -> str:
    return f"TABLE_{of}{name.removeprefix('control.').replace('.', '_').upper()}"


def _tables(routine: Routine, functions: Sequence[str], real: str, of: str = "") -> list[str]:
    """The tables that functions of a file read."""
    return [
        f"static const {real} {_table(name, of)}[{len(row)}] = {{{', '.join(number(float(x), real) for x in row)}}};"
        for name, _, row in routine.tables
        if any(f"{_table(name, of)}[" in each for each in functions)
    ]


def _function(signature: str, first: Iterable[str], lines: Iterable[str]) -> str:
    text = "\n".join([*first, *lines]).strip("\n")
    return f"{signature}\n{{\n{textwrap.indent(text, '    ')}\n}}\n"


def _laws(routine: Routine) -> str:
    """The docstrings of the blocks."""
    parts = []
    for path, block in routine.blocks:
        if path and inspect.getdoc(type(block)):
            parts.append(f"{path}: {block.kind}\n\n{textwrap.indent(inspect.getdoc(type(block)) or '', '  ')}")
    return "\n\n".join(parts)


def _titles(routine: Routine) -> Callable[[str], str]:
    """The title of the statements of a block."""
    kinds: dict[str, Block] = dict(routine.blocks)

    def title(owner: str) -> str:
        block = kinds.get(owner)
        if not owner:
            return "what goes out"
        if block is None or owner.endswith(block.kind):
            return owner
        return f"{owner}: {block.kind}"

    return title


def _needed(used: set[str], real: str) -> list[str]:
    """What a file includes, and the functions that its statements call."""
    functions = helpers(used, real)
    found = ["#include <math.h>"] if used & {"abs", "sqrt", "floor"} else []
    found += ["#include <string.h>"] if used & set(FUNCTIONS) else []
    return [*found, "", *functions] if found else functions


def _joined(lines: Iterable[str]) -> str:
    return "\n".join(lines).rstrip("\n") + "\n"


_SHARED = re.compile(r"\b(designed|designs_exactly|decays|exact_\w+|power_of_twof?|exponentf?|uniform)(?=\()")


def header_only(P: str, made: Texts) -> str:
    """Declarations and bodies in one file, to be included where the step is called."""
    close = f"#ifdef __cplusplus\n}}\n#endif\n\n#endif /* {P.upper()}_H */\n"
    header = made.header.removesuffix(close)
    assert header != made.header, "the header ends otherwise than expected"
    header = header.replace("#include <stdbool.h>", "#include <math.h>\n#include <stdbool.h>", 1)
    header = header.replace("#include <stdint.h>", "#include <stdint.h>\n#include <string.h>", 1)
    header = re.sub(rf"^(void|bool|int) {P}_", rf"static inline \1 {P}_", header, flags=re.MULTILINE)
    bodies, seen = [], set[str]()
    for text in (made.configure, made.source):
        for piece in _pieces(text, P):
            if piece not in seen:
                bodies.append(piece)
                seen.add(piece)
    return header + _own(P, "\n".join(bodies)) + "\n" + close


def _own(P: str, text: str) -> str:
    """Names of functions and tables with the prefix of the axis, so that two axes fit in one program."""
    text = _SHARED.sub(lambda found: f"{P}_{found[0]}", text)
    return re.sub(r"\bTABLE_", f"{P.upper()}_TABLE_", text)


def _pieces(text: str, P: str) -> list[str]:
    """The comment on top, and each function with its comment; without includes."""
    lines = [line for line in text.splitlines() if not line.startswith("#include")]
    body = re.sub(rf"^(void|bool|int) {P}_", rf"static inline \1 {P}_", "\n".join(lines), flags=re.MULTILINE)
    top, rest = body.split("*/\n", 1)
    pieces = [f"{top}*/", *re.split(r"(?<=^\})\n+", rest, flags=re.MULTILINE)]
    return [piece.strip("\n") + "\n" for piece in pieces if piece.strip()]
