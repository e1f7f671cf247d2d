"""Draws docs/images/iterative-feedforward.svg: errors and parameters over six trials of the bundled x-y table.

python docs/draw_iterative_feedforward.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

from feeddrive.learning.trials import iterate_trials
from feeddrive.papers.wu2017.testbed import SAME, SETS, TRIALS, noise, table_axis
from feeddrive.plot.tuning import errors_and_parameters

TARGET = Path(__file__).parent / "images" / "iterative-feedforward.svg"


def drawing() -> Any:
    """Three sets of columns along the same move, tanh friction as in the experiments."""
    named = {name: iterate_trials(table_axis("x", columns), SAME, TRIALS, load=noise) for name, columns in SETS.items()}
    return errors_and_parameters(named)


if __name__ == "__main__":
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "feeddrive"}
    drawing().savefig(TARGET, metadata={"Date": None})
