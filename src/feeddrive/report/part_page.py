"""What a report says of a part program on a machine: the contour, the worst places, the motors, the cut, the time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from feeddrive import plot
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.machining.part_run import PartRun
from feeddrive.path.planned import Planned
from feeddrive.report.page import Entry, LawsReport, Shown, ShownTable
from feeddrive.report.sentences import number, percent

_WORST = 8
_CAUSES = 6
_DRAWN = 3  # laws whose path is drawn: today's, the best, and the one between


def ran(contents: LawsReport) -> list[tuple[Entry, PartRun]]:
    """The laws that ran a part program, in their order."""
    return [(entry, entry.part) for entry in contents.entries if entry.part is not None]


def lead(contents: LawsReport) -> list[str]:
    """The results in sentences, most important first."""
    found = ran(contents)
    first = found[0][1]
    best = min((part for _, part in found), key=lambda part: part.contour.rms)
    said: list[str] = []
    if contents.planned is not None:
        said.append(
            Text(f"The program takes {Quantity(contents.planned.cycle_time, 's'):SI}. {_limited(contents.planned)}")
        )
    if best is first:
        told = "" if len(found) == 1 else "None of the others keeps the contour better than "
        said.append(f"{told}'{first.name}': {_contour(first)}.")
    else:
        said.append(
            f"Of {len(found)} laws '{best.name}' keeps the contour best: {_contour(best)}; '{first.name}': "
            f"{_contour(first)}."
        )
    place = next(iter(best.worst(1)), None)
    if place is not None:
        said.append(
            f"The worst place of '{best.name}' is {_place(best, place.position)}, in line {place.line} of the program."
        )
    return said


def _contour(part: PartRun) -> str:
    return (
        f"{number(1e6 * part.contour.rms)} µm RMS, {number(1e6 * part.contour.within())} µm on 95 % of the path, "
        f"{number(1e6 * part.contour.largest)} µm at most"
    )


def _place(part: PartRun, position: Iterable[float]) -> str:
    return (
        " ".join(f"{axis.upper()} {1e3 * x:.2f}" for axis, x in zip(part.contour.axes, position, strict=True)) + " mm"
    )


def _limited(planned: Planned) -> str:
    most = sorted(planned.seconds.items(), key=lambda each: -each[1])[:3]
    told = ", ".join(f"{name} {percent(seconds / planned.cycle_time)}" for name, seconds in most)
    return f"What limits its speed: {told} of the time."


def tables(contents: LawsReport) -> list[ShownTable]:
    """Laws over the program, axes, worst places, motors, observers, sections that cut, limits of the speed."""
    found = ran(contents)
    if not found:
        return []
    shown = [_laws(found), _axes(found), _places(found), _motors(found)]
    spindles = [(entry, part.load.spindle) for entry, part in found if part.load.spindle is not None]
    if spindles:
        rows = [
            [entry.name, number(each.power), number(each.peak), number(each.energy),
             number(None if each.volume is None else 1e9 * each.volume),
             number(None if each.specific_energy is None else 1e-9 * each.specific_energy)]
            for entry, each in spindles
        ]  # fmt: skip
        heads = ["law", "power mean W", "peak W", "energy J", "chips mm³", "J/mm³"]
        shown.append(ShownTable(Table("Spindle: what the cut takes from it over the whole program.", heads, rows)))
    if any(part.estimates for _, part in found):
        shown.append(_observers(found))
    return [*shown, *contents.cuts, *([] if contents.planned is None else [_causes(contents.planned)])]


def laws_table(title: str, parts: Mapping[str, PartRun]) -> Table:
    """The laws over a program, short, for a terminal."""
    heads = ["law", "contour RMS um", "95 %", "largest", "in line", "of continuous", "cut N", "J"]
    rows: list[list[str]] = []
    for name, part in parts.items():
        worst = next(iter(part.worst(1)), None)
        sizes = (part.contour.rms, part.contour.within(), part.contour.largest)
        cells = [*(f"{1e6 * each:.4g}" for each in sizes), "-" if worst is None else str(worst.line)]
        cells += ["-" if part.duty is None else Text(f"{Quantity(part.duty, 'share'):3}")]
        cut = part.cutting_rms
        rows.append([name, *cells, "-" if cut is None else f"{cut:.4g}", f"{part.load.energy():.4g}"])
    return Table(title, heads, rows)


def _laws(found: Sequence[tuple[Entry, PartRun]]) -> ShownTable:
    heads = ["law", "contour error RMS µm", "95 % µm", "largest µm", "in line", "largest at a reversal µm",
             "effort: RMS of continuous force", "energy J"]  # fmt: skip
    columns = [
        [part.contour.rms for _, part in found],
        [part.contour.within() for _, part in found],
        [part.contour.largest for _, part in found],
    ]
    cuts = any(part.cutting is not None for _, part in found)
    heads += ["cutting force RMS N"] if cuts else []
    rows: list[list[str]] = []
    for i, (entry, part) in enumerate(found):
        worst = next(iter(part.worst(1)), None)
        glitch = max((each.glitch for each in part.axes.values() if each.glitches), default=None)
        row = [entry.name, *(number(1e6 * column[i]) for column in columns), "–" if worst is None else str(worst.line)]
        row += ["–" if glitch is None else number(1e6 * glitch)]
        row += ["–" if part.duty is None else percent(part.duty), number(part.load.energy())]
        rows.append([*row, *([number(part.cutting_rms)] if cuts else [])])
    best = [min(range(len(rows)), key=column.__getitem__) for column in columns]
    said = (
        "Contour error: the distance of the tool from the commanded path, whatever its delay along it. What counts is "
        "the path that cuts, or is moved at a feed. Effort: of the motor that needs the largest share. "
        "Energy: of the axes and the spindle."
    )
    marks = [*best, *([None] * (len(heads) - 4))]
    return ShownTable(Table(said, heads, rows), marks if len(rows) > 1 else ())


def _axes(found: Sequence[tuple[Entry, PartRun]]) -> ShownTable:
    names = list(found[0][1].axes)
    heads = ["law", *(head for axis in names for head in (f"{axis} RMS µm", "peak µm", "in line"))]
    rows = [[entry.name, *(cell for axis in names for cell in _axis(part, axis))] for entry, part in found]
    return ShownTable(
        Table("Following error of each axis over the whole program, and the line of its peak.", heads, rows)
    )


def _axis(part: PartRun, axis: str) -> list[str]:
    each = part.axes[axis]
    return [number(1e6 * each.following_rms), number(1e6 * each.following_peak), str(each.line)]


def _places(found: Sequence[tuple[Entry, PartRun]]) -> ShownTable:
    """The worst places of the first law, and what the others do there."""
    first = found[0][1]
    heads = ["place mm", "line", "time s", *(entry.name for entry, _ in found)]
    rows: list[list[str]] = []
    for each in first.worst(_WORST):
        cells = [number(1e6 * _near(part, each.time)) for _, part in found]
        rows.append([_place(first, each.position).removesuffix(" mm"), str(each.line), f"{each.time:.4g}", *cells])
    said = f"Worst places of '{first.name}': largest contour error within 60 ms of each, in µm, with each law."
    return ShownTable(Table(said, heads, rows))


def _near(part: PartRun, time: float) -> float:
    here = abs(part.contour.time - time) <= 0.06
    return float(abs(part.contour.error[here]).max(initial=0.0))


def _motors(found: Sequence[tuple[Entry, PartRun]]) -> ShownTable:
    heads = [
        "law",
        "axis",
        "force RMS N",
        "of continuous",
        "peak N",
        "of peak",
        "work J",
        "drawn without recovery J",
        "",
    ]
    rows = [
        [entry.name if i == 0 else "", axis, number(load.rms), _share(load.of_continuous), number(load.peak),
         _share(load.of_peak), number(load.work), number(load.drawn), load.verdict]
        for entry, part in found for i, (axis, load) in enumerate(part.load.axes.items())
    ]  # fmt: skip
    return ShownTable(
        Table("Motors over the whole program: what they give, and whether they can for ever.", heads, rows)
    )


def _share(share: float | None) -> str:
    return "–" if share is None else percent(share)


def _observers(found: Sequence[tuple[Entry, PartRun]]) -> ShownTable:
    axes = list(found[0][1].disturbances)
    heads = [
        "law",
        "observer",
        "delay ms",
        *(h for axis in axes for h in (f"{axis}: acts N", "error N", "over a turn N")),
    ]
    rows: list[list[str]] = []
    for entry, part in found:
        for i, (observer, by) in enumerate(part.estimates.items()):
            delay = number(1e3 * next(iter(by.values())).lag)
            cells = [
                cell for axis in axes for cell in (number(by[axis].true), number(by[axis].error), number(by[axis].slow))
            ]
            rows.append([entry.name if i == 0 else "", observer.replace("_", " "), delay, *cells])
    said = (
        "Cut, friction and weight as observers estimate them from readings and commands of the run, each with the "
        "start values of its tuning, RMS. What acts: without its mean. The delay of an estimate is taken out of its "
        "error; over a turn: the same in the mean over a turn of the spindle, without the teeth."
    )
    return ShownTable(Table(said, heads, rows))


def _causes(planned: Planned) -> ShownTable:
    most = sorted(planned.seconds.items(), key=lambda each: -each[1])[:_CAUSES]
    rows = [[name, f"{seconds:.4g}", percent(seconds / planned.cycle_time)] for name, seconds in most]
    return ShownTable(
        Table(
            "Cycle time by what limits it: the limit used most, the feed, a standstill.",
            ["limit", "s", "of the time"],
            rows,
        )
    )


def pictures(contents: LawsReport) -> Iterator[Shown]:
    """The path with the error on it, the error along it, the time."""
    found = ran(contents)
    if not found:
        return
    parts = {entry.name: part for entry, part in found}
    first = found[0][1]
    if len(parts) > 1:
        yield Shown(
            "laws",
            "Contour error by law",
            "The root of the mean square, what is kept on 95 % of the path, and the largest, of the path that counts.",
            "Contour error of each law.",
            lambda: plot.part_laws(parts),
        )
    best = min(parts.values(), key=lambda part: part.contour.rms)
    for key, part in {"path": first, **({} if best is first else {"bestpath": best})}.items():
        yield Shown(
            key,
            f"The path with '{part.name}'",
            "Color and width: the size of the contour error on the path that counts. Gray: the tool, its deviation "
            "enlarged.",
            f"The path with the contour error of {part.name}, enlarged.",
            lambda part=part: plot.contour_on_path(part.contour),
        )
    worst = next(iter(first.worst(1)), None)
    if worst is not None:
        yield Shown(
            "worst",
            f"The worst place of '{first.name}'",
            Text(
                f"{_place(first, worst.position)}, line {worst.line}, {Quantity(worst.time, 's'):SI}: the contour "
                "error of each law."
            ),
            "Contour error of each law around the worst place of the first one.",
            lambda: plot.part_zoom(parts, worst.time),
        )
    if first.cutting is not None:
        yield Shown(
            "cut",
            "Force of the cut",
            f"On each axis with '{first.name}', from the chip that the actual motion of the axes leaves.",
            "Force of the cut on each axis over time.",
            lambda: plot.part_cutting(first),
        )
    for axis in list(first.disturbances)[:1] if first.estimates and first.cutting is not None else ():
        yield Shown(
            "estimates",
            "The force and what observers see of it",
            f"Cut, friction and weight on axis {axis} where the cut is largest, and three observers in the same run of "
            f"'{first.name}': none follows the teeth.",
            "Estimates of the force on an axis over time.",
            lambda axis=axis: plot.part_estimates(first, axis),
        )
    planned = contents.planned
    if planned is not None:
        yield Shown(
            "limits",
            "What limits the speed, and when",
            "A row for each limit; it is filled where this limit is used most, and its share of the cycle time stands "
            "at its right.",
            "Which limit is used most, over time.",
            lambda: plot.plan_causes(planned),
        )
