"""What each column of a log is: one value whose text loses nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feeddrive.files.columns import OWN_UNIT, ROLES, Column
from feeddrive.files.mapping import Mapping, guess_roles, write_roles
from feeddrive.files.read_log import read_log, read_request
from feeddrive.language.errors import LogError, ParameterError

# of each quantity, in the spelling of makers too
SPELLINGS = {
    "s": ("s", "ms", "µs", "sec"),
    "m": ("m", "mm", "µm", "in"),
    "m/s": ("mm/s", "m/min"),
    "m/s2": ("mm/s²",),
    "N": ("N", "kN", "Newton"),
    "rad": ("rad", "deg", "°"),
    "rad/s": ("rpm", "U/min", "deg/s"),
    "N m": ("Nm", "mNm", "N m"),
    "A": ("A", "mA"),
    "": ("V", "percent", "A", "[%]", "any text: N*m"),
}
FACTORS = st.floats(allow_nan=False, allow_infinity=False).filter(bool) | st.integers(1, 10**15)
NAMES = st.text() | st.sampled_from(
    [
        "force [N]",
        'said "so"',
        "it's",
        "a]",
        "[a",
        "{ column = 'x' }",
        "# no comment",
        "tab\tand\nline",
        "\r\n",
        "\\n",
        "\x7f\x00\x1b",
        "\u2028\x85",
        '"""',
        "'''",
        "Ü-ß-µ",
        "位置",
        "a = b",
        "x*2:mm",
        " ",
        "",
    ]
)


def columns(role: str) -> st.SearchStrategy[Column]:
    """Any column that may have a role."""
    unit = st.sampled_from(["", *SPELLINGS["" if role in OWN_UNIT else ROLES[role]]])
    return st.builds(Column, name=NAMES, unit=unit, factor=st.none() | FACTORS)


@st.composite
def by_role(draw: st.DrawFn) -> dict[str, Column]:
    return {role: draw(columns(role)) for role in draw(st.sets(st.sampled_from([*ROLES]), max_size=3))}


@st.composite
def mappings(draw: st.DrawFn) -> Mapping:
    named, optional = draw(by_role()), draw(by_role())
    there = sorted({*named, *optional})
    reasons = draw(st.dictionaries(st.sampled_from(there), st.text(), max_size=3)) if there else {}
    step = draw(st.none() | st.floats(5e-324, 1e9, exclude_max=True))
    return Mapping(named, optional, reasons, draw(st.text()), step)


@settings(max_examples=60)
@given(mappings(), st.text())
def test_any_mapping_comes_back_from_its_text(mapping: Mapping, file: str) -> None:
    """Equal in every field: names and reasons to the letter, factors and sample time to the bit."""
    again = Mapping.read(mapping.text(file))
    assert again == mapping
    assert list(again) == list(mapping)
    assert {role: str(each.factor) for role, each in again.items()} == {
        role: str(each.factor) for role, each in mapping.items()
    }
    assert Mapping.read(again.text()) == mapping  # a log that is named elsewhere


@settings(max_examples=20)
@given(mappings())
def test_any_mapping_comes_back_from_a_file(tmp_path_factory: pytest.TempPathFactory, mapping: Mapping) -> None:
    path = tmp_path_factory.getbasetemp() / "roles.toml"
    path.write_text(mapping.text("run.csv"), encoding="utf-8", newline="")
    assert read_request(path).mapping == mapping


@given(st.sampled_from([*ROLES]).flatmap(lambda role: st.tuples(st.just(role), columns(role))))
def test_a_word_of_the_command_line_is_the_column_of_a_file(drawn: tuple[str, Column]) -> None:
    role, column = drawn
    if "*" in column.name or ":" in column.name or "*" in column.unit or ":" in column.unit:
        return  # in a file alone
    checked = column.checked(role)
    assert Column.of(checked.text()).checked(role) == checked
    assert Mapping({role: Column.of(checked.text())}) == Mapping({role: column})


def log_of(path: Path) -> Path:
    rows = "".join(f"{k},{k % 7},{3 * k}\n" for k in range(50))
    path.write_text("t [ms],x [mm],load\n" + rows, encoding="utf-8")
    return path


def test_unit_and_factor_together_are_a_factor_to_the_unit(tmp_path: Path) -> None:
    """In a file, a word and Python: 2.5 of the column is 1 kN less its sign, whatever the head says."""
    path = log_of(tmp_path / "run.csv")
    x, load = (np.arange(50.0) % 7, 3.0 * np.arange(50.0))
    (tmp_path / "roles.toml").write_text(
        '[log]\nfile = "run.csv"\n[log.channels]\n'
        'position_load = { column = "x", unit = "mm", factor = -1 }\n'
        'force = { column = "load", unit = "kN", factor = 0.4 }\n'
    )
    for log in (
        read_request(tmp_path / "roles.toml").read(),
        read_log(path, {"position_load": Column.of("x*-1:mm"), "force": Column.of("load*0.4:kN")}),
        read_log(
            path,
            Mapping(
                {
                    "position_load": Column(name="x", unit="mm", factor=-1.0),
                    "force": Column(name="load", unit="kN", factor=0.4),
                }
            ),
        ),
    ):
        np.testing.assert_allclose(log["position_load"], -1e-3 * x, rtol=1e-15)
        np.testing.assert_allclose(log["force"], 400.0 * load, rtol=1e-15)
        assert log.units == {"position_load": "m", "force": "N"}


def test_a_turned_sign_alone_does_not_make_metres_of_millimetres(tmp_path: Path) -> None:
    path = log_of(tmp_path / "run.csv")
    with pytest.raises(LogError, match=r"column 'x' is in mm, as the file says, and a factor of -1 .* as x\*-1\.0:mm"):
        read_log(path, {"position_load": ("x", -1.0)})
    np.testing.assert_array_equal(read_log(path, {"force": ("load", -1.0)})["force"], -3.0 * np.arange(50.0))
    np.testing.assert_allclose(read_log(path, {"position_load": ("x", 1e-3)})["position_load"].max(), 6e-3)


def test_a_mapping_says_which_columns_may_be_missing_and_the_clock(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("x,f\n" + "".join(f"{k},{k}\n" for k in range(9)), encoding="utf-8")
    found = read_log(
        tmp_path / "run.csv",
        Mapping(
            {"position_load": Column(name="x")},
            {"force": Column(name="f"), "command": Column(name="none")},
            sample_time=2e-3,
        ),
    )
    assert {*found.channels} == {"position_load", "force"}
    assert found.sample_time == 2e-3


@pytest.mark.parametrize("head", ["x", "t,x"])
def test_a_sample_time_that_was_typed_is_in_the_file(tmp_path: Path, head: str) -> None:
    """For a log without a clock, and for one whose stamps are rounded."""
    rows = [f"{round(1.2e-3 * k, 3)},{k}" if "t" in head else f"{k}" for k in range(30)]
    (tmp_path / "run.csv").write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    guess = guess_roles(read_log(tmp_path / "run.csv", sample_time=1.2e-3))
    write_roles(tmp_path / "roles.toml", guess, "run.csv")
    assert read_request(tmp_path / "roles.toml").read().sample_time == 1.2e-3


def test_the_axis_that_was_typed_is_in_the_file(tmp_path: Path) -> None:
    rows = "".join(f"{k},{k},{k},{k}\n" for k in range(9))
    (tmp_path / "run.csv").write_text("x_cmd_mm,y_cmd_mm,x_fb_mm,y_fb_mm\n" + rows, encoding="utf-8")
    guess = guess_roles(read_log(tmp_path / "run.csv", sample_time=1e-3), "y")
    assert Mapping.read(guess.toml()).axis == guess.mapping.axis == "y"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('force = { column = "f", factor = 0 }', r"roles\.toml:4: log\.channels\.force: .* that is not 0"),
        ('force = { column = "f", unit = "mm" }', r"roles\.toml:4: log\.channels\.force: unit 'mm' does not measure"),
        (
            'force = { column = "f", reason = 1 }',
            r"roles\.toml:4: log\.channels\.force\.reason must be a text in quotes",
        ),
        ('force = { column = "f", why = "so" }', r"roles\.toml:4: key 'log\.channels\.force\.why' is not known"),
        ('push = "f"', r"roles\.toml:4: key 'log\.channels\.push' is not known"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_its_line(tmp_path: Path, line: str, message: str) -> None:
    (tmp_path / "roles.toml").write_text(f'[log]\nfile = "run.csv"\n[log.channels]\n{line}\n', encoding="utf-8")
    with pytest.raises(ParameterError, match=message):
        read_request(tmp_path / "roles.toml")


def test_what_cannot_be_is_refused_in_python() -> None:
    for wrong in ({"reasons": {"torque": "so"}}, {"sample_time": 0.0}, {"sample_time": float("nan")}):
        with pytest.raises(ParameterError):
            Mapping({"force": Column(name="f")}, **wrong)
    with pytest.raises(ParameterError, match="a log has no role 'forc'; did you mean force"):
        Mapping({"forc": Column(name="f")})
