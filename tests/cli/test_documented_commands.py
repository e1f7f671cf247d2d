"""Every command of the pages for a shop runs on a log of its own, and finds in it what was put in.

The logs are made here with numpy, with the columns and units that the page names and other numbers than its own; the
machine file is that of the page.  What a command needs of the one before it is made here too.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from feeddrive.cli.commands import app
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from plain_drive import Cascade, HalPid, PlainAxis, write_columns

DOCS = Path(__file__).parents[2] / "docs" / "tutorials"
PAGES = sorted(DOCS.glob("shop_*.md"))
_CODE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
_SPAN = re.compile(r"`(feeddrive [^`]+)`")
runner = CliRunner()


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def commands_of(page: Path) -> list[str]:
    """Every command line of a page: in its consoles, and between the words, as in tables."""
    text = text_of(page)
    found = [
        line.removeprefix("$ ")
        for _, code in _CODE.findall(text)
        for line in code.splitlines()
        if re.match(r"(\$ )?feeddrive \S", line)
    ]
    found += _SPAN.findall(_CODE.sub("", text))
    return list(dict.fromkeys(found))


def machine_of(page: str) -> str:
    """The machine file that a page shows."""
    (found,) = (code for language, code in _CODE.findall(text_of(DOCS / page)) if language == "toml")
    return found


# what each page claims to be there, made with other numbers

MILL = PlainAxis(mass=1900.0, viscous=2500.0, coulomb=350.0, late=0.8)
PER_VOLT = 753.98  # N, of the page's machine file
TURNED = PlainAxis(mass=640.0, viscous=2000.0, coulomb=180.0)
RADIANS = 2.0 * np.pi / 0.01  # of the motor in a meter of the table
MOTOR, TABLE, SPRING, DAMPER, FRICTION = 3100.0, 820.0, 1.6e8, 1.5e4, 9e3  # kg, kg, N/m, N s/m, N s/m


@cache
def milled() -> dict[str, np.ndarray]:
    """Under the pid of the page's machine file."""
    return MILL.run(HalPid(20.0, 20.0, 0.5, 0.004, 0.002, PER_VOLT))


@cache
def turned() -> dict[str, np.ndarray]:
    return TURNED.run(Cascade(25.0, 32e3))


def for_linuxcnc(folder: Path) -> None:
    run = milled()
    rows = np.column_stack([1e3 * run["set"], 1e3 * run["position"], run["force"] / PER_VOLT])
    with (folder / "x.halscope").open("w") as file:
        file.write("# Sampling period is 1000000 ns\njoint.0.motor-pos-cmd;joint.0.motor-pos-fb;pid.x.output\n")
        file.write("# Position: 0;0;0\n# Scale: 0;0;0\n")
        np.savetxt(file, rows, fmt="%.14f", delimiter=";")
    machine = machine_of("shop_linuxcnc.md")
    (folder / "my_axis.toml").write_text(machine, encoding="utf-8")
    found = re.sub(r"mass_kg = 1000.*", "mass_kg = 1900", machine)
    tuned = re.sub(r"(?s)kind = \"linuxcnc_pid\".*", 'kind = "cascade_ppi"\nKv = 60\nKp = 450e3\nTn_ms = 40\n', found)
    for name, text in (("axis", found), ("tuned", tuned)):
        (folder / name).mkdir()
        (folder / name / "machine.toml").write_text(text, encoding="utf-8")


def for_sinumerik(folder: Path) -> None:
    run = turned()
    columns = {
        "Zeit [s]": run["time"],
        "Lagesollwert [mm]": 1e3 * run["set"],
        "Lageistwert [mm]": 1e3 * run["position"],
        "Drehmomentsollwert [Nm]": run["force"] / RADIANS,
    }
    write_columns(folder / "trace.csv", columns, ";", ",")
    f = np.geomspace(2.0, 800.0, 90)
    s = 2j * np.pi * f
    link = DAMPER * s + SPRING
    speed = s * (TABLE * s**2 + link) / ((MOTOR * s**2 + FRICTION * s + link) * (TABLE * s**2 + link) - link**2)
    plant = RADIANS**2 * speed  # (rad/s)/(N m)
    lines = zip(f, 20.0 * np.log10(np.abs(plant)), np.degrees(np.angle(plant)), strict=True)
    text = "".join(";".join(f"{value:.9g}" for value in line).replace(".", ",") + "\n" for line in lines)
    (folder / "speed_plant.txt").write_text(f"f [Hz];mag [dB];phase [°]\n{text}", encoding="utf-8")
    (folder / "X1.xml").write_text(tool_file(f, plant), encoding="utf-8")
    machine = machine_of("shop_sinumerik.md")
    (folder / "my_axis.toml").write_text(machine, encoding="utf-8")
    for name in ("model", "tuned"):
        (folder / name).mkdir()
        (folder / name / "machine.toml").write_text(machine, encoding="utf-8")


def tool_file(f: np.ndarray, plant: np.ndarray) -> str:
    """The XML of the tuning tool, with a response of the speed plant, its coherence, and a speed controller."""

    def array(member: str, kind: str, values: np.ndarray) -> str:
        numbers = ",".join(f"{each:.9g}" for each in values)
        raw = f'<raw name="m_pNumberArray">{numbers}</raw>'
        return f'<NumericArray name="{member}"{kind} format="CSV">{raw}</NumericArray>'

    def response(member: str, values: np.ndarray) -> str:
        parts = np.column_stack([values.real, values.imag]).ravel()
        inside = array("m_ValueVector", ' elementtype="complex"', parts) + array("m_FrequencyVector", "", f)
        return f'<FrequencyResponseFunction name="{member}">{inside}</FrequencyResponseFunction>'

    both = response("m_pPlant", plant) + response("m_pMeasCoherence", np.full(f.size, 0.999 + 0j))
    return (
        f'<DynamicModelAxisController ver="4.96"><string name="m_szAxisName">X1</string>'
        f'<LinkedList name="m_SpeedPlantMeasurementList"><SpeedPlantMeasurement>{both}</SpeedPlantMeasurement>'
        f'</LinkedList><LinkedList name="m_PositionControllerList"><PIRegulator name="m_SpeedRegulator">'
        f'<float name="m_Kp">4.5</float><float name="m_Tn">0.016</float></PIRegulator></LinkedList>'
        f"</DynamicModelAxisController>"
    )


FILES: dict[str, Callable[[Path], None]] = {"shop_linuxcnc.md": for_linuxcnc, "shop_sinumerik.md": for_sinumerik}


# what a command must have found or written: by the first words of its line


def mass(machine: str, **wanted: float) -> Callable[[Path, str], None]:
    """The machine file that an identification wrote has the masses of the log."""

    def check(folder: Path, _: str) -> None:
        (axis,) = read_machine_axis(folder / machine)
        for name, value in wanted.items():
            # integrated in twentieths of a sample, or computed lines of nine digits
            assert tree.get(axis, f"plant.{name}") == pytest.approx(value, rel=2e-3), name

    return check


def read_machine_axis(path: Path) -> list[object]:
    """The axes of a machine file; one that a response gives has no control, and gets that of a bundled machine."""
    text = path.read_text(encoding="utf-8")
    if ".control" not in text:
        text = f'sample_time = 1e-3\n{text}\n[axis.x.control.law]\nkind = "cascade_ppi"\nKv = 1\nKp = 1\n'
        path = path.with_name("whole.toml")
        path.write_text(text, encoding="utf-8")
    return [loop.axis for loop in read_machine(path).loops.values()]


def says(*words: str) -> Callable[[Path, str], None]:
    def check(_: Path, said: str) -> None:
        for each in words:
            assert each in said

    return check


def writes(*names: str) -> Callable[[Path, str], None]:
    def check(folder: Path, _: str) -> None:
        for each in names:
            assert (folder / each).stat().st_size > 0

    return check


by_hand = 12.0 / 10.0 * 0.5 * 2.0 * np.pi / 0.005  # A/V, N m/A, 1/m
FOUND: dict[str, Callable[[Path, str], None]] = {
    "feeddrive force pid.output": says(f"1 of 'pid.x.output' is {by_hand:.6g} N"),
    "feeddrive identify x.halscope": mass("axis/machine.toml", mass=MILL.mass),
    "feeddrive tune axis/machine.toml": writes("tuned/machine.toml"),
    "feeddrive export tuned/machine.toml --axis x --target linuxcnc-pid": writes("to_pid/axis-x.ini"),
    "feeddrive export tuned/machine.toml --axis x --target linuxcnc ": writes("to_component/README.md"),
    "feeddrive channels X1.xml": says("speed_plant_1_plant", "(rad/s)/(N m)", "today", "4.5", "16"),
    "feeddrive identify X1.xml": mass("model/machine.toml", mass_motor=MOTOR, mass_load=TABLE),
    "feeddrive identify speed_plant.txt": mass(
        "results/identify_speed_plant/machine.toml", mass_motor=MOTOR, mass_load=TABLE
    ),
    "feeddrive identify trace.csv": mass("results/identify_trace/machine.toml", mass=TURNED.mass),
    "feeddrive tune model/machine.toml": writes("tuned/machine.toml"),
    "feeddrive export tuned/machine.toml --target parameters": writes("to_control/sinumerik.txt"),
}
LONG = ("feeddrive tune", "feeddrive identify x.halscope", "feeddrive identify X1.xml")
CASES = [
    pytest.param(
        page.name,
        line,
        id=f"{page.stem}: {line[:60]}",
        marks=[pytest.mark.slow(reason="a search, a whole loop with friction, three structures: seconds each")]
        if line.startswith(LONG)
        else [],
    )
    for page in PAGES
    for line in commands_of(page)
]


def test_each_page_for_a_shop_has_its_files_here() -> None:
    assert {page.name for page in PAGES} == {*FILES}
    assert all(commands_of(page) for page in PAGES)


@pytest.mark.parametrize(("page", "line"), CASES)
def test_a_documented_command_finds_what_was_put_in(
    page: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    FILES[page](tmp_path)
    (check,) = (each for begins, each in FOUND.items() if line.startswith(begins))
    words = shlex.split(line)[1:]
    if "--out" in words:  # made for other commands
        shutil.rmtree(words[words.index("--out") + 1], ignore_errors=True)
    done = runner.invoke(app, words)
    assert done.exit_code == 0, f"{line}\n{done.output}\n{done.exception}"
    check(tmp_path, done.output)
