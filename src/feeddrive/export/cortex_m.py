"""The target `cortex-m`: the step for a core, constants instead of configure, test programs, README."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from feeddrive.export.c.bundle import c_files
from feeddrive.export.c.header import mark
from feeddrive.export.c.programs import filled
from feeddrive.export.c.statements import number
from feeddrive.export.cortex_m_builds import FLAGS, PACKAGES, Core, cmake_lists, find_core, makefile, toolchain
from feeddrive.export.design import CONTROL, Design
from feeddrive.export.layout import Layout
from feeddrive.export.layout_run import LayoutRun
from feeddrive.export.manifest import readme, write_bundle
from feeddrive.language.errors import ParameterError
from feeddrive.loop.routine import Variable, target_name


def cortex_m_files(design: Design, core: Core) -> dict[str, str]:
    """The files of the bundle by name, without machine file and manifest."""
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
    """Write the bundle, completely or not at all; returns its README.

    core  `m4f` or `m7` in single precision, `m7dp` in double; absent: the first that computes with the precision

    Raises ParameterError for an axis, for a core that is not known or computes with another precision, and FileError
    as `new_directory`.
    """
    if design.what != CONTROL:
        raise ParameterError("cortex-m: a microcontroller runs the control; export an axis as fmu2, fmu3 or c")
    chosen = find_core(core, design.layout.precision)
    files = cortex_m_files(design, chosen)
    return write_bundle(design, "cortex-m", out, files, core=chosen.name)


def _readme(design: Design, core: Core) -> str:
    routine = design.routine
    return readme(
        "cortex_m.md.j2", design, core=core, flags=f"{core.flags} -mthumb -mfloat-abi=hard {FLAGS}",
        rate=f"{1.0 / routine.sample_time:g}", period=f"{1e6 * routine.sample_time:g}",
        packages=" ".join(PACKAGES.values()), real=design.layout.precision, act=_act(design),
        off=" || ".join(f"outputs.{target_name(f'{port}enabled')} < 0.5f" for port in routine.origin.ports()),
        given=_named(routine.inputs), taken=_named(routine.outputs),
    )  # fmt: skip


def _named(variables: Sequence[Variable]) -> str:
    return ", ".join(f"`{v.name}`" + (f" ({v.unit})" if v.unit else "") for v in variables)


def _act(design: Design) -> str:
    """The C lines that pass the commands to the drives, in the drive's unit if the machine file has a motor."""
    units, lines = {v.path: v.unit for v in design.routine.outputs}, list[str]()
    for port in design.routine.origin.ports():
        path = f"{port}command" if f"{port}command" in units else f"{port}force"
        drive = f"write_drive{f'_{port[:-1]}' if port else ''}(outputs.{target_name(path)});"
        lines.append(f"{drive:<40}/* {units[path]} */")
    return "\n    ".join(lines)


def count_program(layout: Layout) -> str:
    """A program that runs each stored step between two marks, for counting its instructions."""
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
    """Reads samples from `samples.bin` on the host and writes the outputs to `answers.bin`.

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
    """Linker script of the emulated boards; section `core` has the step and its functions, to be counted."""
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
    """`P_prepared.h` and `P_prepared.c`; they replace configure, which then need not be linked."""
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
    ]  # fmt: skip
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
