"""Certificates: sharp where closed forms are known, true for what lies in the discs, and honest about rounding."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.certificate import check
from feeddrive.certificate.certificate import LoopResponse, deviations, radius_steps
from feeddrive.certificate.systems import deployed, rounded
from feeddrive.language.errors import NotCertifiedError, ParameterError
from feeddrive.loop.linearize import StateSpace
from feeddrive.tuning.control_response import ControlResponse
from fresh_draws import Seeded

Held = dict[str, list[list[str]]]


def held(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> Held:
    return {name: [[float(x).hex() for x in row] for row in m] for name, m in zip("ABCD", (A, B, C, D), strict=True)}


def gain(k: float) -> Held:
    """A control without states: the force is -k times the reading."""
    return held(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[-k]]))


def late_integrator(delay: int) -> Held:
    """1/(z - 1) z^-delay."""
    n = delay + 1
    A = np.diag(np.ones(n - 1), -1) if n > 1 else np.zeros((1, 1))
    A[0, 0] = 1.0
    return held(A, np.eye(n)[:, :1], np.eye(n)[-1:, :], np.zeros((1, 1)))


def row(model: Held, r: float, T: float = 1e-3) -> dict[str, object]:
    return {
        "name": "test",
        "model": model,
        "discs": "one",
        "lines": [],
        "reserve": None,
        "reserve_at_Hz": 0.0,
        "radius": [{"from_Hz": 0.0, "to_Hz": 0.5 / T, "r": [r]}],
    }


def proven(control: Held, model: Held, r: float) -> bool:
    try:
        check.proven(check.polynomials(check.system(control, "control")), row(model, r), 1e-3, check.Work())
    except check.RefusedError:
        return False
    return True


@pytest.mark.parametrize("delay", [0, 1, 2, 3, 8, 20])
def test_the_limit_of_an_integrator_with_dead_time_is_met_exactly(delay: int) -> None:
    """k z^-d/(z - 1) is stable for k < 2 sin(π/(4d + 2)); one part in 10⁹ on either side is told apart."""
    limit = 2.0 * math.sin(math.pi / (4.0 * delay + 2.0))
    assert proven(gain(limit * (1.0 - 1e-9)), late_integrator(delay), 0.0)
    assert not proven(gain(limit * (1.0 + 1e-9)), late_integrator(delay), 0.0)


@pytest.mark.parametrize("k", [1.2, 1.5, 1.9])
def test_the_radius_is_met_exactly(k: float) -> None:
    """|1 + L|/|L| = |z - 1 + k|/k of an integrator is least at z = -1 for k > 1: (2 - k)/k."""
    limit = (2.0 - k) / k
    assert proven(gain(k), late_integrator(0), limit * (1.0 - 1e-6))
    assert not proven(gain(k), late_integrator(0), limit * (1.0 + 1e-6))


def test_a_peak_between_two_lines_of_a_grid_is_found() -> None:
    """A mode of 10⁻⁶ damping at 100.5 Hz, 0.2 mHz wide, turned round the origin: the grid of 1 Hz never sees it.

    Its circle has a diameter of 0.72, so that the loop is stable, but comes down to |1 + L|/|L| = 0.39 where it points
    to -1.  The proof refuses r = 0.5 just there, and names the frequency.
    """
    T, w, d = 1e-3, 2.0 * math.pi * 100.5, 1e-6
    pole = np.exp((-d + 1j * math.sqrt(1.0 - d * d)) * w * T)
    A = np.array([[1.0, 0.0, 0.0], [0.0, pole.real, pole.imag], [0.0, -pole.imag, pole.real]])
    C = np.array([[1.0, 1.0, 0.0]])
    control = check.polynomials(check.system(gain(0.05), "control"))
    coarse, fine = np.arange(1.0, 500.0), 100.5 + np.linspace(-5e-3, 5e-3, 4001)
    refused = 0
    for turn in np.linspace(0.0, 2.0 * math.pi, 13):
        B = np.array([[1.0], [1.8e-5 * math.sin(turn)], [1.8e-5 * math.cos(turn)]])
        near: list[float] = []
        for f in (coarse, fine):
            L = 0.05 * np.array([(C @ np.linalg.solve(x * np.eye(3) - A, B))[0, 0] for x in np.exp(2j * np.pi * f * T)])
            near.append(float(np.min(np.abs(1.0 + L) / np.abs(L))))
        assert near[0] > 0.9
        assert np.max(np.abs(np.linalg.eigvals(A - 0.05 * B @ C))) < 1.0
        if near[1] > 0.51:
            check.proven(control, row(held(A, B, C, np.zeros((1, 1))), 0.5), T, check.Work())
        elif near[1] < 0.49:
            refused += 1
            with pytest.raises(check.RefusedError) as caught:
                check.proven(control, row(held(A, B, C, np.zeros((1, 1))), 0.5), T, check.Work())
            assert caught.value.frequency == pytest.approx(100.5, abs=1e-3)
    assert 0 < refused < 13


def random_loop(seed: int) -> fd.Loop:
    """Two masses with a random mode, dead time and filters; P-PI with gains up to twice what is usual."""
    rng = np.random.default_rng(seed)
    m1, m2 = rng.uniform(5.0, 100.0, 2)
    mode = 2.0 * math.pi * rng.uniform(40.0, 300.0)
    T = float(rng.choice([5e-5, 2.5e-4, 1e-3]))
    both = m1 * m2 / (m1 + m2)
    plant = fd.blocks.TwoMass(mass_motor=m1, mass_load=m2, stiffness=mode**2 * both, damping=0.04 * mode * both)
    late = rng.uniform(0.0, 2.5) * T
    wv = rng.uniform(0.05, 0.4) * mode
    law = fd.blocks.CascadePPI(Kp=(m1 + m2) * wv, Tn=5.0 / wv, Kv=wv / 5.0, velocity_encoder="motor")
    filters = (fd.blocks.LowPass(frequency=min(0.3 / T, mode)),) if rng.random() < 0.5 else ()
    axis = fd.Axis(
        plant=plant, actuator=fd.blocks.Actuator(dead_time=late), friction_load=fd.blocks.Viscous(viscous=20.0)
    )
    return fd.Loop(control=fd.Control(law=law, filters=filters), axis=axis, sample_time=T)


def perturbed(loop: LoopResponse, r: float, a: float, sign: float) -> float:
    """|z| of the largest pole with P (1 + Δ), Δ = ± r (1 - a z)/(z - a), an all-pass of size r, at the input."""
    P, (C,) = loop.plant, loop.samples
    n, m = len(P.states), len(C.states)
    K = C.D @ P.C  # force from the plant's states, and from the control's
    # Δ f: q' = a q + f,  d = ± r ((1 - a²) q - a f)
    s = sign * r
    b = P.B
    A = np.block(
        [
            [P.A + b * (1.0 - s * a) @ K, b * (1.0 - s * a) @ C.C, b * s * (1.0 - a * a)],
            [C.B @ P.C, C.A, np.zeros((m, 1))],
            [K, C.C, np.array([[a]])],
        ]
    )
    assert A.shape == (n + m + 1,) * 2
    return float(np.max(np.abs(np.linalg.eigvals(A))))


@pytest.mark.parametrize("seed", range(12))
def test_what_is_certified_holds_for_plants_in_the_discs_and_no_further(seed: int) -> None:
    """All-passes of size r leave the loop stable; one of 1.01 times the reserve, turned to the worst, does not."""
    loop = random_loop(seed)
    stable = fd.stability(loop).stable
    try:
        found = fd.certificate.certify_loop(loop, radius=0.05)
    except NotCertifiedError:
        L = fd.loop_gain(loop, np.geomspace(1e-2, 0.5 / loop.sample_time, 20_000)).response
        assert not stable or np.min(np.abs(1.0 + L) / np.abs(L)) < 0.05 * 1.001
        return
    assert stable
    assert found.reserve is not None
    one = found.loops["model"]
    f = np.geomspace(1e-2, 0.5 / loop.sample_time, 30_000)
    distance, taken = one.room(f)
    assert np.min(distance / taken) > found.reserve * (1.0 - 1e-5)
    r = 0.05 * found.reserve
    rng = np.random.default_rng(seed)
    for a in [*rng.uniform(-1.0, 1.0, 40), *(1.0 - 10.0 ** rng.uniform(-5.0, 0.0, 40))]:
        for sign in (1.0, -1.0):
            assert perturbed(one, 0.999 * r, float(a), sign) < 1.0
    # Δ(z) = -1/T at the place of least room: 1 + L (1 + Δ) = 0 there
    place = found.document["plants"][0]["reserve_at_Hz"]
    z = np.exp(2j * np.pi * place * loop.sample_time)
    L = one.gains(np.array([place])).sum(axis=0)[0]
    wanted = -(1.0 + L) / L
    grid = np.tanh(np.linspace(-9.0, 9.0, 40_001))
    off = [np.abs(np.angle(sign * (1.0 - grid * z) / (z - grid) / wanted)) for sign in (1.0, -1.0)]
    k = int(np.argmin([each.min() for each in off]))
    a = float(grid[np.argmin(off[k])])
    assert off[k].min() < 1e-2
    assert perturbed(one, 1.01 * r, a, (1.0, -1.0)[k]) > 1.0


def test_polynomials_are_those_of_the_loop() -> None:
    """det(z - A) and the numerators against numpy on random systems; the closed loop's zeros are its eigenvalues."""
    rng = np.random.default_rng(3)
    for n in (0, 1, 4, 9):
        A, B, C, D = (rng.standard_normal(size) for size in ((n, n), (n, 2), (1, n), (1, 2)))
        det, above = check.polynomials(check.system(held(A, B, C, D), "random"))
        for z in (0.3 + 0.9j, -1.2 + 0.1j):
            expected = (C @ np.linalg.solve(z * np.eye(n) - A, B) if n else np.zeros((1, 2))) + D
            for i in range(2):
                ratio = sum(Fraction(x, det[-1]) * 1.0 * z**k for k, x in enumerate(above[0, i])) / sum(
                    Fraction(x, det[-1]) * 1.0 * z**k for k, x in enumerate(det)
                )
                assert ratio == pytest.approx(expected[0, i], rel=1e-9)
        if n:
            zeros = np.roots([float(Fraction(x, det[-1])) for x in reversed(det)])
            assert np.sort(np.abs(zeros)) == pytest.approx(np.sort(np.abs(np.linalg.eigvals(A))), rel=1e-6)


def test_the_squared_size_is_a_polynomial_in_u() -> None:
    """Bernstein coefficients against |p(z)|² at u = sin²(w/2), and both halves of a stretch."""
    p = [3, -1, 4, 1, -5, 9]
    b = check.squared(p, 7)
    common = math.lcm(*(math.comb(7, k) for k in range(8)))
    for u in (0.0, 0.1, 0.5, 0.99, 1.0):
        z = np.exp(2j * math.asin(math.sqrt(u)))
        value = sum(math.comb(7, k) * u**k * (1.0 - u) ** (7 - k) * x for k, x in enumerate(b))
        assert value / common == pytest.approx(abs(sum(x * z**k for k, x in enumerate(p))) ** 2, rel=1e-9)
    left, right = check.halved(b)
    assert left[0] == b[0] << 7
    assert right[-1] == b[-1] << 7
    assert left[-1] == right[0]


def test_stability_is_that_of_the_zeros(seeded: Seeded) -> None:
    """Polynomials of degree 1 to 13 with zeros near the circle, inside and outside, against their zeros."""
    rng = np.random.default_rng(seeded(0))
    verdicts: list[bool] = []
    for _ in range(300):
        n = int(rng.integers(1, 14))
        zeros: list[complex] = [complex(rng.uniform(-1.02, 1.02))] if n % 2 else []
        for _ in range(n // 2):
            z = rng.uniform(0.7, 1.0 + 0.4 / n) * np.exp(1j * rng.uniform(0.0, np.pi))
            zeros += [z, np.conj(z)]
        F = [round(x * 10**15) for x in np.real(np.poly(zeros))[::-1]]
        far = float(np.max(np.abs(np.roots([float(x) for x in reversed(F)]))))
        if abs(far - 1.0) > 1e-6:
            verdicts.append(far < 1.0)
            assert check.stable(F) == verdicts[-1]
            assert check.stable([-x for x in F]) == verdicts[-1]
    assert 50 < sum(verdicts) < len(verdicts) - 50


@pytest.mark.parametrize("machine", ["ball_screw", "emps", "linear_motor", "mill", "xy_table"])
def test_bundled_machines_are_certified(machine: str) -> None:
    for loop in fd.read_machine(machine).loops.values():
        found = fd.certificate.certify_loop(loop, arithmetic="float32")
        peak = fd.margins(fd.loop_gain(loop, np.geomspace(0.1, 0.499 / loop.sample_time, 4000)))
        assert found.reserve is not None
        assert found.reserve > 1.0
        L = peak.loop_gain.response
        # the lines of this grid come within a thousandth of the peak
        assert found.reserve == pytest.approx(np.min(np.abs(1.0 + L) / np.abs(L)) / 0.2, rel=2e-3)


def test_the_deployed_control_is_the_traced_one() -> None:
    """In float64 the matrices are those of the linearised step; in float32 they are off by its rounding."""
    loop = fd.read_machine("ball_screw").loop("x")
    f = np.geomspace(1.0, 9000.0, 60)
    known = ControlResponse(loop.control, float(loop.sample_time), ["law.Kp"])
    expected = known.at([float(fd.parameters(loop)["axis.x.control.law.Kp"])], f).value
    models: list[StateSpace] = []
    for arithmetic, tolerance in (("float64", 1e-9), ("float32", 1e-3)):
        made = deployed(loop.control, float(loop.sample_time), arithmetic)
        assert isinstance(made.model, StateSpace)
        models.append(made.model)
        for i, reading in enumerate(("reading_motor", "reading_load")):
            got = made.model.response(f, input=reading).response
            assert got == pytest.approx(expected[i], rel=tolerance)
        assert all(rounded(x, arithmetic) == x for x in made.numbers.values())
    assert np.any(models[0].A != models[1].A)


def test_rounding_that_destabilises_is_seen() -> None:
    """The observer of the mill needs more than 24 binary places: its smallest coefficients are lost."""
    loop = fd.read_machine("mill").loop("x")
    assert fd.certificate.certify_loop(loop, arithmetic="float32").reserve
    with pytest.raises(NotCertifiedError, match=r"fixed24 coefficients is not stable.*100 %: use more digits"):
        fd.certificate.certify_loop(loop, arithmetic="fixed24")
    with pytest.raises(ParameterError, match=r"float64, float32, or fixedN"):
        fd.certificate.certify_loop(loop, arithmetic="float16")


def test_what_cannot_be_certified_says_where_by_how_much_and_what_to_do() -> None:
    loop = fd.read_machine("ball_screw").loop("x")
    with pytest.raises(NotCertifiedError, match=r"at 58\.\d+ Hz .* r = 0.6 .* at most 0\.5198.*lower the gains"):
        fd.certificate.certify_loop(loop, radius=0.6)
    with pytest.raises(NotCertifiedError, match=r"not stable: an oscillation of .* Hz grows"):
        fd.certificate.certify_loop(fd.vary(loop, {"axis.x.control.law.Kp": 4e5}))
    two_rates = replace(loop, control=replace(loop.control, law=replace(loop.control.law, position_every=16)))
    with pytest.raises(ParameterError, match=r"one disc for both encoders.*measured apart"):
        fd.certificate.certify_loop(two_rates, {"both": measured(loop, 0.0)})
    repeats = fd.blocks.RepetitiveControl(period_samples=2000)
    with pytest.raises(ParameterError, match=r"remembers 1968 numbers, and a certificate is about 60 at most"):
        fd.certificate.certify_loop(replace(loop, control=replace(loop.control, compensation=(repeats,))))
    with pytest.raises(ParameterError, match="needs its sample_time"):
        fd.certificate.certify_loop(loop.control, {"x": loop})
    with pytest.raises(ParameterError, match=r"every 1 ms, not 0\.05 ms"):
        fd.certificate.certify_loop(loop, {"x": fd.read_machine("emps").loop("x")})
    with pytest.raises(ParameterError, match=r"radius = -0\.1"):
        fd.certificate.certify_loop(loop, radius=-0.1)
    with pytest.raises(ParameterError, match=r"confidence = 95 must .* 0\.95 is 95 %"):
        fd.certificate.certify_loop(loop, confidence=95.0)
    with pytest.raises(ParameterError, match=r"confidence = 1 "):
        fd.certificate.certify_loop(loop, confidence=1.0)
    with pytest.raises(ParameterError, match="velocity = nan m/s"):
        fd.certificate.certify_loop(loop, velocity=np.nan)


def test_a_radius_over_frequency_and_several_plants() -> None:
    """A heavier table beside the machine; the radius grows with frequency, and its steps are never below the line."""
    loop = fd.read_machine("linear_motor").loop("x")
    mass = float(fd.parameters(loop)["axis.x.plant.mass"])
    heavy = fd.vary(loop, {"axis.x.plant.mass": 1.3 * mass})
    points = [(10.0, 0.1), (100.0, 0.3), (1000.0, 1.0)]
    found = fd.certificate.certify_loop(loop, {"light": loop, "heavy": heavy.axis}, radius=points)
    assert [each["name"] for each in found.document["plants"]] == ["light", "heavy"]
    for to, r in radius_steps(points, 5000.0):
        assert r >= np.interp(np.log(to), np.log([p[0] for p in points]), [p[1] for p in points]) - 1e-12
    assert len(found.verify()) == 2


def test_a_disc_for_each_encoder_is_as_sharp() -> None:
    """|1 + L| > r₁|C₁P₁| + r₂|C₂P₂| is proven up to a thousandth of where it ends, though it is no polynomial."""
    loop = fd.read_machine("ball_screw").loop("x")
    found = fd.certificate.certify_loop(loop, {"both": measured(loop, 0.0)}, radius=0.1, beyond=0.1)
    plant = found.document["plants"][0]
    assert plant["discs"] == "each"
    one = found.loops["both"]
    f = np.geomspace(1.0, 9999.0, 20_000)
    gains = one.gains(f)
    least = np.min(np.abs(1.0 + gains.sum(axis=0)) / np.abs(gains).sum(axis=0)) / 0.1
    assert found.reserve == pytest.approx(least, rel=1e-3)
    wide = {**plant, "reserve": 1.001 * plant["reserve"] / float(check.KEPT)}
    answers = check.polynomials(check.system(found.document["control"], "control"))
    with pytest.raises(check.RefusedError):
        check.proven(answers, wide, loop.sample_time, check.Work())


def measured(loop: fd.Loop, noise: float) -> list[fd.Loop | fd.FRF]:
    """The loop with responses of both encoders, each line with its own noise."""
    rng = np.random.default_rng(4)
    model = fd.linearize(loop, ["cut"], ["reading_motor", "reading_load"])
    f = np.arange(5.0, 1000.0, 5.0)
    found: list[fd.Loop | fd.FRF] = [loop]
    for output in ("reading_load", "reading_motor"):
        P = model.response(f, output=output).response
        s = noise * np.abs(P)
        G = P + s * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / math.sqrt(2.0)
        found.append(fd.FRF(f, G, "force", output, "m/N", float(loop.sample_time), None, s**2))
    return found


@pytest.mark.parametrize("known", [True, False], ids=["machine", "fitted"])
def test_measured_lines_lie_in_their_discs(known: bool) -> None:
    """1 % of noise: around the true plant r is the noise at the confidence, around a fit a little more."""
    loop = fd.read_machine("ball_screw").loop("x")
    every = measured(loop, 0.01)
    found = fd.certificate.certify_loop(loop, {"lines": every if known else every[1:]}, radius=0.0)
    r = np.array([band["r"] for band in found.document["plants"][0]["radius"]])
    sure = deviations(2 * every[1].frequency.size, 0.95)  # type: ignore[union-attr]
    assert np.min(r) >= 0.01 * sure * 0.98
    # Rayleigh errors of a line are below 3.2 √variance with all 398 lines at 98 %; steps add up to 15 %
    assert np.max(r[:-1]) < 0.01 * (sure + 3.2) * 1.2 * (1.0 if known else 1.3)
    assert np.all(r[-1] == 1.0) or np.all(r[-1] >= 1.0)
    assert found.reserve is not None
    assert found.reserve > 5.0
    assert "lower the gains" not in found.sentence()


def test_a_line_outside_of_every_model_makes_its_disc_wide() -> None:
    """A resonance that the machine file does not know: the disc there reaches it, and the refusal names the band."""
    loop = fd.read_machine("linear_motor").loop("x")
    f = np.arange(5.0, 1500.0, 5.0)
    P = fd.linearize(loop, ["cut"], ["reading_load"]).response(f)
    s, w = 2j * np.pi * f, 2.0 * np.pi * 200.0
    extra = 1.0 + 6.0 * s * s / (s * s + 0.04 * w * s + w * w)
    frf = fd.FRF(f, P.response * extra, "force", "reading_load", "m/N", float(loop.sample_time), None, 0.0 * f)
    with pytest.raises(NotCertifiedError, match=r"fit the plant better around .* with --fit from the lines alone"):
        fd.certificate.certify_loop(loop, {"other": [loop, frf]})


def test_a_response_with_the_wrong_sign_is_named() -> None:
    """A force that pushes backward: the loop drifts away, and lower gains would not help."""
    loop = fd.read_machine("linear_motor").loop("x")
    f = np.arange(5.0, 1500.0, 5.0)
    P = fd.linearize(loop, ["cut"], ["reading_load"]).response(f)
    frf = fd.FRF(
        f, -P.response, "force", "reading_load", "m/N", float(loop.sample_time), None, 1e-6 * np.abs(P.response) ** 2
    )
    with pytest.raises(NotCertifiedError, match=r"a drift grows .* multiply the response by -1"):
        fd.certificate.certify_loop(loop, {"backward": [frf]})


def test_the_certificate_shows_itself() -> None:
    found = fd.certificate.certify_loop(fd.read_machine("emps").loop("x"))
    assert "stable for 1 plant" in str(found)
    assert found.plot() is not None
    assert list(found.to_pandas().columns) == ["reserve", "frequency", "largest_pole"]
    assert any("saturation" in text for text in found.outside)
    assert any("friction" in text for text in found.outside)


def test_laws_of_the_field_are_certified() -> None:
    """A disturbance observer of two poles, linear ADRC, stops, and a repetitive control of a short period."""
    loop, blocks = fd.read_machine("linear_motor").loop("x"), fd.blocks
    observer = blocks.DisturbanceRecovery(mass=40.0, viscous=60.0, form="two_poles", frequency=200.0, delay_samples=2)
    stops = blocks.FrictionStops(width=np.array([1e-6, 1e-5]), stiffness=np.array([1e7, 2e6]))
    repeats = fd.learning.tune_repetitive(loop, 14 * loop.sample_time, passes=3).block
    rejection = blocks.DisturbanceRejection(observer=observer)
    for change, states in (
        ({"law": blocks.CascadePPI(Kv=300.0, Kp=12e3), "compensation": (rejection,)}, 8),
        ({"law": blocks.LinearADRC(mass=40.0, omega_c=200.0, omega_o=1200.0, delay_samples=2), "feedforward": ()}, 7),
        ({"feedforward": (stops,)}, 4),
        ({"compensation": (repeats,)}, 21),
    ):
        found = fd.certificate.certify_loop(replace(loop, control=replace(loop.control, **change)), radius=0.05)
        assert len(found.document["control"]["A"]) == states
