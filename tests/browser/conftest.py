"""A real browser, headless, that can reach nothing but this machine; skipped with a reason where there is none.

``make browser`` installs one. `TSPSLAM_BROWSER` names another program of the Chromium family.
"""

import os
import shutil
from dataclasses import dataclass, field

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]  # fmt: skip
LOCAL = ("file:", "data:", "blob:", "about:", "http://127.0.0.1:", "ws://127.0.0.1:", "http://localhost:")


def find_browser():
    """Path of a browser, or None."""
    named = os.environ.get("TSPSLAM_BROWSER")
    return named or next((found for name in NAMES if (found := shutil.which(name))), None)


@dataclass
class Heard:
    """What a page did besides being shown."""

    errors: list = field(default_factory=list)
    requests: list = field(default_factory=list)

    def note(self, line):
        """Take an error; none is a picture that viser's page lets go while it moves its panel."""
        is_let_go = "ERR_FILE_NOT_FOUND" in line.text and line.location.get("url", "").startswith("blob:")
        if line.type == "error" and not is_let_go:
            self.errors.append(line.text)

    @property
    def foreign(self):
        """Requests that would have left this machine."""
        return [url for url in self.requests if not url.startswith(LOCAL)]


@pytest.fixture(scope="session")
def browser():
    """Chromium, headless."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright: pip install playwright")
    program = find_browser()
    if program is None:
        pytest.skip("no browser: make browser installs Chromium, or TSPSLAM_BROWSER names one")
    with playwright.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=program, args=QUIET)
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser):
    """Open an address, with the network cut but for this machine; gives the page and what was heard of it."""
    contexts = []

    def opened(address, *, width=1280, height=900, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page, heard = context.new_page(), Heard()
        page.on("console", heard.note)
        page.on("pageerror", lambda error: heard.errors.append(str(error)))
        page.on("request", lambda request: heard.requests.append(request.url))
        page.on("websocket", lambda socket: heard.requests.append(socket.url))
        page.route("**/*", lambda route: route.continue_() if route.request.url.startswith(LOCAL) else route.abort())
        page.goto(str(address) if "://" in str(address) else f"file://{os.path.abspath(address)}")
        return page, heard

    yield opened
    for context in contexts:
        context.close()
