"""Claims about the number of samples and the noise."""

from functools import partial
from statistics import mean
from typing import Any

import jax.numpy as jnp
import numpy as np

from . import claim
from .claim import AGREES, DIFFERS, PARTLY, Extent, Row, blur, example, examples, listed
from .costs import processor_ratio

RADIUS = 20
"""The largest half-spread at 320x180: as wide a part of the frame as 40 is at 640x360."""
ENOUGH = 101
"""Samples whose remaining error is far below what is measured."""


def robust_to_samples(extent: Extent) -> Row:
    """Guertin 3.4.3: the center weight N / kappa makes the result robust to N."""
    pole = claim.named(examples(extent), "flagpole")
    numbers = (5, 9, 15, 25, 35, 51)
    found = {
        name: {
            n: claim.psnr(blur(name, pole.frame, samples=n, radius=RADIUS), pole) for n in numbers
        }
        for name in ("guertin2014", "mcguire2012")
    }
    above = {name: [by_n[n] for n in numbers if n >= 15] for name, by_n in found.items()}
    spread = {name: float(np.ptp(values)) for name, values in above.items()}
    ours = "; ".join(f"{name}: {listed(by_n)} dB" for name, by_n in found.items())
    wins = spread["guertin2014"] < spread["mcguire2012"]
    below = found["guertin2014"][15] - found["guertin2014"][5]
    verdict = f"{AGREES if wins else DIFFERS} from N = 15 on: the range is "
    verdict += f"{spread['guertin2014']:.1f} dB against {spread['mcguire2012']:.1f}; "
    verdict += f"5 samples lose {below:.1f} dB to 15"
    return Row(
        claim="the center weight makes the result robust to thin features and to N",
        source="Guertin 2014, 3.4.3, figure 3.12",
        tested="`flagpole`, PSNR where it moves, by N",
        theirs="robust, where the single-velocity filter ghosts to varying degrees",
        ours=ours,
        verdict=verdict,
        measured=found,
    )


def fewest_samples(extent: Extent) -> Row:
    """Guertin 3.5: N at or above 15 avoids excessive noise."""
    chosen = examples(extent)
    numbers = (5, 9, 15, 25, 35)

    def run(n: int) -> Any:
        return lambda frame, seed: blur("guertin2014", frame, seed=seed, samples=n, radius=RADIUS)

    found = {n: claim.noise_level(chosen, run(n)) for n in numbers}
    power = np.polyfit(np.log(numbers), np.log(list(found.values())), 1)[0]
    drops = found[9] / found[15], found[15] / found[25]
    knee = drops[0] > 1.5 * drops[1]
    verdict = "agrees" if knee else "partly: the noise falls steadily, nothing happens at 15"
    return Row(
        claim="at least 15 samples, to avoid excessive noise",
        source="Guertin 2014, 3.5",
        tested="noise by N, white noise, 255ths of display values, mean of the scenes",
        theirs="N >= 15",
        ours=f"{listed(found)}; as N^{power:.2f}",
        verdict=verdict,
        measured=found | {"power": power},
    )


def better_at_fifteen(extent: Extent) -> Row:
    """Guertin figure 3.4: at 15 samples more pleasing than previous algorithms."""
    chosen = examples(extent)
    gains = {
        one.name: claim.psnr(blur("guertin2014", one.frame, samples=15, radius=RADIUS), one)
        - claim.psnr(blur("mcguire2012", one.frame, samples=15, radius=RADIUS), one)
        for one in chosen
    }
    flips = {
        name: claim.mean_flip(chosen, partial(_at_fifteen, name))
        for name in ("guertin2014", "mcguire2012")
    }
    better = sum(gain > 0 for gain in gains.values())
    gain = mean(gains.values())
    agrees = gain > 0 and flips["guertin2014"] < flips["mcguire2012"]
    verdict = AGREES if agrees else PARTLY if gain > 0 else DIFFERS
    return Row(
        claim="better than the filter with one velocity at 15 samples",
        source="Guertin 2014, figure 3.4",
        tested="PSNR and FLIP where it moves, against `mcguire2012`, both with N = 15",
        theirs="more pleasing results (by eye)",
        ours=f"{gain:+.1f} dB, better in {better} of {len(gains)} scenes; FLIP "
        f"{flips['guertin2014']:.3f} against {flips['mcguire2012']:.3f}",
        verdict=verdict,
        measured={"gain": gains, "flip": flips},
    )


def _at_fifteen(name: str, frame: Any) -> Any:
    return blur(name, frame, samples=15, radius=RADIUS)


def coherent_motion(extent: Extent) -> Row:
    """Guertin 3.6.1: where all moves alike, two directions need about twice the samples."""
    pan = jnp.broadcast_to(jnp.array([10.0, 0.0]), (*extent.size, 2))
    chosen = [
        one._replace(frame=one.frame.replace(velocity=pan, depth=jnp.ones(extent.size)))
        for one in examples(extent)
    ]
    numbers = (11, 15, 21, 31, 41, 61)

    def level(directions: str, n: int) -> float:
        return claim.noise_level(
            chosen,
            lambda frame, seed: blur(
                *("guertin2014", frame, None, seed),
                **{"samples": n, "radius": RADIUS, "directions": directions},
            ),
        )

    both = {n: level("two", n) for n in numbers}
    one = level("one", 15)
    logs = np.log(list(both.values()))
    equal = float(np.exp(np.interp(-np.log(one), -logs, np.log(numbers))))
    ratio = equal / 15
    return Row(
        claim="where all moves alike, two directions use twice the samples for equal quality",
        source="Guertin 2014, 3.6.1",
        tested="all pixels of the scenes at one depth, with +-10 px in x: N with two directions "
        "whose noise is that of 15 samples along one",
        theirs="roughly twice",
        ours=f"{equal:.0f} samples for 15, {ratio:.1f} times",
        verdict=AGREES
        if 1.6 <= ratio <= 2.4
        else f"{DIFFERS}: where a pixel moves like its neighborhood both directions are one line; "
        "only pixels at rest waste samples",
        measured={"two directions": both, "one direction, 15": one},
    )


def banding(extent: Extent) -> Row:
    """Guertin figure 2.3: dithering looks like far denser sampling."""
    chosen = examples(extent)

    def error(noise: str, n: int) -> float:
        pairs = (
            (
                blur("mcguire2012", one.frame, samples=n, radius=RADIUS, noise=noise),
                blur("mcguire2012", one.frame, samples=ENOUGH, radius=RADIUS, noise="none"),
                one,
            )
            for one in chosen
        )
        return mean(claim.flip(*pair) for pair in pairs)

    found = {noise: error(noise, 5) for noise in ("none", "ign", "halton")}
    plain = {n: error("none", n) for n in (7, 9, 15)}
    reached = [n for n, value in plain.items() if value > found["ign"]]
    worth = f"worth {max(reached)} samples or more" if reached else "worth fewer than 7 samples"
    return Row(
        claim="dither in place of banding looks like much denser sampling",
        source="Guertin 2014, 2.3.5, figure 2.3",
        tested=f"`mcguire2012` with 5 samples, FLIP against {ENOUGH} samples; without noise too "
        "with more samples",
        theirs="much denser (by eye)",
        ours=f"without noise {found['none']:.4f}, gradient noise {found['ign']:.4f}, Halton "
        f"{found['halton']:.4f}; without noise by N {listed(plain, 4)}",
        verdict=(PARTLY if found["ign"] < found["none"] else DIFFERS) + ": " + worth
        if len(reached) < 2
        else AGREES + ": " + worth,
        measured={"5 samples": found, "without noise": plain},
    )


def low_discrepancy(extent: Extent) -> Row:
    """Guertin 3.4.5: Halton jitter improves the quality, any other such set does."""
    chosen = examples(extent)
    errors = {"psnr": claim.mean_psnr, "flip": claim.mean_flip}

    def run(noise: str) -> Any:
        if noise == "white":
            return lambda frame: blur("guertin2014", frame, seed=0, samples=15, radius=RADIUS)
        return lambda frame: blur("guertin2014", frame, samples=15, radius=RADIUS, noise=noise)

    found = {
        kind: {score: measure(chosen, run(kind)) for score, measure in errors.items()}
        for kind in ("white", "halton", "ign")
    }
    flips = {kind: values["flip"] for kind, values in found.items()}
    better = flips["halton"] < flips["white"] - 5e-4
    verdict = AGREES if better else DIFFERS
    best = min(flips, key=lambda kind: flips[kind])
    return Row(
        claim="Halton jitter improves the quality; any other low-discrepancy set could be used",
        source="Guertin 2014, 3.4.5",
        tested="`guertin2014`, N = 15, against white noise and interleaved gradient noise; PSNR "
        "and FLIP where it moves, mean of the scenes",
        theirs="better than equal spacing with hashed noise (by eye)",
        ours="; ".join(f"{k}: {v['psnr']:.2f} dB, {v['flip']:.4f}" for k, v in found.items()),
        verdict=f"{verdict} by FLIP; the least is that of {best}",
        measured=found,
    )


def jitter_by_samples(extent: Extent) -> Row:
    """Guertin 3.4.5: the jitter shrinks as phi / N, which lowers noise at high N, unbanded."""
    chosen = examples(extent)

    def level(phi: float) -> float:
        return claim.noise_level(
            chosen,
            lambda frame, seed: blur(
                "guertin2014", frame, {"phi": phi}, seed, samples=47, radius=RADIUS
            ),
        )

    def error(phi: float) -> float:
        return mean(
            claim.difference(
                blur("guertin2014", one.frame, {"phi": phi}, samples=47, radius=RADIUS),
                blur("guertin2014", one.frame, {"phi": 151.0}, samples=151, radius=RADIUS),
                one,
            )
            for one in chosen
        )

    noise = {"phi / N": level(27.0), "constant": level(47.0)}
    errors = {"phi / N": error(27.0), "constant": error(47.0)}
    lower = noise["phi / N"] < noise["constant"]
    unbanded = errors["phi / N"] <= 1.02 * errors["constant"]
    return Row(
        claim="jitter by phi / N lowers the noise at high N, without banding",
        source="Guertin 2014, 3.4.5",
        tested="N = 47, against a jitter that does not shrink: noise, and difference from N = 151, "
        "255ths of display values",
        theirs="less noise, no banding",
        ours=f"noise {noise['phi / N']:.2f} against {noise['constant']:.2f}; difference "
        f"{errors['phi / N']:.2f} against {errors['constant']:.2f}",
        verdict=AGREES if lower and unbanded else PARTLY if lower else DIFFERS,
        measured={"noise": noise, "difference": errors},
    )


def constant_spacing(extent: Extent) -> Row:
    """McGuire 2.1: a constant k / S holds the quality as the resolution grows."""
    steps = [(extent.small, 9, 7), (extent.size, 19, 15), (extent.large, 39, 31)]

    def error(size: tuple[int, int], radius: int, samples: int) -> float:
        return mean(
            claim.difference(
                blur("mcguire2012", one.frame, samples=samples, radius=radius),
                blur("mcguire2012", one.frame, samples=6 * samples + 1, radius=radius),
                one,
            )
            for one in examples(extent, size)
        )

    growing = {f"{size[1]}x{size[0]}": error(size, radius, n) for size, radius, n in steps}
    fixed = {f"{size[1]}x{size[0]}": error(size, radius, 7) for size, radius, _ in steps}
    ratio, without = (_last_over_first(values) for values in (growing, fixed))
    return Row(
        claim="k / S constant holds the quality as the resolution grows",
        source="McGuire 2012, 2.1 (a hypothesis)",
        tested="`mcguire2012`, k = 9, 19, 39 with S = 7, 15, 31, and with S = 7; mean of the "
        "scenes, difference from six times the samples, 255ths of display values",
        theirs="approximately constant",
        ours=f"{listed(growing)}; with S = 7: {listed(fixed)}",
        verdict=AGREES
        if 0.8 <= ratio <= 1.25 and ratio < without
        else f"{PARTLY}: the error falls as the resolution grows"
        if ratio < 0.8
        else DIFFERS,
        measured={"k / S constant": growing, "S = 7": fixed},
    )


def _last_over_first(values: dict[str, float]) -> float:
    first, *_, last = values.values()
    return last / first


def five_or_fifteen(extent: Extent) -> Row:
    """McGuire figure 7: S = 15 is perceptibly better than S = 5, at nearly the same cost."""
    gears = example("gears", extent.size, 1.0, extent.truth_samples)
    found = {}
    for n in (5, 15):
        image = blur("mcguire2012", gears.frame, samples=n, radius=RADIUS)
        found[n] = {
            "psnr": claim.psnr(image, gears),
            "flip": claim.flip(image, gears.truth, gears),
        }
    ratio = processor_ratio(
        lambda: blur("mcguire2012", gears.frame, samples=15, radius=RADIUS),
        lambda: blur("mcguire2012", gears.frame, samples=5, radius=RADIUS),
        extent.rounds,
    )
    better = found[15]["flip"] < found[5]["flip"]
    cheap = ratio < 1.25
    verdict = AGREES if better and cheap else PARTLY
    reason = "" if cheap else ": better, but the samples are what costs on a processor"
    return Row(
        claim="S = 15 is perceptibly better than S = 5, at nearly the same cost",
        source="McGuire 2012, section 3, figure 7",
        tested="`gears` of the catalogue, PSNR and FLIP where it moves; processor time",
        theirs="a perceptible increase in quality; nearly the same cost",
        ours="; ".join(
            f"S = {n}: {scores['psnr']:.1f} dB, FLIP {scores['flip']:.3f}"
            for n, scores in found.items()
        )
        + f"; {ratio:.2f} times the time",
        verdict=(verdict if better else DIFFERS) + reason,
        measured={str(n): values for n, values in found.items()} | {"time ratio": ratio},
    )


def split_by_variance(extent: Extent) -> Row:
    """Guertin 3.4.1: half of the samples each is about as good as a split by variance."""
    chosen = examples(extent)
    found = {
        split: claim.mean_psnr(chosen, partial(_split, split)) for split in ("even", "variance")
    }
    gap = found["variance"] - found["even"]
    return Row(
        claim="a split by variance is slightly better, an even one roughly equal",
        source="Guertin 2014, 3.4.1, 3.5, figure 3.7",
        tested="`guertin2014`, N = 35, PSNR where it moves, mean of the scenes",
        theirs="slightly improved, roughly equal (by eye)",
        ours=f"even {found['even']:.2f} dB, by variance {found['variance']:.2f} dB",
        verdict=AGREES
        if 0 <= gap < 0.5
        else PARTLY
        if abs(gap) < 0.5
        else f"{DIFFERS}; so does [005](../005_what_a_scene_needs/README.md), with the reason",
        measured=found,
    )


def _split(split: str, frame: Any) -> Any:
    return blur("guertin2014", frame, samples=35, radius=RADIUS, split=split)


CLAIMS = (
    robust_to_samples,
    fewest_samples,
    better_at_fifteen,
    coherent_motion,
    banding,
    low_discrepancy,
    jitter_by_samples,
    constant_spacing,
    five_or_fifteen,
    split_by_variance,
)
