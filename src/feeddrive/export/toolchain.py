"""The C compiler of this computer."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from feeddrive.language.errors import FileError, MissingProgramError


def compiler(command: str | None = None) -> list[str]:
    """The words that start the C compiler: the one named, else gcc, cc or clang, else that of the package ziglang.

    Raises MissingProgramError if there is none.
    """
    for name in (command,) if command else ("gcc", "cc", "clang"):
        found = shutil.which(name)
        if found is not None:
            return [found]
    if command is None and importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise MissingProgramError(command or "gcc", "gcc libc6-dev", "compiling exported C")


def version(command: str | None = None) -> str:
    """The first line of what the compiler says of itself."""
    done = subprocess.run([*compiler(command), "--version"], capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines()
    return lines[0] if lines else Path(compiler(command)[0]).name


def compiled(folder: Path, sources: Sequence[str], flags: Sequence[str], command: str | None = None) -> Path:
    """The program made of some C files of a folder.

    What runs once, `*_configure.c`, is translated without optimization, which would take seconds for nothing.
    Raises MissingProgramError without a compiler and FileError with its first message if it refuses.
    """
    words = compiler(command)
    objects = []
    for name in sources:
        effort = ["-O0"] if name.endswith("_configure.c") else []
        _run([*words, *flags, *effort, "-c", name, "-o", f"{name}.o"], folder)
        objects.append(f"{name}.o")
    _run([*words, *flags, "-o", "program", *objects, "-lm"], folder)
    return folder / "program"


def _run(words: Sequence[str], folder: Path) -> None:
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = (done.stderr.strip() or "it says nothing").splitlines()
        first = next((line for line in said if "error" in line), said[0])
        raise FileError(f"the C compiler {words[0]} refuses: {first}")
