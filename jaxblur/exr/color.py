"""Color spaces of files, and their conversion to sRGB or a view, by OpenColorIO in OpenImageIO.

Filters keep the color space of a file. Only what people look at and what metrics compare is
converted: PNG previews, report pages, scores. The configuration is that of ``$OCIO`` if it is set,
as in other programs, else the one inside OpenColorIO, ``ocio://default``.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import OpenImageIO as oiio

from jaxblur import srgb
from jaxblur._util.errors import JaxblurIOWarning

from .listing import FileInfo

if TYPE_CHECKING:
    from jaxtyping import Float

BUILT_IN = "ocio://default"
LINEAR_SRGB = "lin_rec709_scene"
"""The name by the Color Interop Forum of linear light with the primaries of sRGB."""
COLORS = "jaxblur:colors"
"""Attribute of a picture that was converted: `Conversion.words`."""
INTEGERS = ("uint8", "uint16")

# Chromaticities of red, green, blue and white by the same forum's names of the spaces.
_PRIMARIES = {
    LINEAR_SRGB: (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
    "lin_ap0_scene": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "lin_p3d65_scene": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329),
    "lin_rec2020_scene": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    "lin_adobergb_scene": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329),
}
_NEAR = 1e-3
"""Programs round chromaticities to three digits."""
# What some readers and programs write where nothing is known.
_NOT_SAID = ("", "unknown", "data", "raw", "none", "linear", "scene_linear")
_LINEAR = "linear sRGB"
"""The name, in words, of all of the following."""
_SAME = (LINEAR_SRGB, "lin_rec709", "lin_srgb", "Linear Rec.709 (sRGB)")


@dataclasses.dataclass(frozen=True)
class Conversion:
    """How colors of a file become colors on a screen.

    Attributes:
        space: color space of the file in words of the file, or None if it names none.
        source: what names it: an attribute, or "given".
        view: view of the configuration's default display; None for sRGB without a tone curve.
    """

    space: str | None = None
    source: str = ""
    view: str | None = None

    @property
    def is_identity(self) -> bool:
        """Whether colors stay as they are."""
        return self.view is None and (self.space is None or self.space in _SAME)

    @property
    def words(self) -> str:
        """The conversion in one line, such as ``ACEScg (chromaticities) to sRGB``."""
        start = f"{_LINEAR} (the file names no color space)"
        if self.space is not None:
            name = _LINEAR if self.space in _SAME else self._spaces()[1]
            start = f"{name} ({self.source})"
        if self.is_identity:
            return f"{start} to sRGB"
        if self.view is None:
            return f"{start} to sRGB, by {self._spaces()[0]}"
        display = _config(config_name()).getDefaultDisplayName()
        return f"{start} to {self.view} of {display}, by {config_name()}"

    def light(
        self, image: Float[np.ndarray, "height width channels"]
    ) -> Float[np.ndarray, "height width shown"]:
        """Convert colors to the linear light that a screen shows through the sRGB curve.

        Args:
            image: (H, W, C) colors of the file, alpha premultiplied; shown over black.

        Returns:
            The image itself if nothing is to be converted, else (H, W, 3): with a view 0..1, else
            not clipped.

        Raises:
            ValueError: OpenColorIO cannot convert it.
        """
        gray = image.shape[-1] < 3
        if self.is_identity or (gray and self.view is None):
            return image
        color = image[..., :1].repeat(3, axis=-1) if gray else image[..., :3]
        pixels = oiio.ImageBuf(np.ascontiguousarray(color, np.float32))
        name, space, to = self._spaces()
        context = ("", "")
        if self.view is None:
            shown = oiio.ImageBufAlgo.colorconvert(pixels, space, to, False, *context, name)
        else:
            display = _config(name).getDefaultDisplayName()
            shown = oiio.ImageBufAlgo.ociodisplay(
                pixels, display, self.view, space, "", False, False, *context, name
            )
        if shown.has_error:
            raise ValueError(f"OpenColorIO cannot convert {self.words}: {shown.geterror()}")
        values = np.asarray(shown.get_pixels("float"))
        return values if self.view is None else srgb.decode(np.clip(values, 0, 1))

    def _spaces(self) -> tuple[str, str, str]:
        """Return the configuration, the file's space in its words, and linear sRGB in its words."""
        names = (config_name(),) if self.view else dict.fromkeys((config_name(), BUILT_IN))
        for name in names:
            start, end = (_found(name, space) for space in (self.space or LINEAR_SRGB, LINEAR_SRGB))
            # A view needs no linear sRGB. A configuration of other spaces leaves the plain
            # conversion to the built-in one.
            if start and (end or self.view):
                return name, start, end or ""
        raise ValueError(
            f"`color_space`: the configuration {config_name()} has no {self.space or LINEAR_SRGB}; "
            f"it has {', '.join(color_spaces())}."
        )


def conversion_of(
    info: FileInfo, channel: str, color_space: str | None = None, view: str | None = None
) -> Conversion:
    """Find out how the colors of a file are to be shown.

    The file's space is, in this order, the one given, its ``colorInteropID``, its
    ``chromaticities``, its ``oiio:ColorSpace``. Integer pictures are read as linear sRGB already.

    Args:
        info: listing of the file.
        channel: full name of one of its color channels.
        color_space: space to use instead of the file's.
        view: view to show it in, of the default display; None for sRGB without a tone curve.

    Returns:
        The conversion. A space that is not known is left as it is, with a warning.

    Raises:
        ValueError: the configuration has no such space or view; the message lists those it has.
    """
    check_view(view)
    found = info.channel(channel)
    if found.type in INTEGERS:
        return Conversion(view=view)
    if color_space is not None:
        check_color_space(color_space)
        return Conversion(color_space, "given", view)
    name, source = _named(info.parts[found.part].attributes)
    if name is None:
        if source:
            _warn(info, f"{source} are of no known color space")
        return Conversion(view=view)
    conversion = Conversion(name, source, view)
    if not conversion.is_identity:
        try:
            conversion._spaces()
        except ValueError:
            _warn(info, f"{source} names the color space {name}, which {config_name()} lacks")
            return Conversion(view=view)
    return conversion


def check_view(view: str | None) -> None:
    """Check that the default display has a view.

    Args:
        view: its name, or None.

    Raises:
        ValueError: it has no such view; the message lists those it has.
    """
    if view is not None and view not in views():
        raise ValueError(f"`view` must be one of {', '.join(views())}; got {view!r}.")


def check_color_space(name: str | None) -> None:
    """Check that the configuration has a color space, by name or alias.

    Args:
        name: of the space, or None.

    Raises:
        ValueError: it has no such space; the message lists those it has.
    """
    if name is not None and not any(_found(n, name) for n in (config_name(), BUILT_IN)):
        raise ValueError(f"`color_space` must be one of {', '.join(color_spaces())}; got {name!r}.")


def views() -> tuple[str, ...]:
    """List the views of the default display."""
    config = _config(config_name())
    return tuple(config.getViewNames(config.getDefaultDisplayName()))


def color_spaces() -> tuple[str, ...]:
    """List the color spaces of the configuration."""
    return tuple(_config(config_name()).getColorSpaceNames())


def config_name() -> str:
    """Return the name of the configuration: ``$OCIO``, or the built-in one."""
    return os.environ.get("OCIO") or BUILT_IN


@functools.cache
def _config(name: str) -> Any:
    config = oiio.ColorConfig(name)
    if message := config.geterror():
        raise ValueError(f"$OCIO: {message}; correct the variable, or unset it.")
    return config


@functools.cache
def _found(config: str, space: str) -> str | None:
    """Return the name in a configuration of a space that is given by name, alias or role."""
    resolved = _config(config).resolve(space)
    return resolved if _config(config).getColorSpaceIndex(resolved) >= 0 else None


def _named(attributes: dict[str, Any]) -> tuple[str | None, str]:
    """Return the color space that a header names, and the attribute that names it."""
    known = attributes.get("colorInteropID")
    if isinstance(known, str) and known.lower() not in _NOT_SAID:
        return known, "colorInteropID"
    primaries = attributes.get("chromaticities")
    if isinstance(primaries, tuple) and len(primaries) == 8:
        for name, values in _PRIMARIES.items():
            if np.abs(np.subtract(primaries, values)).max() < _NEAR:
                return name, "chromaticities"
        return None, "its chromaticities"
    written = attributes.get("oiio:ColorSpace")
    if isinstance(written, str) and written.lower() not in _NOT_SAID:
        return written, "oiio:ColorSpace"
    return None, ""


def _warn(info: FileInfo, what: str) -> None:
    warnings.warn(
        f"{info.path}: {what}; its colors are shown as linear sRGB, unless `color_space` is given.",
        JaxblurIOWarning,
        stacklevel=4,
    )
