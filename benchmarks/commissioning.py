"""The table of docs/commissioning.md: drawn commissioning files, each from the file to the tuned axis by the commands.

    python benchmarks/commissioning.py --seed 100 --files 30 [--tune 6]

The files are those of `tests/commissioning_files.py`: no line of feeddrive computes their axes.  Every other file is in
the flat form of another version.  For each file: the total inertia and the first zero of the model beside the truth, in
per cent and Hz and in standard errors, the CPU time, and, for the first `--tune` files, whether the tuned control keeps
its limits on the true axis without noise.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from commissioning_files import TrueAxis, drawn, written
from feeddrive.analysis.margins import margins
from feeddrive.files.commissioning import read_commissioning
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.tuning.operating_point import OperatingPoint, measured_point, response_on
from feeddrive.workflow.commissioning import drive_axis
from feeddrive.workflow.tune import TuneRequest, tune


@dataclass(frozen=True)
class Row:
    """The result for one file: errors relative to the truth, and in standard errors; s of CPU time."""

    seed: int
    rotary: bool
    inertia: float
    inertia_sigmas: float
    zero: float
    zero_sigmas: float
    identify: float
    tuned: str = ""
    tune: float = 0.0


def true_point(axis: TrueAxis) -> OperatingPoint:
    """Return the operating point of the true axis, without noise, at its motor: what the speed loop would measure."""
    f = axis.lines()
    f = f[f < 0.5 / axis.clock]
    whole = axis.clock / (1.0 - np.exp(-2j * np.pi * f * axis.clock))
    r = 1.0 if axis.rotary else axis.per_motor**2
    response = r * whole * axis.plant(f) * axis.current_loop(f)
    return measured_point(FRF(f, response, "force", "load", "m/N"), sample_time=axis.clock)


def true_margins(axis: TrueAxis, control: Control) -> tuple[float, float, float]:
    """Return Ms, the gain margin in dB and the phase margin in deg of a control on the true axis."""
    point = true_point(axis)
    L = -np.einsum("kl,kl->l", response_on(point, control).value, point.by_force)
    found = margins(FRF(point.frequency, L, "cut", "force", "", axis.clock))
    rising = [c.gain_margin_dB for c in found.phase_crossovers if c.gain_margin_dB >= 0.0]
    return found.sensitivity_peak, min(rising, default=np.inf), abs(found.phase_margin_deg or np.inf)


def measured(seed: int, folder: Path, *, with_tuning: bool) -> Row:
    """Write the file of a seed, identify it and, if asked, tune it."""
    axis = drawn(seed)
    path = written(folder, axis, plain=seed % 2 == 1)
    begun = time.process_time()
    file = read_commissioning(path)
    assert file is not None
    model = drive_axis(file, Progress())
    spent = time.process_time() - begun
    fit = model.result.fit
    total, zero = fit["total_mass"], fit["antiresonance"]
    off = total.value - axis.inertia
    row = Row(
        seed,
        axis.rotary,
        off / axis.inertia,
        off / total.error,
        zero.value - axis.first_zero(),
        (zero.value - axis.first_zero()) / zero.error,
        spent,
    )
    if not with_tuning:
        return row
    begun = time.process_time()
    try:
        tuned = tune.run(TuneRequest(source=path)).result
    except FeeddriveError as error:
        return replace(row, tuned=f"refused: {str(error)[:90]}", tune=time.process_time() - begun)
    spent = time.process_time() - begun
    Ms, gain, phase = true_margins(axis, tuned.control)
    asked = axis.margins if seed % 2 == 0 else (0.0, 0.0)
    kept = Ms <= 2.0 and gain >= asked[0] - 0.05 and phase >= asked[1] - 0.2
    words = f"{'kept' if kept else 'NOT KEPT'}: Ms {Ms:.2f}, {gain:.1f} dB, {phase:.0f} deg, asked {asked[0]:.1f} dB, "
    return replace(row, tuned=f"{words}{asked[1]:.0f} deg", tune=spent)


def main() -> None:
    """Print one line a file, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--files", type=int, default=30)
    parser.add_argument("--tune", type=int, default=0)
    options = parser.parse_args()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(options.files):
            seed = options.seed + k
            row = measured(seed, Path(folder), with_tuning=k < options.tune)
            rows.append(row)
            print(
                f"{seed} {'turns ' if row.rotary else 'linear'} inertia {100 * row.inertia:6.2f} % "
                f"({row.inertia_sigmas:5.2f} errors), zero {row.zero:6.3f} Hz ({row.zero_sigmas:5.2f} errors), "
                f"{row.identify:.1f} s {row.tuned} {row.tune:.1f} s",
                flush=True,
            )
    inside = [np.abs([getattr(row, name) for row in rows]) < 1.96 for name in ("inertia_sigmas", "zero_sigmas")]
    print(
        f"{len(rows)} files: inertia within {100 * max(abs(row.inertia) for row in rows):.2f} %, inside its 95 % "
        f"interval {int(np.sum(inside[0]))}; first zero within {max(abs(row.zero) for row in rows):.3f} Hz, inside "
        f"{int(np.sum(inside[1]))}; identify {np.median([row.identify for row in rows]):.1f} s of CPU, median"
    )


if __name__ == "__main__":
    main()
