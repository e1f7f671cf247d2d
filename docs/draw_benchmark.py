"""Remakes the tables of rules 2 in docs/reference/benchmark.md, and docs/images/benchmark.png, from the stored designs.

python docs/draw_benchmark.py [--kept FOLDER]     five to six minutes of processor time

FOLDER holds finished cases, to go on after a stop.
"""

import argparse
import os
from pathlib import Path

from feeddrive.benchmark.benchmark import score
from feeddrive.benchmark.report import markdown
from feeddrive.benchmark.rules import read_rules
from feeddrive.evaluation import Engine, Folder

PAGE = Path(__file__).parent / "reference/benchmark.md"
BEGIN, END = "<!-- tables of docs/draw_benchmark.py -->\n", "<!-- end of the tables -->\n"


def main() -> None:
    """Judge all stored designs, and replace tables and picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kept", type=Path)
    asked = parser.parse_args()
    store = None if asked.kept is None else Folder(asked.kept)
    found = score(read_rules(2), engine=Engine.of(None, store=store))
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}\n{markdown(found)}\n{END}{after}", encoding="utf-8")
    # no SVG: two thousand dots weigh 0.4 MB there
    found.plot().savefig(PAGE.parent / "images" / "benchmark.png", dpi=120, metadata={"Software": None})
    print(f"{sum(os.times()[:4]):.0f} s of processor time")


if __name__ == "__main__":
    main()
