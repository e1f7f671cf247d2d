"""The statements of one block, with the variables that they need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from feeddrive.export.identifiers import ST_WORDS, identifier
from feeddrive.export.layout import word
from feeddrive.export.structured_text.functions import huge
from feeddrive.export.structured_text.statements import Assignment, Statements
from feeddrive.export.structured_text.units import Declared
from feeddrive.export.structured_text.words import HUGE, decimal
from feeddrive.language.block import Block
from feeddrive.language.errors import StructureError
from feeddrive.language.graph import Graph
from feeddrive.language.naming import Name

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
        """The law's word; that of the state for one that may have been reset; else a number."""
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
        """Enable is a BOOL: its comparison with one half stands for it."""
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
