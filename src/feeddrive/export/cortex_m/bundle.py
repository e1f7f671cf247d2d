"""The target `cortex-m`: a directory with the step for a core, builds, a self-test in an emulator, and a README."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from feeddrive.export.c.bundle import c_files
from feeddrive.export.cortex_m.builds import FLAGS, PACKAGES, Core, cmake_lists, find_core, makefile, toolchain
from feeddrive.export.cortex_m.programs import STARTUP, answer_program, count_program, linker_script, prepared_files
from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.manifest import FILE, manifest_text
from feeddrive.export.readme import readme
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import ParameterError
from feeddrive.loop.routine import Variable


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


def _readme(design: Design, core: Core) -> str:
    routine = design.routine
    return readme(
        "cortex_m.md.j2", design, core=core, flags=f"{core.flags} -mthumb -mfloat-abi=hard {FLAGS}",
        rate=f"{1.0 / routine.sample_time:g}", period=f"{1e6 * routine.sample_time:g}",
        packages=" ".join(PACKAGES.values()), real=design.layout.precision, act=_act(design),
        given=_named(routine.inputs), taken=_named(routine.outputs),
    )  # fmt: skip


def _named(variables: Sequence[Variable]) -> str:
    return ", ".join(f"`{v.name}`" + (f" ({v.unit})" if v.unit else "") for v in variables)


def _act(design: Design) -> str:
    """The line that hands the command on: in the drive's unit, where the machine file has a motor."""
    units = {v.name: v.unit for v in design.routine.outputs}
    name = "command" if "command" in units else "force"
    return f"{f'write_drive(outputs.{name});':<40}/* {units[name]} */"
