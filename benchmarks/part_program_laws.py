"""The laws of the papers on every axis of the bundled machining center, tuned to one rule, as the bundled job.

    python benchmarks/part_program_laws.py --keep kept --out src/feeddrive/files/bundled/jobs/circle_diamond_square.toml

Each law is tuned on each axis alone by `feeddrive compare`'s rule: Ms <= 2, a delay margin of two samples, at most 1.05
times the force that the tuned P-PI makes of the noise of its readings.  Then mass, viscous and dry friction of the P-PI
are learned over six repetitions of the part program (Wu et al. 2017), each axis by its own error.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
from pathlib import Path

from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.comparison.compare import compare_laws
from feeddrive.evaluation import Engine, Folder
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.files.section import to_toml
from feeddrive.learning.iterative_feedforward import compensated
from feeddrive.learning.trials import iterate_trials
from feeddrive.loop.control import Control

LAWS = ("P-PI", "GPI, 3 Taylor states", "DADSC", "pole placement")
LEARNED = "P-PI, learned feedforward"
TRIALS = 6
RULE = (
    "Equal robustness, but for today's row: each law is tuned on each axis alone for the least rope-snap "
    "error with Ms <= 2, a delay margin of two samples and at most 1.05 times the force that the tuned "
    "P-PI makes of the noise of its readings. The learned feedforward is that of the tuned P-PI after six "
    "repetitions of the program."
)
HEAD = """# A test piece with the laws of the papers on all axes; written by benchmarks/part_program_laws.py.
title = "Circle, diamond and square: what does a better law buy?"
machine = "machining_center"
axis = "x"
seed = 1
rule = "RULE"

[program]
file = "circle_diamond_square.ngc"
"""
PROCESS = """
[process.tool.1]                # carbide, in 7075-T6; the program says in comments how deep and wide it cuts
kind = "mechanistic_cutter"
teeth = 4
diameter_mm = 12
axial_depth_mm = 4
flute_length_mm = 24
helix_angle_deg = 30
Ktc_N_per_mm2 = 767
Krc_N_per_mm2 = 169
Kac_N_per_mm2 = 222
Kte_N_per_mm = 27.7
Kre_N_per_mm = 26.6
Kae_N_per_mm = 0.7
"""


def main() -> None:
    """Tune, learn and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    machine = read_machine("machining_center")
    rows: dict[str, dict[str, Control]] = {}
    for axis in machine.loops:
        found = compare_laws(machine, axis, laws=LAWS, engine=Engine.of(None, store=Folder(given.keep / axis)))
        print(found.table())
        for each in found.competitors[1:]:
            rows.setdefault(each.name, {})[axis] = each.loop.control
    head = HEAD.replace("RULE", RULE)
    given.out.write_text(head)
    job = read_job(given.out)
    assert job.program is not None
    for axis, control in rows["P-PI"].items():
        loop = dataclasses.replace(machine.loops[axis], control=control)
        guess = DisturbanceCompensator(mass=100.0, viscous=0.0, coulomb_positive=0.0, coulomb_negative=0.0)
        bare = dataclasses.replace(loop, control=dataclasses.replace(control, feedforward=()))
        learned = iterate_trials(compensated(bare, guess), job.program.references[axis], TRIALS)
        print(axis, learned.table())
        rows.setdefault(LEARNED, {})[axis] = learned.loop.control
    order = ["P-PI", LEARNED, *LAWS[1:]]
    given.out.write_text(head + PROCESS + "".join(_row(name, rows[name]) for name in order))


def _row(name: str, controls: dict[str, Control]) -> str:
    parts = [f'\n[[law]]\nname = "{name}"\n']
    for axis, control in controls.items():
        bare = dataclasses.replace(control, guard=None, force_limit=None)
        parts.append(_short(to_toml(bare, f"law.axis.{axis}.control")))
    return "".join(parts)


def _short(text: str) -> str:
    """Without what is the default, and with numbers of six digits."""
    lines = [re.sub(r"\s+#.*", "", line) for line in text.splitlines() if not line.startswith("#")]
    kept = [line for line in lines if line and line != 'kind = "control"']
    rounded = [re.sub(r"= (-?\d+\.\d+)$", lambda found: f"= {float(found[1]):.6g}", line) for line in kept]
    return "\n" + "\n".join(rounded) + "\n"


if __name__ == "__main__":
    main()
