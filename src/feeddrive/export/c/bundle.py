"""The target `c`: a directory with a routine as C99, a self-test, builds for make and CMake, and a README."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.c.header_only import header_only
from feeddrive.export.c.programs import SAMPLES, self_test
from feeddrive.export.c.text import texts
from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.manifest import FILE, manifest_text, rules_table
from feeddrive.files.atomic_io import new_directory
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.routine import Variable

FLAGS = "-std=c99 -O2 -ffp-contract=off"
WARNINGS = "-Wall -Wextra -Wconversion -Wdouble-promotion"


def c_files(design: Design, *, single_header: bool = False) -> dict[str, str]:
    """The files of the export by name, without machine file and manifest."""
    P = design.name
    made = texts(design.layout, design.title, design.made_by)
    if single_header:
        files = {f"{P}.h": header_only(P, made)}
    else:
        files = {f"{P}.h": made.header, f"{P}.c": made.source, f"{P}_configure.c": made.configure}
    sources = [name for name in files if name.endswith(".c")]
    if design.what == CONTROL:
        files[f"{P}_selftest.c"], files[f"{P}_vectors.h"] = self_test(design.layout)
        files["Makefile"] = _makefile(P, sources)
    files["CMakeLists.txt"] = _cmake(P, sources, tested=design.what == CONTROL)
    files["README.md"] = _readme(design)
    return files


def write_c(design: Design, out: str | Path, *, single_header: bool = False) -> Path:
    """Write the export, whole or not at all; the README is returned. Raises FileError as `new_directory`."""
    files = c_files(design, single_header=single_header)
    files[MACHINE_FILE] = design.machine.file.text
    files[FILE] = manifest_text(design, "c", files, single_header=single_header)
    with new_directory(out) as folder:
        for name, content in files.items():
            (folder / name).write_text(content, encoding="utf-8")
    return Path(out) / "README.md"


def _makefile(P: str, sources: list[str]) -> str:
    files = " ".join([*sources, f"{P}_selftest.c"])
    return f"""\
# make        builds and runs the self-test
CC ?= cc
CFLAGS ?= {FLAGS} {WARNINGS}

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
  # a product and a sum that are rounded once would give other bits than the simulation
  target_compile_options({P} {scope} -ffp-contract=off)
  target_link_libraries({P} {scope} m)
endif()
{test if tested else ""}"""


def _readme(design: Design) -> str:
    P, routine = design.name, design.routine
    parts = [f"# {design.title}", design.made_by, _READ.format(P=P)]
    parts += ["\n".join(f"- **Note**: {remark}." for remark in design.remarks)] if design.remarks else []
    if design.what == CONTROL:
        parts.append(_CONTROL.format(P=P, T=design.period, samples=SAMPLES, flags=FLAGS))
        codes = "\n".join(f"| {code:g} | {text} |" for code, text in TRIPS.items())
        parts.append(f"## What `trip` says\n\n| code | tripped by |\n|---|---|\n| 0 | nothing |\n{codes}")
    else:
        parts.append(_PLANT.format(P=P, T=design.period))
    parts.append("## Inputs\n\n" + _table(routine.inputs))
    parts.append("## Outputs\n\n" + _table(routine.outputs))
    if routine.parameters:
        parts.append("## Parameters\n\n" + _table(routine.parameters, values=True))
        parts.append("## Rules of the parameters\n\n" + rules_table(routine))
    return "\n\n".join(parts) + "\n"


def _table(variables: tuple[Variable, ...], *, values: bool = False) -> str:
    head = "| name | unit | meaning |" + (" bounds | value |" if values else "")
    rows = []
    for v in variables:
        meaning = v.meaning.replace("|", "\\|")
        bounds = v.declared.bounds() if v.declared is not None else ""
        more = f" {bounds} | {v.value:.10g} |" if values else ""
        rows.append(f"| `{v.name}` | {v.unit} | {meaning} |{more}")
    return "\n".join([head, "|---|---|---|" + ("---|---|" if values else ""), *rows])


_READ = """\
`{P}.h` says what goes in and out. The numbers are those of `machine.toml`, which is in this directory. Positions,
forces and all else are in SI; forces and velocities are those of the table."""

_CONTROL = """\
**Before this moves an axis**: check sign and unit of every reading and of the command with the drive switched off; make
the first moves with reduced force limit, the emergency stop in reach, and a hanging axis held from below. This text was
proven to compute what was simulated; nobody proved that the machine is the one that was simulated.

## Use

```c
static {P}_controller controller;
{P}_parameters parameters;

{P}_defaults(&parameters);
if (!{P}_configure(&controller, &parameters)) {{  /* outside the interrupt */
    return false;  /* the parameters break the rule {P}_broken_rule(&parameters): do not go on */
}}
{P}_reset(&controller, &inputs);  /* where the axis is */

/* every {T} */
{P}_step(&controller, &inputs, &outputs);
```

- `outputs.force` is limited and never NaN. `outputs.enabled` drops when the loop is off or tripped: let it drop
  the drive.
- A trip is latched. Take `enable` away and give it again: the loop takes over where the axis is.
- `{P}_retune` changes parameters between two samples. Do not write into `controller` by hand.
- `{P}_configure` and `{P}_retune` refuse (false) what the simulation refuses: a number out of its bounds, and numbers
  that do not fit each other. `{P}_broken_rule` gives the code of the first broken rule; they are listed below. After a
  refused retune the old parameters go on. After a refused configure a step does nothing but command the safe force of
  the machine file. What they do not know is your axis: change to what you have simulated.
- The step takes {T} as its sample time: call it at that period.
- Compile with `{flags}`, never with `-ffast-math`. In C++ the header goes with any standard, the rest with C++17 or
  -std=gnu++.
- Numbers below the normal ones count as zero in the simulation. `{P}_flush_begin` and `{P}_flush_end` around the step
  do the same on x86-64 and AArch64; on a Cortex-M set the flush-to-zero bit once.

## Is it right?

`make` builds and runs {samples} stored samples and compares every output with the simulator's, bit for bit.
`feeddrive verify .` does so with a million samples and this machine's compiler, and prints a certificate."""

_PLANT = """\
A step moves the axis by {T} under `force` and `load_force`; the outputs are those at its end.

```c
{P}_plant plant;
{P}_defaults(&parameters);
{P}_configure(&plant, &parameters);
{P}_reset(&plant, &inputs, &outputs);    /* at inputs.start_position, at rest */
{P}_step(&plant, &inputs, &outputs);
```"""
