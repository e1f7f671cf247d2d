"""The target `cortex-m`: a directory with the step for a core, builds, a self-test in an emulator, and a README."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.c.bundle import c_files
from feeddrive.export.cortex_m.builds import FLAGS, PACKAGES, Core, cmake_lists, find_core, makefile, toolchain
from feeddrive.export.cortex_m.programs import STARTUP, answer_program, count_program, linker_script, prepared_files
from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.manifest import FILE, manifest_text
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import ParameterError
from feeddrive.loop.guard import TRIPS


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
        "README.md": readme(design, core),
    }


def write_cortex_m(design: Design, out: Path, *, core: str | None = None) -> Path:
    """Write the bundle, whole or not at all; its README is returned.

    core  `m4f` or `m7` in single precision, `m7dp` in double; absent: the first that computes with the precision

    Raises ParameterError for an axis, for a core that is not known or computes with another precision, and FileError
    as `new_directory`.
    """
    if design.what != CONTROL:
        raise ParameterError("cortex-m: a microcontroller runs the control; export an axis as fmu2, fmu3 or c")
    chosen = find_core(core, design.layout.precision)
    files = cortex_m_files(design, chosen)
    files[MACHINE_FILE] = design.machine.file.text
    files[FILE] = manifest_text(design, "cortex-m", files, core=chosen.name)
    with new_directory(out) as folder:
        (folder / "selftest").mkdir()
        for name, content in files.items():
            (folder / name).write_text(content, encoding="utf-8")
    return out / "README.md"


def readme(design: Design, core: Core) -> str:
    """The text."""
    codes = "\n".join(f"| {code:g} | {text} |" for code, text in TRIPS.items())
    return _TEXT.format(
        title=design.title, made_by=design.made_by, P=design.name, core=core.name, said=core.said,
        flags=f"{core.flags} -mthumb -mfloat-abi=hard {FLAGS}", rate=f"{1.0 / design.routine.sample_time:g}",
        period=f"{1e6 * design.routine.sample_time:g}", packages=" ".join(PACKAGES.values()), codes=codes,
        given=", ".join(f"`{v.name}`" + (f" ({v.unit})" if v.unit else "") for v in design.routine.inputs),
        taken=", ".join(f"`{v.name}`" + (f" ({v.unit})" if v.unit else "") for v in design.routine.outputs),
        real=design.layout.precision, act=_act(design),
    )  # fmt: skip


def _act(design: Design) -> str:
    """The line that hands the command on: in the drive's unit, where the machine file has a motor."""
    units = {v.name: v.unit for v in design.routine.outputs}
    name = "command" if "command" in units else "force"
    return f"{f'write_drive(outputs.{name});':<40}/* {units[name]} */"


_TEXT = """\
# {title}

For a {said}. {made_by}

**Before this moves an axis**: check sign and unit of every reading and of the command with the power stage off; make
the first moves with a reduced force limit, the emergency stop in reach, and a hanging axis held from below. This text
was proven to compute what was simulated; nobody proved that the machine is the one that was simulated.

| file | what it is |
|---|---|
| `{P}.h`, `{P}.c` | `{P}_reset` and `{P}_step`: no heap, no globals, no library but a few instructions of `<math.h>` |
| `{P}_configure.c` | defaults, configure and retune: what depends on parameters only, in double precision |
| `{P}_prepared.h`, `{P}_prepared.c` | the numbers that configure makes of the machine file, as constants |
| `Makefile`, `CMakeLists.txt`, `cortex-m.cmake` | builds |
| `selftest/` | start-up code, memory map and programs for the emulated boards of qemu: not for your board |
| `{P}_vectors.h` | stored samples and the answers that are expected |

In: {given}.
Out: {taken}.
Numbers are {real} and SI; the parameters are double and SI, with their units in `{P}.h`.

## Call it from the interrupt of the current loop

```c
#include "{P}.h"

static {P}_controller controller;

void start(void)                            /* in thread mode, before the interrupt is enabled */
{{
    {P}_parameters parameters;
    {P}_inputs inputs;
    FPU->FPDSCR |= 3u << 24;                /* flush to zero and default NaN, for interrupts; CPACR: see Traps */
    __set_FPSCR(__get_FPSCR() | 3u << 24);  /* the same for thread mode */
    inputs = read_axis();
    {P}_defaults(&parameters);
    if (!{P}_configure(&controller, &parameters)) {{
        stop();                             /* a parameter is out of its bounds */
    }}
    {P}_reset(&controller, &inputs);
}}

void TIM1_UP_IRQHandler(void)               /* {rate} Hz: every {period} µs */
{{
    {P}_inputs inputs = read_axis();
    {P}_outputs outputs;
    {P}_step(&controller, &inputs, &outputs);
    if (outputs.enabled < 0.5f) {{
        drop_power_stage();
    }}
    {act}
}}
```

Order within the sample: latch the encoder in hardware, read, step, write. The command then acts with the dead time that
the simulation was given; writing it at the start of the next sample adds a whole one.

## Traps

- **CPACR.** The unit is off after reset; the first instruction of it is a usage fault. `SystemInit` of most vendors
  switches it on: `SCB->CPACR |= 0xFu << 20; __DSB(); __ISB();`. Do it there or in the reset handler, in a function that
  does not compute with floats: a compiler may push one of their registers on entry.
- **FPSCR in an interrupt.** At the entry of an interrupt that uses the unit FPSCR is loaded from **FPDSCR**, not taken
  over from thread mode. Bit 24 flushes numbers below the normal ones to zero, as the simulation does; without it a
  velocity that dies out ends in numbers of other bits. Bit 25 makes every NaN the default one.
- **Lazy stacking** (FPCCR.LSPEN and ASPEN, on after reset). The processor reserves room for 17 words at entry and
  writes them when the handler first uses the unit: the step costs these cycles once when thread mode was computing with
  floats. Count on 26 words of stack for the frame. Do not clear ASPEN unless no other code uses the unit.
- **Priorities.** `{P}_step` is not to be entered twice with one controller. `{P}_retune` goes between two samples: in
  the same interrupt, or with it masked. `{P}_configure` and `{P}_retune` compute in double precision. A core that has
  only single precision does so in software: some thousand instructions for a P-PI cascade, 170 000 for a GPI observer
  of seven states. What does not fit between two samples is for an axis that is off.
- **Flash.** Configure is large for laws with a matrix exponential, above all with double precision in software. If no
  parameter ever changes, call `{P}_prepared(&controller)` in place of defaults and configure: the same numbers, and
  the linker leaves the rest out.
- **Long axes.** A float of half a metre has steps of 30 nm, which a differenced velocity divides by the sample time.
  In single precision put the origin into the middle of the travel and subtract it as whole counts, before the reading
  becomes a float.
- **Fused multiply-add.** `-ffp-contract=off` keeps gcc from `vfma`, which rounds once where the simulation rounds
  twice. Never `-ffast-math`.

Compile with

    {flags}

## What `trip` says

| code | tripped by |
|---|---|
| 0 | nothing |
{codes}

A trip is latched. Take `enable` away and give it again: the loop takes over where the axis is.

## Is it right, and what does it cost?

    make selftest   # every output of the stored samples, bit for bit, on an emulated core
    make report     # memory, and executed instructions of a step

These need `apt-get install {packages}`.
Instructions are no cycles: a division takes 14, most others 1, and flash wait states come on top.

`feeddrive verify .` proves it with more samples.
"""
