"""The worst plants of a box: those of an independent computation, also between corners, and limits that hold there."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.signals import Setpoint
from feeddrive.figures.of_loops import DELAY_MARGIN, ROPE_SNAP, SENSITIVITY_PEAK
from feeddrive.language import tree
from feeddrive.language.errors import UnstableError
from feeddrive.language.progress import Progress
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning import criteria, tune, worst
from feeddrive.tuning.candidates import candidates
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.tuning.screen import Places, ScreenedPlants
from feeddrive.tuning.search import Search
from feeddrive.tuning.tune import Tuned, Tuner, Verdict, assess, tune_control
from feeddrive.tuning.worst import Examination, Examined, OverBox, _starts, box_plants, over_box, worst_plants
from independent_box import box_draws

# largest relative difference of Ms of the tuner, by interpolation between lines, and refined at its peak
CLOSE = 1e-3


@pytest.fixture(scope="module")
def draws() -> ModuleType:
    return box_draws()


@pytest.fixture(scope="module")
def motor() -> Loop:
    return fd.read_machine("linear_motor").loop("x")


@pytest.fixture(scope="module")
def table() -> Loop:
    """An axis of two masses whose worst plant lies between corners: P-PI with its gains below those of today."""
    return fd.read_machine("machining_center").loop("x")


class Reports(Progress):
    """The best controls so far, as a search reports them."""

    def __init__(self) -> None:
        super().__init__()
        self.best = list[Control]()

    def show_better(self, cost: float, best: object) -> None:
        assert isinstance(best, Control)
        self.best.append(best)


@pytest.fixture(scope="module")
def reports() -> Reports:
    return Reports()


@pytest.fixture(scope="module")
def held(motor: Loop, reports: Reports) -> Tuned:
    return tune_control(motor, filters="kept", box=Box(), progress=reports)


def examined(loop: Loop, box: Box, limits: Limits | None = None, velocity: float = 0.05) -> OverBox:
    return over_box(loop.control, [box_plants(box, loop, "model", velocity)], limits or Limits())[0]


def test_without_a_spread_the_worst_plant_is_the_model(draws: ModuleType) -> None:
    for machine in ("ball_screw", "machining_center", "rotary_table"):
        loop = next(iter(fd.read_machine(machine).loops.values()))
        result = examined(loop, Box(0.0, 0.0, 0))
        spread = result.spread(SENSITIVITY_PEAK)
        assert spread is not None
        assert spread.worst == spread.nominal
        independent = draws.Draws(loop, Box(0.0, 0.0, 0), 2).under(loop.control)
        assert spread.nominal == pytest.approx(independent.peak, rel=1e-4)
        assert independent.growth == pytest.approx(stability(loop).growth, abs=1e-7)


def test_one_sample_later_takes_a_sample_of_the_delay_margin(motor: Loop) -> None:
    spread = examined(motor, Box(0.0, 0.0, 1)).spread(DELAY_MARGIN)
    assert spread is not None
    assert spread.nominal is not None
    # 1e-3 samples: interpolation of the crossover between lines
    assert spread.worst == pytest.approx(spread.nominal - 1.0, abs=1e-3)


def test_a_worst_plant_between_the_corners_is_found(table: Loop) -> None:
    """Against a grid of plants: Ms is largest where the resonance meets the worst phase."""
    law = replace(table.control.law, Kv=150.0, Kp=37_240.0, Tn=0.0485)
    loop = replace(table, control=replace(table.control, law=law))
    box = Box(0.0, 0.3, 1)
    plants = box_plants(box, loop, "model", 0.05)
    examination = Examination(loop.control, float(loop.sample_time), Limits(), 0.05)
    corners, found = examination.corners(plants)[0], examination.searched(plants)[0]
    grid = [Corner((float(a), float(b)), 1) for a in (-1.0, 1.0) for b in np.linspace(0.5, 1.0, 26)]
    best = max(examination.at(plants, grid), key=lambda plant: plant.used)
    assert found.used >= best.used * (1.0 - 1e-4)
    assert found.used >= corners.used


@pytest.fixture(scope="module")
def head() -> Loop:
    """A hanging axis under P-PI as it was tuned over its box: several peaks of |S| of several plants are equally high.

    At the corner with all masses at their upper end the resonance is the highest peak, and the fourth of all corners.
    Half way along the edge to the next one it is the second peak; between both the worst plant lies.
    """
    loop = fd.read_machine("machining_center").loop("z")
    law = CascadePPI(Kv=116.4974, Kp=104_099.28, Tn=0.01038138)
    filters = (
        Notch(frequency=235.23328, damping_zero=0.25777221, damping_pole=0.51098878),
        LowPass2(frequency=2250.0, damping=0.37622318),
    )
    return replace(loop, control=Control(law=law, filters=filters))


def test_the_worst_plant_is_found_where_another_peak_is_the_highest_one_beside_it(
    head: Loop, draws: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    box, climbed = Box(0.2, 0.2, 1), list[Places]()
    monkeypatch.setattr(worst, "_starts", lambda plants, places: (climbed.append(places), _starts(plants, places))[1])
    found = worst_plants(head.control, [box_plants(box, head, "model", 0.05)], Limits(sensitivity_peak=2.0))[1][0]
    along = np.linspace(-1.0, 1.0, 81)
    edge = np.stack([along, np.ones(81), -np.ones(81)], axis=1)
    independent = draws.Draws(head, box, at=(edge, np.ones(81, int)))
    peaks = independent.peaks(draws.linear_law(head.control, independent.T, 0.05))
    # the middle and both ends are lower than what the limit allows, the worst plant is not
    assert max(peaks[[0, 40, 80]]) < 2.0 < 2.003 < max(peaks)
    # 1e-4: the peak between the lines of the tuner
    assert 2.0 * found.used == pytest.approx(max(peaks), rel=1e-4)
    assert found.corner.late == 1
    assert found.corner.place == pytest.approx((along[int(np.argmax(peaks))], 1.0, -1.0), abs=0.05)
    # both peaks of the middle of the edge are known to the climb, the lower one too
    middle = box_plants(box, head, "model", 0.05).screened.corners.index(Corner((0.0, 1.0, -1.0), 1))
    there = climbed[0].frequency[climbed[0].plant == middle]
    assert np.any((there > 55.0) & (there < 70.0))
    assert np.any((there > 200.0) & (there < 220.0))


def test_a_search_starts_from_each_peak_at_its_worst_plants(head: Loop) -> None:
    """The middle of an edge where the same peak is lower at both ends; of each peak the worst corners and draws."""
    plants = box_plants(Box(0.2, 0.2, 1), head, "model", 0.05)
    known = plants.screened.corners
    used = dict.fromkeys(known, 0.5)
    edge, end, other = (Corner((u, 1.0, -1.0), 1) for u in (0.0, 1.0, -1.0))
    ranked = [corner for corner in plants.corners if corner not in (end, other)][:5]
    used |= {edge: 0.98, end: 0.97, other: 0.96, **{corner: 0.95 - 0.005 * i for i, corner in enumerate(ranked)}}
    drawn = [corner for corner in plants.inside if corner not in (*plants.corners, *plants.edges)][:5]
    used |= {corner: 0.94 - 0.005 * i for i, corner in enumerate(drawn)}

    def starts(second: dict[Corner, float]) -> list[tuple[Corner, float]]:
        """From a peak at 100 Hz of all plants, of one twice, and one at another frequency of some."""
        rows = [*((known.index(corner), 100.0, size) for corner, size in used.items()),
                (known.index(drawn[0]), 100.5, used[drawn[0]] - 1e-4),
                *((known.index(corner), 300.0, size) for corner, size in second.items())]  # fmt: skip
        places = Places(*(np.array(column) for column in zip(*rows, strict=True)))
        return [(known[places.plant[i]], float(places.frequency[i])) for i in _starts(plants, places)]

    found = starts({})
    assert found[0] == (edge, 100.0)
    assert {corner for corner, _ in found if corner in plants.corners} >= {end, other, ranked[0]}
    assert {corner for corner, _ in found if corner in drawn} == set(drawn[:3])
    assert not {corner for corner, _ in found} & {corner for corner, size in used.items() if size == 0.5}
    # a fourth corner is a start only if no edge leads from it to a higher plant
    assert all(corner in (end, other) or corner in ranked for corner, _ in found if corner in plants.corners)
    # a second peak has starts of its own, however high the first one is there
    assert (edge, 300.0) in starts({edge: 0.93, end: 0.92})
    assert (edge, 300.0) not in starts({edge: 0.93, end: 0.935})
    assert (end, 300.0) in starts({edge: 0.93, end: 0.935})
    assert (drawn[4], 300.0) in starts({drawn[4]: 0.92})
    # below a tenth less than the largest nothing is climbed
    assert not {f for _, f in starts({edge: 0.88})} - {100.0}
    used[end] = 0.985
    assert (edge, 100.0) not in starts({})


def test_a_limit_that_is_used_up_everywhere_hides_no_other(table: Loop) -> None:
    """Ms between the corners is found as well beside a bound of the compliance that each plant exceeds more."""
    law = replace(table.control.law, Kv=150.0, Kp=37_240.0, Tn=0.0485)
    loop = replace(table, control=replace(table.control, law=law))
    plants, key = box_plants(Box(0.0, 0.3, 1), loop, "model", 0.05), SENSITIVITY_PEAK.key
    most = [
        max(
            plant.of(key) for plant in Examination(loop.control, float(loop.sample_time), limits, 0.05).searched(plants)
        )
        for limits in (Limits(), Limits(compliance_peak_m_per_N=0.05e-6))
    ]
    assert most[1] == pytest.approx(most[0], rel=1e-6)


def test_what_a_search_reports_on_its_way_keeps_the_limits_at_the_corners(
    held: Tuned, reports: Reports, motor: Loop
) -> None:
    """Who stops a search takes the last report: until now the first one was that of the model alone, and the best."""
    assert held.box is not None
    assert reports.best
    for control in reports.best:
        spread = examined(replace(motor, control=control), Box()).spread(SENSITIVITY_PEAK)
        assert spread is not None
        assert spread.worst is not None
        assert spread.worst <= 2.0 * 1.01  # a plant between the corners may still join


def test_limits_hold_over_the_box(held: Tuned, motor: Loop, draws: ModuleType) -> None:
    assert held.box is not None
    assert held.box.holds is True
    worst = held.box.spread(SENSITIVITY_PEAK)
    assert worst is not None
    drawn = draws.Draws(motor, Box(), 400, seed=5).under(held.control)
    assert drawn.peak <= 2.0
    assert drawn.growth < 1.0
    # half of the draws have the mass at one of its ends, so some lie at the worst corner
    assert worst.worst == pytest.approx(drawn.peak, rel=CLOSE)
    # without the box the same limit is exceeded
    plain = tune_control(motor, filters="kept", starts=1)
    assert draws.Draws(motor, Box(), 400, seed=5).under(plain.control).peak > 2.2
    assert examined(replace(motor, control=plain.control), Box()).holds is False


def test_the_goal_is_that_of_the_model(held: Tuned, motor: Loop) -> None:
    """The limits at the worst plant cost something; more room at the model is left."""
    assert held.box is not None
    plain = tune_control(motor, filters="kept", starts=1)
    assert held.after[0].rope_snap > 1.1 * plain.after[0].rope_snap
    assert held.after[0].margins.sensitivity_peak < 1.7
    assert len(held.after) == 1  # plants of the box are no operating points of the result


def test_a_margin_is_held_over_the_box_too(motor: Loop, draws: ModuleType) -> None:
    found = tune_control(
        motor, limits=Limits(sensitivity_peak=None, delay_margin_samples=5.0), filters="kept", box=Box(), starts=1
    )
    assert found.box is not None
    spread = found.box.spread(DELAY_MARGIN)
    assert spread is not None
    assert spread.worst == pytest.approx(5.0, rel=5e-3)
    assert found.box.holds is True
    assert draws.Draws(motor, Box(), 400).under(found.control).growth < 1.0


def test_an_unstable_plant_is_said(motor: Loop) -> None:
    law = replace(motor.control.law, Kp=120_000.0)
    result = examined(replace(motor, control=replace(motor.control, law=law)), Box(0.0, 0.5, 2))
    assert result.used == np.inf
    assert result.holds is False
    assert "unstable at model: mass -50 %" in str(result.sentence(Limits()))
    spread = result.spread(SENSITIVITY_PEAK)
    assert spread is not None
    assert spread.worst is None


@pytest.mark.parametrize(("used", "reason", "holds"), [
    (0.999, "", True), (1.0015, "", None), (1.0035, "", False), (0.999, "plants exceed it", None), (1.01, "x", False),
])  # fmt: skip
def test_a_violation_of_two_thousandths_is_undecided(used: float, reason: str, holds: bool | None, held: Tuned) -> None:
    assert held.box is not None
    assert replace(held.box, used=used, reason=reason).holds is holds


def test_today_beyond_a_limit_over_the_box_is_a_reason_to_change(motor: Loop) -> None:
    """Today keeps Ms <= 2 at the model and not over the box: the new control is taken although its error is larger."""
    today = tune_control(motor, filters="kept", starts=1).control
    found = tune_control(motor, filters="kept", starts=1, box=Box(), today=today)
    gained = found.gained()
    assert gained is not None
    assert gained < 1.0
    assert found.before[0].margins.sensitivity_peak <= 2.0
    assert found.verdict is Verdict.TAKE
    assert "today's gains do not keep Ms <= 2 over the box: Ms " in found.recommendation()


def test_a_limit_that_the_box_does_not_allow_is_refused_by_name(motor: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    # what could be reached instead is another twenty searches
    monkeypatch.setattr(Tuner, "_reachable", lambda *_: "")
    limits = Limits(sensitivity_peak=1.6, compliance_peak_m_per_N=0.033e-6)
    assert tune_control(motor, limits=limits, filters="kept", starts=1).holds
    with pytest.raises(
        UnstableError, match=r"no setting was found that keeps Ms <= 1.6, .*\('model: .* beyond its limit"
    ):
        tune_control(motor, limits=limits, filters="kept", starts=1, box=Box(0.0, 0.5, 3))


def test_a_rule_is_judged_over_the_box(motor: Loop) -> None:
    result = assess(motor.control, motor, rule="today", box=Box(0.2, 0.5, 2))
    assert result.box is not None
    assert result.box.holds is False
    assert result.holds is False
    assert "limits over the box" in result.proof[-1].what


def joined(motor: Loop, names: tuple[str, ...]) -> tuple[Tuner, list[Examined]]:
    """A tuning with the two worst plants of a box under the gains of today, one of them joined."""
    point = modelled_point(motor)
    tuner = Tuner((point,), ROPE_SNAP, Limits(), (0.0, np.inf), 0.95, 1, 0, 0.05, Progress(), Box())
    plants = Examination(motor.control, float(motor.sample_time), Limits(), 0.05).corners(tuner.boxes[0])
    tuner._join(plants[:1])
    assert tuner.criteria(motor.control, names).screened
    return tuner, plants


def population(motor: Loop) -> tuple[Search, np.ndarray]:
    """A search with a plant that has joined, and 40 points around the gains of today, logarithms."""
    names = ("law.Kv", "law.Kp", "law.Tn")
    tuner, _ = joined(motor, names)
    x = tune.logarithms(motor.control, names)
    search = Search(tuner.criteria(motor.control, names), x - 1.0, x + 1.0)
    return search, x + np.random.default_rng(3).uniform(-0.5, 0.2, (40, 3))


def test_a_plant_that_has_joined_gets_all_of_its_lines(motor: Loop) -> None:
    """It exceeds its limit between the lines of the search: it would else neither join nor keep the limit."""
    tuner, plants = joined(motor, ())
    worst = plants[0]._replace(used=1.0002)
    few = tuner.kept[1].size
    assert tuner._joining([worst]) == [worst]
    tuner._join([worst])
    assert len(tuner.points) == 2
    assert few < tuner.kept[1].size == tuner.points[1].frequency.size
    assert tuner._joining([worst]) == []


def test_a_look_ends_where_it_cannot_win(motor: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    """Plants of the box are screened only for what is better than asked at the model, and the best are those of all."""
    search, points = population(motor)
    whole = search.look(points)
    model = search.look(points, np.full(40, -np.inf))
    assert np.all(model <= whole)
    assert np.any(model < whole - 0.01)
    screened = list[int]()
    bounds = ScreenedPlants.bounds
    monkeypatch.setattr(ScreenedPlants, "bounds", lambda *given: (screened.append(1), bounds(*given))[1])
    best, merits = search.best(points, 3)
    assert merits == pytest.approx(np.sort(whole)[:3], rel=1e-12)
    assert np.array_equal(best, points[np.argsort(whole)[:3]])
    assert 3 <= len(screened) < 40


def test_searches_say_how_many_agree(held: Tuned) -> None:
    agreed, count = held.agreed
    assert count >= 3
    assert held.settled
    assert agreed >= 2


def test_what_is_examined_is_written_down(held: Tuned) -> None:
    assert held.box is not None
    record = held.box.record()
    assert record["box"] == "stiffness=0.2,mass=0.3,dead_time=1sample"
    assert "mass 28 to 52 kg" in str(record["parameters"])
    assert record["verdict"] == "holds"
    assert record["corners"] == {"examined": 4, "all": 4}
    figures = record["figures"]["sensitivity_peak"]
    assert figures["model"] < figures["worst"] <= 2.0
    assert "over the box: every stiffness" in held.rule


def test_only_the_control_differs_between_plants_of_one_model(motor: Loop) -> None:
    """Models of plants are kept for the next control of the same axis, and only for that."""
    box = Box()
    first = box_plants(box, motor, "model", 0.05)
    law = replace(motor.control.law, Kv=100.0)
    assert box_plants(box, replace(motor, control=replace(motor.control, law=law)), "model", 0.05) is first
    heavier = tree.vary(motor, {"axis.x.plant.mass": 41.0})
    assert box_plants(box, heavier, "model", 0.05) is not first
    assert box_plants(Box(0.1), motor, "model", 0.05) is not first


@pytest.mark.slow(
    reason="10,000 draws each of two machines against the tuned limits, by an independent computation, 60 s"
)
@pytest.mark.parametrize("machine", ["machining_center", "ball_screw"])
def test_no_plant_of_ten_thousand_exceeds_the_limit(machine: str, draws: ModuleType) -> None:
    loop = next(iter(fd.read_machine(machine).loops.values()))
    assert isinstance(loop.control.law, CascadePPI)
    found = tune_control(loop, filters="free", box=Box())
    assert found.box is not None
    assert found.box.holds is True
    drawn = draws.Draws(loop, Box(), 10_000, seed=11).under(found.control)
    assert drawn.peak <= 2.0
    assert drawn.growth < 1.0


@pytest.fixture(scope="module")
def screw() -> Loop:
    return fd.read_machine("ball_screw").loop("x")


def traced_states(loop: Loop) -> tuple[str, ...]:
    """The names of the states of a control, in the order of its linear model."""
    control = replace(loop.control, guard=None, force_limit=None)
    start = control.start(control.prepare(float(loop.sample_time)), Setpoint(0.0), 0.0, 0.0)
    return tuple(name for name, _ in tree.leaves(start))


def placed(loop: Loop) -> Loop:
    """The loop under pole placement, with the gains that the law starts from."""
    return next(found.loop for found in candidates(loop)[0] if found.name == "pole placement")


def test_a_number_that_a_law_stored_at_its_start_is_no_pole(screw: Loop, draws: ModuleType) -> None:
    """Pole placement subtracts the offset of its encoders, which it never writes again: an eigenvalue of exactly 1."""
    loop = placed(screw)
    law = draws.linear_law(loop.control, float(loop.sample_time), 0.05)
    names = traced_states(loop)
    assert [names[i] for i in np.flatnonzero(draws.constants(law))] == ["memory.law.offset"]
    few = draws.Draws(screw, Box(0.0, 0.0, 0), 2)
    assert few.under(loop.control).growth == pytest.approx(stability(loop).growth, abs=1e-7)
    # bit by bit: whatever the readings are, the law does not write it
    control = replace(loop.control, guard=None, force_limit=None)
    prepared = control.prepare(float(loop.sample_time))
    state = control.start(prepared, Setpoint(0.0), 3e-6, 1e-6)
    random = np.random.default_rng(4)
    for motor, load in random.normal(0.0, 1e-4, (200, 2)):
        state, _ = control.step(prepared, state, Setpoint(0.0), float(motor), float(load), 1.0, float(loop.sample_time))
        assert state.memory.law.offset == 3e-6 - 1e-6


def test_an_offset_of_the_encoders_does_not_move_the_table(screw: Loop, draws: ModuleType) -> None:
    """The constant acts as a force of K1 times the offset, which the integral takes over: nothing drifts."""
    loop = placed(screw)
    T = float(loop.sample_time)
    law = draws.linear_law(loop.control, T, 0.05)
    A, B, c, d = law
    held = draws.constants(law)
    plants = draws.Draws(screw, Box(0.0, 0.0, 0), 2).plants
    (P, B0, B1, late), C = (part[0] for part in (plants.A, plants.B0, plants.B1, plants.late)), plants.C
    ends = list[float]()
    for offset in (0.0, 1e-6):
        x, xi = np.zeros(len(P)), np.where(held, offset, 0.0)
        sent = np.zeros(int(late) + 2)
        for _ in range(12_000):
            read = C @ x
            sent = np.array([c @ xi + d @ read, *sent[:-1]])
            xi = A @ xi + B @ read
            x = P @ x + B0 * sent[int(late)] + B1 * sent[int(late) + 1]
        ends.append(float((C @ x)[1]))
        assert xi[held] == pytest.approx(offset)
    # 1e-11 m: the slowest pole, 0.9977, leaves 1e-12 of the offset after 12,000 samples
    assert abs(ends[1] - ends[0]) < 1e-11


def test_what_is_left_out_of_a_law_keeps_still(screw: Loop, draws: ModuleType) -> None:
    """Of all laws: states without part in the loop are constants or decay; one law has a clipped sum of set motion."""
    few, grown = draws.Draws(screw, Box(0.0, 0.0, 0), 2), list[str]()
    for found in candidates(screw)[0]:
        law = draws.linear_law(found.loop.control, few.T, 0.05)
        growth = float(np.max(draws.closed_eigenvalues(few.plants, law)))
        if growth != pytest.approx(stability(found.loop).growth, abs=1e-6):
            grown.append(found.name)
    assert grown == ["P-PI + learned stops"]


def test_a_look_with_a_bar_is_the_whole_look_where_it_passes_and_above_the_bar_elsewhere(
    motor: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the goal or a part of the points shows is no better than the whole, and decides as it does."""
    search, points = population(motor)
    whole = search.look(points)
    judged = list[int]()
    bounds = criteria.bounds_of
    monkeypatch.setattr(criteria, "bounds_of", lambda *given: (judged.append(1), bounds(*given))[1])
    bars = np.full(len(points), float(np.median(whole[np.isfinite(whole)])))
    some = search.look(points, bars)
    passes = whole < bars
    assert 3 < np.count_nonzero(passes) < len(points) - 3
    assert np.array_equal(some[passes], whole[passes])
    assert np.all(some[~passes] >= bars[~passes])
    assert np.all(some <= whole)
    assert len(judged) < len(points)  # of some the goal alone says enough


def test_a_plant_that_nearly_uses_a_limit_is_examined_on_all_lines(motor: Loop) -> None:
    plants = box_plants(Box(), motor, "model", 0.05)

    def worst(bound: float) -> Examined:
        return worst_plants(motor.control, [plants], Limits(sensitivity_peak=bound))[1][0]

    few = worst(4.0)
    assert few.figures is not None
    largest = few.figures.margins.sensitivity_peak
    near = worst(1.001 * largest)
    assert near.figures is not None
    assert near.figures.loop_gain.frequency.size > 1.5 * few.figures.loop_gain.frequency.size
    # 1e-4: the few lines of this axis are near enough to its peak
    assert near.of(SENSITIVITY_PEAK.key) == pytest.approx(1.0 / 1.001, rel=1e-4)
    assert near.used >= near.of(SENSITIVITY_PEAK.key)


def test_the_examination_of_a_control_is_made_once(motor: Loop) -> None:
    """A tuning makes it, and a comparison of the tuned law asks for it: for the same numbers, plants and limits."""
    plants, limits = [box_plants(Box(), motor, "model", 0.05)], Limits(sensitivity_peak=2.5)
    made = worst_plants(motor.control, plants, limits)
    equal = tree.vary(motor.control, {"law.Kv": float(motor.control.law.Kv)})  # type: ignore[attr-defined]
    assert equal is not motor.control
    assert worst_plants(equal, plants, limits)[0] is made[0]
    other = tree.vary(motor.control, {"law.Kv": 0.9 * float(motor.control.law.Kv)})  # type: ignore[attr-defined]
    for different in (
        worst_plants(other, plants, limits),
        worst_plants(motor.control, plants, Limits(sensitivity_peak=2.4)),
        worst_plants(motor.control, [box_plants(Box(0.1), motor, "model", 0.05)], limits),
        worst_plants(motor.control, plants, limits, inside=False),
    ):
        assert different[0] is not made[0]


def test_columns_of_bounds_are_the_bounds(motor: Loop) -> None:
    """In the order of their figures, those of two points after each other, with slacks and slopes by columns."""
    names = ("law.Kv", "law.Kp")
    points = (modelled_point(motor, "a"), modelled_point(motor, "b"))
    limits = Limits(sensitivity_peak=1.5, phase_margin_deg=40.0, reading_noise=(1e-9, 1e-9), force_noise_N=1e-3)
    response = ControlResponse(motor.control, points[0].sample_time, names, 0.05)
    x = np.log([float(tree.get(motor.control, name)) for name in names])
    found = criteria.Criteria(points, response, ROPE_SNAP, limits, (0.0, np.inf))(x)
    bounds = list(found.bounds)
    assert len(bounds) == len(found.bounds) > 50
    assert [bound.key for bound in bounds] == found.bounds.keys
    assert len(set(found.bounds.keys)) == len(bounds)
    assert {bound.key[:2] for bound in bounds} == {(limit.figure.key, i) for limit in limits.limits for i in (0, 1)}
    assert np.array_equal([bound.slack for bound in bounds], found.slacks(0.0))
    assert np.array_equal([bound.slope for bound in bounds], found.slopes)
    again = criteria.Bounds.of(bounds)
    assert again.keys == found.bounds.keys
    assert np.array_equal(again.slope(2), found.slopes)
    # a slope is that of its slack
    h = 1e-6
    moved = criteria.Criteria(points, response, ROPE_SNAP, limits, (0.0, np.inf))(x + np.array([h, 0.0]))
    sizes = dict(zip(moved.bounds.keys, moved.slacks(0.0).tolist(), strict=True))
    for bound in bounds:
        # 1e-3: minima between lines are corrected by a slack that has no slope of its own
        if bound.key[0] != SENSITIVITY_PEAK.key:
            assert (sizes[bound.key] - bound.slack) / h == pytest.approx(bound.slope[0], rel=1e-3, abs=1e-3)
