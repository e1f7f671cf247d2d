"""The target `cortex-m`: C sources for a core, precomputed constants and build files, and runs on an emulated core."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from feeddrive.export.c_bundle import c_files, filled
from feeddrive.export.c_code import mark, number
from feeddrive.export.design import CONTROL, Answers, Design, Trial
from feeddrive.export.layout import Layout, LayoutRun
from feeddrive.export.targets import readme, write_bundle
from feeddrive.language.errors import FeeddriveError, MissingProgramError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.routine import Variable, target_name

# The supported Cortex-M cores: build files, and runs of a bundle on an emulated core.

# without errno a square root is one instruction and no call of the library
FLAGS = "-std=c99 -O2 -ffp-contract=off -fno-math-errno"
WARNINGS = "-Wall -Wextra -Wconversion -Wdouble-promotion"
COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
PACKAGES = {
    COMPILER: "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    EMULATOR: "qemu-system-arm",
    "make": "make",
}  # package names in Debian and Ubuntu


def makefile(P: str, core: Core) -> str:
    """Return the makefile, which builds the library, runs the self-test, and reports size and instruction count."""
    others = [other for other in CORES.values() if other.precision == core.precision]
    flags = "\n".join(f"FLAGS_{other.name} := {other.flags}" for other in others)
    machines = "\n".join(f"MACHINE_{other.name} := {other.machine}" for other in others)
    return f"""\
# make            lib{P}.a for your project
# make selftest   runs the stored samples on an emulated core and compares every output, bit for bit
# make report     REPORT.md: memory, and executed instructions of a step
# CORE = {" or ".join(other.name for other in others)}
CORE ?= {core.name}
{flags}
{machines}

PREFIX ?= arm-none-eabi-
QEMU ?= {EMULATOR}
OPTIMISE ?= -O2
OPTIMISE_CONFIGURE ?= -Os
TARGET := $(FLAGS_$(CORE)) -mthumb -mfloat-abi=hard
CFLAGS = {FLAGS.replace("-O2", "$(OPTIMISE)")} $(TARGET) -ffunction-sections -fdata-sections
WARNINGS := {WARNINGS}
LINK := $(TARGET) -nostartfiles -T selftest/memory.ld --specs=rdimon.specs -Wl,--gc-sections
RUN := $(QEMU) -M $(MACHINE_$(CORE)) -nographic -monitor none -serial none \\
    -semihosting-config enable=on,target=native
OBJECTS := {P}.o {P}_configure.o {P}_prepared.o

{P}_configure.o: OPTIMISE := $(OPTIMISE_CONFIGURE)

lib{P}.a: $(OBJECTS)
\t$(PREFIX)ar rcs $@ $(OBJECTS)

%.o: %.c {P}.h | compiler
\t$(PREFIX)gcc $(CFLAGS) $(WARNINGS) -c -o $@ $<

selftest/%.o: selftest/%.c {P}.h {P}_vectors.h | compiler
\t$(PREFIX)gcc $(CFLAGS) -I . -c -o $@ $<

count.elf: selftest/count.o selftest/startup.o {P}.o {P}_prepared.o selftest/memory.ld
\t$(PREFIX)gcc $(LINK) -o $@ $(filter %.o, $^) -lm

%.elf: selftest/%.o selftest/startup.o $(OBJECTS) selftest/memory.ld
\t$(PREFIX)gcc $(LINK) -o $@ $(filter %.o, $^) -lm

selftest: selftest.elf | emulator
\t$(RUN) -kernel $<

answers.bin: answer.elf samples.bin | emulator
\t$(RUN) -kernel $<

# The log has a line for each instruction between the two marks, skipped conditional ones included.
steps.log: count.elf | emulator
\t$(RUN) -singlestep -d nochain,exec -D $@ \\
\t    -dfilter $$($(PREFIX)nm count.elf | awk '/ core_begin$$/ {{b = $$1}} / core_end$$/ {{e = $$1}} \\
\t    END {{print "0x" b "..0x" e}}') -kernel $<

counts.txt: steps.log
\tawk -F/ -v begin=$$($(PREFIX)nm count.elf | awk '/ count_begin$$/ {{print $$1}}') \\
\t    -v end=$$($(PREFIX)nm count.elf | awk '/ count_end$$/ {{print $$1}}') \\
\t    '$$2 == end {{print n}} {{n++}} $$2 == begin {{n = 0}}' $< > $@

REPORT.md: counts.txt $(OBJECTS)
\t{{ echo "# {P} on $(CORE), gcc $$($(PREFIX)gcc -dumpfullversion) $(OPTIMISE)"; echo; \\
\t  sort -n counts.txt | awk 'NR == 1 {{least = $$1}} {{most = $$1}} \\
\t    END {{print "Executed instructions of a step: " least " to " most " over " NR " samples."; print ""}}'; \\
\t  printf 'RAM of a controller: %d bytes.\\n\\n' \\
\t      0x$$($(PREFIX)nm -S count.elf | awk '/ counted$$/ {{print $$2}}'); \\
\t  $(PREFIX)size $(OBJECTS) | sed 's/^/    /'; }} > $@

report: REPORT.md
\t@cat $<

clean:
\t$(RM) *.o selftest/*.o *.a *.elf *.bin steps.log counts.txt REPORT.md

compiler:
\t@command -v $(PREFIX)gcc >/dev/null || {{ \\
\t    echo "$(PREFIX)gcc is not found: run  apt-get install {PACKAGES[COMPILER]}"; exit 1; }}

emulator:
\t@command -v $(QEMU) >/dev/null || {{ \\
\t    echo "$(QEMU) is not found: run  apt-get install {PACKAGES[EMULATOR]}"; exit 1; }}

.PHONY: selftest report clean compiler emulator
.PRECIOUS: %.o selftest/%.o %.elf
"""


def cmake_lists(P: str) -> str:
    """Return the CMakeLists.txt of the library."""
    return f"""\
cmake_minimum_required(VERSION 3.13)
project({P} C)

add_library({P} STATIC {P}.c {P}_configure.c {P}_prepared.c)
target_include_directories({P} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
target_compile_features({P} PUBLIC c_std_99)
# a fused multiply-add rounds once and would give other bits than the simulation
target_compile_options({P} PRIVATE -ffp-contract=off -fno-math-errno)
"""


def toolchain(core: Core) -> str:
    """Return the toolchain file for CMake."""
    return f"""\
# {core.title}:  cmake -B build -DCMAKE_TOOLCHAIN_FILE=cortex-m.cmake -DCMAKE_BUILD_TYPE=Release
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR arm)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
find_program(CMAKE_C_COMPILER {COMPILER})
if(NOT CMAKE_C_COMPILER)
  message(FATAL_ERROR "{COMPILER} is not found: run  apt-get install {PACKAGES[COMPILER]}")
endif()
set(CMAKE_C_FLAGS_INIT "{core.flags} -mthumb -mfloat-abi=hard -ffunction-sections -fdata-sections")
set(CMAKE_C_FLAGS_RELEASE "-O2")
"""


class Core(NamedTuple):
    """A Cortex-M core.

    precision  precision of its floating-point unit, "float" or "double"
    flags      gcc flags
    machine    QEMU machine, a board with this core
    title      full name of the core
    """

    name: str
    precision: str
    flags: str
    machine: str
    title: str


CORES = {
    core.name: core
    for core in (
        Core("m4f", "float", "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16", "mps2-an386", "Cortex-M4F, single precision"),
        Core("m7", "float", "-mcpu=cortex-m7 -mfpu=fpv5-sp-d16", "mps2-an500", "Cortex-M7, single precision"),
        Core("m7dp", "double", "-mcpu=cortex-m7 -mfpu=fpv5-d16", "mps2-an500", "Cortex-M7, double precision"),
    )
}


def cores_for(precision: str) -> tuple[Core, ...]:
    """Return the cores with floating-point hardware of this precision, default first."""
    return tuple(core for core in CORES.values() if core.precision == precision)


def find_core(name: str | None, precision: str) -> Core:
    """Return the core of the given name; by default, the first core with floating-point hardware for the precision.

    Raises ParameterError for an unknown name, and for a core without hardware for the precision.
    """
    if name is None:
        return cores_for(precision)[0]
    if name not in CORES:
        raise ParameterError(f"core = '{name}' is not known: take one of {', '.join(CORES)}")
    core = CORES[name]
    if core.precision != precision:
        fit = " or ".join(fitting.name for fitting in cores_for(precision))
        raise ParameterError(
            f"core = '{name}' computes with {core.precision}, not with {precision}, which it would have to emulate at "
            f"some forty times the cost: export with --precision {core.precision}, or take {fit}"
        )
    return core


PATIENCE = 300.0  # timeout in s for a build and a run


class EmulatorError(FeeddriveError):
    """The error if a bundle does not build, times out or fails its self-test; the message contains the output."""

    exit_code = 1


@dataclass(frozen=True)
class Cost:
    """The cost of a step on a core, over the stored samples of a bundle.

    least, most  executed instructions per step, including called functions
    flash        bytes of reset and step
    configure    bytes of the code that runs once, without library functions
    prepared     bytes of the precomputed constants that can replace that code
    memory       bytes of RAM for each controller
    """

    least: int
    most: int
    flash: int
    configure: int
    prepared: int
    memory: int


def check_programs() -> None:
    """Raise MissingProgramError, naming the package, if compiler, emulator or make is missing."""
    for program in ("make", COMPILER, EMULATOR):
        if shutil.which(program) is None:
            raise MissingProgramError(program, PACKAGES[program], "running a bundle for a Cortex-M")


def self_test(bundle: Path) -> str:
    """Return the output of a bundle's self-test.

    Raises MissingProgramError if a program is missing, and EmulatorError if the self-test does not pass.
    """
    return _made(bundle, "selftest")[0]


def step_cost(bundle: Path, optimise: str = "-O2") -> Cost:
    """Measure code size and instruction count of a bundle. Raises the errors of `self_test`."""
    _, content = _made(bundle, f"OPTIMISE={optimise}", "REPORT.md", read="REPORT.md")
    report = content.decode()
    counts = re.search(r"step: (\d+) to (\d+) over", report)
    memory = re.search(r"controller: (\d+) bytes", report)
    sizes = re.findall(r"^ +(\d+)\t +(\d+)\t +(\d+)\t", report, re.MULTILINE)
    if counts is None or memory is None or len(sizes) != 3:
        raise EmulatorError(f"{bundle}: the report cannot be read:\n{report}")
    flash, configure, constants = (sum(map(int, row[:2])) for row in sizes)
    return Cost(int(counts[1]), int(counts[2]), flash, configure, constants, int(memory[1]))


def answers(
    bundle: Path,
    design: Design,
    inputs: np.ndarray,
    changes: Mapping[int, Mapping[str, float]],
    *,
    optimise_configure: str = "-Os",
) -> np.ndarray:
    """Run the controller on an emulated core; return outputs of shape (n, outputs) for inputs of shape (n, inputs).

    changes             parameter changes, by sample and dotted name
    optimise_configure  optimization level for the code that runs once; it affects compile time, not results

    Raises the errors of `self_test`.
    """
    real = np.float64 if design.layout.precision == "double" else np.float32
    values = {v.path: v.value for v in design.routine.parameters}
    with np.errstate(over="ignore"):
        rows = np.asarray(inputs).astype(real)
    pieces: list[bytes] = []
    for k, row in enumerate(rows):
        if k in changes:
            values |= changes[k]
            # all parameters, those of earlier changes included: the program reads the whole struct
            pieces += [b"\1\0\0\0", np.array(list(values.values()), dtype=np.float64).tobytes()]
        else:
            pieces.append(b"\0\0\0\0")
        pieces.append(row.tobytes())
    _, content = _made(
        bundle,
        f"OPTIMISE_CONFIGURE={optimise_configure}",
        "answers.bin",
        extra_files={"samples.bin": b"".join(pieces)},
        read="answers.bin",
    )
    return np.frombuffer(content, dtype=real).reshape(len(rows), len(design.routine.outputs))


def _made(
    bundle: Path, *targets: str, extra_files: Mapping[str, bytes] | None = None, read: str = ""
) -> tuple[str, bytes]:
    """Run `make` in a copy of the bundle; return the printed output and the content of the file `read`."""
    check_programs()
    with tempfile.TemporaryDirectory(prefix="feeddrive-cortex-m-") as name:
        folder = Path(name) / "bundle"
        # without objects of another build: newer than their sources, make would link them as they are
        shutil.copytree(bundle, folder, ignore=shutil.ignore_patterns("*.o", "*.a", "*.elf", "*.d"))
        for file, content in (extra_files or {}).items():
            (folder / file).write_bytes(content)
        command = ["make", "-s", *targets]
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                capture_output=True,
                text=True,
                encoding="utf-8",
                errors="replace",
                timeout=PATIENCE,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise EmulatorError(
                f"{bundle}: `{' '.join(command)}` did not end within {Quantity(PATIENCE, 's'):6 SI}"
            ) from None
        if done.returncode != 0:
            raise EmulatorError(f"{bundle}: `{' '.join(command)}` failed:\n{done.stdout}{done.stderr}")
        return done.stdout, (folder / read).read_bytes() if read else b""


# The target `cortex-m`: the step for a core, precomputed constants, test programs, README.


def cortex_m_files(design: Design, core: Core) -> dict[str, str]:
    """Return the files of the bundle by name, except the machine file and the manifest."""
    P = design.name
    files = c_files(design)
    return {
        f"{P}.h": files[f"{P}.h"],
        f"{P}.c": files[f"{P}.c"],
        f"{P}_configure.c": files[f"{P}_configure.c"],
        **prepared_files(design.layout),
        f"{P}_vectors.h": files[f"{P}_vectors.h"],
        "selftest/selftest.c": files[f"{P}_selftest.c"],
        "selftest/count.c": count_program(design.layout),
        "selftest/answer.c": answer_program(design.layout),
        "selftest/startup.c": STARTUP,
        "selftest/memory.ld": linker_script(P),
        "Makefile": makefile(P, core),
        "CMakeLists.txt": cmake_lists(P),
        "cortex-m.cmake": toolchain(core),
        "README.md": _readme(design, core),
    }


def write_cortex_m(design: Design, out: Path, *, core: str | None = None) -> Path:
    """Write the bundle atomically and return the path of its README.

    core  `m4f` or `m7` in single precision, `m7dp` in double precision; default: the first core for the precision

    Raises ParameterError for an axis instead of a controller, for a core that is unknown or has another precision, and
    FileError as `new_directory` does.
    """
    if design.what != CONTROL:
        raise ParameterError("cortex-m: a microcontroller runs the control; export an axis as fmu2, fmu3 or c")
    chosen = find_core(core, design.layout.precision)
    files = cortex_m_files(design, chosen)
    return write_bundle(design, "cortex-m", out, files, core=chosen.name)


def _readme(design: Design, core: Core) -> str:
    routine = design.routine
    return readme(
        "cortex_m.md.j2",
        design,
        core=core,
        flags=f"{core.flags} -mthumb -mfloat-abi=hard {FLAGS}",
        rate=f"{1.0 / routine.sample_time:g}",
        period=f"{1e6 * routine.sample_time:g}",
        packages=" ".join(PACKAGES.values()),
        real=design.layout.precision,
        act=_act(design),
        off=" || ".join(f"outputs.{target_name(f'{port}enabled')} < 0.5f" for port in routine.origin.ports()),
        inputs=_named(routine.inputs),
        taken=_named(routine.outputs),
    )


def _named(variables: Sequence[Variable]) -> str:
    return ", ".join(f"`{v.name}`" + (f" ({v.unit})" if v.unit else "") for v in variables)


def _act(design: Design) -> str:
    """Return the C lines that pass the commands to the drives, in the drive's unit if a motor is specified."""
    units, lines = {v.path: v.unit for v in design.routine.outputs}, list[str]()
    for port in design.routine.origin.ports():
        path = f"{port}command" if f"{port}command" in units else f"{port}force"
        drive = f"write_drive{f'_{port[:-1]}' if port else ''}(outputs.{target_name(path)});"
        lines.append(f"{drive:<40}/* {units[path]} */")
    return "\n    ".join(lines)


def count_program(layout: Layout) -> str:
    """Return a C program that runs each stored step between two markers, to count its instructions."""
    P = layout.routine.name
    return f"""\
/* Runs the stored samples between two marks, so that the instructions of each step can be counted in the emulator. */
#include "{P}_prepared.h"
#include "{P}_vectors.h"

#define MARK __attribute__((noinline, section(".count"))) static void

MARK count_begin(void)
{{
    __asm__ volatile("@ begin");
}}

MARK count_end(void)
{{
    __asm__ volatile("@ end");
}}

{P}_controller counted;

int main(void)
{{
    {P}_inputs inputs;
    {P}_outputs outputs;
    (void)expected;
    (void)changes;
    {P}_prepared(&counted);
    for (int k = 0; k < SAMPLES; k++) {{
{filled(layout.routine)}
        if (k == 0) {{
            {P}_reset(&counted, &inputs);
        }}
        count_begin();
        {P}_step(&counted, &inputs, &outputs);
        count_end();
    }}
    return 0;
}}
"""


def answer_program(layout: Layout) -> str:
    """Return a C program that reads samples from `samples.bin` on the host and writes the outputs to `answers.bin`.

    A sample is a 32-bit flag (1: all parameters follow, as doubles), then the inputs.
    """
    P = layout.routine.name
    return f"""\
/* Reads samples from the host through semihosting, and writes the outputs of each step to the host. */
#include "{P}.h"

#include <stdio.h>

int main(void)
{{
    static {P}_controller controller;
    static char incoming[65536], outgoing[65536];
    {P}_parameters parameters;
    {P}_inputs inputs;
    {P}_outputs outputs;
    uint32_t changed;
    int begun = 0;
    FILE *samples = fopen("samples.bin", "rb"), *answers = fopen("answers.bin", "wb");
    if (!samples || !answers) {{
        return 2;
    }}
    setvbuf(samples, incoming, _IOFBF, sizeof incoming);
    setvbuf(answers, outgoing, _IOFBF, sizeof outgoing);
    {P}_defaults(&parameters);
    {P}_configure(&controller, &parameters);
    while (fread(&changed, sizeof changed, 1, samples) == 1) {{
        if (changed && fread(&parameters, sizeof parameters, 1, samples) != 1) {{
            return 2;
        }}
        if (fread(&inputs, sizeof inputs, 1, samples) != 1) {{
            return 2;
        }}
        if (!begun) {{
            {P}_reset(&controller, &inputs);
            begun = 1;
        }}
        if (changed) {{
            {P}_retune(&controller, &parameters);
        }}
        {P}_step(&controller, &inputs, &outputs);
        if (fwrite(&outputs, sizeof outputs, 1, answers) != 1) {{
            return 2;
        }}
    }}
    return fclose(answers) == 0 ? 0 : 2;
}}
"""


STARTUP = r"""\
/* Reset of a bare core, for the self-test in the emulator only: your project has its own. */
#include <stdint.h>
#include <stdlib.h>

extern uint32_t stack_top, data_begin, data_end, data_stored, bss_begin, bss_end;
extern void initialise_monitor_handles(void);
int main(void);
void begin(void);
void reset(void);
static void stop(void);

#define FPDSCR (*(volatile uint32_t *)0xE000EF3Cu) /* what FPSCR is at the entry of an interrupt */
#define FLUSH_AND_DEFAULT_NAN (3u << 24)           /* bits 24 and 25 of FPSCR and of FPDSCR */

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)reset, (const void *)stop, (const void *)stop,
    (const void *)stop, (const void *)stop, (const void *)stop,
};

/* The floating-point unit is switched on before any compiled function can push one of its registers. */
__attribute__((naked, noreturn)) void reset(void)
{
    __asm__ volatile(
        "ldr r0, =0xE000ED88\n" /* CPACR: coprocessors 10 and 11 */
        "ldr r1, [r0]\n"
        "orr r1, r1, #0xF00000\n"
        "str r1, [r0]\n"
        "dsb\n"
        "isb\n"
        "b begin\n");
}

void begin(void)
{
    for (uint32_t *to = &data_begin, *from = &data_stored; to < &data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = &bss_begin; to < &bss_end;) {
        *to++ = 0u;
    }
    FPDSCR |= FLUSH_AND_DEFAULT_NAN;
    __asm__ volatile("vmsr fpscr, %0" : : "r"(FLUSH_AND_DEFAULT_NAN));
    initialise_monitor_handles();
    exit(main());
}

/* A fault ends the program with status 3. */
static void stop(void)
{
    exit(3);
}
"""


def linker_script(P: str) -> str:
    """Return the linker script of the emulated boards; the section `core` holds the code to be counted."""
    return f"""\
/* The boards mps2-an386 and mps2-an500 of qemu, for the self-test only. */
ENTRY(reset)
MEMORY
{{
    CODE (rx)  : ORIGIN = 0x00000000, LENGTH = 4M
    RAM  (rwx) : ORIGIN = 0x20000000, LENGTH = 4M
}}
SECTIONS
{{
    .vectors : {{ KEEP(*(.vectors)) }} > CODE
    .core : {{
        core_begin = .;
        *(.count)
        *{P}.o(.text .text.*)
        *libm*.a:*(.text .text.*)
        *libgcc.a:*(.text .text.*)
        core_end = .;
    }} > CODE
    .text : {{ *(.text .text.*) *(.rodata .rodata.*) }} > CODE
    .ARM.exidx : {{ *(.ARM.exidx*) }} > CODE
    . = ALIGN(8);
    data_stored = LOADADDR(.data);
    .data : {{ . = ALIGN(8); data_begin = .; *(.data .data.*) . = ALIGN(8); data_end = .; }} > RAM AT > CODE
    .bss (NOLOAD) : {{ bss_begin = .; *(.bss .bss.* COMMON) . = ALIGN(8); bss_end = .; }} > RAM
    end = .;
    stack_top = ORIGIN(RAM) + LENGTH(RAM);
}}
"""


def prepared_files(layout: Layout) -> dict[str, str]:
    """Return the files `P_prepared.h` and `P_prepared.c`: constants that make it unnecessary to link `configure`."""
    P, run = layout.routine.name, LayoutRun(layout)
    numbers = [f"        .{field.name} = {_text(run.design[field.node], layout.precision)}," for field in layout.design]
    parameters = [f"        .{v.name} = {number(v.value)}," for v in layout.routine.parameters]
    source = [
        f'#include "{P}_prepared.h"',
        "",
        "#include <math.h>",
        "",
        f"void {P}_prepared({P}_controller *controller)",
        "{",
        *_constant(f"{P}_design", "design", numbers),
        *_constant(f"{P}_parameters", "parameters", parameters),
        *(f"    controller->{name} = {name};" for name, rows in _given(numbers, parameters) if rows),
        f"    controller->configured = {P}_exact() ? {mark(P)} : 0U;",
        "}",
        "",
    ]
    header = _HEADER.format(P=P, guard=f"{P.upper()}_PREPARED_H")
    return {f"{P}_prepared.h": header, f"{P}_prepared.c": "\n".join(source)}


def _given(numbers: list[str], parameters: list[str]) -> tuple[tuple[str, list[str]], ...]:
    return (("design", numbers), ("parameters", parameters))


def _constant(kind: str, name: str, lines: list[str]) -> list[str]:
    return [f"    static const {kind} {name} = {{", *lines, "    };"] if lines else []


def _text(value: object, real: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return number(float(value), real)  # type: ignore[arg-type]


_HEADER = """\
/* In place of {P}_defaults and {P}_configure where no parameter changes: the same numbers, computed by the export. */
#ifndef {guard}
#define {guard}

#include "{P}.h"

#ifdef __cplusplus
extern "C" {{
#endif

void {P}_prepared({P}_controller *controller);

#ifdef __cplusplus
}}
#endif

#endif
"""


def prove(directory: Path, design: Design, tried: Trial) -> Answers:
    """Build the bundle and run a trial on an emulated core. Raises the errors of `answers`."""
    outputs = answers(directory, design, tried.inputs, tried.changes)
    return Answers(outputs.astype(np.float64), "arm-none-eabi-gcc, qemu-system-arm", "the Makefile of the bundle")
