"""The files of an integration: those of a folder beside this module, and how to find jaxblur."""

import io
import json
import pathlib
import zipfile
from collections.abc import Mapping

import jaxblur

HOSTS = ("blender", "nuke", "farm")
_HERE = pathlib.Path(__file__).parent
_BLENDER_ENTRY = '"""Registers the extension."""\n\nfrom .blender import register, unregister\n'
_NUKE_ENTRY = '''\
"""What gizmo and menu call."""

from .nuke.blur import blur


def show_panel():
    """Show the panel, whose module needs a window."""
    from .nuke import panel

    panel.show()
'''
_EARLIEST = (1980, 1, 1, 0, 0, 0)
"""Time of all files in a zip, so that the same version writes the same bytes."""


def blender_files(executable: str) -> dict[str, str]:
    """The Blender extension.

    Args:
        executable: path or name of the command that it calls unless the user chooses another.

    Returns:
        Text by path in the zip.
    """
    files = _texts("blender") | _shared(executable)
    manifest = files.pop("blender/blender_manifest.toml")
    return {
        "blender_manifest.toml": _filled(manifest, {"@VERSION@": jaxblur.__version__}),
        "__init__.py": _BLENDER_ENTRY,
        **files,
    }


def nuke_files(executable: str) -> dict[str, str]:
    """The Nuke extension.

    Args:
        executable: path or name of the command that it calls unless the user chooses another.

    Returns:
        Text by path in the folder.
    """
    files = _texts("nuke")
    # Nuke looks for these in the folders of its path.
    found = {name: files.pop(f"nuke/{name}") for name in ("README.md", "jaxblur.gizmo", "menu.py")}
    found["README.md"] = _filled(found["README.md"], {"@VERSION@": jaxblur.__version__})
    package = {"__init__.py": _NUKE_ENTRY, **files, **_shared(executable)}
    return found | {f"jaxblur_nuke/{name}": text for name, text in package.items()}


def farm_files(executable: str) -> dict[str, str]:
    """Job templates of farms.

    Args:
        executable: path or name of the command on the workers.

    Returns:
        Text by path in the folder.
    """
    # JSON is YAML, and right for a path of Windows.
    values = {"@VERSION@": jaxblur.__version__, "@EXECUTABLE@": json.dumps(executable)}
    return {
        name.removeprefix("farm/"): _filled(text, values) for name, text in _texts("farm").items()
    }


def zipped(files: Mapping[str, str]) -> bytes:
    """Pack files, with the same bytes for the same files.

    Args:
        files: text by path.

    Returns:
        A zip. It is not compressed, since compressed bytes depend on the version of zlib.
    """
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, _EARLIEST)
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, files[name])
    return content.getvalue()


def _shared(executable: str) -> dict[str, str]:
    """What is the same in all hosts, and which command to look for."""
    installation = json.dumps({"executable": executable, "version": jaxblur.__version__}, indent=1)
    return _texts("shared") | {"shared/installation.json": installation + "\n"}


def _filled(text: str, values: Mapping[str, str]) -> str:
    """A text with values in the places of their names."""
    for name, value in values.items():
        text = text.replace(name, value)
    return text


def _texts(folder: str) -> dict[str, str]:
    """The texts of a folder of this package by their path from here."""
    paths = sorted(p for p in (_HERE / folder).rglob("*") if p.is_file() and p.suffix != ".pyc")
    return {path.relative_to(_HERE).as_posix(): path.read_text("utf-8") for path in paths}
