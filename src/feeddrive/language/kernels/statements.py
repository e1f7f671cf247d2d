"""Statements of kernels as LLVM text: control flow, results and errors; a whole kernel as a function."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from feeddrive.language.kernels.assignments import Assignments
from feeddrive.language.kernels.source import INT, Source
from feeddrive.language.kernels.text import REMEDIES, Function, Value, assembled, shown, struct


class _Loop(NamedTuple):
    """A loop: the targets of `continue` and `break`, and the assigned names on each way out of it."""

    onward: str
    out: str
    outcomes: list[frozenset[str] | None]
    facts: dict[str, str]  # that hold at the start of each turn, and so after the loop, too


class Statements(Assignments):
    """Prints the body of a kernel."""

    def __init__(self, source: Source, callee: Callable[[Source], Function]) -> None:
        super().__init__(source, callee)
        self.loops: list[_Loop] = []

    def function(self, symbol: str, number: int) -> Function:
        """The whole kernel as a function of LLVM; `number` is added to the places of its failures."""
        tree, signature = self.source.tree, self.source.signature
        stored, upward = assigned(tree)
        self.names = frozenset([*stored, *signature.names])
        self.counters = frozenset(upward.difference(signature.names))
        parameters: list[str] = []
        arguments = iter(
            [
                Value(
                    kind,
                    f"%a{place}",
                    tuple(f"%a{place}.{level}" for level in range(kind.dimensions)),
                    leaf if kind.dimensions else "",
                )
                for place, (leaf, kind) in enumerate(signature.leaves)
            ]
        )
        for parameter, kind in zip(signature.names, signature.parameters, strict=True):
            value = assembled(kind, arguments)
            parameters += [f"{word} {operand}" for word, operand in value.operands]
            if parameter in stored:
                self.store(parameter, value, tree)
            else:
                self.fixed[parameter] = value
        self.assigned = frozenset(signature.names)
        self.block_of(tree.body)
        if self.reached() and signature.results:
            self.refuse(tree.body[-1], "a path ends without a return", "return on every path, or raise")
        self.leave([]) if self.reached() else self.add("unreachable")
        returned = struct(signature.results)
        for label, ends, added in (("fail", self.failed, number), ("handed", self.handed, 0)):
            if ends:
                self.begin(label)
                status = self.phi("i64", ends)
                status = self.emit(f"add i64 {status}, {added}") if added else status
                failed = self.emit(f"insertvalue {returned} poison, i64 {status}, 0")
                self.add(f"ret {returned} {failed}")
        size, fails = len(self.lines) + self.size, bool(self.failed or self.handed)
        written, head = (
            self.written([leaf for leaf, _ in signature.leaves]),
            f"{returned} @{symbol}({', '.join(parameters)})",
        )
        function = Function(symbol, head, "", written, self.failures, fails, size, [*self.kernels], self.elementary)
        first = f"{head} #0{' alwaysinline' if function.small else ''} {{\nentry:"
        return function._replace(text="\n".join([first, *self.memory, *self.lines, "}", ""]))

    def block_of(self, body: Iterable[ast.stmt]) -> None:
        """Statements one after the other."""
        for node in body:
            print_it = _PRINTERS.get(type(node))
            if print_it is None:
                remedy = REMEDIES.get(type(node), "kernels have assignments, if, while, for, return and raise")
                self.refuse(node, f"'{shown(node)}' ({type(node).__name__})", remedy)
            print_it(self, node)

    def inner(self, body: Iterable[ast.stmt]) -> None:
        """The statements of a loop or branch."""
        self.depth += 1
        self.block_of(body)
        self.depth -= 1

    def merged(self, outcomes: Iterable[frozenset[str] | None]) -> frozenset[str] | None:
        """Return the names that are assigned on all of several paths; None if no path leads here."""
        ways = [outcome for outcome in outcomes if outcome is not None]
        return frozenset.intersection(*ways) if ways else None

    def reached(self) -> bool:
        """True if a path leads to here."""
        return self.assigned is not None

    def dead(self) -> None:
        """Begin a block that is not reached."""
        self.assigned, self.facts = None, {}
        self.begin(self.label())

    def branch(self, node: ast.If) -> None:
        """If, elif, else."""
        yes, no, after = self.label(), self.label(), self.label()
        self.choose(self.truth(node.test), yes, no)
        before, outcomes = self.assigned, list[frozenset[str] | None]()
        known, facts = self.facts, list[dict[str, str]]()
        for label, body in ((yes, node.body), (no, node.orelse)):
            self.assigned, self.facts = before, dict(known)
            self.begin(label)
            self.inner(body)
            self.jump(after)
            outcomes.append(self.assigned)
            facts += [self.facts] if self.reached() else []
        self.assigned = self.merged(outcomes)
        if len(facts) == 1:
            self.facts = facts[0]
        else:
            self.facts = {fact: value for fact, value in known.items() if all(way.get(fact) == value for way in facts)}
        self.begin(after)

    def repeat(self, node: ast.While) -> None:
        """While."""
        head, body, after = self.label(), self.label(), self.label()
        endless = isinstance(node.test, ast.Constant) and node.test.value is True
        self.jump(head)
        self.begin(head)
        changed = self.forget(node)
        self.choose(self.truth(node.test), body, after)
        loop = _Loop(head, after, [None if endless else self.assigned], self.lasting(changed))
        self.begin(body)
        self.turn(node, loop)
        self.after(loop)

    def count(self, node: ast.For) -> None:
        """For over a range with a literal step; the range is computed once."""
        call, target = node.iter, node.target
        if not isinstance(call, ast.Call) or self.outside(call.func) is not range or call.keywords:
            self.refuse(node, f"for over '{shown(call)}'", "loop over range(...)")
        if not isinstance(target, ast.Name) or not 1 <= len(call.args) <= 3:
            self.refuse(node, f"'for {shown(target)} in {shown(call)}'", "write  for i in range(n)")
        limits = [self.whole(argument) for argument in call.args]
        step = limits[2].literal if len(limits) == 3 else 1
        if not step:
            self.refuse(call.args[2], f"the step '{shown(call.args[2])}'", "write a whole number that is not 0")
        start, stop = (Value(INT, "0"), limits[0]) if len(limits) == 1 else limits[:2]
        head, body, onward, after = self.label(), self.label(), self.label(), self.label()
        number, left = self.slot(start.text), ""
        if abs(step) > 1:
            left = self.slot(self.turns(start.text, stop.text, step))
        self.jump(head)
        self.begin(head)
        changed = self.forget(node)
        value, rest = self.emit(f"load i64, ptr {number}"), ""
        if left:
            rest = self.emit(f"load i64, ptr {left}")
            more = self.emit(f"icmp ne i64 {rest}, 0")
        else:
            more = self.emit(f"icmp {'slt' if step > 0 else 'sgt'} i64 {value}, {stop.text}")
        self.choose(more, body, after)
        loop = _Loop(onward, after, [self.assigned], self.lasting(changed))
        self.begin(body)
        self.store(target.id, Value(INT, value), target)
        self.turn(node, loop)
        self.begin(onward)
        following = self.emit(f"add i64 {value}, {step}")
        self.add(f"store i64 {following}, ptr {number}")
        if left:
            fewer = self.emit(f"sub i64 {rest}, 1")
            self.add(f"store i64 {fewer}, ptr {left}")
        self.jump(head)
        self.after(loop)

    def turns(self, start: str, stop: str, step: int) -> str:
        """The number of turns of a range, unsigned, so that it never leaves 64 bits."""
        near, far = (start, stop) if step > 0 else (stop, start)
        some = self.emit(f"icmp slt i64 {near}, {far}")
        span = self.emit(f"sub i64 {far}, {near}")
        less = self.emit(f"sub i64 {span}, 1")
        whole = self.emit(f"udiv i64 {less}, {abs(step)}")
        count = self.emit(f"add i64 {whole}, 1")
        return self.emit(f"select i1 {some}, i64 {count}, i64 0")

    def turn(self, node: ast.While | ast.For, loop: _Loop) -> None:
        """The body of a loop."""
        if node.orelse:
            self.refuse(node.orelse[0], "a loop with else", "set a bool before break, and test it after the loop")
        self.loops.append(loop)
        self.inner(node.body)
        self.loops.pop()
        self.jump(loop.onward)

    def forget(self, loop: ast.While | ast.For) -> set[str]:
        """Forget the values of the variables that a loop changes, and return their loads."""
        held = [self.variables[name] for name in assigned(loop)[0] if name in self.variables]
        changed = {load for variable in held for load in variable.loads}
        self.facts = self.lasting(changed)
        return changed

    def lasting(self, changed: set[str]) -> dict[str, str]:
        """The known facts without the values of some variables."""
        return {fact: value for fact, value in self.facts.items() if fact not in changed}

    def after(self, loop: _Loop) -> None:
        """Begin the block behind a loop."""
        self.assigned, self.facts = self.merged(loop.outcomes), loop.facts
        self.begin(loop.out)

    def leave_loop(self, node: ast.Break) -> None:
        """Break."""
        self.loops[-1].outcomes.append(self.assigned)
        self.jump(self.loops[-1].out)
        self.dead()

    def go_on(self, node: ast.Continue) -> None:
        """Continue."""
        self.jump(self.loops[-1].onward)
        self.dead()

    def give_back(self, node: ast.Return) -> None:
        """Return."""
        signature = self.source.signature
        wanted = signature.results
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            values: list[Value] = []
        elif signature.single:
            values = [self.expression(node.value)]
        elif isinstance(node.value, (ast.Tuple, ast.Call)):
            values = self.values(node.value, {len(wanted)}, node)
        else:
            self.refuse(node, f"'{shown(node)}' is no tuple", "return the numbers one by one")
        if [value.type for value in values] != [*wanted]:
            types = ", ".join(str(value.type) for value in values) or "nothing"
            names = ", ".join(map(str, wanted)) or "nothing"
            remedy = "write 0.0 for 0, float(...) or int(...)"
            self.refuse(node, f"{types} is returned where the annotation has {names}", remedy)
        self.leave(values)
        self.dead()

    def leave(self, values: Sequence[Value]) -> None:
        """Ends the function without an error."""
        returned = struct(self.source.signature.results)
        leaves = [leaf for value in values for leaf in value.leaves]
        aggregate = f"{{ {', '.join(['i64 0', *[f'{leaf.type.llvm} poison' for leaf in leaves]])} }}"
        for place, value in enumerate(leaves, start=1):
            aggregate = self.emit(f"insertvalue {returned} {aggregate}, {value.type.llvm} {value.text}, {place}")
        self.add(f"ret {returned} {aggregate}")

    def throw(self, node: ast.Raise) -> None:
        """Raise with a fixed text."""
        call = node.exc
        if not isinstance(call, ast.Call) or node.cause or call.keywords or len(call.args) != 1:
            self.refuse(node, f"'{shown(node)}'", "write  raise ValueError('a fixed text')")
        kind, text = self.outside(call.func), call.args[0]
        if not (isinstance(kind, type) and issubclass(kind, Exception)):
            self.refuse(node, f"'{shown(call.func)}' is no error", "write  raise ValueError('a fixed text')")
        if not (isinstance(text, ast.Constant) and isinstance(text.value, str)):
            self.refuse(node, f"the text '{shown(text)}' is not fixed", "write it in quotes, or return a number for it")
        try:
            kind(text.value)
        except Exception:  # whatever the constructor of an error class raises
            self.refuse(node, f"'{shown(call.func)}' is not made of a text alone", "write  raise ValueError(...)")
        self.end_with(str(self.failure(kind, text.value, node)))
        self.dead()

    def alone(self, node: ast.Expr) -> None:
        """A docstring, or a call of a kernel for what it writes."""
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return
        if not isinstance(node.value, ast.Call):
            self.refuse(node, f"'{shown(node)}' does nothing", REMEDIES.get(type(node.value), "leave it out"))
        self.results(node.value)

    def nothing(self, node: ast.Pass) -> None:
        """Pass."""


_PRINTERS: dict[type[ast.AST], Callable[..., None]] = {
    ast.Assign: Statements.assign,
    ast.AugAssign: Statements.change,
    ast.If: Statements.branch,
    ast.While: Statements.repeat,
    ast.For: Statements.count,
    ast.Break: Statements.leave_loop,
    ast.Continue: Statements.go_on,
    ast.Return: Statements.give_back,
    ast.Raise: Statements.throw,
    ast.Expr: Statements.alone,
    ast.Pass: Statements.nothing,
}


def assigned(tree: ast.FunctionDef | ast.While | ast.For) -> tuple[set[str], set[str]]:
    """Names that are assigned, and those that only loops assign, which count up from a written number >= 0.

    As an index the latter need no test for it.
    """
    names, others, left = set[str](), set[str](), list[ast.AST]([tree])
    while left:
        node = left.pop()
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
            if not _upward(node.iter):
                others.add(node.target.id)
            left += node.body
            left += node.orelse
        elif isinstance(node, (ast.Assign, ast.AugAssign)):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                for element in target.elts if isinstance(target, ast.Tuple) else [target]:
                    if isinstance(element, ast.Name):
                        others.add(element.id)
        elif isinstance(node, (ast.If, ast.While)):
            left += node.body
            left += node.orelse
        elif isinstance(node, ast.FunctionDef):
            left += node.body
    return names | others, names - others


def _upward(call: ast.expr) -> bool:
    """True if a range counts up from a literal number >= 0."""
    if not isinstance(call, ast.Call):
        return False
    start, step = (call.args[0] if len(call.args) > 1 else None), (call.args[2] if len(call.args) > 2 else None)
    return all(
        argument is None or (isinstance(argument, ast.Constant) and type(argument.value) is int)
        for argument in (start, step)
    )
