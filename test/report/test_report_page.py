# SPDX-License-Identifier: Apache-2.0
"""The report in a real browser: it draws, plays, seeks, zooms, and asks the network for nothing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from support.browser import Page, browser
from support.recorded import random_record, write_record

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.front_door import simulate
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.page import write_report
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, resolved

PICTURE = "const s = report.scene; s.draw(); return s.renderer.domElement.toDataURL()"


def save(folder: Path, record: Record, scenario: Scenario) -> Run:
    """Write the bag of a run and open it."""
    told = {"scenario": resolved(scenario), "lost_messages": "0", "version_numpy": "2"}
    return Run(write_record(folder / "bag", record, custom_data=told))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run with a sudden pull, in which finger 3 slips at a known time and it is seen."""
    changes = {
        "duration": 0.5,
        "plant.disturbances": [{"kind": "step", "start": 0.3, "force": [0.0, 0.0, -10.0]}],
    }
    scenario = load_scenario("pull", changes)
    record = ClosedLoop(scenario).run()
    record.true_sliding[310:330, 2] = 0.01
    record.grip[315:330, 2] = ContactState.SLIP
    return save(tmp_path_factory.mktemp("pull"), record, scenario)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("profile") / "new") as opened:
        yield opened


@pytest.fixture(scope="module")
def written(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(run, tmp_path_factory.mktemp("report"))


@pytest.fixture
def report(page: Page, written: Path) -> Page:
    """Return the browser with the report of the run in it."""
    page.open(written)
    return page


def assert_quiet(page: Page) -> None:
    """Insist that the page has no complaint and has loaded nothing but itself.

    The start page of a new browser, whose own parts are chrome:, may still be loading.
    """
    own = ("file:", "data:", "blob:", "chrome:")
    assert page.errors == []
    assert page.requests, "the log of requests is empty, it would not show any"
    assert [url for url in page.requests if not url.startswith(own)] == []
    assert sum(url.startswith("file:") for url in page.requests) == 1


def click_on(page: Page, element: object, share: float) -> None:
    page.js("arguments[0].scrollIntoView({block: 'center'})", element)
    width = page.js("return arguments[0].clientWidth", element)
    offset = round((share - 0.5) * width)
    ActionChains(page.driver).move_to_element_with_offset(element, offset, 0).click().perform()


def test_it_draws_and_asks_for_nothing(report: Page) -> None:
    assert report.js("return report.scene.colours()") > 500  # a blank picture has one color
    drawn = report.js(
        """return report.charts.map(({plot}) => {
             const {width, height} = plot.ctx.canvas;
             const pixels = plot.ctx.getImageData(0, 0, width, height).data;
             return new Set(new Uint32Array(pixels.buffer)).size;
           })"""
    )
    assert len(drawn) == 6 and min(drawn) > 10
    assert_quiet(report)


def test_no_other_script_or_style_runs(report: Page) -> None:
    # As a name that slips through the escaping of a page would do.
    assert not report.js(
        """const script = document.createElement('script');
           script.textContent = 'window.foreign = true';
           document.body.append(script);
           return window.foreign"""
    )
    assert not report.js(
        """const style = document.createElement('style');
           style.textContent = 'body { color: rgb(1, 2, 3) }';
           document.head.append(style);
           return getComputedStyle(document.body).color === 'rgb(1, 2, 3)'"""
    )
    report.wait(lambda: len(report.errors) >= 2)


def test_it_plays_to_the_end(report: Page) -> None:
    start = report.js(PICTURE)
    report.driver.find_element(By.CSS_SELECTOR, ".play").click()
    assert report.js("return report.player.playing") or report.js("return report.player.time") > 0
    report.wait(lambda: report.js("return report.player.time") > 0.0)
    report.wait(lambda: not report.js("return report.player.playing"))
    assert report.js("return report.player.time") == pytest.approx(0.5)
    assert report.js("return report.scene.frames") > 1
    assert report.js(PICTURE) != start
    assert_quiet(report)


def test_seeking_moves_cursors_and_the_hand(report: Page, run: Run) -> None:
    hand = Hand.load("paper")
    where = "return report.scene.hand.tips.map(({node}) => node.matrixWorld.elements.slice(12, 15))"
    place = """const head = report.charts[0].playhead.getBoundingClientRect().left;
               return head - report.charts[0].plot.over.getBoundingClientRect().left"""
    width = report.js("return report.charts[0].plot.over.clientWidth")
    pictures = set()
    for row in (0, 200, 350, 500):
        time = float(run.record.times[row])
        report.js("report.player.seek(arguments[0])", time)
        expected = hand.fingertips(run.record.theta[row]).positions
        np.testing.assert_allclose(report.js(where), expected, atol=1e-6)
        cube = report.js("return report.scene.solid.group.position.toArray()")
        np.testing.assert_allclose(cube, run.record.object_position[row], atol=1e-7)
        assert report.js(place) == pytest.approx(time / 0.5 * width, abs=2.0)
        pictures.add(report.js(PICTURE))
    assert len(pictures) == 4


def test_the_fingertips_of_coupled_fingers_are_drawn_where_they_touch(page, tmp_path) -> None:
    """`ability` has coupled joints, and its fingertips are not at the origins of their links."""
    run = simulate("ability", {"duration": 0.02, "targets": []})
    page.open(run.report(tmp_path))
    page.js("report.player.seek(arguments[0])", float(run.record.times[-1]))
    drawn = "return report.scene.hand.tips.map(({node}) => node.matrixWorld.elements)"
    hand, theta = Hand.load("ability"), run.record.theta[-1]
    places = np.array(page.js(drawn)).reshape(-1, 4, 4)
    np.testing.assert_allclose(places[:, 3, :3], hand.fingertips(theta).positions, atol=1e-6)
    tops = hand.tip_rotations(theta)[:, :, 0]
    np.testing.assert_allclose(places[:, 0, :3], tops, atol=1e-6)


def test_a_click_in_a_plot_and_in_the_ledger_seeks(report: Page) -> None:
    for selector in (".chart:nth-of-type(3) .u-over", ".ledger .lane"):
        target = report.driver.find_element(By.CSS_SELECTOR, selector)
        for share in (0.25, 0.75):
            click_on(report, target, share)
            assert report.js("return report.player.time") == pytest.approx(0.5 * share, abs=0.01)


def test_dragging_zooms_all_plots_and_a_double_click_shows_all(report: Page) -> None:
    over = report.driver.find_element(By.CSS_SELECTOR, ".u-over")
    report.js("arguments[0].scrollIntoView({block: 'center'})", over)
    width = report.js("return arguments[0].clientWidth", over)
    actions = ActionChains(report.driver).move_to_element_with_offset(over, -width // 4, 0)
    actions.click_and_hold().move_by_offset(width // 2, 0).release().perform()
    shown = "return report.charts.map(({plot}) => [plot.scales.x.min, plot.scales.x.max])"
    report.wait(lambda: report.js(shown)[0][0] > 0.0)
    limits = np.array(report.js(shown))
    np.testing.assert_allclose(limits, [[0.125, 0.375]] * 6, atol=0.01)
    assert report.js("return report.player.time") == 0.0  # zooming is not seeking
    ActionChains(report.driver).move_to_element(over).double_click().perform()
    report.wait(lambda: report.js(shown) == [[0, 0.5]] * 6)


def test_keys(report: Page) -> None:
    body = report.driver.find_element(By.TAG_NAME, "body")
    body.send_keys(Keys.ARROW_RIGHT)
    assert report.js("return report.player.time") == pytest.approx(0.1)
    body.send_keys(Keys.END)
    assert report.js("return report.player.time") == 0.5
    body.send_keys(Keys.HOME, "n")
    first = report.js("return report.events.map((e) => e.time).find((t) => t > 0)")
    assert report.js("return report.player.time") == pytest.approx(first)
    report.js("report.player.setSpeed(1e-6)")  # it cannot come to the end meanwhile
    body.send_keys(Keys.SPACE)
    assert report.js("return report.player.playing")
    body.send_keys(Keys.SPACE)
    assert not report.js("return report.player.playing")
    report.js("report.player.setSpeed(0.05)")
    body.send_keys(Keys.ARROW_UP)
    assert report.js("return report.player.speed") == 0.1


def test_a_slip_is_told_and_seen(report: Page, run: Run) -> None:
    slip = next(e for e in run.events if e.kind == "detection" and e.finger == "finger_3")
    assert slip.time == run.record.times[315]
    report.js("report.player.seek(arguments[0])", slip.time)
    news = report.driver.find_element(By.CSS_SELECTOR, ".news").text
    assert "slip detected" in news and "slip begins" in news
    glow = "return report.scene.hand.tips[arguments[0]].material.emissive.getHex()"
    assert report.js(glow, 2) > 0
    report.js("report.player.seek(0.25)")
    assert report.js(glow, 2) == 0


def test_layers_can_be_hidden(report: Page) -> None:
    report.js("report.player.seek(0.4)")
    assert report.js("return report.scene.contacts[0].cone.group.visible")
    before = report.js(PICTURE)
    report.driver.find_element(By.CSS_SELECTOR, ".layers summary").click()
    for box in report.driver.find_elements(By.CSS_SELECTOR, ".layers input"):
        box.click()
    assert not report.js("return report.scene.contacts[0].cone.group.visible")
    assert not report.js("return report.scene.solid.group.visible")
    assert report.js(PICTURE) != before


def test_dark_and_light(page: Page, written: Path) -> None:
    looks = []
    for dark in (False, True):
        page.open(written, dark=dark)
        looks.append(page.js("return getComputedStyle(document.body).backgroundColor"))
        assert page.js("return document.documentElement.dataset.theme") == ("light", "dark")[dark]
        assert_quiet(page)
    assert looks[0] != looks[1]
    page.driver.find_element(By.TAG_NAME, "body").send_keys("d")
    assert page.js("return getComputedStyle(document.body).backgroundColor") == looks[0]


def test_nothing_sticks_out_at_any_size(page: Page, written: Path) -> None:
    page.open(written, size=(400, 800))
    for size in ((400, 800), (1280, 800), (1920, 1080), (400, 800)):
        page.resize(size)
        assert page.js("return document.documentElement.scrollWidth") <= size[0]


def test_a_real_hand_without_truth_and_scenario(page: Page, tmp_path: Path) -> None:
    page.open(write_report(Run(write_record(tmp_path / "bag", random_record(truth=False)))))
    assert page.js("return report.scene.colours()") > 50
    assert page.js("return report.scene.solid") is None
    assert page.js("return report.scene.contacts[0].group.visible")
    assert "The scenario is unknown" in page.driver.find_element(By.CSS_SELECTOR, ".notes").text
    assert_quiet(page)


def test_without_webgl_the_plots_are_there(tmp_path: Path, written: Path) -> None:
    with browser(tmp_path / "profile", "--disable-3d-apis") as page:
        page.open(written)
        assert "no WebGL" in page.driver.find_element(By.CSS_SELECTOR, ".viewport").text
        page.js("report.player.seek(0.25)")
        assert page.js("return report.charts.length") == 6
        assert page.js("return report.charts[0].playhead.style.transform").startswith("translate")


def test_a_dropped_object_leaves_the_picture(page: Page, tmp_path: Path) -> None:
    scenario = load_scenario("pull", {"slip_regulator.mode": "user", "duration": 2.6})
    run = save(tmp_path, ClosedLoop(scenario).run(), scenario)
    page.open(write_report(run, tmp_path))
    assert page.js("return document.querySelector('.verdict').textContent") == run.headline
    assert run.headline.startswith("object dropped at 2.")
    heights = page.js("return report.scene.view.points.map((point) => point.z)")
    assert max(heights) - min(heights) < 1.0
    assert run.record.object_position[-1, 2] < -2.0
    assert_quiet(page)
