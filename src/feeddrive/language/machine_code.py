"""Compile LLVM text to machine code that is called by address, with a cache in memory and on disk.

This is the only module that uses LLVM's in-memory compiler (MCJIT): the loop engine and the kernels pass LLVM text.
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

# Instruction scheduling before register allocation, from both ends of a block: 2 to 10 % faster here than from its end.
# The option applies to the whole process; no result depends on it.  LLVM 20, 21 and 22 support it.
_ORDER = "-misched-prera-direction=bidirectional"


class MachineCode(NamedTuple):
    """Compiled functions, which stay in memory as long as this object exists."""

    key: str  # cache key
    engine: Any  # owns the code
    addresses: dict[str, int]  # by function name
    below: tuple[MachineCode, ...] = ()  # machine code that it calls


_kept: Recent[MachineCode] = Recent(512)  # callers keep their code alive themselves
_lock = Lock()


@lru_cache(maxsize=1)
def target() -> tuple[str, str, str]:
    """Return the target triple, the processor name and its features."""
    # imported on first use: commands that compile nothing start without LLVM
    import llvmlite.binding as binding

    binding.set_option("feeddrive", _ORDER)
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.get_process_triple(), binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()


def number(value: float) -> str:
    """Return a double as an LLVM hexadecimal literal, bit for bit."""
    return f"0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"


def machine_code(source: str, entries: Sequence[str], *, effort: int, passes: Sequence[str] = ()) -> MachineCode:
    """Return the compiled functions `entries` of an LLVM module whose first line is its target triple.

    effort  optimization level of code generation, 0 to 3
    passes  optimizer passes before code generation, in order, by llvmlite name: `sroa` means `add_sroa_pass`
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
    prepared: Callable[[], bytes | None] | None = None,
) -> MachineCode | None:
    """Return the compiled functions `names` of an LLVM module that calls external functions at the addresses `symbols`.

    content  everything on which the LLVM text depends; it serves as the cache key, so that `source` generates the text
             only on a cache miss
    below    the machine code of the external functions
    stored   if True, return None when the code is not in the disk cache
    prepared returns the module as bitcode that the passes have run over, if there is any: it spares text and passes
    """
    import llvmlite.binding as binding

    key = _key(content, effort, passes)
    with _lock:
        code = _stored(key)
        if stored and code is None:
            return None
        # under the lock: LLVM has one table of external symbols for the whole process
        for name, address in symbols.items():
            binding.add_symbol(name, address)
        compiled = _made(key, code, source, names, effort, passes, prepared)
    return compiled._replace(below=tuple(below))


def _key(content: str, effort: int, passes: Sequence[str]) -> str:
    """Return the key of machine code in the caches in memory and on disk."""
    import llvmlite

    _, processor, features = target()
    # the cache may be shared by machines whose processors cannot run each other's code
    parts = [llvmlite.__version__, processor, features, _ORDER, str(effort), *passes, content]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _made(
    key: str,
    stored: bytes | None,
    source: Callable[[], str],
    names: Sequence[str],
    effort: int,
    passes: Sequence[str],
    prepared: Callable[[], bytes | None] | None = None,
) -> MachineCode:
    """Load cached machine code, or compile it and store it on disk."""
    import llvmlite.binding as binding

    triple, processor, features = target()
    machine = binding.Target.from_triple(triple).create_target_machine(
        cpu=processor, features=features, opt=effort, jit=True
    )
    module = _parsed(prepared, triple) if stored is None else binding.parse_assembly(_stubs(triple, names))
    if module is None:
        module = binding.parse_assembly(source())
        if passes:
            _optimize(module, machine, passes)
    engine = binding.create_mcjit_compiler(module, machine)
    engine.set_object_cache(lambda _, code: _store(key, code), lambda _: stored)
    engine.finalize_object()
    return MachineCode(key, engine, {name: engine.get_function_address(name) for name in names})


def _parsed(prepared: Callable[[], bytes | None] | None, triple: str) -> Any:
    """Return the module of prepared bitcode, or None if there is none that this version of LLVM reads."""
    import llvmlite.binding as binding

    given = prepared() if prepared else None
    # LLVM reads the bitcode of older versions only
    with contextlib.suppress(RuntimeError):
        module = None if given is None else binding.parse_bitcode(given)
        if module is not None:
            module.triple = triple
        return module
    return None


def bitcode_of(source: str, passes: Sequence[str]) -> bytes:
    """Return the bitcode of an LLVM module after some passes."""
    import llvmlite.binding as binding

    triple, processor, features = target()
    module = binding.parse_assembly(source)
    _optimize(
        module, binding.Target.from_triple(triple).create_target_machine(cpu=processor, features=features), passes
    )
    return module.as_bitcode()


def _optimize(module: Any, machine: Any, passes: Sequence[str]) -> None:
    """Run LLVM passes on a module; none of them may change the result of a floating-point operation."""
    import llvmlite.binding as binding

    manager = binding.create_new_module_pass_manager()
    for name in passes:
        getattr(manager, f"add_{name}_pass")()
    manager.run(module, binding.create_pass_builder(machine, binding.create_pipeline_tuning_options()))


def _stubs(triple: str, names: Sequence[str]) -> str:
    """Return an LLVM module of empty functions with these names, which suffices if the code is loaded from disk."""
    return "\n".join([f'target triple = "{triple}"', *[f"define void @{name}() {{\n  ret void\n}}" for name in names]])


def cache_directory() -> Path | None:
    """Return the cache folder: FEEDDRIVE_CACHE, otherwise the user's cache folder; None if it is unavailable or unsafe.

    Machine code from this folder is executed, so a folder that other users own or can write to is not used.
    """
    named = os.environ.get("FEEDDRIVE_CACHE")
    if named == "":
        return None
    try:
        if named:
            place = Path(named)
        elif sys.platform == "win32":
            place = Path(os.environ.get("LOCALAPPDATA") or Path.home()) / "feeddrive" / "cache"
        else:
            place = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "feeddrive"
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        status = place.stat()
    # a user of a container may have no home directory: a RuntimeError
    except (OSError, RuntimeError):
        return None
    if sys.platform != "win32" and (status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        return None
    return place


def _stored(key: str) -> bytes | None:
    """Read machine code from disk; return None if it is missing or damaged."""
    place = cache_directory()
    if place is None:
        return None
    try:
        kept = (place / f"{key}.o").read_bytes()
    except OSError:
        return None
    # a truncated file would be executed as machine code
    digest, code = kept[:32], kept[32:]
    return code if hashlib.sha256(code).digest() == digest else None


def _store(key: str, code: bytes) -> None:
    """Store machine code on disk."""
    _write(f"{key}.o", hashlib.sha256(code).digest() + code)


def time_spent(content: str) -> float:
    """Return how long code has run in earlier processes, s, by the key of its content; 0 if that is not on disk."""
    place = cache_directory()
    with contextlib.suppress(OSError, ValueError):
        return 0.0 if place is None else float((place / f"{content}.s").read_text(encoding="ascii"))
    return 0.0


def store_time_spent(content: str, seconds: float) -> None:
    """Store how long code has run, s, by the key of its content."""
    _write(f"{content}.s", f"{seconds:.6f}".encode())


def _write(name: str, content: bytes) -> None:
    """Write a file of the disk cache atomically; a failed write is ignored."""
    place = cache_directory()
    if place is None:
        return
    with contextlib.suppress(OSError):
        # written beside and renamed: other processes may read the cache at the same time
        handle, temporary = tempfile.mkstemp(dir=place)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(temporary, place / name)
