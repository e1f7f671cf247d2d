"""The report of a certificate, and the files beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from feeddrive import plot
from feeddrive.certificate.certificate import Certificate
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.table import Table
from feeddrive.report.content import Shown
from feeddrive.report.page import definitions, header, page, picture, table
from feeddrive.workflow.certificate_file import write_certificate

FILE = "certificate.json"


def write_certified(found: Certificate, out: str | Path, facts: Mapping[str, str]) -> Path:
    """Write `certificate.json` and `report.html` into a directory; the path of the report. Raises FileError."""
    with new_directory(out) as folder:
        write_certificate(folder / FILE, found)
        (folder / "report.html").write_text(build(found, facts), encoding="utf-8")
    return Path(out) / "report.html"


def build(found: Certificate, facts: Mapping[str, str]) -> str:
    """The page. Pure: the same certificate gives the same text."""
    drawn = list(_pictures(found))
    said = found.sentence()
    name = found.document["machine"].get("name", "")
    title = f"{name[:1].upper()}{name[1:]}: a certified loop" if name else "A certified loop"
    links = [("result", "Result"), *((f"figure-{each.key}", each.title) for each in drawn),
             ("outside", "What is outside"), ("facts", "What was certified")]  # fmt: skip
    shown = [found.table(), plants_table(found), control_table(found)]
    made = "".join(table(f"{each.title[:1].upper()}{each.title[1:]}.", each.heads, each.rows) for each in shown)
    parts = [
        header("feeddrive certify", title, [f"{said[:1].upper()}{said[1:]}."], links),
        f'<section id="result">\n<h2>Result</h2>\n{made}\n</section>\n',
        f'<section id="pictures">\n<h2>Pictures</h2>\n{"".join(picture(each) for each in drawn)}</section>\n',
        f'<section id="outside">\n<h2>What is outside</h2>\n{_list(found.outside)}'
        f"<h3>What is assumed</h3>\n{_list(found.document['assumed'])}</section>\n",
        f'<section id="facts">\n<h2>What was certified</h2>\n'
        f"{definitions([*facts.items(), *_words(found.document)])}\n</section>\n",
    ]
    return page(title, parts)


def _list(texts: Sequence[str]) -> str:
    items = (f"<li>{escape(text[:1].upper() + text[1:])}</li>" for text in texts)
    return f"<ul>{''.join(items)}</ul>"


def _words(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What stands in the certificate in sentences."""
    return [
        ("Claim", document["claim"]),
        ("Theorem", document["theorem"]),
        ("Confidence of the measured lines", f"{100.0 * document['confidence']:g} %, all lines together"),
        ("SHA-256", document["sha256"]),
        ("Check it", f"feeddrive check {FILE}, or with nothing but Python: python check.py {FILE}"),
    ]


def plants_table(found: Certificate) -> Table:
    """Where each plant comes from."""
    rows = [
        [
            each["name"], f"{1e3 * each['dead_time_s']:.4g}",
            str(sum(abs(pole) > 1.0 - 1e-12 for pole in found.loops[each["name"]].plant.poles())), each["source"],
        ]
        for each in found.document["plants"]
    ]  # fmt: skip
    return Table("plants", ["plant", "dead time ms", "poles at or outside |z| = 1", "model"], rows)


def control_table(found: Certificate) -> Table:
    """The parameters of the control, as people read them."""
    control = found.document["control"]
    rows = [[name, f"{value:.6g}", control["units"][name]] for name, value in control["parameters"].items()]
    title = f"control {control['law']}, {found.arithmetic} coefficients, every {found.document['sample_time_ms']:g} ms"
    return Table(title, ["parameter", "value", "unit"], rows)


def _pictures(found: Certificate) -> Iterator[Shown]:
    yield Shown(
        "margin",
        "Margin against the discs",
        "Proven: the blue curve lies above the orange one at every frequency. The dot is where the discs have least "
        "room. Green: where the plant was measured.",
        "Distance |1 + L|/|L| and the radius of the discs over frequency, for each plant.",
        found.plot,
    )
    yield Shown(
        "discs",
        "Discs in the complex plane",
        "Every loop gain that a plant in the discs can have lies in the shaded area; -1 does not.",
        "Nyquist plot of the loop gain with the discs around it, near -1.",
        lambda: plot.certificate_discs(found),
    )
