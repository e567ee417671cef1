"""``jaxblur doctor``: what is installed, and whether a frame can be blurred."""

import argparse
import dataclasses
import importlib
import importlib.util
import json
import logging
import os
import pathlib
import platform
import re
import shutil
import sys
import time
from collections.abc import Mapping
from typing import Any

import jaxblur
from jaxblur._util.cache import UnsafeFolderError, cache_folder, compiled_code, private_folder

from ..arguments import add_command, add_compute_options
from ..compute import start_jax
from ..console import print_line

LOG = logging.getLogger("jaxblur")
PACKAGES = ("numpy", "OpenImageIO", "jax", "jaxlib")
IN_WORDS = {"OpenEXR": "OpenEXR inside OpenImageIO"}
EXTRAS = {
    "compiler": ("ziglang",),
    "dask": ("cryptography", "distributed"),
    "docs": ("mkdocs", "mkdocs-material", "mkdocstrings-python", "nbconvert"),
    "mesh": ("trimesh",),
    "notebook": ("matplotlib", "ipykernel", "ipywidgets", "jupytext", "nbclient"),
    "plot": ("matplotlib",),
}
"""The packages that each extra of jaxblur installs."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WIDTH, HEIGHT, SQUARE, SPEED = 320, 180, 40, 12
"""Of the test frame, in pixels; the square moves by twice the speed."""
FILTER = "layered"
AGREE = 1e-4
"""Largest difference of native code from XLA in 99 % of the values."""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "doctor",
        "Say what is installed, and blur a test frame; status 1 if that fails.",
        run,
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_compute_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print what was found; see `add_parser`."""
    found = diagnose(not arguments.no_compile_cache)
    if arguments.json:
        print(json.dumps(found, indent=2))
    else:
        _print_text(found)
    for remark in found["remarks"]:
        LOG.warning("%s", remark)
    for problem in found["problems"]:
        LOG.error("%s", problem)
    return 1 if found["problems"] else 0


def diagnose(compile_cache: bool) -> dict[str, Any]:
    """Look at the installation, and blur a test frame by each backend.

    Whatever is broken is a problem in the result, not an error.

    Args:
        compile_cache: keep what is compiled, as other commands do.

    Returns:
        What ``--json`` prints: ``problems`` keep a frame from being blurred right, ``remarks`` are
        what makes it slow; both name the remedy where there is one.
    """
    remarks: list[str] = []
    problems: list[str] = []
    found: dict[str, Any] = {
        "jaxblur": {"version": jaxblur.__version__, "folder": os.path.dirname(jaxblur.__file__)},
        "python": {"version": platform.python_version(), "program": sys.executable},
        "system": {
            "name": platform.platform(),
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else os.cpu_count(),
        },
        "cache": _look_at_cache(remarks),
        "packages": _versions(problems),
        "extras": {name: _extra(packages) for name, packages in EXTRAS.items()},
        "browser": next(filter(None, map(shutil.which, BROWSERS)), None),
        "compiler": None,
        "devices": [],
        "backend": None,
        "test": {},
        "remarks": remarks,
        "problems": problems,
    }
    if "jax" not in found["packages"] or "jaxlib" not in found["packages"]:
        return found
    # Whatever is broken below this line, the rest of the answer is wanted.
    try:
        start_jax(compile_cache and found["cache"]["refused"] is None)
        found["compiler"] = _compiler(remarks)
        found["devices"] = _devices()
    except Exception as error:
        chosen = os.environ.get("JAX_PLATFORMS")
        remedy = f"; JAX_PLATFORMS is {chosen!r}, unset it" if chosen else ""
        problems.append(f"jax cannot be used: {_first_line(error)}{remedy}")
        return found
    found["test"], found["backend"] = _blur_test_frame(found["compiler"] is not None, problems)
    return found


def _look_at_cache(remarks: list[str]) -> dict[str, Any]:
    """The folder of compiled code, why it is refused if it is, and what it holds."""
    try:
        folder = cache_folder()
    except UnsafeFolderError as error:
        remarks.append(f"compiled code is not kept between runs: {error}")
        return {"folder": None, "refused": str(error)}
    refused = None
    try:
        private_folder("kernels")
    except UnsafeFolderError as error:
        refused = str(error)
        remarks.append(f"compiled code is not kept between runs: {error}")
    files = [(path, size) for _, size, path in compiled_code(folder)]
    kernels = [size for path, size in files if path.suffix == ".so"]
    programs = [size for path, size in files if path.name.endswith("-cache")]
    return {
        "folder": os.fspath(folder),
        "refused": refused,
        "kernels": len(kernels),
        "kernel_bytes": sum(kernels),
        "programs": len(programs),
        "program_bytes": sum(programs),
    }


def _versions(problems: list[str]) -> dict[str, str]:
    """Versions of the packages that every blur needs, and of OpenEXR inside OpenImageIO."""
    versions: dict[str, str] = {}
    # The C++ part of jax logs messages that a user can do nothing about.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    for name in PACKAGES:
        try:
            versions[name] = importlib.import_module(name).__version__
        except Exception as error:
            problems.append(
                f"{name} cannot be imported: {_first_line(error)}; "
                f"pip install --force-reinstall {name}"
            )
    if "OpenImageIO" in versions:
        import OpenImageIO as oiio

        listed = re.search(r"OpenEXR ([\d.]+)", oiio.get_string_attribute("library_list"))
        if listed:
            versions["OpenEXR"] = listed[1]
    return versions


def _extra(packages: tuple[str, ...]) -> dict[str, str | None]:
    """Versions of the packages of an extra; None for those that are missing."""
    from importlib.metadata import PackageNotFoundError, version

    versions: dict[str, str | None] = {}
    for name in packages:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return versions


def _processor() -> str:
    """The name of the processor's model."""
    try:
        text = pathlib.Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    model = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    return model[1] if model else platform.machine()


def _compiler(remarks: list[str]) -> dict[str, str] | None:
    """The C++ compiler that native code is compiled by."""
    from jaxblur._util.compiler import NO_COMPILER, find_compiler, loads_kernels, words_of

    compiler = find_compiler()
    if compiler is None:
        slow = "XLA does the work, several times as slow"
        system = "native code runs on Linux and macOS only"
        remarks.append(f"{NO_COMPILER if loads_kernels() else system}; {slow}")
        return None
    words = words_of(*compiler.version)
    return {"command": " ".join(compiler.command), "version": words[0] if words else "unknown"}


def _devices() -> list[str]:
    import jax

    return [f"{device.platform} {device.id}: {device.device_kind}" for device in jax.devices()]


def _blur_test_frame(
    has_compiler: bool, problems: list[str]
) -> tuple[dict[str, dict[str, float]], str | None]:
    """Blur the test frame twice by each backend, and compare the results.

    Returns:
        Times by backend, and the backend that ``--backend auto`` uses.
    """
    import jax
    import numpy as np

    times: dict[str, dict[str, float]] = {}
    images: dict[str, Any] = {}
    LOG.info("blurring a test frame; the first time may take a minute")
    has_native = has_compiler and jax.default_backend() == "cpu"
    for backend in ("native", "xla") if has_native else ("xla",):
        try:
            images[backend], times[backend] = _timed_blur(backend)
        except Exception as error:
            problems.append(f"{backend}: the test frame cannot be blurred: {_first_line(error)}")
    for backend, image in images.items():
        if not np.isfinite(image).all():
            problems.append(f"{backend}: the blurred test frame is not finite")
    if len(images) == 2:
        near = np.abs(images["native"] - images["xla"]) <= AGREE
        if near.mean() < 0.99:
            problems.append(
                "native and xla differ in the test frame; remove the folder of compiled code, and "
                "if that does not help, use --backend xla"
            )
    return times, next(iter(images), None)


def _timed_blur(backend: str) -> tuple[Any, dict[str, float]]:
    """The blurred test frame, and the seconds that the first and the second run took."""
    import numpy as np

    from jaxblur.filters import filter_info

    info, frame = filter_info(FILTER), _test_frame()
    settings = dataclasses.replace(info.settings, backend=backend)
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        image = np.asarray(info.call(frame, info.make_parameters(), settings=settings))
        seconds.append(round(time.perf_counter() - start, 4))
    return image, {"first_seconds": seconds[0], "second_seconds": seconds[1]}


def _test_frame() -> Any:
    """A square that moves to the right in front of a texture that moves slowly to the left."""
    import numpy as np

    from jaxblur.frame import Frame

    color = np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32)
    depth = np.full((HEIGHT, WIDTH), 9, np.float32)
    velocity = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    velocity[..., 0] = -1
    row, column = HEIGHT // 2, WIDTH // 2
    square = np.s_[row : row + SQUARE, column : column + SQUARE]
    color[square], depth[square], velocity[square] = 2, 1, (SPEED, 0)
    return Frame(color, depth, velocity)


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0] or type(error).__name__


def _print_text(found: Mapping[str, Any]) -> None:
    system, cache, packages = found["system"], found["cache"], found["packages"]
    rows = {
        "jaxblur": "{version} in {folder}".format(**found["jaxblur"]),
        "Python": "{version} ({program})".format(**found["python"]),
        "system": f"{system['name']}, {system['processor']}, {system['cores']} cores",
        "packages": ", ".join(f"{IN_WORDS.get(n, n)} {version}" for n, version in packages.items()),
        "compiler": _text_of_compiler(found["compiler"]),
        "cache": _text_of_cache(cache),
        "devices": ", ".join(found["devices"]) or "none",
        "backend": found["backend"] or "none",
    }
    for name, versions in found["extras"].items():
        rows[f"extra {name}"] = _text_of_extra(name, versions)
    rows["browser"] = found["browser"] or "none of " + ", ".join(BROWSERS)
    for backend, times in found["test"].items():
        first, second = times["first_seconds"], times["second_seconds"]
        rows[f"{backend} test"] = (
            f"{FILTER}, {WIDTH}x{HEIGHT}: {first:.3g} s the first time, {second:.3g} s the second"
        )
    for name, text in rows.items():
        print_line(f"{name:<16}{text}")


def _text_of_compiler(compiler: Mapping[str, str] | None) -> str:
    return "none" if compiler is None else f"{compiler['command']} ({compiler['version']})"


def _text_of_cache(cache: Mapping[str, Any]) -> str:
    if cache["folder"] is None:
        return f"not used: {cache['refused']}"
    state = "used" if cache["refused"] is None else f"not used: {cache['refused']}"
    return (
        f"{cache['folder']} ({state}): {cache['kernels']} kernels, "
        f"{cache['kernel_bytes'] / 1e6:.1f} MB; {cache['programs']} programs of XLA, "
        f"{cache['program_bytes'] / 1e6:.1f} MB"
    )


def _text_of_extra(name: str, versions: Mapping[str, str | None]) -> str:
    missing = [package for package, version in versions.items() if version is None]
    if missing:
        return f'missing: {", ".join(missing)}; pip install "jaxblur[{name}]"'
    return ", ".join(f"{package} {version}" for package, version in versions.items())
