"""Metadata in formats that keep no attributes of other names: as JSON in their description.

EXR and PNG store any attribute. TIFF and JPEG store known ones only, such as the description.
"""

import json
from collections.abc import Mapping
from typing import Any

DESCRIPTION = "ImageDescription"
_OURS = "jaxblur:"


def to_text(attributes: Mapping[str, str | int | float] | None) -> str:
    """Return attributes as the text of a description, in ASCII and without line breaks."""
    return json.dumps(dict(attributes or {}))


def is_whole(attributes: Mapping[str, Any]) -> bool:
    """Whether a header holds a description that `to_text` made, with its end."""
    return _parsed(attributes) is not None


def described(attributes: Mapping[str, Any]) -> dict[str, str | int | float]:
    """Return the attributes of jaxblur that the description of a header holds; none of others."""
    return {
        name: value
        for name, value in (_parsed(attributes) or {}).items()
        if name.startswith(_OURS) and isinstance(value, str | int | float)
    }


def _parsed(attributes: Mapping[str, Any]) -> dict[str, Any] | None:
    try:
        found = json.loads(str(attributes.get(DESCRIPTION, "")))
    # A description may be any text, and a crafted one nested without end.
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
