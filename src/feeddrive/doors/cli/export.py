"""`feeddrive export`: from a machine file to what a target runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from feeddrive.artefacts.export.design import CONTROL, PLANT, Design, read_design
from feeddrive.artefacts.files.toml_lines import nearest
from feeddrive.language.errors import ParameterError


@dataclass(frozen=True)
class Asked:
    """What the command line says."""

    source: str
    axis: str | None
    target: str
    out: Path | None
    name: str | None
    precision: str | None
    plant: bool
    header_only: bool
    joint: int | None
    core: str | None
    makers: tuple[str, ...]


@dataclass(frozen=True)
class Target:
    """How a target is written, which of the options are its own, and in which precision."""

    write: Callable[[Design, Path, Asked], Path]
    options: tuple[str, ...] = ()
    precision: str = "double"


def _c(design: Design, out: Path, asked: Asked) -> Path:
    from feeddrive.artefacts.export.c.directory import write_c

    return write_c(design, out, single_header=asked.header_only)


def _linuxcnc(design: Design, out: Path, asked: Asked) -> Path:
    from feeddrive.artefacts.export.linuxcnc.write import write_linuxcnc

    return write_linuxcnc(design, out, joint=asked.joint)


def _cortex_m(design: Design, out: Path, asked: Asked) -> Path:
    from feeddrive.artefacts.export.cortex_m.bundle import write_cortex_m

    return write_cortex_m(design, out, core=asked.core)


def _fmu2(design: Design, out: Path, _: Asked) -> Path:
    from feeddrive.artefacts.export.fmu.directory import write_fmu

    return write_fmu(design, out, version=2)


def _fmu3(design: Design, out: Path, _: Asked) -> Path:
    from feeddrive.artefacts.export.fmu.directory import write_fmu

    return write_fmu(design, out, version=3)


def _structured_text(design: Design, out: Path, asked: Asked) -> Path:
    from feeddrive.artefacts.export.structured_text.directory import write_structured_text

    return write_structured_text(design, out)


TARGETS: dict[str, Target] = {
    "c": Target(_c, ("header_only", "plant", "precision")),
    "linuxcnc": Target(_linuxcnc, ("joint",)),
    "fmu2": Target(_fmu2, ("plant",)),
    "fmu3": Target(_fmu3, ("plant",)),
    "cortex-m": Target(_cortex_m, ("core", "precision"), "float"),
    "st": Target(_structured_text, ("precision",)),
}
_FLAGS = {
    "header_only": "--header-only", "plant": "--plant", "precision": "--precision", "joint": "--joint",
    "core": "--core", "makers": "--maker",
}  # fmt: skip


def perform(asked: Asked) -> None:
    """Write, and say where."""
    target = TARGETS.get(asked.target)
    if target is None:
        raise ParameterError(
            f"--target = '{asked.target}' is none of {', '.join(TARGETS)}{nearest(asked.target, list(TARGETS))}"
        )
    for option, flag in _FLAGS.items():
        if getattr(asked, option) and option not in target.options:
            fits = ", ".join(name for name, each in TARGETS.items() if option in each.options)
            raise ParameterError(f"{flag} means nothing for the target {asked.target}; it belongs to {fits}")
    console = Console(highlight=False)
    design = read_design(
        asked.source, asked.axis, name=asked.name, what=PLANT if asked.plant else CONTROL,
        precision=asked.precision or target.precision,
    )  # fmt: skip
    out = asked.out or Path("results") / f"export_{Path(asked.source).stem}_{design.axis}_{asked.target}"
    readme = target.write(design, out, asked)
    said = f"{design.title}: {asked.target}, sample time {1e6 * design.routine.sample_time:g} µs"
    console.print(said, markup=False, soft_wrap=True)
    console.print(f"Read first: {readme}", markup=False, soft_wrap=True)
