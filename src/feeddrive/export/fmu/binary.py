"""A shared library for this computer from the sources of an FMU, built with the installed compiler."""

from __future__ import annotations

import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from feeddrive.export.toolchain import compiler
from feeddrive.language.errors import FileError

_FLAGS = (
    "-std=c99", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden", "-fno-sanitize=undefined",
)  # fmt: skip


def library_place(version: int) -> str:
    """The folder of the FMU in which a tool on this machine looks, and the ending of a library: `linux64/*.so`."""
    system = {"Linux": "linux", "Darwin": "darwin", "Windows": "windows"}.get(platform.system(), "linux")
    wide = sys.maxsize > 2**32
    ending = {"linux": "so", "darwin": "dylib", "windows": "dll"}[system]
    if version == 2:
        return f"{system.replace('windows', 'win')}{64 if wide else 32}/*.{ending}"
    arm = platform.machine().lower() in ("aarch64", "arm64")
    return f"{'aarch64' if arm else 'x86_64' if wide else 'x86'}-{system}/*.{ending}"


def compiled(files: Mapping[str, str], sources: Sequence[str]) -> bytes:
    """The shared library made of some of the files.

    What runs once, `*_configure.c`, is translated as it stands: to optimise its thousands of lines takes seconds.

    Raises MissingProgramError without a compiler and FileError with its first message if it refuses.
    """
    words = compiler()
    flags = _FLAGS if platform.system() == "Windows" else (*_FLAGS, "-fPIC")
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        objects = [f"{name}.o" for name in sources]
        for name, made in zip(sources, objects, strict=True):
            effort = "-O0" if name.endswith("_configure.c") else "-O2"
            _run([*words, *flags, effort, "-c", name, "-o", made], folder)
        _run([*words, "-shared", "-s", "-o", "library", *objects, "-lm"], folder)
        return (Path(folder) / "library").read_bytes()


def _run(words: Sequence[str], folder: str) -> None:
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        first = (done.stderr.strip() or "it says nothing").splitlines()[0]
        raise FileError(f"the C compiler ({words[0]}) cannot make a shared library: {first}")
