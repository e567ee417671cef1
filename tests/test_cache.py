"""The folder of compiled code: no other user can change it."""

import os
import stat
import time
import zlib

import pytest

from jaxblur._util import cache
from jaxblur._util.cache import UnsafeFolderError, private_folder, remove_bad_entries, trim_cache
from tests.command_line import spawn
from tests.exr_files import CAR

as_root = pytest.mark.skipif(os.getuid() != 0, reason="needs root, to give a folder away")
STRANGER = 12345


@pytest.fixture
def home(monkeypatch, tmp_path):
    base = tmp_path / "home" / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(base))
    return base


@pytest.mark.parametrize("umask", [0, 0o022, 0o777])
def test_folders_are_made_for_the_user_only(home, umask):
    before = os.umask(umask)
    try:
        folder = private_folder("kernels")
    finally:
        os.umask(before)
    assert folder == home / "jaxblur" / "kernels"
    for path in (folder, folder.parent, home, home.parent):
        assert stat.S_IMODE(path.stat().st_mode) == 0o700


def test_a_folder_that_others_can_read_is_used(home):
    private_folder("kernels")
    (home / "jaxblur").chmod(0o755)
    assert private_folder("kernels")


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777])
@pytest.mark.parametrize("name", ["", "jaxblur", "jaxblur/kernels"])
def test_a_folder_that_others_can_write_is_not_used(home, name, mode):
    private_folder("kernels")
    (home / name).chmod(mode)
    with pytest.raises(UnsafeFolderError, match=r"writable by other users") as caught:
        private_folder("kernels")
    assert str(home / name) in str(caught.value)


def test_a_writable_folder_far_above_needs_the_sticky_bit(home):
    private_folder()
    home.parent.chmod(0o777)
    with pytest.raises(UnsafeFolderError, match=f"chmod go-w {home.parent}"):
        private_folder()
    home.parent.chmod(0o1777)
    assert private_folder()


@as_root
@pytest.mark.parametrize("name", ["..", ".", "jaxblur", "jaxblur/kernels"])
def test_a_folder_of_another_user_is_not_used(home, name):
    private_folder("kernels")
    os.chown(home / name, STRANGER, STRANGER)
    with pytest.raises(UnsafeFolderError, match="belongs to another user"):
        private_folder("kernels")


@pytest.mark.parametrize("name", ["jaxblur", "jaxblur/kernels"])
def test_a_link_is_not_followed(home, name, tmp_path):
    private_folder("kernels")
    (home / name).rename(tmp_path / "elsewhere")
    (home / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UnsafeFolderError, match="is not a folder; remove it"):
        private_folder("kernels")


def test_a_linked_home_is_resolved(home, monkeypatch, tmp_path):
    private_folder()
    (tmp_path / "link").symlink_to(home)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "link"))
    assert private_folder() == home / "jaxblur"


def test_no_home_is_an_error_of_its_own(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache.pathlib.Path, "home", lambda: (_ for _ in ()).throw(RuntimeError()))
    with pytest.raises(UnsafeFolderError, match="no home folder"):
        private_folder()


def test_a_disk_that_refuses_is_an_error_of_its_own(home, monkeypatch):
    def refuse(path, mode):
        raise OSError(28, "No space left on device", path)

    monkeypatch.setattr(cache.os, "mkdir", refuse)
    with pytest.raises(UnsafeFolderError, match="No space left on device"):
        private_folder()


def test_what_was_used_longest_ago_goes_first(home, monkeypatch):
    folder = private_folder("kernels").parent
    monkeypatch.setattr(cache, "LARGEST", 1000)
    now = time.time()
    names = [
        "kernels/jaxblur_sum_new.so",
        "jit_f-cache",
        "kernels/jaxblur_sum_old.so",
        "jit_g-cache",
    ]
    others = ["mine.so", "kernels/mine.so", "notes.txt", "kernels/jaxblur_sum_old.so.sha256"]
    for age, name in enumerate(names + others):
        (folder / name).write_bytes(bytes(300))
        os.utime(folder / name, (now - 100 * age, now - 100 * age))
    trim_cache()
    left = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert left == {*names[:2], *others[:3]}
    trim_cache()
    assert (folder / names[1]).exists()


def test_entries_that_were_not_written_completely_are_removed_once(home):
    folder = private_folder()
    whole = zlib.compress(bytes(range(256)) * 50)
    entries = {
        "jit_whole-1-cache": whole,
        "jit_cut-2-cache": whole[:-1],
        "jit_flipped-3-cache": whole[:20] + b"?" + whole[21:],
        "jit_empty-4-cache": b"",
        "jit_zstd-5-cache": cache.ZSTD + b"of another Python",
        "notes.txt": b"",
    }
    for name, data in entries.items():
        (folder / name).write_bytes(data)
    remove_bad_entries()
    kept = {"jit_whole-1-cache", "jit_zstd-5-cache", "notes.txt", cache.CHECKED}
    assert {path.name for path in folder.iterdir()} == kept
    old = folder / "jit_whole-1-cache"
    old.write_bytes(whole[:5])
    os.utime(old, (1, 1))
    remove_bad_entries()
    assert old.exists(), "each is read once"


def test_links_in_the_place_of_entries_are_removed(home, tmp_path):
    folder = private_folder()
    planted = tmp_path / "planted"
    planted.write_bytes(zlib.compress(b"x"))
    (folder / "jit_link-1-cache").symlink_to(planted)
    os.mkfifo(folder / "jit_pipe-2-cache")
    remove_bad_entries()
    assert [path.name for path in folder.iterdir()] == [cache.CHECKED] and planted.exists()


@as_root
def test_entries_of_another_user_are_removed_whenever_they_were_written(home):
    folder = private_folder()
    remove_bad_entries()
    for name in ("jit_own-1-cache", "jit_planted-2-cache"):
        (folder / name).write_bytes(zlib.compress(b"x"))
        os.utime(folder / name, (1, 1))
    os.chown(folder / "jit_planted-2-cache", STRANGER, STRANGER)
    remove_bad_entries()
    assert {path.name for path in folder.iterdir()} == {"jit_own-1-cache", cache.CHECKED}


@pytest.mark.slow
def test_an_entry_that_is_cut_off_is_made_again_without_a_word(home, tmp_path):
    environment = os.environ | {"XDG_CACHE_HOME": str(home), "JAX_COMPILATION_CACHE_DIR": ""}
    command = ("blur", CAR, "-o", tmp_path / "out.exr", "--overwrite", "--filter", "pixel_velocity")

    def run():
        # With a seed the frame is blurred through jax, which keeps entries of its own.
        done = spawn(*command, "--backend", "xla", "--seed", "1", env=environment)
        assert done.returncode == 0, done.stderr
        return done.stderr

    usual = run()
    entries = list((home / "jaxblur").glob("*-cache"))
    assert entries
    for path in entries:
        path.write_bytes(path.read_bytes()[:-9])
    assert run() == usual
    assert all(not cache._is_torn(path.read_bytes()) for path in entries)
