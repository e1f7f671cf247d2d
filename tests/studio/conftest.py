"""A real server with the built page, and a real browser: Debian's Chromium, headless."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

import forked_jobs
from feeddrive.studio import jobs
from feeddrive.studio.server import PAGE
from studio_server import CHROMIUM, cookie_of

TESTS = Path(__file__).parents[1]


class Opened:
    """A page of a running server, what it said on its console, and which requests it made."""

    def __init__(self, context: Any, address: str) -> None:
        self.context = context
        self.page = self.context.new_page()
        self.said = list[str]()
        self.requests = list[str]()
        self.page.on("console", lambda each: self.said.append(each.text) if each.type == "error" else None)
        self.page.on("pageerror", lambda each: self.said.append(str(each)))
        self.page.on("request", lambda each: self.requests.append(each.url))
        self.page.goto(address)

    def go(self, room: str) -> None:
        """Open a room and wait for what the server says of it."""
        self.page.click(f"#tab-{room}")
        self.settled()

    def settled(self) -> None:
        """No request is under way."""
        self.page.wait_for_timeout(60)
        self.page.locator("html:not([data-asked])").wait_for(state="attached")
        self.page.wait_for_timeout(120)

    def ended(self, seconds: float = 120.0) -> str:
        """The state of the job, once it has ended."""
        self.page.wait_for_timeout(300)
        ended = ", ".join(f"#job[data-state={each}]" for each in ("done", "failed", "canceled"))
        self.page.locator(ended).wait_for(state="attached", timeout=1e3 * seconds)
        self.settled()
        return str(self.page.get_attribute("#job", "data-state"))

    def barriers(self) -> list[tuple[str, str]]:
        """What keeps people from using the page as it is shown now, as rule and place: serious violations of WCAG."""
        axe = pytest.importorskip("axe_core_python.sync_playwright", reason="NOT TESTED: pip install axe-core-python")
        # all rules are applied; what was passed is not listed, element by element
        found = axe.Axe().run(self.page, options={"resultTypes": ["violations"]})
        return [
            (each["id"], str(node["target"]))
            for each in found["violations"]
            if each["impact"] in ("serious", "critical")
            for node in each["nodes"]
        ]


class Studio:
    """`feeddrive studio` as a person starts it, and the browser."""

    def __init__(self, browser: Any, folder: Path, *words: str) -> None:
        self.browser, self.folder = browser, folder
        command = [sys.executable, "-c", "from feeddrive.cli.commands import app; app()", "studio", *words]
        paths = [str(TESTS / "empty_pictures"), str(TESTS), *filter(None, [os.environ.get("PYTHONPATH")])]
        self.server = subprocess.Popen(
            [*command, "--no-browser", "--folder", str(folder)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
        )
        assert self.server.stdout is not None
        found = re.search(r"http://\S+", self.server.stdout.readline())
        assert found, "no address was printed"
        self.token = found[0]
        self.address = found[0].partition("?")[0]

    def admit(self, context: Any) -> Any:
        """A browser context with the cookie; the first time the token that was printed is changed into it."""
        name, _, value = self._cookie.partition("=")
        context.add_cookies([{"name": name, "value": value, "url": self.address, "sameSite": "Strict"}])
        return context

    @cached_property
    def _cookie(self) -> str:
        return cookie_of(self.token)

    def open(self, width: int = 1280, height: int = 720) -> Opened:
        """Another page of its own."""
        context = self.browser.new_context(viewport={"width": width, "height": height})
        return Opened(self.admit(context), self.address)

    def close(self) -> None:
        """End the server as Ctrl-C does."""
        self.server.terminate()
        self.server.wait(20.0)
        if self.server.stdout is not None:
            self.server.stdout.close()


@pytest.fixture(scope="session", autouse=True)
def _forked() -> Iterator[None]:
    """Jobs of pages that have no server of their own are forked, with what they need and without pictures."""
    with forked_jobs.forked(jobs):
        yield


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium; tests that need it say loudly where it, its driver or the built page is missing."""
    playwright = pytest.importorskip("playwright.sync_api", reason="NOT TESTED: pip install playwright")
    if CHROMIUM is None:
        pytest.skip("NOT TESTED: the page needs a browser: apt-get install chromium-headless-shell")
    if not (PAGE / "index.html").is_file():
        pytest.skip("NOT TESTED: the page is not built: make page")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture(scope="module")
def studio(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    """A server for the machine with two axes."""
    made = Studio(browser, tmp_path_factory.mktemp("studio"), "xy_table", "--axis", "x")
    yield made
    made.close()


@pytest.fixture
def served(browser: Any, tmp_path: Path) -> Iterator[Callable[..., Studio]]:
    """Starts servers of a test by the words of the command line, and ends them."""
    made = list[Studio]()

    def start(*words: str) -> Studio:
        made.append(Studio(browser, tmp_path / f"studio_{len(made)}", *words))
        return made[-1]

    yield start
    for each in made:
        each.close()
