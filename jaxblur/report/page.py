"""One HTML file from a result: templates filled in, pictures embedded, file size limited."""

import base64
import hashlib
import importlib.resources
import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .png import data_uri, shared_exponent
from .results import Picture, Result, Shot

MEGABYTE = 1e6
SMALLEST_CROP = 16
ATTEMPTS = 12


class Page(NamedTuple):
    """The page, and warnings about it for the log.

    Attributes:
        html: the whole file.
        warnings: one sentence each.
    """

    html: str
    warnings: tuple[str, ...]


class Window(NamedTuple):
    """The part of a shot that is embedded, in pixels of the frame."""

    top: int
    left: int
    height: int
    width: int

    def of(self, image: np.ndarray) -> np.ndarray:
        """Cut this window out of an image."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def build_page(result: Result, max_megabytes: float = 20.0) -> Page:
    """Make the page.

    If the file would exceed the limit, each shot is cropped to where its error is largest, or
    without a truth its motion, in the same way for all of its pictures; the page and the warnings
    report it.

    Args:
        result: result from `read_result`.
        max_megabytes: largest file size allowed.

    Returns:
        HTML and warnings.

    Raises:
        ValueError: there is no shot, the limit is not above 0, or even small crops do not fit.
    """
    if not max_megabytes > 0:
        raise ValueError(f"`max_megabytes` must be above 0, got {max_megabytes:g}.")
    if not result.shots:
        raise ValueError("`result` must hold at least one shot.")
    share = 1.0
    for _ in range(ATTEMPTS):
        windows = [_window(shot, share) for shot in result.shots]
        html = _render(result, windows)
        size = len(html.encode("utf-8")) / MEGABYTE
        if size <= max_megabytes:
            return Page(html, _warnings(result.shots, windows, max_megabytes))
        share = min(0.7 * share, 0.9 * share * max_megabytes / size)
    raise ValueError(
        f"`max_megabytes` of {max_megabytes:g} is too small for {len(result.shots)} shots, even "
        f"cropped ({size:.1f} MB); allow more, or write fewer pictures."
    )


def _window(shot: Shot, share: float) -> Window:
    """Place a window with this share of a shot's pixels where error, or motion, is largest."""
    height, width = shot.size
    if share >= 1:
        return Window(0, 0, height, width)
    rows, columns = (
        min(size, max(SMALLEST_CROP, round(size * share**0.5))) for size in (height, width)
    )
    maps = [np.asarray(picture.flip) for picture in shot.pictures if picture.flip is not None]
    if not maps and shot.velocity is not None:
        maps = [np.hypot(*np.moveaxis(np.asarray(shot.velocity), -1, 0))]
    weight = np.mean(maps, axis=0) if maps else np.zeros((height, width))
    total = np.pad(weight.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    sums = total[rows:, columns:] - total[:-rows, columns:] - total[rows:, :-columns]
    top, left = np.unravel_index(np.argmax(sums + total[:-rows, :-columns]), sums.shape)
    return Window(int(top), int(left), rows, columns)


def _warnings(
    shots: Sequence[Shot], windows: Sequence[Window], max_megabytes: float
) -> tuple[str, ...]:
    return tuple(
        f"{shot.name}: cropped to {window.width}x{window.height} of {shot.size[1]}x"
        f"{shot.size[0]} pixels at column {window.left}, row {window.top}, to stay within "
        f"{max_megabytes:g} MB."
        for shot, window in zip(shots, windows, strict=True)
        if shot.size != (window.height, window.width)
    )


def _render(result: Result, windows: Sequence[Window]) -> str:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jaxblur.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    script, style = _template("script.js"), _template("style.css")
    rows = [(shot, picture) for shot in result.shots for picture in shot.pictures]
    names = dict.fromkeys(name for _, picture in rows for name in picture.scores)
    timed = [picture.milliseconds is not None for _, picture in rows]
    points = [
        sum(bool(p.scores) and p.milliseconds is not None for p in shot.pictures)
        for shot in result.shots
    ]
    return environment.get_template("page.html").render(
        result=result,
        rows=rows,
        score_names=list(names),
        timed=any(timed),
        # One point shows no trade of speed against error.
        plotted=max(points) > 1,
        judged=any(shot.truth is not None for shot in result.shots),
        moving=any(shot.velocity is not None for shot in result.shots),
        script=script,
        script_hash=_integrity(script),
        style=style,
        style_hash=_integrity(style),
        data=_as_json(_embedded(result, windows)),
        windows=zip(result.shots, windows, strict=True),
        cropped=any(s.size != w[2:] for s, w in zip(result.shots, windows, strict=True)),
    )


def _template(name: str) -> Any:
    """Read a template file that is inserted into the page unchanged."""
    from markupsafe import Markup

    folder = importlib.resources.files("jaxblur.report") / "templates"
    return Markup((folder / name).read_text(encoding="utf-8"))


def _integrity(text: str) -> str:
    """Hash a script or style, so that the content security policy allows it and no other."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _as_json(content: Any) -> Any:
    """Encode as JSON that cannot close the script element around it."""
    from markupsafe import Markup

    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _embedded(result: Result, windows: Sequence[Window]) -> list[dict[str, Any]]:
    return [
        {
            "name": shot.name,
            "top": window.top,
            "left": window.left,
            "height": window.height,
            "width": window.width,
            "pictures": [*(_picture(p, window) for p in shot.pictures), *_buffers(shot, window)],
        }
        for shot, window in zip(result.shots, windows, strict=True)
    ]


def _buffers(shot: Shot, window: Window) -> list[dict[str, Any]]:
    """The motion vectors and the truth, as far as a shot has them, to be shown like pictures."""
    entries = []
    if shot.velocity is not None:
        vectors = _encoded_vectors(shot.velocity, window)
        entries.append({"method": "motion vectors", "truth": False, "scores": {}, **vectors})
    if shot.truth is not None:
        entries.append(
            {"method": "truth", "truth": True, "scores": {}, **_encoded(shot.truth, window)}
        )
    return entries


def _picture(picture: Picture, window: Window) -> dict[str, Any]:
    entry = {
        "method": picture.method,
        "group": picture.group,
        "published": picture.published,
        "milliseconds": picture.milliseconds,
        "scores": {name: _finite(value) for name, value in picture.scores.items()},
        "truth": False,
    }
    if picture.image is not None:
        entry |= _encoded(picture.image, window)
    if picture.flip is not None:
        error = np.clip(window.of(np.asarray(picture.flip)), 0.0, 1.0)
        entry["flip"] = data_uri(np.floor(error * 255 + 0.5).astype(np.uint8))
    return entry


def _encoded(image: Any, window: Window) -> dict[str, str]:
    pixels = np.asarray(image)[..., :3]
    color = pixels if pixels.shape[-1] == 3 else pixels[..., :1].repeat(3, axis=-1)
    mantissa, exponent = shared_exponent(window.of(color))
    return {"mantissa": data_uri(mantissa), "exponent": data_uri(exponent)}


def _encoded_vectors(velocity: Any, window: Window) -> dict[str, Any]:
    """Vectors as whole multiples of a step, plus 2^15, in two images of bytes: high and low."""
    vectors = window.of(np.asarray(velocity, np.float64))
    step = float(np.abs(vectors).max()) / (2**15 - 1) or 1.0
    levels = np.round(vectors / step).astype(np.int64) + 2**15
    high, low = (
        np.dstack([part, np.zeros(part.shape[:2])]).astype(np.uint8)
        for part in np.divmod(levels, 256)
    )
    return {"high": data_uri(high), "low": data_uri(low), "step": step}


def _finite(value: float) -> float | None:
    """Return a finite value, or None for others, because JSON has no infinity."""
    return value if np.isfinite(value) else None
