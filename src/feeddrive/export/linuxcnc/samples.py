"""An exported controller run in a real HAL: its outputs for given inputs, to compare with the simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from feeddrive.export.linuxcnc import component, controller
from feeddrive.export.linuxcnc.component import hal
from feeddrive.export.linuxcnc.session import HalRun, halrun
from feeddrive.loop.routine import Routine

OUTPUTS = {
    "force": ("force-cmd", "f"),
    "command": ("drive-cmd", "f"),
    "trip": ("trip-code", "s"),
    "enabled": ("running", "b"),
}


def answers(
    routine: Routine,
    directory: Path,
    folder: Path,
    inputs: np.ndarray,
    *,
    units_per_m: float = 1.0,
    also: Mapping[str, np.ndarray] | None = None,
    more: Sequence[tuple[str, str]] = (),
    setup: Sequence[str] = (),
    meanwhile: Sequence[str] = (),
    at_end: Sequence[str] = (),
    paced: bool = False,
    period: int | None = None,
    patience: float = 60.0,
) -> HalRun:
    """The outputs of an exported controller to inputs in SI, shape (n, inputs), in the order of the routine.

    directory    what `write_linuxcnc` wrote;  folder: an empty one to work in
    units_per_m  lengths go in multiplied by it; with 1 the component gets the very numbers of `inputs`
    also         further pins of type bit, and what goes into them at each sample
    more         names and types of pins that are recorded behind the outputs, such as ("fault-code", "s")
    setup        commands of halcmd before the thread starts;  meanwhile, at_end, paced and patience: as for
                 `halrun`
    period       of the thread in ns; absent: that of the sample time

    Raises MissingProgramError and HalError as `halrun`.
    """
    name = hal(routine.name)
    pins = [*(controller.input_pin(v.name) for v in routine.inputs), *(also or {})]
    taken = [OUTPUTS[v.name] for v in routine.outputs] + list(more)
    wiring = [
        f"loadrt {routine.name}", f"addf {name} servo-thread",
        f"setp {name}.units-per-m {units_per_m!r}",
        f"setp {name}.late-limit 0", *setup,  # not in real time here
        *(f"net in-{i} streamer.0.pin.{i} => {name}.{pin}" for i, pin in enumerate(pins)),
        *(f"net out-{i} {name}.{pin} => sampler.0.pin.{i}" for i, (pin, _) in enumerate(taken)),
    ]  # fmt: skip
    rows = np.array(inputs, dtype=float)
    for i, variable in enumerate(routine.inputs):
        if variable.name == "enable":
            rows[:, i] = rows[:, i] > 0.5
        else:
            rows[:, i] *= units_per_m
    rows = np.column_stack([rows, *(also or {}).values()])
    return halrun(
        [directory / f"{routine.name}.comp"], folder, period or component.period(routine), wiring, rows,
        "".join("b" if pin == "enable" or pin in (also or {}) else "f" for pin in pins),
        "".join(kind for _, kind in taken), meanwhile=meanwhile, at_end=at_end, paced=paced, patience=patience,
    )  # fmt: skip
