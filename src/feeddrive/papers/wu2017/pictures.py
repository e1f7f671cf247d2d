"""Plots as in the paper: errors and parameters over the trials, contour, convergence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.learning.trials import Trials
from feeddrive.plot import style
from feeddrive.plot.curves import Row, curves
from feeddrive.plot.tuning import errors_and_parameters
from feeddrive.report.report import Picture

RADIUS = 0.02  # m
ZOOM = 400.0  # contour errors in polar pictures are drawn so many times larger


def errors(same: Mapping[str, Trials]) -> Picture:
    """RMS over the trials."""

    def draw() -> Any:
        figure, (ax,) = style.picture(1, height=3.2)
        for i, (name, trials) in enumerate(same.items()):
            numbers = np.arange(1, len(trials.trials) + 1)
            ax.plot(numbers, 1e6 * trials.rms, marker=style.MARKERS[i], markersize=5, label=name, **style.curve(i))
        ax.set_yscale("log")
        style.plain_decades(ax.yaxis)
        ax.set_xticks(range(1, 7))
        style.labels(ax, "trial", "following error RMS (µm)")
        style.legend(figure, ax)
        return figure

    last = joined(", ", (f"{name} {Quantity(trials.rms[-1], 'm'):.2f}" for name, trials in same.items()))
    caption = "The same 100 mm move six times; each trial uses the parameters of the last one. tanh friction."
    return Picture(
        "errors", "Error over the trials", caption, Text(f"RMS falls within two trials; last: {last}."), draw
    )


def parameters(trials: Trials) -> Picture:
    """Parameters with their standard errors."""
    caption = "Bars are two standard errors, estimated from the residual of each single trial, with its color."
    alt = "The mass is found at once, the friction levels within five trials."
    return Picture(
        "parameters", "Parameters over the trials", caption, alt, lambda: errors_and_parameters({"": trials})
    )


def over_time(same: Mapping[str, Trials]) -> Picture:
    """First and last following error over time."""

    def draw() -> Any:
        first = next(iter(same.values())).trials[0]
        time = first.time
        rows = [Row("first trial (µm)", {"start": 1e6 * first.following_error})]
        rows.append(Row("last trial (µm)", {name: 1e6 * t.trials[-1].following_error for name, t in same.items()}))
        return curves("time (s)", time, rows)

    caption = "Following error of the first trial, and of the sixth with each set of columns."
    alt = "With a and b alone a bump is left after each reversal; Coulomb and Stribeck columns remove it."
    return Picture("overtime", "Following error before and after", caption, alt, draw)


def rates(masses: np.ndarray, found: Mapping[str, list[float]], free: float) -> Picture:
    """The rate of convergence over the assumed mass."""

    def draw() -> Any:
        figure, (ax,) = style.picture(1, height=3.2)
        for i, (name, values) in enumerate(found.items()):
            row = np.maximum(np.array(values), 1e-3)
            ax.plot(masses, row, marker=style.MARKERS[i], markersize=5, label=f"model-based, {name}", **style.curve(i))
        ax.axhline(free, color=style.INK, linewidth=1.0, linestyle=(0, (4, 3)), label="model-free")
        ax.set_xscale("log")
        ax.set_yscale("log")
        style.plain_decades(ax.xaxis)
        style.plain_decades(ax.yaxis)
        style.labels(ax, "assumed mass / mass of the axis", "rate ρ")
        style.legend(figure, ax)
        return figure

    caption = "ρ: factor of the parameters' error from trial to trial. The right mass gives 0, drawn at 1e-3."
    alt = "A mass wrong by a factor of two leaves 5 %; where the curves end the model loop is unstable and refused."
    return Picture("convergence", "Rate of convergence", caption, alt, draw)


def contour(paths: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Picture:
    """Polar picture of the contour error; x and y in m about the center."""

    def draw() -> Any:
        figure, _ = style.picture(1, height=3.4 * -(-len(paths) // 2))
        figure.clear()
        grid = np.ravel(figure.subplots(-(-len(paths) // 2), 2, squeeze=False))
        circle = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 400))
        for i, (ax, (name, (x, y))) in enumerate(zip(grid, paths.items(), strict=False)):
            style.dressed(ax)
            angle, off = np.arctan2(y, x), np.hypot(x, y) - RADIUS
            shown = (RADIUS + ZOOM * off) * np.exp(1j * angle)
            ax.plot(1e3 * RADIUS * np.real(circle), 1e3 * RADIUS * np.imag(circle), color=style.MUTED, linewidth=0.7)
            ax.plot(1e3 * np.real(shown), 1e3 * np.imag(shown), color=style.color(i), linewidth=0.9)
            ax.set_aspect("equal")
            ax.set_title(
                style.read(f"{name}: RMS {Quantity(np.sqrt(np.mean(off**2)), 'm'):.2f}"),
                fontsize=style.SMALL,
                color=style.INK,
            )
            style.labels(ax, "x (mm)", "y (mm)")
        for ax in grid[len(paths) :]:
            ax.set_visible(False)
        return figure

    caption = f"Circle of 20 mm radius at 0.1 m/s, two turns; the contour error is drawn {number(ZOOM)} times larger."
    alt = "Quadrant glitches stay with a and b alone and nearly vanish with the compensator."
    return Picture("contour", "Contour of the circle", caption, alt, draw)


def quadrant(time: np.ndarray, errors: Mapping[str, np.ndarray]) -> Picture:
    """Contour error in a window around a reversal."""
    caption = "One quadrant of the second turn, where the x axis reverses."
    alt = "The peak after the reversal falls with the compensator."
    rows = [Row("contour error (µm)", {name: 1e6 * values for name, values in errors.items()})]
    return Picture("quadrant", "Quadrant glitch, zoomed", caption, alt, lambda: curves("time (s)", time, rows))


def against_signal(curves_by_name: Mapping[str, np.ndarray], title: str, key: str) -> Picture:
    """RMS over the trials of parameters and of a learned signal."""

    def draw() -> Any:
        figure, (ax,) = style.picture(1, height=3.2)
        for i, (name, rms) in enumerate(curves_by_name.items()):
            numbers = np.arange(1, rms.size + 1)
            ax.plot(numbers, 1e6 * rms, marker=style.MARKERS[i], markersize=5, label=name, **style.curve(i))
        ax.set_yscale("log")
        style.plain_decades(ax.yaxis)
        ax.set_xticks(range(1, 1 + max(rms.size for rms in curves_by_name.values())))
        style.labels(ax, "trial", "following error RMS (µm)")
        style.legend(figure, ax, columns=2)
        return figure

    caption = "Parameters that fit any motion, against a force learned sample by sample."
    alt = "The learned force is better while the task repeats, and increases the error when the reference changes."
    return Picture(key, title, caption, alt, draw)
