"""What is played: read, scaled, thinned to the cycle of the bus; and the clock that plays it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_bench import drive
from feeddrive.bus import transport as clock
from feeddrive.bus.play import read_plan_profiles, read_profile
from feeddrive.bus.transport import Pace, urgent
from feeddrive.files.run_files import write_run_csv
from feeddrive.language.errors import ParameterError

T = 1e-3
ROWS = 2001


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Two seconds from 10 mm to 30 mm, with 20 Hz of 50 N on top that does not fade by itself."""
    t = np.arange(ROWS) * T
    s = t / t[-1]
    columns = {
        "excitation": 50.0 * np.cos(2 * np.pi * 20.0 * t),
        "set_position": 0.01 + 0.02 * s**3 * (10.0 - 15.0 * s + 6.0 * s * s),
    }
    write_run_csv(tmp_path / "p.csv", np.round(t, 12), columns, {"excitation": "N", "set_position": "m"})
    return tmp_path / "p.csv"


def test_a_profile_that_begins_at_its_peak_needs_a_ramp(path: Path) -> None:
    with pytest.raises(ParameterError, match=r"excitation begins or ends with 100 % of its peak.*give --ramp"):
        read_profile(path, drive("canopen"))
    found = read_profile(path, drive("canopen"), ramp=0.25)
    assert found.excitation[0] == found.excitation[-1] == 0.0
    kept = slice(250, ROWS - 250)
    whole = 50.0 * np.cos(2 * np.pi * 20.0 * np.arange(ROWS) * T)
    assert np.allclose(found.excitation[kept], whole[kept], rtol=0.0, atol=1e-9)  # N, of the stamps' rounding


def test_the_share_is_of_the_excitation_and_not_of_the_motion(path: Path) -> None:
    whole, tenth = (read_profile(path, drive("canopen"), ramp=0.25, share=share) for share in (1.0, 0.1))
    assert np.allclose(tenth.excitation, 0.1 * whole.excitation, rtol=1e-15, atol=0.0)
    assert np.array_equal(tenth.set_position, whole.set_position)


def test_the_motion_is_relative_and_its_speed_that_of_the_polynomial(path: Path) -> None:
    """30 s² (1 - s)² · 20 mm / 2 s; the central difference is off by x'''T²/6 = 20 mm · 60/2³ s⁻³ · T²/6 at most."""
    found = read_profile(path, drive("canopen"), ramp=0.25)
    assert found.set_position[0] == 0.0
    assert found.set_position[-1] == pytest.approx(0.02, abs=1e-15)
    s = np.linspace(0.0, 1.0, ROWS)[1:-1]
    exact = 0.02 / 2.0 * 30.0 * s**2 * (1.0 - s) ** 2
    assert np.max(np.abs(found.velocity[1:-1] - exact)) <= 0.02 * 60.0 / 8.0 * T**2 / 6.0 * 1.01


def test_a_slower_bus_takes_every_so_many_rows(path: Path) -> None:
    whole = read_profile(path, drive("canopen"), ramp=0.25)
    fourth = read_profile(path, drive("canopen", cycle_time=4e-3), ramp=0.25)
    assert fourth.sample_time == 4e-3
    assert fourth.set_position.size == (ROWS + 3) // 4
    assert np.array_equal(fourth.set_position, whole.set_position[::4])
    kept = slice(100, -100)
    assert np.array_equal(fourth.excitation[kept], whole.excitation[::4][kept])


class Clock:
    """Time that passes only where it is told to."""

    def __init__(self) -> None:
        self.now = 100.0
        self.slept: list[float] = []

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


def test_cycles_keep_their_time_and_a_late_one_is_not_made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work of 0.3 ms in cycles of 1 ms, and once of 4.3 ms: 3.3 ms late, and then 1 ms apart again."""
    time = Clock()
    monkeypatch.setattr(clock, "time", time)
    pace = Pace(1e-3)
    began: list[float] = []
    for k in range(10):
        pace.wait()
        began.append(time.now)
        time.now += 4.3e-3 if k == 4 else 0.3e-3
    gaps = np.diff(began)
    assert gaps == pytest.approx([1e-3] * 4 + [4.3e-3] + [1e-3] * 4, abs=1e-9)
    found = pace.lateness()
    assert found is not None
    assert found.missed == 1
    assert found.most == found.slipped == pytest.approx(3.3e-3, abs=1e-9)
    assert found.median == pytest.approx(0.0, abs=1e-9)


def test_without_a_clock_nothing_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Clock()
    monkeypatch.setattr(clock, "time", time)
    pace = Pace(None)
    for _ in range(5):
        pace.wait()
    assert time.slept == []
    assert pace.lateness() is None


def test_garbage_is_collected_again_after_the_motion() -> None:
    import gc

    assert gc.isenabled()
    with urgent(False) as permitted:
        assert not gc.isenabled()
        assert not permitted
    assert gc.isenabled()


def test_a_plan_ends_at_its_end_on_a_slower_bus_and_turns_what_turns(tmp_path: Path) -> None:
    """2,002 rows a ms apart, of which a bus of 4 ms takes 501: the last one stood 1 ms before the end, 10 nm away."""
    s = np.linspace(0.0, 1.0, ROWS + 1)
    place = 0.02 * s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
    columns = {"x.set_position": place, "x.set_velocity": np.gradient(place, T)}
    for unit in ("m", "rad"):
        units = {"x.set_position": unit, "x.set_velocity": f"{unit}/s"}
        write_run_csv(tmp_path / f"{unit}.csv", np.arange(ROWS + 1) * T, columns, units)
    (found,) = read_plan_profiles(tmp_path / "m.csv", {"x": drive("ethercat", cycle_time=4e-3)})
    assert len(found.set_position) == 502
    assert found.set_position[-1] == place[-1]
    turning = drive("ethercat", cycle_time=4e-3, rotary=True)
    (found,) = read_plan_profiles(tmp_path / "rad.csv", {"x": turning})
    assert found.set_position[-1] == place[-1]
    with pytest.raises(ParameterError, match=r"axis x turns, and its drive file says otherwise: write rotary = true"):
        read_plan_profiles(tmp_path / "rad.csv", {"x": drive("ethercat", cycle_time=4e-3)})
    with pytest.raises(ParameterError, match=r"axis x does not turn, .* leave out rotary = true"):
        read_plan_profiles(tmp_path / "m.csv", {"x": turning})
