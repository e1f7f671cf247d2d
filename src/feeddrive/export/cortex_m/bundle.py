"""The target `cortex-m`: a directory with the step for a core, builds, a self-test in an emulator, and a README."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.c.directory import c_files
from feeddrive.export.cortex_m.builds import cmake_lists, makefile, toolchain
from feeddrive.export.cortex_m.cores import Core, find_core
from feeddrive.export.cortex_m.prepared import prepared_files
from feeddrive.export.cortex_m.programs import answer_program, count_program
from feeddrive.export.cortex_m.readme import readme
from feeddrive.export.cortex_m.startup import STARTUP, linker_script
from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.manifest import FILE, manifest_text
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import ParameterError


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
