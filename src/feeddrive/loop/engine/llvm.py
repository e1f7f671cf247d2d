"""Operations as LLVM text, scalar or as vectors with one variant per lane; `time_loop.py` assembles them.

A value that is the same in all lanes stays scalar and is broadcast where a vector needs it.  No pass reorders
anything: LLVM only selects instructions and registers.
"""

from __future__ import annotations

from collections.abc import Callable

from feeddrive.language.graph import ELEMENTARY, arguments
from feeddrive.language.machine_code import number
from feeddrive.language.primitives import MIX, STRIDES
from feeddrive.loop.engine.plan import Branch, Plan, lazy_branches

_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_COMPARE = {"lt": "olt", "le": "ole", "eq": "oeq"}
_LOGIC = {"and": "and", "or": "or"}
_INTRINSIC = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor"}
# x + 1.5·2⁵² holds the whole number x in its low bits
_SHIFTER = 6755399441055744.0


class Printer:
    """A writer of the lines of one function, block after block."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.branches = lazy_branches(plan) if plan.lanes == 1 else {}
        self.aside = {index for inner in self.branches.values() for index in inner}
        self.lines: list[str] = []
        self.block = "entry"  # the label under which lines are written
        self.names: dict[int, str] = {}  # node -> value, scalar or vector as its kind says
        self.spread: dict[str, str] = {}  # scalar value -> vector value, within the part being written
        self.count = 0
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
        """True if a node is a vector."""
        return self.plan.lanes > 1 and self.plan.kinds.varying[node]

    def type(self, vector: bool, scalar: str = "double") -> str:
        """Return the type of a value."""
        return f"<{self.plan.lanes} x {scalar}>" if vector else scalar

    def value(self, node: int, vector: bool) -> str:
        """Return a node's value as scalar or vector, as needed."""
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
        """Return a 64-bit integer as an operand."""
        signed = value - 2**64 if value >= 2**63 else value
        return str(signed) if not vector else "<" + ", ".join([f"i64 {signed}"] * self.plan.lanes) + ">"

    def real(self, value: float, vector: bool) -> str:
        """Return a double as an operand."""
        text = number(value)
        return text if not vector else "<" + ", ".join([f"double {text}"] * self.plan.lanes) + ">"

    def load(self, base: str, place: int, vector: bool) -> str:
        """Load a number from memory that is laid out by lanes."""
        at = self.emit(f"getelementptr double, ptr {base}, i64 {place * self.plan.lanes}")
        return self.emit(f"load {self.type(vector)}, ptr {at}, align 8")

    def taken(self) -> list[str]:
        """Return the lines written so far and start anew."""
        lines, self.lines = self.lines, []
        return lines

    def begin(self, label: str) -> None:
        """Start a new block."""
        self.block = label
        self.lines.append(f"{label}:")

    def store(self, held: str, at: str) -> None:
        """Store a number to memory that is laid out by lanes."""
        self.lines.append(f"  store {self.type(self.plan.lanes > 1)} {held}, ptr {at}, align 8")

    def node(self, index: int) -> None:
        """Write one operation."""
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
        """Write a choice between two values, by one truth for all lanes or one for each."""
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
        """Write choices by one truth, of which only the branch taken is computed."""
        first, nodes = group[0], self.plan.graph.nodes
        labels = {branch: f"branch{first}.{branch}" for branch in (1, 2)}
        self.lines.append(f"  br i1 {self.names[arguments(nodes[first])[0]]}, label %{labels[1]}, label %{labels[2]}")
        ends: dict[int, list[str]] = {index: [] for index in group}
        for branch in (1, 2):
            self.begin(labels[branch])
            for one in self.branches.get(Branch(first, branch), ()):
                self.node(one)
            for index in group:
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
        """Write the mix of `primitives.uniform`."""
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
        centred = self.minus(self.from_whole(upper, vector), -0.5, vector)
        return self.emit(f"fmul {kind} {centred}, {self.real(2.0**-52, vector)}")

    def library(self, name: str, x: str, vector: bool) -> str:
        """Call a function of the system's library, lane by lane."""
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
        """Read a cell of a ring: the same one in all lanes, or another one in each."""
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
        """Overwrite a cell of a ring in place."""
        held = self.value(value, self.plan.lanes > 1)
        if not self.varies(place):
            self.store(held, self.cell(ring, self.names[place], 0))
            return
        for lane in range(self.plan.lanes):
            at = self.emit(f"extractelement {self.type(True)} {self.names[place]}, i32 {lane}")
            one = self.emit(f"extractelement {self.type(True)} {held}, i32 {lane}")
            self.lines.append(f"  store double {one}, ptr {self.cell(ring, at, lane)}, align 8")

    def cell(self, ring: int, place: str, lane: int) -> str:
        """Return the address of a cell of a ring in the memory of the states."""
        offset = self.emit(f"fptosi double {place} to i64")
        if self.plan.lanes > 1:
            offset = self.emit(f"mul i64 {offset}, {self.plan.lanes}")
        if lane:
            offset = self.emit(f"add i64 {offset}, {lane}")
        return self.emit(f"getelementptr double, ptr {self.names[ring]}, i64 {offset}")

    def by_lane(self, function: Callable[[str], str], x: str) -> str:
        """Write a scalar operation for each lane."""
        lanes = self.plan.lanes
        kind = self.type(True)
        total = "poison"
        for lane in range(lanes):
            one = self.emit(f"extractelement {kind} {x}, i32 {lane}")
            total = self.emit(f"insertelement {kind} {total}, double {function(one)}, i32 {lane}")
        return total


def intrinsics(plan: Plan) -> list[str]:
    """Return declarations of everything that the operations of a plan call."""
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
