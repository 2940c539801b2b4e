"""The documentation as a site: self-contained, and usable from a disk.

`mkdocs build --strict` fails when a page is missing in the navigation and when a link or its anchor leads nowhere.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

from tests.samples.checkout import ROOT

pytest.importorskip("mkdocs", reason="the site is built by mkdocs: pip install 'kit1000[docs]'")
pytestmark = pytest.mark.slow

CONFIG = ROOT / "mkdocs.yml"
LOADED = {"script": "src", "img": "src", "source": "src", "iframe": "src", "video": "src", "link": "href"}
"""Tags of HTML that load what they name, and the attribute that names it."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make site` builds it, without the leaderboard; a broken link ends the build."""
    built = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-f", str(CONFIG), "-d", str(built)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    assert done.returncode == 0, done.stdout + done.stderr
    return built


class Loaded(HTMLParser):
    """What a page loads."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = {key: value for key, value in attrs if value is not None}
        if LOADED.get(tag) in named and named.get("rel") not in ("canonical", "prev", "next"):
            self.targets.append(named[LOADED[tag]])


def pages(site: Path) -> list[Path]:
    """Every page but 404.html, whose links only a server can resolve, and pictures, which are programs of viser."""
    pictures = site / "pictures"
    return sorted(page for page in site.rglob("*.html") if page.name != "404.html" and page.parent != pictures)


def test_nothing_external_is_loaded(site: Path) -> None:
    for page in pages(site):
        for target in Loaded(page).targets:
            assert not urlsplit(target).netloc, f"{page.name} loads {target}"
            assert (page.parent / unquote(urlsplit(target).path)).is_file(), f"{page.name}: {target}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(@import|url\()\s*[\"']?(https?:)?//", sheet.read_text(encoding="utf-8")), sheet.name


def test_tables_and_lists_are_rendered(site: Path) -> None:
    """A line that GitHub takes for a table or a list, and Python's Markdown for text."""
    for page in pages(site):
        stray = re.findall(r"^(?:<p>)?(?:\| |- |\d\. ).*$", page.read_text(encoding="utf-8"), re.MULTILINE)
        stray = [line for line in stray if "<span" not in line]  # highlighted code
        assert not stray, f"{page.name}: {stray[:3]}"


def test_the_search_knows_every_page(site: Path) -> None:
    index = json.loads((site / "search/search_index.json").read_text(encoding="utf-8"))
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    assert {page.relative_to(site).as_posix() for page in pages(site)} <= found


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """The system's Chromium, driven by Playwright."""
    playwright = pytest.importorskip("playwright.sync_api")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("no Chromium on this machine: make browser")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


def test_a_page_opened_from_disk_can_be_searched_without_errors(site: Path, chromium: Any) -> None:
    page = chromium.new_page(viewport={"width": 1280, "height": 800})
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto((site / "index.html").as_uri())
    page.locator(".md-search__input").press_sequentially("penetration")
    page.locator(".md-search-result__link[href*='metrics.html']").first.wait_for()
    assert not complaints
    page.close()


@pytest.mark.slow
def test_a_page_fits_on_a_phone(site: Path, chromium: Any) -> None:
    page = chromium.new_page(viewport={"width": 390, "height": 800})
    for unseen in ("**/*.png", "**/*.js", "**/search_index*"):  # pictures shrink to the page; scripts move nothing
        page.route(unseen, lambda route: route.abort())
    for path in pages(site):
        page.goto(path.as_uri())
        wide = page.evaluate("document.documentElement.scrollWidth")
        assert wide <= 390, f"{path.name} is {wide} px wide"
    page.close()
