"""The report that compares laws on the same task: pictures with captions, and tables."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive import plot
from feeddrive.analysis.friction_map import FrictionMap, friction_map, worst_window
from feeddrive.analysis.replay import Replay
from feeddrive.language import tree
from feeddrive.language.block import Declaration
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.table import UNIT, Cell, Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.plot.identification import has_friction
from feeddrive.plot.over_time import alike
from feeddrive.plot.style import POINTS
from feeddrive.report import machining_report as part_report
from feeddrive.report.laws import Entry, LawsContents, remark_sentences, result_sentences
from feeddrive.report.machining_report import ran
from feeddrive.report.report import Code, Facts, Marked, Part, Picture, Remarks, Report, Section, Verdict, facts

SHORT = 16  # samples: a shorter run has no picture over time
MOST = 8  # laws that the pictures show; the tables have all
# the points of this many curves are shared by more curves, so that the page stays small
CURVES = 4


def chosen(contents: LawsContents) -> LawsContents:
    """Return the contents with only the laws to plot: the first, and those with the smallest following error."""
    others = sorted(contents.entries[1:], key=lambda entry: entry.rms("following_error"))[: MOST - 1]
    # entries compare by identity (eq=False), so that two laws with equal figures stay two; their order is kept
    return replace(contents, entries=[entry for i, entry in enumerate(contents.entries) if i == 0 or entry in others])


def pictures(contents: LawsContents) -> Iterator[Picture]:
    """Yield the pictures in the order of the report."""
    contents = chosen(contents)
    # more curves with fewer points: the page stays below a megabyte with any number of laws
    points = min(POINTS, max(200, POINTS * CURVES // len(contents.entries)))
    yield from _measured(contents, points)
    # reversals and spectra need more than a few samples
    if all(entry.counted("following_error").size >= SHORT for entry in contents.entries):
        yield from _errors(contents, points)
        yield from _forces(contents, points)
    yield from _open_loop(contents)
    yield from _closed_loop(contents)


def _measured(contents: LawsContents, points: int) -> Iterator[Picture]:
    entry = next((entry for entry in contents.entries if entry.replay is not None), None)
    if entry is None or entry.replay is None:
        return
    replay = entry.replay
    yield Picture(
        "prediction",
        "Measured and predicted",
        "Gray: the log. Blue: the model, given only the reference of the log and the state in which it starts. "
        f"Residual: predicted - measured; the first {replay.skipped} samples do not count.",
        Text(f"Measured and predicted signals over time; residual {Quantity(replay.rms('position_load'), 'm'):3} RMS."),
        lambda: plot.replay_chart(replay, points),
    )


def _errors(contents: LawsContents, points: int) -> Iterator[Picture]:
    runs = {entry.name: entry.shown for entry in contents.entries}
    scales = "" if alike(run["following_error"] for run in runs.values()) else " Each row has its own scale."
    listed = joined("; ", (f"{e.name} {Quantity(e.rms('following_error'), 'm'):3} RMS" for e in contents.entries))
    yield Picture(
        "error",
        "Following error over time",
        f"Setpoint minus the controller's reading.{scales}",
        Text(f"Following error over time: {listed}."),
        lambda: plot.following_error_chart(runs, points=points),
    )
    window = worst_window(list(runs.values()))
    # a run without a reversal has its window around the largest error: the texts must not mention friction
    what = "the worst reversal" if window.reversal is not None else "the largest error"
    reason = " Friction changes its sign here." if window.reversal is not None else ""
    yield Picture(
        "zoom",
        f"Following error around {what}",
        Text(f"{Quantity(window.begin, 's'):SI} to {Quantity(window.end, 's'):SI}.{reason}"),
        f"Following error around {what}.",
        lambda: plot.following_error_chart(runs, window, points),
    )
    spectra = {entry.name: entry.spectrum for entry in contents.entries}
    yield Picture(
        "spectrum",
        "Amplitude spectrum of the following error",
        "Above: amplitude (Hann window), the largest of each of 500 bands. Below: the RMS of all that lies below a "
        "frequency; its right end is the RMS of the whole error, and where it climbs the error is made.",
        Text(f"Amplitude spectrum and cumulative RMS of the following error: {listed}."),
        lambda: plot.spectrum_chart(spectra),
    )


def _forces(contents: LawsContents, points: int) -> Iterator[Picture]:
    runs = {entry.name: entry.shown for entry in contents.entries}
    first = contents.entries[0]
    bounds = {k: v for entry in contents.entries for k, v in entry.limits.items()}
    yield Picture(
        "force",
        "Force",
        "As commanded. The peak limit holds for every sample, the continuous one for the RMS of the whole work.",
        Text(f"Commanded force over time, {Quantity(first.peak('force'), 'N'):3} at most with {first.name}."),
        lambda: plot.force_chart(runs, bounds, points),
    )
    yield Picture(
        "motion",
        "Velocity and acceleration",
        "Of the table, true values; dotted: as the reference states them.",
        "Velocity and acceleration of the table over time.",
        lambda: plot.motion_chart(runs, points),
    )
    loops = {entry.name: entry.loop for entry in contents.entries}
    if not any(has_friction(loop) for loop in loops.values()):
        return
    measured = _measured_friction(first)
    legend = " Points with bars: the log, with the inertia taken out." if measured is not None else ""
    yield Picture(
        "friction",
        "Friction",
        f"Force against the motion over velocity, as the model has it, and as met in the run of "
        f"'{first.name}'.{legend}",
        "Friction force over velocity in both directions.",
        lambda: plot.friction_chart(loops, first.shown, measured),
    )


def _measured_friction(entry: Entry) -> FrictionMap | None:
    replay = entry.replay
    if replay is None or "force" not in replay.measured:
        return None
    # a log has no mass: that of the model turns the acceleration into the inertia force to subtract
    mass = float(entry.loop.axis.plant.rigid_mass())
    measured = replay.measured
    return friction_map(measured["position_load"], measured["force"], mass, entry.run.sample_time)


def _open_loop(contents: LawsContents) -> Iterator[Picture]:
    loops = {entry.name: entry.margins for entry in contents.entries if entry.margins is not None}
    if not loops:
        return
    listed = "; ".join(f"{name} Ms {number(m.sensitivity_peak, 3)}" for name, m in loops.items())
    yield Picture(
        "open",
        "Open loop and its margins",
        "The loop gain with all delays, opened at the drive, in motion. Bars: phase margins, from the phase at 0 dB to "
        "-180°, and gain margins, from the gain at -180° (open marks) to 0 dB.",
        f"Bode plot of the open loop with gain and phase margins marked: {listed}.",
        lambda: plot.open_loop_chart(loops),
    )
    yield Picture(
        "nyquist",
        "Nyquist plot near -1",
        "No loop comes nearer to -1 than the circle that it touches; its radius is 1/Ms. Thin: negative frequencies.",
        f"Nyquist plot with unit circle and sensitivity circles: {listed}.",
        lambda: plot.nyquist_chart(loops),
    )
    yield Picture(
        "sensitivity",
        "Sensitivity",
        "|S|: what is left of a disturbance force at the drive; below 0 dB the loop suppresses it, above it amplifies "
        "it, at worst by Ms (marked). |T| = |1 - S|.",
        f"Sensitivity and complementary sensitivity over frequency: {listed}.",
        lambda: plot.sensitivity_chart(loops),
    )


def _closed_loop(contents: LawsContents) -> Iterator[Picture]:
    tracked = {entry.name: entry.tracking for entry in contents.entries if entry.tracking is not None}
    if tracked:
        yield Picture(
            "closed",
            "Closed loop",
            "True position over set position, feedforward included; marks where it falls below -3 dB.",
            "Magnitude of the closed loop over frequency.",
            lambda: plot.closed_loop_chart(tracked),
        )
    stiff = {entry.name: entry.stiffness for entry in contents.entries if entry.stiffness is not None}
    if stiff:
        listed = joined("; ", (f"{name} at least {Quantity(k.minimum, 'N/m'):3}" for name, k in stiff.items()))
        yield Picture(
            "stiffness",
            "Dynamic stiffness",
            "Force on the table over the displacement that it causes, in closed loop and in motion: higher is better. "
            "The rise at the right end is the inertia of the axis.",
            Text(f"Dynamic stiffness over frequency: {listed}."),
            lambda: plot.stiffness_chart(stiff),
        )


def laws_report(contents: LawsContents) -> Report:
    """Return the report that compares the laws. Its HTML page is smaller than 1 MB (1.5 MB with a part program).

    Raises ParameterError for contents without entries.
    """
    if not contents.entries:
        raise ParameterError("a report needs at least one law")
    along = ran(contents)
    drawn = [*contents.pictures, *part_report.pictures(contents), *pictures(contents)]
    first = contents.overview or next(iter(drawn), None)
    replay = next((entry.replay for entry in contents.entries if entry.replay is not None), None)
    rule = [("Rule of comparison", contents.rule)] if contents.rule else []
    laws, shown = len(contents.entries), len(chosen(contents).entries)
    some = f"The pictures show {shown} of {laws} laws: the first, and those that follow best." if shown < laws else ""
    tables: list[Part] = [
        *([prediction(replay)] if replay is not None else []),
        *part_report.tables(contents),
        *contents.extras,
        *([] if along else [errors(contents)]),
        limits(contents),
        *frequency(contents),
        Remarks(remark_sentences(contents)),
    ]
    sentences_ = part_report.lead(contents) if along else result_sentences(contents)
    tripped = any(np.any(entry.run["trip"] > 0.0) for entry in contents.entries)
    same = "The same job, with the same versions and seed, gives the same numbers to the last bit."
    return Report(
        contents.title,
        contents.command,
        # a comparison alone is neither good nor bad: only a trip of a guard is a failure
        Verdict(sentences_, good=False if tripped else None),
        (
            Section("result", "Result", tables),
            Section("pictures", "Pictures", (some, *(picture for picture in drawn if picture is not first))),
            *contents.details,
            Section("details", "Axes, motors, spindle and observers", part_report.details(contents), folded=True),
            facts(
                "What was run",
                [
                    *contents.facts.items(),
                    *((f"Law '{entry.name}'", entry.description) for entry in contents.entries),
                    *rule,
                ],
            ),
            Section("parameters", "All parameters", (parameters(contents),), folded=True),
            Section(
                "repeat",
                "How to repeat it",
                (same, *([Code("Job", contents.job)] if contents.job else []), Facts(contents.versions)),
                folded=True,
            ),
        ),
        first,
        contents.entries[0].loop.axis.rotary,
    )


def errors(contents: LawsContents) -> Marked:
    """Tabulate the RMS and peak errors and the force of each law."""
    figures = [
        (
            entry.rms("following_error"),
            entry.peak("following_error"),
            entry.rms("tracking_error"),
            entry.peak("tracking_error"),
        )
        for entry in contents.entries
    ]
    rows = [
        [entry.name, *errors, _against(entry, "force", "peak"), _against(entry, "force", "rms")]
        for entry, errors in zip(contents.entries, figures, strict=True)
    ]
    # the forces have no best cell: a smaller force is no merit by itself
    best = [*map(_least, zip(*figures, strict=True)), None, None]
    heads = ("following error RMS", "peak", "tracking error RMS", "peak")
    columns = [
        Column("law"),
        *(Column(head, "m", "3") for head in heads),
        Column("force peak", "N"),
        Column("force RMS", "N"),
    ]
    title = (
        "Errors and force. Following error: setpoint minus the controller's reading. "
        "Tracking error: setpoint minus true position."
    )
    return Marked(Table(title, columns, rows), best if len(rows) > 1 else ())


def _against(entry: Entry, signal: str, what: str) -> Text:
    """Return a force as text, followed by its percentage of the corresponding limit in brackets."""
    value = entry.peak(signal) if what == "peak" else entry.rms(signal)
    bounds = entry.limits
    limit = (
        bounds.get("motor continuous (RMS)")
        if what == "rms"
        else bounds.get("motor peak", bounds.get("commanded limit"))
    )
    share = "" if limit is None else f" ({Quantity(value / limit, 'share'):3})"
    return Text(f"{Quantity(value, 'N', bare=True):3}{share}")


def limits(contents: LawsContents) -> str:
    """Return a sentence that states the limits to which the force percentages refer."""
    stated = contents.entries[0].limits
    if not stated:
        return "The machine file states no force limits."
    listed = joined(", ", (f"{name} {Quantity(limit, 'N')}" for name, limit in stated.items()))
    return Text(f"Percentages of force: peak against the peak limit, RMS against the continuous one. Stated: {listed}.")


def frequency(contents: LawsContents) -> list[Table]:
    """Tabulate the margins, sensitivity peak and stiffness of each law; return an empty list if no law has any."""
    if all(entry.margins is None and entry.stiffness is None for entry in contents.entries):
        return []
    rows: list[list[Cell]] = []
    for entry in contents.entries:
        m, k = entry.margins, entry.stiffness
        row: list[Cell] = [entry.name]
        if m is None:
            row += [None] * 6
        else:
            delay = None if m.delay_margin is None else Quantity(m.delay_margin, "s", form="3", bare=True)
            samples = "" if m.delay_margin_samples is None else f" ({number(m.delay_margin_samples, 3)})"
            row += [
                m.crossover,
                m.phase_margin_deg,
                m.gain_increase_dB,
                m.gain_reduction_dB,
                None if delay is None else Text(f"{delay}{samples}"),
                Text(f"{number(m.sensitivity_peak, 3)} ({Quantity(m.modulus_frequency, 'Hz', bare=True):3})"),
            ]
        at = "" if k is None else f"{Quantity(k.minimum_frequency, 'Hz', bare=True):3}"
        row.append(None if k is None else Text(f"{Quantity(k.minimum, 'N/m', bare=True):3} ({at})"))
        # `at` refuses a frequency outside the lines, which end below 1 Hz if the loop runs at less than 2 Hz
        row.append(None if k is None or not k.frequency[0] <= 1.0 <= k.frequency[-1] else k.at(1.0))
        rows.append(row)
    hertz, stiff = unit_name("Hz"), unit_name("N/m")
    columns = [
        Column("law"),
        Column("crossover", "Hz", "3"),
        Column("phase margin", "deg", ".1f"),
        Column("gain may rise", "dB", ".1f"),
        Column("gain may fall", "dB", ".1f"),
        Column(f"delay margin {unit_name('s')}{' (samples)' if _sampled(contents) else ''}"),
        Column(f"Ms (at {hertz})"),
        Column(f"least stiffness {stiff} (at {hertz})"),
        Column("stiffness at 1 Hz", "N/m", "3"),
    ]
    title = "Robustness and stiffness, of the loop in motion, opened at the drive."
    return [Table(title, columns, rows)]


def _sampled(contents: LawsContents) -> bool:
    return any(
        entry.margins is not None and entry.margins.delay_margin_samples is not None for entry in contents.entries
    )


def prediction(replay: Replay) -> Table:
    """Tabulate the measured and the predicted signals."""
    return replay.table()


def parameters(contents: LawsContents) -> Table:
    """Tabulate every parameter of every law with its unit and meaning, marking the rows in which the laws differ."""
    rows: dict[str, tuple[Declaration, list[Any]]] = {}
    count = len(contents.entries)
    for i, entry in enumerate(contents.entries):
        for name, value in tree.parameters(entry.loop).items():
            # laws have different parameters: a cell stays empty where a law has none of this name
            row = rows.setdefault(name, (tree.declaration(entry.loop, name), [None] * count))
            row[1][i] = value
    body: list[list[Cell]] = []
    for name in sorted(rows, key=_place):
        declaration, values = rows[name]
        form = "6" if declaration.unit == "m" else "6 SI"
        cells = [
            None if value is None else Quantity(float(value), declaration.unit, form=form, stays=True)
            for value in values
        ]
        differs = count > 1 and any(value != values[0] for value in values)
        body.append([f"{name} *" if differs else name, *cells, UNIT, declaration.meaning])
    heads: list[Column | str] = ["parameter", *(entry.name for entry in contents.entries), "unit"]
    note = "Parameters of the loop; * marks those in which the laws differ." if count > 1 else "Parameters of the loop."
    return Table(note, [*heads, Column("meaning", sentences=True)], body)


def _place(name: str) -> int:
    """Return the sort key of a parameter, which places controller parameters before axis parameters."""
    return 0 if ".control." in name else 1


def _least(values: Sequence[float]) -> int | None:
    low = min(range(len(values)), key=values.__getitem__)
    # values that agree in all digits shown have no best
    return low if sum(value <= values[low] * 1.0001 for value in values) == 1 else None
