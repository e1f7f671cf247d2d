"""The target `st`: a controller in Structured Text, import files for PLC tools, a test block, and a README."""

import inspect
import re
import textwrap
import uuid
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from feeddrive.export import structured_text_code as st
from feeddrive.export.c_bundle import stepped
from feeddrive.export.design import CONTROL, Design, Trial, trial
from feeddrive.export.identifiers import ST_WORDS, ascii_text, bare, identifier
from feeddrive.export.layout import Field, Layout, LayoutRun
from feeddrive.export.structured_text_code import Array, Assignment, Declared, Section, Structure, Unit
from feeddrive.export.targets import readme, write_bundle
from feeddrive.language.block import LARGEST
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.graph import Graph, arguments, reachable
from feeddrive.language.naming import Name
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.loop import quantity
from feeddrive.loop.routine import Variable, off_outputs, run
from feeddrive.version import __version__

# Design values that are fixed at export because computing them takes too many operations for a PLC.
#
# A filter takes some 30 operations, the gains of a pole placement 100, a matrix exponential 700 to 10 000.  What is
# above the bound is written as initial values, and the parameters that it depends on cannot be changed on the PLC: a
# change needs a new export.

MOST_OPERATIONS = 500  # largest number of operations for one design number


@dataclass(frozen=True)
class Fixed:
    """The numbers that become constants in the export: design numbers and the parameters on which they depend.

    fields      values of the fixed design numbers, by field name
    parameters  parameters that can no longer be changed on the PLC
    nodes       values, by node, that depend on fixed parameters only and are read by rules on tunable parameters
    """

    fields: Mapping[str, float]
    parameters: tuple[Variable, ...]
    nodes: Mapping[int, float]


def fixed(layout: Layout) -> Fixed:
    """Return the numbers that the export turns into constants.

    They are the design numbers whose computation takes too many operations for a PLC, and all others that depend only
    on the same parameters.
    """
    leaves = layout.leaves
    held: set[int] = set()
    below = {field.name: set(reachable(layout.graph, [field.node])) for field in layout.design}
    for nodes in below.values():
        if len(nodes) > MOST_OPERATIONS:
            held |= {node for node in nodes if leaves.get(node, ("", 0))[0] == "parameter"}
    values = LayoutRun(layout).design
    constants: dict[str, float] = {}
    for field in layout.design:
        behind = {node for node in below[field.name] if leaves.get(node, ("", 0))[0] == "parameter"}
        if behind and behind <= held:
            constants[field.name] = float(values[field.node])
    routine = layout.routine
    return Fixed(
        constants, tuple(routine.parameters[leaves[node][1]] for node in sorted(held)), _read_by_rules(layout, held)
    )


def _read_by_rules(layout: Layout, held: set[int]) -> dict[int, float]:
    """Return, by node, the values that depend on fixed parameters only and are read by rules on tunable parameters."""
    graph, leaves = layout.graph, layout.leaves
    moves = _depending(graph, {node for node, (kind, _) in leaves.items() if kind == "parameter"} - held)
    stands = _depending(graph, held)
    rules = [rule for rule in layout.conditions[len(layout.routine.parameters) :] if moves[rule]]
    read = {i for index in reachable(graph, rules) if moves[index] for i in arguments(graph.nodes[index])}
    wanted = {i for i in read if stands[i] and not moves[i] and graph.nodes[i][0] not in ("const", "truth", "input")}
    values = LayoutRun(layout, wide=True).values(sorted(wanted))
    return dict(zip(sorted(wanted), values, strict=True))


def _depending(graph: Graph, others: set[int]) -> list[bool]:
    """Return, per node, True if it is one of `others` or depends on one of them."""
    depends: list[bool] = []
    for index, node in enumerate(graph.nodes):
        depends.append(index in others or any(depends[i] for i in arguments(node)))
    return depends


class Printing(Protocol):
    """The interface of the generator that `configure` uses: the layout, legal names, and statements."""

    layout: Layout
    fixed: Fixed
    name: str
    real: str
    parameters: dict[str, str]
    design: dict[str, str]

    def section(self, leaves: Mapping[int, str], taken: Iterable[str], real: str) -> Section:
        """Start a section of statements, given the code of existing values and the names already taken."""
        ...

    def computed(self, section: Section, nodes: Iterable[int]) -> list[str]:
        """Return the statements that compute some nodes."""
        ...

    def parameter(self, struct: str, i: int) -> str:
        """Return the expression for a parameter."""
        ...

    def narrow(self, text: str) -> str:
        """Convert an LREAL to the stored type."""
        ...


def configure(printer: Printing) -> Unit:
    """Return the function block that computes the design in LREAL and rounds each number once for storage.

    Bounds are checked first, then the rules between parameters; then the design is computed.  Each step is skipped
    if an earlier condition is violated, so that rejected parameters never cause a division by zero.
    """
    layout = printer.layout
    wanted = [field for field in layout.design if field.name not in printer.fixed.fields]
    leaves: dict[int, str] = {node: st.literal(value) for node, value in printer.fixed.nodes.items()}
    for node, (kind, i) in layout.leaves.items():
        if kind == "sample_time":
            leaves[node] = st.literal(layout.routine.sample_time)
        elif kind == "parameter":
            leaves[node] = printer.parameter("parameters", i)
    section = printer.section(leaves, ["parameters", "design", "rule"], "LREAL")
    for node, (kind, i) in layout.leaves.items():
        # a table may be read here, too: at a fixed index the entry depends on parameters only
        if kind == "table":
            section.table(node, layout.routine.tables[i][0], [float(x) for x in layout.routine.tables[i][2]])
    lines = ["rule := 0;"]
    bounds = len(layout.routine.parameters)
    for code, (node, variable) in enumerate(zip(layout.conditions, layout.routine.parameters, strict=False), 1):
        if variable.path in printer.parameters:
            lines += _refused(layout, _inline(layout, node, section, printer.name), code)
    rules = [
        (code, node) for code, node in enumerate(layout.conditions[bounds:], bounds + 1) if _is_tunable(printer, node)
    ]
    inner = printer.computed(section, [node for _, node in rules])
    for code, node in rules:
        inner += _refused(layout, section.statements.texts[node], code)
    lines += _unless_broken(inner)
    places = {field.node: f"design.{printer.design[field.name]}" for field in wanted}
    # in REAL a field holds the rounded number: other numbers must be computed from a variable of their own
    section.places = places if printer.real == "LREAL" else {}
    inner = printer.computed(section, places)
    for field in wanted:
        text, place = section.statements.texts[field.node], places[field.node]
        if text != place:
            inner += Assignment(place, text if field.truth else printer.narrow(text)).lines()
    lines += _unless_broken(inner)
    return Unit(
        f"{printer.name}_configure",
        "What depends on parameters only: once, not in every sample. `rule` is 0, or the code of the first rule\n"
        "that the parameters break, which the README explains; the design is then not to be used.",
        sections={
            st.INPUTS: [Declared("parameters", f"{printer.name}_parameters")],
            st.OUTPUTS: [
                Declared("design", f"{printer.name}_design"),
                Declared("rule", "DINT", "0", "0, or the broken rule"),
            ],
            st.VARIABLES: section.variables,
            st.CONSTANTS: section.constants(),
        },
        body=lines,
    )


def _is_tunable(printer: Printing, node: int) -> bool:
    """Return True if a node depends on a parameter that the PLC can change."""
    for i in reachable(printer.layout.graph, [node]):
        kind, place = printer.layout.leaves.get(i, ("", 0))
        if kind == "parameter" and printer.layout.routine.parameters[place].path in printer.parameters:
            return True
    return False


def _inline(layout: Layout, node: int, section: Section, prefix: str) -> str:
    """Return the comparisons of a bounds check as one expression."""
    name, *values = layout.graph.nodes[node]
    number = _finite(layout, node)
    if number is not None:
        # true of finite numbers alone, without the largest one, which some compilers refuse as a literal
        text = section.statements.texts[number]
        return f"(({text} - {text}) = 0.0)"
    if name == "and":
        return f"({' AND '.join(_inline(layout, i, section, prefix) for i in values)})"
    texts = [section.statements.texts.get(i) or st.literal(float.fromhex(layout.graph.nodes[i][1])) for i in values]
    return st.expression(name, texts, prefix)


def _finite(layout: Layout, node: int) -> int | None:
    """Return the node of x if a node is (-LARGEST <= x) AND (x <= LARGEST), else None."""
    name, *sides = layout.graph.nodes[node]
    if name != "and":
        return None
    least, most = (layout.graph.nodes[i] for i in sides)
    if least[0] != "le" or most[0] != "le" or least[2] != most[1]:
        return None
    ends = [layout.graph.nodes[i] for i in (least[1], most[2])]
    return most[1] if ends == [("const", (sign * LARGEST).hex()) for sign in (-1.0, 1.0)] else None


def _refused(layout: Layout, holds: str, code: int) -> list[str]:
    """Return the lines that store the code of a condition if it is the first one that is violated."""
    sentence = st.plain(ascii_text(layout.routine.sentences[code]))
    return [
        f"(* {code}: {sentence} *)",
        f"IF (rule = 0) AND (NOT {holds}) THEN",
        f"{st.INDENT}rule := {code};",
        "END_IF;",
    ]


def _unless_broken(lines: list[str]) -> list[str]:
    """Return the lines wrapped in an IF block that runs only if no rule has been violated so far."""
    return ["IF rule = 0 THEN", *(f"{st.INDENT}{line}".rstrip() for line in lines), "END_IF;"] if lines else []


# A control as structures and function blocks: the law in one block, one-time computations in three others.
#
# axis_x             one sample; a reset in the first cycle, and a retune at a rising edge
# axis_x_configure   parameters -> design numbers
# axis_x_reset       design, inputs -> state: off, where the axis is
# axis_x_retune      state, parameters and design before and after -> state

# relative: the cycle of a task is known more precisely, and any other sample time is another design
CYCLE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Program:
    """The functions and function blocks of a program, each defined before use.

    `names` maps the dotted names of parameters to their Structured Text names.
    """

    structures: tuple[Structure, ...]
    arrays: tuple[Array, ...]
    units: tuple[Unit, ...]
    fixed: Fixed
    names: Mapping[str, str]

    @property
    def block(self) -> Unit:
        """The function block that a PLC task calls."""
        return self.units[-1]

    def text(self) -> str:
        """Return the program as one source file."""
        return "\n".join(part.text() for part in (*self.structures, *self.arrays, *self.units))


def program(layout: Layout, heading: str) -> Program:
    """Return the Structured Text program of a controller; `heading` is the comment above its function block.

    Raises StructureError for a table with too many entries.
    """
    return Printer(layout, heading).program()


class Printer:
    """The generator of Structured Text from a layout, with one legal name for each field."""

    def __init__(self, layout: Layout, heading: str) -> None:
        self.layout, self.heading = layout, heading
        self.routine, self.name = layout.routine, layout.routine.name
        self.real = "LREAL" if layout.precision == "double" else "REAL"
        self.fixed = fixed(layout)
        self.values = {variable.path: variable.value for variable in self.fixed.parameters}
        self.parameters = _legal((v.path, v.name) for v in self.routine.parameters if v.path not in self.values)
        self.design = _legal((f.name, f.name) for f in layout.design)
        self.states = _legal((v.path, v.name) for v in self.routine.states)
        self.used: dict[str, set[str]] = {"LREAL": set(), "REAL": set()}

    def program(self) -> Program:
        """Return the structures, functions and function blocks of the controller."""
        reset = self._reset()
        blocks = [configure(self), reset, self._retune(), self._step(reset.sections[st.INPUTS][1:])]
        own = [unit for real, used in self.used.items() for unit in st.functions(used, self.name, real)]
        units = (*own, *blocks)
        return Program(self._structures(), tuple(st.arrays(units)), units, self.fixed, self.parameters)

    def _structures(self) -> tuple[Structure, ...]:
        parameters = [
            Declared(self.parameters[v.path], "LREAL", st.initial(v.value, "LREAL", v.path), _meaning(v))
            for v in self.routine.parameters
            if v.path in self.parameters
        ]
        prepared = {node: path for path, node in self.layout.prepared if node not in self.layout.leaves}
        meanings = self.routine.meanings
        design = [
            (
                Declared(self.design[f.name], self._kind(f), self._fixed_value(f)),
                meanings.get(prepared.get(f.node, ""), ""),
            )
            for f in self.layout.design
        ]
        states = [(Declared(self.states[v.path], self.real), meanings.get(v.path, "")) for v in self.routine.states]
        return (
            Structure(f"{self.name}_parameters", "What can be changed while the loop runs, by retune.", parameters),
            Structure(f"{self.name}_design", self._design_comment(), _grouped(design)),
            Structure(f"{self.name}_state", "State from sample to sample.", _grouped(states)),
        )

    def _design_comment(self) -> str:
        """Return the comment above the design structure, which lists the parameters fixed by the export."""
        lines = ["Numbers that depend on parameters only."]
        if self.fixed.parameters:
            lines += ["", "Those with a value are fixed by the export. They were computed for these parameters:"]
            lines += [f"  {v.path} = {st.decimal(v.value)} {v.unit}".rstrip() for v in self.fixed.parameters]
        return "\n".join(lines)

    def _kind(self, field: Field) -> str:
        return "BOOL" if field.truth else self.real

    def _fixed_value(self, field: Field) -> str:
        value = self.fixed.fields.get(field.name)
        if value is None:
            return ""
        return ("TRUE" if value else "FALSE") if field.truth else st.initial(value, self.real, field.name)

    def parameter(self, struct: str, i: int) -> str:
        """Return the expression for a parameter: its field in `struct`, or its value if it is fixed."""
        path = self.routine.parameters[i].path
        return st.literal(self.values[path]) if path in self.values else f"{struct}.{self.parameters[path]}"

    def _reset(self) -> Unit:
        inputs = self._inputs()
        section = self._sampled([variable.name for variable in inputs])
        lines = self.computed(section, self.layout.reset.states)
        lines += section.assign(self._targets(self.layout.reset.states))
        words = set(re.findall(r"\w+", "\n".join(lines)))
        return Unit(
            f"{self.name}_reset",
            "The state of a loop that is off and has no trip, where the axis is.",
            sections={
                st.INPUTS: [
                    Declared("design", f"{self.name}_design"),
                    *(variable for variable in inputs if variable.name in words),
                ],
                st.OUTPUTS: [Declared("state", f"{self.name}_state")],
                st.VARIABLES: section.variables,
                st.CONSTANTS: section.constants(),
            },
            body=lines,
        )

    def _retune(self) -> Unit:
        """Return the function block for live parameter changes, which computes in LREAL, as `configure` does."""
        retune = self.layout.retune
        assert retune is not None, "a control can be retuned, an axis is not printed"
        states = [f"state.{self.states[v.path]}" for v in self.routine.states]
        leaves: dict[int, str] = {}
        for node, (kind, i) in retune.leaves.items():
            if kind == "state":
                leaves[node] = self._wide(states[i])
            elif kind in ("old", "new"):
                leaves[node] = self.parameter("before" if kind == "old" else "after", i)
            elif i in self.routine.prepared_leaves:
                source = self.layout.prepared[self.routine.prepared_leaves.index(i)][1]
                leaves[node] = self._prepared("design_before" if kind == "old_prepared" else "design_after", source)
        taken = ["before", "after", "design_before", "design_after", "state", "retuned"]
        section = self.section(leaves, taken, "LREAL", (retune.graph, retune.names, retune.makers))
        changed = [
            (f"retuned.{self.states[variable.path]}", node)
            for i, (variable, node) in enumerate(zip(self.routine.states, retune.states, strict=True))
            if retune.leaves.get(node) != ("state", i)
        ]
        lines = self.computed(section, [node for _, node in changed])
        lines.append("retuned := state;")
        for place, node in changed:
            lines += Assignment(place, self.narrow(section.statements.texts[node])).lines()
        structs = {"before": "parameters", "after": "parameters", "design_before": "design", "design_after": "design"}
        return Unit(
            f"{self.name}_retune",
            "The state after a live change: forces and estimates go on without a jump.",
            sections={
                st.INPUTS: [Declared(n, f"{self.name}_{kind}") for n, kind in (structs | {"state": "state"}).items()],
                st.OUTPUTS: [Declared("retuned", f"{self.name}_state")],
                st.VARIABLES: section.variables,
            },
            body=lines,
        )

    def _prepared(self, struct: str, node: int) -> str:
        """Return the expression for a precomputed coefficient: a constant or a design field; empty if it is unused."""
        constant = self.layout.graph.nodes[node]
        if constant[0] == "const":
            return st.literal(float.fromhex(constant[1]))
        name = next((field.name for field in self.layout.design if field.node == node), None)
        return "" if name is None else self._wide(f"{struct}.{self.design[name]}")

    def _step(self, reset_inputs: list[Declared]) -> Unit:
        inputs, T = self._inputs(), self.routine.sample_time
        more = [
            Declared(
                "cycle_time",
                self.real,
                st.decimal(T, self.real),
                "s: cycle of the calling task; the loop stays off unless it is the sample time",
            ),
            Declared("reset", "BOOL", "FALSE", "TRUE: start anew where the axis is, off and without a trip"),
            Declared("retune", "BOOL", "FALSE", "rising edge: take the parameters over while the loop runs"),
            Declared("parameters", f"{self.name}_parameters", "", "read in the first cycle, at a reset and a retune"),
        ]
        outputs = [self._output(v) for v in self.routine.outputs]
        outputs.append(Declared("cycle_wrong", "BOOL", "", "TRUE: the cycle of the task is not the sample time"))
        outputs.append(Declared("broken_rule", "DINT", "0", "0, or the rule that refused parameters break: see README"))
        own = [
            Declared("started", "BOOL", "FALSE", "whether there is a state"),
            Declared("retuned", "BOOL", "FALSE", "retune in the cycle before"),
            Declared("fresh", "BOOL"),
            *(Declared(switched, "BOOL") for switched in self._switches().values()),
            Declared("active", f"{self.name}_parameters", "", "parameters in use"),
            Declared("design", f"{self.name}_design"),
            Declared("state", f"{self.name}_state"),
            Declared("configuring", f"{self.name}_configure"),
            Declared("resetting", f"{self.name}_reset"),
            Declared("retuning", f"{self.name}_retune"),
        ]
        section = self._sampled([declared.name for declared in (*inputs, *more, *outputs, *own)])
        step = self.layout.step
        lines = self.computed(section, [*step.states, *step.outputs])
        lines += ["", "(* the outputs, and the state for the next sample *)"]
        for variable, node in zip(self.routine.outputs, step.outputs, strict=True):
            lines += self._put(variable, section.statements.texts[node])
        lines += section.assign(self._targets(step.states))
        first = _FIRST.format(
            inputs="".join(f",\n            {declared.name} := {declared.name}" for declared in reset_inputs),
            T=st.literal(T, self.real),
            tolerance=st.literal(CYCLE_TOLERANCE * T, self.real),
        )
        first += "".join(
            f"{switched} := {enable} AND (NOT cycle_wrong);\n" for enable, switched in self._switches().items()
        )
        return Unit(
            self.name,
            self.heading,
            sections={
                st.INPUTS: [*inputs, *more],
                st.OUTPUTS: outputs,
                st.VARIABLES: [*own, *section.variables],
                st.CONSTANTS: section.constants(),
            },
            body=[
                *first.splitlines(),
                "",
                "IF started THEN",
                *(f"{st.INDENT}{line}".rstrip() for line in lines),
                "ELSE",
                *(st.INDENT + line for line in self._off()),
                "END_IF;",
            ],
        )

    def _off(self) -> list[str]:
        """Return the assignments of the outputs for invalid parameters, with the safe force of the machine file."""
        printed: list[str] = []
        kinds = {variable.name: quantity(variable.path) for variable in self.routine.outputs}
        for name, value in off_outputs(self.routine).items():
            text = {"trip": "INT#0", "enabled": "FALSE"}.get(kinds[name]) or bare(st.literal(value, self.real))
            printed.append(f"{name} := {text};")
        return printed

    def _inputs(self) -> list[Declared]:
        return [
            Declared(v.name, "BOOL", "FALSE", "TRUE: the loop shall run")
            if quantity(v.path) == "enable"
            else Declared(v.name, self.real, "", _meaning(v))
            for v in self.routine.inputs
        ]

    def _switches(self) -> dict[str, str]:
        """Return, for each input `enable`, the name of the variable that is FALSE in a task with another cycle, too."""
        names = (v.name for v in self.routine.inputs if quantity(v.path) == "enable")
        return {name: f"{name.removesuffix('enable')}switched_on" for name in names}

    def _output(self, variable: Variable) -> Declared:
        codes = ", ".join(f"{code:.0f} {text}" for code, text in TRIPS.items())
        special = {
            "trip": ("INT", f"0 none, {codes}"),
            "enabled": ("BOOL", "TRUE while the loop runs, FALSE while it is off or tripped"),
        }
        kind, meaning = special.get(quantity(variable.path), (self.real, _meaning(variable)))
        return Declared(variable.name, kind, "", meaning)

    def _put(self, output: Variable, text: str) -> list[str]:
        """Return the assignment of an output, converted to its declared type."""
        if quantity(output.path) == "trip":
            return [f"{output.name} := {self.real}_TO_INT({text});"]
        if quantity(output.path) == "enabled":
            return [f"{output.name} := {text} > {st.literal(0.5, self.real)};"]
        return Assignment(output.name, text).lines()

    def _wide(self, text: str) -> str:
        """Convert a stored number to LREAL."""
        return text if self.real == "LREAL" else f"REAL_TO_LREAL({text})"

    def narrow(self, text: str) -> str:
        """Convert an LREAL to the stored type."""
        return text if self.real == "LREAL" else f"LREAL_TO_REAL({text})"

    def computed(self, section: Section, nodes: Iterable[int]) -> list[str]:
        """Return the statements that compute some nodes, and register the functions that they call."""
        lines = section.compute(nodes)
        self.used[section.real] |= section.statements.used
        return lines

    def _sampled(self, taken: Iterable[str]) -> Section:
        """Return a new section for the statements of one sample, which read inputs, state and design."""
        layout, routine = self.layout, self.routine
        fields = {field.node: f"design.{self.design[field.name]}" for field in layout.design}
        leaves: dict[int, str] = {}
        for node, (kind, i) in layout.leaves.items():
            if kind == "input":
                leaves[node] = routine.inputs[i].name
            elif kind == "state":
                leaves[node] = f"state.{self.states[routine.states[i].path]}"
        section = self.section(leaves | fields, [*taken, "state", "design"], self.real)
        section.statements.bounds = set(fields)
        for node, (kind, i) in layout.leaves.items():
            if kind == "table":
                section.table(node, routine.tables[i][0], [float(x) for x in routine.tables[i][2]])
            elif kind == "input" and quantity(routine.inputs[i].path) == "enable":
                section.switch(node, self._switches()[routine.inputs[i].name])
        return section

    def section(
        self,
        leaves: Mapping[int, str],
        taken: Iterable[str],
        real: str,
        traced: tuple[Graph, Mapping[int, Name], Mapping[int, str]] | None = None,
    ) -> Section:
        """Return a new section for the statements of one function block."""
        layout = self.layout
        graph, names, makers = traced or (layout.graph, layout.names, layout.makers)
        return Section(self.name, dict(self.routine.blocks), graph, leaves, names, makers, real, taken)

    def _targets(self, nodes: Iterable[int]) -> list[tuple[str, int]]:
        pairs = zip(self.routine.states, nodes, strict=True)
        return [(f"state.{self.states[variable.path]}", node) for variable, node in pairs]


_FIRST = """\
(* The parameters are taken over in the first cycle, at a reset and at a retune. *)
fresh := reset OR (NOT started);
IF fresh OR (retune AND (NOT retuned)) THEN
    configuring(parameters := parameters);
    broken_rule := configuring.rule;
END_IF;
IF (fresh OR (retune AND (NOT retuned))) AND (broken_rule = 0) THEN
    IF fresh THEN
        resetting(
            design := configuring.design{inputs});
        state := resetting.state;
    ELSE
        retuning(
            before := active,
            after := parameters,
            design_before := design,
            design_after := configuring.design,
            state := state);
        state := retuning.retuned;
    END_IF;
    active := parameters;
    design := configuring.design;
    started := TRUE;
ELSIF fresh THEN
    started := FALSE;
END_IF;
retuned := retune;

(* A law is designed for its sample time: in a task with another cycle the loop stays off. *)
cycle_wrong := NOT (ABS(cycle_time - {T}) <= {tolerance});
"""


def _legal(names: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return a legal Structured Text name for each key."""
    taken: set[str] = set()
    return {key: identifier(name, taken, ST_WORDS) for key, name in names}


def _grouped(fields: Iterable[tuple[Declared, str]]) -> list[Declared]:
    """Return the fields with the comment of each group attached to its first field."""
    grouped: list[Declared] = []
    last = ""
    for field, meaning in fields:
        grouped.append(field._replace(above=meaning if meaning != last else ""))
        last = meaning
    return grouped


def _meaning(variable: Variable) -> str:
    """Return the unit and the meaning of a variable, without the part that explains an absent value."""
    meaning = re.sub(r"; absent[^;]*$", "", variable.meaning)
    return f"{variable.unit}: {meaning}" if variable.unit else meaning


def structured_text_files(design: Design) -> dict[str, str]:
    """Return the files of the export by name, except the machine file and the manifest.

    Raises ParameterError for an axis instead of a controller, and StructureError for a table with too many entries.
    """
    if design.what != CONTROL:
        raise ParameterError("st: a PLC runs the control; export an axis as fmu2, fmu3 or c")
    P = design.name
    printed = program(design.layout, header(design))
    tried = check(design.layout, printed)
    *of_check, _ = checking = check_parts(printed, tried)
    parts = (*printed.structures, *printed.arrays, *of_check, *printed.units, tried)
    text = "\n".join(part.text() for part in checking)
    files = {f"{P}.st": printed.text(), f"{P}_check.st": text, f"{P}.xml": plcopen(P, parts)}
    files |= {f"twincat/{name}": content for name, content in map(twincat_file, parts)}
    files["README.md"] = _readme(design, printed)
    return files


def write_structured_text(design: Design, out: Path) -> Path:
    """Write the export atomically and return the path of its README.

    Raises the errors of `structured_text_files`, and FileError as `new_directory` does.
    """
    files = structured_text_files(design)
    return write_bundle(design, "st", out, files)


def header(design: Design) -> str:
    """Return the comment above the function block: title, usage, and the docstrings of the controller's blocks."""
    parts = [
        design.title,
        design.made_by,
        f"Call it once in every cycle of a task with a cycle of {_time(design)}.",
    ]
    for path, block in design.routine.blocks:
        docstring = inspect.getdoc(type(block))
        if path and docstring:
            parts.append(f"{path}: {block.kind}\n{textwrap.indent(docstring, '  ')}")
    lines: list[str] = []
    for line in "\n\n".join(parts).split("\n"):
        indent = " " * (len(line) - len(line.lstrip()))
        lines += textwrap.wrap(line, st.WIDTH, subsequent_indent=indent) or [""]
    return "\n".join(lines)


def _readme(design: Design, printed: Program) -> str:
    return readme(
        "structured_text.md.j2",
        design,
        time=_time(design),
        samples=SAMPLES,
        inputs=printed.block.sections[st.INPUTS],
        outputs=printed.block.sections[st.OUTPUTS],
        fields=printed.names,
        fixed=printed.fixed.parameters,
    )


def _time(design: Design) -> str:
    return f"{1e6 * design.routine.sample_time:.10g} µs"


NAMESPACE = "http://www.plcopen.org/xml/tc6_0200"
_XHTML = "http://www.w3.org/1999/xhtml"
_PLACES = {st.INPUTS: "inputVars", st.OUTPUTS: "outputVars", st.VARIABLES: "localVars", st.CONSTANTS: "localVars"}
_ELEMENTARY = ("LREAL", "REAL", "BOOL", "INT", "DINT")
_WHEN = "2000-01-01T00:00:00"  # the format requires a date; a fixed one makes the export reproducible


def plcopen(name: str, parts: Iterable[Structure | Array | Unit]) -> str:
    """Return the text of the PLCopen project file."""
    parts = list(parts)
    project = ET.Element("project", {"xmlns": NAMESPACE})
    ET.SubElement(
        project,
        "fileHeader",
        companyName="",
        productName="feeddrive",
        productVersion=__version__,
        creationDateTime=_WHEN,
    )
    header = ET.SubElement(project, "contentHeader", name=name)
    scales = ET.SubElement(header, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(scales, language), "scaling", x="1", y="1")
    types = ET.SubElement(project, "types")
    data, units = ET.SubElement(types, "dataTypes"), ET.SubElement(types, "pous")
    for part in parts:
        if isinstance(part, Structure):
            kind = ET.SubElement(ET.SubElement(data, "dataType", name=part.name), "baseType")
            struct = ET.SubElement(kind, "struct")
            for field in part.declared():
                _variable(struct, field)
        elif isinstance(part, Array):
            kind = ET.SubElement(ET.SubElement(data, "dataType", name=part.name), "baseType")
            inner = ET.SubElement(kind, "array")
            ET.SubElement(inner, "dimension", lower="0", upper=str(part.size - 1))
            _type(ET.SubElement(inner, "baseType"), part.element)
        else:
            _unit(units, part)
    ET.SubElement(ET.SubElement(project, "instances"), "configurations")
    ET.indent(project, " ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(project, encoding="unicode") + "\n"


def _unit(units: ET.Element, unit: Unit) -> None:
    pou = ET.SubElement(units, "pou", name=unit.name, pouType="function" if unit.result else "functionBlock")
    interface = ET.SubElement(pou, "interface")
    if unit.result:
        _type(ET.SubElement(interface, "returnType"), unit.result)
    for section, place in _PLACES.items():
        if unit.sections.get(section):
            constant = {"constant": "true"} if section == st.CONSTANTS else {}
            variables = ET.SubElement(interface, place, constant)
            for declared in unit.sections[section]:
                _variable(variables, declared)
    text = ET.SubElement(ET.SubElement(ET.SubElement(pou, "body"), "ST"), "xhtml", xmlns=_XHTML)
    text.text = "\n" + unit.implementation()
    if unit.comment:
        _document(pou, unit.comment)


def _variable(parent: ET.Element, declared: Declared) -> None:
    variable = ET.SubElement(parent, "variable", name=declared.name)
    _type(ET.SubElement(variable, "type"), declared.kind)
    if declared.value:
        initial = ET.SubElement(variable, "initialValue")
        if declared.value.startswith("["):
            row = ET.SubElement(initial, "arrayValue")
            for value in declared.value.strip("[]").split(", "):
                ET.SubElement(ET.SubElement(row, "value"), "simpleValue", value=value)
        else:
            ET.SubElement(initial, "simpleValue", value=declared.value)
    if declared.meaning:
        _document(variable, declared.meaning)


def _document(parent: ET.Element, text: str) -> None:
    ET.SubElement(ET.SubElement(parent, "documentation"), "xhtml", xmlns=_XHTML).text = text


def _type(parent: ET.Element, kind: str | Array) -> None:
    if kind in _ELEMENTARY:
        ET.SubElement(parent, str(kind))
    else:
        ET.SubElement(parent, "derived", name=str(kind))


_HEAD = '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1" ProductVersion="3.1.4024.12">\n'


def twincat_file(part: Structure | Array | Unit) -> tuple[str, str]:
    """Return the name and the content of the TwinCAT file of a type, function or function block."""
    if isinstance(part, Structure | Array):
        body = f"    <Declaration><![CDATA[{_cdata(part.text())}]]></Declaration>\n"
        return f"{part.name}.TcDUT", _wrapped("DUT", part.name, "", body)
    body = (
        f"    <Declaration><![CDATA[{_cdata(part.declaration())}]]></Declaration>\n"
        f"    <Implementation>\n      <ST><![CDATA[{_cdata(part.implementation())}]]></ST>\n    </Implementation>\n"
    )
    return f"{part.name}.TcPOU", _wrapped("POU", part.name, ' SpecialFunc="None"', body)


def _wrapped(tag: str, name: str, more: str, body: str) -> str:
    """Return the file of an element. Its GUID depends only on the name, so that a new export replaces the old one."""
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"feeddrive/{tag}/{name}")
    return f'{_HEAD}  <{tag} Name="{name}" Id="{{{identity}}}"{more}>\n{body}  </{tag}>\n</TcPlcObject>\n'


def _cdata(text: str) -> str:
    """Return the text without sequences that would end its CDATA section."""
    return text.replace("]]>", "]] >")


# few, since they are constants in the memory of the PLC
SAMPLES = 100
_SEEDS = 10  # attempts: outputs of random samples are next to never outside the range of literals
_SAID = """\
Tries {name} on this PLC: call it in any task until done. It gives {samples} stored samples to the controller, with
a live change of parameters in between, and compares every output with the simulator's, all bits.
wrong = 0 says that this PLC computes what was simulated; otherwise first_wrong is the first sample that differs."""


def check(layout: Layout, program: Program, seed: int = 0) -> Unit:
    """Return the function block `axis_x_check`, which compares the controller with stored samples."""
    routine, name = layout.routine, layout.routine.name
    real = "LREAL" if layout.precision == "double" else "REAL"
    tried, expected = _tried(layout, program, seed)
    changes = tried.changes
    signals, wanted = [v.name for v in routine.inputs], [v.name for v in routine.outputs]
    constants = [
        _array(name, f"{what}_{v.name}", quantity(v.path), row, real)
        for what, variables, rows in (("given", routine.inputs, tried.inputs), ("wanted", routine.outputs, expected))
        for v, row in zip(variables, rows.T, strict=True)
    ]
    retunes = [f"(k = {sample})" for sample in changes]
    calls = [f"{signal} := given_{signal}[k]" for signal in signals]
    calls += [f"retune := {' OR '.join(retunes) or 'FALSE'}", "parameters := parameters"]
    differs = " OR ".join(f"(tried.{signal} <> wanted_{signal}[k])" for signal in wanted)
    body = [
        "IF NOT done THEN",
        *(st.INDENT + line for line in _changes(changes, program)),
        f"{st.INDENT}tried(",
        *(f"{st.INDENT * 2}{call}{',' if call != calls[-1] else ');'}" for call in calls),
        f"{st.INDENT}IF {differs} THEN",
        f"{st.INDENT * 2}IF wrong = 0 THEN",
        f"{st.INDENT * 3}first_wrong := k;",
        f"{st.INDENT * 2}END_IF;",
        f"{st.INDENT * 2}wrong := wrong + 1;",
        f"{st.INDENT}END_IF;",
        f"{st.INDENT}k := k + 1;",
        f"{st.INDENT}done := k >= {SAMPLES};",
        "END_IF;",
    ]
    return Unit(
        f"{name}_check",
        _SAID.format(name=name, samples=SAMPLES),
        sections={
            st.OUTPUTS: [
                Declared("done", "BOOL", "FALSE"),
                Declared("wrong", "DINT", "0", "samples that differ"),
                Declared("first_wrong", "DINT", "-1"),
            ],
            st.VARIABLES: [
                Declared("tried", name),
                Declared("parameters", f"{name}_parameters"),
                Declared("k", "DINT", "0"),
            ],
            st.CONSTANTS: constants,
        },
        body=body,
    )


def check_parts(program: Program, block: Unit) -> list[Array | Unit]:
    """Return the check block with the array types before it that the program lacks."""
    return [*(array for array in st.arrays([block]) if array not in program.arrays), block]


def _tried(layout: Layout, program: Program, seed: int) -> tuple[Trial, np.ndarray]:
    """Return the samples of the check block and the expected outputs, of the first seed whose numbers are literals."""
    for attempt in range(seed, seed + _SEEDS):
        # no broken inputs: Structured Text has no literal for NaN or infinity
        tried = trial(layout.routine, SAMPLES, attempt, changes=1, broken=0.0)
        changes = {
            # parameters that the export has fixed cannot change on the PLC
            sample: {path: value for path, value in changed.items() if path in program.names}
            for sample, changed in tried.changes.items()
        }
        tried = Trial(tried.inputs, changes)
        double = layout.precision == "double"
        expected = run(layout.routine, tried.inputs, changes) if double else stepped(layout, tried)
        if all(map(st.is_literal, [*tried.inputs.flat, *expected.flat])):
            return tried, expected
    raise StructureError(
        f"{layout.routine.name}: its outputs hold numbers for which Structured Text has no literals: export another "
        f"target"
    )


def _changes(changes: Mapping[int, Mapping[str, float]], program: Program) -> list[str]:
    lines: list[str] = []
    for sample, changed in changes.items():
        lines.append(f"IF k = {sample} THEN")
        lines += [
            f"{st.INDENT}parameters.{program.names[path]} := {bare(st.literal(v))};" for path, v in changed.items()
        ]
        # an IF without a statement is illegal
        lines += ["END_IF;"] if changed else [f"{st.INDENT};", "END_IF;"]
    return lines


def _array(prefix: str, name: str, signal: str, row: Sequence[float] | np.ndarray, real: str) -> Declared:
    """Return the declaration of a constant array with samples of a signal, in the type of that quantity."""
    if signal in ("enable", "enabled"):
        kind, texts = "BOOL", ["TRUE" if x > 0.5 else "FALSE" for x in row]
    elif signal == "trip":
        kind, texts = "INT", [f"{x:.0f}" for x in row]
    else:
        kind, texts = real, [st.decimal(float(x), real) for x in row]
    return Declared(name, Array(prefix, kind, len(texts)), f"[{', '.join(texts)}]")
