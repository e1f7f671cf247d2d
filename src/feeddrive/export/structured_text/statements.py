"""From a graph to statements: every choice becomes an IF, every named number a variable.

An unnamed operation that is used once is written inside the expression that uses it.  A choice is
an IF and not SEL, which computes both sides: what is not chosen must not divide by zero on a PLC that traps it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import cast

from feeddrive.export.identifiers import ST_WORDS, bare, identifier
from feeddrive.export.layout import word
from feeddrive.export.structured_text.units import HUGE, INDENT, Declared, decimal, expression, huge, literal, own
from feeddrive.language.block import Block
from feeddrive.language.errors import StructureError
from feeddrive.language.graph import TRUTH, Graph, arguments
from feeddrive.language.naming import Name

WIDTH = 84  # an expression longer than this is cut by giving a part of it a name
LEAVES = ("input", "const", "truth", "table")


@dataclass
class Assignment:
    """`target := text;`"""

    target: str
    text: str
    needs: frozenset[int] = frozenset()  # nodes whose variables it reads
    owner: str | None = None  # the block in whose text it stands

    def lines(self) -> list[str]:
        """As text."""
        return [f"{self.target} := {bare(self.text)};"]


@dataclass
class Choice:
    """IF condition THEN ... ELSE ... END_IF; of assignments and of choices inside."""

    condition: str
    then: list[Assignment | Choice]
    otherwise: list[Assignment | Choice]
    needs: frozenset[int]
    owner: str | None = None
    makes: set[int] = field(default_factory=set)

    def lines(self) -> list[str]:
        """As text; a choice alone in the other branch becomes ELSIF."""
        found = [f"IF {bare(self.condition)} THEN", *_indented(self.then)]
        rest = self.otherwise
        while len(rest) == 1 and isinstance(rest[0], Choice):
            inner = rest[0]
            found += [f"ELSIF {bare(inner.condition)} THEN", *_indented(inner.then)]
            rest = inner.otherwise
        return [*found, "ELSE", *_indented(rest), "END_IF;"]


def _indented(statements: Iterable[Assignment | Choice]) -> list[str]:
    return [INDENT + line for statement in statements for line in statement.lines()]


def _append(done: list[Assignment | Choice], made: Assignment | Choice) -> None:
    """Append; a choice is merged with the one before if both have the same condition."""
    last = done[-1] if done else None
    if isinstance(last, Choice) and isinstance(made, Choice) and last.condition == made.condition:
        for branch, more in ((last.then, made.then), (last.otherwise, made.otherwise)):
            for statement in more:
                _append(branch, statement)
        last.needs |= made.needs
    else:
        done.append(made)


def _no_array(size: int) -> str:
    raise AssertionError(f"no place for a row of {size} numbers")


class Statements:
    """The statements that compute some nodes of a graph.

    `texts` has the text of leaves and of nodes that were computed before.  `declare(node, kind)` returns the name of
    a new variable of a type, or of a variable that has the value already.
    """

    def __init__(
        self,
        graph: Graph,
        texts: Mapping[int, str],
        declare: Callable[[int, str], str],
        named: Iterable[int],
        prefix: str,
        real: str = "LREAL",
        makers: Mapping[int, str] | None = None,
    ) -> None:
        self.graph = graph
        self.texts = dict(texts)
        self.declare = declare
        self.named = set(named)
        self.prefix = prefix
        self.real = real
        self.makers = makers or {}
        self.bounds: set[int] = set()  # numbers that stand behind in a comparison, as constants do
        self.used: set[str] = set()  # operations
        self.array: Callable[[int], str] = _no_array
        self.done: list[Assignment | Choice] = []
        self._reads: dict[int, frozenset[int]] = {}  # nodes whose variables a node's text reads
        self._held: set[int] = set()
        self._inside: set[int] = set()  # choices that stand inside another choice

    def compute(self, roots: Iterable[int], held: Iterable[int] = ()) -> list[Assignment | Choice]:
        """The statements for some nodes in the order of the law's text; those in `held` get a variable in any case."""
        roots, self._held = list(roots), set(held)
        order = self._needed(roots)
        uses = Counter(i for index in order for i in arguments(self.graph.nodes[index]))
        uses.update(roots)
        uses.update(2 * list(self._held))
        alone = {index for index in order if uses[index] == 1 and index not in self.named}
        for index in order:
            name = self.graph.nodes[index][0]
            if name == "select":
                self._inside |= {
                    i
                    for i in arguments(self.graph.nodes[index])[1:]
                    if i in alone and self.graph.nodes[i][0] == "select"
                }
        for index in order:
            self._node(index, index in alone)
        return self.done

    def _needed(self, roots: list[int]) -> list[int]:
        """What is computed here, each node after its arguments."""
        found: set[int] = set()
        waiting = list(roots)
        while waiting:
            index = waiting.pop()
            if index not in found and index not in self.texts:
                found.add(index)
                waiting.extend(arguments(self.graph.nodes[index]))
        return sorted(found)

    def _node(self, index: int, alone: bool) -> None:
        node = self.graph.nodes[index]
        match node[0]:
            case "const":
                self._hold(index, literal(float.fromhex(node[1]), self.real), frozenset())
            case "truth":
                self._hold(index, "TRUE" if node[1] else "FALSE", frozenset())
            case "input" | "table":
                raise AssertionError(f"no text for the leaf '{node[1]}'")
            case "select":
                if index not in self._inside:
                    self._choice(index)
            case "decays":
                size, array = len(node) - 1, self.array(len(node) - 1)
                self.used.add(f"decays_{size}")
                entries = [(k, self.texts[i]) for k, i in enumerate(arguments(node)) if self.texts[i] != "0.0"]
                reads = self._all_reads(arguments(node))
                for k, text in entries:
                    self.done.append(Assignment(f"{array}[{k}]", text, reads))
                called = f"{own(self.prefix, f'decays_{size}', self.real)}({array})"
                self.done.append(Assignment(self._variable(index, "BOOL"), called, reads))
            case name:
                self.used.add(name)
                values = arguments(node)
                text = expression(name, [self.texts[i] for i in values], self.prefix, self.real)
                if name in ("lt", "le") and (values[0] in self.bounds or self.graph.nodes[values[0]][0] == "const"):
                    text = f"({self.texts[values[1]]} {'>' if name == 'lt' else '>='} {self.texts[values[0]]})"
                reads = self._all_reads(values)
                trivial = name in ("neg", "not") and self.graph.nodes[values[0]][0] in LEAVES
                trivial = trivial and index not in self.named and index not in self._held
                if trivial or (alone and len(text) <= WIDTH):
                    self._hold(index, text, reads)
                    return
                target = self._variable(index, "BOOL" if name in TRUTH else self.real)
                self._add(Assignment(target, text, reads, self.makers.get(index)))

    def _hold(self, index: int, text: str, reads: frozenset[int]) -> None:
        self.texts[index] = text
        self._reads[index] = reads

    def _variable(self, index: int, kind: str) -> str:
        name = self.declare(index, kind)
        self._hold(index, name, frozenset({index}))
        return name

    def _all_reads(self, values: Iterable[int]) -> frozenset[int]:
        return frozenset().union(*(self._reads.get(i, frozenset({i})) for i in values))

    def _add(self, statement: Assignment) -> None:
        """Append after the present statements, or before an independent choice at their end, to merge choices."""
        last = self.done[-1] if self.done else None
        place = (
            len(self.done) - 1 if isinstance(last, Choice) and not (statement.needs & last.makes) else len(self.done)
        )
        self.done.insert(place, statement)

    def _choice(self, index: int) -> None:
        """A choice, or two more assignments in the one before on the same condition."""
        made = self._branches(index, self._variable(index, self._kind(index)))
        _append(self.done, made)
        cast(Choice, self.done[-1]).makes.add(index)

    def _kind(self, index: int) -> str:
        """BOOL for a choice between truth values."""
        name, *values = self.graph.nodes[index]
        if name == "select":
            return self._kind(values[1])
        return "BOOL" if name in TRUTH or name == "truth" else self.real

    def _branches(self, index: int, target: str) -> Choice:
        condition, *sides = arguments(self.graph.nodes[index])
        then, otherwise = (self._branch(side, target) for side in sides)
        needs = self._all_reads([condition]) | then.needs | otherwise.needs
        return Choice(self.texts[condition], [then], [otherwise], needs, self.makers.get(index))

    def _branch(self, side: int, target: str) -> Assignment | Choice:
        if side in self._inside:
            return self._branches(side, target)
        return Assignment(target, self.texts[side], self._all_reads([side]))


MOST_ENTRIES = 10_000  # of a table: an array with its first values in the source


class Section:
    """The statements of one block, and the variables that they need."""

    def __init__(
        self,
        prefix: str,
        blocks: Mapping[str, Block],
        graph: Graph,
        leaves: Mapping[int, str],
        names: Mapping[int, Name],
        makers: Mapping[int, str],
        real: str,
        taken: Iterable[str],
    ) -> None:
        self.blocks, self.graph, self.names, self.real = blocks, graph, names, real
        self.variables: list[Declared] = []
        self.places: dict[int, str] = {}  # where a number goes that needs no variable of its own
        self._tables: dict[str, Declared] = {}
        self._taken = {HUGE, *taken}
        self._lines: list[str] = []
        self.statements = Statements(graph, leaves, self._declare, names, prefix, real, makers)
        self.statements.array = self.array

    def _declare(self, index: int, kind: str) -> str:
        if index in self.places:
            return self.places[index]
        name = identifier(self._wanted(index), self._taken, ST_WORDS)
        self.variables.append(Declared(name, kind))
        return name

    def _wanted(self, index: int) -> str:
        """The variable name in the law; that of the state for one that may have been reset; else a number."""
        if index in self.names:
            return word(self.names[index])
        node = self.graph.nodes[index]
        kept = self.statements.texts.get(node[2], "") if node[0] == "select" else ""
        return kept.removeprefix("state.") if kept.startswith("state.") else f"v{len(self.variables) + 1}"

    def array(self, size: int) -> str:
        """A variable for a row of numbers."""
        name = identifier("matrix", self._taken, ST_WORDS)
        self.variables.append(Declared(name, f"ARRAY[0..{size - 1}] OF {self.real}"))
        return name

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
        """Enable is a BOOL, which replaces its comparison with one half."""
        for index, each in enumerate(self.graph.nodes):
            if each[0] == "lt" and each[2] == node and self.graph.nodes[each[1]] == ("const", (0.5).hex()):
                self.statements.texts[index] = "switched_on"

    def compute(self, nodes: Iterable[int]) -> list[str]:
        """Statements for some nodes, under the names of the blocks in whose text they stand."""
        nodes = list(nodes)
        self.statements.done = []
        found = self.statements.compute(nodes, nodes)
        self._lines = []
        owner = None
        for each in found:
            if each.owner is not None and each.owner != owner:
                owner = each.owner
                kind = self.blocks[owner].kind if owner in self.blocks else ""
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
