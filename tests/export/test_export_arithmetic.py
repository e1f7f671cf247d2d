"""A compiler that computes otherwise than the simulation is refused, by the header or when the program starts."""

from __future__ import annotations

import platform
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from exported import LOOPS
from feeddrive.export import cortex_m
from feeddrive.export.c_bundle import c_files, streamed
from feeddrive.export.c_code import CODE, SENTENCE
from feeddrive.export.cortex_m import EmulatorError, write_cortex_m
from feeddrive.export.design import Design, read_design, trial
from feeddrive.language.errors import FileError
from feeddrive.loop.routine import run
from hal_programs import needs_linuxcnc

needs_gcc, needs_tcc, needs_clang = (
    pytest.mark.skipif(shutil.which(each) is None, reason=f"NOT TESTED with {each}: apt-get install {each}")
    for each in ("gcc", "tcc", "clang")
)
needs_x86 = pytest.mark.skipif("x86" not in platform.machine(), reason="NOT TESTED: only an x86 has an x87")
STRICT = ("-std=c99", "-O2", "-ffp-contract=off", "-w")
# what a compiler says of itself, taken away: an older gcc has no macros for the parts of -ffast-math
SILENT = (
    "-U__ASSOCIATIVE_MATH__",
    "-U__RECIPROCAL_MATH__",
    "-U__NO_SIGNED_ZEROS__",
    "-U__FLT_EVAL_METHOD__",
    "-U__FLT_EVAL_METHOD_TS_18661_3__",
)
ASSOCIATIVE = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")
TOLD = [
    (("-ffast-math",), "broken readings could not be detected"),
    (("-funsafe-math-optimizations",), "compile without -funsafe-math-optimizations"),
    (ASSOCIATIVE, "compile without -funsafe-math-optimizations"),
    (("-freciprocal-math",), "compile without -funsafe-math-optimizations"),
    pytest.param(("-mfpmath=387",), "FLT_EVAL_METHOD is not 0", marks=needs_x86),
    pytest.param(("-mfpmath=both",), "FLT_EVAL_METHOD is not 0", marks=needs_x86),
]
UNTOLD = [
    ("-funsafe-math-optimizations", *SILENT),
    (*ASSOCIATIVE, *SILENT),
    ("-freciprocal-math", *SILENT),
    pytest.param(("-mfpmath=387", *SILENT), marks=needs_x86),
    pytest.param(("-ffp-contract=fast", "-mfma"), marks=needs_x86),
    ("-flto", "-funsafe-math-optimizations", *SILENT),
    ("-O3", "-funsafe-math-optimizations", *SILENT),
]
HARMLESS = [(), ("-O0",), ("-O3",), ("-Os",), ("-fno-math-errno",), ("-fno-trapping-math",)]


@cache
def files(precision: str = "double", *, single_header: bool = False) -> dict[str, str]:
    """The export of a loop with a notch, a low-pass, two encoders and a motor."""
    return c_files(read_design("ball_screw", precision=precision), single_header=single_header)


def built(
    folder: Path, flags: tuple[str, ...], made: dict[str, str], compiler: str = "gcc"
) -> subprocess.CompletedProcess[str]:
    """The answer of a compiler, or of the self-test that it built."""
    for name, text in made.items():
        (folder / name).write_text(text, encoding="utf-8")
    sources = sorted(name for name in made if name.endswith(".c"))
    words = [compiler, *STRICT, *flags] if compiler != "tcc" else ["tcc", *flags]
    found = subprocess.run(
        [*words, "-o", "selftest", *sources, "-lm"], cwd=folder, capture_output=True, text=True, check=False
    )
    if found.returncode:
        return found
    return subprocess.run([folder / "selftest"], capture_output=True, text=True, check=False)


@needs_gcc
@pytest.mark.parametrize(("flags", "said"), TOLD, ids=str)
def test_what_a_macro_tells_does_not_compile(tmp_path: Path, flags: tuple[str, ...], said: str) -> None:
    """All but the first compiled without a word, and gave other last bits."""
    found = built(tmp_path, flags, {name: text for name, text in files().items() if name.endswith(".h")} | SHORT)
    assert found.returncode != 0
    assert said in found.stderr


SHORT = {"main.c": '#include "axis_x.h"\nint main(void)\n{\n    return 0;\n}\n'}


@needs_gcc
def test_what_no_macro_tells_is_refused_at_the_start(tmp_path: Path) -> None:
    found = built(tmp_path, ("-funsafe-math-optimizations", *SILENT), files())
    assert found.stdout == f"refused: rule {CODE} is broken, see the README\n", found.stderr
    assert found.returncode == 2


@needs_gcc
@pytest.mark.slow(reason="the same of every option, in single precision and of a single header")
@pytest.mark.parametrize("flags", UNTOLD, ids=lambda each: each[0] if each[0] != "-O3" else "-O3 unsafe")
@pytest.mark.parametrize("single", [False, True], ids=["files", "header"])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_every_form_of_an_export_refuses(tmp_path: Path, flags: tuple[str, ...], precision: str, single: bool) -> None:
    found = built(tmp_path, flags, files(precision, single_header=single))
    assert found.returncode == 2, found.stderr
    assert f"rule {CODE}" in found.stdout


@needs_gcc
@pytest.mark.slow(reason="the refusal has quick tests; here that nothing else is refused")
@pytest.mark.parametrize("flags", HARMLESS, ids=str)
@pytest.mark.parametrize("precision", ["double", "float"])
def test_what_changes_no_bit_is_not_refused(tmp_path: Path, flags: tuple[str, ...], precision: str) -> None:
    found = built(tmp_path, flags, files(precision))
    assert (found.returncode, found.stdout.endswith(": 0 outputs differ\n")) == (0, True), found


@needs_clang
@pytest.mark.parametrize("flags", [("-funsafe-math-optimizations",), (*ASSOCIATIVE,), ("-freciprocal-math",)], ids=str)
def test_clang_is_refused_too(tmp_path: Path, flags: tuple[str, ...]) -> None:
    found = built(tmp_path, flags, files(), "clang")
    assert found.returncode != 0
    assert "compile without -funsafe-math-optimizations" in found.stderr or f"rule {CODE}" in found.stdout


@needs_tcc
@pytest.mark.parametrize(
    "precision", ["double", pytest.param("float", marks=pytest.mark.slow(reason="the same in single precision"))]
)
def test_the_self_test_compiles_in_tcc(tmp_path: Path, precision: str) -> None:
    """It has neither -HUGE_VAL nor NaN as constants: "initializer element is not constant"."""
    found = built(tmp_path, (), files(precision), "tcc")
    assert found.stdout.endswith(": 0 outputs differ\n"), found.stderr


@needs_gcc
@pytest.mark.slow(reason="the refusal has a quick test; here what a step does after it")
def test_a_step_that_was_refused_commands_the_safe_force_alone(tmp_path: Path) -> None:
    """Configure, the constants of a microcontroller, and a step after each."""
    made = LOOPS["cascade_ppi"]
    text = """
#include "axis_x_prepared.h"
#include <stdio.h>
int main(void)
{
    static axis_x_controller one, other;
    axis_x_parameters parameters;
    const axis_x_inputs inputs = {.reading_load = 0.1, .reading_motor = 0.1, .set_position = 0.1005, .enable = 1.0};
    axis_x_outputs outputs;
    axis_x_defaults(&parameters);
    printf("%d %d", axis_x_configure(&one, &parameters), axis_x_broken_rule(&parameters));
    axis_x_prepared(&other);
    for (int i = 0; i < 2; i++) {
        axis_x_controller *controller = i ? &other : &one;
        axis_x_reset(controller, &inputs);
        axis_x_step(controller, &inputs, &outputs);
        printf(" %g %g", outputs.force, outputs.enabled);
    }
    return 0;
}
"""
    write_cortex_m(design_of(made, "double"), tmp_path / "bundle", core="m7dp")
    sources = {each.name: each.read_text() for each in (tmp_path / "bundle").glob("axis_x*.[ch]")} | {"main.c": text}
    held = float(made.control.guard.safe_force)
    refused = built(tmp_path, ("-freciprocal-math", *SILENT), sources)
    assert refused.stdout == f"0 {CODE} {held:g} 0 {held:g} 0", refused.stderr
    taken = built(tmp_path, (), sources).stdout.split()
    assert (taken[:2], taken[3], taken[5], taken[2]) == (["1", "0"], "1", "1", taken[4])


def design_of(loop, precision: str) -> Design:
    from test_export_cortex_m import design

    return design(loop, precision)


@needs_gcc
@needs_x86
@pytest.mark.slow(reason="the refusal has a quick test; here what `verify` says of it")
def test_the_proof_on_a_computer_says_that_the_program_refuses() -> None:
    design = read_design("ball_screw")
    tried = trial(design.routine, 100, 1)
    flags = (*STRICT, "-mfpmath=387", *SILENT)
    with pytest.raises(FileError) as refused:
        streamed(design.layout, files(), tried, flags=flags)
    assert SENTENCE in str(refused.value)
    assert "-mfpmath=387" in str(refused.value)
    found = streamed(design.layout, files(), tried)
    assert np.array_equal(found.outputs, run(design.routine, tried.inputs, tried.changes), equal_nan=True)


@pytest.mark.slow(reason="an FMU with its library; the header and the check are those of the quick tests")
def test_an_fmu_refuses_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmpy = pytest.importorskip("fmpy", reason="NOT TESTED: pip install fmpy")
    pytest.importorskip("fmpy.fmi1")
    from feeddrive.export.fmu import fmu
    from feeddrive.export.targets import write_export
    from fmus import Played

    flags = fmu._FLAGS
    monkeypatch.setattr(fmu, "_FLAGS", (*flags, "-funsafe-math-optimizations"))
    with pytest.raises(FileError, match="cannot make a shared library"):
        write_export("ball_screw", "fmu2", tmp_path / "told")
    monkeypatch.setattr(fmu, "_FLAGS", (*flags, "-funsafe-math-optimizations", *SILENT))
    for version in (2, 3):
        out = tmp_path / f"untold{version}"
        write_export("ball_screw", f"fmu{version}", out)
        (made,) = out.rglob("*.fmu")
        monkeypatch.setattr(Played, "begin", lambda *_, **__: None)
        played = Played(made, out)
        monkeypatch.undo()
        with pytest.raises(fmpy.fmi1.FMICallException):
            played.begin()
        assert any(f"this binary breaks rule {CODE}: {SENTENCE}" in each for *_, each in played.said), played.said
        monkeypatch.setattr(fmu, "_FLAGS", (*flags, "-funsafe-math-optimizations", *SILENT))


@pytest.mark.slow(reason="a bundle in the emulator; the check of single precision is that of the host")
def test_a_microcontroller_refuses(tmp_path: Path) -> None:
    missing = [each for each in cortex_m.PACKAGES if shutil.which(each) is None]
    if missing:
        pytest.skip(f"NOT TESTED on a Cortex-M: apt-get install {' '.join(cortex_m.PACKAGES.values())}")
    bundle = tmp_path / "bundle"
    write_cortex_m(read_design("ball_screw", precision="float"), bundle)
    with pytest.raises(EmulatorError, match="compile without -funsafe-math-optimizations"):
        cortex_m._made(bundle, "OPTIMISE=-O2 -funsafe-math-optimizations", "selftest")
    silent = " ".join(SILENT)
    for flags in ("-funsafe-math-optimizations", "-freciprocal-math", "-ffp-contract=fast"):
        words = f"OPTIMISE=-O2 -ffp-contract=off {flags} {silent}"
        # the last flag of a kind counts: the Makefile has its own behind this one
        made = bundle / "Makefile"
        made.write_text(made.read_text().replace("-ffp-contract=off", ""), encoding="utf-8")
        with pytest.raises(EmulatorError, match=f"rule {CODE} is broken"):
            cortex_m._made(bundle, words, "selftest")


@needs_linuxcnc
@pytest.mark.slow(reason="a component in HAL; the header and the check are those of the quick tests")
def test_a_component_faults(tmp_path: Path) -> None:
    from test_export_linuxcnc import answers

    from feeddrive.export.targets import write_export

    place = write_export("emps", "linuxcnc", tmp_path / "hal")[1].parent
    header = place / "axis_x.h"
    options = '#pragma GCC optimize("no-signed-zeros", "no-trapping-math", "associative-math")\n'
    text = header.read_text(encoding="utf-8")
    at = text.index("#define AXIS_X_SAMPLE_TIME")
    header.write_text(text[:at] + options + text[at:], encoding="utf-8")
    routine = read_design("emps").routine
    inputs = np.zeros((40, len(routine.inputs)))
    inputs[:, 0] = 1e-4
    inputs[5:, -1] = 1.0
    more = [("fault", "b"), ("ok", "b"), ("parameter-bad", "b"), ("parameter-rule", "s")]
    got = answers(routine, place, tmp_path, inputs, more=more).rows
    force = got[:, [v.name for v in routine.outputs].index("force")]
    fault, ok, bad, rule = got[:, len(routine.outputs) :].T
    assert np.all(force == float(routine.loop.control.guard.safe_force))
    assert np.all(rule == CODE)
    assert np.all(bad == 1.0)
    assert np.all(fault[5:] == 1.0)
    assert np.all(ok[5:] == 0.0)
