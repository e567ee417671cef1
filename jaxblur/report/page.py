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

    If the file would exceed the limit, each shot is cropped around its largest error, in the same
    way for all of its pictures; the page and the warnings report it.

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
    """Place a window with this share of a shot's pixels where the error is largest."""
    height, width = shot.truth.shape[:2]
    if share >= 1:
        return Window(0, 0, height, width)
    rows, columns = (
        min(size, max(SMALLEST_CROP, round(size * share**0.5))) for size in (height, width)
    )
    maps = [picture.flip for picture in shot.pictures if picture.flip is not None]
    error = np.mean(maps, axis=0) if maps else np.zeros((height, width))
    total = np.pad(error.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    sums = total[rows:, columns:] - total[:-rows, columns:] - total[rows:, :-columns]
    top, left = np.unravel_index(np.argmax(sums + total[:-rows, :-columns]), sums.shape)
    return Window(int(top), int(left), rows, columns)


def _warnings(
    shots: Sequence[Shot], windows: Sequence[Window], max_megabytes: float
) -> tuple[str, ...]:
    return tuple(
        f"{shot.name}: cropped to {window.width}x{window.height} of {shot.truth.shape[1]}x"
        f"{shot.truth.shape[0]} pixels at column {window.left}, row {window.top}, to stay within "
        f"{max_megabytes:g} MB."
        for shot, window in zip(shots, windows, strict=True)
        if shot.truth.shape[:2] != (window.height, window.width)
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
    timed = any(picture.milliseconds is not None for _, picture in rows)
    return environment.get_template("page.html").render(
        result=result,
        rows=rows,
        score_names=list(names),
        timed=timed,
        plotted=timed and bool(names),
        script=script,
        script_hash=_integrity(script),
        style=style,
        style_hash=_integrity(style),
        data=_as_json(_embedded(result, windows)),
        windows=zip(result.shots, windows, strict=True),
        cropped=any(s.truth.shape[:2] != w[2:] for s, w in zip(result.shots, windows, strict=True)),
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
            "pictures": [
                *(_picture(picture, window) for picture in shot.pictures),
                {"method": "truth", "truth": True, "scores": {}, **_encoded(shot.truth, window)},
            ],
        }
        for shot, window in zip(result.shots, windows, strict=True)
    ]


def _picture(picture: Picture, window: Window) -> dict[str, Any]:
    entry = {
        "method": picture.method,
        "group": picture.group,
        "published": picture.published,
        "milliseconds": picture.milliseconds,
        "scores": {name: _finite(value) for name, value in picture.scores.items()},
        "truth": False,
    }
    if picture.image is None:
        return entry
    error = np.clip(window.of(np.asarray(picture.flip)), 0.0, 1.0)
    flip = data_uri(np.floor(error * 255 + 0.5).astype(np.uint8))
    return entry | _encoded(picture.image, window) | {"flip": flip}


def _encoded(image: Any, window: Window) -> dict[str, str]:
    pixels = np.asarray(image)[..., :3]
    color = pixels if pixels.shape[-1] == 3 else pixels[..., :1].repeat(3, axis=-1)
    mantissa, exponent = shared_exponent(window.of(color))
    return {"mantissa": data_uri(mantissa), "exponent": data_uri(exponent)}


def _finite(value: float) -> float | None:
    """Return a finite value, or None for others, because JSON has no infinity."""
    return value if np.isfinite(value) else None
