"""One HTML file in which a frame is blurred live, by the WGSL of an export."""

import base64
import gzip
import hashlib
import html
import importlib.resources
import json
import math
from typing import Any

import numpy as np

from .compute import print_wgsl
from .graph import Graph
from .plan import plan_of
from .reference import FAR

WIDEST = 20.0
"""Ratio of the ends of a slider from which it moves by factors."""

LARGEST_SHUTTER = 3.0
"""Largest exposure of the slider, in units of that of the frame."""


def build_play(
    graph: Graph,
    planes: dict[str, np.ndarray],
    truth: np.ndarray | None = None,
    *,
    title: str,
    shutter: float = 0.5,
) -> str:
    """Make the page.

    Args:
        graph: the filter, for three channels.
        planes: color (H, W, 3) linear light as a screen shows it, depth (H, W), velocity (H, W, 2)
            half-spread in pixels, and path (H, W, 2, 2) and noise if the filter reads them.
        truth: (H, W, 3) in the same light, or None.
        title: such as the name of the file.
        shutter: exposure in frames that the velocity is for, to be shown.

    Returns:
        The whole file. It needs no network, and WebGPU.

    Raises:
        NotExpressible: the filter has no form in WGSL.
        ValueError: the filter is not for three channels, or a plane that it reads is missing.
    """
    if graph.channels != 3:
        raise ValueError(f"`graph` must be of three channels, got {graph.channels}.")
    missing = [buffer.name for buffer in graph.inputs if buffer.name not in planes]
    if missing:
        raise ValueError(f"`planes` must hold {', '.join(missing)}, which the filter reads.")
    height, width = planes["color"].shape[:2]
    embedded = {"color": _packed(planes["color"], True)}
    embedded |= {
        buffer.name: _packed(np.minimum(planes[buffer.name], FAR), False)
        for buffer in graph.inputs
        if buffer.name != "color"
    }
    embedded.setdefault("velocity", _packed(planes["velocity"], False))
    if truth is not None:
        embedded["truth"] = _packed(truth[..., :3], True)
    data = {
        "plan": plan_of(graph),
        "code": print_wgsl(graph),
        "width": width,
        "height": height,
        "shutter": shutter,
        "planes": embedded,
        "sliders": _sliders(graph),
    }
    style, script = _template("play.css"), _template("webgpu.js") + "\n" + _template("play.js")
    settings = graph.settings
    subtitle = (
        f"{graph.filter.name}, {settings.samples} samples, radius {settings.radius} px, "
        f"{settings.fetch} reads; {width} x {height} pixels. Computed in this browser from the "
        "program that jaxblur runs."
    )
    parts = {
        "TITLE": html.escape(title),
        "SUBTITLE": html.escape(subtitle),
        "STYLE": style,
        "STYLE_HASH": _integrity(style),
        "SCRIPT": script,
        "SCRIPT_HASH": _integrity(script),
        "DATA": _as_json(data),
    }
    pieces = _template("play.html").split("@")
    # Every second piece is a name; what is filled in is not looked at again.
    return "".join(parts[p] if k % 2 else p for k, p in enumerate(pieces))


def _sliders(graph: Graph) -> list[dict[str, Any]]:
    sliders = [
        {
            "name": "shutter",
            "value": 1.0,
            "low": 0.0,
            "high": LARGEST_SHUTTER,
            "log": False,
            "meaning": "length of the exposure, times that of the frame",
            "unit": "",
        }
    ]
    for name, value in graph.parameters.items():
        info = graph.filter.parameter_infos[name]
        low, high = (
            end if math.isfinite(end) else other
            for end, other in zip(info.useful, (info.low, info.high), strict=True)
        )
        low = low if math.isfinite(low) else value - 10 * abs(value) - 1
        high = high if math.isfinite(high) else max(10 * abs(value), 1.0)
        low, high = min(low, value), max(high, value)
        sliders.append(
            {
                "name": name,
                "value": value,
                "low": low,
                "high": high,
                "log": low > 0 and high / low > WIDEST,
                "meaning": info.meaning,
                "unit": info.unit,
            }
        )
    return sliders


def _packed(plane: np.ndarray, half: bool) -> dict[str, Any]:
    """A plane as compressed text."""
    if half:
        plane = np.clip(plane, -65504.0, 65504.0)
    values = np.ascontiguousarray(plane, "<f2" if half else "<f4")
    content = gzip.compress(values.tobytes(), 6, mtime=0)
    return {"half": half, "data": base64.b64encode(content).decode()}


def _template(name: str) -> str:
    folder = importlib.resources.files("jaxblur.export") / "templates"
    return (folder / name).read_text(encoding="utf-8")


def _integrity(text: str) -> str:
    """Hash a script or style, so that the content security policy allows it and no other."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _as_json(content: Any) -> str:
    """Encode as JSON that cannot close the script element around it."""
    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
