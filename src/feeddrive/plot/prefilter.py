"""The fit of a trajectory prefilter over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.language.table import picture_of
from feeddrive.plot import style
from feeddrive.plot.envelope import POINTS, envelope
from feeddrive.tuning.trajectory_prefilter import PrefilterFit


@picture_of.register(PrefilterFit)
def prefilter_fit(fit: PrefilterFit, points: int = POINTS) -> Any:
    """Above: the error and what the derivatives explain of it. Below: what is predicted to remain."""
    figure, axes = style.picture(2, height=4.2)
    measured = {"color": style.MUTED, "linewidth": 2.6, "alpha": 0.55}
    axes[0].plot(*envelope(fit.time, 1e6 * fit.error, points), **measured, label="error")
    axes[0].plot(*envelope(fit.time, 1e6 * fit.explained, points), **style.curve(0), label="explained")
    axes[1].plot(*envelope(fit.time, 1e6 * fit.predicted, points), **style.curve(1) | {"linestyle": "-"})
    size = 1.1e6 * float(np.max(np.abs(fit.error), initial=1e-12))
    for ax in axes:
        ax.set_ylim(-size, size)
    style.labels(axes[0], None, "tracking error\n(µm)")
    style.labels(axes[1], "time (s)", "predicted with\nthe prefilter (µm)")
    style.note(axes[1], f"RMS {1e6 * fit.rms(fit.error):.4g} µm -> {1e6 * fit.rms(fit.predicted):.4g} µm")
    style.legend(figure, axes[0])
    return figure
