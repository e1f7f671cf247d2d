"""Every law of the library shaped on a measurement: the limits hold on the true axis, which no search has seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.stiffness import rope_snap
from feeddrive.language.errors import UnstableError
from feeddrive.tuning.candidates import Candidate, candidates
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import OperatingPoint, measured_point, with_table_force
from feeddrive.tuning.tune import law_tunables, tune_control
from slow_share import all_but

# rope snap in nm √s/N that each reaches here on the true axis, and a hundredth more: another noise may cost that
SNAP = {
    "P-PI": 9.08,
    "P-PI + compensator": 9.08,
    "P-PI + recovery": 8.91,
    "DADSC": 29.4,
    "DADSC + recovery": 23.1,
    "GPI, 3 Taylor states": 7.93,
    "GPI, 1 Taylor state": 7.74,
    "pole placement": 6.88,
}
# within Ms <= 2 its peak compliance is ten times the others' at best: the limit of 0.2 µm/N is refused
REFUSED = "GPI, 5 Taylor states"


@pytest.fixture(scope="module")
def screw() -> fd.Loop:
    return fd.read_machine("ball_screw").loop("x")


@pytest.fixture(scope="module")
def point(screw: fd.Loop) -> OperatingPoint:
    """Two encoders, 1000 lines with 0.3 % of noise; the force on the table by the plant, as with --baseline."""
    random, lines = np.random.default_rng(0), np.arange(1.0, 2001.0, 2.0)
    model = fd.linearize(screw, ["cut"], ["reading_load", "reading_motor"])
    found = []
    for reading in model.outputs:
        true = model.response(lines, reading, "cut").response
        a, b = random.standard_normal((2, lines.size))
        noisy = true + 0.003 * np.abs(true) * (a + 1j * b) / np.sqrt(2.0)
        variance = (0.003 * np.abs(true)) ** 2
        found.append(fd.FRF(lines, noisy, "cut", reading, "m/N", screw.sample_time, variance=variance))
    return with_table_force(measured_point(*found, sample_time=float(screw.sample_time)), screw, "the plant")[0]


def design_of(screw: fd.Loop, name: str) -> Candidate:
    return next(each for each in candidates(screw)[0] if each.name == name)


@pytest.mark.parametrize("name", all_but(["DADSC", "GPI, 1 Taylor state"], SNAP, "a search of a whole tuning for each"))
def test_every_law_on_a_measurement(screw: fd.Loop, point: OperatingPoint, name: str) -> None:
    """Stable by the poles of the true loop, Ms and peak compliance as asked, half a per cent for 95 %."""
    design = design_of(screw, name)
    limits = Limits(sensitivity_peak=2.0, compliance_peak_m_per_N=0.2e-6)
    found = tune_control(design.loop.control, point, limits=limits, filters="kept", starts=1)
    assert found.holds, found.proof
    assert set(found.tunables) == {*law_tunables(design.loop.control)}
    both = loop_model(replace(design.loop, control=found.control))
    assert np.abs(both.closed.poles()[0]) < 1.0
    lines = both.lines(400)
    assert fd.margins(both.loop_gain(lines)).sensitivity_peak <= 2.01
    peak = np.max(both.closed.response(lines, "position_load", "load_force").magnitude)
    assert peak <= 0.201e-6
    assert 1e9 * rope_snap(both.closed) <= SNAP[name]


@pytest.mark.slow(reason="two searches of a law that cannot keep its limits")
@pytest.mark.timeout(1200)
def test_what_a_law_cannot_keep_is_refused_with_what_it_can(screw: fd.Loop) -> None:
    """The other tuner, on poles and sums, finds the same law soft: 66 nm √s/N with Ms <= 2 alone."""
    loop = design_of(screw, REFUSED).loop
    with pytest.raises(UnstableError, match=r"in conflict with .*reachable.*Ms <= "):
        tune_control(
            loop.control,
            loop,
            limits=Limits(sensitivity_peak=2.0, compliance_peak_m_per_N=0.2e-6),
            filters="kept",
            starts=1,
        )


def test_all_laws_are_here(screw: fd.Loop) -> None:
    """Those with an observer of another law are proven with the published table of the comparison.

    The laws of docs/reference/laws/field.md have tests of their own, and stored designs in the benchmark.
    """
    laws = ("P-PI", "DADSC", "super-twisting")
    others = {f"{law} + {observer} recovery" for law in laws for observer in ("Kalman", "GPI")}
    others |= {f"{law} + DOB" for law in ("P-P", *laws)} | {"super-twisting", "super-twisting + recovery"}
    others |= {"GPC, short horizon", "GPC, long horizon", "LADRC", "LQG"}
    assert {each.name for each in candidates(screw)[0] if not each.then} == {*SNAP, REFUSED, *others}
