"""What free checkers say of exported C: MISRA C:2012 by cppcheck's addon, and coverage by gcov."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from export.parameter_cases import one_for_each_rule
from exported import LOOPS
from feeddrive.export.c_bundle import self_test
from feeddrive.export.c_code import FUNCTIONS, texts
from feeddrive.export.layout import layout
from feeddrive.loop.routine import controller_routine
from slow_share import all_but

# rule -> why it is not kept; docs/internals/c_quality.md has the same list
DEVIATIONS = {
    "2.5": "names for the codes of `trip` are there for the caller",
    "2.7": "a processor without a mode for tiny numbers ignores the one that it is given back",
    "8.9": "a table stands before the functions, with what it is, also where one function alone reads it",
    "15.5": "a function leaves where a condition is broken: `configured`, a rule of the parameters",
    "20.1": "xmmintrin.h is included where the processor has it",
    "21.15": "memcpy between a number and its bits, which C99 defines and a pointer of another type does not",
}

LONG = 350  # lines of a function that cppcheck reads whole: the time grows with the third power, 440 take 90 s
PIECE = 60  # lines of a piece of a longer one

needs_cppcheck = pytest.mark.skipif(
    shutil.which("cppcheck") is None, reason="NOT TESTED: MISRA C:2012 needs cppcheck: apt-get install cppcheck"
)
needs_gcov = pytest.mark.skipif(
    shutil.which("gcov") is None or shutil.which("gcc") is None,
    reason="NOT TESTED: coverage needs gcov: apt-get install gcc",
)


def misra(files: dict[str, str], place: Path) -> dict[str, list[str]]:
    """Places by rule."""
    for name, text in files.items():
        (place / name).write_text(text, encoding="utf-8")
    sources = sorted(name for name in files if name.endswith(".c"))
    done = subprocess.run(
        [
            "cppcheck",
            "--addon=misra",
            "--std=c99",
            "--language=c",
            "--enable=style",
            "--quiet",
            "--template={id} {file}:{line}",
            *sources,
        ],
        cwd=place,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found: dict[str, list[str]] = {}
    for line in done.stderr.splitlines():
        rule, _, where = line.partition(" ")
        assert rule.startswith("misra-c2012-"), f"cppcheck says more than MISRA: {line}"
        file, _, number = where.rpartition(":")
        if rule.endswith("-12.1") and "? (" in "".join(files[file].split("\n")[int(number) - 2 : int(number)]):
            continue  # cppcheck removes the parentheses of `a ? (b * c) : d` before its addon asks for them
        found.setdefault(rule.removeprefix("misra-c2012-"), []).append(where)
    return found


def exported(name: str) -> dict[str, str]:
    made = texts(layout(controller_routine(LOOPS[name], "axis_x")), "a control under test", "made by a test")
    return {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}


_NAME = re.compile(r"(?<![>.\w])[A-Za-z_]\w*")  # not those of members


def in_pieces(text: str) -> str:
    """The same file with a long `designed` as functions of some lines each, every statement as it stands.

    The function is a row of constants and of `if (...) { return n; }`, without a variable that changes. What a piece
    needs of those before are its parameters, and what it leaves to those behind it writes into a row.
    """
    head, _, rest = text.partition("static int designed(")
    declared, _, rest = rest.partition("\n{\n")
    body, _, behind = rest.partition("\n}\n")
    lines = body.split("\n")
    if len(lines) <= LONG:
        return text
    cuts = [0]
    for number, line in enumerate(lines):
        # beside a declaration that a block behind it fills there is no cut
        if number - cuts[-1] >= PIECE and re.match(r"    (const |if \(|/\*|design->)", line):
            cuts.append(number)
    pieces = ["\n".join(lines[a:b]) for a, b in zip(cuts, [*cuts[1:], len(lines)], strict=True)]
    known: dict[str, str] = {}  # names of the pieces before, with their types
    made = []
    for number, piece in enumerate(pieces):
        words = set(_NAME.findall(piece))
        own = {
            name: kind for kind, name in re.findall(r"^    (?:const )?(double|float|bool) (\w+)(?: =|;)", piece, re.M)
        }
        later = set(_NAME.findall("\n".join(pieces[number + 1 :])))
        given = [f"{kind} {name}" for name, kind in known.items() if name in words]
        left = [name for name in own if name in later]
        given += ["axis_x_design *design"] if "design" in words else []
        given += ["const axis_x_parameters *parameters"] if "parameters" in words else []
        given += ["double *left"] if left else []
        stored = [f"    left[{k}] = {f'{n} ? 1.0 : 0.0' if own[n] == 'bool' else n};" for k, n in enumerate(left)]
        ends = [] if piece.endswith("    return 0;") else ["    return 0;"]
        whole = f"int piece_{number}({', '.join(given)})"
        made.append("\n".join([f"{whole};", whole, "{", piece, *stored, *ends, "}", ""]))
        known |= own
    return "\n".join([f"{head}int designed({declared};", *made, behind])


def undeclared(found: dict[str, list[str]]) -> dict[str, list[str]]:
    """What is found of other rules than those with a reason."""
    return {rule: places[:3] for rule, places in found.items() if rule not in DEVIATIONS}


@needs_cppcheck
@pytest.mark.parametrize(
    "name",
    all_but(["cascade_ppi"], LOOPS, "cppcheck takes half a minute or more for each loop"),
)
def test_misra_rules_but_for_those_with_a_reason(name: str, tmp_path: Path) -> None:
    """The parameters' check and design, of up to 3,000 lines, is read in pieces: whole, cppcheck takes hours."""
    files = exported(name)
    files["axis_x_configure.c"] = in_pieces(files["axis_x_configure.c"])
    assert not undeclared(misra(files, tmp_path))


_CALLED = """
double called(double *rows, double x);
double called(double *rows, double x)
{
    double sum = power_of_two(x) + exponent(x);
    sum = sum + (double)power_of_twof((float)x);
    sum = sum + (double)exponentf((float)x);
    sum = sum + uniform(x, 2.0, 3.0);
    if (decays(rows, 2)) {
        sum = sum + 1.0;
    }
    rows[0] = sum;
    return sum;
}
"""


@needs_cppcheck
def test_misra_rules_of_every_function_beside_the_step(tmp_path: Path) -> None:
    """What C has no operator for: a law whose `configure` cppcheck reads in a second has none of them."""
    assert all(f"{name}(" in _CALLED for name in FUNCTIONS)
    heads = "".join(f"#include <{name}.h>\n" for name in ("math", "stdbool", "stdint", "string"))
    text = heads + "\n".join(FUNCTIONS.values()) + _CALLED
    assert not undeclared(misra({"functions.c": text}, tmp_path))


@needs_cppcheck
def test_the_checker_finds_what_is_not_allowed(tmp_path: Path) -> None:
    """A checker that finds nothing proves nothing: an octal number (7.1), a parameter that is changed (17.8)."""
    text = "int f(int a);\nint f(int a)\n{\n    if (a > 017) {\n        a = 0;\n    }\n    return a;\n}\n"
    assert {"7.1", "17.8"} <= set(misra({"f.c": text}, tmp_path))
    text = "double f(double a);\ndouble f(double a)\n{\n    return ((a * 2.0) + 1.0) - RIGHT;\n}\n"
    for right, rules in (("((a < 1.0) ? (a * 2.0) : a)", set()), ("((a < 1.0) ? a * 2.0 : a)", {"12.1"})):
        assert set(misra({"f.c": text.replace("RIGHT", right)}, tmp_path)) == rules


_MAIN = """
#include "axis_x.h"
#include <math.h>
int selftest(void);
static void tried(axis_x_controller *one, const axis_x_parameters *p)
{
    static axis_x_inputs inputs;
    axis_x_outputs outputs;
    inputs.enable = 1.0;
    if (axis_x_configure(one, p)) {
        axis_x_reset(one, &inputs);
        axis_x_step(one, &inputs, &outputs);
        axis_x_step(one, &inputs, &outputs);
    }
}
int main(void)
{
    static axis_x_controller off;
    static axis_x_inputs inputs;
    axis_x_outputs outputs;
    axis_x_parameters p, first;
    axis_x_defaults(&first);
    axis_x_reset(&off, &inputs);
    axis_x_step(&off, &inputs, &outputs);
    if (axis_x_retune(&off, &first)) return 1;
RULES
    return selftest();
}
"""


def covered(name: str, place: Path) -> dict[str, tuple[float, float]]:
    """Shares in percent of lines that ran and of branches that were taken, by file."""
    routine = controller_routine(LOOPS[name], "axis_x")
    program, vectors = self_test(layout(routine))
    rules = []
    for changed in one_for_each_rule(routine, {v.path for v in routine.parameters}).values():
        rules.append("    p = first;")
        for variable in routine.parameters:
            if variable.path in changed:
                value = float(changed[variable.path])
                rules.append(f"    p.{variable.name} = {'(double)NAN' if np.isnan(value) else value.hex()};")
        rules.append("    if (axis_x_broken_rule(&p) == 0 || axis_x_configure(&off, &p)) return 2;")
    share = [v.name for v in routine.parameters if v.name == "law_share"]
    for variable in routine.parameters:  # refused or not
        changed = f"p = first; p.{variable.name} = ldexp(p.{variable.name} == 0.0 ? 1.0 : p.{variable.name}, k);"
        rules.append(f"    for (int k = -54; k <= 20; k++) {{ {changed} tried(&off, &p); }}")
        if share:  # a rule on the whole share is behind one on the share itself
            changed = changed.replace("p = first;", f"p = first; p.{share[0]} = 0.01;")
            rules.append(f"    for (int k = -54; k <= 20; k++) {{ {changed} tried(&off, &p); }}")
    main = _MAIN.replace("RULES", "\n".join(rules))
    files = exported(name) | {"axis_x_selftest.c": program, "axis_x_vectors.h": vectors, "main.c": main}
    for file, text in files.items():
        (place / file).write_text(text, encoding="utf-8")
    flags = ["-std=c99", "-O0", "-ffp-contract=off"]
    for source in ("axis_x", "axis_x_configure"):
        subprocess.run(["gcc", *flags, "--coverage", "-c", f"{source}.c"], cwd=place, check=True)
    subprocess.run(["gcc", *flags, "-Dmain=selftest", "-c", "axis_x_selftest.c"], cwd=place, check=True)
    objects = ["axis_x.o", "axis_x_configure.o", "axis_x_selftest.o"]
    subprocess.run(["gcc", *flags, "--coverage", "main.c", *objects, "-o", "all", "-lm"], cwd=place, check=True)
    subprocess.run([place / "all"], cwd=place, check=True, capture_output=True)
    found = {}
    for source in ("axis_x", "axis_x_configure"):
        done = subprocess.run(["gcov", "-b", f"{source}.c"], cwd=place, capture_output=True, text=True, check=True)
        own = done.stdout.split(f"File '{source}.c'")[1]
        shares = [float(x) for x in re.findall(r"(?:Lines executed|Taken at least once):([\d.]+)%", own)[:2]]
        found[source] = (shares[0], shares[1])
    return found


@needs_gcov
@pytest.mark.parametrize(
    "name", all_but(["cascade_ppi"], LOOPS, "each is compiled for coverage and breaks every rule once")
)
def test_every_line_of_a_step_runs_in_the_tests_and_every_rule_is_broken(name: str, tmp_path: Path) -> None:
    """The 400 samples that go with the export, one refusal of each rule, two samples with each parameter from 2^-54 to
    2^20 of itself (at the first powers of an observer's matrix fall no more in 2^48), and a control never configured.
    """
    found = covered(name, tmp_path)
    assert found["axis_x"][0] == 100.0, found
    assert found["axis_x_configure"][0] == 100.0, found
    assert found["axis_x"][1] > 80.0, found
