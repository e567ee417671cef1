"""Headless Chromium, for tests of pages."""

import contextlib
import shutil

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--disable-quic",
]


SHADERS = [
    "--headless",
    "--no-sandbox",
    "--no-first-run",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    # The page must be put together by Vulkan too: a canvas that WebGPU draws to crashes without.
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
]
"""Arguments with which WebGPU and WebGL 2 run on a processor."""

WITHOUT_WEBGPU = [argument for argument in SHADERS if "webgpu" not in argument]
"""Arguments with which WebGL 2 alone does."""


@contextlib.contextmanager
def chromium(arguments=ARGUMENTS):
    """Start the system's Chromium; skip the test if there is none."""
    driver = pytest.importorskip("playwright.sync_api", reason="needs playwright, of jaxblur[dev]")
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip(
            f"needs a browser: install one of {', '.join(NAMES)}, e.g. apt install chromium"
        )
    with driver.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=arguments)
        try:
            yield browser
        finally:
            browser.close()
