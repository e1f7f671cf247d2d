"""Build and run of a bundle on an emulated core: self-test, memory, instruction count, outputs for given samples."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.export.cortex_m.builds import COMPILER, EMULATOR, PACKAGES
from feeddrive.export.design import Design
from feeddrive.language.errors import FeeddriveError, MissingProgramError

PATIENCE = 300.0  # s, for a build and a run


class EmulatorError(FeeddriveError):
    """A bundle did not build, did not end, or its self-test found a difference; the message holds what was printed."""


@dataclass(frozen=True)
class Cost:
    """What a step costs on a core, over the stored samples of a bundle.

    least, most  executed instructions of a step, with all that it calls
    flash        bytes of reset and step
    configure    bytes of what runs once, without the library's own;  prepared: bytes of the constants in its place
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
    """What the self-test of a bundle prints. Raises MissingProgramError, or EmulatorError if it does not pass."""
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
    optimise_configure  of the compiler, for what runs once: the bits are the same with all, the time to compile is not

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
    """What `make` prints in a copy of the bundle, and one of the files that it makes."""
    check_programs()
    with tempfile.TemporaryDirectory(prefix="feeddrive-cortex-m-") as name:
        folder = Path(name) / "bundle"
        shutil.copytree(bundle, folder, ignore=shutil.ignore_patterns("*.o", "*.a", "*.elf", "*.d"))
        for file, content in (given or {}).items():
            (folder / file).write_bytes(content)
        command = ["make", "-s", *targets]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            raise EmulatorError(f"{bundle}: `{' '.join(command)}` did not end within {PATIENCE:g} s") from None
        if done.returncode != 0:
            raise EmulatorError(f"{bundle}: `{' '.join(command)}` failed:\n{done.stdout}{done.stderr}")
        return done.stdout, (folder / read).read_bytes() if read else b""
