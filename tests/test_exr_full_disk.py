"""A file that was not stored to its last byte never replaces the old one."""

import json

import pytest

from tests.command_line import spawn

pytestmark = pytest.mark.slow

# A limit on the file size acts like a full disk: bytes beyond it are not written.
SCRIPT = """
import json, resource, sys
import numpy as np
from pathlib import Path
from jaxblur import exr

folder, counts = Path(sys.argv[1]), {"whole": 0, "refused": 0, "partial": []}
image = np.random.default_rng(0).random((40, 60, 3), np.float32)
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
for kind in ("exr", "png", "tif"):
    whole = folder / f"whole.{kind}"
    exr.write_image(whole, image)
    size = whole.stat().st_size
    # The last pages are written when the file is closed.
    for limit in (*range(size - 5000, size, 131), size - 1, size):
        path = folder / f"{limit}.{kind}"
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
        try:
            exr.write_image(path, image)
        except exr.JaxblurIOError as error:
            counts["refused"] += 1
            assert f"/.{limit}." not in str(error), "no temporary file is named"
            assert not path.exists()
        else:
            counts["whole"] += 1
            if path.stat().st_size != size:
                counts["partial"].append(path.name)
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
hidden = [path.name for path in folder.iterdir() if path.name.startswith(".")]
print(json.dumps(counts | {"hidden": hidden}))
"""


def test_a_file_that_lacks_any_of_its_last_bytes_is_rejected(tmp_path):
    outcome = spawn(tmp_path, code=SCRIPT)
    assert outcome.returncode == 0, outcome.stderr
    counts = json.loads(outcome.stdout)
    assert counts["partial"] == [] and counts["hidden"] == []
    assert counts["whole"] == 3 and counts["refused"] > 70
