"""Spectrum: Parseval, amplitudes of known sines, and what cannot be transformed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feeddrive.analysis.spectrum import spectrum
from feeddrive.language.errors import ParameterError


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=257),
    st.sampled_from(["hann", "none"]),
    st.floats(1e-5, 1.0),
)
def test_the_last_cumulative_value_is_the_rms_for_any_signal_and_window(values, window, T) -> None:
    x = np.array(values)
    found = spectrum(x, T, window=window)
    assert found.rms == pytest.approx(np.sqrt(np.mean(x**2)), rel=1e-12, abs=1e-12)
    assert np.all(np.diff(found.cumulative_rms) >= 0.0)
    assert found.frequency[0] == 0.0
    assert found.frequency.shape == found.amplitude.shape == found.cumulative_rms.shape


@pytest.mark.parametrize("window", ["hann", "none"])
def test_a_sine_on_a_line_shows_its_amplitude_and_a_mean_shows_at_zero(window: str) -> None:
    T, n = 1e-3, 4000
    t = T * np.arange(n)
    x = -3e-6 + 5e-6 * np.sin(2 * np.pi * 40.0 * t + 0.3) + 2e-6 * np.cos(2 * np.pi * 110.0 * t)
    found = spectrum(x, T, name="following_error", unit="m", window=window)
    at = {f: found.amplitude[np.searchsorted(found.frequency, f - 1e-9)] for f in (0.0, 40.0, 110.0)}
    assert at[0.0] == pytest.approx(3e-6, rel=1e-12)
    assert at[40.0] == pytest.approx(5e-6, rel=1e-12)
    assert at[110.0] == pytest.approx(2e-6, rel=1e-12)
    assert [f for f, _ in found.largest(2)] == pytest.approx([40.0, 110.0])
    # the mean and both sines gather as squares
    steps = found.cumulative_rms[np.searchsorted(found.frequency, [1.0, 60.0, 200.0])]
    assert steps == pytest.approx([3e-6, np.sqrt(9 + 12.5) * 1e-6, np.sqrt(9 + 12.5 + 2) * 1e-6], rel=1e-9)
    assert "um" in str(found)


def test_an_alternating_signal_has_its_amplitude_at_nyquist() -> None:
    x = 7.0 * (-1.0) ** np.arange(64)
    assert spectrum(x, 0.5, window="none").amplitude[-1] == pytest.approx(7.0)
    assert spectrum(x, 0.5).amplitude[-1] == pytest.approx(7.0)
    assert spectrum(x, 0.5).frequency[-1] == 1.0


@pytest.mark.parametrize(
    ("values", "window", "message"),
    [
        ([1.0], "hann", "at least two samples"),
        ([1.0, np.nan], "hann", "not finite"),
        ([1.0, 2.0], "hamming", "must be one of hann, none"),
    ],
)
def test_errors_say_what_is_wrong(values, window, message) -> None:
    with pytest.raises(ParameterError, match=message):
        spectrum(np.array(values), 1e-3, window=window)


def test_the_table_names_the_fundamental_and_five_harmonics() -> None:
    """Of a square wave of 1 Hz, whose harmonics are the odd ones."""
    time = np.arange(1000) * 1e-3
    wave = sum(np.sin(2.0 * np.pi * n * time) / n for n in range(1, 16, 2))
    rows = spectrum(np.asarray(wave), 1e-3, window="none").table().rows
    assert [round(float(str(row[0]))) for row in rows] == [1, 3, 5, 7, 9, 11]
