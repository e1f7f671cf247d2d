"""From the commissioning file of a drive to its axis and a tuned control: what is read, fitted, handed on and said."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from commissioning_files import USUAL, TrueAxis, drawn, flat, nested, written
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.blocks.plant.screw_two_mass import ScrewTwoMass
from feeddrive.export.parameters import SINUMERIK, parameters_table
from feeddrive.figures import slopes
from feeddrive.files.commissioning import Commissioning, read_commissioning
from feeddrive.files.machine import machine_of_text
from feeddrive.identification.response import plant_fit
from feeddrive.identification.response.plant_fit import simplest, two_mass_band
from feeddrive.language import tree
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.frequency_response import FRF
from feeddrive.tuning.operating_point import response_on
from feeddrive.workflow import commissioning
from feeddrive.workflow.channels import ChannelsRequest, channels
from feeddrive.workflow.commissioning import DriveAxis, axis_key, drive_axis
from feeddrive.workflow.identify import identify
from feeddrive.workflow.identify_responses import IdentifyRequest
from feeddrive.workflow.tune import TuneRequest, tune

FULL = replace(USUAL, filters=((1999.0, 0.7), (310.0, 0.1, 310.0, 0.5), (900.0, 0.3, 1200.0, 0.7)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("commissioning")


def read(folder: Path, axis: TrueAxis, *, plain: bool = False, edit: Any = None) -> Commissioning:
    path = folder / "read.xml"
    text = flat(axis) if plain else nested(axis)
    path.write_text(text if edit is None else edit(text), encoding="iso-8859-1")
    file = read_commissioning(path)
    assert file is not None
    return file


@cache
def usual(folder: Path) -> DriveAxis:
    """The axis of the quick tests, fitted once."""
    file = read_commissioning(written(folder, USUAL))
    assert file is not None
    return drive_axis(file, Progress())


@pytest.mark.parametrize("plain", [False, True])
def test_the_file_is_read_whatever_the_version_calls_its_members(folder: Path, *, plain: bool) -> None:
    file = read(folder, FULL, plain=plain)
    assert (file.axis, file.rotary, file.linear_motor) == (FULL.name, True, False)
    assert file.per_motor == pytest.approx(FULL.per_motor)
    # in the file the clock has the digits of a single
    assert (file.clock, file.position_clock) == (FULL.clock, FULL.clock * FULL.slow)
    assert file.usable_from == pytest.approx(FULL.usable)
    assert file.inertia == pytest.approx(1.04 * FULL.inertia)
    assert file.motor_inertia == pytest.approx(FULL.motor)
    assert file.Kv == pytest.approx(FULL.gains[2])
    first, today = file.controllers
    assert (first.Kp, first.Tn) == pytest.approx(FULL.first_gains)
    assert (today.Kp, today.Tn) == pytest.approx(FULL.gains[:2])
    assert today is file.today
    assert [type(block) for block in today.filters[:2]] == [LowPass2, Notch]
    assert dict(tree.leaves(today.filters[0])) == {"frequency": 1999.0, "damping": 0.7}
    assert dict(tree.leaves(today.filters[1])) == {"frequency": 310.0, "damping_zero": 0.1, "damping_pole": 0.5}
    if not plain:
        assert isinstance(today.filters[2], SecondOrder)
        values = {"frequency_zero": 900.0, "damping_zero": 0.3, "frequency_pole": 1200.0, "damping_pole": 0.7}
        assert dict(tree.leaves(today.filters[2])) == values
        assert file.margins == pytest.approx(FULL.margins)
        assert file.averages == FULL.averages
        assert file.delays == pytest.approx(10.0 * FULL.clock)


def test_the_plant_is_the_one_with_a_coherence_and_names_are_short(folder: Path) -> None:
    file = read(folder, FULL)
    assert file.plants == ("mech_plants_1_plant", "mech_plants_2_plant")
    assert file.plant == "mech_plants_2_plant"
    assert file.current_loop == "current_controller_response"
    assert file.stamps[file.plant] == "2024-03-12 10:15:04"
    assert max(map(len, file.responses)) < 30
    frf, (f, values, coherence, _) = file.responses[file.plant], FULL.measured()
    np.testing.assert_array_equal(frf.frequency, f)
    np.testing.assert_array_equal(frf.response, values)
    assert frf.coherence is not None
    np.testing.assert_array_equal(frf.coherence, coherence)
    assert frf.unit == "(rad/s)/(N m)"


def test_a_linear_motor_has_a_plant_in_metres(folder: Path) -> None:
    def edit(text: str) -> str:
        return text.replace('"m_bMotorIsRotary">true', '"m_bMotorIsRotary">false')

    file = read(folder, replace(FULL, rotary=False), edit=edit)
    assert file.linear_motor
    assert {file.responses[name].unit for name in file.plants} == {"(m/s)/N"}
    assert not commissioning.is_linear(file)


def test_the_strategies_of_the_tool_are_not_what_runs(folder: Path) -> None:
    """A filter of 1234 Hz and 7 as the largest Kv stand only in a strategy."""
    file = read(folder, FULL)
    assert all(getattr(block, "frequency", 0.0) != 1234.0 for each in file.controllers for block in each.filters)
    assert file.Kv != 7.0


def test_an_integral_time_above_a_second_is_in_milliseconds(folder: Path) -> None:
    for written_, meant in ((0.9, 0.9), (1.1, 1.1e-3), (12.0, 0.012)):
        axis = replace(USUAL, gains=(USUAL.gains[0], written_, 1.0))
        today = read(folder, axis, plain=True).today
        assert today is not None
        assert today.Tn == pytest.approx(meant)


def test_what_the_law_has_no_part_for_is_said(folder: Path) -> None:
    def edit(text: str) -> str:
        text = text.replace('"m_bUsingReferenceModel">false', '"m_bUsingReferenceModel">true')
        pt1 = '<PT1Filter><float name="m_dTimeConst">0.001</float></PT1Filter>'
        empty = '"m_ConTimeFilterListActualSpeedFilters"><LinkedList name="m_LinkedList"'
        return text.replace(empty, f'"m_ConTimeFilterListActualSpeedFilters">{pt1}<LinkedList name="m_LinkedList"')

    today = read(folder, FULL, edit=edit).today
    assert today is not None
    assert today.left == ("a filter of the actual speed (PT1Filter)", "the reference model of the speed controller")
    pt1 = '<PT1Filter><float name="m_dTimeConst">0.0001</float></PT1Filter>'
    slow = read(folder, FULL, plain=True, edit=lambda text: text.replace("<PT2Filter>", f"{pt1}<PT2Filter>")).today
    assert slow is not None
    assert isinstance(slow.filters[0], LowPass)
    assert slow.filters[0].frequency == pytest.approx(1591.549, rel=1e-6)


def test_a_controller_that_only_repeats_the_one_before_it_is_one(folder: Path) -> None:
    """The tool stores what it proposes and then what it set: here the same gains, with filters or without."""
    twice = replace(FULL, first_gains=FULL.gains[:2])
    assert len(read(folder, replace(twice, filters=((1999.0, 0.7),))).controllers) == 1
    assert len(read(folder, twice).controllers) == 2


def test_two_masses_are_two_masses(folder: Path) -> None:
    """The bounds of the issue: total inertia within 5 % and inside three errors, the first zero within 1 Hz."""
    axis = usual(folder)
    fit = axis.result.fit
    assert axis.result.chosen == "two-mass"
    for name, true in (
        ("total_mass", USUAL.inertia),
        ("mass_motor", USUAL.motor),
        ("antiresonance", USUAL.first_zero()),
        ("resonance", USUAL.resonance),
    ):
        estimate = fit[name]
        assert abs(estimate.value - true) < 3.0 * estimate.error
        assert abs(estimate.value / true - 1.0) < 0.01
    assert fit["total_mass"].unit == "kg m2"
    assert fit["dead_time"].value == pytest.approx(USUAL.late, abs=10e-6)  # s, a tenth of the clock
    assert axis.plant.frequency[0] >= USUAL.usable
    assert any("lines below" in str(remark) for remark in axis.remarks)


def test_the_loop_of_the_file_is_the_measured_one(folder: Path) -> None:
    """The loop gain by measured point and by model, beside that of the true axis with both clocks, at its crossover."""
    axis = usual(folder)
    loop = axis.today
    law = loop.control.law
    assert isinstance(law, CascadePPI)
    assert (law.Kp, law.Tn, law.position_every) == (pytest.approx(USUAL.gains[0]), pytest.approx(USUAL.gains[1]), 16)
    assert law.Kv == pytest.approx(USUAL.gains[2] / 0.06)
    assert loop.axis.rotary
    assert loop.axis.one_encoder()
    point, _ = axis.point()
    f = point.frequency
    velocity = replace(loop.control, law=replace(law, Kv=1e-9, position_every=1))
    by_point = -np.einsum("kl,kl->l", response_on(point, velocity).value, point.by_force)
    s = 2j * np.pi * f
    # the filter by Tustin with prewarping, in its own frequency
    v = 1j * np.tan(np.pi * f * USUAL.clock) / np.tan(np.pi * 1999.0 * USUAL.clock)
    filtered = 1.0 / (v * v + 1.4 * v + 1.0)
    gain = USUAL.gains[0] * (1.0 + USUAL.clock / USUAL.gains[1] / (1.0 - np.exp(-s * USUAL.clock)))
    true = gain * filtered * USUAL.plant(f) * USUAL.current_loop(f)
    near = (f > 0.5 * USUAL.antiresonance) & (f < 4.0 * USUAL.resonance)
    # 1 % is the size of the systematic error and of the noise of the measurement, and 0.5 % that of the current loop's
    assert np.median(np.abs(by_point[near] / true[near] - 1.0)) < 0.02
    assert dict(tree.leaves(axis.machine().loop(None))) == dict(tree.leaves(loop))


def test_a_linear_axis_has_its_screw(folder: Path) -> None:
    """At the table: kg and N s/m, by the travel in a radian of the motor; the drive's own numbers come back out."""
    axis = usual(folder)
    r = 0.01 / (2.0 * math.pi)
    file = replace(axis.file, rotary=False, per_motor=r)
    loop, _ = commissioning._today(file, axis.result.fit, axis.today.axis.actuator)
    plant, law = loop.axis.plant, loop.control.law
    assert isinstance(plant, ScrewTwoMass)
    assert isinstance(law, CascadePPI)
    assert plant.lead == pytest.approx(0.01)
    assert plant.rigid_mass() * r * r == pytest.approx(axis.result.fit["total_mass"].value)
    assert law.Kp * r * r == pytest.approx(USUAL.gains[0])
    rows = {row[0]: row[1] for row in parameters_table(SINUMERIK, loop).rows}
    assert float(str(rows["p1460[0]"])) == pytest.approx(USUAL.gains[0], rel=1e-5)
    assert float(str(rows["MD32200 $MA_POSCTRL_GAIN[0]"])) == pytest.approx(USUAL.gains[2], rel=1e-5)
    assert float(str(rows["MD31030 $MA_LEADSCREW_PITCH"])) == pytest.approx(10.0, rel=1e-5)


def test_an_axis_that_turns_comes_out_in_the_drives_names(folder: Path) -> None:
    table = parameters_table(SINUMERIK, usual(folder).today)
    rows = {row[0]: (float(str(row[1])), row[2]) for row in table.rows}
    assert rows["p1460[0]"] == (pytest.approx(USUAL.gains[0], rel=1e-5), "Nms/rad")
    assert rows["p1462[0]"] == (pytest.approx(1e3 * USUAL.gains[1], rel=1e-5), "ms")
    assert rows["MD32200 $MA_POSCTRL_GAIN[0]"][0] == pytest.approx(USUAL.gains[2], rel=1e-5)
    assert rows["p1658[0]"] == (1999.0, "Hz")
    assert "MD31030 $MA_LEADSCREW_PITCH" not in rows


def test_the_current_loop_of_the_model_is_fitted_to_the_measured_one() -> None:
    w = 2.0 * np.pi * np.geomspace(5.0, 600.0, 200)
    true = -1j * w * 90e-6 - np.log(1.0 + 1j * w / (2.0 * np.pi * 800.0))
    corner, dead = commissioning._lag(w, true)
    assert corner == pytest.approx(800.0, rel=0.01)  # Hz: the corners that are tried are 1.5 % apart
    assert dead == pytest.approx(90e-6, abs=2e-6)
    # a loop that is ahead of its own clock has no dead time, and no drive a negative one
    assert commissioning._lag(w, -np.log(1.0 + 1j * w / 5e3) + 1j * w * 200e-6)[1] == 0.0


def test_a_position_gain_that_no_velocity_loop_carries_was_in_one_over_seconds(folder: Path) -> None:
    file = usual(folder).file
    rate = 100.0  # 1/s, of the velocity loop: 0.6 of it are 3.6 (1000/min)
    for Kv, read_ in ((3.5, 3.5 / 0.06), (3.7, 3.7), (25.0, 25.0)):
        value, (said,) = commissioning._position_gain(replace(file, Kv=Kv), rate)
        assert value == pytest.approx(read_)
        assert ("MD32200" in str(said)) == (read_ > Kv)
    assert commissioning._position_gain(replace(file, Kv=None), rate)[0] == 25.0


def test_a_file_without_an_axis_is_refused_with_what_there_is(folder: Path) -> None:
    file = usual(folder).file
    with pytest.raises(LogError, match=r"no response of the motor's speed to its torque.*there are: mech_plants_1"):
        drive_axis(replace(file, plants=()), Progress())
    with pytest.raises(ParameterError, match="there is no response 'mech_plants_3_plant'"):
        drive_axis(file, Progress(), motor="mech_plants_3_plant")
    with pytest.raises(LogError, match=r"lines of 'mech_plants_2_plant' from .* are too few"):
        drive_axis(file, Progress(), band=(3.0, 4.0))


def test_what_the_file_does_not_say_is_said(folder: Path) -> None:
    axis = usual(folder)
    bare = replace(axis.file, rotary=None, per_motor=None, controllers=(), Kv=None, second_encoder=True)
    loop, said = commissioning._today(bare, axis.result.fit, axis.today.axis.actuator)
    text = " ".join(map(str, said))
    for words in ("no speed controller", "no position gain", "give --lead for a screw", "a direct encoder"):
        assert words in text
    assert loop.axis.rotary
    _, words = commissioning._actuator(bare, None, axis.result.fit)
    assert "no response of the current loop" in str(words[0])
    assert [axis_key(name) for name in ("AX7", "X-1", "1A", "")] == ["ax7", "x_1", "x", "x"]


def test_a_file_without_a_clock_gives_a_model_and_asks_for_it(folder: Path) -> None:
    axis = replace(usual(folder), loop=None)
    with pytest.raises(LogError, match=r"states no sample time of the speed loop .*: give it with --sample-time"):
        axis.point()
    bare = read(
        folder,
        USUAL,
        plain=True,
        edit=lambda text: re.sub(r'<float name="m_d\w*UpdateTime\w*">[^<]*</float>', "", text),
    )
    assert bare.clock is None


def test_channels_of_a_commissioning_file_is_a_page(folder: Path) -> None:
    path = written(folder, FULL, name="channels.xml")
    outcome = channels.run(ChannelsRequest(log=path))
    shown = [line for item in outcome.shown(verbose=False) for line in str(item).splitlines()]
    assert len(shown) < 40
    text = "\n".join(shown)
    for words in ("mech_plants_2_plant", "2024-03-12 10:15:04", "0.125 ms", "today", "notch 310 Hz"):
        assert words in text
    assert "m_dCurrentControllerGain" not in text
    assert any("m_dCurrentControllerGain" in str(item) for item in outcome.shown(verbose=True))
    assert str(outcome.verdict) == f"feeddrive identify {path}, then feeddrive tune {path}"


def test_the_band_of_the_model_ends_below_further_modes() -> None:
    """Two masses with a resonance at 60 Hz, and a mode at 900 Hz that all lines to 4 kHz would take for it."""
    axis = replace(USUAL, antiresonance=40.0, load=1.25 * USUAL.motor, modes=((900.0, 0.02, 0.2),), noise=0.01)
    f, plant, _, _ = axis.measured()
    few = np.unique(np.searchsorted(np.log(f), np.linspace(np.log(5.0), np.log(f[-1]), 160)).clip(0, f.size - 1))
    exact = FRF(f[few], plant[few], "torque", "speed", "(rad/s)/(N m)", variance=(0.01 * np.abs(plant[few])) ** 2)
    band = two_mass_band(exact, held=False)
    assert axis.resonance < band.high < 900.0
    assert not band.whole


def test_a_structure_that_does_not_know_its_mass_is_not_taken() -> None:
    """Modes that predict unused lines a little better, with an inertia of 0.15 +- 0.8."""

    def fit(count: int, unused: float, error: float) -> Any:
        mass = SimpleNamespace(name="mass", value=0.15, error=error)
        others = [SimpleNamespace(name=f"modes.{i}.mass", value=1.0, error=0.0) for i in range(count - 1)]
        plant = SimpleNamespace(rigid_mass=lambda: 0.15)
        return SimpleNamespace(estimates=(mass, *others), plant=plant, agreement=SimpleNamespace(unused=unused))

    open_, known = fit(9, 0.010, 0.8), fit(6, 0.012, 0.001)
    assert simplest({"two-mass": known, "modal": open_}) == "two-mass"
    assert simplest({"two-mass": known, "modal": fit(9, 0.010, 0.001)}) == "modal"
    assert simplest({"modal": open_}) == "modal"
    # half of the mass is the bound
    assert simplest({"a": fit(6, 0.012, 0.074), "b": fit(9, 0.010, 0.0)}) == "b"
    assert simplest({"a": fit(6, 0.010, 0.076), "b": fit(9, 0.012, 0.0)}) == "b"
    assert plant_fit.UNKNOWN == 0.5


def test_noise_far_below_the_gain_limit_forbids_nothing() -> None:
    """A line on which noise is nine times the loop gain of -60 dB: a violation would need a thousandfold of it."""

    def place(size: float, relative: float) -> slopes.Place:
        f = np.array([900.0, 1000.0, 1100.0])
        gain = size * np.exp(1j * np.radians([-170.0, -179.0, -190.0]))
        variance = 2.0 * (relative * size) ** 2 * np.ones(3)
        x = np.log(f)
        level, phase = np.log(np.abs(gain)), np.unwrap(np.angle(gain))
        lines = (x, level, phase + np.pi, np.diff(phase))
        loop = SimpleNamespace(
            frequency=f, gain=gain, gain_slope=np.zeros((3, 1), complex), gain_variance=variance, logarithms=lines
        )
        (found,) = slopes.gain_margin_places(loop, 6.0, (0.0, math.inf))  # type: ignore[arg-type]
        return found

    far = place(1e-3, 9.0)
    assert far.slack > 3.0 * far.deviation
    # near the limit it is the relative noise, as ever
    near = place(0.499, 0.01)
    assert near.deviation == pytest.approx(0.01, rel=0.01)


@pytest.mark.slow(reason="a search over all gains and filters, with both clocks: 10 s")
def test_from_the_file_to_the_tuned_machine(tmp_path: Path) -> None:
    path = written(tmp_path, drawn(2))
    identified = identify.run(IdentifyRequest(logs=path, out=tmp_path / "model"))
    assert not identified.judgment.bad
    assert identified.then == f"feeddrive tune {path}"
    machine = machine_of_text((tmp_path / "model" / "machine.toml").read_text(encoding="utf-8"), "machine.toml")
    assert machine.loop(None).axis.rotary
    outcome = tune.run(TuneRequest(source=path, filters="kept", starts=1, out=tmp_path / "tuned"))
    assert not outcome.judgment.bad
    after = outcome.result.after[0].margins
    gain, phase = drawn(2).margins
    assert min(c.gain_margin_dB for c in after.phase_crossovers if c.gain_margin_dB > 0.0) >= gain - 0.05
    assert after.phase_margin_deg >= phase - 0.3
    assert any("p1460[0]" in str(table) for table in outcome.tables)
    assert (tmp_path / "tuned" / "machine.toml").is_file()
    from_file = tune.run(TuneRequest(source=tmp_path / "model" / "machine.toml", filters="kept", starts=1))
    assert not from_file.judgment.bad


class Stub:
    """A fit to a band: its resonance, in Hz, and a total mass; `begin` is what the fit began with."""

    def __init__(self, resonance: float, mass: float = 1.0, error: float = 0.0) -> None:
        self.derived = (SimpleNamespace(name="total_mass", value=mass, error=error),)
        self.estimates = ()
        self.resonance, self.plant, self.units = resonance, "plant", None

    def __getitem__(self, name: str) -> Any:
        return SimpleNamespace(value=self.resonance)


def bands(
    monkeypatch: pytest.MonkeyPatch, errors: dict[int, float], resonance: float = 50.0, masses: Any = None
) -> tuple[plant_fit.ModelBand, list[tuple[int, int, int]]]:
    """The band that is chosen when the fit up to each frequency has this error; upper end, lines and starts of each."""
    tried: list[tuple[int, int, int]] = []

    def fit(part: FRF, *, held: bool, begin: Any) -> Any:
        tried.append((round(part.frequency[-1]), part.frequency.size, len(begin)))
        top = tried[-1][0]
        return SimpleNamespace(top=top) if masses is None else Stub(resonance, *masses.get(top, (1.0, 0.0)))

    def with_resonance(part: FRF, *, held: bool, begin: Any) -> Any:
        made = fit(part, held=held, begin=begin)
        if masses is None:
            stub = Stub(resonance)
            stub.top = made.top  # type: ignore[attr-defined]
            return stub
        made.top = tried[-1][0]
        return made

    monkeypatch.setattr(plant_fit, "fit_two_mass", with_resonance)
    monkeypatch.setattr(plant_fit, "_of_grid", lambda *_: ["a", "b", "c", "d"])
    monkeypatch.setattr(plant_fit, "_misses", lambda fit: errors.get(fit.top, 0.0))
    # the ends of the octaves below 4096 Hz are lines
    f = np.unique(np.concatenate([np.geomspace(10.0, 4096.0, 900), 4096.0 / 2.0 ** np.arange(8)]))
    frf = FRF(f[f >= 10.0], 1.0 / (2j * np.pi * f[f >= 10.0]), "torque", "speed", "(rad/s)/(N m)")
    return two_mass_band(frf, held=False), tried


@pytest.mark.parametrize(("error", "high"), [(0.019, 4096.0), (0.021, 2048.0)])
def test_a_band_whose_model_is_off_by_two_per_cent_is_explained(
    monkeypatch: pytest.MonkeyPatch, error: float, high: float
) -> None:
    band, _ = bands(monkeypatch, {4096: error})
    assert band.high == pytest.approx(high)
    assert band.whole == (high > 4000.0)


@pytest.mark.parametrize(("error", "high"), [(0.148, 4096.0), (0.152, 2048.0)])
def test_where_no_band_is_explained_half_as_much_again_will_do(
    monkeypatch: pytest.MonkeyPatch, error: float, high: float
) -> None:
    others = {4096 // 2**k: 0.1 for k in range(1, 8)}
    assert bands(monkeypatch, {4096: error, **others})[0].high == pytest.approx(high)


def test_bands_are_octaves_down_to_eight_times_the_lowest_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two hundred lines each; the first fit finds its starts, the others begin with its plant and two of the grid."""
    _, tried = bands(monkeypatch, {4096 // 2**k: 1.0 for k in range(8)})
    assert [top for top, _, _ in tried] == [4096, 2048, 1024, 512, 256, 128]
    assert {lines for _, lines, _ in tried[:3]} <= set(range(190, 201))
    assert [begun for _, _, begun in tried] == [0, 3, 3, 3, 3, 3]


def test_no_band_is_fitted_that_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once a band is explained, the two below it tell its systematic error; a wider one that is not stays open."""
    errors = {4096: 0.5, 2048: 0.01, 1024: 0.5}
    band, tried = bands(monkeypatch, errors)
    assert band.high == pytest.approx(2048.0)
    assert [top for top, _, _ in tried] == [4096, 2048, 1024, 512]
    # 0.021 is within 1.5 times 0.019 and would be taken, unless a narrower band is better by far
    open_ = {4096: 0.021, 2048: 0.019, 1024: 0.019, 512: 0.019, 256: 0.019}
    for last, high in ((0.019, 4096.0), (0.001, 2048.0)):
        band, tried = bands(monkeypatch, {**open_, 128: last})
        assert [top for top, _, _ in tried] == [4096, 2048, 1024, 512, 256, 128]
        assert band.high == pytest.approx(high)


@pytest.mark.parametrize(("resonance", "whole"), [(97.0, False), (100.0, True), (3100.0, True), (3200.0, True)])
def test_a_band_shows_the_far_side_of_its_resonance(
    monkeypatch: pytest.MonkeyPatch, resonance: float, *, whole: bool
) -> None:
    """Only that to 128 Hz is explained: it counts up to a resonance of 98.5 Hz, 1.3 times below its end."""
    errors = {4096 // 2**k: 1.0 for k in range(5)}
    band, _ = bands(monkeypatch, errors, resonance)
    assert band.whole == whole
    # 3151 Hz times 1.3 is the end of all lines: above it no band has a resonance, and there is nothing to begin with
    assert (band.begin == ()) == (resonance > 3151.0)


def test_the_scatter_of_two_narrower_bands_is_part_of_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    masses = {4096: (1.0, 0.0), 2048: (1.03, 0.0), 1024: (1.04, 0.0), 512: (2.0, 0.0)}
    band, _ = bands(monkeypatch, {}, masses=masses)
    assert band.scatter["total_mass"] == pytest.approx(math.sqrt((0.03**2 + 0.04**2) / 2.0))
    # a narrower band with a larger standard error says nothing
    noisy = {4096: (1.0, 0.01), 2048: (1.03, 0.04), 1024: (1.04, 0.05)}
    assert bands(monkeypatch, {}, masses=noisy)[0].scatter["total_mass"] == 0.0


def test_errors_include_what_no_statistics_show(folder: Path) -> None:
    """Half a per cent of masses, springs and dampers, for the current sensor; a thousandth of a frequency."""
    fit = usual(folder).result.fit
    bare = replace(
        fit,
        estimates=tuple(replace(e, error=0.0) for e in fit.estimates),
        derived=tuple(replace(e, error=0.0) for e in fit.derived),
    )
    wide = plant_fit.ModelBand(5.0, 500.0, False, (), {}).widened(bare)
    assert wide["total_mass"].error == pytest.approx(0.005 * fit["total_mass"].value)
    assert wide["stiffness"].error == pytest.approx(0.005 * fit["stiffness"].value)
    assert wide["resonance"].error == pytest.approx(0.001 * fit["resonance"].value)
    assert wide["dead_time"].error == 0.0


def test_sixteen_lines_are_the_least(folder: Path) -> None:
    file = usual(folder).file
    assert file.plant is not None
    f = file.responses[file.plant].frequency
    with pytest.raises(LogError, match="15 lines"):
        commissioning._measured(file, file.plant, (f[100], f[114]))
    assert commissioning._measured(file, file.plant, (f[100], f[116]))[0].frequency.size == 17
