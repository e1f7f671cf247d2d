"""Hypothesis strategies: any block with any values that its declarations admit.

Each is made once: what hypothesis finds out about a new strategy takes longer than to draw from it.
"""

from __future__ import annotations

import types
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from feeddrive.blocks.catalogue import catalogue
from feeddrive.language import tree
from feeddrive.language.block import Block, declarations, may_be_absent
from feeddrive.language.declaration import Declaration
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
_TRIES = 20
_EITHER = st.booleans()


@cache
def blocks_of(cls: type[Block]) -> st.SearchStrategy[Any]:
    """A valid block of a concrete class: any choices, any parts, absent parameters absent or not."""
    return _blocks(cls)


@st.composite
def _blocks(draw: st.DrawFn, cls: type[Block]) -> Any:
    values = _fields(cls)
    for _ in range(_TRIES):
        given = {
            name: None if may_be_absent(cls, name) and draw(_EITHER) else draw(value) for name, value in values.items()
        }
        rows = {name: value for name, value in given.items() if isinstance(value, np.ndarray)}
        length = min((row.size for row in rows.values()), default=0)
        given |= {name: row[:length] for name, row in rows.items()}  # the rows of a block belong together
        try:
            return cls(**given)
        except FeeddriveError:
            continue
    return reject()


@cache
def _fields(cls: type[Block]) -> dict[str, st.SearchStrategy[Any]]:
    """What each field may be, but for absent ones."""
    hints = get_type_hints(cls)
    return {name: _field(declared, hints[name]) for name, declared in declarations(cls).items()}


def _field(declared: Declaration, hint: Any) -> st.SearchStrategy[Any]:
    match declared.role:
        case "parameter":
            return numbers(declared)
        case "choice":
            return _choices(declared, hint)
        case "table":
            return _rows(declared)
        case "label":
            return st.just("y")
        case _:
            return _parts(hint)


@st.composite
def variants_of(draw: st.DrawFn, block: Block) -> Any:
    """The same block with other numbers: what may differ between the lanes of a batch."""
    for _ in range(_TRIES):
        values = (draw(numbers(tree.declaration(block, name))) for name, _ in tree.leaves(block))
        varied = tree.rebuild(block, values)
        try:
            for part in tree.blocks(varied):
                part.check()
        except FeeddriveError:
            continue
        return varied
    return reject()


@cache
def numbers(declared: Declaration) -> st.SearchStrategy[float]:
    """A usual magnitude within the declared bounds, with the closed bounds themselves now and then."""
    low, high = _USUAL.get(declared.unit, (1e-3, 1e3))
    sizes = st.floats(np.log(low), np.log(high)).map(np.exp).map(float)
    signed = st.builds(lambda size, sign: sign * size, sizes, st.sampled_from([1.0, 1.0, -1.0]))
    ends = [float(bound) for bound in (declared.least, declared.most) if bound is not None]
    within = signed.filter(declared.admits) if declared.least is None and declared.above is None else sizes
    most = declared.most if declared.most is not None else declared.below
    if most is not None and low > most:
        within = st.floats(0.0, 1.0, exclude_min=True, exclude_max=True).map(lambda share: share * most)
    return st.one_of(within.filter(declared.admits), st.sampled_from(ends)) if ends else within.filter(declared.admits)


def _choices(declared: Declaration, hint: Any) -> st.SearchStrategy[Any]:
    if declared.options:
        return st.sampled_from(declared.options)
    if get_origin(hint) is tuple and str in get_args(hint):  # names of axes
        return st.lists(st.sampled_from("xyz"), min_size=2, max_size=3, unique=True).map(tuple)
    if hint is str or str in get_args(hint):  # the name of an axis
        return st.sampled_from("xyz")
    least = 0 if declared.least is None else int(declared.least)
    return st.integers(least, least + 3)


def _rows(declared: Declaration) -> st.SearchStrategy[np.ndarray]:
    high = _USUAL.get(declared.unit, (1e-3, 1e3))[1]
    each = numbers(declared) if declared.bounds() else st.floats(-high, high)
    row = st.lists(each, min_size=2, max_size=5)
    return row.map(sorted).map(np.array) if declared.unit == "s" else row.map(np.array)  # times follow each other


def _parts(hint: Any) -> st.SearchStrategy[Any]:
    """A strategy for the type of a part: a block, a family, one of several, or a tuple of them."""
    if get_origin(hint) is tuple:
        return st.lists(_parts(get_args(hint)[0]), max_size=3).map(tuple)
    concrete = [block for named in part_types(hint) for block in catalogue().get(named, {}).values()]
    return st.sampled_from(concrete).flatmap(blocks_of)


def part_types(hint: Any) -> list[type[Block]]:
    """The blocks and families that the type of a part names: `Motor | None`, `tuple[Mode, ...]`."""
    if get_origin(hint) in (Union, types.UnionType, tuple):
        return [found for option in get_args(hint) for found in part_types(option)]
    return [hint] if isinstance(hint, type) and issubclass(hint, Block) else []
