"""The report as a reader sees it: in a real browser without a network, light and dark."""

from __future__ import annotations

from collections.abc import Iterator
from shutil import which
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import YardRun

CHROMIUM = which("chromium") or which("chromium-browser") or which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install it")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Browser, finished_yard: YardRun) -> Iterator[Page]:
    """The yard's report; any error on its console, and any request, fails the test."""
    page = browser.new_page(viewport={"width": 1600, "height": 900}, color_scheme="light")
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    address = (finished_yard.output / "report.html").resolve().as_uri()

    def watch(request: Any) -> None:
        if request.url != address and not request.url.startswith("data:"):
            complaints.append(f"asked for {request.url}")

    page.on("request", watch)
    page.goto(address)
    yield page
    assert complaints == []
    page.close()


def ids(page: Page) -> list[int]:
    rows = page.locator("#candidates tbody tr")
    return [int(rows.nth(i).get_attribute("data-id") or -1) for i in range(rows.count())]


def test_the_table_is_filtered_and_sorted(page: Page, finished_yard: YardRun) -> None:
    detections = {d["id"]: d for d in finished_yard.detections()}
    kept = [i for i, d in detections.items() if d["fate"] in ("accepted", "ambiguous")]
    assert sorted(ids(page)) == sorted(kept)
    for fate in {d["fate"] for d in detections.values()}:
        page.locator(f"#filters input[value={fate}]").check()
    assert sorted(ids(page)) == sorted(detections)
    page.locator("th[data-column=x_scene]").click()
    down = [detections[i]["position_scene"][0] for i in ids(page)]
    assert down == sorted(down, reverse=True)
    page.locator("th[data-column=x_scene]").click()
    assert ids(page) == sorted(ids(page), key=lambda i: (detections[i]["position_scene"][0], i))
    page.locator("#filters input[type=search]").fill("no such reason")
    assert ids(page) == []


def test_a_candidate_is_explained_where_it_is_chosen(page: Page, finished_yard: YardRun) -> None:
    detections = finished_yard.detections()
    for fate in {d["fate"] for d in detections}:
        page.locator(f"#filters input[value={fate}]").check()
    for d in detections:
        page.locator(f"#candidates tbody tr[data-id='{d['id']}']").click()
        detail = page.locator("#detail").inner_text()
        assert f"Candidate {d['id']}: {d['model']}, {d['fate']}" in detail
        assert d["reason"] in detail
        for part in d["parts"]:
            assert part in detail
        assert "spinpipe why" in detail
    assert page.locator("#detail .thumb").count() == 3
    assert page.locator("#detail canvas").count() >= 2


def test_the_map_answers_to_the_pointer(page: Page, finished_yard: YardRun) -> None:
    accepted = next(d for d in finished_yard.detections() if d["fate"] == "accepted")
    outline = page.locator(f"#map polygon[data-id='{accepted['id']}']")
    outline.hover()
    assert page.locator("#tip").is_visible()
    assert accepted["reason"] in page.locator("#tip").inner_text()
    outline.click()
    assert f"Candidate {accepted['id']}:" in page.locator("#detail").inner_text()
    assert page.locator("#map polygon").count() == len(finished_yard.detections())


def test_pictures_and_themes_are_drawn(page: Page, tmp_path: Path) -> None:
    page.screenshot(path=tmp_path / "light.png")
    page.locator("#theme").click()
    page.screenshot(path=tmp_path / "dark.png")
    light, dark = (
        np.asarray(Image.open(tmp_path / f"{name}.png").convert("L"), float)
        for name in ("light", "dark")
    )
    assert light.mean() > 150 > 100 > dark.mean()
    box = page.locator("#detail .thumb").first.bounding_box()
    assert box is not None
    x, y, side = int(box["x"]), int(box["y"]), int(box["width"])
    assert dark[y : y + side, x : x + side].std() > 10  # a picture, not a blank square
