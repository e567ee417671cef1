"""Runs printed filters, for tests."""

import base64
import contextlib
import ctypes
import importlib.resources
import os
import pathlib
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

from jaxblur.export.plan import plan_of

from .browser import SHADERS, chromium

FLAGS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]


def compile_c(name, source, header, folder):
    """Compile a printed filter without a warning."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        pytest.skip("needs a C compiler: apt install gcc")
    folder = pathlib.Path(folder)
    (folder / f"{name}.h").write_text(header)
    (folder / f"{name}.c").write_text(source)
    library = folder / f"{name}.so"
    arguments = [compiler, *FLAGS, "-o", library, folder / f"{name}.c", "-lm"]
    subprocess.run(arguments, check=True, cwd=folder)
    return ctypes.CDLL(str(library))


def run_library(library, name, inputs, shape, parameters=None):
    """Run a compiled filter on its inputs in order."""
    height, width = shape[:2]
    scratch_bytes = getattr(library, f"{name}_scratch_bytes")
    scratch_bytes.restype = ctypes.c_size_t
    # Rubbish in the working memory must not matter.
    scratch = np.full(scratch_bytes(width, height) + 4, 0x7F, np.uint8)
    out = np.full(shape, np.nan, np.float32)
    values = None
    if parameters is not None:
        values = (ctypes.c_float * len(parameters))(*parameters)
    given = [np.ascontiguousarray(array, np.float32) for array in inputs]
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (*given, out, scratch)]
    assert getattr(library, name)(values, width, height, *pointers) == 0
    return out


def run_c(graph, text, folder, planes, parameters=None):
    """Compile a filter that was printed as C, and run it on planes by name."""
    name = f"jaxblur_{graph.filter.name}"
    library = compile_c(name, text.source, text.header, folder)
    inputs = [planes[buffer.name] for buffer in graph.inputs]
    shape = (*planes["color"].shape[:2], graph.channels)
    return run_library(library, name, inputs, shape, parameters)


PAGE = """<!doctype html><meta charset="utf-8">
<script>{runners}</script><script>
function floats(text) {{
  return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}}
function text(values) {{
  const bytes = new Uint8Array(values.buffer);
  let found = "";
  for (let k = 0; k < bytes.length; k += 8192) {{
    found += String.fromCharCode(...bytes.subarray(k, k + 8192));
  }}
  return btoa(found);
}}
function decoded(inputs) {{
  return Object.fromEntries(Object.entries(inputs).map(([name, value]) => [name, floats(value)]));
}}
async function onShaders({{kind, plan, code, width, height, inputs, parameters}}) {{
  const gpu = await {{ Webgpu, Webgl }}[kind].open(width, height, plan.channels);
  for (const [name, values] of Object.entries(decoded(inputs))) gpu.upload(name, values);
  await gpu.use(await gpu.compile(plan, code));
  await gpu.blur(parameters);
  return text(await gpu.read());
}}
</script>"""


@contextlib.contextmanager
def shader_page(folder):
    """A page in Chromium on which printed shaders run."""
    templates = importlib.resources.files("jaxblur.export") / "templates"
    runners = "".join((templates / name).read_text() for name in ("webgpu.js", "webgl.js"))
    file = pathlib.Path(folder) / "shaders.html"
    file.write_text(PAGE.format(runners=runners))
    with chromium(SHADERS) as browser:
        page = browser.new_page()
        page.goto(file.as_uri())
        yield page


def run_shaders(page, kind, graph, code, planes, parameters=None):
    """Run a filter that was printed as WGSL (`Webgpu`) or GLSL (`Webgl`) on planes by name."""
    height, width = planes["color"].shape[:2]
    inputs = {}
    for buffer in graph.inputs:
        # Shaders may not count on infinity.
        array = np.minimum(np.asarray(planes[buffer.name], np.float32), np.float32(1e18))
        inputs[buffer.name] = base64.b64encode(array.tobytes()).decode()
    given = {"kind": kind, "plan": plan_of(graph), "code": code, "width": width, "height": height}
    given |= {"inputs": inputs, "parameters": parameters or {}}
    found = base64.b64decode(page.evaluate("onShaders", given))
    return np.frombuffer(found, np.float32).reshape(height, width, graph.channels)


def run_vulkan(graph, code, planes):
    """Run a filter that was printed as WGSL by the wheel wgpu, through Vulkan."""
    wgpu = pytest.importorskip("wgpu", reason="needs pip install wgpu")
    adapters = wgpu.gpu.enumerate_adapters_sync()
    adapter = next((a for a in adapters if a.info["backend_type"] == "Vulkan"), None)
    if adapter is None:
        pytest.skip("needs a Vulkan driver: apt install mesa-vulkan-drivers")
    device, plan = adapter.request_device_sync(), plan_of(graph)
    height, width = planes["color"].shape[:2]
    usage = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_SRC | wgpu.BufferUsage.COPY_DST
    buffers, bindings = {}, {}
    for buffer, planned in zip(graph.buffers, plan["buffers"], strict=True):
        made = device.create_buffer(size=4 * buffer.elements(height, width), usage=usage)
        if buffer.role == "input":
            array = np.minimum(np.asarray(planes[buffer.name], np.float32), np.float32(1e18))
            device.queue.write_buffer(made, 0, np.ascontiguousarray(array))
        buffers[buffer.name], bindings[buffer.name] = made, planned["binding"]
    sizes = np.array([height, width], np.int32).tobytes()
    values = np.array(list(graph.parameters.values()), np.float32).tobytes()
    data = (sizes + values).ljust(16 * -(-len(plan["uniforms"]) // 4), b"\0")
    uniforms = device.create_buffer_with_data(data=data, usage=wgpu.BufferUsage.UNIFORM)
    module = device.create_shader_module(code=code)
    encoder = device.create_command_encoder()
    for node, part in zip(graph.nodes, plan["passes"], strict=True):
        kinds = {0: "uniform"} | {bindings[name]: "read-only-storage" for name in part["reads"]}
        kinds[bindings[part["writes"]]] = "storage"
        layout = device.create_bind_group_layout(
            entries=[
                {"binding": k, "visibility": wgpu.ShaderStage.COMPUTE, "buffer": {"type": kind}}
                for k, kind in kinds.items()
            ]
        )
        bound = {0: uniforms} | {bindings[n]: buffers[n] for n in (*part["reads"], part["writes"])}
        group = device.create_bind_group(
            layout=layout,
            entries=[{"binding": k, "resource": {"buffer": b}} for k, b in bound.items()],
        )
        pipeline = device.create_compute_pipeline(
            layout=device.create_pipeline_layout(bind_group_layouts=[layout]),
            compute={"module": module, "entry_point": f"pass_{node.name}"},
        )
        # Buffers of a new device are zero, so that none of marks need be cleared.
        doing = encoder.begin_compute_pass()
        doing.set_pipeline(pipeline)
        doing.set_bind_group(0, group)
        rows, columns = node_grid(node, height, width)
        doing.dispatch_workgroups(-(-columns // plan["group"]), -(-rows // plan["group"]))
        doing.end()
    device.queue.submit([encoder.finish()])
    found = np.frombuffer(device.queue.read_buffer(buffers["blurred"]), np.float32)
    return found.reshape(height, width, graph.channels)


def run_hlsl(graph, code, planes):
    """Run a filter that was printed as HLSL on the processor, by the compiler of slangpy."""
    slang = pytest.importorskip("slangpy", reason="needs the Slang compiler: pip install slangpy")
    # Its target for processors has no atomic operations; one thread needs none.
    code = re.sub(r"InterlockedMax\((.*?), (\w+)\);", r"\1 = max(\1, \2);", code)
    device = slang.Device(type=slang.DeviceType.cpu)
    module = device.load_module_from_source(graph.filter.name, code)
    height, width = planes["color"].shape[:2]
    usage = slang.BufferUsage.shader_resource | slang.BufferUsage.unordered_access
    buffers = {}
    for buffer in graph.buffers:
        count = buffer.elements(height, width)
        made = device.create_buffer(element_count=count, struct_size=4, usage=usage)
        array = planes[buffer.name] if buffer.role == "input" else np.zeros(count)
        array = np.minimum(np.asarray(array, np.float32), np.float32(1e18))
        made.copy_from_numpy(np.ascontiguousarray(array).reshape(-1).view(np.int32))
        buffers[buffer.name] = made
    uniforms = {"height": height, "width": width}
    uniforms |= {f"parameter_{name}": value for name, value in graph.parameters.items()}
    plan = plan_of(graph)
    for node, part in zip(graph.nodes, plan["passes"], strict=True):
        program = device.link_program([module], [module.entry_point(f"pass_{node.name}")])
        variables = {name: buffers[name] for name in part["reads"]}
        variables[f"write_{part['writes']}"] = buffers[part["writes"]]
        rows, columns = node_grid(node, height, width)
        kernel = device.create_compute_kernel(program)
        kernel.dispatch([columns, rows, 1], vars={**variables, "Uniforms": uniforms})
    found = buffers["blurred"].to_numpy().view(np.float32)
    return found.reshape(height, width, graph.channels)


def node_grid(node, height, width):
    """Rows and columns of the grid of a pass."""
    if node.size.of == "tiles":
        return -(-height // node.size.factor), -(-width // node.size.factor)
    return height, width


SANITIZED = """
import ctypes, sys
import numpy as np
name, library, count, height, width, *channels = sys.argv[1:]
loaded, height, width = ctypes.CDLL(library), int(height), int(width)
scratch_bytes = getattr(loaded, f"{name}_scratch_bytes")
scratch_bytes.restype = ctypes.c_size_t
generator = np.random.default_rng(0)
planes = [generator.normal(size=(height, width, int(c))) for c in channels]
planes = [25 * (np.abs(plane) if plane.shape[2] == 1 else plane) for plane in planes]
planes = [np.ascontiguousarray(plane, np.float32) for plane in planes]
planes.append(np.empty((height, width, int(count)), np.float32))
planes.append(np.full(max(scratch_bytes(width, height), 1), 0x7F, np.uint8))
pointers = [plane.ctypes.data_as(ctypes.c_void_p) for plane in planes]
sys.exit(getattr(loaded, name)(None, width, height, *pointers))
"""


def run_sanitized(graph, text, folder, shape):
    """Run a filter that was printed as C with AddressSanitizer; what it prints."""
    compiler = shutil.which("gcc") or pytest.skip("needs gcc and its sanitizers")
    found = subprocess.check_output([compiler, "-print-file-name=libasan.so"], text=True).strip()
    if not pathlib.Path(found).is_absolute():
        pytest.skip("needs libasan: apt install gcc")
    name = f"jaxblur_{graph.filter.name}"
    (folder / f"{name}.h").write_text(text.header)
    (folder / f"{name}.c").write_text(text.source)
    checks = ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    library = folder / f"{name}.so"
    subprocess.run(
        [compiler, *FLAGS, "-g", *checks, "-o", library, folder / f"{name}.c", "-lm"], check=True
    )
    channels = [str(buffer.channels) for buffer in graph.inputs]
    given = [name, library, graph.channels, *shape, *channels]
    return subprocess.run(
        [sys.executable, "-c", SANITIZED, *map(str, given)],
        env=os.environ | {"LD_PRELOAD": found, "ASAN_OPTIONS": "detect_leaks=0"},
        capture_output=True,
        text=True,
    )
