"""The benchmark: rules that do not move, plants that stand, scores by hand, the same bits twice, designs that fit."""

from __future__ import annotations

import inspect
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from feeddrive import cli
from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.benchmark.benchmark import FIGURES, Benchmark, laws_of, score, search
from feeddrive.benchmark.report import latex, markdown, summary, write_benchmark
from feeddrive.benchmark.rules import folder, read_rules
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.evaluation import robustness
from feeddrive.evaluation.competitor import Competitor
from feeddrive.evaluation.designs import Designs
from feeddrive.evaluation.engine import Engine
from feeddrive.evaluation.lineup import Lineup
from feeddrive.evaluation.robustness import Design
from feeddrive.figures.ranking import ROBUST, robust_peak, worst
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.tuning.candidates import PLAIN
from feeddrive.version import __version__
from slow_share import all_but

RULES = read_rules(1)
SNAP, STIFF, SETTLING = FIGURES[0], FIGURES[1], FIGURES[5]
QUICK = "rotary_table"


def test_rules_1_do_not_move() -> None:
    """Tables of one version are compared across years: a change of a number or of a plant is another version."""
    assert RULES.digest() == "1996dace4456e8c0b680aac1122c66eb19fb208d512f3e8d3dcf48987094bcb4"
    plant = RULES.plants["emps"]
    assert [RULES.seed(plant, use) for use in ("run 0", "run 1", "learning")] == [823968658, 1185127105, 1341213185]


def test_seeds_are_those_of_one_use_each() -> None:
    seeds = [
        RULES.seed(plant, use, own)
        for plant in RULES.plants.values()
        for use in ("run 0", "run 1", "learning")
        for own in (0, 1)
    ]
    assert len(set(seeds)) == len(seeds)
    assert min(seeds) > RULES.repeats  # those of the searches


@pytest.mark.parametrize("name", RULES.plants)
def test_a_plant_has_a_source_and_stands_under_its_own_control(name: str) -> None:
    plant = RULES.plants[name]
    assert RULES.jobs[name].machine.source
    assert RULES.jobs[name].title
    assert plant.duty.cut is not None
    for _, model in plant.loops(plant.loop):
        assert stability(model, velocity=plant.rule.velocity).stable


def test_the_plants_are_those_of_the_field() -> None:
    assert len(RULES.plants) == 12
    encoders = [plant.loop.axis.one_encoder() for plant in RULES.plants.values()]
    assert encoders.count(True) == 6
    assert [place.name for place in RULES.plants["screw_long"].places][1:] == [
        "near the bearing, x = 0.4 m",
        "far from it, x = 2.7 m",
    ]


def test_play_is_in_the_runs_and_not_in_the_model() -> None:
    rack = RULES.plants["rack"]
    assert [each.kind for each in rack.loop.axis.forces] == ["backlash"]
    assert rack.model.axis.forces == ()


def test_the_long_screw_is_as_soft_as_its_source_says() -> None:
    """1/k = 1/300 N/um + x/(E A), with E A of a steel bar of 46 mm."""
    bar = 210e9 * math.pi * 0.046**2 / 4.0
    expected = [1.0 / (1.0 / 300e6 + x / bar) for x in (1.5, 0.4, 2.7)]
    found = [place.axis.plant.stiffness for place in RULES.plants["screw_long"].places]
    assert found == pytest.approx(expected, rel=5e-3)


def row(plant: str, law: str, figures: dict[str, float | None], unplaced: str = "") -> Competitor:
    return Competitor(law, RULES.plants[QUICK].loop, figures, unplaced, plant=plant)


def made(*rows: Competitor) -> Benchmark:
    return Benchmark(RULES, ("a", "b"), rows, 0, {"feeddrive": "0"})


def test_a_score_is_the_geometric_mean_of_ratios_by_hand() -> None:
    found = made(
        row("a", PLAIN, {SNAP.key: 2.0, STIFF.key: 10.0, SETTLING.key: 1.0}),
        row("b", PLAIN, {SNAP.key: 6.0, STIFF.key: 10.0, SETTLING.key: 2.0}),
        row("a", "new", {SNAP.key: 1.0, STIFF.key: 20.0, SETTLING.key: math.inf}),
        row("b", "new", {SNAP.key: 12.0, STIFF.key: 5.0, SETTLING.key: 1.0}),
        row("a", "lame", {SNAP.key: 1.0}, unplaced="not settled: by hand"),
        row("b", "lame", {SNAP.key: 3.0}),
    )
    assert found.score("new", SNAP).value == pytest.approx(math.sqrt((2.0 / 1.0) * (6.0 / 12.0)))
    assert found.score("new", STIFF).value == pytest.approx(math.sqrt((20.0 / 10.0) * (5.0 / 10.0)))
    settling = found.score("new", SETTLING)
    assert (settling.value, settling.plants, settling.never) == (2.0, 1, 1)
    lame = found.score("lame", SNAP)
    assert (lame.value, lame.plants) == (2.0, 1)
    assert found.laws == ("lame", PLAIN, "new")
    assert found.unplaced() == {"lame": {"not settled: by hand": ["a"]}}
    line = next(each for each in found.table().rows if each[0] == "lame")
    assert line[1] == "1/2"


def test_the_worst_is_by_what_is_better() -> None:
    assert worst([{SNAP.key: 1.0, STIFF.key: 1.0}, {SNAP.key: 2.0, STIFF.key: 2.0}]) == {SNAP.key: 2.0, STIFF.key: 1.0}
    assert worst([{SNAP.key: 1.0}, {SNAP.key: None}]) == {SNAP.key: None}


def test_a_wrong_mass_lowers_the_margins() -> None:
    """The peak over wrong plants is above that of the nominal one, and infinite where one of them is unstable."""
    loop = RULES.plants["screw_heavy"].model
    assert robust_peak(loop, 0.1, 0.0) < robust_peak(loop, 0.1, 0.2) < 3.0
    law = replace(loop.control.law, Kp=8.0 * loop.control.law.Kp)
    assert robust_peak(replace(loop, control=replace(loop.control, law=law)), 0.1, 0.2) == math.inf


def test_a_second_run_gives_the_same_bits_and_another_seed_others() -> None:
    plants = [RULES.plants[QUICK]]
    first, again, other = (summary(score(RULES, plants, laws=["DADSC"], own=own)) for own in (0, 0, 5))
    assert json.dumps(first) == json.dumps(again)
    rows = [each["rows"][0]["figures"] for each in (first, other)]
    assert rows[0]["sensitivity_peak"] == rows[1]["sensitivity_peak"]
    assert rows[0]["tracking_error_rms_m"] != rows[1]["tracking_error_rms_m"]


@pytest.mark.slow(reason="two processes begin")
def test_processes_give_the_same_bits() -> None:
    plants = [RULES.plants[name] for name in (QUICK, "emps")]
    alone, beside = (summary(score(RULES, plants, laws=["DADSC"], engine=Engine(workers))) for workers in (1, 2))
    assert json.dumps(alone) == json.dumps(beside)


@pytest.mark.slow(reason="a law of one's own is searched")
def test_a_law_of_ones_own_is_searched_and_put_into_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """P-PI as somebody's own law comes to the same optimum as the stored design of P-PI."""
    monkeypatch.chdir(tmp_path)
    text = Path(inspect.getfile(CascadePPI)).read_text(encoding="utf-8")
    own = text.replace("CascadePPI", "OwnCascade").replace('title = "P-PI"', 'title = "own P-PI"')
    (tmp_path / "own_cascade.py").write_text(own, encoding="utf-8")
    asked = ["--blocks", "own_cascade.py", "--law", "own P-PI", "--plant", QUICK, "--keep", "kept", "--out", "out"]
    monkeypatch.setattr("sys.argv", ["feeddrive", "benchmark", *asked])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    rows = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["rows"]
    snaps = {each["law"]: each["figures"][SNAP.key] for each in rows}
    assert snaps["own P-PI"] == pytest.approx(snaps[PLAIN], rel=0.01)
    kept = [path.relative_to(tmp_path / "kept").as_posix() for path in (tmp_path / "kept").rglob("*.json")]
    assert kept == [f"stiffness_0_2_mass_0_2_dead_time_1sample/{QUICK}/own_p_pi.json"]  # in the box of the rules
    assert "own P-PI" in capsys.readouterr().out


@pytest.mark.slow(reason="linear models of all stored designs at the positions of the long screw")
def test_the_rule_is_kept_at_every_position() -> None:
    plant = RULES.plants["screw_long"]
    known = Designs(folder(1) / "designs", plant.name, RULES.version)
    for each in Lineup.of(plant.model).searched:
        design = known.design(each.name)
        if design is None or design.refused:
            continue
        for _, model in plant.loops(replace(each.loop, control=design.control(each))):
            both = loop_model(model, velocity=plant.rule.velocity)
            found = margins(both.loop_gain(both.lines(400)))
            assert found.sensitivity_peak <= 2.0 * 1.001, each.name
            assert (found.delay_margin_samples or math.inf) >= 2.0 * 0.999, each.name


def test_the_citation_has_the_version_of_the_package() -> None:
    said = (Path(__file__).parents[2] / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in said


def test_the_table_is_there_for_papers(tmp_path: Path) -> None:
    found = score(RULES, [RULES.plants[QUICK]], laws=["DADSC"])
    assert write_benchmark(found, tmp_path / "out").is_file()
    text = latex(found)
    assert text.count("&") == 11 * (1 + len(found.laws)) - 1 - len(found.laws)
    assert text.startswith("% feeddrive benchmark of feed-drive control laws, rules 1 (sha256 ")
    # what is unstable with wrong numbers stands beside the name, and not where a page may cut it off
    assert re.search(rf"\n\| {PLAIN} \| 1/1 \| 2\.\d\d \| 1\.00 \|", markdown(found))
    assert summary(found)["rows"][0]["figures"][ROBUST.key] > 2.0


def stale(name: str) -> list[str]:
    """The stored designs of a plant that do not belong to the present code."""
    plant = RULES.plants[name]
    known = Designs(folder(1) / "designs", name, RULES.version)
    said: list[str] = []
    for each in Lineup.of(plant.model).searched:
        design = known.design(each.name)
        if design is not None and not design.refused:
            loop = replace(each.loop, control=design.control(each))
            moved = design.stale(loop, plant.rule)
            said += [f"{each.name}: {moved}: search it again"] if moved else []
    return said


@pytest.mark.parametrize("name", all_but([QUICK], list(RULES.plants), "the linear models of all laws"))
def test_stored_designs_belong_to_the_present_code(name: str) -> None:
    known = Designs(folder(1) / "designs", name, RULES.version)
    assert known.design(PLAIN) is not None
    assert stale(name) == []


def test_a_design_whose_figures_have_moved_is_stale() -> None:
    plant = RULES.plants[QUICK]
    candidate = Lineup.of(plant.model).searched[0]
    design = Designs(folder(1) / "designs", QUICK, RULES.version).design(PLAIN)
    assert design is not None
    loop = replace(candidate.loop, control=design.control(candidate))
    assert design.stale(loop, plant.rule) == ""
    other = replace(design, figures={**design.figures, "sensitivity_peak": 1.9})
    assert "sensitivity_peak was 1.9" in other.stale(loop, plant.rule)


def test_a_design_is_kept_to_the_last_bit(tmp_path: Path) -> None:
    designs = Designs(tmp_path, "a", 1)
    one = Design("P-PI + 1", "a", 1, {"law.Kv": 1.0 / 3.0}, {"sensitivity_peak": 2.0}, held=("Ms",))
    designs.write(one)
    assert designs.design("P-PI + 1") == one
    assert designs.design("another") is None
    assert Designs(tmp_path / "none", "a", 1, (tmp_path,)).design("P-PI + 1") == one


def test_a_search_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rules = replace(RULES, repeats=1, starts=1)
    plants = [rules.plants[QUICK]]
    search(rules, plants, tmp_path, laws=[PLAIN])
    before = (tmp_path / QUICK / "p_pi.json").read_bytes()
    monkeypatch.setattr(robustness, "tune_control", None)  # a search would fail
    search(rules, plants, tmp_path, laws=[PLAIN])
    assert (tmp_path / QUICK / "p_pi.json").read_bytes() == before


def test_whole_tunings_that_disagree_are_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = RULES.plants[QUICK]
    rule = replace(plant.rule, repeats=3, starts=1)
    candidate = Lineup.of(plant.model).searched[0]
    tune, limits = robustness.tune_control, rule.limits()
    one = tune(candidate.loop, limits=limits, filters="kept", starts=1, velocity=rule.velocity)
    goals = {0: 1.0, 1: 1.04, 2: 1.0}

    def fake(*_: object, seed: int, **__: object) -> object:
        if seed not in goals:
            raise UnstableError("by hand")
        first = replace(one.after[0], rope_snap=goals[seed])
        return replace(one, after=(first,))

    monkeypatch.setattr(robustness, "tune_control", fake)
    found = robustness.Tuning(candidate, rule).repeated(Progress())
    assert found.unsettled == ""
    assert found.spread == pytest.approx(math.log(1.04))
    goals[1] = 1.06
    said = robustness.Tuning(candidate, rule).repeated(Progress()).unsettled
    assert said == "3 whole tunings end up to 6 % apart"
    del goals[2]
    assert "1 of 3" in robustness.Tuning(candidate, rule).repeated(Progress()).unsettled


def test_noise_is_stated_for_a_nanometer_of_the_readings() -> None:
    """A gain of 0.395 N/nm from reading to force."""
    rule = replace(RULES.plants[QUICK].rule, noise=0.395e9)
    assert f"at most {Quantity(0.395, 'N'):3} RMS of force per nm RMS of white noise" in rule.sentence
    assert rule.limits().reading_noise == (1e-9, 1e-9)


def test_a_law_is_named_by_its_kind_too() -> None:
    plants = RULES.chosen((QUICK,))
    assert laws_of(plants, ["dadsc", "P-PI", "cascade_ppi"]) == laws_of(plants, ["DADSC", "P-PI"])
    for written, meant in (("dadcs", "dadsc"), ("ppi", "P-PI"), ("ladrc", "LADRC")):
        with pytest.raises(ParameterError, match=f"did you mean {meant}"):
            laws_of(plants, [written])


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--plant", "rac"], "did you mean rack?"),
        (["--plant", "stage_1", "--rules", "1"], "is not in rules 1 of the benchmark; there are: linear_motor,"),
        (["--plant", QUICK, "--law", "DADC"], "'DADC' is not known here"),
        (["--rules", "3"], "there are no rules 3"),
        (["--retune"], "--retune: name with --keep"),
        (["--seed", "-1"], "seed"),
    ],
)
def test_bad_input_is_named(
    asked: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["feeddrive", "benchmark", *asked])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_design_is_named(tmp_path: Path) -> None:
    (tmp_path / QUICK).mkdir()
    (tmp_path / QUICK / "p_pi.json").write_text("{}", encoding="utf-8")
    with pytest.raises(Exception, match="is no design of the benchmark"):
        score(RULES, [RULES.plants[QUICK]], laws=[PLAIN], designs=[tmp_path])
    with pytest.raises(ParameterError, match="there are no rules 7"):
        read_rules(7)
