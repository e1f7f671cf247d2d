"""The output files of `feeddrive tune`: the report, the summary, and the machine file with the tuned control."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive import plot
from feeddrive.analysis.margins import Margins
from feeddrive.analysis.stiffness import Stiffness
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.certificate.certificate import Certificate
from feeddrive.evaluation.duty import duty_of
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import MachineFile
from feeddrive.files.run_files import summary_text
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import TomlEdit, key_of
from feeddrive.language import tree, units
from feeddrive.language.block import Block
from feeddrive.language.errors import FeeddriveError, sentence
from feeddrive.language.quantity import USUAL, Quantity, number, unit_name
from feeddrive.language.table import UNIT, Cell, Column, Table
from feeddrive.language.text import Text, marked
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.report.laws import block_sentence
from feeddrive.report.page import html
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.tuning.closed_loop import Figures, reported
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.filters import aligned
from feeddrive.tuning.proof import ROOM
from feeddrive.tuning.recipes import JudgedRecipe
from feeddrive.tuning.tune import BESIDE, TIMES, Tuned, broken_limits, readable, two_digits, worst_beside
from feeddrive.workflow.certify import write_certificate


def summary(tuned: Tuned, remarks: Sequence[str], rules: Sequence[JudgedRecipe]) -> dict[str, Any]:
    """Return all figures as plain numbers for JSON; a figure that does not apply is None.

    remarks  remarks on the tuning
    rules    tuning rules for comparison
    """
    return {
        "rule": tuned.rule,
        "recommendation": tuned.recommendation(),
        "holds": tuned.holds,
        "tunables": dict(tuned.tunables),
        "today": {name: None if math.isnan(value) else value for name, value in tuned.started.items()},
        "figures": {
            name: {figures.point: _plain(figures) for figures in row}
            for name, row in (("today", tuned.before), ("new", tuned.after))
        },
        "held_back_by": [
            {"what": h.what, "point": h.point, "frequency_Hz": h.frequency, "gain_percent": h.gain} for h in tuned.held
        ],
        "against": "a force at the drive" if tuned.at_drive else "a force on the table",
        "remarks": [*remarks, *tuned.advice],
        "rules": {
            rule.name: {"reason": rule.reason, "figures": {figures.point: _plain(figures) for figures in rule.figures}}
            for rule in rules
        },
        "box": None if tuned.box is None else tuned.box.record(),
        "box_today": None if tuned.box_before is None else tuned.box_before.record(),
        "standard_deviations_kept": tuned.sure,
        "probability_that_all_limits_hold": tuned.confidence,
        "proof": {line.what: {"holds": line.holds, "said": line.text} for line in tuned.proof},
    }


def _usual(quantity: Quantity | None) -> float | None:
    """Return a value in its customary unit, in which the output files state it, or None if there is no value."""
    return None if quantity is None else USUAL.of(quantity.unit)[1] * float(quantity.value)


def _plain(figures: Figures) -> dict[str, float | bool | None]:
    values = {
        figure.label or figure.title: _usual(figure.quantity(figure.read(figures))) if figures.stable else None
        for figure in reported()
    }
    return {
        "stable": figures.stable,
        **{k: None if v is None or not math.isfinite(v) else v for k, v in values.items()},
    }


_LISTS = ("filters", "feedforward", "compensation")
_DIGITS = 7


@dataclass(frozen=True)
class Story:
    """The context of a tuning report: the tuned axis, facts, tuning rules for comparison, and remarks.

    today   the name of the old control in each comparison
    rotary  True for a rotary axis
    loops   the loop of the machine file under the old and the new control, by name, each only if it is stable
    """

    what: str
    facts: Mapping[str, str]
    rules: tuple[JudgedRecipe, ...] = ()
    remarks: tuple[str, ...] = ()
    today: str = "today"
    rotary: bool = False
    loops: Mapping[str, Loop] = field(default_factory=dict[str, Loop])


def write_tuned(
    tuned: Tuned, machine: str | None, axis: str, out: str | Path, story: Story, certificate: Certificate | None
) -> Path:
    """Write report, summary and, if the tuning is valid, control, machine file and certificate into a directory.

    Return the path of the report. Raise FileError if `out` cannot be written.
    """
    with new_directory(out) as folder:
        (folder / "report.html").write_text(html(tuned_report(tuned, story)), encoding="utf-8")
        figures = summary_text(summary(tuned, story.remarks, story.rules), rotary=story.rotary)
        (folder / "summary.json").write_text(figures, encoding="utf-8")
        if tuned.holds:
            # only a control that keeps its limits is written in a form that can be copied into a machine
            (folder / "control.toml").write_text(to_toml(tuned.control, f"axis.{axis}.control"), encoding="utf-8")
            if machine is not None:
                (folder / "machine.toml").write_text(machine, encoding="utf-8")
            if certificate is not None:
                write_certificate(folder / "certificate.json", certificate)
    return Path(out) / "report.html"


def tuned_report(tuned: Tuned, story: Story | None = None) -> Report:
    """Return the report of a tuning."""
    story = Story("A tuned axis", {}) if story is None else story
    timed, reason = _timed(tuned, story)
    picture, *others = [*_pictures(tuned, story), *timed]
    known = {**story.facts, "Old and new in time": reason} if reason else story.facts
    shown = tables(tuned, story)
    # the cascade, loop by loop, the worst plants of the box, and the proof are details
    first = len(shown) - sum(part is not None for part in (tuned.cascade_before, tuned.cascade, tuned.box)) - 1
    return Report(
        Text(f"{story.what}: {marked(tuned.rule).split(' subject to ')[0].split(';')[0]}"),
        "feeddrive tune",
        Verdict(
            (tuned.recommendation(), Text(f"Rule: {tuned.rule}."), *map(sentence, story.remarks)), good=tuned.holds
        ),
        (
            Section("result", "Result", (*shown[:first], _active_limits(tuned))),
            further(others),
            Section("proof", "Proof, and the cascade loop by loop", (shown[-1], *shown[first:-1]), folded=True),
            facts("What was tuned", known),
        ),
        picture,
        story.rotary,
    )


def _active_limits(tuned: Tuned) -> Remarks:
    texts = [Text(f"Held back by {limit.sentence()}.") for limit in tuned.held]
    texts += [sentence(text) for text in tuned.advice]
    texts += [Text(f"Notch {text}.") for text in tuned.notches]
    return Remarks(texts, "Active limits, and what would help")


def tables(tuned: Tuned, story: Story) -> list[Table]:
    """Tabulate the old and new parameters, the figures at each point, the tuning rules, the cascade loop by loop, and
    the proof.
    """
    rows: list[Sequence[Cell]] = []
    for name, value in tuned.tunables.items():
        started, unit = tuned.started[name], tree.declaration(tuned.control, name).unit
        before = None if math.isnan(started) else Quantity(started, unit, form="5 SI")
        now = Quantity(value, unit, form="5 SI")
        rows.append([readable(tuned.control, name), before, now, _change(started, value), UNIT])
    listed = [Table("values of the control, old and new", ["parameter", story.today, "new", "change", "unit"], rows)]
    for i, after in enumerate(tuned.after):
        before = tuned.before[i] if tuned.before else None
        listed.append(_figures(tuned, before, after, len(tuned.after) > 1, story.today))
    if story.rules:
        listed.append(_compared(tuned, story))
    for name, loops in ((story.today, tuned.cascade_before), ("new", tuned.cascade)):
        if loops is not None:
            shown = loops.table()
            listed.append(replace(shown, title=f"{shown.title}, {name}"))
    proof = [
        [line.what, {None: "not proven", True: "holds", False: "does not hold"}[line.holds], line.text]
        for line in tuned.proof
    ]
    if tuned.box is not None:
        listed.append(tuned.box.table())
    listed.append(Table("proof: computed anew in other ways", ["what", "", "figures"], proof))
    return listed


def _figures(tuned: Tuned, before: Figures | None, after: Figures, several: bool, today: str) -> Table:
    """Tabulate the figures under the old and the new control, with a box each beside its worst value over the box."""
    rows: list[Sequence[Cell]] = []
    for figure in reported():
        cells: list[Cell] = [
            None if figures is None else figure.quantity(figure.read(figures)) if figures.stable else "unstable"
            for figures in (before, after)
        ]
        if cells == [None, None]:
            continue
        if tuned.box is not None:
            worst = worst_beside(tuned, figure)
            cells = [cells[0], worst[0], cells[1], worst[1]]
        rows.append([figure.label or figure.title, *cells, UNIT])
    against = ", against a force at the drive" if after.at_drive else ""
    place = f" at {after.point}" if several else ""
    heads = [today, "new"] if tuned.box is None else [today, *BESIDE[1:]]
    over = "" if tuned.box is None else ", each beside the worst plant of the box"
    return Table(f"figures of the closed loop{place}{against}{over}", ["what", *heads, "unit"], rows)


def _compared(tuned: Tuned, story: Story) -> Table:
    """Compare the existing control, all tuning rules and the new control by their worst figures over all points."""
    shown = [(story.today, tuned.before), *((rule.name, rule.figures) for rule in story.rules), ("new", tuned.after)]
    rows = [[name, *_cells(row, tuned.limits)] for name, row in shown]
    title = "beside the rules of the trade: Ms, phase margin, least stiffness, rope-snap error at the worst point"
    if tuned.box is not None:
        title += ", and whether the limits are kept there; at the model, without the other plants of the box"
    return Table(title, ["", *_COMPARED], rows)


_COMPARED = (
    Column("Ms"),
    Column("phase", "deg", "3"),
    Column("stiffness", "N/m"),
    Column("snap", "m √s/N"),
    Column("limits"),
)


def _cells(row: Sequence[Figures], limits: Limits) -> list[Cell]:
    nothing = [None] * (len(_COMPARED) - 1)
    if not row:
        return [*nothing, "no gains"]
    if not all(figures.stable for figures in row):
        return [*nothing, "unstable"]
    # a loop gain that never crosses 1 has no phase margin
    phases = [p for figures in row if (p := figures.margins.phase_margin_deg) is not None]
    return [
        max(figures.margins.sensitivity_peak for figures in row),
        min(phases, default=None),
        min(figures.stiffness.minimum for figures in row),
        max(figures.rope_snap for figures in row),
        "exceeded" if broken_limits(row, limits, ROOM) else "kept",
    ]


def _change(before: float, after: float) -> str:
    if math.isnan(before) or before == 0.0:
        return "-"
    if after / before >= TIMES:
        return f"{two_digits(after / before)} times"
    return Text(f"{'+' if after >= before else ''}{Quantity(after / before - 1.0, 'share'):2}")


_STEP = 20e-6  # m
_LONG = 10.0  # periods of the slowest crossover to show


def _timed(tuned: Tuned, story: Story) -> tuple[list[Picture], str]:
    """Return the time-domain picture of the old and new control; or an empty list and the reason why there is none."""
    crossovers = [c for _, figures in _rows(tuned, story.today) if (c := figures.margins.crossover)]
    if not story.loops or not crossovers:
        return [], "not simulated: no axis is known; give a machine file with --baseline"
    try:
        return [old_and_new(story, min(crossovers))], ""
    except FeeddriveError as error:
        # the pictures in time are an extra: a run that diverges must not cost the report
        return [], Text(f"not simulated: {error}")


def old_and_new(story: Story, crossover: float) -> Picture:
    """Return the picture of a setpoint step, the rope-snap test and a move, simulated with friction and force limit."""
    duty = duty_of(next(iter(story.loops.values())))
    long, begin, move = _LONG / crossover, duty.begin, duty.move
    T = float(next(iter(story.loops.values())).sample_time)
    steps = np.where(np.arange(math.ceil((begin + long) / T) + 2) * T < begin, 0.0, _STEP)
    # the set velocity stays 0: the derivative of a step would be an impulse of one sample
    step = Recorded(position=steps, velocity=np.zeros(steps.size), sample_time=T)
    rows: list[dict[str, tuple[np.ndarray, np.ndarray]]] = [{}, {}, {}]
    for name, loop in story.loops.items():
        # a guard that trips under one control would leave nothing to compare
        free = replace(loop, control=replace(loop.control, guard=None))
        ran = [
            simulate(free, step, duration=begin + long),
            simulate(free, duty.still(), load=duty.snap, duration=begin + long),
            simulate(free, move),
        ]
        for row, run, signal in zip(rows, ran, ("position_load", "position_load", "following_error"), strict=True):
            shown = run.time >= begin - 0.1 * long if signal == "position_load" else run.time >= 0.0
            shift, scale = (begin, 1e3) if signal == "position_load" else (0.0, 1.0)
            row[name] = scale * (run.time[shown] - shift), 1e6 * run[signal][shown]
    return Picture(
        "time",
        "Old and new in time",
        Text(
            "Simulated with friction, counts, noise and force limit of the machine file, without its guard. Above: "
            f"the table after a step of the set position by {Quantity(_STEP, 'm'):6}. Middle: the table after a rope "
            f"that pulled it with {Quantity(duty.force, 'N'):6} is cut. Below: the following error of a move there and "
            f"back, {block_sentence(move)}."
        ),
        "Position of the table after a step and after a rope is cut, and following error of a move, before and after.",
        lambda: plot.in_time_chart(
            [
                (f"time after the step ({unit_name('s')})", f"position ({unit_name('m')})", rows[0]),
                (f"time after the cut ({unit_name('s')})", f"position ({unit_name('m')})", rows[1]),
                ("time (s)", f"following error\n({unit_name('m')})", rows[2]),
            ]
        ),
    )


def _rows(tuned: Tuned, today: str) -> Sequence[tuple[str, Figures]]:
    """Return the name and the figures of every stable loop, old and new, at each operating point."""
    many = len(tuned.after) > 1
    return [
        (f"{name}, {figures.point}" if many else name, figures)
        for name, row in ((today, tuned.before), ("new", tuned.after))
        for figures in row
        if figures.stable
    ]


def _pictures(tuned: Tuned, story: Story) -> Iterator[Picture]:
    rows = _rows(tuned, story.today)
    where = "at the drive" if tuned.at_drive else "on the table"
    stiff: dict[str, Stiffness] = {name: figures.stiffness for name, figures in rows}
    loops: dict[str, Margins] = {name: figures.margins for name, figures in rows}
    yield Picture(
        "stiffness",
        "Dynamic stiffness",
        Text(f"The force {where} that moves the table by {Quantity(1e-6, 'm')}, in closed loop; higher is better."),
        "Dynamic stiffness over frequency, before and after.",
        lambda: plot.stiffness_chart(stiff),
    )
    yield Picture(
        "margins",
        "Open loop and margins",
        "The loop opened at the actuator, filters and dead time included.",
        "Bode plot of the loop gain before and after, with margins.",
        lambda: plot.open_loop_chart(loops),
    )
    yield Picture(
        "sensitivity",
        "Sensitivity",
        "What is left of a disturbance, and the answer to noise; the mark is Ms.",
        "Sensitivity functions before and after.",
        lambda: plot.sensitivity_chart(loops),
    )
    if tuned.cascade is not None:
        yield Picture(
            "cascade",
            "Velocity and position loop",
            "The velocity loop without position loop, and the position loop around the closed velocity loop.",
            "Bode plot of velocity loop and position loop of the new gains.",
            tuned.cascade.chart,
        )


def machine_text(machine: MachineFile, axis: str, control: Control) -> str:
    """Return the text of the machine file with the control of one axis replaced.

    A law of the same structure is edited parameter by parameter.  For another kind, or another form of the same kind,
    the section is replaced: a parameter that the new form lacks must not stay in the file.  Prefilters are treated
    likewise.  Guard, force limit and delay are set, or left as they are if the control has none.  In a list of
    blocks, retained ones are edited parameter by parameter, others are removed, and new ones appended (`aligned`).
    """
    edit = TomlEdit(machine.file.text, machine.file.name)
    old = machine.loops[axis].control
    where, rotary = ("axis", axis, "control"), machine.loops[axis].axis.rotary
    if tree.structure(old.law) == tree.structure(control.law):
        _numbers(edit, (*where, "law"), old.law, control.law)
    else:
        edit.replace((*where, "law"), to_toml(control.law, ".".join((*where, "law")), rotary=rotary))
    if old.prefilter is not None and control.prefilter is None:
        edit.remove((*where, "prefilter"))
    elif control.prefilter is not None and control.prefilter != old.prefilter:
        if old.prefilter is not None and tree.structure(old.prefilter) == tree.structure(control.prefilter):
            _numbers(edit, (*where, "prefilter"), old.prefilter, control.prefilter)
        else:
            text = to_toml(control.prefilter, ".".join((*where, "prefilter")), rotary=rotary)
            edit.replace((*where, "prefilter"), text)
    if control.guard is not None and old.guard is None:
        edit.add(to_toml(control.guard, ".".join((*where, "guard")), rotary=rotary))
    elif control.guard is not None and old.guard is not None:
        _numbers(edit, (*where, "guard"), old.guard, control.guard)
    for name in ("feedback_delay", "force_limit"):
        before, after = getattr(old, name), getattr(control, name)
        if after is not None and after != before:
            edit.set((*where, name), float(after), tree.declaration(control, name).unit, _DIGITS)
    for name in _LISTS:
        before, after = getattr(old, name), getattr(control, name)
        # a removed and a new block at one index are two blocks: comments of the old one must not stay on the new one
        kept = aligned(before, after)
        # from the end, so that the indices of the blocks before stay valid
        for place in reversed(range(len(before))):
            if place not in kept:
                edit.remove((*where, name, place))
        for i, place in enumerate(kept):
            _numbers(edit, (*where, name, i), before[place], after[i])
        for block in after[len(kept) :]:
            edit.add(to_toml(block, ".".join((*where, name)), listed=True, rotary=rotary))
    return edit.text


def _numbers(edit: TomlEdit, key: tuple[str | int, ...], old: Block, new: Block) -> None:
    """Write the changed parameters of a block, each with its old value in a comment."""
    before = dict(tree.leaves(old))
    for name, value in tree.leaves(new):
        if before.get(name) != value:
            unit = tree.declaration(new, name).unit
            written = edit.set((*key, *key_of(name)), float(value), unit, _DIGITS)
            # a comment on the old number must not be read as one on the new number
            if name in before:
                scale = _scale(str(written[-1]), key_of(name)[-1], unit)
                edit.comment(written, f"was {number(before[name] / scale, 7)}")


def _scale(written: str, name: str | int, unit: str) -> float:
    """Return the factor from the unit in a file's key to the declared unit: 1000 for Kp_kN_s_per_m and 1 for Kp."""
    stated = written.removeprefix(f"{name}_")
    return 1.0 if stated == written else units.factor(stated, unit)
