"""Compilation of a plan to machine code, with a cache in memory and on disk."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from feeddrive.language.recent import Recent
from feeddrive.loop.engine import time_loop
from feeddrive.loop.engine.plan import Plan

# How LLVM orders instructions for few registers: from both ends of a block, which is 2 to 10 % faster here than from
# its end.  The option is one of the whole process; no program depends on it.  LLVM 20, 21 and 22 know it.
_ORDER = "-misched-prera-direction=bidirectional"
_SIGNATURE = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 5, *[ctypes.c_int64] * 2)
_NUMBER = 8  # bytes
_engines: Recent[tuple[Any, int]] = Recent(512)  # a `Native` keeps its own engine alive
_lock = Lock()


class Native:
    """A compiled plan. It owns the machine code."""

    def __init__(self, plan: Plan, source: str, *, quick: bool = False) -> None:
        """`quick` as in `native`."""
        self.plan = plan
        self.key, self._engine, address = _machine_code(source, 0 if quick else 2)
        self._call = _SIGNATURE(address)

    def run(
        self,
        count: int,
        first: int,
        constants: np.ndarray,
        inputs: np.ndarray,
        states: np.ndarray,
        outputs: np.ndarray | None,
        tables: Sequence[np.ndarray],
    ) -> None:
        """`count` samples from sample `first` on; `states` goes in and comes out, `outputs` is filled.

        constants (n, lanes), inputs (count, n), states (n, lanes), outputs (count, n, lanes): float64, C order, but the
        inputs may have any strides.
        """
        rows = (ctypes.c_void_p * max(1, len(tables)))(*[row.ctypes.data for row in tables])
        written = 0 if outputs is None else outputs.ctypes.data
        memory = constants.ctypes.data, inputs.ctypes.data, states.ctypes.data, written, ctypes.addressof(rows)
        self.run_at(count, first, memory, inputs.strides)

    def run_at(self, count: int, first: int, memory: Sequence[int], strides: Sequence[int]) -> None:
        """The same with the addresses of constants, inputs, states, outputs and tables; strides of inputs in bytes."""
        self._call(count, first, *memory, *[stride // _NUMBER for stride in strides])


def native(plan: Plan, *, flush: bool = True, quick: bool = False) -> Native:
    """The machine code of a plan.

    flush  whether numbers below the normal ones count as zero; plain Python has them
    quick  compile in a third of the time, to slower code: for what runs once
    """
    return Native(plan, time_loop.text(plan, "feeddrive_run", target()[0], flush=flush), quick=quick)


@lru_cache(maxsize=1)
def target() -> tuple[str, str, str]:
    """Triple, processor and its features."""
    import llvmlite.binding as binding

    binding.set_option("feeddrive", _ORDER)
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.get_process_triple(), binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()


def _machine_code(source: str, effort: int) -> tuple[str, Any, int]:
    """The key of the code, the engine that holds it, and the address of the function."""
    import llvmlite
    import llvmlite.binding as binding

    triple, processor, features = target()
    parts = [llvmlite.__version__, processor, features, _ORDER, str(effort), source]
    key = hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def compiled() -> tuple[Any, int]:
        machine = binding.Target.from_triple(triple).create_target_machine(
            cpu=processor, features=features, opt=effort, jit=True
        )
        module = binding.parse_assembly(source if _stored(key) is None else _stub(source))
        engine = binding.create_mcjit_compiler(module, machine)
        engine.set_object_cache(lambda _, code: _store(key, code), lambda _: _stored(key))
        engine.finalize_object()
        return engine, engine.get_function_address("feeddrive_run")

    with _lock:
        return key, *_engines.get(key, compiled)


def _stub(source: str) -> str:
    """The module without its body: enough when the code comes from the disk."""
    triple = source.split("\n", 1)[0]
    arguments = "i64, i64, ptr, ptr, ptr, ptr, ptr, i64, i64"
    return f"{triple}\ndefine void @feeddrive_run({arguments}) {{\n  ret void\n}}\n"


def cache_directory() -> Path | None:
    """Where machine code is kept: FEEDDRIVE_CACHE, else the user's cache folder; None if it is not safely the user's.

    Machine code read from there is run, so a folder that others could write to is not used.
    """
    named = os.environ.get("FEEDDRIVE_CACHE")
    if named == "":
        return None
    if named:
        place = Path(named)
    elif sys.platform == "win32":
        place = Path(os.environ.get("LOCALAPPDATA", Path.home())) / "feeddrive" / "cache"
    else:
        place = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "feeddrive"
    try:
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        status = place.stat()
    except (OSError, RuntimeError):
        return None
    if sys.platform != "win32" and (status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        return None
    return place


def _stored(key: str) -> bytes | None:
    """Machine code from the disk, if it is whole."""
    place = cache_directory()
    if place is None:
        return None
    try:
        kept = (place / f"{key}.o").read_bytes()
    except OSError:
        return None
    digest, code = kept[:32], kept[32:]
    return code if hashlib.sha256(code).digest() == digest else None


def _store(key: str, code: bytes) -> None:
    """Machine code to the disk, whole or not at all; a disk that refuses is no error."""
    place = cache_directory()
    if place is None:
        return
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=place)
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(code).digest() + code)
        os.replace(name, place / f"{key}.o")
