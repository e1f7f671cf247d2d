"""A plan as an LLVM module: the whole time loop as one function.

    void name(i64 count, i64 first, double *constants, double *inputs, double *states, double *outputs, double **tables,
              i64 row, i64 column)

Memory: constants, and states with the cells of rings behind them, [number][lane], inputs the same for all lanes,
outputs [sample][number][lane].  It is `row` numbers from sample to sample of the inputs and `column` from number to
number, so that each input may be a row of its own; outputs as rows of their own made the loop 8 % slower.  What does
not change from sample to sample is computed before the loop.
"""

from __future__ import annotations

from feeddrive.language.graph import arguments
from feeddrive.loop.engine.llvm import Printer, intrinsics
from feeddrive.loop.engine.plan import Plan

_ARGUMENTS = (
    "i64 %count, i64 %first, ptr noalias readonly %constants, ptr noalias readonly %inputs, "
    "ptr noalias %states, ptr noalias %outputs, ptr noalias readonly %tables, "
    "i64 %row, i64 %column"
)
# Vectors as wide as the processor has them, and a stack on which none of them straddles two cache lines.
_ATTRIBUTES = 'nounwind alignstack=64 "min-legal-vector-width"="512" "prefer-vector-width"="512"'


def text(plan: Plan, name: str, target: str, *, flush: bool = True) -> str:
    """Return the module of a plan for a target triple; `flush`: on x86 and aarch64 subnormal numbers become 0."""
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
        """Write everything that is constant over the run, and the first states."""
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
        for index in plan.order:  # spread before the loop what the loop needs in every lane
            for i in arguments(plan.graph.nodes[index]):
                wanted = moving[index] and not moving[i] and printer.varies(index) and not printer.varies(i)
                if wanted and plan.graph.nodes[i][0] not in ("table", "ring"):
                    printer.value(i, True)
        return printer.taken()

    def body(self) -> list[str]:
        """Write one sample."""
        plan, printer = self.plan, self.printer
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
        """Write the last states back to memory; those that are the same in all lanes to all of them."""
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
        """Write a state's value: the first one when coming from the entry, else that at the end of a sample."""
        kind = self.printer.type(self.printer.varies(self.plan.states[self.places[name]].before))
        return f"phi {kind} [ {self.begins[name]}, %entry ], [ {self.ends[name]}, %{self.last} ]"


def _flush(target: str) -> tuple[list[str], list[str], list[str]]:
    """Return declarations, and the lines that set and restore the mode in which subnormal numbers are 0."""
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
