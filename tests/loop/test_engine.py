"""The engine: native code, its lanes, threads and chunks have the bits of the same law run by Python."""

from __future__ import annotations

import dataclasses
import re
import sys
import threading
import time
from functools import cache
from pathlib import Path
from typing import Any

import engine_loops as loops
import numpy as np
import pytest

from feeddrive.blocks.families import Load
from feeddrive.blocks.signals import Noise, Setpoint
from feeddrive.language import machine_code, tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import ELEMENTARY, Graph
from feeddrive.language.recent import Recent
from feeddrive.loop import runner
from feeddrive.loop import runner as groups
from feeddrive.loop.engine import plan as lazy_branches
from feeddrive.loop.engine.llvm import native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import simulate, simulate_batch, stream
from feeddrive.loop.trace import Carried, Program, concrete, evaluate
from heard import Heard
from slow_share import all_but

REFERENCE = loops.Sway()
LOOPS = {
    "common": (loops.common(), None),
    "substeps": (loops.common(4), None),
    "rich": (loops.rich(), loops.Saw()),
}


def every_operation() -> Program:
    """A program with one output for each operation; a, b are any numbers, k and n whole ones."""
    graph = Graph()
    a, b, k, n = (graph.input(name) for name in "abkn")
    found = {name: graph.apply(name, a, b) for name in ("add", "sub", "mul", "div", "quantise")}
    found |= {name: graph.apply(name, a) for name in ("neg", "abs", "sqrt", "floor", "exponent", *sorted(ELEMENTARY))}
    found |= {name: graph.apply("select", graph.apply(name, a, b), a, b) for name in ("lt", "le", "eq")}
    both = graph.apply("and", graph.apply("lt", a, b), graph.apply("not", graph.apply("le", k, n)))
    found["and"] = graph.apply("select", both, a, 1.0)
    found["or"] = graph.apply("select", graph.apply("or", both, graph.apply("eq", k, n)), b, -0.0)
    found["power_of_two"] = graph.apply("power_of_two", k)
    found["uniform"] = graph.apply("uniform", n, graph.input("sample"), 3.0)
    found["gather"] = graph.apply("gather", graph.table("row", 7), a)
    found["constant"] = graph.constant(1.0 / 3.0)
    state = graph.input("state.sum")
    return Program(
        graph=graph,
        constants={"n": n.index},
        inputs={name: graph.input(name).index for name in "abk"},
        states=(Carried("sum", state.index, (state + k).index),),
        outputs={name: symbol.index for name, symbol in found.items()},
        sample=graph.input("sample").index,
        tables={"row": graph.table("row", 7).index},
    )


SPECIAL = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    1.5,
    2.5,
    -2.5,
    1e-300,
    -1e-300,
    1e300,
    1.7e308,
    709.7,
    -708.0,
    1e9,
    np.inf,
    -np.inf,
    np.nan,
]
ROW = np.array([3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0])


def arguments() -> np.ndarray:
    """All pairs of special numbers, then random ones of all sizes; a whole number k beside them."""
    pairs = [(a, b) for a in SPECIAL for b in SPECIAL]
    draw = np.random.default_rng(5)
    some = draw.choice([-1.0, 1.0], (3000, 2)) * 10.0 ** draw.uniform(-5, 5, (3000, 2))
    both = np.vstack([pairs, some])
    return np.ascontiguousarray(np.column_stack([both, draw.integers(-1000, 1000, len(both))]))


@cache
def every_result(n: float) -> np.ndarray:
    """The outputs of every operation by plain Python, row by row: once for all who compare with them."""
    program, inputs = every_operation(), arguments()
    rows = []
    with np.errstate(all="ignore"):
        for k, (a, b, whole) in enumerate(inputs):
            leaves = {"a": a, "b": b, "k": whole, "n": np.float64(n), "sample": np.float64(k), "row": ROW}
            leaves["state.sum"] = np.float64(0.0)
            rows.append(evaluate(program.graph, list(program.outputs.values()), leaves))
    return np.array(rows, dtype=np.float64)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Bit for bit, except that all NaN count as one, and numbers below the normal ones as 0."""
    a, b = (np.where(np.abs(x) < 2.3e-308, np.copysign(0.0, x), x) for x in (a, b))
    return bool(np.all((a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))))


@pytest.mark.parametrize("lanes", [1, 2, 8])
def test_every_operation_has_the_bits_of_python(lanes: int):
    program, inputs = every_operation(), arguments()
    seeds = np.array([7.0, *range(9, 7 + lanes), 8.0])[:lanes]  # those of the first and the last lane are known
    made = native(plan(program, lanes=lanes, varying=["n"] if lanes > 1 else []))
    outputs, states = np.empty((len(inputs), len(program.outputs), lanes)), np.zeros((1, lanes))
    made.run(len(inputs), 0, seeds[None, :].copy(), inputs, states, outputs, [ROW])
    for lane in {0, lanes - 1}:
        expected = every_result(float(seeds[lane]))
        for i, name in enumerate(program.outputs):
            assert same(outputs[:, i, lane].copy(), expected[:, i].copy()), name
    assert np.all(states == inputs[:, 2].sum())


def test_functions_of_the_library_are_a_choice_of_the_run():
    """Own functions and the library's differ in last bits, and by no more than the ulp bounds of the own ones."""
    program, inputs = every_operation(), arguments()
    made = native(plan(program, arithmetic="libm"))
    outputs = np.empty((len(inputs), len(program.outputs)))
    made.run(len(inputs), 0, np.full((1, 1), 7.0), inputs, np.zeros((1, 1)), outputs, [ROW])
    expected = every_result(7.0)
    usual = np.isfinite(inputs[:, 0]) & (np.abs(inputs[:, 0]) < 700.0)
    for i, name in enumerate(program.outputs):
        got, own = outputs[usual, i].copy(), expected[usual, i].copy()
        if name in ELEMENTARY:
            finite = np.isfinite(own)
            assert np.array_equal(got[~finite], own[~finite], equal_nan=True), name
            assert np.all(np.abs(got[finite] - own[finite]) <= 4 * np.spacing(np.abs(own[finite]))), name
        else:
            assert same(got, own), name


def oracle(loop: Loop, load: Load | None, count: int, seed: int) -> dict[str, np.ndarray]:
    """The loop stepped by Python on float64."""
    work = Work(loop, REFERENCE, load)
    plain = concrete(loop)
    timing = loop.timing()
    times = np.arange(count) * work.T
    setpoints = np.column_stack(list(REFERENCE.at(times)))
    forces = None if load is None else load.at(times)
    enable = loops.enabling(count)
    record = []
    with np.errstate(all="ignore"):
        prepared = plain.prepare(timing)
        first = work.first()
        state = plain.start(prepared, timing, first, first.position, first.velocity)
        for k in range(count):
            state, signals = plain.step(
                prepared,
                state,
                Setpoint(*setpoints[k]),
                None if forces is None else forces[k],
                Noise(np.float64(seed), np.float64(k)),
                1.0 if loop.control.guard is None else enable[k],
                np.float64(k) * plain.sample_time,
            )
            record.append(signals)
    return dict(zip(Signals._fields, np.array(record, dtype=np.float64).T, strict=True))


def given(loop: Loop, count: int) -> np.ndarray | None:
    return None if loop.control.guard is None else loops.enabling(count)


@pytest.mark.parametrize("name", LOOPS)
def test_native_code_has_the_bits_of_python(name: str):
    loop, load = LOOPS[name]
    count = 2400  # the first 2000 at rest
    expected = oracle(loop, load, count, seed=3)
    run = simulate(loop, REFERENCE, load=load, enable=given(loop, count), duration=(count - 1) * loops.T, seed=3)
    for signal in Signals._fields:
        assert np.array_equal(run[signal], expected[signal]), signal
    assert np.any(run["velocity_load"] == 0.0)
    assert np.any(run["velocity_load"] != 0.0)


def varied(loop: Loop, count: int) -> Loop:
    """Variants of a loop: gains, masses, stiffness, friction, counts, a notch."""
    draw = np.random.default_rng(2)
    names = [
        "axis.x.control.law.Kv",
        "axis.x.control.law.Kp",
        "axis.x.control.law.Tn",
        "axis.x.control.filters.0.frequency",
        "axis.x.control.force_limit",
    ]
    names += ["axis.x.plant.mass_load", "axis.x.plant.stiffness", "axis.x.friction_load.coulomb"]
    names += ["axis.x.encoder_motor.resolution"]
    return tree.vary(loop, {name: tree.get(loop, name) * draw.uniform(0.9, 1.1, count) for name in names})


def lane_of(loop: Loop, variants: Loop, lane: int) -> Loop:
    """One variant as a loop of its own."""
    values = {n: float(v[lane]) for n, v in tree.parameters(variants).items() if isinstance(v, np.ndarray)}
    return tree.vary(loop, values)


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("lanes", all_but([2, 8], [2, 4, 8, 16], "other numbers of lanes"))
def test_a_lane_has_the_bits_of_a_single_run(name: str, lanes: int):
    loop, load = LOOPS[name]
    count = 1500
    variants = varied(loop, lanes)
    seeds = np.arange(11.0, 11.0 + lanes)
    work = Work(variants, REFERENCE, load, given(loop, count))
    prepared = Prepared(variants, work.first(), None, seeds)
    program = prepared.program(load=load is not None, enable=bool(work.enable))
    made = prepared.native(program, record=Signals._fields, lanes=lanes)
    outputs = np.empty((count, len(Signals._fields), lanes))
    made.run(
        count,
        0,
        prepared.constants(made),
        work.inputs(made, 0, count),
        prepared.states(made),
        outputs,
        prepared.rows(made),
    )
    for lane in range(lanes):
        alone = lane_of(loop, variants, lane)
        span = (count - 1) * loops.T
        run = simulate(alone, REFERENCE, load=load, enable=given(loop, count), duration=span, seed=int(seeds[lane]))
        for i, signal in enumerate(Signals._fields):
            assert np.array_equal(run[signal], outputs[:, i, lane]), (lane, signal)


RULES = {
    "between parameters": ("axis.x.control.guard.safe_force", [0.0, -2.0, 1e9], r"variant 2 of 0 \.\. 2, 1 of which"),
    "of a filter": ("axis.x.control.filters.0.frequency", [900.0, 1e5, 2e5], r"variant 1 of 0 \.\. 2, 2 of which"),
    "of a mode": ("axis.x.plant.mass_load", [300.0, 300.0, 1e-12], r"variant 2 .*fastest mode"),
}


@pytest.mark.parametrize("case", RULES)
def test_a_batch_refuses_a_variant_that_breaks_a_rule_as_a_single_run_does(case: str):
    path, values, words = RULES[case]
    loop = dataclasses.replace(
        loops.common(), control=dataclasses.replace(loops.common().control, guard=Guard(), force_limit=5e3)
    )
    alone = [_refusal(loop, {path: value}) for value in values]
    broken = next(i for i, text in enumerate(alone) if text)
    found = _refusal(loop, {path: np.array(values)})
    assert found.endswith(alone[broken]), "the reason is that of the single run"
    assert re.match(words, found)
    assert not _refusal(loop, {path: np.array(values)[:broken]})


def _refusal(loop: Loop, changes: dict[str, Any]) -> str:
    try:
        tree.vary(loop, changes)
    except ParameterError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("name", LOOPS)
def test_a_batch_has_the_numbers_of_its_variants_on_any_lanes_and_threads(name: str):
    loop, load = LOOPS[name]
    count, size = 1500, 21
    variants, seeds = varied(loop, size), np.arange(21)
    span = (count - 1) * loops.T
    batches = [
        simulate_batch(
            variants,
            REFERENCE,
            load=load,
            enable=given(loop, count),
            duration=span,
            seed=seeds,
            lanes=lanes,
            threads=threads,
        )
        for lanes in (2, 4, 8, 16, None)
        for threads in (1, 2)
    ]
    for other in batches[1:]:
        for found in ("rms", "peak", "least", "most"):
            for signal, values in getattr(batches[0], found).items():
                assert np.array_equal(values, getattr(other, found)[signal]), (found, signal)
    for lane in (0, 7, 20):
        alone = lane_of(loop, variants, lane)
        run = simulate(alone, REFERENCE, load=load, enable=given(loop, count), duration=span, seed=int(seeds[lane]))
        for signal in batches[0].rms:
            assert batches[0].peak[signal][lane] == np.max(np.abs(run[signal]))
            assert batches[0].least[signal][lane] == np.min(run[signal])
            assert batches[0].most[signal][lane] == np.max(run[signal])
            # the batch adds squares in the order of time, numpy in pairs: n roundings of at most 2⁻⁵³ each
            assert batches[0].rms[signal][lane] == pytest.approx(
                np.sqrt(np.mean(run[signal] ** 2)), rel=count * 2.0**-53
            )


def test_widths_are_tried_and_stretches_joined(monkeypatch):
    """A batch that tries its widths and runs in several stretches has the numbers of the plain one."""
    variants = varied(loops.common(), 40)
    plain = simulate_batch(variants, REFERENCE, duration=0.05, lanes=8)
    monkeypatch.setattr(groups, "WIDE", 1)
    monkeypatch.setattr(groups, "TRIED", 1)
    monkeypatch.setattr(sys.modules["feeddrive.loop.simulate"], "CHUNK", 300)
    heard = Heard()
    tried = simulate_batch(variants, REFERENCE, duration=0.05, progress=heard)
    seen = [(done, of) for _, done, of, _ in heard.steps]
    for found in ("rms", "peak", "least", "most"):
        for signal, values in getattr(plain, found).items():
            assert np.array_equal(values, getattr(tried, found)[signal]), (found, signal)
    assert seen[-1] == (40, 40)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_what_is_the_same_for_all_variants_is_gathered_for_each():
    """A signal that no parameter reaches is computed once, and stands in the result of every variant."""
    batch = simulate_batch(varied(loops.common(), 5), REFERENCE, duration=0.2, gather=("set_position", "force"))
    run = simulate(loops.common(), REFERENCE, duration=0.2)
    assert np.array_equal(batch.most["set_position"], np.full(5, np.max(run["set_position"])))


@pytest.mark.parametrize("name", LOOPS)
def test_a_choice_computes_only_the_side_that_is_chosen(name: str, monkeypatch):
    """Computing branches only when they are taken, alone or many by one truth, changes no bit."""
    loop, load = LOOPS[name]
    given_enable = given(loop, 2001)
    plain = simulate(loop, REFERENCE, load=load, enable=given_enable, duration=0.1, seed=1)
    for least, fewest in ((1, 1), (1, 10**9), (10**9, 2)):
        monkeypatch.setattr(lazy_branches, "LEAST_COST", least)
        monkeypatch.setattr(lazy_branches, "FEWEST", fewest)
        monkeypatch.setattr(runner, "_natives", Recent(8))
        other = simulate(loop, REFERENCE, load=load, enable=given_enable, duration=0.1, seed=1)
        for signal in Signals._fields:
            assert np.array_equal(plain[signal], other[signal]), (least, fewest, signal)


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("chunk", [1, 7, 997, 10_000])
def test_a_stream_has_the_bits_of_a_single_run(name: str, chunk: int):
    loop, load = LOOPS[name]
    count = 300 if chunk == 1 else 5000
    span, enable = (count - 1) * loops.T, given(loop, count)
    run = simulate(loop, REFERENCE, load=load, enable=enable, duration=span, seed=5)
    parts = list(stream(loop, REFERENCE, load=load, enable=enable, duration=span, seed=5, chunk=chunk))
    assert [part.first for part in parts] == list(range(0, count, chunk))
    for signal in Signals._fields:
        assert np.array_equal(np.concatenate([part[signal] for part in parts]), run[signal]), signal
    assert np.array_equal(np.concatenate([part.time for part in parts]), run.time)


@pytest.mark.parametrize("name", LOOPS)
def test_fused_operations_stay_near(name: str):
    """`fma` rounds less often; a count more or less at a quantiser is the largest effect, so compare within counts."""
    loop, load = LOOPS[name]
    span, enable = 0.2, given(loop, 4001)
    exact, fused = (
        simulate(loop, REFERENCE, load=load, enable=enable, duration=span, arithmetic=a) for a in ("exact", "fma")
    )
    assert np.max(np.abs(exact["position_load"] - fused["position_load"])) < 5e-8  # m, five counts


def test_numbers_below_the_normal_ones_are_zero_and_the_mode_is_restored():
    graph = Graph()
    x = graph.input("state.x")
    program = Program(graph, {}, {}, (Carried("x", x.index, (0.5 * x).index),), {"x": x.index}, None, {})
    made = native(plan(program))
    states, outputs = np.array([[1e-300]]), np.empty((40, 1))
    made.run(40, 0, np.empty((0, 1)), np.empty((40, 0)), states, outputs, [])
    assert np.all(outputs[outputs > 0.0] >= 2.2250738585072014e-308)
    assert states[0, 0] == 0.0
    assert np.float64(1e-310) * np.float64(0.5) == 5e-311
    assert np.all(np.full(64, 1e-310) * 0.5 == 5e-311)


def test_python_runs_on_while_native_code_runs():
    """Another thread comes to its turn many times during one native call: the call holds no lock."""
    loop = loops.common()
    work = Work(loop, REFERENCE)
    prepared = Prepared(loop, work.first())
    made = prepared.native(prepared.program(load=False, enable=False), record=())
    count = 4_000_000
    inputs = np.zeros((count, len(made.plan.inputs)))
    constants, states = prepared.constants(made), prepared.states(made)

    def turns_of_another() -> int:
        marks: list[str] = []

        def busy() -> None:
            marks.append("begin")
            made.run(count, 0, constants, inputs, states, None, [])
            marks.append("end")

        worker = threading.Thread(target=busy)
        worker.start()
        while worker.is_alive():
            time.sleep(1e-3)
            marks.append("turn")
        return marks[marks.index("begin") : marks.index("end")].count("turn")

    # With a lock it would be one, between the lines of `busy`; a busy machine may leave too few turns in one call.
    assert any(turns_of_another() >= 5 for _ in range(20))


def test_what_stays_the_same_costs_nothing_in_the_loop():
    """The text has no division of parameters in its loop, and states that never change are not carried."""
    from feeddrive.loop.engine import llvm as time_loop

    loop = loops.common()
    prepared = Prepared(loop, Work(loop, REFERENCE).first())
    made = plan(prepared.program(load=False, enable=False).keeping(["force"]))
    inner = time_loop.text(made, "run", "x86_64-unknown-linux-gnu").split("\nloop:")[1].split("\ndone:")[0]
    assert (
        inner.count(" fdiv ") == 5
    )  # two encoders, the velocity, friction's impulse, its share of the Stribeck velocity


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """An empty folder for machine code, and nothing in memory."""
    monkeypatch.setenv("FEEDDRIVE_CACHE", str(tmp_path))
    monkeypatch.setattr(machine_code, "_kept", Recent(8))
    return tmp_path


def small(factor: float = 3.0) -> Program:
    graph = Graph()
    x = graph.input("x")
    return Program(graph, {}, {"x": x.index}, (), {"y": (factor * x).index}, None, {})


def result(program: Program) -> float:
    outputs = np.empty((1, 1))
    native(plan(program)).run(1, 0, np.empty((0, 1)), np.array([[2.0]]), np.empty((0, 1)), outputs, [])
    return outputs[0, 0]


def test_machine_code_is_kept_on_disk_and_read_back(fresh, monkeypatch):
    assert result(small()) == 6.0
    kept = list(fresh.iterdir())
    assert len(kept) == 1
    before = kept[0].stat().st_mtime_ns
    monkeypatch.setattr(machine_code, "_kept", Recent(8))
    assert result(small()) == 6.0
    assert [path.stat().st_mtime_ns for path in fresh.iterdir()] == [before]
    assert result(small(5.0)) == 10.0
    assert len(list(fresh.iterdir())) == 2


@pytest.mark.parametrize("damage", ["cut", "flip", "empty"])
def test_damaged_machine_code_is_made_anew(fresh, monkeypatch, damage: str):
    assert result(small()) == 6.0
    (path,) = fresh.iterdir()
    held = bytearray(path.read_bytes())
    if damage == "flip":
        held[len(held) // 2] ^= 1
    path.write_bytes({"cut": held[: len(held) // 2], "flip": held, "empty": b""}[damage])
    monkeypatch.setattr(machine_code, "_kept", Recent(8))
    assert result(small()) == 6.0


def test_code_that_is_deleted_while_it_is_loaded_is_not_replaced_by_nothing(fresh, monkeypatch):
    """Read once: the module without its body, which is enough with code from the disk, is never compiled and kept."""
    assert result(small()) == 6.0
    (path,) = fresh.iterdir()
    kept = [machine_code._stored(path.stem)]
    monkeypatch.setattr(machine_code, "_kept", Recent(8))
    monkeypatch.setattr(machine_code, "_stored", lambda _: kept.pop() if kept else None)
    before = path.read_bytes()
    assert result(small()) == 6.0
    assert path.read_bytes() == before


def test_a_folder_that_others_can_write_to_is_not_used(fresh):
    fresh.chmod(0o777)
    assert machine_code.cache_directory() is None
    assert result(small()) == 6.0
    assert list(fresh.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="NOT TESTED on Windows: XDG_CACHE_HOME is of Unix")
def test_a_user_without_a_home_directory_has_a_cache_only_where_he_names_one(monkeypatch, tmp_path):
    def missing():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("FEEDDRIVE_CACHE", raising=False)
    monkeypatch.setattr(Path, "home", missing)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert machine_code.cache_directory() is None
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert machine_code.cache_directory() == tmp_path / "feeddrive"


def test_the_cache_can_be_switched_off_and_a_wrong_place_is_no_error(monkeypatch, tmp_path):
    monkeypatch.setattr(machine_code, "_kept", Recent(8))
    monkeypatch.setenv("FEEDDRIVE_CACHE", "")
    assert machine_code.cache_directory() is None
    assert result(small(7.0)) == 14.0
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("FEEDDRIVE_CACHE", str(blocked / "cache"))
    monkeypatch.setattr(machine_code, "_kept", Recent(8))
    assert result(small(9.0)) == 18.0


def test_a_run_that_leaves_its_bounds_says_when():
    from feeddrive.language.errors import DivergedError

    wild = dataclasses.replace(loops.common(), control=dataclasses.replace(loops.common().control, force_limit=None))
    wild = tree.vary(wild, {"axis.x.control.law.Kp": 1e9})
    with pytest.raises(DivergedError, match=r"sample \d+"):
        simulate(wild, REFERENCE)
    variants = tree.vary(wild, {"axis.x.control.law.Kp": np.array([2e5, 1e9])})
    batch = simulate_batch(variants, REFERENCE, duration=0.3)
    assert batch.left[0] == -1
    with pytest.raises(DivergedError, match=f"sample {batch.left[1]} "):
        simulate(wild, REFERENCE, duration=0.3)
