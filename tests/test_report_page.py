"""The report page in a real browser."""

import re

import numpy as np
import pytest

from jaxblur.report import Picture, Shot, build_page, read_result, write_result

from .browser import chromium

pytestmark = pytest.mark.slow

SHAPE = (40, 64)
HOSTILE = "</script><img src=x onerror=window.hacked=1>"


def ramp(channel):
    """The column number in one channel, 1/64 per pixel, so that a color shows where it was read."""
    image = np.zeros((*SHAPE, 3), np.float32)
    image[..., channel] = (np.arange(SHAPE[1]) + 0.5) / SHAPE[1]
    return image


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    bright = np.full((*SHAPE, 3), 0.1, np.float32)
    bright[20, 30] = (4.0, 0.25, 0.5)
    pictures = [
        Picture("red ramp", ramp(0), 10.0, group="a", published=True),
        Picture("green ramp", ramp(1), 20.0, group="b"),
        Picture("flat", bright, 40.0, group="b"),
        Picture(HOSTILE, np.zeros((*SHAPE, 3), np.float32)),
        Picture("figures only", milliseconds=80.0, scores={"flip": 0.01, "psnr": np.inf}),
    ]
    shots = [
        Shot("first", ramp(2), pictures, {HOSTILE: HOSTILE}),
        Shot(HOSTILE, np.full((*SHAPE, 3), 0.5, np.float32), [Picture("red ramp", ramp(0))]),
    ]
    write_result(folder, f"Title {HOSTILE}", shots)
    path = folder / "page.html"
    path.write_text(build_page(read_result(folder)).html, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


@pytest.fixture
def problems():
    return []


@pytest.fixture
def page(browser, page_file, problems):
    """Load the page; a console message, an error or a request fails the test."""
    with browser.new_context(viewport={"width": 1280, "height": 900}) as context:
        opened = context.new_page()
        opened.on("console", lambda message: problems.append(message.text))
        opened.on("pageerror", lambda error: problems.append(str(error)))
        opened.on("dialog", lambda dialog: problems.append("dialog"))
        opened.on("request", lambda request: problems.append(request.url))
        opened.goto(page_file.as_uri())
        drawn(opened)
        # The only requests are the page itself and the data that it embeds.
        problems[:] = [p for p in problems if p != page_file.as_uri() and p[:5] != "data:"]
        yield opened
        assert [p for p in problems if p[:5] not in ("data:", "blob:")] == []


def drawn(page):
    """Wait until the canvas shows the requested pictures."""
    page.wait_for_selector("#canvas[data-drawn=yes]")


def color(page, x=0.5, y=0.5):
    """The color of the canvas at a share of its width and height."""
    drawn(page)
    return page.evaluate(
        "([x, y]) => { const c = document.getElementById('canvas');"
        "const at = [x * (c.width - 1), y * (c.height - 1)].map(Math.round);"
        "const copy = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });"
        "copy.drawImage(c, ...at, 1, 1, 0, 0, 1, 1);"
        "return [...copy.getImageData(0, 0, 1, 1).data.slice(0, 3)]; }",
        [x, y],
    )


def linear(level):
    value = level / 255
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def set_range(page, name, value):
    page.evaluate(
        "([id, value]) => { const e = document.getElementById(id); e.value = value;"
        "e.dispatchEvent(new Event('input', { bubbles: true })); }",
        [name, str(value)],
    )
    drawn(page)


def chosen(page):
    return page.locator("#methods [aria-checked=true]").inner_text()


def test_the_page_loads_and_names_its_picture(page):
    assert page.get_by_role("radio", checked=True).inner_text().endswith("red ramp")
    assert page.locator("#canvas").get_attribute("aria-label") == "Picture of first by red ramp"
    red = color(page)
    assert linear(red[0]) == pytest.approx(0.5, abs=0.02) and red[1:] == [0, 0]


def test_number_keys_and_letters_switch_the_picture(page):
    for key, name, channel in (("2", "green ramp", 1), ("t", "truth", 2), ("1", "red ramp", 0)):
        page.keyboard.press(key)
        shown = color(page)
        assert page.get_by_role("radio", name=name).get_attribute("aria-checked") == "true"
        assert shown[channel] > 150 and sum(shown) == shown[channel]
        assert page.get_by_role("status").inner_text() == f"{name} of first"
    page.keyboard.press("x")
    assert color(page)[2] > 150, "swapped with the truth"
    page.keyboard.press("9")
    assert "truth" in chosen(page), "there is no ninth picture"


def test_arrow_keys_walk_through_the_pictures(page):
    page.get_by_role("radio", name="red ramp").focus()
    page.keyboard.press("ArrowRight")
    assert "green ramp" in chosen(page)
    assert page.evaluate("document.activeElement.textContent").endswith("green ramp")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert "truth" in chosen(page)


def test_the_slider_shows_the_picture_left_and_the_compared_one_right(page):
    page.keyboard.press("2")
    set_range(page, "slide", 50)
    left, right = color(page, 0.25), color(page, 0.75)
    assert left[1] > 100 and left[2] == 0 and right[2] > 100 and right[1] == 0
    assert page.locator("#tag-left").inner_text() == "green ramp"
    assert page.locator("#tag-right").inner_text() == "truth"
    page.locator("#slide").focus()
    page.keyboard.press("Home")
    assert color(page, 0.25)[2] > 60, "the slider works by keyboard"
    assert page.locator("#tag-left").inner_text() == ""


def test_zoom_and_pan_are_the_same_for_all_pictures(page):
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    for _ in range(4):
        page.mouse.wheel(0, -100)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.35 * box["width"], box["y"] + 0.5 * box["height"], steps=3)
    page.mouse.up()
    drawn(page)
    before = page.locator("#canvas").evaluate("c => [c.dataset.scale, c.dataset.x, c.dataset.y]")
    places = np.array([0.1, 0.5, 0.9])
    columns = {}
    for key, channel in (("1", 0), ("2", 1), ("t", 2)):
        page.keyboard.press(key)
        columns[key] = [linear(color(page, x)[channel]) * SHAPE[1] for x in places]
    after = page.locator("#canvas").evaluate("c => [c.dataset.scale, c.dataset.x, c.dataset.y]")
    assert before == after
    np.testing.assert_allclose(columns["2"], columns["1"], atol=0.6)
    np.testing.assert_allclose(columns["t"], columns["1"], atol=0.6)
    # 4 zoom steps of 1.25 centered at 30 % of the width, then 5 % to the right.
    seen = 0.3 + (places - 0.35) / 1.25**4
    np.testing.assert_allclose(columns["1"], seen * SHAPE[1], atol=1.2)


def test_zoom_keys_and_fit(page):
    fitted = page.locator("#zoom").inner_text()
    page.keyboard.press("+")
    drawn(page)
    assert page.locator("#zoom").inner_text() != fitted
    page.get_by_role("button", name="Fit").click()
    assert page.locator("#zoom").inner_text() == fitted


def test_exposure_multiplies_light(page):
    page.keyboard.press("3")
    before = linear(color(page, 0.1)[0])
    set_range(page, "exposure", 2)
    assert linear(color(page, 0.1)[0]) == pytest.approx(4 * before, rel=0.03)
    page.keyboard.press("[")
    page.keyboard.press("[")
    assert page.locator("#stops").inner_text() == "+1 stops"
    assert linear(color(page, 0.1)[0]) == pytest.approx(2 * before, rel=0.03)


def test_values_under_the_cursor_are_those_of_the_files(page):
    page.keyboard.press("3")
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(
        box["x"] + 30.5 / SHAPE[1] * box["width"], box["y"] + 20.5 / SHAPE[0] * box["height"]
    )
    readout = page.locator("#readout").inner_text()
    assert "row 20, column 30" in readout
    found = re.search(r"flat: R ([\d.]+) G ([\d.]+) B ([\d.]+)  FLIP ([\d.]+)", readout)
    assert found, readout
    assert [float(v) for v in found.groups()[:3]] == pytest.approx([4, 0.25, 0.5], abs=0.02)
    assert 0 <= float(found[4]) <= 1 and "truth: R 0.000 G 0.000 B 0.47" in readout


def test_the_keyboard_reads_values_too(page):
    page.locator("#canvas").focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowRight")
    drawn(page)
    assert "row 21, column 33" in page.locator("#readout").inner_text()
    assert "row 21" in page.get_by_role("status").inner_text()
    x = page.locator("#canvas").get_attribute("data-x")
    page.keyboard.press("Shift+ArrowRight")
    drawn(page)
    assert page.locator("#canvas").get_attribute("data-x") != x


def test_the_flip_map_can_be_switched_on_and_off(page):
    picture = color(page)
    page.keyboard.press("f")
    assert page.get_by_role("button", name="FLIP map").get_attribute("aria-pressed") == "true"
    error = color(page)
    assert error != picture and error[0] > 0 and error[2] > 0, "a color of the map, not red"
    page.get_by_role("button", name="FLIP map").click()
    assert color(page) == picture


def test_points_of_the_plot_select_their_picture(page):
    points = page.locator("#plot .point")
    assert points.count() == 4, "two of six pictures have no time"
    assert page.locator("#plot polygon.point").count() == 1, "one is published"
    page.get_by_role("button", name=re.compile("^green ramp: 20.0 ms")).click()
    assert "green ramp" in chosen(page) and color(page)[1] > 150
    page.get_by_role("button", name=re.compile("^flat: 40.0 ms")).focus()
    page.keyboard.press("Enter")
    assert "flat" in chosen(page)
    page.locator("#axis").select_option("psnr")
    assert points.count() == 3, "infinity has no place"


def test_tables_sort_both_ways_and_show_their_picture(page):
    def column(number):
        return page.locator(f"#scores tbody tr td:nth-child({number})").all_inner_texts()

    head = page.get_by_role("columnheader", name="milliseconds")
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    last = page.locator("#scores thead th").count()
    assert column(last) == ["10", "20", "40", "80", "", ""]
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "descending"
    assert column(last) == ["80", "40", "20", "10", "", ""]
    page.get_by_role("columnheader", name="psnr").get_by_role("button").click()
    assert "inf" in column(3)[-1]
    page.locator("#scores tbody tr", has_text="green ramp").click()
    assert "green ramp" in chosen(page)


def test_a_name_with_markup_does_not_run_and_is_shown_as_text(page):
    page.locator("#shot").select_option(HOSTILE)
    drawn(page)
    page.locator("#shot").select_option("first")
    page.get_by_role("radio", name=HOSTILE).click()
    drawn(page)
    assert page.evaluate("window.hacked") is None
    assert page.locator("img").count() == 0
    assert page.title() == f"Title {HOSTILE}"
    assert page.get_by_role("heading", level=1).inner_text() == f"Title {HOSTILE}"
    assert HOSTILE in page.locator("#scores").inner_text()


def test_another_shot_has_its_own_pictures(page):
    page.keyboard.press("4")
    page.locator("#shot").select_option(HOSTILE)
    drawn(page)
    assert page.get_by_role("radio").count() == 2
    assert "No times" in page.locator("#plot").text_content()


def test_a_method_without_picture_says_so(page):
    page.get_by_role("radio", name="figures only").click()
    assert page.get_by_role("status").inner_text() == "figures only has scores only"


def test_every_control_has_a_name_and_focus_can_be_seen(page):
    unnamed = page.evaluate(
        "[...document.querySelectorAll('button, select, input, [tabindex], [role=button]')]"
        ".filter(e => e.id !== 'figures' && !(e.textContent.trim() || e.ariaLabel ||"
        "e.labels?.[0]?.textContent.trim())).map(e => e.outerHTML.slice(0, 80))"
    )
    assert unnamed == []
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the tables"
    page.locator("#fit").focus()
    page.keyboard.press("Shift+Tab")
    width = page.evaluate("getComputedStyle(document.activeElement).outlineWidth")
    assert width == "3px"


@pytest.mark.parametrize(("scheme", "dark"), [("light", False), ("dark", True)])
def test_colors_follow_the_system(page, scheme, dark):
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
    ground, ink = (
        page.evaluate(f"getComputedStyle(document.body).{name}")
        for name in ("backgroundColor", "color")
    )
    light = [sum(map(int, re.findall(r"\d+", value)[:3])) for value in (ground, ink)]
    assert (light[0] < light[1]) == dark and abs(light[0] - light[1]) > 400
    scroll = page.evaluate("getComputedStyle(document.documentElement).scrollBehavior")
    assert scroll == "auto"


@pytest.fixture(scope="module")
def bare_file(tmp_path_factory):
    """Two shots without a truth, the first with vectors."""
    folder = tmp_path_factory.mktemp("bare")
    velocity = np.zeros((*SHAPE, 2), np.float32)
    # Right at the left end of the middle row, up at its right end, rest between.
    velocity[:, :16], velocity[:, 48:] = (8, 0), (0, -4)
    pictures = [Picture("input", ramp(0)), Picture("layered", ramp(1), 12.0)]
    shots = [
        Shot("first", None, pictures, velocity=velocity),
        Shot("second", None, [Picture("input", ramp(2))]),
    ]
    write_result(folder, "bare", shots)
    path = folder / "page.html"
    path.write_text(build_page(read_result(folder)).html, encoding="utf-8")
    return path


@pytest.fixture
def bare(browser, bare_file):
    problems = []
    with browser.new_context(viewport={"width": 1280, "height": 900}) as context:
        opened = context.new_page()
        opened.on("console", lambda message: problems.append(message.text))
        opened.on("pageerror", lambda error: problems.append(str(error)))
        opened.goto(bare_file.as_uri())
        drawn(opened)
        yield opened
        assert problems == []


def test_without_a_truth_the_output_is_compared_with_the_input(bare):
    assert "layered" in chosen(bare) and color(bare)[1] > 150
    set_range(bare, "slide", 50)
    left, right = color(bare, 0.25), color(bare, 0.75)
    assert left[1] > 100 and left[0] == 0 and right[0] > 100 and right[1] == 0
    assert bare.locator("#tag-right").inner_text() == "input"
    assert bare.get_by_role("heading", name="Methods").count() == 1
    heads = bare.locator("#scores thead th").all_inner_texts()
    assert heads == ["shot", "method", "milliseconds"]
    assert bare.locator("#scores tbody td:nth-child(3)").all_inner_texts() == ["", "12", ""]


def test_without_a_truth_there_is_no_error_to_show(bare):
    assert bare.get_by_role("button", name="FLIP map").count() == 0
    shown = color(bare)
    for key in ("t", "f"):
        bare.keyboard.press(key)
        assert color(bare) == shown and "layered" in chosen(bare)
    label = bare.locator("#canvas").get_attribute("aria-label")
    assert label == "Picture of first by layered"


def test_motion_vectors_are_shown_as_colors_and_as_numbers(bare):
    bare.get_by_role("radio", name="motion vectors").click()
    assert color(bare, 0.1) == [255, 0, 0], "right is red, the fastest in full color"
    assert color(bare, 0.5) == [255, 255, 255], "rest is white"
    assert color(bare, 0.9) == pytest.approx([191, 128, 255], abs=2), "up is violet, at half speed"
    set_range(bare, "exposure", 1)
    assert color(bare, 0.9) == pytest.approx([128, 0, 255], abs=2), "a stop shows half the speed"
    box = bare.locator("#canvas").bounding_box()
    bare.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 0.5 * box["height"])
    readout = bare.locator("#readout").inner_text()
    assert re.search(r"motion vectors: x -?0\.00 y -4\.00 px", readout), readout
    assert "input: R 0.9" in readout


def test_a_shot_with_one_picture_and_nothing_else_is_shown(bare):
    bare.locator("#shot").select_option("second")
    assert color(bare)[2] > 150
    assert bare.get_by_role("radio").count() == 1


def test_without_times_there_is_no_plot_and_names_in_tables_stay_whole(browser, tmp_path):
    name = "seq_0040_shot_0120_beauty_v003.1001.exr"
    settings = {f"a_long_setting_{number}": "a value" for number in range(12)}
    shot = Shot(name, ramp(2), [Picture("layered", ramp(0), settings=settings)])
    write_result(tmp_path, "no times", [shot])
    path = tmp_path / "page.html"
    path.write_text(build_page(read_result(tmp_path)).html, encoding="utf-8")
    with browser.new_context(viewport={"width": 1400, "height": 900}) as context:
        page = context.new_page()
        page.goto(path.as_uri())
        drawn(page)
        assert page.get_by_text("Speed against error").count() == 0
        whole = page.locator("td", has_text=name).or_(page.locator(".setting"))
        lines = whole.evaluate_all(
            "all => all.map(e => { const r = document.createRange(); r.selectNodeContents(e);"
            "return r.getClientRects().length; })"
        )
        assert len(lines) > 12 and set(lines) == {1}
