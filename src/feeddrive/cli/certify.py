"""`feeddrive certify`: from a machine, and what was measured on it, to a certificate."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from feeddrive.certificate.certificate import Certificate
from feeddrive.certificate.certify import PlantLike, certify
from feeddrive.certificate.sites import site_plants
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.frf import encoders, read_frf, read_frfs
from feeddrive.files.machine import BUNDLED, MachineFile, read_machine
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.tuning.shaping.site import Site
from feeddrive.workflow.certificate_page import FILE, write_certified


@dataclass(frozen=True)
class Asked:
    """What the command line says."""

    source: str
    axis: str | None
    others: Sequence[str]
    measured: Path | None
    motor: Path | None
    fit: bool
    radius: float | None
    beyond: float
    arithmetic: str
    confidence: float
    velocity: float
    out: Path | None


def perform(asked: Asked) -> None:
    """Certify, show, write."""
    console = open_console()
    machine = read_machine(asked.source)
    loop = machine.loop(asked.axis)
    found = certify(
        loop, _plants(asked, loop), radius=asked.radius, beyond=asked.beyond, arithmetic=asked.arithmetic,
        confidence=asked.confidence, velocity=asked.velocity, machine=source(machine),
    )  # fmt: skip
    facts = {
        "Machine": f"{machine.name}, {asked.source}",
        "Law": loop.control.law.kind,
        "Sample time": f"{1e3 * float(loop.sample_time):g} ms",
        "Velocity of the axis": f"{asked.velocity:g} m/s",
    }
    report = write_certified(found, asked.out or Path("results") / f"certify_{Path(asked.source).stem}", facts)
    console.print(drawn(found.table()))
    console.print(f"- {found.document['claim']}", markup=False)
    for text in found.outside:
        console.print(f"- Outside: {text}", markup=False)
    console.print(f"Certificate: {report.parent / FILE}", markup=False, soft_wrap=True)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def certified(
    control: Control, sites: Sequence[Site | Loop], text: str | None, axis: str
) -> tuple[Certificate | None, str]:
    """The certificate of a tuned control at its sites, and what it says; None and the reason where there is none.

    With the text of a machine file it is the control of that file, whose numbers have fewer digits.
    """
    of_file: dict[str, str] = {}
    try:
        if text is not None:
            with TemporaryDirectory() as folder:
                file = Path(folder) / "machine.toml"
                file.write_text(text, encoding="utf-8")
                machine = read_machine(file)
            control, of_file = machine.loop(axis).control, source(machine)
        found = certify(control, site_plants(sites), sample_time=float(sites[0].sample_time), machine=of_file)
    except FeeddriveError as error:
        return None, str(error)
    return found, found.sentence()


def source(machine: MachineFile) -> dict[str, str]:
    """What a certificate says of a machine file: its name and the digest of its text."""
    digest = hashlib.sha256(machine.file.text.encode()).hexdigest()
    return {"name": machine.name, "file": Path(machine.file.name).name, "sha256": digest}


def _plants(asked: Asked, loop: Loop) -> dict[str, PlantLike]:
    """The axis itself, as a model or with its measured lines, and the others."""
    plants: dict[str, PlantLike] = {}
    if asked.measured is None:
        if asked.motor is not None or asked.fit:
            raise ParameterError("--motor and --fit need --measured, the response of the axis")
        plants["model"] = loop
    else:
        lines = _responses(asked.measured, loop)
        lines += [] if asked.motor is None else [_sampled(read_frf(asked.motor), loop)]
        plants[asked.measured.stem] = lines if asked.fit else [loop, *lines]
    for each in asked.others:
        name = _unused(Path(each).stem, plants)
        bundled = not Path(each).suffix and (BUNDLED / "machines" / f"{each}.toml").exists()
        if bundled or Path(each).suffix.lower() == ".toml":
            plants[name] = read_machine(each).loop(asked.axis)
        else:
            plants[name] = _responses(Path(each), loop)
    return plants


def _responses(file: Path, loop: Loop) -> list[FRF]:
    """The response of a file, or those of load and motor, in this order."""
    found = read_frfs(file)
    if len(found) == 1:
        return [_sampled(next(iter(found.values())), loop)]
    told = encoders(found)
    if set(told) != {"motor", "load"}:
        raise ParameterError(f"{file}: holds {', '.join(found)}: name the responses of both encoders motor and load")
    return [_sampled(told[role], loop) for role in ("load", "motor")]


def _sampled(found: FRF, loop: Loop) -> FRF:
    """A response that does not say how it was sampled counts as sampled with the loop."""
    return replace(found, sample_time=float(loop.sample_time)) if found.sample_time is None else found


def _unused(name: str, plants: dict[str, PlantLike]) -> str:
    """A name that no plant has yet."""
    count = 2
    free = name
    while free in plants:
        free, count = f"{name} {count}", count + 1
    return free
