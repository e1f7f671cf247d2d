"""`feeddrive tune`: a machine or a measured frequency response to a tuned control."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from feeddrive.certificate.certificate import Certificate
from feeddrive.cli.certify import certified
from feeddrive.cli.frf import frequencies
from feeddrive.cli.terminal import open_console
from feeddrive.cli.tune_sources import Measurement, machine_of, several, site_of
from feeddrive.cli.working import drawn
from feeddrive.files.machine import MachineFile, read_machine
from feeddrive.files.messages import nearest
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.judged_recipes import JudgedRecipe, judged_recipes
from feeddrive.tuning.recipes import RECIPES, margin_goals
from feeddrive.tuning.shaping.limits import Limits
from feeddrive.tuning.shaping.shape import assess, tune
from feeddrive.tuning.shaping.shaped_loop import Tuned
from feeddrive.tuning.shaping.site import Site
from feeddrive.workflow.tune_page import Story, tables, write_tuned
from feeddrive.workflow.tuned_machine import machine_text


@dataclass(frozen=True)
class Asked:
    """What the command line says: the source, what it is measured with, and what is wanted."""

    source: str
    others: Sequence[str]
    motor: Sequence[str]
    disturbance: Path | None
    disturbance_motor: Path | None
    unit: str | None
    sample_time: float | None
    delay: float
    baseline: str | None
    axis: str | None
    law: str | None
    recipe: str | None
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
    console = open_console()
    _check(asked)
    bar = Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console,
                   transient=True, disable=not console.is_terminal)  # fmt: skip
    with bar:
        task = bar.add_task("reading")
        step: Callable[[str], None] = lambda text: bar.update(task, description=escape(text))  # noqa: E731
        found, story, text, name, certificate = _tuned(asked, step)
        step("report")
        out = asked.out or Path("results") / f"tune_{Path(asked.source).stem}"
        report = write_tuned(found, text, name, out, story, certificate)
    _show(console, found, story, report, text is not None)
    if not found.holds:
        sys.stderr.write("feeddrive: the tuning does not hold what it should; no machine file was written\n")
        raise SystemExit(1)


def _check(asked: Asked) -> None:
    """Numbers that no function downstairs can name by their option."""
    if asked.sample_time is not None and not (math.isfinite(asked.sample_time) and asked.sample_time > 0.0):
        raise ParameterError(f"--sample-time {asked.sample_time:g} must be a finite number of seconds > 0")
    if not (math.isfinite(asked.delay) and asked.delay >= 0.0):
        raise ParameterError(f"--delay {asked.delay:g} must be a finite number of seconds >= 0")
    if asked.recipe is not None and asked.recipe not in RECIPES:
        raise ParameterError(f"--recipe {asked.recipe} is none{nearest(asked.recipe, list(RECIPES))}")
    if asked.recipe is not None and asked.law not in (None, "cascade_ppi"):
        raise ParameterError(f"--recipe gives a cascade_ppi, not --law {asked.law}: leave one of them out")


def _tuned(asked: Asked, step: Callable[[str], None]) -> tuple[Tuned, Story, str | None, str, Certificate | None]:
    machine = machine_of(asked.source)
    base = machine if asked.baseline is None else read_machine(asked.baseline)
    loop = None if base is None else base.loop(asked.axis)
    if loop is not None and asked.sample_time and abs(asked.sample_time / float(loop.sample_time) - 1.0) > 1e-6:
        raise ParameterError(
            f"--sample-time {asked.sample_time:g} s is not that of the machine file, {float(loop.sample_time):g} s: "
            f"leave it out, or change sample_time there"
        )
    name = _name(loop, asked.axis)
    sites, said = _sites(asked, machine, loop, step)
    control, begun = _control(asked, loop, sites)
    band = frequencies(asked.band) or (0.0, math.inf)
    today = None if loop is None else loop.control
    if asked.recipe is not None:
        made = RECIPES[asked.recipe](sites[0], control)
        found = assess(
            replace(control, law=made.law, compensation=()), sites, rule=f"{made.name}: {made.reason} ({made.source})",
            goal=asked.goal, limits=asked.limits, band=band, confidence=asked.confidence, today=today, step=step,
        )  # fmt: skip
    else:
        found = tune(
            control, sites, goal=asked.goal, limits=asked.limits, filters=asked.filters, confidence=asked.confidence,
            starts=asked.starts, seed=asked.seed, today=today, band=band, step=step,
        )  # fmt: skip
    rules: tuple[JudgedRecipe, ...] = ()
    if found.control.law.kind == "cascade_ppi":
        rules = judged_recipes(sites, control, asked.limits, step)
    what = f"{base.name}, axis {name}" if base is not None else Path(asked.source).name
    facts = {
        "Source": ", ".join([asked.source, *asked.others]),
        "Today": begun or what,
        "Law": control.law.kind,
        "Sample time": f"{1e3 * float(sites[0].sample_time):g} ms",
        "Loops judged": str(found.evaluations),
        "Searches": "none, a rule"
        if found.recipe
        else f"{asked.starts}, their ends {100.0 * found.spread:.2g} % apart",
        "Again": f"feeddrive {shlex.join(sys.argv[1:])}" if sys.argv[1:2] == ["tune"] else "",
        "In Python": _python(asked),
    }
    text = None if base is None or not found.holds else machine_text(base, name, found.control)
    step("certificate")
    certificate, facts["Certificate"] = certified(found.control, sites, text, name) if found.holds else (None, "")
    story = Story(what, {k: v for k, v in facts.items() if v}, rules, tuple(said), begun or "today")
    return found, story, text, name, certificate


def _python(asked: Asked) -> str:
    """What gives the same tuning from Python, for a machine."""
    if asked.recipe is not None or not (asked.source.endswith(".toml") or machine_of(asked.source)):
        return ""
    axis = "" if asked.axis is None else f"{asked.axis!r}"
    return (
        f"loop = fd.read_machine({asked.source!r}).loop({axis}); fd.tune(loop.control, loop, goal={asked.goal!r}, "
        f"limits=fd.{asked.limits!r}, filters={asked.filters!r}, starts={asked.starts}, seed={asked.seed})"
    )


def _show(console: Console, found: Tuned, story: Story, report: Path, written: bool) -> None:
    for each in tables(found, story)[:-1]:
        console.print(drawn(each))
    for line in found.proof:
        verdict = {None: "not proven", True: "holds", False: "DOES NOT HOLD"}[line.holds]
        console.print(f"- proof, {line.what}: {verdict} ({line.said})", markup=False)
    for sentence in (*story.said, *(f"held back by {h.sentence()}" for h in found.held), *found.advice):
        console.print(f"- {sentence}", markup=False)
    for sentence in found.notches:
        console.print(f"- notch {sentence}", markup=False)
    console.print(found.recommendation(), markup=False)
    if written:
        kind = "Machine, with values that are not recommended" if found.not_worth else "Machine"
        console.print(f"{kind}: {report.parent / 'machine.toml'}", markup=False, soft_wrap=True)
    if (report.parent / "certificate.json").exists():
        console.print(f"Certificate: {report.parent / 'certificate.json'}", markup=False, soft_wrap=True)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def _name(loop: Loop | None, axis: str | None) -> str:
    return axis or "x" if loop is None else loop.name


def _sites(
    asked: Asked, machine: MachineFile | None, loop: Loop | None, step: Callable[[str], None]
) -> tuple[list[Site | Loop], list[str]]:
    """The axis at every position and load that was given: machines and measurements."""
    machines = {i: made for i, each in enumerate(asked.others) if (made := machine_of(each)) is not None}
    if machine is not None and (asked.motor or asked.disturbance):
        raise ParameterError("--motor and --disturbance belong to a measured response: leave them out for a machine")
    measured = [each for i, each in enumerate(asked.others) if i not in machines]
    first = Measurement(asked.source, None, asked.disturbance, asked.disturbance_motor)
    places = several(first, measured, asked.motor) if machine is None else [Measurement(each) for each in measured]
    found: list[Site | Loop] = [] if machine is None else [machine.loop(asked.axis)]
    said: list[str] = []
    for each in places:
        step(f"reading {Path(each.load).name}")
        site, words = site_of(each, Path(each.load).stem, loop, asked.sample_time, asked.delay, asked.unit)
        found.append(site)
        said += words
    return [*found, *(each.loop(asked.axis) for each in machines.values())], said


def _control(asked: Asked, loop: Loop | None, sites: Sequence[Site | Loop]) -> tuple[Control, str]:
    """Where the search begins: today's control, another law on the same axis, or a P-PI by robust margins.

    And what stands in the place of today's control, if there is none.
    """
    if loop is None:
        if asked.law not in (None, "cascade_ppi"):
            raise ParameterError(f"--law {asked.law} needs a machine to take its model from: give it with --baseline")
        law = replace(margin_goals(sites[0]).law, velocity_encoder="motor")
        return Control(law=law), "rule margins-robust"
    if asked.law is None or asked.law == loop.control.law.kind:
        law = loop.control.law
        if law.period() > 1 and law.kind == "cascade_ppi":
            raise StructureError(
                "the position loop runs only every few samples, so that the loop has no response at the actuator: set "
                "position_every = 1 in the baseline"
            )
        return loop.control, ""
    return control_with(loop, asked.law), ""
