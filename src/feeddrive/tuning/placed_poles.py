"""Poles that a law places by its numbers, moved by hand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.controller.generalized_predictive import GeneralizedPredictive
from feeddrive.blocks.controller.linear_adrc import LinearADRC
from feeddrive.blocks.controller.lqg import LQG
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.loop.control import Control

_LEAST, _MOST = 0.01, 1.0  # of a damping ratio that is dragged
_BUTTERWORTH = float(np.sqrt(0.5))


class _Placed(NamedTuple):
    """A pair or a real pole: the fields of its frequency and of its damping ratio, and the ratio where none has one."""

    label: str
    frequency: str
    damping: str = ""
    ratio: float = 1.0


_PLACED: Mapping[type[Block], tuple[_Placed, ...]] = {
    PolePlacement: (
        _Placed("real pole", "bandwidth"),
        _Placed("rigid pair", "rigid_frequency", "rigid_damping"),
        _Placed("axial pair", "axial_frequency", "axial_damping"),
    ),
    LinearADRC: (_Placed("tracking error", "omega_c", "zeta_c"), _Placed("observer, three real poles", "omega_o")),
    ActiveDisturbanceRejection: (_Placed("tracking error", "omega_c", "zeta_c"),),
    GpiObserver: (_Placed("observer, its pairs", "omega_o", "zeta_o"), _Placed("observer, real pole", "p0")),
    LQG: (
        _Placed("tracking error", "omega_c", ratio=_BUTTERWORTH),
        _Placed("filter, own frequency", "omega_o", ratio=_BUTTERWORTH),
    ),
    GeneralizedPredictive: (_Placed("observer of the prediction", "omega_o"),),
    DADSC: (
        _Placed("sliding line", "tracking_rate"),
        _Placed("reaching it", "reaching_rate"),
        _Placed("adaptation", "adaptation_rate"),
    ),
}


@dataclass(frozen=True)
class PlacedPole:
    """A pole that a law or an observer places, as the numbers say it, without delay and sampling.

    name       of its frequency below the control, as law.axial_frequency, whether it has a number or follows a rule
    s          1/s, of a pair the one in the upper half plane
    frequency, damping  names of the numbers that are moved with it; empty where there is none
    """

    name: str
    label: str
    s: complex
    frequency: str
    damping: str


def placed_poles(control: Control) -> tuple[PlacedPole, ...]:
    """All poles that the law and its observers place; empty for a law whose gains are not given by poles."""
    return tuple(_placed(control))


def _placed(control: Control) -> Iterator[PlacedPole]:
    blocks: list[tuple[str, Any]] = [("law", control.law)]
    blocks += [(f"compensation.{i}", block) for i, block in enumerate(control.compensation)]
    blocks += [(f"{where}.observer", block.observer) for where, block in blocks if getattr(block, "observer", None)]
    for where, block in blocks:
        for pole in _PLACED.get(type(block), ()):
            stated = getattr(block, pole.frequency)
            size = _by_rule(block, pole.frequency) if stated is None else _rate(block, pole.frequency)
            if size is None:
                continue
            ratio = min(float(getattr(block, pole.damping)), 1.0) if pole.damping else pole.ratio
            name = f"{where}.{pole.frequency}"
            yield PlacedPole(
                name,
                pole.label,
                size * complex(-ratio, np.sqrt(1.0 - ratio * ratio)),
                "" if stated is None else name,
                f"{where}.{pole.damping}" if pole.damping else "",
            )


def _rate(block: Block, field: str) -> float:
    """A frequency in rad/s."""
    value = float(getattr(block, field))
    return 2.0 * np.pi * value if declarations(type(block))[field].unit == "Hz" else value


def _by_rule(block: Block, field: str) -> float | None:
    """A frequency in rad/s that is absent and follows from others; None for a pole that then is not there."""
    if not isinstance(block, PolePlacement):
        return None
    real = _rate(block, "bandwidth")
    if field == "rigid_frequency":
        return real
    rigid = real if block.rigid_frequency is None else _rate(block, "rigid_frequency")
    return float(np.sqrt(float(block.polynomial()[0]) / (real * rigid**2)))  # the last of all factors of s⁰


def placed_dragged(control: Control, name: str, s: complex) -> dict[str, float]:
    """The numbers with which a placed pole lies as near to s (1/s) as they let it: its distance from 0 is the
    frequency, its angle the damping ratio, from 0.01 to 1.

    Raises ParameterError for a pole that there is not.
    """
    known = {pole.name: pole for pole in placed_poles(control)}
    if name not in known:
        raise ParameterError(f"the law places no pole '{name:.60}'{nearest(name, known)}")
    values, pole, size = dict[str, float](), known[name], abs(s)
    if pole.frequency:
        along = size if pole.damping else max((s * np.conj(pole.s)).real / abs(pole.s), 0.0)  # on its own ray
        scale = 2.0 * np.pi if tree.declaration(control, pole.frequency).unit == "Hz" else 1.0
        values[pole.frequency] = _digits(max(along, 1e-3 * abs(pole.s)) / scale)
    if pole.damping and size > 0.0:
        values[pole.damping] = _digits(min(max(-s.real / size, _LEAST), _MOST))
    return values


def _digits(value: float) -> float:
    return float(f"{value:.4g}")
