"""Pictures of chatter: stability lobes versus spindle speed, and indicators of chatter in a signal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import USUAL, Quantity, signal_unit, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.chart import (
    ALERT,
    BAR,
    DOTS,
    MARKERS,
    PANELS,
    PLAIN,
    Abscissa,
    Band,
    Chart,
    Curve,
    Level,
    Mark,
    Note,
    Panel,
    numbered,
    rods,
)
from feeddrive.plot.drawing import figure_of

if TYPE_CHECKING:
    from feeddrive.machining.cutting_force import CuttingForces
    from feeddrive.machining.lobes import ChatterSigns, CutStability, Lobes

_CROWDED = 12  # largest number of labeled tooth-passing lines; of more lines, only the upper ones have labels


def lobes_chart(lobes: Lobes) -> Chart:
    """Plot the depth limits versus spindle speed, Hopf and flip limits in different colors and the stable region
    shaded.

    The chatter frequency is plotted below.
    """
    speed, there = lobes.spindle_speed, np.isfinite(lobes.depth)
    top = 1e3 * (1.15 * np.max(lobes.depth[there]) if np.any(there) else lobes.deepest)
    if lobes.own is not None:
        top = max(top, 1.15e3 * lobes.own.depth)
    # a speed that is stable at every depth is shaded up to the edge
    shaded = np.minimum(np.where(there, 1e3 * lobes.depth, top), top)
    stable = Band(speed, np.zeros(speed.size), shaded, 2, "stable")
    borders, frequencies = list[Curve](), list[Curve]()
    for i, (flip, name) in enumerate(((False, "Hopf border"), (True, "flip border"))):
        borders += _border(speed, 1e3 * lobes.depth, there, lobes.flip == flip, i, name)
        chosen = there & (lobes.flip == flip)
        frequencies.append(Curve(speed[chosen], lobes.frequency[chosen], number=i, look=MARKERS, size=0.55))
    for rpm, low, high in lobes.islands:
        height = np.array([1e3 * low, min(1e3 * high, top)])
        borders.append(Curve(np.array([rpm, rpm]), height, "stable again above the border", 2, BAR))
    caption = "tooth passes every k swings of a mode"
    passing = tuple(
        Level(rpm, f"{k}" if n < _CROWDED else "", upright=True, dashed=True, faint=True, caption=caption)
        for n, (rpm, _, k) in enumerate(reversed(lobes.passing()))
    )
    marks, notes = ((), ()) if lobes.own is None else _this_cut(lobes.own, speed)
    low = float(np.nanmin(lobes.frequency)) if np.any(there) else 0.0
    high = float(np.nanmax(lobes.frequency)) if np.any(there) else 1.0
    low, high = style.padded(low, high, 0.12)
    panels = (
        Panel(
            "axial depth (mm)",
            tuple(borders),
            marks,
            levels=passing,
            notes=notes,
            bands=(stable,),
            low=0.0,
            high=float(top),
            share=2.0,
        ),
        Panel(
            "chatter (Hz)",
            tuple(frequencies),
            levels=tuple(Level(float(f), dashed=True) for f in lobes.natural),
            low=low,
            high=high,
            caption="dashed: own frequencies" if lobes.natural.size else "",
        ),
    )
    ends = float(speed[0]), float(speed[-1])
    return Chart("spindle speed (rpm)", panels, low=ends[0], high=ends[1], height=5.4, columns=3)


lobes = figure_of(lobes_chart)


def _border(
    speed: np.ndarray, depth: np.ndarray, there: np.ndarray, kind: np.ndarray, number: int, name: str
) -> list[Curve]:
    """Return the stability limit of one type, extended to the next speed so that there is no gap where the type
    changes.
    """
    chosen = there & kind
    if not np.any(chosen):
        return []
    joined = chosen | (np.roll(chosen, 1) & there & (np.arange(speed.size) > 0))
    line = Curve(speed, np.where(joined, depth, np.nan), name, number)
    if np.count_nonzero(chosen) >= 3:
        return [line]
    return [line, Curve(speed[chosen], depth[chosen], number=number, look=MARKERS, size=0.9)]


def _this_cut(cut: CutStability, speed: np.ndarray) -> tuple[tuple[Mark, ...], tuple[Note, ...]]:
    number = 2 if cut.stable else ALERT
    text = Text(f"this cut: |µ| = {Quantity(cut.growth):.3f}{'' if cut.stable else ', chatters'}")
    at = cut.speed, 1e3 * cut.depth
    left = cut.speed > 0.6 * float(speed[-1]) + 0.4 * float(speed[0])
    return (Mark(*at, number),), (Note(*at, text, number, right=not left),)


def cutting_forces_chart(cutting: CuttingForces) -> Chart:
    """Plot forces versus spindle angle in the last cutting revolution, and radial spindle force and power versus
    time.
    """
    turns = cutting.angle / (2.0 * np.pi)
    cuts = np.flatnonzero(cutting.torque != 0.0)
    forces, caption = tuple[Curve, ...](), ""
    if cuts.size:
        last = np.floor(turns[cuts[-1]])
        # the last whole turn, since the one in which the cut ends is not complete
        turn = (turns >= last - 1.0) & (turns < last) if last >= 1.0 else np.ones(turns.size, dtype=bool)
        degrees = 360.0 * (turns[turn] - np.floor(turns[turn][0]))
        names = ("feed", "normal", "axial")
        forces = tuple(Curve(degrees, getattr(cutting, name)[turn], name, i) for i, name in enumerate(names))
        caption = Text(f"the turn from {Quantity(cutting.time[turn][0], 's'):SI} on")
    angle = Abscissa("angle of the spindle (°)", low=0.0, high=360.0, ticks=numbered(range(0, 361, 60)))
    panels = [Panel(f"force on the\ntool ({unit_name('N')})", forces, caption=caption, abscissa=angle)]
    for name, words, unit in (("resultant", "force across\nthe spindle", "N"), ("power", "power", "W")):
        values = getattr(cutting, name)
        mean = float(np.mean(values[cuts])) if cuts.size else 0.0
        mean, peak = (Quantity(size, unit, bare=True) for size in (mean, np.max(np.abs(values))))
        caption = Text(f"mean {mean} while it cuts, peak {peak}")
        panels.append(
            Panel(f"{words} ({unit_name(unit)})", (Curve(*style.envelope(cutting.time, values)),), caption=caption)
        )
    ends = float(cutting.time[0]), float(cutting.time[-1])
    return Chart("time (s)", tuple(panels), low=ends[0], high=ends[1], height=6.0, legend=PANELS)


cutting_forces = figure_of(cutting_forces_chart)


def chatter_signs_chart(signs: ChatterSigns) -> Chart:
    """Plot the spectrum with tooth-passing harmonics separate, and each once-per-tooth sample versus the previous
    one.
    """
    lines = signs.spectrum
    unit, factor = USUAL.of(lines.unit, signal_unit(lines.unit))
    name = unit_name(style.written(unit))
    # beyond the eighth harmonic of tooth or chatter nothing new appears
    top = min(float(lines.frequency[-1]), 8.0 * max(signs.passing, signs.chatter if signs.dots != 1 else 0.0))
    chosen = (lines.frequency > 0.0) & (lines.frequency <= top)
    stems = tuple(
        Curve(*rods(lines.frequency, 0.0, np.where(kind & chosen, factor * lines.amplitude, np.nan)), text, i, PLAIN)
        for i, (kind, text) in enumerate(((signs.harmonic, "harmonics of the teeth"), (~signs.harmonic, "all else")))
    )
    notes = tuple[Note, ...]()
    if signs.dots != 1:
        peak = factor * float(lines.amplitude[np.searchsorted(lines.frequency, signs.chatter)])
        notes = (Note(signs.chatter, peak, Text(f"{Quantity(signs.chatter, 'Hz')}"), 1, right=True),)
    spectrum = Panel(
        f"{lines.name.replace('_', ' ')} ({name})",
        stems,
        notes=notes,
        low=0.0,
        width=1.7,
        high=1.12 * factor * float(np.max(lines.amplitude[chosen])),
        abscissa=Abscissa("frequency (Hz)", low=0.0, high=top),
    )
    values = factor * signs.samples
    middle, spread = float(np.mean(values)), 1.3 * float(np.ptp(values))
    room = max(0.5 * spread, 0.5 * factor * signs.swing if signs.dots == 1 else 0.0) or 1.0
    low, high = middle - room, middle + room
    once = Curve(values[:-1], values[1:], number=0 if signs.dots == 1 else 1, look=DOTS, size=2.0)
    sections = Panel(
        f"a tooth later ({name})",
        (once,),
        low=low,
        high=high,
        caption={1: "one dot: stable", 2: "two dots: flip", 0: "a ring: Hopf chatter"}[signs.dots],
        abscissa=Abscissa(f"once per tooth ({name})", low=low, high=high, square=True),
    )
    return Chart("", (spectrum, sections), across=2, height=3.6)


chatter_signs = figure_of(chatter_signs_chart)
