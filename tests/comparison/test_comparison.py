"""The comparison of laws: today first, the rule kept, places by figures, and a report that shows who loses where."""

from __future__ import annotations

import csv
import io
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from feeddrive.analysis.stability import stability
from feeddrive.blocks.catalogue import imported
from feeddrive.blocks.compensation.machine_mode import MachineMode
from feeddrive.blocks.compensation.mode_compensation import ModeCompensation
from feeddrive.blocks.families import Law
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.cli.terminal import show
from feeddrive.comparison.compare import TODAY, Comparison, advice, compare_laws
from feeddrive.comparison.report import figures_csv, write_comparison
from feeddrive.evaluation.duty import duty_of
from feeddrive.evaluation.engine import Engine
from feeddrive.evaluation.lineup import FIXED, Lineup
from feeddrive.evaluation.store import Folder
from feeddrive.figures.figure import Figure
from feeddrive.figures.ranking import CRITERIA, ranks
from feeddrive.files.machine import MachineFile, read_machine
from feeddrive.language import tree
from feeddrive.language.errors import CancelledError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Refusal, candidates
from feeddrive.workflow.compare import in_short

SHORT = SnapLimitedMove(
    distance=0.02, velocity=0.2, acceleration=5.0, jerk=400.0, snap=4e4, back=True, dwell_before=0.5, dwell_after=0.2
)

QUICK = ("P-PI + compensator", "DADSC", "pole placement", "pole placement + prefilter")


def same(a: Loop, b: Loop) -> bool:
    """The same blocks with the same numbers, to the bit."""
    return tree.structure(a) == tree.structure(b) and list(tree.leaves(a)) == list(tree.leaves(b))


def with_law(machine: MachineFile, **values: float) -> MachineFile:
    loop = tree.vary(machine.loop("x"), {f"axis.x.control.law.{name}": value for name, value in values.items()})
    return replace(machine, loops={"x": loop})


@pytest.fixture(scope="module")
def found() -> Comparison:
    """The linear motor, whose figures at equal robustness are known; one search a law, and the quick ones only."""
    return compare_laws(read_machine("linear_motor"), reference=SHORT, starts=1, laws=QUICK)


def test_today_comes_first_and_is_left_as_it_is(found: Comparison) -> None:
    first = found.competitors[0]
    assert first.name == TODAY
    assert same(first.loop, read_machine("linear_motor").loop("x"))
    assert first.tuned is None


def test_all_others_keep_the_rule_and_prove_it(found: Comparison) -> None:
    assert len(found.competitors) == 4
    for each in found.competitors[1:]:
        assert each.tuned is not None
        assert each.figures["sensitivity_peak"] <= 2.0005, each.name
        assert each.figures["delay_margin_samples"] >= 1.999, each.name
        assert each.figures["noise_gain_N_per_m"] <= 1.0505 * found[PLAIN].figures["noise_gain_N_per_m"], each.name
        assert each.held_by == ("force noise" if each.name == "DADSC" else "Ms"), each.name
        assert all(line.holds for line in each.tuned.proof), (each.name, each.tuned.proof)


def test_dadsc_loses_to_the_cascade_at_equal_robustness_and_the_report_says_so(found: Comparison) -> None:
    """0.90 against 1.43 nm √s/N: both are PIDs, and the cascade has the better zeros.

    With Ms and delay margin alone DADSC has 1.04 and a fifth more noise; the bound takes its gains back to Ms 1.79.
    """
    cascade, dadsc = (found[name].figures["rope_snap_ISE_root_m_per_N"] for name in (PLAIN, "DADSC"))
    assert 1e9 * cascade == pytest.approx(0.90, abs=0.005)
    assert 1e9 * dadsc == pytest.approx(1.43, abs=0.01)
    said = next(remark for remark in found.remarks if remark.startswith("'DADSC' loses"))
    assert "rope snap ISE" in said.partition("; wins")[0]


def test_the_friction_compensator_changes_tracking_and_nothing_else(found: Comparison) -> None:
    plain, other = found[PLAIN], found["P-PI + compensator"]
    for criterion in CRITERIA:
        if not criterion.key.startswith("tracking") and criterion.key != "operations":
            assert other.figures[criterion.key] == pytest.approx(plain.figures[criterion.key], rel=1e-9), criterion.key
    assert other.figures["tracking_error_rms_m"] < plain.figures["tracking_error_rms_m"]


def test_laws_that_do_not_fit_are_named_with_the_reason(found: Comparison) -> None:
    assert {each.name for each in found.refusals} == {"pole placement", "pole placement + prefilter"}
    assert all("encoder" in each.reason for each in found.refusals)


def test_the_screen_has_the_reason_of_a_refusal_in_one_sentence(found: Comparison) -> None:
    """It had the names only: "Cannot control this axis: super twisting.\""""
    law = (
        "there is no linear model at this operating point: a square root of 0 has no finite slope (twisting, law.py, "
        "line 49: force = 1. / self.gain * ops.sqrt(s))"
    )
    more = Refusal("twisting", f"{law}. Poles, margins, tuning by them and certificates need one; simulation does not")
    said = [each for each in in_short(replace(found, refusals=(*found.refusals, more))) if each.startswith("Cannot")]
    both = "pole placement, pole placement + prefilter"
    assert said[0].startswith(f"Cannot control this axis: {both}: pole placement needs the position of the motor and ")
    assert said[1:] == [f"Cannot control this axis: twisting: {law}."]


@pytest.mark.pictures
def test_the_directory_holds_what_it_promises(found: Comparison, tmp_path: Path) -> None:
    report = write_comparison(found, tmp_path / "out")
    page = report.read_text(encoding="utf-8")
    assert report.stat().st_size < 1_000_000
    for text in (
        found.rule.replace("<=", "&lt;=").replace("'", "&#39;"),
        "loses to P-PI",
        "Laws that cannot control this axis",
    ):
        assert text in page
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert next(iter(summary["laws"])) == TODAY
    rows = list(csv.DictReader((tmp_path / "out" / "figures.csv").read_text(encoding="utf-8").splitlines()))
    for row, each in zip(rows, found.competitors, strict=True):
        assert row["law"] == each.name
        assert float(row["force_noise_N"]) == each.figures["force_noise_N"]
    # a tuned control, put into the machine file in place of today's, is read back to the same bits
    given = (tmp_path / "out" / "machine.toml").read_text(encoding="utf-8")
    physics = given.partition("[axis.x.control]")[0]
    tuned = (tmp_path / "out" / "controls" / "p_pi.toml").read_text(encoding="utf-8")
    (tmp_path / "tuned.toml").write_text(physics + tuned, encoding="utf-8")
    assert same(read_machine(tmp_path / "tuned.toml").loop("x"), found[PLAIN].loop)


def test_unstable_gains_are_a_first_row_that_says_so(tmp_path: Path) -> None:
    machine = with_law(read_machine("linear_motor"), Kp=1e6)
    assert not stability(machine.loop("x")).stable
    found = compare_laws(machine, reference=SHORT, starts=1, laws=())
    first = found.competitors[0]
    assert first.kind == "unfit"
    assert "unstable" in first.reason
    assert "tracking_error_rms_m" not in first.figures
    assert "unstable" in found.remarks[0]
    assert all(found.places(criterion)[0] is None for criterion in CRITERIA)
    assert found[PLAIN].figures["rope_snap_ISE_root_m_per_N"] == pytest.approx(0.9e-9, rel=0.03)
    assert "unstable" in write_comparison(found, tmp_path / "out").read_text(encoding="utf-8")


def test_a_law_that_nobody_knows_is_refused() -> None:
    with pytest.raises(ParameterError, match="law 'PID' is not known here; there are: P-PI"):
        compare_laws(read_machine("linear_motor"), laws=["PID"])


def test_a_law_is_named_by_its_kind_too() -> None:
    loop = read_machine("linear_motor").loop(None)
    lineup = Lineup.of(loop)
    chosen = lineup.only(lineup.names(["active_disturbance_rejection", "pole_placement"]))
    assert {row.name for row in chosen.possible} == {
        PLAIN,
        *(f"GPI, {n} Taylor state{'s' * (n > 1)}" for n in (5, 3, 1)),
    }
    assert [row.name for row in chosen.refused] == ["pole placement"]
    assert lineup.fitting("cascade_ppi") == lineup.fitting(PLAIN) == PLAIN
    with pytest.raises(ParameterError, match="'pole placement' cannot control this axis: pole placement needs"):
        lineup.fitting("pole_placement")
    with pytest.raises(ParameterError, match="linuxcnc_pid has no start values"):
        lineup.fitting("linuxcnc_pid")


def test_processes_side_by_side_give_the_same(found: Comparison) -> None:
    again = compare_laws(read_machine("linear_motor"), reference=SHORT, starts=1, laws=["DADSC"], engine=Engine(2))
    assert again["DADSC"].tuned is not None
    assert found["DADSC"].tuned is not None
    assert again["DADSC"].tuned.tunables == pytest.approx(found["DADSC"].tuned.tunables, rel=1e-9)


def test_places() -> None:
    rows: list[dict[str, float | None]] = [{"a": 1.0}, {"a": 1.001}, {"a": 2.0}, {"a": None}, {"a": np.inf}, {}]
    assert ranks(Figure("a", "a", "", "model", len), rows) == [1, 1, 3, None, 4, None]
    assert ranks(Figure("a", "a", "", "model", len, "higher"), rows) == [3, 3, 2, None, 1, None]


def test_the_work_follows_the_limits_of_the_machine() -> None:
    """On the ball screw it is the move of Gordon & Erkorkmaz: 300 mm, 1 m/s, 10 m/s², 800 m/s³, 8e4 m/s⁴."""
    move = duty_of(read_machine("ball_screw").loop("x")).move
    assert isinstance(move, SnapLimitedMove)
    assert (move.distance, *move.limits()) == (0.3, 1.0, 10.0, 800.0, 8e4)
    # an axis whose dry friction is large is pulled harder, so that it moves
    assert duty_of(read_machine("emps").loop("x")).force == pytest.approx(100.0, rel=0.02)
    with pytest.raises(ParameterError, match="force > 0"):
        duty_of(read_machine("emps").loop("x"), force=-1.0)


def test_the_pictures_are_drawn(found: Comparison) -> None:
    from feeddrive.comparison.report import contents
    from feeddrive.plot.drawing import drawn

    pictures = {shown.key: drawn(shown.chart()) for shown in contents(found).pictures}
    assert found.plot().axes
    assert len(pictures["recovery"].axes) == 2
    for figure in pictures.values():  # private-use characters are the marks of quantities, which no reader may see
        texts = [each.get_text() for each in figure.findobj(lambda each: hasattr(each, "get_text"))]
        assert texts
        assert not [text for text in texts if any("\ue000" <= letter <= "\uf8ff" for letter in text)]
    assert "P-PI" in str(found)
    assert found.to_pandas().shape[0] == len(found.competitors)
    assert found.ranking().rows[0][0] == TODAY


def test_a_comparison_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    """Stopped after P-PI, which is then not searched again; the end is that of one never stopped, to the bit."""

    class Stopping(Progress):
        def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
            told.append((what, done, of))
            if what.startswith("DADSC") and not whole:
                self.cancel()

    told: list[tuple[str, int | None, int | None]] = []
    whole = False
    asked = {"laws": ["DADSC"], "reference": SHORT, "starts": 1, "engine": Engine(store=Folder(tmp_path / "kept"))}
    with pytest.raises(CancelledError):
        compare_laws(read_machine("linear_motor"), progress=Stopping(), **asked)
    (path,) = (tmp_path / "kept").iterdir()
    assert path.name.startswith("p_pi-")
    whole = True
    told.clear()
    again = compare_laws(read_machine("linear_motor"), progress=Stopping(), **asked)
    assert next(what for what, _, _ in told if what.startswith("P-PI: ")) == "P-PI: as it was kept"
    # the bar moves within a law, never back, and to its end
    parts = [done / of for _, done, of in told if done is not None and of]
    assert len(parts) > 8
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    never = compare_laws(read_machine("linear_motor"), laws=["DADSC"], reference=SHORT, starts=1)
    assert [each.figures for each in again.competitors] == [each.figures for each in never.competitors]
    assert again.remarks == never.remarks
    # what somebody has changed, or what was kept of other work, is not taken
    kept = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(kept | {"digest": "of something else"}), encoding="utf-8")
    told.clear()
    compare_laws(read_machine("linear_motor"), progress=Stopping(), **(asked | {"laws": []}))
    assert "P-PI: as it was kept" not in [what for what, _, _ in told]


OWN = '''
from typing import NamedTuple
from feeddrive.blocks.families import Law
from feeddrive.language import ops
from feeddrive.language.block import parameter


class HandWheel(Law):
    """Position feedback against a differenced velocity, with an integral."""

    Kv: float = parameter("1/s", "position gain", above=0)
    Kp: float = parameter("N s/m", "velocity gain", above=0)
    Ki: float = parameter("N/(m s)", "integral gain", above=0)

    class State(NamedTuple):
        position: float
        integral: float

    def start(self, prepared, setpoint, reading):
        return self.State(reading.position_load, reading.applied)

    def step(self, prepared, state, setpoint, reading, T):
        error = setpoint.position - reading.position_load
        velocity = (reading.position_load - state.position) / T
        integral = state.integral + self.Ki * T * error
        return self.State(reading.position_load, integral), self.Kp * (self.Kv * error - velocity) + integral


class Spring(Law):
    """A spring and a damper that are chosen: nothing is left to tune."""

    stiffness: float = parameter("N/m", "force per following error", above=0, default=4e5)
    damping: float = parameter("N s/m", "force per velocity", above=0, default=4e3)

    def start(self, prepared, setpoint, reading):
        return reading.position_load

    def step(self, prepared, state, setpoint, reading, T):
        velocity = (reading.position_load - state) / T
        error = setpoint.position - reading.position_load
        return reading.position_load, self.stiffness * error - self.damping * velocity


class Rooted(Law):
    """The root of the following error: it has no slope where the error is 0, and nothing to tune."""

    stiffness: float = parameter("N/m", "force per following error", above=0, default=4e5)

    def start(self, prepared, setpoint, reading):
        return reading.position_load

    def step(self, prepared, state, setpoint, reading, T):
        error = setpoint.position - reading.position_load
        return reading.position_load, self.stiffness * error - ops.sqrt(ops.absolute(error))
'''


def test_a_law_of_ones_own_by_package_and_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code is run that the command line names, and what is no law is refused with what it lacks."""
    (tmp_path / "my_own_laws.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    law = imported(Law, "my_own_laws:HandWheel")
    spring, rooted = imported(Law, "my_own_laws:Spring"), imported(Law, "my_own_laws:Rooted")
    found = compare_laws(read_machine("linear_motor"), laws=[law, spring, rooted], reference=SHORT, starts=1)
    assert [each.name for each in found.competitors] == [TODAY, PLAIN, "hand wheel", "spring"]
    assert found["hand wheel"].figures["noise_gain_N_per_m"] is not None
    left = found["spring"]  # ended the whole comparison: no tunables
    assert left.tuned is None
    assert left.figures["noise_gain_N_per_m"] is not None
    assert FIXED in left.remark
    assert "Nothing to tune, so judged as it is: spring." in in_short(found)
    reasons = {refusal.name: refusal.reason for refusal in found.refusals}  # an error of one law ended all the others
    assert "a square root of 0 has no finite slope" in reasons["rooted"]
    write_comparison(found, tmp_path / "report")
    for place, why in (
        ("my_own_laws:Nothing", "there is no class 'Nothing'"),
        ("no_such_package:Law", "cannot be imported"),
        ("pathlib:Path", "must derive from Law"),
        ("feeddrive.blocks.families:Law", "it lacks start, step"),
    ):
        with pytest.raises(ParameterError, match=why):
            imported(Law, place)


def test_the_cascade_keeps_the_rates_of_the_machine() -> None:
    """Both loops of a controller with a slower position loop; it was compared as one whose loops are both fast."""
    loop = read_machine("linear_motor").loop("x")
    law = replace(loop.control.law, position_every=8)
    slow = replace(loop, control=replace(loop.control, law=law))
    made = {each.name: each for each in candidates(slow)[0]}
    assert made[PLAIN].loop.control.law.position_every == 8
    assert made["P-PI + recovery"].loop.control.law.position_every == 8
    assert made["DADSC"].loop.control.law.period() == 1
    assert "every sample" not in made[PLAIN].remark


def test_what_is_tried_beside_a_law() -> None:
    """Recovery in four forms, the compensator as told and as learned; modes only where the machine file has one."""
    loop = read_machine("linear_motor").loop("x")
    made, refused = candidates(loop)
    names = {each.name for each in made}
    forms = ("recovery", "DOB", "Kalman recovery", "GPI recovery", "compensator", "learned compensator")
    assert {f"P-PI + {form}" for form in forms} <= names
    assert {name for name in names if name.startswith("P-P ")} == {"P-P + DOB"}  # which integrates for it
    assert "P-P" not in names
    assert {"GPI, 1 Taylor state", "GPI, 3 Taylor states", "GPI, 5 Taylor states"} <= names
    assert "states no mode" in {each.name: each.reason for each in refused}["P-PI + mode compensation"]
    mode = MachineMode(frequency=30.0, stiffness=2e7)
    observer = DisturbanceRecovery(mass=40.0, viscous=60.0, frequency=50.0, delay_samples=2)
    control = replace(loop.control, compensation=(ModeCompensation(modes=(mode,), observer=observer),))
    found = {each.name: each for each in candidates(replace(loop, control=control))[0]}
    row = found["P-PI + mode compensation"]
    assert row.loop.control.compensation[0].modes == (mode,)
    assert row.like == PLAIN  # tuned for the table it would be tuned away


def test_the_learned_compensator_learns_the_friction_of_the_axis() -> None:
    """xy_table: 120 kg, 95/80 N at speed and 130 N at rest, which has a column of its own.

    With the four columns of mass, viscous friction and levels alone the mass goes 142, 122, 130, 119, 133 kg from trial
    to trial, also with an encoder of 1 nm; without the 35 and 50 N more at rest it comes to 119 kg.  Which level is
    the larger cannot be learned from starts and stops: the integral takes over a constant force in 4 ms.
    """
    found = compare_laws(read_machine("xy_table"), "x", laws=["P-PI + learned compensator"], starts=1)
    learned, plain = found["P-PI + learned compensator"], found[PLAIN]
    block = learned.loop.control.feedforward[0]
    assert isinstance(block, DisturbanceCompensator)
    assert block.mass == pytest.approx(120.0, rel=0.05)
    assert block.stribeck is not None
    assert 30.0 <= block.stribeck <= 50.0
    assert 95.0 <= block.coulomb_positive <= 130.0
    # 0.037 um: it was 0.069 with four columns
    assert learned.figures["tracking_error_rms_m"] < 0.3 * plain.figures["tracking_error_rms_m"]


def test_the_screen_of_a_comparison_is_one_screen(found: Comparison) -> None:
    """A table and sentences of at most 40 lines of 100 columns; what is worse than P-PI comes first, two digits."""
    console = Console(width=100, file=io.StringIO(), force_terminal=False)
    for each in (found.table(), f"- rule: {found.rule}", *in_short(found), advice(found).sentence):
        show(console, each)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert len(lines) <= 40 - (19 - len(found.competitors))  # a machine on which all laws work has 19 rows
    assert max(map(len, lines)) <= 100
    assert all(any(line.lstrip().startswith(each.name) for line in lines) for each in found.competitors)
    # none of these is ranked but today's, since one search confirms nothing
    assert advice(found).sentence == "No law that was tuned is ranked: nothing is recommended."
    rows = [replace(each, unplaced="") for each in found.competitors]
    said = advice(replace(found, competitors=tuple(rows))).sentence
    assert said.startswith("Worse than with ")
    assert "has the least rope-snap error of all that are ranked" in said
    assert not re.search(r"\d\.\d{3}|e[+-]\d", said)


def test_what_breaks_the_rule_is_shown_and_not_placed() -> None:
    found = compare_laws(with_law(read_machine("linear_motor"), Kp=1.2e5), reference=SHORT, starts=1, laws=())
    first = found.competitors[0]
    assert "Ms" in first.reason
    assert found.ranking().rows[0][1].startswith("outside of the rule")
    assert all(found.places(criterion)[0] is None for criterion in CRITERIA)


def test_stiffness_at_10_and_100_Hz_stands_beside_the_rope_snap_everywhere(found: Comparison) -> None:
    keys = ("rope_snap_ISE_root_m_per_N", "stiffness_10_Hz_N_per_m", "stiffness_100_Hz_N_per_m")
    assert tuple(criterion.key for criterion in CRITERIA[:3]) == keys
    assert {"snap nm √s/N", "at 10 Hz N/um", "at 100 Hz N/um"} <= set(found.table().heads)
    assert set(keys) <= set(figures_csv(found).splitlines()[0].split(","))
    for each in found.competitors:
        frequency = np.array([10.0])
        assert each.model is not None
        there = each.model.closed.response(frequency, "position_load", "load_force").magnitude[0]
        assert each.figures["stiffness_10_Hz_N_per_m"] == pytest.approx(1.0 / there)


@pytest.mark.slow(reason="all laws are tuned on whole machines")
@pytest.mark.parametrize(("name", "axis"), [("ball_screw", "x"), ("mill", "x"), ("emps", "x")])
def test_every_bundled_machine(name: str, axis: str, tmp_path: Path) -> None:
    found = compare_laws(read_machine(name), axis, starts=1)
    assert write_comparison(found, tmp_path / "out").is_file()
    for each in found.competitors[1:]:
        assert each.figures["sensitivity_peak"] <= 2.001, each.name
    if name == "ball_screw":
        ratio = (
            found["pole placement"].figures["rope_snap_ISE_root_m_per_N"]
            / found[PLAIN].figures["rope_snap_ISE_root_m_per_N"]
        )
        # paper 2 in our rule: it holds the table better at equal Ms, by more than the 5 % that settled searches of
        # one law may differ by. Measured 0.797
        assert ratio < 0.95
