"""Certificates of laws with two rates: true for what lies in the discs, with bounds that hold, refused when wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.certificate import check
from feeddrive.certificate.certificate import Certificate, LoopResponse
from feeddrive.language.errors import NotCertifiedError, ParameterError
from feeddrive.loop.linearize import loop_gain

Document = dict[str, Any]


def two_rates(name: str, every: int, **changed: float) -> fd.Loop:
    """A bundled machine with its position loop in every so many samples."""
    loop = fd.read_machine(name).loop(None)
    return replace(loop, control=replace(loop.control, law=replace(loop.control.law, position_every=every, **changed)))


@pytest.fixture(scope="module")
def loop() -> fd.Loop:
    """EMPS, its position loop every 4 ms."""
    return two_rates("emps", 4)


@pytest.fixture(scope="module")
def found(loop: fd.Loop) -> Certificate:
    return fd.certificate.certify_loop(loop, arithmetic="float32")


def random_lifted(seed: int, every: int) -> tuple[check.Lifted, np.ndarray]:
    """A random loop whose samples differ, exactly lifted, and its product A in floats."""
    rng = np.random.default_rng(seed)
    n, m = 3, 2

    def drawn(states: int, through: float) -> dict[str, list[list[float]]]:
        A, B, C = (rng.standard_normal(size) for size in ((states, states), (states, 1), (1, states)))
        D = through * rng.standard_normal((1, 1))
        return {name: x.tolist() for name, x in zip("ABCD", (0.42 * A, 0.2 * B, C, D), strict=True)}

    plant, samples = drawn(m, 0.0), [drawn(n, 0.2) for _ in range(every)]
    product = np.eye(n + m)
    P = {name: np.array(x) for name, x in plant.items()}
    for each in samples:
        C = {name: np.array(x) for name, x in each.items()}
        closed = np.block([[C["A"], C["B"] @ P["C"]], [P["B"] @ C["C"], P["A"] + P["B"] @ C["D"] @ P["C"]]])
        product = closed @ product
    return check.lifted(samples, plant), product


def test_a_law_with_one_rate_told_as_three_equal_samples_has_the_same_discs() -> None:
    """No image is coupled to another: Σ|H| = |L/(1 + L)|, so the reserve of one rate holds to the checker's 0.2 %."""
    one = fd.certificate.certify_loop(fd.read_machine("emps").loop("x"))
    document = json.loads(one.text())
    control = document["control"]
    control["samples"] = [{name: control.pop(name) for name in "ABCD"}] * 3
    three = Certificate.of({name: value for name, value in document.items() if name != "sha256"})
    assert "r sum|H| < 1" in three.verify()[0]
    assert three.two_rates
    f = np.geomspace(1.0, 499.0, 300)
    a, b = one.loops["model"], three.loops["model"]
    assert b.size(f) == pytest.approx(a.size(f), rel=1e-9, abs=1e-10)  # the other images are rounding
    assert b.gains(f)[0] == pytest.approx(a.gains(f).sum(axis=0), rel=1e-9, abs=1e-10)
    wider = json.loads(three.text())
    wider["plants"][0]["reserve"] *= 1.003
    with pytest.raises(check.RefusedError, match=r"r Σ|reserve is not"):
        check.verified({**wider, "sha256": check.digest(wider)})


def test_the_loop_gain_is_that_of_the_analysis(loop: fd.Loop, found: Certificate) -> None:
    """The gain that a sine meets, from the rounded coefficients: to what float32 moves, 1e-6."""
    f = np.geomspace(0.5, 499.0, 80)
    bare = replace(loop, control=replace(loop.control, guard=None, force_limit=None))
    assert found.loops["model"].gains(f)[0] == pytest.approx(loop_gain(bare, f).response, rel=1e-5)


def test_checker_and_certificate_agree_on_every_image(found: Certificate) -> None:
    """Exactly lifted and solved with bounds, against numpy; at frequencies on both sides of each image's turn."""
    document = found.document
    control = check.prepared(document["control"], check.Work())
    model = check.system(document["plants"][0]["model"], "model")
    assert isinstance(control, list)
    lifted = check.lifted(control, model)
    f = np.linspace(0.3, 499.7, 41)
    sums = np.abs(found.loops["model"].images(f)).sum(axis=1)
    assert [check.image_sum(lifted, x, 1e-3) for x in f] == pytest.approx(sums.tolist(), rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("every", [2, 3, 5])
def test_the_exact_lift_is_the_product_of_the_samples(every: int) -> None:
    lifted, product = random_lifted(every, every)
    assert np.array(lifted.A) == pytest.approx(product, rel=1e-11, abs=1e-13)
    assert [len(line) for line in lifted.D] == list(range(every))


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_of_a_stretch_holds_and_is_of_second_order(seed: int) -> None:
    """No point within is above the bound, and where h is a tenth, what the bound adds at the center is a hundredth.

    Up to a factor of two, since the first order is what a straight line may add.
    """
    every = 2 + seed % 4
    lifted, _ = random_lifted(seed, every)
    rng = np.random.default_rng(seed)
    tried = 0
    for center in rng.uniform(0.2, 3.0, 6):
        added: list[float] = []
        for h in (2e-2, 2e-3):
            stretch = check.Stretch(lifted, float(center), h)
            if not stretch.fits:
                break
            for k in range(every):
                most = check.most_of(stretch, k, 0.0)
                inner = [check.Stretch(lifted, float(center + x), 0.0) for x in (-h, -0.6 * h, 0.3 * h, h)]
                values = [check.most_of(each, k, 0.0) for each in inner]
                assert max(values) <= most * (1.0 + 1e-9)
                assert check.most_of(stretch, k, 1e9) >= most * (1.0 - 1e-9)
                y0, y1, _ = stretch.forces(k)
                here = check.most_of(check.Stretch(lifted, float(center), 0.0), k, 0.0)
                added.append(most - max(values))
                assert here <= most
                assert len(y0) == len(y1) == every
        if len(added) == 2 * every:
            tried += 1
            wide, narrow = np.array(added[:every]), np.array(added[every:])
            assert np.all(narrow < 0.04 * wide + 1e-9)
    assert tried > 2


def one_state(a: float, every: int = 4) -> check.Lifted:
    """x' = a x over a period, moved by its first sample and read in its last."""
    silent = [[0.0]] * (every - 1)
    return check.Lifted([[a]], [[1.0], *silent], [*silent, [1.0]], [[0.0] * k for k in range(every)])


LATE = check.Lifted([[0.0]], [[0.0]] * 4, [[0.0]] * 4, [[], [1.0], [1.0, 1.0], [1.0, 1.0, 1.0]])


@pytest.mark.parametrize(
    ("lifted", "center", "h"),
    [(LATE, 1.0, 0.5), (one_state(0.0), 1.0, 0.3), (one_state(0.99), 0.0, 1e-3), (one_state(0.99), 0.0, 7.4e-3)],
    ids=["what goes through at once", "without a pole", "near a pole", "as near as is tried"],
)
def test_the_rest_is_at_least_what_a_straight_line_leaves(lifted: check.Lifted, center: float, h: float) -> None:
    """Loops of one term each, in which the bound cannot be far above: up to five times, near a pole too."""
    stretch = check.Stretch(lifted, center, h)
    assert stretch.fits
    M, one = np.array(stretch.M), np.ones(len(stretch.M))
    assert np.all((np.eye(len(M)) - M) @ stretch.bounded(one.tolist()) >= one)
    y0, y1, rest = stretch.forces(1)
    A, B, C = np.array(lifted.A), np.array(lifted.B), np.array(lifted.C)
    D = np.array([line + [0.0] * (4 - len(line)) for line in lifted.D])
    left: list[float] = []
    for t in (-h, h):
        turn = np.exp(1j * (center + t + 2.0 * np.pi) * np.arange(4) / 4)
        states = turn @ B / (np.exp(1j * (center + t)) - A[0])
        there = (C @ states + D @ turn) / turn
        left.append(float(np.linalg.norm(there - np.array(y0) - t * np.array(y1))))
    assert max(left) <= rest < 5.0 * max(left)


def perturbed(loop: LoopResponse, r: float, a: float, sign: float) -> float:
    """|z| over a period with P (1 + Δ), Δ = ± r (1 - a z)/(z - a), an all-pass of size r at the fast rate."""
    P, s, b = loop.plant, sign * r, loop.plant.B
    product = np.eye(len(P.states) + len(loop.samples[0].states) + 1)
    for C in loop.samples:
        K = C.D @ P.C
        product = (
            np.block(
                [
                    [P.A + b * (1.0 - s * a) @ K, b * (1.0 - s * a) @ C.C, b * s * (1.0 - a * a)],
                    [C.B @ P.C, C.A, np.zeros((len(C.states), 1))],
                    [K, C.C, np.array([[a]])],
                ]
            )
            @ product
        )
    return float(np.max(np.abs(np.linalg.eigvals(product))))


@pytest.mark.parametrize(("name", "every"), [("emps", 4), ("linear_motor", 3)])
def test_what_is_certified_holds_for_plants_in_the_discs_and_hardly_further(name: str, every: int) -> None:
    """All-passes of the proven size leave the loop stable; one of 1.04 times it, turned to the worst, does not.

    The norm of columns is wider than needed by what couples the images: 1.6 % for EMPS, less for the linear motor.
    """
    made = fd.certificate.certify_loop(two_rates(name, every))
    one, reserve = made.loops["model"], made.reserve
    assert reserve is not None
    r = 0.2 * reserve
    rng = np.random.default_rng(0)
    for a in [*rng.uniform(-1.0, 1.0, 40), *(1.0 - 10.0 ** rng.uniform(-5.0, 0.0, 40))]:
        for sign in (1.0, -1.0):
            assert perturbed(one, 0.999 * r, float(a), sign) < 1.0
    place = made.document["plants"][0]["reserve_at_Hz"]
    z = np.exp(2j * np.pi * place * made.sample_time)
    wanted = 1.0 / one.images(np.array([place]))[0, 0]  # 1 - H Δ = 0
    grid = np.tanh(np.linspace(-9.0, 9.0, 40_001))
    off = [np.abs(np.angle(sign * (1.0 - grid * z) / (z - grid) / wanted)) for sign in (1.0, -1.0)]
    k = int(np.argmin([each.min() for each in off]))
    assert perturbed(one, 1.04 * r, float(grid[np.argmin(off[k])]), (1.0, -1.0)[k]) > 1.0


def changed(found: Certificate, change: Callable[[Document], None]) -> Document:
    document = json.loads(found.text())
    change(document)
    return {**document, "sha256": check.digest(document)}


def times(document: Document, sample: int, name: str, factor: float) -> None:
    matrix = document["control"]["samples"][sample][name]
    matrix[:] = [[(float.fromhex(x) * factor).hex() for x in line] for line in matrix]


def radii(document: Document, low: float, high: float, r: float) -> None:
    """0.2 everywhere but in one band; no reserve is claimed."""
    bands = [{"from_Hz": 0.0, "to_Hz": low, "r": [0.2]}, {"from_Hz": low, "to_Hz": high, "r": [r]}]
    bands += [{"from_Hz": high, "to_Hz": 500.0, "r": [0.2]}] if high < 500.0 else []
    document["plants"][0] |= {"radius": bands, "reserve": None}


def one_louder(document: Document) -> None:
    times(document, 2, "D", 1.2)


def all_louder(document: Document) -> None:
    for k in range(4):
        times(document, k, "C", 30.0)
        times(document, k, "D", 30.0)


def a_sample_less(document: Document) -> None:
    del document["control"]["samples"][1]


def a_sample_more(document: Document) -> None:
    document["control"]["samples"].append(document["control"]["samples"][1])


def another_order(document: Document) -> None:
    samples = document["control"]["samples"]
    samples[0], samples[1] = samples[1], samples[0]


def wider(document: Document) -> None:
    document["plants"][0]["radius"][0]["r"][0] *= 1.6


def a_wide_band(document: Document) -> None:
    radii(document, 18.0, 20.0, 0.33)


def at_an_image(document: Document) -> None:
    radii(document, 300.0, 310.0, 50.0)


def at_half_the_sample_rate(document: Document) -> None:
    radii(document, 499.0, 500.0, 1e9)


def a_narrow_band(document: Document) -> None:
    radii(document, 18.9, 18.901, 0.33)


def more_reserve(document: Document) -> None:
    document["plants"][0]["reserve"] *= 1.01


def less_reserve(document: Document) -> None:
    document["plants"][0]["reserve"] *= 0.98


def of_each(document: Document) -> None:
    document["plants"][0]["discs"] = "each"
    document["plants"][0]["radius"][0]["r"] *= 2


def without_states(document: Document) -> None:
    for name in "AB":
        document["control"]["samples"][0][name] = []
    document["control"]["samples"][0]["C"] = [[]]


def nothing(document: Document) -> None:
    document["control"]["samples"] = []


CHANGES = [
    (one_louder, "r Σ|reserve"),
    (all_louder, "nominal loop is not stable"),
    (a_sample_less, "r Σ|reserve|stable"),
    (a_sample_more, "r Σ|reserve|stable"),
    (another_order, "r Σ|reserve|stable"),
    (wider, r"r Σ\|H\| is 1\.0\d* at 1\d\.\d* Hz"),
    (a_wide_band, r"r Σ\|H\| is 1\.\d* at 1[89]\.\d* Hz"),
    (at_an_image, r"r Σ\|H\| is .* at 30\d"),
    (at_half_the_sample_rate, r"r Σ\|H\| is .* at 499"),
    (a_narrow_band, r"r Σ\|H\| is 1\.0\d* at 18\.90"),
    (more_reserve, "r Σ|reserve"),
    (less_reserve, "reserve"),
    (of_each, "fit|one disc for all readings|length"),
    (without_states, "samples do not fit"),
]


@pytest.mark.parametrize(("change", "reason"), CHANGES, ids=[change.__name__ for change, _ in CHANGES])
def test_a_wrong_certificate_is_refused(change: Callable[[Document], None], reason: str, found: Certificate) -> None:
    """Even when its digest was made anew."""
    with pytest.raises(check.RefusedError, match=reason):
        check.verified(changed(found, change))


def test_a_copy_of_the_checker_in_an_empty_folder_proves_it(found: Certificate, tmp_path: Path) -> None:
    """One file is enough for two rates too; isolated from this package and from every other one."""
    (tmp_path / "loop.json").write_text(found.text())
    (tmp_path / "empty.json").write_text(json.dumps(changed(found, nothing)))
    folder = tmp_path / "empty"
    folder.mkdir()
    program = folder / "check.py"
    program.write_text(Path(check.__file__).read_text())
    assert "feeddrive" not in "".join(line for line in program.read_text().split("\n") if "import" in line)
    for file, proves in (("loop.json", True), ("empty.json", False)):
        command = [sys.executable, "-I", str(program), str(tmp_path / file)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert not done.stderr
        assert done.returncode == (0 if proves else 1)
        assert done.stdout.startswith("REFUSED: ") != proves
        assert ("PROVEN: plants: 1, coefficients: float32" in done.stdout) == proves


def test_what_cannot_be_certified_says_where_and_what_to_do(loop: fd.Loop) -> None:
    with pytest.raises(NotCertifiedError, match=r"at 18\.\d* Hz .* r = 0.5 .* at most 0\.317\d: lower the gains"):
        fd.certificate.certify_loop(loop, radius=0.5)
    with pytest.raises(NotCertifiedError, match=r"not stable: an oscillation of \d+\.\d* Hz grows"):
        fd.certificate.certify_loop(fd.vary(loop, {"axis.x.control.law.Kv": 400.0}))
    with pytest.raises(ParameterError, match="repeats itself every 65 samples"):
        fd.certificate.certify_loop(two_rates("emps", 65))


def test_the_certificate_shows_itself(found: Certificate) -> None:
    assert "max Σ|H|" in str(found)
    assert found.plot() is not None
    assert "det(1 - H Δ)" in found.document["theorem"]
