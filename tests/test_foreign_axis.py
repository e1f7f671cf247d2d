"""The foreign simulator against closed forms: tests that trust its logs trust these."""

from __future__ import annotations

import numpy as np
import pytest

import foreign_axis as fa

T = 1e-3


def run(axes: fa.Axes, law: fa.Law, rows: int, **more: object) -> fa.Logs:
    return fa.simulate(axes, law, np.zeros(rows), T, np.random.default_rng(0), **more)  # type: ignore[arg-type]


def test_a_pushed_mass_coasts_to_a_stop() -> None:
    """2 m/s2 for 0.2 s less friction of 60 N, then 0.6 m/s2 of deceleration: constant forces are stepped exactly."""
    wave = np.where(np.arange(1000) < 200, 260.0, 0.0)
    logs = run(fa.Axes(mass=100.0, coulomb_positive=60.0, coulomb_negative=40.0), fa.Open(wave), 1000)
    speed = logs.hidden["velocity"][0]
    assert speed[200] == pytest.approx(0.4, abs=1e-12)
    assert speed[400] == pytest.approx(0.4 - 0.6 * 0.2, abs=1e-12)
    # the stop falls into a substep of 0.25 ms, in which the speed is below 0.15 mm/s
    assert logs.hidden["position"][0][-1] == pytest.approx(0.04 + 0.16 / 1.2, abs=4e-8)


def test_dead_time_is_a_real_number_of_samples() -> None:
    wave = np.ones(100)
    logs = run(fa.Axes(mass=1.0, dead_time=2.3e-3), fa.Open(wave), 100)
    # v = t - dead time; the force before the log is 0
    assert logs.hidden["velocity"][0][50] == pytest.approx(50e-3 - 2.3e-3, abs=1e-12)


def test_two_masses_swing_at_their_resonance() -> None:
    axes = fa.Axes(mass=60.0, mass_load=40.0, stiffness=5e6)
    wave = np.zeros(2000)
    wave[0] = 1000.0
    logs = run(axes, fa.Open(wave), 2000)
    stretch = logs.hidden["position"][0] - logs.hidden["position_load"][0]
    lines = np.abs(np.fft.rfft(stretch * np.hanning(2000), 1 << 16))
    found = np.argmax(lines) / (1 << 16) / T
    # a window of 2 s and a grid of 0.015 Hz
    assert found == pytest.approx(float(axes.resonance), abs=0.02)


def test_presliding_is_a_spring_and_then_a_level() -> None:
    axes = fa.Axes(mass=10.0, coulomb_positive=50.0, coulomb_negative=50.0, creep=10e-6)
    # slowly, since a step would swing beyond and stay there
    small = run(axes, fa.Open(np.minimum(np.arange(1500) / 1000.0, 1.0) * 5.0), 1500, substeps=4)
    # s0 = 100 N / 20 um = 5 N/um; Dahl: F = C (1 - exp(-x s0 / C)), so 10 % of C takes -ln(0.9) C / s0 = 1.054 um
    assert small.hidden["position"][0][-1] == pytest.approx(1.0536e-6, rel=1e-2)
    fast = run(axes, fa.Open(np.full(500, 60.0)), 500, substeps=8)
    assert fast.hidden["friction"][0][-1] == pytest.approx(-50.0, rel=1e-3)


def test_draws_are_stable_and_files_hold_the_log(tmp_path) -> None:
    rng = np.random.default_rng(5)
    logs = fa.draw(rng, count=3, T=1e-3, seconds=2.0, move="dwells", law="P-PI", two=False, rotary=False)
    assert logs.stable.all()
    written = fa.write_csv(tmp_path / "log.csv", logs.log(1), rng, unit="mm", force_unit="%")
    lines = (tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2001
    row = [float(part.replace(written.decimal, ".")) for part in lines[1001].split(written.delimiter)]
    names = [name for name in written.names if name != "time"]
    assert len(row) == len(names) + 1
    assert any(value == pytest.approx(1e3 * logs.log(1)["position"][1000], rel=1e-8) for value in row)
