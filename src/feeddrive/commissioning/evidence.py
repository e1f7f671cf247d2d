"""What a commissioning measured, as its folder holds it: the strokes, the responses over the model, and the trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from feeddrive.certificate.systems import READINGS
from feeddrive.files.frf import read_frfs
from feeddrive.files.log import Log
from feeddrive.files.machine import read_machine
from feeddrive.files.read_log import read_log
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize

RUNS = ("alone", "pushed", "predicted_alone", "predicted_pushed", "before_alone", "before_pushed")


class Modelled(NamedTuple):
    """A response that was measured, and that of the model on the same lines, as far as the model has any."""

    measured: FRF
    model: FRF | None


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was measured so far.

    strokes    log of the strokes under the start law
    responses  from the commanded force to the readings, by name, with the model if there is one yet
    runs       logs of the trial by name, of `RUNS`: those that are predicted have the same rows as those measured
    """

    strokes: Log | None = None
    responses: Mapping[str, Modelled] = field(default_factory=dict[str, Modelled])
    runs: Mapping[str, Log] = field(default_factory=dict[str, Log])


def read_evidence(folder: Path) -> Evidence:
    """Return what the folder of a commissioning holds. Raises the errors of the readers for files that are damaged."""
    strokes = _of(folder, "friction_and_mass", "strokes.parquet")
    logs = {name: _of(folder, "trial", f"{name}.parquet") for name in RUNS}
    return Evidence(
        None if strokes is None else read_log(strokes),
        _responses(folder),
        {name: read_log(path) for name, path in logs.items() if path is not None},
    )


def _responses(folder: Path) -> dict[str, Modelled]:
    path, machine = _of(folder, "responses", "responses/frf.csv"), _of(folder, "model", "machine.toml")
    if path is None:
        return {}
    measured = read_frfs(path)
    if machine is None:
        return {name: Modelled(frf, None) for name, frf in measured.items()}
    loops = list(read_machine(machine).loops.values())
    outputs = [frf.output for frf in measured.values()]
    # of several axes together the model is none of a single loop
    if len(loops) != 1 or not set(outputs) <= set(READINGS):
        return {name: Modelled(frf, None) for name, frf in measured.items()}
    model = linearize(loops[0], ["cut"], outputs)
    # a sampled model has no response above its Nyquist frequency
    highest = 0.5 / model.sample_time
    return {
        name: Modelled(frf, model.response(frf.frequency[frf.frequency <= highest], frf.output, "cut"))
        for name, frf in measured.items()
    }


def _of(folder: Path, step: str, file: str) -> Path | None:
    """Return a file of a step, whose folder has its number before its name; None if it is not there."""
    places = (place for place in sorted(folder.glob("*_*")) if place.name.partition("_")[2] == step)
    return next((place / file for place in places if (place / file).is_file()), None)
