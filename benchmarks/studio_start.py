"""How soon the studio can be used: from the command to its address, and from the address to the first picture.

    python benchmarks/studio_start.py

The command is started five times with the bundled ball screw, each time as a process of its own and with a browser
page that has nothing in its cache. The first time begins with the process and ends with the line that has the address.
The second one is the browser's own: it begins with the navigation to that address, and ends with the first line that
is drawn on a canvas, and with the last one of the first second without another.

Bars: the address in < 3 s; the first picture in <= 1 s.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
from playwright.sync_api import Browser, sync_playwright

_MACHINE, _ROUNDS = "ball_screw", 5
_DRAWN = """
window.drawn = [];  // times of lines and areas on any canvas, ms since the navigation
for (const name of ['stroke', 'fill']) {
  const real = CanvasRenderingContext2D.prototype[name];
  CanvasRenderingContext2D.prototype[name] = function (...given) {
    window.drawn.push(performance.now());
    return real.apply(this, given);
  };
}
"""


def main() -> None:
    """Print the figures, one a line."""
    chromium = shutil.which("chromium") or sys.exit("apt-get install chromium")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        found = np.array([measured(browser) for _ in range(_ROUNDS)])
    for what, row, unit in zip(("address", "first picture", "all pictures"), found.T, ("s", "ms", "ms"), strict=True):
        print(f"{what}: median {np.median(row):.3g} {unit}, largest {np.max(row):.3g} {unit} of {_ROUNDS}")


def measured(browser: Browser) -> tuple[float, float, float]:
    """Time to the address, s; from there to the first drawing and to the last, ms."""
    command = [sys.executable, "-c", "from feeddrive.cli import main; main()", "studio", _MACHINE]
    begun = time.perf_counter()
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen([*command, "--no-browser", "--folder", folder], stdout=subprocess.PIPE, text=True) as server,
    ):
        try:
            assert server.stdout is not None
            found = re.search(r"http://\S+", server.stdout.readline())
            took = time.perf_counter() - begun
            assert found
            context: Any = browser.new_context(viewport={"width": 1280, "height": 720}, bypass_csp=True)
            page = context.new_page()
            page.add_init_script(_DRAWN)
            page.goto(found[0])
            page.wait_for_selector("#verdict:not(:empty)")
            page.wait_for_timeout(1000)
            drawn = page.evaluate("window.drawn")
            context.close()
        finally:
            server.terminate()
    return took, drawn[0], drawn[-1]


if __name__ == "__main__":
    main()
