"""The page and the files of an estimated frequency response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np

from feeddrive.files.atomic_io import new_directory
from feeddrive.files.frf import write_frf
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
from feeddrive.language.table import Table
from feeddrive.report.content import Shown
from feeddrive.report.page import definitions, header, page, picture, table

TRUSTED = 0.9  # coherence from which a line may carry a tuning


def write_estimates(found: Sequence[FrequencyEstimate], out: str | Path, facts: Mapping[str, str]) -> Path:
    """Write `frf.csv` with all responses and `report.html` into a directory; the path of the report. FileError."""
    with new_directory(out) as folder:
        write_frf(folder / "frf.csv", *(each.frf for each in found))
        (folder / "report.html").write_text(build(found, facts), encoding="utf-8")
    return Path(out) / "report.html"


def build(found: Sequence[FrequencyEstimate], facts: Mapping[str, str]) -> str:
    """The page, a section for each response. Pure: the same estimates give the same text."""
    heads = [each.frf.output for each in found]  # columns under the names that their owner gave them
    title = f"Frequency response, {found[0].frf.input} to {' and '.join(heads)}"
    keys = [f"response{'abcdefghijkl'[k]}" for k in range(len(found))]
    lead = [
        sentence if len(found) == 1 else f"{name}: {sentence}"
        for name, each in zip(heads, found, strict=True)
        for sentence in sentences(each)
    ]
    links = [*zip(keys, heads, strict=True), ("facts", "What was measured")]
    counts = {"Method": found[0].method, **{name: str(count) for name, count in found[0].counts.items()}}
    return page(title, [
        header("feeddrive frf", title, lead, links),
        *(_section(*each) for each in zip(keys, heads, found, strict=True)),
        f'<section id="facts">\n<h2>What was measured</h2>\n{definitions({**facts, **counts}.items())}\n</section>\n',
    ])  # fmt: skip


def _section(key: str, head: str, found: FrequencyEstimate) -> str:
    """One response: picture, tables and remarks."""
    shown = Shown(
        f"{key}picture",
        "Response, phase and coherence",
        "Band: the true response lies in it with 95 % on each line. Dots: what is not the linear answer, on the scale "
        "of the response; distortion only where the excitation left lines empty or the response scatters more than "
        "noise explains.",
        "Magnitude and phase over frequency with their confidence bands, and the coherence below.",
        found.plot,
    )
    tables = "".join(table(each.title, each.heads, each.rows) for each in (found.table(), levels(found)))
    said = "".join(f"<li>{escape(remark)}</li>" for remark in found.remarks)
    remarks = f'<div class="remarks"><h3>Remarks</h3><ul>{said}</ul></div>' if said else ""
    return f'<section id="{key}">\n<h2>{escape(head)}</h2>\n{picture(shown)}{tables}{remarks}\n</section>\n'


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
    heads = ["band", "noise %", "scatter %", "odd %", "even %"]
    title = "Noise of the mean, scatter beyond noise, odd and even distortion: shares of the response (medians)."
    return Table(title, heads, rows)
