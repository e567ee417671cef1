"""The corpus of strange files, and fresh mutants of it, on the command line."""

import pytest

from tests.exr_files import plain_frame, write_single
from tests.fuzz import __main__ as fuzz, make_corpus, mutants, rules

MUTANTS, SEED = 50, 20

CORPUS = sorted(make_corpus.CORPUS.glob("*.exr"))


def broken(files):
    return {name: result["broken"] for name, _, result in fuzz.check_all(files) if result["broken"]}


def test_the_corpus_is_small_and_complete():
    assert len(CORPUS) > 40
    assert sum(path.stat().st_size for path in CORPUS) < 300_000


def test_the_script_makes_the_corpus(tmp_path):
    """Names only: compressed bytes differ between versions of the libraries."""
    make_corpus.write_corpus(tmp_path)
    stored = {path.name for path in CORPUS if not path.name.startswith("mutant_")}
    assert {path.name for path in tmp_path.iterdir()} == stored


def test_mutants_are_fixed_by_seed_and_number():
    made = [mutants.make(CORPUS, 3, number) for number in range(60)]
    assert made == [mutants.make(CORPUS, 3, number) for number in range(60)]
    names = {path.name: path.read_bytes() for path in CORPUS}
    changed = [data != names[what.partition(":")[0]] for what, data in made]
    assert sum(changed) > 50
    assert len({what.rpartition(" ")[2] for what, _ in made}) > 8


@pytest.mark.parametrize(
    ("status", "printed", "rule"),
    [
        (0, "fine\n", None),
        (2, "jaxblur: error: a.exr: no.\n", None),
        (3, "", "exit status 3"),
        (1, "Traceback (most recent call last):\n", "a traceback"),
        (2, "", "exit status 2 with 0 errors"),
        (0, "jaxblur: error: a.exr: no.\n", "exit status 0 with 1 errors"),
        (2, 2 * "jaxblur: error: a.exr: no.\n", "with 2 errors"),
        (2, "jaxblur: error: b.exr: no.\n", "without the file's name"),
        (2, "jaxblur: error: a.exr: \x1b[31m\n", "control characters"),
        (0, "x" * 300_000, "bytes printed"),
    ],
)
def test_rules_can_be_broken(tmp_path, status, printed, rule):
    found = rules.broken_rules(status, printed.encode(), tmp_path / "a.exr")
    assert found == [] if rule is None else any(rule in text for text in found)


@pytest.mark.slow
def test_a_process_that_hangs_or_dies_breaks_a_rule(tmp_path):
    file = write_single(tmp_path / "a.exr", plain_frame())
    child = fuzz.Child()
    assert child.check(file)["broken"] == []
    assert child.check(file, seconds=0.001)["broken"] == ["took more than 0.001 s"]
    assert not child.is_alive()
    child = fuzz.Child()
    child.check(file)
    child._process.kill()
    child._process.wait()
    assert "died" in child.check(file)["broken"][0]


@pytest.mark.slow
def test_the_corpus_breaks_no_rule():
    outcomes = {}
    for name, _, result in fuzz.check_all((path.name, path.read_bytes()) for path in CORPUS):
        assert result["broken"] == [], name
        outcomes[name] = result["outcomes"]
    read = [name for name, found in outcomes.items() if found["blur"] == 0]
    assert len(read) > 25 and all(f"scheme_{scheme}.exr" in read for scheme in ("zip", "b44"))


@pytest.mark.slow
def test_mutants_break_no_rule():
    assert broken(mutants.make(CORPUS, SEED, number) for number in range(MUTANTS)) == {}
