"""Takes the pictures of the studio in docs/images/: the tour step by step, and each room.

    python docs/draw_studio.py [NAME ...]

It starts `feeddrive studio` and drives it in Chromium as a person would, so that the pictures show the page as it is.
It needs the extras `studio` and `dev`, the built page (make page), and Chromium with a display or without one. All
inputs are bundled or have a seed. Pictures have a palette and at most 150 kB.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

IMAGES = Path(__file__).parent / "images"
WIDE, TABLET = (1280, 800), (768, 1024)
_MOST = 150_000  # bytes
_COLORS = (256, 128, 64, 32)  # as many as fit
_PATIENCE = 240e3  # ms


class Page:
    """A page of a studio of its own."""

    def __init__(self, browser: Any, address: str, size: tuple[int, int]) -> None:
        self.page = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme="light", bypass_csp=True
        ).new_page()
        self.page.goto(address)
        self.settle()

    def settle(self) -> None:
        """All that was asked for is drawn."""
        self.page.wait_for_timeout(300)
        self.page.wait_for_function("() => !document.documentElement.hasAttribute('data-busy')")
        self.page.wait_for_timeout(500)

    def click(self, what: str, then: str = "") -> None:
        """Press something; `then` is there when its work has ended."""
        self.page.click(what)
        if then:
            self.page.wait_for_selector(then, timeout=_PATIENCE)
        self.settle()

    def write(self, what: str, text: str) -> None:
        """Write into a field and leave it."""
        self.page.fill(what, text)
        self.page.keyboard.press("Tab")
        self.settle()

    def see(self, what: str) -> None:
        """Scroll so that something stands at the top, below the panel of the tour."""
        self.page.locator(what).first.evaluate(
            "(each) => document.querySelector('main').scrollBy(0, each.getBoundingClientRect().top - 56 -"
            " (document.getElementById('tour')?.offsetHeight ?? 0))"
        )
        self.settle()

    def take(self, name: str, part: str = "") -> None:
        """A picture of what is seen, or of one element."""
        self.page.mouse.move(0, 0)
        shown = self.page.locator(part).first.screenshot() if part else self.page.screenshot()
        keep(name, shown)


def keep(name: str, shown: bytes) -> None:
    """Write a picture with as many colors as fit. Stops where even the fewest do not."""
    image = Image.open(BytesIO(shown)).convert("RGB")
    for colors in _COLORS:
        packed = BytesIO()
        image.quantize(colors, dither=Image.Dither.NONE).save(packed, "PNG", optimize=True)
        if packed.tell() <= _MOST:
            (IMAGES / f"{name}.png").write_bytes(packed.getvalue())
            print(f"{name}.png: {packed.tell() // 1000} kB, {colors} colors")
            return
    sys.exit(f"{name}: {packed.tell()} bytes are more than {_MOST}: take a smaller part")


@contextmanager
def studio(browser: Any, folder: Path, *words: str, size: tuple[int, int] = WIDE) -> Generator[Page]:
    """A page of `feeddrive studio` with some words, begun in a folder so that its files have short names."""
    command = [sys.executable, "-c", "from feeddrive.cli import main; main()", "studio", *words, "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder) as server:
        try:
            assert server.stdout is not None
            found = re.search(r"http://\S+", server.stdout.readline())
            assert found
            yield Page(browser, found[0], size)
        finally:
            server.terminate()


def tour(browser: Any, folder: Path) -> None:
    """The tour: a picture of each step that shows something new."""
    with studio(browser, folder, "--tour") as page:
        page.page.wait_for_selector("#columns-of-log", timeout=_PATIENCE)
        page.settle()
        page.take("studio_tour_log")
        page.click("#tour-next")
        page.click("#identify", "#take-identified")
        page.see("h2:has-text('Result: ')")
        page.take("studio_tour_model")
        page.click("#take-identified", "#verdict:not(:empty)")
        page.take("studio_tour_today")
        page.click("#tab-optimize")
        page.write("#optimize-field-max_compliance", "6.25")
        page.click("#tune-start", "#room-optimize .verdict")
        page.take("studio_tour_goal")
        page.click("#optimize-accept", "#room-tune:not([hidden]) #verdict:not(:empty)")
        page.take("studio_tour_after")
        page.click("#tab-prove")
        page.click("#prove-certify", "#proof-certificate h2:has-text('Proven.')")
        page.take("studio_tour_proof")
        page.click("#tab-export")
        page.click("#export-target-c", "#export-archive-c")
        page.take("studio_tour_export")


def import_(browser: Any, folder: Path) -> None:
    """A log as it was understood."""
    feeddrive("tour", "--out", str(folder / "tour"))
    with studio(browser, folder, "tour/tour.csv") as page:
        page.page.wait_for_selector("#columns-of-log", timeout=_PATIENCE)
        page.settle()
        page.take("studio_bring")


def scope(browser: Any, folder: Path) -> None:
    """A log that is followed while it is written: 2.4 s that are there, of which the latest window is shown."""
    feeddrive("tour", "--out", str(folder / "tour"))
    with studio(browser, folder, "--follow", "tour/tour.csv") as page:
        page.click("#tab-scope")
        page.click("#scope-follow")
        page.page.wait_for_timeout(3000)
        page.take("studio_scope")


def by_hand(browser: Any, folder: Path) -> None:
    """Tuning by hand: a snapshot, poles, dark, and on a tablet."""
    with studio(browser, folder, "ball_screw") as page:
        page.page.wait_for_selector("#verdict:not(:empty)")
        page.write("[id='number-law.Kp']", "95000")
        page.click("#keep")
        page.write("[id='number-law.Kv']", "130")
        page.take("studio")
        page.click("#dark")
        page.take("studio_dark")
        page.click("#dark")
        page.click("#see summary")
        for name in ("open_loop", "nyquist", "stiffness", "sensitivity", "run"):
            page.page.uncheck(f"#see-{name}")
        for name in ("poles", "damping", "step", "snap"):
            page.page.check(f"#see-{name}")
        page.click("#see summary")
        page.take("studio_poles")
    with studio(browser, folder, "ball_screw", size=TABLET) as page:
        page.page.wait_for_selector("#verdict:not(:empty)")
        page.see("#pictures")
        page.take("studio_tablet")


def measured(browser: Any, folder: Path) -> None:
    """Today's control on measured responses, with bands and coherence."""
    feeddrive("excite", "ball_screw", "--band", "5..1000", "--amplitude", "100", "--out", str(folder / "sent"))
    logs = [str(folder / "sent" / f"simulated_{i}.parquet") for i in (1, 2)]
    feeddrive("frf", *logs, "--out", str(folder / "measured"))
    with studio(browser, folder, "measured/frf.csv") as page:
        page.page.wait_for_selector("#tune-responses", timeout=_PATIENCE)
        page.page.select_option('label:has-text("Today\'s machine") select', "ball_screw")
        page.click("#tune-responses", "#verdict:not(:empty)")
        page.click("#see summary")
        page.page.uncheck("#see-run")
        page.page.check("#see-response")
        page.click("#see summary")
        page.take("studio_measured")


def optimize(browser: Any, folder: Path) -> None:
    """A search that has ended."""
    with studio(browser, folder, "linear_motor") as page:
        page.page.wait_for_selector("#verdict:not(:empty)")
        page.click("#tab-optimize")
        page.click("#tune-start", "#room-optimize .verdict")
        page.take("studio_goal")


def prove(browser: Any, folder: Path) -> None:
    """The circle test of a machine with two axes."""
    with studio(browser, folder, "xy_table", "--axis", "x") as page:
        page.page.wait_for_selector("#verdict:not(:empty)")
        page.click("#tab-prove")
        page.click("#proofs-circle", "#prove-circle")
        page.click("#prove-circle", "#proof-circle .hero")
        page.take("studio_prove")


def program(browser: Any, folder: Path) -> None:
    """A program of five axes that ran, and one of three axes that was corrected."""
    with studio(browser, folder) as page:
        page.click("#tab-program")
        page.click("#program-example", "#program-run-now.main")
        page.click("#program-run-now", "#program-worst")
        page.click("#program-worst li:nth-child(3) button")
        page.take("studio_program")
    with studio(browser, folder, "mill", "--axis", "x") as page:
        page.page.wait_for_selector("#verdict:not(:empty)")
        page.click("#tab-program")
        page.page.select_option("#program-chosen", "circle_diamond_square.ngc")
        page.settle()
        page.click("#program-plan-now", "#program-run-now.main")
        page.click("#program-run-now", "#program-worst")
        page.click("#program-correct-now", "#program-color-corrected")
        page.take("studio_corrected")


def commission(browser: Any, folder: Path) -> None:
    """A virtual drive that is about to move for the first time."""
    with studio(browser, folder, "ball_screw") as page:
        page.page.wait_for_selector("#verdict:not(:empty)")
        page.click("#tab-commission")
        page.click("#commission-start", "#commission-answer-yes:enabled")
        page.click("#commission-step-small_move")
        page.take("studio_commission")
        page.page.keyboard.press("Escape")
        page.page.wait_for_selector("#commission-start", timeout=_PATIENCE)


def compare(browser: Any, folder: Path) -> None:
    """The laws at equal robustness, which takes minutes."""
    with studio(browser, folder, "linear_motor") as page:
        page.page.wait_for_selector("#verdict:not(:empty)")
        page.click("#tab-compare")
        page.click("#compare-start", "#room-compare .folded")
        page.see("#compare-tradeoff")
        page.take("studio_compare")


def chromium() -> str:
    """The browser, with a display or without one."""
    found = (shutil.which(name) for name in ("chromium-headless-shell", "chromium"))
    return next(filter(None, found), None) or sys.exit("apt-get install chromium-headless-shell")


def feeddrive(*words: str) -> None:
    """A command that must succeed."""
    subprocess.run([sys.executable, "-c", "from feeddrive.cli import main; main()", *words], check=True)


DRAWN: dict[str, Callable[[Any, Path], None]] = {
    each.__name__: each
    for each in (tour, import_, scope, by_hand, measured, optimize, prove, program, commission, compare)
}


def main() -> None:
    """Take the pictures that are named, or all."""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        for name in sys.argv[1:] or DRAWN:
            with tempfile.TemporaryDirectory() as folder:
                DRAWN[name](browser, Path(folder))


if __name__ == "__main__":
    main()
