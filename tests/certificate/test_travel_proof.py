"""Proofs along the travel: sharp against grids and a moving simulation written anew, refused where they do not hold."""

from __future__ import annotations

import json
import math
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import travel_draws
from feeddrive.blocks import DADSC, CascadePPI, GainSchedule, Rigid, ScheduleLoad, SchedulePlace
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.certificate import travel_check, travel_proof
from feeddrive.certificate.travel_proof import AlongTravel, TravelProof, document, prove_along_travel
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.tuning import Travel, frozen

T = 2.5e-4  # s
PLACES = (0.0, 0.5, 1.0)  # m
GAINS = ((60.0, 3.2e4, 0.02), (50.0, 2.6e4, 0.025), (40.0, 2.2e4, 0.03))


def rigid(x: float, law: Any = None) -> Loop:
    """A mass of 100 kg with a load that grows along the travel, under P-PI gains that fall."""
    axis = Axis(
        plant=Rigid(mass=100.0 + 60.0 * x, viscous=200.0), actuator=Actuator(dead_time=T), encoder_load=Encoder()
    )
    return Loop(control=Control(law=law or schedule()), axis=axis, sample_time=T)


def schedule(factor: float = 1.0) -> GainSchedule:
    return GainSchedule(
        places=tuple(
            SchedulePlace(position=x, law=CascadePPI(Kv=Kv, Kp=factor * Kp, Tn=Tn, velocity_encoder="load"))
            for x, (Kv, Kp, Tn) in zip(PLACES, GAINS, strict=True)
        )
    )


TRAVEL = Travel.of({x: rigid(x) for x in (0.0, 0.3, 0.7, 1.0)})
CONTROL = rigid(0.0).control


def peak(x: float, control: Control = CONTROL) -> float:
    """Ms of a frozen loop on 20,000 lines."""
    model = linearize(replace(TRAVEL.at(x), control=frozen(control, x)), ["cut"], ["force"])
    lines = np.geomspace(1.0, 0.5 / T, 20_000)
    return float(np.max(1.0 / np.abs(1.0 - model.response(lines, "force", "cut").response)))


WORST = max(peak(float(x)) for x in np.linspace(0.0, 1.0, 41))


@pytest.fixture(scope="module")
def proof() -> TravelProof:
    """The proof at a bound 0.5 % above the largest Ms, and for a moving axis."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(travel_proof, "_MESH", 24)
        return prove_along_travel(TRAVEL, CONTROL, sensitivity_peak=1.005 * WORST)


def test_the_bound_is_proven_above_the_largest_peak_and_refused_below_it(proof: TravelProof) -> None:
    assert proof.proven is True
    assert proof.intervals() == [(0.0, 1.0)]
    below = prove_along_travel(TRAVEL, CONTROL, sensitivity_peak=0.998 * WORST, speed=False)
    assert below.proven is False
    assert below.position is not None
    assert peak(below.position) > 0.998 * WORST
    assert "|S| is" in below.reason


def test_a_bound_that_only_a_position_between_the_places_violates_is_refused() -> None:
    """In the middle of the second interval the gain is three times that; at all measured positions the bound holds."""
    first, middle, last = schedule().places
    bump = SchedulePlace(position=0.55, law=replace(middle.law, Kp=3.0 * middle.law.Kp))  # type: ignore[call-arg]
    control = Control(law=GainSchedule(places=(first, middle, bump, replace(middle, position=0.6), last)))
    bound = 1.02 * max(peak(x, control) for x in (0.0, 0.3, 0.5, 0.6, 0.7, 1.0))
    found = prove_along_travel(TRAVEL, control, sensitivity_peak=bound, speed=False)
    assert found.proven is False
    assert found.position == pytest.approx(0.55, abs=0.05)


def test_an_unstable_position_is_named() -> None:
    found = prove_along_travel(TRAVEL, Control(law=schedule(20.0)), speed=False)
    assert found.proven is False
    assert "at 0 m it is unstable: a pole at |z| = " in found.reason


def test_a_bound_on_the_largest_peak_itself_is_not_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 1e-7 nothing is proven, and with few cells the work ends it."""
    found = prove_along_travel(TRAVEL, CONTROL, sensitivity_peak=WORST * (1.0 + 1e-9), speed=False, work=300)
    assert found.proven is not True
    few = prove_along_travel(TRAVEL, CONTROL, sensitivity_peak=1.005 * WORST, speed=False, work=10)
    assert few.proven is None
    assert few.reason == "10 cells of positions were examined, as many as are allowed"
    monkeypatch.setattr(travel_proof, "_NARROW", 0.1)
    short = prove_along_travel(TRAVEL, CONTROL, sensitivity_peak=1.0005 * WORST, speed=False)
    assert short.proven is None
    assert "is too near to the bound to decide" in short.reason


@pytest.mark.parametrize("step", [0.0, 1e-3])
@pytest.mark.parametrize("law", ["cascade_ppi", "dadsc"])
def test_the_enclosures_hold_the_models_of_drawn_positions(law: str, step: float) -> None:
    """The axis at one position, its law at another one within a step, and the state of the law from a third one."""
    gains = schedule()
    if law == "dadsc":
        first = DADSC(mass=100.0, tracking_rate=90.0, reaching_rate=120.0, adaptation_rate=60.0, adaptation_ratio=1.01)
        last = replace(first, mass=150.0, reaching_rate=80.0)
        gains = GainSchedule(places=(SchedulePlace(position=0.0, law=first), SchedulePlace(position=1.0, law=last)))
    along = AlongTravel(TRAVEL, Control(law=gains))
    assert (along.retuned is None) == (law == "cascade_ppi")
    low, high = np.array([0.1, 0.45]), np.array([0.15, 0.5])
    cell, X = along.matrices(low, high, step)
    random = np.random.default_rng(6)
    scale = along.scale[None, :] / along.scale[:, None]
    for draw in range(30):
        row = int(random.integers(cell.size))
        t, e, d = random.uniform(-1.0, 1.0, 3)
        if draw == 0:
            # the end of a cell at a place, with the law behind it
            row, t, e = int(np.flatnonzero(cell == 1)[0]), 1.0, 1.0
        i = cell[row]
        x = 0.5 * (low[i] + high[i]) + 0.5 * (high[i] - low[i]) * t
        loop = replace(TRAVEL.at(float(x)), control=frozen(along.control, float(x + step * e)))
        model = linearize(loop, ["added_force"], ["force"], position=float(x))
        exact = np.block([[model.A, model.B], [model.C, model.D + 1.0]])
        value = sum(X.terms[k, row] * t**k for k in range(len(X.terms)))
        rest = X.rest[row]
        if step:
            value = value + (X.slope[0, row] + X.slope[1, row] * t) * e
            # behind a place the parameters bend, by up to these
            rest = rest + np.sum(np.abs(X.slope[2:4, row]), axis=0)
        if step and law == "dadsc":
            value = value + (X.slope[4, row] + X.slope[5, row] * t) * d
            old, new = (gains.law_at(float(x + step * (e - s))) for s in (d, 0.0))
            place = [along.traced.names.index(f"control.memory.law.{name}") for name in ("estimate", "sliding")]
            turn = np.eye(len(exact))
            turn[place[0], place[1]] = old.prepare(T).g2 - new.prepare(T).g2  # type: ignore[attr-defined]
            assert turn[place[0], place[1]] != 0.0
            exact = exact @ turn
        # 1e-15: the rounding of the model that it is compared with
        assert np.all(np.abs(exact * scale - value) <= rest * (1.0 + 1e-9) + 4e-15 * np.abs(exact * scale))


@pytest.mark.parametrize("growth", [6.0, -6.0])
def test_the_step_at_which_a_function_falls_as_fast_as_the_loop_decays_is_sharp(growth: float) -> None:
    """x(k+1) = 0.98 x(k) with P = e^(growth y): proven as long as P changes by less than 1/0.98² over two steps."""
    edges = np.linspace(0.0, 1.0, 101)
    P = np.exp(growth * edges)[:, None, None]

    class Still:
        """A loop of one state that does not depend on the position."""

        places, states = (), 1

        def matrices(self, low: np.ndarray, high: np.ndarray, step: float = 0.0) -> Any:
            terms = np.zeros((5, low.size, 2, 2))
            terms[0, :, 0, 0] = 0.98
            rest = np.zeros((low.size, 2, 2))
            return np.arange(low.size), travel_proof.Enclosures(terms, np.zeros((0, low.size, 2, 2)), rest)

    # at the end of a cell where P is least, against the steeper slope beside it
    share = abs(np.diff(P[:, 0, 0])) / 0.01 / np.minimum(P[1:, 0, 0], P[:-1, 0, 0])
    least, most = (1.0 - 0.98**2) / (2.0 * float(np.max(share))), (0.98**-2 - 1.0) / (2.0 * abs(growth)) * 1.1
    assert travel_proof._moving_holds(Still(), edges, P, 0.9 * least)  # type: ignore[arg-type]
    assert not travel_proof._moving_holds(Still(), edges, P, most)  # type: ignore[arg-type]


def test_the_file_is_accepted_and_each_kind_of_damage_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(travel_proof, "_MESH", 24)
    proof = prove_along_travel(TRAVEL, Control(law=schedule().places[1].law), sensitivity_peak=2.0)
    content = json.loads(json.dumps(document(proof)))
    file = tmp_path / "proof.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    sentences, proven = travel_check.checked(str(file))
    assert proven, sentences
    assert sentences[-1] == "PROVEN"
    assert proof.speed is not None
    assert f"moving: stable up to {proof.speed:.4g} m/s" in sentences[1]

    def refused(change: Any, said: str, *, signed: bool = True) -> None:
        changed = deepcopy(content)
        change(changed)
        if signed:
            changed["sha256"] = travel_check.digest(changed)
        with pytest.raises(travel_check.RefusedError, match=said):
            travel_check.verified(changed)

    refused(lambda d: d.update(sensitivity_peak=1.05), "is not proven")
    refused(lambda d: d["cells"].pop(1), "the cells leave a gap")
    refused(lambda d: d.update(to_m=1.01), "the cells leave a gap")
    refused(lambda d: d["moving"].update(step_m=200.0 * d["moving"]["step_m"]), "is not proven|shorter than two steps")
    refused(lambda d: d["moving"]["cells"].pop(), "a cell is missing")
    refused(lambda d: d["cells"][1]["low"][0].__setitem__(0, -1.0), "P is not positive definite")
    refused(lambda d: d["cells"][1]["branches"][0][0].__setitem__(4, 1e3), "is not proven")
    refused(lambda d: d["cells"][1]["branches"][0].append(d["cells"][1]["branches"][0][0]), "stands there twice")
    refused(lambda d: d["cells"][0].update(from_m=math.nan), "no number")
    refused(lambda d: d.update(claim="more"), "its digest is another one", signed=False)
    for entry in ("sha256", "states"):
        without = {key: value for key, value in content.items() if key not in ("sha256", entry)}
        signed = {} if entry == "sha256" else {"sha256": travel_check.digest(without)}
        file.write_text(json.dumps({**without, **signed}), encoding="utf-8")
        said = f"REFUSED: {file}: its entry '{entry}' is missing: take the file as feeddrive travel wrote it"
        assert travel_check.checked(str(file))[0][-1].startswith(said)
    file.write_text('{"format": "feeddrive tra', encoding="utf-8")
    assert travel_check.checked(str(file))[0][-1].endswith(
        "it is not whole JSON: the file was cut off or changed, copy it anew"
    )
    # what is built otherwise is refused without a traceback
    file.write_text('{"format": "feeddrive travel proof, version 1", "states": 3, "sha256": 0}', encoding="utf-8")
    assert travel_check.checked(str(file))[1] is False


def test_a_matrix_that_is_only_just_indefinite_is_not_called_positive() -> None:
    """Both tests: X of one number on either side of the bound, as near as their rounding."""
    one, zero = np.ones((1, 1, 1)), np.zeros((1, 1, 1))
    for value, holds in ((0.9, True), (1.0 - 1e-12, True), (1.0, False), (1.0 + 1e-12, False)):
        assert travel_proof.proven_positive(value * one, zero, one, one, one, one)[0] == holds
        assert travel_check.positive([[value]], [[0.0]], [[1.0]], [[1.0]], [[1.0]], [[1.0]]) == holds
    # the rest counts
    assert not travel_proof.proven_positive(0.9 * one, 0.11 * one, one, one, one, one)[0]
    assert not travel_check.positive([[0.9]], [[0.11]], [[1.0]], [[1.0]], [[1.0]], [[1.0]])


def test_what_has_no_enclosure_is_refused() -> None:
    slow = GainSchedule(places=tuple(replace(p, law=replace(p.law, position_every=4)) for p in schedule().places))
    with pytest.raises(ParameterError, match="two rates, and the proof along the travel takes one"):
        prove_along_travel(TRAVEL, Control(law=slow))
    with pytest.raises(ParameterError, match=r"max_ms = 0\.9 must be above 1"):
        prove_along_travel(TRAVEL, CONTROL, sensitivity_peak=0.9)


def test_the_proof_of_one_payload_is_that_of_the_gains_for_it() -> None:
    """A drawn payload between those of the schedule: proven above the largest Ms with it, and refused below it."""
    random = np.random.default_rng(19)
    heavy = 120.0  # kg: the light table needs other gains
    loads = tuple(
        SchedulePlace(
            position=place.position,
            loads=(
                ScheduleLoad(payload=0.0, law=place.law),
                ScheduleLoad(payload=heavy, law=replace(place.law, Kp=2.5 * place.law.Kp)),
            ),
        )
        for place in schedule().places
    )
    control = Control(law=GainSchedule(payload=0.0, places=loads))

    def carrying(x: float, m: float) -> Loop:
        loop = rigid(x)
        return replace(loop, axis=replace(loop.axis, plant=replace(loop.axis.plant, mass=100.0 + 60.0 * x + m)))

    travel = Travel.of({(x, m): carrying(x, m) for x in (0.0, 0.4, 1.0) for m in (0.0, 50.0, heavy)})
    with pytest.raises(ParameterError, match=r"is that of one payload: take travel\.with_payload\(m\)"):
        prove_along_travel(travel, control)
    payload = float(random.uniform(20.0, 100.0))
    worst = 0.0
    for x in np.linspace(0.0, 1.0, 21):
        loop = replace(carrying(float(x), payload), control=frozen(control, float(x), payload))
        model = linearize(loop, ["cut"], ["force"])
        lines = np.geomspace(1.0, 0.5 / T, 4000)
        worst = max(worst, float(np.max(1.0 / np.abs(1.0 - model.response(lines, "force", "cut").response))))
    one = travel.with_payload(payload)
    above = prove_along_travel(one, control, sensitivity_peak=1.005 * worst, speed=False)
    assert above.proven is True
    assert f"each frozen with a payload of {payload:.4g}"[:-2] in above.claim
    assert above.record()["payload_kg"] == payload
    assert prove_along_travel(one, control, sensitivity_peak=0.998 * worst, speed=False).proven is False


@pytest.mark.slow(reason="proofs of two drawn axes and 200 draws of each take 20 s")
def test_draws_do_not_contradict_the_proofs() -> None:
    draws = travel_draws.load()
    random = np.random.default_rng(12)
    for _ in range(2):
        axis = draws.drawn(random)
        row = draws.judged(axis, random, 200, 20, 4000)
        assert row["verdict"] == "proven"
        assert not draws.contradicted(row)


@pytest.mark.slow(reason="a proof of a drawn axis and 200 draws of each take 20 s")
@pytest.mark.parametrize(("law", "payloads"), [("linear_adrc", False), ("cascade_ppi", True)])
def test_draws_do_not_contradict_the_proofs_of_another_law_and_of_a_payload(law: str, payloads: bool) -> None:
    draws = travel_draws.load()
    random = np.random.default_rng(14)
    rows = []
    while len(rows) < 1:
        row = draws.judged(draws.drawn(random, law, payloads=payloads), random, 200, 20, 4000)
        rows += [row] if row["verdict"] == "proven" else []
    assert not draws.contradicted(rows[0])
