"""The export targets by name, with the functions that write and prove them, and the general export functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from feeddrive.analysis.stability import require_stable
from feeddrive.export.design import CONTROL, PLANT, Design, read_design
from feeddrive.export.trial import Answers, Trial
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.language.errors import NoSlopeError, ParameterError, nearest

_HERE = __name__.rpartition(".")[0]


@dataclass(frozen=True)
class Proof:
    """The function `prove` of a module, with which `verify` runs an export, and the length of its trial.

    samples    number of samples, which takes some seconds
    changes    number of live parameter changes in the trial; 0 if the program does not support them
    own_build  true if the export builds itself, so that compiler and flags cannot be chosen
    """

    module: str
    samples: int
    changes: int = 50
    own_build: bool = True

    def answers(
        self, directory: Path, design: Design, tried: Trial, flags: Sequence[str], command: str | None
    ) -> Answers:
        """Run the export in a directory and return its outputs. Raises the errors of the module's `prove`."""
        compiler = () if self.own_build else (flags, command)
        return import_module(f"{_HERE}.{self.module}").prove(directory, design, tried, *compiler)


@dataclass(frozen=True)
class Target:
    """A target: the function that writes it, its capabilities, and the proof of its export.

    precisions  supported precisions, default first
    together    true if it can contain the controls of several axes as one
    linear      true if it supports linear axes only: it uses mm, or the units of a motor with its lead
    in_c        true if its code is that of the target c, whose `configure` returns the codes of violated rules
    proof       absent if the export cannot run on this computer; `unproven` gives the reason
    """

    module: str
    function: str
    options: tuple[str, ...] = ()
    precisions: tuple[str, ...] = ("double",)
    plants: bool = False
    together: bool = False
    fixed: Mapping[str, Any] = field(default_factory=dict[str, Any])
    linear: bool = False
    in_c: bool = False
    proof: Proof | None = None
    unproven: str = ""


_BOTH = ("double", "float")
TARGETS: dict[str, Target] = {
    "c": Target(
        "c_bundle",
        "write_c",
        ("single_header",),
        _BOTH,
        plants=True,
        together=True,
        in_c=True,
        proof=Proof("c_bundle", 1_000_000, own_build=False),
    ),
    "linuxcnc": Target(
        "linuxcnc",
        "write_linuxcnc",
        ("joint",),
        linear=True,
        in_c=True,
        proof=Proof("linuxcnc_session", 50_000, changes=0),
    ),
    "linuxcnc-pid": Target(
        "linuxcnc_pid",
        "write_linuxcnc_pid",
        ("joint", "route", "units"),
        linear=True,
        unproven="is numbers for LinuxCNC's own pid, which computes something else; see its README",
    ),
    "fmu2": Target("fmu", "write_fmu", plants=True, fixed={"version": 2}, in_c=True, proof=Proof("fmu", 50_000)),
    "fmu3": Target("fmu", "write_fmu", plants=True, fixed={"version": 3}, in_c=True, proof=Proof("fmu", 50_000)),
    "cortex-m": Target(
        "cortex_m",
        "write_cortex_m",
        ("core",),
        ("float", "double"),
        together=True,
        in_c=True,
        proof=Proof("cortex_m", 2_000, changes=8),
    ),
    "st": Target(
        "structured_text",
        "write_structured_text",
        precisions=_BOTH,
        unproven="runs on a PLC: {name}_check.st, in the same directory, makes the same comparison there",
    ),
    "parameters": Target(
        "parameters",
        "write_parameters",
        ("makers", "lead", "gear"),
        linear=True,
        unproven="is numbers for a person to check; there is nothing to run",
    ),
}


def write_export(
    source: MachineLike,
    target: str,
    out: str | Path | None = None,
    *,
    axis: str | None = None,
    name: str | None = None,
    precision: str | None = None,
    plant: bool = False,
    together: bool = False,
    **options: Any,
) -> tuple[Design, Path]:
    """Export the control of an axis, or with `plant` the axis itself, to a target; return the design and the README.

    source     a machine file, or the name of a bundled machine; `axis` is required if it has several axes
    plant      export the plant; without an `axis`, all axes of the file with their couplings as one plant
    target     a name in `TARGETS`
    out        directory, written atomically; default: results/export_MACHINE_AXIS_TARGET
    name       prefix of all names on the target; default: `axis_x`, or `plant_x`
    precision  "double" or "float", if the target supports both
    options    target options: `single_header`, `joint`, `route`, `units`, `core`, `makers`, `lead`, `gear`

    Raises ParameterError for an unknown target or an option of another target, UnstableError for a loop that is
    unstable with the axis of its machine file, and the errors of `read_design` and of the target's function.
    """
    design, place, write = _planned(source, target, out, axis, name, precision, plant, together, options)
    return design, write(design, place)


def write_all(
    source: MachineLike,
    target: str,
    out: str | Path | None = None,
    *,
    axis: str | None = None,
    name: str | None = None,
    precision: str | None = None,
    plant: bool = False,
    together: bool = False,
    **options: Any,
) -> list[tuple[Design, Path]]:
    """Export as `write_export` does; without an `axis`, export the controls of all axes of the machine file.

    With `together`, or if couplings between the controls exist, they become one design.  Otherwise each has a separate
    directory `out`/AXIS and, with a `name`, the prefix NAME_AXIS.  All designs are checked before the first is
    written.
    """
    machine = read_machine(source)
    axes = list(machine.loops)
    together = together or (axis is None and not plant and any(coupling.controls for coupling in machine.couplings))
    if axis is not None or plant or together or len(axes) == 1:
        return [
            write_export(
                source,
                target,
                out,
                axis=axis,
                name=name,
                precision=precision,
                plant=plant,
                together=together,
                **options,
            )
        ]
    if options.get("joint") is not None:
        raise ParameterError("--joint belongs to one axis: name the axis by --axis, or leave both out")
    planned = []
    for i, own in enumerate(axes):
        place = None if out is None else Path(out) / own
        if "joint" in _chosen(target).options:
            options["joint"] = i
        prefix = None if name is None else f"{name}_{own}"
        planned.append(_planned(source, target, place, own, prefix, precision, False, False, options))
    return [(design, write(design, place)) for design, place, write in planned]


def write_again(design: Design, target: str, out: Path, options: Mapping[str, Any]) -> None:
    """Repeat an export with the options in its `export.json`: the same design gives the same bytes.

    Raises the errors of the target's function, and TypeError for options that it does not have.
    """
    chosen = _chosen(target)
    write = getattr(import_module(f"{_HERE}.{chosen.module}"), chosen.function)
    write(design, out, **{**options, **chosen.fixed})


def _planned(
    source: MachineLike,
    target: str,
    out: str | Path | None,
    axis: str | None,
    name: str | None,
    precision: str | None,
    plant: bool,
    together: bool,
    options: Mapping[str, Any],
) -> tuple[Design, Path, Callable[[Design, Path], Path]]:
    """Return a checked design, its path, and the function that writes it."""
    chosen = _chosen(target)
    chosen_options = {key: value for key, value in options.items() if value not in (None, False, ())}
    for option in chosen_options:
        if option not in chosen.options:
            raise ParameterError(f"{_flag(option)} means nothing for the target {target}{_instead(option)}")
    for option, kind in (("joint", int), ("units", float), ("lead", float), ("gear", float)):
        value = chosen_options.get(option)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | kind)):
            wanted = "a whole number" if kind is int else "a number"
            raise ParameterError(f"{_flag(option)} = {value!r} must be {wanted}")
    if plant and not chosen.plants:
        fits = ", ".join(target_ for target_, entry in TARGETS.items() if entry.plants)
        raise ParameterError(f"--plant means nothing for the target {target}; an axis can be exported to {fits}")
    if together and (axis is not None or plant):
        raise ParameterError("--together is for the controls of all axes: leave out --axis and --plant")
    if together and not chosen.together:
        fits = ", ".join(target_ for target_, entry in TARGETS.items() if entry.together)
        raise ParameterError(
            f"--target = '{target}' holds the control of one axis; the controls of several axes as one, as a contour "
            f"control between them needs it, can be exported to {fits}"
        )
    if precision is not None and precision not in chosen.precisions:
        raise ParameterError(f"--precision = '{precision}': the target {target} has {', '.join(chosen.precisions)}")
    what = PLANT if plant else CONTROL
    design = read_design(
        source, axis, name=name, what=what, precision=precision or chosen.precisions[0], together=together
    )
    if chosen.linear and any(loop.axis.rotary for loop in design.system.loops().values()):
        fits = ", ".join(target_ for target_, entry in TARGETS.items() if not entry.linear)
        raise ParameterError(
            f"--target = '{target}': axis {design.axis} turns, and this target is written for axes that move along, in "
            f"mm or with a lead; {fits} are in rad and N m"
        )
    if not plant:
        with suppress(NoSlopeError):  # no derivative needed; the remarks state that nothing is proven
            require_stable(design.system)
    stem, part = Path(design.machine.file.name).stem, "all" if design.together else design.axis
    place = Path("results") / f"export_{stem}_{part}_{target}" if out is None else Path(out)
    write = getattr(import_module(f"{_HERE}.{chosen.module}"), chosen.function)
    return design, place, partial(write, **chosen.fixed, **chosen_options)


def _chosen(target: str) -> Target:
    if target not in TARGETS:
        raise ParameterError(f"--target = '{target}' is not a target{nearest(target, TARGETS)}")
    return TARGETS[target]


def _flag(option: str) -> str:
    """Return an option in command-line syntax."""
    flags = {"single_header": "--header-only", "makers": "--maker"}
    return flags.get(option, f"--{option}")


def _instead(option: str) -> str:
    fits = [name for name, entry in TARGETS.items() if option in entry.options]
    return f"; it belongs to {', '.join(fits)}" if fits else ""
