"""The Cortex-M cores that a bundle is made for: what they compute with, and how compiler and emulator call them."""

from __future__ import annotations

from typing import NamedTuple

from feeddrive.language.errors import ParameterError


class Core(NamedTuple):
    """A core.

    precision  that of its floating-point unit
    flags      of gcc
    machine    of qemu, a board with this core
    said       in words
    """

    name: str
    precision: str
    flags: str
    machine: str
    said: str


CORES = {
    core.name: core
    for core in (
        Core("m4f", "float", "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16", "mps2-an386", "Cortex-M4F, single precision"),
        Core("m7", "float", "-mcpu=cortex-m7 -mfpu=fpv5-sp-d16", "mps2-an500", "Cortex-M7, single precision"),
        Core("m7dp", "double", "-mcpu=cortex-m7 -mfpu=fpv5-d16", "mps2-an500", "Cortex-M7, double precision"),
    )
}


def cores_for(precision: str) -> tuple[Core, ...]:
    """The cores that compute with this precision in hardware, the usual one first."""
    return tuple(core for core in CORES.values() if core.precision == precision)


def find_core(name: str | None, precision: str) -> Core:
    """The core of a name; absent: the usual one of the precision.

    Raises ParameterError for a name that is not known, and for a core that would emulate each operation.
    """
    if name is None:
        return cores_for(precision)[0]
    if name not in CORES:
        raise ParameterError(f"core = '{name}' is not known: take one of {', '.join(CORES)}")
    core = CORES[name]
    if core.precision != precision:
        fit = " or ".join(each.name for each in cores_for(precision))
        raise ParameterError(
            f"core = '{name}' computes with {core.precision}, not with {precision}, which it would have to emulate at "
            f"some forty times the cost: export with --precision {core.precision}, or take {fit}"
        )
    return core
