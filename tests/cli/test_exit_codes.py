"""The exit code of every judgment that a command passes on its own result, each provoked through the command line."""

from __future__ import annotations

import importlib
import io
import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

import feeddrive as fd
from feeddrive import cli
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.papers import claims as papers
from feeddrive.papers.claims import Claim, Experiment
from feeddrive.path import setpoints
from feeddrive.workflow.schemas import outcome_schema
from small_axis import MACHINE as SMALL
from workflow.test_travel_command import PLACES, machine_files

OUTCOME = Draft202012Validator(outcome_schema())
T = 1e-3  # s
MASS, COULOMB, VISCOUS = 140.0, 55.0, 310.0  # kg, N, N s/m


def table(name: str, heads: str, *columns: np.ndarray) -> None:
    np.savetxt(name, np.column_stack(columns), delimiter=",", fmt="%.10g", header=heads, comments="")


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and force of a rigid axis with Coulomb and viscous friction."""
    t = T * np.arange(8000)
    w, a = 2.0 * np.pi * np.array([0.5, 1.3]), np.array([0.08, 0.012])
    x, v, acceleration = (
        np.sum(a[:, None] * term, axis=0)
        for term in (
            np.sin(w[:, None] * t),
            w[:, None] * np.cos(w[:, None] * t),
            -(w[:, None] ** 2) * np.sin(w[:, None] * t),
        )
    )
    noise = np.random.default_rng(12).standard_normal(t.size)
    return t, x, MASS * acceleration + VISCOUS * v + COULOMB * np.sign(v) + 0.5 * noise


def log(force: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda _t, f: f, unit: str = "mm") -> list[str]:
    t, x, f = motion()
    table("motion.csv", "t_s,x,f", t, 1e3 * x, force(t, f))
    return ["identify", "motion.csv", "--position", f"x:{unit}", "--force", "f:N"]


def response(mode: float, last: float, noise: float = 0.0) -> None:
    """The response at the drive of two masses, 90 and 60 kg, with a mode in Hz; noise as a share."""
    f = np.geomspace(4.0, last, 240)
    s, rng = 2j * np.pi * f, np.random.default_rng(3)
    w = 2.0 * np.pi * mode
    k = w**2 * 90.0 * 60.0 / 150.0
    c = 2.0 * 0.03 * k / w
    G = (60.0 * s**2 + c * s + k) / (s**2 * (90.0 * 60.0 * s**2 + 150.0 * (c * s + k)))
    G = G * (1.0 + noise * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)))
    table("frf.csv", "f_Hz,re_motor[m/N],im_motor[m/N]", f, G.real, G.imag)


def speeds(*values: float, drift: float = 0.0) -> list[str]:
    """Runs of constant speeds in both directions, with a Stribeck curve; `drift` in N from run to run."""
    rng = np.random.default_rng(8)
    v = np.concatenate([np.full(300, each) for each in (*values, *(-each for each in values))])
    friction = np.sign(v) * (30.0 + 18.0 * np.exp(-np.abs(v) / 0.008)) + 150.0 * v
    f = friction + 0.4 * rng.standard_normal(v.size) + np.repeat(drift * rng.standard_normal(v.size // 300), 300)
    table("runs.csv", "t_s,v,f", T * np.arange(v.size), 1e3 * v, f)
    return ["friction", "runs.csv", "--velocity", "v:mm/s", "--force", "f:N"]


FAST = (0.02, 0.03, 0.05, 0.08, 0.12, 0.18)
ALL = (0.001, 0.002, 0.004, 0.007, 0.012, *FAST)


def turns(odd: float, even: float, way: str = "both") -> list[str]:
    """Slow runs over a pole pair of 32 mm: an order that turns with the direction and one that does not, in A."""
    rng = np.random.default_rng(5)
    x = np.concatenate([np.full(150, 0.0), np.linspace(0.0, 0.1, 4000), np.full(150, 0.1)])
    direction = np.ones(x.size)
    if way == "both":
        x, direction = np.concatenate([x, x[::-1]]), np.concatenate([direction, -direction])
    angle = 2.0 * np.pi * x / 0.032
    current = direction * (0.4 + odd * np.sin(3.0 * angle)) + even * np.sin(12.0 * angle + 0.4)
    table("slow.csv", "t_s,x,i", T * np.arange(x.size), 1e3 * x, current + 0.03 * rng.standard_normal(x.size))
    words = ["cogging", "slow.csv", "--position", "x:mm", "--current", "i:A", "--period", "32:mm"]
    return [*words, "--force-constant", "55"]


def shaken(noise: float, unit: str = "N") -> list[str]:
    """A mass of 20 kg shaken by noise, for a response from force to acceleration."""
    rng = np.random.default_rng(6)
    force = 300.0 * rng.standard_normal(6000)
    acceleration = force / 20.0 + noise * rng.standard_normal(force.size)
    table("shaken.csv", "t_s,f,a", T * np.arange(force.size), force, acceleration)
    words = ["frf", "shaken.csv", "--input", f"f:{unit}", "--output", "a:m/s2", "--method", "h1"]
    return [*words, "--reference", "none"]


MACHINE = """
sample_time_ms = 1.0
[axis.x.plant]
kind = "rigid"
mass = 90
[axis.x.encoder_load]
kind = "encoder"
resolution_um = 1
[axis.x.control]
force_limit = 2500
[axis.x.control.guard]
following_error_limit_mm = {bound}
[axis.x.control.law]
kind = "cascade_ppi"
Kv = {Kv}
Kp = {Kp}
Tn = 0.03
"""
JOB = """
machine = "machine.toml"
[reference]
kind = "snap_limited_move"
distance_mm = 5
velocity_mm_per_s = 50
acceleration_mm_per_s2 = 500
jerk_mm_per_s3 = 2e4
snap_mm_per_s4 = 1e6
"""


def machine(bound: float = 5.0, Kv: float = 30.0, Kp: float = 1.2e4) -> None:
    Path("machine.toml").write_text(MACHINE.format(bound=bound, Kv=Kv, Kp=Kp), encoding="utf-8")


def job(bound: float) -> list[str]:
    machine(bound)
    Path("job.toml").write_text(JOB, encoding="utf-8")
    return ["run", "job.toml"]


def changing() -> list[str]:
    """A log in whose last fifth a quarter of the mass has left the table: no value is sure to 2.5 %."""
    t = T * np.arange(8000)
    x = 0.03 * np.sin(0.5 * np.pi * t) + 0.005 * np.sin(8.0 * np.pi * t)
    v = np.gradient(x, T)
    f = MASS * np.where(t > 6.4, 0.75, 1.0) * np.gradient(v, T) + VISCOUS * v + COULOMB * np.sign(v)
    f += 8.0 * np.random.default_rng(1).standard_normal(t.size)
    table("motion.csv", "t_s,x,f", t, 1e3 * x, f)
    return ["identify", "motion.csv", "--position", "x:mm", "--force", "f:N"]


def lines(mode: float, last: float, noise: float, *words: str) -> list[str]:
    response(mode, last, noise)
    return ["identify", "frf.csv", "--motor", "motor", *words]


def exported(*, Kv: float = 30.0, Kp: float = 1.2e4) -> list[str]:
    machine(Kv=Kv, Kp=Kp)
    return ["export", "machine.toml", "--target", "c", "--out", "c"]


def undecided() -> list[str]:
    """A law with a root of the position error, which has no slope where it stands still."""
    folder = Path(__file__).parents[2] / "examples"
    machine()
    text = Path("machine.toml").read_text(encoding="utf-8")
    law = re.search(r'TWISTING = """(.*?)"""', (Path(__file__).parents[1] / "test_own_blocks.py").read_text(), re.S)
    assert law is not None
    own = law[1].partition("[law.control.law]")[2]
    Path("machine.toml").write_text(text.partition("[axis.x.control.law]")[0] + "[axis.x.control.law]" + own)
    return ["export", "machine.toml", "--target", "c", "--blocks", str(folder / "square_root_mode.py")]


def cut(depth: float) -> list[str]:
    """A mill with a cutter of two teeth, up milling of half of its diameter, the tool a mode at 922 Hz."""
    bundled = Path(fd.__file__).parent / "files/bundled/machines/xy_table.toml"
    added = """
[[couplings]]
kind = "milling_cut"
spindle_speed = 10000
[couplings.cutter]
kind = "helical_cutter"
teeth = 2
diameter_mm = 12
axial_depth_mm = 0.2
radial_depth_mm = 6
specific_energy = 6e8
radial_ratio = 0.3
"""
    Path("mill.toml").write_text(bundled.read_text(encoding="utf-8") + added, encoding="utf-8")
    words = ["lobes", "mill.toml", "--rigid", "--mode", "922:0.011:0.04:x", "--speeds", "9000:11000:2"]
    return [*words, "--depth", str(depth)]


def certificate(change: str) -> list[str]:
    """A certificate of the machine, whose confidence is changed."""
    machine()
    fd.workflow.certify("machine.toml", out="proven")
    text = Path("proven/certificate.json").read_text(encoding="utf-8")
    Path("proven/certificate.json").write_text(text.replace('"confidence": 0.95', change), encoding="utf-8")
    return ["check", "proven/certificate.json"]


def chain(axis: str) -> list[str]:
    """A certificate of the machine beside a machine file of that name."""
    certificate('"confidence": 0.95')
    return ["check", "proven/certificate.json", "--machine", axis]


def proof(*words: str, edited: bool = False) -> list[str]:
    if shutil.which("gcc") is None:
        pytest.skip("NOT TESTED: the proof of an export needs gcc: apt-get install gcc libc6-dev")
    machine()
    fd.workflow.export("machine.toml", target="c", out="c")
    if edited:
        Path("c/README.md").write_text("mine\n", encoding="utf-8")
    return ["verify", "c", "--samples", "300", *words]


def part(share: float = 0.0) -> list[str]:
    """A part program; the planner may use more of the limits than there is of them."""
    Path("part.ngc").write_text("G21 G90 G17\nG1 X7 Y0 F2500\nX7 Y5\nM2\n", encoding="utf-8")
    made = setpoints.planned

    def planned(moves, axes, limits, *rest):
        return made(moves, axes, limits * (1.0 + share), *rest)

    PATCH.setattr(setpoints, "planned", planned)
    return ["plan", "part.ngc", "--machine", "xy_table"]


def claimed(got: float) -> list[str]:
    """A paper with one claim that holds up to 1."""

    def run(paper: str, progress: Progress) -> Experiment:
        progress.step("the only run")
        return Experiment(paper, "A paper", "Someone 1999", [Claim("1", "it is small", "alone", got, most=1.0)])

    PATCH.setattr(papers, "run", run)
    return ["reproduce", "wu2017"]


def study(values: str, bounds: str = "sensitivity_peak = { most = 2 }", of: str = "job.toml") -> None:
    job(5.0)
    vary = f'[[vary]]\nparameter = "axis.x.actuator.dead_time"\nvalues_us = [{values}]\n'
    text = f'job = "{of}"\nsampler = "grid"\n[specification]\n{bounds}\n{vary}'
    Path("study.toml").write_text(text, encoding="utf-8")


def swept(values: str) -> list[str]:
    study(values)
    return ["sweep", "study.toml", "--workers", "1"]


def robust() -> list[str]:
    """Today's crossover is 70.3 Hz; with Ms up to 3 the new one is 73.4 Hz, beyond a bound that is only counted."""
    study("40, 50", "sensitivity_peak = { most = 3 }\ncrossover_Hz = { most = 72 }", "ball_screw")
    return ["tune", "--study", "study.toml", "--filters", "kept", "--starts", "1", "--fresh", "16"]


def tuned(recipe: str, source: str = "machine.toml", **gains: float) -> list[str]:
    machine(bound=50.0, **gains)
    return ["tune", source, "--recipe", recipe]


def traveled(rounds: int | None = None) -> list[str]:
    """A schedule over the travel of a long screw; without rounds no place gives way to the positions between."""
    if rounds is not None:
        PATCH.setattr("feeddrive.tuning.travel._ROUNDS", rounds)
    files = machine_files(Path())
    positions = [word for x in PLACES for word in ("--position", str(1000.0 * x))]
    return ["travel", *files, *positions, "--starts", "1", "--between", "1"]


def along(most: str) -> list[str]:
    """The P-PI of a long screw as it is, proven at every position or not."""
    files = machine_files(Path())
    positions = [word for x in PLACES for word in ("--position", str(1000.0 * x))]
    return ["travel", *files, *positions, "--kept", "--certify", "proof.json", "--frozen", "--prove-ms", most]


def along_undecided() -> list[str]:
    """A bound that needs short cells, and no cell may be halved."""
    PATCH.setattr("feeddrive.certificate.travel_proof._PARTS", 1)
    PATCH.setattr("feeddrive.certificate.travel_proof._NARROW", 2.0)
    return along("1.5")


def compared(starts: int, *, today: bool = False) -> list[str]:
    """P-PI against today's gains, which keep their place alone if its snap is made the larger one."""
    machine(bound=50.0)
    if today:
        module = importlib.import_module("feeddrive.workflow.compare")
        made = module.compare_laws

        def compare_laws(*args, **options):
            found = made(*args, **options)
            key = "rope_snap_ISE_root_m_per_N"
            worse = [
                each if each.name == "today's gains" else replace(each, figures={**each.figures, key: 1.0})
                for each in found.competitors
            ]
            return replace(found, competitors=tuple(worse))

        PATCH.setattr(module, "compare_laws", compare_laws)
    return ["compare", "machine.toml", "--law", "P-PI", "--starts", str(starts)]


def scored(*words: str, without: str = "") -> list[str]:
    """The benchmark on one plant; the rows of laws whose name holds `without` lose their place."""
    module = importlib.import_module("feeddrive.workflow.benchmark")
    made = module.score

    def score(*args, **options):
        found = made(*args, **options)
        rows = [replace(each, unplaced="no place") if without and without in each.name else each for each in found.rows]
        return replace(found, rows=tuple(rows))

    PATCH.setattr(module, "score", score)
    return ["benchmark", "--rules", "1", "--plant", "rotary_table", *words]


def commissioned(force: float) -> list[str]:
    """A virtual drive; a force limit of 20 N does not overcome the friction of the axis, 40 N."""
    Path("small.toml").write_text(SMALL.replace("force_limit_N = 1500", f"force_limit_N = {force}"))
    return ["commission", "--virtual", "small.toml", "--yes"]


def corrected(*words: str) -> list[str]:
    return ["setpath", "circle", "--method", "force", *words]


def learned() -> list[str]:
    fd.workflow.run("circle", out="ran")
    return corrected("--from-log", "ran/runs/today.parquet")


def box_of(most: str, box: str = "standard") -> list[str]:
    """The P-PI of the linear motor: its Ms is 1.42303 at the model, and 2.0 at the worst plant of the standard box."""
    return ["certify", "linear_motor", "--box", box, "--max-ms", most]


NO_BOX = "mass=0,friction=0,stiffness=0,dead_time=0"
# a machine with a hundredth of the friction gets a hundred times too much of it: no share is safe
SMOOTH = "mass=0,friction=0.99,stiffness=0,dead_time=0"


def no_loop() -> list[str]:
    """An installation on which no loop can be simulated."""

    def fails(*_: object) -> None:
        raise OSError("no memory for machine code")

    PATCH.setattr(sys.modules["feeddrive.loop.simulate"], "simulate", fails)
    return ["doctor"]


QUICK: dict[Judgment, Callable[[], list[str]]] = {
    Judgment.DO_NOT_TUNE: lambda: log(lambda t, f: f + 70.0 * np.sin(19.0 * t)),
    Judgment.UNITS_IN_DOUBT: lambda: shaken(1.0, unit="mN"),
    Judgment.SCALES_IN_DOUBT: lambda: [*log(), "--mass", str(0.95 * MASS)],
    Judgment.INCOHERENT: lambda: shaken(60.0),
    Judgment.CURVE_IS_OPEN: lambda: speeds(*FAST),
    Judgment.NEAR_UNSTABLE: lambda: exported(Kv=100.0, Kp=1e5),
    Judgment.NOT_PROVEN: lambda: certificate('"confidence": 0.97'),
    Judgment.TRAVEL_NOT_PROVEN: lambda: along("1.05"),
    Judgment.TRAVEL_UNDECIDED: along_undecided,
    Judgment.BOX_PROVEN: lambda: box_of("2.3"),
    Judgment.BOX_NOT_PROVEN: lambda: box_of("1.9"),
    Judgment.BOX_UNDECIDED: lambda: box_of("1.42312", "dead_time=0samples"),
    Judgment.NOT_TOGETHER: lambda: chain("emps"),
    Judgment.NOT_COMMISSIONED: lambda: commissioned(20.0),
    Judgment.CLAIM_FAILS: lambda: claimed(1.2),
    Judgment.WORKS: lambda: ["doctor"],
    Judgment.DOES_NOT_WORK: no_loop,
    Judgment.DONE: lambda: ["force", "V", "--column", "u", "--at-full", "30:Nm"],
}
SLOW: dict[Judgment, Callable[[], list[str]]] = {
    Judgment.USE_VALUES: log,
    Judgment.DO_NOT_TRUST: changing,
    Judgment.USE_MODEL: lambda: lines(60.0, 400.0, 0.0),
    Judgment.DO_NOT_USE_MODEL: lambda: lines(60.0, 400.0, 1.5),
    Judgment.MODEL_IS_OPEN: lambda: lines(60.0, 20.0, 0.01, "--model", "two-mass"),
    Judgment.TAKE_CURVE: lambda: speeds(*ALL),
    Judgment.DO_NOT_USE_CURVE: lambda: speeds(*ALL, drift=60.0),
    Judgment.TAKE_COGGING: lambda: turns(0.0, 0.3),
    Judgment.NO_COGGING: lambda: turns(0.3, 0.0),
    Judgment.COGGING_IS_OPEN: lambda: turns(0.0, 0.3, "forward"),
    Judgment.TAKE_TUNING: lambda: tuned("kv-rule"),
    Judgment.LEAVE_CONTROL: lambda: tuned("margins-robust", "ball_screw"),
    Judgment.DO_NOT_USE_TUNING: lambda: tuned("kv-rule", Kv=100.0, Kp=1e5),
    Judgment.FEWER_ARE_GOOD: robust,
    Judgment.TAKE_SCHEDULE: traveled,
    Judgment.DO_NOT_USE_SCHEDULE: lambda: traveled(0),
    Judgment.TRAVEL_PROVEN: lambda: along("3"),
    Judgment.CORRECTED: lambda: corrected("--box", NO_BOX),
    Judgment.NOT_CORRECTED: lambda: corrected("--box", SMOOTH),
    Judgment.LEARNED: learned,
    Judgment.RANKED: lambda: compared(2),
    Judgment.KEEP_GAINS: lambda: compared(2, today=True),
    Judgment.NONE_RANKED: lambda: compared(1),
    Judgment.SCORED: lambda: scored("--law", "P-PI"),
    Judgment.NO_PLACE: lambda: scored("--law", "LADRC", without="LADRC"),
    Judgment.NONE_PLACED: lambda: scored("--law", "P-PI", without="P-PI"),
    Judgment.PLANNED: part,
    Judgment.NOT_PLANNED: lambda: part(1e-6),
    Judgment.RAN: lambda: job(5.0),
    Judgment.TRIPPED: lambda: job(1e-6),
    Judgment.SWEPT: lambda: swept("500, 1000"),
    Judgment.NO_FIGURES: lambda: swept("50000, 60000"),
    Judgment.STABLE_CUT: lambda: cut(0.1),
    Judgment.CHATTERS: lambda: cut(0.3),
    Judgment.EXPORTED: exported,
    Judgment.NOT_DECIDED: undecided,
    Judgment.PROVEN: lambda: certificate('"confidence": 0.95'),
    Judgment.TOGETHER: lambda: chain("machine.toml"),
    Judgment.EQUAL: proof,
    Judgment.NOT_EQUAL: lambda: proof("--flag", "-fsingle-precision-constant"),
    Judgment.CHANGED: lambda: proof(edited=True),
    Judgment.COMMISSIONED: lambda: commissioned(1500.0),
    Judgment.CLAIMS_HOLD: lambda: claimed(0.8),
}
# what a good result says by its figures, and no sentence
SILENT = {
    Judgment.DONE,
    Judgment.TAKE_TUNING,
    Judgment.PLANNED,
    Judgment.RAN,
    Judgment.SWEPT,
    Judgment.EXPORTED,
    Judgment.CLAIMS_HOLD,
}
PATCH: pytest.MonkeyPatch


@pytest.fixture
def streams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `feeddrive` in an empty folder: exit code, standard output and error stream."""
    global PATCH
    PATCH = monkeypatch
    monkeypatch.chdir(tmp_path)

    def asked(words: list[str]) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return asked


@pytest.fixture
def call(streams):
    """Runs `feeddrive` in an empty folder: exit code and all that it says."""

    def asked(words: list[str]) -> tuple[int, str]:
        code, out, errors = streams(words)
        return code, out + errors

    return asked


def check(call, judgment: Judgment, words: list[str]) -> None:
    code, said = call(words)
    assert code == judgment.exit_code, said
    assert "error:" not in said
    assert judgment in SILENT or judgment.says in said, said


@pytest.mark.parametrize("judgment", QUICK, ids=lambda each: each.name)
def test_a_judgment_ends_with_its_code(call, judgment: Judgment) -> None:
    check(call, judgment, QUICK[judgment]())


@pytest.mark.slow(reason="the other judgments, 0.5 to 30 s each; one of each kind stays quick")
@pytest.mark.parametrize("judgment", SLOW, ids=lambda each: each.name)
def test_every_judgment_ends_with_its_code(call, judgment: Judgment) -> None:
    check(call, judgment, SLOW[judgment]())


@pytest.mark.slow(reason="the other commands that doubt units")
@pytest.mark.parametrize("command", ["identify", "friction", "cogging"])
def test_units_in_doubt_are_bad_in_every_command(call, command: str) -> None:
    words = {
        "identify": lambda: log(unit="m"),
        "friction": lambda: [each.replace("v:mm/s", "v:m/s") for each in speeds(*ALL)],
        "cogging": lambda: [each.replace("x:mm", "x:m") for each in turns(0.0, 0.3)],
    }[command]()
    check(call, Judgment.UNITS_IN_DOUBT, words)


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def record(streams, words: list[str]) -> dict[str, Any]:
    """The JSON object of a command, which must be all that stands on the standard output."""
    code, out, _ = streams([*words, "--json"])
    found = json.loads(out, parse_constant=refuse)
    assert "\\ue00" not in out, "a mark is left in a text"
    assert (found["command"], found["exit_code"]) == (words[0], code)
    OUTCOME.validate(found)
    if isinstance(found.get("tables"), list):
        for table in (*found["tables"], *found["details"]["tables"]):
            assert all(len(row) == len(table["columns"]) for row in table["rows"])
    return found


def commands() -> dict[str, Callable[[], list[str]]]:
    """A call of each command that needs neither a drive nor a browser."""

    def circles() -> list[str]:
        phase = np.linspace(0.0, 4.4 * np.pi, 6000)
        table("circle.csv", "t_s,x,y", T * np.arange(phase.size), 20.0 * np.cos(phase), 20.0 * np.sin(phase))
        return ["circle", "circle.csv", "--x", "x:mm", "--y", "y:mm"]

    def channels() -> list[str]:
        log()
        return ["channels", "motion.csv"]

    def of_machine(*words: str) -> list[str]:
        machine()
        return [words[0], "machine.toml", *words[1:]]

    return {
        "channels": channels,
        "circle": circles,
        "identify": log,
        "frf": lambda: shaken(1.0),
        "friction": lambda: speeds(*ALL),
        "cogging": lambda: turns(0.0, 0.3),
        "tune": lambda: tuned("kv-rule"),
        "travel": traveled,
        "run": lambda: job(5.0),
        "plan": part,
        "lobes": lambda: cut(0.3),
        "force": QUICK[Judgment.DONE],
        "certify": lambda: of_machine("certify"),
        "check": lambda: certificate('"confidence": 0.95'),
        "adjust": lambda: of_machine("adjust", "--set", "law.Kv=31"),
        "export": exported,
        "setpath": lambda: of_machine("setpath"),
        "sweep": lambda: swept("500, 1000"),
        "excite": lambda: ["excite", "ball_screw", "--band", "5..200", "--amplitude", "300"],
        "reproduce": lambda: claimed(0.8),
        "compare": lambda: compared(1),
        "tour": lambda: ["tour"],
    }


@pytest.mark.parametrize("command", ["channels", "circle", "force", "adjust", "frf", "check", "reproduce"])
def test_a_command_prints_json(streams, command: str) -> None:
    found = record(streams, commands()[command]())
    assert found["tables"] or found["texts"] or found["verdict"]
    assert found["error"] is None


@pytest.mark.slow(reason="the other commands, up to 30 s each")
@pytest.mark.parametrize(
    "command",
    [
        "identify",
        "friction",
        "cogging",
        "tune",
        "travel",
        "run",
        "plan",
        "lobes",
        "certify",
        "export",
        "setpath",
        "sweep",
        "excite",
        "compare",
        "tour",
    ],
)
def test_every_command_prints_json(streams, command: str) -> None:
    found = record(streams, commands()[command]())
    assert found["tables"] or found["verdict"] or found["files"]


def test_json_has_numbers_in_si_with_their_errors(streams) -> None:
    found = record(streams, ["force", "percent", "--column", "trq", "--rated", "3.2:Nm", "--lead", "0.01"])
    factor = 0.032 * 2.0 * np.pi / 0.01
    assert found["tables"][0]["rows"][-1][1] == {"value": pytest.approx(factor), "unit": "N"}
    assert found["judgment"] == "done"


def test_a_bad_judgment_and_an_error_are_json_with_the_same_code(streams) -> None:
    found = record(streams, QUICK[Judgment.INCOHERENT]())
    assert (found["judgment"], found["exit_code"]) == ("incoherent", 1)
    code, out, errors = streams(["check", "nothing.json", "--json"])
    found = json.loads(out)
    OUTCOME.validate(found)
    assert found == {
        "command": "check",
        "exit_code": 2,
        "error": {"kind": "FileError", "message": "nothing.json: no such file"},
    }
    assert (code, errors) == (2, "feeddrive: error: nothing.json: no such file\n")
    code, out, errors = streams(["check", "--nothing", "--json"])
    assert (code, json.loads(out)["exit_code"]) == (2, 2)
    assert "--nothing" in errors


def test_progress_and_questions_do_not_disturb_json(streams, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log whose columns are guessed, which is told meanwhile; and a motion that is not confirmed."""
    log()
    code, out, errors = streams(["identify", "motion.csv", "--unit", "mm", "--json"])
    assert json.loads(out)["exit_code"] == code
    assert "These roles are guessed" in errors
    module = importlib.import_module("feeddrive.workflow.force")

    def asks(request: Any, progress: Progress) -> Any:
        progress.confirm("Is the travel clear?")

    monkeypatch.setattr(module.force, "work", asks)
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    code, out, errors = streams([*QUICK[Judgment.DONE](), "--json"])
    assert (code, json.loads(out)["exit_code"]) == (1, 1)
    assert "Is the travel clear?" in errors


def test_every_judgment_is_provoked() -> None:
    assert {*QUICK, *SLOW} == {*Judgment}
    assert not {*QUICK} & {*SLOW}


def test_the_table_of_the_docs_is_that_of_the_code() -> None:
    page = (Path(__file__).parents[2] / "docs/reference/files.md").read_text(encoding="utf-8")
    page = page.partition("| command | judgment | code |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \| (\d) \|$", page, re.MULTILINE)
    assert rows == [(each.commands, each.says, str(each.exit_code)) for each in Judgment]


def test_a_certificate_that_is_not_there_is_a_wrong_path(call) -> None:
    code, said = call(["check", "nothing.json"])
    assert code == 2
    assert said == "feeddrive: error: nothing.json: no such file\n"
