"""Processor time of commands as processes: what a user waits for with the bundled inputs.

    python benchmarks/commands.py [--repeats 5] [--before PATH] [--only WORD]

User and system time of the whole process, least and median; modules compiled before (`python -m compileall -q src`), as
pip leaves them, and machine code on the disk, from as many runs before as it takes until none is made again.
`--before` names the folder `src` of another version, whose runs alternate with those of this one.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

SOURCE = Path(__file__).parents[1] / "src"
COMMANDS = (
    "--help",
    "plan --help",
    "run --help",
    "tune --help",
    "identify --help",
    "studio --help",
    "plan absent.ngc --machine mill",
    "run absent.toml",
    "identify absent.csv",
    "tune emps --starts x",
    "channels run.csv --out channels.toml",
    "adjust ball_screw --set law.Kp=52000 --out adjusted",
    "export linear_motor --target c --out exported",
    "certify linear_motor --out certified",
    "check certified/certificate.json",
    "run ball_screw --out ran",
    "circle xy_table --out circle",
    "tune ball_screw --box none --out tuned",
    "tune ball_screw --out tuned_box",
    "demo --out demo",
)
WARMING = 3  # runs before


def spent(words: list[str], source: Path, folder: Path) -> float:
    """User and system time of a command, s."""
    cache = folder / "cache"
    cache.mkdir(mode=0o700, exist_ok=True)
    env = {**os.environ, "PYTHONPATH": str(source), "FEEDDRIVE_CACHE": str(cache), "PYTHONSAFEPATH": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    code = "import feeddrive" if words == ["import"] else "from feeddrive.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, *words], env=env, cwd=folder, capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode < 0 or b"Traceback" in done.stderr:
        raise SystemExit(f"{' '.join(words)}: {done.stderr.decode()[-2000:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(words: list[str], sources: list[Path], folders: list[Path], repeats: int) -> list[list[float]]:
    """The times of a command by version, in turn."""
    took = [list[float]() for _ in sources]
    for turn in range(WARMING + repeats):
        for place, (source, folder) in enumerate(zip(sources, folders, strict=True)):
            seconds = spent(words, source, folder)
            if turn >= min(WARMING, repeats):
                took[place].append(seconds)
    return took


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    sources = [SOURCE] if asked.before is None else [asked.before.resolve(), SOURCE]
    with tempfile.TemporaryDirectory() as root:
        folders = [Path(root) / str(k) for k in range(len(sources))]
        for folder in folders:
            folder.mkdir()
            rows = (f"{k},{0.1 * k:.1f},{0.1 * k - 0.02:.2f}\n" for k in range(4000))
            (folder / "run.csv").write_text("t [ms],x_cmd_mm,x_fb_mm\n" + "".join(rows), encoding="utf-8")
        heads = ["command", *(["before"] if len(sources) > 1 else []), "now"]
        print(f"| {' | '.join(heads)} |\n|---{'|--:' * len(sources)}|")
        for text in [str(each) for each in ("import", *COMMANDS)]:
            if asked.only in text:
                took = measured([*text.split()], sources, folders, asked.repeats)
                cells = [f"{min(times):.2f} ({median(times):.2f})" for times in took]
                print(f"| `{text}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
