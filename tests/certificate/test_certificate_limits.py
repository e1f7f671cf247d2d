"""The limits within which plants are fitted and certificates are searched: a case on either side of each."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import feeddrive as fd
from feeddrive.certificate import check, systems
from feeddrive.certificate.certificate import LoopResponse, measured
from feeddrive.certificate.systems import Lines, NominalPlant, deployed, fitted_plant
from feeddrive.language.errors import NotCertifiedError, NotIdentifiableError
from feeddrive.loop.linearize import StateSpace


@pytest.fixture(scope="module")
def loop() -> fd.Loop:
    return fd.read_machine("linear_motor").loop("x")


@pytest.mark.parametrize(("reserve", "is_stated"), [(0.75e6, True), (1.5e6, False)])
def test_a_reserve_of_more_than_a_million_is_none(loop: fd.Loop, reserve: float, is_stated: bool) -> None:
    limit = fd.certificate.certify_loop(loop, radius=0.1).reserve
    assert limit is not None
    found = fd.certificate.certify_loop(loop, radius=0.1 * limit / reserve).reserve
    assert found == pytest.approx(reserve, rel=1e-3) if is_stated else found is None


@pytest.mark.parametrize(("peaks", "is_certified"), [(4, True), (5, False)])
def test_four_peaks_between_the_lines_of_the_search_are_tried(
    loop: fd.Loop, monkeypatch: pytest.MonkeyPatch, peaks: int, is_certified: bool
) -> None:
    """The checker names one peak at a time, by whose frequency the search is repeated."""
    verified, left = check.verified, [100.0 * k for k in range(1, peaks + 1)]

    def with_peaks(document: Any) -> list[str]:
        if left:
            raise check.RefusedError("a peak", left.pop())
        return verified(document)

    monkeypatch.setattr(check, "verified", with_peaks)
    if is_certified:
        assert fd.certificate.certify_loop(loop).reserve
    else:
        with pytest.raises(NotCertifiedError, match="a peak"):
            fd.certificate.certify_loop(loop)


def test_the_limiting_frequency_is_found_to_seven_digits() -> None:
    """k/(z² - z + k), an integrator with a sample of dead time, has a sharp peak for k just below 1."""
    T, k = 1e-3, 0.95
    plant = StateSpace(
        np.array([[1.0, 1.0], [0.0, 0.0]]),
        np.array([[0.0], [1.0]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
        T,
        ("a", "b"),
        ("cut",),
        ("reading_load",),
    )
    control = StateSpace(
        np.zeros((0, 0)),
        np.zeros((0, 1)),
        np.zeros((1, 0)),
        np.array([[-k]]),
        T,
        (),
        ("reading_load",),
        ("force",),
    )
    found = LoopResponse(control, plant, [{"from_Hz": 0.0, "to_Hz": 500.0, "r": [0.01]}]).reserve()

    def room(f: float) -> float:
        z = np.exp(2j * np.pi * f * T)
        return abs(z * z - z + k) / k

    peak = minimize_scalar(room, bounds=(150.0, 180.0), method="bounded", options={"xatol": 1e-9})
    assert found[1] == pytest.approx(peak.x, rel=1e-7)
    assert found[0] == pytest.approx(100.0 * peak.fun, rel=1e-9)


@pytest.mark.parametrize(("ratio", "steps"), [(1.1, 1), (1.2, 2)])
def test_neighboring_lines_whose_radii_differ_by_less_than_15_percent_share_a_step(
    loop: fd.Loop, ratio: float, steps: int
) -> None:
    """Of the steps only those between the lines: beyond the last one the radius is another."""
    model = fd.linearize(loop, ["cut"], ["reading_load"])
    f = np.array([50.0, 100.0, 150.0, 200.0])
    response = model.response(f).response
    lines = Lines(f, response * (1.0 + 0.1 * np.array([1.0, 1.0, ratio, ratio])), 0.0 * f)
    plant = NominalPlant("x", model, (lines,), "", 0.0)
    found = measured(plant, 1.0, 0.0, 5.0, 0.5 / float(loop.sample_time))[0]
    assert len([to for to, _ in found if to <= 200.0]) == steps


@pytest.mark.parametrize(("share", "is_named"), [(0.0075, False), (0.015, True)])
def test_a_number_that_rounding_changes_by_more_than_a_percent_is_named(
    loop: fd.Loop, share: float, is_named: bool
) -> None:
    """With 16 binary places n + ½ of them becomes n."""
    gain = (round(0.5 / share / 2.0) * 2 + 0.5) * 2.0**-16
    law = replace(loop.control.law, Kv=gain)
    found = deployed(replace(loop.control, law=law), float(loop.sample_time), "fixed16")
    assert ("control.law.Kv" in found.coarse) == is_named


def fitted(
    loop: fd.Loop, monkeypatch: pytest.MonkeyPatch, factor: float = 1.0, off: float = 1.0, noise: float = 0.0
) -> tuple[int, dict[str, Any]]:
    """Fit 2000 lines where each mode changes the misfit by a factor, to a model that is off by another.

    Returns the number of modes, and the lines and weights of the fit.
    """
    model, fit = fd.linearize(loop, ["cut"], ["reading_load"]), dict[str, Any]()

    def refined(f: Any, G: Any, weight: Any, T: float, count: int) -> tuple[float, np.ndarray]:
        fit.update(lines=f, weight=weight * np.abs(G))
        return factor**count, np.zeros(2 * count + 2)

    monkeypatch.setattr(systems, "_refined", refined)
    monkeypatch.setattr(systems, "_sampled", lambda *_: replace(model, C=off * model.C))
    f = np.arange(1.0, 2001.0)
    P = model.response(f).response
    frf = fd.FRF(f, P, "force", "reading_load", "m/N", float(loop.sample_time), None, (noise * np.abs(P)) ** 2)
    return fitted_plant("x", [frf], float(loop.sample_time))[2], fit


@pytest.mark.parametrize(("factor", "modes"), [(0.9, 0), (0.8, 8)])
def test_a_mode_must_take_15_percent_of_the_misfit_and_there_are_eight(
    loop: fd.Loop, monkeypatch: pytest.MonkeyPatch, factor: float, modes: int
) -> None:
    assert fitted(loop, monkeypatch, factor)[0] == modes


def test_a_fit_takes_some_250_lines_spread_evenly_over_the_logarithm(
    loop: fd.Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where there are enough: from 100 of the 2000 lines on neighbors are at the same ratio, 2000^(1/249)."""
    f = fitted(loop, monkeypatch)[1]["lines"]
    ratios = np.diff(np.log(f[f > 100.0]))
    assert np.mean(ratios) == pytest.approx(np.log(2000.0) / 250.0, rel=0.1)
    assert np.max(ratios) < 2.0 * np.mean(ratios)


@pytest.mark.parametrize(("noise", "least"), [(0.0, 0.01), (1e-3, 0.01), (0.1, 0.1)])
def test_less_noise_than_a_percent_does_not_count_more(
    loop: fd.Loop, monkeypatch: pytest.MonkeyPatch, noise: float, least: float
) -> None:
    weight = fitted(loop, monkeypatch, noise=noise)[1]["weight"]
    np.testing.assert_allclose(1.0 / weight, least, rtol=0.01)


@pytest.mark.parametrize(("off", "fits"), [(1.4, True), (1.6, False)])
def test_a_model_that_misses_the_lines_by_half_is_none(
    loop: fd.Loop, monkeypatch: pytest.MonkeyPatch, off: float, fits: bool
) -> None:
    if fits:
        assert fitted(loop, monkeypatch, off=off)[0] == 0
    else:
        with pytest.raises(NotIdentifiableError, match="no model with up to"):
            fitted(loop, monkeypatch, off=off)


def slow_pole(decay: float) -> check.Lifted:
    """1e-1 decay/(z - 1 + decay): at most 0.1 on the unit circle, within an angle of its own decay."""
    return check.Lifted([[1.0 - decay]], [[1.0]], [[0.1 * decay]], [[]])


def test_a_peak_is_covered_down_to_the_rounding_of_its_angle() -> None:
    """A decay of 1e-8 needs intervals of 1e-8 rad, thirty times halved; one of 1e-15 is lost in rounding."""
    T = 1e-3
    bands = check.Bands([{"from_Hz": 0.0, "to_Hz": 500.0, "r": [1.0]}], 1, T)
    assert check.separated_with_images(slow_pole(1e-8), bands, 1.0, check.Work()) > 1
    with pytest.raises(check.RefusedError, match="cannot be shown"):
        check.separated_with_images(slow_pole(1e-15), bands, 1.0, check.Work())


def test_an_interval_is_never_tried_where_the_bound_of_its_inverse_does_not_hold() -> None:
    """(I - M)⁻¹ is a bound only for a spectral radius of M below 1; h |R| alone is 1.2 here."""
    loop = slow_pole(1e-2)
    assert check.Stretch(loop, 0.0, 0.5e-2).fits
    assert not check.Stretch(loop, 0.0, 1.2e-2).fits


def dense(states: int, spread: float) -> dict[str, Any]:
    """A certificate whose control has a dense matrix with numbers of 2^-spread to 2^spread."""
    draw = np.random.default_rng(states)
    document = json.loads(fd.certificate.certify_loop(fd.read_machine("emps").loop("x")).text())
    control, readings = document["control"], len(document["control"]["readings"])
    sizes = {"A": (states, states), "B": (states, readings), "C": (1, states), "D": (1, readings)}
    for name, size in sizes.items():
        values = draw.normal(size=size) * 2.0 ** draw.uniform(-spread, spread, size)
        control[name] = [[float(x).hex() for x in row] for row in values]
    control["states"] = [f"s{k}" for k in range(states)]
    return {**document, "sha256": check.digest(document)}


@pytest.mark.parametrize(("spread", "begins"), [(50.0, True), (80.0, False)])
def test_a_proof_that_would_take_minutes_is_refused_before_it_begins(
    monkeypatch: pytest.MonkeyPatch, spread: float, begins: bool
) -> None:
    def begun(*_: Any) -> None:
        raise ArithmeticError("the proof has begun")

    document = dense(60, spread)
    monkeypatch.setattr(check, "polynomials", begun)
    assert len(json.dumps(document)) > 90_000
    if begins:
        with pytest.raises(ArithmeticError, match="the proof has begun"):
            check.verified(document)
        return
    with pytest.raises(check.RefusedError, match=r"the polynomial of the control takes \d\.\de\+10 steps"):
        check.verified(document)


def spent(document: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> float:
    """The steps that a check counts."""
    kept = list[check.Work]()

    class Counted(check.Work):
        def __init__(self) -> None:
            super().__init__()
            kept.append(self)

    with monkeypatch.context() as patch, suppress(check.RefusedError):
        patch.setattr(check, "Work", Counted)
        check.verified(document)
    return check.WORK - kept[0].left


def test_the_counted_steps_follow_the_work(loop: fd.Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = (spent(dense(states, 0.0), monkeypatch) for states in (8, 16))
    # n multiplications of n^3 products, the numbers of which grow with n: between n^3 and n^5
    assert 8.0 < large / small < 32.0
    # what is bundled takes less than a thousandth of what a check may take
    plain = fd.certificate.certify_loop(loop)
    assert 0.0 < spent(dict(plain.document), monkeypatch) < 1e-3 * check.WORK


def test_a_bisection_ends_when_its_steps_are_used_up(loop: fd.Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    document = dict(fd.certificate.certify_loop(loop).document)
    needed = spent(document, monkeypatch)
    for share, proves in ((0.9, False), (1.1, True)):
        monkeypatch.setattr(check.Work, "__init__", lambda self, most=share * needed: setattr(self, "left", most))
        if proves:
            assert len(check.verified(document)) == 1
        else:
            with pytest.raises(check.RefusedError, match="cannot be shown near"):
                check.verified(document)
