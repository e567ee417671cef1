"""Does `fit` gain from right derivatives? Each scene is left out in turn.

    python -m experiments.013_gradients.fits -o OUT [--filters NAME,...] [--steps N]

For guertin2014 (gamma, phi, depth_sharpness) and layered (jitter, distinct, front_sharpness), and
each of six scenes of the catalogue: a fit to the other five from the defaults, with the derivative
that the filter has, and with that which it had before, the texels held that it reads. Both take
the same steps of Adam with the same noise, without scans, so that nothing but the derivative leads
them. Each is judged on the scene left out, over the pixels that motion reaches, with several
noise seeds. Writes ``fits`` (PSNR of display values, dB, with 95 % intervals over scenes) and
``fitted`` (the values of each fold).
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxblur
from experiments import common
from jaxblur import metrics
from jaxblur.filters import filter_info
from jaxblur.fitting.constraints import starting_values, to_free
from jaxblur.fitting.descent import State, Task, default_optimizer, descend
from jaxblur.fitting.objective import Objective, draw_noise
from jaxblur.fitting.pairs import make_batches, make_pairs, pixel_weights
from jaxblur.kernels import places

SCENES = ("camera_dolly", "zoom", "crossing", "cube_between_crates", "gears", "rotor_over_city")
SIZE, SHUTTER, TRUTH_SAMPLES = (72, 128), 1.5, 48
FREE = {
    "guertin2014": ("gamma", "phi", "depth_sharpness"),
    "layered": ("jitter", "distinct", "front_sharpness"),
}
SETTINGS = {
    "guertin2014": jaxblur.GuertinSettings(samples=15, radius=20),
    "layered": filter_info("layered").make_settings(samples=35, radius=40),
}
SEEDS = (11, 12, 13)
MODULE = "experiments.013_gradients.fits"


def fitted(name: str, examples: list[common.Example], steps: int) -> dict[str, float]:
    """The parameters after a descent from the defaults."""
    free, defaults = FREE[name], filter_info(name).defaults
    start = defaults | starting_values(name, {key: defaults[key] for key in free})
    objective = Objective(
        filter_name=name,
        free=free,
        pixel="display",
        over="expected" if name == common.GUERTIN else "mean",
        settings=SETTINGS[name],
        noise="fresh",
        noise_draws=1,
    )
    pairs = make_pairs([(e.frame, e.truth) for e in examples], [e.name for e in examples])
    batches = make_batches(pairs, pixel_weights(pairs, "moving", "display"))
    held = {key: value for key, value in start.items() if key not in free}
    task = Task(objective, held, batches, jax.random.key(0))
    optimizer, vector = default_optimizer(steps), to_free(name, start, free)
    final, _ = descend(task, State(vector, optimizer.init(vector)), steps, optimizer)
    return task.parameters(final.free)


def judge(name: str, example: common.Example, parameters: dict[str, float]) -> list[float]:
    """PSNR with each seed of the noise."""
    info, mask = filter_info(name), metrics.motion_footprint(example.frame)
    figures = []
    for seed in SEEDS:
        height, width = example.frame.depth.shape
        noise = draw_noise(jax.random.key(seed), (height, width))
        image = info.call(
            example.frame, info.make_parameters(**parameters), settings=SETTINGS[name], noise=noise
        )
        figures.append(float(metrics.compare(image, example.truth, mask).psnr))
    return figures


def folds(name: str, steps: int) -> list[dict[str, Any]]:
    """What is fitted without each scene, and the scores there before and after."""
    examples = [
        common.catalogue_example(n, SIZE, SHUTTER, TRUTH_SAMPLES, path=True) for n in SCENES
    ]
    found = []
    for example in examples:
        parameters = fitted(name, [e for e in examples if e is not example], steps)
        scores = [judge(name, example, p) for p in ({}, parameters)]
        found.append({"scene": example.name, "parameters": parameters, "scores": scores})
        print(found[-1], file=sys.stderr, flush=True)
    return found


def in_process(name: str, steps: int, texels: str) -> list[dict[str, Any]]:
    """The same in a process of its own, with caches of its own."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"XDG_CACHE_HOME": cache, "JAX_PLATFORMS": "cpu"}
        command = [sys.executable, "-m", MODULE, "--one", name, str(steps), texels]
        done = subprocess.run(
            command, env=environment, check=True, stdout=subprocess.PIPE, cwd=ROOT, text=True
        )
    return json.loads(done.stdout.splitlines()[-1])


ROOT = Path(__file__).resolve().parents[2]


def rows_of(name: str, right: list[Any], held: list[Any]) -> list[list[Any]]:
    """One row for each scene, and the means over scenes."""
    rows, gains = [], []
    for new, old in zip(right, held, strict=True):
        defaults, after = np.array(new["scores"])
        before = np.array(old["scores"][1])
        pairs = before - defaults, after - defaults, after - before
        gains.append([pair.mean() for pair in pairs])
        rows.append([name, new["scene"], f"{defaults.mean():.2f}", *map(_interval, pairs)])
    pooled = [_interval(column) for column in np.transpose(gains)]
    return [*rows, [name, "mean over scenes", "", *pooled]]


def _interval(values: Any) -> str:
    mean, half = common.mean_and_interval(values)
    return f"{mean:+.2f} ± {half:.2f}"


def main() -> None:
    """Parse the command line, fit, judge, write."""
    if "--one" in sys.argv:
        _, _, name, steps, texels = sys.argv
        if texels == "held":
            places._Stage.places = ()  # pyright: ignore[reportAttributeAccessIssue]
        print(json.dumps(folds(name, int(steps))))
        return
    parser = common.output_parser("What fits gain from right derivatives.")
    parser.add_argument("--filters", default=",".join(FREE), metavar="NAME,...")
    parser.add_argument("--steps", type=int, default=20)
    options = parser.parse_args()
    rows: list[Any] = []
    values: list[Any] = []
    for name in options.filters.split(","):
        right, held = (in_process(name, options.steps, texels) for texels in ("moving", "held"))
        rows += rows_of(name, right, held)
        for fold, old in zip(right, held, strict=True):
            for key in FREE[name]:
                figures = filter_info(name).defaults, old["parameters"], fold["parameters"]
                numbers = [f"{values_of[key]:.3g}" for values_of in figures]
                values.append([name, fold["scene"], key, *numbers])
        heads = ("held derivative", "right derivative", "right against held")
        columns = ["filter", "scene left out", "defaults, dB", *(f"gain, {h}" for h in heads[:2])]
        common.write_table(options.output, "fits", [*columns, heads[2]], rows)
        columns = ["filter", "scene left out", "parameter", "default", *heads[:2]]
        common.write_table(options.output, "fitted", columns, values)


if __name__ == "__main__":
    main()
