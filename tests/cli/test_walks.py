"""From a log to an exported, verified loop: the commands of docs/tutorials/from_your_log.md, as they are typed.

The logs come from the foreign simulator (`foreign_axis`), with the names and units of each shop.  Each `Next:` line
names the command, the file and the options of the page's next line, which adds where to write and limits of its own.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import commissioning_files as cf
import foreign_axis as fa
from feeddrive.cli.commands import app
from feeddrive.files.machine import read_machine
from feeddrive.language import tree

PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "from_your_log.md"
COMPILER = next((found for name in ("gcc", "cc", "clang") if (found := shutil.which(name))), None)
T = 1e-3
MOVES = fa.smooth_moves(T, (0.1, 0.0) * 2, 0.2, 2.0, 80.0, 0.15, 0.2)


def logged(mass: float, law: fa.Law, force: float, seed: int) -> dict[str, np.ndarray]:
    """Two strokes of a table with friction, 1 um counts, and noise of half a thousandth of `force` (N)."""
    axes = fa.Axes(
        mass=mass,
        viscous=2.0 * mass,
        coulomb_positive=0.3 * mass,
        coulomb_negative=0.3 * mass,
        dead_time=0.9e-3,
        noise_log=5e-4 * force,
        resolution=1e-6,
    )
    return fa.simulate(axes, law, MOVES, T, np.random.default_rng(seed), count=1).log(0)


def rows(path: Path, head: str, columns: list[np.ndarray], form: str = "%.7f") -> None:
    np.savetxt(path, np.column_stack(columns), fmt=form, delimiter="," if head else " ", header=head, comments="")


MAKER, SHOP, STUDENT, TRACED = 62.0, 820.0, 41.0, 530.0  # kg, of each table


def for_maker(folder: Path) -> None:
    """Percent of the 450 N of the data sheet."""
    log = logged(MAKER, fa.Cascade(Kv=22.0, Kp=130.0 * MAKER, rate=14.0, ff=1.0), 450.0, 41)
    columns = [1e3 * log["time"], 1e3 * log["setpoint"], 1e3 * log["position"], log["force"] / 4.5]
    rows(folder / "axis.csv", "time (ms),target (mm),actual (mm),torque (%)", columns)


def for_linuxcnc(folder: Path) -> None:
    """halsampler of a servo thread of 1 ms: set position and position in mm, output in V of 300 N."""
    law = fa.LinuxCncPid(P=2860.0 * SHOP, I=4e4 * SHOP, D=130.0 * SHOP, FF1=2.0 * SHOP, FF2=SHOP)
    log = logged(SHOP, law, 3000.0, 42)
    columns = [1e3 * log["setpoint"], 1e3 * log["position"], log["force"] / 300.0]
    rows(folder / "x.txt", "", columns)
    numbered = [np.arange(log["force"].size, dtype=float), *columns]
    np.savetxt(folder / "x_t.txt", np.column_stack(numbered), fmt=["%d", "%.7f", "%.7f", "%.7f"])


def for_student(folder: Path) -> None:
    """SI units, and names of a script of one's own."""
    log = logged(STUDENT, fa.Cascade(Kv=25.0, Kp=120.0 * STUDENT), 300.0, 43)
    columns = [log["time"], log["setpoint"], log["position"], log["force"]]
    rows(folder / "run.csv", "t_s,x_ref_m,x_meas_m,u_N", columns, "%.9g")


def for_sinumerik(folder: Path) -> None:
    """A trace with decimal commas; the torque of the motor on a screw of 10 mm."""
    log = logged(TRACED, fa.Cascade(Kv=25.0, Kp=130.0 * TRACED, rate=20.0), 3000.0, 44)
    torque = log["force"] * 0.01 / (2.0 * np.pi)
    columns = [log["time"], 1e3 * log["setpoint"], 1e3 * log["position"], torque]
    lines = ["Zeit [s];Lagesollwert [mm];Lageistwert [mm];Drehmomentsollwert [Nm]"]
    lines += [";".join(f"{value:.7f}" for value in row).replace(".", ",") for row in zip(*columns, strict=True)]
    (folder / "trace.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


# the walk is that of the page: a screw, and a clock at which a search is short
TUNED_BY_AST = replace(
    cf.drawn(3), rotary=False, per_motor=0.01 / (2.0 * np.pi), clock=125e-6, slow=8, modes=(), noise=0.02
)


def for_ast(folder: Path) -> None:
    """The XML of the tuning tool."""
    cf.written(folder, TUNED_BY_AST, name="AX1.xml")


def commands_of(walk: str) -> list[str]:
    """The commands of one section of the page."""
    section = re.split(r"(?m)^## ", PAGE.read_text(encoding="utf-8"))
    (text,) = (part for part in section if part.startswith(f"{walk}\n"))
    return re.findall(r"(?m)^\$ (feeddrive .+)$", text)


def typed(command: str) -> str:
    done = CliRunner().invoke(app, shlex.split(command)[1:])
    assert done.exit_code == 0, f"{command}\n{done.output}\n{done.exception}"
    return done.output


def walk(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, writes: Callable[[Path], None]) -> list[str]:
    """Type the commands of the page in a folder; each `Next:` line is the next command of the page. Their outputs."""
    monkeypatch.chdir(folder)
    writes(folder)
    commands, outputs = commands_of(name), list[str]()
    if COMPILER is None and any(" verify " in command for command in commands):
        pytest.skip("NOT TESTED: `feeddrive verify` needs a compiler: apt-get install gcc libc6-dev")
    for command, following in zip(commands, [*commands[1:], ""], strict=True):
        outputs.append(typed(command))
        named = re.findall(r"(?m)^Next: (.+)$", outputs[-1])
        if named:
            (said,) = (shlex.split(each) for each in named)
            typed_next = shlex.split(following)
            assert typed_next[:3] == said[:3], f"{command}\nsays {said}"
            assert {word for word in said if word.startswith("-")} <= set(typed_next), f"{command}\nsays {said}"
            continue
        # a command that ends without a next one is the last of its kind: verify, and parameters for a person to type
        assert command.split()[1] == "verify" or not following, command
    return outputs


def assert_mass(machine: Path, mass: float) -> None:
    """Within 1 %: counts of 1 um and noise of half a thousandth of the force."""
    loop = read_machine(machine).loop(None)
    assert tree.get(loop, f"axis.{loop.name}.plant.mass") == pytest.approx(mass, rel=0.01)


def assert_equal(verified: str) -> None:
    assert "EQUAL" in verified
    assert "bit for bit" in verified


def test_a_maker_walks_from_percent_to_a_verified_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = walk("A maker", tmp_path, monkeypatch, for_maker)
    assert_mass(tmp_path / "model/machine.toml", MAKER)
    assert_equal(outputs[-1])


@pytest.mark.slow(reason="a search and compiled C: 6 s")
def test_a_linuxcnc_shop_walks_from_halsampler_to_a_verified_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs = walk("A LinuxCNC shop", tmp_path, monkeypatch, for_linuxcnc)
    assert_mass(tmp_path / "model/machine.toml", SHOP)
    assert_equal(outputs[-1])
    command = commands_of("A LinuxCNC shop")[0].replace("x.txt", "x_t.txt").replace("out model", "out again")
    # with -t the number of the row is the first column
    for column in (3, 2, 1):
        command = command.replace(f"column_{column}", f"column_{column + 1}")
    typed(command)
    assert_mass(tmp_path / "again/machine.toml", SHOP)


@pytest.mark.slow(reason="a search and compiled C: 2 s")
def test_a_student_walks_from_a_log_to_a_verified_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = walk("A student", tmp_path, monkeypatch, for_student)
    assert_mass(tmp_path / "model/machine.toml", STUDENT)
    assert_equal(outputs[-1])


@pytest.mark.slow(reason="a search and compiled C: 2 s")
def test_a_sinumerik_engineer_walks_from_a_trace_to_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = walk("A SINUMERIK engineer", tmp_path, monkeypatch, for_sinumerik)
    assert_mass(tmp_path / "model/machine.toml", TRACED)
    assert_equal(outputs[-2])
    written = (tmp_path / "to_control/sinumerik.txt").read_text(encoding="utf-8")
    assert "MD32200" in written
    assert "p1460" in written


@pytest.mark.slow(reason="a fit, a search and compiled C: 20 s")
def test_a_sinumerik_engineer_walks_from_the_file_of_the_tuning_tool(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs = walk("A SINUMERIK engineer with the tuning tool's file", tmp_path, monkeypatch, for_ast)
    plant = dict(tree.leaves(read_machine(tmp_path / "model/machine.toml").loop(None).axis.plant))
    per_turn = TUNED_BY_AST.per_motor
    inertia = plant["inertia_motor"] + per_turn**2 * plant["mass_load"]
    # errors of the drawn file: waves of 1 % over the response
    assert inertia == pytest.approx(TUNED_BY_AST.inertia, rel=0.01)
    assert_equal(outputs[-2])
    written = (tmp_path / "to_control/sinumerik.txt").read_text(encoding="utf-8")
    # today's law of the file, and tuned at the margins that the file asks for
    assert f"Kp {TUNED_BY_AST.gains[0]:.4g} N m s/rad" in outputs[0]
    assert "tuned at the margins that the file asks for" in outputs[1]
    for name in ("MD31030 $MA_LEADSCREW_PITCH = 10", "MD32200", "p1460", "p1462"):
        assert name in written
