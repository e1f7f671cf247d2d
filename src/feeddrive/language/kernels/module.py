"""All kernels of a file, and those of other files that they call, as one LLVM module."""

from __future__ import annotations

from collections.abc import Sequence

from feeddrive.language.kernels.source import INT, Source
from feeddrive.language.kernels.statements import Statements
from feeddrive.language.kernels.text import Failure, Function, struct

_INTRINSICS = """
declare double @llvm.sqrt.f64(double)
declare double @llvm.fabs.f64(double)
declare double @llvm.floor.f64(double)
declare { i64, i1 } @llvm.sadd.with.overflow.i64(i64, i64)
declare { i64, i1 } @llvm.ssub.with.overflow.i64(i64, i64)
declare { i64, i1 } @llvm.smul.with.overflow.i64(i64, i64)
attributes #0 = { nounwind "no-builtins" }
!0 = !{!"branch_weights", i32 1048575, i32 1}
"""


class Module:
    """Printed kernels, each after those that it calls, and the errors behind their statuses."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self.failures: list[Failure] = []
        self.functions: dict[Source, Function] = {}
        self._begun = 0
        self._open: list[Source] = []  # begun, not yet ended: the chain of calls
        self.entries = [f"entry{place}" for place in range(len(sources))]
        self._entries = [self._entry(name, each) for name, each in zip(self.entries, sources, strict=True)]

    def function(self, source: Source) -> Function:
        """The function of a kernel, printed when it is first asked for."""
        found = self.functions.get(source)
        if found is not None:
            return found
        if source in self._open:
            names = " -> ".join(each.name for each in [*self._open[self._open.index(source) :], source])
            source.refuse(source.tree, f"recursion: {names}", "write a loop, with a stack in an array of the caller")
        self._open.append(source)
        self._begun += 1
        made = Statements(source, self.failures, self.function).function(f'"k{self._begun}.{source.name}"')
        self._open.pop()
        return self.functions.setdefault(source, made)

    def text(self, triple: str) -> str:
        """The module, with its triple in the first line."""
        angles, left = dict[str, str](), [each for function in self.functions.values() for each in function.elementary]
        while left:
            each = left.pop()
            if each.name not in angles:
                angles[each.name], called = each.printed()
                left += called
        functions = [each.text for each in self.functions.values()]
        printed = [f'target triple = "{triple}"', *functions, *angles.values(), *self._entries]
        return "\n".join(printed) + _INTRINSICS

    def _entry(self, name: str, source: Source) -> str:
        """A function that takes its arguments from words of 64 bits in memory, and leaves its results there."""
        function, signature = self.function(source), source.signature
        lines, operands = list[str](), list[str]()
        words = [each for given in signature.parameters for each in (given, *[INT] * given.dimensions)]
        for place, kind in enumerate(words):
            loaded = kind.llvm.replace("i1", "i64")
            lines.append(f"%p{place} = getelementptr i64, ptr %words, i64 {place}")
            lines.append(f"%w{place} = load {loaded}, ptr %p{place}")
            if loaded != kind.llvm:
                lines.append(f"%t{place} = trunc i64 %w{place} to i1")
            operands.append(f"{kind.llvm} %{'w' if loaded == kind.llvm else 't'}{place}")
        returned = struct(signature.results)
        lines.append(f"%made = call {returned} @{function.name}({', '.join(operands)})")
        for at, kind in enumerate(signature.results):
            value = f"%r{at}"
            lines.append(f"{value} = extractvalue {returned} %made, {at + 1}")
            if kind.llvm == "i1":
                lines.append(f"%e{at} = zext i1 {value} to i64")
                value = f"%e{at}"
            lines.append(f"%o{at} = getelementptr i64, ptr %words, i64 {at}")
            lines.append(f"store {kind.llvm.replace('i1', 'i64')} {value}, ptr %o{at}")
        lines.append(f"%status = extractvalue {returned} %made, 0")
        lines.append("ret i64 %status")
        return "\n  ".join([f"define i64 @{name}(ptr %words) #0 {{", *lines]) + "\n}\n"
