"""The supported Cortex-M cores: build files, and build and run of a bundle on an emulated core."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from feeddrive.export.design import Design
from feeddrive.export.trial import Answers, Trial
from feeddrive.language.errors import FeeddriveError, MissingProgramError, ParameterError
from feeddrive.language.quantity import Quantity

FLAGS = "-std=c99 -O2 -ffp-contract=off -fno-math-errno"
WARNINGS = "-Wall -Wextra -Wconversion -Wdouble-promotion"
COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
PACKAGES = {
    COMPILER: "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    EMULATOR: "qemu-system-arm",
    "make": "make",
}  # of Debian and Ubuntu


def makefile(P: str, core: Core) -> str:
    """Targets: the library, the self-test in the emulator, size, instruction count, and both as a report."""
    others = [each for each in CORES.values() if each.precision == core.precision]
    flags = "\n".join(f"FLAGS_{each.name} := {each.flags}" for each in others)
    machines = "\n".join(f"MACHINE_{each.name} := {each.machine}" for each in others)
    return f"""\
# make            lib{P}.a for your project
# make selftest   runs the stored samples on an emulated core and compares every output, bit for bit
# make report     REPORT.md: memory, and executed instructions of a step
# CORE = {" or ".join(each.name for each in others)}
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
    """The library for a project with CMake."""
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
    """A toolchain file for CMake."""
    return f"""\
# {core.said}:  cmake -B build -DCMAKE_TOOLCHAIN_FILE=cortex-m.cmake -DCMAKE_BUILD_TYPE=Release
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
    """A core.

    precision  that of its floating-point unit
    flags      of gcc
    machine    of qemu, a board with this core
    said       in words
    """

    name: str
    precision: str
    flags: str
    machine: str
    said: str


CORES = {
    core.name: core
    for core in (
        Core("m4f", "float", "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16", "mps2-an386", "Cortex-M4F, single precision"),
        Core("m7", "float", "-mcpu=cortex-m7 -mfpu=fpv5-sp-d16", "mps2-an500", "Cortex-M7, single precision"),
        Core("m7dp", "double", "-mcpu=cortex-m7 -mfpu=fpv5-d16", "mps2-an500", "Cortex-M7, double precision"),
    )
}


def cores_for(precision: str) -> tuple[Core, ...]:
    """The cores that compute with this precision in hardware, the usual one first."""
    return tuple(core for core in CORES.values() if core.precision == precision)


def find_core(name: str | None, precision: str) -> Core:
    """The core of a name; absent: the usual one of the precision.

    Raises ParameterError for a name that is not known, and for a core that would emulate each operation.
    """
    if name is None:
        return cores_for(precision)[0]
    if name not in CORES:
        raise ParameterError(f"core = '{name}' is not known: take one of {', '.join(CORES)}")
    core = CORES[name]
    if core.precision != precision:
        fit = " or ".join(each.name for each in cores_for(precision))
        raise ParameterError(
            f"core = '{name}' computes with {core.precision}, not with {precision}, which it would have to emulate at "
            f"some forty times the cost: export with --precision {core.precision}, or take {fit}"
        )
    return core


PATIENCE = 300.0  # s, for a build and a run


class EmulatorError(FeeddriveError):
    """A bundle did not build, timed out, or its self-test found a difference; the message has the output."""

    exit_code = 1


@dataclass(frozen=True)
class Cost:
    """Cost of a step on a core, over the stored samples of a bundle.

    least, most  executed instructions of a step, called functions included
    flash        bytes of reset and step
    configure    bytes of the code that runs once, without library functions; prepared: of the constants instead
    memory       bytes of a controller in RAM
    """

    least: int
    most: int
    flash: int
    configure: int
    prepared: int
    memory: int


def check_programs() -> None:
    """Raise MissingProgramError, naming the package, unless compiler, emulator and make are there."""
    for program in ("make", COMPILER, EMULATOR):
        if shutil.which(program) is None:
            raise MissingProgramError(program, PACKAGES[program], "running a bundle for a Cortex-M")


def self_test(bundle: Path) -> str:
    """The output of a bundle's self-test. Raises MissingProgramError, or EmulatorError if it does not pass."""
    return _made(bundle, "selftest")[0]


def step_cost(bundle: Path, optimise: str = "-O2") -> Cost:
    """Size and instruction count of a bundle. Raises as `self_test`."""
    _, found = _made(bundle, f"OPTIMISE={optimise}", "REPORT.md", read="REPORT.md")
    report = found.decode()
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
    """The outputs of an emulated core, shape (n, outputs), for inputs of shape (n, inputs), from a reset on.

    changes             other parameters, by sample and dotted name
    optimise_configure  compiler option for the code that runs once; it changes the compile time, not the results

    Raises as `self_test`.
    """
    real = np.float64 if design.layout.precision == "double" else np.float32
    values = {v.path: v.value for v in design.routine.parameters}
    with np.errstate(over="ignore"):
        rows = np.asarray(inputs).astype(real)
    pieces: list[bytes] = []
    for k, row in enumerate(rows):
        if k in changes:
            values |= changes[k]
            pieces += [b"\1\0\0\0", np.array(list(values.values()), dtype=np.float64).tobytes()]
        else:
            pieces.append(b"\0\0\0\0")
        pieces.append(row.tobytes())
    _, found = _made(
        bundle, f"OPTIMISE_CONFIGURE={optimise_configure}", "answers.bin",
        given={"samples.bin": b"".join(pieces)}, read="answers.bin",
    )  # fmt: skip
    return np.frombuffer(found, dtype=real).reshape(len(rows), len(design.routine.outputs))


def _made(bundle: Path, *targets: str, given: Mapping[str, bytes] | None = None, read: str = "") -> tuple[str, bytes]:
    """The output of `make` in a copy of the bundle, and one of the files that it builds."""
    check_programs()
    with tempfile.TemporaryDirectory(prefix="feeddrive-cortex-m-") as name:
        folder = Path(name) / "bundle"
        shutil.copytree(bundle, folder, ignore=shutil.ignore_patterns("*.o", "*.a", "*.elf", "*.d"))
        for file, content in (given or {}).items():
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


def prove(directory: Path, design: Design, tried: Trial) -> Answers:
    """Build the bundle and run a trial on an emulated core. Raises as `answers`."""
    outputs = answers(directory, design, tried.inputs, tried.changes)
    return Answers(outputs.astype(np.float64), "arm-none-eabi-gcc, qemu-system-arm", "the Makefile of the bundle")
