"""Folders for files that jaxblur can generate again."""

import os
import pathlib


def cache_folder() -> pathlib.Path:
    """Return the folder for compiled code: ``$XDG_CACHE_HOME/jaxblur`` or ``~/.cache/jaxblur``.

    Raises:
        RuntimeError: there is no home folder.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    return (pathlib.Path(base) if base else pathlib.Path.home() / ".cache") / "jaxblur"
