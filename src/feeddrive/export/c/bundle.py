"""The target `c`: a directory with a routine as C99, a self-test, builds for make and CMake, and a README."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.c.programs import SAMPLES, self_test
from feeddrive.export.c.text import header_only, texts
from feeddrive.export.design import CONTROL, Design
from feeddrive.export.manifest import readme, write_bundle

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
    files["README.md"] = readme("c.md.j2", design, samples=SAMPLES, flags=FLAGS)
    return files


def write_c(design: Design, out: str | Path, *, single_header: bool = False) -> Path:
    """Write the export, completely or not at all; returns the README. Raises FileError as `new_directory`."""
    files = c_files(design, single_header=single_header)
    return write_bundle(design, "c", Path(out), files, single_header=single_header)


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
  # a fused multiply-add rounds once and would give other bits than the simulation
  target_compile_options({P} {scope} -ffp-contract=off)
  target_link_libraries({P} {scope} m)
endif()
{test if tested else ""}"""
