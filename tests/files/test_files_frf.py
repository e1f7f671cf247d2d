"""Frequency responses from files: the same numbers in every layout, and an error that names what is wrong."""

from __future__ import annotations

import builtins
import gzip
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.files.frf import encoders, named, read_controllers, read_frf, read_frfs, write_frf
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import FileError, LogError, MissingExtraError, ParameterError
from feeddrive.loop.frequency_response import FRF

F = np.array([1.0, 2.5, 10.0, 400.0])
G = np.array([1.0 + 2.0j, -0.5 + 1e-3j, 3e-9 - 2e-9j, -1.0 - 0.25j])
GAMMA2 = np.array([1.0, 0.99, 0.5, 0.0])


def write(tmp_path: Path, text: str, name: str = "a.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def table(heads: str, *columns: np.ndarray, separator: str = ",", decimal: str = ".") -> str:
    rows = [separator.join(repr(float(x)).replace(".", decimal) for x in row) for row in zip(*columns, strict=True)]
    return "\n".join([heads, *rows]) + "\n"


@pytest.mark.parametrize(
    ("heads", "columns"),
    [
        ("f,re,im", (F, G.real, G.imag)),
        ("f_Hz,Re,Im", (F, G.real, G.imag)),
        ("frequency [Hz],real,imag", (F, G.real, G.imag)),
        ("Freq (kHz),G.real,G.imag", (F * 1e-3, G.real, G.imag)),
        ("omega,Re(G),Im(G)", (2 * np.pi * F, G.real, G.imag)),
        ("f_rad_per_s,re_G,im_G", (2 * np.pi * F, G.real, G.imag)),
        ("im,f,re", (G.imag, F, G.real)),
        ("f,ReG,ImG", (F, G.real, G.imag)),
        ("f,mag_dB,phase_deg", (F, 20 * np.log10(np.abs(G)), np.degrees(np.angle(G)))),
        ("f,magnitude,phase [rad]", (F, np.abs(G), np.angle(G))),
        ("f,Gain (dB),Phase (°)", (F, 20 * np.log10(np.abs(G)), np.degrees(np.angle(G)) - 360.0)),
        ("phase_rad,amplitude,f", (np.angle(G), np.abs(G), F)),
        ("f,mag dB,phase deg", (F, 20 * np.log10(np.abs(G)), np.degrees(np.angle(G)))),
        ("Frequenz [Hz],Betrag [dB],Phase [°]", (F, 20 * np.log10(np.abs(G)), np.degrees(np.angle(G)))),
    ],
)
def test_every_layout_gives_the_same_response(tmp_path: Path, heads: str, columns: Sequence[np.ndarray]) -> None:
    frf = read_frf(write(tmp_path, table(heads, *columns)))
    np.testing.assert_allclose(frf.frequency, F, rtol=1e-14)
    # |G| over dB and degrees: a few units in the last place of the logarithm, 20 log10(3e-9) = -170
    np.testing.assert_allclose(frf.response, G, rtol=1e-13, atol=0)
    assert frf.coherence is None
    assert frf.variance is None


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", "."), (" ", ",")])
def test_separators_and_packing(tmp_path: Path, separator: str, decimal: str) -> None:
    heads = separator.join(["f", "re", "im", "coherence"])
    text = table(heads, F, G.real, G.imag, GAMMA2, separator=separator, decimal=decimal)
    frf = read_frf(write(tmp_path, text))
    np.testing.assert_array_equal(frf.response, G)
    assert frf.coherence is not None
    np.testing.assert_array_equal(frf.coherence, GAMMA2)
    packed = tmp_path / "a.csv.gz"
    packed.write_bytes(gzip.compress(text.encode()))
    np.testing.assert_array_equal(read_frf(packed).response, G)


def test_units_are_turned_into_si(tmp_path: Path) -> None:
    text = table("f,re [um/N],im [um/N],variance", F, G.real, G.imag, np.full(4, 4.0))
    frf = read_frf(write(tmp_path, text))
    assert frf.unit == "m/N"
    np.testing.assert_allclose(frf.response, 1e-6 * G, rtol=1e-15)
    assert frf.variance is not None
    np.testing.assert_allclose(frf.variance, 4e-12, rtol=1e-15)
    stated = read_frf(write(tmp_path, f"# unit: um/N\n{table('f,re,im,variance', F, G.real, G.imag, np.full(4, 4.0))}"))
    assert stated.unit == "m/N"
    np.testing.assert_array_equal(stated.response, frf.response)
    np.testing.assert_array_equal(stated.variance, frf.variance)
    frf = read_frf(write(tmp_path, table("f,mag [deg/A],phase_deg", F, np.abs(G), np.degrees(np.angle(G)))))
    assert frf.unit == "rad/A"
    np.testing.assert_allclose(frf.response, np.radians(1.0) * G, rtol=1e-13)
    frf = read_frf(write(tmp_path, table("f,re_mm_per_s_per_A,im", F, G.real, G.imag)))
    assert frf.unit == "(m/s)/A"
    np.testing.assert_allclose(frf.response, 1e-3 * G, rtol=1e-15)


def test_several_responses_by_name(tmp_path: Path) -> None:
    path = write(tmp_path, table("f,re_m,im_m,coh_m,re_l,im_l", F, G.real, G.imag, GAMMA2, -G.imag, G.real))
    found = read_frfs(path)
    assert list(found) == ["m", "l"]
    np.testing.assert_array_equal(found["l"].response, 1j * G)
    assert found["l"].coherence is None
    np.testing.assert_array_equal(found["m"].coherence, GAMMA2)
    with pytest.raises(ParameterError, match=r"holds 2 responses: m, l; name the one that is meant"):
        read_frf(path)
    with pytest.raises(ParameterError, match=r"there is no response 'k'; there are: m, l"):
        read_frf(path, "k")
    frf = read_frf(path, "l", input="force", output="position_load", unit="m/N")
    assert (frf.input, frf.output, frf.unit) == ("force", "position_load", "m/N")


def test_a_coherence_without_a_name_belongs_to_the_only_response(tmp_path: Path) -> None:
    frf = read_frf(write(tmp_path, table("f,re_G,im_G,coherence", F, G.real, G.imag, GAMMA2)))
    np.testing.assert_array_equal(frf.coherence, GAMMA2)


def test_a_file_without_heads_is_given_its_names(tmp_path: Path) -> None:
    path = write(tmp_path, table("", F, G.real, G.imag))
    with pytest.raises(LogError, match=r"no column of frequency among 'column_1'.*columns = \['f_Hz', 're', 'im'"):
        read_frf(path)
    np.testing.assert_array_equal(read_frf(path, columns=["f_Hz", "re", "im"]).response, G)
    with pytest.raises(ParameterError, match="3 columns of numbers need 3 different names"):
        read_frf(path, columns=["f", "re"])


def test_a_line_at_0_hz_is_left_out(tmp_path: Path) -> None:
    frf = read_frf(write(tmp_path, "f,re,im,coherence\n0,1,0,1\n1,2,3,0.5\n2,4,5,0.25\n"))
    assert frf.frequency.tolist() == [1.0, 2.0]
    assert frf.response.tolist() == [2 + 3j, 4 + 5j]
    assert frf.coherence is not None
    assert frf.coherence.tolist() == [0.5, 0.25]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f,re,im\n-1,1,2\n1,1,2\n", r"a\.csv: the frequency is -1 Hz at line 2 \(1 such lines\); an FRF has positive"),
        ("f,re,im\n3,1,2\n2,1,2\n4,1,1\n", r"the frequency falls at line 3: 3 Hz is followed by 2 Hz \(1 such lines\)"),
        ("f,re,im\n3,1,2\n3,1,2\n4,1,1\n", r"the frequency stands still at line 3"),
        ("f,re,im,coherence\n1,1,2,1.2\n2,1,2,1\n", r"the coherence 'coherence' is 1\.2 at line 2.*outside 0 to 1"),
        ("f,re,im,coherence\n1,1,2,99\n2,1,2,98\n", r"coherence' is 99 at line 2 \(2 such lines\).*in percent\?"),
        ("f,re,im,coherence\n1,1,2,1\n2,1,2,-0.1\n", r"the coherence 'coherence' is -0\.1 at line 3"),
        ("f,re,im,coherence\n1,1,2,nan\n2,1,2,1\n", r"column 'coherence' is nan at line 2"),
        ("f,re,im,variance\n1,1,2,-1\n2,1,2,1\n", r"the variance 'variance' is -1 at line 2; it must be >= 0"),
        ("f,re,im\n1,nan,2\n2,1,2\n", r"column 're' is nan at line 2 \(1 such lines\); remove those lines"),
        ("f,re,im\n1,1,2\ninf,1,2\n", r"column 'f' is inf at line 3"),
        ("f,mag,phase_deg\n1,-20,90\n2,0,0\n", r"the magnitude 'mag' is -20 at line 2; if it is in dB say so"),
        ("f,mag,phase\n1,20,90\n2,0,0\n", r"the phase 'phase' has no unit; name the column phase_deg or phase_rad"),
        ("f,mag_dB\n1,20\n2,0\n", r"'mag_dB' is a magnitude without a phase; margins need both"),
        ("f,mag_dB,phase_deg\n1,20000,9\n2,0,0\n", r"column 'mag_dB' reaches 20000 dB"),
        ("f,re,im\n1,1,2\n2,1e300,3\n", r"a\.csv: the response reaches 1e\+300 at line 3, beyond 1e\+30"),
        ("f,x,y\n1,20,90\n2,0,0\n", r"no column is the real and imaginary part, or the magnitude, of a response"),
        ("t,re,im\n1,20,90\n2,0,0\n", r"has no column of frequency among 't', 're', 'im'"),
        ("f,freq,re,im\n1,1,20,90\n2,2,0,0\n", r"has 2 columns of frequency among"),
        ("f,re,real,im\n1,1,20,90\n2,2,0,0\n", r"'re' and 'real' are both the re of one response"),
        ("f,re [m/N],im [um/N]\n1,1,2\n2,2,3\n", r"'im' is in 'um/N', its real part in 'm/N'"),
        ("f,re [rpm/kg],im\n1,1,2\n2,2,3\n", r"column 're' is in 'rpm/kg'; give the response in SI"),
        ("f,re [foo],im\n1,1,2\n2,2,3\n", r"a\.csv: column 're': unit 'foo' is not known; give the response in SI"),
        ("f [mm],re,im\n1,1,2\n2,2,3\n", r"the frequency 'f' is in 'mm', which is no unit of it; Hz or rad/s"),
        ("f,re,im\n0,1,2\n", r"holds only a line at 0 Hz"),
        ("f,re,im\n1,1,2\n2,1,3\n3,1,4\n2,2\n", r"line 5 has 2 cells, the lines above 3: the file is cut off there"),
        ("", r"a\.csv: is empty"),
        ("<?xml version='1.0'?><a/>", r"is XML without a measured response of the tuning tool"),
        ("<html><body>", r"is damaged XML: no element found"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(LogError, match=message):
        read_frf(write(tmp_path, text))


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no such file"):
        read_frf(tmp_path / "nothing.csv")


@pytest.mark.parametrize(
    ("column", "kind", "name"),
    [
        ("Re_Pv1", "re", "Pv1"),
        ("ImGm", "im", "Gm"),
        ("real", "re", ""),
        ("G.imag", "im", "G"),
        ("magnitude_dB", "magnitude", ""),
        ("phase_y_deg", "phase", "y"),
        ("coh_x", "coherence", "x"),
        ("reading", None, ""),
        ("image", None, ""),
        ("time", None, ""),
        ("velocity", None, ""),
    ],
)
def test_names_taken_apart(column: str, kind: str | None, name: str) -> None:
    found = named(column, "")
    assert (None if found is None else found.kind) == kind
    if found is not None:
        assert found.name == name


@given(
    st.lists(st.floats(1e-3, 1e6), min_size=1, max_size=30, unique=True),
    st.data(),
    st.booleans(),
    st.sampled_from([None, 1e-3, 1 / 3e3]),
)
def test_written_and_read_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, lines: list[float], data: st.DataObject, known: bool, T: float | None
) -> None:
    n = len(lines)
    numbers = st.lists(st.floats(-1e9, 1e9), min_size=n, max_size=n)
    frf = FRF(
        np.array(sorted(lines)),
        np.array(data.draw(numbers)) + 1j * np.array(data.draw(numbers)),
        input="force",
        output="position_load",
        unit="m/N",
        sample_time=T,
        coherence=np.array(data.draw(st.lists(st.floats(0, 1), min_size=n, max_size=n))) if known else None,
        variance=np.array(data.draw(st.lists(st.floats(0, 1e9), min_size=n, max_size=n))) if known else None,
    )
    path = tmp_path_factory.mktemp("frf") / "a.csv"
    write_frf(path, frf)
    again = read_frf(path)
    assert (again.input, again.output, again.unit) == ("force", "position_load", "m/N")
    assert again.sample_time == T
    for name in ("frequency", "response", "coherence", "variance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(frf, name))


def test_the_stage_and_the_bench(shared: Path) -> None:
    """Heads in a comment that goes on with a remark; two encoders, four and two responses in one file."""
    stage = shared / "tokyo_stage_frf" / "frf.csv"
    bench = shared / "tokyo_motor_bench" / "frf_typeA.csv"
    if not (stage.exists() and bench.exists()):
        pytest.skip(f"NOT TESTED on measured responses: none in {shared}")
    numbers = np.loadtxt(stage, delimiter=",")
    found = read_frfs(stage)
    assert list(found) == ["Pv1", "Pv2", "Pp1", "Pp2"]
    for k, frf in enumerate(found.values()):
        np.testing.assert_array_equal(frf.frequency, numbers[:, 0])
        np.testing.assert_array_equal(frf.response, numbers[:, 1 + 2 * k] + 1j * numbers[:, 2 + 2 * k])
    assert found["Pv1"].frequency[[0, -1]] == pytest.approx([0.1, 1000.0])
    numbers = np.loadtxt(bench, delimiter=",")
    found = read_frfs(bench)
    assert list(found) == ["Gm", "Gl"]
    assert found["Gm"].unit == "rad/A"
    np.testing.assert_array_equal(found["Gl"].response, numbers[:, 3] + 1j * numbers[:, 4])


# universal files


def function(
    data: np.ndarray,
    *,
    binary: bool,
    kind: int = 4,
    name: str = "x",
    node: int = 1,
    unit: str = "NONE",
    of: tuple[int, int, int] = (18, 8, 13),
    begin: float = 1.0,
    step: float = 1.0,
) -> bytes:
    """One dataset 58 over an even abscissa in double precision, by the published layout."""
    numbers = data.astype("<c16").view("<f8") if np.iscomplexobj(data) else data.astype("<f8")
    body = numbers.tobytes()
    first = f"    58b     1     2          11{len(body):12d}     0     0           0           0\n"
    axes = [
        f"{each:10d}    0    0    0 {'NONE':20s} {label:20s}\n"
        for each, label in zip((*of, 0), ("NONE", unit, "NONE", "NONE"), strict=True)
    ]
    head = "".join(
        [
            "    -1\n",
            first if binary else "    58\n",
            f"{name:80s}\n",
            *(f"{'NONE':80s}\n" for _ in range(4)),
            f"{kind:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{node:10d}{3:4d} {'NONE':10s}{2:10d}{-3:4d}\n",
            f"{6 if np.iscomplexobj(data) else 4:10d}{data.size:10d}{1:10d}{begin:13.5e}{step:13.5e}{0.0:13.5e}\n",
            *axes,
        ]
    )
    if binary:
        return head.encode() + body + b"\n    -1\n"
    cells = [f"{number:20.12e}" for number in numbers]
    rows = "".join("".join(cells[k : k + 4]) + "\n" for k in range(0, len(cells), 4))
    return (head + rows + "    -1\n").encode()


def need_pyuff() -> None:
    pytest.importorskip("pyuff", reason="NOT TESTED on universal files: pyuff is not installed")


EVEN = np.arange(1.0, 21.0)
RESPONSE = 1e-6 * np.exp(1j * EVEN) / EVEN


@pytest.mark.parametrize("binary", [True, False])
def test_universal_files(tmp_path: Path, binary: bool) -> None:
    need_pyuff()
    path = tmp_path / "a.uff"
    path.write_bytes(
        function(RESPONSE, binary=binary)
        + function(np.linspace(0, 1, 20), binary=binary, kind=6, of=(18, 0, 0))
        + function(2 * RESPONSE, binary=binary, node=7, unit="mm")
    )
    found = read_frfs(path)
    assert list(found) == ["1+Z_2-Z", "7+Z_2-Z"]
    first, second = found.values()
    np.testing.assert_array_equal(first.frequency, EVEN)
    # a text holds 13 digits
    np.testing.assert_allclose(first.response, RESPONSE, rtol=0.0 if binary else 1e-12)
    assert (first.input, first.output, first.unit) == ("2-Z", "1+Z", "m/N")
    assert first.coherence is not None
    np.testing.assert_allclose(first.coherence, np.linspace(0, 1, 20), rtol=0.0 if binary else 1e-12)
    np.testing.assert_allclose(second.response, 2e-3 * RESPONSE, rtol=1e-12)
    assert second.unit == "m/N"
    assert second.coherence is None


def test_time_responses_of_a_universal_file(tmp_path: Path) -> None:
    need_pyuff()
    t = 1e-3 * np.arange(50)
    path = tmp_path / "a.uff"
    table = function(np.sin(t), binary=True, kind=1, name="table", of=(17, 8, 0), begin=0.0, step=1e-3)
    other = function(np.cos(t), binary=True, kind=1, name="motor", of=(17, 12, 0), begin=0.0, step=1e-3)
    path.write_bytes(table + other + function(RESPONSE, binary=True))
    log = read_log(path)
    assert log.units == {"table": "m", "motor": "m/s2"}
    np.testing.assert_array_equal(log["table"], np.sin(t))
    assert log.sample_time == 1e-3
    assert "no time response" in log.left_out["x"]
    path.write_bytes(table)
    with pytest.raises(LogError, match=r"is a universal file without a frequency response"):
        read_frf(path)


def test_damaged_universal_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_pyuff()
    path = tmp_path / "a.uff"
    whole = function(RESPONSE, binary=True)
    for content in (
        whole[:300],
        whole[:-100],
        whole[:-30],
        b"    -1\n    58\n    -1\n",
        whole.replace(b"        20", b"        21"),
    ):
        path.write_bytes(content)
        with pytest.raises(LogError, match=r"universal file|states 21 values and holds 20"):
            read_frf(path)
    real = builtins.__import__

    def absent(name: str, *rest: object) -> object:
        if name == "pyuff":
            raise ImportError
        return real(name, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", absent)
    path.write_bytes(whole)
    with pytest.raises(MissingExtraError, match=r"needs the package 'pyuff'.*feeddrive\[uff\]"):
        read_frf(path)


# the XML of a tuning tool: no file of it can be passed on, so that its form is written here from its description

ALPHABET = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"


def base85(numbers: np.ndarray) -> str:
    """Doubles as words of 32 bits, big-endian, each of five digits; a point for a word of zeros. Word by word."""
    text = ""
    for (word,) in struct.iter_unpack(">I", numbers.astype(">f8").tobytes()):
        text += "." if word == 0 else "".join(ALPHABET[word // 85**k % 85] for k in (4, 3, 2, 1, 0))
    return "\n".join(text[k : k + 76] for k in range(0, len(text), 76))


def array(member: str, numbers: np.ndarray, *, form: str = "") -> str:
    complex_ = np.iscomplexobj(numbers)
    plain = numbers.astype(np.complex128).view(np.float64) if complex_ else numbers
    text = ",".join(map(repr, plain.tolist())) if form else base85(plain)
    kind = "complex" if complex_ else "double"
    return (
        f'<NumericArray name="{member}" elementtype="{kind}"{form}>'
        f'<raw name="m_pNumberArray"><![CDATA[{text}]]></raw></NumericArray>'
    )


def measured(member: str, frequency: np.ndarray, values: np.ndarray, *, form: str = "") -> str:
    inside = array("m_ValueVector", values, form=form) + array("m_FrequencyVector", frequency, form=form)
    return f'<FrequencyResponseFunction name="{member}">{inside}</FrequencyResponseFunction>'


def ast_xml(response: np.ndarray = G, *, form: str = "", more: str = "", coherent: slice = slice(None)) -> str:
    plant = measured("m_pPlant", F, response, form=form)
    coherence = measured("m_pMeasCoherence", F[coherent], GAMMA2[coherent].astype(complex), form=form)
    empty = measured("m_CurrentControllerResponse", F[:0], G[:0])
    again = measured("m_pPlant", 2.0 * F, 3.0 * response) + measured("m_CurrentControllerResponse", F, G / 2.0)
    item = '<SpeedPlantMeasurement><string name="m_szTimeStamp">2014-05-06 07:08:09</string>'
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<DynamicModelAxisController satclassid="1" ver="4.96" env="x">{more}
 <string name="m_szAxisName">X1</string><boolean name="m_bAxisIsRotary">0</boolean>
 <LinkedList name="m_SpeedPlantMeasurementList" elementtype="SpeedPlantMeasurement">
  {item}{plant}{coherence}{empty}</SpeedPlantMeasurement>
  {item}{again}</SpeedPlantMeasurement>
 </LinkedList>
 <LinkedList name="m_PositionControllerList" elementtype="x"><PIRegulator name="m_SpeedRegulator">
  <float name="m_Kp">12.5</float><float name="m_Tn">0.008</float>
  <LinkedList name="m_Filters" elementtype="x">
   <PT2Filter><float name="m_dFrequency">1999</float></PT2Filter>
  </LinkedList>
 </PIRegulator><float name="m_dUpdateTimeSeconds">0.002</float></LinkedList>
</DynamicModelAxisController>
"""


@pytest.mark.parametrize("form", ["", ' format="CSV"'])
def test_ast_xml(tmp_path: Path, form: str) -> None:
    """All responses that have numbers, bit for bit, named by list, place and member."""
    frfs = read_frfs(write(tmp_path, ast_xml(form=form), "a.xml"))
    assert list(frfs) == ["speed_plant_1_plant", "speed_plant_2_plant", "speed_plant_2_current_controller_response"]
    frf = frfs["speed_plant_1_plant"]
    np.testing.assert_array_equal(frf.frequency, F)
    np.testing.assert_array_equal(frf.response, G)
    assert frf.coherence is not None
    np.testing.assert_array_equal(frf.coherence, GAMMA2)
    assert (frf.input, frf.output, frf.unit) == ("torque", "speed_motor", "(rad/s)/(N m)")
    np.testing.assert_array_equal(frfs["speed_plant_2_plant"].response, 3.0 * G)
    assert frfs["speed_plant_2_plant"].coherence is None


def test_a_word_of_zeros_is_a_point_anywhere(tmp_path: Path) -> None:
    values = np.array([0.0 + 1.0j, 0.1 - 2.0j, 5e-324 + 0.0j, 3.0 + 0.3j])  # words of zeros first, second, in pairs
    assert base85(values.view(np.float64)).count(".") > 5
    frf = read_frfs(write(tmp_path, ast_xml(values), "a.xml"))["speed_plant_1_plant"]
    np.testing.assert_array_equal(frf.response, values)


def test_lines_of_the_plant_without_a_coherence_are_left_out(tmp_path: Path) -> None:
    frf = read_frfs(write(tmp_path, ast_xml(coherent=slice(1, None)), "a.xml"))["speed_plant_1_plant"]
    np.testing.assert_array_equal(frf.frequency, F[1:])
    few = read_frfs(write(tmp_path, ast_xml(coherent=slice(3, None)), "b.xml"))["speed_plant_1_plant"]
    assert few.coherence is None
    assert few.frequency.size == F.size


def test_controllers_of_ast_xml(tmp_path: Path) -> None:
    found = read_controllers(write(tmp_path, ast_xml(), "a.xml"))
    assert found["m_PositionControllerList.m_SpeedRegulator"] == {"m_Kp": 12.5, "m_Tn": 0.008}
    assert found["m_PositionControllerList.m_SpeedRegulator.m_Filters.PT2Filter[1]"] == {"m_dFrequency": 1999.0}
    others = found[""]
    assert others["m_szAxisName"] == "X1"
    assert others["m_SpeedPlantMeasurementList.SpeedPlantMeasurement[2].m_szTimeStamp"] == "2014-05-06 07:08:09"
    assert found["m_PositionControllerList"] == {"m_dUpdateTimeSeconds": 0.002}
    with pytest.raises(LogError, match="is not the XML of a tuning tool"):
        read_controllers(write(tmp_path, "f_Hz,re,im\n1,2,3\n", "a.csv"))


BILLION = '<!DOCTYPE a [<!ENTITY b "lol"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">]>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ast_xml().replace("<Dynamic", BILLION + "<Dynamic"), "holds a document type with entities"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd"><a/>', "holds a document type|is .*damaged XML|an XML"),
        ('<?xml version="1.0"?><!DOCTYPE a SYSTEM "file:///etc/passwd"><a/>', "holds a document type with entities"),
        ("<a>" * 100, "holds more than 50 levels"),
        ("<a>" + "<b/>" * 300_000 + "</a>", "more than 50 levels or 200,000 elements"),
        (ast_xml()[:300], "is damaged XML"),
        (ast_xml().replace("CDATA[", "CDATA[" + base85(np.array([1.0])), 1), r"m_pPlant has \d+ values at \d+ freq"),
        (ast_xml().replace("CDATA[", "CDATA[0", 1), "m_ValueVector is not .* base 85: a word has not five characters"),
        (ast_xml().replace("CDATA[", "CDATA[00.000", 1), "a word has not five characters"),
        (ast_xml().replace("CDATA[", "CDATA[~~~~~", 1), "a word is beyond 32 bits"),
        (ast_xml().replace("CDATA[", "CDATA[0000&", 1), "it has characters beyond the 85"),
        (ast_xml(form=' format="CSV"').replace("CDATA[", "CDATA[1,x,", 1), "is not a list of numbers with commas"),
        (ast_xml(G * np.nan), "column 're_speed_plant_1_plant' is nan at row 1"),
        ("<a><b/></a>", "is XML without a measured response of the tuning tool"),
    ],
)
def test_what_is_wrong_with_ast_xml(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(LogError, match=message):
        read_frf(write(tmp_path, text, "a.xml"))


def test_both_encoders_go_into_one_file_on_the_lines_they_share(tmp_path: Path):
    f = np.array([1.0, 2.0, 3.5, 7.0])
    coherence = np.array([0.9, 0.99, 1.0, 0.3])
    motor = FRF(f, (1.0 + 2.0j) / f, "force", "reading_motor", "m/N", 1e-3, coherence, variance=0.1 / f)
    load = FRF(f[1:], (3.0 - 1.0j) * f[1:], "force", "reading_load", "m/N", 1e-3)
    path = tmp_path / "both.csv"
    write_frf(path, motor, load)
    back = read_frfs(path)
    assert list(back) == ["reading_motor", "reading_load"]
    for frf in (motor, load):
        got, kept = back[frf.output], np.isin(frf.frequency, f[1:])
        assert np.array_equal(got.frequency, f[1:])
        assert np.array_equal(got.response, frf.response[kept])
        assert (got.input, got.output, got.unit, got.sample_time) == ("force", frf.output, "m/N", 1e-3)
    assert np.array_equal(back["reading_motor"].coherence, coherence[1:])
    assert np.array_equal(back["reading_motor"].variance, motor.variance[1:])
    assert back["reading_load"].coherence is None
    assert encoders(back)["motor"] is back["reading_motor"]
    assert encoders(back)["load"] is back["reading_load"]


def test_responses_that_do_not_belong_into_one_file_are_refused(tmp_path: Path):
    f = np.array([1.0, 2.0])
    one = FRF(f, f + 0j, "force", "reading_motor", "m/N")
    with pytest.raises(ParameterError, match="different names"):
        write_frf(tmp_path / "a.csv", one, one)
    with pytest.raises(ParameterError, match="one input"):
        write_frf(tmp_path / "a.csv", one, replace(one, input="current", output="reading_load"))
    with pytest.raises(ParameterError, match="need common lines"):
        write_frf(tmp_path / "a.csv", one, replace(one, frequency=f + 0.5, output="reading_load"))
    assert not (tmp_path / "a.csv").exists()


def test_encoders_are_known_by_name_alone():
    f = np.array([1.0, 2.0])
    frf = FRF(f, f + 0j, "force", "y", "m/N")
    assert encoders({"frf": frf}) == {"motor": frf}
    assert encoders({"load": frf}) == {"load": frf}
    assert encoders({"a": frf, "b": frf}) == {}


@pytest.mark.parametrize(
    ("head", "si", "times"),
    [
        ("|G| [mm/s/A]", "(m/s)/A", 1e-3),
        ("|G| [rad/(s Nm)]", "(rad/s)/(N m)", 1.0),
        ("|G| [µm/N]", "m/N", 1e-6),
        ("magnitude [(m/s)/N]", "(m/s)/N", 1.0),
    ],
)
def test_a_magnitude_between_bars_with_its_unit(tmp_path: Path, head: str, si: str, times: float) -> None:
    path = tmp_path / "frf.csv"
    name = "G" if head.startswith("|") else ""
    path.write_text(f"f [Hz];{head};arg {name} [°]\n1;2;-90\n2;4;-90\n3;8;-90\n", encoding="utf-8")
    frf = read_frf(path)
    assert frf.unit == si
    assert frf.magnitude == pytest.approx(times * np.array([2.0, 4.0, 8.0]), rel=1e-12)
