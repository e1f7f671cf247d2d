"""The page and the files of an estimated frequency response."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np

from feeddrive.artefacts.files.frf import write_frf
from feeddrive.artefacts.files.whole import new_directory
from feeddrive.artefacts.report.content import Shown
from feeddrive.artefacts.report.page import definitions, header, page, picture
from feeddrive.artefacts.report.tables import table
from feeddrive.engineer.identification.frequency_estimate import FrequencyEstimate
from feeddrive.language.table import Table

TRUSTED = 0.9  # coherence from which a line may carry a tuning


def write_estimate(found: FrequencyEstimate, out: str | Path, facts: Mapping[str, str]) -> Path:
    """Write `frf.csv` and `report.html` into a directory; the path of the report. Raises FileError."""
    with new_directory(out) as folder:
        write_frf(folder / "frf.csv", found.frf)
        (folder / "report.html").write_text(build(found, facts), encoding="utf-8")
    return Path(out) / "report.html"


def build(found: FrequencyEstimate, facts: Mapping[str, str]) -> str:
    """The page. Pure: the same estimate gives the same text."""
    frf = found.frf
    title = f"Frequency response, {frf.input} to {frf.output}".replace("_", " ")
    drawn = Shown(
        "response",
        "Response, phase and coherence",
        "Band: the true response lies in it with 95 % on each line. Dots: what is not the linear answer, on the scale "
        "of the response; distortion only where the excitation left lines empty or the response scatters more than "
        "noise explains.",
        "Magnitude and phase over frequency with their confidence bands, and the coherence below.",
        found.plot,
    )
    summary = levels(found)
    said = "".join(f"<li>{escape(remark)}</li>" for remark in found.remarks)
    remarks = f'<div class="remarks"><h3>Remarks</h3><ul>{said}</ul></div>' if said else ""
    tables = "".join(table(each.title, each.heads, each.rows) for each in (found.table(), summary))
    counts = {name: str(count) for name, count in found.counts.items()}
    parts = [
        header("feeddrive frf", title, sentences(found), [("response", "Response"), ("facts", "What was measured")]),
        f'<section id="response">\n<h2>Response</h2>\n{picture(drawn)}{tables}{remarks}\n</section>\n',
        f'<section id="facts">\n<h2>What was measured</h2>\n'
        f"{definitions({**facts, 'Method': found.method, **counts}.items())}\n</section>\n",
    ]
    return page(title, parts)


def sentences(found: FrequencyEstimate) -> list[str]:
    """What it is worth, in sentences."""
    frf = found.frf
    assert frf.coherence is not None
    assert frf.variance is not None
    share = 100.0 * np.sqrt(frf.variance) / frf.magnitude
    good = float(np.mean(frf.coherence > TRUSTED))
    what = "noise and nonlinear distortion" if found.total else "noise"
    lead = [
        f"{frf.frequency.size} lines from {frf.frequency[0]:.4g} to {frf.frequency[-1]:.4g} Hz; the deviation by "
        f"{what} is {np.median(share):.2g} % in the middle and {np.max(share):.2g} % at worst, at "
        f"{frf.frequency[int(np.argmax(share))]:.4g} Hz."
    ]
    if good < 1.0:
        low = frf.frequency[frf.coherence <= TRUSTED]
        lead.append(
            f"The coherence is {TRUSTED:g} or less on {100.0 * (1.0 - good):.3g} % of the lines, between {low[0]:.4g} "
            f"and {low[-1]:.4g} Hz: do not tune on them; measure again there with more amplitude or longer."
        )
    return lead


def levels(found: FrequencyEstimate) -> Table:
    """Noise and distortion as a share of the response, in the median over octaves of the band."""
    f, size = found.frequency, found.frf.magnitude
    edges = np.geomspace(f[0], f[-1] * (1.0 + 1e-9), 7)
    rows: list[list[str]] = []
    for low, high in pairwise(edges):
        row = [f"{low:.4g} .. {high:.4g} Hz"]
        for name in ("noise", "nonlinear", "odd", "even"):
            level = found.levels.get(name)
            inside = None if level is None else (level.frequency >= low) & (level.frequency < high)
            if level is None or inside is None or not np.any(np.isfinite(level.response[inside])):
                row.append("–")
                continue
            share = level.response[inside] / np.interp(level.frequency[inside], f, size)
            row.append(f"{100.0 * float(np.nanmedian(share)):.3g}")
        rows.append(row)
    heads = ["band", "noise %", "scatter beyond noise %", "odd distortion %", "even distortion %"]
    return Table("Noise of the mean and nonlinear distortion, as a share of the response (medians).", heads, rows)
