"""Quadrant glitches of simulated machines against stick and slip solved event by event."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import ParameterError
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, simulate
from feeddrive.machining.contour import contour_error
from feeddrive.machining.reversal import Reversals, reversals, stick_time
from machining.circles import KP, KV, MASS, TN, VISCOUS, axis, circle, smooth_xy_table
from machining.stick_slip import glitch

UM = 1e-6
DRY = Coulomb(coulomb=95.0, viscous=VISCOUS)

# R, V, share: stick begin and time ms, peak um, when ms
GOLDEN = [
    (0.02, 0.1, 1.0, -0.02098674, 4.57730460, 34.55708405, 21.399293),
    (0.02, 0.02, 1.0, None, 46.67694623, 27.16005958, 56.677864),
    (0.05, 1.0 / 60.0, 1.0, None, 85.67354423, 22.57770782, 93.470554),
    (0.1, 0.05, 1.0, None, 41.59577701, 27.89968644, 52.043350),
    (0.02, 0.02, 0.0, 24.99392806, 46.68436595, 20.91196563, None),
]


@pytest.mark.parametrize(("R", "V", "share", "begin", "length", "peak", "when"), GOLDEN)
def test_the_event_driven_truth_has_the_golden_values(
    R: float, V: float, share: float, begin: float | None, length: float, peak: float, when: float | None
) -> None:
    found = glitch(R, V, coulomb=95.0, breakaway=95.0, share=share)
    assert 1e3 * found.length == pytest.approx(length, abs=2e-8)
    assert begin is None or 1e3 * found.begin == pytest.approx(begin, abs=1e-8)
    assert found.peak / UM == pytest.approx(peak, abs=1e-7)  # the last digit but one
    assert when is None or 1e3 * found.peak_time == pytest.approx(when, rel=1e-5)  # a flat top


def run(R: float, V: float, T: float = 2.5e-4, substeps: int = 1, turns: float = 3.2) -> Run:
    """Two equal dry axes on a pure cosine and sine from t = 0, moving as set."""
    loop = axis(T, friction_load=DRY, substeps=substeps)
    t = T * np.arange(int(2.0 * np.pi * turns * R / (V * T)) + 1)
    w = V / R
    references = {}
    for name, phase in (("x", 0.5 * np.pi), ("y", 0.0)):
        rows = [R * w**k * np.sin(w * t + phase + 0.5 * np.pi * k) for k in range(5)]
        position, velocity, acceleration, jerk, snap = rows
        references[name] = Recorded(
            position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap, sample_time=T
        )
    signals = ("position_load", "velocity_load", "set_position", "set_velocity", "set_acceleration")
    record = [f"{name}.{signal}" for name in references for signal in signals]
    return simulate(Machine.of({"x": loop, "y": loop}), references, start={"x": (R, 0.0), "y": (0.0, V)}, record=record)


@pytest.mark.parametrize(
    ("substeps", "golden"), [(1, 34.34041398), (4, 34.34069865), (16, 34.34070860), (64, 34.34070989)]
)
def test_the_simulated_peak_has_the_golden_value_of_its_substeps(substeps: int, golden: float) -> None:
    whole = run(0.02, 0.1, substeps=substeps)
    turn = 2.0 * np.pi * 0.02 / 0.1
    late = (whole.time >= 2.2 * turn) & (whole.time <= 3.2 * turn)
    outward = np.hypot(whole["x.position_load"], whole["y.position_load"])[late] - 0.02
    assert np.max(outward) / UM == pytest.approx(golden, abs=2e-8)


@pytest.mark.parametrize(("R", "V"), [(0.02, 0.1), (0.02, 0.02)])
def test_quadrant_glitches_within_two_percent_of_the_truth(R: float, V: float) -> None:
    truth = glitch(R, V, coulomb=95.0, breakaway=95.0)
    found = reversals(run(R, V, turns=2.2), begin=1.1 * 2.0 * np.pi * R / V)
    assert [f"{each.axis}{each.side}" for each in found.reversals[:4]] == ["y+", "x-", "y-", "x+"]
    for each in found.reversals[:4]:
        assert each.base + each.height == pytest.approx(truth.peak, rel=0.02)
        assert each.peak_time == pytest.approx(truth.peak_time, abs=5e-4)  # two samples
        assert each.stick_time == pytest.approx(truth.length, abs=5e-4)
        assert each.stick_time == pytest.approx(
            stick_time(V**2 / R, mass=MASS, coulomb=95.0, breakaway=95.0, Kv=KV, Kp=KP, Tn=TN), rel=0.02, abs=5e-4
        )
        assert 0.5 * each.peak_time < each.width < 3.0 * each.peak_time
    assert "height um" in str(found)


def test_the_closed_form_of_the_stand() -> None:
    for R, V, _, _, length, _, _ in GOLDEN:
        found = stick_time(V**2 / R, mass=MASS, coulomb=95.0, breakaway=95.0, Kv=KV, Kp=KP, Tn=TN)
        assert 1e3 * found == pytest.approx(length, rel=0.006)  # as its source says
    assert stick_time(2.0, mass=MASS, coulomb=95.0, breakaway=95.0, Kv=KV, Kp=KP) == 0.0
    with pytest.raises(ParameterError, match="acceleration = 0"):
        stick_time(0.0, mass=MASS, coulomb=95.0, breakaway=95.0, Kv=KV, Kp=KP)


def test_an_axis_without_dry_friction_does_not_stand() -> None:
    found = reversals(simulate(smooth_xy_table(), circle(0.02, 0.1)), begin=1.0)
    assert found.reversals
    for each in found.reversals:
        assert each.stick_time == 0.0
        assert abs(each.height) < 1.0 * UM  # unequal axes draw an ellipse of 1 um
    three = np.column_stack([np.arange(9.0)] * 3)
    error = contour_error(three, three)
    with pytest.raises(ParameterError, match="a plane path"):
        reversals(simulate(smooth_xy_table(), circle(0.02, 0.1), duration=0.1), error)


def turned(outward: np.ndarray, stuck: float = 1.0) -> Reversals:
    """The reversals of x on a circle of 400 samples in a second, with these outward errors and a speed of x at rest."""
    angle = 2.0 * np.pi * (np.arange(400) + 0.5) / 400
    R, w = 0.02, 2.0 * np.pi
    cos, sin = np.cos(angle), np.sin(angle)
    signals = {
        "x.set_position": R * cos, "y.set_position": R * sin,
        "x.set_velocity": -R * w * sin, "y.set_velocity": R * w * cos,
        "x.set_acceleration": -R * w * w * cos, "y.set_acceleration": -R * w * w * sin,
        "x.position_load": (R + outward) * cos, "y.position_load": (R + outward) * sin,
        "x.velocity_load": -R * w * sin, "y.velocity_load": R * w * cos,
    }  # fmt: skip
    signals["x.velocity_load"][200:206] = stuck  # behind the reversal of x at half a turn
    return reversals(Run("circle", signals, 1.0 / 400, 400))


def test_the_base_is_the_last_fifth_before_a_reversal() -> None:
    """From the reversal of y at sample 100 on: 2 um in the last 15 of the hundred samples before that of x at 200."""
    outward = np.zeros(400)
    outward[185:200] = 2 * UM
    found = {f"{each.axis}{each.side}": each for each in turned(outward).reversals}
    assert found["x-"].base == pytest.approx(2 * UM * 15 / 20, abs=1e-3 * UM)


@pytest.mark.parametrize(("speed", "samples"), [(0.7e-12, 6), (1.5e-12, 0)])
def test_an_axis_sticks_below_a_picometer_per_second(speed: float, samples: int) -> None:
    found = {f"{each.axis}{each.side}": each for each in turned(np.zeros(400), speed).reversals}
    assert found["x-"].stick_time == pytest.approx(samples / 400)
