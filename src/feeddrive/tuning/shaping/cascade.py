"""The two loops of a cascade one by one, both from the control that runs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.language.table import Result, Table
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.tuning.shaping.control_response import ControlResponse
from feeddrive.tuning.shaping.site import Site

_OFF = 1e-9  # of Kv: a position loop that is open


@dataclass(frozen=True, eq=False, repr=False)
class CascadeLoops(Result):
    """Loop gains of the velocity loop alone, opened at the actuator, and of the position loop around it, closed."""

    velocity: Margins
    position: Margins

    def table(self) -> Table:
        """Crossover and margins of both."""
        rows: list[list[str]] = []
        for name, m in (("velocity loop", self.velocity), ("position loop", self.position)):
            cells = (m.crossover, m.phase_margin_deg, m.gain_increase_dB, m.sensitivity_peak)
            rows.append([name, *("-" if cell is None else f"{cell:.4g}" for cell in cells)])
        heads = ["loop", "crossover Hz", "phase margin deg", "gain may rise dB", "Ms"]
        return Table("the cascade, loop by loop", heads, rows)


def cascade_loops(control: Control, site: Site) -> CascadeLoops | None:
    """Velocity and position loop of a P-PI control; None for another law.

    With Lv the gain at the actuator without position loop (Kv -> 0) and L the whole, the position loop opened at the
    velocity command has the gain (L - Lv)/(1 + Lv).
    """
    law = control.law
    if not isinstance(law, CascadePPI):
        return None
    gains: list[np.ndarray] = []
    for Kv in (law.Kv, _OFF * law.Kv):
        C = ControlResponse(replace(control, law=replace(law, Kv=Kv)), site.sample_time, ()).at((), site.frequency)
        gains.append(-np.einsum("kl,kl->l", C.value, site.by_force))
    whole, inner = gains
    T = site.sample_time
    found = [
        margins(FRF(site.frequency, gain, source, answer, unit, T))
        for gain, source, answer, unit in (
            (inner, "cut", "force", "N/N"),
            ((whole - inner) / (1.0 + inner), "velocity command", "velocity command", ""),
        )
    ]
    return CascadeLoops(*found)
