"""What is shown of signals that come piece by piece: windows around triggers, in bounded memory; what cursors read."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from feeddrive.analysis import oscilloscope
from feeddrive.analysis.oscilloscope import (
    AUTO,
    FALLING,
    NORMAL,
    SINGLE,
    Oscilloscope,
    Recording,
    Rows,
    Shown,
    Trigger,
    readout,
)
from feeddrive.language.errors import ParameterError

H = 1e-3


class Played:
    """A source that plays rows in pieces."""

    name, over = "played", False
    clock = "s"

    def __init__(self, *pieces: Rows, channels: tuple[str, ...] = ("x", "y")) -> None:
        self.channels: Mapping[str, str] = dict.fromkeys(channels, "m")
        self._pieces = iter(pieces)

    def take(self) -> Rows:
        return next(self._pieces, Rows(np.empty(0), np.empty((0, len(self.channels)))))

    def state(self) -> str:
        return ""

    def close(self) -> None:
        pass


def saw(start: float, end: float, period: float = 0.1) -> Rows:
    """x rises from 0 to 1 in each period; y is the time."""
    time = np.arange(round(start / H), round(end / H)) * H
    return Rows(time, np.column_stack([(time / period) % 1.0, time]))


def fed(scope: Oscilloscope, *pieces: Rows) -> Iterator[Shown | None]:
    source = Played(*pieces)
    for _ in pieces:
        scope.feed(source)
        yield scope.shown()


@pytest.mark.parametrize("size", [1, 7, 64, 5000])
@pytest.mark.parametrize("before", [0.0, 0.3, 0.95])
def test_a_window_holds_all_rows_around_its_trigger_whatever_the_pieces(size: int, before: float) -> None:
    """Of 0.3 s with triggers each 0.1 s at 0.05 + n 0.1: the last whole one, with every row from begin to end."""
    whole = saw(0.0, 2.0)
    scope = Oscilloscope(0.3, before, NORMAL, Trigger("x", 0.5))
    pieces = [Rows(whole.time[k : k + size], whole.values[k : k + size]) for k in range(0, whole.time.size, size)]
    *_, shown = fed(scope, *pieces)
    assert shown is not None
    assert shown.whole
    assert shown.triggered
    assert (shown.zero - 0.05) % 0.1 == pytest.approx(0.0, abs=1e-9) or (shown.zero - 0.05) % 0.1 == pytest.approx(0.1)
    low, high = shown.zero - 0.3 * before, shown.zero + 0.3 * (1.0 - before)
    assert high <= 2.0
    np.testing.assert_array_equal(shown.time, whole.time[(whole.time >= low) & (whole.time <= high)])
    np.testing.assert_array_equal(shown.values[:, 1], shown.time)
    assert (shown.start, shown.end) == pytest.approx((-0.3 * before, 0.3 * (1.0 - before)))
    # no instant counts while a window fills: from one to the next as many periods as it takes
    after = math.ceil(round(0.3 * (1.0 - before) / 0.1, 9)) or 1
    first = 0.05 + 0.1 * max(0, math.ceil(round((0.3 * before - 0.05) / 0.1, 9)))  # what is before it is there
    assert scope.count == math.floor((2.0 - 0.3 * (1.0 - before) - first) / (0.1 * after) + 1e-9) + 1


def test_single_keeps_the_first_and_is_armed_again() -> None:
    scope = Oscilloscope(0.05, 0.2, SINGLE, Trigger("x", 0.5))
    shown = [*fed(scope, saw(0.0, 1.0), saw(1.0, 2.0))]
    assert [each.zero for each in shown if each] == pytest.approx([0.05, 0.05])
    assert not scope.waits
    scope.arm()
    assert scope.waits
    (again,) = fed(scope, saw(2.0, 3.0))
    assert again is not None
    assert again.zero == pytest.approx(2.05)


def test_hold_leaves_out_what_comes_too_soon() -> None:
    scope = Oscilloscope(0.01, 0.2, NORMAL, Trigger("x", 0.5, hold=0.35))
    *_, shown = fed(scope, saw(0.0, 1.0))
    assert scope.count == 3  # at 0.05, 0.45, 0.85
    assert shown is not None
    assert shown.zero == pytest.approx(0.85)


def test_auto_lets_the_signal_run_by_without_a_trigger_and_normal_does_not() -> None:
    still = Rows(np.arange(1000, 4000) * H, np.zeros((3000, 2)))
    found = {}
    for mode in (AUTO, NORMAL):
        scope = Oscilloscope(0.2, 0.5, mode, Trigger("x", 0.5))
        first, then = fed(scope, saw(0.0, 1.0), still)
        assert first is not None
        assert first.triggered
        assert then is not None
        found[mode] = then
    assert not found[AUTO].triggered
    assert (found[AUTO].zero, found[AUTO].time[0]) == pytest.approx((3.999, 3.799))
    assert found[NORMAL].triggered
    quiet = Oscilloscope(0.2, 0.5, NORMAL, Trigger("x", 5.0))
    assert [*fed(quiet, saw(0.0, 1.0))] == [None]


def test_a_long_window_is_shown_while_it_fills() -> None:
    scope = Oscilloscope(4.0, 0.25, NORMAL, Trigger("y", 1.5))
    before, filling, whole = fed(scope, saw(0.0, 1.0), saw(1.0, 2.0), saw(2.0, 5.0))
    assert before is None
    assert filling is not None
    assert whole is not None
    assert (filling.whole, whole.whole) == (False, True)
    assert filling.time[-1] == pytest.approx(1.999)
    assert (filling.zero, filling.end) == pytest.approx((1.5, 3.0))


def test_a_clock_that_begins_again_is_another_record() -> None:
    """No window reaches over the jump, and none shows rows of the old clock."""
    scope = Oscilloscope(0.3, 0.5, NORMAL, Trigger("x", 0.5, FALLING))
    *_, shown = fed(scope, saw(10.0, 10.4), saw(0.0, 1.0))
    assert shown is not None
    assert shown.zero < 1.0
    assert np.all(shown.time < 1.0)
    assert float(scope.recording.time[0]) < 1.0


def test_what_is_written_anew_by_the_same_clock_is_a_gap() -> None:
    scope = Oscilloscope(1.0)
    later = saw(0.5, 0.8)
    *_, shown = fed(scope, saw(0.0, 0.4), Rows(later.time, later.values, anew=True))
    assert shown is not None
    assert np.count_nonzero(np.isnan(shown.values[:, 0])) == 1
    assert shown.time.size == 701


def test_the_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oscilloscope, "MOST_NUMBERS", 3000)
    scope = Oscilloscope(600.0)
    [*_] = fed(scope, *(saw(k, k + 1.0) for k in range(20)))
    assert len(scope.recording) == 1000
    assert float(scope.recording.time[-1]) == pytest.approx(19.999)
    short = Oscilloscope(0.1)
    [*_] = fed(short, *(saw(k, k + 1.0) for k in range(20)))
    assert len(short.recording) == pytest.approx(150, abs=1)  # one and a half windows


def test_other_channels_are_another_record() -> None:
    scope = Oscilloscope(1.0)
    scope.feed(Played(saw(0.0, 0.5)))
    scope.feed(Played(Rows(np.array([0.7]), np.array([[1.0]])), channels=("z",)))
    assert scope.channels == {"z": "m"}
    assert len(scope.recording) == 1
    scope.set(1.0, 0.2, AUTO, None)
    with pytest.raises(ParameterError, match="no channel 'x'"):
        scope.set(1.0, 0.2, AUTO, Trigger("x"))


def test_the_same_channels_in_another_order_are_another_record() -> None:
    """A file that is written anew with two of its columns exchanged: no name stands over the rows of the other."""
    scope = Oscilloscope(1.0)
    scope.feed(Played(saw(0.0, 0.5), channels=("x", "y")))
    later = saw(0.5, 0.9)
    scope.feed(Played(Rows(later.time, later.values[:, ::-1], anew=True), channels=("y", "x")))
    shown = scope.shown()
    assert shown is not None
    assert [*shown.channels] == [*scope.channels] == ["y", "x"]
    np.testing.assert_array_equal(shown.values[:, 0], shown.time)
    assert shown.time[0] == 0.5


def test_what_was_caught_keeps_its_own_channels_and_clock() -> None:
    scope = Oscilloscope(0.1, 0.2, NORMAL, Trigger("x", 0.5))
    scope.feed(Played(saw(0.0, 0.5), channels=("x", "y")))
    other = Played(saw(0.5, 0.9), channels=("z", "x"))
    other.clock = "samples"
    scope.feed(other)
    shown = scope.shown()
    assert shown is not None
    assert (scope.channels, scope.clock) == ({"z": "m", "x": "m"}, "samples")
    assert (dict(shown.channels), shown.clock) == ({"x": "m", "y": "m"}, "s")
    np.testing.assert_array_equal(shown.values[:, [*shown.channels].index("y")], shown.time)
    last = scope.last()
    assert last is not None
    assert (dict(last.channels), last.clock) == ({"z": "m", "x": "m"}, "samples")


@pytest.mark.parametrize("size", [100, 5000])
def test_a_window_that_is_longer_than_what_is_kept_is_not_whole(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """1000 rows of 1 ms are kept; the window that is advised instead is whole, whatever the pieces."""
    monkeypatch.setattr(oscilloscope, "MOST_NUMBERS", 3000)
    rows = saw(0.0, 5.0)
    pieces = [Rows(rows.time[k : k + size], rows.values[k : k + size]) for k in range(0, 5000, size)]
    scope = Oscilloscope(2.0, 0.0, SINGLE, Trigger("x", 0.5))
    *_, shown = fed(scope, *pieces)
    assert shown is not None
    assert shown.time[0] > shown.zero + 0.5
    assert not shown.whole
    assert scope.lack == (
        "a window of 2 s is longer than what is kept of 2 channels at this rate: make it 0.87 s or shorter, or record "
        "fewer channels"
    )
    fits = Oscilloscope(0.87, 0.0, SINGLE, Trigger("x", 0.5))
    *_, whole = fed(fits, *pieces)
    assert whole is not None
    assert (whole.whole, fits.lack) == (True, "")
    assert whole.time[-1] - whole.time[0] == pytest.approx(0.87, abs=1.5 * H)


def test_rows_that_are_kept_are_the_last_ones() -> None:
    recording = Recording(1)
    for k in range(300):
        recording.add(np.arange(10 * k, 10 * k + 10) * H, np.arange(10 * k, 10 * k + 10.0)[:, None])
        recording.keep(0.0505)
        np.testing.assert_array_equal(recording.values[:, 0], np.round(recording.time / H))
        assert recording.time.size == min(10 * k + 10, 51)
    time, values = recording.between(2.96, 2.97)
    np.testing.assert_array_equal(values[:, 0], np.arange(2960.0, 2971.0))
    assert time.size == 11


def test_cursors_read_straight_lines_exactly_and_nothing_beside_them() -> None:
    time = np.array([1.0, 1.5, 2.5, 4.0])
    values = np.column_stack([3.0 * time - 2.0, np.where(time == 2.5, np.nan, 1.0)])
    shown = Shown(time, values, {"x": "m", "y": "m"}, zero=2.0, start=-1.0, end=2.0, triggered=True)
    read = readout(shown, -1.0, 0.25)
    np.testing.assert_allclose(read.at_a, [1.0, 1.0])
    assert read.at_b[0] == pytest.approx(3.0 * 2.25 - 2.0)
    assert math.isnan(read.at_b[1])
    assert (read.step, read.rate) == (1.25, 0.8)
    assert read.rise[0] == pytest.approx(3.0 * 1.25)
    assert np.all(np.isnan(readout(shown, -1.01, 2.01).at_a))
    assert np.all(np.isnan(readout(shown, -1.01, 2.01).at_b))
    assert readout(shown, 0.5, 0.5).rate == math.inf
    np.testing.assert_allclose(readout(shown, -0.5, 2.0).at_a, values[1])


@pytest.mark.parametrize(
    ("given", "reason"),
    [((0.0, 0.2, AUTO), "window = 0 s"), ((1.0, 0.96, AUTO), "before = 0.96"), ((1.0, 0.2, "free"), "mode = 'free'")],
)
def test_settings_out_of_bounds_are_refused(given: tuple[float, float, str], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        Oscilloscope(*given)


def test_a_recording_takes_eight_megabytes() -> None:
    """Numbers of eight bytes, of all channels and their time."""
    assert 7e6 < 8 * 5 * Recording(4).most <= 8e6


def test_a_window_of_a_second_and_a_half_is_shown_when_it_is_whole() -> None:
    scope = Oscilloscope(1.5, 0.0, NORMAL, Trigger("x", 0.5))
    *_, first, filling = fed(scope, saw(0.0, 1.0), saw(1.0, 1.6), saw(1.6, 2.0))
    assert first is not None
    assert filling is not None
    assert filling.whole
    assert filling.zero == first.zero
