"""Sizes and bounds of the steps of `feeddrive commission`: of motions on an axis in closed form, and of what is tried.

Steps begin from a record with facts that are stated here, as after an interruption, and end with a no to a question.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.harmonic import Harmonic
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.bus.drive_file import BusLimits
from feeddrive.bus.play import Played, Profile
from feeddrive.commissioning.cogging import described, stated
from feeddrive.commissioning.friction import FrictionFit
from feeddrive.commissioning.record import Commissioned, Step, digests, write_record
from feeddrive.files.frf import write_frf
from feeddrive.files.log import Log
from feeddrive.files.machine import read_machine
from feeddrive.files.read_log import read_log
from feeddrive.language.block import Block
from feeddrive.language.errors import DivergedError, NotCertifiedError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow.commission_steps import Chain
from small_axis import MACHINE as SMALL

module = importlib.import_module("feeddrive.workflow.commission_steps")

T = 1e-3  # s
LIMITS = BusLimits(travel=0.1, velocity=0.5, force=1000.0, following_error=2e-3, quick_stop_deceleration=2.0)
FACTS = {
    "listened_noise": 0.0,
    "holding": 0.0,
    "friction": 40.0,
    "lag": 0.02,
    "noise": 1e-8,
    "rough_mass": 100.0,
    "force_sign": 1.0,
    "length_factor": 1.0,
    "mass": 100.0,
    "mass_error": 1.0,
    "coulomb": 40.0,
    "viscous": 300.0,
    "dead_time": 2e-3,
    "wide": 0.0,
    "soft": 0.0,
    "amplitude": 20.0,
    "model_band": 400.0,
    "gap": 0.0,
    "resistance": 40.0,
}


@dataclass
class Axis:
    """An axis that follows every motion `lag` s late, with mass, friction and weight; it notes what it played."""

    limits: BusLimits = LIMITS
    mass: float = 100.0
    coulomb: float = 40.0
    held: float = 0.0
    lag: float = 0.02
    led: float = 1e-4  # s, under a control on trial
    blocked: int = 0  # small moves that end early
    cause: str = "following_error"  # for which they do
    stands: bool = False  # a control on trial does not move it, as the monitor says
    buzz: float = 0.0  # N, of the force of a control from sample to sample
    increment: float = 1e-8
    rotary: bool = False
    played: list[tuple[Profile, BusLimits]] = field(default_factory=list)
    guards: list[float] = field(default_factory=list)  # bounds of the following error of controls on trial, m
    where: str = "paper, axis 1"
    commanded: str = "force"
    is_virtual: bool = False
    sample_time: float = T
    takes: tuple[type[Block], ...] = (Block,)

    def limited(self, limits: BusLimits) -> Axis:
        return replace(self, limits=limits)

    def scaled(self, factor: float, force_sign: int = 1) -> Axis:
        return self

    def as_found(self) -> Axis:
        return self

    def text(self) -> str:
        return "paper"

    def listen(self, seconds: float, progress: Progress | None = None) -> Played:
        still = np.zeros(round(seconds / T))
        return Played(self._log(still, still, still, still), None, 0, None, ())

    def play(self, profile: Profile, progress: Progress | None = None, control: Control | None = None) -> Played:
        self.played.append((profile, self.limits))
        speed = np.gradient(profile.set_position, T)
        late = (self.led if control is not None else self.lag) * speed
        force = self.held + self.coulomb * np.sign(speed) + self.mass * np.gradient(speed, T)
        if control is not None:
            force = force + 0.5 * self.buzz * (-1.0) ** np.arange(speed.size)
        spectrum = np.fft.rfft(profile.excitation)
        omega = 2.0 * np.pi * np.fft.rfftfreq(speed.size, T)
        spectrum[1:] /= -self.mass * omega[1:] ** 2
        shaken = np.fft.irfft(spectrum, speed.size) if np.any(profile.excitation) else 0.0
        log = self._log(profile.set_position, profile.set_position - late + shaken, force, profile.excitation)
        if control is not None and control.guard is not None:
            self.guards.append(float(control.guard.following_error_limit or 0.0))
        if control is not None and self.stands:
            return Played(log, "it stands", 0, None, (), "standstill")
        blocked = profile.name == "small move" and len(self.of(profile.name)) <= self.blocked
        return Played(log, "it stands" if blocked else None, 0, None, (), self.cause if blocked else "")

    @staticmethod
    def _log(target: np.ndarray, reading: np.ndarray, force: np.ndarray, excitation: np.ndarray) -> Log:
        channels = {
            "set_position": target,
            "reading_load": reading,
            "velocity_load": np.gradient(reading, T),
            "force": force + excitation,
            "commanded": force + excitation,
            "excitation": excitation,
        }
        units = {"set_position": "m", "reading_load": "m", "velocity_load": "m/s", "force": "N", "commanded": "N"}
        return Log(name="paper", time=T * np.arange(target.size), channels=channels, units=units, sample_time=T)

    def inside(self) -> Mapping[str, str]:
        return {}

    def keep(self, machine_file: Path, export: Path, inside: Mapping[str, str]) -> str:
        raise AssertionError("nothing is kept here")

    def restore(self, inside: Mapping[str, str]) -> str:
        return ""

    def of(self, name: str) -> list[tuple[Profile, BusLimits]]:
        """What was played under a name, with the limits."""
        return [each for each in self.played if each[0].name == name]


class Person(Progress):
    """Says yes until a question begins with some words."""

    def __init__(self, until: str) -> None:
        super().__init__()
        self.until, self.asked, self.remarks = until, list[str](), list[str]()

    def confirm(self, question: str) -> bool:
        self.asked.append(str(question))
        return not str(question).startswith(self.until)

    def measured(self, question: str, expected: float, unit: str) -> float | None:
        return expected

    def show_remark(self, message: Any) -> None:
        self.remarks.append(str(message))


def begun(folder: Path, axis: Axis, before: str = "listen", until: str = "Small", **facts: float) -> Commissioned:
    """Run the steps from one on, with the facts of those before it, until a question that gets a no."""
    return fd.commission(axis, out=begun_at(folder, before, **facts), progress=Person(until))


def begun_at(folder: Path, before: str, **facts: float) -> Path:
    """Write a record of the steps before one, with the facts that are stated; return its folder."""
    steps = list(module.STEPS)[: list(module.STEPS).index(before)]
    done = []
    for number, name in enumerate(steps, start=1):
        place = folder / f"{number}_{name}"
        files = [str(path.relative_to(folder)) for path in sorted(place.rglob("*")) if path.is_file()]
        done.append(Step(name, "stated", {**FACTS, **facts}, digests(folder, files)))
    if done:
        folder.mkdir(exist_ok=True)
        axis = Axis()
        write_record(folder, axis.text(), module.asked_of(module.CommissionRequest(axis)), {}, done, {})
    return folder


def speed(profile: Profile) -> float:
    return float(np.max(np.abs(profile.velocity)))


# the small move


def test_the_small_move_begins_with_a_tenth_of_the_force_and_doubles_it_twice(tmp_path: Path) -> None:
    axis = Axis(blocked=3)
    result = begun(tmp_path / "out", axis, until="Friction")
    assert result.refusal == "the small move ended early: it stands"
    assert [limits.force for _, limits in axis.of("small move")] == pytest.approx([100.0, 200.0, 400.0], rel=0.01)
    axis = Axis(blocked=2)
    begun(tmp_path / "other", axis, until="Friction")
    forces = [limits.force for _, limits in axis.of("small move")]
    assert forces[:3] == pytest.approx([100.0, 200.0, 400.0], rel=0.01)


def test_an_axis_that_stands_still_gets_more_force_in_the_small_move_alone(tmp_path: Path) -> None:
    axis = Axis(blocked=1, cause="standstill")
    begun(tmp_path / "out", axis, until="Friction")
    forces = [limits.force for _, limits in axis.of("small move")]
    assert forces[:2] == pytest.approx([100.0, 200.0], rel=0.01)
    # a new control that does not move the axis is not tried again with another one: its readings may be frozen
    axis, result = tried(tmp_path / "trial", stands=True)
    assert result.refusal == "the gentle trial ended early: it stands"
    assert [profile.name for profile, _ in axis.played] == ["gentle trial"]


@pytest.mark.parametrize("cause", ["person", "runaway", "jump", "bus", "drive", ""])
def test_what_is_no_motion_that_asked_for_too_much_is_not_tried_again(tmp_path: Path, cause: str) -> None:
    """Nothing moves after a person's stop, nor after readings or a drive that cannot be trusted."""
    axis = Axis(blocked=3, cause=cause)
    result = begun(tmp_path / "out", axis, until="Friction")
    assert len(axis.of("small move")) == 1
    assert axis.played[-1][0].name == "small move"
    assert result.refusal.startswith("it was stopped by hand" if cause == "person" else "the small move ended early")


@pytest.mark.parametrize(("travel", "moved"), [(0.1, 0.01), (0.05, 0.005), (1.0, 0.01)])
def test_it_is_a_tenth_of_the_travel_and_at_most_10_mm(tmp_path: Path, travel: float, moved: float) -> None:
    axis = Axis(limits=replace(LIMITS, travel=travel))
    begun(tmp_path / "out", axis, until="Friction")
    first, _ = axis.of("small move")[0]
    assert first.set_position[-1] == pytest.approx(moved)


def test_an_axis_that_turns_moves_by_at_most_a_fifth_of_a_radian(tmp_path: Path) -> None:
    axis = Axis(limits=replace(LIMITS, travel=20.0), rotary=True)
    begun(tmp_path / "out", axis, until="Friction")
    assert axis.of("small move")[0][0].set_position[-1] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("lag", "expected"),
    [
        # 0.4 of 2 mm of following error, over the lag
        (0.02, 0.04),
        # of a drive that feeds forward at least 1 ms is counted, with which the fifth of the velocity is the bound
        (0.0, 0.1),
    ],
)
def test_a_push_slides_as_fast_as_the_following_error_allows(tmp_path: Path, lag: float, expected: float) -> None:
    axis = Axis(limits=replace(LIMITS, travel=2.0), lag=lag)
    begun(tmp_path / "out", axis, until="Friction")
    profile, _ = axis.of("push")[0]
    assert speed(profile) == pytest.approx(expected, rel=0.02)


def test_a_drive_with_feedforward_is_taken_to_be_late_by_a_millisecond(tmp_path: Path) -> None:
    axis = Axis(limits=replace(LIMITS, travel=5.0, velocity=5.0, quick_stop_deceleration=20.0), lag=1e-4)
    begun(tmp_path / "out", axis, until="Friction")
    # 0.4 of 2 mm in 1 ms
    assert speed(axis.of("push")[0][0]) == pytest.approx(0.8, rel=0.02)


def test_a_push_needs_six_tenths_of_the_travel(tmp_path: Path) -> None:
    axis = Axis(limits=replace(LIMITS, travel=0.05), lag=1e-3)
    begun(tmp_path / "out", axis, until="Friction")
    profile, _ = axis.of("push")[0]
    # at a lower speed than that of the rule, and a little less for the shorter ramp
    assert 0.8 * 0.6 * 0.05 < profile.set_position[-1] <= 0.6 * 0.05


# strokes


def none(*_: Any, **__: Any) -> Any:
    raise ParameterError("no excitation within the limits")


def strokes(
    monkeypatch: pytest.MonkeyPatch, folder: Path, error: float = 1.0, *, led: float = 1e-4, **limits: float
) -> tuple[Axis, Commissioned]:
    """Strokes from the facts that are stated, which give 120 kg with an error; nothing comes after them."""
    rigid = SimpleNamespace(estimates=())
    mass, delay = SimpleNamespace(value=120.0, error=error), SimpleNamespace(dead_time=1.0)
    found = SimpleNamespace(result=SimpleNamespace(rigid=rigid, mass=mass, delay=delay), verdict="")
    monkeypatch.setattr(module, "identify", SimpleNamespace(run=lambda *_: found))
    monkeypatch.setattr(module, "design_excitation", none)
    axis = Axis(limits=replace(LIMITS, **limits), led=led)
    return axis, begun(folder, axis, "start_law", until="Responses")


def test_strokes_take_six_tenths_of_the_travel_slow_ones_a_quarter_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    axis, _ = strokes(monkeypatch, tmp_path / "out", following_error=0.05)
    series = [profile for profile, _ in axis.of("first stroke")]
    reached = [float(np.max(profile.set_position)) for profile in series]
    assert reached[0] == pytest.approx(0.25 * 0.6 * 0.1)
    assert reached[-1] == pytest.approx(0.6 * 0.1)
    # half of the free force on 100 kg: 4.8 m/s2 and not more than the quick stop; three ramps within the travel
    fastest = (2.0 * 0.06 / 3.0) ** 0.5
    assert speed(series[-1]) == pytest.approx(fastest, rel=0.01)
    assert speed(series[0]) == pytest.approx(0.1 * fastest, rel=0.01)
    # one to and fro tells the following error; strokes at five speeds follow at the last pace alone
    assert series[-1].set_position.size < 0.3 * axis.of("strokes")[0][0].set_position.size
    assert speed(axis.of("strokes")[0][0]) == pytest.approx(fastest, rel=0.01)
    assert len(axis.of("strokes")) == 1


def test_a_force_along_the_travel_is_told_by_strokes_over_all_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The slower series are shorter ones; without such a force the last of them is enough."""
    axis, result = strokes(monkeypatch, tmp_path / "out", led=0.01)
    series = [profile for profile, _ in axis.of("strokes")]
    assert np.max(series[-1].set_position) < 0.9 * 0.6 * 0.1
    assert "along_force" not in result["friction_and_mass"].figures
    found = Cogging(force=30.0, period=0.02, harmonics=tuple(Harmonic(order=n, share=1.0 / n) for n in (1, 2, 3)))
    monkeypatch.setattr(module, "periodic_force", lambda *_: found)
    axis, result = strokes(monkeypatch, tmp_path / "other", led=0.01)
    more = [profile for profile, _ in axis.of("strokes")]
    assert len(more) == len(series) + 1
    assert np.max(more[-1].set_position) == pytest.approx(0.6 * 0.1)
    assert speed(more[-1]) == pytest.approx(speed(series[-1]), rel=0.01)
    assert repr(stated(result["friction_and_mass"].figures)) == repr(found)
    log = read_log(tmp_path / "other" / "4_friction_and_mass" / "strokes.parquet")
    assert np.max(np.abs(log["acting"] - log["commanded"])) == pytest.approx(
        np.max(np.abs(found.at(log["reading_load"]))), rel=0.01
    )


def test_strokes_use_half_of_the_force_that_is_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    axis, _ = strokes(monkeypatch, tmp_path / "out", following_error=0.05, force=200.0, quick_stop_deceleration=2.0)
    series = [profile for profile, _ in axis.of("strokes")]
    acceleration = float(np.max(np.abs(np.diff(series[-1].set_position, 2)))) / T**2
    assert acceleration == pytest.approx(0.5 * (200.0 - 40.0) / 100.0, rel=0.01)


def test_strokes_leave_a_part_of_the_velocity_for_overshoot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    axis, _ = strokes(monkeypatch, tmp_path / "out", following_error=0.05, velocity=0.1)
    assert speed(axis.of("strokes")[-1][0]) == pytest.approx(module.FAST * 0.1, rel=0.01)


def test_a_start_law_bears_two_milliseconds_that_nobody_knows_beside_two_cycles(tmp_path: Path) -> None:
    begun(tmp_path / "out", Axis(), "start_law", until="Friction")
    loop = read_machine(tmp_path / "out" / "3_start_law" / "machine.toml").loop("x")
    assert float(loop.axis.actuator.dead_time) == pytest.approx(2e-3 + 2.0 * T)


@pytest.mark.parametrize(("error", "taken"), [(9.0, 120.0), (15.0, 100.0)])
def test_a_mass_by_strokes_is_taken_if_it_is_known_to_a_tenth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: float, taken: float
) -> None:
    """The strokes give 120 kg, where the push gave 100 kg."""
    _, result = strokes(monkeypatch, tmp_path / "out", error)
    assert result["friction_and_mass"].figures["mass"] == taken


# the excitation


def standing(monkeypatch: pytest.MonkeyPatch, factor: Callable[[float], float]) -> list[Any]:
    """Put excitations in place of designed ones that stand out of the noise by a factor of their highest line; there is
    none for 0.  Returns the list of the options that are asked for.
    """
    asked = list[Any]()

    def design(loop: Any, **options: Any) -> Any:
        asked.append(SimpleNamespace(**options))
        low, top = options["band"]
        if not factor(top):
            none()
        # two lines over four samples in all: a line moves 100 kg by a / (m w^2), and its noise is that of the reading
        noise = np.hypot(FACTS["noise"], 1e-8 / 3.5)
        amplitude = factor(top) * noise * 100.0 * (2.0 * np.pi * top) ** 2
        still = SimpleNamespace(signals={"set_position": np.zeros(1), "reading_load": np.zeros(1)})
        return SimpleNamespace(
            drawings=(still,),
            periods=1,
            period=4,
            crest=1.0,
            lines=np.arange(2),
            frequency=[low, top],
            amplitude=amplitude,
        )

    def written(*_: Any) -> None:
        raise ParameterError("it would be written")

    monkeypatch.setattr(module, "design_excitation", design)
    monkeypatch.setattr(module, "excitation_report", lambda *_: None)
    monkeypatch.setattr(module, "write_excitation", written)
    return asked


def not_designed(monkeypatch: pytest.MonkeyPatch, folder: Path, axis: Axis | None = None, **facts: float) -> list[Any]:
    """The options of each excitation that is asked for, where there is none."""
    asked = standing(monkeypatch, lambda _: 0.0)
    result = begun(folder, axis or Axis(), "excitation", until="Responses", **facts)
    assert "stands out of the noise" in result.refusal
    return asked


def test_an_excitation_has_eight_realisations_and_lines_over_a_factor_of_fifty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = not_designed(monkeypatch, tmp_path / "out")
    # lines up to the 400 Hz up to which modes are looked for, and from a fiftieth of it
    assert asked[0].band == pytest.approx((8.0, 400.0))
    assert {each.realisations for each in asked} == {8}
    # of 960 N above friction
    assert asked[0].amplitude == pytest.approx(0.5 * 960.0)
    assert asked[0].travel == pytest.approx(0.6 * 0.1)


def test_a_fine_grid_counts_more_than_a_band_beyond_400_hz(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At a rate of 4 kHz bands end at 1,000 Hz or lower; the coarsest grid comes before those that end below 200 Hz."""
    asked = not_designed(monkeypatch, tmp_path / "out", Axis(sample_time=0.25e-3), dead_time=0.0)
    tried = list(dict.fromkeys((each.resolution, round(each.band[1])) for each in asked))
    assert tried[:6] == [(grid, top) for grid in (1.0, 2.0) for top in (1000, 700, 490)]
    assert tried[6:10] == [(grid, top) for top in (343, 240) for grid in (1.0, 2.0)]
    assert tried[10:15] == [(4.0, top) for top in (1000, 700, 490, 343, 240)]
    assert tried[15:18] == [(grid, 168) for grid in (1.0, 2.0, 4.0)]


@pytest.mark.parametrize(
    ("dead_time", "widest"),
    [
        # 0.4 over the dead time and a cycle of 0.25 ms
        (0.25e-3, 800.0),
        # at least as far as modes are looked for
        (2e-3, 400.0),
        # at most 1 kHz
        (0.0, 1000.0),
    ],
)
def test_a_dead_time_bounds_the_band_of_an_excitation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dead_time: float, widest: float
) -> None:
    asked = not_designed(monkeypatch, tmp_path / "out", Axis(sample_time=0.25e-3), dead_time=dead_time)
    assert asked[0].band[1] == pytest.approx(widest)


@pytest.mark.parametrize(("stands_out", "tops"), [(5.5, {400.0}), (4.5, {400.0, 280.0})])
def test_the_highest_line_is_five_times_its_noise_or_the_band_ends_lower(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stands_out: float, tops: set[float]
) -> None:
    asked = standing(monkeypatch, lambda top: stands_out if top > 300.0 else 6.0)
    result = begun(tmp_path / "out", Axis(), "excitation", until="Responses", dead_time=0.0)
    assert result.refusal == "it would be written"
    assert {round(each.band[1], 6) for each in asked} == tops


def test_an_axis_with_cogging_is_shaken_with_a_force_against_it_that_is_no_excitation(tmp_path: Path) -> None:
    along = Cogging(force=30.0, period=0.02, harmonics=tuple(Harmonic(order=n, share=1.0 / n) for n in (1, 2, 3)))
    axis = Axis()
    chain = module.Chain(module.CommissionRequest(None, virtual="paper"), axis, tmp_path, Person(""))
    chain.facts = FACTS | described(along)
    path = np.concatenate([np.zeros(200), np.linspace(0.0, 0.047, 800), np.full(200, 0.047)])
    shaken = 10.0 * np.sin(np.arange(path.size)) * np.hanning(path.size)
    log = chain._excited(axis, Profile("excitation", "", T, "N", shaken, path, np.gradient(path, T)), None)
    against = axis.played[0][0].excitation - shaken
    np.testing.assert_allclose(against[100:-100], -along.at(path)[100:-100], atol=1e-9)
    # the axis begins at rest, and ends where it would be pulled
    assert abs(along.at(path)[-1]) > 10.0
    assert against[0] == against[-1] == 0.0
    np.testing.assert_array_equal(log["excitation"], shaken)


# what is tried of a model, a tuning and a start law


BAD = SimpleNamespace(judgment=SimpleNamespace(bad=True), files={}, verdict="", notes=(), failure="not good")


def prepared(folder: Path, highest: float = 400.0) -> None:
    """Files of the steps that fit and tune: a start law, and a response with lines from 4 Hz on."""
    begun(folder, Axis(), "start_law", until="Friction")
    text = (folder / "3_start_law" / "machine.toml").read_text()
    for place in ("5_excitation", "7_model"):
        (folder / place).mkdir()
        (folder / place / "machine.toml").write_text(text)
    (folder / "6_responses" / "responses").mkdir(parents=True)
    lines = np.linspace(4.0, highest, 50)
    response = FRF(lines, -1.0 / (100.0 * (2.0 * np.pi * lines) ** 2), "commanded", "reading_load", "m/N", T)
    write_frf(folder / "6_responses" / "responses" / "frf.csv", response)


def test_a_model_is_fitted_to_all_of_the_band_to_half_and_to_a_quarter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared(tmp_path / "out")
    bands, lags = list[str](), list[float | None]()

    def fitted(request: Any, _: Progress) -> Any:
        bands.append(request.band)
        lags.append(request.machine.loop("x").axis.actuator.current_loop)
        return BAD

    monkeypatch.setattr(module, "identify", SimpleNamespace(run=fitted))
    result = begun(tmp_path / "out", Axis(), "model")
    assert result.refusal.startswith("model:")
    # with the encoder at the motor and at the load, each with the lag of the current loop and without, in three
    # structures
    assert bands == 3 * [band for top in (400, 200, 100) for band in 4 * [f"4..{top}"]]
    assert lags == 3 * [lag for top in (400.0, 200.0, 100.0) for lag in 2 * [top, None]]


def test_a_control_is_tuned_on_responses_then_with_wider_margins_then_a_start_law_is_slowed_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared(tmp_path / "out")
    tuned, gains = list[tuple[str, float | None]](), list[float]()

    def not_tuned(request: Any, _: Progress) -> Any:
        tuned.append((request.source.name, request.max_ms))
        return BAD

    def not_certified(request: Any, _: Progress) -> Any:
        law: Any = read_machine(request.source).loop("x").control.law
        gains.append(float(law.Kv))
        raise NotCertifiedError("its margin is used up")

    monkeypatch.setattr(module, "tune", SimpleNamespace(run=not_tuned))
    monkeypatch.setattr(module, "certify", SimpleNamespace(run=not_certified))
    result = begun(tmp_path / "out", Axis(), "tune")
    assert result.refusal == "tuning: its margin is used up"
    assert tuned == [("frf.csv", 2.0), ("machine.toml", 2.0), ("machine.toml", 1.5), ("machine.toml", 1.25)]
    # each within the model, and within a fit of the responses
    loop = read_machine(tmp_path / "out" / "7_model" / "machine.toml").loop("x")
    law: Any = loop.control.law
    assert gains[::2] == pytest.approx(float(law.Kv) * np.array([1.0, 0.6, 0.36, 0.2, 0.1]), rel=1e-4)


@pytest.mark.parametrize(
    ("amplitude", "again"),
    [
        # 0.4 of 40 N of friction, and half as much again
        (24.1, True),
        (23.9, False),
    ],
)
def test_before_a_tuning_is_refused_responses_are_measured_with_a_force_that_leaves_a_play_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, amplitude: float, again: bool
) -> None:
    prepared(tmp_path / "out", 370.0)

    def not_certified(*_: Any) -> Any:
        raise NotCertifiedError("its margin is used up")

    monkeypatch.setattr(module, "tune", SimpleNamespace(run=lambda *_: BAD))
    monkeypatch.setattr(module, "certify", SimpleNamespace(run=not_certified))
    asked = standing(monkeypatch, lambda _: 6.0)
    person = Person("Nothing")
    out = begun_at(tmp_path / "out", "tune", amplitude=amplitude)
    result = fd.commission(Axis(), out=out, progress=person)
    assert result.refusal == ("it would be written" if again else "tuning: its margin is used up")
    assert [each.amplitude for each in asked[:1]] == ([pytest.approx(0.4 * 40.0)] if again else [])
    # up to the same lines, and without another question
    assert [each.band[1] for each in asked[:1]] == ([pytest.approx(400.0)] if again else [])
    assert person.asked == []


def test_noise_may_shake_a_tuned_force_by_a_tenth_of_what_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared(tmp_path / "out")
    asked = list[Any]()

    def not_tuned(request: Any, _: Progress) -> Any:
        asked.append(request)
        raise ParameterError("it is not tuned here")

    def not_certified(*_: Any) -> Any:
        raise NotCertifiedError("its margin is used up")

    monkeypatch.setattr(module, "tune", SimpleNamespace(run=not_tuned))
    monkeypatch.setattr(module, "certify", SimpleNamespace(run=not_certified))
    fd.commission(
        Axis(), out=begun_at(tmp_path / "out", "tune", noise=3e-8, holding=-160.0), progress=Person("Nothing")
    )
    # 30 nm of reading noise and a count of 10 nm
    assert len(asked) == 4
    assert [each.reading_noise for each in asked] == pytest.approx(4 * [np.hypot(3e-8, 1e-8 / np.sqrt(12.0))])
    assert [each.max_noise for each in asked] == pytest.approx(4 * [0.1 * (1000.0 - 160.0 - 40.0)])
    own = module.CommissionRequest(Axis(), out=begun_at(tmp_path / "out", "tune"), max_noise=5.0)
    asked.clear()
    module.Chain(own, Axis(), tmp_path / "out", Person("Nothing")).run(kept=True)
    assert {each.max_noise for each in asked} == {5.0}


@pytest.mark.parametrize(
    ("highest", "again"),
    [
        # 0.45 of a rate of 1 kHz is the widest band, of which less than 0.8 may be widened
        (350.0, True),
        (370.0, False),
    ],
)
def test_responses_are_measured_further_once_before_a_tuning_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, highest: float, again: bool
) -> None:
    prepared(tmp_path / "out", highest)

    def not_certified(*_: Any) -> Any:
        raise NotCertifiedError("its margin is used up")

    monkeypatch.setattr(module, "tune", SimpleNamespace(run=lambda *_: BAD))
    monkeypatch.setattr(module, "certify", SimpleNamespace(run=not_certified))
    asked = standing(monkeypatch, lambda _: 6.0)
    person = Person("Nothing")
    result = fd.commission(Axis(), out=begun_at(tmp_path / "out", "tune"), progress=person)
    assert result.refusal == ("it would be written" if again else "tuning: its margin is used up")
    assert [each.band[1] for each in asked[:1]] == ([pytest.approx(450.0)] if again else [])
    assert person.asked == []


def test_a_control_whose_trial_cannot_be_predicted_or_does_not_fit_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared(tmp_path / "out")
    (tmp_path / "out" / "10_export").mkdir()
    good = SimpleNamespace(run=lambda *_: SimpleNamespace(judgment=SimpleNamespace(bad=False), verdict="good"))
    monkeypatch.setattr(module, "tune", SimpleNamespace(run=lambda *_: BAD))
    for name in ("certify", "check", "export"):
        monkeypatch.setattr(module, name, good)
    planned, gains, ends = module.Chain._trial_motion, list[float](), [DivergedError("it grows"), None]

    def trial_motion(self: Any, loop: Any) -> Any:
        gains.append(float(loop.control.law.Kv))
        end = ends[len(gains) - 1] if len(gains) <= len(ends) else planned(self, loop)
        if end is None:
            raise module.UnlikePredictedError("no trial fits")
        if isinstance(end, Exception):
            raise end
        return end

    monkeypatch.setattr(module.Chain, "_trial_motion", trial_motion)
    result = begun(tmp_path / "out", Axis(limits=replace(LIMITS, following_error=0.02)), "tune", until="Trial")
    # it is planned once for each control, and the third is tried
    assert np.array(gains) / gains[0] == pytest.approx([1.0, 0.6, 0.36], rel=1e-4)
    assert result["tune"].says.startswith("A safe start law, 36 % as fast")
    assert "no trial fits" in result["tune"].says


# the trial


def tried(folder: Path, highest: float = 400.0, **axis: Any) -> tuple[Axis, Commissioned]:
    """A trial of the start law, which is there as if it had been tuned, on the axis that follows as it likes."""
    prepared(folder, highest)
    (folder / "8_tune").mkdir()
    text = (folder / "3_start_law" / "machine.toml").read_text()
    (folder / "8_tune" / "machine.toml").write_text(text)
    paper = Axis(limits=replace(LIMITS, following_error=0.02), **axis)
    return paper, begun(folder, paper, "trial", until="Keep")


def test_a_new_control_first_moves_a_fifth_as_far_and_as_fast(tmp_path: Path) -> None:
    axis, result = tried(tmp_path / "out")
    names = [profile.name for profile, _ in axis.played]
    assert names[:3] == ["gentle trial", "trial", "trial with a force"]
    gentle, alone = (profile for profile, _ in axis.played[:2])
    assert np.max(gentle.set_position) == pytest.approx(0.2 * np.max(alone.set_position))
    assert speed(gentle) == pytest.approx(0.2 * speed(alone), rel=0.01)
    # the guard acts at three times what is predicted, also of the pulse, where the user allows 20 mm
    logs = [read_log(tmp_path / "out" / "11_trial" / f"predicted_{name}.parquet") for name in ("alone", "pushed")]
    most = max(float(np.max(np.abs(log["set_position"] - log["reading_load"]))) for log in logs)
    assert axis.guards[:3] == pytest.approx(3 * [3.0 * most])
    assert 3.0 * most < 0.02
    assert result.trial is not None
    # this axis follows a hundred times better than any start law
    assert not result.kept
    assert "the trial is not as predicted" in result.refusal


@pytest.mark.parametrize(("buzz", "oscillates"), [(8.0, False), (40.0, True)])
def test_a_force_that_changes_from_sample_to_sample_by_a_hundredth_of_its_limit_ends_the_trial(
    tmp_path: Path, buzz: float, oscillates: bool
) -> None:
    """Of 1000 N, beside three times what the move itself and its friction are predicted to change."""
    axis, result = tried(tmp_path / "out", buzz=buzz)
    assert ("the new control oscillates" in result.refusal) is oscillates
    # a slower control is tuned, and begins gently again
    assert bool(axis.of("trial")) is not oscillates


def test_after_a_trial_unlike_its_prediction_a_slower_control_is_tuned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing can be tuned here, so that each start law is certified and tried, and its trial is unlike."""
    tuned = list[float | None]()

    def not_tuned(request: Any, _: Progress) -> Any:
        tuned.append(request.max_ms)
        return BAD

    good = SimpleNamespace(run=lambda *_: SimpleNamespace(judgment=SimpleNamespace(bad=False), verdict="good"))
    monkeypatch.setattr(module, "tune", SimpleNamespace(run=not_tuned))
    for name in ("certify", "check", "export"):
        monkeypatch.setattr(module, name, good)
    axis, result = tried(tmp_path / "out")
    assert "the trial is not as predicted" in result.refusal
    assert [profile.name for profile, _ in axis.played].count("gentle trial") == 3
    # the second trial begins with less than the first, the third with a start law
    assert tuned == [1.5, 1.25]


@pytest.mark.parametrize(("highest", "again"), [(350.0, True), (370.0, False)])
def test_a_control_that_is_worse_than_the_one_before_is_tuned_once_more_on_higher_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, highest: float, again: bool
) -> None:
    for name in ("agrees", "is_worse"):
        monkeypatch.setattr(module.Trial, name, property(lambda _: True))
    asked = standing(monkeypatch, lambda _: 6.0)
    axis, result = tried(tmp_path / "out", highest)
    assert [profile.name for profile, _ in axis.played][:2] == ["gentle trial", "trial"]
    if again:
        assert asked[0].band[1] == pytest.approx(450.0)
        assert result.refusal == "it would be written"
        assert result.trial is None
    else:
        assert asked == []
        assert "the control before has the smaller following error" in result.refusal


def begun_trial(folder: Path, **facts: float) -> Commissioned:
    """A trial of the start law, from facts, with a report in the folder of the model."""
    prepared(folder, 370.0)
    (folder / "7_model" / "report.html").write_text("a report")
    (folder / "8_tune").mkdir()
    (folder / "8_tune" / "machine.toml").write_text((folder / "3_start_law" / "machine.toml").read_text())
    axis = Axis(limits=replace(LIMITS, following_error=0.02))
    return begun(folder, axis, "trial", until="Keep", **facts)


def test_the_friction_of_the_model_is_fitted_to_a_trial_with_another_following_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the start law that was tried; the force along the travel and a play stay out of the model."""
    ran = list[tuple[float, str, bool]]()

    def fitted(loop: Any, log: Log, coulomb: float, viscous: float, *, play: bool) -> Any:
        ran.append((float(loop.control.law.Kv), log.name, play))
        return FrictionFit(replace(loop.axis, friction_load=Coulomb(coulomb=77.0)), "load", "coulomb", 1e-6)

    good = SimpleNamespace(run=lambda *_: SimpleNamespace(judgment=SimpleNamespace(bad=False), verdict="good"))
    monkeypatch.setattr(module, "fit_friction", fitted)
    monkeypatch.setattr(module, "tune", SimpleNamespace(run=lambda *_: BAD))
    for name in ("certify", "check", "export"):
        monkeypatch.setattr(module, name, good)
    result = begun_trial(tmp_path / "out")
    tried = read_machine(tmp_path / "out" / "3_start_law" / "machine.toml").loop("x")
    law: Any = tried.control.law
    assert ran[0] == (pytest.approx(float(law.Kv)), "paper", False)
    assert result["model"].says.startswith("The model as before, with the friction of the trial: on the load")
    loop = read_machine(tmp_path / "out" / "7_model" / "machine.toml").loop("x")
    assert loop.axis.friction_load is not None
    assert float(loop.axis.friction_load.coulomb) == 77.0
    assert loop.axis.forces == tried.axis.forces
    assert (tmp_path / "out" / "7_model" / "report.html").read_text() == "a report"
    # the next trial is predicted with it
    next_one = read_machine(tmp_path / "out" / "8_tune" / "machine.toml").loop("x").axis.friction_load
    assert next_one is not None
    assert float(next_one.coulomb) == 77.0


@pytest.mark.parametrize(
    ("figure", "again"),
    [
        # friction is in both runs of a stiffness, and not in their difference
        ("stiffness", True),
        ("following_rms", False),
    ],
)
def test_after_a_trial_with_another_stiffness_the_responses_are_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, figure: str, again: bool
) -> None:
    monkeypatch.setattr(module.Trial, "ratio", lambda _, name: 1.2 if name == figure else 1.0)
    monkeypatch.setattr(module, "fit_friction", none)
    asked = standing(monkeypatch, lambda _: 6.0)
    tuned = list[Any]()

    def not_tuned(request: Any, _: Progress) -> Any:
        tuned.append(request)
        return BAD

    monkeypatch.setattr(module, "tune", SimpleNamespace(run=not_tuned))
    monkeypatch.setattr(module, "certify", SimpleNamespace(run=none))
    result = begun_trial(tmp_path / "out", amplitude=100.0)
    assert result.refusal == "it would be written"
    assert asked[0].amplitude == pytest.approx(16.0)
    # at once, or after other controls were tuned in vain
    assert (tuned == []) is again


@pytest.mark.parametrize(("gain", "passes"), [(8e3, True), (68e3, False)])
def test_a_control_that_the_model_takes_near_instability_is_not_tried(
    tmp_path: Path, gain: float, passes: bool
) -> None:
    """By a mode above the lines that were measured, which tuning and certificate have not seen."""
    (tmp_path / "machine.toml").write_text(SMALL.replace("Kp = 8e3", f"Kp = {gain:g}"), encoding="utf-8")
    chain: Any = SimpleNamespace(place=tmp_path, _real=lambda machine: machine, _trial_motion=lambda _: ("fits", {}))
    why = Chain._not_tried(chain)
    assert (why == "") == passes
    assert passes or ("sensitivity peak Ms is" in why and "a tuned loop has at most 2" in why)
    assert (chain.planned is not None) == passes
