"""Text logs: every usual layout gives the same numbers; every broken line is named."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from counting import lines_run
from feeddrive.files.columns import Columns
from feeddrive.files.read_log import read_log
from feeddrive.files.readers import text_files
from feeddrive.files.readers.text_files import read_csv
from feeddrive.language.errors import LogError

NUMBERS = np.array([[0.0, 1.5, -2e-7], [0.001, -2.25, 3.0], [0.002, 12345.678, 0.0], [0.003, 0.1, 1e10]])


def read(text: str | bytes, wanted: frozenset[str] | None = None) -> Columns:
    return read_csv("a.csv", text.encode() if isinstance(text, str) else text, wanted)


def written(numbers: np.ndarray, separator: str, decimal: str) -> str:
    return "".join(separator.join(repr(float(x)) for x in row) + "\n" for row in numbers).replace(".", decimal)


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("  ", "."), (" ", ",")]
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("heads", ["", "names", "units", "row of units", "preamble", "comment"])
def test_every_layout(separator: str, decimal: str, end: str, heads: str) -> None:
    names = ["t", "x", "y"]
    above = {
        "": "",
        "names": separator.join(names) + "\n",
        "units": separator.join(["t[ms]", "x[µm]", "y(N)"]) + "\n",
        "row of units": separator.join(names) + "\n" + separator.join(["ms", "µm", "N"]) + "\n",
        "preamble": "Recorder 5\nDate:;2020-07-08\nPeriod:;6,4\n\n" + separator.join(names) + "\n",
        "comment": "# from the drive\n# " + separator.join(names) + "\n",
    }[heads]
    text = (above + written(NUMBERS, separator, decimal)).replace("\n", end)
    found = read(text)
    assert list(found.values) == (names if heads else ["column_1", "column_2", "column_3"])
    assert found.units == ({"t": "ms", "x": "um", "y": "N"} if "unit" in heads else {})
    np.testing.assert_array_equal(np.column_stack(list(found.values.values())), NUMBERS)
    assert found.place(3).removeprefix("line ") == str(above.count("\n") + 4)


@settings(max_examples=150)
@given(
    st.integers(1, 5).flatmap(
        lambda n: st.lists(st.lists(st.floats(width=64), min_size=n, max_size=n), min_size=2, max_size=30)
    ),
    st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", "."), (" ", ".")]),
)
def test_every_number_comes_back_exactly(numbers: list[list[float]], layout: tuple[str, str]) -> None:
    array = np.array(numbers)
    heads = layout[0].join(f"c{k}" for k in range(array.shape[1])) + "\n"
    found = read(heads + written(array, *layout))
    np.testing.assert_array_equal(np.column_stack(list(found.values.values())), array)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t,x\n0,1\n1,2\n", {"t": [0, 1], "x": [1, 2]}),
        ("t,x\n0,1\n1,2", {"t": [0, 1], "x": [1, 2]}),  # no end of line at the end
        ("t,x,\n0,1,\n1,2,\n", {"t": [0, 1], "x": [1, 2]}),  # a separator too many in every line
        ('"t","x"\n"0","1"\n"1","2"\n', {"t": [0, 1], "x": [1, 2]}),
        ('"t [s]";"x, y"\n"0";"1,5"\n"1";"2,5"\n', {"t": [0, 1], "x, y": [1.5, 2.5]}),
        ("t;date;x\n0;2020-01-01;5\n1;2020-01-02;6\n", {"t": [0, 1], "x": [5, 6]}),
        ("t,x\n\n0,1\n# a remark\n1,2\n   \n% another\n2,3\n// more\n", {"t": [0, 1, 2], "x": [1, 2, 3]}),
        ("x,x\n0,1\n1,2\n", {"x": [0, 1], "x_again": [1, 2]}),
        ("0;1\n1;2\n2;3\n3;4,5\n", {"column_1": [0, 1, 2, 3], "column_2": [1, 2, 3, 4.5]}),
        ("x\n1\n2\n3\n", {"x": [1, 2, 3]}),
        ("  0   1.5\n  1  -2.5\n", {"column_1": [0, 1], "column_2": [1.5, -2.5]}),
        ("t,x\n0,\n1,2\n2,3\n3,4\n", "a.csv: line 2, column 'x': is empty"),
        ("t,x\n0,1e999\n1,2\n", {"t": [0, 1], "x": [np.inf, 2]}),
        ("t,x\n0,+.5E-1\n1,2.\n", {"t": [0, 1], "x": [0.05, 2]}),
    ],
)
def test_small_texts(text: str, expected: dict[str, list[float]] | str) -> None:
    if isinstance(expected, str):
        with pytest.raises(LogError, match=expected):
            read(text)
    else:
        assert {name: values.tolist() for name, values in read(text).values.items()} == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "t,x\n0,1\n1,2\n2,3\n3\n",
            r"line 5 has 1 cells, the lines above 2: the file is cut off there; remove its last",
        ),
        (
            "t,x\n0,1\n1,2\n2\n3,4\n4,5\n5,6\n",
            r"line 4 has 1 cells, the lines above 2: '2'; correct or remove that line",
        ),
        ("t,x\n0,1\n1,2\n2,3,4\n3,4\n", r"line 4 has 3 cells, the lines above 2: '2,3,4'"),
        ("t,x\n0,1\n1,2\n2,abc\n3,4\n", r"line 4, column 'x': 'abc' is not a number; correct or remove that line"),
        ("t,x\n0,1\n1,2\n2,0x10\n3,4\n", r"line 4, column 'x': '0x10' is not a number"),
        ("t,x\n0,1\n1,2\n2,1_0\n3,4\n", r"line 4, column 'x': '1_0' is not a number"),
        ("t,x\n0,1\n1,2\n2,1;5\n3,4\n", r"line 4, column 'x': '1;5' is not a number"),
        ("t x\n0 1\n1 2\noverrun\n2 3\n", r"line 4 says that samples were lost \('overrun'\)"),
        ("", "holds no rows of numbers; a log is a table"),
        ("\n\n\n", "holds no rows of numbers; a log is a table"),
        ("t,x\n", "holds no rows of numbers; a log is a table of numbers"),
        ("hello world\nthis is a text\n", "holds no rows of numbers; a log"),
        ("G1 X0 Y0 F100\nG1 X10 Y5\nM30\n", "holds no rows of numbers; a log"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(text: str, message: str) -> None:
    with pytest.raises(LogError, match=message):
        read(text)


def test_a_bad_line_far_behind_the_sample_is_found() -> None:
    lines = [f"{k},{k + 1}" for k in range(5000)]
    lines[4321] = "4321,x"
    with pytest.raises(LogError, match=r"line 4322, column 'column_2': 'x' is not a number"):
        read("\n".join(lines))
    lines[4321] = "4321,1,1"  # the third cell is in no column, but the row is not one of the log
    with pytest.raises(LogError, match="line 4322 has 3 cells"):
        read("\n".join(lines), frozenset(["column_1"]))
    lines[4321] = '4321,"1"'
    assert read("\n".join(lines)).values["column_2"][4321] == 1.0


def test_rows_are_placed_by_their_line_in_the_file() -> None:
    found = read("head\n# remark\nt,x\n0,1\n\n1,2\n# remark\n2,3\n")
    assert [found.place(k) for k in range(3)] == ["line 4", "line 6", "line 8"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings(encoding: str) -> None:
    found = read("t [ms];größe [µm]\n0;1\n1;2\n".encode(encoding))
    assert list(found.values) == ["t", "größe"]
    assert found.units == {"t": "ms", "größe": "um"}


@pytest.mark.parametrize(
    ("head", "name", "unit"),
    [
        ("v [mm/s]", "v", "mm/s"),
        ("v (mm/s²)", "v", "mm/s2"),
        ("v[mm/s^2]", "v", "mm/s2"),
        ("torque (%)", "torque", "percent"),
        ("torque [Nm]", "torque", "N m"),
        ("phase [°]", "phase", "deg"),
        ("speed [U/min]", "speed", "rpm"),
        ("position [inc]", "position", "inc"),  # not known, but plainly a unit
        ("mean (over five runs)", "mean (over five runs)", ""),  # not a unit
        ("x_mm", "x_mm", ""),
    ],
)
def test_units_in_heads(head: str, name: str, unit: str) -> None:
    found = read(f"t;{head}\n0;1\n1;2\n")
    assert list(found.values)[1] == name
    assert found.units.get(name, "") == unit


def test_a_row_of_units_may_hold_counts() -> None:
    found = read(";Position actual value;Torque\nms;qc;%\n0.000;161;0.5\n1.000;160;0.4\n2.000;158;0.3\n")
    assert list(found.values) == ["time", "Position actual value", "Torque"]
    assert found.units == {"time": "ms", "Position actual value": "qc", "Torque": "percent"}


def test_a_recorder_file_with_a_preamble_of_the_same_width() -> None:
    """The last line of the preamble looks like a row of numbers; the heads below it say that it is none."""
    found = read("Max. samples:;500\nSampling period:;6.400\n;Velocity\nms;rpm\n0.000;161\n6.400;160\n12.800;158\n")
    assert list(found.values) == ["time", "Velocity"]
    assert found.units == {"time": "ms", "Velocity": "rpm"}
    assert found.values["Velocity"].tolist() == [161, 160, 158]


def test_the_recorder_files_of_the_lead_screw(shared: Path) -> None:
    files = sorted((shared / "leadscrew_epos" / "experiments").rglob("*.csv"))
    if not files:
        pytest.skip(f"NOT TESTED on recorder files: none in {shared / 'leadscrew_epos'}")
    for file in files:
        log = read_log(file)
        preamble = file.read_text().split("\n")
        period = next(float(line.split(";")[-1]) for line in preamble if line.startswith("Sampling period"))
        assert log.sample_time == pytest.approx(1e-3 * period, rel=1e-12)
        assert len(log) == 500
        assert log.units == {"Velocity actual value averaged": "rpm", "Torque actual value averaged": "percent"}
        last = [line for line in preamble if line.strip()][-1].split(";")
        assert log["Velocity actual value averaged"][-1] == float(last[1])
        assert log["Torque actual value averaged"][-1] == float(last[2])


def test_the_logs_of_a_real_planner(shared: Path) -> None:
    """Packed by gzip, in mm by the names of the columns, and without a column of time."""
    files = sorted((shared / "linuxcnc_logs").glob("*.csv.gz"))
    if not files:
        pytest.skip(f"NOT TESTED on planner logs: none in {shared / 'linuxcnc_logs'}")
    for file in files:
        with pytest.raises(LogError, match="has no column of time among x_"):
            read_log(file)
        names = gzip.decompress(file.read_bytes()).decode().split("\n")[0].split(",")
        log = read_log(file, {"setpoint_position": names[0]}, sample_time=1e-3)
        truth = np.loadtxt(file, delimiter=",", skiprows=1)
        np.testing.assert_allclose(log["setpoint_position"], truth[:, 0] * 1e-3, rtol=1e-15)
        assert log.time[-1] == pytest.approx(1e-3 * (len(truth) - 1))


def test_exports_of_figures_are_refused_for_their_missing_clock(shared: Path) -> None:
    for name in (
        "leadscrew_epos/friction_map_drive1.csv",
        "tokyo_stage_frf/frf.csv",
        "tokyo_motor_bench/frf_typeA.csv",
    ):
        with pytest.raises(LogError, match="has no column of time"):
            read_log(shared / name)


@pytest.mark.timeout(60)
def test_a_large_log_is_read() -> None:
    """200,000 rows of 7 columns, as 10 s at 20 kHz are; the limit of time is for a reader that never ends."""
    rows = "".join(f"{k * 5e-5:.6f},{k},{k + 1},{k + 2},1.234567,-2.5e-3,{k % 7}\n" for k in range(200_000))
    found = read("t,a,b,c,d,e,f\n" + rows)
    assert found.values["f"][-1] == 199_999 % 7


def test_a_text_is_the_same_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two megabytes are taken at once; here 3 kB, with comments, empty lines, quotes and µ anywhere."""
    lines = ["head", "t [ms];x [µm]"]
    for k in range(2000):
        lines.append(f"{k};{k % 13 - 6}" if k % 7 else f'{k};"{k % 13 - 6}"')
        lines += ["# µ"] if k % 31 == 0 else [""] if k % 37 == 0 else []
    for encoding in ("utf-8", "cp1252", "utf-16"):
        for end in ("\n", "\r\n", "\r"):
            content = end.join(lines).encode(encoding)
            whole = read(content)
            with monkeypatch.context() as patch:
                patch.setattr(text_files, "PIECE", 3000)
                found = read(content)
                assert list(found.values) == ["t", "x"]
                assert found.units == {"t": "ms", "x": "um"}
                np.testing.assert_array_equal(found.values["t"], np.arange(2000))
                np.testing.assert_array_equal(found.values["x"], whole.values["x"])
                assert found.place(1999) == whole.place(1999) == f"line {len(lines)}"
                assert found.place(777) == whole.place(777)
    monkeypatch.setattr(text_files, "PIECE", 3000)
    at = lines.index("1500;-1")
    with pytest.raises(LogError, match=f"line {at + 1} has 1 cells, the lines above 2: '1500'; correct"):
        read("\n".join([*lines[:at], "1500", *lines[at + 1 :]]))


def test_too_much_text_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_files, "MOST_BYTES", 10)
    with pytest.raises(LogError, match="convert it to Parquet or cut it"):
        read("t,x\n0,1\n1,2\n2,3\n")


def test_only_wanted_columns_are_looked_at() -> None:
    text = "t,x,bad\n0,1,5\n1,2,6\n2,3,\n3,4,7\n"
    found = read(text, frozenset(["x"]))
    assert {name: values.tolist() for name, values in found.values.items()} == {"t": [0, 1, 2, 3], "x": [1, 2, 3, 4]}
    with pytest.raises(LogError, match="line 4, column 'bad': is empty"):
        read(text)


def strategy_of_texts() -> Any:
    cell = st.one_of(
        st.floats(allow_nan=False).map(repr), st.sampled_from(["", "x", "1,5", '"', "#", "nan", "1e", " "])
    )
    line = st.tuples(st.lists(cell, max_size=5), st.sampled_from(",;\t ")).map(lambda pair: pair[1].join(pair[0]))
    return st.lists(line, max_size=12).map("\n".join)


@settings(max_examples=300)
@given(strategy_of_texts())
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        found = read(text)
    except LogError as error:
        assert str(error).startswith("a.csv: ")  # noqa: PT017
    else:
        lengths = {values.size for values in found.values.values()}
        assert len(lengths) == 1
        assert found.place(max(lengths) - 1).startswith("line ")


def test_equal_names_get_numbers_and_cost_no_more_than_others(tmp_path: Path) -> None:
    """2000 equal names once took 154 s: each was compared with ever longer ones."""
    path = tmp_path / "a.csv"

    def cost(names: list[str]) -> int:
        row = ",".join(["1.5"] * len(names))
        path.write_text("\n".join(["t," + ",".join(names), *(f"{0.001 * k},{row}" for k in range(3))]))
        return lines_run(lambda: read_log(path))

    others = cost([f"x{k}" for k in range(1999)])
    assert cost(["x"] * 1999) < 1.1 * others  # lines of Python; 1999 longer names would be compared 2 million times
    channels = read_log(path).channels
    assert len(channels) == 1999
    assert list(channels)[:4] == ["x", "x_again", "x_again3", "x_again4"]


_EPOS_NOTED = {
    "commas": ["0.000;-101;-24.1,,", "0.400;-100;-24.0,,", "0.800;-99;-1200.0,,strange", "1.200;-101;-24.2,,"],
    "some commas": ["0.000;-101;-24.1", "0.400;-100;-24.0,,", "0.800;-99;-1200.0", "1.200;-101;-24.2"],
    "semicolons": ["0.000;-101;-24.1;;", "0.400;-100;-24.0;;", "0.800;-99;-1200.0;strange, 2;", "1.200;-101;-24.2;;"],
    "decimal commas": ["0,000;-101;-24,1;", "0,400;-100;-24,0;", "0,800;-99;-1200,0;strange", "1,200;-101;-24,2;"],
}


@pytest.mark.parametrize("kind", _EPOS_NOTED)
def test_a_recorder_file_that_somebody_wrote_remarks_in(kind: str, tmp_path: Path) -> None:
    rows = _EPOS_NOTED[kind]
    tail = {"commas": ",,", "some commas": "", "semicolons": ";note;", "decimal commas": ";note"}[kind]
    head = ["Date:;2020-07-08", "EPOS Studio Version:;3.6.1.0", "Recorded samples:;4", "Sampling period:;0.400"]
    lines = [
        *(f"{line}{tail.replace('note', '')}" for line in head),
        f";Velocity;Torque{tail}",
        f"ms;rpm;%{tail}",
        *rows,
    ]
    file = tmp_path / "run.csv"
    file.write_bytes("\r\n".join([*lines, ""]).encode())
    log = read_log(file)
    assert list(log["Torque"]) == [-24.1, -24.0, -1200.0, -24.2]
    assert log.units == {"Velocity": "rpm", "Torque": "percent"}
    assert log.sample_time == pytest.approx(0.4e-3, rel=1e-12)
    noted = "strange" in "".join(rows)
    assert log.left_out.get("after the last channel", "") == ("remarks in 1 row" if noted else "")
    file.write_bytes("\r\n".join([*lines[:-1], "1.200;-101", ""]).encode())
    with pytest.raises(LogError, match="line 10"):
        read_log(file)


@pytest.mark.parametrize(
    ("head", "name", "unit"),
    [
        ("t/s", "t", "s"),
        ("x/mm", "x", "mm"),
        ("v/(mm/s)", "v", "mm/s"),
        ("v/mm/s", "v", "mm/s"),
        ("Sollmoment/N m", "Sollmoment", "N m"),
        ("pid.0.output/%", "pid.0.output", "percent"),
        ("mm/s", "mm/s", ""),
        ("re m/N", "re m/N", ""),
        ("cmd/fb", "cmd/fb", ""),
    ],
)
def test_a_head_divided_by_its_unit_states_it(head: str, name: str, unit: str) -> None:
    """As DIN and ISO write the heads of tables; a unit of two parts, and two names, are no such head."""
    assert text_files._named(head) == (name, unit)
