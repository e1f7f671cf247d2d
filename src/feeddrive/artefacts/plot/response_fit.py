"""Picture of a model over the frequency responses that it was fitted to."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.artefacts.plot import style
from feeddrive.engineer.identification.agreement import Agreement


def response_fit(found: Agreement) -> Any:
    """Measured responses as dots with the model as a line: magnitude, phase, and the distance of both in dB."""
    figure, axes = style.picture(3, height=5.8, ratios=[3, 2, 1.2])
    every = list(zip(found.measured, found.fitted, strict=True))
    lows, highs = [], []
    for i, (measured, fitted) in enumerate(every):
        f = measured.frequency
        dots = style.curve(i) | {"linestyle": "none", "marker": ".", "markersize": 3.0, "alpha": 0.6}
        name = measured.output if len(every) > 1 else ""
        axes[0].plot(f, style.decibel(measured.magnitude), label=style.caption(name, "measured"), **dots)
        axes[0].plot(f, style.decibel(fitted.magnitude), label=style.caption(name, "fitted"), **style.curve(i))
        phase = fitted.phase_deg
        apart = np.degrees(np.angle(measured.response / fitted.response))
        axes[1].plot(f, phase + apart, **dots)
        axes[1].plot(f, phase, **style.curve(i))
        axes[2].plot(f, style.decibel(np.abs(fitted.response / measured.response - 1.0)), **dots)
        lows.append(float(np.min(phase)))
        highs.append(float(np.max(phase)))
    unit = every[0][0].unit
    style.labels(axes[0], None, f"magnitude (dB re 1 {unit})" if unit else "magnitude (dB)")
    style.labels(axes[1], None, "phase (deg)")
    style.labels(axes[2], "frequency (Hz)", "error (dB)")
    style.degrees_axis(axes[1], min(lows), max(highs))
    lines = [m.frequency for m, _ in every]
    style.frequency_axis(axes[2], float(min(f[0] for f in lines)), float(max(f[-1] for f in lines)))
    style.frequency_grid(axes)
    style.legend(figure, axes[0], 2)
    return figure
