"""The reports on machining: circular tests, planned part programs, and simulated part programs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from feeddrive import plot
from feeddrive.language.quantity import Quantity, count_of, number, unit_name
from feeddrive.language.table import Cell, Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.report.report import Marked, Part, Picture, Report, Section, Verdict, facts, further, titled
from feeddrive.version import __version__

if TYPE_CHECKING:
    # the report on a plan needs none of these, and is there sooner
    from feeddrive.machining.circle_test import CircleCauses, CircleTest
    from feeddrive.machining.part_run import PartRun
    from feeddrive.machining.tip_error import TipError
    from feeddrive.path.planned import Planned
    from feeddrive.report.laws import Entry, LawsContents


def circle_report(test: CircleTest, causes: CircleCauses, note: str = "") -> Report:
    """Return the report on a circular test; `note` is a line of text for the circle plot."""
    from feeddrive.machining.circle_test import peaks_table

    pictures = [
        Picture(
            "circle",
            "Circle plot",
            "Deviations from the nominal circle, enlarged; a ring is a division. Dots: where a circle begins; arrows: "
            "its direction.",
            "Radial deviations on the nominal circle, in both directions.",
            lambda: plot.circle_test_chart(test, remark=note),
        ),
        Picture(
            "unrolled",
            "Over the angle",
            "The same over the polar angle; hollow: the peak behind each reversal; below, "
            "ten degrees before and behind each reversal.",
            "Radial deviations over the angle, with zooms of the reversals.",
            lambda: plot.circle_unrolled_chart(test),
        ),
        Picture(
            "causes",
            "What draws it",
            "The largest deviation that each cause draws on one of the circles; hatched: it cannot be told apart from "
            "another one.",
            "Causes by the largest deviation that they draw.",
            causes.chart,
        ),
    ]
    first = test.circles[0]
    conditions = [
        ("Circles", ", ".join(path.name for path in test.circles)),
        ("Nominal radius", Text(f"{Quantity(test.radius, 'm'):6 mm}, in {''.join(first.axes)}")),
        (
            "Measured by",
            "encoders, which do not see the tool" if first.source == "encoder" else "positions of the tool",
        ),
        ("Center of F", test.about),
        ("feeddrive", __version__),
    ]
    most = test.largest
    ways = "both directions, " if most.both else ""
    largest = Text(f"The circular deviation is {Quantity(most.G, 'm')} ({ways}{most.name}).")
    ranked = [cause for cause in causes.ranked if cause.effect > 0.0][:3]
    ranking = joined(", ", (f"{cause.name} {Quantity(cause.effect, 'm'):3}" for cause in ranked))
    peaks = "Quadrant peaks: outward, in the 10° after a reversal, above the mean of the 10° before it."
    tables = (
        titled(test.table(), "Circular test after ISO 230-4."),
        titled(peaks_table(test), peaks),
        titled(causes.table(), "What draws the deviations."),
    )
    shown, *others = pictures
    return Report(
        "Circular test",
        "feeddrive circle",
        Verdict((largest, Text(f"What draws most: {ranking}."))),
        (Section("figures", "Figures", tables), further(others), facts("What was measured", conditions)),
        shown,
    )


_LISTED = 200  # largest number of listed stops


def plan_report(plan: Planned, with_pictures: bool = True) -> Report:
    """Return the report on a planned part program."""
    pictures = _pictures(plan) if with_pictures else []
    conditions = [
        ("Program", plan.program),
        ("Machine", plan.machine),
        ("Setpoints", Text(f"{plan.samples:,}, one every {Quantity(plan.sample_time, 's'):3}")),
        ("Moves", f"{plan.blocks:,}, in {count_of(plan.runs, 'run')} from rest to rest"),
        *([("Purpose", plan.settings.sentence())] if plan.settings.purpose else []),
        ("Proof", _proof(plan)),
        ("feeddrive", __version__),
    ]
    return Report(
        f"{plan.program}: plan",
        "feeddrive plan",
        Verdict(_lead(plan), good=plan.violations == 0),
        (
            Section("limits", "Limits", (titled(plan.table(), "The largest share of each limit that is used."),)),
            further(pictures[1:]),
            Section("falls", "Falls of the feed", _falls(plan), folded=True),
            Section("stops", "Stops", _stops(plan), folded=True),
            facts("What was planned", conditions),
        ),
        next(iter(pictures), None),
    )


def _lead(plan: Planned) -> Sequence[str]:
    proof = plan.proof
    held = (
        "Every limit is proven to hold in continuous time, joints included."
        if plan.violations == 0
        else f"{count_of(plan.violations, 'violation')} of the tip of the tool: no setpoints were written. This is a "
        "fault of feeddrive, not of the program."
        if proof.count == 0
        else f"{count_of(plan.violations, 'violation')}, the first at {plan.limits.named(str(proof.faults[0]))}: no "
        "setpoints were written. This is a fault of feeddrive, not of the program."
    )
    first = Text(
        f"The cycle takes {Quantity(plan.cycle_time, 's'):6 SI}, with {count_of(plan.stop_count, 'stop')}. {held}"
    )
    most = sorted(plan.seconds.items(), key=lambda item: -item[1])[:3] if plan.cycle_time else []
    shares = joined(", ", (f"{name} {Quantity(seconds / plan.cycle_time, 'share'):3}" for name, seconds in most))
    told = [first]
    if tip := plan.tip:
        told.append(
            Text(
                f"The tip of the tool stays within {Quantity(tip.deviation, 'm'):4} of the program, and the tool "
                f"within {Quantity(tip.angle, 'rad'):deg} of its direction: both are proven."
            )
        )
    return [*told, Text(f"What limits it for most of the time: {shares}.")] if most else told


def _proof(plan: Planned) -> str:
    return (
        f"{count_of(plan.proof.spans, 'span')} of time by interval arithmetic, within 1e-9 of each limit; the largest "
        f"jump at a joint is {number(plan.proof.jump, 2)} of a limit"
    )


def _pictures(plan: Planned) -> Sequence[Picture]:
    letters = plan.limits.letters
    of_tip = plan.tip is not None
    # a program without motion has neither a path to draw nor a cycle time to divide by
    if not len(plan.course.time) or not plan.cycle_time:
        return []
    return [
        Picture(
            "path",
            "Path and speed",
            "Color and width: the speed along the path, slow is warm and wide. Dotted: traverses. Circles: stops, the "
            "first 300."
            + (
                " Path and speed are those of the tip of the tool, in the frame of the workpiece."
                if of_tip
                else " In the speed an angle counts by its tolerance."
                if plan.limits.rotary
                else ""
            ),
            f"The path of {plan.program} with its speed as color.",
            plan.chart,
        ),
        Picture(
            "losses",
            "Where and why the feed falls",
            "Color: what makes the path slower than 95 % of its programmed feed, with the time that is lost by it, "
            "ramps included. Thin: at the feed. Circles: stops, the first 300.",
            f"The path of {plan.program}, colored by the cause of each fall of the feed.",
            lambda: plot.plan_losses_chart(plan),
        ),
        Picture(
            "causes",
            "What limits the speed, and when",
            "A row for each limit; it is filled where this limit is used most, and its share of the cycle time stands "
            "behind its name. Feed: the program asks for no more. None above half: ends of ramps, and "
            "what a bend ahead or behind holds at its speed.",
            "Which limit is used most, over time.",
            lambda: plot.plan_causes_chart(plan),
        ),
        *(
            [
                Picture(
                    "joints",
                    "Tool and joints",
                    "The tilt of the tool against Z of the workpiece, the rotary and the linear joints over time.",
                    "Tilt of the tool and positions of all joints over time.",
                    lambda: plot.plan_joints_chart(plan),
                )
            ]
            if of_tip
            else []
        ),
        *(
            Picture(
                f"axis{letter}",
                f"Axis {letter}",
                "From the least to the most in each stretch of time; dashed: the limits, where they are near.",
                f"Velocity, acceleration, jerk and snap of axis {letter} over time with their limits.",
                # bound as a default: the chart is drawn after the loop has ended, when `i` is the last axis
                lambda i=i: plot.plan_profiles_chart(plan, i),
            )
            for i, letter in enumerate(letters)
            # an axis that never moves has no profile
            if np.any(plan.proof.use[i] > 0.0)
        ),
    ]


def _falls(plan: Planned) -> list[Part]:
    loss = plan.loss
    if not loss.fall_count:
        return ["None: the path keeps its feed."]
    causes = [[row.cause, row.limit, row.falls, row.lost, row.length] for row in loss.causes]
    heads = ["cause", "limit", "falls", Column("lost", "s", "SI"), Column("length", "m", "mm")]
    rows = [
        [
            f"{fall.first} to {fall.last}",
            fall.time,
            fall.lost,
            fall.length,
            fall.slowest,
            fall.feed,
            fall.cause,
            fall.limit,
        ]
        for fall in sorted(loss.falls, key=lambda fall: -fall.lost)[:_LISTED]
    ]
    columns = [
        "lines",
        Column("time", "s", "SI"),
        Column("lost", "s", "SI"),
        Column("length", "m", "mm"),
        Column("slowest", "m/s", "mm/s"),
        Column("feed", "m/s", "mm/s"),
        "cause",
        "limit",
    ]
    caption = (
        f"The {len(rows)} with the largest loss, of {loss.fall_count:,}." if loss.fall_count > len(rows) else "All."
    )
    at_feed = Quantity(plan.cycle_time - loss.lost, "s")
    sums = Text(f"Time lost by cause: {Quantity(loss.lost, 's'):6 SI} more than {at_feed:6 SI} at the feed.")
    return [Table(sums, heads, causes), Table(caption, columns, rows)]


def _stops(plan: Planned) -> list[Part]:
    if not plan.stops:
        return ["None: the program is one motion."]
    by_reason = sorted(plan.stop_reasons.items(), key=lambda item: -item[1])
    rows = [
        [
            stop.time,
            stop.line,
            str(stop),
            stop.duration,
            ", ".join(
                f"{letter} {number(factor * x, 6)}"
                for letter, (factor, _), x in zip(plan.limits.letters, plan.limits.shown, stop.position, strict=True)
            ),
        ]
        for stop in plan.stops[:_LISTED]
    ]
    caption = f"The first {_LISTED} of {plan.stop_count:,}." if plan.stop_count > _LISTED else "All of them."
    place = "place mm, deg" if plan.limits.rotary else "place mm"
    columns = [Column("time", "s", "SI"), "line", "reason", Column("stands", "s", "SI"), place]
    reasons = Table("Stops by reason.", ["reason", "stops"], [[name, f"{count:,}"] for name, count in by_reason])
    return [reasons, Table(caption, columns, rows)]


_WORST = 8
_CAUSES = 6


def ran(contents: LawsContents) -> list[tuple[Entry, PartRun]]:
    """Return each law that followed a part program, together with its run, in the order of the entries."""
    return [(entry, entry.part) for entry in contents.entries if entry.part is not None]


def lead(contents: LawsContents) -> list[str]:
    """Return the conclusions on the contour errors as sentences, the most important first."""
    runs = ran(contents)
    first = runs[0][1]
    best = min((part for _, part in runs), key=lambda part: part.contour.rms)
    results: list[str] = []
    if best is first:
        lead_in = "" if len(runs) == 1 else "None of the others keeps the contour better than "
        results.append(Text(f"{lead_in}'{first.name}': {_contour(first)}."))
    else:
        results.append(
            Text(
                f"Of {len(runs)} laws '{best.name}' keeps the contour best: {_contour(best)}; '{first.name}': "
                f"{_contour(first)}."
            )
        )
    place = next(iter(best.worst(1)), None)
    if place is not None:
        results.append(
            Text(
                f"The worst place of '{best.name}' is {_place(best, place.position)}, in line {place.line} of the "
                "program."
            )
        )
    results += _tip_sentences(best, contents.planned)
    if contents.planned is not None:
        cycle = Quantity(contents.planned.cycle_time, "s", form="SI")
        results.append(Text(f"The program takes {cycle}. {_limited(contents.planned)}"))
    return results


def _tip_sentences(part: PartRun, planned: Planned | None) -> list[str]:
    """Return the sentences on a run of five axes: direction of the tool, and the joint that adds most."""
    tip = part.tip
    if tip is None:
        return []
    most = max(tip.joints, key=lambda joint: joint.share)
    results: list[str] = [
        Text(
            f"The tool is off the direction that belongs to its place by {_angle(tip.rms(tip.direction))} RMS, "
            f"{_angle(tip.peak(tip.direction))} at most. Joint {most.letter} makes {Quantity(most.share, 'share'):3} "
            "of the mean square of the contour error."
        )
    ]
    if planned is not None and planned.tip is not None:
        deviation = Quantity(planned.tip.deviation, "m", form="4", stays=True)
        results.append(
            Text(f"All this is against the planned path, whose tip is proven to be within {deviation} of the program.")
        )
    return results


def _angle(size: float) -> Quantity:
    return Quantity(size, "rad", form="3 urad", stays=True)


def _contour(part: PartRun) -> str:
    contour = part.contour
    rms, most, largest = (Quantity(error, "m", form="3") for error in (contour.rms, contour.within(), contour.largest))
    return Text(f"{rms} RMS, {most} on 95 % of the path, {largest} at most")


def _place(part: PartRun, position: Iterable[float], *, bare: bool = False) -> Text:
    """Return a position on the workpiece as text, in mm even if an axis is rotary; `bare` omits the unit."""
    coordinates = [
        f"{axis.upper()} {Quantity(x, 'm', form='.2f mm', stays=True, bare=True)}"
        for axis, x in zip(part.contour.axes, position, strict=True)
    ]
    return joined(" ", coordinates if bare else [*coordinates, unit_name("m", "mm", stays=True)])


def _limited(planned: Planned) -> str:
    most = sorted(planned.seconds.items(), key=lambda item: -item[1])[:3]
    shares = joined(", ", (f"{name} {Quantity(seconds / planned.cycle_time, 'share'):3}" for name, seconds in most))
    return Text(f"What limits its speed: {shares} of the time.")


def tables(contents: LawsContents) -> list[Part]:
    """Tabulate the results of each law over the program, and the positions with the largest errors."""
    runs = ran(contents)
    if not runs:
        return []
    tips = [(entry, part.tip) for entry, part in runs if part.tip is not None]
    return [_laws(runs), *([_joints(tips)] if tips else []), _places(runs)]


def details(contents: LawsContents) -> list[Part]:
    """Tabulate axes, motors, spindle, observers, cutting sections, and the limits on the velocity."""
    runs = ran(contents)
    if not runs:
        return []
    shown: list[Part] = [_axes(runs), _motors(runs)]
    tips = [(entry, part.tip) for entry, part in runs if part.tip is not None]
    shown += [_tips(tips)] if tips else []
    spindles = [(entry, part.load.spindle) for entry, part in runs if part.load.spindle is not None]
    if spindles:
        rows = [
            [entry.name, spindle.power, spindle.peak, spindle.energy, spindle.volume, spindle.specific_energy]
            for entry, spindle in spindles
        ]
        columns = [
            Column("law"),
            Column("power mean", "W", "3"),
            Column("peak", "W", "3"),
            Column("energy", "J", "3"),
            Column("chips", "m3", "3 mm3"),
            Column("energy of chips", "J/m3", "3 J/mm3"),
        ]
        shown.append(Table("Spindle: what the cut takes from it over the whole program.", columns, rows))
    if any(part.estimates for _, part in runs):
        shown.append(_observers(runs))
    return [*shown, *contents.cuts, *([] if contents.planned is None else [_causes(contents.planned)])]


def laws_table(title: str, parts: Mapping[str, PartRun]) -> Table:
    """Return a short table of the results of each law over a program, for the terminal."""
    columns = [
        Column("law"),
        Column("contour RMS", "m"),
        Column("95 %", "m"),
        Column("largest", "m"),
        Column("in line"),
        Column("of continuous", "share", "3"),
        Column("cut", "N"),
        Column("energy", "J"),
    ]
    of_tip = any(part.tip is not None for part in parts.values())
    columns[4:4] = [Column("tool direction", "rad", "3 urad")] if of_tip else []
    rows: list[list[Cell]] = []
    for name, part in parts.items():
        worst = next(iter(part.worst(1)), None)
        contour, line = part.contour, None if worst is None else worst.line
        rows.append(
            [
                name,
                contour.rms,
                contour.within(),
                contour.largest,
                *([None if part.tip is None else part.tip.peak(part.tip.direction)] if of_tip else []),
                line,
                part.duty,
                part.cutting_rms,
                part.load.energy(),
            ]
        )
    return Table(title, columns, rows)


def _laws(runs: Sequence[tuple[Entry, PartRun]]) -> Marked:
    columns = [
        Column("law"),
        Column("contour error RMS", "m", "3"),
        Column("95 %", "m", "3"),
        Column("largest", "m", "3"),
        Column("in line"),
        Column("largest at a reversal", "m", "3"),
        Column("effort: RMS of continuous force", "share", "3"),
        Column("energy", "J", "3"),
    ]
    errors = [(part.contour.rms, part.contour.within(), part.contour.largest) for _, part in runs]
    cuts = any(part.cutting is not None for _, part in runs)
    columns += [Column("cutting force RMS", "N", "3")] if cuts else []
    of_tip = any(part.tip is not None for _, part in runs)
    columns += [Column("tool direction RMS", "rad", "3 urad"), Column("largest", "rad", "3 urad")] if of_tip else []
    rows: list[list[Cell]] = []
    for (entry, part), sizes in zip(runs, errors, strict=True):
        worst = next(iter(part.worst(1)), None)
        glitch = max((axis_errors.glitch for axis_errors in part.axes.values() if axis_errors.glitches), default=None)
        row: list[Cell] = [entry.name, *sizes, None if worst is None else worst.line, glitch]
        row += [part.duty, part.load.energy(), *([part.cutting_rms] if cuts else [])]
        rows.append([*row, *_direction(part.tip)] if of_tip else row)
    # only the contour errors have a best cell: effort and energy are what they cost
    best = [min(range(len(rows)), key=sizes.__getitem__) for sizes in zip(*errors, strict=True)]
    title = (
        "Contour error: the distance of the tool from the commanded path, whatever its delay along it. What counts is "
        "the path on which the tool leaves a wall of the part, not its way in and out beside it; a slot counts whole, "
        "and without [process] all that is moved at a feed. Effort: of the motor that needs the largest share. "
        "Energy: of the axes and the spindle."
    )
    if of_tip:
        title += (
            " The tool is its tip, in the frame of the workpiece; its direction is compared with the one that belongs "
            "to its place on the path."
        )
    marks = [*best, *([None] * (len(columns) - 4))]
    return Marked(Table(title, columns, rows), marks if len(rows) > 1 else ())


def _direction(tip: TipError | None) -> list[Cell]:
    return [None, None] if tip is None else [tip.rms(tip.direction), tip.peak(tip.direction)]


def _joints(tips: Sequence[tuple[Entry, TipError]]) -> Table:
    from feeddrive.machining.tip_error import joint_cells, joint_columns

    rows = [
        [entry.name if i == 0 else "", joint.letter, *joint_cells(joint)]
        for entry, tip in tips
        for i, joint in enumerate(tip.joints)
    ]
    title = (
        "What each joint adds at the tip of the tool, on the path that counts. Error: actual less set position. At the "
        "tip: what it moves there, of a rotary joint the error times the lever arm, the distance of the tip from its "
        "axis (the largest is given). Share: of the mean square of the contour error; negative where the joint makes "
        "up for another one."
    )
    return Table(title, [Column("law"), Column("joint"), *joint_columns()], rows)


def _tips(tips: Sequence[tuple[Entry, TipError]]) -> Table:
    columns = [
        Column("law"),
        Column("along the path RMS", "m", "3"),
        Column("peak", "m", "3"),
        Column("across RMS", "m", "3"),
        Column("peak", "m", "3"),
        Column("lag", "m", "3"),
        Column("tool direction", "rad", "3 urad"),
    ]
    rows = [
        [
            entry.name,
            tip.rms(tip.along),
            tip.peak(tip.along),
            tip.rms(tip.across),
            tip.peak(tip.across),
            tip.peak(tip.contour.lag),
            tip.peak(tip.direction_now),
        ]
        for entry, tip in tips
    ]
    title = "The tip against its set position at the same instant, on the path that counts; lag: along the path."
    return Table(title, columns, rows)


def _axes(runs: Sequence[tuple[Entry, PartRun]]) -> Table:
    names = list(runs[0][1].axes)
    columns = [Column("law")]
    for axis in names:
        unit, form = ("rad", "3 urad") if runs[0][1].turns(axis) else ("m", "3")
        columns += [Column(f"{axis} RMS", unit, form), Column("peak", unit, form), Column("in line")]
    rows = [[entry.name, *(cell for axis in names for cell in _axis(part, axis))] for entry, part in runs]
    title = "Following error of each axis over the whole program, and the line of its peak."
    return Table(title, columns, rows)


def _axis(part: PartRun, axis: str) -> list[Cell]:
    errors = part.axes[axis]
    return [errors.following_rms, errors.following_peak, errors.line]


def _places(runs: Sequence[tuple[Entry, PartRun]]) -> Table:
    """Tabulate the positions at which the first law has its largest errors, with the errors of all laws there."""
    first = runs[0][1]
    columns = [
        Column(f"place {unit_name('m', 'mm', stays=True)}"),
        Column("line"),
        Column("time", "s", "SI"),
        *(Column(entry.name, "m", "3") for entry, _ in runs),
    ]
    rows: list[list[Cell]] = []
    for place in first.worst(_WORST):
        cells = [_near(part, place.time) for _, part in runs]
        rows.append([_place(first, place.position, bare=True), place.line, place.time, *cells])
    title = (
        f"Worst places of '{first.name}': largest contour error within 60 ms of each, in {unit_name('m')}, with each "
        "law."
    )
    return Table(title, columns, rows)


def _near(part: PartRun, time: float) -> float:
    # other laws arrive a little earlier or later: 60 ms cover their delays
    here = abs(part.contour.time - time) <= 0.06
    return float(abs(part.contour.error[here]).max(initial=0.0))


def _motors(runs: Sequence[tuple[Entry, PartRun]]) -> Table:
    columns = [
        Column("law"),
        Column("axis"),
        Column("force RMS", "N", "3"),
        Column("of continuous", "share", "3"),
        Column("peak", "N", "3"),
        Column("of peak", "share", "3"),
        Column("work", "J", "3"),
        Column("drawn without recovery", "J", "3"),
        Column(""),
    ]
    rows = [
        [
            entry.name if i == 0 else "",
            axis,
            Text(f"{part.force_of(axis, load.rms, '3')}") if part.turns(axis) else load.rms,
            load.of_continuous,
            Text(f"{part.force_of(axis, load.peak, '3')}") if part.turns(axis) else load.peak,
            load.of_peak,
            load.work,
            load.drawn,
            load.verdict,
        ]
        for entry, part in runs
        for i, (axis, load) in enumerate(part.load.axes.items())
    ]
    title = "Motors over the whole program: what they give, and whether they can for ever."
    return Table(title, columns, rows)


def _observers(runs: Sequence[tuple[Entry, PartRun]]) -> Table:
    axes = list(runs[0][1].disturbances)
    columns = [Column("law"), Column("observer"), Column("delay", "s", "3")]
    for axis in axes:
        columns += [Column(f"{axis}: acts", "N", "3"), Column("error", "N", "3"), Column("over a turn", "N", "3")]
    rows: list[list[Cell]] = []
    for entry, part in runs:
        for i, (observer, by) in enumerate(part.estimates.items()):
            delay = next(iter(by.values())).lag
            cells = [figure for axis in axes for figure in (by[axis].true, by[axis].error, by[axis].slow)]
            rows.append([entry.name if i == 0 else "", observer.replace("_", " "), delay, *cells])
    title = (
        "Cut, friction and weight as observers estimate them from readings and commands of the run, each with the "
        "start values of its tuning, RMS. What acts: without its mean. The delay of an estimate is taken out of its "
        "error; over a turn: the same in the mean over a turn of the spindle, without the teeth."
    )
    return Table(title, columns, rows)


def _causes(planned: Planned) -> Table:
    most = sorted(planned.seconds.items(), key=lambda item: -item[1])[:_CAUSES]
    rows = [[name, seconds, Quantity(seconds / planned.cycle_time, "share", form="3")] for name, seconds in most]
    columns = [Column("limit"), Column("", "s", "SI"), Column("of the time")]
    title = "Cycle time by what limits it: the limit used most, the feed, a standstill."
    return Table(title, columns, rows)


def pictures(contents: LawsContents) -> Iterator[Picture]:
    """Yield the pictures: contour error by law and along the path, cutting force, force estimates, active limits."""
    runs = ran(contents)
    if not runs:
        return
    parts = {entry.name: part for entry, part in runs}
    first = runs[0][1]
    if len(parts) > 1:
        yield Picture(
            "laws",
            "Contour error by law",
            "The root of the mean square, what is kept on 95 % of the path, and the largest, of the path that counts.",
            "Contour error of each law.",
            lambda: plot.part_laws_chart(parts),
        )
    best = min(parts.values(), key=lambda part: part.contour.rms)
    # the baseline always, the best law only if it is another one: a picture of each law would bury both
    for key, part in {"path": first, **({} if best is first else {"bestpath": best})}.items():
        yield Picture(
            key,
            f"The path with '{part.name}'",
            "Color and width: the size of the contour error on the path that counts. Gray: the tool, its deviation "
            "enlarged.",
            f"The path with the contour error of {part.name}, enlarged.",
            lambda part=part: plot.contour_on_path_chart(part.contour),
        )
    yield from _tip_pictures(first)
    worst = next(iter(first.worst(1)), None)
    if worst is not None:
        yield Picture(
            "worst",
            f"The worst place of '{first.name}'",
            Text(
                f"{_place(first, worst.position)}, line {worst.line}, {Quantity(worst.time, 's'):SI}: the contour "
                "error of each law."
            ),
            "Contour error of each law around the worst place of the first one.",
            lambda: plot.part_zoom_chart(parts, worst.time),
        )
    if first.cutting is not None:
        yield Picture(
            "cut",
            "Force of the cut",
            f"On each axis with '{first.name}', from the chip that the actual motion of the axes leaves.",
            "Force of the cut on each axis over time.",
            lambda: plot.part_cutting_chart(first),
        )
    for axis in list(first.disturbances)[:1] if first.estimates and first.cutting is not None else ():
        yield Picture(
            "estimates",
            "The force and what observers see of it",
            f"Cut, friction and weight on axis {axis} where the cut is largest, and three observers in the same run of "
            f"'{first.name}': none follows the teeth.",
            "Estimates of the force on an axis over time.",
            lambda axis=axis: plot.part_estimates_chart(first, axis),
        )
    planned = contents.planned
    if planned is not None:
        yield Picture(
            "limits",
            "What limits the speed, and when",
            "A row for each limit; it is filled where this limit is used most, and its share of the cycle time stands "
            "behind its name.",
            "Which limit is used most, over time.",
            lambda: plot.plan_causes_chart(planned),
        )


def _tip_pictures(part: PartRun) -> Iterator[Picture]:
    tip = part.tip
    if tip is None:
        return
    yield Picture(
        "tip",
        f"Tip and direction of the tool with '{part.name}'",
        "Across the path: the contour error. Along it: ahead of the set position at the same instant, or behind it. "
        "Direction: against the one that belongs to the place of the tip on its path.",
        "Error of the tip across and along its path, and of the direction of the tool, over time.",
        lambda: plot.tip_error_chart(tip),
    )
    yield Picture(
        "joints",
        f"What each joint adds with '{part.name}'",
        "Each joint's error, less the lag that all have in common, times what it moves at the tip, in the direction of "
        "the contour error: the sum of all joints is the contour error. Below zero a joint makes up for another one.",
        "Parts of the joints in the contour error over time.",
        lambda: plot.tip_joints_chart(tip),
    )
