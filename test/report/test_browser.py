"""The report in a real browser: headless Chromium, driven as a reader would."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bag_maker import START, Sea

from pipeline_tracker.report.filmstrip import DIRECTORY
from pipeline_tracker.report.page import page
from pipeline_tracker.report.record import Record, read_record
from pipeline_tracker.types import RelativeState

webdriver = pytest.importorskip("selenium.webdriver")

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
DRIVER = shutil.which("chromedriver") or ""
pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="no chromium and chromedriver on this machine"
)
SECOND = 1_000_000_000
# A busy machine is slow, not wrong.
PATIENCE = 120.0
WHITE, DARK = "rgb(255, 255, 255)", "rgb(18, 22, 27)"

Make = Callable[..., Path]


class Browser:
    """A page that is open, and what a reader does with it."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def open(self, path: Path, *, width: int = 1400, height: int = 900, dark: bool = False) -> None:
        phone = width < 600
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone}
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.command("Emulation.setDeviceMetricsOverride", metrics)
        self.command("Emulation.setTouchEmulationEnabled", {"enabled": phone})
        self.command("Emulation.setEmulatedMedia", {"features": [scheme]})
        # What was logged of the page before is not of this one.
        self.driver.get_log("browser")
        self.driver.get_log("performance")
        self.driver.get(path.resolve().as_uri())
        self.wait("return document.documentElement.dataset.plots")

    def command(self, name: str, values: dict[str, Any]) -> Any:
        return self.driver.execute_cdp_cmd(name, values)

    def run(self, script: str, *given: Any) -> Any:
        return self.driver.execute_script(script, *given)

    def wait(self, script: str) -> Any:
        from selenium.webdriver.support.ui import WebDriverWait

        return WebDriverWait(self.driver, PATIENCE, 0.05).until(lambda _: self.run(script))

    def errors(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def requests(self) -> list[str]:
        logged = [json.loads(e["message"])["message"] for e in self.driver.get_log("performance")]
        sent = [e["params"] for e in logged if e["method"] == "Network.requestWillBeSent"]
        return [params["request"]["url"] for params in sent]

    def click(self, box: str, curve: int, index: int) -> None:
        """Click on a drawn point of a time line."""
        from selenium.webdriver.common.action_chains import ActionChains

        element = self.driver.find_element("id", box)
        x, y = self.run(
            """
            const box = document.getElementById(arguments[0]);
            box.scrollIntoView({block: "center"});
            const trace = box._fullData[arguments[1]], k = arguments[2];
            const xaxis = box._fullLayout.xaxis;
            const yaxis = box._fullLayout[trace.yaxis.replace("y", "yaxis")];
            return [xaxis._offset + xaxis.d2p(trace.x[k]), yaxis._offset + yaxis.d2p(trace.y[k])];
            """,
            box, curve, index,
        )  # fmt: skip
        size = element.size
        chain = ActionChains(self.driver)
        # Offsets are from the middle.
        for off in (3.0, 0.0):
            chain.move_to_element_with_offset(
                element, round(x - size["width"] / 2 + off), round(y - size["height"] / 2)
            )
        chain.click().perform()

    def press(self, key: str) -> None:
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).send_keys(key).perform()

    @property
    def frame(self) -> str:
        return str(self.run("return document.querySelector('#caption b').textContent"))

    @property
    def picture(self) -> int:
        """Which picture of the film strip is shown large."""
        return int(
            self.run(
                "const src = document.getElementById('picture').src;"
                "return [...document.querySelectorAll('#strip img')].findIndex(i => i.src === src)"
            )
        )

    def curve(self, box: str, name: str) -> tuple[int, list[float | None], list[int]]:
        """Return a curve's number, its y and the rows that it is drawn of."""
        return tuple(
            self.run(
                "const all = document.getElementById(arguments[0]).data;"
                "const k = all.findIndex(t => t.name === arguments[1]);"
                "return [k, all[k].y, all[k].customdata]",
                box, name,
            )
        )  # fmt: skip


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        # Chromium's sandbox needs another user.
        options.add_argument("--no-sandbox")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield started
    started.quit()


@pytest.fixture
def browser(driver: Any) -> Browser:
    return Browser(driver)


@pytest.fixture
def sea(make: Make) -> Path:
    """A pipe that gets lost, with a dip of the quality at frame 9; the page of its replay."""
    levels = {5: 50, 6: 60, 9: 110}
    return make(Sea(frames=14, level=lambda i: levels.get(i, 150 + i))) / "report.html"


def test_all_is_drawn_and_a_click_on_a_dip_shows_its_picture(browser: Browser, sea: Path) -> None:
    browser.open(sea)
    assert browser.run("return document.documentElement.dataset.plots") == "drawn"
    for box in ("timelines", "plan", "profile"):
        drawn = f"return document.querySelectorAll('#{box} .scatterlayer .js-line').length"
        assert browser.run(drawn) >= 3, box
    assert {url.partition(":")[0] for url in browser.requests()} == {"file", "data"}
    assert browser.errors() == []
    assert browser.frame == "Frame 1 of 14, 0.0 s"
    # The picture is a picture.
    browser.wait("return document.getElementById('picture').naturalWidth === 64")
    assert browser.run("return document.documentElement.scrollWidth <= innerWidth")
    assert browser.run("return getComputedStyle(document.body).backgroundColor") == WHITE
    shapes = browser.run("return document.getElementById('timelines').layout.shapes")
    assert [(s["x0"], s["x1"]) for s in shapes if s["type"] == "rect"] == [(2.25, 3.25)]

    # What is zoomed stays so.
    browser.run("Plotly.relayout('plan', {'xaxis.range': [2, 2.5], 'yaxis.range': [0, 0.1]})")
    low, high = browser.run("return document.getElementById('plan').layout.xaxis.range")
    assert 1.0 < low < high < 3.5

    # A click on a dip shows its picture.
    curve, quality, rows = browser.curve("timelines", "quality")
    known = [v for k, v in enumerate(quality) if k not in (5, 6)]
    dip = quality.index(min(known))
    assert rows[dip] == 9
    browser.click("timelines", curve, dip)
    browser.wait("return document.querySelector('#caption b').textContent.startsWith('Frame 10 ')")
    assert browser.picture == 9
    values = browser.run("return document.getElementById('values').textContent")
    assert "tracking" in values
    # The line through the time lines stands there, and the ring on the plan.
    browser.wait("return document.getElementById('timelines').layout.shapes.at(-1).x0 === 4.5")
    browser.wait("return Math.abs(document.getElementById('plan').data.at(-1).x[0] - 1.8) < 0.01")
    assert browser.errors() == []


def test_keys_buttons_slider_and_strip_step(browser: Browser, sea: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    browser.open(sea)
    for key, frame in ((Keys.ARROW_RIGHT, 2), (Keys.ARROW_RIGHT, 3), (Keys.ARROW_LEFT, 2),
                       (Keys.END, 14), (Keys.ARROW_RIGHT, 14), (Keys.HOME, 1)):  # fmt: skip
        browser.press(key)
        assert browser.frame.startswith(f"Frame {frame} of 14"), key
        assert browser.picture == frame - 1
    browser.run("document.getElementById('on').click()")
    assert browser.picture == 1
    browser.run(
        "const s = document.getElementById('slider'); s.value = 6;"
        "s.dispatchEvent(new Event('input', {bubbles: true}))"
    )
    assert browser.picture == 6
    assert "too dark" in browser.run("return document.getElementById('caption').textContent")
    browser.run("document.querySelectorAll('#strip button')[11].click()")
    assert browser.picture == 11
    browser.run("document.querySelectorAll('tr.lost button')[0].click()")
    assert browser.picture == 5
    assert browser.errors() == []


def test_a_phone_has_room_enough_and_dark_is_dark(browser: Browser, sea: Path) -> None:
    browser.open(sea, width=390, height=844, dark=True)
    assert browser.run("return document.documentElement.scrollWidth") == 390
    assert browser.run("return getComputedStyle(document.body).backgroundColor") == DARK
    assert browser.run("return document.getElementById('plan').layout.font.color") == "#9ba6b3"
    # A finger on a plot scrolls the page.
    assert browser.run("return document.getElementById('plan').layout.dragmode") is False
    assert browser.errors() == []


def test_no_band_bridges_a_gap(browser: Browser, make: Make) -> None:
    # Dark from 4 to 9: carried on by the pose for a second, then lost, and found again.
    dark = make(Sea(frames=14, level=lambda i: 50 if 4 <= i < 10 else 150), tracking__max_coast=0.3)
    browser.open(dark / "report.html")
    curve, heading, _ = browser.curve("timelines", "heading")
    gaps = [0.5 * k for k, value in enumerate(heading) if value is None]
    assert gaps
    xs = browser.run(f"return document.getElementById('timelines').data[{curve - 1}].x")
    runs = [[]]  # type: list[list[float]]
    for x in xs:
        if x is None:
            runs.append([])
        else:
            runs[-1].append(x)
    runs = [run for run in runs if run]
    assert len(runs) == 2
    assert not any(min(run) < gap < max(run) for run in runs for gap in gaps)


def test_on_paper_plots_fit_the_sheet_and_cover_nothing(browser: Browser, sea: Path) -> None:
    browser.open(sea)
    # A4 with the margins of page.css has 703 px.
    metrics = {"width": 703, "height": 1032, "deviceScaleFactor": 1, "mobile": False}
    browser.command("Emulation.setDeviceMetricsOverride", metrics)
    browser.command("Emulation.setEmulatedMedia", {"media": "print"})
    browser.run("dispatchEvent(new Event('beforeprint'))")
    try:
        drawn = browser.wait(
            "const edges = (e) => e.getBoundingClientRect();"
            "const boxes = [...document.querySelectorAll('.plot')].map(box =>"
            " [edges(box.querySelector('.main-svg')), edges(box)]);"
            "return innerWidth === 703 && boxes.map(([svg, box]) =>"
            " [svg.right, svg.bottom - box.bottom, box.height])"
        )
        assert len(drawn) == 3
        for right, below, height in drawn:
            assert right <= 703
            assert below <= 0.5
            assert height > 200
        assert browser.run("return document.documentElement.scrollWidth <= innerWidth")
    finally:
        browser.command("Emulation.setEmulatedMedia", {"media": ""})
        browser.run("dispatchEvent(new Event('afterprint'))")


EVIL = '<img src=x onerror="document.title=1"><script>alert(1)<'


@pytest.mark.parametrize(
    ("options", "name"),
    [({"frames": 1}, EVIL), ({"level": lambda _: 50, "pose": ""}, "sea")],
)
def test_poor_replays_are_drawn_and_hostile_names_do_nothing(
    browser: Browser, make: Make, options: dict[str, Any], name: str
) -> None:
    browser.open(make(Sea(**options), name=name) / "report.html")
    assert browser.run("return document.documentElement.dataset.plots") == "drawn"
    assert browser.run("return document.title") == f"Pipeline report: {name}"
    assert browser.run("return document.querySelectorAll('h1 *').length") == 0
    assert browser.errors() == []


def long_record(directory: Path, count: int = 10_000) -> Record:
    """Return a replay of so many frames, with pictures of some; frame 4321 has a dip."""
    record = read_record(directory)
    row, (picture, *_) = record.rows[0], record.pictures.values()
    stamps = [START + k * SECOND for k in range(count)]
    record.rows = [{**row, "stamp_ns": str(stamp)} for stamp in stamps]
    record.states = {stamp: RelativeState(stamp, True, 0.9, 0) for stamp in stamps}
    record.states[stamps[4321]] = RelativeState(stamps[4321], True, 0.2, 0)
    record.pictures = dict.fromkeys([*stamps[::50], stamps[4321]], picture)
    return record


def test_of_many_frames_no_dip_is_hidden(browser: Browser, make: Make, tmp_path: Path) -> None:
    output = make(Sea(frames=3))
    assert (output / DIRECTORY).is_dir()
    path = tmp_path / "long.html"
    path.write_text(page(long_record(output), None), encoding="utf-8")
    browser.open(path)
    curve, quality, rows = browser.curve("timelines", "quality")
    assert len(rows) <= 1400
    assert quality[rows.index(4321)] == 0.2
    browser.click("timelines", curve, rows.index(4321))
    browser.wait("return document.querySelector('#caption b').textContent.startsWith('Frame 4322')")
    # Zoomed in, every frame is there; back again, the share.
    browser.run("Plotly.relayout('timelines', {'xaxis.range': [4300, 4400]})")
    seen = "return document.getElementById('timelines').data.find(t => t.name === 'quality')"
    browser.wait(f"{seen[:6]} ({seen[7:]}).x.length < 110")
    _, _, rows = browser.curve("timelines", "quality")
    assert rows == list(range(4299, 4402))
    shown = browser.run("return document.getElementById('timelines').layout.xaxis.range")
    assert shown == [4300, 4400]
    browser.run("Plotly.relayout('timelines', {'xaxis.autorange': true})")
    browser.wait(f"{seen[:6]} ({seen[7:]}).x.length > 600")
    assert browser.errors() == []
