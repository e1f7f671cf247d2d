"""Friction against velocity: the model's curve, what a simulated run met, and what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from feeddrive.analysis.friction_map import FrictionMap
from feeddrive.blocks.families import Friction
from feeddrive.language.table import picture_of
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run
from feeddrive.plot import style

CELLS = 160  # a picture is so many points wide and high: of those that fall on each other one is drawn


def friction(
    loops: Loop | Mapping[str, Loop],
    run: Run | None = None,
    measured: FrictionMap | None = None,
) -> Any:
    """Force against the motion in N over velocity in mm/s, both directions.

    Of loops with the same friction one curve is drawn.  `run` adds what was met in a run of the first loop.
    """
    figure, (ax,) = style.picture(1, height=3.4)
    ax.axhline(0.0, color=style.MUTED, linewidth=0.8)
    ax.axvline(0.0, color=style.MUTED, linewidth=0.8)
    chosen = style.named(loops)
    reach = _reach(run, measured)
    curves = _different(chosen)
    if run is not None and chosen:
        _met(ax, next(iter(chosen.values())), run)
    for i, (name, block) in enumerate(curves.items()):
        for sign in (-1.0, 1.0):
            v = sign * reach * np.concatenate([[1e-9], np.geomspace(1e-5, 1.0, 400)])
            force = [float(block.steady(np.float64(x))) for x in v]
            ax.plot(1e3 * v, force, label=style.caption(name) if sign > 0.0 else None, **style.curve(i))
    if measured is not None:
        ax.errorbar(
            1e3 * measured.velocity, measured.force, measured.deviation, fmt="o", markersize=3.5, color=style.INK,
            ecolor=style.MUTED, elinewidth=0.8, label="measured, mean and deviation",
        )  # fmt: skip
    style.labels(ax, "velocity (mm/s)", "friction against\nthe motion (N)")
    ax.set_xlim(-1.03e3 * reach, 1.03e3 * reach)
    style.legend(figure, ax)
    return figure


def has_friction(loop: Loop) -> bool:
    """Whether there is a curve to draw."""
    return loop.axis.friction_load is not None or loop.axis.friction_motor is not None


def _reach(run: Run | None, measured: FrictionMap | None) -> float:
    found = [0.0]
    if run is not None:
        found.append(float(np.max(np.abs(run["velocity_load"]), initial=0.0)))
    if measured is not None:
        found.append(float(np.max(np.abs(measured.velocity), initial=0.0)))
    return max(found) or 0.1


def _different(loops: Mapping[str, Loop]) -> dict[str, Friction]:
    """The frictions by name, each different one once."""
    found: dict[str, Friction] = {}
    seen: set[str] = set()
    places = {"friction_load": "guideway", "friction_motor": "screw and bearings"}
    several = any(loop.axis.friction_motor is not None for loop in loops.values())
    for name, loop in loops.items():
        for field, place in places.items():
            block = getattr(loop.axis, field)
            if block is None or f"{field} {block!r}" in seen:
                continue
            seen.add(f"{field} {block!r}")
            label = f"model, {place}" if several else "model"
            found[label if label not in found else f"{label}, {name}"] = block
    return found


def _met(ax: Any, loop: Loop, run: Run) -> None:
    """What the run met: the force of a row belongs to the velocity at the end of its sample."""
    label: str | None = "met in the run"
    for place in ("load", "motor"):
        block = getattr(loop.axis, f"friction_{place}")
        if block is None or run.time.size < 3:
            continue
        velocity = run[f"velocity_{place}"][1:]
        force = -run[f"friction_{place}"][:-1] + float(block.linear()) * velocity
        cells = np.column_stack([np.rint(CELLS * x / (np.max(np.abs(x)) or 1.0)) for x in (velocity, force)])
        _, kept = np.unique(cells, axis=0, return_index=True)
        ax.plot(
            1e3 * velocity[kept], force[kept], "o", markersize=4.0, color=style.color(5), alpha=0.45,
            markeredgewidth=0, label=label,
        )  # fmt: skip
        label = None


@picture_of.register
def _friction_map(found: FrictionMap) -> Any:
    return friction({}, measured=found)
