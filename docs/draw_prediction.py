"""Draws docs/images/emps.svg: the EMPS axis, measured and predicted; needs the published log beside the repository.

python docs/draw_prediction.py ../shared/data/emps/DATA_EMPS.mat
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("svg")
import matplotlib.pyplot as plt
import numpy as np

import feeddrive as fd

TARGET = Path(__file__).parent / "images" / "emps.svg"


def draw(log: str) -> None:
    """One stroke out and back: following error above, prediction minus measurement below."""
    replay = fd.run(fd.read_job("emps_log", log)).rows[0].replay
    assert replay is not None
    t = replay.run.time
    part = (t >= 2.0) & (t <= 12.0)
    every = np.flatnonzero(part)[::8]
    mpl.rcParams |= {
        "svg.fonttype": "none",
        "svg.hashsalt": "feeddrive",
        "font.size": 9,
        "path.simplify_threshold": 0.3,
    }
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(7.2, 3.4), sharex=True, height_ratios=[2, 1], layout="constrained"
    )
    above.plot(
        t[every], 1e6 * replay.measured["following_error"][every], color="#9aa0a8", linewidth=3, label="measured"
    )
    above.plot(t[every], 1e6 * replay.run["following_error"][every], color="#1f5fa8", linewidth=1, label="predicted")
    above.set_ylabel("following error, µm")
    above.legend(loc="upper right", frameon=False)
    residual = replay.run["position_load"] - replay.measured["position_load"]
    rows = np.flatnonzero(part)
    groups = rows[: rows.size // 8 * 8].reshape(-1, 8)
    largest = groups[np.arange(len(groups)), np.argmax(np.abs(residual[groups]), axis=1)]  # no peak is lost
    below.plot(t[largest], 1e6 * residual[largest], color="#b8341b", linewidth=0.8)
    below.set_ylabel("difference, µm")
    below.set_xlabel("time, s")
    for axes in (above, below):
        axes.grid(color="#e3e5e8", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(TARGET, metadata={"Date": None})


if __name__ == "__main__":
    draw(sys.argv[1])
