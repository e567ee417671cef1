"""Does `jaxblur.plan` stay within its tolerance on scenes that it was not derived from?

    python -m experiments.005_what_a_scene_needs.validate_plan -o OUT [--reference-data DIR]

Writes for every scene and tolerance: the choice of the plan; its expected and its measured loss
against the full filter over the pixels that motion reaches; and the share of time saved, by the
stored constants.
"""

import itertools
from typing import Any

import jax

import jaxblur
from experiments import common
from experiments.common import Example
from jaxblur.filters import filter_info
from jaxblur.fitting.objective import draw_noise
from jaxblur.metrics import display, motion_footprint, psnr
from jaxblur.planning import constants

SCENES = ("wheels_at_three_depths", "tracked_car", "random_cubes", "opposed")
SIZE, SHUTTER, TRUTH_SAMPLES, REFERENCE_WIDTH = (72, 128), 2.0, 96, 320
TOLERANCES = (0.25, 0.5, 1.0, 2.0)


def full_plan(frame: jaxblur.Frame) -> jaxblur.Plan:
    """A plan for this frame with the filter against which losses are measured."""
    (record,) = [
        record
        for record in constants()["candidates"].values()
        if record["spread"] == 0 and not any(record["loss"])
    ]
    statistics = jaxblur.frame_statistics(frame)
    info = filter_info(record["filter"])
    return jaxblur.Plan(
        filter=info.name,
        settings=info.kind(**record["settings"], radius=statistics.radius),
        parameters=info.make_parameters(**record["parameters"]),
        summary="the measure of loss",
        reason="the measure of loss",
        loss=0.0,
        spread=0.0,
        jod_loss=0.0,
        jod_spread=0.0,
        milliseconds=record["milliseconds_per_megapixel"] * statistics.pixels / 1e6,
    )


def moving_psnr(plan: jaxblur.Plan, example: Example) -> float:
    """PSNR over the pixels that motion reaches, with random noise."""
    height, width = example.frame.depth.shape
    image = jaxblur.FILTERS[plan.filter](
        example.frame,
        plan.parameters,
        settings=plan.settings,
        noise=draw_noise(jax.random.key(3), (height, width)),
    )
    mask = motion_footprint(example.frame)
    return float(psnr(display(image), display(example.truth), mask=mask))


def rows_of(example: Example) -> list[Any]:
    """One row for each tolerance."""
    full = full_plan(example.frame)
    plans = [jaxblur.plan(example.frame, tolerance_db=tolerance) for tolerance in TOLERANCES]
    # Plans may differ in their reasons alone; measure equal choices once.
    measured: dict[Any, float] = {}
    for plan in (full, *plans):
        key = plan.filter, plan.settings, plan.parameters
        if key not in measured:
            measured[key] = moving_psnr(plan, example)
    best = measured[full.filter, full.settings, full.parameters]
    rows = []
    for tolerance, plan in zip(TOLERANCES, plans, strict=True):
        loss = best - measured[plan.filter, plan.settings, plan.parameters]
        choice = plan.reason.partition(":")[0]
        saved = 1 - plan.milliseconds / full.milliseconds
        kept = "yes" if loss <= tolerance else "no"
        rows.append((example.name, tolerance, choice, plan.loss, plan.spread, loss, kept, saved))
    return rows


def main() -> None:
    """Render, plan, measure, and write the table."""
    options = common.output_parser(
        "Try jaxblur.plan on other scenes.", "try on these too"
    ).parse_args()
    examples = [common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES) for name in SCENES]
    if options.reference_data:
        examples += common.cycles_examples(options.reference_data, REFERENCE_WIDTH)
    columns = ("scene", "tolerance dB", "choice", "expected dB", "spread dB", "measured dB")
    columns += ("within", "time saved")
    rows = list(itertools.chain.from_iterable(rows_of(example) for example in examples))
    common.write_table(options.output, "validation", columns, rows)


if __name__ == "__main__":
    main()
