"""Logs that are no motion of a drive: each ends with a reason, none with a traceback."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.identification.motion.identify import identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.rigid import find_delay, identify_rigid
from feeddrive.language.errors import FeeddriveError, NotIdentifiableError

ROWS = 10000


def unusable(name: str, T: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Position in m and force in N of a log by name."""
    random, t = np.random.default_rng(0), np.arange(ROWS) * T
    noise = random.standard_normal(ROWS)
    match name.split():
        case ["sine", frequency]:
            w = 2.0 * np.pi * float(frequency)
            force = -95.0 * 1e-3 * w * w * np.sin(w * t) + 20.0 * np.sign(np.cos(w * t)) + noise
            return 1e-3 * np.sin(w * t), force
        case ["rest"]:
            return 5e-8 * np.round(0.4 * random.standard_normal(ROWS)), noise
        case ["one", "count"]:
            return np.where(np.arange(ROWS) == ROWS // 2, 5e-8, 0.0), noise
        case ["noise"]:
            return random.standard_normal(ROWS), noise
        case ["frequencies"]:  # a frequency response without its header: lines in Hz and a magnitude
            return np.geomspace(1.0, 1000.0, ROWS), np.exp(-np.arange(ROWS) / 1000.0) * noise
        case ["jump"]:
            return np.where(t > 0.5 * t[-1], 1.0, 0.0), noise
        case ["one", "force"]:
            return 1e-2 * np.sin(2.0 * np.pi * t), np.where(np.arange(ROWS) == 0, 1e-9, 0.0)
        case _:
            return 1e300 * np.sin(2.0 * np.pi * t), 1e300 * np.cos(2.0 * np.pi * t)


NAMES = ("sine 20", "sine 35", "sine 100", "rest", "one count", "noise", "frequencies", "jump", "one force", "huge")


@pytest.mark.parametrize("T", [1e-3, 5e-5], ids=["1 kHz", "20 kHz"])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_motion_is_refused_with_a_reason(name: str, T: float) -> None:
    for work in (identify_motion, identify_rigid, find_delay):
        position, force = unusable(name, T)
        if work is find_delay and name == "frequencies":
            continue  # a motion in one direction tells a delay, and no mass
        with pytest.raises(FeeddriveError):
            work(MotionLog(name=name, position=position, force=force, sample_time=T))


def test_the_reason_is_the_right_one() -> None:
    def refused(name: str) -> str:
        position, force = unusable(name)
        with pytest.raises(NotIdentifiableError) as caught:
            find_delay(MotionLog(name=name, position=position, force=force, sample_time=1e-3))
        return str(caught.value)

    assert "one frequency" in refused("sine 20")
    assert "rows are left where the axis moves" in refused("sine 35")
    assert "rows are left where the axis moves" in refused("rest")


def test_a_log_at_20_khz_is_decimated_by_a_filter_that_is_stable() -> None:
    """Eighth order, edge at 0.4 % of Nyquist: as one polynomial its rounding explodes; a slow sine passes unchanged."""
    from feeddrive.identification.motion.motion_log import decimated

    t = np.arange(100000) * 5e-5
    wave = np.sin(2.0 * np.pi * 2.0 * t)
    # ripple of 0.05 dB forth and back: 1.2 % at most
    kept = slice(20, -20)
    np.testing.assert_allclose(decimated(wave, 200)[kept], wave[199::200][kept], atol=0.012)
