"""`feeddrive excite` and `feeddrive frf` as a user meets them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from feeddrive import cli
from feeddrive.files.frf import encoders, read_frf, read_frfs
from feeddrive.files.machine import read_machine
from feeddrive.files.read_log import read_log
from feeddrive.files.run_files import write_run_csv
from feeddrive.loop.linearize import linearize

EXCITED = ("excite", "ball_screw", "--band", "10..500", "--amplitude", "300", "--resolution", "5", "--out", "sent")


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `feeddrive` in an empty folder: exit code, output, errors."""
    monkeypatch.chdir(tmp_path)

    def asked(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return asked


@pytest.mark.pictures
def test_what_is_sent_comes_back_as_the_model(call) -> None:
    """excite -> simulated logs -> frf -> frf.csv -> read_frf: the linear model of the machine file to 1 %."""
    code, out, _ = call(*EXCITED)
    assert code == 0
    assert "force, peak" in out
    assert "The axis moves by itself" in out
    sent = read_log("sent/excitation_1.csv")
    assert sent.units["excitation"] == "N"
    assert np.max(np.abs(sent["excitation"])) == pytest.approx(300.0, rel=0.01)
    code, out, err = call("frf", "sent/simulated_1.parquet", "sent/simulated_2.parquet", "--out", "measured")
    assert code == 0, err
    assert encoders(read_frfs("measured/frf.csv")).keys() == {"motor", "load"}
    frf = read_frf("measured/frf.csv", "reading_load")
    assert (frf.input, frf.output, frf.unit) == ("force", "reading_load", "m/N")
    assert frf.coherence is not None
    assert frf.variance is not None
    loop = read_machine("ball_screw").loop(None)
    model = linearize(loop, ["cut"], ["reading_load"], velocity=0.05).response(frf.frequency)
    low = frf.frequency < 200.0
    assert np.max(np.abs(frf.response / model.response - 1.0)[low]) < 0.01
    page = Path("measured/report.html").read_text(encoding="utf-8")
    assert "coherence" in page
    assert "Frequency response, force to reading_load and reading_motor" in page  # columns under their own names
    assert "odd and even distortion" in page
    assert page.count("<figure") == 2  # one for each encoder


def test_a_limit_that_breaks_ends_the_command(call) -> None:
    code, _, err = call(*EXCITED, "--travel", "0.005")
    assert code == 2
    assert "travel reaches" in err
    assert not Path("sent").exists()


def test_columns_are_named_where_they_cannot_be_guessed(call) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(4000) * 1e-3
    iq, angle = rng.standard_normal(4000), rng.standard_normal(4000).cumsum()
    write_run_csv("log.csv", t, {"p7": iq, "p9": angle}, {"p7": "", "p9": ""})
    code, _, err = call("frf", "log.csv")
    assert code == 2
    assert "name it with --input" in " ".join(err.split())
    code, out, err = call("frf", "log.csv", "--input", "p7:A", "--output", "p9:rad", "--method", "h1")
    assert code == 1, err
    assert "Do not tune on this response" in out  # the signals have nothing to do with each other
    assert "No reference was given" in out
    page = Path("results/frf_log/report.html").read_text(encoding="utf-8")
    assert "No reference was given" in page
    assert read_frf("results/frf_log/frf.csv").unit == "rad/A"
    code, _, err = call("frf", "log.csv", "--input", "p7:A", "--output", "p9:rad", "--band", "5-500")
    assert code == 2
    assert "as 5..500" in err


def test_columns_that_need_a_factor_are_named(call) -> None:
    """Counts and percent: the guess says which factor, the error which columns there are, and `*factor` takes them."""
    rng = np.random.default_rng(2)
    t, torque = np.arange(4000) * 1e-3, rng.standard_normal(4000)
    columns = {"Torque": torque, "Position": np.round(1e3 * torque.cumsum())}
    write_run_csv("log.csv", t, columns, {"Torque": "%", "Position": "counts"})
    code, out, err = call("frf", "log.csv")
    assert code == 2
    assert "m per counts" in out
    assert "Torque, Position" in err
    assert "name it with --input" in err
    asked = ("--input", "Torque*0.1:N", "--output", "Position*2e-8:m")
    code, out, err = call("frf", "log.csv", *asked, "--method", "h1")
    assert code == 1, err
    assert out.count("its mass is 0.00287 kg") == 1
    assert read_frf("results/frf_log/frf.csv").unit == "m/N"


def test_units_by_name_by_option_and_by_nothing(call) -> None:
    """A response of mm that passed for one of m would be a thousand times off in the tuning."""
    rng = np.random.default_rng(3)
    t, force = np.arange(4000) * 1e-3, rng.standard_normal(4000)
    position = 1e-5 * force.cumsum()  # some 60 kg
    write_run_csv("log.csv", t, {"force_N": force, "pos_act_mm": position, "p9": position}, {})
    asked = ("frf", "log.csv", "--method", "h1", "--input")
    code, _, err = call(*asked, "force_N", "--output", "pos_act_mm", "--out", "a")
    assert code == 0, err
    code, _, err = call(*asked, "force_N:kN", "--output", "p9:mm", "--out", "b")
    assert code == 0, err
    named, told = read_frf("a/frf.csv"), read_frf("b/frf.csv")
    assert named.unit == told.unit == "m/N"
    np.testing.assert_allclose(named.response, 1e3 * told.response, rtol=1e-12)
    code, out, err = call(*asked, "force_N", "--output", "p9", "--out", "c")
    assert code == 0, err
    assert "No unit of 'p9' is known" in out
    assert "--output p9:mm" in Path("c/report.html").read_text(encoding="utf-8")
    assert read_frf("c/frf.csv").unit == ""
    code, _, err = call(*asked, "force_N:foo", "--output", "p9")
    assert code == 2
    assert "'force_N:foo': the unit 'foo' is not known" in err


def test_an_excitation_that_is_lost_in_noise_is_said_with_what_to_do(call) -> None:
    """Above the torsional mode, 450 Hz, the table hardly answers: 3 N there are less than the encoder's count."""
    code, _, err = call(
        "excite",
        "ball_screw",
        "--band",
        "100..900",
        "--amplitude",
        "3",
        "--resolution",
        "10",
        "--periods",
        "3",
        "--realisations",
        "1",
        "--out",
        "weak",
    )
    assert code == 0, err
    page = " ".join(Path("weak/report.html").read_text(encoding="utf-8").split())
    assert "lines are not known to 30 %" in page
    assert "take more amplitude or more periods" in page
