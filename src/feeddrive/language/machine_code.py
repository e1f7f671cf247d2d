"""LLVM text to machine code that is called by address, with a cache in memory and on disk.

The only file that knows LLVM's compiler in memory (MCJIT): the engine of the loop and the kernels hand over text.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import struct
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

from feeddrive.language.recent import Recent

# How LLVM orders instructions for few registers: from both ends of a block, which is 2 to 10 % faster here than from
# its end.  The option is one of the whole process; no program depends on it.  LLVM 20, 21 and 22 know it.
_ORDER = "-misched-prera-direction=bidirectional"


class MachineCode(NamedTuple):
    """Functions in memory, as long as this is held."""

    key: str  # of the cache
    engine: Any  # owns the code
    addresses: dict[str, int]  # of its functions
    below: tuple[MachineCode, ...] = ()  # that it calls


_kept: Recent[MachineCode] = Recent(512)  # who calls the code keeps it alive
_lock = Lock()


@lru_cache(maxsize=1)
def target() -> tuple[str, str, str]:
    """Triple, processor and its features."""
    import llvmlite.binding as binding

    binding.set_option("feeddrive", _ORDER)
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.get_process_triple(), binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()


def number(value: float) -> str:
    """A double as LLVM writes it, by its bits."""
    return f"0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"


def machine_code(source: str, entries: Sequence[str], *, effort: int, passes: Sequence[str] = ()) -> MachineCode:
    """The functions `entries` of an LLVM module whose first line is its triple.

    effort  of the selection of instructions and registers, 0 to 3
    passes  of the optimizer before that, in order, by their names in llvmlite: `sroa` is its `add_sroa_pass`
    """
    key = _key(source, effort, passes)

    def compiled() -> MachineCode:
        return _made(key, _stored(key), lambda: source, entries, effort, passes)

    with _lock:
        return _kept.get(key, compiled)


def linked_code(
    content: str,
    source: Callable[[], str],
    names: Sequence[str],
    symbols: Mapping[str, int],
    below: Sequence[MachineCode],
    *,
    effort: int,
    passes: Sequence[str] = (),
    stored: bool = False,
) -> MachineCode | None:
    """The functions `names` of an LLVM module that calls those of others, whose addresses are the `symbols`.

    content  all that the text depends on: the key, so that the text is printed only if the code is not on the disk
    below    the code that holds the other functions
    stored   return None if the code is not on the disk
    """
    import llvmlite.binding as binding

    key = _key(content, effort, passes)
    with _lock:
        code = _stored(key)
        if stored and code is None:
            return None
        for name, address in symbols.items():
            binding.add_symbol(name, address)
        compiled = _made(key, code, source, names, effort, passes)
    return compiled._replace(below=tuple(below))


def _key(content: str, effort: int, passes: Sequence[str]) -> str:
    """The key of machine code in memory and on disk."""
    import llvmlite

    _, processor, features = target()
    parts = [llvmlite.__version__, processor, features, _ORDER, str(effort), *passes, content]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _made(
    key: str, stored: bytes | None, source: Callable[[], str], names: Sequence[str], effort: int, passes: Sequence[str]
) -> MachineCode:
    """Load machine code, or compile it and store it on the disk."""
    import llvmlite.binding as binding

    triple, processor, features = target()
    machine = binding.Target.from_triple(triple).create_target_machine(
        cpu=processor, features=features, opt=effort, jit=True
    )
    module = binding.parse_assembly(source() if stored is None else _stubs(triple, names))
    if stored is None and passes:
        _optimize(module, machine, passes)
    engine = binding.create_mcjit_compiler(module, machine)
    engine.set_object_cache(lambda _, code: _store(key, code), lambda _: stored)
    engine.finalize_object()
    return MachineCode(key, engine, {name: engine.get_function_address(name) for name in names})


def _optimize(module: Any, machine: Any, passes: Sequence[str]) -> None:
    """Run passes of LLVM over a module; none of them may change the result of an operation on floats."""
    import llvmlite.binding as binding

    manager = binding.create_new_module_pass_manager()
    for name in passes:
        getattr(manager, f"add_{name}_pass")()
    manager.run(module, binding.create_pass_builder(machine, binding.create_pipeline_tuning_options()))


def _stubs(triple: str, names: Sequence[str]) -> str:
    """A module of empty functions, which is enough when the code comes from the disk."""
    return "\n".join([f'target triple = "{triple}"', *[f"define void @{name}() {{\n  ret void\n}}" for name in names]])


def cache_directory() -> Path | None:
    """The folder of machine code: FEEDDRIVE_CACHE, else the user's cache folder; None if it is not safely the user's.

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
    """Read machine code from the disk; None if it is missing or damaged."""
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
    """Store machine code on the disk, whole or not at all; a disk that refuses is no error."""
    place = cache_directory()
    if place is None:
        return
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=place)
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(code).digest() + code)
        os.replace(name, place / f"{key}.o")
