"""What is done to a log before least squares: zero-phase low pass, central differences, decimation."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import butter, cheby1, sosfiltfilt

from feeddrive.language.errors import LogError, ParameterError


def zero_phase(values: np.ndarray, cutoff: float, sample_time: float, order: int = 4) -> np.ndarray:
    """A Butterworth low pass of `order`, forth and back, so that nothing is delayed; `cutoff` in Hz.

        gain of both passes = 1 / (1 + (f / cutoff)^(2 order)),   1/2 at the cutoff

    Both ends are continued by 3 `order` samples turned about the end point, as MATLAB's filtfilt does.
    Raises ParameterError for a cutoff that is not below half the sampling rate, LogError for a log that is too short.
    """
    nyquist = 0.5 / sample_time
    if not 0.0 < cutoff < nyquist:
        raise ParameterError(f"cutoff = {cutoff:g} Hz must be > 0 Hz and < {nyquist:g} Hz, half the sampling rate")
    return _forth_and_back(butter(order, cutoff / nyquist, output="sos"), order, values)


def central_difference(values: np.ndarray, sample_time: float) -> np.ndarray:
    """(x(k+1) - x(k-1)) / 2T, one-sided at both ends."""
    return np.gradient(values, sample_time)


def decimated(values: np.ndarray, factor: int) -> np.ndarray:
    """Every `factor`-th sample after a low pass that leaves no room for aliases; the last sample is kept.

    The low pass is that of MATLAB's decimate: Chebyshev of first kind, order 8, ripple 0.05 dB, edge 0.8 / factor of
    the half sampling rate, forth and back.
    """
    if factor < 1:
        raise ParameterError(f"decimation = {factor} must be >= 1")
    if factor == 1:
        return values
    smooth = _forth_and_back(cheby1(8, 0.05, 0.8 / factor, output="sos"), 8, values)
    return smooth[kept(values.size, factor)]


def kept(samples: int, factor: int) -> np.ndarray:
    """Indices of the samples that decimation keeps."""
    rows = -(-samples // factor)
    return np.arange(samples - factor * (rows - 1) - 1, samples, factor)


def _forth_and_back(sections: Any, order: int, values: np.ndarray) -> np.ndarray:
    """In sections of second order: as one polynomial the low pass of a log at 20 kHz is unstable by rounding."""
    ends = 3 * order
    if values.size <= ends:
        raise LogError(f"the log has {values.size} samples; its filter needs more than {ends}: record a longer one")
    return sosfiltfilt(sections, values, padlen=ends)
