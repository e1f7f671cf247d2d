"""Commands: declared requests, options made from them, one progress, and nothing written by what is cancelled."""

from __future__ import annotations

import ast
import inspect
import re
import shlex
import subprocess
import sys
import types
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.main import get_command
from typer.testing import CliRunner

import feeddrive as fd
from feeddrive.cli import commands
from feeddrive.cli.commands import OFFERED, app, offered
from feeddrive.files.machine import BUNDLED
from feeddrive.language import units
from feeddrive.language.errors import CancelledError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import COMMANDS, Command, Outcome, Request, argument, fields_of, load, option

formats = import_module("feeddrive.files.read_log")  # `feeddrive.files.read_log` is the function


class Asked(Request):
    """One field of each kind."""

    machine: str = argument("a machine file")
    compliance: float | None = option("largest compliance", default=None, unit="m/N", entered="um/N", above=0.0)
    starts: int = option("searches", default=2, least=1, most=20)
    goal: str = option("what is made best", default="snap", options=("snap", "stiffness"))
    at: tuple[Path, ...] = option("other places", default=())


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"compliance": -2e-6}, "--compliance = -2 um/N (largest compliance) must be > 0 um/N"),
        ({"compliance": float("nan")}, "--compliance = nan um/N (largest compliance) must be a finite number"),
        ({"starts": 21}, "--starts = 21 (searches) must be <= 20"),
        ({"starts": 1.5}, "--starts = 1.5 (searches) must be a whole number"),
        ({"goal": "speed"}, "--goal = 'speed' (what is made best) must be one of 'snap', 'stiffness'"),
    ],
)
def test_a_wrong_field_is_refused_by_name_value_bound_and_unit(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ParameterError) as caught:
        Asked("emps", **given)
    assert str(caught.value) == said


def test_a_request_is_in_si_and_says_its_command_line() -> None:
    asked = Asked("emps", compliance=5e-7, at=("a b.csv", "c.csv"))  # type: ignore[arg-type]
    assert asked.at == (Path("a b.csv"), Path("c.csv"))
    assert asked.python("tune") == "fd.workflow.tune('emps', compliance=5e-07, at=('a b.csv', 'c.csv'))"
    assert asked.command_line("tune") == "feeddrive tune emps --compliance 0.5 --at 'a b.csv' --at c.csv"


class OfEveryKind(Request):
    """A field of each kind, and of each kind several."""

    machine: str = argument("a machine file")
    starts: int = option("searches", default=2)
    joint: int | None = option("number of a joint", default=None)
    counts: tuple[int, ...] = option("samples", default=())
    compliance: float | None = option("largest compliance", default=None, unit="m/N", entered="um/N")
    turning: float = option("a speed", default=1.0, unit="rad/s", entered="rpm")
    delay: float = option("a delay", default=0.0, unit="s")
    feed: tuple[float, ...] = option("feeds", default=(), unit="m/s", entered="mm/min")
    fit: bool = option("fit it", default=False)
    goal: str = option("what is made best", default="snap", options=("snap", "stiffness"))
    law: tuple[str, ...] = option("a law", default=())
    out: Path | None = option("where to", default=None)
    at: tuple[Path, ...] = option("other places", default=())


def entered(text: str, request: type[Request]) -> Request:
    """The request that the command line makes of a text."""
    made: list[Request] = []

    def kept(given: Any, _: Progress) -> Any:
        made.append(given)
        return Outcome(None)

    shell = typer.Typer()
    shell.command()(commands._function(Command(request, kept)))  # pyright: ignore[reportPrivateUsage]
    get_command(shell).main(shlex.split(text)[2:], standalone_mode=False)
    return made[0]


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"starts": 5, "joint": 0, "counts": (-3, 7)},
        {"fit": True, "goal": "stiffness", "law": ("P-PI", "one of mine: ü")},
        {"out": Path("a b/c"), "at": (Path("it's.csv"), Path("c.csv"))},
        {"delay": 0.1 + 0.2, "turning": -2.5, "compliance": 2e-7},
        {"delay": 1.0 / 3.0, "feed": (1e300, 5e-324)},
    ],
    ids=lambda given: ",".join(given) or "defaults",
)
def test_the_command_line_of_a_request_makes_an_equal_request(given: dict[str, Any]) -> None:
    asked = OfEveryKind("a machine", **given)
    assert entered(asked.command_line("tune"), OfEveryKind) == asked


@given(st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False, max_value=1e200, min_value=-1e200))
def test_no_bit_of_a_number_that_was_entered_is_lost(number: float) -> None:
    """What is entered in um/N, rpm or mm/min is the same number in SI after the way through the command line."""
    for name, unit in (("compliance", 1e-6), ("turning", units.factor("rpm", "rad/s")), ("delay", 1.0)):
        value = units.scaled(number, unit)
        field = next(each for each in fields_of(OfEveryKind) if each.name == name)
        assert units.scaled(float(field.shown(value)), unit) == value


def test_what_is_given_on_the_command_line_reaches_the_request_in_si(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.2 um/N on the command line are 0.2e-6 m/N in the request."""
    seen: list[Any] = []

    def stopped(_: object, request: Request, progress: Progress) -> None:
        seen.append(request)
        raise CancelledError("enough")

    monkeypatch.setattr(Command, "run", stopped)
    command: Any = get_command(app)
    with pytest.raises(CancelledError):
        command.main(
            ["tune", "emps", "--max-compliance", "0.2", "--at", "mill", "--at", "b.csv"], standalone_mode=False
        )
    assert seen[0].max_compliance == pytest.approx(2e-7, rel=1e-12)
    assert seen[0].at == ("mill", "b.csv")
    assert seen[0].out == Path("results/tune_emps")


def test_every_field_of_a_request_is_an_argument_or_an_option() -> None:
    command: Any = get_command(app)
    for name in COMMANDS:
        shown = {option.name: option for option in command.commands[name].params if option.name != "help"}
        assert "--verbose" in shown.pop("verbose").opts, name
        assert "--blocks" in shown.pop("blocks").opts, name
        assert "--json" in shown.pop("json").opts, name
        fields = {field.name: field for field in fields_of(load(name).request)}
        assert set(shown) == set(fields), name
        assert not [key for key, field in fields.items() if not field.declared.meaning], name
        assert not [key for key, field in fields.items() if field.flag not in ("", *shown[key].opts)], name


@pytest.mark.parametrize("name", COMMANDS)
def test_the_examples_of_a_command_are_shown_and_make_its_request(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is read as the command line reads it, and the request checks names, units and bounds."""
    made: list[Request] = []

    def seen(_: object, request: Request, progress: Progress) -> None:
        made.append(request)
        raise CancelledError("enough")

    monkeypatch.setattr(Command, "run", seen)
    command: Any = get_command(app)
    shown = CliRunner().invoke(app, [name, "--help"]).output.splitlines()
    examples = COMMANDS[name].examples
    assert examples
    for each in examples:
        assert f"  feeddrive {name} {each}".rstrip() in shown
        with pytest.raises(CancelledError):
            command.main([name, *shlex.split(each)], standalone_mode=False)
    assert len(made) == len(examples)


def test_help_has_every_command_once_under_what_a_user_does() -> None:
    said = CliRunner().invoke(app, ["--help"]).output
    held: dict[str, list[str]] = {}
    for line in said.splitlines():
        if head := re.fullmatch(r"(\w[\w ]*):", line):
            held[head[1]] = []
        elif held and (row := re.match(r"  ([a-z][\w-]*) ", line)):
            held[list(held)[-1]].append(row[1])
    held.pop("Options")
    assert held == {
        group: [name for name, each in OFFERED.items() if each.group == group]
        for group in dict.fromkeys(each.group for each in OFFERED.values())
    }
    assert 4 <= len(held) <= 8


def test_commands_have_one_function_of_their_name() -> None:
    """`fd.workflow.NAME`; no other public name is called like a command and does something else.

    In `fd.plot` a name says what is drawn.
    """
    rooms = [room for room in dir(fd) if isinstance(getattr(fd, room), types.ModuleType) and room != "plot"]
    for name in COMMANDS:
        own = name.replace("-", "_")
        function = getattr(fd.workflow, own)
        assert function is load(name)
        assert list(inspect.signature(function).parameters) == [field.name for field in fields_of(function.request)]
        for place in (fd, *(getattr(fd, room) for room in rooms)):
            if own in dir(place) and not isinstance(getattr(place, own), types.ModuleType):
                assert getattr(place, own) is function, f"{place.__name__}.{own}"


def test_the_table_of_the_docs_has_every_command() -> None:
    page = (Path(__file__).parents[2] / "docs" / "tutorials" / "first-axis.md").read_text(encoding="utf-8")
    told = dict(re.findall(r"(?m)^\| `feeddrive ([\w-]+)` \| `fd\.([\w.]+)`", page))
    assert set(told) == set(COMMANDS)
    for name, dotted in told.items():
        held: Any = fd
        for part in dotted.split("."):
            held = getattr(held, part)
        assert held is load(name)


def test_what_was_read_may_be_given_in_place_of_its_file(tmp_path: Path) -> None:
    """Machine, job, loop, log and motion log: the result is that of the file, or of what was made from it."""
    log_of_a_motion(tmp_path / "log.csv")
    log = fd.read_log(tmp_path / "log.csv")
    by_path, by_log = (
        fd.identify(each, position="position_m", force="force_N") for each in (tmp_path / "log.csv", log)
    )
    assert by_log.rigid["mass"].value == by_path.rigid["mass"].value
    motion = fd.identification.MotionLog(
        name="m", position=log["position_m"], force=log["force_N"], sample_time=log.sample_time
    )
    assert fd.identify(motion).rigid["mass"].value == by_path.rigid["mass"].value
    by_path, by_log = (fd.workflow.channels(each).mapping.columns for each in (tmp_path / "log.csv", log))
    # the clock of a log that was read is called time
    assert {**by_log, "time": None} == {**by_path, "time": None}
    machine = fd.read_machine("linear_motor")
    made = [fd.certify(each).text() for each in (machine, "linear_motor")]
    assert made[0] == made[1]
    loop = fd.vary(
        machine.loop("x"), {"axis.x.plant.mass": 1.1 * fd.parameters(machine.loop("x"))["axis.x.plant.mass"]}
    )
    assert fd.certify(loop).document["control"] == fd.certify(machine).document["control"]
    rule = {"recipe": "margins-robust", "confidence": 0.9}
    assert fd.tune(machine, **rule).tunables == fd.tune("linear_motor", **rule).tunables
    assert fd.tune(loop, **rule).control != fd.tune(machine, **rule).control
    job = fd.read_job("emps")
    assert fd.workflow.run.request(job).usual_out() == Path("results/emps")


class Stopped(Progress):
    """Somebody who cancels at the first step."""

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.cancel()


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("run", {"job": "emps"}),
        ("demo", {}),
        ("compare", {"machine": "linear_motor", "law": ("DADSC",), "starts": 1}),
        ("tune", {"source": "linear_motor", "starts": 1}),
        ("certify", {"source": "linear_motor"}),
        ("excite", {"machine": "emps", "band": "5..50", "amplitude": 1.0}),
        ("reproduce", {"paper": "gordon2013"}),
    ],
)
def test_a_cancel_ends_the_work_and_nothing_is_written(name: str, asked: dict[str, Any], tmp_path: Path) -> None:
    command = load(name)
    with pytest.raises(CancelledError):
        command.run(command.request(**asked, out=tmp_path / "d"), Stopped())
    assert not list(tmp_path.iterdir())


def test_without_a_place_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from feeddrive.workflow.excite import excite

    monkeypatch.chdir(tmp_path)
    asked = excite.request("emps", band="20..40", amplitude=1.0, periods=2, realisations=1)
    found = excite.run(asked)
    assert found.result.frequency.size > 0
    assert not found.files
    assert not list(tmp_path.iterdir())


def log_of_a_motion(path: Path) -> None:
    """0.4 kg and dry friction, to and fro; columns with the usual names."""
    t = 1e-3 * np.arange(4000)
    x = 0.05 * np.sin(2.0 * np.pi * 0.5 * t) + 0.005 * np.sin(2.0 * np.pi * 2.3 * t)
    v, a = np.gradient(x, 1e-3), np.gradient(np.gradient(x, 1e-3), 1e-3)
    force = 40.0 * a + 12.0 * np.sign(v) + 5.0 * v + np.random.default_rng(1).normal(0.0, 0.2, t.size)
    rows = "\n".join(f"{p:.6f};{q:.9f};{r:.6f}" for p, q, r in zip(t, x, force, strict=True))
    path.write_text("time_s;position_m;force_N\n" + rows + "\n", encoding="utf-8")


@pytest.mark.parametrize("words", [{}, {"time": "time_s"}, {"force": "force_N:N"}])
def test_identify_parses_its_log_once(words: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It asks whether there are frequency responses, guesses roles, and reads what it chose: four looks, one parse."""
    from feeddrive.workflow.identify import identify

    log_of_a_motion(tmp_path / "log.csv")
    read, parsed = formats.text_files.read_csv, list[str]()

    def counted(name: str, *rest: Any) -> Any:
        parsed.append(name)
        return read(name, *rest)

    monkeypatch.setattr(formats.text_files, "read_csv", counted)
    found = identify(tmp_path / "log.csv", **words)
    assert found.rigid is not None
    assert len(parsed) == 1


OWN_CLI = ("cli/commands.py", "workflow/command.py", "workflow/schemas.py")
FOREIGN = {
    "cli/__init__.py": "--force-reinstall",  # of pip
    "workflow/doctor.py": "--force-reinstall",
    "export/cortex_m.py": "--specs --gc-sections",  # of gcc and its linker
    "export/linuxcnc.py": "--install",  # of halcompile
    "export/linuxcnc_axis.py": "--install",
    "export/linuxcnc_hal.py": "--install",
    "export/linuxcnc_session.py": "--install --compile --user --map-user --ipc --mount --net --pid --fork --kill-child "
    "--mount-proc --map-root-user",  # of halcompile and unshare
    "report/page.py": "--ink --muted --paper --alert --curve- --heat-",  # variables of the style sheet
    "report/svg.py": "--font",
}


def test_hints_name_options_that_exist() -> None:
    """Every `--option` in a text of the program is one of some command, or of another program that is named here."""
    declared = {field.flag for name in OFFERED for field in fields_of(offered(name).request)}
    declared |= {each for one in get_command(app).params for each in one.opts} | {"--help", "--blocks"}
    source = Path(fd.__file__).parent
    wrong, used = [], set()
    for file in sorted(source.rglob("*.py")):
        name = file.relative_to(source).as_posix()
        own = FOREIGN.get(name, "").split()
        own_cli = {"--verbose", "--version", "--json"} if name in OWN_CLI else set()
        text = file.read_text(encoding="utf-8")
        # only files with an option somewhere are parsed: a syntax tree of all sources takes seconds
        for node in ast.walk(ast.parse(text)) if "--" in text else ():
            if not (isinstance(node, ast.Constant) and isinstance(node.value, str)):
                continue
            for flag in re.findall(r"(?<![\w-])--[a-z][\w-]*", node.value):
                if flag in own:
                    used.add((name, flag))
                elif flag not in declared | own_cli:
                    wrong.append(f"{name}:{node.lineno}: {flag}")
    assert not wrong
    assert used == {(name, flag) for name, flags in FOREIGN.items() for flag in flags.split()}, (
        "an exemption of nothing"
    )


HEAVY = {"scipy.special", "scipy.optimize", "scipy.linalg", "scipy.sparse", "pandas", "matplotlib", "llvmlite.binding"}


def loaded_by(code: str) -> set[str]:
    """The modules that a fresh interpreter has imported after some code."""
    code = f"import sys\n{code}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    return set(done.stdout.split())


def test_no_command_loads_before_it_works_what_only_its_work_needs() -> None:
    """The time of `--help` is that of the imports, see docs/reference/speed.md: all commands, in one interpreter."""
    found = loaded_by("from feeddrive.workflow.command import COMMANDS, load\nfor each in COMMANDS: load(each)")
    assert not (HEAVY | {"pyarrow"}) & found


# of packages: all that stands in them
PLANNER = {
    "feeddrive.path.setpoints",
    "feeddrive.path.proof",
    "feeddrive.path.schedule",
    "feeddrive.path.program.reading",
}
LOGS = {"feeddrive.files.read_log", "feeddrive.identification", "feeddrive.analysis.replay"}
WORK = {
    "llvmlite",
    "pyarrow",
    "jinja2",
    "scipy",
    "importlib.metadata",
    "feeddrive.report.page",
    "feeddrive.loop.gradient",
}
NEVER = {"pydantic", "matplotlib", "pandas"}


@pytest.mark.parametrize(
    ("words", "code", "without"),
    [
        ("--help", 0, {"feeddrive.files", "feeddrive.path", "feeddrive.loop", "rich"} | LOGS | WORK),
        ("plan --help", 0, {"feeddrive.files.part_program", "feeddrive.language.kernels"} | PLANNER | LOGS | WORK),
        ("plan absent.ngc --machine mill", 2, {"feeddrive.files.part_program"} | PLANNER | LOGS | WORK),
        ("plan absent.ngc --machine mill --tolerance x", 2, PLANNER | LOGS | WORK),
        ("run absent.toml", 2, PLANNER | WORK - {"feeddrive.loop.gradient", "feeddrive.report.page"}),
        ("plan {part} --limits {limits} --sample-time 1 --out {out}", 0, LOGS | {"feeddrive.path.program.siemens"}),
    ],
)
def test_a_command_loads_what_it_uses(tmp_path: Path, words: str, code: int, without: set[str]) -> None:
    """A tenth of a second is some 100 modules: what a command does not need is imported by what needs it."""
    part, limits = tmp_path / "part.ngc", tmp_path / "limits.toml"
    part.write_text("G21 G90 F1000\nG1 X1\nM2\n", encoding="utf-8")
    keys = "velocity = 0.5\nacceleration = 5\njerk = 100\nsnap = 5e4\n"
    limits.write_text("".join(f"[axis.{axis}.limits]\n{keys}" for axis in "xyz"), encoding="utf-8")
    given = words.format(part=part, limits=limits, out=tmp_path / "out").split()
    found = loaded_by(
        f"sys.argv[1:] = {given!r}\nfrom feeddrive.cli import main\nimport contextlib, io\n"
        f"with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):\n"
        f"    try: main()\n    except SystemExit as ended: code = ended.code\nassert code == {code}, code"
    )
    assert not {name for name in found for late in without | NEVER if name == late or name.startswith(f"{late}.")}


def test_channels_of_a_text_log_loads_pyarrow_alone(tmp_path: Path) -> None:
    """Its time is that of the imports, too; pandas alone took as long as all others."""
    rows = "".join(f"{k},{0.1 * k:.1f},{0.1 * k - 0.02:.2f}\n" for k in range(100))
    (tmp_path / "run.csv").write_text("t [ms],x_cmd_mm,x_fb_mm\n" + rows, encoding="utf-8")
    found = loaded_by(f"import feeddrive as fd; fd.workflow.channels({str(tmp_path / 'run.csv')!r})")
    assert "pyarrow" in found
    assert not HEAVY & found


def test_the_command_to_type_next_is_one_that_can_be_typed(tmp_path: Path) -> None:
    """Its words are parsed as those of a terminal, and the files that it names were written."""
    copied = tmp_path / "my axis.toml"
    copied.write_text((BUNDLED / "machines" / "linear_motor.toml").read_text(encoding="utf-8"), encoding="utf-8")
    bare = tmp_path / "bare.toml"
    whole = (BUNDLED / "machines" / "emps.toml").read_text(encoding="utf-8")
    without = re.sub(r"(?ms)^\[axis\.x\.control\.guard\]\n.*?(?=^\[)", "", whole)
    bare.write_text(without, encoding="utf-8")
    unguarded = load("certify").run(load("certify").build_request(source=str(bare)), Progress())
    assert unguarded.then.startswith("feeddrive adjust ")
    assert "put the limits of your machine" in unguarded.notes[-1]
    outcomes = [
        unguarded,
        load("certify").run(load("certify").build_request(source=str(copied)), Progress()),
        load("export").run(
            load("export").build_request(source=str(copied), target="c", out=tmp_path / "the export"), Progress()
        ),
    ]
    for outcome in outcomes:
        _, name, *words = shlex.split(outcome.then)
        group: Any = get_command(app)
        group.get_command(typer.Context(group), name).make_context(name, list(words))
        assert Path(words[0]).exists()
        assert str(outcome).endswith(f"Next: {outcome.then}")
        assert outcome.record()["next"] == outcome.then


def typed_next(outcome: Outcome[Any]) -> list[str]:
    """The words of the command to type next, of which the files exist and the options are known."""
    _, name, *words = shlex.split(outcome.then)
    group: Any = get_command(app)
    group.get_command(typer.Context(group), name).make_context(name, list(words))
    return [name, *words]


def test_excite_leads_to_the_response_and_plan_to_a_run_of_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("feeddrive.report.page.svg", lambda *_: "")  # pictures take the time
    excite, plan = load("excite"), load("plan")
    out = tmp_path / "sent"
    request = excite.build_request("linear_motor", band="20..60", amplitude=100.0, resolution=5.0, periods=2, out=out)
    command, *logs = typed_next(excite.run(request, Progress()))
    assert command == "frf"
    assert [Path(log).name for log in logs] == ["simulated_1.parquet", "simulated_2.parquet"]
    assert all(Path(log).exists() for log in logs)
    assert excite.run(replace(request, out=None), Progress()).then == ""
    part = tmp_path / "part.ngc"
    part.write_text("G21 G90 G1 X5 F2000\nG1 Y5\nM2\n", encoding="utf-8")
    given = {"program": part, "machine": "xy_table", "out": tmp_path / "plan"}
    words = typed_next(plan.run(plan.build_request(**given), Progress()))
    assert words == ["run", str(tmp_path / "plan" / "job.toml")]
    job = fd.read_job(words[1])
    assert job.program is not None
    assert job.program.file == part
    # a job has the sample time of the loops
    other = plan.build_request(**{**given, "sample_time": 1e-3, "out": tmp_path / "other"})
    assert plan.run(other, Progress()).then == ""
    assert not (tmp_path / "other" / "job.toml").exists()
