"""Exported C against the simulator: every law, a million samples, every bit; and what a compiler says of the text."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from jinja2 import UndefinedError

import feeddrive as fd
from exported import LAWS, LOOPS, ONE, PPI, TWO, T
from exported import loop as a_loop
from feeddrive.export.c_bundle import self_test, stepped, streamed
from feeddrive.export.c_code import header_only, texts
from feeddrive.export.design import BROKEN, Trial, read_design, trial
from feeddrive.export.fmu import model_description, variables
from feeddrive.export.layout import Layout, layout
from feeddrive.export.structured_text import program
from feeddrive.export.targets import readme
from feeddrive.loop.guard import TRIP_COMMAND, TRIP_READING
from feeddrive.loop.routine import controller_routine, plant_routine, run
from fresh_draws import Seeded
from slow_share import all_but

pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc libc6-dev"
)
WARNINGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror"]
WARNINGS += ["-ffp-contract=off"]

# every operation of the printer is in one of these; the million samples run over every loop
QUICK = (
    "cascade_ppi",
    "cascade_ppi, inverse dynamics, friction and prefilter",
    "pole_placement, exact commands",
    "dadsc, mode",
)
WHY = "a compiler reads thousands of lines for each loop; a quick one has each operation"
NAMES = all_but(QUICK, LOOPS, WHY)
OBSERVERS = tuple(name for name in LOOPS if name.startswith("active_disturbance_rejection"))


def files(made: Layout) -> dict[str, str]:
    found = texts(made, "a control under test", "made by a test")
    P = made.routine.name
    return {f"{P}.h": found.header, f"{P}.c": found.source, f"{P}_configure.c": found.configure}


def laid_out(loop: fd.Loop, precision: str = "double") -> Layout:
    return layout(controller_routine(loop, "axis_x"), precision)


def same_bits(found: np.ndarray, wanted: np.ndarray) -> bool:
    return np.ascontiguousarray(found).tobytes() == np.ascontiguousarray(wanted).tobytes()


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *all_but(
            [(name, 50_000) for name in (*LAWS, *QUICK, "cascade_ppi, rings and reversals") if name not in OBSERVERS],
            [(name, 50_000) for name in LOOPS],
            "a compiler reads each loop; the battery has the C of every block",
        ),
        *all_but([], ((name, 1_000_000) for name in LAWS), "a million samples of what 50 000 assert"),
    ],
)
def test_a_million_samples_have_the_simulators_bits(name: str, count: int, seeded: Seeded) -> None:
    """With limits, trips, broken numbers and live changes of parameters; the trial must have reached them all."""
    made = laid_out(LOOPS[name])
    tried = trial(made.routine, count, seed=seeded(3), changes=20)
    wanted = run(made.routine, tried.inputs, tried.changes)
    assert same_bits(streamed(made, files(made), tried).outputs, wanted)
    assert len(tried.changes) >= 10
    outputs = dict(zip((v.name for v in made.routine.outputs), wanted.T, strict=True))
    assert 0.3 < np.mean(outputs["enabled"]) < 1.0
    assert np.any(outputs["trip"] == TRIP_READING)
    assert np.all(np.isfinite(wanted))
    if LOOPS[name].control.force_limit is not None:
        limits = [9000.0, *(each.get("axis.x.control.force_limit", 9000.0) for each in tried.changes.values())]
        assert np.any(np.isin(np.abs(outputs["force"]), limits)), "no sample reached the force limit"


@pytest.mark.parametrize("name", NAMES)
def test_a_closed_loop_has_the_simulators_bits(name: str) -> None:
    """The readings of a simulated move, given to the C, bring the force of the simulation."""
    loop = LOOPS[name]
    loop = dataclasses.replace(loop, control=dataclasses.replace(loop.control, guard=fd.Guard()))
    move = fd.blocks.SnapLimitedMove(
        distance=0.02, velocity=0.2, acceleration=3.0, jerk=200.0, snap=2e4, dwell_after=0.05
    )
    record = ["reading_motor", "reading_load", "force", "trip"]
    simulated = fd.simulate(loop, move, load=fd.blocks.StepForce(force=-100.0, start=0.05), record=record)
    made = laid_out(loop)
    count = len(simulated["force"])
    setpoint = move.at(np.arange(count) * T)
    rows = {
        **{f"set_{field}": np.broadcast_to(getattr(setpoint, field), count) for field in setpoint._fields},
        "reading": simulated["reading_load"],
        "reading_motor": simulated["reading_motor"],
        "reading_load": simulated["reading_load"],
        "enable": np.ones(count),
    }
    inputs = np.column_stack([rows[variable.name] for variable in made.routine.inputs])
    assert count > 1000
    assert np.ptp(simulated["force"]) > 100.0
    assert same_bits(streamed(made, files(made), Trial(inputs, {})).outputs[:, 0], simulated["force"])


@pytest.mark.parametrize("name", all_but(["cascade_ppi", "dadsc, mode"], LOOPS, WHY))
def test_single_precision_has_the_bits_of_its_operations(name: str, seeded: Seeded) -> None:
    """Against the same operations in Python, each rounded to single precision."""
    made = laid_out(LOOPS[name], "float")
    tried = trial(made.routine, 600, seed=seeded(4), changes=3, broken=1e-3)
    assert same_bits(streamed(made, files(made), tried).outputs, stepped(made, tried))


@pytest.mark.parametrize(
    ("name", "precision"),
    all_but(
        [*((name, "double") for name in QUICK), ("cascade_ppi", "float")],
        [(name, precision) for name in LOOPS for precision in ("double", "float")],
        "sanitizers make a compiler slow; the bits in single precision are compared quickly",
    ),
)
def test_the_compiler_has_no_complaint_and_the_self_test_passes(name: str, precision: str, tmp_path: Path) -> None:
    """All warnings are errors; then the program that goes with the export, under address and behaviour sanitizers."""
    made = laid_out(LOOPS[name], precision)
    program, vectors = self_test(made)
    for file, text in {**files(made), "axis_x_selftest.c": program, "axis_x_vectors.h": vectors}.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    sources = ["axis_x.c", "axis_x_configure.c", "axis_x_selftest.c"]
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    subprocess.run(["gcc", *WARNINGS, *checks, *sources, "-o", "selftest", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "selftest"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "400 samples" in done.stdout


def test_the_self_test_finds_one_wrong_bit(tmp_path: Path) -> None:
    """A self-test that cannot fail proves nothing: one parameter moves by one unit in the last place."""
    made = laid_out(LOOPS["cascade_ppi"])
    program, vectors = self_test(made)
    written = files(made)
    wrong = written["axis_x_configure.c"].replace("law_Kv = 80.0;", "law_Kv = 0x1.4000000000001p+6;")
    assert wrong != written["axis_x_configure.c"]
    written["axis_x_configure.c"] = wrong
    for file, text in {**written, "axis_x_selftest.c": program, "axis_x_vectors.h": vectors}.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    subprocess.run(
        ["gcc", "axis_x.c", "axis_x_configure.c", "axis_x_selftest.c", "-o", "s", "-lm"], cwd=tmp_path, check=True
    )
    done = subprocess.run([tmp_path / "s"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "force is" in done.stdout


@pytest.mark.parametrize(
    "name", all_but(set(LAWS) - {"active_disturbance_rejection"}, LAWS, "its configure is thousands of lines of C")
)
def test_fuzzed_inputs_never_make_a_command_that_is_no_number(name: str) -> None:
    """10 000 samples of NaN, infinities, denormals and huge numbers in any input; broken ones are flagged in time."""
    made = laid_out(LOOPS[name])
    random = np.random.default_rng(7)
    sound = trial(made.routine, 10_000, seed=5, changes=0, broken=0.0).inputs
    holes = random.random(sound.shape) < 0.1
    inputs = np.where(holes, random.choice(np.array([*BROKEN, 1e308, -1e30, 1e-300]), sound.shape), sound)
    found = streamed(made, files(made), Trial(inputs, {})).outputs
    assert same_bits(found, run(made.routine, inputs))
    names = [variable.name for variable in made.routine.outputs]
    outputs = dict(zip(names, found.T, strict=True))
    assert np.all(np.isfinite(found))
    assert np.all(np.abs(outputs["force"]) <= 9000.0)
    # a reading that is none, for more than the one sample that is held, under a loop that ran before: tripped
    reading = inputs[:, [variable.name.startswith("reading") for variable in made.routine.inputs]]
    broken = ~np.all(np.abs(reading) <= 1000.0, axis=1)
    ran = outputs["enabled"][:-2] > 0.5
    twice = ran & broken[1:-1] & broken[2:]
    assert np.sum(twice) > 5
    assert np.all(outputs["enabled"][2:][twice] == 0.0)
    assert {TRIP_READING} <= set(outputs["trip"]) <= {0.0, 1.0, 2.0, 3.0, 4.0, TRIP_COMMAND}


@pytest.mark.parametrize("axis", ["two encoders", "one encoder"])
def test_an_exported_axis_moves_as_the_simulated_one(axis: str, tmp_path: Path) -> None:
    """Step by step under the recorded force of a closed loop: the readings of the simulation, bit for bit."""
    loop = LOOPS["cascade_ppi" if axis == "two encoders" else "dadsc"]
    loop = dataclasses.replace(loop, control=dataclasses.replace(loop.control, guard=None))
    move = fd.blocks.SnapLimitedMove(distance=0.01, velocity=0.2, acceleration=3.0, jerk=200.0, snap=2e4)
    record = ["force", "load_force", "reading_motor", "reading_load", "velocity_load"]
    simulated = fd.simulate(loop, move, load=fd.blocks.StepForce(force=-100.0, start=0.05), record=record)
    made = layout(plant_routine(loop, "plant_x"))
    found = texts(made, "an axis under test", "made by a test")
    rows = np.column_stack([simulated["force"], simulated["load_force"]])
    rows.tofile(tmp_path / "in")
    (tmp_path / "plant_x.h").write_text(found.header, encoding="utf-8")
    (tmp_path / "plant_x.c").write_text(found.source, encoding="utf-8")
    (tmp_path / "plant_x_configure.c").write_text(found.configure, encoding="utf-8")
    (tmp_path / "main.c").write_text(_PLANT, encoding="utf-8")
    subprocess.run(
        ["gcc", *WARNINGS, "plant_x.c", "plant_x_configure.c", "main.c", "-o", "plant", "-lm"], cwd=tmp_path, check=True
    )
    with open(tmp_path / "in", "rb") as given:
        answer = subprocess.run([tmp_path / "plant"], stdin=given, capture_output=True, check=True).stdout
    motion = np.frombuffer(answer, dtype=np.float64).reshape(-1, 3)
    wanted = np.column_stack([simulated["reading_motor"], simulated["reading_load"], simulated["velocity_load"]])
    assert same_bits(motion[:-1], wanted)


_PLANT = """\
#include "plant_x.h"
#include <stdio.h>

static void say(const plant_x_outputs *outputs)
{
    const double row[3] = {outputs->reading_motor, outputs->reading_load, outputs->velocity_load};
    (void)fwrite(row, sizeof row, 1, stdout);
}

int main(void)
{
    static plant_x_plant plant;
    plant_x_parameters parameters;
    plant_x_inputs inputs = {0};
    plant_x_outputs outputs;
    double row[2];
    const uint64_t mode = plant_x_flush_begin();
    plant_x_defaults(&parameters);
    plant_x_configure(&plant, &parameters);
    plant_x_reset(&plant, &inputs, &outputs);
    say(&outputs);
    while (fread(row, sizeof row, 1, stdin) == 1) {
        inputs.force = row[0];
        inputs.load_force = row[1];
        plant_x_step(&plant, &inputs, &outputs);
        say(&outputs);
    }
    plant_x_flush_end(mode);
    return 0;
}
"""


def test_parameters_that_are_out_of_bounds_change_nothing(tmp_path: Path) -> None:
    """Configure and retune say false for NaN, infinities and numbers beyond a declared bound.

    No byte is touched, but for the mark that a refused configure leaves.
    """
    made = laid_out(LOOPS["cascade_ppi, filters and inertia"])
    for file, text in {**files(made), "main.c": _BOUNDS}.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    sources = ["axis_x.c", "axis_x_configure.c", "main.c"]
    subprocess.run(["gcc", *WARNINGS, *sources, "-o", "bounds", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "bounds"], capture_output=True, text=True, check=False)
    assert done.stdout == "refused 16 of 16, unchanged\n"
    assert done.returncode == 0


_BOUNDS = """\
#include "axis_x.h"
#include <math.h>
#include <stdio.h>
#include <string.h>

int main(void)
{
    static axis_x_controller controller, before;
    axis_x_parameters good, bad;
    double *const places[] = {&bad.law_Kv, &bad.law_Tn, &bad.force_limit, &bad.guard_safe_force, &bad.motor_lead,
                              &bad.guard_hold_samples, &bad.filters_0_frequency, &bad.feedforward_0_mass};
    const double values[] = {(double)NAN, 0.0, -5.0, (double)INFINITY, -0.02, 2e6, 5000.0, -1.0};
    int refused = 0;
    axis_x_defaults(&good);
    if (!axis_x_configure(&controller, &good)) {
        return 1;
    }
    before = controller;
    for (int i = 0; i < 8; i++) {
        bad = good;
        *places[i] = values[i];
        refused += !axis_x_retune(&controller, &bad) && controller.configured == AXIS_X_CONFIGURED;
        refused += !axis_x_configure(&controller, &bad) && controller.configured != AXIS_X_CONFIGURED;
        controller.configured = AXIS_X_CONFIGURED; /* the only thing that a refused configure changes */
    }
    printf("refused %d of 16, %s\\n", refused, memcmp(&before, &controller, sizeof before) ? "changed" : "unchanged");
    return 0;
}
"""


@pytest.mark.parametrize("compiler", ["gcc -std=c99", "g++ -std=c++17"])
def test_two_axes_in_headers_alone_share_one_program(compiler: str, tmp_path: Path) -> None:
    """No name of one is a name of the other, in C and in C++; each in two files of the program."""
    command = compiler.split()
    if shutil.which(command[0]) is None:
        pytest.skip(f"NOT TESTED: {compiler} is not here: apt-get install {command[0]}")
    for name, loop in (
        ("axis_x", "pole_placement"),
        ("axis_y", "cascade_ppi, inverse dynamics, friction and prefilter"),
    ):
        made = layout(controller_routine(LOOPS[loop], name))
        found = header_only(name, texts(made, "a control under test", "made by a test"))
        (tmp_path / f"{name}.h").write_text(found, encoding="utf-8")
    both = '#include "axis_x.h"\n#include "axis_y.h"\n'
    suffix = "cpp" if "++" in compiler else "c"
    (tmp_path / f"one.{suffix}").write_text(f"{both}int one(void);\nint one(void) {{ return 1; }}\n", encoding="utf-8")
    (tmp_path / f"main.{suffix}").write_text(f"{both}int main(void) {{ return 0; }}\n", encoding="utf-8")
    flags = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]
    sources = [f"one.{suffix}", f"main.{suffix}"]
    subprocess.run([*command, *flags, *sources, "-o", "both", "-lm"], cwd=tmp_path, check=True)


# what stands in the text of a target where the part of the guard is there, and nowhere else
MARKS = {
    "checks_setpoint": ("setpoint_size", "good_setpoint"),
    "holds": ("hold_samples", "guard_set_position"),
    "aligns": ("guard_offset", "guard_aligned"),
    "starts_moving": ("guard_before",),
}
BOUNDS = dict.fromkeys(("following_error_limit", "velocity_limit", "travel_most"), 2.0) | {"travel_least": -2.0}


def guarded_texts(guard: fd.Guard) -> dict[str, str]:
    """Of P-PI on two encoders under a guard, by target, without comments."""
    routine = controller_routine(a_loop(TWO, PPI, guard=guard), "axis_x")
    found = {"c": "".join(files(layout(routine)).values())}
    found["st"] = program(layout(routine), "made by a test").text()
    found["fmi3"] = model_description(3, "axis_x", "t", "t", "t", T, variables(routine), ["axis_x.c"]).decode()
    found["c"] = re.sub(r"/\*.*?\*/", "", found["c"], flags=re.DOTALL)
    found["st"] = re.sub(r"\(\*.*?\*\)", "", found["st"], flags=re.DOTALL)
    return found


def test_a_part_of_the_guard_that_is_left_out_has_no_line_on_a_target() -> None:
    whole = guarded_texts(fd.Guard(**BOUNDS))
    for part, marks in MARKS.items():
        without = guarded_texts(fd.Guard(**BOUNDS, **{part: False}))
        for mark in marks:
            assert mark in whole["c"]
            assert mark in whole["st"]
            assert all(mark not in text for text in without.values()), (part, mark)
        assert len(without["c"]) < len(whole["c"])
        assert len(without["st"]) < len(whole["st"])
    assert "hold_samples" in whole["fmi3"]
    for bound in BOUNDS:
        assert all(bound in text for text in whole.values())
        without = guarded_texts(fd.Guard(**{name: value for name, value in BOUNDS.items() if name != bound}))
        assert all(bound not in text for text in without.values()), bound


def test_an_export_names_the_parts_of_its_guard_that_are_off(tmp_path: Path) -> None:
    text = fd.read_machine("ball_screw").file.text
    assert text.count("[axis.x.control.guard]\n") == 1
    file = tmp_path / "less.toml"
    file.write_text(
        text.replace("[axis.x.control.guard]\n", "[axis.x.control.guard]\nholds = false\n"), encoding="utf-8"
    )
    remarks = read_design(file, "x").remarks
    assert (
        "the guard has holds = false: the loop trips in the first broken sample, and hold_samples is not read"
        in remarks
    )
    assert not any("starts_moving" in each for each in remarks)
    fd.write_export(file, "c", tmp_path / "out", axis="x")
    assert "holds = false" in (tmp_path / "out" / "README.md").read_text(encoding="utf-8")


def test_a_hanging_axis_is_held_when_the_loop_is_off() -> None:
    """By the safe force of its guard; and so it is before the first sample in which it is enabled."""
    hanging = dataclasses.replace(ONE, forces=(fd.blocks.Gravity(force=-392.4),))
    routine = controller_routine(a_loop(hanging, PPI, guard=fd.Guard(safe_force=392.4)), "axis_x")
    off = trial(routine, 5).inputs
    off[:, -1] = 0.0  # enable
    assert np.all(run(routine, off)[:, 0] == 392.4)


@pytest.mark.parametrize("target", ["c", "linuxcnc", "fmu2", "fmu3", "cortex-m", "st"])
def test_a_control_that_was_simulated_without_a_guard_is_refused(target: str, tmp_path: Path) -> None:
    """The error holds the lines to add; with these lines the file can be exported."""
    text = fd.read_machine("mill").file.text
    bare = re.sub(r"\[axis\.z\.control\.guard\]\n(?:[a-z].*\n)+", "", text)
    file = tmp_path / "mill.toml"
    file.write_text(bare, encoding="utf-8")
    with pytest.raises(fd.FeeddriveError, match="has no guard") as found:
        fd.write_export(file, target, tmp_path / "out", axis="z")
    assert not (tmp_path / "out").exists()
    lines = [line.strip() for line in str(found.value).splitlines() if line.startswith("    ")]
    assert len(lines) == 4
    assert "safe_force_N = 392.4" in lines[3]
    file.write_text(bare + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
    assert fd.read_machine(file).loop("z").control.guard is not None


def test_a_readme_without_what_its_template_names_is_an_error() -> None:
    design = read_design("ball_screw")
    assert "17 stored samples" in readme("c.md.j2", design, samples=17, flags="-O2")
    with pytest.raises(UndefinedError, match="samples"):
        readme("c.md.j2", design, flags="-O2")
