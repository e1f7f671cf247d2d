"""A measured log and its prediction over each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.analysis.replay import Replay
from feeddrive.identification.motion.output_error import Refinement
from feeddrive.language.table import picture_of
from feeddrive.plot import style
from feeddrive.plot.envelope import POINTS, envelope

# shown unit, factor from SI, words
_SHOWN = {
    "position_load": ("mm", 1e3, "position"),
    "following_error": ("µm", 1e6, "following error"),
    "force": ("N", 1.0, "force"),
}


@picture_of.register(Replay)
def replay(replay: Replay, points: int = POINTS) -> Any:
    """Measured over predicted for position, following error and force, each with its residual below."""
    signals = [name for name in _SHOWN if name in replay.measured and name in replay.run.signals]
    residuals = [name for name in signals if name != "following_error"]
    rows = [(name, False) for name in signals] + [(name, True) for name in residuals]
    rows.sort(key=lambda row: (signals.index("following_error" if row == ("position_load", True) else row[0]), row[1]))
    figure, axes = style.picture(len(rows), height=0.8 + 1.45 * len(rows))
    time = replay.run.time
    for ax, (name, is_residual) in zip(axes, rows, strict=True):
        unit, factor, words = _SHOWN[name]
        if is_residual:
            unit, factor = ("µm", 1e6) if unit == "mm" else (unit, factor)
            off = factor * replay.residual(name)
            ax.plot(
                *envelope(time[replay.skipped :], off, points), **style.curve(1) | {"linestyle": "-", "linewidth": 0.9}
            )
            style.labels(ax, None, f"{words}\nresidual ({unit})")
            style.note(ax, f"predicted - measured: RMS {_rms(off):.4g} {unit}, peak {np.max(np.abs(off)):.4g} {unit}")
            continue
        ax.plot(*envelope(time, factor * replay.measured[name], points), color=style.MUTED, linewidth=2.6, alpha=0.55,
                label="measured")  # fmt: skip
        ax.plot(*envelope(time, factor * replay.run[name], points), color=style.color(0), linewidth=1.0,
                label="predicted")  # fmt: skip
        style.labels(ax, None, f"{words}\n({unit})")
        if name != "position_load":
            style.note(ax, f"measured RMS {_rms(factor * replay.measured[name][replay.skipped :]):.4g} {unit}")
    axes[-1].set_xlabel("time (s)", fontsize=style.TEXT)
    figure.align_ylabels(axes)
    style.legend(figure, axes[0])
    return figure


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values)))


@picture_of.register
def _refinement(found: Refinement) -> Any:
    return replay(found.replay)
