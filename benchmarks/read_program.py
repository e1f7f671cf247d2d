"""Lines of a part program that are read in a second: plain G1 lines of three coordinates, from file to moves.

    python benchmarks/read_program.py            # 50,000 lines, best of three

Processor time of this process alone.  tests/path/test_part_program_input.py counts the lines of Python that each costs.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from feeddrive.path.program.reading import read_program


def main() -> None:
    """Write the program, read it three times, and print the best."""
    lines = int(sys.argv[1]) if len(sys.argv) > 1 else 50_000
    body = "".join(f"G1 X{i % 977 * 0.01:.4f} Y{i % 1013 * 0.013:.4f} Z{i % 31 * 0.1:.3f}\n" for i in range(lines))
    taken = list[float]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "program.ngc"
        path.write_text(f"G21 G90 G64 P0.01\nF1000\n{body}M2\n", encoding="utf-8")
        for _ in range(3):
            begun = time.process_time()
            moves = sum(1 for _ in read_program(path))
            taken.append(time.process_time() - begun)
    print(f"{moves:,} moves; {lines / min(taken):,.0f} lines/s, {60e-6 * lines / min(taken):.2f} million a minute")


if __name__ == "__main__":
    main()
