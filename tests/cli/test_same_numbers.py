"""What is typed of a log on the page, in a file, on the command line and in Python means the same everywhere.

The log of the first tests is that of a drive that records its force in percent of 1,200 N: one of it is 12 N.  Its
mass is 180 kg.  Those of the last ones are drawn by `benchmarks/entry.py` from a simulator that shares no code with
feeddrive: names, units, percent, amperes, decimal commas, laws, masses, encoders, axes that turn.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from collections.abc import Mapping as Mapping_
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import foreign_axis as foreign
import surfaces
from column_logs import written as write_log
from feeddrive.cli.commands import app
from feeddrive.files.columns import Column
from feeddrive.files.machine import read_machine
from feeddrive.files.mapping import Mapping
from feeddrive.files.origins import with_origins
from feeddrive.language import tree
from feeddrive.studio.rooms.export import recipe_of
from feeddrive.studio.server import Session
from feeddrive.workflow import identify
from feeddrive.workflow.identify import machine_text
from plain_drive import Cascade, PlainAxis, write_columns
from slow_share import all_but
from studio_server import Served

runner = CliRunner()
AXIS, KV, KP, PER_PERCENT = PlainAxis(mass=180.0), 30.0, 9000.0, 12.0


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = AXIS.run(Cascade(KV, KP))
    columns = {
        "t_s": run["time"],
        "x_cmd_mm": 1e3 * run["set"],
        "x_fb_mm": 1e3 * run["position"],
        "load": run["force"] / PER_PERCENT,
    }
    return write_columns(tmp_path_factory.mktemp("log") / "axis.csv", columns)


def on_the_page(log: Path, folder: Path, *, again: bool = False, **typed: Any) -> Path:
    """Bring the log, type what its column of the force is, and press Identify; its jobs run in this process.

    again  do the same once more by the command that the page says
    """
    session = Session(folder)
    ask = surfaces.asking_here(session, log)
    typed_on_page(ask, log.name, **typed)
    machine = machine_in(folder)
    if again:
        machine.unlink()
        done = runner.invoke(app, shlex.split(recipe_of(session.desk).commands.splitlines()[-1])[1:])
        assert done.exit_code == 0, done.output
    return machine


@contextmanager
def serving(folder: Path) -> Iterator[Served]:
    """A server as a person starts it."""
    served = Served(folder)
    try:
        yield served
    finally:
        served.close()


def typed_on_page(ask: Callable[..., dict[str, Any]], name: str, **typed: Any) -> None:
    """What a person does on the page, as it asks for it."""
    for do, more in (("import.look", {"names": [name]}), ("import.role", {"column": "load", "role": "force", **typed})):
        words = ask(do, **more)
        assert not words.get("error"), words["error"]
    row = next(each for each in ask("import.show")["columns"] if each["column"] == "load")
    assert {key: row[key] for key in typed} == typed  # the fields show what was typed
    words = ask("import.identify")
    assert not words.get("error"), words["error"]


def machine_in(folder: Path) -> Path:
    """The machine file that an identification on the page wrote."""
    (found,) = folder.rglob("identified_*/machine.toml")
    return found


def by_words(log: Path, folder: Path, *words: str) -> Path:
    done = runner.invoke(app, ["identify", str(log), *words, "--out", str(folder / "out")])
    assert done.exit_code == 0, done.output
    return folder / "out" / "machine.toml"


def with_file(log: Path, folder: Path) -> Path:
    """The channels file that the command writes, corrected by hand in an editor."""
    roles = folder / "roles.toml"
    assert runner.invoke(app, ["channels", str(log), "--out", str(roles)]).exit_code == 0
    text = roles.read_text(encoding="utf-8")
    roles.write_text(f'{text}force = {{ column = "load", factor = 12 }}\n', encoding="utf-8")
    return by_words(log, folder, "--channels", str(roles))


def from_python(log: Path, folder: Path, **typed: Any) -> Path:
    identify(log, out=folder / "out", **typed)
    return folder / "out" / "machine.toml"


MAPPING = Mapping(
    {
        "setpoint_position": Column(name="x_cmd_mm", unit="mm"),
        "position_load": Column(name="x_fb_mm", unit="mm"),
        "force": Column(name="load", factor=PER_PERCENT),
    }
)
# each with the column of the force as its report says it
SURFACES: dict[str, tuple[Callable[[Path, Path], Path], str]] = {
    "page": (lambda log, folder: on_the_page(log, folder, factor=12), "load*12.0"),
    "page, then its command": (
        lambda log, folder: on_the_page(log, folder, unit="kN", factor=0.012, again=True),
        "load*0.012:kN",
    ),
    "channels file": (with_file, "load*12.0"),
    "command line": (lambda log, folder: by_words(log, folder, "--force", "load*12"), "load*12.0"),
    "Python, factor and unit": (lambda log, folder: from_python(log, folder, force="load*0.012:kN"), "load*0.012:kN"),
}


@pytest.fixture(scope="module")
def by_mapping(log: Path) -> str:
    """The machine file by a `Mapping` in Python."""
    text = machine_text(identify(log, channels=MAPPING), None, "x")
    assert text is not None
    return with_origins(text, (log,))


@pytest.mark.parametrize("surface", SURFACES)
def test_a_typed_factor_gives_the_same_machine_on_every_surface(
    log: Path, tmp_path: Path, by_mapping: str, surface: str
) -> None:
    made, said = SURFACES[surface]
    machine = made(log, tmp_path)
    assert machine.read_text(encoding="utf-8") == by_mapping  # every number to the last digit
    assert f"force: {said}<" in (machine.parent / "report.html").read_text(encoding="utf-8").replace(", ", "<")
    found = read_machine(machine).loop("x")
    # integrated in twentieths of a sample: 5e-4 of the mass; the law without noise, to rounding of 12 digits
    assert tree.get(found, "axis.x.plant.mass") == pytest.approx(AXIS.mass, rel=5e-4)
    assert tree.get(found, "axis.x.control.law.Kp") == pytest.approx(KP, rel=1e-6)
    assert tree.get(found, "axis.x.control.law.Kv") == pytest.approx(KV, rel=1e-6)


@pytest.mark.slow(reason="a server, its socket and its processes; what the page asks for is checked quickly above")
def test_the_factor_goes_through_the_socket(log: Path, tmp_path: Path, by_mapping: str) -> None:
    with serving(tmp_path / "served") as served, served.page("x") as page:
        assert served.upload("x", log.name, log.read_bytes()) == (200, {"name": log.name})

        def ask(do: str, **more: Any) -> dict[str, Any]:
            page.job = None
            said = page.ask(do, name=log.name, **more)
            if do in ("import.look", "import.identify"):
                ended = page.ended()
                assert ended["state"] == "done", ended["error"]
            return said

        typed_on_page(ask, log.name, factor=12)
        assert machine_in(tmp_path / "served").read_text(encoding="utf-8") == by_mapping


# ---------------------------------------------------------------- logs that are not ours, left to the guess or named


def benchmark(name: str) -> ModuleType:
    """A script of benchmarks/, which is no package."""
    spec = spec_from_file_location(name, Path(__file__).parents[2] / "benchmarks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def same(log: Path, folder: Path, stated: Mapping_[str, Any], ask: surfaces.Ask, session: Path) -> surfaces.Told:
    """Machine file and report, or the refusal, of command line, Python and page: equal to the last digit."""
    told = surfaces.on_command_line(log, folder / "by_command", stated)
    python, page = (
        surfaces.in_python(log, folder / "in_python", stated),
        surfaces.on_the_page(ask, session, log, stated),
    )
    surfaces.assert_same(told, python)
    surfaces.assert_same(surfaces.of_page(told), page)
    return told


def several_axes(path: Path) -> Path:
    """Two axes with velocities, forces in percent, and a column of which no name says what it is."""
    columns: dict[str, np.ndarray] = {}
    for axis, mass in (("X1", 95.0), ("Y1", 42.0)):
        log = PlainAxis(mass=mass).run(Cascade(KV, 50.0 * mass))
        columns.setdefault("time [ms]", 1e3 * log["time"])
        columns[f"{axis}_CommandPosition [mm]"] = 1e3 * log["set"]
        columns[f"{axis}_ActualPosition [mm]"] = 1e3 * log["position"]
        columns[f"{axis}_ActualVelocity [mm/s]"] = 1e3 * np.gradient(log["position"], 1e-3)
        columns[f"{axis}_OutputForce [%]"] = log["force"] / 4.0
    return write_log(path, {**columns, "spare": np.sin(np.arange(log["time"].size))})


def turning(path: Path) -> Path:
    """An axis that turns: degrees, and amperes of a motor of 2.5 N m/A."""
    T, inertia = 1e-3, 0.05  # kg m2
    axes = foreign.Axes(
        mass=inertia,
        viscous=2.0 * inertia,
        coulomb_positive=3.0 * inertia,
        coulomb_negative=3.0 * inertia,
        resolution=1e-5,
        rotary=True,
    )
    moves = 10.0 * foreign.smooth_moves(T, (0.1, 0.0), 0.2, 2.0, 80.0, 0.1, 0.2)
    law = foreign.Cascade(Kv=25.0, Kp=120.0 * inertia)
    log = foreign.simulate(axes, law, moves, T, np.random.default_rng(3), count=1).log(0)
    columns = {"t [s]": log["time"], "SetPosition [deg]": np.degrees(log["setpoint"])}
    columns |= {"ActPosition [deg]": np.degrees(log["position"]), "MotorCurrent [A]": log["force"] / 2.5}
    return write_log(path, columns)


KINDS: dict[str, tuple[Callable[[Path], Path], dict[str, Any]]] = {
    "axis y1 of two": (several_axes, {"axis": "y1", "rated": "400N"}),
    "the first axis of two": (several_axes, {"rated": "400N"}),
    "percent of nothing": (several_axes, {}),
    "an axis that turns": (turning, {"rotary": True, "torque_constant": 2.5}),
    "a wrong force": (several_axes, {"axis": "x1", "force": "spare:N"}),
}


@pytest.mark.parametrize("kind", all_but(["axis y1 of two", "percent of nothing"], KINDS, "the same of other logs"))
def test_page_command_line_and_python_say_the_same_of_a_log(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("feeddrive.report.page.svg", lambda *_: "")  # pictures take the time, and are not compared
    writes, stated = KINDS[kind]
    log = writes(tmp_path / "log.csv")
    (session := tmp_path / "session").mkdir()
    told = same(log, tmp_path, stated, surfaces.asking_here(Session(session), log), session)
    assert bool(told.machine) == ("rated" in stated or "torque_constant" in stated)
    if "axis y1" in kind:
        assert "[axis.y1" in str(told.machine)
        assert "[axis.x" not in str(told.machine)


@pytest.mark.slow(reason="six foreign logs of a law, each identified twice by command, in Python and on a running page")
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("law", foreign.LAWS)
def test_thirty_foreign_logs_give_the_same_numbers_everywhere(tmp_path: Path, law: str) -> None:
    """First left to the guess, then named; a refusal is the same sentence."""
    entry = benchmark("entry")
    rng = np.random.default_rng([2610, foreign.LAWS.index(law)])
    machines = 0
    with serving(tmp_path / "served") as served:
        for number, two in enumerate((False, True) * 3):
            logs = entry.draw(rng, law, two=two)
            rotary = bool(logs.axes.rotary)
            (folder := tmp_path / str(number)).mkdir()
            log = logs.log(0, first=300)
            written = foreign.write_csv(folder / f"log_{number}.csv", log, rng, rotary=rotary, two=two)
            clock = {"time": f"{written.names['time']}:{written.units['time']}"}
            known = entry.data_sheet(written, rotary=rotary), entry.named(written, rotary=rotary, two=two)
            for attempt, stated in enumerate(known):
                name = f"{number}_{attempt}"
                with served.page(name) as page:
                    ask = surfaces.asking(served, page, written.path)
                    told = same(written.path, folder / name, clock | stated, ask, tmp_path / "served")
                machines += told.machine is not None
    assert machines >= 6  # of 12
