"""How many part programs are refused, and why.

    python benchmarks/coverage.py FOLDER ... [--dialect linuxcnc] [--suffix .ngc .gcode .nc]

Every file below the folders is read by the own reader, and its moves become segments of all nine axes; nothing is
planned.  Files with the same content count once.  Refusals are listed by their reason, with one of the files.
"""

from __future__ import annotations

import argparse
import hashlib
import re
from collections import defaultdict
from pathlib import Path

from feeddrive.language.errors import FeeddriveError
from feeddrive.path.geometry.segments import chains
from feeddrive.path.program.reading import read_program

MOST_AGAIN = 300_000  # lines that loops may repeat: a program that never ends is refused in seconds


def refusal(path: Path, dialect: str) -> str:
    """Return the reason why a program is refused; empty if it is not."""
    try:
        moves = read_program(path, front_end="own", dialect=dialect, most_again=MOST_AGAIN)  # type: ignore[arg-type]
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
    parser.add_argument("--suffix", nargs="+", default=[".ngc", ".gcode", ".nc"])
    given = parser.parse_args()
    programs: dict[bytes, Path] = {}
    for folder in given.folders:
        for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in given.suffix):
            if path.is_file():
                programs.setdefault(hashlib.sha256(path.read_bytes()).digest(), path)
    reasons: dict[str, list[tuple[Path, str]]] = defaultdict(list)
    for path in programs.values():
        if reason := refusal(path, given.dialect):
            # the same word at other places is the same reason
            reasons[re.sub(r"^line \d+, column \d+: ", "", reason)[:100]].append((path, reason))
    refused = sum(map(len, reasons.values()))
    print(f"{len(programs)} programs, {refused} refused ({refused / max(len(programs), 1):.1%})")
    for _, files in sorted(reasons.items(), key=lambda item: -len(item[1])):
        print(f"{len(files):4}  {files[0][0]}: {files[0][1][:160]}")


if __name__ == "__main__":
    main()
