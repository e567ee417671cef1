"""The names in Cryptomattes, as ``jaxblur info`` lists them."""

from typing import Any

from ..console import print_line, print_table

LISTED = 20
"""Names that are listed without ``-v``."""


def names_of(info: Any) -> list[dict[str, Any]]:
    """The Cryptomatte layers of a file.

    Args:
        info: a `jaxblur.exr.FileInfo`.

    Returns:
        For each layer its ``name``, the number of ``ranks``, and ``identifiers`` by name in
        hexadecimal; without a manifest the identifiers that pixels have, by themselves. For layers
        that are damaged the ``reason``.
    """
    from jaxblur import exr

    if not info.path.lower().endswith(".exr"):
        return []
    try:
        layers = exr.cryptomatte_layers(info.path)
        return [
            {
                "name": layer.name,
                "ranks": len(layer.channels) // 2,
                "manifest": bool(layer.manifest),
                "identifiers": {
                    name: f"{number:08x}"
                    for name, number in (layer.manifest or _unnamed(layer)).items()
                },
            }
            for layer in layers
        ]
    except exr.JaxblurIOError as error:
        return [{"name": "", "reason": error.reason}]


def _unnamed(layer: Any) -> dict[str, int]:
    from jaxblur import exr

    return {f"<{number:08x}>": number for number in exr.identifiers_in(layer)}


def print_names(layers: list[dict[str, Any]], every: bool) -> None:
    """Print the layers and their names.

    Args:
        layers: that `names_of` returned.
        every: all names, not the first `LISTED` of each layer.
    """
    for layer in layers:
        if reason := layer.get("reason"):
            print_line(f"Cryptomatte: damaged ({reason})")
            continue
        rows = list(layer["identifiers"].items())
        holds = f"manifest of {len(rows)} names"
        if not layer["manifest"]:
            holds = f"no manifest, {len(rows)} identifiers in the pixels; names match by their hash"
        print_line()
        print_line(f"Cryptomatte {layer['name']}: {layer['ranks']} ranks, {holds}")
        shown = rows if every else rows[:LISTED]
        if shown:
            print_table(("name", "identifier"), shown)
        if len(shown) < len(rows):
            print_line(f"and {len(rows) - len(shown)} more; -v lists all")
