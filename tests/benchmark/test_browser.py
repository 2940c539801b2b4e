"""The leaderboard pages in a real browser: sorting, filters, tabs, narrow and wide windows, light and dark."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from benchmark.pages import build
from kit1000.queries.tracks import TRACKS
from tests.samples.board import SNAPS, write_board

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
WIDTHS = (390, 1280)
READABLE = 4.5  # contrast of text, by WCAG AA


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pages of all made-up methods."""
    folder = tmp_path_factory.mktemp("board")
    build(write_board(folder / "submissions"), folder / "site")
    return folder / "site"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium, without a window."""
    if CHROMIUM is None:
        pytest.skip("no chromium on the search path: install one to see the pages as a reader does")
    with sync_playwright() as play:
        opened = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def opened(browser: Browser, site: Path) -> Iterator[Callable[..., Page]]:
    """Opens a page of the site from its file; no page may write to the console or load anything external."""
    context = browser.new_context()
    complaints: list[str] = []

    def visit(name: str = "index.html", width: int = 1280) -> Page:
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request",
            lambda request: None if request.url.startswith(("file:", "data:")) else complaints.append(request.url),
        )
        page.set_viewport_size({"width": width, "height": 900})
        page.goto(f"file://{site}/{name}")
        return page

    yield visit
    context.close()
    assert not complaints


def shown(page: Page, track: str = "snap") -> list[str]:
    """Names of the methods that a reader sees in a table, in order."""
    rows = page.locator(f"#track-{track} tbody tr:visible th a")
    return rows.all_inner_texts()


@pytest.mark.parametrize("width", WIDTHS)
def test_no_page_is_wider_than_its_window(opened: Callable[..., Page], width: int) -> None:
    for name in ("index.html", "table1.html", "methods/snaps.html", "methods/rotations.html"):
        page = opened(name, width)
        assert page.evaluate("document.documentElement.scrollWidth") == width
        tables = page.locator(".scroll:visible")
        assert tables.count() > 0
        wider = tables.evaluate_all(f"all => all.filter(one => one.getBoundingClientRect().right > {width}).length")
        assert wider == 0


def test_on_a_phone_the_names_stay_while_the_numbers_pass(opened: Callable[..., Page]) -> None:
    page = opened(width=390)
    table, name = page.locator("#track-snap .scroll"), page.locator("#track-snap tbody th").first
    before = name.bounding_box()
    table.evaluate("one => one.scrollLeft = 300")
    assert table.evaluate("one => one.scrollLeft") == 300
    assert name.bounding_box() == before


def test_a_click_sorts_and_another_reverses_the_order(opened: Callable[..., Page]) -> None:
    page = opened()
    head = page.locator("#track-snap thead th", has_text="Rotation")
    best = ["With true volumes", SNAPS.method, "Learned", "Rotations only", "Unchanged guess"]
    head.locator("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    assert shown(page) == best
    head.locator("button").press("Enter")  # as well as with the mouse
    assert head.get_attribute("aria-sort") == "descending"
    assert shown(page) == best[::-1]
    assert page.locator('#track-snap thead [aria-sort]:not([aria-sort="none"])').count() == 1


def test_missing_values_come_last_in_both_orders(opened: Callable[..., Page]) -> None:
    page = opened()
    head = page.locator("#track-snap thead th", has_text="Seated")
    for _ in range(2):
        head.locator("button").click()
        assert shown(page)[-1] == "Rotations only"
    page.locator("#track-snap thead button").first.click()
    assert shown(page) == sorted(shown(page), key=str.lower)


def test_filters_leave_the_rows_that_match_all_of_them(opened: Callable[..., Page]) -> None:
    page = opened()
    assert len(shown(page)) == 5
    page.get_by_label("Controls").uncheck()
    assert "Unchanged guess" not in shown(page)
    page.get_by_label("True geometry").select_option("no")
    assert shown(page) == [SNAPS.method, "Learned", "Rotations only"]
    page.get_by_label("Learned").select_option("yes")
    page.get_by_label("Time per query").select_option("slow")
    assert shown(page) == ["Learned"]
    assert page.locator("output").inner_text() == "1 of 5 shown"
    page.get_by_label("Time per query").select_option("medium")
    assert page.locator("#track-snap .empty").is_visible()


def test_tabs_are_reached_by_mouse_by_keys_and_by_address(opened: Callable[..., Page]) -> None:
    page = opened()
    page.get_by_role("tab", name="place", exact=True).click()
    assert page.locator(".track:visible").get_attribute("id") == "track-place"
    assert page.url.endswith("#track-place")
    page.keyboard.press("ArrowRight")
    assert page.locator(".track:visible").get_attribute("id") == "track-place-paper"
    page.keyboard.press("Home")
    assert page.get_by_role("tab", selected=True).inner_text() == "snap"
    assert opened("index.html#track-snap-d415").locator(".track:visible").get_attribute("id") == "track-snap-d415"


def test_without_scripts_every_table_is_there(browser: Browser, site: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(f"file://{site}/index.html")
    assert page.locator(".track:visible").count() == len(TRACKS) + 1  # and that of real scenes
    assert not page.locator(".filters").is_visible()
    context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_enough_contrast(browser: Browser, site: Path, scheme: Any) -> None:
    context = browser.new_context(color_scheme=scheme)
    page = context.new_page()
    page.goto(f"file://{site}/index.html")
    for place in (".lede", ".about", ".legend", "tbody a", ".control a", "thead small", "svg text", ".tag"):
        assert contrast(page, place) >= READABLE, place
    context.close()


def contrast(page: Page, place: str) -> float:
    """Ratio of luminances of a text and what lies behind it."""
    colours = (
        page.locator(place)
        .locator("visible=true")
        .first.evaluate(
            """one => {
            const style = getComputedStyle(one);
            let behind = one;
            const paper = (place) => getComputedStyle(place).backgroundColor;
            while (paper(behind) === "rgba(0, 0, 0, 0)") behind = behind.parentElement;
            return [one instanceof SVGElement ? style.fill : style.color, paper(behind)];
        }"""
        )
    )
    light, dark = sorted(map(luminance, colours), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def luminance(colour: str) -> float:
    values = [int(number) / 255 for number in re.findall(r"\d+", colour)[:3]]
    linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in values]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
