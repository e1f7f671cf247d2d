"""Pictures over time: runs, logs, and a prediction over its measurement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.analysis.friction_map import Window, set_velocity
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, USUAL, Quantity, signal_unit, unit_name
from feeddrive.language.text import Text, joined
from feeddrive.loop.simulate import Run
from feeddrive.plot import style
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from feeddrive.analysis.replay import Replay
    from feeddrive.cosimulation.simulate_with_fmu import Cosimulation
    from feeddrive.files.guess import Guess
    from feeddrive.files.log import Log
    from feeddrive.identification.motion.output_error import Refinement

_LIMITS = ((0, (5, 2)), (0, (1.5, 1.5)), (0, (5, 1.5, 1, 1.5)))  # dashes of the force limits

Runs = Run | Mapping[str, Run] | Sequence[Run]


def run(run: Run) -> Any:
    """Following error, force and velocity of one run."""
    figure, axes = style.picture(3, height=5.4)
    _draw(axes[0], run.time, 1e6 * run["following_error"], style.curve(0))
    style.labels(axes[0], None, f"following error\n({unit_name('m')})")
    _draw(axes[1], run.time, run["force"], style.curve(1) | {"linestyle": "-"})
    style.labels(axes[1], None, f"force\n({unit_name('N')})")
    if "velocity_load" in run.signals:  # optional in an FMU
        _draw(axes[2], run.time, 1e3 * run["velocity_load"], style.curve(2) | {"linestyle": "-"}, "actual")
    _draw(axes[2], run.time, 1e3 * set_velocity(run), _set_line(), "set")
    style.labels(axes[2], "time (s)", f"velocity\n({unit_name('m/s')})")
    style.row_legend(axes[2])
    style.note(axes[0], Text(f"RMS {Quantity(_rms(run['following_error']), 'm')}"))
    return figure


def following_error(runs: Runs, window: Window | None = None, points: int = POINTS) -> Any:
    """Following error of each run in its own row, whole or in a window of time."""
    chosen = style.named(runs)
    values = {name: run["following_error"] for name, run in chosen.items()}
    notes = {name: _sizes(v, "m") for name, v in values.items()}
    if window is not None:
        inside = {name: _inside(run, window) for name, run in chosen.items()}
        notes = {name: Text(f"peak here {Quantity(_peak(values[name][inside[name]]), 'm')}") for name in chosen}
    values = {name: 1e6 * error for name, error in values.items()}
    figure, axes = _rows(chosen, values, notes, f"following error ({unit_name('m')})", window, points)
    if window is not None and window.reversal is not None:
        lines = [ax.axvline(window.reversal, color=style.INK, linewidth=1.0, linestyle=(0, (4, 3))) for ax in axes]
        style.figure_legend(figure, {"the setpoint starts off in the other direction": lines[0]})
    return figure


def force(runs: Runs, limits: Mapping[str, float] | None = None, points: int = POINTS) -> Any:
    """Force of each run in its own row, with the limits in N by name as lines on both sides."""
    chosen = style.named(runs)
    values = {name: run["force"] for name, run in chosen.items()}
    notes = {name: _sizes(v, "N") for name, v in values.items()}
    figure, axes = _rows(chosen, values, notes, f"force ({unit_name('N')})", None, points, one_scale=True)
    largest = max(_peak(v) for v in values.values())
    outside: list[Text] = []
    lines: dict[str, Any] = {}
    for i, (name, limit) in enumerate((limits or {}).items()):
        if limit > 4.0 * largest:
            outside.append(Text(f"{name} ±{Quantity(limit, 'N')}"))
            continue
        look: dict[str, Any] = {"color": style.ALERT, "linewidth": 1.0, "linestyle": _LIMITS[i % len(_LIMITS)]}
        for ax in axes:
            drawn = [ax.axhline(side, **look) for side in (-limit, limit)]
            low, high = ax.get_ylim()
            ax.set_ylim(min(low, -1.12 * limit), max(high, 1.12 * limit))
            lines[Text(f"{name} ±{Quantity(limit, 'N')}")] = drawn[0]
    style.figure_legend(figure, lines)
    if outside:
        style.note(axes[-1], "outside of the picture: " + joined(", ", outside), x=0.005, align="left", y=0.0)
    return figure


def comparison(chosen: Mapping[str, Run]) -> Any:
    """Following error of each run in its own row, and the forces of all in the last."""
    rows = len(chosen) + 1
    figure, axes = style.picture(rows, height=0.9 + 1.45 * rows)
    errors = [1e6 * run["following_error"] for run in chosen.values()]
    for i, (name, run) in enumerate(chosen.items()):
        line = style.curve(i) | {"linestyle": "-"}
        _draw(axes[i], run.time, errors[i], line, name)
        style.row_legend(axes[i])
        style.note(axes[i], _sizes(run["following_error"], "m"))
        style.labels(axes[i], None, f"error ({unit_name('m')})")
        _draw(axes[-1], run.time, run["force"], line)
    if alike(errors):
        low, high = min(float(np.min(e)) for e in errors), max(float(np.max(e)) for e in errors)
        for ax in axes[:-1]:
            ax.set_ylim(*style.padded(low, high))
    style.labels(axes[-1], "time (s)", f"force ({unit_name('N')})")
    figure.align_ylabels(axes)
    return figure


def motion(runs: Runs, points: int = POINTS) -> Any:
    """Velocity and acceleration of the table, actual and set."""
    chosen = style.named(runs)
    figure, axes = style.picture(2, height=4.2)
    first = next(iter(chosen.values()))
    lows: list[float] = []
    highs: list[float] = []
    for i, (name, run) in enumerate(chosen.items()):
        velocity = run["velocity_load"]
        _draw(axes[0], run.time, 1e3 * velocity, style.curve(i), name or "actual", points)
        acceleration = np.gradient(velocity, run.sample_time)
        _draw(axes[1], run.time, acceleration, style.curve(i), points=points)
        lows.append(float(np.min(acceleration)))
        highs.append(float(np.max(acceleration)))
    wanted = set_velocity(first)
    _draw(axes[0], first.time, 1e3 * wanted, _set_line(), "set", points)
    _draw(axes[1], first.time, np.gradient(wanted, first.sample_time), _set_line(), points=points)
    # a log that starts in motion has a jump in its first set velocity, which is no acceleration of the axis
    axes[1].set_ylim(*style.padded(min(lows), max(highs)))
    style.labels(axes[0], None, f"velocity ({unit_name('m/s')})")
    style.labels(axes[1], "time (s)", f"acceleration ({unit_name('m/s²')})")
    style.legend(figure, axes[0])
    return figure


def _rows(
    chosen: Mapping[str, Run],
    values: Mapping[str, np.ndarray],
    notes: Mapping[str, str],
    quantity: str,
    window: Window | None,
    points: int,
    one_scale: bool = False,
) -> tuple[Any, list[Axes]]:
    """One row a run, over the same time; with one scale for all if their peaks are alike."""
    rows = len(chosen)
    figure, axes = style.picture(rows, height=2.7 if rows == 1 else 0.7 + 1.45 * rows)
    shown: dict[str, np.ndarray] = {}
    for i, (ax, (name, run)) in enumerate(zip(axes, chosen.items(), strict=True)):
        inside = slice(None) if window is None else _inside(run, window)
        shown[name] = values[name][inside]
        _draw(ax, run.time[inside], shown[name], style.curve(i) | {"linestyle": "-"}, name, points)
        style.row_legend(ax)
        style.note(ax, notes[name])
    if one_scale or alike(shown.values()):
        low, high = min(np.min(v) for v in shown.values()), max(np.max(v) for v in shown.values())
        for ax in axes:
            ax.set_ylim(*style.padded(float(low), float(high)))
    style.labels(axes[-1], "time (s)", quantity if rows == 1 else "")
    if rows > 1:
        figure.supylabel(style.read(quantity), fontsize=style.TEXT, color=style.INK)
    return figure, axes


def alike(curves: Iterable[np.ndarray]) -> bool:
    """Whether the peaks of curves are so near each other that one scale shows them all."""
    peaks = [_peak(curve) for curve in curves]
    return max(peaks) <= style.WIDE * min(peaks)


def _draw(
    ax: Axes, x: np.ndarray, y: np.ndarray, line: Mapping[str, Any], name: str = "", points: int = POINTS
) -> None:
    ax.plot(*envelope(x, y, points), label=style.caption(name), **line)


def _set_line() -> dict[str, Any]:
    return {"color": style.INK, "linestyle": (0, (1, 1.5)), "linewidth": 1.0}


def _inside(run: Run, window: Window) -> np.ndarray:
    return (run.time >= window.begin) & (run.time <= window.end)


def _sizes(values: np.ndarray, unit: str) -> Text:
    """Return RMS and peak of values in SI, in words."""
    return Text(f"RMS {Quantity(_rms(values), unit)}, peak {Quantity(_peak(values), unit)}")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values))) if values.size else 0.0


def _peak(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def cosimulation(found: Cosimulation) -> Any:
    """Following error of each law."""
    return following_error({row.name: row.run for row in found.rows})


MOST = 12  # rows; a log with more channels shows the first ones


def log(log: Log) -> Any:
    """The channels of a log over time, each in the usual unit."""
    chosen = dict(list(log.channels.items())[:MOST])
    figure, axes = style.picture(len(chosen), height=1.0 + 1.3 * len(chosen))
    for i, (name, values) in enumerate(chosen.items()):
        si = log.units.get(name, "")
        unit, factor = USUAL.of(si, signal_unit(si))
        axes[i].plot(*envelope(log.time, factor * values, POINTS), **style.curve(0))
        head = name.replace("_", " ")
        last = i == len(chosen) - 1
        style.labels(
            axes[i], "time (s)" if last else None, f"{head}\n({unit_name(style.written(unit))})" if unit else head
        )
    return figure


def guess(found: Guess) -> Any:
    """Raise ParameterError: a guess has no picture."""
    raise ParameterError(f"{found.name}: a guess of roles has no picture; plot the log itself")


# SI unit, shown unit of the signal, words
_SHOWN = {
    "position_load": ("m", "mm", "position"),
    "following_error": ("m", "", "following error"),
    "force": ("N", "", "force"),
}


def replay(replay: Replay, points: int = POINTS) -> Any:
    """Measured over predicted for position, following error and force, each with its residual below."""
    signals = [name for name in _SHOWN if name in replay.measured and name in replay.run.signals]
    residuals = [name for name in signals if name != "following_error"]
    rows = [(name, False) for name in signals] + [(name, True) for name in residuals]
    rows.sort(key=lambda row: (signals.index("following_error" if row == ("position_load", True) else row[0]), row[1]))
    figure, axes = style.picture(len(rows), height=0.8 + 1.45 * len(rows))
    time = replay.run.time
    for ax, (name, is_residual) in zip(axes, rows, strict=True):
        unit, in_unit, words = _SHOWN[name]
        if is_residual:
            off, factor = replay.residual(name), DRAWN.of(unit)[1]
            ax.plot(
                *envelope(time[replay.skipped :], factor * off, points),
                **style.curve(1) | {"linestyle": "-", "linewidth": 0.9},
            )
            style.labels(ax, None, f"{words}\nresidual ({unit_name(unit)})")
            style.note(ax, Text(f"predicted - measured: {_sizes(off, unit)}"))
            continue
        factor = DRAWN.of(unit, in_unit)[1]
        ax.plot(*envelope(time, factor * replay.measured[name], points), color=style.MUTED, linewidth=2.6, alpha=0.55,
                label="measured")  # fmt: skip
        ax.plot(*envelope(time, factor * replay.run[name], points), color=style.color(0), linewidth=1.0,
                label="predicted")  # fmt: skip
        style.labels(ax, None, f"{words}\n({unit_name(unit, in_unit)})")
        if name != "position_load":
            size = Quantity(_rms(replay.measured[name][replay.skipped :]), unit)
            style.note(ax, Text(f"measured RMS {size}"))
    axes[-1].set_xlabel("time (s)", fontsize=style.TEXT)
    figure.align_ylabels(axes)
    style.legend(figure, axes[0])
    return figure


def refinement(found: Refinement) -> Any:
    """Predicted and measured columns."""
    return replay(found.replay)
