"""Outputs of an exported controller for given inputs, from a compiler, LinuxCNC, FMPy or an emulator."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.export.c.programs import FLAGS, streamed
from feeddrive.export.design import Design
from feeddrive.export.trial import Trial
from feeddrive.language.errors import FileError, ParameterError


@dataclass(frozen=True, eq=False)
class Answers:
    """Outputs, shape (n, outputs), and by which program they were computed."""

    outputs: np.ndarray
    program: str
    how: str


@dataclass(frozen=True)
class Proof:
    """How a target answers, how many samples take some seconds, and whether parameters can change in between."""

    answer: Callable[[Path, Design, Trial, Sequence[str], str | None], Answers]
    samples: int
    changes: int = 50


def _c(directory: Path, design: Design, tried: Trial, flags: Sequence[str], command: str | None) -> Answers:
    P = design.name
    names = [name for name in (f"{P}.h", f"{P}.c", f"{P}_configure.c") if (directory / name).is_file()]
    if f"{P}.h" not in names:
        raise FileError(f"{directory / f'{P}.h'}: is missing; export again")
    files = {name: (directory / name).read_text(encoding="utf-8") for name in names}
    found = streamed(design.layout, files, tried, flags=(*FLAGS, *flags), command=command)
    return Answers(found.outputs, found.compiler, " ".join(found.flags))


def _linuxcnc(directory: Path, design: Design, tried: Trial, flags: Sequence[str], command: str | None) -> Answers:
    from feeddrive.export.linuxcnc.samples import answers

    _own_build("linuxcnc", flags, command)
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        found = answers(design.routine, directory.resolve(), Path(folder), tried.inputs)
    return Answers(found.rows[:, : len(design.routine.outputs)], "LinuxCNC, halrun", "halcompile --install")


def _fmu(directory: Path, design: Design, tried: Trial, flags: Sequence[str], command: str | None) -> Answers:
    from feeddrive.export.fmu.importer import answers

    _own_build("fmu", flags, command)
    found = answers(directory / f"{design.name}.fmu", design.routine, tried)
    import fmpy

    return Answers(found, f"FMPy {fmpy.__version__}", "the library in the FMU")


def _cortex_m(directory: Path, design: Design, tried: Trial, flags: Sequence[str], command: str | None) -> Answers:
    from feeddrive.export.cortex_m.emulator import answers

    _own_build("cortex-m", flags, command)
    found = answers(directory, design, tried.inputs, tried.changes)
    return Answers(found.astype(np.float64), "arm-none-eabi-gcc, qemu-system-arm", "the Makefile of the bundle")


def _own_build(target: str, flags: Sequence[str], command: str | None) -> None:
    if flags or command:
        raise ParameterError(f"--compiler and --flag mean nothing for the target {target}, which has its own build")


PROOFS: dict[str, Proof] = {
    "c": Proof(_c, 1_000_000),
    "linuxcnc": Proof(_linuxcnc, 50_000, changes=0),
    "fmu2": Proof(_fmu, 50_000),
    "fmu3": Proof(_fmu, 50_000),
    "cortex-m": Proof(_cortex_m, 2_000, changes=8),
}
WITHOUT = {
    "st": "runs on a PLC: {name}_check.st, in the same directory, makes the same comparison there",
    "linuxcnc-pid": "is numbers for LinuxCNC's own pid, which computes something else; its README says what",
    "parameters": "is numbers for a person to check; there is nothing to run",
}
