"""Prepared kernels: the LLVM modules of the package's kernels as bitcode, in the folder `bitcode` beside this file.

They are made when a wheel is built, and by `make` in a clone:  python -m feeddrive.language.kernels.prepared

Without a cache on disk, the first call of a kernel then prints and parses no text; LLVM makes the machine code for the
processor at hand.  A kernel whose key has changed is printed as if nothing had been prepared.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from feeddrive.language.kernels import kernel
from feeddrive.language.kernels.kernel import QUICK, Kernel, Unit, unit_of
from feeddrive.language.machine_code import bitcode_of


def units_of_the_package() -> Iterator[Unit]:
    """Yield the unit of each file of the package that defines kernels."""
    package = Path(__file__).parents[2]
    for path in sorted(package.rglob("*.py")):
        if "\n@kernel" in path.read_text(encoding="utf-8"):
            name = ".".join([package.name, *path.relative_to(package).with_suffix("").parts])
            values = vars(import_module(name)).values()
            own = [each for each in values if isinstance(each, Kernel) and each.__module__ == name]
            yield from (unit_of(each.source) for each in own[:1])


def prepare() -> int:
    """Write the bitcode of all kernels of the package, and return its size in bytes; remove that of former kernels."""
    folder = kernel.BITCODE
    made = {folder / f"{each.key}.bc": bitcode_of(each.text(QUICK), QUICK.passes) for each in units_of_the_package()}
    folder.mkdir(exist_ok=True)
    for path in set(folder.glob("*.bc")) - made.keys():
        path.unlink()
    for path, content in made.items():
        path.write_bytes(content)
    return sum(map(len, made.values()))


if __name__ == "__main__":
    sys.stdout.write(f"{kernel.BITCODE}: {prepare() / 1e6:.1f} MB\n")
