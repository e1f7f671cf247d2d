"""A compiler of IEC 61131-3 by others, matiec: built once from ../shared/tools; what it makes runs beside exported C.

OpenPLC and Beremiz use it. It is a tool of the tests: neither its text nor what it links is part of feeddrive.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from feeddrive.export.c_code import texts
from feeddrive.export.design import Trial, trial
from feeddrive.export.layout import Layout
from feeddrive.export.structured_text import Program
from feeddrive.loop.routine import Routine

SOURCE = Path(__file__).parents[2].parent / "shared" / "tools" / "matiec-6bb2c33.tar.xz"
NEEDED = ("autoreconf", "bison", "flex", "g++", "make", "gcc")


def _place() -> Path:
    """The folder of the built compiler: of this source alone, in the folder for temporary files."""
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"feeddrive_matiec_{digest}"


def missing() -> str:
    """Why there is no compiler, or an empty text."""
    if not SOURCE.is_file():
        return f"NOT RUN: Structured Text in a real compiler: {SOURCE} is not there"
    lacking = [name for name in NEEDED if shutil.which(name) is None]
    if lacking and not (_place() / "iec2c").is_file():
        return (
            f"NOT RUN: Structured Text in a real compiler: {', '.join(lacking)} is missing: "
            "apt-get install autoconf automake bison flex g++ make gcc"
        )
    return ""


def not_built() -> str:
    """Why a quick test is skipped, or an empty text."""
    return missing() or ("" if is_built() else "NOT RUN: the slow tests build matiec first, in 40 s of CPU")


def is_built() -> bool:
    """Whether the compiler was built by an earlier test: building it takes 40 s of CPU."""
    return not missing() and (_place() / "iec2c").is_file()


def built() -> Path:
    """The folder with `iec2c` and `lib`, built if need be; skips the test where that is impossible."""
    why = missing()
    if why:
        pytest.skip(why)
    place = _place()
    if not (place / "iec2c").is_file():
        # elsewhere first, and then moved: two processes may build it at one time
        with tempfile.TemporaryDirectory(prefix="feeddrive_matiec_", dir=place.parent) as folder:
            subprocess.run(["tar", "xf", SOURCE], cwd=folder, check=True)
            source = next(each for each in Path(folder).iterdir() if each.is_dir())
            for words in (["autoreconf", "-i"], ["./configure"], ["make", "-j2", "CXXFLAGS=-O1 -w"]):
                done = subprocess.run(words, cwd=source, capture_output=True, text=True, check=False)
                assert done.returncode == 0, done.stderr[-2000:]
            made = Path(folder) / "made"
            made.mkdir()
            shutil.copy(source / "iec2c", made / "iec2c")
            shutil.copytree(source / "lib", made / "lib")
            with suppress(OSError):  # another process was faster
                os.replace(made, place)
    return place


def compiled(text: str, folder: Path) -> None:
    """Let the compiler make C of a source text, in a folder. Fails with its messages if it refuses the text."""
    place = built()
    (folder / "program.st").write_text(text, encoding="utf-8")
    done = subprocess.run(
        [place / "iec2c", "-I", place / "lib", "-T", folder, folder / "program.st"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@dataclass(frozen=True, eq=False)
class Storm:
    """Samples for both programs: inputs, by row; all parameters, by the sample before which they change; resets."""

    inputs: np.ndarray
    parameters: Mapping[int, np.ndarray]
    resets: frozenset[int]


WILD = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, 5e-324)


def storm(routine: Routine, tunable: Mapping[str, str], count: int, seed: int) -> Storm:
    """Random samples with broken numbers, storms of enable, resets, and changes of parameters good and bad.

    In every third block of 300 samples enable is drawn anew in each sample, in every seventh a tenth of all numbers is
    broken. Each change moves some parameters by up to 25 %; every fourth has a wild number, which the next takes back.
    """
    random = np.random.default_rng(seed)
    changes = max(4, count // 1000)
    tried: Trial = trial(routine, count, seed, changes=changes, broken=2e-3)
    inputs = tried.inputs.copy()
    names = [variable.path for variable in routine.inputs]
    block = np.arange(count) // 300
    enable = [i for i, name in enumerate(names) if name.rpartition(".")[2] == "enable"]
    for i in enable:
        inputs[:, i] = np.where(block % 3 == 1, (random.random(count) < 0.5).astype(float), inputs[:, i])
    rain = random.random(inputs.shape) < 0.1 * (block % 7 == 5)[:, None]
    rain[:, enable] = False  # a BOOL on a PLC has no broken value
    broken = random.choice(np.array([np.nan, np.inf, -np.inf, 1e300, -1e200, 5e-324, 1e-310, -1e-315]), inputs.shape)
    inputs = np.where(rain, broken, inputs)
    inputs[:, enable] = (inputs[:, enable] > 0.5).astype(float)
    values = {variable.path: variable.value for variable in routine.parameters}
    free = [path for path in values if path in tunable]
    parameters: dict[int, np.ndarray] = {}
    for number, (sample, changed) in enumerate(sorted(tried.changes.items())):
        values |= {path: value for path, value in changed.items() if path in tunable}
        row = dict(values)
        if number % 4 == 2 and free:
            row[str(random.choice(free))] = float(random.choice(np.array(WILD)))
        parameters[sample] = np.array(list(row.values()))
    near = set(parameters) | {sample + 1 for sample in parameters}
    resets = {int(k) for k in random.integers(1, count, max(3, count // 5000))} - near
    return Storm(inputs, parameters, frozenset(resets))


@dataclass(frozen=True, eq=False)
class Both:
    """What the compiled text and the exported C answer: outputs (n, outputs), and the code of the rule refused last."""

    names: tuple[str, ...]
    text: np.ndarray
    c: np.ndarray
    rule_of_text: np.ndarray
    rule_of_c: np.ndarray

    def different(self) -> int:
        """How many outputs differ in a bit; all NaN are one."""
        bits = self.text.view(np.uint64) != self.c.view(np.uint64)
        return int(np.sum(bits & ~(np.isnan(self.text) & np.isnan(self.c))))


def both(layout: Layout, program: Program, given: Storm, folder: Path) -> Both:
    """Compile the text and the C of one control into one program, and run both on the same samples."""
    routine, P = layout.routine, layout.routine.name
    compiled(program.text(), folder)
    made = texts(layout, "a control under test", "made by a test")
    (folder / f"{P}.h").write_text(made.header, encoding="utf-8")
    (folder / f"{P}.c").write_text(made.source, encoding="utf-8")
    (folder / f"{P}_configure.c").write_text(made.configure, encoding="utf-8")
    (folder / "main.c").write_text(_main(layout, program), encoding="utf-8")
    library = built() / "lib" / "C"
    flags = ["-std=gnu99", "-ffp-contract=off", "-w"]
    for file, effort in (("main.c", "-O1"), (f"{P}.c", "-O1"), (f"{P}_configure.c", "-O0")):
        words = ["gcc", *flags, effort, "-I", library, "-I", folder, "-c", folder / file, "-o", folder / f"{file}.o"]
        subprocess.run(words, check=True)
    objects = [folder / f"{file}.o" for file in ("main.c", f"{P}.c", f"{P}_configure.c")]
    subprocess.run(["gcc", *objects, "-o", folder / "program", "-lm"], check=True)
    count = len(given.inputs)
    wide = 2 + len(routine.parameters) + len(routine.inputs)
    rows = np.zeros((count, wide))
    current = np.array([variable.value for variable in routine.parameters])
    for k in range(count):
        if k in given.parameters:
            current, rows[k, 0] = given.parameters[k], 1.0
        rows[k, 1] = float(k in given.resets)
        rows[k, 2 : 2 + len(current)] = current
    rows[:, 2 + len(current) :] = given.inputs
    done = subprocess.run([folder / "program"], input=rows.tobytes(), capture_output=True, check=True)
    n = len(routine.outputs)
    found = np.frombuffer(done.stdout).reshape(count, 2 * n + 2)
    names = tuple(variable.name for variable in routine.outputs)
    text, c = (np.ascontiguousarray(found[:, i * n : (i + 1) * n]) for i in range(2))
    return Both(names, text, c, found[:, -2], found[:, -1])


def agree(layout: Layout, program: Program, count: int, seed: int, folder: Path) -> None:
    """Assert that compiled text and C answer the same in a storm: all bits of the outputs, and the rules refused."""
    given = storm(layout.routine, program.names, count, seed)
    found = both(layout, program, given, folder)
    assert found.different() == 0
    assert np.array_equal(found.rule_of_text, found.rule_of_c)
    columns = {name: found.c[:, i] for i, name in enumerate(found.names)}
    for name, column in columns.items():
        if name.endswith("force"):
            assert np.all(np.isfinite(column))
        elif name.endswith("enabled"):
            assert 0.2 < np.mean(column) < 0.9
        elif name.endswith("trip"):
            assert np.sum(np.diff(column) > 0.0) > count / 1000
    assert np.any(found.rule_of_c > 0.0), "no change of parameters was refused"
    assert np.any((found.rule_of_c[1:] == 0.0) & (found.rule_of_c[:-1] > 0.0))


def _main(layout: Layout, program: Program) -> str:
    routine, P = layout.routine, layout.routine.name
    real = layout.precision
    parameters = routine.parameters
    first = 2 + len(parameters)
    c_parameters = [f"given.{v.name} = row[{2 + i}];" for i, v in enumerate(parameters)]
    text_parameters = [
        f"block.PARAMETERS.value.{program.names[v.path].upper()} = row[{2 + i}];"
        for i, v in enumerate(parameters)
        if v.path in program.names
    ]
    c_inputs = [f"inputs.{v.name} = ({real})row[{first + i}];" for i, v in enumerate(routine.inputs)]
    given = [f"row[{first + i}]" for i in range(len(routine.inputs))]
    given = [f"{x} > 0.5" if _is_enable(v.name) else f"({real}){x}" for x, v in zip(given, routine.inputs, strict=True)]
    text_inputs = [f"block.{v.name.upper()}.value = {x};" for x, v in zip(given, routine.inputs, strict=True)]
    answers = [f"out[{i}] = (double)block.{v.name.upper()}.value;" for i, v in enumerate(routine.outputs)]
    n = len(routine.outputs)
    answers += [f"out[{n + i}] = (double)outputs.{v.name};" for i, v in enumerate(routine.outputs)]
    lines = {
        "parameters": "\n        ".join([*c_parameters, *text_parameters]),
        "inputs": "\n        ".join([*c_inputs, *text_inputs]),
        "answers": "\n        ".join(answers),
    }
    return _MAIN.format(P=P, B=P.upper(), width=first + len(routine.inputs), outputs=2 * n + 2, n=2 * n, **lines)


def _is_enable(name: str) -> bool:
    return name == "enable" or name.endswith("_enable")


_MAIN = """\
#include "{P}.h"
#include "POUS.h"
#include "POUS.c"
#include <stdio.h>

TIME __CURRENT_TIME;
BOOL __DEBUG;

int main(void)
{{
    static {P}_controller controller;
    static {B} block;
    {P}_parameters given;
    {P}_inputs inputs;
    {P}_outputs outputs;
    static double row[{width}], out[{outputs}];
    bool started = false;
    int rule = 0;
    const uint64_t mode = {P}_flush_begin();
    {P}_defaults(&given);
    {B}_init__(&block, 0);
    while (fread(row, sizeof row, 1, stdin) == 1) {{
        {parameters}
        {inputs}
        if (row[1] > 0.5 || !started) {{
            /* as the block does: at a reset, and until parameters are accepted */
            rule = {P}_broken_rule(&given);
            started = {P}_configure(&controller, &given);
            if (started != (rule == 0)) {{
                return 2;
            }}
            {P}_reset(&controller, &inputs);
        }} else if (row[0] > 0.5) {{
            rule = {P}_broken_rule(&given);
            if ({P}_retune(&controller, &given) != (rule == 0)) {{
                return 3;
            }}
        }}
        {P}_step(&controller, &inputs, &outputs);
        block.RETUNE.value = row[0] > 0.5;
        block.RESET.value = row[1] > 0.5;
        {B}_body__(&block);
        {answers}
        out[{n}] = (double)block.BROKEN_RULE.value;
        out[{n} + 1] = (double)rule;
        if (fwrite(out, sizeof out, 1, stdout) != 1) {{
            return 4;
        }}
    }}
    {P}_flush_end(mode);
    return 0;
}}
"""
