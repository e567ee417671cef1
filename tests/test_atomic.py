"""Files are written whole or not at all, whatever else lies in the folder."""

import os
import threading

import pytest

from jaxblur._util import atomic
from jaxblur._util.atomic import replacing
from jaxblur._util.errors import JaxblurIOError

ORPHAN = ".out.0123abcd.exr"


def write(target, text="new"):
    with replacing(target) as temporary, open(temporary, "w") as file:
        file.write(text)


@pytest.fixture
def target(tmp_path):
    return tmp_path / "out.exr"


def test_an_orphan_is_removed(target):
    (target.parent / ORPHAN).write_text("half")
    (target.parent / ".other.0123abcd.exr").write_text("not ours")
    write(target)
    assert {path.name for path in target.parent.iterdir()} == {"out.exr", ".other.0123abcd.exr"}


def test_a_pipe_in_the_place_of_an_orphan_does_not_hang(target):
    os.mkfifo(target.parent / ORPHAN)
    writing = threading.Thread(target=write, args=(target,), daemon=True)
    writing.start()
    writing.join(10)
    assert not writing.is_alive() and target.read_text() == "new"
    # A pipe that somebody reads can be opened.
    reader = os.open(target.parent / ORPHAN, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write(target, "newer")
    finally:
        os.close(reader)
    assert target.read_text() == "newer" and (target.parent / ORPHAN).exists()


def test_a_link_in_the_place_of_an_orphan_is_left(target, tmp_path):
    (kept := tmp_path / "precious").write_text("kept")
    (target.parent / ORPHAN).symlink_to(kept)
    write(target)
    assert kept.read_text() == "kept" and (target.parent / ORPHAN).is_symlink()


def refuse(*_, **__):
    raise PermissionError(13, "Permission denied")


def test_an_orphan_that_may_not_be_touched_is_no_failure(target, monkeypatch):
    (target.parent / ORPHAN).write_text("of another user")
    opened = os.open
    monkeypatch.setattr(
        atomic.os, "open", lambda p, *a: refuse() if ORPHAN in str(p) else opened(p, *a)
    )
    write(target)
    assert target.read_text() == "new" and (target.parent / ORPHAN).exists()


def test_a_folder_that_cannot_be_listed_is_no_failure(target, monkeypatch):
    monkeypatch.setattr(atomic.os, "listdir", refuse)
    write(target)
    assert target.read_text() == "new"


def test_a_file_that_is_in_its_place_is_done_whatever_the_folder_says(target, monkeypatch):
    fsync = os.fsync

    def full(descriptor):
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):
            raise OSError(28, "No space left on device")
        fsync(descriptor)

    monkeypatch.setattr(atomic.os, "fsync", full)
    write(target)
    assert target.read_text() == "new"


def test_a_last_check_that_fails_leaves_the_old_file(target):
    def check():
        raise JaxblurIOError("in.exr", "changed.")

    target.write_text("old")
    with pytest.raises(JaxblurIOError, match=r"in\.exr: changed"):
        with replacing(target, check) as temporary, open(temporary, "w") as file:
            file.write("new")
    assert target.read_text() == "old" and len(list(target.parent.iterdir())) == 1
