"""Tables in a terminal, also in a narrow one."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from feeddrive.cli.terminal import DrawnTable
from feeddrive.language.table import Table


@pytest.mark.parametrize("width", [20, 30, 60, 120])
def test_no_value_is_cut(width: int) -> None:
    rows = [["row", "2998", "12.5", "-366.5"], ["another row", "1", "5.468e-09", "0.00305"]]
    out = io.StringIO()
    Console(file=out, width=width).print(
        DrawnTable(Table("a title", ["name", "lines inside", "discs wider by", "deg"], rows))
    )
    shown = "".join(out.getvalue().split())
    for row in rows:
        for cell in row:
            assert cell.replace(" ", "") in shown
