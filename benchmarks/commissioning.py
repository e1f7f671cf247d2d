"""The table of docs/how_to/commissioning.md: drawn files, each taken to exported parameters by commands.

    python benchmarks/commissioning.py --seed 100 --files 30 --rows rows.jsonl

The files are those of `tests/commissioning_files.py`: no line of feeddrive computes their axes.  Every other file is in
the flat form of another version.  In a folder with nothing but the file, the commands are typed as a person types them:
`identify FILE`, `tune FILE`, and what each `Next:` line names, to `verify`; then the parameters are exported.  Each row
has the errors of the model, the CPU time of the commands, whole processes with imports and reports, and whether the
tuned control keeps its limits on the true axis without noise.  Rows are kept in a file, so that a run may be made in
parts: `--only 5` makes five more.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from commissioning_files import TrueAxis, drawn, written
from feeddrive.analysis.margins import margins
from feeddrive.files.commissioning import read_commissioning
from feeddrive.files.machine import read_machine
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.tuning.operating_point import OperatingPoint, measured_point, response_on
from feeddrive.workflow.commissioning import drive_axis

RUN = "import sys; from feeddrive.cli import main; sys.exit(main())"
_LONGEST = 12  # commands of one walk: it ends after six


@dataclass(frozen=True)
class Row:
    """The result for one file: relative error of the inertia, error of the first zero in Hz, both also in standard
    errors; s of CPU time; what the tuned control has on the true axis; why a command refused.
    """

    seed: int
    rotary: bool
    inertia: float
    inertia_sigmas: float
    zero: float
    zero_sigmas: float
    identify: float
    tune: float
    walked: str
    tuned: str
    refused: str = ""


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


def typed(command: str, folder: Path) -> tuple[int, str, float]:
    """Type a command in a folder; return its exit code, its output and the CPU time of its process."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "200", "NO_COLOR": "1"}
    before = os.times()
    done = subprocess.run(
        [sys.executable, "-c", RUN, *shlex.split(command)[1:]],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return done.returncode, done.stdout + done.stderr, spent


def walk(name: str, folder: Path) -> tuple[dict[str, float], str, str]:
    """Type `identify` and all that the `Next:` lines name; return CPU times by command, the commands, and a refusal."""
    command, spent, typed_commands = f"feeddrive identify {name}", dict[str, float](), list[str]()
    refused = ""
    for _ in range(_LONGEST):
        code, output, seconds = typed(command, folder)
        kind = command.split()[1]
        spent[kind] = spent.get(kind, 0.0) + seconds
        typed_commands.append(kind)
        if code != 0:
            refused = f"{kind}: {' '.join(output.split())[-300:]}"
        following = re.findall(r"(?m)^Next: (.+)$", output)
        if code != 0 or not following:
            break
        command = following[-1]
    return spent, " ".join(typed_commands), refused


def measured(seed: int, folder: Path) -> Row:
    """Write the file of a seed and walk from it to exported parameters."""
    axis = drawn(seed)
    path = written(folder, axis, plain=seed % 2 == 1)
    file = read_commissioning(path)
    assert file is not None
    fit = drive_axis(file, Progress()).result.fit
    names = [estimate.name for estimate in (*fit.estimates, *fit.derived)]
    total = fit["total_mass" if "total_mass" in names else "mass"]
    off = total.value - axis.inertia
    # a rigid model has no zero
    apart, sigmas = np.nan, np.nan
    if "antiresonance" in names:
        apart = fit["antiresonance"].value - axis.first_zero()
        sigmas = apart / fit["antiresonance"].error
    spent, walked, refused = walk(path.name, folder)
    machine = folder / "results" / f"tune_{path.stem}" / "machine.toml"
    tuned = ""
    if machine.is_file():
        Ms, gain, phase = true_margins(axis, read_machine(machine).loop(None).control)
        asked = axis.margins if seed % 2 == 0 else (0.0, 0.0)
        kept = Ms <= 2.0 and gain >= asked[0] - 0.05 and phase >= asked[1] - 0.2
        words = f"Ms {Ms:.2f}, {gain:.1f} dB, {phase:.0f} deg, asked {asked[0]:.1f} dB, {asked[1]:.0f} deg"
        tuned = f"{'kept' if kept else 'NOT KEPT'}: {words}"
        code, output, _ = typed(f"feeddrive export {machine} -t parameters --maker sinumerik --out parameters", folder)
        text = folder / "parameters" / "sinumerik.txt"
        walked += " parameters" if code == 0 and "p1460[0] = " in text.read_text(encoding="utf-8") else ""
        refused = refused or ("" if code == 0 else f"parameters: {' '.join(output.split())[-200:]}")
    return Row(
        seed,
        axis.rotary,
        off / axis.inertia,
        off / total.error,
        apart,
        sigmas,
        spent.get("identify", 0.0),
        spent.get("tune", 0.0),
        walked,
        tuned,
        refused,
    )


def shown(row: Row) -> str:
    """Return a row as a line."""
    return (
        f"{row.seed} {'turns ' if row.rotary else 'linear'} inertia {100 * row.inertia:6.2f} % "
        f"({row.inertia_sigmas:5.2f} errors), zero {row.zero:6.3f} Hz ({row.zero_sigmas:5.2f} errors), "
        f"CPU {row.identify:.1f} and {row.tune:.1f} s; {row.walked}; {row.tuned}"
        f"{' REFUSED ' + row.refused if row.refused else ''}"
    )


def summary(rows: list[Row]) -> str:
    """Return the table of the page, in Markdown."""
    lines = [
        f"| {len(rows)} files, seeds {rows[0].seed} to {rows[-1].seed} | largest | median | inside the 95 % interval | "
        "farthest, in standard errors |",
        "|---|--:|--:|--:|--:|",
    ]
    for label, unit, scale, name in (("total inertia", "%", 100.0, "inertia"), ("first zero", "Hz", 1.0, "zero")):
        errors = scale * np.abs([getattr(row, name) for row in rows])
        sigmas = np.abs([getattr(row, f"{name}_sigmas") for row in rows])
        lines.append(
            f"| error of the {label} | {np.nanmax(errors):.2f} {unit} | {np.nanmedian(errors):.2f} {unit} | "
            f"{int(np.sum(sigmas < 1.96))} | {np.nanmax(sigmas):.1f} |"
        )
    for name in ("identify", "tune"):
        times = np.array([getattr(row, name) for row in rows])
        lines.append(f"| CPU time of `{name}` | {np.max(times):.1f} s | {np.median(times):.1f} s | | |")
    kept = sum(row.tuned.startswith("kept") for row in rows)
    whole = sum("verify" in row.walked and row.walked.endswith("parameters") for row in rows)
    lines.append(
        f"\n{whole} of {len(rows)} walked to a verified export and to parameters; {kept} of "
        f"{sum(bool(row.tuned) for row in rows)} tuned controls keep their limits on the true axis without noise"
    )
    lines += [f"refused: {row.seed}, {row.refused}" for row in rows if row.refused]
    return "\n".join(lines)


def main() -> None:
    """Print one line a file, and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--files", type=int, default=30)
    parser.add_argument("--only", type=int, default=10**6, help="rows to make in this run")
    parser.add_argument("--rows", type=Path, default=Path("commissioning_rows.jsonl"))
    options = parser.parse_args()
    text = options.rows.read_text(encoding="utf-8") if options.rows.is_file() else ""
    rows = {row.seed: row for row in (Row(**json.loads(line)) for line in text.splitlines())}
    missing = [options.seed + k for k in range(options.files) if options.seed + k not in rows]
    for seed in missing[: options.only]:
        with tempfile.TemporaryDirectory() as folder:
            rows[seed] = measured(seed, Path(folder))
        with options.rows.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(rows[seed])) + "\n")
        print(shown(rows[seed]), flush=True)
    there = [rows[options.seed + k] for k in range(options.files) if options.seed + k in rows]
    if there:
        print(summary(there))


if __name__ == "__main__":
    main()
