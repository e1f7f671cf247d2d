"""`feeddrive certify` and `feeddrive check`."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import feeddrive as fd
from feeddrive.cli.commands import app
from feeddrive.language.errors import FeeddriveError, NotCertifiedError, ParameterError

RUN = CliRunner()


def run(*words: str, code: int = 0) -> str:
    found = RUN.invoke(app, list(words))
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        raise found.exception
    assert found.exit_code == code, found.output
    return " ".join(found.output.split())


@pytest.mark.pictures
def test_a_machine_gets_a_certificate_and_a_report(tmp_path: Path) -> None:
    out = tmp_path / "out"
    said = run("certify", "ball_screw", "--float32", "--out", str(out))
    assert "stable for 1 plant and everything in its disc, with float32 coefficients; the room is " in said
    assert "Not covered: saturation; friction" in said
    assert "Outside: friction" not in said
    assert len(said) < 1600  # 20 lines of 80 columns
    said = run("certify", "ball_screw", "--float32", "--verbose", "--out", str(out))
    assert "Outside: saturation" in said
    assert "Outside: friction" in said
    document = json.loads((out / "certificate.json").read_text())
    assert document["machine"]["file"] == "ball_screw.toml"
    assert document["arithmetic"] == "float32"
    page = (out / "report.html").read_text()
    for word in ("Room at each frequency", "Where L may lie", "What is outside", "Rouché", "Saturation"):
        assert word in page
    assert "Green" not in page, "nothing was measured: the picture has no green"
    assert "PROVEN: plants: 1" in run("check", str(out / "certificate.json"))
    text = (out / "certificate.json").read_text().replace('"confidence": 0.95', '"confidence": 0.9')
    (tmp_path / "other.json").write_text(text)
    assert "other.json: its content does not fit its SHA-256" in run("check", str(tmp_path / "other.json"), code=1)


def measured(tmp_path: Path) -> str:
    """A file with the responses of both encoders of the ball screw, with noise and its variance."""
    loop = fd.read_machine("ball_screw").loop("x")
    model = fd.linearize(loop, ["cut"], ["reading_motor", "reading_load"])
    f = np.geomspace(3.0, 2500.0, 300)
    rng = np.random.default_rng(1)
    both: list[fd.FRF] = []
    for output in ("reading_motor", "reading_load"):
        P = model.response(f, output=output)
        s = 0.02 * np.abs(P.response)
        G = P.response + s * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2.0)
        both.append(fd.FRF(f, G, "force", output, "m/N", None, None, s**2))
    file = tmp_path / "axis.csv"
    fd.write_frf(file, *both)
    return str(file)


def test_measured_responses_and_other_positions(tmp_path: Path) -> None:
    """Both encoders in one file: around a fit, around the machine's plant, and another machine beside it."""
    file = measured(tmp_path)
    said = run(
        "certify",
        "ball_screw",
        "--measured",
        file,
        "--fit",
        "--at",
        "ball_screw",
        "--at",
        file,
        "--out",
        str(tmp_path / "out"),
    )
    assert "stable for 3 plants" in said
    assert said.count(" 600 ") == 2  # no value of the table is cut at 80 columns
    assert "Green at the lower edge: where the plant was measured" in (tmp_path / "out" / "report.html").read_text()
    document = json.loads((tmp_path / "out" / "certificate.json").read_text())
    assert [each["name"] for each in document["plants"]] == ["axis", "ball_screw", "axis 2"]
    assert "fitted to 600 measured lines" in document["plants"][0]["source"]


@pytest.mark.slow(reason="a certificate more; beside another machine it is quick")
def test_a_measured_response_around_the_plant_of_the_machine(tmp_path: Path) -> None:
    said = run("certify", "ball_screw", "--measured", measured(tmp_path), "--out", str(tmp_path / "known"))
    assert "the disc of 'axis' could be" in said


def test_what_cannot_be_certified_is_not_written(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(NotCertifiedError, match=r"at most 0\.5198"):
        run("certify", "ball_screw", "--radius", "0.7", "--out", str(out))
    assert not out.exists()
    with pytest.raises(ParameterError, match="need --measured"):
        run("certify", "ball_screw", "--fit", "--out", str(out))
    with pytest.raises(FeeddriveError, match="arithmetic = 'double' must be float64"):
        run("certify", "ball_screw", "--arithmetic", "double", "--out", str(out))


def test_a_tuning_brings_the_certificate_of_the_file_that_it_writes(tmp_path: Path) -> None:
    """The numbers of the machine file have seven digits; it is they that are certified."""
    run("tune", "linear_motor", "--filters", "kept", "--starts", "1", "--out", str(tmp_path / "out"))
    document = fd.read_certificate(tmp_path / "out" / "certificate.json").document
    machine = tmp_path / "out" / "machine.toml"
    assert document["machine"]["sha256"] == hashlib.sha256(machine.read_bytes()).hexdigest()
    loop = fd.read_machine(machine).loop("x")
    assert document["control"]["parameters"]["law.Kp"] == fd.parameters(loop)["axis.x.control.law.Kp"]
    assert document["control"] == fd.certificate.certify_loop(loop).document["control"]
