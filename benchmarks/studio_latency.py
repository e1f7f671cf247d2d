"""How soon the pictures of the studio follow a slider, in a real browser with software rendering.

    python benchmarks/studio_latency.py

A real mouse drags a slider of the room `tune`. t0 is the time stamp of the browser's own event of the pointer; the end
is the last call that draws a line or fills an area on any canvas before the next event. First 40 single steps, each
after the pictures have come to rest; then 120 moves, each 16 ms after the one before, or as soon as the browser has
taken that one: Playwright's mouse waits for the frame in which it was handled.

Bars: single steps, median <= 40 ms, 95th percentile <= 70 ms; in the drag >= 24 frames/s, with every step drawn that
was sent, and nothing left to be drawn after it.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time

import numpy as np
from playwright.sync_api import sync_playwright

_MACHINE = "ball_screw"
_STEPS, _MOVES, _APART = 40, 120, 16  # single steps; moves of the drag, and ms between two of them
_COUNTING = """
window.moved = [];   // [time of the event, time of the last drawing after it]
window.frames = [];  // times of animation frames in which something was drawn
let drawn = false;
for (const name of ['stroke', 'fill', 'fillText']) {
  const real = CanvasRenderingContext2D.prototype[name];
  CanvasRenderingContext2D.prototype[name] = function (...given) {
    drawn = true;
    if (window.moved.length) window.moved.at(-1)[1] = performance.now();
    return real.apply(this, given);
  };
}
const frame = () => {
  if (drawn) window.frames.push(performance.now());
  drawn = false;
  requestAnimationFrame(frame);
};
requestAnimationFrame(frame);
window.asked = 0;    // steps that the server was asked for: each answer is drawn
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  if (text.includes('tune.move')) window.asked += 1;
  return send.call(this, text);
};
let pointer = 0;
document.addEventListener('pointermove', (event) => { pointer = event.timeStamp; }, true);
document.addEventListener('input', () => window.moved.push([pointer, 0]), true);
"""


def main() -> None:
    """Print the figures, one a line."""
    chromium = shutil.which("chromium") or sys.exit("apt-get install chromium")
    command = [sys.executable, "-c", "from feeddrive.cli.commands import app; app()", "studio", _MACHINE]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen([*command, "--no-browser", "--folder", folder], stdout=subprocess.PIPE, text=True) as server,
    ):
        try:
            assert server.stdout is not None
            found = re.search(r"http://\S+", server.stdout.readline())
            assert found
            with sync_playwright() as driver:
                browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
                page = browser.new_context(viewport={"width": 1280, "height": 1400}, bypass_csp=True).new_page()
                page.add_init_script(_COUNTING)
                page.goto(found[0])
                page.wait_for_selector("#verdict:not(:empty)")
                page.wait_for_timeout(1000)
                measure(page)
        finally:
            server.terminate()


def measure(page: object) -> None:
    box = page.locator("#numbers-list input[type=range]").nth(1).bounding_box()  # type: ignore[attr-defined]
    y, x = box["y"] + box["height"] / 2, box["x"] + box["width"] / 2
    mouse = page.mouse  # type: ignore[attr-defined]
    mouse.move(x, y)
    mouse.down()
    for i in range(_STEPS):
        mouse.move(x + 2 + i % 20, y)
        page.wait_for_timeout(200)  # type: ignore[attr-defined]
    moved = np.array([each for each in json.loads(page.evaluate("JSON.stringify(window.moved)")) if each[1]])  # type: ignore[attr-defined]
    took = moved[:, 1] - moved[:, 0]
    print(
        f"single steps: {took.size} drawn, median {np.median(took):.1f} ms, "
        f"95th percentile {np.percentile(took, 95):.1f} ms"
    )
    page.evaluate("window.moved = []; window.frames = []; window.asked = 0")  # type: ignore[attr-defined]
    for i in range(_MOVES):
        began = time.perf_counter()
        mouse.move(x + 30.0 * np.sin(0.13 * i), y)
        if (left := _APART - 1e3 * (time.perf_counter() - began)) > 0.0:
            page.wait_for_timeout(left)  # type: ignore[attr-defined]
    last = page.evaluate("performance.now()")  # type: ignore[attr-defined]
    page.wait_for_timeout(1500)  # type: ignore[attr-defined]
    frames = np.array(page.evaluate("window.frames"))  # type: ignore[attr-defined]
    steps, drawn = page.evaluate("[window.moved.length, window.asked]")  # type: ignore[attr-defined]
    during = frames[frames <= last]
    rate = (during.size - 1) / (during[-1] - during[0]) * 1e3
    print(f"drag: {steps} steps of the slider, {drawn} of them drawn, {rate:.1f} frames/s")
    print(f"after the drag: the last drawing {max(frames[-1] - last, 0.0):.0f} ms after the last move")
    mouse.up()


if __name__ == "__main__":
    main()
