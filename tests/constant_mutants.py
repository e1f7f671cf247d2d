"""A mutation run over thresholds: every numeric constant of some modules is halved and doubled, and a test must fail.

    python tests/constant_mutants.py                      # all modules of MODULES: make mutate
    python tests/constant_mutants.py chatter_signs guard  # those whose name ends like this

A constant is a name at the top of a module that is assigned a number.  The source of its module is changed as it is
imported, in a process of its own, which runs the tests of the module until one fails.
"""

from __future__ import annotations

import ast
import importlib.abc
import importlib.machinery
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

TESTS = Path(__file__).parent
MUTANT = "FEEDDRIVE_MUTANT"  # environment: module, line, number, number in its place

# a module whose thresholds decide what a person is told, and the tests that hold them, those that fail soonest first
MODULES = {
    "feeddrive.machining.lobes": "test_thresholds.py machining/test_chatter_signs.py machining/test_lobes.py",
    "feeddrive.workflow.friction": "test_thresholds.py cli/test_friction_command.py",
    "feeddrive.tuning.criteria": "test_thresholds.py tuning/test_shaping.py",
    "feeddrive.figures.ranking": "test_thresholds.py",
    "feeddrive.loop.guard": "test_thresholds.py loop/test_guard.py",
}

# mutants that nothing can tell from the original, or that only take longer, with the reason
EQUIVALENT = {
    ("feeddrive.machining.lobes", "_PLACES", "32"): "a coarser search of the place in a tooth, good enough",
    ("feeddrive.machining.lobes", "_PLACES", "128"): "a finer search of the same",
    ("feeddrive.loop.guard", "SETPOINT_LIMIT", "500000000000.0"): "no axis comes within nine decades of it",
    ("feeddrive.loop.guard", "SETPOINT_LIMIT", "2000000000000.0"): "the same",
    ("feeddrive.loop.guard", "COMMAND_LIMIT", "5e+17"): "no drive comes within twelve decades of it",
    ("feeddrive.loop.guard", "COMMAND_LIMIT", "2e+18"): "the same",
}


class Constant(NamedTuple):
    """A number at the top of a module."""

    module: str
    name: str
    line: int
    value: float | int

    def changed(self) -> Iterator[float | int]:
        """The numbers in its place: half of it and double."""
        for factor in (0.5, 2):
            other = int(factor * self.value) if isinstance(self.value, int) else factor * self.value
            if other != self.value:
                yield other


def constants(module: str) -> list[Constant]:
    """All plain numbers that a module assigns to a name at its top."""
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    body = ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body
    assigned = [node for node in body if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)]
    return [
        Constant(module, node.targets[0].id, node.lineno, value)  # type: ignore[attr-defined]
        for node in assigned
        if (value := number(node.value)) is not None
    ]


def number(node: ast.expr) -> float | int | None:
    """The value of a number, or of an expression of numbers; None for anything else."""
    numbers = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
    parts = (ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
    if not all(isinstance(part, parts) for part in ast.walk(node)) or any(type(n) not in (int, float) for n in numbers):
        return None
    return eval(compile(ast.Expression(node), "", "eval"))


class Changed(importlib.machinery.SourceFileLoader):
    """Loads a module with one number changed."""

    def __init__(self, module: str, path: str, line: int, old: str, new: str) -> None:
        super().__init__(module, path)
        self.change = line, old, new

    def get_code(self, fullname: str) -> object:  # no cache of bytes: the source on disk is another one
        source = Path(self.path).read_text(encoding="utf-8").splitlines(keepends=True)
        line, old, new = self.change
        name, _, value = source[line - 1].partition("=")
        assert number(ast.parse(value.partition("#")[0].strip(), mode="eval").body) == float(old)
        source[line - 1] = f"{name}= {new}\n"
        return compile("".join(source), self.path, "exec")


class Finder(importlib.abc.MetaPathFinder):
    """Finds the one module that is changed."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        module, line, old, new = os.environ[MUTANT].split()
        if fullname != module:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        assert spec is not None
        assert spec.origin is not None
        spec.loader = Changed(module, spec.origin, int(line), old, new)
        return spec


if MUTANT in os.environ:  # as a plugin of pytest: python -m pytest -p constant_mutants
    sys.meta_path.insert(0, Finder())


def survives(constant: Constant, other: float | int) -> bool:
    """Whether all tests of the module pass with another number in place of the constant."""
    change = f"{constant.module} {constant.line} {constant.value!r} {other!r}"
    tests = [str(TESTS / name) for name in MODULES[constant.module].split()]
    words = ["-m", "pytest", "-q", "-x", "-p", "constant_mutants", "-p", "no:cacheprovider", "-m", "not slow", *tests]
    path = os.pathsep.join([str(TESTS), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, MUTANT: change, "PYTHONPATH": path, "CI": "1"}
    done = subprocess.run(
        [sys.executable, *words], cwd=TESTS.parent, env=environment, capture_output=True, encoding="utf-8", check=False
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"{change}: pytest ended with {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 0


def main(asked: Sequence[str]) -> int:
    """Change every constant of the modules that were asked for; the exit status is 1 if a mutant survives."""
    modules = [name for name in MODULES if not asked or name.rpartition(".")[2] in asked]
    killed, left = 0, list[str]()
    for module in modules:
        for constant in constants(module):
            for other in constant.changed():
                words = f"{constant.name} {constant.value!r} -> {other!r}"
                if (module, constant.name, repr(other)) in EQUIVALENT:
                    continue
                if survives(constant, other):
                    left.append(f"{module}: {words}")
                    print(f"SURVIVES {left[-1]}", flush=True)
                else:
                    killed += 1
    print(f"{killed} of {killed + len(left)} changed constants of {len(modules)} modules are noticed")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
