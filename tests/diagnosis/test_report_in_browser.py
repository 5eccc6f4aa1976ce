import dataclasses
import re

import numpy as np
import pytest

from skat.diagnosis.report.content import Content, Verdict
from skat.diagnosis.report.page import page
from tests.diagnosis.browser import Reader, axe_script, browser
from tests.diagnosis.synthetic import full_content

WIDTHS = [1280, 390]
LOOKS = [("light", "screen"), ("dark", "screen"), ("dark", "print")]
SMALLEST_LABEL_PX = 9
# The part of a plot that is seen: left, top, width, height.
WINDOW = "{}.getAttribute('viewBox').split(' ').map(Number)"


@pytest.fixture(scope="module")
def driver():
    driver = browser()
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A page with everything, one with names and texts that are long, and one with hardly anything."""
    folder = tmp_path_factory.mktemp("pages")
    full = full_content()
    name = "dry_friction[left_front_outer_knuckle_of_the_second_gripper_finger_joint]"
    word = "x" * 70
    long = dataclasses.replace(
        full,
        title=f"/home/{word}/{word}.xml against {word}.csv",
        causes=tuple(
            dataclasses.replace(cause, name=name, interval=(1.2345e-7, 9.8765e12)) for cause in full.causes
        ),
        visibility=tuple(
            dataclasses.replace(one, name=f"{name}{k}") for k, one in enumerate(full.visibility)
        ),
        changes=tuple(
            dataclasses.replace(one, element=f'joint "{word}"', after=word) for one in full.changes
        ),
        provenance=dataclasses.replace(
            full.provenance, command=f"skat diagnose {word}/{word}", warnings=(word, word)
        ),
    )
    bare = Content("A against B", Verdict("nothing detected", "Nothing detected"))
    paths = {}
    for key, content in {"full": full, "long": long, "bare": bare}.items():
        paths[key] = folder / f"{key}.html"
        paths[key].write_text(page(content), encoding="utf-8")
    return paths


@pytest.fixture
def read(driver, pages):
    return lambda key="full", **look: Reader(driver).look(pages[key], **look)


@pytest.mark.parametrize("key", ["full", "long", "bare"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize(("scheme", "media"), LOOKS)
def test_the_page_fits_its_labels_can_be_read_and_the_console_is_silent(read, key, width, scheme, media):
    reader = read(key, width=width, scheme=scheme, media=media)
    found = reader.ask(
        """
        const wide = document.documentElement.clientWidth;
        const shown = [...document.querySelectorAll("body *")].filter((one) => one.checkVisibility());
        const scrolled = (one) => one.closest(".scroll, svg");
        const beyond = shown.filter((one) => !scrolled(one) && one.getBoundingClientRect().right > wide + 0.5);
        const says = (one) => [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
        // Text in a drawing that is scaled is smaller than its style says.
        const scale = (one) => one.offsetWidth ? one.getBoundingClientRect().width / one.offsetWidth : 1;
        const sizes = shown.filter((one) => says(one) && !["STYLE", "SCRIPT"].includes(one.tagName))
          .map((one) => parseFloat(getComputedStyle(one).fontSize) * scale(one));
        return {
          overflow: document.documentElement.scrollWidth - wide,
          beyond: beyond.map((one) => one.outerHTML.slice(0, 120)),
          smallest: Math.min(...sizes), texts: sizes.length, inside: document.querySelectorAll('svg text').length,
        };
        """
    )
    assert found["overflow"] <= 0
    assert found["beyond"] == []
    assert found["texts"] > 3 or key == "bare"
    assert found["inside"] == 0
    assert found["smallest"] >= SMALLEST_LABEL_PX
    assert reader.messages() == []


@pytest.mark.parametrize("width", WIDTHS)
def test_labels_of_an_axis_do_not_meet(read, width):
    meeting = read(width=width).ask(
        """
        const meeting = [];
        for (const axis of document.querySelectorAll(".plot .x, .plot .y")) {
          const labels = [...axis.children].filter((one) => one.checkVisibility());
          labels.forEach((one, k) => labels.slice(k + 1).forEach((other) => {
            const [box, far] = [one.getBoundingClientRect(), other.getBoundingClientRect()];
            const across = box.left < far.right && far.left < box.right;
            const up = box.top < far.bottom && far.top < box.bottom;
            if (across && up) meeting.push([one.textContent, other.textContent]);
          }));
        }
        return meeting;
        """
    )
    assert meeting == []


@pytest.mark.parametrize("key", ["full", "long"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_core_finds_no_fault(read, key, width, scheme):
    script = axe_script()
    reader = read(key, width=width, scheme=scheme)
    reader.ask("document.querySelectorAll('details').forEach((one) => { one.open = true; });")
    reader.ask(script)
    found = reader.driver.execute_async_script(
        """
        const done = arguments[0];
        const told = (node) => node.html.slice(0, 160) + node.failureSummary;
        axe.run(document).then((result) => done(result.violations.map(
          (one) => [one.impact, one.id, one.nodes.slice(0, 3).map(told)])));
        """
    )
    assert found == []


def test_links_lead_to_what_they_name(read):
    reader = read()
    targets = reader.ask("return [...document.querySelectorAll('nav a')].map((one) => one.hash)")
    assert len(targets) == 9
    for target in targets:
        top = reader.ask(
            "document.querySelector(`nav a[href='${arguments[0]}']`).click();"
            "return document.querySelector(arguments[0]).getBoundingClientRect().top",
            target,
        )
        # The last sections cannot come to the top of the window.
        assert -1 <= top < 900


@pytest.mark.parametrize("width", WIDTHS)
def test_tables_sort_by_their_columns_from_the_keyboard(read, width):
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    reader = read(width=width)
    table = reader.driver.find_element(By.CSS_SELECTOR, "section[aria-labelledby=visible] table")
    column = [header.text.strip() for header in table.find_elements(By.CSS_SELECTOR, "thead th")]
    place = next(k for k, text in enumerate(column) if text.startswith("similarity"))
    cells = "return [...arguments[0].tBodies[0].rows].map((row) => row.cells[arguments[1]].textContent)"
    given = [float(text) for text in reader.ask(cells, table, place)]
    button = table.find_elements(By.CSS_SELECTOR, "thead button")[place]
    for direction, is_down in (("ascending", False), ("descending", True)):
        button.send_keys(Keys.ENTER)
        assert [float(text) for text in reader.ask(cells, table, place)] == sorted(given, reverse=is_down)
        header = table.find_elements(By.CSS_SELECTOR, "thead th")[place]
        assert header.get_attribute("aria-sort") == direction
    names = [text for text in reader.ask(cells, table, 0)]
    table.find_elements(By.CSS_SELECTOR, "thead button")[0].click()
    assert reader.ask(cells, table, 0) == sorted(names)
    assert reader.ask("return document.querySelectorAll('[aria-sort]').length") == 1


@pytest.mark.parametrize("width", WIDTHS)
def test_signals_zoom_from_the_keyboard_and_all_channels_move_together(read, width):
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    reader = read(width=width)
    group = reader.driver.find_element(By.CSS_SELECTOR, ".signals")
    boxes = f"return [...arguments[0].querySelectorAll('.plot svg')].map((one) => {WINDOW.format('one')})"
    ticks = (
        "return [...arguments[0].querySelector('.x').children]"
        ".map((one) => [parseFloat(one.style.left), parseFloat(one.textContent)])"
    )
    before = reader.ask(boxes, group)
    assert {tuple(box) for box in before} == {(0, 0, 1000, 1000)}
    group.send_keys("+")
    group.send_keys("+")
    near = reader.ask(boxes, group)
    assert {(box[0], box[2]) for box in near} == {(375, 250)}
    assert all(box[3] <= 1000 * 1.2 for box in near)
    # Ticks say where they stand: the signals last 4 s.
    for left, value in reader.ask(ticks, group):
        assert value == pytest.approx(4 * (0.375 + 0.25 * left / 100), abs=0.01)
    assert len(reader.ask(ticks, group)) >= 3
    assert "1.5" in group.find_element(By.CSS_SELECTOR, "output").text
    group.send_keys(Keys.ARROW_RIGHT)
    assert {box[0] for box in reader.ask(boxes, group)} == {437.5}
    group.send_keys("0")
    assert reader.ask(boxes, group) == before
    other = reader.driver.find_elements(By.CSS_SELECTOR, ".signals")[1]
    assert {tuple(box) for box in reader.ask(boxes, other)} == {(0, 0, 1000, 1000)}
    assert reader.messages() == []


def test_zooming_shows_what_lies_in_the_window_on_an_axis_of_its_own(read):
    from selenium.webdriver.common.by import By

    reader = read()
    group = reader.driver.find_element(By.CSS_SELECTOR, ".signals")
    for _ in range(6):
        group.send_keys("+")
    svg = group.find_element(By.CSS_SELECTOR, "svg")
    left, top, width, height = reader.ask(f"return {WINDOW.format('arguments[0]')}", svg)
    points = reader.ask("return arguments[0].querySelector('.measured').getAttribute('d')", svg)
    x, y = np.array([[float(one) for one in pair] for pair in re.findall(r"([-\d.]+) ([-\d.]+)", points)]).T
    seen = y[(x >= left) & (x <= left + width)]
    assert top <= seen.min()
    assert seen.max() <= top + height
    assert height < 300


def test_signals_zoom_by_buttons_and_by_dragging(read):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    reader = read()
    group = reader.driver.find_element(By.CSS_SELECTOR, ".signals")
    svg = group.find_element(By.CSS_SELECTOR, "svg")
    box = f"return {WINDOW.format('arguments[0]')}"
    buttons = group.find_elements(By.CSS_SELECTOR, ".tools button")
    assert [button.is_enabled() for button in buttons] == [True, False, False, False, False]
    buttons[0].click()
    assert reader.ask(box, svg)[::2] == [250, 500]
    buttons[4].click()
    assert reader.ask(box, svg) == [0, 0, 1000, 1000]
    width = svg.size["width"]
    ActionChains(reader.driver).move_to_element(svg).click_and_hold().move_by_offset(
        round(width / 4), 0
    ).release().perform()
    left, wide = reader.ask(box, svg)[::2]
    assert left == pytest.approx(500, abs=8)
    assert wide == pytest.approx(250, abs=8)


def test_everything_is_reached_by_the_tab_key_and_has_a_name(read):
    reader = read()
    names = reader.ask(
        """
        return [...document.querySelectorAll("a, button, summary, [tabindex]")].filter((one) => one.checkVisibility())
          .map((one) => one.getAttribute("aria-label") || one.textContent.trim());
        """
    )
    assert len(names) > 30
    assert all(names)
    images = reader.ask(
        """
        return [...document.querySelectorAll("img, svg[role=img]")]
          .map((one) => one.alt || one.getAttribute("aria-label"));
        """
    )
    assert all(images)


def test_paper_is_light_shows_what_is_folded_and_breaks_no_figure(read):
    reader = read(scheme="dark", media="print")
    found = reader.ask(
        """
        const style = (selector) => getComputedStyle(document.querySelector(selector));
        const folded = document.querySelector(".signals details .plot");
        return {
          ink: style(".skat-report").color, nav: style("nav").display, tools: style(".tools").display,
          figure: style(".plot").breakInside, row: style("tbody tr").breakInside, heading: style("h2").breakAfter,
          folded: folded.getBoundingClientRect().height,
        };
        """
    )
    assert found["ink"] == "rgb(31, 35, 40)"
    assert found["nav"] == found["tools"] == "none"
    assert found["figure"] == found["row"] == "avoid"
    assert found["heading"] == "avoid"
    assert found["folded"] > 50
    pdf = reader.printed()
    assert pdf.startswith(b"%PDF")
    assert 5 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 12


def test_without_scripts_the_page_is_whole(driver, pages):
    driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        Reader(driver).look(pages["full"])
    finally:
        driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
    from selenium.webdriver.common.by import By

    assert driver.find_elements(By.CSS_SELECTOR, ".tools") == []
    svg = driver.find_element(By.CSS_SELECTOR, ".plot svg")
    assert svg.size["height"] > 100
    assert len(driver.find_elements(By.CSS_SELECTOR, ".plot .x span")) > 10
