"""How many part programs are refused, and why.

    python benchmarks/coverage.py FOLDER ... [--tools TABLE] [--parameters NAME=VALUE,..] [--front-end auto]

Every file below the folders is read, by default by the own reader, and its moves become segments of all nine axes;
nothing is planned.  Files with the same content count once.  Refusals are listed by their reason, with one of the
files, and with the number of those that LinuxCNC's interpreter `rs274` refuses too.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any

from feeddrive.language.errors import FeeddriveError
from feeddrive.path.geometry.segments import chains
from feeddrive.path.program.reading import read_program

MOST_AGAIN = 300_000  # lines that loops may repeat: a program that never ends is refused in seconds


def refusal(path: Path, **options: Any) -> str:
    """Return the reason why a program is refused; empty if it is not."""
    try:
        moves = read_program(path, **options)
        for _ in chains(moves, "XYZABCUVW"):
            pass
    except FeeddriveError as error:
        return str(error).removeprefix(f"{path}, ")
    return ""


def main() -> None:
    """Read all programs, and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--dialect", default="linuxcnc")
    parser.add_argument("--front-end", default="own", choices=("own", "auto"))
    parser.add_argument("--tools", type=Path)
    parser.add_argument("--parameters", default="")
    parser.add_argument("--suffix", nargs="+", default=[".ngc", ".gcode", ".nc"])
    given = parser.parse_args()
    programs: dict[bytes, Path] = {}
    for folder in given.folders:
        for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in given.suffix):
            if path.is_file():
                programs.setdefault(hashlib.sha256(path.read_bytes()).digest(), path)
    pairs = [entry.split("=") for entry in given.parameters.split(",") if entry]
    parameters = {name: float(value) for name, value in pairs} or None
    reasons: dict[str, list[tuple[Path, str, bool]]] = defaultdict(list)
    for path in programs.values():
        options = {"tools": given.tools, "most_again": MOST_AGAIN}
        reason = refusal(path, front_end=given.front_end, dialect=given.dialect, **options)
        # rs274 takes no parameters from outside
        if reason and parameters:
            reason = refusal(path, front_end="own", dialect=given.dialect, parameters=parameters, **options)
        if reason:
            too = given.dialect == "linuxcnc" and shutil.which("rs274") is not None
            too = too and bool(refusal(path, front_end="rs274", **options))
            # the same word at other places is the same reason
            reasons[re.sub(r"^.*line \d+, column \d+: ", "", reason)[:60]].append((path, reason, too))
    files = [file for rows in reasons.values() for file in rows]
    both = sum(too for *_, too in files)
    share = len(files) / max(len(programs), 1)
    print(f"{len(programs)} programs, {len(files)} refused ({share:.1%}), {both} by rs274 too")
    for rows in sorted(reasons.values(), key=lambda rows: -len(rows)):
        path, reason, _ = rows[0]
        print(f"{len(rows):4} {sum(too for *_, too in rows):4}  {path.name}: {reason[:170]}")


if __name__ == "__main__":
    main()
