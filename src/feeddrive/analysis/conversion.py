"""Conversion to an FRF from numpy arrays and python-control objects. The inverse is `FRF.to_control`."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace


def as_frf(
    source: Any,
    frequency: Sequence[float] | np.ndarray | None = None,
    *,
    sample_time: float | None = None,
    unit: str = "",
) -> FRF:
    """Return an FRF from an FRF, a feeddrive model, numpy arrays, or an object of python-control.

    source     FRF                        returned unchanged
               feeddrive StateSpace       its first input to its first output at `frequency`
               complex array (n,)         at `frequency`
               array (n, 3)               columns: Hz, real, imaginary part
               (frequency, response)      two arrays
               python-control FRD         at its own frequencies, converted from rad/s to Hz
               python-control tf, ss      at `frequency`: on the imaginary axis, or at z = e^(j2πfT) if its dt is a
                                          sample time
    frequency  Hz, shape (n,); needed if the source has no frequencies

    Raises ParameterError for a source of another type, for several inputs or outputs, for lines beyond Nyquist, and if
    frequencies are missing.
    """
    if isinstance(source, FRF):
        return source
    lines = None if frequency is None else np.asarray(frequency, float)
    if isinstance(source, StateSpace):
        return source.response(_required(lines, "a linear model"))
    # by name: python-control is an extra that need not be installed
    if type(source).__module__.partition(".")[0] == "control":
        return _from_control(source, lines, unit)
    if isinstance(source, tuple) and len(source) == 2:
        lines, source = np.asarray(source[0], float), source[1]
    values = np.asarray(source)
    if values.ndim == 2 and values.shape[1] == 3 and not np.iscomplexobj(values):
        lines, values = values[:, 0].astype(float), values[:, 1] + 1j * values[:, 2]
    if values.ndim != 1 or values.dtype.kind not in "fiuc":
        raise ParameterError(
            f"a frequency response is an FRF, an array of complex numbers with `frequency`, an array (n, 3) of Hz, "
            f"real and imaginary part, or an object of python-control, not {type(source).__name__} of shape "
            f"{values.shape}"
        )
    return FRF(_required(lines, "an array"), values.astype(complex), unit=unit, sample_time=sample_time)


def _required(lines: np.ndarray | None, what: str) -> np.ndarray:
    if lines is None:
        raise ParameterError(f"{what} has no frequencies: give `frequency` in Hz")
    return lines


def _from_control(source: Any, lines: np.ndarray | None, unit: str) -> FRF:
    if (source.ninputs, source.noutputs) != (1, 1):
        raise ParameterError(
            f"the object of python-control has {source.ninputs} inputs and {source.noutputs} outputs: pick one of "
            f"each, as G[0, 0]"
        )
    step = source.dt
    sampled = None if step in (None, 0) else (1.0 if step is True else float(step))
    if step is True:
        raise ParameterError("the object of python-control is sampled but has no sample time (dt = True): give it a dt")
    if hasattr(source, "omega"):
        omega = np.asarray(source.omega, float)
        # older versions of python-control name it fresp
        values = np.asarray(source.frdata if hasattr(source, "frdata") else source.fresp).reshape(-1)
        order = np.argsort(omega)
        order = order[omega[order] != 0.0]  # a line at zero has no place on a logarithmic axis
        frf = _named(FRF(omega[order] / (2.0 * np.pi), values[order], unit=unit, sample_time=sampled), source)
        if lines is not None and (lines.shape != frf.frequency.shape or not np.allclose(lines, frf.frequency)):
            raise ParameterError("an FRD already has frequencies: leave `frequency` out")
        return frf
    lines = _required(lines, "a transfer function")
    if sampled is not None and lines.size and lines.max() > 0.5 / sampled * (1.0 + 1e-9):
        raise ParameterError(
            f"frequency {Quantity(lines.max(), 'Hz'):6} is beyond Nyquist, {Quantity(0.5 / sampled, 'Hz'):6}: an "
            f"object of python-control with dt = {Quantity(sampled, 's'):6 SI} has no response there"
        )
    s = 2j * np.pi * lines
    point = s if sampled is None else np.exp(s * sampled)
    values = np.asarray(source(point, warn_infinite=False)).reshape(-1)
    return _named(FRF(lines, values, unit=unit, sample_time=sampled), source)


def _named(frf: FRF, source: Any) -> FRF:
    """Return the FRF with the labels of a python-control object; its default labels are ignored."""
    names = [str(label[0]) for label in (source.input_labels, source.output_labels)]
    return frf if names == ["u[0]", "y[0]"] else replace(frf, input=names[0], output=names[1])
