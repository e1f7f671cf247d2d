"""Records the page of the studio at work for the README: docs/images/at_work.webp, an animation of less than 1 MB.

    python docs/draw_recording.py

It drives the real page as `draw_studio.py` does and needs the same: the extras `studio` and `dev`, the built page
(make page), and Chromium. The bundled ball screw is tuned by hand until a limit is exceeded, then optimized, proven
and exported.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from draw_studio import IMAGES, WIDE, Page, chromium, studio
from PIL import Image
from playwright.sync_api import sync_playwright

TARGET = IMAGES / "at_work.webp"
_MOST = 1_000_000  # bytes
_COLORS = (128, 64, 32)  # as many as fit
_STEP, _STAY = 180, 2200  # ms that a frame of a drag and one to be read are shown
# velocity gain (N s/m) and position gain (1/s), step by step
_BY_HAND = {"law.Kp": (72e3, 76e3, 80e3, 84e3, 88e3, 92e3, 96e3, 1e5), "law.Kv": (105, 110, 115, 120, 125, 130)}


class Film:
    """The frames so far, each with the time in ms that it is shown."""

    def __init__(self) -> None:
        self.frames: list[Image.Image] = []
        self.times: list[int] = []

    def take(self, page: Page, time: int) -> None:
        """Add what the page shows."""
        page.page.mouse.move(0, 0)
        self.frames.append(Image.open(BytesIO(page.page.screenshot())).convert("RGB"))
        self.times.append(time)

    def packed(self, colors: int) -> bytes:
        """The animation, lossless: letters stay sharp."""
        file = BytesIO()
        first, *others = (frame.quantize(colors, dither=Image.Dither.NONE).convert("RGB") for frame in self.frames)
        first.save(
            file, "WEBP", save_all=True, append_images=others, duration=self.times, loop=0, lossless=True, method=6
        )
        return file.getvalue()


def drag(film: Film, page: Page, name: str, values: Sequence[float]) -> None:
    """One parameter, step by step."""
    for value in values:
        page.page.fill(f"[id='number-{name}']", f"{value:g}")
        page.page.keyboard.press("Tab")
        page.page.wait_for_timeout(100)
        page.page.wait_for_function("() => !document.documentElement.hasAttribute('data-busy')")
        page.page.wait_for_timeout(100)
        film.take(page, _STEP)
    film.times[-1] = _STAY


def record(page: Page) -> Film:
    """Tune by hand, optimize, prove, export."""
    film = Film()
    page.page.wait_for_selector("#verdict:not(:empty)")
    page.settle()
    film.take(page, _STAY)
    for name, values in _BY_HAND.items():
        drag(film, page, name, values)
    page.click("#tab-optimize")
    page.click("#tune-start", "#room-optimize .verdict")
    film.take(page, _STAY)
    page.click("#optimize-accept", "#room-tune:not([hidden]) #verdict:not(:empty)")
    film.take(page, _STAY)
    page.click("#tab-prove")
    page.click("#prove-certify", "#proof-certificate h2:has-text('Proven.')")
    film.take(page, _STAY)
    page.click("#tab-export")
    film.take(page, _STAY)
    return film


def main() -> None:
    """Record, and stop where the file is too large."""
    with sync_playwright() as driver, tempfile.TemporaryDirectory() as folder:
        browser = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        with studio(browser, Path(folder), "ball_screw", size=WIDE) as page:
            film = record(page)
    for colors in _COLORS:
        packed = film.packed(colors)
        if len(packed) <= _MOST:
            TARGET.write_bytes(packed)
            print(f"{TARGET.name}: {len(packed) // 1000} kB, {len(film.frames)} frames, {colors} colors")
            return
    sys.exit(f"{len(packed)} bytes are more than {_MOST}: record fewer steps")


if __name__ == "__main__":
    main()
