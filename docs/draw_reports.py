"""Makes the gallery of reports, docs/reference/gallery.md: runs each command on bundled inputs and takes its report.

    python docs/draw_reports.py [NAME ...]     some minutes; without names all, and the page

It needs the extra `dev` and Chromium. Pictures are the top of the report as a browser shows it.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from draw_studio import chromium, keep
from playwright.sync_api import sync_playwright

PAGE = Path(__file__).parent / "reference/gallery.md"
_SIZE = {"width": 1100, "height": 760}


class Shown(NamedTuple):
    """A report: its name, the commands that make it (the last one writes into `out/`), and what it answers."""

    name: str
    title: str
    commands: tuple[str, ...]
    answers: str
    explained: str


REPORTS = (
    Shown(
        "demo",
        "Several controls, the same motion",
        ("feeddrive demo --out out",),
        "What does each step of the cascade bring on a measured ball-screw axis?",
        "[Your first axis](../tutorials/first-axis.md)",
    ),
    Shown(
        "identify",
        "A model from a log",
        ("feeddrive tour --out tour", "feeddrive identify tour/tour.csv --out out"),
        "Which mass, friction and dead time does the log show, how sure is that, and what is left over?",
        "[Identification](../how_to/identification.md)",
    ),
    Shown(
        "frf",
        "Frequency responses",
        (
            "feeddrive excite ball_screw --band 5..1000 --amplitude 400 --out sent",
            "feeddrive frf sent/simulated_1.parquet sent/simulated_2.parquet --out out",
        ),
        "Where are the resonances, and how far may each line be trusted?",
        "[Frequency responses](../how_to/identification.md#frequency-responses)",
    ),
    Shown(
        "tune",
        "Gains within limits",
        ("feeddrive tune ball_screw --goal rope-snap --max-ms 2 --box none --out out",),
        "Which gains and filters are best within the limits, what do they cost, and what holds them back?",
        "[Tuning](../how_to/tuning.md)",
    ),
    Shown(
        "certify",
        "A certificate",
        ("feeddrive certify ball_screw --float32 --out out",),
        "For which plants is the rounded control proven to be stable, and by how much?",
        "[Certificates](../explanation/certificate.md)",
    ),
    Shown(
        "plan",
        "A part program",
        ("feeddrive plan blade --machine trunnion_ac --out out",),
        "How long does the program take, where and why does the feed fall, and which limit holds it?",
        "[From a part program to setpoints](../how_to/plan.md)",
    ),
    Shown(
        "mill",
        "A machine that cuts",
        ("feeddrive demo mill --out out",),
        "How far is the tool from its path under each law, where, and why?",
        "[The machine that cuts](../how_to/machining.md)",
    ),
    Shown(
        "circle",
        "A circle test",
        ("feeddrive circle xy_table --out out",),
        "How round is the circle after ISO 230-4, and which fault draws how much of the deviation?",
        "[Circle test](../how_to/machining.md#circle-test)",
    ),
    Shown(
        "setpath",
        "A corrected part program",
        ("feeddrive setpath circle_diamond_square --law P-PI --out out",),
        "What does friction that is fed forward by the plan gain on this part, before it is run?",
        "[A part program, corrected](../how_to/setpath.md)",
    ),
    Shown(
        "sweep",
        "A series of machines",
        ("feeddrive sweep ball_screw_series --workers 2 --out out",),
        "How many machines of a series keep their limits under one control, and what decides it?",
        "[What a study says](../explanation/yield.md)",
    ),
)


def page() -> str:
    """The page, from the list above."""
    lines = [
        "# Gallery of reports",
        "",
        "Each command writes a report that opens without a network. These are the tops of some, from bundled inputs; "
        "`docs/draw_reports.py` takes them again and writes this page. The page on which an axis is tuned has its own "
        "[gallery](studio_gallery.md).",
        "",
    ]
    for each in REPORTS:
        lines += [f"## {each.title}", "", f"{each.answers} {each.explained}", ""]
        lines += ["```sh", *each.commands, "```", ""]
        lines += [f"![Report: {each.title}](../images/report_{each.name}.png)", ""]
    return "\n".join(lines).rstrip() + "\n"


def draw(browser: Any, shown: Shown, folder: Path) -> None:
    """Run the commands in a folder, and take the picture."""
    for line in shown.commands:
        words = shlex.split(line)[1:]
        asked = [sys.executable, "-c", "from feeddrive.cli import main; main()", *words]
        done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1):  # 1: the command advises against its result, and the report says so
            sys.exit(f"{line}\n{done.stdout}{done.stderr}")
    view = browser.new_context(viewport=_SIZE, color_scheme="light").new_page()
    view.goto((folder / "out/report.html").as_uri())
    view.wait_for_timeout(500)
    keep(f"report_{shown.name}", view.screenshot())


def main() -> None:
    """Draw the reports that are named, or all with the page."""
    if not sys.argv[1:]:
        PAGE.write_text(page(), encoding="utf-8")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        for each in REPORTS:
            if not sys.argv[1:] or each.name in sys.argv[1:]:
                with tempfile.TemporaryDirectory() as folder:
                    draw(browser, each, Path(folder))


if __name__ == "__main__":
    main()
