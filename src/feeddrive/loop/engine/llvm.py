"""A plan as LLVM text: the whole time loop, scalar or with one variant per lane of a vector.

What does not change from sample to sample is computed before the loop.  What is the same in all lanes stays scalar and
is spread when a vector needs it.  No pass reorders anything: LLVM only selects instructions and registers.

    void name(i64 count, i64 first, double *constants, double *inputs, double *states, double *outputs, double **tables)

Memory: constants and states [number][lane], inputs [sample][number] (the same for all lanes), outputs
[sample][number][lane].
"""

from __future__ import annotations

import struct

from feeddrive.language.graph import ELEMENTARY, arguments
from feeddrive.language.primitives import MIX, STRIDES
from feeddrive.loop.engine.plan import Plan

_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_COMPARE = {"lt": "olt", "le": "ole", "eq": "oeq"}
_LOGIC = {"and": "and", "or": "or"}
_INTRINSIC = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor"}
# x + 1.5·2⁵² holds the whole number x in its low bits
_SHIFTER = 6755399441055744.0


def number(value: float) -> str:
    """A double as LLVM writes it, by its bits."""
    return f"0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"


class Printer:
    """Writes the lines of one function."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.lines: list[str] = []
        self.names: dict[int, str] = {}  # node -> value, scalar or vector as its kind says
        self.spread: dict[str, str] = {}  # scalar value -> vector value, within the part being written
        self.count = 0
        self.flag = " contract" if plan.arithmetic == "fma" else ""

    def fresh(self) -> str:
        """A new local name."""
        self.count += 1
        return f"%v{self.count}"

    def emit(self, text: str) -> str:
        """A line that defines a new value."""
        name = self.fresh()
        self.lines.append(f"  {name} = {text}")
        return name

    def varies(self, node: int) -> bool:
        """Whether a node is a vector."""
        return self.plan.lanes > 1 and self.plan.kinds.varying[node]

    def type(self, vector: bool, scalar: str = "double") -> str:
        """The type of a value."""
        return f"<{self.plan.lanes} x {scalar}>" if vector else scalar

    def value(self, node: int, vector: bool) -> str:
        """A node's value in the shape that is needed."""
        held = self.names[node]
        if not vector or self.varies(node):
            return held
        if held not in self.spread:
            kind = "i1" if self.plan.kinds.truth[node] else "double"
            self.spread[held] = self.splat(held, kind)
        return self.spread[held]

    def splat(self, held: str, kind: str) -> str:
        """A scalar in every lane."""
        lanes = self.plan.lanes
        first = self.emit(f"insertelement <{lanes} x {kind}> poison, {kind} {held}, i32 0")
        mask = f"<{lanes} x i32> zeroinitializer"
        return self.emit(f"shufflevector <{lanes} x {kind}> {first}, <{lanes} x {kind}> poison, {mask}")

    def whole(self, value: int, vector: bool) -> str:
        """A 64-bit whole number as an operand."""
        signed = value - 2**64 if value >= 2**63 else value
        return str(signed) if not vector else "<" + ", ".join([f"i64 {signed}"] * self.plan.lanes) + ">"

    def real(self, value: float, vector: bool) -> str:
        """A double as an operand."""
        text = number(value)
        return text if not vector else "<" + ", ".join([f"double {text}"] * self.plan.lanes) + ">"

    def load(self, base: str, place: int, vector: bool) -> str:
        """A number from memory that is laid out by lanes."""
        at = self.emit(f"getelementptr double, ptr {base}, i64 {place * self.plan.lanes}")
        return self.emit(f"load {self.type(vector)}, ptr {at}, align 8")

    def node(self, index: int) -> None:
        """One operation."""
        node = self.plan.graph.nodes[index]
        name, inner = node[0], arguments(node)
        if name in ("input", "table"):
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
            self.names[index] = self.select(index, inner, vector)
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

    def select(self, index: int, inner: tuple[int, ...], vector: bool) -> str:
        """A choice between two values, by one truth for all lanes or one for each."""
        kind = self.type(vector, "i1" if self.plan.kinds.truth[index] else "double")
        each = vector and self.varies(inner[0])
        condition = f"{self.type(each, 'i1')} {self.names[inner[0]]}"
        a, b = self.value(inner[1], vector), self.value(inner[2], vector)
        return self.emit(f"select {condition}, {kind} {a}, {kind} {b}")

    def power_of_two(self, k: str, vector: bool) -> str:
        """2ᵏ by writing k + 1023 where a double keeps its exponent."""
        kind, whole = self.type(vector), self.type(vector, "i64")
        shifted = self.emit(f"fadd {kind} {k}, {self.real(_SHIFTER, vector)}")
        bits = self.emit(f"bitcast {kind} {shifted} to {whole}")
        biased = self.emit(f"add {whole} {bits}, {self.whole(1023, vector)}")
        placed = self.emit(f"shl {whole} {biased}, {self.whole(52, vector)}")
        return self.emit(f"bitcast {whole} {placed} to {kind}")

    def exponent(self, x: str, vector: bool) -> str:
        """The exponent bits as a double."""
        kind, whole = self.type(vector), self.type(vector, "i64")
        bits = self.emit(f"bitcast {kind} {x} to {whole}")
        down = self.emit(f"lshr {whole} {bits}, {self.whole(52, vector)}")
        kept = self.emit(f"and {whole} {down}, {self.whole(0x7FF, vector)}")
        return self.minus(self.from_whole(kept, vector), 1023.0, vector)

    def from_whole(self, bits: str, vector: bool) -> str:
        """A whole number below 2⁵² as a double: written into the bits of 2⁵², which is then taken away."""
        kind, whole = self.type(vector), self.type(vector, "i64")
        held = self.emit(f"or {whole} {bits}, {self.whole(0x4330000000000000, vector)}")
        return self.minus(self.emit(f"bitcast {whole} {held} to {kind}"), 2.0**52, vector)

    def minus(self, x: str, constant: float, vector: bool) -> str:
        """X - constant."""
        return self.emit(f"fsub {self.type(vector)} {x}, {self.real(constant, vector)}")

    def uniform(self, values: list[str], vector: bool) -> str:
        """The mix of `primitives.uniform`."""
        whole, kind = self.type(vector, "i64"), self.type(vector)
        bits = self.whole(0, vector)
        for value, stride in zip(values, STRIDES, strict=True):
            given = self.emit(f"fptoui {kind} {value} to {whole}")
            bits = self.emit(f"add {whole} {bits}, {given}")
            bits = self.emit(f"add {whole} {bits}, {self.whole(1, vector)}")
            bits = self.emit(f"mul {whole} {bits}, {self.whole(stride, vector)}")
            for shift, factor in ((30, MIX[0]), (27, MIX[1])):
                down = self.emit(f"lshr {whole} {bits}, {self.whole(shift, vector)}")
                mixed = self.emit(f"xor {whole} {bits}, {down}")
                bits = self.emit(f"mul {whole} {mixed}, {self.whole(factor, vector)}")
            down = self.emit(f"lshr {whole} {bits}, {self.whole(31, vector)}")
            bits = self.emit(f"xor {whole} {bits}, {down}")
        upper = self.emit(f"lshr {whole} {bits}, {self.whole(12, vector)}")
        centred = self.minus(self.from_whole(upper, vector), -0.5, vector)
        return self.emit(f"fmul {kind} {centred}, {self.real(2.0**-52, vector)}")

    def library(self, name: str, x: str, vector: bool) -> str:
        """A function of the system's library, lane by lane."""
        if not vector:
            return self.emit(f"call double @{name}(double {x})")
        return self.by_lane(lambda one: self.emit(f"call double @{name}(double {one})"), x)

    def gather(self, table: int, place: int, vector: bool) -> str:
        """A read from a table at a place that is inside it."""

        def read(one: str) -> str:
            offset = self.emit(f"fptosi double {one} to i64")
            at = self.emit(f"getelementptr double, ptr {self.names[table]}, i64 {offset}")
            return self.emit(f"load double, ptr {at}, align 8")

        return self.by_lane(read, self.names[place]) if vector else read(self.names[place])

    def by_lane(self, function: object, x: str) -> str:
        """A scalar operation for each lane."""
        lanes = self.plan.lanes
        kind = self.type(True)
        total = "poison"
        for lane in range(lanes):
            one = self.emit(f"extractelement {kind} {x}, i32 {lane}")
            total = self.emit(f"insertelement {kind} {total}, double {function(one)}, i32 {lane}")  # type: ignore[operator]
        return total


def text(plan: Plan, name: str, target: str) -> str:
    """The module of a plan. `target` is a triple; on x86 and aarch64 numbers below the normal ones become 0."""
    printer = Printer(plan)
    graph, kinds = plan.graph, plan.kinds
    still = [state for state in plan.states if state.before == state.after]
    carried = [state for state in plan.states if state.before != state.after]
    needed = set(plan.order)
    places = {state.name: i for i, state in enumerate(plan.states)}
    for i, (_, node) in enumerate(plan.tables):
        at = printer.emit(f"getelementptr ptr, ptr %tables, i64 {i}")
        printer.names[node] = printer.emit(f"load ptr, ptr {at}, align 8")
    for i, (_, node) in enumerate(plan.constants):
        if node in needed:
            printer.names[node] = printer.load("%constants", i, printer.varies(node))
    for state in still:
        printer.names[state.before] = printer.load("%states", places[state.name], printer.varies(state.before))
    for index in plan.order:
        if not kinds.moving[index]:
            printer.node(index)
    for index in plan.order:  # spread before the loop what the loop needs in every lane
        for i in arguments(graph.nodes[index]):
            wanted = kinds.moving[index] and not kinds.moving[i] and printer.varies(index) and not printer.varies(i)
            if wanted and graph.nodes[i][0] != "table":
                printer.value(i, True)
    begin = {state.name: printer.load("%states", places[state.name], printer.varies(state.before)) for state in carried}
    entry, printer.lines = printer.lines, []
    outer = dict(printer.spread)

    phis = []
    for state in carried:
        printer.names[state.before] = printer.fresh()
    if plan.sample is not None and plan.sample in needed:
        count = printer.emit("add i64 %first, %k")
        printer.names[plan.sample] = printer.emit(f"sitofp i64 {count} to double")
    row = printer.emit(f"mul i64 %k, {len(plan.inputs)}")
    for i, (_, node) in enumerate(plan.inputs):
        if node in needed:
            at = printer.emit(f"add i64 {row}, {i}")
            place = printer.emit(f"getelementptr double, ptr %inputs, i64 {at}")
            printer.names[node] = printer.emit(f"load double, ptr {place}, align 8")
    for index in plan.order:
        if kinds.moving[index]:
            printer.node(index)
    if plan.outputs:
        row = printer.emit(f"mul i64 %k, {len(plan.outputs) * plan.lanes}")
        for i, (_, node) in enumerate(plan.outputs):
            vector = plan.lanes > 1
            at = printer.emit(f"add i64 {row}, {i * plan.lanes}")
            place = printer.emit(f"getelementptr double, ptr %outputs, i64 {at}")
            held = printer.value(node, vector)
            printer.lines.append(f"  store {printer.type(vector)} {held}, ptr {place}, align 8")
    ends = {}
    for state in carried:
        kind = printer.type(printer.varies(state.before))
        ends[state.name] = printer.value(state.after, printer.varies(state.before))
        before, first, last = printer.names[state.before], begin[state.name], ends[state.name]
        phis.append(f"  {before} = phi {kind} [ {first}, %entry ], [ {last}, %loop ]")
    body, printer.lines = printer.lines, []
    printer.spread = outer

    for state in carried:
        vector = printer.varies(state.before)
        kind = printer.type(vector)
        last = printer.emit(f"phi {kind} [ {begin[state.name]}, %entry ], [ {ends[state.name]}, %loop ]")
        ends[state.name] = last
    for state in carried:
        vector = printer.varies(state.before)
        held = ends[state.name]
        at = printer.emit(f"getelementptr double, ptr %states, i64 {places[state.name] * plan.lanes}")
        printer.lines.append(f"  store {printer.type(vector)} {held}, ptr {at}, align 8")
    done = printer.lines
    declare, on, off = _flush(target)
    return "\n".join(
        [
            f'target triple = "{target}"',
            *declare,
            *(f"declare double @{f}(double)" for f in sorted({graph.nodes[i][0] for i in plan.order} & ELEMENTARY)),
            *_intrinsics(plan),
            f"define void @{name}(i64 %count, i64 %first, "
            "ptr noalias readonly %constants, ptr noalias readonly %inputs, "
            "ptr noalias %states, ptr noalias %outputs, ptr noalias readonly %tables) #0 {",
            "entry:",
            *on,
            *entry,
            "  %any = icmp sgt i64 %count, 0",
            "  br i1 %any, label %loop, label %done",
            "loop:",
            "  %k = phi i64 [ 0, %entry ], [ %k.next, %loop ]",
            *phis,
            *body,
            "  %k.next = add i64 %k, 1",
            "  %more = icmp slt i64 %k.next, %count",
            "  br i1 %more, label %loop, label %done",
            "done:",
            *done,
            *off,
            "  ret void",
            "}",
            'attributes #0 = { nounwind "min-legal-vector-width"="512" "prefer-vector-width"="512" }',
            "",
        ]
    )


def _intrinsics(plan: Plan) -> list[str]:
    used = sorted({plan.graph.nodes[i][0] for i in plan.order} & set(_INTRINSIC))
    kinds = [("f64", "double")]
    if plan.lanes > 1:
        kinds.append((f"v{plan.lanes}f64", f"<{plan.lanes} x double>"))
    return [f"declare {kind} @llvm.{_INTRINSIC[name]}.{suffix}({kind})" for name in used for suffix, kind in kinds]


def _flush(target: str) -> tuple[list[str], list[str], list[str]]:
    """Declarations, and the lines that set and restore the mode in which numbers below the normal ones are 0."""
    if target.startswith("x86_64"):
        return (
            ["declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)"],
            [
                "  %mode.old = alloca i32, align 4",
                "  %mode.new = alloca i32, align 4",
                "  call void @llvm.x86.sse.stmxcsr(ptr %mode.old)",
                "  %mode = load i32, ptr %mode.old, align 4",
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
                "  %mode.set = or i64 %mode, 16777216",
                "  call void @llvm.aarch64.set.fpcr(i64 %mode.set)",
            ],
            ["  call void @llvm.aarch64.set.fpcr(i64 %mode)"],
        )
    return [], [], []
