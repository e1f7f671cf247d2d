"""A mutation run over thresholds: every numeric constant of every module is halved and doubled, and a test must fail.

    python tests/constant_mutants.py                      # all modules: make mutate
    python tests/constant_mutants.py lobes guard          # the modules whose name ends like this
    python tests/constant_mutants.py --coverage FILE      # look for a test of constants that have none yet

A constant is a name at the top of a module that is assigned a number, or a row of numbers.  `constants.json` names the
test that notices each change, or the reason why none can.  tests/test_constants.py holds that no constant is missing.
FILE is what coverage.py measured with a context for each test:

    python -m pytest -m "not slow" --cov=feeddrive --cov-context=test

Each change is made as the module is imported, in a process that is forked before any module of feeddrive is loaded and
that runs the tests until one fails.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib.abc
import importlib.machinery
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import CodeType, ModuleType
from typing import NamedTuple

TESTS = Path(__file__).parent
SOURCE = TESTS.parent / "src"
LEDGER = TESTS / "constants.json"
ENDLESS = 60.0  # s, and ten times what the tests took: a changed constant that hangs a test is noticed, too
LONGEST = 6.0  # s of tests that are tried for one change in a search
MOST = 60  # of them
CHANGES = {"half": 0.5, "double": 2.0}

type_of_value = float | int | tuple[float | int, ...]


class Constant(NamedTuple):
    """A number, or a row of numbers, at the top of a module; `ends` are the places of its text in the file."""

    module: str
    name: str
    value: type_of_value
    ends: tuple[int, int, int, int]

    def changed(self, change: str) -> type_of_value | None:
        """The constant with its numbers halved or doubled; None if they stay the same."""
        factor = CHANGES[change]
        if isinstance(self.value, tuple):
            other: type_of_value = tuple(_scaled(value, factor) for value in self.value)
        else:
            other = _scaled(self.value, factor)
        return None if other == self.value else other


def _scaled(value: float | int, factor: float) -> float | int:
    return int(factor * value) if isinstance(value, int) else factor * value


def modules() -> Mapping[str, Path]:
    """The files of all modules of feeddrive, by name."""
    files = sorted(SOURCE.rglob("*.py"))
    return {".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__"): path for path in files}


def constants(module: str, path: Path) -> list[Constant]:
    """The numeric constants of a module."""
    rows = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if not isinstance(node, ast.Assign | ast.AnnAssign) or not isinstance(target, ast.Name) or node.value is None:
            continue
        if (value := number(node.value)) is not None:
            at = node.value
            ends = at.lineno, at.col_offset, at.end_lineno or 0, at.end_col_offset or 0
            rows.append(Constant(module, target.id, value, ends))
    return rows


def number(node: ast.expr) -> type_of_value | None:
    """The value of a number, of an expression of numbers, or of a tuple of them; None for anything else."""
    if isinstance(node, ast.Tuple):
        values = [number(part) for part in node.elts]
        row = [value for value in values if isinstance(value, float | int)]
        return tuple(row) if row and len(row) == len(values) else None
    numbers = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
    parts = (ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
    if not all(isinstance(part, parts) for part in ast.walk(node)) or any(type(n) not in (int, float) for n in numbers):
        return None
    return eval(compile(ast.Expression(node), "", "eval"))


@cache
def all_constants() -> tuple[Constant, ...]:
    """The numeric constants of all modules."""
    return tuple(constant for module, path in modules().items() for constant in constants(module, path))


@dataclass
class Finder(importlib.abc.MetaPathFinder):
    """Finds the one module that is changed."""

    constant: Constant
    other: type_of_value

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.constant.module:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        assert spec is not None
        assert spec.origin is not None
        spec.loader = Changed(fullname, spec.origin, self.constant, self.other)
        return spec


class Changed(importlib.machinery.SourceFileLoader):
    """Loads a module with one constant changed."""

    def __init__(self, module: str, path: str, constant: Constant, other: type_of_value) -> None:
        super().__init__(module, path)
        self.constant, self.other = constant, other

    def get_code(self, fullname: str) -> CodeType:  # no cache of bytes: the source on disk is another one
        lines = Path(self.path).read_text(encoding="utf-8").splitlines(keepends=True)
        line, column, last, end = self.constant.ends
        head, tail = lines[line - 1].encode()[:column].decode(), lines[last - 1].encode()[end:].decode()
        # as many lines as before, so that kernels find their source
        lines[line - 1 : last] = [f"{head}{self.other!r}{tail}", *["\n"] * (last - line)]
        return compile("".join(lines), self.path, "exec")


class Noticed:
    """A plugin of pytest that puts the changed module in place and writes which test failed first."""

    def __init__(self, pipe: int, finder: Finder) -> None:
        self.pipe, self.finder = pipe, finder

    def pytest_configure(self) -> None:
        sys.meta_path.insert(0, self.finder)  # again, before the finder of pytest that rewrites assertions

    def pytest_runtest_logreport(self, report: object) -> None:
        if getattr(report, "failed", False):
            self._write(str(getattr(report, "nodeid", "")))

    def pytest_collectreport(self, report: object) -> None:
        if getattr(report, "failed", False):
            self._write(str(getattr(report, "nodeid", "")))

    def _write(self, nodeid: str) -> None:
        os.write(self.pipe, f"{nodeid}\n".encode())


class Mutant(NamedTuple):
    """A change of one constant, and the tests that may notice it."""

    constant: Constant
    change: str
    tests: tuple[str, ...]


def _child(mutant: Mutant, pipe: int) -> int:
    """Run the tests with a constant changed, in a forked process; return the exit status of pytest."""
    import pytest

    quiet = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(quiet, stream)
    os.environ["CI"] = "1"
    os.chdir(TESTS.parent)
    other = mutant.constant.changed(mutant.change)
    assert other is not None
    finder = Finder(mutant.constant, other)
    sys.meta_path.insert(0, finder)
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # of the plugins only what the tests use
    words = ["-q", "-x", "-p", "no:cacheprovider", "-p", "_hypothesis_pytestplugin", "-p", "pytest_timeout"]
    words += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # hypothesis is there already
    return int(pytest.main([*words, *(f"tests/{name}" for name in mutant.tests)], plugins=[Noticed(pipe, finder)]))


class Running(NamedTuple):
    """A forked process that tests a mutant."""

    mutant: Mutant
    began: float
    pipe: int


def tested(mutants: Sequence[Mutant], jobs: int, longest: float) -> Iterator[tuple[Mutant, str]]:
    """Test mutants in forked processes; yield each with the test that noticed it, "" if none did."""
    waiting, running = list(reversed(mutants)), dict[int, Running]()
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            out, pipe = os.pipe()
            child = os.fork()
            if not child:
                status = 70
                with contextlib.suppress(BaseException):
                    status = _child(mutant, pipe)
                os._exit(status)
            os.close(pipe)
            running[child] = Running(mutant, time.monotonic(), out)
        done, status = os.waitpid(-1, os.WNOHANG)
        if not done:
            for child, one in running.items():
                if time.monotonic() - one.began > longest:
                    os.kill(child, 9)
            time.sleep(0.01)
            continue
        if done not in running:
            continue
        mutant, _, out = running.pop(done)
        with open(out, "rb") as file:
            failed = file.read().decode().split("\n")[0].removeprefix("tests/")
        code = os.waitstatus_to_exitcode(status)
        if code == 0:
            yield mutant, ""
        elif code in (1, 2) or code < 0:  # a failed test, a module that can't be imported, no end or a crash
            yield mutant, failed or mutant.tests[-1]
        elif code == 4 and len(mutant.tests) > 1:  # the name of a test hangs on the constant
            waiting.append(mutant._replace(tests=mutant.tests[1:]))
        else:
            raise SystemExit(f"{mutant}: pytest ended with {code}")


def preload() -> None:
    """Load what all tests need, but nothing of feeddrive: each mutant imports that anew."""
    for name in ("hypothesis.strategies", "matplotlib.figure", "numpy.linalg", "pytest"):
        import_module(name)
    for name in ("linalg", "optimize", "signal"):
        import_module(f"scipy.{name}")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.dont_write_bytecode = False
    assert not any(name.partition(".")[0] == "feeddrive" for name in sys.modules)
    sys.path[:0] = [str(SOURCE), str(TESTS)]


@cache
def text_of(file: str) -> str:
    """The text of a file of tests."""
    return (TESTS / file).read_text(encoding="utf-8")


class Coverage:
    """Which tests run which lines, of a measurement with coverage.py."""

    def __init__(self, path: Path, durations: Mapping[str, float]) -> None:
        from coverage import CoverageData

        self.data = CoverageData(str(path))
        self.data.read()
        self.files = {name.partition("/src/")[2]: name for name in self.data.measured_files()}
        self.durations = durations
        self.lines: dict[str, dict[int, list[str]]] = {}
        self.sources = {name: path.read_text(encoding="utf-8") for name, path in modules().items()}

    def tests(self, constant: Constant) -> tuple[str, ...]:
        """The tests that may notice a change of a constant: first those that run a line which uses it, in files that
        import its module, the short ones first.
        """
        users = {constant.module}
        if not constant.name.startswith("_"):
            users |= {name for name, source in self.sources.items() if constant.name in source}
        using = {test for name in users for test in self._of_lines(modules()[name], self._uses(constant, name))}
        # a number that is used as its module is loaded may matter to whoever runs a line of it
        wanted = using or self._of_lines(modules()[constant.module], None)

        def order(test: str) -> tuple[bool, float]:
            near = constant.module in text_of(test.partition("::")[0])
            return not near, self.durations.get(test, 0.02)

        chosen, total = list[str](), 0.0
        for test in sorted(wanted, key=order):
            took = self.durations.get(test, 0.02)
            if total + took <= LONGEST and len(chosen) < MOST:
                chosen.append(test)
                total += took
        return tuple(chosen)

    def _uses(self, constant: Constant, module: str) -> list[int]:
        """The lines of functions of a module that use a constant."""
        names = [
            node for node in ast.walk(ast.parse(self.sources[module])) if isinstance(node, ast.Name | ast.Attribute)
        ]
        return [
            node.lineno for node in names if constant.name == (node.id if isinstance(node, ast.Name) else node.attr)
        ]

    def _of_lines(self, path: Path, lines: Sequence[int] | None) -> set[str]:
        """The tests that run lines of a file; of all its lines inside functions if None."""
        name = str(path.relative_to(SOURCE))
        if name not in self.files:
            return set()
        if name not in self.lines:
            self.lines[name] = self.data.contexts_by_lineno(self.files[name])
        rows = self.lines[name] if lines is None else {line: self.lines[name].get(line, []) for line in lines}
        names = {context.partition("|")[0] for contexts in rows.values() for context in contexts}
        return {name.removeprefix("tests/") for name in names if "::" in name}


def main(words: Sequence[str]) -> int:
    """Change every constant of the modules that were asked for; the exit status is 1 if a mutant survives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="*")
    parser.add_argument("--coverage", type=Path, help="look for tests of constants that have none, and write them down")
    parser.add_argument("--durations", type=Path, help="what pytest --durations=0 printed: short tests come first")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args(words)
    preload()
    ledger = json.loads(LEDGER.read_text(encoding="utf-8")) if LEDGER.exists() else {}
    coverage = Coverage(asked.coverage, _durations(asked.durations)) if asked.coverage else None
    mutants, missing = list[Mutant](), list[str]()
    for constant in all_constants():
        if asked.modules and not any(constant.module.endswith(name) for name in asked.modules):
            continue
        known = ledger.get(constant.module, {}).get(constant.name, {})
        for change in CHANGES:
            if constant.changed(change) is None or "reason" in known or f"{change} reason" in known:
                continue
            if coverage is not None and change not in known:
                mutants.append(Mutant(constant, change, coverage.tests(constant)))
            elif coverage is None and change in known:
                mutants.append(Mutant(constant, change, (known[change],)))
            elif coverage is None:
                missing.append(f"{constant.module}: {constant.name}, {change}: no test in {LEDGER.name}")
    survivors = [
        f"{one.constant.module}: {one.constant.name}, {one.change}: no test" for one in mutants if not one.tests
    ]
    noticed = 0
    for mutant, test in tested([one for one in mutants if one.tests], asked.jobs, ENDLESS):
        constant = mutant.constant
        if test:
            noticed += 1
            if coverage is not None:
                ledger.setdefault(constant.module, {}).setdefault(constant.name, {})[mutant.change] = test
                _write(ledger)
        else:
            survivors.append(f"{constant.module}: {constant.name} = {constant.value}, {mutant.change}")
            print(f"SURVIVES {survivors[-1]}", flush=True)
    for line in missing:
        print(f"MISSING {line}")
    print(f"{noticed} of {noticed + len(survivors)} changed constants are noticed")
    return 1 if survivors or missing else 0


def _write(ledger: Mapping[str, Mapping[str, Mapping[str, str]]]) -> None:
    """Write which test notices which change, in the order of modules and names."""
    ordered = {name: dict(sorted(rows.items())) for name, rows in sorted(ledger.items())}
    text = json.dumps(ordered, indent=1, ensure_ascii=False)
    part = LEDGER.with_suffix(".part")
    part.write_text(f"{text}\n", encoding="utf-8")
    part.replace(LEDGER)


def _durations(path: Path | None) -> dict[str, float]:
    """Read the table of durations that pytest prints, in s by test."""
    took: dict[str, float] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path else []:
        parts = line.split(maxsplit=2)
        if len(parts) == 3 and parts[0].endswith("s") and parts[1] in ("call", "setup"):
            with contextlib.suppress(ValueError):
                name = parts[2].removeprefix("tests/")
                took[name] = took.get(name, 0.0) + float(parts[0][:-1])
    return took


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
