"""The machine code of a plan: its operations and its time loop as LLVM text, and the compiled function.

Operations are scalar, or vectors with one variant per lane.  A value that is the same in all lanes stays scalar and is
broadcast where a vector needs it.  No pass reorders anything: LLVM only selects instructions and registers.

The whole time loop is one function:

    void name(i64 count, i64 first, double *constants, double *inputs, double *states, double *outputs, double **tables,
              i64 row, i64 column)

Constants, and states followed by the cells of ring buffers, are laid out as [value][lane], and outputs as
[sample][value][lane].  Inputs are the same for all lanes; `row` is their stride from sample to sample and `column` the
stride from value to value, so each input may be a separate row.  Separate rows for the outputs made the loop 8 %
slower.  Values that do not change from sample to sample are computed before the loop.
"""

import ctypes
from collections.abc import Callable, Sequence

import numpy as np

from feeddrive.language.graph import ELEMENTARY, arguments
from feeddrive.language.machine_code import machine_code, number, target
from feeddrive.language.primitives import MIX, STRIDES
from feeddrive.loop.engine.plan import Branch, Plan, lazy_branches

_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
# ordered comparisons: with a NaN they are false, as in Python
_COMPARE = {"lt": "olt", "le": "ole", "eq": "oeq"}
_LOGIC = {"and": "and", "or": "or"}
_INTRINSIC = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor"}
# x + 1.5·2⁵² holds the whole number x in its low bits
_SHIFTER = 6755399441055744.0


class Printer:
    """The writer of one function as LLVM text; it collects the lines of one basic block after another."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        # lanes may take different branches: with several lanes both sides are computed
        self.branches = lazy_branches(plan) if plan.lanes == 1 else {}
        self.aside = {index for inner in self.branches.values() for index in inner}
        self.lines: list[str] = []
        self.block = "entry"  # the label under which lines are written
        self.names: dict[int, str] = {}  # node -> value, scalar or vector as its kind says
        self.spread: dict[str, str] = {}  # scalar value -> vector value, within the part being written
        self.count = 0
        # "contract" alone allows a fused a·b + c; "fast" would reorder sums as well
        self.flag = " contract" if plan.arithmetic == "fma" else ""

    def fresh(self) -> str:
        """Return a new local name."""
        self.count += 1
        return f"%v{self.count}"

    def emit(self, text: str) -> str:
        """Write a line that defines a new value; return its name."""
        name = self.fresh()
        self.lines.append(f"  {name} = {text}")
        return name

    def varies(self, node: int) -> bool:
        """True if the value of a node differs between lanes and is therefore a vector."""
        return self.plan.lanes > 1 and self.plan.kinds.varying[node]

    def type(self, vector: bool, scalar: str = "double") -> str:
        """Return the LLVM type of a value, vector or scalar."""
        return f"<{self.plan.lanes} x {scalar}>" if vector else scalar

    def value(self, node: int, vector: bool) -> str:
        """Return the value of a node as a scalar or a vector, as needed."""
        held = self.names[node]
        if not vector or self.varies(node):
            return held
        if held not in self.spread:
            kind = "i1" if self.plan.kinds.truth[node] else "double"
            self.spread[held] = self.splat(held, kind)
        return self.spread[held]

    def splat(self, held: str, kind: str) -> str:
        """Broadcast a scalar to every lane."""
        lanes = self.plan.lanes
        first = self.emit(f"insertelement <{lanes} x {kind}> poison, {kind} {held}, i32 0")
        mask = f"<{lanes} x i32> zeroinitializer"
        return self.emit(f"shufflevector <{lanes} x {kind}> {first}, <{lanes} x {kind}> poison, {mask}")

    def whole(self, value: int, vector: bool) -> str:
        """Return a 64-bit integer constant as an operand."""
        # LLVM reads decimal constants as signed
        signed = value - 2**64 if value >= 2**63 else value
        return str(signed) if not vector else "<" + ", ".join([f"i64 {signed}"] * self.plan.lanes) + ">"

    def real(self, value: float, vector: bool) -> str:
        """Return a double constant as an operand."""
        text = number(value)
        return text if not vector else "<" + ", ".join([f"double {text}"] * self.plan.lanes) + ">"

    def load(self, base: str, place: int, vector: bool) -> str:
        """Load a number from memory with the layout [number][lane]."""
        at = self.emit(f"getelementptr double, ptr {base}, i64 {place * self.plan.lanes}")
        # the memory is numpy's, which aligns numbers, not vectors
        return self.emit(f"load {self.type(vector)}, ptr {at}, align 8")

    def taken(self) -> list[str]:
        """Return the lines written so far, and clear them."""
        lines, self.lines = self.lines, []
        return lines

    def begin(self, label: str) -> None:
        """Start a new basic block."""
        self.block = label
        self.lines.append(f"{label}:")

    def store(self, held: str, at: str) -> None:
        """Store a number to memory with the layout [number][lane]."""
        self.lines.append(f"  store {self.type(self.plan.lanes > 1)} {held}, ptr {at}, align 8")

    def node(self, index: int) -> None:
        """Write the operation of a node."""
        node = self.plan.graph.nodes[index]
        name, inner = node[0], arguments(node)
        if name in ("input", "table", "ring") or (index in self.plan.together and index in self.names):
            return
        vector = self.varies(index)
        kind = self.type(vector)
        if name == "const":
            self.names[index] = number(float.fromhex(node[1]))
            return
        if name == "truth":
            self.names[index] = "true" if node[1] else "false"
            return
        if name == "gather":
            self.names[index] = self.gather(inner[0], inner[1], vector)
            return
        if name == "get":
            self.names[index] = self.get(inner[0], inner[1], vector)
            return
        if name == "put":
            self.put(*inner)
            self.names[index] = self.names[inner[0]]
            return
        compared = name in _COMPARE
        values = [self.value(i, vector) for i in inner] if name != "select" else []
        if name in _BINARY:
            self.names[index] = self.emit(f"{_BINARY[name]}{self.flag} {kind} {values[0]}, {values[1]}")
        elif compared:
            self.names[index] = self.emit(f"fcmp {_COMPARE[name]} {kind} {values[0]}, {values[1]}")
        elif name in _LOGIC:
            self.names[index] = self.emit(f"{_LOGIC[name]} {self.type(vector, 'i1')} {values[0]}, {values[1]}")
        elif name == "not":
            ones = "true" if not vector else self.splat("true", "i1")
            self.names[index] = self.emit(f"xor {self.type(vector, 'i1')} {values[0]}, {ones}")
        elif name == "neg":
            self.names[index] = self.emit(f"fneg {kind} {values[0]}")
        elif name in _INTRINSIC:
            suffix = f"v{self.plan.lanes}f64" if vector else "f64"
            self.names[index] = self.emit(f"call {kind} @llvm.{_INTRINSIC[name]}.{suffix}({kind} {values[0]})")
        elif name == "select":
            self.select(index, inner, vector)
        elif name == "power_of_two":
            self.names[index] = self.power_of_two(values[0], vector)
        elif name == "exponent":
            self.names[index] = self.exponent(values[0], vector)
        elif name == "uniform":
            self.names[index] = self.uniform(values, vector)
        elif name in ELEMENTARY:
            self.names[index] = self.library(name, values[0], vector)
        else:
            raise AssertionError(f"no text for the operation '{name}'")

    def select(self, index: int, inner: tuple[int, ...], vector: bool) -> None:
        """Emit code that selects one of two values, with one condition for all lanes or one per lane."""
        group = self.plan.together.get(index, (index,))
        if Branch(group[0], 1) in self.branches or Branch(group[0], 2) in self.branches:
            self.branch(group)
            return
        kind = self.type(vector, "i1" if self.plan.kinds.truth[index] else "double")
        per_lane = vector and self.varies(inner[0])
        condition = f"{self.type(per_lane, 'i1')} {self.names[inner[0]]}"
        a, b = self.value(inner[1], vector), self.value(inner[2], vector)
        self.names[index] = self.emit(f"select {condition}, {kind} {a}, {kind} {b}")

    def branch(self, group: tuple[int, ...]) -> None:
        """Write selections with a common condition so that only the branch taken is computed."""
        first, nodes = group[0], self.plan.graph.nodes
        labels = {branch: f"branch{first}.{branch}" for branch in (1, 2)}
        self.lines.append(f"  br i1 {self.names[arguments(nodes[first])[0]]}, label %{labels[1]}, label %{labels[2]}")
        ends: dict[int, list[str]] = {index: [] for index in group}
        for branch in (1, 2):
            self.begin(labels[branch])
            for one in self.branches.get(Branch(first, branch), ()):
                self.node(one)
            for index in group:
                # the block in which the branch ends, which is another one after an inner branch
                ends[index].append(f"[ {self.names[arguments(nodes[index])[branch]]}, %{self.block} ]")
            self.lines.append(f"  br label %after{first}")
        self.begin(f"after{first}")
        for index in group:
            kind = "i1" if self.plan.kinds.truth[index] else "double"
            self.names[index] = self.emit(f"phi {kind} {', '.join(ends[index])}")

    def power_of_two(self, k: str, vector: bool) -> str:
        """Write 2ᵏ by placing k + 1023 in the exponent bits of a double."""
        kind, whole = self.type(vector), self.type(vector, "i64")
        shifted = self.emit(f"fadd {kind} {k}, {self.real(_SHIFTER, vector)}")
        bits = self.emit(f"bitcast {kind} {shifted} to {whole}")
        biased = self.emit(f"add {whole} {bits}, {self.whole(1023, vector)}")
        placed = self.emit(f"shl {whole} {biased}, {self.whole(52, vector)}")
        return self.emit(f"bitcast {whole} {placed} to {kind}")

    def exponent(self, x: str, vector: bool) -> str:
        """Return the exponent bits as a double."""
        kind, whole = self.type(vector), self.type(vector, "i64")
        bits = self.emit(f"bitcast {kind} {x} to {whole}")
        down = self.emit(f"lshr {whole} {bits}, {self.whole(52, vector)}")
        kept = self.emit(f"and {whole} {down}, {self.whole(0x7FF, vector)}")
        return self.minus(self.from_whole(kept, vector), 1023.0, vector)

    def from_whole(self, bits: str, vector: bool) -> str:
        """Convert an integer below 2⁵² to a double: write it into the bits of 2⁵², then subtract 2⁵²."""
        kind, whole = self.type(vector), self.type(vector, "i64")
        held = self.emit(f"or {whole} {bits}, {self.whole(0x4330000000000000, vector)}")
        return self.minus(self.emit(f"bitcast {whole} {held} to {kind}"), 2.0**52, vector)

    def minus(self, x: str, constant: float, vector: bool) -> str:
        """Subtract a constant."""
        return self.emit(f"fsub {self.type(vector)} {x}, {self.real(constant, vector)}")

    def uniform(self, values: list[str], vector: bool) -> str:
        """Write the bit mixing of `primitives.uniform`."""
        whole, kind = self.type(vector, "i64"), self.type(vector)
        bits = self.whole(0, vector)
        for value, stride in zip(values, STRIDES, strict=True):
            seed = self.emit(f"fptoui {kind} {value} to {whole}")
            bits = self.emit(f"add {whole} {bits}, {seed}")
            bits = self.emit(f"add {whole} {bits}, {self.whole(1, vector)}")
            bits = self.emit(f"mul {whole} {bits}, {self.whole(stride, vector)}")
            for shift, factor in zip((30, 27), MIX, strict=True):
                down = self.emit(f"lshr {whole} {bits}, {self.whole(shift, vector)}")
                mixed = self.emit(f"xor {whole} {bits}, {down}")
                bits = self.emit(f"mul {whole} {mixed}, {self.whole(factor, vector)}")
            down = self.emit(f"lshr {whole} {bits}, {self.whole(31, vector)}")
            bits = self.emit(f"xor {whole} {bits}, {down}")
        upper = self.emit(f"lshr {whole} {bits}, {self.whole(12, vector)}")
        # the middle of one of 2⁵² intervals: never 0 or 1, whose logarithm a normal number could not take
        centred = self.minus(self.from_whole(upper, vector), -0.5, vector)
        return self.emit(f"fmul {kind} {centred}, {self.real(2.0**-52, vector)}")

    def library(self, name: str, x: str, vector: bool) -> str:
        """Call a function of the system's math library, lane by lane."""
        if not vector:
            return self.emit(f"call double @{name}(double {x})")
        return self.by_lane(lambda one: self.emit(f"call double @{name}(double {one})"), x)

    def gather(self, table: int, place: int, vector: bool) -> str:
        """Read from a table at a valid index."""

        def read(one: str) -> str:
            offset = self.emit(f"fptosi double {one} to i64")
            at = self.emit(f"getelementptr double, ptr {self.names[table]}, i64 {offset}")
            return self.emit(f"load double, ptr {at}, align 8")

        return self.by_lane(read, self.names[place]) if vector else read(self.names[place])

    def get(self, ring: int, place: int, vector: bool) -> str:
        """Read a cell of a ring buffer: the same cell in all lanes, or a different one per lane."""
        if not vector:
            return self.emit(f"load double, ptr {self.cell(ring, self.names[place], 0)}, align 8")
        if not self.varies(place):
            return self.emit(f"load {self.type(True)}, ptr {self.cell(ring, self.names[place], 0)}, align 8")
        total = "poison"
        for lane in range(self.plan.lanes):
            one = self.emit(f"extractelement {self.type(True)} {self.names[place]}, i32 {lane}")
            held = self.emit(f"load double, ptr {self.cell(ring, one, lane)}, align 8")
            total = self.emit(f"insertelement {self.type(True)} {total}, double {held}, i32 {lane}")
        return total

    def put(self, ring: int, place: int, value: int) -> None:
        """Overwrite a cell of a ring buffer in place."""
        held = self.value(value, self.plan.lanes > 1)
        if not self.varies(place):
            self.store(held, self.cell(ring, self.names[place], 0))
            return
        for lane in range(self.plan.lanes):
            at = self.emit(f"extractelement {self.type(True)} {self.names[place]}, i32 {lane}")
            one = self.emit(f"extractelement {self.type(True)} {held}, i32 {lane}")
            self.lines.append(f"  store double {one}, ptr {self.cell(ring, at, lane)}, align 8")

    def cell(self, ring: int, place: str, lane: int) -> str:
        """Return the address of a cell of a ring buffer, which lies in the memory of the states."""
        offset = self.emit(f"fptosi double {place} to i64")
        if self.plan.lanes > 1:
            offset = self.emit(f"mul i64 {offset}, {self.plan.lanes}")
        if lane:
            offset = self.emit(f"add i64 {offset}, {lane}")
        return self.emit(f"getelementptr double, ptr {self.names[ring]}, i64 {offset}")

    def by_lane(self, function: Callable[[str], str], x: str) -> str:
        """Write a scalar operation separately for each lane."""
        lanes = self.plan.lanes
        kind = self.type(True)
        total = "poison"
        for lane in range(lanes):
            one = self.emit(f"extractelement {kind} {x}, i32 {lane}")
            total = self.emit(f"insertelement {kind} {total}, double {function(one)}, i32 {lane}")
        return total


def intrinsics(plan: Plan) -> list[str]:
    """Return the declarations of all functions that the operations of a plan call."""
    used = {plan.graph.nodes[i][0] for i in plan.order}
    kinds = [("f64", "double")]
    if plan.lanes > 1:
        kinds.append((f"v{plan.lanes}f64", f"<{plan.lanes} x double>"))
    built_in = [
        f"declare {kind} @llvm.{_INTRINSIC[name]}.{suffix}({kind})"
        for name in sorted(used & set(_INTRINSIC))
        for suffix, kind in kinds
    ]
    return built_in + [f"declare double @{name}(double)" for name in sorted(used & ELEMENTARY)]


_ARGUMENTS = (
    "i64 %count, i64 %first, ptr noalias readonly %constants, ptr noalias readonly %inputs, "
    "ptr noalias %states, ptr noalias %outputs, ptr noalias readonly %tables, "
    "i64 %row, i64 %column"
)
# Vectors as wide as the processor has them, and a stack on which none of them straddles two cache lines.
_ATTRIBUTES = 'nounwind alignstack=64 "min-legal-vector-width"="512" "prefer-vector-width"="512"'


def text(plan: Plan, name: str, target: str, *, flush: bool = True) -> str:
    """Return the LLVM module of a plan for a target triple; with `flush`, subnormal numbers become 0 on x86 and
    aarch64.
    """
    writer = _TimeLoop(plan)
    entry = writer.entry()
    body = writer.body()
    done = writer.done()
    declare, set_mode, restore = _flush(target) if flush else ([], [], [])
    return "\n".join(
        [
            f'target triple = "{target}"',
            *declare,
            *intrinsics(plan),
            f"define void @{name}({_ARGUMENTS}) #0 {{",
            "begin:",
            *set_mode,
            "  br label %entry",
            "entry:",
            *entry,
            "  %any = icmp sgt i64 %count, 0",
            "  br i1 %any, label %loop, label %done",
            "loop:",
            f"  %k = phi i64 [ 0, %entry ], [ %k.next, %{writer.last} ]",
            *writer.joins,
            *body,
            "  %k.next = add i64 %k, 1",
            "  %more = icmp slt i64 %k.next, %count",
            "  br i1 %more, label %loop, label %done",
            "done:",
            *done,
            "  br label %restore",
            "restore:",
            *restore,
            "  ret void",
            "}",
            f"attributes #0 = {{ {_ATTRIBUTES} }}",
            "",
        ]
    )


class _TimeLoop:
    """The three parts of the function, to be written in this order: `entry`, `body`, `done`."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.printer = Printer(plan)
        self.needed = set(plan.order)
        self.places = {state.name: i for i, state in enumerate(plan.states)}
        self.carried = [state for state in plan.states if state.before != state.after]
        self.begins: dict[str, str] = {}  # value of each state before the loop
        self.ends: dict[str, str] = {}  # its value at the end of a sample
        self.joins: list[str] = []  # its value at the start of a sample, as phis
        self.inputs: dict[int, str] = {}  # where each input that is read begins, by node
        self.last = ""  # the block in which a sample ends

    def entry(self) -> list[str]:
        """Write the code for all values that are constant over the run, and for the initial states."""
        plan, printer = self.plan, self.printer
        moving = plan.kinds.moving
        for i, (_, node) in enumerate(plan.tables):
            at = printer.emit(f"getelementptr ptr, ptr %tables, i64 {i}")
            printer.names[node] = printer.emit(f"load ptr, ptr {at}, align 8")
        first = len(plan.states)
        for _, node, length in plan.rings:
            printer.names[node] = printer.emit(f"getelementptr double, ptr %states, i64 {first * plan.lanes}")
            first += length
        for i, (_, node) in enumerate(plan.inputs):
            if node in self.needed:
                offset = printer.emit(f"mul i64 {i}, %column")
                self.inputs[node] = printer.emit(f"getelementptr double, ptr %inputs, i64 {offset}")
        for i, (_, node) in enumerate(plan.constants):
            if node in self.needed:
                printer.names[node] = printer.load("%constants", i, printer.varies(node))
        for state in plan.states:
            held = printer.load("%states", self.places[state.name], printer.varies(state.before))
            if state.before == state.after:
                printer.names[state.before] = held
            self.begins[state.name] = held
        for index in plan.order:
            if not moving[index]:
                printer.node(index)
        # broadcast before the loop, so that no sample repeats it
        for index in plan.order:
            for i in arguments(plan.graph.nodes[index]):
                wanted = moving[index] and not moving[i] and printer.varies(index) and not printer.varies(i)
                if wanted and plan.graph.nodes[i][0] not in ("table", "ring"):
                    printer.value(i, True)
        return printer.taken()

    def body(self) -> list[str]:
        """Return the lines of code that compute one sample."""
        plan, printer = self.plan, self.printer
        # a vector that is made in the loop does not exist behind it
        outside = dict(printer.spread)
        printer.block = "loop"
        for state in self.carried:
            printer.names[state.before] = printer.fresh()
        if plan.sample is not None and plan.sample in self.needed:
            count = printer.emit("add i64 %first, %k")
            printer.names[plan.sample] = printer.emit(f"sitofp i64 {count} to double")
        row = printer.emit("mul i64 %k, %row")
        for node, begin in self.inputs.items():
            at = printer.emit(f"getelementptr double, ptr {begin}, i64 {row}")
            printer.names[node] = printer.emit(f"load double, ptr {at}, align 8")
        for index in plan.order:
            if plan.kinds.moving[index] and index not in printer.aside:
                printer.node(index)
        row = printer.emit(f"mul i64 %k, {len(plan.outputs) * plan.lanes}")
        for i, (_, node) in enumerate(plan.outputs):
            place = printer.emit(f"add i64 {row}, {i * plan.lanes}")
            at = printer.emit(f"getelementptr double, ptr %outputs, i64 {place}")
            printer.store(printer.value(node, plan.lanes > 1), at)
        for state in self.carried:
            self.ends[state.name] = printer.value(state.after, printer.varies(state.before))
        self.last = printer.block
        self.joins = [f"  {printer.names[state.before]} = {self._join(state.name)}" for state in self.carried]
        printer.spread = outside
        return printer.taken()

    def done(self) -> list[str]:
        """Write the final states back to memory; a state that is the same in all lanes is written to every lane."""
        plan, printer = self.plan, self.printer
        lasts = {state.name: printer.emit(self._join(state.name)) for state in self.carried}
        for state in self.carried:
            held = lasts[state.name]
            if plan.lanes > 1 and not printer.varies(state.before):
                held = printer.splat(held, "double")
            at = printer.emit(f"getelementptr double, ptr %states, i64 {self.places[state.name] * plan.lanes}")
            printer.store(held, at)
        return printer.taken()

    def _join(self, name: str) -> str:
        """Return the phi instruction of a state, which takes its initial value or its value at the end of the previous
        sample.
        """
        kind = self.printer.type(self.printer.varies(self.plan.states[self.places[name]].before))
        return f"phi {kind} [ {self.begins[name]}, %entry ], [ {self.ends[name]}, %{self.last} ]"


def _flush(target: str) -> tuple[list[str], list[str], list[str]]:
    """Return the declarations for flush-to-zero mode (subnormal numbers count as 0), and the lines that set and restore
    it.
    """
    if target.startswith("x86_64"):
        return (
            ["declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)"],
            [
                "  %mode.old = alloca i32, align 4",
                "  %mode.new = alloca i32, align 4",
                "  call void @llvm.x86.sse.stmxcsr(ptr %mode.old)",
                "  %mode = load i32, ptr %mode.old, align 4",
                # 0x8040: results flush to zero, and subnormal operands are zero
                "  %mode.set = or i32 %mode, 32832",
                "  store i32 %mode.set, ptr %mode.new, align 4",
                "  call void @llvm.x86.sse.ldmxcsr(ptr %mode.new)",
            ],
            ["  call void @llvm.x86.sse.ldmxcsr(ptr %mode.old)"],
        )
    if target.startswith(("aarch64", "arm64")):
        return (
            ["declare i64 @llvm.aarch64.get.fpcr()", "declare void @llvm.aarch64.set.fpcr(i64)"],
            [
                "  %mode = call i64 @llvm.aarch64.get.fpcr()",
                # bit 24 of FPCR: flush to zero, for operands and results
                "  %mode.set = or i64 %mode, 16777216",
                "  call void @llvm.aarch64.set.fpcr(i64 %mode.set)",
            ],
            ["  call void @llvm.aarch64.set.fpcr(i64 %mode)"],
        )
    return [], [], []


_SIGNATURE = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 5, *[ctypes.c_int64] * 2)
_NUMBER = 8  # bytes
_ENTRY = "feeddrive_run"


class Native:
    """A compiled plan, which owns its machine code."""

    def __init__(self, plan: Plan, source: str, *, quick: bool = False) -> None:
        """Compile a plan; for `quick` see `native`."""
        self.plan = plan
        # kept, since the memory of the function is freed with it
        self._code = machine_code(source, [_ENTRY], effort=0 if quick else 2)
        self.key = self._code.key
        self._call = _SIGNATURE(self._code.addresses[_ENTRY])

    def run(
        self,
        count: int,
        first: int,
        constants: np.ndarray,
        inputs: np.ndarray,
        states: np.ndarray,
        outputs: np.ndarray | None,
        tables: Sequence[np.ndarray],
    ) -> None:
        """Compute `count` samples, beginning with sample `first`; update `states` and fill `outputs` in place.

        The shapes are constants (n, lanes), inputs (count, n), states (n, lanes) and outputs (count, n, lanes). All
        arrays are float64 in C order, except that the inputs may have any strides.
        """
        rows = (ctypes.c_void_p * max(1, len(tables)))(*[row.ctypes.data for row in tables])
        written = 0 if outputs is None else outputs.ctypes.data
        memory = constants.ctypes.data, inputs.ctypes.data, states.ctypes.data, written, ctypes.addressof(rows)
        self.run_at(count, first, memory, inputs.strides)

    def run_at(self, count: int, first: int, memory: Sequence[int], strides: Sequence[int]) -> None:
        """Run with `memory`, the addresses of constants, inputs, states, outputs and tables; `strides` are those of the
        inputs, in bytes.
        """
        self._call(count, first, *memory, *[stride // _NUMBER for stride in strides])


def native(plan: Plan, *, flush: bool = True, quick: bool = False) -> Native:
    """Return the machine code of a plan.

    flush  flush subnormal numbers to zero; plain Python keeps them
    quick  compile in a third of the time to slower code, for a plan that runs only once
    """
    return Native(plan, text(plan, _ENTRY, target()[0], flush=flush), quick=quick)
