"""Mattes read from Cryptomattes, by the name of a thing."""

import numpy as np
import pytest

from jaxblur import exr
from tests.exr_files import write_single
from tests.hero_files import HERO, crypto_notes, frame, ids, write_crypto


def test_a_matte_is_read_by_name(tmp_path):
    path = write_crypto(tmp_path / "a.exr")
    np.testing.assert_array_equal(exr.read_cryptomatte(path, "/hero"), np.where(HERO, 0.75, 0))
    ground = exr.read_cryptomatte(path, "/set/*")
    np.testing.assert_array_equal(ground, np.where(HERO, 0.25, 1))
    np.testing.assert_array_equal(exr.read_cryptomatte(path, "CryptoObject:/hero") > 0, HERO)
    (layer,) = exr.cryptomatte_layers(path)
    assert layer.name == "CryptoObject" and list(layer.manifest) == ["/hero", "/set/ground"]


def test_without_a_manifest_the_name_is_hashed(tmp_path):
    notes = {key: value for key, value in crypto_notes().items() if "manifest" not in key}
    for index, given in enumerate((notes, {})):
        path = write_crypto(tmp_path / f"{index}.exr", notes=given)
        np.testing.assert_array_equal(exr.read_cryptomatte(path, "/hero") > 0, HERO)
        with pytest.raises(exr.JaxblurIOError, match="no pixel of CryptoObject is of '/villain'"):
            exr.read_cryptomatte(path, "/villain")


def test_a_manifest_may_be_a_file_beside(tmp_path):
    notes = crypto_notes(manif_file="names.json")
    manifest = notes.pop("cryptomatte/a1b2c3d/manifest")
    path = write_crypto(tmp_path / "a.exr", notes=notes)
    with pytest.raises(exr.JaxblurIOError, match=r"its manifest .*names\.json: no such file"):
        exr.read_cryptomatte(path, "/hero")
    (tmp_path / "names.json").write_text(manifest)
    assert exr.read_cryptomatte(path, "/hero").max() == 0.75


def test_a_thing_outside_the_frame_covers_nothing(tmp_path):
    path = write_crypto(tmp_path / "a.exr", notes=crypto_notes(("/hero", "/away")))
    assert not exr.read_cryptomatte(path, "/away").any()


@pytest.mark.parametrize(
    ("name", "notes", "match"),
    [
        ("/herro", {}, r"no '/herro' in Cryptomatte CryptoObject \(did you mean /hero\?\)"),
        ("/hero", {"hash": "MD5"}, "hash MD5 with uint32_to_float32 is not known"),
        ("/hero", {"name": "Other"}, r"there are no channels Other00\.R"),
        ("/hero", {"manifest": "{"}, "damaged manifest"),
        ("/hero", {"manifest": "[]"}, "damaged manifest \\(it is no object with names"),
        ("/hero", {"manifest": '{"/hero": "123456789"}'}, "'123456789' in place of 8 hexadecimal"),
        ("/hero", {"manifest": '{"/hero": "-1"}'}, "'-1' in place of 8 hexadecimal digits"),
        ("/hero", {"manifest": '{"/hero": 1}'}, "'/hero' has 1 in place of 8 hexadecimal digits"),
        ("/hero", {"manifest": 3000 * "["}, "damaged manifest"),
    ],
)
def test_wrong_cryptomattes(tmp_path, name, notes, match):
    path = write_crypto(tmp_path / "a.exr", notes=crypto_notes(**notes))
    with pytest.raises(exr.JaxblurIOError, match=match):
        exr.read_cryptomatte(path, name)


def test_a_manifest_that_would_fill_the_memory_is_rejected(tmp_path):
    path = write_crypto(tmp_path / "a.exr", notes=crypto_notes(manifest=7_000_000 * "{},"))
    with pytest.raises(exr.JaxblurIOError, match="it is larger than 20 MB"):
        exr.read_cryptomatte(path, "/hero")


def test_identifiers_in_half_are_rejected(tmp_path):
    channels = frame() | ids(("/hero", "/set/ground"))
    types = ["half" if "Crypto" in name else "float" for name in channels]
    path = write_single(tmp_path / "a.exr", channels, types, **crypto_notes())
    with pytest.raises(exr.JaxblurIOError, match="half cannot hold the identifiers"):
        exr.read_cryptomatte(path, "/hero")
    with pytest.raises(exr.JaxblurIOError, match="no Cryptomatte; render with it"):
        exr.read_cryptomatte(write_single(tmp_path / "b.exr", frame()), "/hero")


def test_layers_that_share_a_name_are_told_apart(tmp_path):
    material = {name.replace("Object", "Material"): v for name, v in ids(("/hero", "b")).items()}
    notes = crypto_notes() | {
        key.replace("a1b2c3d", "0000001"): value.replace("Object", "Material")
        for key, value in crypto_notes().items()
    }
    channels = frame() | ids(("/hero", "/set/ground")) | material
    path = write_single(tmp_path / "a.exr", channels, **notes)
    with pytest.raises(exr.JaxblurIOError, match="write CryptoMaterial:/hero or CryptoObject:"):
        exr.read_cryptomatte(path, "/hero")
    assert exr.read_cryptomatte(path, "CryptoMaterial:/hero").max() == 0.75
