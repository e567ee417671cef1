"""One HTML file in which a frame is blurred live, by the WGSL or GLSL of exports."""

import base64
import dataclasses
import gzip
import hashlib
import html
import importlib.resources
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..filters.parameters import ParameterInfo
from .compute import print_wgsl
from .expressions import NotExpressible
from .fragments import print_glsl
from .graph import Graph
from .plan import plan_of
from .reference import FAR

WIDEST = 20.0
"""Ratio of the ends of a slider from which it moves by factors."""

FINEST = 100.0
"""A slider whose range excludes its lower end begins at this part of the way to its value."""

LARGEST_SHUTTER = 3.0
"""Largest exposure of the slider, in units of that of the frame."""


class PlayForms:
    """The filters of a page in all their forms, texts that are equal kept once.

    Attributes:
        channels: of color: 3, or 4 with alpha, which some filters weigh by.
    """

    def __init__(self, channels: int = 3) -> None:
        self.channels = channels
        self.filters: list[dict[str, Any]] = []
        self.inputs: list[str] = []
        self._texts: dict[str, int] = {}

    def add(self, graphs: Sequence[Graph], start: int) -> None:
        """Add a filter.

        Args:
            graphs: the filter with some numbers of samples, for the channels of the page.
            start: number of the graph with which the page begins.

        Raises:
            NotExpressible: the filter has a form neither in WGSL nor in GLSL.
            ValueError: a graph is of other channels.
        """
        for graph in graphs:
            if graph.channels != self.channels:
                raise ValueError(
                    f"`graphs` must be of {self.channels} channels, got {graph.channels}."
                )
        variants = [self._variant(graph) for graph in graphs]
        chosen = graphs[start]
        self.filters.append(
            {
                "name": chosen.filter.name,
                "summary": chosen.filter.summary,
                "start": start,
                "parameters": _sliders(chosen),
                "variants": variants,
            }
        )
        names = (buffer.name for graph in graphs for buffer in graph.inputs)
        self.inputs = list(dict.fromkeys([*self.inputs, *names]))

    def packed(self) -> str:
        """All of it as compressed text."""
        content = {"texts": list(self._texts), "filters": self.filters}
        return _compressed(json.dumps(content, separators=(",", ":")).encode())

    def _variant(self, graph: Graph) -> dict[str, Any]:
        forms: dict[str, Any] = {}
        problems = []
        try:
            forms["wgsl"] = self._parts(print_wgsl(graph))
        except NotExpressible as error:
            problems.append(error)
        try:
            shaders = print_glsl(graph)
            forms["glsl"] = {name: self._parts(text) for name, text in shaders.items()}
        except NotExpressible as error:
            problems.append(error)
        if not forms:
            raise problems[0]
        settings = dataclasses.asdict(graph.settings)
        # Where a filter runs is no matter of its picture.
        del settings["backend"]
        samples = graph.settings.samples
        return {"samples": samples, "settings": settings, "plan": plan_of(graph), **forms}

    def _parts(self, text: str) -> list[int]:
        """Numbers of the paragraphs of a text: passes that do not depend on samples are shared."""
        return [self._texts.setdefault(part, len(self._texts)) for part in text.split("\n\n")]


def build_play(
    forms: PlayForms,
    planes: dict[str, np.ndarray],
    truth: np.ndarray | None = None,
    *,
    title: str,
    shutter: float = 0.5,
) -> str:
    """Make the page.

    Args:
        forms: the filters; the page begins with the first.
        planes: color (H, W, channels) linear light as a screen shows it, alpha premultiplied,
            depth (H, W), velocity (H, W, 2) half-spread in pixels, and path (H, W, 2, 2) and noise
            if a filter reads them.
        truth: (H, W, 3) in the same light, or None.
        title: such as the name of the file.
        shutter: exposure in frames that the velocity is for, to be shown.

    Returns:
        The whole file. It needs no network; WebGPU, or WebGL 2 for filters with a form in GLSL.

    Raises:
        ValueError: there is no filter, or a plane that one reads is missing.
    """
    if not forms.filters:
        raise ValueError("`forms` must hold a filter; add one.")
    missing = [name for name in forms.inputs if name not in planes]
    if missing:
        raise ValueError(f"`planes` must hold {', '.join(missing)}, which a filter reads.")
    height, width = planes["color"].shape[:2]
    embedded = {"color": _packed(planes["color"], True)}
    embedded |= {
        name: _packed(np.minimum(planes[name], FAR), False)
        for name in forms.inputs
        if name != "color"
    }
    if truth is not None:
        # As many channels as the color; its alpha is not looked at.
        more = [(0, 0), (0, 0), (0, forms.channels - 3)]
        embedded["truth"] = _packed(np.pad(truth[..., :3], more), True)
    data = {
        "width": width,
        "height": height,
        "channels": forms.channels,
        "shutter": shutter,
        "slider": {
            "name": "shutter",
            "value": 1.0,
            "low": 0.0,
            "high": LARGEST_SHUTTER,
            "log": False,
            "meaning": "length of the exposure, times that of the frame",
        },
        "planes": embedded,
        "programs": forms.packed(),
    }
    style = _template("play.css")
    script = "\n".join(map(_template, ("webgpu.js", "webgl.js", "play.js")))
    subtitle = (
        f"{width} x {height} pixels, blurred in this browser by the programs that jaxblur runs."
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
    infos = graph.filter.parameter_infos
    return [_slider(name, value, infos[name]) for name, value in graph.parameters.items()]


def _slider(name: str, value: float, info: ParameterInfo) -> dict[str, Any]:
    low, high = info.low, info.high
    if not (math.isfinite(low) and math.isfinite(high)):
        low, high = (
            end if math.isfinite(end) else other
            for end, other in zip(info.useful, (low, high), strict=True)
        )
    low = low if math.isfinite(low) else value - 10 * abs(value) - 1
    high = high if math.isfinite(high) else max(10 * abs(value), 1.0)
    if not info.allows(low):
        low += (value - low) / FINEST
    low, high = min(low, value), max(high, value)
    return {
        "name": name,
        "value": value,
        "low": low,
        "high": high,
        "log": low > 0 and high / low > WIDEST,
        "meaning": info.meaning,
        "unit": info.unit,
    }


def _packed(plane: np.ndarray, half: bool) -> dict[str, Any]:
    """A plane as compressed text."""
    if half:
        plane = np.clip(plane, -65504.0, 65504.0)
    values = np.ascontiguousarray(plane, "<f2" if half else "<f4")
    return {"half": half, "data": _compressed(values.tobytes())}


def _compressed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


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
