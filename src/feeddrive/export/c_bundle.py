"""The target `c`: sources, a self-test, build files for make and CMake, a README, and the proof of an export."""

import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.export.c_code import SENTENCE, header_only, number, texts
from feeddrive.export.design import CONTROL, Answers, Design, Trial, trial
from feeddrive.export.layout import Layout, LayoutRun
from feeddrive.export.targets import readme, write_bundle
from feeddrive.language.errors import FileError, MissingProgramError
from feeddrive.loop.routine import Routine, run

# C programs that run an export, a self-test and one that reads samples, and the compiler that builds them.

# Few samples keep the vectors small; invalid readings are ten times as frequent as in `trial`, so that some occur.
SAMPLES, CHANGES, BROKEN = 400, 4, 2e-3


def self_test(layout: Layout, seed: int = 0) -> tuple[str, str]:
    """Return the program `P_selftest.c` and its samples `P_vectors.h`.

    In double precision the expected outputs are the simulator's; in single precision those of the same operations in
    Python, each rounded to single precision.  The comparison is exact, bit for bit.
    """
    routine, P = layout.routine, layout.routine.name
    tried = trial(routine, SAMPLES, seed, changes=CHANGES, broken=BROKEN)
    double = layout.precision == "double"
    expected = run(routine, tried.inputs, tried.changes) if double else stepped(layout, tried)
    retuned = _parameter_rows(layout, tried)
    program = _PROGRAM.format(
        P=P,
        real=layout.precision,
        inputs=filled(routine),
        outputs=_compared([v.name for v in routine.outputs]),
        parameters="\n".join(
            f"            parameters.{v.name} = changes[change].parameters[{i}];"
            for i, v in enumerate(routine.parameters)
        ),
    )
    vectors = _VECTORS.format(
        P=P.upper(),
        real=layout.precision,
        bits=f"uint{64 if double else 32}_t",
        count=len(tried.inputs),
        inputs=len(routine.inputs),
        seed=seed,
        outputs=len(routine.outputs),
        parameters=len(routine.parameters),
        # C knows no array of length 0
        changes=max(1, len(retuned)),
        held=len(retuned),
        samples=_rows(tried.inputs, layout.precision),
        expected=_rows(expected, layout.precision),
        rows=",\n".join(f"    {{{k}, {{{', '.join(map(number, values))}}}}}" for k, values in retuned)
        or "    {0, {0.0}}",
    )
    return program, vectors


def stepped(layout: Layout, tried: Trial) -> np.ndarray:
    """Run a trial in Python, operation by operation in the precision of the layout; return the outputs."""
    held = LayoutRun(layout)
    held.reset(tried.inputs[0])
    outputs = []
    for k, inputs in enumerate(tried.inputs):
        if k in tried.changes:
            held.retune(tried.changes[k])
        outputs.append([float(x) for x in held.step(inputs)])
    return np.array(outputs)


def _parameter_rows(layout: Layout, tried: Trial) -> list[tuple[int, list[float]]]:
    """Return, for each parameter change, its sample index and the values of all parameters after it."""
    values = {v.path: v.value for v in layout.routine.parameters}
    rows = []
    for sample in sorted(tried.changes):
        values |= tried.changes[sample]
        rows.append((sample, list(values.values())))
    return rows


def _rows(values: np.ndarray, real: str) -> str:
    """Return a C initializer with numbers as bit patterns, since not every compiler accepts NaN and infinity."""
    with np.errstate(over="ignore"):
        held = np.ascontiguousarray(values, np.float64 if real == "double" else np.float32)
    digits = 2 * held.itemsize
    bits = held.view(f"u{held.itemsize}")
    return ",\n".join(f"    {{{', '.join(f'0x{int(word):0{digits}X}' for word in row)}}}" for row in bits)


def filled(routine: Routine) -> str:
    """Return the C lines that copy the stored sample k into the inputs of the controller."""
    return "\n".join(f"        inputs.{v.name} = value(samples[k][{i}]);" for i, v in enumerate(routine.inputs))


def _compared(names: Sequence[str]) -> str:
    return "\n".join(
        f'        wrong += differs(k, "{name}", outputs.{name}, value(expected[k][{i}]));'
        for i, name in enumerate(names)
    )


_VECTORS = """\
/* Random samples, seed {seed}, and the answers of the simulator, by the bits of each number: see the README. */
#ifndef {P}_VECTORS_H
#define {P}_VECTORS_H

#include <stdint.h>
#include <string.h>

#define SAMPLES {count}
#define CHANGES {held}

static const {bits} samples[SAMPLES][{inputs}] = {{
{samples}
}};

static const {bits} expected[SAMPLES][{outputs}] = {{
{expected}
}};

/* The number that has these bits. */
static inline {real} value({bits} bits)
{{
    {real} number;
    memcpy(&number, &bits, sizeof number);
    return number;
}}

/* Other parameters, from a sample on. */
static const struct {{ int sample; double parameters[{parameters}]; }} changes[{changes}] = {{
{rows}
}};

#endif
"""

_PROGRAM = """\
/* Runs the stored samples and compares every output with the stored answer, bit for bit. Exit status 0 if all agree. */
#include "{P}.h"
#include "{P}_vectors.h"

#include <stdio.h>

/* Does the number differ from the expected one? All NaN count as equal. */
static int differs(int sample, const char *name, {real} found, {real} wanted)
{{
    if (memcmp(&found, &wanted, sizeof found) == 0 || (found != found && wanted != wanted)) {{
        return 0;
    }}
    printf("sample %d: %s is %.17g, not %.17g\\n", sample, name, (double)found, (double)wanted);
    return 1;
}}

int main(void)
{{
    static {P}_controller controller;
    {P}_parameters parameters;
    {P}_inputs inputs;
    {P}_outputs outputs;
    int wrong = 0, change = 0;
    const uint64_t mode = {P}_flush_begin();
    {P}_defaults(&parameters);
    if (!{P}_configure(&controller, &parameters)) {{
        printf("refused: rule %d is broken, see the README\\n", {P}_broken_rule(&parameters));
        return 2;
    }}
    for (int k = 0; k < SAMPLES; k++) {{
{inputs}
        if (k == 0) {{
            {P}_reset(&controller, &inputs);
        }}
        if (change < CHANGES && changes[change].sample == k) {{
{parameters}
            {P}_retune(&controller, &parameters);
            change++;
        }}
        {P}_step(&controller, &inputs, &outputs);
{outputs}
    }}
    {P}_flush_end(mode);
    printf("%d samples, %d changes of parameters: %d outputs differ\\n", SAMPLES, change, wrong);
    return wrong == 0 ? 0 : 1;
}}
"""


FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")


@dataclass(frozen=True, eq=False)
class Streamed:
    """The outputs of exported C code in a trial, shape (n, outputs), and the compiler and flags used."""

    outputs: np.ndarray
    compiler: str
    flags: tuple[str, ...]


def streamed(
    layout: Layout,
    files: Mapping[str, str],
    tried: Trial,
    *,
    flags: Sequence[str] = FLAGS,
    command: str | None = None,
    emulator: Sequence[str] = (),
    order: str = "=",
) -> Streamed:
    """Compile the C files of an exported controller and run the program on the samples of a trial.

    emulator  command in front of the program, for a compiler of another processor
    order     order of the bytes of a number there, as NumPy writes it: "=" that of this computer, ">" big-endian

    Raises MissingProgramError if there is no compiler, and FileError if compilation or the program fails.
    """
    routine, P = layout.routine, layout.routine.name
    program = _STREAM_PROGRAM.format(
        P=P,
        real=layout.precision,
        inputs=len(routine.inputs),
        outputs=len(routine.outputs),
        parameters=max(1, len(routine.parameters)),
        filled=_stream_filled("inputs", [v.name for v in routine.inputs], "row", f"({layout.precision})"),
        retuned=_stream_filled("parameters", [v.name for v in routine.parameters], "values", ""),
        answered=_answered([v.name for v in routine.outputs]),
        refused=_REFUSED,
    )
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        place = Path(folder)
        for name, text in {**files, f"{P}_stream.c": program}.items():
            (place / name).write_text(text, encoding="utf-8")
        sources = [f"{P}_stream.c", *(name for name in (f"{P}.c", f"{P}_configure.c") if name in files)]
        binary = compiled(place, sources, flags, command)
        (place / "in").write_bytes(_packed(layout, tried).astype(f"{order}f8").tobytes())
        with open(place / "in", "rb") as samples, open(place / "out", "wb") as answers:
            done = subprocess.run([*emulator, str(binary)], stdin=samples, stdout=answers, check=False)
        if done.returncode == _REFUSED:
            words = " ".join([*compiler(command), *flags])
            raise FileError(f"{P}: what {words} makes of it refuses to run: not {SENTENCE}")
        if done.returncode != 0:
            raise FileError(f"{P}: the compiled program ended with status {done.returncode}")
        outputs = np.fromfile(place / "out", dtype=f"{order}f8").astype(np.float64).reshape(-1, len(routine.outputs))
    if len(outputs) != len(tried.inputs):
        raise FileError(f"{P}: the compiled program answered {len(outputs)} of {len(tried.inputs)} samples")
    return Streamed(outputs, version(command), tuple(flags))


def _packed(layout: Layout, tried: Trial) -> np.ndarray:
    """Return a trial as numbers for the program: blocks of samples, and the values of all parameters between blocks."""
    values = {v.path: v.value for v in layout.routine.parameters}
    pieces, start = [], 0
    for place in [*sorted(tried.changes), len(tried.inputs)]:
        pieces += [np.array([float(place - start)]), tried.inputs[start:place].ravel()]
        start = place
        if place in tried.changes:
            values |= tried.changes[place]
            pieces += [np.array([-1.0]), np.array(list(values.values()) or [0.0])]
    return np.concatenate(pieces)


def _answered(names: Sequence[str]) -> str:
    return "\n".join(f"                out[{i}] = (double)outputs.{name};" for i, name in enumerate(names))


def _stream_filled(struct: str, names: Sequence[str], source: str, cast: str) -> str:
    return "\n".join(f"                {struct}.{name} = {cast}{source}[{i}];" for i, name in enumerate(names))


# exit status of a program whose compiler rounds differently; other failures end with 1 to 4
_REFUSED = 5
_STREAM_PROGRAM = """\
#include "{P}.h"

#include <stdio.h>

/* Reads doubles: a count and as many rows of inputs, or -1 and all parameters. Writes outputs for each sample. */
int main(void)
{{
    static {P}_controller controller;
    {P}_parameters parameters;
    {P}_inputs inputs;
    {P}_outputs outputs;
    double count, row[{inputs}], values[{parameters}], out[{outputs}];
    bool begun = false;
    const uint64_t mode = {P}_flush_begin();
    {P}_defaults(&parameters);
    if (!{P}_configure(&controller, &parameters)) {{
        return {P}_broken_rule(&parameters) < 0 ? {refused} : 1;
    }}
    while (fread(&count, sizeof count, 1, stdin) == 1) {{
        if (count < 0.0) {{
            if (fread(values, sizeof values, 1, stdin) != 1) {{
                return 2;
            }}
            {{
{retuned}
            }}
            {P}_retune(&controller, &parameters);
        }} else {{
            for (double k = 0.0; k < count; k += 1.0) {{
                if (fread(row, sizeof row, 1, stdin) != 1) {{
                    return 3;
                }}
{filled}
                if (!begun) {{
                    {P}_reset(&controller, &inputs);
                    begun = true;
                }}
                {P}_step(&controller, &inputs, &outputs);
{answered}
                if (fwrite(out, sizeof out, 1, stdout) != 1) {{
                    return 4;
                }}
            }}
        }}
    }}
    {P}_flush_end(mode);
    return 0;
}}
"""


def compiler(command: str | None = None) -> list[str]:
    """Return the command that starts the C compiler: the requested one, or by default gcc, cc, clang or the package
    ziglang.

    Raises MissingProgramError if there is none.
    """
    for name in (command,) if command else ("gcc", "cc", "clang"):
        path = shutil.which(name)
        if path is not None:
            return [path]
    if command is None and importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise MissingProgramError(command or "gcc", "gcc libc6-dev", "compiling exported C")


def version(command: str | None = None) -> str:
    """Return the first line of the compiler's version message."""
    done = subprocess.run(
        [*compiler(command), "--version"],
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    lines = done.stdout.strip().splitlines()
    return lines[0] if lines else Path(compiler(command)[0]).name


def compiled(folder: Path, sources: Sequence[str], flags: Sequence[str], command: str | None = None) -> Path:
    """Compile C files of a folder into a program and return its path.

    The code that runs once, `*_configure.c`, is compiled without optimization, since optimizing it takes seconds.
    Raises MissingProgramError if there is no compiler, and FileError, with its first message, if compilation fails.
    """
    words = compiler(command)
    objects = []
    for name in sources:
        effort = ["-O0"] if name.endswith("_configure.c") else []
        _run([*words, *flags, *effort, "-c", name, "-o", f"{name}.o"], folder)
        objects.append(f"{name}.o")
    _run([*words, *flags, "-o", "program", *objects, "-lm"], folder)
    return folder / "program"


def _run(words: Sequence[str], folder: Path) -> None:
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, encoding="utf-8", errors="replace", check=False
    )
    if done.returncode != 0:
        messages = (done.stderr.strip() or "no message").splitlines()
        # notes and warnings may precede the error
        first = next((line for line in messages if "error" in line), messages[0])
        raise FileError(f"the C compiler {words[0]} refuses: {first}")


def prove(directory: Path, design: Design, tried: Trial, flags: Sequence[str], command: str | None) -> Answers:
    """Compile the exported C and run a trial. Raises FileError for a missing file, and the errors of `streamed`."""
    P = design.name
    names = [name for name in (f"{P}.h", f"{P}.c", f"{P}_configure.c") if (directory / name).is_file()]
    if f"{P}.h" not in names:
        raise FileError(f"{directory / f'{P}.h'}: is missing; export again")
    files = {name: (directory / name).read_text(encoding="utf-8") for name in names}
    ran = streamed(design.layout, files, tried, flags=(*FLAGS, *flags), command=command)
    return Answers(ran.outputs, ran.compiler, " ".join(ran.flags))


# The target `c`: a directory with a routine as C99, a self-test, build files for make and CMake, and a README.

BUILD_FLAGS = "-std=c99 -O2 -ffp-contract=off"
WARNINGS = "-Wall -Wextra -Wconversion -Wdouble-promotion"


def c_files(design: Design, *, single_header: bool = False) -> dict[str, str]:
    """Return the files of the export by name, except the machine file and the manifest."""
    P = design.name
    written = texts(design.layout, design.title, design.made_by)
    if single_header:
        files = {f"{P}.h": header_only(P, written)}
    else:
        files = {f"{P}.h": written.header, f"{P}.c": written.source, f"{P}_configure.c": written.configure}
    sources = [name for name in files if name.endswith(".c")]
    if design.what == CONTROL:
        files[f"{P}_selftest.c"], files[f"{P}_vectors.h"] = self_test(design.layout)
        files["Makefile"] = _makefile(P, sources)
    files["CMakeLists.txt"] = _cmake(P, sources, tested=design.what == CONTROL)
    files["README.md"] = readme("c.md.j2", design, samples=SAMPLES, flags=BUILD_FLAGS)
    return files


def write_c(design: Design, out: str | Path, *, single_header: bool = False) -> Path:
    """Write the export atomically and return the path of the README. Raises FileError as `new_directory` does."""
    files = c_files(design, single_header=single_header)
    return write_bundle(design, "c", Path(out), files, single_header=single_header)


def _makefile(P: str, sources: list[str]) -> str:
    files = " ".join([*sources, f"{P}_selftest.c"])
    return f"""\
# make        builds and runs the self-test
CC ?= cc
CFLAGS ?= {BUILD_FLAGS} {WARNINGS}

selftest: {P}_selftest
\t./{P}_selftest

{P}_selftest: {files} {P}.h {P}_vectors.h
\t$(CC) $(CFLAGS) -o $@ {files} -lm

clean:
\t$(RM) {P}_selftest

.PHONY: selftest clean
"""


def _cmake(P: str, sources: list[str], *, tested: bool) -> str:
    kind, scope = ("STATIC " + " ".join(sources), "PUBLIC") if sources else ("INTERFACE", "INTERFACE")
    test = f"""
enable_testing()
add_executable({P}_selftest {P}_selftest.c)
target_link_libraries({P}_selftest PRIVATE {P})
add_test(NAME {P} COMMAND {P}_selftest)
"""
    return f"""\
cmake_minimum_required(VERSION 3.13)
project({P} C)

add_library({P} {kind})
target_include_directories({P} {scope} ${{CMAKE_CURRENT_SOURCE_DIR}})
target_compile_features({P} {scope} c_std_99)
if(NOT MSVC)
  # a fused multiply-add rounds once and would give other bits than the simulation
  target_compile_options({P} {scope} -ffp-contract=off)
  target_link_libraries({P} {scope} m)
endif()
{test if tested else ""}"""
