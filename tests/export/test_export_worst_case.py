"""The bound of a step from its instruction listing, and an emulated core, against docs/internals/step_cost.md."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import pytest

from slow_share import all_but

FOLDER = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(FOLDER))
import step_cost  # noqa: E402
import worst_case  # noqa: E402
from worst_case import Bound, Instruction, ListingError, bound, cycles  # noqa: E402

DOCUMENT = FOLDER.parent / "docs" / "internals" / "step_cost.md"
NAMES = {
    "P-PI": "p_pi",
    "pole placement": "pole_placement",
    "GPI, 7 states": "gpi",
    "DADSC": "dadsc",
    "super-twisting": "super_twisting",
    "LQG": "lqg",
}
ROW = re.compile(
    r"^\| (?P<law>[^|]+) \| (?P<core>M4F|M7), (?P<precision>\w+) \| `(?P<optimise>-O\w)` "
    r"\| (?P<least>\d+) \| (?P<most>\d+) \| (?P<bound>\d+) \| (?P<cycles>\d*) \| (?P<cycle_bound>\d*) "
    r"\| (?P<stack>\d+) \| (?P<stack_bound>\d+) \|$",
    re.MULTILINE,
)
ROWS = [match.groupdict() for match in ROW.finditer(DOCUMENT.read_text(encoding="utf-8"))]
LABELS = [f"{row['law']}, {row['core']} {row['optimise']}" for row in ROWS]
needs_core = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None,
    reason="NOT RUN: no Cortex-M tools: apt-get install make gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm",
)
NEAR = 1.05  # another gcc orders instructions otherwise


def test_the_document_has_a_row_for_each_law_core_and_option() -> None:
    assert {NAMES[row["law"]] for row in ROWS} == set(worst_case.LAWS)
    assert len(ROWS) == 4 * len(worst_case.LAWS)


@needs_core
@pytest.mark.parametrize("label", all_but(["P-PI, M4F -O2"], LABELS, "the same of other laws, cores and options"))
def test_the_stated_cost_is_executed_and_below_the_bound_of_the_listing(label: str) -> None:
    """Over 400 random samples with saturation, broken numbers, trips and starts, on the emulated core."""
    row = ROWS[LABELS.index(label)]
    law = worst_case.LAWS[NAMES[row["law"]]]
    found, most = worst_case.measured(step_cost.design(law, row["precision"]), row["optimise"])
    assert found.instructions[1] <= most.instructions
    assert found.cycles[1] <= most.cycles
    assert found.stack <= most.stack
    stated = [row[key] for key in ("least", "most", "bound", "cycles", "cycle_bound")]
    measured = [*found.instructions, most.instructions, found.cycles[1], most.cycles]
    # an M7 has no cycles in the table
    assert all(not b or a <= NEAR * int(b) for a, b in zip(measured, stated, strict=True)), measured
    assert found.stack <= int(row["stack"]) + 8, "bytes: a pair of registers more"
    assert most.stack <= int(row["stack_bound"]) + 8


def code(*lines: str, start: int = 0x100) -> list[Instruction]:
    """Instructions of four bytes each."""
    return [Instruction(start + 4 * i, text, start + 4 * i + 4) for i, text in enumerate(lines)]


def test_the_longer_side_of_a_branch_counts() -> None:
    """Taken: 3 instructions; not taken: 5. Cycles: a refill of 3 for the branch that is taken and for the return."""
    rows = code("cmp r0, #0", "beq.n 110", "add r0, #1", "add r0, #1", "bx lr")
    found = bound({"f": rows}, "f")
    assert found == Bound(5, max(1 + 1 + 1 + 1 + (1 + 3), 1 + (1 + 3) + (1 + 3)), 0), "each the largest of all paths"
    shorter = code("cmp r0, #0", "beq.n 10c", "add r0, #1", "bx lr")
    assert bound({"f": shorter}, "f") == Bound(4, max(1 + 1 + 1 + 4, 1 + 4 + 4), 0)


def test_a_call_adds_the_path_and_the_stack_of_what_it_calls() -> None:
    caller = code("push {r4, lr}", "bl 200", "sub sp, #8", "pop {r4, pc}")
    called = code("vpush {d8-d9}", "vdiv.f32 s0, s0, s1", "bx lr", start=0x200)
    found = bound({"f": caller, "g": called}, "f")
    # cycles: a call and a return 1 + 3 each, push and pop of two 1 + 2, vpush of four words 1 + 4, a division 14 + 1
    assert found == Bound(7, 3 + (4 + (5 + 15 + 4)) + 1 + (3 + 3), 8 + 8 + 16)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (("add r0, #1", "bne.n 100", "bx lr"), "loop"),
        (("bl 100", "bx lr"), "calls itself"),
        (("ldr pc, [r0]",), "does not name"),
        (("blx r3",), "not known|does not name"),
        (("frobnicate r0",), "not known"),
        (("add r0, #1",), "is not in the function"),
    ],
)
def test_what_bounds_nothing_is_refused(lines: tuple[str, ...], said: str) -> None:
    with pytest.raises(ListingError, match=said):
        bound({"f": code(*lines)}, "f")


def test_cycles_are_those_of_the_table_at_its_upper_ends() -> None:
    """SWCU192, tables 3-25 and 3-27; one more where a floating-point result may be waited for."""
    known = {
        "vadd.f32 s0, s1, s2": 2,
        "vmla.f32 s0, s1, s2": 4,
        "vdiv.f32 s0, s1, s2": 15,
        "vldr s0, [r0, #4]": 2,
        "vstr d8, [sp]": 3,
        "push {r4, r5, lr}": 4,
        "vpop {d8-d9}": 5,
        "ldrd r2, r3, [r0]": 3,
        "udiv r0, r1, r2": 12,
        "vmov r0, r1, d0": 2,
        "vmov s0, r0": 1,
        "movgt r0, #1": 1,
        "addseq r0, r0, r1": 1,
        "ite gt": 1,
        "vmrs APSR_nzcv, fpscr": 1,
    }
    assert {text: cycles(text) for text in known} == known
