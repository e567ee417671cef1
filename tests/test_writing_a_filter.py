"""The filter of the page "Write your own filter" works everywhere, from one file."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import bench
from jaxblur.filters import load_filter
from jaxblur.kernels.cpp import build
from tests.command_line import run
from tests.exr_files import CAR
from tests.helpers import random_frame

PAGE = Path(jaxblur.__file__).parent / "filters" / "WRITING_A_FILTER.md"
CODE = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
NAME = "bright_streaks"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "bright.py"
    path.write_text(CODE, encoding="utf-8")
    yield path
    if NAME in jaxblur.FILTERS:
        jaxblur.filters.unregister(NAME)


@pytest.fixture
def info(file):
    return load_filter(f"{file}:{NAME}")


def test_the_program_is_forty_lines():
    body = CODE[CODE.index("@jax.tree_util") : CODE.index("jaxblur.register(")]
    assert len([line for line in body.splitlines() if line.strip()]) <= 40


def test_the_package_of_the_page_makes_the_filter_known(tmp_path):
    (toml,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    project = tomllib.loads(toml)["project"]
    ((entry, module),) = project["entry-points"]["jaxblur.filters"].items()
    installed = tmp_path / f"{project['name']}-{project['version']}.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\n")
    (installed / "entry_points.txt").write_text(f"[jaxblur.filters]\n{entry} = {module}\n")
    (tmp_path / f"{module}.py").write_text(CODE, encoding="utf-8")
    code = f"import jaxblur; print(jaxblur.FILTERS[{entry!r}].__module__)"
    path = os.pathsep.join([str(tmp_path), *sys.path])
    environment = os.environ | {"PYTHONPATH": path}
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert entry == NAME and found.stdout.strip() == module


def plain(frame, boost, samples):
    """The same by loops."""
    color, velocity = np.asarray(frame.color, float), np.asarray(frame.velocity, float)
    result = color.copy()
    for row, column in np.ndindex(*color.shape[:2]):
        x, y = velocity[row, column]
        if x * x + y * y <= 0.25:
            continue
        total, weights = 0.0, 0.0
        for i in range(samples):
            t = (2 * i + 1) / samples - 1
            there = np.floor([t * y + 0.5, t * x + 0.5]) + np.array([row, column])
            there = np.clip(there, 0, np.subtract(color.shape[:2], 1))
            value = color[tuple(there.astype(int))]
            weight = 1 + boost * value[:3].mean()
            total, weights = total + weight * value, weights + weight
        result[row, column] = total / weights
    return result


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_values_and_derivatives(info, backend):
    if backend == "native" and build.find_compiler() is None:
        pytest.skip("needs a C++ compiler")
    frame, settings = random_frame((9, 21)), info.make_settings(samples=7, backend=backend)

    def total(color, boost):
        parameters = info.make_parameters(boost=boost)
        return jnp.sum(info.call(frame.replace(color=color), parameters, settings=settings) ** 2)

    blurred = info.call(frame, info.make_parameters(boost=2.0), settings=settings)
    np.testing.assert_allclose(blurred, plain(frame, 2.0, 7), atol=2e-6)
    of_color, of_boost = jax.grad(total, (0, 1))(frame.color, 2.0)
    step = 1e-2
    change = (total(frame.color, 2.0 + step) - total(frame.color, 2.0 - step)) / (2 * step)
    np.testing.assert_allclose(of_boost, change, rtol=2e-2)
    along = jnp.cos(7 * frame.color)
    moved = [total(frame.color + sign * step * along, 2.0) for sign in (1, -1)]
    slope = (moved[0] - moved[1]) / (2 * step)
    np.testing.assert_allclose(jnp.sum(of_color * along), slope, rtol=1e-2)


@pytest.mark.parametrize("channels", [1, 4])
def test_any_number_of_channels(info, channels):
    frame, settings = random_frame((9, 21), channels=channels), info.make_settings(samples=7)
    blurred = info.call(frame, info.make_parameters(boost=2.0), settings=settings)
    np.testing.assert_allclose(blurred, plain(frame, 2.0, 7), atol=2e-6)


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_derivatives_by_the_motion(info, backend):
    if backend == "native" and build.find_compiler() is None:
        pytest.skip("needs a C++ compiler")
    # Random colors blurred toward gray: longer paths lose more contrast.
    frame, settings = random_frame((24, 40), speed=6.0), info.make_settings(backend=backend)

    def contrast(velocity, boost):
        blurred = info.call(
            frame.replace(velocity=velocity), info.make_parameters(boost=boost), settings=settings
        )
        return jnp.var(blurred)

    derivatives = jax.jit(jax.grad(contrast, (0, 1)))
    by_velocity, by_boost = derivatives(frame.velocity, 1.0)
    assert np.isfinite(by_velocity).all() and np.isfinite(by_boost)
    slope = jnp.sum(by_velocity * frame.velocity)
    change = (contrast(1.1 * frame.velocity, 1.0) - contrast(0.9 * frame.velocity, 1.0)) / 0.2
    assert change < 0 and 0.6 < slope / change < 1.6
    assert all(np.isfinite(of).all() for of in derivatives(0 * frame.velocity, 1.0))


def test_the_radius_limits_the_motion(info):
    frame, settings = random_frame((9, 21)), info.make_settings(samples=7, radius=4)
    longest = np.linalg.norm(frame.velocity, axis=-1, keepdims=True)
    clamped = frame.replace(velocity=frame.velocity * jnp.minimum(1, 4 / jnp.maximum(longest, 1)))
    blurred = info.call(frame, info.make_parameters(boost=2.0), settings=settings)
    # Where rounding decides between two texels, one sample may differ.
    wrong = np.abs(blurred - plain(clamped, 2.0, 7)).max(axis=-1) > 1e-4
    assert longest.max() > 8 and wrong.mean() < 0.02


def test_an_array_in_a_program_is_refused(info, tmp_path):
    code = CODE.replace(
        "[weight * value for value in color]", "list(weight * jax.numpy.stack(color))"
    )
    path = tmp_path / "stacked.py"
    path.write_text(code.replace(NAME, "stacked_streaks"), encoding="utf-8")
    stacked = load_filter(f"{path}:stacked_streaks")
    try:
        with pytest.raises(ValueError, match=r"operation .* makes an array of shape \(3,\)"):
            stacked.call(random_frame((5, 8)), stacked.make_parameters(), settings=stacked.settings)
    finally:
        jaxblur.filters.unregister("stacked_streaks")


def test_batches_and_masks(info):
    frames = [random_frame((5, 8), seed) for seed in (0, 1)]
    parameters = info.make_parameters()
    one_by_one = np.stack([info.call(f, parameters, settings=info.settings) for f in frames])
    np.testing.assert_allclose(jaxblur.blur_batch(NAME, frames), one_by_one, atol=1e-6)
    stacked = jax.tree.map(lambda *buffers: jnp.stack(buffers), *frames)
    batched = jax.vmap(lambda frame: info.call(frame, parameters, settings=info.settings))(stacked)
    np.testing.assert_allclose(batched, one_by_one, atol=1e-6)
    hole = np.ones((5, 8), bool)
    hole[2, 3] = False
    color = frames[0].color.at[2, 3].set(jnp.nan)
    masked = frames[0].replace(color=color, valid=hole)
    assert np.isfinite(info.call(masked, parameters, settings=info.settings)).all()


def test_fit_and_bench(info):
    frame = random_frame((16, 16))
    truth = info.call(frame, info.make_parameters(boost=3.0), settings=info.settings)
    result = jaxblur.fit(NAME, [(frame, truth)], steps=40, free=("boost",))
    assert result.parameters["boost"] == pytest.approx(3.0, abs=0.2)
    assert bench.make_case(NAME, samples=9).label == "bright_streaks N=9"


def test_the_command_line(file, tmp_path):
    output = tmp_path / "blurred.exr"
    arguments = ["--filter", f"{file}:{NAME}", "--param", "boost=4"]
    assert run("blur", str(CAR), "-o", str(output), *arguments).status == 0
    info = load_filter(f"{file}:{NAME}")
    frame = jaxblur.read_frame(CAR)
    expected = info.call(frame, info.make_parameters(boost=4.0), settings=info.settings)
    image = jaxblur.exr.read_image(output)
    np.testing.assert_allclose(image[..., :3], expected[..., :3], atol=2e-3)
