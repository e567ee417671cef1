"""``jaxblur study``: its folders, and its page with an artificial observer in Chromium."""

import csv

import numpy as np
import pytest

from jaxblur import metrics, perception
from jaxblur.exr import JaxblurIOError, write_image
from jaxblur.report import Picture, Shot, write_result
from tests.browser import chromium
from tests.command_line import refused, run

SHAPE = (48, 64, 3)


def scene():
    """A picture and three that are more and more wrong."""
    generator = np.random.default_rng(0)
    truth = np.repeat(np.repeat(generator.random((6, 8, 3)), 8, 0), 8, 1).astype(np.float32)
    noise = generator.normal(size=SHAPE).astype(np.float32)
    return truth, {
        "good": truth + 0.02 * noise,
        "fair": truth + 0.15 * noise,
        "poor": np.roll(truth, 6, 1) + 0.3 * noise,
    }


def write_folder(folder, animated=()):
    _, pictures = scene()
    for name, image in pictures.items():
        (folder / name).mkdir(parents=True)
        write_image(folder / name / "still.png", np.clip(image, 0, 1))
        for frame in animated:
            moved = np.roll(np.clip(image, 0, None), frame, 1)
            write_image(folder / name / f"moving.{frame:04d}.exr", moved)
    return folder


def test_a_folder_for_each_method(tmp_path):
    study = perception.read_study(write_folder(tmp_path / "in", animated=(1, 2, 3)))
    assert study.stimuli == ("fair", "good", "poor")
    assert [(s.name, len(s.frames[0])) for s in study.scenes] == [("moving", 3), ("still", 1)]
    shown = study.scenes[1].frames[1][0]
    expected = np.asarray(metrics.display(np.clip(scene()[1]["good"], 0, 1)))
    assert shown.dtype == np.uint8 and np.abs(shown / 255 - expected).max() < 0.5 / 255 + 3e-3
    assert study.key == perception.read_study(tmp_path / "in").key


def test_a_result_folder(tmp_path):
    truth, pictures = scene()
    shot = Shot("a shot", truth, [Picture(name, image) for name, image in pictures.items()])
    write_result(tmp_path, "title", [shot])
    study = perception.read_study(tmp_path)
    assert study.stimuli == ("good", "fair", "poor") and study.scenes[0].name == "a shot"


def test_what_is_no_study_is_refused(tmp_path):
    folder = write_folder(tmp_path / "in", animated=(1, 2))
    (folder / "fair" / "moving.0002.exr").unlink()
    with pytest.raises(JaxblurIOError, match="moving has 1 frames by fair and 2 by good"):
        perception.read_study(folder)
    output = ("-o", tmp_path / "out.html")
    assert "every method needs the same" in refused("study", folder, *output)
    assert "holds 0 methods" in refused("study", folder / "good", *output)
    assert "no folder" in refused("study", tmp_path / "none", *output)
    assert "can write .html only" in refused("study", folder, "-o", tmp_path / "out.txt")
    line = refused("study", folder, "-o", tmp_path / "new" / "out.html")
    assert f"no folder {tmp_path / 'new'}; create it first" in line
    good = write_folder(tmp_path / "good")
    write_image(good / "good" / "still.png", np.zeros((16, 16, 3), np.float32))
    assert "one size is needed" in refused("study", good, *output)
    small = ("--max-megabytes", "0.001")
    assert "--max-megabytes" in refused("study", write_folder(tmp_path / "b"), *output, *small)
    assert not (tmp_path / "out.html").exists()


def test_methods_with_equal_pictures_are_refused(tmp_path):
    folder = write_folder(tmp_path / "in", animated=(1,))
    for file in (folder / "fair").iterdir():
        file.write_bytes((folder / "poor" / file.name).read_bytes())
    message = refused("study", folder, "-o", tmp_path / "out.html")
    assert "every picture by fair equals that by poor; leave one of the two out" in message
    # One picture that differs is enough.
    write_image(folder / "fair" / "still.png", np.zeros(SHAPE, np.float32))
    assert perception.read_study(folder).stimuli == ("fair", "good", "poor")


def test_names_cannot_leave_their_place(tmp_path):
    hostile = "</script><script>alert(1)</script>"
    frames = ((np.zeros((4, 4, 3), np.uint8),),) * 3
    study = perception.Study((hostile, "b", "c"), (perception.Scene(hostile, frames),))
    html = perception.build_study(study, perception.Options(title=hostile, question=hostile))
    assert html.count("</script>") == 2 and "alert(1)</script>" not in html


def answers(page, prefers):
    """Answer every pair by a function of the two names, and return the rows that are saved."""
    page.get_by_label("Name or initials").fill("observer, the 1st")
    page.get_by_role("button", name="Begin").click()
    seen = 0
    while True:
        page.wait_for_selector("body[data-state=choosing], body[data-state=end]")
        if page.evaluate("document.body.dataset.state") == "end":
            break
        shown = page.evaluate("({...document.getElementById('stage').dataset})")
        assert page.locator("#progress").inner_text().startswith(f"Pair {seen + 1} of ")
        first = prefers(shown["first"], shown["second"]) == shown["first"]
        if seen % 2:
            page.keyboard.press("1" if first else "2")
        else:
            page.locator("#one" if first else "#two").click()
        seen += 1
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the answers").click()
    return download.value


@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), ("--side-by-side",)])
def test_an_observer_who_prefers_the_lower_flip(tmp_path, beside):
    folder = write_folder(tmp_path / "in", animated=(1, 2))
    options = ("--seconds", "0.05", "--fps", "60", "--repeats", "3", *beside)
    outcome = run("study", folder, "-o", tmp_path / "study.html", *options)
    assert outcome.status == 0, outcome.err
    truth, pictures = scene()
    error = {
        name: float(metrics.flip(np.clip(image, 0, 1), truth)) for name, image in pictures.items()
    }
    order = sorted(error, key=error.__getitem__)
    error |= {f"{name} (coarse copy)": 2.0 for name in pictures}
    problems = []
    with chromium() as browser, browser.new_context() as context:
        page = context.new_page()
        page.on("console", lambda message: problems.append(message.text))
        page.on("pageerror", lambda failure: problems.append(str(failure)))
        page.on("request", lambda request: problems.append(request.url))
        page.goto((tmp_path / "study.html").as_uri())
        download = answers(page, lambda *two: min(two, key=error.__getitem__))
        download.save_as(tmp_path / "votes.csv")
    assert [p for p in problems if p[:5] not in ("data:", "blob:", "file:")] == []
    with (tmp_path / "votes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    # Three pairs, two scenes, three times, and four catch trials; both orders occur.
    assert len(rows) == 3 * 2 * 3 + 4
    assert len({(row["first"], row["second"]) for row in rows if not row["catch"]}) > 3
    assert {row["observer"] for row in rows} == {"observer, the 1st"}
    votes = perception.read_votes([tmp_path / "votes.csv"])
    found = perception.analyze(votes)
    assert not votes.left_out and found.rounds == 6
    assert list(found.scores) == order and list(found.scores.values()) == [12, 6, 0]
    assert found.consistency == found.agreement == 1


@pytest.mark.slow
def test_a_pair_is_seen_again_and_a_study_may_stop_early(tmp_path):
    folder = write_folder(tmp_path / "in")
    run("study", folder, "-o", tmp_path / "study.html", "--seconds", "5", "--catch", "0")
    with chromium() as browser, browser.new_context() as context:
        page = context.new_page()
        # The page's time stands still but for `run_for`, so no answer comes too early or late.
        page.clock.install(time=0)
        page.goto((tmp_path / "study.html").as_uri())
        page.clock.pause_at(60_000)
        page.get_by_role("button", name="Begin").click()
        assert "Please give a name" in page.locator("#missing").inner_text()
        page.get_by_label("Name or initials").fill("ann")
        page.keyboard.press("Enter")
        assert page.locator("#one").is_disabled(), "no answer before both were seen"
        page.keyboard.press("1")
        while page.locator("#one").is_disabled():
            page.clock.run_for(1000)
        assert page.locator("#progress").inner_text() == "Pair 1 of 6"
        page.keyboard.press("Space")
        page.keyboard.press("2")
        assert page.locator("#progress").inner_text() == "Pair 2 of 6"
        page.locator("#early").click()
        rows = list(csv.DictReader(page.locator("#csv").input_value().splitlines()))
    assert len(rows) == 1 and rows[0]["views"] == "2"
