"""A schedule tuned over the travel of a long screw: every place gains, and the limits hold between the places, too."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feeddrive.analysis.stability import stability
from feeddrive.benchmark.rules import read_rules
from feeddrive.blocks import GainSchedule, PolePlacement
from feeddrive.certificate.systems import deployed
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.tuning import Travel, TunedTravel, along_travel, frozen, tune_control, tune_travel
from feeddrive.tuning.candidates import control_with

BASE: Loop = read_rules(1).plants["screw_long"].loop
EA = 210e9 * math.pi * 0.046**2 / 4.0  # N
PLACES = (0.4, 1.5, 2.7)  # m


def stiffness(x: float) -> float:
    return 1.0 / (1.0 / 300e6 + x / EA)


def at(x: float, **plant: Any) -> Loop:
    changed = replace(BASE.axis.plant, stiffness=stiffness(x), **plant)
    return replace(BASE, axis=replace(BASE.axis, plant=changed))


TRAVEL = Travel.of({x: at(x) for x in PLACES})


@pytest.fixture(scope="module")
def tuned() -> TunedTravel:
    return tune_travel(TRAVEL, starts=1, between=3)


def peak(loop: Loop, position: float) -> float:
    """Ms of a loop at a position, from the linear model of the schedule itself, on 4000 lines."""
    model = linearize(loop, ["cut"], ["force"], position=position)
    lines = np.geomspace(0.1, 1999.0, 4000)
    return float(np.max(1.0 / np.abs(1.0 - model.response(lines, "force", "cut").response)))


def test_between_the_places_the_axis_is_that_of_its_source() -> None:
    assert list(TRAVEL.fits) == ["axis.x.plant.stiffness"]
    for x in (0.4, 0.9, 2.0, 2.7):
        assert TRAVEL.at(x).axis.plant.stiffness == pytest.approx(stiffness(x), rel=1e-9)  # type: ignore[attr-defined]


def test_no_place_is_worse_than_with_fixed_gains_and_the_limits_hold_between_the_places(tuned: TunedTravel) -> None:
    assert tuned.holds
    assert [row.position for row in tuned.after][::4] == list(PLACES)
    for old, new in zip(tuned.before, tuned.after, strict=True):
        # a thousandth: where the worst place decides, both searches end at the same gains
        assert new.goal < 1.001 * old.goal
    # docs/explanation/travel.md: 69, 18 and 0 % at the three places
    better = [old.goal / new.goal - 1.0 for old, new in zip(tuned.before[::4], tuned.after[::4], strict=True)]
    assert better == pytest.approx([0.69, 0.18, 0.0], abs=0.02)
    assert tuned.gained == pytest.approx(0.0, abs=1e-3)


def test_the_peaks_of_the_table_are_those_of_the_schedule_itself(tuned: TunedTravel) -> None:
    """The tuner judges the frozen law; here the schedule is linearized at each position."""
    for row in tuned.after:
        loop = replace(TRAVEL.at(row.position), control=tuned.control)
        assert row.figures is not None
        shown = row.figures.margins.sensitivity_peak
        assert peak(loop, row.position) == pytest.approx(shown, rel=2e-3)  # of other lines
        assert shown <= 2.0 * 1.002


def test_without_giving_way_the_limits_do_not_hold_between_the_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each place is tuned to Ms = 2, and between them it is 2.03: the reason why a place gives way."""
    monkeypatch.setattr("feeddrive.tuning.travel._ROUNDS", 0)
    plain = tune_travel(TRAVEL, starts=1, between=1)
    assert not plain.holds
    assert "does not keep its limits (Ms 2.0" in plain.sentence
    assert all(row.keeps for row in plain.after[::2])


def test_a_schedule_of_a_machine_keeps_its_positions_and_its_places_are_frozen(tuned: TunedTravel) -> None:
    law = tuned.control.law
    assert isinstance(law, GainSchedule)
    for place, one in zip(law.places, tuned.places, strict=True):
        here = frozen(tuned.control, float(place.position)).law
        pairs = zip(tree.leaves(here), tree.leaves(one.control.law), strict=True)
        assert all(a == pytest.approx(b, rel=1e-12) for (_, a), (_, b) in pairs)
    two = replace(law, places=(replace(law.places[0], position=0.6), replace(law.places[2], position=2.4)))
    again = tune_travel(TRAVEL, replace(BASE.control, law=two), starts=1, between=0)
    assert isinstance(again.control.law, GainSchedule)
    assert [place.position for place in again.control.law.places] == [0.6, 2.4]


def test_the_model_of_a_law_follows_the_axis() -> None:
    control = control_with(at(1.5), "pole_placement")
    found = tune_travel(TRAVEL, control, starts=1, between=0)
    law = found.control.law
    assert isinstance(law, GainSchedule)
    laws = [place.law for place in law.places]
    models = [law.model.stiffness for law in laws if isinstance(law, PolePlacement)]  # type: ignore[attr-defined]
    assert models == pytest.approx([stiffness(x) for x in PLACES], rel=1e-9)
    assert found.gained > 0.08  # 11 %; docs/explanation/travel.md: 19 % by three searches


def test_what_is_not_known_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"known at 2 positions, and 3 are needed at least.*measure at more"):
        Travel.of({x: at(x) for x in (0.4, 2.7)})
    with pytest.raises(ParameterError, match=r"the axis at 3 m: it is known from 0\.4 m to 2\.7 m, and nothing is ext"):
        TRAVEL.at(3.0)
    with pytest.raises(ParameterError, match="nothing is extrapolated"):
        along_travel(TRAVEL, BASE.control, [0.3])
    bare = replace(BASE, axis=replace(BASE.axis, friction_motor=None))
    with pytest.raises(
        StructureError, match=r"at 1\.5 m axis\.friction_motor would go from stribeck to nothing: along"
    ):
        Travel.of({0.4: at(0.4), 1.5: bare, 2.7: at(2.7)})
    slower = replace(at(1.5), sample_time=5e-4)
    with pytest.raises(ParameterError, match=r"at 1\.5 m the sample time is 0\.0005 s, not 0\.00025 s"):
        Travel.of({0.4: at(0.4), 1.5: slower, 2.7: at(2.7)})
    with pytest.raises(StructureError, match="lqg computes its gains by more than 500 operations"):
        tune_travel(TRAVEL, control_with(at(1.5), "lqg"))
    with pytest.raises(ParameterError, match="goal = 'best' must be one of"):
        tune_travel(TRAVEL, goal="best")


def test_an_unstable_position_is_told() -> None:
    law = replace(BASE.control.law, Kp=1e8)  # type: ignore[call-arg]
    rows = along_travel(TRAVEL, replace(BASE.control, law=law), [0.4, 2.7])
    assert [row.text for row in rows] == ["the loop is unstable"] * 2
    assert all(row.growth > 1.0 and not row.keeps for row in rows)


def test_the_errors_of_the_measurements_reach_the_numbers_between_them() -> None:
    errors = {x: {"axis.x.plant.stiffness": 0.02 * stiffness(x)} for x in PLACES}
    travel = Travel.of({x: at(x) for x in PLACES}, errors)
    value, error = travel.fits["axis.x.plant.stiffness"].at(1.5)
    # a line through three values of equal relative error: in the middle about the error of their mean
    assert 0.02 * value / math.sqrt(3.0) * 0.8 < error < 0.02 * value


def test_what_has_no_position_refuses_a_schedule_and_a_run_needs_every_place_to_be_stable(tuned: TunedTravel) -> None:
    loop = replace(BASE, control=tuned.control)
    with pytest.raises(ParameterError, match=r"'gain_schedule' depends on the position of the axis: tune it over the"):
        tune_control(loop)
    with pytest.raises(ParameterError, match=r"'gain_schedule' depends on the position.*prove it along the travel"):
        deployed(tuned.control, float(BASE.sample_time))
    assert stability(loop).stable
    law = tuned.control.law
    assert isinstance(law, GainSchedule)
    fast = replace(law.places[2], law=replace(law.places[2].law, Kp=1e8))  # type: ignore[call-arg]
    wild = replace(loop, control=replace(tuned.control, law=replace(law, places=(*law.places[:2], fast))))
    assert not stability(wild).stable
    # at the first place alone it is stable: the linear model of position 0
    assert linearize(wild, ["set_position"], ["force"]).is_stable()


def drawn_axis(seed: int) -> tuple[Any, tuple[float, ...], tuple[float, ...]]:
    """An axis of two masses with drawn numbers: a function of position and payload, its positions and payloads."""
    random = np.random.default_rng(seed)
    base = BASE.axis.plant
    factor = float(random.uniform(0.5, 1.5))
    compliance, slope = 1.0 / (factor * 250e6), float(random.uniform(0.5, 1.5)) / (factor * EA)
    positions = tuple(float(x) for x in np.sort(random.uniform(0.2, 2.8, 3)))
    payloads = (0.0, *(float(m) for m in np.sort(factor * random.uniform(100.0, 700.0, 2))))

    def at(x: float, m: float) -> Loop:
        plant = replace(
            base,
            mass_motor=factor * base.mass_motor,  # type: ignore[attr-defined]
            mass_load=factor * 500.0 + m,
            stiffness=1.0 / (compliance + slope * x),
        )
        law = replace(BASE.control.law, Kp=factor * BASE.control.law.Kp)  # type: ignore[attr-defined, call-arg]
        control = replace(BASE.control, law=law)
        return replace(BASE, axis=replace(BASE.axis, plant=plant), control=control)

    return at, positions, payloads


def test_an_axis_over_pairs_is_the_one_that_was_drawn_also_where_pairs_are_missing() -> None:
    at, positions, payloads = drawn_axis(31)
    every = {(x, m): at(x, m) for x in positions for m in payloads}
    del every[positions[1], payloads[2]], every[positions[0], payloads[1]]
    travel = Travel.of(every)
    assert set(travel.fits) == {"axis.x.plant.mass_load", "axis.x.plant.stiffness"}
    random = np.random.default_rng(32)
    for _ in range(5):
        x, m = float(random.uniform(*positions[::2])), float(random.uniform(*payloads[::2]))
        for found in (travel.at(x, m), travel.with_payload(m).at(x)):
            pairs = zip(tree.leaves(found.axis.plant), tree.leaves(at(x, m).axis.plant), strict=True)
            assert all(a == pytest.approx(b, rel=1e-9) for (_, a), (_, b) in pairs)
    with pytest.raises(ParameterError, match="with payloads: name one"):
        travel.at(positions[0])
    with pytest.raises(ParameterError, match=r"kg: it is known from 0 kg to .* kg, and nothing is extrapolated"):
        travel.at(positions[0], payloads[2] + 1.0)
    with pytest.raises(ParameterError, match="for one payload: leave out the payload"):
        TRAVEL.at(1.0, 0.0)
    with pytest.raises(ParameterError, match="robust = True is about payloads"):
        tune_travel(TRAVEL, robust=True)
    del every[positions[2], payloads[2]]
    with pytest.raises(ParameterError, match=r"the axis: no measurement at .* m with .* kg; the first and the last"):
        Travel.of(every)


@pytest.mark.slow(reason="two tunings at nine pairs, judged at 49 pairs each, take 20 s")
@pytest.mark.parametrize("robust", [False, True])
def test_a_schedule_over_pairs_keeps_its_limits_between_them_and_no_pair_is_worse(robust: bool) -> None:
    """The peaks are those of the schedule itself, linearized at the pair with its payload set."""
    at, positions, payloads = drawn_axis(33)
    travel = Travel.of({(x, m): at(x, m) for x in positions for m in payloads})
    found = tune_travel(travel, starts=1, between=2, robust=robust)
    law = found.control.law
    assert found.holds
    assert isinstance(law, GainSchedule)
    assert len(law.places) == 3
    assert [len(place.loads) for place in law.places] == [0 if robust else 3] * 3
    assert (law.payload is None) == robust
    assert len(found.after) == 49
    for old, new in zip(found.before, found.after, strict=True):
        assert new.goal < 1.005 * old.goal  # between places the schedule is no optimum
        assert new.payload is not None
        own = found.control if robust else replace(found.control, law=law.with_payload(new.payload))
        loop = replace(at(*new.pair), control=own)  # type: ignore[arg-type]
        assert peak(loop, new.position) < 2.0 * 1.003
    # the light axis at the near end gains most where the payload is known
    assert found.before[0].goal / found.after[0].goal > (1.05 if robust else 1.2)
