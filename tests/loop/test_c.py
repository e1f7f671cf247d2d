"""The loop as C text: compiled by the machine's own compiler it has the bits of the native code."""

from __future__ import annotations

import ctypes
from pathlib import Path

import engine_loops as loops
import numpy as np
import pytest
from test_engine import LOOPS, REFERENCE, ROW, arguments, every_operation, given, same

from feeddrive.loop.engine.llvm import native
from feeddrive.loop.engine.plan import Plan, plan
from feeddrive.loop.loop import Signals
from feeddrive.loop.runner import Prepared, Work
from feeddrive.testing import exercise as c

COUNT = 20_000


def run(library: ctypes.CDLL, count: int, *arrays: np.ndarray, rows: list[np.ndarray]) -> None:
    tables = (ctypes.c_void_p * max(1, len(rows)))(*[row.ctypes.data for row in rows])
    function = library.feeddrive_run
    function.restype, function.argtypes = None, [ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 5]
    function(count, 0, *(array.ctypes.data for array in arrays), ctypes.addressof(tables))


@pytest.mark.parametrize("arithmetic", ["exact", "libm"])
@pytest.mark.parametrize("name", LOOPS)
def test_c_has_the_bits_of_the_native_code(name: str, arithmetic: str, tmp_path: Path):
    loop, load = LOOPS[name]
    work = Work(loop, REFERENCE, load, given(loop, COUNT))
    prepared = Prepared(loop, work.first(), None, 4)
    program = prepared.program(load=load is not None, enable=bool(work.enable))
    made = prepared.native(program, record=Signals._fields, bounded=["tracking_error"], arithmetic=arithmetic)
    library = c.compiled(c.text(made.plan, "feeddrive_run"), tmp_path)
    constants, inputs, rows = (
        prepared.constants(made),
        np.ascontiguousarray(work.inputs(made, 0, COUNT)),
        prepared.rows(made),
    )
    ends, records = [], []
    for way in (made.run, None):
        states, outputs = prepared.states(made), np.empty((COUNT, len(Signals._fields)))
        if way is None:
            run(library, COUNT, constants, inputs, states, outputs, rows=rows)
        else:
            way(COUNT, 0, constants, inputs, states, outputs, rows)
        ends.append(states)
        records.append(outputs)
    for i, signal in enumerate(Signals._fields):
        assert np.array_equal(records[0][:, i], records[1][:, i]), signal
    assert np.array_equal(ends[0], ends[1])
    assert np.any(records[0][:, Signals._fields.index("velocity_load")] != 0.0)


def test_every_operation_in_c(tmp_path: Path):
    program, inputs = every_operation(), arguments()
    made = plan(program)
    library = c.compiled(c.text(made, "feeddrive_run"), tmp_path)
    both = [np.empty((len(inputs), len(program.outputs))) for _ in range(2)]
    ends = [np.zeros((1, 1)) for _ in range(2)]
    constants = np.full((1, 1), 12.0)
    native(made).run(len(inputs), 0, constants, inputs, ends[0], both[0], [ROW])
    run(library, len(inputs), constants, inputs, ends[1], both[1], rows=[ROW])
    for i, name in enumerate(program.outputs):
        assert same(both[0][:, i].copy(), both[1][:, i].copy()), name
    assert ends[0][0, 0] == ends[1][0, 0]
    assert np.float64(1e-310) * np.float64(0.5) == 5e-311  # the mode for small numbers was restored


def common_plan(arithmetic: str = "exact") -> Plan:
    loop = loops.common()
    prepared = Prepared(loop, Work(loop, REFERENCE).first())
    return plan(prepared.program(load=False, enable=False).keeping(["force"]), arithmetic=arithmetic)


def test_the_text_can_be_read():
    """Parameters, states and signals keep their names; lines stay short; no elementary function of the library."""
    text = c.text(common_plan(), "axis_run")
    for name in ("control_law_Kv", "axis_velocity_1", "set_position", "/* force */", "void axis_run("):
        assert name in text
    assert max(map(len, text.splitlines())) <= 160
    for function in ("exp(", "tanh(", "sin("):
        assert function not in text
    assert " exp(" in c.text(common_plan("libm"), "axis_run")


@pytest.mark.parametrize(
    "value", [0.0, -0.0, 1.0, -2.5, 1.0 / 3.0, 1e300, -5e-310, 1023.0, 2.0**-52, 1e6, 123456.75, np.inf, -np.inf]
)
def test_numbers_in_the_text_are_exact(value: float):
    text = c.number(value).strip("()")
    sign, size = (-1.0, text[1:]) if text.startswith("-") else (1.0, text)
    back = sign * (np.inf if size == "HUGE_VAL" else float.fromhex(size) if "x" in size else float(size))
    assert back == value
    assert np.signbit(back) == np.signbit(value)


def test_names_never_clash():
    """Names that C reserves, and names that become the same without their dots."""
    from feeddrive.language.graph import Graph
    from feeddrive.loop.trace import Carried, Program

    graph = Graph()
    names = ["double", "k", "a.b", "a_b", "exp", "v3", "states"]
    total = graph.constant(0.0)
    for name in names:
        total = total + graph.input(name)
    x = graph.input("state.k")
    program = Program(
        graph, {n: graph.input(n).index for n in names}, {}, (Carried("k", x.index, (x + total).index),), {}, None, {}
    )
    text = c.text(plan(program), "run")
    declared = [
        line.split("=")[0].split()[-1] for line in text.splitlines() if "double " in line and " = constants[" in line
    ]
    assert len(set(declared)) == len(names)
    assert not {"double", "k", "exp", "states"} & set(declared)


def test_states_that_take_over_others_take_their_last_value(tmp_path: Path):
    """A chain of delays: each takes what the one before had in the last sample."""
    from feeddrive.language.graph import Graph
    from feeddrive.loop.trace import Carried, Program

    graph = Graph()
    x = graph.input("x")
    delays = [graph.input(f"state.d{i}") for i in range(3)]
    states = tuple(
        Carried(f"d{i}", delay.index, (x if i == 0 else delays[i - 1]).index) for i, delay in enumerate(delays)
    )
    swapped = [graph.input(f"state.s{i}") for i in range(2)]
    states += (Carried("s0", swapped[0].index, swapped[1].index), Carried("s1", swapped[1].index, swapped[0].index))
    program = Program(graph, {}, {"x": x.index}, states, {"y": delays[2].index}, None, {})
    made = plan(program)
    library = c.compiled(c.text(made, "feeddrive_run"), tmp_path)
    for way in ("native", "c"):
        outputs, held = np.empty((10, 1)), np.array([[0.0], [0.0], [0.0], [1.0], [2.0]])
        inputs, none = np.arange(10.0)[:, None].copy(), np.empty((0, 1))
        if way == "native":
            native(made).run(10, 0, none, inputs, held, outputs, [])
        else:
            run(library, 10, none, inputs, held, outputs, rows=[])
        assert np.array_equal(outputs[:, 0], [0, 0, 0, *range(7)])
        assert np.array_equal(held[:, 0], [9, 8, 7, 1, 2])


@pytest.mark.parametrize("substeps", [1, 4])
def test_the_loop_by_hand_of_the_speed_benchmark_is_the_same_loop(
    substeps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """What the engine is timed against computes the same bits, or the comparison would mean nothing."""
    folder = Path(__file__).parents[2] / "benchmarks"
    monkeypatch.syspath_prepend(str(folder))
    import single
    import workload

    library = c.compiled((folder / "single.c").read_text(), tmp_path, f"-DSUBSTEPS={substeps}")
    work = Work(workload.loop(substeps), workload.reference())
    prepared = Prepared(workload.loop(substeps), work.first())
    program = prepared.program(load=False, enable=False)
    made = prepared.native(program, record=workload.RECORD, arithmetic="libm")
    inputs, expected = np.ascontiguousarray(work.inputs(made, 0, COUNT)), np.empty((COUNT, len(workload.RECORD)))
    made.run(COUNT, 0, prepared.constants(made), inputs, prepared.states(made), expected, [])
    parameters = np.array([float(prepared.numbers[name]) for name in single.PARAMETERS])
    state, record = np.array([float(prepared.first[name]) for name in single.STATES]), np.empty_like(expected)
    library.run.restype, library.run.argtypes = None, [ctypes.c_long, *[ctypes.c_void_p] * 4]
    library.run(COUNT, *(array.ctypes.data for array in (parameters, inputs, state, record)))
    assert np.array_equal(record, expected)
    assert np.any(record[:, workload.RECORD.index("velocity_load")] == 0.0)
