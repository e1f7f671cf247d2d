"""Records of kernels: what is refused, how they come from Python, what is written, and what a record costs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import kernel_records
import numpy as np
import pytest
from kernel_records import Counted, Ramp, Stretch

from feeddrive.language.kernels.kernel import THOROUGH, interpreted
from feeddrive.language.kernels.source import KernelError, by_field, columns, rows_for
from kernel_oracle import written

HEAD = """
from typing import NamedTuple
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Ints, Records, Records2, records

class Ramp(NamedTuple):
    rise: float
    time: float = 1.0

class Stretch(NamedTuple):
    begin: float
    up: Ramp
    held: bool = False

class Counted(NamedTuple):
    count: int
    x: float

class Wrong(NamedTuple):
    name: str

class Itself(NamedTuple):
    inner: "Itself"

class Late(NamedTuple):
    inner: "Unknown"

WHOLE = Ramp(0, 1)

@kernel
def other(ramp: Ramp, x: float) -> Ramp:
    return ramp

"""


def made(folder: Path, text: str, name: str = "f") -> Any:
    return written(folder, HEAD + text, name)


# what is written in a kernel, and what stands in the error: what is wrong, and what to write instead
REFUSED = {
    "y = ramp.rize": ("'Ramp' has no field 'rize'", "its fields are rise, time"),
    "y = stretch.up.rize": ("'Ramp' has no field 'rize'", "its fields are rise, time"),
    "y = table[0].up.rize": ("'Ramp' has no field 'rize'", "rise, time"),
    "y = table[0].Begin": ("'Stretch' has no field 'Begin'", "begin, up, held"),
    "y = table.begin": ("'table.begin' is not known", "index it first"),
    "y = x.rise": ("'x.rise' is not known", "records by their fields"),
    "y = ramp.rise.time": ("'ramp.rise.time' is not known", "records by their fields"),
    "y = row[0].rise": ("'row[0].rise' is not known", "records by their fields"),
    "y = ramp[0]": ("'ramp' is a Ramp without indices", "name a field"),
    "y = table[0, 1]": ("2 indices for Records[Stretch]", "name the field"),
    "y = table[0][1]": ("'table[0]' is a Stretch without indices", "name a field"),
    "ramp.rise = x": ("'ramp.rise' is assigned", "record = record._replace(rise=...)"),
    "table[0].begin = x": ("'table[0].begin' is assigned", "record = record._replace(begin=...)"),
    "ramp.rise += x": ("ramp.rise += x", "record = record._replace(rise=...)"),
    "ramp += x": ("'ramp' is of type Ramp", "name a field"),
    "table[0] += x": ("'table[0]' is a record", "compute with its fields"),
    "table[0] = x": ("of type Stretch and is given float", "give a Stretch"),
    "table[0] = ramp": ("of type Stretch and is given Ramp", "give a Stretch"),
    "table[0] = x, x": ("is a record and is given a tuple", "Stretch(...)"),
    "stretch = ramp": ("'stretch' is of type Stretch and is given Ramp", "another name"),
    "ramp = x": ("'ramp' is of type Ramp and is given float", "another name"),
    "y = ramp + x": ("'ramp' is of type Ramp", "name a field"),
    "y = ramp == ramp": ("compares Ramp with Ramp", "numbers"),
    "y = ramp if ramp else ramp": ("'ramp' is of type Ramp, not bool", "compare"),
    "y = ramp if x > 0.0 else stretch": ("chooses between Ramp and Stretch", "one type"),
    "y = len(ramp)": ("given Ramp", "array"),
    "y = Ramp()": ("gives no 'rise'", "(rise, time)"),
    "y = Ramp(x, x, x)": ("3 values for 2 fields", "(rise, time)"),
    "y = Ramp(0)": ("gives int for the field 'rise' of type float", "0.0 for 0"),
    "y = Ramp(x, time=1)": ("gives int for the field 'time'", "0.0 for 0"),
    "y = Ramp(x, rise=x)": ("'Ramp(x, rise=x)'", "each field once"),
    "y = Ramp(x, tame=x)": ("'Ramp' has no field 'tame'", "rise, time"),
    "y = Ramp(**x)": ("'Ramp(**x)'", "each field once"),
    "y = Stretch(x, x)": ("gives float for the field 'up' of type Ramp", "another"),
    "y = ramp._replace(tame=x)": ("'Ramp' has no field 'tame'", "rise, time"),
    "y = ramp._replace(x)": ("'ramp._replace(x)'", "record._replace(field=value)"),
    "y = x._replace(rise=x)": ("'x' is of type float, which is no record", "record._replace"),
    "y = ramp._asdict()": ("'ramp._asdict' is no kernel", "call kernels"),
    "y = WHOLE": ("gives int for the field 'rise'", "0.0 for 0"),
    "y = Wrong(x)": ("the field 'name' of 'Wrong' is of type str", "write float, int, bool"),
    "y = Itself(x)": ("holds itself", "index"),
    "y = Late(x)": ("the fields of 'Late' cannot be read", "define them above"),
    "y = other(stretch, x)": ("gives Stretch for 'ramp'", "takes Ramp"),
    "y = other(x, x)": ("gives float for 'ramp'", "takes Ramp"),
    "y = other(ramp=ramp, x=x)": ("names its arguments", "in their order"),
    "a, b, c = ramp": ("2 values for 3 names", "a value"),
    "a, b, c = other(ramp, x)": ("2 values for 3 names", "a value"),
    "a, b = table": ("of type Records[Stretch]", "a tuple or a row"),
    "if x > 0.0:\n        y = ramp\n    x = y.rise": ("'y' is read where", "before"),
    "y = records(Ramp, i)": ("'i' is no fixed size", "whole numbers"),
    "y = records(Ramp)": ("'records(Ramp)'", "one or two sizes"),
    "y = records(Ramp, 2, 2, 2)": ("'records(Ramp, 2, 2, 2)'", "one or two sizes"),
    "y = records(Ramp, 129)": ("'records(Ramp, 129)'", "256 numbers at most"),
    "y = records(3)": ("'records(3)'", "name = records(Record, 3)"),
    "y = records(Counted, 3)": ("fits no row", "keep whole numbers"),
    "y = records(Wrong, 3)": ("the field 'name' of 'Wrong'", "write float"),
    "if x > 0.0:\n        y = records(Ramp, 3)": ("'y = records(Ramp, 3)'", "outside of loops and branches"),
    "y = len(records(Ramp, 3))": ("'records(Ramp, 3)' makes an array here", "name = records(Record, 3)"),
    "y = records(Ramp, 3)\n    y = table": ("of type Records[Ramp] and is given Records[Stretch]", "another name"),
    "y = row\n    y = table": ("'y' is of type Floats and is given Records[Stretch]", "another name"),
}


def test_a_wrong_use_of_records_is_refused(tmp_path: Path):
    """With the file, the line, what it is, and what to write instead."""
    head = "@kernel\ndef f(x: float, row: Floats, ramp: Ramp, stretch: Stretch, table: Records[Stretch]) -> None:\n    "
    first = HEAD.count("\n") + 3
    for body, (what, remedy) in REFUSED.items():
        kernel = made(tmp_path, f"{head}{body}\n")
        with pytest.raises(KernelError) as error:
            kernel.unit.text()
        found = re.fullmatch(r"(.*), line (\d+), kernel 'f': (.+); (.+)", str(error.value))
        assert found, body
        assert found[1] == kernel.source.file
        assert first <= int(found[2]) <= first + body.count("\n"), body
        assert what in found[3], (body, found[3])
        assert remedy in found[4], (body, found[4])


HEADS = {
    "x: Records[Counted]) -> None": ("'Counted' has fields that are neither float nor bool", "fits no row"),
    "x: Records[float]) -> None": ("'Records[float]' is no type", "Records[of one]"),
    "x: Records) -> None": ("'Records' is no type", "Records[of one]"),
    "x: Wrong) -> None": ("the field 'name' of 'Wrong'", "write float"),
    "x: Records[Wrong]) -> None": ("the field 'name' of 'Wrong'", "write float"),
    "x: Ramp) -> Records[Ramp]": ("an array is returned", "caller"),
    "x: Ramp) -> Stretch": ("Ramp is returned where the annotation has Stretch", ""),
    "x: Ramp) -> tuple[Ramp, float]": ("is no tuple", "one by one"),
}


def test_a_kernel_with_a_wrong_record_in_its_head_is_refused(tmp_path: Path):
    for head, (what, remedy) in HEADS.items():
        with pytest.raises(KernelError, match=r", line \d+, kernel 'f'") as error:
            made(tmp_path, f"@kernel\ndef f({head}:\n    {'pass' if 'None' in head else 'return x'}\n").unit.text()
        assert what in str(error.value), (head, error.value)
        assert remedy in str(error.value), (head, error.value)


def test_records_of_the_caller_are_checked_in_both_ways():
    def refused(match: str, kernel: Any, *given: Any) -> None:
        with pytest.raises((TypeError, ValueError), match=match):
            kernel(*given)
        with interpreted(), pytest.raises((TypeError, ValueError), match=match):
            kernel(*given)

    ramp = Ramp(1.0)
    refused("'stretch' is Ramp: give Stretch", kernel_records.record_fields, ramp, 1.0)
    refused("'stretch' is tuple: give Stretch", kernel_records.record_fields, (1.0, ramp, True, ramp, 1.0), 1.0)
    refused("'stretch.up' is float: give Ramp", kernel_records.record_fields, Stretch(1.0, 2.0), 1.0)
    refused("'stretch.up.rise' is str: give float", kernel_records.record_fields, Stretch(1.0, Ramp("a")), 1.0)
    refused("'stretch.held' is int: give bool", kernel_records.record_fields, Stretch(1.0, ramp, 1), 1.0)
    refused(
        "'stretches' is an array with 6 columns: give 7, those of Stretch",
        kernel_records.record_bools,
        np.zeros((3, 6)),
        1,
    )
    refused(
        "'stretches' is an array of float64 with 1 indices: give float64 with 2",
        kernel_records.record_bools,
        np.zeros(7),
        1,
    )
    path = kernel_records.Path(
        np.ones(3), np.ones((3, 2)), np.ones((3, 3)), np.ones(3, np.int64), np.ones((3, 3, 2)), Counted(1, ramp, True)
    )
    path.caps.flags.writeable = False
    refused("'path.caps' is written to and is read-only", kernel_records.record_with_arrays, path, 0, 1.0)
    assert kernel_records.record_fields(stretch=Stretch(1, Ramp(2)), x=1) == (2.0, 0.5, False, np.inf)


def test_a_row_is_the_fields_in_their_order():
    stretches = rows_for(Stretch, 2)
    assert stretches.shape == (2, 7)
    stretches[1] = columns(Stretch(1.0, Ramp(2.0, 3.0), True, Ramp(4.0, 5.0), 6.0))
    assert stretches[1].tolist() == [1.0, 2.0, 3.0, 1.0, 4.0, 5.0, 6.0]
    assert kernel_records.record_is_a_value(stretches, 0, 1, 9.0)[2] == Stretch(
        9.0, Ramp(0.0, 0.0), False, Ramp(0.0, 0.0), 0.0
    )


def test_writing_into_arrays_of_records_counts_as_writing():
    def written(kernel: Any) -> set[str]:
        places = kernel.unit.function(kernel.source).written
        return {kernel.source.signature.leaves[place][0] for place in places}

    everything = {"path.begin", "path.caps", "path.piece", "path.table", "path.block"}
    assert written(kernel_records.record_with_arrays) == everything
    assert written(kernel_records.record_rows) == {"stretches", "block"}
    assert written(kernel_records.record_errors) == set()


def test_machine_code_on_disk_is_that_of_the_fields(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Another default, another constant or another order of fields is other code."""
    monkeypatch.setenv("FEEDDRIVE_CACHE", str(tmp_path / "cache"))
    fields = "class Pair(NamedTuple):\n    a: float\n    b: float = 2.0\n\nKNOWN = Pair(1.0)\n\n"
    text = "@kernel\ndef f(pairs: Records[Pair]) -> float:\n    return pairs[0].a - Pair(1.0).b + 10.0 * KNOWN.b\n"
    turned = fields.replace("a: float\n    b: float = 2.0", "b: float\n    a: float = 2.0")
    for changed, result in (
        (fields, 21.0),
        (fields.replace("2.0", "3.0"), 30.0),
        (turned, 13.0),
        (fields.replace("Pair(1.0)", "Pair(1.0, 4.0)"), 41.0),
    ):
        assert made(tmp_path, changed + text)(np.array([[3.0, 4.0]])) == result


def test_a_record_costs_nothing(tmp_path: Path):
    """A loop over records is no longer, as LLVM text, than the same loop over columns."""
    head = "@kernel\ndef f(table: {}, x: float) -> float:\n    total = 0.0\n    for k in range(len(table)):\n"
    loop = "        total = total + {} * x\n        table[k] = {}\n    return total\n"
    record = head.format("Records[Ramp]") + loop.format("table[k].rise", "Ramp(total, table[k].rise)")
    plain = head.format("Floats2") + loop.format("table[k, 0]", "total, table[k, 0]")
    counts = [made(tmp_path, text).unit.text(THOROUGH).count("\n") for text in (record, plain)]
    assert counts[0] < counts[1], "a row needs no check of its length"


def test_the_columns_of_an_array_as_one_record():
    """Views, nested as the record is; bools are true where the number is not 0."""
    rows = rows_for(Stretch, 4)
    rows[:] = np.arange(28.0).reshape(4, 7)
    rows[:, 3] = 0.0, 1.0, 2.0, 0.0
    stretches = by_field(Stretch, rows)
    assert stretches.held.tolist() == [False, True, True, False]
    for k in range(4):
        here = Stretch(
            stretches.begin[k],
            Ramp(stretches.up.rise[k], stretches.up.time[k]),
            bool(stretches.held[k]),
            Ramp(stretches.down.rise[k], stretches.down.time[k]),
            stretches.end[k],
        )
        assert columns(here) == [*rows[k, :3], float(rows[k, 3] != 0.0), *rows[k, 4:]]
    stretches.up.time[1] = 100.0
    assert rows[1, 2] == 100.0
