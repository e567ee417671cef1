"""Pass L5 of `layered` through a lens: the mean over samples of time and aperture.

Each sample reads one map of owners, which holds the texel that covers the pixel at one time, seen
from one point of the lens. The sample has a time and a point near those of the map. Along the path
and the disc of the owner it reads the texel that covers the pixel at its own time and point. If
that texel is of another surface, the color of the owner is taken. If the map has no owner there,
the color of `.holes` is taken.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int

from ...kernels import At, Image, Outcome, sum_over
from .._sampling import find_texel, read_color
from .aperture import point_in_cell
from .clock import Times, time_of_light, time_of_owners
from .owners import RESTS, moving_owner, point_of
from .paths import Path
from .slices import Inputs, Plan, Sums, landing, longest_motion, mean_of, slices_along


class Images(NamedTuple):
    """Images of pass L5.

    Attributes:
        color: (H, W, C).
        paths: (H, W, 6), see `.paths.Path`.
        owners: (T H, W, 1), see `.owners.owners_of`.
        states: (H, W, 1), see `.owners.states_of`.
        background: (H, W, C + 1), see `.background.known_colors`.
        noise: (H, W, 3): of the time in [-1, 1), of the aperture in [-1/2, 1/2).
        points: (1, T, 2) of the unit disc, from which the maps are seen.
        clock: tables of the shutter; None for the nominal one.
    """

    color: Image
    paths: Image
    owners: Image
    states: Image
    background: Image
    noise: Image
    points: Image
    clock: Times | None


def view_pixel(at: At, images: Images, inputs: Inputs, plan: Plan) -> Outcome:
    """Pass L5: the mean over the samples; `slices` of the plan is their number."""
    settings, parameters = plan.settings, inputs.parameters
    limit = (
        slices_along(longest_motion(at, images.paths, images.owners, plan), plan)
        if settings.spacing
        else None
    )
    count = plan.slices if limit is None else limit
    tap, *turn = images.noise.here()
    inverse_tolerance = 1 / jnp.square(parameters.landing_tolerance)
    *behind, known = images.background.here()

    def sample(i: Int[Array, ""]) -> Sums:
        number = (2 * i + 1).astype(tap.dtype)
        light = (number - count + tap * parameters.jitter) / count
        index = (number * (plan.maps.total / 2) / count).astype(jnp.int32)
        # Beyond its own number of samples a pixel is evaluated too, beside others with more.
        index = jnp.minimum(index, plan.maps.total - 1)
        time, weight = time_of_light(light, at.row, images.clock, inputs.span)
        own_time = time_of_owners(index, plan.maps, tap, at.row, images.clock, inputs.span)
        own_point = point_of(images.points, index)
        assert own_point is not None
        owner = moving_owner(
            at, images.owners, images.paths, index, own_time, plan.coding, own_point
        )
        way = Path(*images.paths.read_texel(owner.texel))
        point = point_in_cell(own_point, (turn[0], turn[1]), i, plan.maps, parameters.jitter)
        squared = own_time * own_time
        assert way.disc is not None
        offset_x = -time * way.x - squared * way.bend_x - way.disc * point[0]
        offset_y = -time * way.y - squared * way.bend_y - way.disc * point[1]
        texel = find_texel(at, offset_x, offset_y, images.color, settings)
        x, y, depth, _, _, disc = images.paths.read_texel(texel.number)
        there = Path(x, y, depth, way.bend_x, way.bend_y, disc)
        there_x, there_y = there.at(time, point)
        miss = jnp.square(offset_x + there_x) + jnp.square(offset_y + there_y)
        lands = landing(miss * inverse_tolerance, there, way, parameters)
        lands = jnp.where(texel.counts, lands, 0)
        found = read_color(images.color, texel, settings.fetch)
        itself = images.color.read_texel(owner.texel)
        color = [
            jnp.where(owner.exists, b + lands * (a - b), c)
            for a, b, c in zip(found, itself, behind, strict=True)
        ]
        values = (*color, jnp.where(owner.exists, 1, known))
        if weight is not None:
            values = tuple(weight * value for value in values)
        if limit is not None:
            values = tuple(jnp.where(i < limit, value, 0) for value in values)
        return Sums(values[:-1], values[-1])

    sums = sum_over(plan.slices, sample, limit)
    (state,) = images.states.here()
    return Outcome(mean_of(sums, images.color.here()), where=state != RESTS)
