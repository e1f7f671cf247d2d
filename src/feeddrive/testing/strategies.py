"""Hypothesis strategies that draw any block, with any values that its declarations allow.

Each strategy is built once, since Hypothesis takes longer to analyze a new strategy than to draw from it.
"""

import dataclasses
import math
import re
import types
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from feeddrive.blocks.catalogue import catalogue
from feeddrive.language import tree
from feeddrive.language.block import Block, Declaration, declarations
from feeddrive.language.errors import FeeddriveError

# Magnitudes that occur in feed drives, by unit; the declared bounds cut them.
_USUAL: dict[str, tuple[float, float]] = {
    "kg": (1.0, 1e3),
    "kg m2": (1e-5, 1e-2),
    "N/m": (1e5, 1e9),
    "N s/m": (1.0, 1e5),
    "N m s/rad": (1e-6, 1e-2),
    "N m/A": (0.1, 10.0),
    "N": (1.0, 1e3),
    "m": (1e-6, 1.0),
    "m/s": (1e-4, 1.0),
    "Hz": (1.0, 2e3),
    "s": (1e-4, 1.0),
    "rad": (1e-3, 7.0),
    "rad/s": (1.0, 2e3),
    "rpm": (100.0, 6e3),
    "N/m2": (1e7, 5e9),
    "J/m3": (1e8, 1e10),
    "": (1e-2, 2.0),
}
_TRIES = 40
_SAMPLE = 2e-4  # s: the longest sample time of the exercises, at which variants of one block must be valid
_EITHER, _SELDOM = st.booleans(), st.integers(0, 3)
# not down to 5e-324: so small a share of a range is no magnitude of a drive
_SHARES = st.floats(0.0, 1.0).map(lambda share: share if share > 1e-6 else 0.0)
_GOLDEN = 0.6180339887498949  # turns of a share by it fill the range evenly
_NAME = re.compile(r"[A-Za-z_]\w*")
# optional fields often belong together: independent draws would seldom give all of a group, or none
_PRESENT = ("none", "all", "some", "some")
_Draw = Callable[[st.DrawFn, int], Any]  # a value of a field; the whole number turns its choices, attempt by attempt


@cache
def blocks_of(cls: type[Block], sample_time: float | None = None) -> st.SearchStrategy[Any]:
    """Return a strategy for valid blocks of a concrete class, with any choices, parts and optional fields.

    If a sample time in s is given, the blocks also satisfy the rules that depend on the sample time.
    """
    return _blocks(cls, sample_time)


@st.composite
def _blocks(draw: st.DrawFn, cls: type[Block], sample_time: float | None) -> Any:
    """Draw fields within their bounds; if the block rejects them, draw the fields named in its error again.

    At every fourth attempt all fields are drawn again, since the error may be caused by a field that it does not name.
    Each attempt shifts the drawn values, since Hypothesis may draw the same values again and again.
    """
    fields = _fields(cls)
    values = _drawn(draw, cls, fields, 0)
    # tables of one block mostly share their length, which independent draws would seldom hit
    if draw(_EITHER):
        values = _cut(values, values)
    for attempt in range(1, _TRIES + 1):
        try:
            with np.errstate(all="ignore"):
                block = cls(**values)
        except FeeddriveError as refusal:
            named = fields.keys() & _NAME.findall(str(refusal))
            cut = _cut(values, named)
            if any(cut[name] is not values[name] for name in named):
                values = cut
                continue
        else:
            if _runs_at(block, sample_time):
                return block
            named = frozenset[str]()
        again = fields.keys() if not named or attempt % 4 == 0 else named
        values |= _drawn(draw, cls, again, attempt)
    return reject()


def _runs_at(block: Block, sample_time: float | None) -> bool:
    """Return True if a block satisfies its rules at this sample time.

    It does not raise an error for a violated rule, because the remedy given in the message is expensive to compute.
    """
    if sample_time is None:
        return True
    plain = tree.rebuild(block, (np.float64(value) for _, value in tree.leaves(block)))
    with np.errstate(all="ignore"):
        return all(rule.holds for rule in tree.sampled_rules(plain, np.float64(sample_time)))


def _drawn(draw: st.DrawFn, cls: type[Block], names: Container[str], attempt: int) -> dict[str, Any]:
    """Draw the named fields of a block: none, some or all of the optional fields, occasionally with defaults."""
    present = _PRESENT[(draw(st.integers(0, len(_PRESENT) - 1)) + attempt) % len(_PRESENT)]
    drawn: dict[str, Any] = {}
    for place, (name, (default, value)) in enumerate(_fields(cls).items()):
        if name not in names:
            continue
        if default is None:
            absent = present == "none" or (present == "some" and draw(_EITHER) == bool(attempt >> place & 1))
            drawn[name] = None if absent else value(draw, attempt * (place + 1))
        else:
            usual = default is not dataclasses.MISSING and (attempt % 2 == 1 or draw(_SELDOM) == 3)
            drawn[name] = default if usual else value(draw, attempt * (place + 1))
    return drawn


def _cut(values: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """Truncate the tables among the named fields to equal length; tables named in one error belong together."""
    rows = {name: values[name] for name in names if isinstance(values[name], np.ndarray)}
    length = min((row.size for row in rows.values()), default=0)
    return {**values, **{name: row[:length] for name, row in rows.items() if row.size > length}}


@cache
def _fields(cls: type[Block]) -> dict[str, tuple[Any, _Draw]]:
    """Return the default of each field and the function that draws its value."""
    hints = get_type_hints(cls)
    defaults = {spec.name: spec.default for spec in dataclasses.fields(cls)}  # type: ignore[arg-type]
    return {
        name: (defaults[name], _field(declared, hints[name], defaults[name] is dataclasses.MISSING))
        for name, declared in declarations(cls).items()
    }


def _field(declared: Declaration, hint: Any, needed: bool) -> _Draw:
    match declared.role:
        case "parameter":
            return _number(declared)
        case "choice":
            return _choices(declared, hint, needed)
        case "table":
            return _always(_rows(declared))
        case "label":
            return _always(st.just("y"))
        case _:
            return _alike(hint) if declared.alike else _parts(hint)


def _always(strategy: st.SearchStrategy[Any]) -> _Draw:
    return lambda draw, _: draw(strategy)


def _one_of(options: Sequence[Any]) -> _Draw:
    places = st.integers(0, len(options) - 1)
    return lambda draw, turn: options[(draw(places) + turn) % len(options)]


@st.composite
def variants_of(draw: st.DrawFn, block: Block, sample_time: float) -> Any:
    """Draw a copy of a block with new values for some leaves, which may differ between variants and change live."""
    values = dict(tree.leaves(block))
    names = [name for name in values if draw(_EITHER)] or list(values)
    values |= {name: draw(numbers(tree.declaration(block, name))) for name in names}
    for _ in range(_TRIES):
        varied = tree.rebuild(block, iter(values.values()))
        try:
            with np.errstate(all="ignore"):
                for part in tree.blocks(varied):
                    part.require()
        except FeeddriveError as refusal:
            words = set(_NAME.findall(str(refusal)))
            named = [name for name in names if name.rpartition(".")[2] in words]
        else:
            if _runs_at(varied, sample_time):
                return varied
            named = names
        values |= {name: draw(numbers(tree.declaration(block, name))) for name in named or names}
    return reject()


@cache
def numbers(declared: Declaration) -> st.SearchStrategy[float]:
    """Return a strategy for numbers of usual magnitude within the declared bounds, sometimes an inclusive bound."""
    value = _number(declared)
    return st.composite(lambda draw: value(draw, 0))()


@cache
def _number(declared: Declaration) -> _Draw:
    low, high = _USUAL.get(declared.unit, (1e-3, 1e3))
    least = declared.above if declared.least is None else declared.least
    most = declared.below if declared.most is None else declared.most
    first, last = max(low, least or 0.0), high if most is None else min(high, most)
    signed = least is None and most is None

    def at(share: float) -> float:
        """Return the number at a fraction of the range, on a logarithmic scale if possible."""
        if signed:
            sign, share = (1.0, share / 0.75) if share < 0.75 else (-1.0, 4.0 * share - 3.0)
            return sign * low * (high / low) ** share
        if least is not None and least >= 0.0 and first < last:
            return first * (last / first) ** share
        bottom = min(-high, (most or 0.0) - high) if least is None else least
        top = max(high, 2.0 * bottom) if most is None else most
        return bottom + share * (top - bottom)

    ends = [float(bound) for bound in (declared.least, declared.most) if bound is not None]

    def value(draw: st.DrawFn, turn: int) -> float:
        """Return a number at a random fraction of the range, or an inclusive bound."""
        if ends and draw(_EITHER):
            return ends[(draw(_EITHER) + turn) % len(ends)]
        drawn = at((draw(_SHARES) + turn * _GOLDEN) % 1.0)
        # an end of the range may be an open bound
        return drawn if declared.admits(drawn) else at(0.5)

    return value


def _choices(declared: Declaration, hint: Any, needed: bool) -> _Draw:
    if declared.options:
        return _one_of(declared.options)
    if get_origin(hint) is tuple and str in get_args(hint):  # names of axes
        return _always(st.lists(st.sampled_from("xyz"), min_size=2, max_size=3, unique=True).map(tuple))
    if hint is str or str in get_args(hint):  # the name of an axis
        return _one_of("xyz")
    if hint is bool:
        return _one_of((False, True))
    least = 0 if declared.least is None else int(declared.least)
    most = math.inf if declared.most is None else int(declared.most)
    # more states or samples only take longer to compile
    counts = st.integers(least, int(min(least + 3, most)))
    return lambda draw, turn: min(draw(counts) + (turn % 8 if needed else 0), most)


def _rows(declared: Declaration) -> st.SearchStrategy[np.ndarray]:
    entries = numbers(declared) if declared.bounds() else st.one_of(numbers(declared), st.just(0.0))
    if declared.unit == "s":  # times follow each other
        return st.lists(entries, min_size=2, max_size=5, unique=True).map(sorted).map(np.array)
    return st.lists(entries, min_size=2, max_size=5).map(np.array)


def _alike(hint: Any) -> _Draw:
    """Return a function that draws a tuple of two to four blocks that differ in numbers only."""
    (kind, *_), counts = get_args(hint), st.integers(2, 4)

    def value(draw: st.DrawFn, turn: int) -> tuple[Any, ...]:
        first = draw(blocks_of(kind, _SAMPLE))
        return (first, *(draw(variants_of(first, _SAMPLE)) for _ in range(draw(counts) - 1)))

    return value


def _parts(hint: Any) -> _Draw:
    """Return a function that draws a part: a block of a permitted class or family, or a tuple of such blocks."""
    if get_origin(hint) is tuple:
        part, counts = _parts(get_args(hint)[0]), st.integers(0, 3)
        return lambda draw, turn: tuple(part(draw, turn) for _ in range(draw(counts) or min(turn, 1)))
    kinds = _one_of([kind for named in part_types(hint) for kind in catalogue().get(named, {"": named}).values()])
    return lambda draw, turn: draw(blocks_of(kinds(draw, turn)))


def part_types(hint: Any) -> list[type[Block]]:
    """Return the block classes and families in the type hint of a part: `Motor | None`, `tuple[Mode, ...]`."""
    if get_origin(hint) in (Union, types.UnionType, tuple):
        return [part for option in get_args(hint) for part in part_types(option)]
    return [hint] if isinstance(hint, type) and issubclass(hint, Block) else []
