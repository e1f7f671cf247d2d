"""Recordings as their makers write them: LinuxCNC, EPOS Studio, numpy."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from feeddrive.files.read_log import read_arrays, read_columns, read_log
from feeddrive.language.errors import LogError

RNG = np.random.default_rng(3)
X = np.round(np.cumsum(RNG.normal(size=(40, 2)), axis=0), 6)


def write(tmp_path: Path, content: str | bytes, name: str = "a.txt") -> Path:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# LinuxCNC


def halscope(period: int = 1_000_000) -> str:
    """As halscope 2.9 writes it: names, two lines of its screen, rows."""
    rows = "".join(f"{a:.14f};{b:.14f}\n" for a, b in X)
    return (
        f"# Sampling period is {period} ns\njoint.0.motor-pos-cmd;joint.0.motor-pos-fb\n"
        f"# Position: 0.500000;0.500000\n# Scale: 0;-3\n{rows}"
    )


def old_halscope(period: int = 1_000_000) -> str:
    """As halscope up to 2.8 writes it: name and value by turns."""
    rows = "".join(f"\njoint.0.motor-pos-cmd {a:+.14f} joint.0.motor-pos-fb {b:+.14f} " for a, b in X)
    return f"Sampling period is {period} nSec \n{rows}"


@pytest.mark.parametrize("text", [halscope(), old_halscope(), halscope().replace("\n", "\r\n")])
def test_halscope(tmp_path: Path, text: str) -> None:
    log = read_log(write(tmp_path, text))
    assert log.sample_time == 1e-3
    assert list(log.channels) == ["joint.0.motor-pos-cmd", "joint.0.motor-pos-fb"]
    np.testing.assert_allclose(log["joint.0.motor-pos-cmd"], X[:, 0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(log["joint.0.motor-pos-fb"], X[:, 1], rtol=0, atol=1e-14)
    one = read_log(write(tmp_path, text), {"position_load": ("joint.0.motor-pos-fb", "mm")})
    np.testing.assert_allclose(one["position_load"], 1e-3 * X[:, 1], rtol=1e-12, atol=1e-17)
    assert one.provenance["format"] == "halscope"


def test_what_is_wrong_with_halscope(tmp_path: Path) -> None:
    lines = halscope().split("\n")
    lines[10] = "1.0"
    with pytest.raises(LogError, match=r"a\.txt: line 11 has 1 cells, the lines above 2: '1\.0'"):
        read_log(write(tmp_path, "\n".join(lines)))
    with pytest.raises(LogError, match=r"states a sampling period of 0 ns, which must be > 0 ns"):
        read_log(write(tmp_path, halscope(0)))
    with pytest.raises(LogError, match=r"a sample time of 1 s is not one of a servo loop"):
        read_log(write(tmp_path, halscope(1_000_000_000)))
    twice = old_halscope().replace("pos-fb", "pos-cmd")
    with pytest.raises(LogError, match=r"records 'joint\.0\.motor-pos-cmd' twice"):
        read_log(write(tmp_path, twice))
    lines = old_halscope().split("\n")
    lines[6] = lines[6].replace("joint.0.motor-pos-fb", "joint.1.motor-pos-fb")
    with pytest.raises(LogError, match=r"'joint\.0\.motor-pos-fb' is not in every line"):
        read_log(write(tmp_path, "\n".join(lines)))
    lines[6] = lines[6].replace("joint.1.motor-pos-fb", "")
    with pytest.raises(LogError, match=r"line 7 has 3 cells, the lines above 4"):
        read_log(write(tmp_path, "\n".join(lines)))


def halsampler(tag: bool, lost: int | None = None, late: bool = False) -> str:
    """As halsampler prints it: %f and %ld with a space after each; `overrun` where the numbers jump."""
    text = "overrun\n" if late else ""
    number = 1000 if late else 0
    for k, (a, b) in enumerate(X):
        if k == lost:
            text += "overrun\n"
            number += 7
        text += (f"{number} " if tag else "") + f"{a:f} {b:f} {k % 2} \n"
        number += 1
    return text


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("tag", [False, True])
def test_halsampler(tmp_path: Path, tag: bool, late: bool) -> None:
    path = write(tmp_path, halsampler(tag, late=late))
    with pytest.raises(LogError, match=r"has no column of time among .*give the sample time"):
        read_log(path)
    log = read_log(path, sample_time=1e-3)
    first = 2 if tag else 1
    assert list(log.channels) == [f"column_{first + k}" for k in range(3)]
    np.testing.assert_array_equal(log[f"column_{first + 1}"], X[:, 1])
    np.testing.assert_allclose(log.time, 1e-3 * np.arange(40), rtol=1e-15)
    assert log.provenance["format"] == "halsampler"


@pytest.mark.parametrize("tag", [False, True])
def test_lost_samples_of_halsampler_are_named(tmp_path: Path, tag: bool) -> None:
    path = write(tmp_path, halsampler(tag, lost=20))
    with pytest.raises(LogError, match=r"line 21 says that samples were lost \('overrun'\)"):
        read_log(path, sample_time=1e-3)
    path = write(tmp_path, halsampler(tag=True, lost=20).replace("overrun\n", ""))
    with pytest.raises(LogError, match=r"a gap lies before line 21: 0\.019 s is followed by 0\.027 s"):
        read_log(path, sample_time=1e-3)


def test_a_table_with_spaces_is_not_taken_for_halsampler(tmp_path: Path) -> None:
    log = read_log(write(tmp_path, "0.5 1\n1.5 2\n2.5 3\n"), sample_time=1e-3)
    assert log.provenance["format"].startswith("text")


# EPOS Studio


def epos(rows: int = 40, stated: int = 40, period: str = "6.400") -> str:
    body = "".join(f"{6.4 * k:.3f};{k};{-0.1 * k:.1f}\r\n" for k in range(rows))
    return (
        "Date:;2020-07-08 21:10:30\r\nEPOS Studio Version:;3.6.1.0\r\nIndex:;0x30D3;0x30D2\r\n"
        f"Max. samples:;500\r\nRecorded samples:;{stated}\r\nSampling period:;{period}\r\n"
        "Scale:;0;True;2.000;179.000\r\n;Velocity actual value averaged;Torque actual value averaged\r\n"
        f"ms;rpm;%\r\n{body}"
    )


def test_epos(tmp_path: Path) -> None:
    log = read_log(write(tmp_path, epos()))
    assert log.provenance["format"] == "EPOS Studio"
    assert log.sample_time == 6.4e-3
    assert log.units == {"Velocity actual value averaged": "rpm", "Torque actual value averaged": "percent"}
    log = read_log(write(tmp_path, epos()), {"speed_motor": "Velocity actual value averaged"})
    np.testing.assert_allclose(log["speed_motor"], np.arange(40) * 2 * np.pi / 60, rtol=1e-14)
    assert log.units == {"speed_motor": "rad/s"}
    german = epos().replace(".", ",")
    np.testing.assert_array_equal(read_log(write(tmp_path, german)).time, log.time)


def test_what_an_epos_file_says_of_itself_is_checked(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"states 500 recorded samples and holds 40; it is cut off or was edited"):
        read_log(write(tmp_path, epos(stated=500)))
    with pytest.raises(LogError, match=r"with a sample time of 0\.0064 s, line 12 should be at 0\.0128 s"):
        read_log(write(tmp_path, epos().replace("\r\n12.800;", "\r\n12.900;").replace("12.900", "18.900")))
    with pytest.raises(LogError, match=r"with a sample time of 0\.0128 s, line 11 should be at"):
        read_log(write(tmp_path, epos(period="12.800")))
    assert read_log(write(tmp_path, epos(period="0"))).sample_time == 6.4e-3  # says nothing


# numpy


def saved(array: np.ndarray, **options: bool) -> bytes:
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


@pytest.mark.parametrize("dtype", ["f8", ">f8", "f4", "i2", "u8", "?", "f2"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_numpy(dtype: str, order: str) -> None:
    array = np.array(100 * RNG.normal(size=(3, 50)) + 200, dtype=dtype, order=order)
    for each in (array, array.T):
        found = read_columns("a.npy", saved(each), None)
        assert list(found.values) == ["column_1", "column_2", "column_3"]
        np.testing.assert_array_equal(np.stack(list(found.values.values())), array.astype(float))
    found = read_columns("a.npy", saved(array[0]), None)
    np.testing.assert_array_equal(found.values["column_1"], array[0].astype(float))
    found = read_columns("a.npy", saved(array), frozenset({"column_2"}))
    assert list(found.values) == ["column_2"]
    assert found.unread == ("column_1", "column_3")


def test_numpy_structures() -> None:
    array = np.zeros(20, dtype=[("t", "f8"), ("x", "i4"), ("z", "c16"), ("s", "U3"), ("m", "f8", (2,))])
    array["t"] = np.arange(20)
    found = read_columns("a.npy", saved(array), None)
    assert list(found.values) == ["t", "x"]
    assert found.left_out["z"] == "complex numbers"
    assert set(found.left_out) == {"z", "s", "m"}


def test_numpy_objects_are_never_read() -> None:
    for array in (np.array([1, "a", None], dtype=object), np.zeros(3, dtype=[("a", "f8"), ("b", "O")])):
        with pytest.raises(LogError, match=r"a\.npy: holds Python objects, .*a pickle and could execute code"):
            read_columns("a.npy", saved(array, allow_pickle=True), None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b[:-8], "is cut off or damaged: 50 numbers are stated, of 400 bytes, and 392 bytes are there"),
        (lambda b: b + b"x", "and 401 bytes are there"),
        (lambda b: b.replace(b"(50,)", b"(5000000000000,)").replace(b" " * 11, b"", 1), "5,000,000,000,000 numbers"),
        (lambda b: b.replace(b"(50,)", b"(2,5,5)").replace(b" " * 2, b"", 1), "is an array of 3 dimensions"),
        (lambda b: b.replace(b"'<f8'", b"'<q8'"), "its header is damaged"),
        (lambda b: b[:6] + b"\x09" + b[7:], "its header is damaged"),
        (lambda b: b[:30], "its header is damaged"),
        (lambda b: b[:8] + b"\xff\xff" + b[10:], "its header"),
    ],
)
def test_damaged_numpy_files(change: object, message: str) -> None:
    assert callable(change)
    with pytest.raises(LogError, match=message):
        read_columns("a.npy", change(saved(np.arange(50.0))), None)


def test_arrays_need_no_clock(tmp_path: Path) -> None:
    found = read_arrays(write(tmp_path, "speed,torque\n-1,nan\n5,2\n3,3\n"))
    np.testing.assert_array_equal(found["speed"], [-1, 5, 3])
    np.testing.assert_array_equal(found["torque"], [np.nan, 2, 3])
    with pytest.raises(LogError, match="is empty"):
        read_arrays(write(tmp_path, ""))


def test_a_matrix_that_is_no_log() -> None:
    with pytest.raises(LogError, match="is a matrix of 100 x 100; a log has at most 64 columns"):
        read_columns("a.npy", saved(np.zeros((100, 100))), None)


def test_the_cogging_set(shared: Path) -> None:
    folder = shared / "odrive_cogging"
    if not folder.exists():
        pytest.skip(f"NOT TESTED on cogging maps: {folder} is not there")
    for path in sorted(folder.glob("*.npy")):
        truth = np.atleast_2d(np.load(path))
        found = read_columns(str(path), path.read_bytes(), None)
        np.testing.assert_array_equal(np.stack(list(found.values.values())), truth)
        np.testing.assert_array_equal(np.stack(list(read_arrays(path).values())), truth)
    with pytest.raises(LogError, match=r"a gap lies before row 183: .*\(7 such rows\)"):  # its clock is a PC's
        read_log(folder / "slow2_comp_0.npy", {"time": "column_1", "current": "column_3"})


# TwinCAT Scope


def twincat(separator: str = "\t", decimal: str = ",", *, shared_time: bool = False, filetime: bool = False) -> str:
    """As Scope View 3.4 writes it: two channels at 1 ms and a slow one at 5 ms, whose cells end early."""
    names, steps, units_ = ["Axis 1.ActPos", "Axis 1.ActVelo", "slow"], [1, 1, 5], ["mm", "mm/s (Velocity)", "(None)"]

    def row(key: str, cells: list[str]) -> str:
        if shared_time:
            return separator.join([key, cells[0], cells[1], key, cells[2]])
        return separator.join(part for cell in cells for part in (key, cell))

    def shown(number: float) -> str:
        return repr(float(number)).replace(".", decimal)

    lines = [
        f"Name{separator}Scope1",
        f"File{separator}C:\\a.csv",
        f"Starttime of export{separator}132959733843760000{separator}Montag, 2. Mai 2022",
        "",
        "",
        row("Name", names),
        row("SymbolComment", [""] * 3),
        row("Data-Type", ["REAL64"] * 3),
        row("SampleTime[ms]", [str(step) for step in steps]),
        row("Unit", units_),
        "",
    ]
    for k in range(40):
        t = str(132959733843760000 + 10_000 * k) if filetime else str(k)
        slow = [str(5 * k), shown(float(k))] if k < 8 else []
        first = [t, shown(X[k, 0]), *([] if shared_time else [t]), shown(X[k, 1])]
        lines.append(separator.join(first + slow))
    return "\n".join([*lines, "EOF"]) + "\n"


@pytest.mark.parametrize("shared_time", [False, True])
@pytest.mark.parametrize("filetime", [False, True])
@pytest.mark.parametrize(("separator", "decimal"), [("\t", ","), ("\t", "."), (";", ","), (",", ".")])
def test_twincat(tmp_path: Path, separator: str, decimal: str, filetime: bool, shared_time: bool) -> None:
    text = twincat(separator, decimal, shared_time=shared_time, filetime=filetime)
    log = read_log(write(tmp_path, text))
    assert log.sample_time == 1e-3
    assert log.units == {"Axis 1.ActPos": "mm", "Axis 1.ActVelo": "mm/s"}
    np.testing.assert_array_equal(log["Axis 1.ActPos"], X[:, 0])
    np.testing.assert_array_equal(log["Axis 1.ActVelo"], X[:, 1])
    assert log.left_out == {"slow": "sampled every 5 ms, not every 1 ms"}
    slow = read_log(write(tmp_path, text), {"force": "slow"})
    assert slow.sample_time == 5e-3
    assert slow["force"].tolist() == list(range(8))


def test_what_is_wrong_with_a_twincat_export(tmp_path: Path) -> None:
    lines = twincat().split("\n")
    broken = lines.copy()
    broken[15] = broken[15].replace("\t", "\tx", 1)
    with pytest.raises(LogError, match=r"a\.txt: line 16: 'x-?[0-9,]+' is not a number; correct or remove"):
        read_log(write(tmp_path, "\n".join(broken)))
    with pytest.raises(LogError, match=r"line 21: the file is cut off there"):
        read_log(write(tmp_path, "\n".join([*lines[:20], "9\t1,5"])))
    with pytest.raises(LogError, match=r"a gap lies before line 21"):
        read_log(write(tmp_path, "\n".join([*lines[:20], *lines[22:]]).replace("EOF", "")))
    with pytest.raises(LogError, match=r"column 'slow' \(force\) is not numbers but sampled every 5 ms"):
        read_log(
            write(tmp_path, "\n".join(lines)),
            {"position_load": "Axis 1.ActPos", "velocity_load": "Axis 1.ActVelo", "force": "slow"},
        )
