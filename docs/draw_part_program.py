"""Draws docs/images/part_program_laws.svg and part_program_worst.svg: six laws on one part program that cuts.

python docs/draw_part_program.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("svg")

from feeddrive import plot
from feeddrive.files.job import read_job
from feeddrive.jobs.run_laws import run_laws

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """The pictures of the demo's report that compare its laws."""
    parts = run_laws(read_job("circle_diamond_square")).parts
    worst = parts["today"].worst(1)[0]
    plot.part_laws(parts).savefig(IMAGES / "part_program_laws.svg", metadata={"Date": None})
    plot.part_zoom(parts, worst.time).savefig(IMAGES / "part_program_worst.svg", metadata={"Date": None})


if __name__ == "__main__":
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "feeddrive"}):
        main()
