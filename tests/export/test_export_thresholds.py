"""Thresholds of exports: a case on either side of each."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import structured_text_machine

from export.test_export_structured_text import exported
from export.test_export_structured_text_statements import printed
from exported import LOOPS, T
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.export import c_bundle, cortex_m, linuxcnc_session, structured_text
from feeddrive.export.c_bundle import write_c
from feeddrive.export.c_code import SENTENCE, Body, comment, wrapped
from feeddrive.export.cortex_m import EmulatorError, write_cortex_m
from feeddrive.export.design import Answers, Trial, _check_tables, read_design, trial
from feeddrive.export.drive_quantities import read_cascade
from feeddrive.export.linuxcnc import limits, servo_period, settings
from feeddrive.export.linuxcnc_pid import moves, stock_law
from feeddrive.export.linuxcnc_session import halrun
from feeddrive.export.parameters import halcmd_lines, twincat_filters
from feeddrive.export.structured_text import fixed
from feeddrive.export.structured_text_code import Declared, Unit
from feeddrive.export.targets import FILE, changed_files, read_manifest
from feeddrive.export.verify import verify_export
from feeddrive.language import tree
from feeddrive.language.block import declarations
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.graph import Graph
from feeddrive.language.judgment import Judgment
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import controller_routine
from feeddrive.loop.simulate import simulate
from feeddrive.workflow.export import VerifyRequest

DOCS = Path(__file__).parents[2] / "docs" / "how_to"
COLUMNS = 120  # of a line that a person reads, in C and in Structured Text


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An export in single precision."""
    place = tmp_path_factory.mktemp("export") / "bundle"
    write_cortex_m(read_design("emps", precision="float"), place)
    return place


@pytest.fixture(scope="module")
def linear_motor() -> Loop:
    return read_design("linear_motor").loop


def guarded(loop: Loop, **changes: float | None) -> Loop:
    guard = loop.control.guard
    assert guard is not None
    return replace(loop, control=replace(loop.control, guard=replace(guard, **changes)))


# C and Structured Text


@pytest.mark.parametrize("write", [wrapped, comment], ids=["wrapped", "comment"])
def test_a_line_of_c_is_broken_only_where_it_does_not_fit(write: Callable[[str], list[str]]) -> None:
    """It is indented by 4: 100 characters fit into 120 columns, 150 do not."""
    words = "long_name + " * 20
    assert len(write(words[:99] + ";")) == 1
    lines = write(words[:149] + ";")
    assert len(lines) > 1
    assert max(map(len, lines)) <= COLUMNS


@pytest.mark.parametrize(("terms", "split"), [(4, False), (8, True)])
def test_a_long_expression_of_c_is_split(terms: int, split: bool) -> None:
    """A term has 14 characters with its operator: 56 are read at once, 112 are not."""
    graph = Graph()
    inputs = [graph.input(f"longer_name{i}") for i in range(terms)]
    total = sum(inputs[1:], inputs[0])
    body = Body(graph, [False] * len(graph.nodes), {s.index: f"longer_name{i}" for i, s in enumerate(inputs)},
                {}, {}, "double", str)  # fmt: skip
    body.compute(range(len(graph.nodes)), [])
    assert bool(body.lines) == split
    assert max(map(len, [*body.lines, body.text(total.index)])) <= COLUMNS


@pytest.mark.parametrize(("terms", "split"), [(4, False), (9, True)])
def test_a_long_expression_of_structured_text_is_split(terms: int, split: bool) -> None:
    graph = Graph()
    names = tuple(f"longer_name{i}" for i in range(terms))
    inputs = [graph.input(name) for name in names]
    a = graph.input("a")
    _, lines = printed(graph, {"a": a + sum(inputs[1:], inputs[0])}, names)
    assert (len(lines) > 2) == split  # the sum, and its assignment
    assert max(map(len, lines)) <= COLUMNS


@pytest.mark.parametrize(("count", "lines"), [(18, 1), (26, 2)])
def test_initial_values_of_an_array_are_broken_where_they_do_not_fit(count: int, lines: int) -> None:
    """5 characters a value, after 18 of the declaration: 108 and 148."""
    row = Declared("row", "ARRAY OF REAL", ", ".join(["1.0"] * count))
    text = Unit("f", "", "", {"VAR": [row]}, []).text()
    block = text.partition("VAR\n")[2].partition("END_VAR")[0].splitlines()
    assert len(block) == lines
    assert max(map(len, block)) <= COLUMNS


def test_the_code_of_other_arithmetic_is_that_of_the_readme(bundle: Path) -> None:
    """0 says that no rule is broken, 1 and more name a rule: what a compiler did is below them."""
    text = (bundle / "README.md").read_text()
    found = re.search(r"broken_rule` is then (-\d+)", text)
    assert found
    assert json.loads((bundle / FILE).read_text())["rules"][found[1]] == SENTENCE


@pytest.mark.parametrize(("share", "right"), [(0.8e-6, True), (1.5e-6, False)])
def test_a_cycle_of_a_plc_is_right_within_a_millionth(share: float, right: bool) -> None:
    made = exported("cascade_ppi, plain")
    block = made.machine.blocks["axis_x"].instance()
    given: dict[str, Any] = {v.name: 0.0 for v in made.routine.inputs} | {"enable": True}
    for sign in (-1.0, 1.0):
        answer = block.call(**given, cycle_time=T * (1.0 + sign * share))
        assert bool(answer.enabled) == right


@pytest.mark.parametrize(("operations", "is_fixed"), [(400, False), (700, True)])
def test_a_design_number_of_more_than_500_operations_is_fixed(
    operations: int, is_fixed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = Graph()
    parameter = graph.input("gain")
    number = parameter
    for _ in range(operations):
        number = number * parameter
    monkeypatch.setattr(
        structured_text, "LayoutRun", lambda *_, **__: SimpleNamespace(design={number.index: 2.0}, values=lambda _: [])
    )
    variable = SimpleNamespace(path="law.gain")
    found = fixed(
        SimpleNamespace(  # type: ignore[arg-type]
            graph=graph,
            leaves={parameter.index: ("parameter", 0)},
            design=[SimpleNamespace(name="power", node=number.index)],
            routine=SimpleNamespace(parameters=[variable]),
            conditions=[number.index],
        )
    )
    assert found.fields == ({"power": 2.0} if is_fixed else {})
    assert found.parameters == ((variable,) if is_fixed else ())


def test_the_check_on_a_plc_takes_the_cycles_that_the_document_says() -> None:
    found = re.search(r"all bits, in (\d+) cycles", (DOCS / "structured_text.md").read_text(encoding="utf-8"))
    assert found
    made = exported("cascade_ppi, plain")
    unit = structured_text.check(made.layout, made.program)
    parts = structured_text.check_parts(made.program, unit)
    text = "\n".join([made.program.text(), *(part.text() for part in parts)])
    block = structured_text_machine.program(text).blocks["axis_x_check"].instance()
    cycles = 1
    while not block.call().done:
        cycles += 1
    assert cycles == int(found[1])


# verification


@pytest.mark.parametrize(("refusals", "changes"), [(4, 1), (7, 0)])
def test_a_change_that_a_block_refuses_is_drawn_again(
    refusals: int, changes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four refusals in a row still leave a change; after more of them the trial has none there."""
    left = iter([True] * refusals)

    def check(*_: Any) -> None:
        if next(left, False):
            raise ParameterError("refused")

    monkeypatch.setattr(tree, "check_sampled", check)
    tried = trial(controller_routine(LOOPS["cascade_ppi"], "axis_x"), 40, changes=1)
    assert len(tried.changes) == changes


def test_a_verification_in_single_precision_has_the_samples_that_its_help_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = re.search(r"(\d+) in single precision", declarations(VerifyRequest)["samples"].meaning)
    assert found

    class TrialKnownError(Exception):
        """The trial is known."""

    lengths = list[int]()

    def prove(directory: Path, design: object, tried: Trial, *_: object) -> Answers:
        lengths.append(len(tried.inputs))
        raise TrialKnownError

    monkeypatch.setattr(c_bundle, "prove", prove)
    with pytest.raises(TrialKnownError):
        verify_export(write_c(read_design("emps", precision="float"), tmp_path / "c").parent)
    assert lengths == [int(found[1])]


def test_more_samples_than_memory_holds_are_refused() -> None:
    """30 million rows of 8 inputs and 8 outputs are 4 GB."""
    with pytest.raises(ParameterError, match=r"samples = 30000000 .* must be"):
        VerifyRequest(directory=Path("out"), samples=30_000_000)


@pytest.mark.parametrize(("numbers", "fits"), [(60_000, True), (70_000, False)])
def test_a_table_of_half_a_megabyte_is_exported(numbers: int, fits: bool) -> None:
    """In double precision, 8 bytes a number."""
    layout: Any = SimpleNamespace(routine=SimpleNamespace(tables=[("law.table", None, np.zeros(numbers))]))
    if fits:
        _check_tables(layout)
    else:
        with pytest.raises(ParameterError, match=r"law\.table has 70000 numbers"):
            _check_tables(layout)


@pytest.mark.parametrize(("megabytes", "read"), [(8, True), (15, False)])
def test_a_file_of_an_export_is_read_up_to_ten_megabytes(
    megabytes: int, read: bool, bundle: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(bundle, tmp_path / "copy")
    with open(copy / "axis_x.c", "ab") as file:
        file.truncate(megabytes * 1_000_000)
    if read:
        assert changed_files(copy, read_manifest(copy)) == ["axis_x.c"]
    else:
        with pytest.raises(FileError, match="more than the"):
            changed_files(copy, read_manifest(copy))


@pytest.mark.parametrize(("seconds", "ends"), [(200.0, True), (500.0, False)])
def test_an_emulator_has_five_minutes(
    seconds: float, ends: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A million samples take some minutes there; an emulator that hangs must end, too."""

    def run(command: list[str], timeout: float, **_: Any) -> subprocess.CompletedProcess[str]:
        if seconds > timeout:
            raise subprocess.TimeoutExpired(command, timeout)
        return subprocess.CompletedProcess(command, 0, "0 outputs differ", "")

    (tmp_path / "bundle").mkdir()
    monkeypatch.setattr(cortex_m, "check_programs", lambda: None)
    monkeypatch.setattr(subprocess, "run", run)
    if ends:
        assert cortex_m.self_test(tmp_path / "bundle")
    else:
        with pytest.raises(EmulatorError, match="did not end within"):
            cortex_m.self_test(tmp_path / "bundle")


# judgment


def test_a_loop_with_the_sensitivity_of_a_tuned_one_is_not_near_instability() -> None:
    """The ball screw has an Ms of 1.95, and a tuned loop at most 2."""
    assert read_design("ball_screw").judgment == Judgment.EXPORTED


# LinuxCNC


def test_a_thread_may_be_late_by_some_periods_and_not_by_fifteen() -> None:
    routine = read_design("emps").routine
    (limit,) = (value for item, value in settings(routine).items() if item.name == "late-limit")
    assert 8 * servo_period(routine) < limit < 15 * servo_period(routine)


@pytest.mark.parametrize(("travel", "velocity"), [(0.25, 0.5), (0.15, 0.25)])
def test_a_move_has_a_fifth_of_a_second_of_each_piece(linear_motor: Loop, travel: float, velocity: float) -> None:
    """0.2 s of ramp up, of constant velocity and of ramp down are 0.4 s times the velocity: 0.2 m, and 0.1 m."""
    found = limits(guarded(linear_motor, travel_least=0.0, travel_most=travel))
    assert found.velocity == velocity
    assert found.acceleration == pytest.approx(velocity / 0.2)


@pytest.mark.parametrize(("limit", "velocity"), [(0.16, 0.1), (0.08, 0.05)])
def test_the_velocity_is_the_largest_round_one_below_70_percent(
    linear_motor: Loop, limit: float, velocity: float
) -> None:
    """Of 0.25, 0.1 and 0.05 m/s below 0.112 m/s, and below 0.056 m/s."""
    assert limits(guarded(linear_motor, velocity_limit=limit)).velocity == velocity


@pytest.mark.parametrize(("share", "fits"), [(0.6, True), (0.8, False)])
def test_a_move_may_use_70_percent_of_the_force(linear_motor: Loop, share: float, fits: bool) -> None:
    def limited(force: float | None) -> Loop:
        return replace(linear_motor, control=replace(linear_motor.control, force_limit=force))

    free = limits(limited(None))
    assert (limits(limited(free.peak_force / share)).velocity == free.velocity) == fits


def test_ferror_is_the_next_round_number_above_twice_the_error(linear_motor: Loop) -> None:
    """5.04 um of error: 10 um are less than twice of it, 20 um are not."""
    found = limits(guarded(linear_motor, velocity_limit=0.08))
    assert 5e-6 < found.peak_error < 1e-5
    assert found.following_error == pytest.approx(2e-5)


@pytest.mark.parametrize(
    ("sent", "taken", "taken_all"), [(152, 20, True), (153, 1, False), (1, 21, False), (0, 1, False), (1, 0, False)]
)
def test_a_streamer_has_twenty_pins(
    sent: int, taken: int, taken_all: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MAX_PINS and MAX_STREAMERS in LinuxCNC's streamer.h; one pin of a streamer says that a row is valid."""

    def session(*_: Any) -> str:
        (tmp_path / "out.bin").write_bytes(np.zeros((2, taken)).tobytes())
        return ""

    monkeypatch.setattr(linuxcnc_session, "session", session)
    row = (), tmp_path, 1_000_000, (), np.zeros((2, sent)), "f" * sent, "f" * taken
    if taken_all:
        assert halrun(*row).rows.shape == (2, taken)
    else:
        with pytest.raises(ParameterError, match="has 1 to 152 numbers in and 1 to 20 out"):
            halrun(*row)


def test_after_a_move_a_slow_axis_comes_to_rest_and_does_not_rest_longer_than_it_moved(linear_motor: Loop) -> None:
    """With Kv = 20/s the error falls to e⁻⁶ in 0.3 s; a longer rest would lower the RMS error along the move."""
    law = CascadePPI(Kv=20.0, Kp=4e4, Tn=0.004, velocity_feedforward=0.0)
    free = guarded(linear_motor, following_error_limit=None)  # 15 mm of error would trip it
    slow = replace(free, control=replace(free.control, law=law))
    move, _ = moves(slow)
    error = np.abs(simulate(slow, move, record=("following_error",))["following_error"])
    assert error[-1] < 0.01 * np.max(error)
    assert move.dwell_after < move.leg_time


# makers' files


def test_gains_for_halcmd_are_those_of_lengths_in_mm(linear_motor: Loop) -> None:
    """The velocity gain is Kp, in N s/m, for 1 mm/s and one unit of the output."""
    cascade = read_cascade(linear_motor)
    lines, _ = halcmd_lines(cascade)
    (gain,) = (float(line.text) for line in lines if line.name == "velocity.Pgain")
    assert 1e3 * gain * stock_law(cascade).force_per_output == pytest.approx(cascade.law.Kp, rel=1e-6)


@pytest.mark.parametrize(("damping", "held"), [(0.7, True), (1.0, False)])
def test_a_drive_has_low_passes_with_complex_poles(damping: float, held: bool) -> None:
    """The drives take dampings below 1."""
    assert (not twincat_filters(LowPass2(frequency=500.0, damping=damping), 0).why) == held
