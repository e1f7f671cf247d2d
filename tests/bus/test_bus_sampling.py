"""A drive that is sampled: nothing that is sent commands or changes it, and lost frames are gaps."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bus_bench import SCALING, T, bench_loop, drive
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.bus.client import transport_of
from feeddrive.bus.sampling import Sampler, sample
from feeddrive.bus.virtual_drive import DrivenAxis, Firmware
from feeddrive.bus.virtual_nodes import serve_canopen
from feeddrive.language.errors import BusError, ParameterError

ACTUAL = {"statusword", "mode_display", "position", "velocity", "torque", "following_error", "second_position"}


@contextmanager
def served(name: str, lose: Any = lambda _: False) -> Generator[Firmware]:
    """A virtual drive whose 100 kg are pulled by 2 N."""
    loop = bench_loop()
    loop = replace(loop, axis=replace(loop.axis, forces=(Gravity(force=2.0),)))
    firmware = Firmware(DrivenAxis(loop), SCALING, T)
    ready, stop = threading.Event(), threading.Event()
    options = {"ready": ready.set, "stopped": stop.is_set, "lose": lose}
    thread = threading.Thread(target=serve_canopen, args=(firmware, f"virtual:{name}", 5), kwargs=options)
    thread.start()
    try:
        assert ready.wait(20)
        yield firmware
    finally:
        stop.set()
        thread.join(10)


def sampled(name: str, rows: int) -> tuple[np.ndarray, np.ndarray, dict[str, str]]:
    sampler = Sampler(transport_of(drive("canopen"), f"virtual:{name}", None), drive("canopen"))
    pieces = list[tuple[np.ndarray, np.ndarray]]()
    try:
        sampler.open()
        sample(sampler, lambda *piece: pieces.append(piece), lambda: sum(t.size for t, _ in pieces) >= rows)
    finally:
        sampler.close()
    return np.concatenate([t for t, _ in pieces]), np.concatenate([y for _, y in pieces]), sampler.channels


def test_no_object_that_a_master_may_write_is_changed_and_the_drive_stays_off() -> None:
    with served("untouched") as firmware:
        before = dict(firmware.values)
        time, values, channels = sampled("untouched", 300)
        after = dict(firmware.values)
        assert firmware.state.name == "SWITCH_ON_DISABLED"
    assert {name for name in after if after[name] != before[name]} <= ACTUAL
    assert channels == {
        "position": "m",
        "velocity": "m/s",
        "force": "N",
        "following_error": "m",
        "position_second": "m",
        "status": "",
    }
    np.testing.assert_allclose(np.diff(time), T, atol=1e-12)
    # 2 N on 100 kg with 300 N s/m: the motion of a mass that nobody holds, to the increments and the swing of the screw
    place = values[:, [*channels].index("position")]
    k = np.arange(place.size) * T
    fit = np.polyfit(k, place, 2)
    assert 2.0 * fit[0] == pytest.approx(2.0 / 100.0, rel=0.4)
    assert np.all(np.diff(place[50:]) > 0.0)
    assert np.all(values[:, [*channels].index("force")] == 0.0)


def test_a_lost_frame_is_a_row_of_gaps_and_time_goes_on() -> None:
    with served("lost", lambda cycle: cycle == 40):
        time, values, _ = sampled("lost", 80)
    lost = np.isnan(values).all(axis=1)
    assert np.count_nonzero(lost) == 1
    assert np.isfinite(values[~lost]).all()
    np.testing.assert_allclose(np.diff(time), T, atol=1e-12)


def test_a_drive_of_another_scaling_is_refused_before_anything_is_sampled() -> None:
    wrong = drive("canopen", scaling=replace(SCALING, counts_per_turn=2e6))
    with served("scaled"):
        sampler = Sampler(transport_of(wrong, "virtual:scaled", None), wrong)
        with pytest.raises(BusError, match="but the drive says"):
            sampler.open()
        sampler.close()
    nowhere = Sampler(transport_of(wrong, "nowhere", None), wrong)
    with pytest.raises(ParameterError, match="must name what python-can calls"):
        nowhere.open()
    nowhere.close()
