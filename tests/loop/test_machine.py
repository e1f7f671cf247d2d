"""Machines: axes in one program, structure modes in one exact hold, forces at common substeps."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.dynamometer_force import DynamometerForce
from feeddrive.blocks.coupling.force_record import ForceRecord
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.coupling.mode_shape import ModeShape
from feeddrive.blocks.coupling.structure_mode import StructureMode
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.load.milling_force import MillingForce
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.signals import Noise
from feeddrive.files.machine import read_machine
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.graph import reachable
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.gradient import gradient
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import SETPOINT, Loop, Signals
from feeddrive.loop.machine import Machine, noise_of
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import simulate, simulate_batch, stream
from feeddrive.loop.trace import concrete
from feeddrive.plot.curves import batch_chart
from feeddrive.testing import exercise as c
from loop import engine_loops as loops

T, COUNT = 2e-4, 750
X = TwoMass(mass_motor=120.0, mass_load=300.0, stiffness=6e7, damping=3000.0, viscous_motor=200.0)
Y = Rigid(mass=180.0, viscous=900.0)
MODES = (
    StructureMode(
        frequency=43.0,
        damping_ratio=0.03,
        mass=1500.0,
        shapes=(ModeShape(axis="x", motor=-0.4, load=1.0), ModeShape(axis="y", motor=0.7, load=0.7)),
    ),
    StructureMode(frequency=95.0, damping_ratio=0.02, mass=700.0, shapes=(ModeShape(axis="y", motor=0.2, load=-1.1),)),
)


def law() -> Control:
    return Control(law=CascadePPI(Kv=25.0, Kp=3.0e4, Tn=0.03))


def coupled(modes: tuple[StructureMode, ...] = MODES, substeps: int = 2) -> Machine:
    x = Axis(
        plant=X,
        friction_load=Viscous(viscous=800.0),
        actuator=Actuator(dead_time=1.3 * T, current_loop=900.0),
        substeps=substeps,
    )
    y = Axis(plant=Y, friction_load=Viscous(viscous=400.0), actuator=Actuator(dead_time=T), substeps=substeps)
    both = {"x": Loop(control=law(), axis=x, sample_time=T), "y": Loop(control=law(), axis=y, sample_time=T)}
    return Machine.of(both, modes)


def dry() -> Machine:
    """With friction that sticks on both axes, which share modes, and a cut between them."""
    axes = {}
    for name, loop in coupled().loops().items():
        friction = Stribeck(coulomb=60.0, breakaway=90.0, stribeck_velocity=0.003, viscous=500.0)
        axes[name] = replace(loop, axis=replace(loop.axis, friction_load=friction))
    cut = MillingCut(cutter=HelicalCutter.beltran2013(), spindle_speed=6000.0, surfaces=1, direction=0.0, remembered=64)
    cut = replace(cut, cutter=replace(cut.cutter, axial_depth=1e-3))
    return Machine.of(axes, (*MODES, cut))


PATH = {"x": loops.Sway(), "y": loops.Sway()}
LOADS = {"y": loops.Saw()}


@pytest.mark.parametrize("name", ["common", "rich"])
def test_a_machine_of_one_axis_is_its_loop(name: str):
    loop: Loop = getattr(loops, name)()
    alone = simulate(loop, loops.Sway(), load=loops.Saw(), duration=0.02, seed=3)
    one = simulate(Machine.of({"x": loop}), {"x": loops.Sway()}, load={"x": loops.Saw()}, duration=0.02, seed=3)
    for signal in Signals._fields:
        assert np.array_equal(alone[signal], one[f"x.{signal}"]), signal


def operations(system: Any, setpoint: Any) -> int:
    made = Prepared(system, setpoint).program()
    return len(reachable(made.graph, [*made.outputs.values(), *(state.after for state in made.states)]))


def test_a_machine_of_one_axis_has_the_operations_of_its_loop():
    loop = loops.rich()
    first = Work(loop, loops.Sway()).first()
    assert operations(Machine.of({"x": loop}), {"x": first}) == operations(loop, first)


def test_axes_without_couplings_move_as_they_do_alone():
    machine = coupled(modes=())
    found = simulate(machine, PATH, load=LOADS, duration=0.05)
    for name, loop in machine.loops().items():
        alone = simulate(loop, PATH[name], load=LOADS.get(name), duration=0.05)
        assert np.array_equal(found[f"{name}.tracking_error"], alone["tracking_error"])


def truth(machine: Machine, frequency: float) -> np.ndarray:
    """Motor and load positions of x, load of y over commands of x and y and load forces of x and y; scipy's expm."""
    shapes = np.array([[-0.4, 0.0], [1.0, 0.0], [0.7, 0.2], [0.7, -1.1]])  # rows: x motor, x load, y motor, y load
    mass = block_diag(np.diag([120.0, 300.0]), 180.0, 1500.0, 700.0)
    k = 6e7 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    w = 2.0 * np.pi * np.array([43.0, 95.0])
    stiffness = block_diag(k, 0.0, np.diag(w**2 * [1500.0, 700.0]))
    rows = np.hstack([np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0, 0, 1.0]]), shapes])
    modal = np.diag(2.0 * np.array([0.03, 0.02]) * w * [1500.0, 700.0])
    damping = block_diag(k * 3000.0 / 6e7 + np.diag([200.0, 0.0]), 900.0, modal)
    damping = damping + 800.0 * np.outer(rows[1], rows[1]) + 400.0 * np.outer(rows[3], rows[3])
    n, lag = 5, 2.0 * np.pi * 900.0
    size = 2 * n + 1
    A = np.zeros((size, size))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n, :n], A[n : 2 * n, n : 2 * n] = -np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)
    forces = np.linalg.solve(mass, rows.T)
    A[n : 2 * n, 2 * n] = forces[:, 0]  # the drive force of x acts on its motor and lags behind the command
    A[2 * n, 2 * n] = -lag
    B = np.zeros((size, 4))
    B[2 * n, 0] = lag
    B[n : 2 * n, 1], B[n : 2 * n, 2], B[n : 2 * n, 3] = forces[:, 2], forces[:, 1], forces[:, 3]

    def held(time: float) -> tuple[np.ndarray, np.ndarray]:
        moved = expm(np.block([[A, B], [np.zeros((4, size + 4))]]) * time)
        return moved[:size, :size], moved[:size, size:]

    z = np.exp(2j * np.pi * frequency * T)
    whole, inputs = held(T)
    first, early = held(0.3 * T)
    rest, late = held(0.7 * T)
    assert np.allclose(rest @ first, whole)
    inputs = inputs.astype(complex)
    inputs[:, 0] = late[:, 0] / z + rest @ early[:, 0] / z**2  # 1.3 samples late
    inputs[:, 1] = inputs[:, 1] / z
    states = np.linalg.solve(z * np.eye(size) - whole, inputs)
    return rows[[0, 1, 3]] @ states[:n]


@pytest.mark.parametrize("substeps", [1, 3])
def test_every_entry_of_the_response_is_exact(substeps: int):
    """Against the coupled mechanics with zero-order hold, dead time, lag and friction, built by hand with scipy."""
    machine = coupled(substeps=substeps)
    inputs = ["x.cut", "y.cut", "x.load_force", "y.load_force"]
    outputs = ["x.position_motor", "x.position_load", "y.position_load"]
    model = linearize(machine, inputs, outputs)
    for frequency in (5.0, 43.0, 90.0, 400.0, 2400.0):
        expected = truth(machine, frequency)
        for i, output in enumerate(outputs):
            for j, given in enumerate(inputs):
                found = model.response(np.array([frequency]), output, given).response[0]
                # relative to the largest entry at this frequency: rounding of matrices of 15 rows
                assert abs(found - expected[i, j]) < 1e-10 * np.max(np.abs(expected)), (frequency, output, given)


def test_the_response_is_that_of_a_run():
    """A step of force on the load of y, in the linear machine, against its linear model sample by sample."""
    machine = coupled()
    model = linearize(machine, ["y.load_force"], ["x.tracking_error", "y.tracking_error"], velocity=0.0)
    found = simulate(machine, {name: Still() for name in "xy"}, load={"y": Step()}, duration=0.1)
    state, rows = np.zeros(len(model.states)), []
    for _ in found.time:
        rows.append(model.C @ state + model.D[:, 0])
        state = model.A @ state + model.B[:, 0]
    for i, name in enumerate("xy"):
        expected = np.array(rows)[:, i]
        assert np.max(np.abs(found[f"{name}.tracking_error"] - expected)) < 1e-10 * np.max(np.abs(expected))
    assert np.max(np.abs(found["x.tracking_error"])) > 1e-9  # the mode carries it over


class Still(loops.Sway):
    """At rest."""

    def at(self, t: np.ndarray) -> Any:
        return type(super().at(t))(*(0.0 * each for each in super().at(t)))


class Step(loops.Saw):
    """1 N from the start."""

    def at(self, t: np.ndarray) -> np.ndarray:
        return np.ones_like(t)


def test_native_code_has_the_bits_of_the_source():
    machine = dry()
    work = Work(machine, PATH, LOADS)
    found = simulate(machine, PATH, load=LOADS, duration=(COUNT - 1) * T)
    plain, timing = concrete(machine), machine.timing()
    rows = work.sampled(0, COUNT)
    names = [*(f"{axis}.{name}" for axis in "xy" for name in SETPOINT), "y.load_force"]
    with np.errstate(all="ignore"):
        made = plain.prepare(timing)
        first = work.first()
        begun = ({axis: getattr(first[axis], what) for axis in "xy"} for what in ("position", "velocity"))
        state = plain.start(made, timing, first, *begun)
        for k in range(COUNT):
            inputs = {name: np.float64(rows[name][k]) for name in names}
            noise = Noise(np.float64(0.0), np.float64(k))
            state, signals = plain.sample(made, state, inputs, noise, np.float64(k) * plain.sample_time)
            for name, value in signals.items():
                assert found[name][k] == float(value), (k, name)
    assert np.ptp(found["x.load_force"]) > 1.0  # N, of the cut


def test_c_and_stream_have_the_bits_of_a_run(tmp_path):
    machine = dry()
    found = simulate(machine, PATH, load=LOADS, duration=(COUNT - 1) * T)
    pieces = list(stream(machine, PATH, load=LOADS, duration=(COUNT - 1) * T, chunk=77))
    assert np.array_equal(np.concatenate([piece["y.force"] for piece in pieces]), found["y.force"])
    work = Work(machine, PATH, LOADS)
    prepared = Prepared(machine, work.first())
    made = prepared.native(prepared.program(load=["y"]), record=["x.force", "y.position_load"])
    library = c.compiled(c.text(made.plan, "machine_run"), tmp_path, "-Wno-unused-parameter")
    library.machine_run.restype = None
    library.machine_run.argtypes = [ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 5]
    outputs = np.empty((COUNT, 2))
    arrays = (
        prepared.constants(made),
        np.ascontiguousarray(work.inputs(made, 0, COUNT)),
        prepared.states(made),
        outputs,
    )
    tables = (ctypes.c_void_p * 1)()
    library.machine_run(COUNT, 0, *(each.ctypes.data for each in arrays), ctypes.addressof(tables))
    assert np.array_equal(outputs[:, 0], found["x.force"])
    assert np.array_equal(outputs[:, 1], found["y.position_load"])


def test_a_batch_has_the_bits_of_single_runs():
    names = {"axis.x.control.law.Kv": np.linspace(15.0, 30.0, 9), "couplings.0.frequency": np.linspace(40.0, 60.0, 9)}
    machine = dry()
    found = simulate_batch(tree.vary(machine, names), PATH, load=LOADS, duration=(COUNT - 1) * T)
    for i in (0, 8):
        one = tree.vary(machine, {name: values[i] for name, values in names.items()})
        alone = simulate(one, PATH, load=LOADS, duration=(COUNT - 1) * T)
        assert found.most["x.tracking_error"][i] == np.max(alone["x.tracking_error"])
        assert found.peak["y.force"][i] == np.max(np.abs(alone["y.force"]))
    # the chart of a machine of several axes was a KeyError
    assert len(batch_chart(found).panels) == len(found.units) == len(found.rms)


def test_gradients_go_through_couplings():
    machine = coupled()
    names = ["couplings.0.frequency", "couplings.1.mass", "axis.x.plant.mass_load", "axis.y.control.law.Kp"]
    found = gradient(machine, PATH, [*names, "axis.x.actuator.dead_time"], load=LOADS, duration=0.1)
    for name in found.gradient:
        value = float(tree.get(machine, name))

        def cost(x: float, name: str = name) -> float:
            run = simulate(tree.vary(machine, {name: x}), PATH, load=LOADS, duration=0.1)
            return float(np.mean(run["x.tracking_error"] ** 2 + run["y.tracking_error"] ** 2))

        h = 1e-4 * value
        slope = (cost(value + h) - cost(value - h)) / (2.0 * h)
        # second differences of the cost are some 1e-7 of it; a dead time of 1.3 samples has a kink nowhere near
        assert found.gradient[name] == pytest.approx(slope, rel=1e-4), name


def test_a_live_change_by_name():
    machine = coupled()
    change = {"axis.y.control.law.Kv": 40.0}
    found = simulate(machine, PATH, load=LOADS, duration=0.05, changes={100: change})
    same = simulate(machine, PATH, load=LOADS, duration=0.05)
    assert np.array_equal(found["y.force"][:100], same["y.force"][:100])
    assert not np.array_equal(found["y.force"][100:], same["y.force"][100:])


def test_the_chip_is_what_the_axes_really_did():
    """Two heavy carriages at constant speed without control: the force is that of the chip feed / (teeth n / 60)."""
    feed, speed, T = np.array([3e-3, -2e-3]), 1800.0, 1e-4
    off = Control(law=CascadePPI(Kv=1e-9, Kp=1e-9, Tn=1e9))
    loop = Loop(control=off, axis=Axis(plant=Rigid(mass=1e12)), sample_time=T)
    cutter = HelicalCutter.beltran2013()
    machine = Machine.of({"x": loop, "y": loop}, (MillingCut(cutter=cutter, spindle_speed=speed),))
    start = {"x": (0.0, feed[0]), "y": (0.0, feed[1])}
    found = simulate(machine, {"x": Still(), "y": Still()}, start=start, duration=0.1)
    chip, direction = float(np.hypot(*feed)) / (2.0 * speed / 60.0), float(np.arctan2(feed[1], feed[0]))
    settled = found.time > 60.0 / (2.0 * speed) + T
    for axis in "xy":
        load = MillingForce(cutter=cutter, spindle_speed=speed, component=axis, chip_load=chip, direction=direction)
        expected = load.at(found.time + 0.5 * T)  # a force of the substep's middle
        assert np.max(np.abs(found[f"{axis}.load_force"] - expected)[settled]) < 1e-6 * np.max(np.abs(expected))
    grown = np.abs(found["x.load_force"])[~settled]
    assert grown[0] < 0.05 * np.max(np.abs(found["x.load_force"]))  # the first chip grows from nothing


def test_a_dynamometer_record_acts_on_its_axes_at_substeps():
    """Against the closed form of a mass under a force that is linear in time."""
    off = Control(law=CascadePPI(Kv=1e-9, Kp=1e-9, Tn=1e9))
    loop = Loop(control=off, axis=Axis(plant=Rigid(mass=50.0), substeps=4), sample_time=1e-3)
    ramp = np.linspace(0.0, 100.0, 11)
    coupling = DynamometerForce(
        components=(ForceRecord(axis="x", row=ramp), ForceRecord(axis="y", row=-0.5 * ramp)), interval=0.01
    )
    found = simulate(Machine.of({"x": loop, "y": loop}, (coupling,)), {"x": Still(), "y": Still()}, duration=0.2)
    inside = found.time <= 0.1
    t = found.time[inside]
    # v = (1000 N/s) t² / 2 m: the midpoint of each substep is exact for a linear force
    assert np.max(np.abs(found["x.velocity_load"][inside] - 1000.0 * t**2 / 100.0)) < 1e-12
    assert np.max(np.abs(found["y.velocity_load"] + 0.5 * found["x.velocity_load"])) < 1e-12
    assert np.ptp(found["x.velocity_load"][found.time > 0.1005]) < 1e-12  # nothing after the record


def test_the_axes_of_a_file_make_a_machine():
    """With a mode that both feel, a move of x alone loads the friction that holds y."""
    file = read_machine("xy_table")
    shapes = (ModeShape(axis="x", load=1.0), ModeShape(axis="y", load=0.5))
    machine = file.machine(StructureMode(frequency=35.0, mass=900.0, shapes=shapes))
    still = SnapLimitedMove(distance=0.0, velocity=0.2, acceleration=3.0, jerk=60.0, snap=1e4)
    path = {"x": replace(still, distance=0.02), "y": still}
    found = simulate(machine, path, duration=0.3)
    alone = simulate(file.machine(), path, duration=0.3)
    assert np.max(np.abs(alone["y.friction_load"])) == 0.0
    assert np.max(np.abs(found["y.friction_load"])) > 1.0  # N


def test_what_does_not_fit_is_refused():
    machine = coupled()
    loops_ = machine.loops()
    with pytest.raises(ParameterError, match="one sample time"):
        Machine.of({"x": loops_["x"], "y": replace(loops_["y"], sample_time=2 * T)})
    with pytest.raises(StructureError, match="number of substeps"):
        Machine.of({"x": loops_["x"], "y": replace(loops_["y"], axis=replace(loops_["y"].axis, substeps=5))})
    with pytest.raises(StructureError, match="axis 'z', which is not there"):
        Machine.of(loops_, (StructureMode(frequency=40.0, mass=1.0, shapes=(ModeShape(axis="z"),)),))
    with pytest.raises(ParameterError, match="cannot be the name of an axis"):
        Machine.of({"x 1": loops_["x"]})
    with pytest.raises(ParameterError, match="reference: axis y has none"):
        simulate(machine, {"x": loops.Sway()})
    with pytest.raises(ParameterError, match="no axis 'z'"):
        machine.loop("z")
    with pytest.raises(ParameterError, match=r"no signal 'force'; did you mean y.force or x.force"):
        simulate(machine, PATH, record=["force"])
    with pytest.raises(ParameterError, match=r"remembered = 8 .* at least 52"):
        Machine.of(loops_, (replace(dry().couplings[-1], remembered=8),))


def test_seeds_below_a_million_million_are_those_of_one_axis() -> None:
    """Noise depends on whole numbers up to 2⁵³: 2¹³ axes with 2⁴⁰ seeds each, none of which is that of another."""
    seeds = {noise_of(Noise(seed, 0.0), axis).seed for seed in (0.0, 2.0**39, 2.0**40 - 1.0) for axis in range(4)}
    assert len(seeds) == 12
    assert noise_of(Noise(2.0**40 - 1.0, 0.0), 2**13 - 1).seed < 2.0**53
