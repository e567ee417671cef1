"""Damaged files of every kind through the commands: refused in one line, or read and finite.

The long run is that of experiments/008_hard_cases/fuzz.py; this one uses its parts.
"""

import importlib

import numpy as np
import pytest

pytestmark = pytest.mark.slow

fuzz = importlib.import_module("experiments.008_hard_cases.fuzz")
mutations = importlib.import_module("experiments.008_hard_cases.mutations")

COUNT, WHOLE = 150, 6


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpus")
    fuzz.make_corpus(folder)
    return folder


def test_every_undamaged_file_is_read_except_deep_ones(corpus, tmp_path):
    names = sorted(path.name for path in corpus.glob("*.exr"))
    assert len(names) == 24
    for name in names:
        (tmp_path / "whole.exr").write_bytes((corpus / name).read_bytes())
        found = fuzz.check(tmp_path / "whole.exr", tmp_path)
        # Truth files hold only color.
        no_frame = name == "deep.exr" or "truth" in name
        assert found == {"info": "read", "blur": "refused" if no_frame else "read"}, name


@pytest.mark.parametrize("way", mutations.MUTATIONS)
def test_every_way_of_damage_changes_files(way, corpus):
    data = (corpus / "zip.exr").read_bytes()
    changed = 0
    for seed in range(5):
        damaged = bytearray(data)
        result = mutations.MUTATIONS[way](damaged, np.random.default_rng(seed))
        changed += bytes(damaged if result is None else result) != data
    assert changed >= 3


def test_damaged_files_are_rejected_or_read(corpus):
    """Reads in a worker that has limited memory and is stopped if it hangs."""
    records = list(fuzz.supervise(corpus, 7, range(COUNT)))
    assert [record["number"] for record in records] == list(range(COUNT))
    assert [record for record in records if not fuzz.is_good(record)] == []
    outcomes = [record["blur"] for record in records]
    assert COUNT / 3 < outcomes.count("refused") < COUNT and outcomes.count("read") > 10
    readable = [record["number"] for record in records if record["blur"] == "read"][:WHOLE]
    blurred = list(fuzz.supervise(corpus, 7, readable, whole=True))
    assert [record["blur"] for record in blurred] == ["read"] * WHOLE


def test_a_worker_that_dies_or_hangs_costs_one_file(corpus, monkeypatch):
    def one_worker(corpus, seed, numbers, whole):
        for number in numbers:
            if number == 2:
                return
            if number == 4:
                yield {"number": 4, "info": "hung", "blur": "hung"}
                return
            yield {"number": number, "info": "read", "blur": "read"}

    monkeypatch.setattr(fuzz, "_one_worker", one_worker)
    records = list(fuzz.supervise(corpus, 7, range(6)))
    assert [record["blur"] for record in records] == [
        "read",
        "read",
        "died",
        "read",
        "hung",
        "read",
    ]
    assert sum(not fuzz.is_good(record) for record in records) == 2
