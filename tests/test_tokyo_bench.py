"""The two-inertia bench of the University of Tokyo: multisine type A, 20 periods of 2500 samples at 2.5 kHz.

Source of the data: T. Beauduin, W. Ohnishi, FdiTools, Hori-Fujimoto Laboratory, The University of Tokyo, 2016.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from feeddrive.files.columns import Column
from feeddrive.files.read_log import read_log
from feeddrive.identification.excitation.estimate_frf import estimate_frf
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate, Record

FOLDER = Path(__file__).parents[2] / "shared" / "data" / "tokyo_motor_bench"
needs_log = pytest.mark.skipif(not FOLDER.exists(), reason="NOT RUN: the bench's log is not in ../shared")
BAND = (11.0, 250.0)


def estimated(angle: str, sign: float = 1.0, **asked: object) -> FrequencyEstimate:
    time = Column(name="time", unit="us")
    channels = {"input": "iq_adx", "reference": "iq_refx", "output": angle}
    found = {
        role: read_log(FOLDER / "MultisineTypeA.mat", {"time": time, "command": name})["command"]
        for role, name in channels.items()
    }
    record = Record(
        input=found["input"],
        output=sign * found["output"],
        references=(found["reference"],),
        sample_time=4e-4,
        input_name="current",
        output_name="angle",
        unit="rad/A",
    )
    return estimate_frf(record, band=BAND, **asked)  # type: ignore[arg-type]


@needs_log
@pytest.mark.parametrize(
    ("angle", "sign", "column"), [("theta_mx", 1.0, 1), ("theta_my", -1.0, 3)], ids=["motor", "load"]
)
def test_the_averaged_response_is_that_of_an_independent_program(angle: str, sign: float, column: int) -> None:
    """With the same 19 periods the two differ by rounding alone; the table has 19 digits."""
    found = estimated(angle, sign, skip=1)
    table = np.loadtxt(FOLDER / "frf_typeA.csv", delimiter=",")
    assert found.frequency == pytest.approx(table[:, 0], rel=1e-12)
    expected = table[:, column] + 1j * table[:, column + 1]
    assert np.max(np.abs(found.frf.response / expected - 1.0)) < 1e-9


@needs_log
def test_noise_floor_and_distortion_are_reported() -> None:
    """The period is found, the transient dropped; the noise is 44 dB below the response in the median.

    In the band the grid is full: odd and even distortion show together, as scatter.  Below the band lines 1 .. 10 are
    empty, and their odd ones hold far more than noise: the friction of the bearings.
    """
    found = estimated("theta_mx")
    assert found.counts["dropped"] in (1, 2)
    below = 20.0 * np.log10(found.frf.magnitude / np.sqrt(found.noise))
    assert np.median(below) == pytest.approx(44.0, abs=1.0)
    assert found.total
    scatter, noise = found.levels["nonlinear"], found.levels["noise"]
    assert np.median(scatter.output / noise.output) > 3.0
    odd = found.levels["odd"]
    low = odd.frequency < 10.0
    assert np.all(odd.output[low] > 50.0 * np.median(noise.output))
    assert np.all(np.isnan(odd.response[low]))
