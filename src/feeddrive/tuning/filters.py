"""Manual filter design.

The module computes start values for a filter in a loop, its frequency response, its drag handles in a plot, and the
difference between two lists of filters.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from feeddrive.analysis.margins import Margins
from feeddrive.blocks.catalogue import find, members
from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.language import tree
from feeddrive.language.block import Block, declarations
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity, Units, number
from feeddrive.language.recent import Recent
from feeddrive.language.text import Text
from feeddrive.language.units import rounded
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop

B = TypeVar("B", bound=Block)
# The filters are warped by tan(π f T), which grows without bound at half the sample rate.
HIGHEST_FILTER = 0.45  # of the sample rate: upper limit of filter frequencies that are chosen or searched
_OPEN = 0.4  # of the sample rate: frequency of a low-pass that is added before a search
HIGHEST = 0.49  # of the sample rate: upper limit of a dragged frequency
_RISE = 3.0  # dB by which a resonance must rise above the loop gain below it
_AROUND = 1.1  # half width of a resonance, as a factor of its frequency
_BEYOND = 3.0  # multiple of the crossover at which a filter starts if there is no resonance
_COSTS = 10.0  # largest phase lag in degrees of a new filter at the crossover
_PASSES = 0.5  # gain near half the sample rate below which a filter is a low-pass
_MOST_NARROWED = 10.0  # largest factor by which a filter is narrowed from its default
_HALVINGS = 20


def filter_kinds() -> tuple[str, ...]:
    """Return all kinds of filters, including user-defined ones."""
    return tuple(members(Filter))  # type: ignore[type-abstract]


def written_filter(block: Filter) -> str:
    """Return a filter in command-line syntax: notch:frequency=164.0,damping_zero=0.05,damping_pole=0.5."""
    return f"{block.kind}:{','.join(f'{name}={value!r}' for name, value in tree.leaves(block))}"


def filter_text(block: Filter, units: Units) -> str:
    """Return the kind of a filter with its frequencies, in the given display units: `notch 456 Hz`."""
    values = (getattr(block, name) for name in _frequencies(block))
    frequencies = ", ".join(units.value_text(float(value), "Hz") for value in values)
    return f"{block.kind.replace('_', ' ')} {frequencies}".strip()


def read_filter(text: str) -> Filter:
    """Parse a filter in the syntax of `written_filter`, in SI; omitted fields take their defaults.

    Raises ParameterError for an unknown kind or field, a missing field, a value that is not a number, and a value out
    of bounds.
    """
    return read_block(Filter, text)  # type: ignore[type-abstract]


def read_block(family: type[B], text: str) -> B:
    """Parse a block of a family in command-line syntax, with values in SI: cascade_ppi:Kv=38,Kp=9e4.

    Raises ParameterError for an unknown kind or field, a missing field, a value that is not a number, and a value out
    of bounds.
    """
    kind, _, rest = text.partition(":")
    block_type: type[Any] = find(family, kind.strip())
    fields = [name for name, declared in declarations(block_type).items() if declared.role == "parameter"]
    values = dict[str, float]()
    for pair in filter(None, (part.strip() for part in rest.split(","))):
        name, equals, value = (part.strip() for part in pair.partition("="))
        if not equals:
            raise ParameterError(f"'{pair}' of '{text}': write it as NAME=VALUE, as notch:frequency=164")
        if name not in fields:
            raise ParameterError(f"{block_type.kind} has no number '{name}'{nearest(name, fields)}")
        try:
            values[name] = float(value)
        except ValueError:
            raise ParameterError(f"{block_type.kind}.{name} = '{value}' is no number") from None
    missing = [
        field.name
        for field in dataclasses.fields(block_type)  # type: ignore[arg-type]
        if field.name in fields and field.name not in values and field.default is dataclasses.MISSING
    ]
    if missing:
        units = ", ".join(f"{name} in {declarations(block_type)[name].unit or '1'}" for name in missing)
        raise ParameterError(f"'{text}' needs {units}: write {kind}:{missing[0]}=VALUE")
    return block_type(**values)


def filter_response(block: Filter, frequency: np.ndarray, sample_time: float) -> np.ndarray:
    """Return the complex gain of a filter on lines in Hz, obtained by linearizing one step of its code.

    The gain is H = c (z - A)⁻¹ b + d with z = e^(j2πfT).
    """
    prepared = block.prepare(sample_time)
    rest = block.start(prepared, 0.0)
    count = sum(1 for _ in tree.leaves(rest))

    def stepped(state: np.ndarray, value: float) -> list[float]:
        after, output = block.step(prepared, tree.rebuild(rest, iter(state)), value)
        return [*(float(number) for _, number in tree.leaves(after)), float(output)]

    # a filter is linear: its step at unit states and at a unit input gives the columns of its matrices
    rows = [stepped(row, 0.0) for row in np.eye(count)] + [stepped(np.zeros(count), 1.0)]
    whole = np.array(rows).T  # [A b; c d]
    z = np.exp(2j * np.pi * np.asarray(frequency) * sample_time)
    inverse = z[:, None, None] * np.eye(count) - whole[:count, :count]
    states = np.linalg.solve(inverse, np.broadcast_to(whole[:count, count:], (z.size, count, 1)))
    return (whole[count:, :count] @ states)[:, 0, 0] + whole[count, count]


def begun_filter(kind: str, loop: Margins, sample_time: float, at: float | None = None) -> Filter:
    """Return a filter with start values for a loop gain, at frequency `at` (Hz) or where it is probably needed.

    A filter that passes high frequencies starts at a resonance beyond the crossover: of the resonances that rise at
    least 3 dB above the loop gain around them, the one that comes closest to -1. Without such a resonance it starts at
    three times the crossover. If its phase lag at the crossover exceeds 10°, it starts narrower: all its damping ratios
    are reduced by a common factor. A low-pass starts at the lowest frequency at which its phase lag is at most 10°. No
    filter starts above 0.45 times the sample rate.

    Raises ParameterError for a filter with a parameter that has no default and is not a frequency.
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
        dampings = {name: rounded(narrow * value, 4) for name, value in ratios.items()}
        return filter_type(**dict.fromkeys(names, rounded(frequency, 4)), **dampings)

    def mild(block: Filter) -> bool:
        return abs(np.degrees(np.angle(filter_response(block, np.array([crossover]), sample_time)[0]))) <= _COSTS

    # at a tenth of the range, since a filter placed near half the sample rate has no frequencies above it
    through = abs(filter_response(placed(0.1 * highest), np.array([highest]), sample_time)[0])
    if through < _PASSES:
        low = min(crossover, highest)
        return placed(at or _least(lambda frequency: mild(placed(frequency)), low, highest))
    where = at or min(_resonance(loop, crossover), highest)
    return placed(where, 1.0 / _least(lambda factor: mild(placed(where, 1.0 / factor)), 1.0, _MOST_NARROWED))


def _least(admits: Callable[[float], bool], low: float, high: float) -> float:
    """Return the smallest admissible value between low and high, or high if none is admissible.

    If a value is admissible, all larger ones must be admissible too.
    """
    if admits(low):
        return low
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if admits(middle) else (middle, high)
    return high


def _resonance(loop: Margins, crossover: float) -> float:
    """Return the frequency, Hz, of the peak of |L| beyond the crossover at which L comes closest to -1."""
    # imported here: slow to load and not needed by every command
    from scipy.signal import find_peaks

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
    """The edits from one controller to another: filters removed by index, others appended, then parameters set.

    removed  indices in the old filter list
    added    filters appended to the remaining ones
    values   changed parameters, by dotted name within the controller with the new filter list
    """

    removed: tuple[int, ...]
    added: tuple[Filter, ...]
    values: Mapping[str, float]

    @property
    def is_empty(self) -> bool:
        """True if the two controllers are identical."""
        return not (self.removed or self.added or self.values)


def with_filters(control: Control, removed: Sequence[int], added: Sequence[Filter]) -> Control:
    """Return the controller without the filters at some indices of its list, and with others appended.

    Raises ParameterError for an index that does not exist.
    """
    for place in removed:
        if not 0 <= place < len(control.filters):
            there = ", ".join(f"filters.{i} ({filter_.kind})" for i, filter_ in enumerate(control.filters)) or "none"
            raise ParameterError(f"there is no filters.{place} to remove; the filters are: {there}")
    kept = [filter_ for i, filter_ in enumerate(control.filters) if i not in removed]
    return dataclasses.replace(control, filters=(*kept, *added))


def with_notch_and_low_pass(loop: Loop) -> Loop:
    """Return a loop whose control has at least a notch and a low-pass, those added nearly without effect.

    The notch is at the lowest resonance of the axis, if it has one.  A search that tunes the filters can then use both
    with every law.
    """
    T, filters = float(loop.sample_time), list(loop.control.filters)
    if not any(isinstance(block, Notch) for block in filters):
        resonances = np.abs(linearize(loop, ["cut"], ["reading_load"]).oscillations()) / (2.0 * np.pi)
        if resonances.size and np.min(resonances) < HIGHEST_FILTER / T:
            filters.append(Notch(frequency=float(np.min(resonances)), damping_zero=0.35, damping_pole=0.4))
    if not any(isinstance(block, LowPass | LowPass2) for block in filters):
        filters.append(LowPass2(frequency=_OPEN / T, damping=0.7))
    return replace(loop, control=replace(loop.control, filters=tuple(filters)))


def difference(before: Control, after: Control) -> Difference | None:
    """Return the edits from one controller to another; None if they differ in more than filters and parameters.

    `aligned` determines the filters that are kept.
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
    """Return the indices of the old blocks to keep; in this order they become the first new blocks.

    As many blocks as possible are kept, with as few changed parameters as possible.
    """
    ways = (_kept(before, after[:count]) for count in range(len(after), 0, -1))
    return next((way for way in ways if way is not None), ())


def _kept(before: Sequence[Block], after: Sequence[Block]) -> tuple[int, ...] | None:
    """Match every new block to an old one of the same type, in order; return the old indices, or None if impossible."""
    best: dict[int, tuple[int, tuple[int, ...]]] = {0: (0, ())}  # cost and indices, by count of matched blocks
    for i, old in enumerate(before):
        # downwards, so that each old block is matched at most once
        for done in sorted(best, reverse=True):
            if done < len(after) and tree.structure(old) == tree.structure(after[done]):
                cost = best[done][0] + sum(
                    a != b for (_, a), (_, b) in zip(tree.leaves(old), tree.leaves(after[done]), strict=True)
                )
                if done + 1 not in best or cost < best[done + 1][0]:
                    best[done + 1] = cost, (*best[done][1], i)
    return best[len(after)][1] if len(after) in best else None


OFF = "off"  # off.0, off.1: filters that are not in the loop
DEPTH, WIDTH = "depth", "width"
DEEPEST = 60.0  # dB: the largest depth that a notch is given by its depth
_NO_GAIN = 120.0  # dB: a deeper notch, such as one with damping_zero = 0, is said to be as deep as this
_SHAPE_DIGITS = 7  # of dampings that follow from a depth or a width, so that it reads as it was written
_LEAST_DAMPING, _MOST_DAMPING = 1e-3, 10.0  # range of a dragged damping ratio
_NARROWEST, _WIDEST = 0.005, 1.5  # range of the damping ratio of a notch's poles
_LOWEST_DRAWN = -60.0  # dB: nothing is drawn below it
_ACROSS, _UP = 1.02, 0.5  # step of an arrow key: a factor of the frequency, and dB


class _Height(NamedTuple):
    """The damping ratio that sets the gain of a filter at a characteristic frequency.

    rising  True if the gain is proportional to the damping ratio, False if it is inversely proportional
    """

    damping: str
    rising: bool


_HEIGHTS: Mapping[tuple[type[Filter], str], _Height] = {
    (Notch, "frequency"): _Height("damping_zero", True),  # H = ζn/ζd
    (LowPass2, "frequency"): _Height("damping", False),  # |H| = 1/(2 damping)
    (SecondOrder, "frequency_zero"): _Height("damping_zero", True),  # numerator 2 damping_zero
    (SecondOrder, "frequency_pole"): _Height("damping_pole", False),  # denominator 2 damping_pole
}


@dataclass(frozen=True)
class Grip:
    """A drag handle of a filter on the open-loop gain.

    name   filters.0.frequency, or filters.0.width for the edge of a notch
    x, y   frequency (Hz) and |L| (dB) at the handle; for a width, |L| at the center of the notch
    low, high  range of x, Hz
    label  the parameter that the handle changes
    text   the value of this parameter in words
    """

    name: str
    x: float
    y: float
    low: float
    high: float
    label: str
    text: str


def notch_shapes(control: Control) -> dict[str, float]:
    """Return depth (dB) and width (Hz) of each notch, by names such as filters.0.depth and filters.0.width.

    The depth is the attenuation at the center, ζd/ζn. The width is 2 ζd f, with its frequency f: the distance of the
    edges at which a deep notch attenuates by 3 dB.
    """
    shapes = dict[str, float]()
    for i, block in enumerate(control.filters):
        if isinstance(block, Notch):
            zero, pole = float(block.damping_zero), float(block.damping_pole)
            depth = -_decibel(complex(max(zero / pole, 10.0 ** (-_NO_GAIN / 20.0))))
            shapes[f"filters.{i}.{DEPTH}"] = rounded(depth, 5) + 0.0  # no -0
            shapes[f"filters.{i}.{WIDTH}"] = rounded(2.0 * pole * float(block.frequency), 5)
    return shapes


def notch_shaped(control: Control, name: str, value: float) -> dict[str, float]:
    """Return both dampings of a notch with another depth (dB) or width (Hz), as named by `notch_shapes`.

    A depth is kept between 0 and 60 dB with the width as it is; a width is kept in the range of a dragged one, with the
    depth as it is. Raises ParameterError for an unknown name.
    """
    if name not in (shapes := notch_shapes(control)):
        raise ParameterError(f"the control has no number '{name:.60}'{nearest(name, list(shapes))}")
    held, _, part = name.rpartition(".")
    block = control.filters[int(held.split(".")[1])]
    assert isinstance(block, Notch)
    if part == WIDTH:
        return _of_width(block, held, value / (2.0 * float(block.frequency)), _SHAPE_DIGITS)
    depth = min(max(value, 0.0), DEEPEST)
    zero = float(block.damping_pole) * 10.0 ** (-depth / 20.0)
    return {f"{held}.damping_zero": rounded(zero, _SHAPE_DIGITS)}


def width_range(frequency: float) -> tuple[float, float]:
    """Return the range of the width of a notch at a frequency, both in Hz."""
    return 2.0 * _NARROWEST * frequency, 2.0 * _WIDEST * frequency


def filter_grips(control: Control, loop: Margins, sample_time: float, off: Sequence[Filter] = ()) -> tuple[Grip, ...]:
    """Return the drag handles of all filters on a loop gain.

    Each filter frequency has a handle. A notch has another one at its upper edge, f (ζ + √(1 + ζ²)) with its
    damping_pole ζ, where a deep notch attenuates by 3 dB. The handles of filters that are off, off.0.frequency, stand
    where the loop gain would go through if the filter were on.
    """
    grips = list[Grip]()
    for i, block in enumerate(control.filters):
        grips += _grips_of(block, f"filters.{i}", f"filter {i}", loop, sample_time)
    for i, block in enumerate(off):
        grips += _grips_of(block, f"{OFF}.{i}", f"filter {i} of those off", loop, sample_time)
    return tuple(grips)


def _grips_of(block: Filter, held: str, said: str, loop: Margins, sample_time: float) -> list[Grip]:
    grips, ends = list[Grip](), (float(loop.loop_gain.frequency[0]), HIGHEST_FILTER / sample_time)
    kind = block.kind.replace("_", " ")
    for name in _frequencies(block):
        x, height = float(getattr(block, name)), _HEIGHTS.get((type(block), name))
        which = name.removeprefix("frequency").replace("_", " ")
        label = f"{said}, {kind}{which}: frequency" + (
            "" if height is None else " and depth" if isinstance(block, Notch) else " and damping"
        )
        filter_gain = _decibel(_gain(block, x, sample_time))
        text = Text(f"{Quantity(x, 'Hz')}, gain {Quantity(filter_gain, 'dB'):.1f} there")
        y = max(_height(block, held, x, loop, sample_time), _LOWEST_DRAWN)
        grips.append(Grip(f"{held}.{name}", x, y, *ends, label, text))
    if isinstance(block, Notch):
        ratio, f = float(block.damping_pole), float(block.frequency)
        edge = _edge(block, sample_time)
        text = Text(f"{Quantity(2.0 * ratio * f, 'Hz')} wide, damping of the poles {number(ratio, 3)}")
        y = max(_height(block, held, f, loop, sample_time), _LOWEST_DRAWN)
        grips.append(Grip(f"{held}.{WIDTH}", edge, y, *ends, f"{said}, {kind}: width", text))
    return grips


def _height(block: Filter, held: str, frequency: float, loop: Margins, sample_time: float) -> float:
    """Return |L| in dB at a frequency in Hz, with a filter that is off as if it were on."""
    level = _on(loop, frequency)
    return level + _decibel(_gain(block, frequency, sample_time)) if held.startswith(f"{OFF}.") else level


def filter_dragged(
    control: Control,
    name: str,
    x: float,
    y: float | None,
    loop: Margins,
    sample_time: float,
    off: Sequence[Filter] = (),
) -> dict[str, float]:
    """Return the parameters of a filter after its handle is dragged to x (frequency in Hz) and y (|L| in dB).

    `loop` holds the margins of the loop with this controller. With the returned parameters, |L| at the handle is y, as
    far as the range of the damping ratio allows: a notch attenuates by 0 to 60 dB. If y is None, the damping ratio is
    unchanged. Dragging the width of a notch changes both of its damping ratios, but not its depth.
    The parameters of a filter of those that are `off` have names as off.0.frequency.
    Raises ParameterError for an unknown handle.
    """
    held, part, block = _held(control, name, off)
    low, high = float(loop.loop_gain.frequency[0]), HIGHEST_FILTER / sample_time
    at = min(max(x, low), high)
    if part == WIDTH:
        return _widened(block, held, at)
    moved = replace(block, **{part: rounded(at, 4)})
    values = {f"{held}.{part}": float(getattr(moved, part))}
    height = _HEIGHTS.get((type(block), part))
    if height is None or y is None:
        return values
    place = float(getattr(moved, part))
    # a damping ratio of 0 has no factor that raises it
    now = max(float(getattr(block, height.damping)), _LEAST_DAMPING)
    shown = replace(moved, **{height.damping: now})
    before, after = (_decibel(_gain(version, place, sample_time)) for version in (block, shown))
    there = _height(block, held, place, loop, sample_time)
    change = 10.0 ** ((y - (there - before + after)) / 20.0)
    wanted = now * change if height.rising else now / change
    # above damping_pole a notch would amplify
    most = float(block.damping_pole) if isinstance(block, Notch) else _MOST_DAMPING
    least = _LEAST_DAMPING * most if isinstance(block, Notch) else _LEAST_DAMPING
    values[f"{held}.{height.damping}"] = rounded(min(max(wanted, least), most), 4)
    return values


def filter_stepped(
    control: Control,
    name: str,
    across: float,
    up: float,
    loop: Margins,
    sample_time: float,
    off: Sequence[Filter] = (),
) -> dict[str, float]:
    """Return the parameters of a filter after its handle is moved with the arrow keys.

    across  number of steps of 2 % in frequency or width
    up      number of steps of 0.5 dB in |L|; for a width, of 2 % too
    """
    held, part, block = _held(control, name, off)
    if part == WIDTH:
        ratio = float(block.damping_pole) * _ACROSS ** (across + up)  # type: ignore[attr-defined]
        return _of_width(block, held, ratio)
    x = float(getattr(block, part)) * _ACROSS**across
    y = _height(block, held, float(getattr(block, part)), loop, sample_time) + _UP * up if up else None
    return filter_dragged(control, name, x, y, loop, sample_time, off)


def _held(control: Control, name: str, off: Sequence[Filter]) -> tuple[str, str, Filter]:
    """Return the name of the filter of a handle, such as filters.0, the part that it moves, and the filter."""
    filters = {f"filters.{i}": block for i, block in enumerate(control.filters)}
    filters |= {f"{OFF}.{i}": block for i, block in enumerate(off)}
    handles = {
        f"{held}.{part}": (held, part, block)
        for held, block in filters.items()
        for part in (*_frequencies(block), *((WIDTH,) if isinstance(block, Notch) else ()))
    }
    if name not in handles:
        raise ParameterError(f"there is no filter grip '{name:.60}'{nearest(name, list(handles))}")
    return handles[name]


def _frequencies(block: Filter) -> list[str]:
    return [
        name
        for name, declared in declarations(type(block)).items()
        if declared.role == "parameter" and declared.unit == "Hz" and getattr(block, name) is not None
    ]


def _edge(block: Notch, sample_time: float) -> float:
    """Return the upper edge of a notch, Hz, or the lower edge if the upper one is too close to half the sample rate."""
    f, ratio = float(block.frequency), float(block.damping_pole)
    apart = ratio + float(np.sqrt(1.0 + ratio * ratio))
    return f * apart if f * apart <= HIGHEST_FILTER / sample_time else f / apart


def _widened(block: Filter, held: str, edge: float) -> dict[str, float]:
    f = float(block.frequency)  # type: ignore[attr-defined]
    # inverse of edge/f = ζ + √(1 + ζ²); the lower edge f/(ζ + √(1 + ζ²)) gives the same ζ
    return _of_width(block, held, 0.5 * abs(edge / f - f / edge))


def _of_width(block: Filter, held: str, ratio: float, digits: int = 4) -> dict[str, float]:
    """Return both damping ratios of a notch if that of its poles changes to `ratio` and the depth is kept."""
    assert isinstance(block, Notch)
    wanted = rounded(min(max(ratio, _NARROWEST), _WIDEST), digits)
    depth = float(block.damping_zero) / float(block.damping_pole)
    return {f"{held}.damping_pole": wanted, f"{held}.damping_zero": rounded(depth * wanted, digits)}


def _on(loop: Margins, frequency: float) -> float:
    """Return |L| in dB at a frequency in Hz."""
    f, L = loop.loop_gain.frequency, loop.loop_gain.response
    k = min(max(int(np.searchsorted(f, frequency)), 1), f.size - 1)
    x, low, high = np.log(np.array([frequency, f[k - 1], f[k]]))
    share = min(max(float((x - low) / (high - low)), 0.0), 1.0)
    return (1.0 - share) * _decibel(L[k - 1]) + share * _decibel(L[k])


_gains: Recent[complex] = Recent(256)


def _gain(block: Filter, frequency: float, sample_time: float) -> complex:
    """Return the complex gain of a filter at a frequency in Hz.

    Results are cached, since only one of many filters changes at a time.
    """
    key = tree.structure(block), tuple(value for _, value in tree.leaves(block)), frequency, sample_time
    return _gains.get(key, lambda: complex(filter_response(block, np.array([frequency]), sample_time)[0]))


def _decibel(gain: complex) -> float:
    return 20.0 * float(np.log10(max(abs(gain), 1e-30)))
