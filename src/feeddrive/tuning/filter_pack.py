"""The filter pack by hand: a filter with start values for the loop, its response, and what two packs differ in."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from feeddrive.analysis.margins import Margins
from feeddrive.blocks.catalogue import find, members
from feeddrive.blocks.families import Filter
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.loop.control import Control
from feeddrive.tuning.tunables import HIGHEST_FILTER

B = TypeVar("B", bound=Block)
_RISE = 3.0  # dB by which a resonance stands out of the loop gain below it
_AROUND = 1.1  # factor of the frequency of a resonance within which it counts
_BEYOND = 3.0  # times the crossover: where a filter begins if nothing stands out
_COSTS = 10.0  # degrees of phase at the crossover that a filter may take to begin with
_PASSES = 0.5  # gain near half the sample rate below which a filter is a low-pass
_NARROWEST = 10.0  # times narrower than by default
_HALVINGS = 20


def filter_kinds() -> tuple[str, ...]:
    """All kinds of filters, those of one's own too."""
    return tuple(members(Filter))  # type: ignore[type-abstract]


def written_filter(block: Filter) -> str:
    """A filter as the command line takes it: notch:frequency=164.0,damping_zero=0.05,damping_pole=0.5."""
    return f"{block.kind}:{','.join(f'{name}={value!r}' for name, value in tree.leaves(block))}"


def read_filter(text: str) -> Filter:
    """The filter of a text as `written_filter` gives it, in SI; fields that are left out have their defaults.

    Raises ParameterError for an unknown kind or field, a missing one, no number, and a value outside of its bounds.
    """
    return read_block(Filter, text)  # type: ignore[type-abstract]


def read_block(family: type[B], text: str) -> B:
    """A block of a family as the command line takes it, by its numbers in SI: cascade_ppi:Kv=38,Kp=9e4.

    Raises ParameterError for an unknown kind or field, a missing one, no number, and a value outside of its bounds.
    """
    kind, _, rest = text.partition(":")
    block_type: type[Any] = find(family, kind.strip())
    known = [name for name, declared in declarations(block_type).items() if declared.role == "parameter"]
    values = dict[str, float]()
    for pair in filter(None, (part.strip() for part in rest.split(","))):
        name, equals, value = (part.strip() for part in pair.partition("="))
        if not equals:
            raise ParameterError(f"'{pair}' of '{text}': write it as NAME=VALUE, as notch:frequency=164")
        if name not in known:
            raise ParameterError(f"{block_type.kind} has no number '{name}'{nearest(name, known)}")
        try:
            values[name] = float(value)
        except ValueError:
            raise ParameterError(f"{block_type.kind}.{name} = '{value}' is no number") from None
    missing = [
        field.name
        for field in dataclasses.fields(block_type)  # type: ignore[arg-type]
        if field.name in known and field.name not in values and field.default is dataclasses.MISSING
    ]
    if missing:
        units = ", ".join(f"{name} in {declarations(block_type)[name].unit or '1'}" for name in missing)
        raise ParameterError(f"'{text}' needs {units}: write {kind}:{missing[0]}=VALUE")
    return block_type(**values)


def filter_response(block: Filter, frequency: np.ndarray, sample_time: float) -> np.ndarray:
    """The gain of a filter on lines in Hz, from its own step: H = c (z - A)⁻¹ b + d, z = e^(j2πfT)."""
    prepared = block.prepare(sample_time)
    rest = block.start(prepared, 0.0)
    count = sum(1 for _ in tree.leaves(rest))

    def stepped(state: np.ndarray, value: float) -> list[float]:
        after, output = block.step(prepared, tree.rebuild(rest, iter(state)), value)
        return [*(float(number) for _, number in tree.leaves(after)), float(output)]

    rows = [stepped(row, 0.0) for row in np.eye(count)] + [stepped(np.zeros(count), 1.0)]
    whole = np.array(rows).T  # [A b; c d]
    z = np.exp(2j * np.pi * np.asarray(frequency) * sample_time)
    inverse = z[:, None, None] * np.eye(count) - whole[:count, :count]
    states = np.linalg.solve(inverse, np.broadcast_to(whole[:count, count:], (z.size, count, 1)))
    return (whole[count:, :count] @ states)[:, 0, 0] + whole[count, count]


def begun_filter(kind: str, loop: Margins, sample_time: float, at: float | None = None) -> Filter:
    """A filter with start values for a loop gain: at a frequency in Hz, or where it is likely to be wanted.

    A filter that passes high frequencies begins at the resonance beyond the crossover that brings the loop nearest to
    -1, of those that stand out of the loop gain by 3 dB; without one at three times the crossover.  Where it would take
    more than 10° of the phase at the crossover it begins narrower: all its damping ratios smaller by a common factor.
    A low-pass begins at the lowest frequency at which it takes no more than 10°.  Never above 0.45 times the sample
    rate.

    Raises ParameterError for a filter with a number that is neither a frequency nor has a default.
    """
    filter_type: type[Any] = find(Filter, kind)  # type: ignore[type-abstract]
    highest = HIGHEST_FILTER / sample_time
    names = list[str]()
    for field in dataclasses.fields(filter_type):  # type: ignore[arg-type]
        declared = declarations(filter_type)[field.name]
        if field.default is dataclasses.MISSING and declared.role == "parameter":
            if declared.unit != "Hz":
                raise ParameterError(
                    f"{filter_type.kind}.{field.name} has no default and is no frequency: add the filter by its "
                    f"numbers, feeddrive adjust --add {filter_type.kind}:{field.name}=VALUE"
                )
            names.append(field.name)

    ratios = {
        field.name: field.default
        for field in dataclasses.fields(filter_type)  # type: ignore[arg-type]
        if field.name.startswith("damping") and isinstance(field.default, (int, float))
    }
    crossover = loop.crossover or float(loop.loop_gain.frequency[0])

    def placed(frequency: float, narrow: float = 1.0) -> Filter:
        dampings = {name: float(f"{narrow * value:.4g}") for name, value in ratios.items()}
        return filter_type(**dict.fromkeys(names, float(f"{frequency:.4g}")), **dampings)

    def mild(block: Filter) -> bool:
        return abs(np.degrees(np.angle(filter_response(block, np.array([crossover]), sample_time)[0]))) <= _COSTS

    through = abs(filter_response(placed(0.1 * highest), np.array([highest]), sample_time)[0])
    if through < _PASSES:
        low = min(crossover, highest)
        return placed(at or _least(lambda frequency: mild(placed(frequency)), low, highest))
    where = at or min(_resonance(loop, crossover), highest)
    return placed(where, 1.0 / _least(lambda factor: mild(placed(where, 1.0 / factor)), 1.0, _NARROWEST))


def _least(admits: Callable[[float], bool], low: float, high: float) -> float:
    """The least value from low to high that is admitted, of values that are from some place on; the highest if none."""
    if admits(low):
        return low
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if admits(middle) else (middle, high)
    return high


def _resonance(loop: Margins, crossover: float) -> float:
    """Hz of that peak of |L| beyond its crossover which brings the loop nearest to -1."""
    from scipy.signal import find_peaks  # not with every command

    beyond = loop.loop_gain.frequency > crossover
    f, L = loop.loop_gain.frequency[beyond], loop.loop_gain.response[beyond]
    level = 20.0 * np.log10(np.maximum(np.abs(L), 1e-30))
    peaks, _ = find_peaks(level, prominence=_RISE)
    if not peaks.size:
        return min(_BEYOND * crossover, float(loop.loop_gain.frequency[-1]))
    near = [np.min(np.abs(1.0 + L[(f > f[k] / _AROUND) & (f < f[k] * _AROUND)])) for k in peaks]
    return float(f[peaks[int(np.argmin(near))]])


@dataclasses.dataclass(frozen=True)
class Difference:
    """What leads from one control to another: filters are removed by place, others added behind, then numbers set.

    removed  places in the old pack
    added    behind those that are left
    values   below the control with the new pack: numbers that are others now
    """

    removed: tuple[int, ...]
    added: tuple[Filter, ...]
    values: Mapping[str, float]

    @property
    def nothing(self) -> bool:
        """The controls are equal."""
        return not (self.removed or self.added or self.values)


def with_filters(control: Control, removed: Sequence[int], added: Sequence[Filter]) -> Control:
    """The control without filters at some places of its pack, and with others behind.

    Raises ParameterError for a place that there is not.
    """
    for place in removed:
        if not 0 <= place < len(control.filters):
            there = ", ".join(f"filters.{i} ({filter_.kind})" for i, filter_ in enumerate(control.filters)) or "none"
            raise ParameterError(f"there is no filters.{place} to remove; the filters are: {there}")
    kept = [filter_ for i, filter_ in enumerate(control.filters) if i not in removed]
    return dataclasses.replace(control, filters=(*kept, *added))


def difference(before: Control, after: Control) -> Difference | None:
    """What leads from one control to another; None if they differ in more than filters and numbers.

    Which filters stay is that of `aligned`.
    """
    kept = aligned(before.filters, after.filters)
    removed = tuple(i for i in range(len(before.filters)) if i not in kept)
    added = after.filters[len(kept) :]
    begun = with_filters(before, removed, added)
    if tree.structure(begun) != tree.structure(after) or not _same_tables(begun, after):
        return None
    old = dict(tree.leaves(begun))
    return Difference(removed, added, {name: value for name, value in tree.leaves(after) if value != old[name]})


def _same_tables(one: Any, other: Any) -> bool:
    pairs = zip(tree.tables(one), tree.tables(other), strict=True)
    return all(np.array_equal(a, b) for (_, a), (_, b) in pairs)


def aligned(before: Sequence[Block], after: Sequence[Block]) -> tuple[int, ...]:
    """Places of the old blocks that stay, in order, and become the first of the new ones: as many as possible, of
    several ways that with the fewest other numbers.
    """
    ways = (_kept(before, after[:count]) for count in range(len(after), 0, -1))
    return next((way for way in ways if way is not None), ())


def _kept(before: Sequence[Block], after: Sequence[Block]) -> tuple[int, ...] | None:
    """Places of the old blocks that become all the new ones, in their order; None if they do not go."""
    best: dict[int, tuple[int, tuple[int, ...]]] = {0: (0, ())}  # numbers that differ and places, by how many are done
    for i, old in enumerate(before):
        for done in sorted(best, reverse=True):
            if done < len(after) and tree.structure(old) == tree.structure(after[done]):
                cost = best[done][0] + sum(
                    a != b for (_, a), (_, b) in zip(tree.leaves(old), tree.leaves(after[done]), strict=True)
                )
                if done + 1 not in best or cost < best[done + 1][0]:
                    best[done + 1] = cost, (*best[done][1], i)
    return best[len(after)][1] if len(after) in best else None
