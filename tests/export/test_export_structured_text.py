"""Exported Structured Text against the simulator, bit for bit: read by the grammar of the standard, run in Python."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import iec_compiler
import numpy as np
import pytest
import structured_text_machine
from blark.parse import parse_source_code

import feeddrive as fd
from exported import LAWS, LOOPS, T
from feeddrive.export.c_bundle import stepped
from feeddrive.export.design import Trial, read_design, trial
from feeddrive.export.layout import layout
from feeddrive.export.structured_text import (
    NAMESPACE,
    Program,
    check,
    program,
    structured_text_files,
    write_structured_text,
)
from feeddrive.language.errors import FileError, ParameterError, StructureError
from feeddrive.loop.guard import TRIP_READING
from feeddrive.loop.routine import Routine, controller_routine, run
from slow_share import all_but

# beside the laws: feedforwards and a prefilter, functions of the text's own, a table
BESIDE = ["cascade_ppi, inverse dynamics, friction and prefilter", "cascade_ppi, learned force"]
QUICK = ["cascade_ppi", BESIDE[1]]
CASES = all_but(QUICK, LOOPS, "8,000 samples and more of some 1,000 lines, run by Python")


class Exported:
    """A loop as text, and as a function block that runs."""

    def __init__(self, name: str, precision: str = "double") -> None:
        self.loop = LOOPS[name]
        self.routine: Routine = controller_routine(self.loop, "axis_x")
        self.layout = layout(self.routine, precision)
        self.program: Program = program(self.layout, "under test")

    @cached_property
    def machine(self) -> structured_text_machine.Program:
        return structured_text_machine.program(self.program.text())

    def outputs(self, tried: Trial, resets: tuple[int, ...] = ()) -> np.ndarray:
        """What a fresh function block answers to a trial."""
        block = self.machine.blocks["axis_x"].instance()
        found = np.empty((len(tried.inputs), len(self.routine.outputs)))
        for k, row in enumerate(tried.inputs):
            for path, value in tried.changes.get(k, {}).items():
                setattr(block.s.parameters, self.program.names[path], value)
            given: dict[str, Any] = {v.name: float(x) for v, x in zip(self.routine.inputs, row, strict=True)}
            given["enable"] = given["enable"] > 0.5
            answer = block.call(**given, retune=k in tried.changes, reset=k in resets)
            found[k] = [float(getattr(answer, v.name)) for v in self.routine.outputs]
        return found

    def trial(self, count: int, seed: int, **more: Any) -> Trial:
        """Random samples; parameters that the export fixes stay."""
        tried = trial(self.routine, count, seed, **more)
        kept = {k: {p: v for p, v in each.items() if p in self.program.names} for k, each in tried.changes.items()}
        return Trial(tried.inputs, kept)


@cache
def exported(name: str, precision: str = "double") -> Exported:
    return Exported(name, precision)


def same_bits(found: np.ndarray, wanted: np.ndarray) -> bool:
    return np.ascontiguousarray(found).tobytes() == np.ascontiguousarray(wanted).tobytes()


def closed_loop(loop: fd.Loop, routine: Routine) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """The inputs of a control during a simulated move, and the simulated signals."""
    move = fd.blocks.SnapLimitedMove(
        distance=0.01, velocity=0.2, acceleration=3.0, jerk=200.0, snap=2e4, dwell_after=0.02
    )
    record = ["reading_motor", "reading_load", "force", "trip"]
    simulated = fd.simulate(loop, move, load=fd.blocks.StepForce(force=-100.0, start=0.02), record=record)
    count = len(simulated["force"])
    setpoint = move.at(np.arange(count) * T)
    rows = {
        **{f"set_{field}": np.broadcast_to(getattr(setpoint, field), count) for field in setpoint._fields},
        "reading": simulated["reading_load"],
        "reading_motor": simulated["reading_motor"],
        "reading_load": simulated["reading_load"],
        "enable": np.ones(count),
    }
    signals = {name: np.asarray(simulated[name]) for name in record}
    return np.column_stack([rows[variable.name] for variable in routine.inputs]), signals


def check_broken(made: Exported) -> None:
    """Ten thousand samples of which every tenth number is NaN, infinite, huge or below the normal ones."""
    tried = made.trial(10_000, seed=9, changes=3, broken=0.1)
    found = made.outputs(tried)
    names = [v.name for v in made.routine.outputs]
    assert np.all(np.isfinite(found))
    assert np.max(np.abs(found[:, names.index("force")])) <= 9000.0 * 1.25**3
    assert np.any(found[:, names.index("trip")] == TRIP_READING), "no broken reading was flagged"
    assert same_bits(found, run(made.routine, tried.inputs, tried.changes))


@pytest.mark.parametrize("name", CASES)
def test_every_loop_has_the_simulators_bits(name: str) -> None:
    """Over random samples with limits, trips, broken numbers, retunes and resets, and in a closed loop."""
    made = exported(name)
    tried = made.trial(8000, seed=5, changes=20, broken=2e-3)
    wanted = run(made.routine, tried.inputs, tried.changes)
    assert same_bits(made.outputs(tried), wanted)
    assert np.all(np.isfinite(wanted))
    outputs = dict(zip((v.name for v in made.routine.outputs), wanted.T, strict=True))
    assert 0.2 < np.mean(outputs["enabled"]) < 1.0
    assert np.any(outputs["trip"] > 0.0)
    assert sum(bool(each) for each in tried.changes.values()) >= 5

    still = Trial(tried.inputs[:3000], {})
    pieces = [run(made.routine, still.inputs[:1234]), run(made.routine, still.inputs[1234:])]
    assert same_bits(made.outputs(still, resets=(0, 1234)), np.vstack(pieces)), "a reset is not a fresh start"

    if name in LAWS:
        check_broken(made)

    inputs, simulated = closed_loop(made.loop, made.routine)
    found = made.outputs(Trial(inputs, {}))
    names = [v.name for v in made.routine.outputs]
    assert len(inputs) > 1000
    assert np.max(np.abs(simulated["force"])) > 50.0
    assert same_bits(found[:, names.index("force")], simulated["force"])
    assert same_bits(found[:, names.index("trip")], simulated["trip"])


@pytest.mark.parametrize(
    "name", all_but(["cascade_ppi, plain"], ["cascade_ppi, plain", *LAWS], "a cycle in Python takes a millisecond")
)
def test_short_reals_have_the_bits_of_single_precision(name: str) -> None:
    made = exported(name, "float")
    tried = made.trial(400, seed=2, changes=3)
    assert same_bits(made.outputs(tried), stepped(made.layout, tried))
    assert "LREAL" not in made.program.block.text().replace(f"{made.routine.name}_parameters", "")


def test_in_a_task_with_another_cycle_the_loop_stays_off() -> None:
    made = exported("cascade_ppi, plain")
    block = made.machine.blocks["axis_x"].instance()
    given: dict[str, Any] = {v.name: 0.0 for v in made.routine.inputs} | {"enable": True}
    assert block.call(**given).enabled
    for wrong in (2.0 * T, 1.0001 * T, 0.0, np.nan):
        answer = block.call(**given, cycle_time=wrong)
        assert answer.cycle_wrong
        assert not answer.enabled
        assert answer.force == 0.0
    assert block.call(**given, cycle_time=T * (1.0 + 1e-9)).enabled


def test_parameters_are_taken_over_by_a_rising_edge_only() -> None:
    made = exported("cascade_ppi, plain")
    block = made.machine.blocks["axis_x"].instance()
    given: dict[str, Any] = {v.name: 0.0 for v in made.routine.inputs} | {"enable": True}
    block.call(**given, retune=True)
    block.s.parameters.law_Kv = 33.0
    assert block.call(**given, retune=True).design.law_Kv == 80.0
    assert block.call(**given, retune=False).design.law_Kv == 80.0
    assert block.call(**given, retune=True).design.law_Kv == 33.0


def test_what_is_too_much_for_a_plc_is_fixed_and_said_so() -> None:
    """The observer's matrix exponential is computed at the export; its parameters are no inputs any more."""
    made = exported("active_disturbance_rejection")
    fixed = {variable.path for variable in made.program.fixed.parameters}
    assert fixed == {
        "axis.x.control.law.observer.mass",
        "axis.x.control.law.observer.omega_o",
        "axis.x.control.law.observer.zeta_o",
    }
    assert not fixed & set(made.program.names)
    assert {"axis.x.control.law.omega_c", "axis.x.control.law.mass", "axis.x.control.force_limit"} <= set(
        made.program.names
    )
    (design,) = (each for each in made.program.structures if each.name == "axis_x_design")
    assert "axis.x.control.law.observer.omega_o = 150.0 rad/s" in design.comment
    assert not exported("cascade_ppi").program.fixed.parameters


def test_the_text_keeps_the_words_of_the_law() -> None:
    text = exported("cascade_ppi").program.block.text()
    assert "law_velocity := " in text
    assert "design.law_Kv * " in text
    assert "END_IF;" in text
    assert not re.search(r"END_IF(?!;)", text)
    assert "\t" not in text
    assert max(map(len, text.splitlines())) < 200


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "emps"
    assert write_structured_text(read_design("emps"), out) == out / "README.md"
    return out


def test_the_check_on_the_plc_passes_and_can_fail(directory: Path) -> None:
    text = (directory / "axis_x.st").read_text() + "\n" + (directory / "axis_x_check.st").read_text()
    check = structured_text_machine.program(text).blocks["axis_x_check"]
    block = check.instance()
    calls = 0
    while not block.call().done:
        calls += 1
        assert calls < 200
    assert block.s.wrong == 0
    assert block.s.first_wrong == -1
    other = check.instance()
    other.s.wanted_force = list(other.s.wanted_force)
    other.s.wanted_force[7] = float(np.nextafter(other.s.wanted_force[7], np.inf))
    while not other.call().done:
        pass
    assert (other.s.wrong, other.s.first_wrong) == (1, 7)


def test_all_files_hold_the_same_text(directory: Path) -> None:
    """TwinCAT's files and PLCopen's are two more ways to write what stands in the source file."""
    text = (directory / "axis_x.st").read_text() + "\n" + (directory / "axis_x_check.st").read_text()
    texts, bodies = [], {}
    for file in sorted((directory / "twincat").iterdir()):
        (each,) = ET.parse(file).getroot()
        assert each.get("Name") == file.stem
        declaration = each.findtext("Declaration") or ""
        body = each.findtext("Implementation/ST")
        bodies[file.stem] = body
        ending = (
            "" if body is None else "END_FUNCTION\n" if "\nFUNCTION " in f"\n{declaration}" else "END_FUNCTION_BLOCK\n"
        )
        texts.append(declaration + (f"\n{body}{ending}" if body is not None else ""))
    assert all(each in text for each in texts)
    assert sorted("".join(texts).split()) == sorted(text.split())

    space = {"p": NAMESPACE, "h": "http://www.w3.org/1999/xhtml"}
    project = ET.parse(directory / "axis_x.xml").getroot()
    pous = project.findall(".//p:pou", space)
    assert {pou.get("name") for pou in pous} == {name for name, body in bodies.items() if body is not None}
    for pou in pous:
        name = str(pou.get("name"))
        assert (pou.findtext("p:body/p:ST/h:xhtml", namespaces=space) or "").strip() == (bodies[name] or "").strip()
        for variable in pou.findall("p:interface//p:variable", space):
            assert re.search(rf"\n    {variable.get('name')} : ", text)
    types = {str(each.get("name")) for each in project.findall(".//p:dataType", space)}
    arrays = {f"axis_x_{kind}_100" for kind in ("lreal", "int", "bool")}
    assert types == {"axis_x_parameters", "axis_x_design", "axis_x_state", *arrays}
    field = project.find(".//p:dataType[@name='axis_x_parameters']//p:variable[@name='law_Kv']", space)
    assert field is not None
    assert float(field.find(".//p:simpleValue", space).get("value")) == 160.18  # type: ignore[union-attr, arg-type]


@pytest.mark.parametrize(
    "name",
    all_but([], LOOPS, "blark reads some 100 lines a second; our own grammar reads all"),
)
def test_blark_reads_it_too(name: str) -> None:
    """A grammar of TwinCAT's dialect that was written by others; looser than the standard's, which every test reads."""
    text = re.sub(r":= \[[^\[\]]+\];", ":= [1.0, -0.1, 2.5E-7];", exported(name).program.text())
    parse_source_code(text).transform()


def declared(text: str) -> list[str]:
    """The lines of a source text without comments."""
    return re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL).split("\n")


# a table, an exponential, and the powers of a matrix
WRITTEN = [BESIDE[1], "cascade_ppi, compensator", "active_disturbance_rejection, 0 taylor states"]


@pytest.mark.parametrize("name", all_but(WRITTEN, LOOPS, "some of these texts take a second to print"))
def test_every_literal_is_in_the_range_of_a_short_real_and_every_array_has_a_named_type(name: str) -> None:
    """matiec reads literals by `strtof`, and takes two anonymous array types for two types."""
    made = exported(name)
    text = made.program.text() + check(made.layout, made.program).text()
    lines = declared(text)
    literals = [float(each) for line in lines for each in re.findall(r"(?<![\w.])\d+\.\d+(?:E[+-]?\d+)?", line)]
    assert len(literals) > 200
    assert all(x == 0.0 or 1.18e-38 < x < 3e38 for x in literals)
    assert all(line.startswith("TYPE ") for line in lines if "ARRAY" in line)


def agrees(name: str, count: int, seed: int, folder: Path, precision: str = "double") -> None:
    """The text, compiled by matiec, against the exported C."""
    made = exported(name, precision)
    iec_compiler.agree(made.layout, made.program, count, seed, folder)


# 300,000 samples of a law take 3 to 12 s, of which the compilers take 1 to 3
STORM = "300,000 samples of each law, compiled by matiec: 3 to 12 s a law, and 40 s once for matiec itself"


@pytest.mark.slow(reason=STORM)
@pytest.mark.parametrize("name", LOOPS)
def test_a_real_compiler_makes_of_it_what_the_c_computes(name: str, tmp_path: Path) -> None:
    """With NaN, infinities, numbers below the normal ones, storms of enable, resets, and live changes good and bad."""
    agrees(name, 300_000, 3, tmp_path)


@pytest.mark.slow(reason="as above, in short reals: the numbers of configure are the same")
@pytest.mark.parametrize("name", LAWS)
def test_a_real_compiler_makes_of_short_reals_what_the_c_computes(name: str, tmp_path: Path) -> None:
    agrees(name, 300_000, 4, tmp_path, "float")


@pytest.mark.skipif(bool(iec_compiler.not_built()), reason=iec_compiler.not_built())
@pytest.mark.parametrize("name", ["cascade_ppi, learned force"])
def test_a_real_compiler_that_was_built_before_makes_of_it_what_the_c_computes(name: str, tmp_path: Path) -> None:
    agrees(name, 6_000, 5, tmp_path)


@pytest.mark.slow(reason="40 s for matiec itself, if no other test built it")
def test_a_real_compiler_takes_the_check_block_too_and_it_passes(directory: Path, tmp_path: Path) -> None:
    text = (directory / "axis_x.st").read_text() + "\n" + (directory / "axis_x_check.st").read_text()
    iec_compiler.compiled(text, tmp_path)
    (tmp_path / "main.c").write_text(CHECKED)
    library = iec_compiler.built() / "lib" / "C"
    words = ["gcc", "-std=gnu99", "-ffp-contract=off", "-w", "-O1", "-I", library, "main.c", "-o", "main", "-lm"]
    subprocess.run(words, cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["100", "0", "-1"]


CHECKED = """\
#include "POUS.h"
#include "POUS.c"
#include <stdio.h>
TIME __CURRENT_TIME;
BOOL __DEBUG;
int main(void)
{
    static AXIS_X_CHECK check;
    int calls = 0;
    AXIS_X_CHECK_init__(&check, 0);
    while (!check.DONE.value && calls < 200) {
        AXIS_X_CHECK_body__(&check);
        calls++;
    }
    printf("%d %d %d\\n", calls, (int)check.WRONG.value, (int)check.FIRST_WRONG.value);
    return 0;
}
"""


def test_the_same_design_gives_the_same_bytes_and_a_readme_that_says_what_to_mind() -> None:
    files = structured_text_files(read_design("mill", "z", name="hanging"))
    assert files == structured_text_files(read_design("mill", "z", name="hanging"))
    said = files["README.md"]
    for word in ("Existing Item", "PLCopenXML", "Floating Point Exceptions", "cycle_wrong", "safety", "export again"):
        assert word in said
    assert "| fixed | `axis.z.control.law.observer.omega_o` |" in said
    assert "500 µs" in said or "µs**" in said
    assert all(name.startswith(("hanging", "twincat/hanging", "README")) for name in files)


def test_what_cannot_be_exported_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="a PLC runs the control"):
        write_structured_text(read_design("emps", what="plant"), tmp_path / "plant")
    with pytest.raises(ParameterError, match="word of Structured Text"):
        read_design("emps", name="Task")
    force = fd.blocks.LearnedForce(force=np.concatenate([np.ones(20_000), [0.0]]))
    loop = LOOPS["cascade_ppi"]
    long = dataclasses.replace(loop, control=dataclasses.replace(loop.control, compensation=(force,)))
    with pytest.raises(StructureError, match="20001 entries, more than the 10000"):
        program(layout(controller_routine(long, "axis_x")), "")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    with pytest.raises(FileError, match="not written by feeddrive"):
        write_structured_text(read_design("emps"), tmp_path / "mine")
    assert [each.name for each in tmp_path.iterdir()] == ["mine"]
