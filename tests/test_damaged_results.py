"""Damaged files of the kinds that jaxblur writes: fits, tables, states, reports, attributes."""

import functools
import json
import os
import struct
import zipfile
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur import bench, exr, perception
from jaxblur._util.small_files import MOST_BYTES
from jaxblur.bench.results import COLUMNS
from jaxblur.exr import JaxblurIOError
from jaxblur.fitting import descent
from jaxblur.fitting.result import FitResult
from jaxblur.report import MANIFEST, build_page, read_result
from tests.command_line import refused, run
from tests.exr_files import CAR, make_spec, plain_frame, write_parts, write_single
from tests.test_fitting_result import RESULT
from tests.test_report_results import folder as folder

LONG = "1" + 400 * "0"
LONGER = "1" + 5000 * "0"
DEEP = 3000


def mutants(text, count, seed=0):
    """Texts with pieces removed, doubled, moved, or replaced by odd ones."""
    random = np.random.default_rng(seed)
    odd = [
        "",
        "null",
        "nan",
        "-1",
        "0",
        LONG,
        '"',
        "[",
        "}",
        "\n",
        "\0",
        "\u202e",
        ",,",
        "= =",
        "1e999",
    ]
    for _ in range(count):
        start, length = random.integers(len(text)), random.integers(1, 30)
        end, piece = start + length, odd[random.integers(len(odd))]
        pieces = ("", piece, piece + text[start:end], 2 * text[start:end], text[end : end + length])
        yield text[:start] + pieces[random.integers(len(pieces))] + text[end:]


# Results of a fit


def toml(tmp_path, text):
    path = tmp_path / "fitted.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def fitted(tmp_path):
    RESULT.save(tmp_path / "written.toml")
    return (tmp_path / "written.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("soft_z_extent = 0.25", f"soft_z_extent = {LONG}"),
        ("soft_z_extent = 0.25", f"soft_z_extent = {LONGER}"),
        ("steps = 2", "steps = " + DEEP * "[" + DEEP * "]"),
        ("samples = 15", 'samples = "15"'),
        ("samples = 15", "samples = 15.5"),
        ('backend = "auto"', "backend = 3"),
    ],
)
def test_a_damaged_result_names_the_file(tmp_path, fitted, old, new):
    assert old in fitted
    path = toml(tmp_path, fitted.replace(old, new, 1))
    assert f"{path}: " in refused("blur", CAR, "-o", tmp_path / "out.exr", "--parameters", path)


def test_mutants_of_a_result_are_read_or_refused_by_name(tmp_path, fitted):
    outcomes = []
    for text in mutants(fitted, 400):
        path = toml(tmp_path, text)
        try:
            FitResult.load(path)
            outcomes.append(True)
        except ValueError as error:
            assert str(path) in str(error)
            outcomes.append(False)
    assert 20 < sum(outcomes) < 380


# Tables of measurements


def table(tmp_path, **changes):
    record = dict.fromkeys(COLUMNS, "") | {
        "scene": "crossing",
        "width": "64",
        "height": "36",
        "shutter": "1",
        "source": "accumulate 4",
        "method": "pixel_velocity",
        "ms": "1.5",
    }
    record |= changes
    path = tmp_path / "old.csv"
    lines = [",".join(COLUMNS), ",".join(record.values())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="surrogateescape")
    return path


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ms": "0"}, "ms must be a number above 0"),
        ({"ms": "nan"}, "ms must be a number above 0"),
        ({"calibration_ms": "-1"}, "calibration_ms must be"),
        ({"width": "many"}, "many"),
        ({"shutter": "x"}, "x"),
        ({"source": "accumulate 4.5"}, "4.5"),
        ({"samples": LONGER}, "old.csv"),
        ({"radius": "\0"}, "old.csv"),
        ({"radius": 140_000 * "1"}, "is not a table"),
        ({"radius": "\udcff"}, "is no text in UTF-8"),
    ],
)
def test_a_damaged_table_names_the_file(tmp_path, changes, words):
    path = table(tmp_path, **changes)
    message = refused("bench", "--compare", path, "-o", tmp_path / "new.csv")
    assert f"{path}: " in message and words in message
    assert not (tmp_path / "new.csv").exists()


def test_mutants_of_a_table_are_read_or_refused_by_name(tmp_path):
    text = table(tmp_path).read_text()
    outcomes = []
    for mutant in mutants(text, 400):
        path = tmp_path / "mutant.csv"
        path.write_text(mutant)
        try:
            for row in bench.read_rows(path):
                assert row.figures.ms is None or 0 < row.figures.ms < np.inf
            outcomes.append(True)
        except ValueError as error:
            assert str(path) in str(error)
            outcomes.append(False)
    assert 20 < sum(outcomes) < 390


# States of fits


@pytest.fixture
def state(tmp_path):
    optimizer = (jnp.zeros(2), jnp.zeros((), int))
    fresh = descent.State(jnp.zeros(2), optimizer, (), (), 0)
    path = tmp_path / "fit.state.npz"
    descent.save_state(path, fresh, "mark")
    return path, fresh


def test_an_undamaged_state_is_read(state):
    path, fresh = state
    assert descent.load_state(path, fresh, "mark").losses == ()


@pytest.mark.parametrize("byte", [0, 6, 8, 30, 45, 60, 100, -5, -20, -40])
def test_a_state_with_changed_bytes_is_refused_or_read(state, byte):
    path, fresh = state
    for value in (0, 1, 99, 255):
        data = bytearray(path.read_bytes())
        data[byte] ^= value or 1
        (damaged := path.with_name("damaged.npz")).write_bytes(data)
        try:
            descent.load_state(damaged, fresh, "mark")
        except ValueError as error:
            assert f"{damaged}: " in str(error)


def test_an_encrypted_state_is_refused(state):
    path, fresh = state
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as file:
        offsets = [entry.header_offset for entry in file.infolist()]
    for offset in offsets:
        data[offset + 6] |= 1
    start = 0
    while (start := data.find(b"PK\x01\x02", start)) >= 0:
        data[start + 8] |= 1
        start += 4
    path.write_bytes(data)
    with pytest.raises(ValueError, match="does not hold the state of a fit"):
        descent.load_state(path, fresh, "mark")


def test_a_state_of_another_shape_is_refused(state):
    path, fresh = state
    other = descent.State(jnp.zeros(3), fresh.optimizer, (), (), 0)
    with pytest.raises(ValueError, match="does not hold the state of a fit"):
        descent.load_state(path, other, "mark")


def test_a_state_that_unpacks_to_more_than_a_fit_holds_is_refused(state):
    path, fresh = state
    with np.load(path) as file:
        arrays: Any = {**file, "trail": np.zeros(MOST_BYTES // 8)}
    np.savez_compressed(path, **arrays)
    assert path.stat().st_size < 100_000
    with pytest.raises(ValueError, match="does not hold the state of a fit"):
        descent.load_state(path, fresh, "mark")


# Files of every kind that are no such files

READERS = {
    "fit": FitResult.load,
    "state": lambda path: descent.load_state(path, descent.State(jnp.zeros(1), ()), ""),
    "table": bench.read_rows,
    "cameras": exr.read_camera_file,
    "votes": lambda path: perception.read_votes([path]),
    "result": lambda path: read_result(path.parent),
}


@pytest.mark.parametrize("kind", READERS)
def test_what_never_ends_or_is_too_large_is_refused_at_once(tmp_path, kind):
    path = tmp_path / MANIFEST
    refusal = functools.partial(pytest.raises, JaxblurIOError)
    with refusal(match=rf"{MANIFEST}: no such file; "):
        READERS[kind](path)
    os.mkfifo(path)
    with refusal(match=rf"{MANIFEST}: is not a file; "):
        READERS[kind](path)
    path.unlink()
    path.symlink_to("/dev/zero")
    with refusal(match=rf"{MANIFEST}: is not a file; "):
        READERS[kind](path)
    path.unlink()
    path.touch()
    os.truncate(path, MOST_BYTES + 1)
    with refusal(match=rf"{MANIFEST}: is larger than 20 MB; "):
        READERS[kind](path)
    path.unlink()
    path.mkdir()
    with refusal(match=rf"{MANIFEST}: is a folder; "):
        READERS[kind](path)


def test_bytes_that_are_no_text_are_refused_in_plain_words(tmp_path):
    path = tmp_path / MANIFEST
    path.write_bytes(b'{"a": "\xff"}')
    for kind in sorted(READERS.keys() - {"state"}):
        with pytest.raises(JaxblurIOError, match="is no text in UTF-8; "):
            READERS[kind](path)


# Folders of results


def set_picture(key, value):
    def edit(content):
        content["shots"][0]["pictures"][0][key] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "word"),
    [
        (set_picture("scores", {"flip": None}), "scores"),
        (set_picture("scores", {"flip": int(LONG)}), "scores"),
        (set_picture("scores", [1]), "scores"),
        (set_picture("milliseconds", 0), "milliseconds"),
        (set_picture("milliseconds", -1), "milliseconds"),
        (set_picture("milliseconds", int(LONG)), "milliseconds"),
        (set_picture("file", "a\0b"), "file"),
        (lambda content: content.update(shots=[]), "'shots' is empty"),
    ],
)
def test_a_damaged_manifest_names_the_file(folder, edit, word, tmp_path):
    content = json.loads((folder / MANIFEST).read_text())
    edit(content)
    (folder / MANIFEST).write_text(json.dumps(content))
    message = refused("report", folder, "-o", tmp_path / "page.html")
    assert f"{folder / MANIFEST}: " in message or "a\\x00b" in message
    assert word in message or "a\\x00b" in message
    assert not (tmp_path / "page.html").exists()


def test_a_wrong_value_of_a_manifest_is_cut_and_named_in_its_own_words(folder):
    content = json.loads((folder / MANIFEST).read_text())
    content["shots"][0]["pictures"][0]["flip"] = 5000 * [9]
    (folder / MANIFEST).write_text(json.dumps(content))
    with pytest.raises(JaxblurIOError, match=r"'flip' must be str or null, got \[9, 9") as refusal:
        read_result(folder)
    assert len(str(refusal.value)) < 500


def test_a_deep_manifest_is_refused(folder, tmp_path):
    (folder / MANIFEST).write_text(DEEP * "[" + DEEP * "]")
    assert f"{MANIFEST}: " in refused("report", folder, "-o", tmp_path / "page.html")
    (folder / MANIFEST).write_text('{"schema": ' + LONGER + "}")
    assert f"{MANIFEST}: " in refused("report", folder, "-o", tmp_path / "page.html")


def test_mutants_of_a_manifest_are_shown_or_refused_by_name(folder):
    text = (folder / MANIFEST).read_text()
    outcomes = []
    for mutant in mutants(text, 150):
        (folder / MANIFEST).write_text(mutant)
        try:
            build_page(read_result(folder))
            outcomes.append(True)
        except JaxblurIOError as error:
            assert str(folder) in str(error)
            outcomes.append(False)
    assert 10 < sum(outcomes) < 140


def test_a_page_shows_no_characters_that_change_its_reading_order(folder):
    content = json.loads((folder / MANIFEST).read_text())
    content["title"] = "a\u202eb\x1b[31m"
    content["settings"] = {"\u2066name": "\u202evalue", "list": ["\x07"]}
    content["shots"][0]["name"] = "shot\u202e"
    content["shots"][0]["pictures"][0]["method"] = "method\u2067"
    (folder / MANIFEST).write_text(json.dumps(content))
    page = build_page(read_result(folder)).html
    assert not {"\u202e", "\u2066", "\u2067", "\x1b", "\x07"} & set(page)
    assert "a\\u202eb\\x1b[31m" in page


# Attributes and parts of images


def with_attribute(path, kind, data, name_of=b"jaxblur:filter"):
    """Add an attribute of any type to a file of lines."""
    content = bytearray(path.read_bytes())
    position = 8
    rows = top = bottom = 0
    lines = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32}

    def text(start):
        end = content.index(0, start)
        return bytes(content[start:end]), end + 1

    while True:
        name, position = text(position)
        if not name:
            break
        _, position = text(position)
        (size,) = struct.unpack_from("<i", content, position)
        position += 4
        if name == b"compression":
            rows = lines[content[position]]
        if name == b"dataWindow":
            _, top, _, bottom = struct.unpack_from("<4i", content, position)
        position += size
    added = name_of + b"\0" + kind + b"\0" + struct.pack("<i", len(data)) + data
    for chunk in range(-(-(bottom - top + 1) // rows)):
        (offset,) = struct.unpack_from("<Q", content, position + 8 * chunk)
        struct.pack_into("<Q", content, position + 8 * chunk, offset + len(added))
    content[8:8] = added
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        (b"mystery", b"\1\2\3"),
        (b"box2i", struct.pack("<4i", 0, 0, 1, 1)),
        (b"float", struct.pack("<f", 1.5)),
        (b"stringvector", struct.pack("<i", 1) + b"a"),
        (b"string", b"\xff\xfe\x1b[31m"),
    ],
)
def test_an_attribute_of_another_type_does_no_harm(tmp_path, kind, data):
    path = with_attribute(write_single(tmp_path / "in.exr", plain_frame((16, 16))), kind, data)
    for command in (("info", path), ("info", "--json", path)):
        outcome = run(*command)
        assert outcome.status == 0 and "\x1b" not in outcome.out
    blur = ("blur", path, "-o", tmp_path / "out.exr", "--filter", "pixel_velocity")
    outcome = run(*blur)
    assert outcome.status == 0 and "was blurred by" in outcome.err
    # The same output, made by something else, is in the way of a sequence.
    path.rename(tmp_path / "in.0001.exr")
    (tmp_path / "out.exr").rename(tmp_path / "out.0001.exr")
    sequence = ("blur", tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr")
    assert "--overwrite replaces such files" in refused(*sequence)


def test_an_attribute_that_only_openexr_may_write_is_left_out(tmp_path):
    path = write_single(tmp_path / "in.exr", plain_frame((16, 16)))
    with_attribute(path, b"int", struct.pack("<i", 3), b"version")
    blur = ("blur", path, "-o", tmp_path / "out.exr", "--filter", "pixel_velocity")
    assert run(*blur).status == 0
    assert "version" not in exr.inspect(tmp_path / "out.exr").parts[0].attributes


@pytest.mark.parametrize(
    ("kind", "what"), [(b"mystery", "uint8[4000000]"), (b"floatvector", "float[1000000]")]
)
def test_a_long_attribute_is_listed_by_its_type(tmp_path, kind, what):
    path = write_single(tmp_path / "in.exr", plain_frame((16, 16)))
    with_attribute(path, kind, bytes(4_000_000))
    assert exr.inspect(path).parts[0].attributes["jaxblur:filter"] == what
    assert what in run("info", "-v", path).out


def test_many_parts_are_listed_once(tmp_path, monkeypatch):
    channels = plain_frame((4, 5))
    parts = [(make_spec(channels, name="beauty"), channels)]
    for index in range(40):
        more = {f"extra{index}": channels["R"]}
        parts.append((make_spec(more, name=f"part{index}"), more))
    path = write_parts(tmp_path / "parts.exr", parts)
    opened = []
    open_input = exr.opening.open_input

    def counted(name):
        opened.append(name)
        return open_input(name)

    for module in (exr.channels, exr.listing, exr.survey):
        monkeypatch.setattr(module, "open_input", counted)
    outcome = run("info", path)
    assert outcome.status == 0 and "part39.extra39" in outcome.out
    assert len(opened) < 10
