"""`feeddrive tune`: a machine or a measured frequency response to a tuned control."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from feeddrive.artefacts.files.frf import read_frf
from feeddrive.artefacts.files.machine import BUNDLED, Machine, read_machine
from feeddrive.artefacts.files.messages import nearest
from feeddrive.artefacts.tuning.tune_page import tables, write_tuned
from feeddrive.artefacts.tuning.tuned_machine import machine_text
from feeddrive.doors.cli.frf import frequencies
from feeddrive.doors.cli.working import drawn
from feeddrive.engineer.tuning.designs import designs
from feeddrive.engineer.tuning.recipes import margin_goals
from feeddrive.engineer.tuning.shaping.limits import Limits
from feeddrive.engineer.tuning.shaping.shape import shape
from feeddrive.engineer.tuning.shaping.site import Site, measured_site
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop


@dataclass(frozen=True)
class Asked:
    """What the command line says: the source, what it is measured with, and what is wanted."""

    source: str
    others: Sequence[str]
    motor: Path | None
    disturbance: Path | None
    disturbance_motor: Path | None
    sample_time: float | None
    delay: float
    baseline: str | None
    axis: str | None
    law: str | None
    goal: str
    band: str | None
    filters: str
    confidence: float
    limits: Limits
    starts: int
    seed: int
    out: Path | None


def perform(asked: Asked) -> None:
    """Tune, show, write; exit code 1 if the tuning does not hold what it should."""
    console = Console(highlight=False)
    machine = _machine(asked.source)
    base = machine if asked.baseline is None else read_machine(asked.baseline)
    loop = None if base is None else base.loop(asked.axis)
    name = _name(base, loop, asked.axis)
    sites = _sites(asked, machine, loop)
    control = _control(asked, loop, sites)
    found = shape(
        control, sites, goal=asked.goal, limits=asked.limits, filters=asked.filters, confidence=asked.confidence,
        starts=asked.starts, seed=asked.seed, today=None if loop is None else loop.control,
        band=frequencies(asked.band) or (0.0, math.inf),
    )  # fmt: skip
    facts = {
        "Source": ", ".join([asked.source, *asked.others]),
        "Today": "nothing to compare with" if base is None else f"{base.name}, axis {name}",
        "Law": control.law.kind,
        "Sample time": f"{1e3 * sites[0].sample_time:g} ms" if isinstance(sites[0], Site) else _step(sites[0]),
        "Loops judged": str(found.evaluations),
        "Searches": f"{asked.starts}, their ends {100.0 * found.spread:.2g} % apart",
    }
    text = None if base is None or not found.holds else machine_text(base, name, found.control)
    report = write_tuned(found, text, name, asked.out or Path("results") / f"tune_{Path(asked.source).stem}", facts)
    for each in tables(found):
        console.print(drawn(each))
    for sentence in (*(f"held back by {h.sentence()}" for h in found.held), *found.advice, *found.notches):
        console.print(f"- {sentence}", markup=False)
    console.print(found.recommendation(), markup=False)
    if text is not None:
        console.print(f"Machine: {report.parent / 'machine.toml'}", markup=False, soft_wrap=True)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)
    if not found.holds:
        sys.stderr.write("feeddrive: the tuning does not hold what it should; no machine file was written\n")
        raise SystemExit(1)


def _step(loop: Loop | Site) -> str:
    return f"{1e3 * float(loop.sample_time):g} ms"


def _machine(source: str) -> Machine | None:
    """The machine in a TOML file or bundled under a name; None for a measurement."""
    given = Path(source)
    bundled = not given.suffix and not given.exists()
    if given.suffix.lower() == ".toml" or (bundled and (BUNDLED / "machines" / f"{source}.toml").exists()):
        return read_machine(source)
    if bundled:
        names = [each.stem for each in (BUNDLED / "machines").glob("*.toml")]
        raise ParameterError(f"{source}: is neither a file nor the name of a bundled machine{nearest(source, names)}")
    return None


def _name(machine: Machine | None, loop: Loop | None, axis: str | None) -> str:
    if machine is None:
        return axis or "x"
    return next(name for name, each in machine.loops.items() if each is loop)


def _sites(asked: Asked, machine: Machine | None, loop: Loop | None) -> list[Site | Loop]:
    """The axis at every position and load that was given: machines, or measurements."""
    if machine is not None:
        return [machine.loop(asked.axis), *(read_machine(each).loop(asked.axis) for each in asked.others)]
    first = read_frf(asked.source, input="force", unit=None)
    step = asked.sample_time or first.sample_time or (None if loop is None else float(loop.sample_time))
    if step is None:
        raise ParameterError(
            f"{asked.source}: does not say with which sample time the control runs: give it with --sample-time, or "
            f"today's machine with --baseline"
        )
    motor = None if asked.motor is None else read_frf(asked.motor)
    struck = None
    if asked.disturbance is not None:
        back = None if asked.disturbance_motor is None else read_frf(asked.disturbance_motor)
        if motor is not None and back is None:
            raise ParameterError(
                "--disturbance with --motor needs --disturbance-motor: the motor's answer to the hammer"
            )
        struck = (read_frf(asked.disturbance), back)
    found: list[Site | Loop] = [
        measured_site(
            first, motor, disturbance=struck, sample_time=step, delay=asked.delay, name=Path(asked.source).stem
        )
    ]
    for each in asked.others:
        if motor is not None:
            raise ParameterError("--at takes measurements of one encoder: leave out --motor")
        found.append(measured_site(read_frf(each), sample_time=step, delay=asked.delay, name=Path(each).stem))
    return found


def _control(asked: Asked, loop: Loop | None, sites: Sequence[Site | Loop]) -> Control:
    """Where the search begins: today's control, another law on the same axis, or a P-PI by robust margins."""
    if loop is None:
        if asked.law not in (None, "cascade_ppi"):
            raise ParameterError(f"--law {asked.law} needs a machine to take its model from: give it with --baseline")
        first = sites[0]
        law = replace(margin_goals(first).law, velocity_encoder="motor")
        return Control(law=law)
    if asked.law is None or asked.law == loop.control.law.kind:
        law = loop.control.law
        if law.period() > 1 and law.kind == "cascade_ppi":
            raise StructureError(
                "the position loop runs only every few samples, so that the loop has no response at the actuator: set "
                "position_every = 1 in the baseline"
            )
        return loop.control
    made, refused = designs(loop)
    for each in made:
        if each.loop.control.law.kind == asked.law and not each.loop.control.compensation and not each.prefilter:
            return each.loop.control
    kinds = sorted({each.loop.control.law.kind for each in made})
    reasons = "; ".join(f"{each.name}: {each.reason}" for each in refused)
    raise ParameterError(
        f"--law {asked.law} is not on this axis{nearest(asked.law, kinds)}; there are {', '.join(kinds)}"
        + (f" ({reasons})" if reasons else "")
    )
