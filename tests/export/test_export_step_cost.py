"""What an exported step costs: instructions, counted by valgrind and by an emulator, against C by hand. No times."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.export.design import trial
from feeddrive.loop.routine import run
from slow_share import all_but

FOLDER = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(FOLDER))
import step_cost  # noqa: E402

NAMES = all_but(
    set(step_cost.LAWS) - {"gpi"},
    sorted(step_cost.LAWS),
    "an emulator runs thousands of lines of its configure",
)

needs_valgrind = pytest.mark.skipif(
    shutil.which("valgrind") is None or shutil.which("gcc") is None,
    reason="gcc and valgrind are not both there: apt-get install gcc libc6-dev valgrind",
)
needs_core = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None,
    reason="no Cortex-M tools: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm",
)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not there: apt-get install gcc libc6-dev")
@pytest.mark.parametrize("name", NAMES)
def test_c_by_hand_computes_what_the_simulator_does(name: str, tmp_path: Path):
    """Otherwise the comparison of instructions would be one of two different laws."""
    made = step_cost.design(step_cost.LAWS[name])
    library = tmp_path / "hand.so"
    source = step_cost.BY_HAND / f"{name}.c"
    subprocess.run(["gcc", *step_cost.FLAGS, "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    step = ctypes.CDLL(str(library)).hand_step
    inputs = trial(made.routine, 20_000, 5, broken=0.01).inputs
    inputs[np.abs(inputs) < 1e-300] = 0.0  # this process keeps numbers below the normal ones, the simulator does not
    inputs[0] = np.nan_to_num(inputs[0])
    held = step_cost.hand_numbers(made, inputs[0])
    found = np.empty((len(inputs), 4))
    for row, out in zip(inputs, found, strict=True):
        step(held.ctypes, np.ascontiguousarray(row).ctypes, out.ctypes)
    expected = run(made.routine, inputs, {})
    assert {0.0, 1.0} <= set(expected[:, 2])
    assert np.max(np.abs(expected[:, 0])) == step_cost.LIMIT
    assert found.tobytes() == expected.tobytes()


@needs_valgrind
@pytest.mark.parametrize("name", all_but(["p_pi"], step_cost.LAWS, "the same for a longer step"))
def test_exported_c_takes_no_more_than_a_fifth_over_c_by_hand(name: str):
    made = step_cost.design(step_cost.LAWS[name])
    ours, theirs = step_cost.generated_counts(made), step_cost.hand_counts(name, made)
    assert all(ours[situation] <= 1.2 * theirs[situation] for situation in ours), (ours, theirs)
    usual = ours["usual"]
    assert ours["subnormal setpoint"] == usual  # no number is slower than another
    assert abs(ours["saturated"] - usual) <= 3.0  # pole placement freezes its integral
    assert max(ours.values()) <= usual + 40.0  # what hangs on faults is bounded: see docs/internals/step_cost.md


BOUNDS = {"p_pi": (121, 160), "pole_placement": (151, 191), "gpi": (305, 341)}  # usual and most; gcc 12.2


@needs_core
def test_parts_of_the_guard_that_are_left_out_are_not_paid_for() -> None:
    """P-PI in float on an M4F: usual and most; 5 % as below, the figures of docs/internals/step_cost.md."""
    law = step_cost.LAWS["p_pi"]
    bare = step_cost.core_cost(step_cost.design(law, "float", (), None))
    least = step_cost.core_cost(step_cost.design(law, "float", (), step_cost.LEAST))
    assert bare.least == bare.most <= 1.05 * 67
    assert least.least <= 1.05 * 99
    assert least.most <= 1.05 * 125
    assert least.memory < 176  # bytes, of the default guard


@needs_core
@pytest.mark.parametrize("name", all_but(["p_pi"], step_cost.LAWS, "the same for a longer step"))
def test_executed_instructions_on_a_cortex_m4f(name: str):
    """With the whole guard; a biquad costs at most 25 more."""
    law = step_cost.LAWS[name]
    cost = step_cost.core_cost(step_cost.design(law, "float"))
    filtered = step_cost.core_cost(step_cost.design(law, "float", (fd.blocks.Notch(frequency=400.0),)))
    least, most = BOUNDS[name]
    assert cost.least <= 1.05 * least
    assert cost.most <= 1.05 * most
    assert filtered.least - cost.least <= 25
    assert name != "gpi" or cost.least <= 320
