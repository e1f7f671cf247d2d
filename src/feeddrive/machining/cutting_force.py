"""Cutting forces of a finished run along feed, normal and spindle, with torque and power of the spindle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.signals import Motion
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import Ring
from feeddrive.language.table import UNIT, Cell, Result, Table
from feeddrive.loop.engine.llvm import native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.simulate import Run
from feeddrive.loop.trace import Carried, Program, concrete, leaf, node


@dataclass(frozen=True, eq=False, repr=False)
class CuttingForces(Result):
    """The forces of the workpiece on the tool over a run, averaged over each sample; all arrays of shape (n,).

    time                 s, start of the sample
    feed, normal, axial  N, along the feed, along spindle axis x feed, along the spindle
    torque, power        N m and W, of the spindle
    spindle_speed        rpm
    angle                rad, unwrapped spindle angle in the middle of the sample
    along, across        components of the direction of the feed in x and y
    """

    time: np.ndarray
    feed: np.ndarray
    normal: np.ndarray
    axial: np.ndarray
    torque: np.ndarray
    spindle_speed: np.ndarray
    angle: np.ndarray
    along: np.ndarray
    across: np.ndarray

    @property
    def power(self) -> np.ndarray:
        """The spindle power, torque times angular velocity, W."""
        return self.torque * self.spindle_speed * (np.pi / 30.0)

    @property
    def resultant(self) -> np.ndarray:
        """The resultant force in the plane normal to the spindle, N."""
        return np.hypot(self.feed, self.normal)

    def table(self) -> Table:
        """Return a table of mean and peak values while the tool cuts."""
        cuts = self.torque != 0.0
        rows: list[list[Cell]] = []
        units = {"feed": "N", "normal": "N", "axial": "N", "resultant": "N", "torque": "N m", "power": "W"}
        for name, unit in units.items():
            values = getattr(self, name)[cuts]
            mean, peak = (float(np.mean(values)), float(np.max(np.abs(values)))) if values.size else (0.0, 0.0)
            rows.append([name, UNIT, Quantity(mean, unit), Quantity(peak, unit)])
        share = Quantity(float(np.mean(cuts)) if cuts.size else 0.0, "share")
        title = f"force on the tool, which cuts in {share:3} of the samples"
        return Table(title, ["", "unit", "mean", "peak"], rows)


def cutting_forces(run: Run, cut: MillingCut) -> CuttingForces:
    """Compute the cutting forces of a run from the motion of its axes, with the same model as in the run.

    For a run with one substep it is exactly the force of the run; otherwise it is that with one substep per sample.
    Raises ParameterError for a run that does not begin at 0 s or without the positions and velocities of x and y.
    """
    if run.first:
        raise ParameterError(
            f"the run begins at sample {run.first}: what the tool cut before is not known; give the whole run"
        )
    names = {f"{axis}.{what}" for axis in (cut.along_x, cut.along_y) for what in ("position_load", "velocity_load")}
    missing = sorted(names - set(run.signals))
    if missing:
        raise ParameterError(f"the run has no {', '.join(missing)}: record these for the cutting force")
    T = np.float64(run.sample_time)
    plain = concrete(cut)  # type: ignore[arg-type]
    first = {name: np.float64(run[name][0]) for name in names}
    begun = plain.start(None, _motions(cut, first, 0.0))
    tables = dict(tree.tables(cut))
    compiled = native(plan(_program(cut, begun, tables)))
    values = {**dict(tree.leaves(plain)), "T": T}
    constants = np.array([[values[name]] for name, _ in compiled.plan.constants]).reshape(-1, 1)
    held = {name: value for name, value in tree.leaves(begun) if not isinstance(value, Ring)}
    states = np.zeros((len(compiled.plan.memory), 1))
    for i, state in enumerate(compiled.plan.states):
        states[i, 0] = held[state.name]
    inputs = np.column_stack([run[name] for name, _ in compiled.plan.inputs])
    outputs = np.empty((run.samples, len(compiled.plan.outputs), 1))
    rows = [np.asarray(tables[name]) for name, _ in compiled.plan.tables]
    compiled.run(run.samples, 0, constants, np.ascontiguousarray(inputs), states, outputs, rows)
    results = {name: outputs[:, i, 0].copy() for i, (name, _) in enumerate(compiled.plan.outputs)}
    middle = run.time + 0.5 * run.sample_time
    acts = middle >= cut.cut_from
    if cut.cut_to is not None:
        acts &= middle < cut.cut_to
    forces = {name: np.where(acts, results[name], 0.0) for name in ("feed", "normal", "axial", "torque")}
    speed = _speed(cut, middle)
    turns = (
        np.concatenate([[0.0], np.cumsum(speed[:-1] * (run.sample_time / 60.0))]) + 0.5 * speed * run.sample_time / 60.0
    )
    return CuttingForces(
        run.time,
        **forces,
        spindle_speed=speed,
        angle=cut.start_angle + 2.0 * np.pi * turns,
        along=results["along"],
        across=results["across"],
    )


def _motions(cut: MillingCut, signals: Any, ahead: Any) -> dict[str, Motion]:
    """Return the motions of the axes, extrapolated by a time in s."""
    motions: dict[str, Motion] = {}
    for axis in (cut.along_x, cut.along_y):
        x, v = signals[f"{axis}.position_load"], signals[f"{axis}.velocity_load"]
        motions[axis] = Motion(x, x + ahead * v, v, v)
    return motions


def _speed(cut: MillingCut, time: np.ndarray) -> np.ndarray:
    rows = {} if cut.sections is None else cut.sections.rows()
    if "spindle_speed" not in rows:
        return np.full(time.shape, float(cut.spindle_speed))
    section = np.clip(np.searchsorted(rows["start"], time, side="right") - 1, 0, None)
    return np.asarray(rows["spindle_speed"])[section]


def _program(cut: MillingCut, begun: Any, tables: dict[str, Any]) -> Program:
    """Trace one substep of the cut between named numbers."""
    graph = Graph()
    symbolic = tree.rebuild(cut, (graph.input(name) for name, _ in tree.leaves(cut)))
    symbolic = tree.with_tables(symbolic, {name: graph.table(name, len(row)) for name, row in tables.items()})
    names = [name for name, _ in tree.leaves(begun)]
    before = tree.rebuild(begun, (leaf(graph, f"state.{name}", value) for name, value in tree.leaves(begun)))
    signals = [f"{axis}.{what}" for axis in (cut.along_x, cut.along_y) for what in ("position_load", "velocity_load")]
    symbols = {name: graph.input(name) for name in signals}
    sample = graph.input("sample")
    T: Any = graph.input("T")
    after, (along, across), forces = symbolic.forces(
        before, _motions(cut, symbols, 0.5 * T), cast(Number, sample * T + 0.5 * T), T
    )
    carried = tuple(
        Carried(name, node(graph, old), node(graph, new))
        for name, (_, old), (_, new) in zip(names, tree.leaves(before), tree.leaves(after), strict=True)
    )
    outputs = {**forces._asdict(), "along": along, "across": across}
    return Program(
        graph=graph,
        constants={name: graph.input(name).index for name in (*dict(tree.leaves(cut)), "T")},
        inputs={name: symbol.index for name, symbol in symbols.items()},
        states=carried,
        outputs={name: graph.symbol(value).index for name, value in outputs.items()},
        sample=sample.index,
        tables={name: graph.table(name, len(row)).index for name, row in tables.items()},
    )
