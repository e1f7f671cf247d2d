"""Checks whether a target can hold a routine: table length, range of single precision, supported operations."""

from __future__ import annotations

import numpy as np

from feeddrive.export.c.expressions import CALLS, FUNCTIONS, INFIX
from feeddrive.export.layout import Field, Layout
from feeddrive.export.layout_run import LayoutRun
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.graph import ELEMENTARY

LONGEST_TABLE = 65_536  # numbers: half a megabyte in double precision, more than the flash of most microcontrollers
_WORDS = {*INFIX, *CALLS, *FUNCTIONS, *ELEMENTARY, "select", "gather", "neg", "not"}
_LEAVES = ("const", "truth", "input", "table")


def check_exportable(layout: Layout) -> None:
    """Raise ParameterError or StructureError, with the place and what to do, if a routine cannot be written."""
    _check_tables(layout)
    _check_operations(layout)
    if layout.precision == "float":
        _check_numbers(layout)


def _check_tables(layout: Layout) -> None:
    for name, _, row in layout.routine.tables:
        if len(row) > LONGEST_TABLE:
            raise ParameterError(
                f"{name} has {len(row)} numbers, {len(row) - LONGEST_TABLE} more than the {LONGEST_TABLE} that an "
                f"export may hold: give it fewer, over a coarser grid or a shorter motion"
            )


def _check_operations(layout: Layout) -> None:
    for index, node in enumerate(layout.graph.nodes):
        single = layout.precision == "float" and layout.moving[index]
        if (node[0] not in _WORDS and node[0] not in _LEAVES) or (single and node[0] == "uniform"):
            owner = layout.makers.get(index, layout.routine.name)
            precision = " in single precision" if single else ""
            raise StructureError(f"{owner}: uses '{node[0]}', for which an export has no word{precision}: leave it out")


def _check_numbers(layout: Layout) -> None:
    """Every number that is stored in single precision must be one there too."""
    read = layout.moving_users
    for index, node in enumerate(layout.graph.nodes):
        if node[0] == "const" and read[index] and _too_large(float.fromhex(node[1])):
            owner = layout.makers.get(index, layout.routine.name)
            raise StructureError(f"{owner}: holds the number {float.fromhex(node[1]):g}, {_BEYOND}")
    with np.errstate(over="ignore"):
        stored, wide = LayoutRun(layout).design, LayoutRun(layout, wide=True).design
    for field in layout.design:
        if not field.truth and np.isinf(stored[field.node]) and np.isfinite(wide[field.node]):
            raise ParameterError(f"{_said(layout, field)} = {float(wide[field.node]):g}, {_BEYOND}")


_BEYOND = "beyond single precision, which ends at 3.4e38: take --precision double, or change the parameter"


def _too_large(value: float) -> bool:
    return bool(np.isfinite(value)) and abs(value) > float(np.finfo(np.float32).max)


def _said(layout: Layout, field: Field) -> str:
    """A design number by its dotted name if it is a parameter, else by its word."""
    kind, place = layout.leaves.get(field.node, ("", 0))
    return layout.routine.parameters[place].path if kind == "parameter" else f"the design number {field.name}"
