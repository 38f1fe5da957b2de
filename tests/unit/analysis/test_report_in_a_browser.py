"""The report in headless Chromium: figures are drawn without console errors, 3D views turn, and it fits a phone."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
import valid_sweeps
from matplotlib.image import imread
from playwright.sync_api import Browser, Page, sync_playwright

from shift3d.analysis.cases.rendered import Rendered
from shift3d.analysis.cases.selection import Case
from shift3d.analysis.html.blocks import Section
from shift3d.analysis.html.document import document
from shift3d.analysis.html.figure import plotly_library
from shift3d.analysis.html.report import write_report
from shift3d.analysis.html.scene_figures import paired_3d_views
from shift3d.store.log_entries import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (Debian: apt install chromium)")
SOFTWARE_3D = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
DRAWN = "[...document.querySelectorAll('.plot')].every(plot => plot.dataset.drawn === 'yes')"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *SOFTWARE_3D])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "sweep"
    valid_sweeps.write_sweep(folder)
    write_final(folder, read_plan(folder), read_log(folder))
    write_report(folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def two_cars(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of one hard case: two vehicles side by side, in turnable views."""
    mesh = trimesh.creation.box((4.0, 2.0, 1.5))
    box = Rendered(
        mesh, np.zeros(6), np.zeros((0, 2)), np.zeros((0, 2)), 0, np.array([0, 0, 0, 4, 2, 1.5, 0]), None, 0.0
    )
    case = Case("id", "suv", "north", "shape", 0.9, 0.1)
    page = document("t", [Section("k", "s", paired_3d_views("x", case, box, box))], "l", plotly_library())
    file = tmp_path_factory.mktemp("cars") / "page.html"
    file.write_text(page)
    return file


def opened(browser: Browser, file: Path, width: int = 1280, scheme: str = "light") -> tuple[Page, list[str]]:
    """Open a page with every figure drawn. Returns the page and its console errors."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)  # type: ignore[arg-type]
    words: list[str] = []
    page.on("console", lambda message: words.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: words.append(str(error)))
    page.on("request", lambda request: None if request.url.startswith(("file:", "data:", "blob:")) else words.append(
        f"asked the network for {request.url}"
    ))  # fmt: skip
    page.goto(file.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
    # Figures are drawn once they come into view.
    for plot in page.locator(".plot").all():
        plot.scroll_into_view_if_needed()
    page.wait_for_function(DRAWN, timeout=60_000)
    return page, words


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (400, "dark")])
def test_every_figure_is_drawn_and_the_page_fits(browser: Browser, report: Path, width: int, scheme: str) -> None:
    page, words = opened(browser, report, width, scheme)
    assert words == []
    assert page.locator(".plot").count() == report.read_text().count('class="plot"') > 0
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    # No text is cut off.
    cut = page.evaluate("""() => [...document.querySelectorAll("h1, h2, h3, p, li, caption span, summary, button")]
        .filter(part => part.getBoundingClientRect().right > window.innerWidth + 1)
        .map(part => part.textContent.slice(0, 60))""")
    assert cut == []
    dark = page.evaluate(
        "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).every(c => c < 64)"
    )
    assert dark == (scheme == "dark")
    page.close()


def eyes(page: Page) -> list[str]:
    """Return the camera position of each 3D view."""
    return page.evaluate("""() => [...document.querySelectorAll(".plot")]
        .map(view => JSON.stringify(view._fullLayout.scene._scene.getCamera().eye))""")  # type: ignore[no-any-return]


def test_both_vehicles_turn_together_by_keyboard_and_by_drag(browser: Browser, two_cars: Path) -> None:
    page, words = opened(browser, two_cars, width=600)
    first = eyes(page)
    button = page.locator("button[data-turn]").first
    button.focus()
    page.keyboard.press("Enter")
    page.wait_for_timeout(1500)
    turned = eyes(page)
    assert turned[0] != first[0] and turned[0] == turned[1]
    view = page.locator(".plot").first.bounding_box()
    assert view is not None
    x, y = view["x"] + view["width"] / 2, view["y"] + view["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y + 30, steps=3)
    page.mouse.up()
    page.wait_for_timeout(1500)
    assert eyes(page)[0] != turned[0]
    assert words == []
    page.close()


@pytest.mark.parametrize("width", [400, 800, 1280])
def test_both_vehicles_are_whole(browser: Browser, two_cars: Path, width: int) -> None:
    page, words = opened(browser, two_cars, width)
    page.wait_for_timeout(1000)
    for view in page.locator(".plot").all():
        pixels = imread(io.BytesIO(view.screenshot()))[..., :3]
        ground = np.median(pixels, axis=(0, 1))
        vehicle = np.abs(pixels - ground).max(axis=2) > 0.1
        rows, columns = vehicle.any(axis=1), vehicle.any(axis=0)
        margin = 4  # rounded corners
        assert vehicle.mean() > 0.05
        assert not rows[margin] and not rows[-margin - 1] and not columns[margin] and not columns[-margin - 1]
    assert words == []
    page.close()


def test_a_printed_page_holds_whole_figures(browser: Browser, report: Path) -> None:
    page, words = opened(browser, report)
    widths = """() => [...document.querySelectorAll(".plot")].filter(plot => plot.offsetParent)
        .map(plot => [plot.clientWidth, plot.querySelector("svg, canvas").getBoundingClientRect().width])"""
    screen = page.evaluate(widths)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    paper = page.evaluate(widths)
    assert len(paper) > 0 and all(drawn == own <= 190 / 25.4 * 96 for own, drawn in paper)  # A4 less two margins
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(widths) == screen
    assert words == []
    page.close()
