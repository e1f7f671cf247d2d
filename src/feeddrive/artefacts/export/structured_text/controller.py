"""A control as structures and function blocks: the law in one block, what is done once in three others.

    axis_x             one sample; a reset in the first cycle, and a retune at a rising edge
    axis_x_configure   parameters -> design numbers
    axis_x_reset       design, inputs -> state: disabled, where the axis is
    axis_x_retune      state, parameters and design before and after -> state

What takes more than `MOST_OPERATIONS` to configure, such as a matrix exponential, is not computed on the PLC: its
design numbers stand as first values in the structure, and the parameters that they depend on are fixed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from feeddrive.artefacts.export.identifiers import ST_WORDS, identifier
from feeddrive.artefacts.export.layout import Field, Layout, word
from feeddrive.artefacts.export.layout_run import LayoutRun
from feeddrive.artefacts.export.structured_text.functions import functions, huge
from feeddrive.artefacts.export.structured_text.statements import Assignment, Statements
from feeddrive.artefacts.export.structured_text.units import (
    CONSTANTS,
    INPUTS,
    OUTPUTS,
    VARIABLES,
    Declared,
    Structure,
    Unit,
)
from feeddrive.artefacts.export.structured_text.words import HUGE, decimal, literal
from feeddrive.language.errors import StructureError
from feeddrive.language.graph import Graph, reachable
from feeddrive.language.naming import Name
from feeddrive.loop.routine import Variable

MOST_OPERATIONS = 2000  # of one design number: some 20 us on a PLC, once
MOST_ENTRIES = 10_000  # of a table: an array with its first values in the source
CYCLE_TOLERANCE = 1e-6  # of the sample time: a task's cycle is known to 100 ns or better


@dataclass(frozen=True)
class Frozen:
    """What is fixed by the export: design numbers with their values, and the parameters behind them."""

    fields: Mapping[str, float]
    parameters: tuple[Variable, ...]


def frozen(layout: Layout) -> Frozen:
    """The design numbers that take too many operations, and what depends on the same parameters alone."""
    leaves = layout.leaves
    fixed: set[int] = set()
    below = {field.name: set(reachable(layout.graph, [field.node])) for field in layout.design}
    for nodes in below.values():
        if len(nodes) > MOST_OPERATIONS:
            fixed |= {node for node in nodes if leaves.get(node, ("", 0))[0] == "parameter"}
    values = LayoutRun(layout).design
    found: dict[str, float] = {}
    for field in layout.design:
        given = {node for node in below[field.name] if leaves.get(node, ("", 0))[0] == "parameter"}
        if given & fixed and given <= fixed:
            found[field.name] = float(values[field.node])
    routine = layout.routine
    return Frozen(found, tuple(routine.parameters[leaves[node][1]] for node in sorted(fixed)))


@dataclass(frozen=True)
class Program:
    """All that is printed, in the order in which it must be read."""

    structures: tuple[Structure, ...]
    units: tuple[Unit, ...]
    frozen: Frozen

    @property
    def block(self) -> Unit:
        """The function block that a PLC calls."""
        return self.units[-1]

    def text(self) -> str:
        """As one source file."""
        return "\n".join(each.text() for each in (*self.structures, *self.units))


class Printer:
    """Prints a layout; names of fields are made legal once, and used everywhere."""

    def __init__(self, layout: Layout, said: str) -> None:
        self.layout, self.said = layout, said
        self.routine, self.name = layout.routine, layout.routine.name
        self.real = "LREAL" if layout.precision == "double" else "REAL"
        self.frozen = frozen(layout)
        fixed = {variable.path for variable in self.frozen.parameters}
        self.parameters = _legal((v.path, v.name) for v in self.routine.parameters if v.path not in fixed)
        self.design = _legal((f.name, f.name) for f in layout.design)
        self.states = _legal((v.path, v.name) for v in self.routine.states)
        self.used: dict[str, set[str]] = {"LREAL": set(), "REAL": set()}
        self._reset_inputs: list[str] = []

    def program(self) -> Program:
        """Structures, functions and function blocks."""
        blocks = [self._configure(), self._reset(), self._retune(), self._step()]
        own = [unit for real, used in self.used.items() for unit in functions(used, self.name, real)]
        return Program(self._structures(), (*own, *blocks), self.frozen)

    def _structures(self) -> tuple[Structure, ...]:
        parameters = [
            Declared(self.parameters[v.path], "LREAL", decimal(v.value), _meaning(v))
            for v in self.routine.parameters
            if v.path in self.parameters
        ]
        design = [Declared(self.design[f.name], self._kind(f), self._frozen_value(f)) for f in self.layout.design]
        states = [Declared(self.states[v.path], self.real) for v in self.routine.states]
        return (
            Structure(f"{self.name}_parameters", "What can be changed while the loop runs; see retune.", parameters),
            Structure(f"{self.name}_design", "Numbers that depend on parameters only.", design),
            Structure(f"{self.name}_state", "What is remembered from sample to sample.", states),
        )

    def _kind(self, field: Field) -> str:
        return "BOOL" if field.truth else self.real

    def _frozen_value(self, field: Field) -> str:
        value = self.frozen.fields.get(field.name)
        if value is None:
            return ""
        return ("TRUE" if value else "FALSE") if field.truth else decimal(value, self.real)

    # the four blocks

    def _configure(self) -> Unit:
        """Always in long reals: the design has the best numbers that a short one can store."""
        wanted = [field for field in self.layout.design if field.name not in self.frozen.fields]
        fixed = {v.path: v.value for v in self.frozen.parameters}
        leaves = {}
        for node, (kind, i) in self.layout.leaves.items():
            if kind == "sample_time":
                leaves[node] = literal(self.routine.sample_time)
            elif kind == "parameter":
                path = self.routine.parameters[i].path
                leaves[node] = literal(fixed[path]) if path in fixed else f"parameters.{self.parameters[path]}"
        layout = self.layout
        section = _Section(self, layout.graph, leaves, layout.names, layout.makers, "LREAL", ["parameters", "design"])
        if self.real == "LREAL":
            section.places = {field.node: f"design.{self.design[field.name]}" for field in wanted}
        lines = section.compute([field.node for field in wanted])
        for field in wanted:
            text, place = section.statements.texts[field.node], f"design.{self.design[field.name]}"
            short = self.real == "REAL" and not field.truth
            if text != place:
                lines += Assignment(place, f"LREAL_TO_REAL({text})" if short else text).lines()
        return Unit(
            f"{self.name}_configure", "What depends on parameters only: once, not in every sample.",
            sections={
                INPUTS: [Declared("parameters", f"{self.name}_parameters")],
                OUTPUTS: [Declared("design", f"{self.name}_design")],
                VARIABLES: section.variables,
            },
            body=lines or [";"],
        )  # fmt: skip

    def _reset(self) -> Unit:
        inputs = self._inputs()
        section = self._sampled([each.name for each in inputs])
        lines = section.compute(self.layout.reset.states)
        lines += section.assign(self._targets(self.layout.reset.states))
        inputs = self._read(inputs, lines)
        self._reset_inputs = [each.name for each in inputs]
        return Unit(
            f"{self.name}_reset", "The state of a loop that is off and has no trip, where the axis is.",
            sections={
                INPUTS: [Declared("design", f"{self.name}_design"), *inputs],
                OUTPUTS: [Declared("state", f"{self.name}_state")],
                VARIABLES: section.variables,
                CONSTANTS: section.constants(),
            },
            body=lines,
        )  # fmt: skip

    def _read(self, inputs: list[Declared], lines: list[str]) -> list[Declared]:
        """The inputs that statements read."""
        words = set(re.findall(r"\w+", "\n".join(lines)))
        return [each for each in inputs if each.name in words]

    def _retune(self) -> Unit:
        """In long reals, as configure."""
        retune = self.layout.retune
        assert retune is not None, "only a control is printed"
        short = self.real == "REAL"
        fixed = {v.path: v.value for v in self.frozen.parameters}
        fields = {field.node: field.name for field in self.layout.design}
        leaves: dict[int, str] = {}
        for node, (kind, i) in retune.leaves.items():
            if kind == "state":
                text = f"state.{self.states[self.routine.states[i].path]}"
                leaves[node] = f"REAL_TO_LREAL({text})" if short else text
            elif kind in ("old", "new"):
                path = self.routine.parameters[i].path
                held = "before" if kind == "old" else "after"
                leaves[node] = literal(fixed[path]) if path in fixed else f"{held}.{self.parameters[path]}"
            elif i in self.routine.prepared_leaves:
                made = self.layout.prepared[self.routine.prepared_leaves.index(i)][1]
                constant = self.layout.graph.nodes[made]
                held = "design_before" if kind == "old_prepared" else "design_after"
                if constant[0] == "const":
                    leaves[node] = literal(float.fromhex(constant[1]))
                elif made in fields:
                    text = f"{held}.{self.design[fields[made]]}"
                    leaves[node] = f"REAL_TO_LREAL({text})" if short else text
        taken = ["before", "after", "design_before", "design_after", "state", "retuned"]
        section = _Section(self, retune.graph, leaves, retune.names, retune.makers, "LREAL", taken)
        changed = [
            (variable, node)
            for variable, node in zip(self.routine.states, retune.states, strict=True)
            if retune.leaves.get(node) != ("state", self.routine.states.index(variable))
        ]
        lines = section.compute([node for _, node in changed])
        lines += ["retuned := state;"]
        lines += [
            line
            for variable, node in changed
            for text in [section.statements.texts[node]]
            for line in Assignment(
                f"retuned.{self.states[variable.path]}", f"LREAL_TO_REAL({text})" if short else text
            ).lines()
        ]
        return Unit(
            f"{self.name}_retune", "The state after a live change: forces and estimates go on without a jump.",
            sections={
                INPUTS: [
                    Declared("before", f"{self.name}_parameters"), Declared("after", f"{self.name}_parameters"),
                    Declared("design_before", f"{self.name}_design"), Declared("design_after", f"{self.name}_design"),
                    Declared("state", f"{self.name}_state"),
                ],
                OUTPUTS: [Declared("retuned", f"{self.name}_state")],
                VARIABLES: section.variables,
            },
            body=lines,
        )  # fmt: skip

    def _step(self) -> Unit:
        inputs, T = self._inputs(), literal(self.routine.sample_time, self.real)
        extra = [
            Declared("cycle_time", self.real, decimal(self.routine.sample_time, self.real),
                     "s: cycle of the calling task; the loop stays off unless it is the sample time"),
            Declared("reset", "BOOL", "FALSE", "TRUE: start anew where the axis is, off and without a trip"),
            Declared("retune", "BOOL", "FALSE", "rising edge: take the parameters over while the loop runs"),
            Declared("parameters", f"{self.name}_parameters", "", "taken over by the first cycle, reset and retune"),
        ]  # fmt: skip
        outputs = [self._output(v) for v in self.routine.outputs]
        outputs.append(Declared("cycle_wrong", "BOOL", "", "TRUE: the task has another cycle than the sample time"))
        own = [
            Declared("started", "BOOL", "FALSE", "whether there is a state"),
            Declared("retuned", "BOOL", "FALSE", "retune in the cycle before"),
            Declared("fresh", "BOOL"), Declared("switched_on", "BOOL"),
            Declared("active", f"{self.name}_parameters", "", "parameters in use"),
            Declared("design", f"{self.name}_design"), Declared("state", f"{self.name}_state"),
            Declared("configuring", f"{self.name}_configure"), Declared("resetting", f"{self.name}_reset"),
            Declared("retuning", f"{self.name}_retune"),
        ]  # fmt: skip
        section = self._sampled([each.name for each in (*inputs, *extra, *outputs, *own)])
        step = self.layout.step
        lines = section.compute([*step.states, *step.outputs])
        lines += ["", "(* outputs, and what the next sample remembers *)"]
        for variable, node in zip(self.routine.outputs, step.outputs, strict=True):
            text = section.statements.texts[node]
            if variable.name == "trip":
                lines.append(f"trip := {self.real}_TO_INT({text});")
            elif variable.name == "enabled":
                lines.append(f"enabled := {text} > {literal(0.5, self.real)};")
            else:
                lines += Assignment(variable.name, text).lines()
        lines += section.assign(self._targets(step.states))
        given = "".join(f",\n            {name} := {name}" for name in self._reset_inputs)
        tolerance = literal(CYCLE_TOLERANCE * self.routine.sample_time, self.real)
        first = _FIRST.format(inputs=given, T=T, tolerance=tolerance).splitlines()
        return Unit(
            self.name, self.said,
            sections={
                INPUTS: [*inputs, *extra], OUTPUTS: outputs,
                VARIABLES: [*own, *section.variables], CONSTANTS: section.constants(),
            },
            body=[*first, *lines],
        )  # fmt: skip

    def _inputs(self) -> list[Declared]:
        return [
            Declared(v.name, "BOOL" if v.name == "enable" else self.real, "",
                     "TRUE: the loop shall run" if v.name == "enable" else _meaning(v))
            for v in self.routine.inputs
        ]  # fmt: skip

    def _output(self, variable: Variable) -> Declared:
        special = {
            "trip": ("INT", "0 none, 1 reading, 2 following error, 3 velocity, 4 travel, 5 command is no number"),
            "enabled": ("BOOL", "TRUE while the loop runs, FALSE while it is off or tripped"),
        }
        kind, meaning = special.get(variable.name, (self.real, _meaning(variable)))
        return Declared(variable.name, kind, "", meaning)

    def _sampled(self, taken: Iterable[str]) -> _Section:
        """A section that reads inputs, state and design."""
        layout, routine = self.layout, self.routine
        fields = {field.node: f"design.{self.design[field.name]}" for field in layout.design}
        leaves: dict[int, str] = {}
        for node, (kind, i) in layout.leaves.items():
            if kind == "input":
                leaves[node] = routine.inputs[i].name
            elif kind == "state":
                leaves[node] = f"state.{self.states[routine.states[i].path]}"
        leaves |= fields
        taken = [*taken, "state", "design"]
        section = _Section(self, layout.graph, leaves, layout.names, layout.makers, self.real, taken)
        section.statements.bounds = set(fields)
        for node, (kind, i) in layout.leaves.items():
            if kind == "table":
                section.table(node, routine.tables[i][0], [float(x) for x in routine.tables[i][2]])
            elif kind == "input" and routine.inputs[i].name == "enable":
                section.switch(node)
        return section

    def _targets(self, nodes: Iterable[int]) -> list[tuple[str, int]]:
        pairs = zip(self.routine.states, nodes, strict=True)
        return [(f"state.{self.states[variable.path]}", node) for variable, node in pairs]


_FIRST = """\
(* The parameters are taken over in the first cycle, at a reset and at a retune. *)
fresh := reset OR (NOT started);
IF fresh OR (retune AND (NOT retuned)) THEN
    configuring(parameters := parameters);
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
END_IF;
retuned := retune;

(* A law is designed for its sample time: in a task with another cycle the loop stays off. *)
cycle_wrong := NOT (ABS(cycle_time - {T}) <= {tolerance});
switched_on := enable AND (NOT cycle_wrong);
"""


class _Section:
    """The statements of one block, and the variables that they need."""

    def __init__(
        self,
        printer: Printer,
        graph: Graph,
        leaves: Mapping[int, str],
        names: Mapping[int, Name],
        makers: Mapping[int, str],
        real: str,
        taken: Iterable[str],
    ) -> None:
        self.printer, self.graph, self.names, self.real = printer, graph, names, real
        self.variables: list[Declared] = []
        self.places: dict[int, str] = {}  # where a number goes that needs no variable of its own
        self._tables: dict[str, Declared] = {}
        self._taken = {HUGE, *taken}
        self._lines: list[str] = []
        self.statements = Statements(graph, leaves, self._declare, names, printer.name, real, makers)

    def _declare(self, index: int, kind: str) -> str:
        if index in self.places:
            return self.places[index]
        name = identifier(self._wanted(index), self._taken, ST_WORDS)
        self.variables.append(Declared(name, kind))
        return name

    def _wanted(self, index: int) -> str:
        """The law's word; that of the state for one that may have been reset; else a number."""
        if index in self.names:
            return word(self.names[index])
        node = self.graph.nodes[index]
        kept = self.statements.texts.get(node[2], "") if node[0] == "select" else ""
        return kept.removeprefix("state.") if kept.startswith("state.") else f"v{len(self.variables) + 1}"

    def table(self, node: int, path: str, row: list[float]) -> None:
        """A table as an array that is constant."""
        if len(row) > MOST_ENTRIES:
            raise StructureError(
                f"{path} has {len(row)} entries, more than the {MOST_ENTRIES} that fit into a Structured Text array; "
                f"leave it out, or export another target"
            )
        name = identifier(path.removeprefix("control."), self._taken, ST_WORDS)
        values = ", ".join(decimal(value, self.real) for value in row)
        self._tables[name] = Declared(name, f"ARRAY[0..{len(row) - 1}] OF {self.real}", f"[{values}]")
        self.statements.texts[node] = name

    def switch(self, node: int) -> None:
        """Enable is a BOOL: its comparison with one half stands for it."""
        for index, each in enumerate(self.graph.nodes):
            if each[0] == "lt" and each[2] == node and self.graph.nodes[each[1]] == ("const", (0.5).hex()):
                self.statements.texts[index] = "switched_on"

    def compute(self, nodes: Iterable[int]) -> list[str]:
        """Statements for some nodes, under the names of the blocks in whose text they stand."""
        found = self.statements.compute(nodes, nodes)
        self.printer.used[self.real] |= self.statements.used
        self._lines = []
        titles, owner = dict(self.printer.routine.blocks), None
        for each in found:
            if each.owner is not None and each.owner != owner:
                owner = each.owner
                kind = titles[owner].kind if owner in titles else ""
                shown = owner if not kind or owner.endswith(kind) else f"{owner}: {kind}"
                self._lines += [*([""] if self._lines else []), f"(* {shown or 'the loop'} *)"]
            self._lines += each.lines()
        if any(HUGE in line for line in self._lines):
            self.variables.append(huge(self.real))
        return self._lines

    def constants(self) -> list[Declared]:
        """The tables that the statements read."""
        return [each for name, each in self._tables.items() if any(f"{name}[" in line for line in self._lines)]

    def assign(self, targets: Iterable[tuple[str, int]]) -> list[str]:
        """`place := number;` for each, at once: what is overwritten and still wanted is taken first."""
        moved = [(place, self.statements.texts[index]) for place, index in targets]
        moved = [(place, text) for place, text in moved if place != text]
        places = {place for place, _ in moved}
        lines: list[str] = []
        held: dict[str, str] = {}
        for _, text in moved:
            if text in places and text not in held:
                name = identifier(f"last_{text.rpartition('.')[2]}", self._taken, ST_WORDS)
                self.variables.append(Declared(name, self.real))
                held[text] = name
                lines.append(f"{name} := {text};")
        return lines + [line for place, text in moved for line in Assignment(place, held.get(text, text)).lines()]


def _legal(names: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Key -> a name that Structured Text takes."""
    taken: set[str] = set()
    return {key: identifier(name, taken, ST_WORDS) for key, name in names}


def _meaning(variable: Variable) -> str:
    return f"{variable.unit}: {variable.meaning}" if variable.unit else variable.meaning
