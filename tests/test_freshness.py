"""Each experiment says truly whether its figures are of the code as it is."""

import pytest

from experiments import freshness

CODE = '''
"""What it does."""


def double(value):  # twice
    """Two times."""
    text = """kept # too"""
    return 2 * value, text
'''


@pytest.mark.parametrize("name", freshness.names())
def test_the_line_of_the_page_is_true(name):
    record = freshness.read_record()
    assert name in record, f"run python -m experiments.freshness --made {name}"
    page = (freshness.FOLDER / name / "README.md").read_text(encoding="utf-8")
    line = freshness.line_of(name, record[name])
    assert line in page.splitlines()[:4], "run python -m experiments.freshness"


def test_words_do_not_count_and_code_does():
    same = CODE.replace("What it", "How it").replace("# twice", "").replace("Two", "Twice")
    assert freshness.without_words(same) == freshness.without_words(CODE)
    assert "kept#too" in freshness.without_words(CODE)
    other = CODE.replace("2 * value", "3 * value")
    assert freshness.without_words(other) != freshness.without_words(CODE)


def test_a_change_of_code_makes_a_page_older(tmp_path, monkeypatch):
    (tmp_path / "scenes").mkdir()
    (tmp_path / "experiments" / "030_new").mkdir(parents=True)
    code, program = tmp_path / "scenes" / "mesh.py", tmp_path / "experiments" / "030_new" / "run.py"
    code.write_text(CODE)
    program.write_text("from jaxblur import scenes\n")
    page = program.with_name("README.md")
    page.write_text("# 030: new\n\nText.\n")
    monkeypatch.setattr(freshness, "PACKAGE", tmp_path)
    monkeypatch.setattr(freshness, "FOLDER", tmp_path / "experiments")
    monkeypatch.setattr(freshness, "RECORD", tmp_path / "made.json")
    monkeypatch.setattr(freshness, "SAME_NUMBERS", tmp_path / "same_numbers.json")
    freshness.RECORD.write_text("{}")
    freshness.SAME_NUMBERS.write_text("{}")
    freshness.main(["--made", "030_new"])
    assert page.read_text().splitlines()[2].endswith(", with the code as it is.*")
    code.write_text(CODE.replace("twice", "two times"))
    freshness.main([])
    assert page.read_text().splitlines()[2].endswith(", with the code as it is.*")
    code.write_text(CODE.replace("2 *", "3 *"))
    freshness.main([])
    assert page.read_text().splitlines()[2].endswith(" Code changed since then: scenes.*")
    assert page.read_text().endswith("\n\nText.\n")

    # The same numbers as in a checkout that has the former code.
    former = tmp_path / "former" / "jaxblur" / "scenes" / "mesh.py"
    former.parent.mkdir(parents=True)
    former.write_text(CODE)
    freshness.main(["--same", "scenes", "--as", str(tmp_path / "former")])
    line = page.read_text().splitlines()[2]
    assert line.endswith("since then (scenes): results are the same, times may differ.*")
    code.write_text(CODE.replace("2 *", "4 *"))
    freshness.main(["--same", "scenes", "--as", str(tmp_path / "former")])
    assert page.read_text().splitlines()[2] == line
    code.write_text(CODE.replace("2 *", "5 *"))
    freshness.main([])
    assert page.read_text().splitlines()[2].endswith(" Code changed since then: scenes.*")
