"""Every figure of a loop from arrays alone, against closed forms and against python-control."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

import feeddrive as fd
from feeddrive.language.errors import ParameterError

F = np.geomspace(0.5, 2000.0, 3000)
STEP = np.log(F[1] / F[0])
MASS, STIFFNESS, VISCOUS = 120.0, 4e6, 900.0


def plant(f: np.ndarray) -> np.ndarray:
    """A mass with viscous friction, m/N."""
    s = 2j * np.pi * f
    return 1.0 / (MASS * s * s + VISCOUS * s)


def law(f: np.ndarray) -> np.ndarray:
    """PID with a lag, N/m."""
    s = 2j * np.pi * f
    return (STIFFNESS + 3e7 / s + 3e4 * s) / (1.0 + s / 6000.0)


def test_a_control_given_as_an_array_closes_the_measured_loop() -> None:
    """L, S, T, compliance and dynamic stiffness of a mass under PID, to rounding of the closed forms."""
    G, C = plant(F), law(F)
    found = fd.measured_loop((F, C), None, (F, G), disturbance=((F, G), None), delay=2e-4)
    L = G * C * np.exp(-2j * np.pi * F * 2e-4)
    assert found.loop_gain.response == pytest.approx(L, rel=1e-12)
    assert found.sensitivity.response == pytest.approx(1.0 / (1.0 + L), rel=1e-12)
    assert found.complementary_sensitivity.response == pytest.approx(L / (1.0 + L), rel=1e-12)
    assert found.compliance is not None
    assert found.compliance.response == pytest.approx(G / (1.0 + L), rel=1e-9)
    assert found.stiffness.magnitude == pytest.approx(np.abs((1.0 + L) / G), rel=1e-9)
    assert found.encirclement(integrators=2).stable
    assert found.margins.loop_gain.sample_time is None


def test_control_and_axis_from_python_control() -> None:
    """The same loop three times: arrays, python-control's transfer functions, and the FRDs of both handed back."""
    control = pytest.importorskip("control", reason="NOT TESTED: pip install 'feeddrive[control]'")
    s = control.tf("s")
    C = (STIFFNESS + 3e7 / s + 3e4 * s) / (1.0 + s / 6000.0)
    G = 1.0 / (MASS * s * s + VISCOUS * s)
    arrays = fd.measured_loop((F, law(F)), None, (F, plant(F)))
    models = fd.measured_loop(C, None, G, frequency=F)
    frds = fd.measured_loop(
        fd.analysis.as_frf((F, law(F))).to_control(), None, fd.analysis.as_frf((F, plant(F))).to_control()
    )
    for other in (models, frds):
        assert other.loop_gain.response == pytest.approx(arrays.loop_gain.response, rel=1e-9)
        assert other.margins.delay_margin == pytest.approx(arrays.margins.delay_margin, rel=1e-6)
    back = arrays.loop_gain.to_control()
    assert back.dt == 0
    assert (back.input_labels, back.output_labels) == (["cut"], ["force"])
    named = fd.analysis.as_frf(back)
    assert (named.input, named.output) == ("cut", "force")


def test_a_sampled_control_acts_at_z() -> None:
    """A discrete PI of python-control: at z = e^(j2πfT), refused with another sample time and beyond Nyquist."""
    control = pytest.importorskip("control", reason="NOT TESTED: pip install 'feeddrive[control]'")
    T = 1e-3
    C = control.tf([3e4, -2.95e4], [1.0, -1.0], T)
    f = np.geomspace(1.0, 500.0, 400)
    found = fd.measured_loop(C, T, (f, plant(f)), delay=0.5 * T)
    z = np.exp(2j * np.pi * f * T)
    expected = (3e4 * z - 2.95e4) / (z - 1.0) * plant(f) / np.sqrt(z)
    assert found.loop_gain.response == pytest.approx(expected, rel=1e-9)
    assert found.loop_gain.sample_time == T
    with pytest.raises(ParameterError, match=r"sampled with 0.001 s, and sample_time is 0.002 s"):
        fd.measured_loop(C, 2 * T, (f[f < 200], plant(f[f < 200])))
    with pytest.raises(ParameterError, match="beyond Nyquist, 500 Hz"):
        fd.analysis.as_frf(C, np.array([10.0, 600.0]))
    with pytest.raises(ParameterError, match="beyond Nyquist, 500 Hz"):
        fd.measured_loop((F, law(F)), T, (F, plant(F)))


def test_what_does_not_fit_together_is_said() -> None:
    with pytest.raises(ParameterError, match="reads one encoder"):
        fd.measured_loop((F, law(F)), None, (F, plant(F)), (F, plant(F)))
    with pytest.raises(ParameterError, match="different frequencies"):
        fd.measured_loop((1.01 * F, law(F)), None, (F, plant(F)))
    with pytest.raises(ParameterError, match="give its sample_time"):
        fd.measured_loop(fd.Control(law=fd.blocks.CascadePPI(Kv=40.0, Kp=2e4, Tn=0.02)), None, (F, plant(F)))


@pytest.mark.parametrize(
    ("frequency", "said"),
    [
        ([-1.0, 2.0, 3.0], r"line 1 .* is -1 Hz \(1 such lines\)"),
        ([1.0, 3.0, 2.0], r"line 3 .* is 2 Hz after 3 Hz"),
        ([0.0, 2.0, 3.0], r"line 1 .* is 0 Hz"),
        ([1.0, np.nan, 3.0], r"line 2 is 1\+1j at nan Hz"),
    ],
)
def test_wrong_lines_are_named(frequency: list[float], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        fd.margins(np.full(3, 1.0 + 1.0j), np.array(frequency))


def test_a_dead_time_is_exact() -> None:
    """Any dead time turns by 2πfτ and moves the delay margin by τ; in whole samples it is z⁻ᵏ to rounding."""
    T, K = 1e-3, 2 * np.pi * 30.0
    f = np.geomspace(0.5, 499.0, 4000)
    z = np.exp(2j * np.pi * f * T)
    L = fd.FRF(f, K * T / (z - 1.0), sample_time=T)
    for samples in (1, 2):
        assert L.delayed(samples * T).response == pytest.approx(L.response * z**-samples, rel=1e-12)
    before = fd.margins(L).delay_margin
    assert before is not None
    for late in (1.7e-4, 2.5e-3, 6.123e-3):
        after = fd.margins(L.delayed(late))
        # |L| does not change; a phase that is linear in f bows over ln f by 2πfτ step²/8 = 5e-7 rad at most, 2.5 ns
        assert after.delay_margin == pytest.approx(before - late, abs=2.5e-9)
        assert after.crossover == pytest.approx(fd.margins(L).crossover, rel=1e-12)
    noisy = fd.FRF(f, L.response, sample_time=T, variance=np.full(f.size, 1e-4)).delayed(1e-3)
    assert noisy.variance == pytest.approx(np.full(f.size, 1e-4), rel=1e-12)


def within(fine: np.ndarray, values: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """python-control's margins and their frequencies in Hz, in order, as far as they lie on the lines."""
    values, places = np.atleast_1d(values), np.atleast_1d(omega) / (2.0 * np.pi)
    order = np.argsort(places)
    order = order[(places[order] > fine[0]) & (places[order] < fine[-1])]
    return values[order], places[order]


@settings(max_examples=60, deadline=None)
@given(
    crossover=st.floats(3.0, 120.0),
    zero=st.floats(1.0, 60.0),
    pole=st.floats(80.0, 900.0),
    resonance=st.floats(60.0, 700.0),
    damping=st.floats(0.05, 0.6),
    integrators=st.integers(0, 2),
)
# with Ms above 600 the distance to -1 is a tenth of that between two lines
@example(crossover=60.0, zero=1.0, pole=689.0, resonance=60.0, damping=0.05078125, integrators=2)
@example(crossover=60.0, zero=32.0, pole=80.0, resonance=60.0, damping=0.0546875, integrators=1)
@example(crossover=94.0, zero=1.0, pole=80.0, resonance=94.375, damping=0.05078125, integrators=1)
def test_all_crossings_are_those_of_python_control(
    crossover: float, zero: float, pole: float, resonance: float, damping: float, integrators: int
) -> None:
    """Random rational loops: as many gain and phase crossovers, at the same places, with the same margins."""
    control = pytest.importorskip("control", reason="NOT TESTED: pip install 'feeddrive[control]'")
    s = control.tf("s")
    w = 2 * np.pi * resonance
    model = (s / (2 * np.pi * zero) + 1.0) / (s / (2 * np.pi * pole) + 1.0) ** 2 / s**integrators
    model = model * w**2 / (s**2 + 2 * damping * w * s + w**2)
    model = model / abs(model(2j * np.pi * crossover))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gm, pm, sm, wpc, wgc, _ = control.stability_margins(model, returnall=True)
    fine = np.geomspace(0.5, 20_000.0, 20_000)
    found = fd.margins(model, fine)
    (gm, wpc), (pm, wgc) = within(fine, gm, wpc), within(fine, pm, wgc)
    # a curve that hardly crosses is between two lines where a straight piece of it is not: steeper ones are within
    # step²/8 times the bend over the slope, (5.3e-4)²/8 / (2 0.05²) / 0.5 = 1.4e-5 of the frequency
    response = np.asarray(model(2j * np.pi * fine))
    flat = np.abs(np.gradient(np.log(np.abs(response)), np.log(fine)))
    assume(np.all(np.interp(wgc, fine, flat) > 0.5))
    turn = np.abs(np.gradient(np.unwrap(np.angle(response)), np.log(fine)))
    assume(np.all(np.interp(wpc, fine, turn) > 0.5))
    assert [c.frequency for c in found.gain_crossovers] == pytest.approx(wgc, rel=1e-4)
    assert [c.phase_margin_deg for c in found.gain_crossovers] == pytest.approx(pm, abs=0.05)
    assert [c.frequency for c in found.phase_crossovers] == pytest.approx(wpc, rel=1e-4)
    assert [c.gain_margin_dB for c in found.phase_crossovers] == pytest.approx(20 * np.log10(gm), abs=0.01)
    if np.size(sm):
        # python-control lists local minima, to 1e-9; feeddrive names the least of the curve.  Between two lines it runs
        # as r + b x + c x² + d x³, -1 <= x <= 1, and a parabola of |1 + L|² leaves out 2 |x - x³| (|b c| + |r d|) and
        # |x² - x⁴| |c|²
        near = slice(max(np.searchsorted(fine, found.modulus_frequency) - 3, 0), None)
        rows = (1.0 + response, np.gradient(response), np.diff(response, 2) / 2.0, np.diff(response, 3) / 6.0)
        r, b, c, d = (np.max(np.abs(row[near][:5])) for row in rows)
        assert found.modulus_margin**2 <= np.min(sm) ** 2 + 0.77 * (b * c + r * d) + 0.25 * c**2 + 1e-9


@settings(max_examples=30, deadline=None)
@given(
    Kv=st.floats(5.0, 500.0),
    Kp=st.floats(1e3, 8e5),
    Tn=st.floats(2e-3, 0.2),
    stiffness=st.floats(1e6, 1e8),
    dead_time=st.floats(0.0, 1.5e-3),
    lag=st.floats(100.0, 2000.0),
)
def test_encirclements_of_random_sampled_loops_are_their_eigenvalues(
    Kv: float, Kp: float, Tn: float, stiffness: float, dead_time: float, lag: float
) -> None:
    """P-PI on two masses with any dead time and lag, sampled: turns round -1 against eigenvalues of the closed loop."""
    T = 2.5e-4
    axis = fd.Axis(
        plant=fd.blocks.TwoMass(
            mass_motor=130.0, mass_load=33.0, stiffness=stiffness, damping=2500.0, viscous_motor=1500.0
        ),
        actuator=fd.blocks.Actuator(dead_time=dead_time, current_loop=lag),
    )
    loop = fd.Loop(control=fd.Control(law=fd.blocks.CascadePPI(Kv=Kv, Kp=Kp, Tn=Tn)), axis=axis, sample_time=T)
    f = np.geomspace(0.02, 0.5 / T, 12_000)
    found = fd.analysis.encirclement(fd.loop_gain(loop, f))
    poles = fd.stability(loop).model.poles()
    assume(np.all(np.abs(np.abs(poles) - 1.0) > 1e-5))  # beside the edge the lines cannot resolve it
    growing = int(np.sum(np.abs(poles) > 1.0))
    assert found.unstable == growing or not found.certain
    assert found.stable == (growing == 0) or not found.certain
