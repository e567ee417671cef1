"""Clips with their quality by the package cvvdp, which `jaxblur.metrics.cvvdp` must reproduce.

    python -m tests.reference.cvvdp_clips

writes cvvdp.json beside this file. It needs the package cvvdp (`pip install cvvdp`, which brings
torch); what it wrote is committed, so that tests need neither.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from jaxblur import exr, srgb

STORED = Path(__file__).with_name("cvvdp.json")
DATA = Path(__file__).parents[1] / "data"
FRAMES = 12


class Pair(NamedTuple):
    """A clip or an image beside its reference, and how they are shown.

    Attributes:
        test: (F, H, W, 3) or (H, W, 3), in the unit of the display.
        reference: the same shape.
        frames_per_second: frame rate; None for an image.
        display: key of `jaxblur.metrics.DISPLAYS`.
    """

    test: np.ndarray
    reference: np.ndarray
    frames_per_second: float | None = 24.0
    display: str = "standard_4k"


def texture(size: tuple[int, int], seed: int) -> np.ndarray:
    """(H, W, 3) colored clouds of several sizes in 0.02 .. 0.9, the same at both borders."""
    generator = np.random.default_rng(seed)
    layers = [
        ndimage.gaussian_filter(generator.random((*size, 3)), (s, s, 0.3), mode="wrap")
        for s in (1.0, 3.0, 8.0)
    ]
    total = sum((layer - layer.mean()) / layer.std() for layer in layers)
    return np.clip(0.35 + 0.12 * total, 0.02, 0.9).astype(np.float32)


def panned(image: np.ndarray, pixels: int, frames: int = FRAMES) -> np.ndarray:
    """(F, H, W, 3): the image moved to the left by so many pixels a frame."""
    return np.stack([np.roll(image, -pixels * number, axis=1) for number in range(frames)])


def blurred(clip: np.ndarray, pixels: int) -> np.ndarray:
    """Mean over a horizontal window of so many pixels."""
    return ndimage.uniform_filter1d(clip, pixels, axis=-2, mode="wrap")


def grain(clip: np.ndarray, strength: float, animated: bool, seed: int = 7) -> np.ndarray:
    """Gray noise, new in every frame or the same in all."""
    generator = np.random.default_rng(seed)
    noise = generator.uniform(-1, 1, (len(clip) if animated else 1, *clip.shape[1:3], 1))
    return (clip + strength * noise).astype(np.float32)


def photographed() -> tuple[np.ndarray, np.ndarray]:
    """(96, 128, 3) parts of a sharp frame and of its true blur."""
    cut = (slice(40, 136), slice(60, 188), slice(0, 3))
    sharp = exr.read_image(DATA / "cube_over_crates_frame_0011.exr")
    truth = exr.read_image(DATA / "cube_over_crates_truth_0011.exr")
    return np.asarray(sharp, np.float32)[cut], np.asarray(truth, np.float32)[cut]


def pairs() -> dict[str, Pair]:
    """Ten clips and three images by name; those of one size, rate and display share a program."""
    still = texture((96, 128), 0)
    pan = panned(still, 3)
    smooth = blurred(pan, 7)
    sharp, truth = photographed()
    flicker = 1 + 0.05 * (-1.0) ** np.arange(FRAMES, dtype=np.float32)[:, None, None, None]
    tinted = (smooth * np.array([1.15, 0.95, 0.8], np.float32)).astype(np.float32)
    small = panned(texture((63, 90), 1), 2)
    bright = panned(900 * texture((64, 96), 2) ** 2, 5)
    return {
        "unblurred": Pair(pan, smooth),
        "animated_grain": Pair(grain(smooth, 0.15, True), smooth),
        "fixed_grain": Pair(grain(smooth, 0.15, False), smooth),
        "flicker": Pair(smooth * flicker, smooth),
        "tint": Pair(tinted, smooth),
        "rendered_pan": Pair(panned(sharp, 1), panned(truth, 1)),
        "fast": Pair(pan, smooth, 60.0, "standard_fhd"),
        "odd_size_headset": Pair(grain(small, 0.4, True), small, 30.0, "standard_hmd"),
        "bright": Pair(blurred(bright, 5), bright, 24.0, "standard_hdr_linear"),
        "bright_pq": Pair(blurred(bright, 5), bright, 24.0, "standard_hdr_pq"),
        "image_unblurred": Pair(sharp, truth, None),
        "image_grain": Pair(grain(still[None], 0.3, True)[0], still, None, "standard_phone"),
        "image_bright": Pair(blurred(bright[0], 9), bright[0], None, "standard_hdr_linear_dark"),
    }


def pq(light: np.ndarray) -> np.ndarray:
    """Code values by SMPTE ST 2084 of light in cd/m2."""
    power = (np.clip(light, 0, 10000) / 10000) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375


def by_the_package(pair: Pair) -> float:
    """Quality in JOD by the package cvvdp on the processor."""
    import pycvvdp  # pyright: ignore[reportMissingImports]
    import torch  # pyright: ignore[reportMissingImports]

    metric = pycvvdp.cvvdp(display_name=pair.display, quiet=True, device=torch.device("cpu"))

    def shown(light: np.ndarray) -> Any:
        if pair.display.startswith("standard_hdr_linear"):
            return light
        code = pq(light) if pair.display == "standard_hdr_pq" else srgb.encode(light.clip(0, 1))
        return np.asarray(code, np.float32)

    quality, _ = metric.predict(
        shown(pair.test),
        shown(pair.reference),
        dim_order="FHWC"[-pair.test.ndim :],
        frames_per_second=pair.frames_per_second or 0,
    )
    return float(quality)


def main() -> None:
    """Write the qualities and what computed them."""
    from importlib.metadata import version

    record = {
        "versions": {name: version(name) for name in ("cvvdp", "torch", "numpy", "scipy")},
        "jod": {name: round(by_the_package(pair), 5) for name, pair in pairs().items()},
    }
    STORED.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
