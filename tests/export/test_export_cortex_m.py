"""Bundles for Cortex-M cores: compiled, run in an emulator, and compared with simulator and host, every bit."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from exported import LAWS, LOOPS
from feeddrive.export.c_bundle import streamed
from feeddrive.export.cortex_m import CORES, EmulatorError, answers, find_core, self_test, step_cost, write_cortex_m
from feeddrive.export.design import CONTROL, Design, read_design, trial
from feeddrive.export.layout import layout
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import FileError, MissingProgramError, ParameterError
from feeddrive.loop.routine import controller_routine, run
from slow_share import all_but

needs_tools = pytest.mark.skipif(
    any(shutil.which(program) is None for program in ("make", "arm-none-eabi-gcc", "qemu-system-arm")),
    reason="NOT TESTED: Cortex-M needs  apt-get install make gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm",
)


def design(loop: fd.Loop, precision: str) -> Design:
    """A loop that stands in no machine file."""
    return Design(read_machine("ball_screw"), "x", CONTROL, layout(controller_routine(loop, "axis_x"), precision))


BESIDE = (  # all blocks that compute in another way: exponential, filters, observers, queues of samples
    "cascade_ppi, inverse dynamics, friction and prefilter",
    "cascade_ppi, filters and inertia",
    "cascade_ppi, recovery",
    "dadsc, mode",
    "pole_placement, exact commands",
)
QUICK = [("cascade_ppi", core) for core in CORES]
QUICK += [("dadsc", "m7dp"), (BESIDE[0], "m4f"), (BESIDE[3], "m7dp")]
CASES = all_but(
    QUICK,
    [(name, core) for name in LOOPS for core in CORES if name in LAWS or core != "m7"],
    "an emulator runs each loop; the quick ones have each core and each way to compute",
)


def check_bits(name: str, core: str, count: int, folder: Path) -> None:
    """Double precision against the simulator, single against the same C compiled for this machine."""
    made, bundle = design(LOOPS[name], CORES[core].precision), folder / "bundle"
    write_cortex_m(made, bundle, core=core)
    tried = trial(made.routine, count, seed=6, changes=5)
    # and numbers about the smallest normal one of the precision, which processors treat in ways of their own
    random, decade = np.random.default_rng(7), -38.0 if CORES[core].precision == "float" else -308.0
    small = random.random(tried.inputs.shape) < 0.02
    sizes = 10.0 ** (decade + random.uniform(-8.0, 1.0, int(small.sum())))
    tried.inputs[small] = random.choice([-1.0, 1.0], sizes.size) * sizes
    found = answers(bundle, made, tried.inputs, tried.changes, optimise_configure="-O0")
    if CORES[core].precision == "double":
        wanted = run(made.routine, tried.inputs, tried.changes)
    else:
        files = {file: (bundle / file).read_text() for file in ("axis_x.h", "axis_x.c", "axis_x_configure.c")}
        wanted = streamed(made.layout, files, tried).outputs.astype(np.float32)
    trips = found[:, [v.name for v in made.routine.outputs].index("trip")]
    assert np.any(trips == 0.0)
    assert np.any(trips > 0.0)
    assert np.all(np.isfinite(found))
    assert found.tobytes() == np.ascontiguousarray(wanted).tobytes()


@needs_tools
@pytest.mark.parametrize(("name", "core"), CASES)
def test_an_emulated_core_has_the_bits_of_simulator_and_host(name: str, core: str, tmp_path: Path):
    check_bits(name, core, 20_000 if name in LAWS else 2_000, tmp_path)


@needs_tools
@pytest.mark.slow(reason="a million samples in an emulator")
@pytest.mark.parametrize("core", ["m4f", "m7dp"])
@pytest.mark.parametrize("name", LAWS)
def test_a_million_samples_on_an_emulated_core(name: str, core: str, tmp_path: Path):
    check_bits(name, core, 1_000_000, tmp_path)


@needs_tools
def test_the_self_test_passes_and_finds_a_wrong_bit(tmp_path: Path):
    bundle = tmp_path / "bundle"
    write_cortex_m(read_design("ball_screw", precision="float"), bundle)
    assert "0 outputs differ" in self_test(bundle)
    vectors = bundle / "axis_x_vectors.h"
    before, after = vectors.read_text().split("expected[SAMPLES]")
    wrong = re.sub(r"(0x[0-9A-F]{8})", lambda found: f"0x{int(found[1], 16) ^ 1:08X}", after, count=1)
    assert wrong != after
    vectors.write_text(f"{before}expected[SAMPLES]{wrong}")
    with pytest.raises(EmulatorError, match="1 outputs differ"):
        self_test(bundle)


@needs_tools
def test_the_report_counts_instructions_and_bytes(tmp_path: Path):
    bundle = tmp_path / "bundle"
    write_cortex_m(read_design("ball_screw", precision="float"), bundle)
    cost = step_cost(bundle)
    # by hand: it cannot be less than what it loads and stores, nor its bytes less than two for each instruction
    assert 100 < cost.least <= cost.most < 400
    assert cost.flash > 2 * cost.least
    header = (bundle / "axis_x.h").read_text()
    doubles, floats = (len(re.findall(rf"^    {kind} \w+;", header, re.MULTILINE)) for kind in ("double", "float"))
    outside = len(re.findall(r"^    float", header.split("Numbers that depend")[0], re.MULTILINE))
    assert cost.memory == pytest.approx(8 * doubles + 4 * (floats - outside), abs=8)  # but for padding


@needs_tools
def test_cmake_builds_the_library(tmp_path: Path):
    if shutil.which("cmake") is None:
        pytest.skip("NOT TESTED: cmake is not there: apt-get install cmake")
    bundle = tmp_path / "bundle"
    write_cortex_m(read_design("ball_screw", precision="float"), bundle)
    tool = f"-DCMAKE_TOOLCHAIN_FILE={bundle / 'cortex-m.cmake'}"
    for command in (["cmake", "-S", bundle, "-B", tmp_path / "build", tool], ["cmake", "--build", tmp_path / "build"]):
        subprocess.run(command, check=True, capture_output=True)
    assert (tmp_path / "build" / "libaxis_x.a").stat().st_size > 1000


@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: gcc is not there: apt-get install gcc libc6-dev")
@pytest.mark.parametrize(
    ("name", "precision"),
    all_but(
        [("cascade_ppi", "float"), ("dadsc", "double")],
        [*((name, "float") for name in (*LAWS, *BESIDE)), ("dadsc", "double")],
        "a compiler reads the configure of each loop; the printing of constants is the same",
    ),
)
def test_constants_in_place_of_configure_are_the_same_numbers(name: str, precision: str, tmp_path: Path):
    write_cortex_m(design(LOOPS[name], precision), tmp_path / "bundle")
    main = """#include "axis_x_prepared.h"
#include <string.h>
int main(void)
{
    static axis_x_controller a, b;
    axis_x_parameters parameters;
    axis_x_defaults(&parameters);
    axis_x_configure(&a, &parameters);
    axis_x_prepared(&b);
    return memcmp(&a, &b, sizeof a) != 0;
}
"""
    (tmp_path / "bundle" / "same.c").write_text(main)
    sources = ["same.c", "axis_x.c", "axis_x_configure.c", "axis_x_prepared.c"]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O0", "-ffp-contract=off"]
    subprocess.run(["gcc", *flags, "-o", "same", *sources, "-lm"], cwd=tmp_path / "bundle", check=True)
    assert subprocess.run([tmp_path / "bundle" / "same"], check=False).returncode == 0


def test_what_is_refused(tmp_path: Path):
    with pytest.raises(ParameterError, match="m4f, m7, m7dp"):
        find_core("m3", "float")
    with pytest.raises(ParameterError, match="export with --precision float, or take m7dp"):
        write_cortex_m(read_design("ball_screw", precision="double"), tmp_path / "bundle", core="m4f")
    with pytest.raises(ParameterError, match="an axis"):
        write_cortex_m(read_design("ball_screw", what="plant", precision="float"), tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.txt").write_text("keep")
    with pytest.raises(FileError, match="there"):
        write_cortex_m(read_design("ball_screw", precision="float"), tmp_path / "there")
    assert [file.name for file in (tmp_path / "there").iterdir()] == ["mine.txt"]


def test_a_missing_program_is_named_with_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write_cortex_m(read_design("ball_screw", precision="float"), tmp_path / "bundle")
    monkeypatch.setenv("PATH", os.devnull)
    with pytest.raises(MissingProgramError, match="apt-get install make"):
        self_test(tmp_path / "bundle")


def test_every_core_is_reached_by_its_precision():
    assert find_core(None, "float").name == "m4f"
    assert find_core(None, "double").name == "m7dp"
    assert {core.precision for core in CORES.values()} == {"float", "double"}


def test_the_readme_calls_what_is_declared(tmp_path: Path):
    write_cortex_m(read_design("ball_screw", precision="float"), tmp_path / "bundle")
    bundle = tmp_path / "bundle"
    readme = (bundle / "README.md").read_text()
    headers = (bundle / "axis_x.h").read_text() + (bundle / "axis_x_prepared.h").read_text()
    called = set(re.findall(r"axis_x_\w+(?=\()", readme))
    assert {"axis_x_step", "axis_x_prepared", "axis_x_broken_rule"} < called
    assert all(f"{name}(" in headers for name in called)


def test_the_readme_explains_every_code_of_a_refusal(tmp_path: Path):
    write_cortex_m(read_design("ball_screw", precision="float"), tmp_path / "bundle")
    readme = (tmp_path / "bundle" / "README.md").read_text()
    rules = json.loads((tmp_path / "bundle" / "export.json").read_text())["rules"]
    assert rules
    for code, sentence in rules.items():
        assert f"| {code} | {sentence} |\n" in readme
