"""Where filters are held in the open loop by hand: places on |L| that are moved, and the numbers that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.margins import Margins
from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.language import tree
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.recent import Recent
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.tuning.filter_pack import filter_response
from feeddrive.tuning.tunables import HIGHEST_FILTER

WIDTH = "width"
_LEAST, _MOST = 1e-3, 10.0  # of a damping ratio that is dragged
_NARROWEST, _WIDEST = 0.005, 1.5  # of the damping ratio of a notch's poles
_LOWEST = -60.0  # dB: no place is drawn below it
_ACROSS, _UP = 1.02, 0.5  # a step of a key: a factor of the frequency, dB


class _Height(NamedTuple):
    """A damping ratio that the gain of its filter at one of its frequencies is proportional to, or its inverse."""

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
    """A place in the open loop at which a filter is held.

    name   filters.0.frequency, or filters.0.width for the edge of a notch
    x, y   Hz, and dB on |L|; of a width on |L| at the middle of the notch
    low, high  between which x may lie, Hz
    label  what it moves
    text   its value in words
    """

    name: str
    x: float
    y: float
    low: float
    high: float
    label: str
    text: str


def filter_grips(control: Control, loop: Margins, sample_time: float) -> tuple[Grip, ...]:
    """All grips of the filter pack on a loop gain: each frequency of a filter, and the upper edge of a notch.

    The edge lies where a notch that is deep attenuates by 3 dB, at f (ζ + √(1 + ζ²)) with ζ its damping_pole.
    """
    grips, ends = list[Grip](), (float(loop.loop_gain.frequency[0]), HIGHEST_FILTER / sample_time)
    for i, block in enumerate(control.filters):
        kind = block.kind.replace("_", " ")
        for name in _frequencies(block):
            x, height = float(getattr(block, name)), _HEIGHTS.get((type(block), name))
            which = name.removeprefix("frequency").replace("_", " ")
            label = f"filter {i}, {kind}{which}: frequency" + (
                "" if height is None else " and depth" if isinstance(block, Notch) else " and damping"
            )
            own = _decibel(_gain(block, x, sample_time))
            grips.append(
                Grip(
                    f"filters.{i}.{name}",
                    x,
                    _on(loop, x),
                    *ends,
                    label,
                    Text(f"{Quantity(x, 'Hz')}, gain {Quantity(own, 'dB'):.1f} there"),
                )
            )
        if isinstance(block, Notch):
            ratio, f = float(block.damping_pole), float(block.frequency)
            edge = _edge(block, sample_time)
            text = Text(f"{Quantity(2.0 * ratio * f, 'Hz')} wide, damping of the poles {ratio:.3g}")
            grips.append(Grip(f"filters.{i}.{WIDTH}", edge, _on(loop, f), *ends, f"filter {i}, {kind}: width", text))
    return tuple(grips)


def filter_dragged(
    control: Control, name: str, x: float, y: float | None, loop: Margins, sample_time: float
) -> dict[str, float]:
    """The numbers of a filter whose grip is taken to a frequency in Hz and a height on |L| in dB; None keeps the depth.

    loop is that of the control.  The loop gain at the grip is y afterwards, as far as the damping ratios go: a notch
    attenuates, from 0 to 60 dB.  The width of a notch changes both of its damping ratios, and not its depth.
    Raises ParameterError for a grip that there is not.
    """
    i, part, block = _held(control, name)
    low, high = float(loop.loop_gain.frequency[0]), HIGHEST_FILTER / sample_time
    at = min(max(x, low), high)
    if part == WIDTH:
        return _widened(block, i, at)
    moved = replace(block, **{part: _digits(at)})
    values = {f"filters.{i}.{part}": float(getattr(moved, part))}
    height = _HEIGHTS.get((type(block), part))
    if height is None or y is None:
        return values
    place = float(getattr(moved, part))
    now = max(float(getattr(block, height.damping)), _LEAST)
    shown = replace(moved, **{height.damping: now})
    before, after = (_decibel(_gain(version, place, sample_time)) for version in (block, shown))
    change = 10.0 ** ((y - (_on(loop, place, cut=False) - before + after)) / 20.0)
    wanted = now * change if height.rising else now / change
    most = float(block.damping_pole) if isinstance(block, Notch) else _MOST
    least = _LEAST * most if isinstance(block, Notch) else _LEAST
    values[f"filters.{i}.{height.damping}"] = _digits(min(max(wanted, least), most))
    return values


def filter_stepped(
    control: Control, name: str, across: float, up: float, loop: Margins, sample_time: float
) -> dict[str, float]:
    """The numbers after some steps of the keys: 2 % of the frequency or the width across, 0.5 dB upwards."""
    _, part, block = _held(control, name)
    if part == WIDTH:
        ratio = float(block.damping_pole) * _ACROSS ** (across + up)  # type: ignore[attr-defined]
        return _of_width(block, _held(control, name)[0], ratio)
    x = float(getattr(block, part)) * _ACROSS**across
    y = _on(loop, float(getattr(block, part)), cut=False) + _UP * up if up else None
    return filter_dragged(control, name, x, y, loop, sample_time)


def _held(control: Control, name: str) -> tuple[int, str, Filter]:
    known = {
        f"filters.{i}.{part}": (i, part, block)
        for i, block in enumerate(control.filters)
        for part in (*_frequencies(block), *((WIDTH,) if isinstance(block, Notch) else ()))
    }
    if name not in known:
        raise ParameterError(f"there is no place '{name:.60}' to hold a filter{nearest(name, list(known))}")
    return known[name]


def _frequencies(block: Filter) -> list[str]:
    return [
        name
        for name, declared in declarations(type(block)).items()
        if declared.role == "parameter" and declared.unit == "Hz" and getattr(block, name) is not None
    ]


def _edge(block: Notch, sample_time: float) -> float:
    """The upper edge in Hz; the lower one if that lies too near half the sample rate."""
    f, ratio = float(block.frequency), float(block.damping_pole)
    apart = ratio + float(np.sqrt(1.0 + ratio * ratio))
    return f * apart if f * apart <= HIGHEST_FILTER / sample_time else f / apart


def _widened(block: Filter, i: int, edge: float) -> dict[str, float]:
    f = float(block.frequency)  # type: ignore[attr-defined]
    return _of_width(block, i, 0.5 * abs(edge / f - f / edge))


def _of_width(block: Filter, i: int, ratio: float) -> dict[str, float]:
    """Both damping ratios of a notch whose poles get another one; the depth stays."""
    assert isinstance(block, Notch)
    wanted = _digits(min(max(ratio, _NARROWEST), _WIDEST))
    depth = float(block.damping_zero) / float(block.damping_pole)
    return {f"filters.{i}.damping_pole": wanted, f"filters.{i}.damping_zero": _digits(depth * wanted)}


def _on(loop: Margins, frequency: float, *, cut: bool = True) -> float:
    """|L| in dB at a frequency in Hz; `cut` for what is drawn."""
    f, L = loop.loop_gain.frequency, loop.loop_gain.response
    k = min(max(int(np.searchsorted(f, frequency)), 1), f.size - 1)
    x, low, high = np.log(np.array([frequency, f[k - 1], f[k]]))
    share = min(max(float((x - low) / (high - low)), 0.0), 1.0)
    level = (1.0 - share) * _decibel(L[k - 1]) + share * _decibel(L[k])
    return max(level, _LOWEST) if cut else level


_gains: Recent[complex] = Recent(256)


def _gain(block: Filter, frequency: float, sample_time: float) -> complex:
    """Of a filter at a frequency in Hz; kept, since of many filters one is moved."""
    key = tree.structure(block), tuple(value for _, value in tree.leaves(block)), frequency, sample_time
    return _gains.get(key, lambda: complex(filter_response(block, np.array([frequency]), sample_time)[0]))


def _decibel(gain: complex) -> float:
    return 20.0 * float(np.log10(max(abs(gain), 1e-30)))


def _digits(value: float) -> float:
    return float(f"{value:.4g}")
