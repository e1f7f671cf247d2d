"""One payload at a place of a gain schedule, with the law that holds for it."""

from typing import Any

from feeddrive.blocks.families import Law
from feeddrive.language import tree
from feeddrive.language.block import Block, Number, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.graph import Graph, Symbol, reachable
from feeddrive.language.recent import Recent

# of a law's `prepare`, which runs twice in each sample: pole placement takes 90, a GPI observer of one state 870
MOST_OPERATIONS = 500


class ScheduleLoad(Block):
    """A payload on the axis and the law with the parameters that are right for it, at one place of a `GainSchedule`.

        p(payload) = the parameters of this law

    The payload is the mass that is added to the table.
    """

    payload: Number = parameter("kg", "mass on the table for which the parameters of this law hold", least=0)
    law: Law = part("the law with its parameters for this payload")

    def check(self) -> None:
        """Raise StructureError for a law that a schedule cannot interpolate in each sample."""
        require_schedulable(self.law, f"{self.kind}.law")


def require_schedulable(law: Law, where: str) -> None:
    """Raise StructureError for a law that a schedule cannot interpolate in each sample."""
    if any(isinstance(block, Law) and block.scheduled_at() for block in tree.blocks(law)):
        raise StructureError(f"{where} = {law.kind} is itself a schedule: one position gives one schedule")
    if law.steps_live:
        raise StructureError(
            f"{where}: the force of {law.kind} jumps at every change of its parameters, and a schedule changes "
            f"them in each sample: take another law"
        )
    if not _is_short.get(tree.structure(law), lambda: _computes_few(law)):
        raise StructureError(
            f"{where}: {law.kind} computes its gains by more than {MOST_OPERATIONS} operations, too many for a "
            f"schedule, which computes them in each sample; take a law with fewer, such as cascade_ppi, "
            f"pole_placement, linear_adrc, dadsc or super_twisting"
        )


class _TooLongError(Exception):
    """The `prepare` of a law has far more operations than a schedule admits."""


class _ShortGraph(Graph):
    """A graph that ends a trace which has become far too long."""

    def apply(self, name: str, *arguments: Any) -> Symbol:
        # operations that no result needs are stored as well: they are not counted in the end
        if len(self.nodes) > 4 * MOST_OPERATIONS:
            raise _TooLongError
        return super().apply(name, *arguments)


_is_short: Recent[bool] = Recent(64)


def _computes_few(law: Law) -> bool:
    """Return True if the law's `prepare` takes at most `MOST_OPERATIONS` operations."""
    graph = _ShortGraph()
    traced: Any = tree.rebuild(law, (graph.input(name) for name, _ in tree.leaves(law)))
    traced = tree.with_tables(traced, {name: graph.table(name, len(row)) for name, row in tree.tables(law)})
    try:
        prepared = traced.prepare(graph.input("T"))
    except _TooLongError:
        return False
    ends = [graph.symbol(value).index for _, value in tree.leaves(prepared)]
    count = sum(graph.nodes[node][0] not in ("const", "input", "table") for node in reachable(graph, ends))
    return count <= MOST_OPERATIONS
