"""The motion-vector conventions of renderers, as data.

A preset names the channels that hold the vectors and the conversion of their raw values to
displacements. `VectorPair.time` is the target of the vectors once the signs are applied: -1 means
the displacement from a point's current position to its position one frame (or one shutter) earlier,
+1 to its position one frame later, in pixels, x right, y **down**.

``verified=False`` marks conventions from documentation or forums that were not checked against
source code or renders: measure them with `jaxblur.vectors.rank_conventions`.
"""

import dataclasses
from typing import Literal

Scale = Literal["pixels", "size", "half-size", "max-displace"]
Span = Literal["frame", "shutter"]
DepthKind = Literal["z", "-z", "1/z", "normalized-near1", "flat"]
"""What a renderer stores as depth."""


@dataclasses.dataclass(frozen=True)
class VectorPair:
    """Two channels that hold one displacement.

    Attributes:
        x: name of the channel with the first component, or its ending; ``*`` matches any
            characters except a dot.
        y: the same for the second component.
        time: -1 if ``(sign_x, sign_y) * raw`` leads to the previous position, +1 to the next.
        sign_x: +1, or -1 if the raw component has the opposite direction.
        sign_y: the same for y; axes after the sign are x right, y down.
    """

    x: str
    y: str
    time: Literal[-1, 1]
    sign_x: Literal[-1, 1]
    sign_y: Literal[-1, 1]


Layout = tuple[VectorPair, ...]
"""Pairs of channels that a file must hold together, to one or both neighbors in time."""


@dataclasses.dataclass(frozen=True)
class Preset:
    """One convention: ``displacement = sign * (raw - offset) * gain * scale``.

    Attributes:
        name: the key in `PRESETS`.
        layouts: alternatives, the fullest first; each one or two pairs (previous and next).
        scale: "pixels" 1; "size" (width, height); "half-size" half of that; "max-displace" a number
            in pixels that is not in the file and must be given by the caller.
        offset: raw value of a point at rest.
        gain: factor after the offset.
        span: "frame" if vectors cover a full frame, "shutter" if they cover the exposure of the
            render that wrote them (the caller gives its length).
        depth: kind of depth that the same renderer writes.
        premultiplied: whether raw vectors were multiplied by alpha.
        named: whether the channel names alone identify the convention, so that
            ``preset="auto"`` may choose it.
        verified: whether it was checked against source code or renders.
        source: its origin, and notes for use.
    """

    name: str
    layouts: tuple[Layout, ...]
    scale: Scale = "pixels"
    offset: float = 0.0
    gain: float = 1.0
    span: Span = "frame"
    depth: DepthKind = "z"
    premultiplied: bool = False
    named: bool = False
    verified: bool = False
    source: str = ""


def _one_pair(
    names: tuple[tuple[str, str], ...],
    time: Literal[-1, 1],
    sign_x: Literal[-1, 1],
    sign_y: Literal[-1, 1],
) -> tuple[Layout, ...]:
    """Make one single-pair layout for every alternative spelling of the channel names."""
    return tuple((VectorPair(x, y, time, sign_x, sign_y),) for x, y in names)


def _spellings(*layers: str) -> tuple[tuple[str, str], ...]:
    """List the channel pairs under which two components of a layer are stored."""
    components = (("R", "G"), ("r", "g"), ("X", "Y"), ("x", "y"), ("u", "v"))
    return tuple((f"{layer}.{x}", f"{layer}.{y}") for layer in layers for x, y in components)


# Common names of layers with vectors; these names do not identify a convention.
_ANY_LAYER = (
    *_spellings("velocity", "Velocity", "motion", "motionvector", "motionvec", "mv", "mvec"),
    *_spellings("MotionVectors", "MotionVector", "motion_vector", "flow", "uv", "rsmb"),
)
_PLAIN = (("R", "G"), ("X", "Y"), ("x", "y"), ("u", "v"))
_GENERIC = (*_ANY_LAYER, *_PLAIN)

_BLENDER_PREVIOUS = VectorPair("Vector.X", "Vector.Y", -1, 1, -1)
_BLENDER_NEXT = VectorPair("Vector.Z", "Vector.W", 1, -1, 1)
_NUKE_PREVIOUS = VectorPair("backward.u", "backward.v", -1, 1, -1)
_NUKE_NEXT = VectorPair("forward.u", "forward.v", 1, 1, -1)
_JAXBLUR_PREVIOUS = VectorPair("velocity.previous.X", "velocity.previous.Y", -1, 1, 1)
_JAXBLUR_NEXT = VectorPair("velocity.next.X", "velocity.next.Y", 1, 1, 1)

_ALL = (
    Preset(
        "jaxblur",
        ((_JAXBLUR_PREVIOUS, _JAXBLUR_NEXT), *_one_pair((("velocity.X", "velocity.Y"),), 1, 1, 1)),
        named=True,
        verified=True,
        source=(
            "What jaxblur writes: pixels per full frame, forward in time, x right, y down. Curved "
            "paths store the positions one frame before and after, relative to now."
        ),
    ),
    Preset(
        "blender",
        ((_BLENDER_PREVIOUS, _BLENDER_NEXT),),
        named=True,
        verified=True,
        source=(
            "Cycles and EEVEE Vector pass: X,Y = previous - now, Z,W = now - next, pixels per "
            "full frame, y up, whatever the shutter (cycles camera.h; measured on renders). The "
            "pass is empty while render motion blur is on."
        ),
    ),
    Preset(
        "nuke",
        ((_NUKE_PREVIOUS, _NUKE_NEXT), (_NUKE_NEXT,), (_NUKE_PREVIOUS,)),
        depth="1/z",
        named=True,
        source=(
            "forward and backward (together the layer `motion`): pixels per frame to the next and "
            "previous frame (Foundry VectorBlur guide); y up and depth 1/z are common knowledge."
        ),
    ),
    Preset(
        "arnold",
        _one_pair(
            (("motionvector.X", "motionvector.Y"), ("motionvector.R", "motionvector.G")), 1, 1, -1
        ),
        span="shutter",
        named=True,
        source="AOV motionvector: pixels over the shutter interval, y up (forum posts).",
    ),
    Preset(
        "vray",
        _one_pair(
            (
                *(("velocity.R", "velocity.G"), ("Velocity.R", "Velocity.G")),
                *(("VRayVelocity.R", "VRayVelocity.G"), ("VRayVelocity.X", "VRayVelocity.Y")),
            ),
            1,
            1,
            -1,
        ),
        scale="max-displace",
        offset=0.5,
        gain=2.0,
        depth="normalized-near1",
        named=True,
        source=(
            "Velocity: gray 0.5 at rest, `max velocity` scales, y up (docs.chaos.com). Sources "
            "disagree on a factor of two; gain 2 is assumed."
        ),
    ),
    Preset(
        "redshift",
        _one_pair(
            (
                *(("MotionVectors.R", "MotionVectors.G"), ("MotionVectors.X", "MotionVectors.Y")),
                *(("motionVectors.R", "motionVectors.G"), ("motionVectors.X", "motionVectors.Y")),
            ),
            1,
            1,
            -1,
        ),
        named=True,
        source="MotionVectors in raw pixels, filtering off; y up is an assumption.",
    ),
    Preset(
        "renderman",
        _one_pair(_spellings("motionFore"), 1, 1, 1)
        + _one_pair(_spellings("motionBack"), -1, 1, 1),
        span="shutter",
        named=True,
        source=(
            "motionFore, motionBack: raster pixels, y down (community). dPdtime and "
            "dPcameradtime are 3-D and cannot be used."
        ),
    ),
    Preset(
        "karma",
        _one_pair(_GENERIC, 1, 1, -1),
        scale="size",
        span="shutter",
        source="Karma or Mantra, a render variable the user built: NDC difference, y up (forums).",
    ),
    Preset(
        "moonray",
        _one_pair(_spellings("motionvec"), 1, 1, -1),
        scale="half-size",
        premultiplied=True,
        named=True,
        source="motionvec: screen -1..1 per frame, times alpha (openmoonray docs); y up assumed.",
    ),
    Preset(
        "terragen",
        _one_pair(_spellings("tgSurf2dMotion"), 1, 1, -1),
        span="shutter",
        named=True,
        source="tgSurf2dMotion: pixels over the camera's shutter (vendor forum).",
    ),
    Preset(
        "unreal",
        _one_pair((("FinalImage*MotionVectors.R", "FinalImage*MotionVectors.G"),), -1, -1, 1),
        scale="size",
        offset=0.5,
        gain=2.0,
        named=True,
        source=(
            "Movie Render Queue: 0.5 at rest, fraction of the screen, previous to current, y up; "
            "only past motion. Decoding inferred from one training-data loader."
        ),
    ),
    Preset(
        "unity",
        _one_pair(_GENERIC, -1, -1, 1),
        scale="size",
        source="HDRP Recorder: fraction of the screen over a full frame; y flips by platform.",
    ),
    Preset(
        "fsr2",
        _one_pair(_GENERIC, -1, 1, 1),
        source="FSR2 input: pixels, current to previous, y down (README; its sample disagreed).",
    ),
    Preset(
        "falcor",
        _one_pair((*_spellings("mvec"), *_PLAIN), -1, 1, 1),
        scale="size",
        verified=True,
        source="Falcor mvec: previous - current in 0..1, y down, no jitter (MathHelpers.slang).",
    ),
    Preset(
        "dlss",
        _one_pair(_GENERIC, -1, 1, 1),
        scale="size",
        source="Streamline: current to previous, fraction of the screen; may be at render size.",
    ),
    Preset(
        "rsmb8",
        _one_pair(_GENERIC, -1, 1, -1),
        scale="max-displace",
        offset=127 / 255,
        gain=2 * 255 / 254,
        verified=True,
        source="RE:Vision 8 bit: 0..254, 127 at rest, times MaxDisplace, y up (revisionfx.com).",
    ),
    Preset(
        "rsmb16",
        _one_pair((*_spellings("mv2DNormRemap"), *_GENERIC), -1, 1, -1),
        scale="max-displace",
        offset=32767 / 65535,
        gain=2 * 65535 / 65534,
        verified=True,
        source="RE:Vision 16 bit: 0..65534, 32767 at rest, times MaxDisplace, y up (same).",
    ),
    Preset(
        "guertin8",
        _one_pair(_GENERIC, 1, 1, 1),
        scale="max-displace",
        offset=128 / 255,
        gain=2 * 255 / 127,
        span="shutter",
        verified=True,
        source=(
            "8 bit as `encode_velocity` writes: half-spread over the shutter, 128 at rest, times "
            "the radius (MaxDisplace), y down (Guertin et al. 2014, section 3.5)."
        ),
    ),
    Preset(
        "toxik",
        _one_pair(_spellings("mv2DToxik"), 1, 1, -1),
        named=True,
        source="Maya mv2DToxik: pixels per frame, raw (Autodesk Composite help); y up assumed.",
    ),
    Preset(
        "fusion",
        _one_pair(_GENERIC, 1, 1, -1),
        source="Fusion and Resolve: +1 in X is one pixel to the right; y up to be checked.",
    ),
    Preset(
        "flo",
        _one_pair(_GENERIC, 1, 1, 1),
        verified=True,
        source="Optical flow (.flo): pixels, current to next, x right, y down.",
    ),
    Preset(
        "pixel",
        _one_pair(_GENERIC, 1, 1, 1),
        verified=True,
        source="By definition: pixels per frame, forward in time, x right, y down.",
    ),
    Preset(
        "uv",
        _one_pair(_GENERIC, 1, 1, 1),
        scale="size",
        verified=True,
        source="By definition: fractions of width and height per frame, forward, y down.",
    ),
    Preset(
        "ndc",
        _one_pair(_GENERIC, 1, 1, -1),
        scale="half-size",
        verified=True,
        source="By definition: normalized device coordinates -1..1 per frame, forward, y up.",
    ),
)

PRESETS: dict[str, Preset] = {preset.name: preset for preset in _ALL}
"""All presets by name."""
