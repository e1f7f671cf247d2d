"""Design values that are fixed at export because computing them takes too many operations for a PLC.

A filter takes some 30 operations, the gains of a pole placement 100, a matrix exponential 700 to 10 000.  What is above
the bound is written as initial values, and the parameters that it depends on cannot be changed on the PLC: a change
needs a new export.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from feeddrive.export.identifiers import ascii_text
from feeddrive.export.layout import Layout
from feeddrive.export.layout_run import LayoutRun
from feeddrive.export.structured_text.statements import Assignment, Section
from feeddrive.export.structured_text.units import (
    CONSTANTS,
    INDENT,
    INPUTS,
    OUTPUTS,
    VARIABLES,
    Declared,
    Unit,
    expression,
    literal,
    plain,
)
from feeddrive.language.graph import Graph, arguments, reachable
from feeddrive.loop.routine import Variable

MOST_OPERATIONS = 500  # behind one design number


@dataclass(frozen=True)
class Fixed:
    """The parts fixed by the export: design numbers with their values, and the parameters behind them.

    nodes  values of the nodes that depend on fixed parameters alone and are read by rules on others
    """

    fields: Mapping[str, float]
    parameters: tuple[Variable, ...]
    nodes: Mapping[int, float]


def fixed(layout: Layout) -> Fixed:
    """The design numbers that take too many operations, and what depends on the same parameters alone."""
    leaves = layout.leaves
    held: set[int] = set()
    below = {field.name: set(reachable(layout.graph, [field.node])) for field in layout.design}
    for nodes in below.values():
        if len(nodes) > MOST_OPERATIONS:
            held |= {node for node in nodes if leaves.get(node, ("", 0))[0] == "parameter"}
    values = LayoutRun(layout).design
    found: dict[str, float] = {}
    for field in layout.design:
        given = {node for node in below[field.name] if leaves.get(node, ("", 0))[0] == "parameter"}
        if given and given <= held:
            found[field.name] = float(values[field.node])
    routine = layout.routine
    return Fixed(
        found, tuple(routine.parameters[leaves[node][1]] for node in sorted(held)), _read_by_rules(layout, held)
    )


def _read_by_rules(layout: Layout, held: set[int]) -> dict[int, float]:
    """Operations on fixed parameters that rules on other parameters read, with their values."""
    graph, leaves = layout.graph, layout.leaves
    moves = _depending(graph, {node for node, (kind, _) in leaves.items() if kind == "parameter"} - held)
    stands = _depending(graph, held)
    rules = [rule for rule in layout.conditions[len(layout.routine.parameters) :] if moves[rule]]
    read = {i for index in reachable(graph, rules) if moves[index] for i in arguments(graph.nodes[index])}
    wanted = {i for i in read if stands[i] and not moves[i] and graph.nodes[i][0] not in ("const", "truth", "input")}
    values = LayoutRun(layout, wide=True).values(sorted(wanted))
    return dict(zip(sorted(wanted), values, strict=True))


def _depending(graph: Graph, others: set[int]) -> list[bool]:
    """Of each node whether it is one of some others or depends on one."""
    found: list[bool] = []
    for index, node in enumerate(graph.nodes):
        found.append(index in others or any(found[i] for i in arguments(node)))
    return found


class Printing(Protocol):
    """The printer of the other blocks: its layout, legal names and statements."""

    layout: Layout
    fixed: Fixed
    name: str
    real: str
    parameters: dict[str, str]
    design: dict[str, str]

    def section(self, leaves: Mapping[int, str], taken: Iterable[str], real: str) -> Section:
        """Where statements are collected, with the texts of what is there already and the names that are taken."""
        ...

    def computed(self, section: Section, nodes: Iterable[int]) -> list[str]:
        """The statements for some nodes."""
        ...

    def parameter(self, struct: str, i: int) -> str:
        """The text of a parameter."""
        ...

    def narrow(self, text: str) -> str:
        """A long real where it is stored."""
        ...


def configure(printer: Printing) -> Unit:
    """Always in long reals: the design has the best numbers that a short one can store.

    Bounds are checked first, then the rules between parameters, then the design is computed, each only if all before
    hold: what is refused divides nothing by zero.
    """
    layout = printer.layout
    wanted = [field for field in layout.design if field.name not in printer.fixed.fields]
    leaves: dict[int, str] = {node: literal(value) for node, value in printer.fixed.nodes.items()}
    for node, (kind, i) in layout.leaves.items():
        if kind == "sample_time":
            leaves[node] = literal(layout.routine.sample_time)
        elif kind == "parameter":
            leaves[node] = printer.parameter("parameters", i)
    section = printer.section(leaves, ["parameters", "design", "rule"], "LREAL")
    for node, (kind, i) in layout.leaves.items():
        if kind == "table":  # one that is read at fixed places: what a law computes of it depends on parameters only
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
            INPUTS: [Declared("parameters", f"{printer.name}_parameters")],
            OUTPUTS: [
                Declared("design", f"{printer.name}_design"), Declared("rule", "DINT", "0", "0, or the broken rule")
            ],
            VARIABLES: section.variables,
            CONSTANTS: section.constants(),
        },
        body=lines,
    )  # fmt: skip


def _is_tunable(printer: Printing, node: int) -> bool:
    """Whether a node depends on a parameter that can be changed on the PLC."""
    for i in reachable(printer.layout.graph, [node]):
        kind, place = printer.layout.leaves.get(i, ("", 0))
        if kind == "parameter" and printer.layout.routine.parameters[place].path in printer.parameters:
            return True
    return False


def _inline(layout: Layout, node: int, section: Section, prefix: str) -> str:
    """The comparisons of a bound, in one expression."""
    name, *values = layout.graph.nodes[node]
    if name == "and":
        return f"({' AND '.join(_inline(layout, i, section, prefix) for i in values)})"
    texts = [section.statements.texts.get(i) or literal(float.fromhex(layout.graph.nodes[i][1])) for i in values]
    return expression(name, texts, prefix)


def _refused(layout: Layout, holds: str, code: int) -> list[str]:
    """Keep the code of the first condition that does not hold."""
    said = plain(ascii_text(layout.routine.sentences[code]))
    return [f"(* {code}: {said} *)", f"IF (rule = 0) AND (NOT {holds}) THEN", f"{INDENT}rule := {code};", "END_IF;"]


def _unless_broken(lines: list[str]) -> list[str]:
    """Lines for parameters that break no rule so far."""
    return ["IF rule = 0 THEN", *(f"{INDENT}{line}".rstrip() for line in lines), "END_IF;"] if lines else []
