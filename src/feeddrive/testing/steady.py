"""The response of a block of a control to a live change of its parameters, in a steady state without following error.

The axis follows exactly, at rest or at constant velocity, and the force that a law commands acts in the next sample.
All outputs of the block are then constant and must remain so after a live change, unless the new parameters require
another value: a larger share of a disturbance is a different force.  The required value is the output of the new block
if it is started there, of a compensation with its blended parts fully active.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks import families
from feeddrive.blocks.catalogue import family_of
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import Ring
from feeddrive.language.text import Text

# a power of two: sums of few of its multiples are exact in doubles, so that no rounding looks like a bump
_GRID = 2.0**-17  # m: positions on it, and their differences, are exact
ERRORS = tuple(1e-4 * k for k in (-1.5, -0.5, 0.5, 1.5, 2.5))  # m: they fill the integral of a law
# samples between the states that are compared, and outputs that are recorded on both sides of a change
SETTLING, SAMPLES = 12, 8
_SHARE = 1e-6  # of an output: far above rounding, far below what a wrong unit makes of it
_SMALL = 1e-9  # of the usual size of an output that is 0
_DIGITS = 8.0 * float(np.finfo(float).eps)
_SIZES = (1e-3, 1.0, 10.0, 1e3, 1e5)  # m, m/s, m/s², m/s³, m/s⁴ of motions
_FORCE = 1e3  # N


class Place(NamedTuple):
    """An operating point: position at sample 0 and travel per sample (m), sample time T (s) and a force (N)."""

    position: Any
    way: Any
    T: Any
    force: Any

    def setpoint(self, sample: int, ahead: float = 0.0) -> Setpoint:
        """Return the setpoint at a sample, `ahead` m in front of the axis."""
        return Setpoint(self.position + float(sample) * self.way + ahead, self.way / self.T)

    def reading(self, sample: int, force: Any) -> Reading:
        """Return the reading at a sample while a force acts."""
        position = self.position + float(sample) * self.way
        return Reading(position, position, force, force, self.way / self.T)


def place(position: float, moves: bool, T: float, force: float) -> Place:
    """Return an operating point near a position, on a grid on which differences of positions are exact."""
    return Place(*map(np.float64, (round(position / _GRID) * _GRID, _GRID if moves else 0.0, T, force)))


class Steady:
    """A block that runs from a given operating point and sample."""

    def __init__(self, block: Any, at: Place, sample: int = 0) -> None:
        self.block, self.at, self.sample = block, at, sample
        self._family = family_of(type(block))
        self.prepared = None if self._family in UNPREPARED else block.prepare(at.T)
        self.force = at.force  # that acts: of a law the last one that it commanded
        setpoint, reading = at.setpoint(sample), at.reading(sample, at.force)
        if self._family in UNPREPARED:
            self.state = block.start(setpoint)
        elif self._family is families.Filter:
            self.state = block.start(self.prepared, at.force)
        elif self._family is families.Observer:
            self.state = block.start(self.prepared, reading)
        else:
            self.state = block.start(self.prepared, setpoint, reading)

    def outputs(self, count: int, errors: Sequence[float] = ()) -> np.ndarray:
        """Return the outputs of the next samples, one row per sample, with following errors in the first ones."""
        rows = [self._step(errors[k] if k < len(errors) else 0.0) for k in range(count)]
        return np.array(rows, dtype=float)

    def after(self, count: int, errors: Sequence[float] = ()) -> np.ndarray:
        """Return the numbers of the state after some samples; rings are left out, they show in values read from
        them.
        """
        self.outputs(count, errors)
        return np.array([float(value) for _, value in tree.leaves(self.state) if not isinstance(value, Ring)])

    def _step(self, error: float) -> Sequence[Any]:
        self.sample += 1
        setpoint, reading = self.at.setpoint(self.sample, error), self.at.reading(self.sample, self.force)
        block, prepared, T = self.block, self.prepared, self.at.T
        if self._family is families.Law:
            self.state, self.force = block.step(prepared, self.state, setpoint, reading, T)
            return (self.force,)
        if self._family is families.Filter:
            self.state, value = block.step(prepared, self.state, self.force)
            return (value,)
        if self._family is families.Observer:
            self.state, seen = block.step(prepared, self.state, reading, T)
            return (seen.position - reading.position_load, seen.velocity, seen.disturbance)
        if self._family is families.Compensation:
            self.state, moved, force = block.step(prepared, self.state, setpoint, reading, T)
            return (moved.position - setpoint.position, *moved[1:], force)
        self.state, outputs = block.step(self.state, setpoint, T)
        if self._family is families.Feedforward:
            return (outputs,)
        return (outputs.position - setpoint.position, *outputs[1:])

    def retune(self, new: Any) -> None:
        """Change the parameters of the block between two samples."""
        if self._family in UNPREPARED:
            self.state = new.retune(self.state, self.block)
        else:
            prepared = new.prepare(self.at.T)
            self.state, self.prepared = new.retune(self.state, self.block, self.prepared, prepared), prepared
        self.block = new


UNPREPARED = (families.Feedforward, families.Prefilter)
RETUNED = (families.Law, families.Filter, families.Observer, families.Compensation, *UNPREPARED)


def without_friction(new: Block, old: Block) -> Block:
    """Return the new block with the old viscous friction: in motion, other friction requires another force."""
    pairs = zip(tree.leaves(new), tree.leaves(old), strict=True)
    values = (old if name.rpartition(".")[2].startswith("viscous") else new for (name, new), (_, old) in pairs)
    return tree.rebuild(new, values)


def bump(old: Block, new: Block, at: Place, errors: Sequence[float] = ()) -> str:
    """Return a description of an unnecessary change of a steady output by a live change from one block to another.

    It is empty if the output continues, and if there is no steady state: with a block that settles slowly, with a law
    that does not hold the force with which it was started, and in motion also if the new block would not.
    """
    change = _changed(old, new, at, errors)
    if not change.settled:
        return ""
    last, required = change.before[-1], change.required
    rounding = _rounding(old, new, at, errors, change)
    near = _SHARE * np.maximum(np.abs(last), np.abs(required[0])) + _SMALL * _usual(last.size) + rounding
    # a hundredth of what counts as a bump: a slow drift must not be taken for one
    steady = np.all(np.abs(change.before - last) <= 0.01 * near)
    # a law that does not hold its first force has still a transient: it shows the change of gains, not of state
    if isinstance(old, families.Law) and not errors:
        steady = steady and abs(last[0] - at.force) <= near[0]
    # in motion other numbers may need another force: only where they need the same one is a change of it a bump
    if at.way > 0.0:
        steady = steady and np.all(np.abs(required - last) <= near)
    low, high = np.minimum(last, required) - near, np.maximum(last, required) + near
    wrong = np.argwhere(~((low <= change.after) & (change.after <= high)))
    if not steady or not wrong.size:
        return ""
    sample, output = wrong[0]
    return Text(
        f"output {output} of {new.kind} was {Quantity(last[output]):9} in a steady state; {sample + 1} samples after a "
        f"live change it is {Quantity(change.after[sample, output]):9}, and started there with the new numbers it "
        f"would be {Quantity(required[sample, output]):9}: retune must return the state with which it goes on"
    )


class Change(NamedTuple):
    """The outputs before and after a live change and of the new block started there; whether a state settled; its
    size.
    """

    before: np.ndarray
    after: np.ndarray
    required: np.ndarray
    settled: bool
    size: float


def _changed(
    old: Block, new: Block, at: Place, errors: Sequence[float], wrong: float = 0.0, pattern: int = 0
) -> Change:
    """Run a live change; a nonzero `wrong` perturbs readings in their last digits and the state by this share.

    Bit `pattern` of the index of a number in the state is the sign of its perturbation.
    """
    held = Steady(old, at)
    states = [held.after(SETTLING, errors), held.after(SETTLING), held.after(SETTLING)]
    before = held.outputs(SAMPLES)
    # a compensation fades in: the fade of a fresh start is no bump of the live change
    whole = new.settled() if isinstance(new, families.Compensation) else new
    required = Steady(whole, at._replace(force=held.force), held.sample).outputs(SAMPLES)
    if wrong:
        held.at = at._replace(position=(1.0 + _DIGITS) * at.position)
        values = [value for _, value in tree.leaves(held.state)]
        signs = [wrong if i >> pattern & 1 else -wrong for i in range(len(values))]
        moved = (v if isinstance(v, Ring) else (1.0 + sign) * v for v, sign in zip(values, signs, strict=True))
        held.state = tree.rebuild(held.state, moved)
    held.retune(new)
    settled, size = _settled(*states, exactly=len(errors) > 0), np.max(np.abs(states[-1]), initial=0.0)
    return Change(before, held.outputs(SAMPLES), required, settled, float(size))


def _rounding(old: Block, new: Block, at: Place, errors: Sequence[float], change: Change) -> np.ndarray:
    """Return the change of the outputs due to rounding of readings and state and to rounding left in the outputs.

    With a gain of 1e17 N/m, as of a predictive law over a short horizon, that is 100 N; with a filter that amplifies
    high frequencies by 1e6 it is 0.1 N.
    """
    last = change.before[-1]
    size = np.abs(last) + _SMALL * _usual(last.size)
    off = np.abs(change.required[0] - last)
    wrong = _DIGITS * max(1.0, change.size / float(np.max(size)))
    wrong += float(np.max(np.where(off <= _SHARE * np.abs(last), off, 0.0) / size))
    # three patterns of signs: with a single one errors of two states could cancel each other
    beside = [_changed(old, new, at, errors, wrong, pattern).after for pattern in range(3)]
    return 10.0 * np.max(np.abs(np.array(beside) - change.after), axis=(0, 1))


def _settled(first: np.ndarray, second: np.ndarray, third: np.ndarray, exactly: bool) -> bool:
    """True if states at equal time intervals lie on straight lines: other gains would show an unfinished transient.

    After errors they must be equal to the last bit, as the state of an integrator is, unlike the slow end of an
    observer's transient.
    """
    if exactly:
        return bool(np.all(first == second) and np.all(second == third))
    largest = np.maximum(np.maximum(np.abs(first), np.abs(second)), np.abs(third))
    bent = np.abs(first - 2.0 * second + third)
    return bool(np.all(bent <= 1e-9 * largest + 1e-13 * np.max(largest, initial=0.0)))


def _usual(count: int) -> np.ndarray:
    """Return the typical magnitudes of the outputs of a block, the force last."""
    return np.array([*_SIZES[: 5 if count >= 5 else count - 1], *([_FORCE] if count != 5 else [])])
