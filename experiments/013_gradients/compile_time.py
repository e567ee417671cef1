"""How long value and gradient of every input take to be ready, cold and with the caches.

    python -m experiments.013_gradients.compile_time -o OUT [--size 640x360] [--cores 2]

Each row is two processes with a cache folder of their own: in the first nothing is cached, in the
second native kernels (jaxblur's cache) and XLA's programs (JAX's persistent cache) are. JAX keeps
programs that took XLA a second or more, unless JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS says
otherwise; here it keeps all. Seconds of wall and of processor time (compilers included) of tracing,
lowering and compiling, without import and without the first run. Writes ``compile_time``.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

from experiments.common import output_parser, write_table

CASES = ("layered", "guertin2014", "mcguire2012", "pixel_velocity")
MODULE = "experiments.013_gradients.compile_time"


def timed(function: Callable[[], Any]) -> tuple[Any, list[float]]:
    """The result of a function; wall seconds, and processor seconds with those of children."""

    def now() -> list[float]:
        both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return [time.perf_counter(), sum(u.ru_utime + u.ru_stime for u in both)]

    start = now()
    result = function()
    return result, [b - a for a, b in zip(start, now(), strict=True)]


def measure(name: str, height: int, width: int) -> dict[str, list[float]]:
    """Seconds of each stage, in this process."""
    import jax
    import jax.numpy as jnp

    import jaxblur
    from jaxblur.filters import filter_info

    info = filter_info(name)
    make = jax.random.uniform
    keys = jax.random.split(jax.random.key(0), 3)
    frame = jaxblur.Frame(
        make(keys[0], (height, width, 3)),
        1 + make(keys[1], (height, width)),
        make(keys[2], (height, width, 2), minval=-9.0, maxval=9.0),
    )
    parameters = jax.tree.map(jnp.float32, info.make_parameters())

    def loss(frame: Any, parameters: Any) -> Any:
        return jnp.mean(jnp.square(info.call(frame, parameters, settings=info.settings)))

    program = jax.jit(jax.value_and_grad(loss, (0, 1)))
    traced, tracing = timed(lambda: program.trace(frame, parameters))
    lowered, lowering = timed(traced.lower)
    compiled, compiling = timed(lowered.compile)
    _, running = timed(lambda: jax.block_until_ready(compiled(frame, parameters)))
    stages = {"trace": tracing, "lower": lowering, "compile": compiling}
    total = [sum(values) for values in zip(*stages.values(), strict=True)]
    return stages | {"ready": total, "first run": running}


def in_process(name: str, size: str, cache: str) -> dict[str, list[float]]:
    """The same in a process of its own, with this folder for all caches."""
    environment = os.environ | {
        "XDG_CACHE_HOME": cache,
        "JAX_COMPILATION_CACHE_DIR": f"{cache}/jax",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PLATFORMS": "cpu",
    }
    command = [sys.executable, "-m", MODULE, "--one", name, "--size", size]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    """Parse the command line, measure, write."""
    if "--one" in sys.argv:
        _, _, name, _, size = sys.argv
        width, height = map(int, size.split("x"))
        print(json.dumps(measure(name, height, width)))
        return
    parser = output_parser("Seconds until a gradient is ready.")
    parser.add_argument("--size", default="640x360", metavar="WxH")
    parser.add_argument("--filters", default=",".join(CASES), metavar="NAME,...")
    options = parser.parse_args()
    rows = []
    for name in options.filters.split(","):
        with tempfile.TemporaryDirectory() as cache:
            for when in ("cold", "cached"):
                found = in_process(name, options.size, cache)
                ready = [f"{seconds:.1f}" for seconds in found.pop("ready")]
                rows.append([name, when, *ready, *(f"{wall:.1f}" for wall, _ in found.values())])
                print(rows[-1], flush=True)
    columns = ["filter", "caches", "ready, s", "processor s", "trace, s", "lower, s", "compile, s"]
    write_table(options.output, "compile_time", [*columns, "first run, s"], rows)


if __name__ == "__main__":
    main()
