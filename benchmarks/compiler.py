"""C compilers of this machine, and C functions as Python calls."""

from __future__ import annotations

import atexit
import ctypes
import functools
import hashlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path


@functools.cache
def folder() -> Path:
    """A folder for libraries, taken away when the process ends."""
    made = Path(tempfile.mkdtemp(prefix="feeddrive-benchmark-"))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def compilers() -> dict[str, list[str]]:
    """Name and command of every C compiler that is here; `pip install ziglang` brings a clang."""
    found = {name: [name] for name in ("gcc", "clang") if shutil.which(name)}
    if "clang" not in found:
        try:
            import ziglang  # noqa: F401

            found["clang"] = [sys.executable, "-m", "ziglang", "cc"]
        except ImportError:
            pass
    return found


def version(command: list[str]) -> str:
    """The first line that a compiler says about itself."""
    return subprocess.run([*command, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]


def library(source: str, command: list[str], flags: list[str]) -> ctypes.CDLL:
    """C text as a loaded library. Every text gets a name of its own: a loaded one must not change."""
    name = hashlib.sha256(repr((source, command, flags)).encode()).hexdigest()[:16]
    text, made = folder() / f"{name}.c", folder() / f"{name}.so"
    if not made.exists():
        text.write_text(source)
        line = [*command, "-shared", "-fPIC", "-fno-math-errno", *flags, "-o", str(made), str(text), "-lm"]
        done = subprocess.run(line, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{' '.join(line)}\n{done.stderr[:2000]}")
    return ctypes.CDLL(str(made))
