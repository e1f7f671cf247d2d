"""Which pictures a page draws, what is computed for them, and in which units they are read."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.analysis.stability import stability
from feeddrive.files.frf import write_frf
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.studio.bench import Bench, bench_of, bench_of_responses
from feeddrive.studio.pictures import PICTURES, USUAL
from feeddrive.studio.server import Session


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_of("ball_screw")


@pytest.fixture
def session(bench: Bench, tmp_path: Path) -> Session:
    return Session(tmp_path, bench)


def asked(session: Session, do: str, **more: Any) -> dict[str, Any]:
    answer = session.answer({"number": 1, "do": do, **more})
    (length,) = struct.unpack_from("<I", answer)
    said = json.loads(answer[4 : 4 + length])
    numbers = np.frombuffer(answer[4 + length :], "<f4")
    for chart in said["charts"].values():
        for panel in chart["panels"]:
            for curve in panel["curves"]:
                curve["x"], curve["y"] = (numbers[curve["at"] + k * curve["n"] :][: curve["n"]] for k in (0, 1))
    return said


def panels(said: dict[str, Any], name: str) -> list[dict[str, Any]]:
    return said["charts"][name]["panels"]


def test_a_page_begins_with_the_usual_pictures_and_computes_nothing_for_others(session: Session) -> None:
    said = asked(session, "tune.show")
    assert set(said["charts"]) == set(USUAL)
    assert [each["name"] for each in said["pictures"] if each["chosen"]] == list(USUAL)
    asked(session, "tune.move", name="law.Kv", value=90.0)
    (parts,) = [each.parts for name, each in session.rooms["tune"]._seen.items() if name == "now"]  # type: ignore[attr-defined]
    assert {"run"} == {each for each in ("run", "snap", "linear", "step") if each in vars(parts)}
    said = asked(session, "tune.see", names=["nyquist"])
    assert set(said["charts"]) == {"nyquist"}
    asked(session, "tune.move", name="law.Kv", value=95.0)
    (parts,) = [each.parts for name, each in session.rooms["tune"]._seen.items() if name == "now"]  # type: ignore[attr-defined]
    assert not {each for each in ("run", "snap", "linear", "step") if each in vars(parts)}


def test_every_picture_can_be_chosen_and_follows_what_is_moved(session: Session) -> None:
    before = asked(session, "tune.see", names=list(PICTURES))
    assert set(before["charts"]) == set(PICTURES)
    assert all(each["why"] == "" for each in before["pictures"])
    after = asked(session, "tune.move", name="law.Kp", value=40000.0)
    told = {name: json.dumps([[c["said"] for c in p["curves"]] for p in panels(after, name)]) for name in PICTURES}
    same = {
        name
        for name in PICTURES
        if told[name] == json.dumps([[c["said"] for c in p["curves"]] for p in panels(before, name)])
    }
    assert same == {"response", "friction"}  # of the axis, whatever its control
    assert set(asked(session, "tune.show")["charts"]) == set(PICTURES)  # a page that is loaded again has them still
    assert "there is no picture 'x'" in asked(session, "tune.see", names=["x"])["error"]


def test_the_pole_map_has_the_poles_of_the_loop_at_the_numbers_of_now(session: Session, bench: Bench) -> None:
    """Not those of the linear model that is drawn, but those by which stability is decided."""
    asked(session, "tune.see", names=["poles", "damping"])
    said = asked(session, "tune.move", name="law.Kp", value=40000.0)
    (panel,) = panels(said, "poles")
    (now,) = [each for each in panel["curves"] if each["name"] == "now"]
    values = {**bench.by_hand.values, "law.Kp": 40000.0}
    loop = bench.needed_loop()
    poles = stability(replace(loop, control=bench.by_hand.control(values))).model.poles()
    s = np.log(poles[np.abs(poles) > 1e-3]) / (2.0 * np.pi * loop.sample_time)
    for x, y in zip(now["x"], now["y"], strict=True):
        if np.hypot(x, y) < 1e4:  # what is faster has no influence, and the reduced model may lack it
            assert np.min(np.abs(s - complex(x, y))) < 1e-3 * np.hypot(x, y)
    slow = s[(np.abs(s) < 1e4) & (s.imag >= 0.0)]
    assert len(slow) == np.sum(np.hypot(now["x"], now["y"]) < 1e4)


def test_a_loop_that_is_not_stable_shows_its_growing_poles_and_no_step(session: Session) -> None:
    asked(session, "tune.see", names=["poles", "step", "snap"])
    said = asked(session, "tune.move", name="law.Kp", value=2e6)
    names = [each["name"] for each in panels(said, "poles")[0]["curves"] if each["name"]]
    assert names == ["today", "now", "now grows"]
    assert [each["name"] for each in panels(said, "step")[0]["curves"]] == ["today"]
    assert [each["name"] for each in panels(said, "snap")[0]["curves"]] == ["today"]


def test_units_are_chosen_for_pictures_numbers_and_words(session: Session) -> None:
    usual = asked(session, "tune.see", names=[*USUAL, "snap"])
    other = usual
    for kind, unit in (("length", "mm"), ("force", "kN"), ("frequency", "rad/s"), ("gain", "absolute")):
        other = asked(session, "tune.unit", kind=kind, unit=unit)
    assert other["charts"]["open_loop"]["label"] == "frequency (rad/s)"
    assert other["charts"]["open_loop"]["factor"] == pytest.approx(2.0 * np.pi)
    assert panels(other, "run")[0]["label"] == "following error (mm)"
    assert panels(other, "stiffness")[0]["label"] == "dynamic stiffness (kN/mm)"
    for name, factor in (("run", 1e-3), ("snap", 1e-3), ("stiffness", 1.0)):
        before, after = panels(usual, name)[0]["curves"][0]["y"], panels(other, name)[0]["curves"][0]["y"]
        np.testing.assert_allclose(after, factor * before, rtol=1e-5)
    level, same = (panels(each, "sensitivity")[0]["levels"][-1]["value"] for each in (usual, other))
    assert level == pytest.approx(20.0 * np.log10(same))
    knobs = {each["name"]: each for each in other["knobs"]}
    assert (knobs["filters.0.frequency"]["unit"], knobs["filters.0.frequency"]["factor"]) == ("rad/s", 2.0 * np.pi)
    assert knobs["law.Tn"]["unit"] == "ms"
    assert "rad/s" in other["figures"]
    assert "rad/s" in other["judged"][0]["text"]
    grip, moved = (each["grips"][0] for each in (usual, other))
    assert grip["x"] == moved["x"]  # in Hz: the page turns it by the factor of the picture
    assert grip["y"] == pytest.approx(20.0 * np.log10(moved["y"]))
    said = asked(session, "tune.drag", name="filters.0.frequency", x=400.0, y=moved["y"], first=True)
    assert said["values"]["filters.0.frequency"] == 400.0
    assert "one of N, kN" in asked(session, "tune.unit", kind="force", unit="lbf")["error"]
    assert "one of length" in asked(session, "tune.unit", kind="mass", unit="kg")["error"]


def test_an_axis_that_turns_has_pictures_of_torque_and_angle(tmp_path: Path) -> None:
    session = Session(tmp_path, bench_of("rotary_table"))
    said = asked(session, "tune.see", names=list(PICTURES))
    assert panels(said, "stiffness")[0]["label"] == "dynamic stiffness (N m/µrad)"
    assert "N m/µrad" in panels(said, "stiffness")[0]["curves"][0]["said"]
    labels = " ".join(each["label"] for name in said["charts"] for each in panels(said, name))
    assert not any(unit in labels for unit in ("(µm)", "(N)", "mm/s", "N/µm"))
    assert ["um", "urad"] in next(each["among"] for each in said["units"] if each["kind"] == "length")


@pytest.fixture(scope="module")
def responses(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Responses of the ball screw with noise of known variance; on some lines the coherence is low."""
    loop, random = bench.needed_loop(), np.random.default_rng(11)
    f = np.geomspace(3.0, 1500.0, 260)
    model = linearize(loop, ["cut"], ["reading_motor", "reading_load"])
    found = list[FRF]()
    for reading in model.outputs:
        G = model.response(f, reading, "cut").response
        coherence = np.where((f > 300.0) & (f < 400.0), 0.5, 0.999)
        deviation = np.abs(G) * np.sqrt((1.0 - coherence) / coherence / 16.0)
        error = deviation * np.sqrt(0.5) * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
        found.append(FRF(f, G + error, "force", reading, "m/N", float(loop.sample_time), coherence, deviation**2))
    path = tmp_path_factory.mktemp("responses") / "frf.csv"
    write_frf(path, *found)
    return path


def test_a_measured_response_has_coherence_bands_and_its_model_beside_it(responses: Path, tmp_path: Path) -> None:
    session = Session(tmp_path, bench_of_responses(responses, baseline="ball_screw"))
    said = asked(session, "tune.see", names=["open_loop", "response"])
    loop, response = panels(said, "open_loop"), panels(said, "response")
    assert [each["label"] for each in loop] == ["open loop |L| (dB)", "phase (deg)", "coherence"]
    assert {each["name"] for each in loop[0]["bands"]} == {"", "95 % of the measurement"}
    assert loop[2]["bands"][0]["name"] == "coherence 0.9 or less"
    assert [each["label"] for each in response] == [
        "magnitude (dB re 1 m/N)",
        "phase (deg)",
        "error (dB)",
        "coherence",
    ]
    names = [each["name"] for each in response[0]["curves"]]
    assert names == [f"reading of the {side}, {what}" for side in ("motor", "load") for what in ("measured", "model")]
    measured, model = response[0]["curves"][:2]
    good = (measured["x"] < 250.0) | (measured["x"] > 500.0)
    assert np.max(np.abs(measured["y"] - np.interp(measured["x"], model["x"], model["y"]))[good]) < 1.5  # dB


def test_what_needs_a_machine_says_so_without_one(responses: Path, tmp_path: Path) -> None:
    bench = bench_of_responses(responses, sample_time=5e-5)
    session = Session(tmp_path, bench)
    said = asked(session, "tune.see", names=list(PICTURES))
    absent = {each["name"] for each in said["pictures"] if each["why"]}
    assert absent == {"run", "step", "snap", "poles", "damping", "friction"}
    assert set(said["charts"]) == set(PICTURES) - absent
    assert [each["name"] for each in panels(said, "response")[0]["curves"]] == [
        "reading of the motor, measured",
        "reading of the load, measured",
    ]
