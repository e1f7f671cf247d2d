"""The laws that a comparison begins with are those that the tables of the benchmark show."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from feeddrive.files.machine import read_machine
from feeddrive.tuning.candidates import PLAIN, STANDING, candidates, likeliest

(PAGE,) = Path(__file__).parents[2].glob("docs/**/benchmark.md")


@pytest.mark.parametrize(("encoders", "word"), [(1, "one encoder"), (2, "two encoders")])
def test_the_standing_is_that_of_the_table_of_the_benchmark(encoders: int, word: str) -> None:
    text = PAGE.read_text(encoding="utf-8")
    table = text.partition(f"Rules 2, {word}: times better than P-PI at equal robustness")[2].partition("\n\nRules 2")[
        0
    ]
    rows = [line.split("|")[2:5:2] for line in table.splitlines() if re.match(r"\| \d", line)]
    times = {law.strip(" *"): float(figure.split()[0]) for law, figure in rows}
    # a prefilter has the gains of the law beside which it stands, and is not tuned
    better = [law for law, figure in times.items() if figure > 1.0 and not law.endswith("prefilter")]
    assert sorted(times.values(), reverse=True) == [*times.values()]
    assert list(STANDING[encoders]) == better


@pytest.mark.parametrize(("machine", "axis"), [("ball_screw", "x"), ("linear_motor", "x")])
def test_the_likeliest_are_four_that_can_control_the_axis(machine: str, axis: str) -> None:
    loop = read_machine(machine).loop(axis)
    possible = candidates(loop)[0]
    names = likeliest(loop, possible)
    assert names[0] == PLAIN
    assert len(names) == 4
    assert {*names} <= {law.name for law in possible if not law.like}
    assert names[1] == next(law for law in STANDING[loop.axis.encoders()] if law in {each.name for each in possible})
