"""Pictures of a certificate: the margin against the discs over frequency, and the discs in the complex plane."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.plot import style

if TYPE_CHECKING:
    from feeddrive.certificate.certificate import Certificate
    from feeddrive.certificate.discs import LoopResponse

_MOST = 6  # rows of one picture
_DECADES = 3.0  # below the smallest reserve, the range that is shown
_DISCS = 500  # drawn in the complex plane
_SHADE = "#f6dbc8"


def certificate(found: Certificate) -> Any:
    """|1 + L|/|L| of each plant over the certified radius, the plants with the smallest reserve first.

    With two rates 1/Σ|H| instead, over the force at a frequency and its images that a sine of 1 N there adds to.
    """
    plants = sorted(found.document["plants"], key=lambda each: each["reserve"] or np.inf)[:_MOST]
    figure, axes = style.picture(len(plants), height=1.0 + 2.2 * len(plants))
    nyquist = 0.5 / found.sample_time
    low = min(max(each["reserve_at_Hz"] * 10.0**-_DECADES, 1e-4 * nyquist) for each in plants)
    for ax, each in zip(axes, plants, strict=True):
        loop = found.loops[each["name"]]
        f = loop.lines()
        f = f[f >= low]
        distance, taken = loop.room(f)
        size = loop.size(f)
        ax.plot(f, distance / size, label="1/Σ|H|" if found.two_rates else "|1 + L|/|L|", **style.curve(0))
        ax.fill_between(f, taken / size, 1e-9, color=style.color(1), alpha=0.25, linewidth=0.0)
        ax.plot(f, taken / size, label="radius r of the discs", **style.curve(1))
        for band in _measured(each):
            ax.axvspan(*band, ymax=0.02, color=style.color(2), alpha=0.8, linewidth=0.0)
        ax.set_yscale("log")
        near = distance / size
        floor = 0.5 * min(float(np.min(near)), float(np.min(taken / size)) or 1.0)
        ax.set_ylim(max(floor, 1e-3 * float(np.min(near))), 30.0 * max(1.0, float(np.min(near))))
        style.plain_decades(ax.yaxis, crowded=len(plants) > 1)
        if each["reserve"] is not None:
            place = np.array([each["reserve_at_Hz"]])
            there = float((loop.room(place)[0] / loop.size(place))[0])
            ax.plot(place, [there], style.MARKERS[0], color=style.color(0), markersize=5)
            said = f"discs could be {each['reserve']:.3g} times as wide, at {each['reserve_at_Hz']:.4g} Hz"
        else:
            said = "no disc"
        style.note(ax, style.caption(each["name"] if len(plants) > 1 else "", said) or "")
        style.labels(ax, None, "relative size")
    style.labels(axes[-1], "frequency (Hz)", "relative size")
    style.frequency_axis(axes[-1], low, nyquist)
    style.frequency_grid(axes)
    style.legend(figure, axes[0])
    return figure


def _measured(plant: Any) -> list[tuple[float, float]]:
    """The bands in which a plant was measured."""
    return [(lines[0][0], lines[-1][0]) for lines in plant["lines"] if lines]


def certificate_discs(found: Certificate) -> Any:
    """L of the plant with the smallest reserve near -1, with the disc in which it may lie at each frequency."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    plant = min(found.document["plants"], key=lambda each: each["reserve"] or np.inf)
    loop: LoopResponse = found.loops[plant["name"]]
    f = loop.lines()
    L = loop.gains(f).sum(axis=0)
    taken = loop.room(f)[1]
    figure, (ax,) = style.picture(1, height=5.2)
    figure.set_size_inches(5.8, 5.2)
    ax.set_aspect("equal")
    reach = (-2.4, 1.2, -1.9, 1.7)
    ax.set_xlim(*reach[:2])
    ax.set_ylim(*reach[2:])
    ax.axhline(0.0, color=style.MUTED, linewidth=0.8)
    ax.axvline(0.0, color=style.MUTED, linewidth=0.8)
    near = (np.abs(L.real + 0.6) < 2.5 + taken) & (np.abs(L.imag) < 2.5 + taken) & (taken < 4.0)
    walked = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(L[near])))])
    keep = np.unique(np.searchsorted(walked, np.linspace(0.0, walked[-1], _DISCS)).clip(0, walked.size - 1))
    circles = [Circle((x.real, x.imag), r) for x, r in zip(L[near][keep], taken[near][keep], strict=True)]
    # one light color without transparency: where discs overlap nothing is more likely
    ax.add_collection(PatchCollection(circles, facecolor=_SHADE, edgecolor="none", zorder=0.5))
    ax.plot(np.clip(L.real, -20, 20), np.clip(L.imag, -20, 20), label="L of the model", **style.curve(0))
    ax.plot([], [], color=_SHADE, linewidth=6, label="where L may lie")
    ax.plot([-1.0], [0.0], "+", color=style.ALERT, markersize=11, markeredgewidth=1.8)
    style.labels(ax, "real part of L", "imaginary part of L")
    style.note(ax, style.caption(plant["name"]) or "")
    style.legend(figure, ax)
    return figure
