"""The file of a proof over a box: accepted by a checker of the standard library alone, refused once it is damaged."""

from __future__ import annotations

import cmath
import json
import math
import subprocess
import sys
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.certificate import box_check, box_proof
from feeddrive.certificate.box_proof import document, prove_over_box
from feeddrive.certificate.systems import deployed
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import Box
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop
from feeddrive.workflow.certify import CertifyRequest, certify
from feeddrive.workflow.check import CheckRequest, check
from independent_box import box_draws

Document = dict[str, Any]
PEAK = 2.35  # 4 % above the largest Ms of the motor over its box
ONE = box_check.ONE


def two_masses(dead_samples: float = 0.4, bandwidth: float | None = 800.0) -> Loop:
    T = 2e-4
    plant = TwoMass(mass_motor=40.0, mass_load=90.0, stiffness=5e7, damping=900.0, viscous_load=50.0)
    axis = Axis(
        plant=plant,
        actuator=Actuator(dead_time=dead_samples * T, current_loop=bandwidth),
        encoder_motor=Encoder(),
        encoder_load=Encoder(),
    )
    return Loop(control=Control(law=CascadePPI(Kv=40.0, Kp=20_000.0, Tn=0.03)), axis=axis, sample_time=T)


def written(loop: Loop, box: Box, peak: float | None) -> Document:
    proof = prove_over_box(loop, box, sensitivity_peak=peak)
    assert proof.proven, proof.sentence()
    return json.loads(json.dumps(document(proof)))


@pytest.fixture(scope="module")
def motor() -> Document:
    """One mass, so near to its bound that cells are halved along it and along the frequency."""
    loop = fd.read_machine("linear_motor").loop("x")
    lagged = replace(loop.axis, actuator=replace(loop.axis.actuator, current_loop=900.0))
    return written(replace(loop, axis=lagged), Box(0.0, 0.3, 0), PEAK)


@pytest.fixture(scope="module")
def table() -> Document:
    """Two masses and a spring, each of them halved; two readings, a current loop, part of a sample of dead time."""
    return written(two_masses(), Box(0.1, 0.1, 0), 1.8)


def signed(content: Document) -> Document:
    return {**content, "sha256": box_check.digest(content)}


def test_a_file_of_a_proof_is_accepted(table: Document) -> None:
    sentences = box_check.verified(table)
    assert sentences[0].startswith("stable and Ms <= 1.8 at every plant: mass_motor 36.0 to 44.0; mass_load 81.0 to ")
    assert sentences[0].endswith("; 0 to 0 more samples of dead time")
    assert {-1, -2, -3, -4} == {code for tree in table["trees"] for code in tree if code < 0}


def test_a_copy_of_the_checker_alone_proves_a_file(motor: Document, tmp_path: Path) -> None:
    """Isolated from this package and from every other one: the file imports the standard library alone."""
    program, file = tmp_path / "alone.py", tmp_path / "proof.json"
    program.write_text(Path(box_check.__file__).read_text(encoding="utf-8"), encoding="utf-8")
    assert "feeddrive." not in "".join(line for line in program.read_text().split("\n") if "import" in line)
    file.write_text(json.dumps(motor), encoding="utf-8")
    done = subprocess.run([sys.executable, "-I", str(program), str(file)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    claim, count, _, verdict = done.stdout.splitlines()
    assert claim == f"stable and Ms <= {PEAK} at every plant: mass 28.0 to 52.0; 0 to 0 more samples of dead time"
    halvings = [code for tree in motor["trees"] for code in tree if code < 0]
    assert {-1, -2} == set(halvings)
    assert count == f"{motor['cells'] - len(halvings)} cells"
    assert verdict == "PROVEN"
    file.write_text(json.dumps({**motor, "sensitivity_peak": 2.0}), encoding="utf-8")
    outcome = check.run(CheckRequest(file))
    assert outcome.result is False
    assert "its digest is another one" in str(outcome.tables[-1])


def scaled(path: str, factor: float) -> Callable[[Document], None]:
    *parents, last = path.split(".")

    def change(content: Document) -> None:
        part: Any = content
        for name in parents:
            part = part[int(name)] if isinstance(part, list) else part[name]
        place = int(last) if isinstance(part, list) else last
        part[place] *= factor

    return change


def set_to(**values: Any) -> Callable[[Document], None]:
    return lambda content: content.update(values)


def longest(content: Document) -> list[int]:
    return max(content["trees"], key=len)


def shallower(content: Document) -> None:
    """Take a halving away: the direction of its first leaf for the whole cell."""
    tree = longest(content)
    i = next(i for i in range(len(tree)) if tree[i] < 0 <= min(tree[i + 1], tree[i + 2]))
    tree[i : i + 3] = [tree[i + 1]]


def no_second_half(content: Document) -> None:
    longest(content).pop()


def leaf_too_many(content: Document) -> None:
    longest(content).append(longest(content)[-1])


def other_direction(content: Document) -> None:
    tree = longest(content)
    tree[-1] = (tree[-1] + 2 * content["directions"]) % (4 * content["directions"])


def no_interval(content: Document) -> None:
    i = content["trees"].index(longest(content))
    del content["frequencies_rad_s"][i], content["trees"][i]


@pytest.mark.parametrize(("change", "said"), [
    (set_to(sensitivity_peak=2.26), "is not proven"),
    (set_to(sensitivity_peak=0.99), "the bound on Ms must be above 1"),
    (scaled("uncertain.0.to", 1.1), "is not proven"),
    (scaled("uncertain.0.from", 0.9), "is not proven"),
    (scaled("uncertain.0.from", 2.0), "its ends are not in order"),
    (scaled("uncertain.0.factor", 1.2), "is not proven"),
    (scaled("uncertain.0.factor", -1.0), "no positive mass"),
    (scaled("control.D.0.0", 1.05), "is not proven"),
    (scaled("control.C.0.0", 1.05), "is not proven|unstable"),
    (scaled("control.A.1.1", 1.05), "is not proven|unstable"),
    (scaled("plant.force.0", 1.05), "is not proven"),
    (scaled("plant.force.0", -1.0), "unstable"),
    (scaled("plant.current_loop_rad_s", 0.7), "is not proven"),
    (scaled("plant.dead_time_s", 1.2), "is not proven"),
    (scaled("sample_time_s", 1.2), "is not proven|end below|go on beyond|unstable"),
    (set_to(late_samples=1), "trees: one is needed"),
    (no_interval, "is not proven"),
    (lambda content: (content["frequencies_rad_s"].pop(), content["trees"].pop()), "end below that of Nyquist"),
    (lambda content: (content["frequencies_rad_s"].pop(0), content["trees"].pop(0)), "the frequencies do not rise"),
    (lambda content: content["trees"].pop(3), "trees: one is needed"),
    (no_second_half, "cells are missing"),
    (leaf_too_many, "goes on behind its last cell"),
    (shallower, "is not proven"),
    (other_direction, "is not proven"),
    (lambda content: longest(content).__setitem__(0, -3), "there is no parameter"),
    (lambda content: longest(content).__setitem__(0, 4000), "is no direction"),
    (lambda content: content["control"]["D"][0].__setitem__(0, math.nan), "no number"),
    (lambda content: content["control"]["D"][0].__setitem__(0, 1e-200), "out of range"),
    (lambda content: content["uncertain"][0].update(adds_to="damping"), "neither mass nor stiffness"),
    (set_to(verdict="undecided"), "its verdict is not proven"),
])  # fmt: skip
def test_each_kind_of_damage_is_refused(motor: Document, change: Callable[[Document], Any], said: str) -> None:
    changed = deepcopy(motor)
    change(changed)
    with pytest.raises(box_check.RefusedError, match="its digest is another one"):
        box_check.verified(changed)
    with pytest.raises(box_check.RefusedError, match=said):
        box_check.verified(signed(changed))


def test_a_plant_that_resonates_between_the_images_is_refused(table: Document) -> None:
    """Far above the sample rate, where the images of a resonance would be missed."""
    changed = deepcopy(table)
    for name in ("from", "to"):
        changed["uncertain"][2][name] *= 300.0
    with pytest.raises(box_check.RefusedError, match=r"is not proven|may have a pole|beyond two sample rates"):
        box_check.verified(signed(changed))
    # the mode lies at about 4.65 rad per sample, of which 1.63 is an image
    control = box_check.control_of(changed["control"])
    bodies = box_check.bodies_of(changed, control.readings)
    cells = box_check.Cells(bodies, control, None)
    frequencies = box_check.Frequencies(bodies, control, cells.degree, cells.largest, 0)
    beside, there = (
        frequencies.at(*(box_check.fixed(Fraction(x)) for x in ends)) for ends in ((0.5, 0.501), (1.63, 1.631))
    )
    assert all(tail < ONE for tail in cells.tails(cells.corners, beside))
    with pytest.raises(box_check.RefusedError, match="an image of the cell may have a pole"):
        cells.tails(cells.corners, there)


@pytest.mark.parametrize("content", [
    b"", b"[]", b'{"format": "feeddrive box proof, version 1"}', b"\xff", b'{"format": 1e999}', b"[" * 100_000,
    b'{"format": "feeddrive box proof, version 1", "sha256": 0, "verdict": "proven"}',
])  # fmt: skip
def test_what_is_built_otherwise_is_refused_without_a_traceback(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "proof.json"
    file.write_bytes(content)
    sentences, proven = box_check.checked(str(file))
    assert not proven
    assert sentences[-1].startswith("REFUSED: ")
    assert "Error" not in sentences[-1] or content[:1] == b"["
    assert box_check.checked(str(tmp_path / "none.json"))[1] is False


@pytest.mark.parametrize("entry", ["sha256", "verdict", "control", "late_samples", "frequencies_rad_s", "outside"])
def test_an_entry_that_is_missing_is_named(motor: Document, entry: str, tmp_path: Path) -> None:
    """A file without its digest ended in a KeyError."""
    without = {key: value for key, value in motor.items() if key != entry}
    file = tmp_path / "proof.json"
    file.write_text(json.dumps(without if entry == "sha256" else signed(without)), encoding="utf-8")
    said = f"REFUSED: {file}: its entry '{entry}' is missing: take the file as feeddrive certify --box wrote it, or "
    assert box_check.checked(str(file))[0][-1].startswith(said)


def test_every_function_of_frequency_is_within_its_bounds(table: Document) -> None:
    """D, Nᵢ G, den and numᵢ of the checker against complex floats, at frequencies drawn from intervals of all sizes."""
    control = box_check.control_of(table["control"])
    bodies = box_check.bodies_of(table, control.readings)
    cells = box_check.Cells(bodies, control, None)
    random = np.random.default_rng(5)
    T, lag = float(bodies.T), float(bodies.lag or 0)
    values = [random.uniform(float(p.low), float(p.high)) for p in bodies.parameters]
    model = StateOf(table)
    exact = [[float(x) for x in p] for p in bodies.polynomials([Fraction(x) for x in values])]
    unit = float(bodies.polynomials([p.low for p in bodies.parameters])[0][-1])
    corner = tuple(tuple(box_check.fixed(Fraction(x / unit), box_check.BITS + box_check.DEEP) for x in p)
                   for p in ([*part, *[0.0] * (5 - len(part))] for part in exact))  # fmt: skip
    for low, high in ((0.0, 1e-6), (1e-4, 1.4e-4), (0.003, 0.01), (0.5, 0.6), (2.9, math.pi), (3.0, 3.0001)):
        frequencies = box_check.Frequencies(bodies, control, cells.degree, cells.largest, 1)
        here = frequencies.at(*(box_check.fixed(Fraction(x)) for x in (low, high)))
        middle = 0.5 * (low + high)
        for theta in random.uniform(low, high, 10):
            z, s = cmath.exp(1j * theta), 1j * theta
            G = (1.0 - cmath.exp(-s)) / s * cmath.exp(-s * (float(bodies.delay) + 1.0)) * lag / (lag + s)
            D, N = model.at(z)
            found = [(here.D, D), *zip(here.drives, [n * G for n in N], strict=True)]
            found += [
                (here.main.line(p), sum(x * s**k for k, x in enumerate(q)) / unit)
                for p, q in zip(corner, exact, strict=True)
            ]
            for line, true in found:
                said = complex(line.re, line.im) / ONE + complex(line.slope_re, line.slope_im) / ONE * (theta - middle)
                # 1e-9: the floats with which it is compared
                assert abs(said - true) <= line.rest / ONE + 1e-9 * (abs(true) + abs(said))
                assert abs(true) <= line.most(here.delta) / ONE * (1.0 + 1e-9)
        # what an image adds is not more than its bound
        for (image, gain), k in zip(here.images, (-2, -1, 1, 2), strict=True):
            there = abs(middle + 2.0 * math.pi * k)
            s = 1j * there
            G = (1.0 - cmath.exp(-1j * middle)) / s * lag / (lag + s)
            assert abs(G) <= gain / ONE * (1.0 + 1e-9)
            assert image.theta / ONE == pytest.approx(there, rel=1e-12)
        # all images together, of which the bound takes 5 more: that of an interval of no width is sharp
        rates = middle + 2.0 * math.pi * np.array([k for k in range(-3000, 3001) if k])
        hold = abs(1.0 - cmath.exp(-1j * middle)) / np.abs(rates) * lag / np.abs(lag + 1j * rates)
        values = [np.abs(np.polyval(p[::-1], 1j * rates)) for p in exact]
        for i, bound in enumerate(cells.tails([corner], here)):
            images = float(np.sum(hold * values[1 + i] / values[0]))
            assert images <= bound / ONE * (1.0 + 1e-9)
            if low == 3.0:
                assert bound / ONE < 1.2 * images
    assert T == 2e-4


@pytest.mark.parametrize(("dead", "bandwidth"), [(0.0, None), (30.4, None), (0.4, 300.0)])
def test_the_drive_alone_is_within_its_bounds(dead: float, bandwidth: float | None) -> None:
    """G without the control, whose own rest would hide that of the hold, of the dead time or of the current loop."""
    loop = two_masses(dead, bandwidth)
    model = deployed(loop.control, float(loop.sample_time)).model
    assert isinstance(model, StateSpace)
    content = box_proof.stated(loop, Box(0.1, 0.1, 0), model)
    control = box_check.control_of(content["control"])
    bodies = box_check.bodies_of(content, control.readings)
    frequencies, lag, sharp = box_check.Frequencies(bodies, control, 4, ONE, 0), float(bodies.lag or 0), list[float]()
    for low, high in ((0.0, 0.2), (1e-3, 2e-3), (0.5, 0.6), (2.9, math.pi)):
        first, last = (box_check.fixed(Fraction(x)) for x in (low, high))
        theta = (first + last) // 2
        delta, half = max(last - theta, theta - first), box_check.turned(theta // 2)
        line = frequencies._drive(theta, half._replace(radius=half.radius + 1), delta)
        for x in np.linspace(low, high, 9)[[*range(4), *range(5, 9)]].tolist():
            s = 1j * (x or 1e-12)
            G = (1.0 - cmath.exp(-s)) / s * cmath.exp(-s * dead) * (lag / (lag + s) if lag else 1.0)
            straight = complex(line.re, line.im) / ONE + complex(line.slope_re, line.slope_im) / ONE * (
                x - 0.5 * (low + high)
            )
            # 1e-13: of the floats with which it is compared; the difference of 1 and e^-s near 0 is known to 1e-4
            assert abs(straight - G) <= line.rest / ONE * (1.0 + 1e-9) + (1e-13 if x > 0.0 else 2e-4)
            sharp.append(abs(straight - G) * ONE / line.rest)
    assert max(sharp) > 0.4


def test_what_the_images_may_add_is_taken_from_every_cell(motor: Document, monkeypatch: pytest.MonkeyPatch) -> None:
    tails = box_check.Cells.tails
    monkeypatch.setattr(box_check.Cells, "tails", lambda *cell: [50 * tail for tail in tails(*cell)])
    with pytest.raises(box_check.RefusedError, match="is not proven"):
        box_check.verified(motor)


def test_lines_of_the_checker_bound_every_product() -> None:
    """Numbers anywhere within the rests, at places of an interval, against floats: no bound leaves the rest out."""
    random = np.random.default_rng(8)
    delta, sharp = box_check.fixed(Fraction(3, 10)), [0.0, 0.0, 0.0]

    def line(value: complex, slope: complex, rest: float) -> box_check.Line:
        parts = (value.real, value.imag, slope.real, slope.imag, rest)
        return box_check.Line(*(box_check.fixed(Fraction(x)) for x in parts))

    for _ in range(300):
        a, b, slope_a, slope_b = (random.normal(size=4) + 1j * random.normal(size=4)).tolist()
        rests = np.abs(random.normal(size=2)).tolist()
        first = line(a, slope_a, rests[0])
        found = first.times(line(b, slope_b, rests[1]), delta)
        least = box_check.least_along(first, 3 << 64, 4 << 64, delta) / (5 << 64) / ONE
        for t in (-0.3, 0.1, 0.3):
            u, v = np.exp(2j * np.pi * random.random(2))
            x, y = a + slope_a * t + rests[0] * u, b + slope_b * t + rests[1] * v
            straight = complex(found.re, found.im) / ONE + complex(found.slope_re, found.slope_im) / ONE * t
            along = ((3.0 - 4.0j) / 5.0 * x).real
            assert abs(x * y - straight) <= found.rest / ONE * (1.0 + 1e-12)
            assert abs(x) <= first.most(delta) / ONE * (1.0 + 1e-12)
            assert along >= least - 1e-12
            near = least / along if least > 0.0 else 0.0
            shares = abs(x * y - straight) * ONE / found.rest, abs(x) * ONE / first.most(delta), near
            sharp = [max(pair) for pair in zip(sharp, shares, strict=True)]
    # bounds that nothing comes near would be of no use
    assert min(sharp) > 0.8


class StateOf:
    """D and Nᵢ of the control of a file at a point of the plane, in floats."""

    def __init__(self, content: Document) -> None:
        self.parts = [np.array(content["control"][name], float) for name in "ABCD"]

    def at(self, z: complex) -> tuple[complex, list[complex]]:
        A, B, C, D = self.parts
        determinant = complex(np.linalg.det(z * np.eye(len(A)) - A))
        response = C @ np.linalg.solve(z * np.eye(len(A)) - A, B.astype(complex)) + D
        return determinant, [complex(x) * determinant for x in response[0]]


@pytest.mark.parametrize(("dead", "bandwidth"), [(1.0, None), (0.37, 1500.0)])
def test_the_characteristic_polynomial_is_that_of_the_simulated_loop(dead: float, bandwidth: float | None) -> None:
    """Its roots against the eigenvalues of the loop that `benchmarks/box.py` builds of its own matrices."""
    loop = two_masses(dead, bandwidth)
    model = deployed(loop.control, float(loop.sample_time)).model
    assert isinstance(model, StateSpace)
    content = box_proof.stated(loop, Box(0.1, 0.1, 1), model)
    control = box_check.control_of(content["control"])
    bodies = box_check.bodies_of(content, control.readings)
    draws = box_draws()
    for late in (0, 1):
        found = box_check.characteristic(bodies, control, late, 512)
        assert all(span.high - span.low < 1 << 200 for span in found)
        bodies_of_two = draws.chain(np.array([[40.0, 90.0]]), np.array([[5e7]]), [900.0], [0.0, 50.0])
        plants = draws.held(bodies_of_two, np.array([late]), loop)
        growth = float(draws.closed_eigenvalues(plants, draws.linear_law(loop.control, 2e-4, 0.05))[0])
        roots = np.roots([float(Fraction(span.low, 1 << 512)) for span in reversed(found)])
        assert float(np.max(np.abs(roots))) == pytest.approx(growth, abs=1e-6)
        assert box_check.stable(found) is True


@pytest.mark.parametrize(("radius", "verdict"), [(1.0 - 1e-9, True), (1.0 + 1e-9, False)])
def test_roots_near_the_unit_circle_are_told_apart(radius: float, verdict: bool) -> None:
    pair = [Fraction(radius) ** 2, Fraction(radius) * Fraction(-19, 10), Fraction(1)]
    found = box_check.times(pair, [Fraction(-1, 2), Fraction(1)], Fraction(0))
    assert box_check.stable([box_check.span(x, 256) for x in found]) is verdict
    # with 20 bits nobody can tell, and nobody does
    assert box_check.stable([box_check.span(x, 20) for x in found]) is None


def test_the_numbers_of_the_checker() -> None:
    assert math.pi == box_check.PI / ONE
    assert 0 < box_check.pi(400) - (box_check.PI << 80) < 2 << 80
    for angle in (-7.5, -0.3, 0.0, 1e-9, 0.7, 3.0):
        turn = box_check.turned(box_check.fixed(Fraction(angle)))
        assert complex(turn.re, turn.im) / ONE == pytest.approx(cmath.exp(1j * angle), abs=1e-15)
        assert turn.radius < 1 << 30
    around = [box_check.direction(code, 5) for code in range(20)]
    angles = [cmath.phase(complex(*vector)) % (2.0 * math.pi) for vector in around]
    assert all(a < b for a, b in pairwise(angles))
    assert all(abs(x) + abs(y) == 5 << 64 for x, y in around)


def test_directions_are_those_of_the_checker() -> None:
    angles = np.random.default_rng(1).uniform(-4.0, 7.0, 200)
    codes = box_proof._direction(angles)
    vectors = box_proof._vector(codes)
    assert np.max(np.abs(vectors - np.exp(1j * angles))) < 1.0 / box_proof._AROUND
    for code, vector in zip(codes.tolist(), vectors, strict=True):
        x, y = box_check.direction(code, box_proof._AROUND)
        assert complex(x, y) / abs(complex(x, y)) == pytest.approx(vector, abs=1e-14)


def test_a_file_is_compared_with_its_machine_file(tmp_path: Path) -> None:
    """The checker takes plants and control from the file; `check --machine` computes both again."""
    certify.run(CertifyRequest("linear_motor", box="mass=0.1", arithmetic="float32", out=tmp_path / "proof"))
    file = tmp_path / "proof" / "box_proof.json"
    outcome = check.run(CheckRequest(file, machine="linear_motor"))
    assert outcome.result is True
    assert [row[1] for row in outcome.tables[-1].rows] == ["holds"] * 3
    content = json.loads(file.read_text(encoding="utf-8"))
    # claims that are true, of another machine
    for change, link in ((scaled("uncertain.0.to", 0.99), "plants"), (scaled("control.A.1.1", 1.0 - 1e-6), "control")):
        changed = deepcopy(content)
        change(changed)
        file.write_text(json.dumps(signed(changed)), encoding="utf-8")
        outcome = check.run(CheckRequest(file, machine="linear_motor"))
        assert outcome.result is False
        broken = [row for row in outcome.tables[-1].rows if row[1] == "BROKEN"]
        assert len(broken) == 1
        assert broken[0][0].endswith(f": {link}")


def test_too_many_cells_for_a_file_are_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(box_proof, "_RECORDED", 80)
    outcome = certify.run(CertifyRequest("linear_motor", box="standard", out=tmp_path / "proof"))
    assert outcome.result.proven
    assert "150 cells are too many for a file that feeddrive check can read." in outcome.remarks
    sentences, proven = box_check.checked(str(tmp_path / "proof" / "box_proof.json"))
    assert not proven
    assert "the cells of its proof were not kept" in sentences[-1]


@pytest.mark.slow(reason="10,000 draws for each of three machines, by other means, and the files checked, 90 s")
@pytest.mark.parametrize(("machine", "box"), [
    ("linear_motor", Box()), ("machining_center", Box()), ("ball_screw", Box(0.1, 0.1, 1)),
])  # fmt: skip
def test_no_plant_of_ten_thousand_contradicts_a_file(machine: str, box: Box) -> None:
    """The largest Ms of the draws: 2 % above it the file is accepted, and 0.1 % below it no directions help."""
    loop = next(iter(fd.read_machine(machine).loops.values()))
    drawn = box_draws().Draws(loop, box, 10_000, seed=46).under(loop.control)
    assert drawn.growth < 1.0
    content = written(loop, box, 1.02 * drawn.peak)
    box_check.verified(content)
    with pytest.raises(box_check.RefusedError, match="is not proven"):
        box_check.verified(signed({**content, "sensitivity_peak": 0.999 * drawn.peak}))
    # the proof of this control is none of one with 1.3 times its gain
    law = deepcopy(content["control"])
    for name in "CD":
        law[name] = (np.array(law[name]) * 1.3).tolist()
    with pytest.raises(box_check.RefusedError, match=r"is not proven|unstable"):
        box_check.verified(signed({**content, "control": law}))
