"""Bounds on an exported step on a Cortex-M from its instruction listing, beside what an emulated core executes.

python benchmarks/worst_case.py

The step has no loop and no indirect call, so that its longest path through the listing of objdump bounds the executed
instructions of every input; the same path with the cycles of each instruction bounds the cycles of a Cortex-M4F at
zero wait states.  Cycles: Texas Instruments SWCU192 (CC13x2/CC26x2 Technical Reference Manual), tables 3-25 and 3-27.
Where the table gives a range, its end is taken: a pipeline refill P = 3, and one cycle more for every floating-point
result, as if the next instruction waited for it.  Needs gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import feeddrive as fd
from feeddrive.blocks.families import Law
from feeddrive.export.c_bundle import filled
from feeddrive.export.cortex_m import CORES, write_cortex_m
from feeddrive.export.design import Design

sys.path.insert(0, str(Path(__file__).parent))
import step_cost

REFILL = 3  # cycles: the largest P of the table, after a taken branch, a call or a return
_RETURNS = re.compile(r"^bx\s+lr$|^(?:pop|ldmia\.w\s+sp!,|ldmia\s+sp!,).*\bpc\b|^ldr(?:\.w)?\s+pc,\s*\[sp\]")
_BRANCH = re.compile(r"^b(?P<condition>[a-z]{2})?(?:\.[nw])?\s+(?P<target>[0-9a-f]+)\b")
_COMPARE = re.compile(r"^cbn?z\s+\w+,\s*(?P<target>[0-9a-f]+)\b")
_CALL = re.compile(r"^bl\s+(?P<target>[0-9a-f]+)\b")
_LINE = re.compile(r"^\s*(?P<place>[0-9a-f]+):\t(?P<text>[^;@<]+)")
_HEAD = re.compile(r"^(?P<place>[0-9a-f]+) <(?P<name>[^>]+)>:$")
_CONDITIONS = ["eq", "ne", "cs", "cc", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt", "le", "hs", "lo"]


class ListingError(Exception):
    """A listing that bounds nothing: a loop, an indirect branch, or an instruction whose cycles are not known."""


class Bound(NamedTuple):
    """Instructions and cycles of the longest path, and bytes of stack."""

    instructions: int
    cycles: int
    stack: int


class Instruction(NamedTuple):
    """An instruction, its place, and the place behind it."""

    place: int
    text: str
    next: int


def listing(program: Path) -> dict[str, list[Instruction]]:
    """The instructions of each function of a linked program, as objdump lists them."""
    words = ["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", program]
    text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    functions: dict[str, list[tuple[int, str]]] = {}
    name = ""
    for line in text.splitlines():
        if head := _HEAD.match(line):
            name = head["name"]
            functions[name] = []
        elif (found := _LINE.match(line)) and name:
            words_of = " ".join(found["text"].split())
            if not words_of.startswith("."):  # data between functions
                functions[name].append((int(found["place"], 16), words_of))
    return {
        name: [
            Instruction(place, text, rows[i + 1][0] if i + 1 < len(rows) else place + 4)
            for i, (place, text) in enumerate(rows)
        ]
        for name, rows in functions.items()
        if rows
    }


def _registers(text: str) -> int:
    """How many registers stand in braces, of 32 bits each."""
    inside = text[text.index("{") + 1 : text.index("}")]
    count = 0
    for piece in inside.split(","):
        first, _, last = piece.strip().partition("-")
        several = int(last[1:]) - int(first[1:]) + 1 if last else 1
        count += several * (2 if first.startswith("d") else 1)
    return count


_ARITHMETIC = ("vadd", "vsub", "vmul", "vnmul", "vabs", "vneg", "vcvt", "vcmp", "vcmpe", "vcvtr")
_FUSED = ("vmla", "vmls", "vnmla", "vnmls", "vfma", "vfms", "vfnma", "vfnms")
_MANY = {"push", "pop", "vpush", "vpop", "stm", "ldm", "stmia", "ldmia", "stmdb", "vldm", "vldmia", "vstm", "vstmia"}
_LOADS = "ldr str ldrd strd ldrb ldrh strb strh ldrsb ldrsh vldr vstr"
_BRANCHES = "b bl bx cbz cbnz"
_SLOW = "vdiv vsqrt sdiv udiv vmov"
_SINGLE = (
    "add adc adr sub sbc rsb mul mla mls cmp cmn and eor orr orn bic mvn tst teq lsl lsr asr ror mov movw movt "
    "ubfx sbfx bfi bfc uxtb uxth sxtb sxth clz it ite itt itet ittt itte itee iteet ittet ittee itttt ittte iteee "
    "itete itett nop rev vmrs vmsr smull umull"
)
_KNOWN = {*_MANY, *" ".join((_LOADS, _BRANCHES, _SLOW, _SINGLE)).split(), *_ARITHMETIC, *_FUSED}


def _bare(text: str) -> str:
    """The mnemonic without type, width, condition and the `s` that sets flags."""
    word = text.split()[0].split(".")[0]
    if word in _KNOWN:
        return word
    for condition in ("", *_CONDITIONS):
        shorter = word.removesuffix(condition)
        for candidate in (shorter, shorter.removesuffix("s")):
            if candidate in _KNOWN:
                return candidate
    raise ListingError(f"the cycles of '{text}' are not known")


@cache
def cycles(text: str) -> int:
    """The cycles of an instruction on a Cortex-M4F; of a branch those that it takes if it does not branch."""
    word = _bare(text)
    if word in ("vdiv", "vsqrt"):
        return 14 + 1
    if word in _FUSED:
        return 3 + 1
    if word in _ARITHMETIC:
        return 1 + 1
    if word in _MANY:
        return 1 + _registers(text)
    if word in ("ldrd", "strd"):
        return 3
    if word in ("vldr", "vstr"):
        return 3 if re.search(r"\bd\d", text) else 2
    if word.startswith(("ldr", "str")):
        return 2
    if word in ("sdiv", "udiv"):
        return 12
    if word == "vmov":
        return 2 if len(re.findall(r"\br\d+|\bip|\blr|\bsl|\bfp", text)) > 1 else 1
    return 1


def uncounted(_: str) -> int:
    """In place of `cycles` on a Cortex-M7, for which no table is published: it executes up to two at a time."""
    return 0


def stack_of(text: str) -> int:
    """The bytes by which an instruction lowers the stack pointer."""
    word = text.split()[0].split(".")[0]
    if word in ("push", "vpush") or text.startswith("stmdb sp!"):
        return 4 * _registers(text)
    if found := re.match(r"^sub(?:\.w|w)?\s+sp,(?:\s*sp,)?\s*#(\d+)", text):
        return int(found[1])
    if found := re.match(r"^v?strd?(?:\.\w+)?\s+.*\[sp, #-(\d+)\]!", text):
        return int(found[1])
    return 0


Cycles = Callable[[str], int]


def bound(functions: Mapping[str, list[Instruction]], entry: str, cost_of: Cycles = cycles) -> Bound:
    """The longest path of a function through its listing, with those of the functions that it calls.

    Raises ListingError for a loop, a recursion, an indirect branch or an unknown instruction.
    """
    starts = {rows[0].place: name for name, rows in functions.items()}
    owners = {row.place: row for rows in functions.values() for row in rows}
    of_function: dict[str, Bound] = {}
    open_functions: list[str] = []

    def called(name: str) -> Bound:
        if name in open_functions:
            raise ListingError(f"{name} calls itself")
        if name not in of_function:
            open_functions.append(name)
            of_function[name] = _walk(functions[name], owners, starts, called, cost_of)
            open_functions.pop()
        return of_function[name]

    return called(entry)


def _walk(
    rows: list[Instruction],
    owners: Mapping[int, Instruction],
    starts: Mapping[int, str],
    called: Callable[[str], Bound],
    cost_of: Cycles,
) -> Bound:
    inside = {row.place for row in rows}
    longest: dict[int, tuple[int, int]] = {}
    open_places: set[int] = set()
    frame, deepest = sum(stack_of(row.text) for row in rows), 0

    def leaves(row: Instruction) -> tuple[list[tuple[int, int, int]], list[tuple[int, int]]]:
        """Places that follow, each with instructions and cycles on the way, and ends of the function likewise."""
        nonlocal deepest
        text, cost = row.text, cost_of(row.text)
        if _RETURNS.match(text):
            return [], [(0, cost + REFILL)]
        if found := _CALL.match(text):
            one = called(starts[int(found["target"], 16)])
            deepest = max(deepest, one.stack)
            return [(row.next, one.instructions, cost + REFILL + one.cycles)], []
        if found := _BRANCH.match(text):
            target = int(found["target"], 16)
            if target in inside:
                onward, ends = [(target, 0, cost + REFILL)], list[tuple[int, int]]()
            else:  # another function in place of a return
                one = called(starts[target])
                deepest = max(deepest, one.stack)
                onward, ends = [], [(one.instructions, cost + REFILL + one.cycles)]
            if found["condition"] in _CONDITIONS:
                onward.append((row.next, 0, cost))
            return onward, ends
        if found := _COMPARE.match(text):
            return [(int(found["target"], 16), 0, cost + REFILL), (row.next, 0, cost)], []
        if re.match(r"^(?:bx|blx|tb[bh]|mov(?:\.w)?\s+pc|ldr(?:\.w)?\s+pc|b[a-z]*\s+[^0-9a-f])", text):
            conditional = re.match(r"^bx[a-z]{2}\s+lr$", text)
            if conditional:
                return [(row.next, 0, cost)], [(0, cost + REFILL)]
            raise ListingError(f"'{text}' leads to a place that the listing does not name")
        if re.match(r"^pop[a-z]{2}.*\bpc\b|^ldmia[a-z]{2}.*\bpc\b", text):
            return [(row.next, 0, cost)], [(0, cost + REFILL)]
        return [(row.next, 0, cost)], []

    def walk(first: int) -> tuple[int, int]:
        # without recursion: a step has more instructions than Python has frames
        waiting = [first]
        while waiting:
            place = waiting[-1]
            if place in longest:
                waiting.pop()
                continue
            if place not in inside:
                raise ListingError(f"0x{place:x} is not in the function")
            onward, ends = leaves(owners[place])
            missing = [target for target, _, _ in onward if target not in longest]
            if missing:
                if place in open_places:
                    raise ListingError(f"0x{place:x} is in a loop")
                open_places.add(place)
                if open_places & set(missing):
                    raise ListingError(f"0x{place:x} leads back: a loop")
                waiting += missing
                continue
            found = [(1 + n + longest[target][0], c + longest[target][1]) for target, n, c in onward]
            found += [(1 + n, c) for n, c in ends]
            # the longest of each: an upper bound of both, even where they belong to two paths
            longest[place] = (max(n for n, _ in found), max(c for _, c in found))
            open_places.discard(place)
            waiting.pop()
        return longest[first]

    instructions, cost = walk(rows[0].place)
    return Bound(instructions, cost, frame + deepest)


class Executed(NamedTuple):
    """What an emulated core executed in a step, over the stored samples: least and most, and the bytes of stack."""

    instructions: tuple[int, int]
    cycles: tuple[int, int]
    stack: int


def executed(folder: Path, functions: Mapping[str, list[Instruction]], cost_of: Cycles = cycles) -> Executed:
    """From the log of `make steps.log`: each instruction between the two marks, and its cycles by the table."""
    rows = {row.place: row for each in functions.values() for row in each}
    begin, end = (functions[name][0].place for name in ("count_begin", "count_end"))
    counts: list[tuple[int, int]] = []
    places: list[int] = []
    for line in (folder / "steps.log").read_text().splitlines():
        place = int(line.split("/")[1], 16)
        if place == begin:
            places = []
        elif place == end:
            counts.append(_counted(places, rows, cost_of))
        else:
            places.append(place)
    instructions, cost = ([row[i] for row in counts] for i in range(2))
    return Executed((min(instructions), max(instructions)), (min(cost), max(cost)), _stack(folder))


def _counted(places: list[int], rows: Mapping[int, Instruction], cost_of: Cycles) -> tuple[int, int]:
    """Instructions and cycles of a step between the marks."""
    total = 0
    # -1: behind the last one the function returns
    for place, after in zip(places, [*places[1:], -1], strict=True):
        row = rows[place]
        total += cost_of(row.text) + (REFILL if after != row.next else 0)
    return len(places), total


STACK = """\
#include "{P}_prepared.h"
#include "{P}_vectors.h"

#include <stdio.h>

enum {{ WORDS = 1024 }};
static const uint32_t PATTERN = 0xA5C35A3Cu;

int main(void)
{{
    static {P}_controller controller;
    static {P}_inputs inputs;
    static {P}_outputs outputs;
    static int deepest, i;
    (void)expected;
    (void)changes;
    {P}_prepared(&controller);
    for (int k = 0; k < SAMPLES; k++) {{
{filled}
        if (k == 0) {{
            {P}_reset(&controller, &inputs);
        }}
        volatile uint32_t *sp;
        __asm__ volatile("mov %0, sp" : "=r"(sp));
        for (i = 1; i <= WORDS; i++) {{
            sp[-i] = PATTERN;
        }}
        {P}_step(&controller, &inputs, &outputs);
        for (i = WORDS; i > 0 && sp[-i] == PATTERN; i--) {{
        }}
        deepest = i > deepest ? i : deepest;
    }}
    printf("%d\\n", 4 * deepest);
    return 0;
}}
"""


def _stack(folder: Path) -> int:
    """The bytes below the stack pointer that a step wrote, over the stored samples, on the emulated core."""
    P = next(folder.glob("*_prepared.c")).name.removesuffix("_prepared.c")
    objects = f"{P}.o {P}_prepared.o"
    subprocess.run(["make", "-s", "stack.elf", f"OBJECTS={objects}"], cwd=folder, check=True, capture_output=True)
    core = next(line for line in (folder / "Makefile").read_text().splitlines() if line.startswith("CORE ?="))
    machine = CORES[core.split()[-1]].machine
    words = ["qemu-system-arm", "-M", machine, "-nographic", "-monitor", "none", "-serial", "none"]
    words += ["-semihosting-config", "enable=on,target=native", "-kernel", "stack.elf"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True, timeout=120)
    return int(done.stdout.split()[-1])


def measured(made: Design, optimise: str = "-O2") -> tuple[Executed, Bound]:
    """What an emulated core executes in a step of a design, and the bounds of its listing."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "bundle"
        write_cortex_m(made, folder)
        text = STACK.format(P=made.name, filled=filled(made.routine))
        (folder / "selftest" / "stack.c").write_text(text)
        subprocess.run(["make", "-s", "steps.log", f"OPTIMISE={optimise}"], cwd=folder, check=True, capture_output=True)
        functions = listing(folder / "count.elf")
        cost_of = cycles if made.layout.precision == "float" else uncounted
        return executed(folder, functions, cost_of), bound(functions, f"{made.name}_step", cost_of)


LAWS: dict[str, Law] = {
    **step_cost.LAWS,
    "dadsc": fd.blocks.DADSC(
        mass=163.0, viscous=1520.0, tracking_rate=120.0, reaching_rate=120.0, adaptation_rate=60.0
    ),
    "super_twisting": fd.blocks.SuperTwisting(
        mass=163.0, viscous=1520.0, tracking_rate=120.0, zone_time=2e-3, disturbance_rate=2e3
    ),
    "lqg": fd.blocks.LQG(model=fd.blocks.Rigid(mass=163.0, viscous=1520.0), omega_c=80.0, omega_o=300.0),
}


def main() -> None:
    """The table of docs/internals/step_cost.md."""
    print("| law | core | | instructions: least | most | bound | cycles: most | bound | stack | bound |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, law in LAWS.items():
        for precision, core in (("float", "M4F"), ("double", "M7")):
            for optimise in ("-O2", "-Os"):
                found, most = measured(step_cost.design(law, precision), optimise)
                cost = (found.cycles[1], most.cycles) if precision == "float" else ("", "")
                cells = [name, f"{core}, {precision}", f"`{optimise}`", *found.instructions, most.instructions, *cost]
                print("|", " | ".join(map(str, [*cells, found.stack, most.stack])), "|", flush=True)


if __name__ == "__main__":
    main()
