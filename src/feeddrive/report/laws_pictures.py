"""The pictures of laws over the same work, with captions that explain them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from feeddrive import plot
from feeddrive.analysis.friction_map import FrictionMap, friction_map, worst_window
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.plot.friction import has_friction
from feeddrive.plot.over_time import alike
from feeddrive.plot.style import POINTS
from feeddrive.report.laws import Entry, LawsContents
from feeddrive.report.report import Picture

SHORT = 16  # samples: a shorter run has no picture over time
MOST = 8  # laws that the pictures show; the tables have all
CURVES = 4  # more curves than these share the points of so many: the page stays small


def chosen(contents: LawsContents) -> LawsContents:
    """Return the contents with the laws that the pictures show: the first, and those that follow best, in order."""
    others = sorted(contents.entries[1:], key=lambda entry: entry.rms("following_error"))[: MOST - 1]
    return replace(contents, entries=[entry for i, entry in enumerate(contents.entries) if i == 0 or entry in others])


def pictures(contents: LawsContents) -> Iterator[Picture]:
    """Yield the pictures in the order of the report."""
    contents = chosen(contents)
    points = min(POINTS, max(200, POINTS * CURVES // len(contents.entries)))
    yield from _measured(contents, points)
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
    own = "" if alike(run["following_error"] for run in runs.values()) else " Each row has its own scale."
    listed = joined("; ", (f"{e.name} {Quantity(e.rms('following_error'), 'm'):3} RMS" for e in contents.entries))
    yield Picture(
        "error",
        "Following error over time",
        f"Setpoint minus the controller's reading.{own}",
        Text(f"Following error over time: {listed}."),
        lambda: plot.following_error_chart(runs, points=points),
    )
    window = worst_window(list(runs.values()))
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
