// Runs printed filters on one frame with WebGPU, and shows and measures what they give.
// webgl.js has the same methods.

const WEBGPU_SUMS = 4096;

const WEBGPU_DISPLAY = `
fn display(light: vec3f) -> vec3f {
  let x = clamp(light, vec3f(0.0), vec3f(1.0));
  return select(1.055 * pow(x, vec3f(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3f(0.0031308));
}
`;

// Squared differences of display values, summed over every so many pixels.
const WEBGPU_ERRORS = (channels) => `${WEBGPU_DISPLAY}
@group(0) @binding(0) var<storage, read> image: array<f32>;
@group(0) @binding(1) var<storage, read> truth: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(64)
fn add_up(@builtin(global_invocation_id) id: vec3u) {
  var sum = 0.0;
  for (var k = ${channels}u * id.x; k < arrayLength(&image); k += ${channels}u * ${WEBGPU_SUMS}u) {
    let a = display(vec3f(image[k], image[k + 1u], image[k + 2u]));
    let b = display(vec3f(truth[k], truth[k + 1u], truth[k + 2u]));
    sum += dot(a - b, a - b);
  }
  sums[id.x] = sum;
}
`;

const WEBGPU_SHOW = (channels) => `${WEBGPU_DISPLAY}
struct View { gain: f32, edge: f32, errors: f32, width: f32 }
@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> blurred: array<f32>;
@group(0) @binding(2) var<storage, read> right: array<f32>;
@group(0) @binding(3) var<storage, read> compared: array<f32>;

@vertex
fn corner(@builtin(vertex_index) number: u32) -> @builtin(position) vec4f {
  return vec4f(select(-1.0, 3.0, number == 1u), select(-1.0, 3.0, number == 2u), 0.0, 1.0);
}

@fragment
fn shade(@builtin(position) at: vec4f) -> @location(0) vec4f {
  let k = ${channels}u * (u32(at.y) * u32(view.width) + u32(at.x));
  if (at.x >= view.edge) {
    return vec4f(display(view.gain * vec3f(right[k], right[k + 1u], right[k + 2u])), 1.0);
  }
  let shown = display(view.gain * vec3f(blurred[k], blurred[k + 1u], blurred[k + 2u]));
  if (view.errors == 0.0) {
    return vec4f(shown, 1.0);
  }
  let other = display(view.gain * vec3f(compared[k], compared[k + 1u], compared[k + 2u]));
  return vec4f(min(vec3f(1.0), view.errors * abs(shown - other)), 1.0);
}
`;

class Webgpu {
  static language = "wgsl";
  static label = "WebGPU";

  // channels: of color. canvas: what `show` draws to, of the size of the frame; null for none.
  static async open(width, height, channels, canvas = null) {
    if (!navigator.gpu) throw new Error("This browser has no WebGPU");
    const adapter = await navigator.gpu.requestAdapter();
    if (!adapter) throw new Error("WebGPU finds no graphics processor here");
    const requiredLimits = {};
    for (const name of ["maxStorageBufferBindingSize", "maxBufferSize"]) requiredLimits[name] = adapter.limits[name];
    const requiredFeatures = adapter.features.has("timestamp-query") ? ["timestamp-query"] : [];
    const device = await adapter.requestDevice({ requiredLimits, requiredFeatures });
    const gpu = Object.assign(new Webgpu(), { device, width, height, images: {}, work: {}, passes: [] });
    gpu.images.blurred = gpu._buffer(4 * width * height * channels);
    gpu.sums = gpu._buffer(4 * WEBGPU_SUMS);
    if (requiredFeatures.length) {
      gpu.times = device.createQuerySet({ type: "timestamp", count: 2 });
      gpu.ticks = device.createBuffer({ size: 16, usage: GPUBufferUsage.QUERY_RESOLVE | GPUBufferUsage.COPY_SRC });
    }
    gpu.summing = await gpu._checked(() =>
      device.createComputePipelineAsync({ layout: "auto", compute: { module: device.createShaderModule({ code: WEBGPU_ERRORS(channels) }) } }));
    if (canvas) {
      const format = navigator.gpu.getPreferredCanvasFormat();
      gpu.context = canvas.getContext("webgpu");
      gpu.context.configure({ device, format, alphaMode: "opaque" });
      const module = device.createShaderModule({ code: WEBGPU_SHOW(channels) });
      gpu.showing = await gpu._checked(() =>
        device.createRenderPipelineAsync({ layout: "auto", vertex: { module }, fragment: { module, targets: [{ format }] } }));
      gpu.view = device.createBuffer({ size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    }
    return gpu;
  }

  // Calls back with the reason if the graphics processor is lost.
  onLost(call) {
    this.device.lost.then((info) => call(info.message || info.reason));
  }

  // Fill an image of the frame: a Float32Array of all its pixels.
  upload(name, values) {
    this.images[name] ??= this._buffer(values.byteLength);
    this.device.queue.writeBuffer(this.images[name], 0, values);
  }

  // plan: of the export; code: its WGSL. The result is for `use`.
  async compile(plan, code) {
    const { device } = this;
    const module = device.createShaderModule({ code });
    const [problem] = (await module.getCompilationInfo()).messages.filter((message) => message.type === "error");
    if (problem) throw new Error(`Line ${problem.lineNum}: ${problem.message}`);
    const buffers = Object.fromEntries(plan.buffers.map((buffer) => [buffer.name, buffer]));
    const visibility = GPUShaderStage.COMPUTE;
    const compiled = async (pass) => {
      const entries = [{ binding: 0, visibility, buffer: { type: "uniform" } }];
      for (const name of pass.reads) entries.push({ binding: buffers[name].binding, visibility, buffer: { type: "read-only-storage" } });
      entries.push({ binding: buffers[pass.writes].binding, visibility, buffer: { type: "storage" } });
      const layout = device.createBindGroupLayout({ entries });
      const pipeline = await device.createComputePipelineAsync({
        layout: device.createPipelineLayout({ bindGroupLayouts: [layout] }),
        compute: { module, entryPoint: `pass_${pass.name}` },
      });
      return { ...pass, layout, pipeline };
    };
    return { plan, buffers, passes: await this._checked(() => Promise.all(plan.passes.map(compiled))) };
  }

  // Make a compiled filter the one that blurs. The buffers between its passes replace those of the one before.
  async use({ plan, buffers, passes }) {
    const { device } = this;
    for (const { name, role } of plan.buffers) {
      if (role === "input" && !this.images[name]) throw new Error(`The filter reads ${name}, which was not uploaded`);
    }
    for (const old of Object.values(this.work)) old.destroy();
    this.plan = plan;
    await this._checked(() => {
      this.work = { uniforms: device.createBuffer({ size: 16 * Math.ceil(plan.uniforms.length / 4), usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST }) };
      for (const { name, role, size, channels } of plan.buffers) {
        const [columns, rows] = this._sized(size);
        if (role === "work") this.work[name] = this._buffer(4 * columns * rows * channels);
      }
      const of = (name) => this.work[name] ?? this.images[name];
      this.passes = passes.map(({ pipeline, layout, reads, writes, grid }) => ({
        pipeline,
        group: device.createBindGroup({
          layout,
          entries: [
            { binding: 0, resource: { buffer: this.work.uniforms } },
            ...[...reads, writes].map((name) => ({ binding: buffers[name].binding, resource: { buffer: of(name) } })),
          ],
        }),
        groups: this._sized(grid).map((side) => Math.ceil(side / plan.group)),
        clears: buffers[writes].clear ? of(writes) : null,
      }));
    });
  }

  // Blur the frame with parameters by name; resolves to the milliseconds that the passes took.
  async blur(parameters = {}) {
    const { device, plan, passes, times } = this;
    const data = new DataView(new ArrayBuffer(16 * Math.ceil(plan.uniforms.length / 4)));
    plan.uniforms.forEach(({ name, type, value }, k) => {
      if (type === "int32") data.setInt32(4 * k, this[name], true);
      else data.setFloat32(4 * k, parameters[name] ?? value, true);
    });
    device.queue.writeBuffer(this.work.uniforms, 0, data.buffer);
    const encoder = device.createCommandEncoder();
    passes.forEach(({ pipeline, group, groups, clears }, k) => {
      if (clears) encoder.clearBuffer(clears);
      const stamps = {};
      if (k === 0) stamps.beginningOfPassWriteIndex = 0;
      if (k === passes.length - 1) stamps.endOfPassWriteIndex = 1;
      const timed = times && Object.keys(stamps).length > 0;
      const recorded = encoder.beginComputePass(timed ? { timestampWrites: { querySet: times, ...stamps } } : {});
      recorded.setPipeline(pipeline);
      recorded.setBindGroup(0, group);
      recorded.dispatchWorkgroups(...groups);
      recorded.end();
    });
    if (times) encoder.resolveQuerySet(times, 0, 2, this.ticks, 0);
    const started = performance.now();
    device.queue.submit([encoder.finish()]);
    await device.queue.onSubmittedWorkDone();
    const waited = performance.now() - started;
    if (!times) return waited;
    const [begin, end] = new BigUint64Array(await this._fetch(this.ticks, 16));
    return end > begin ? Number(end - begin) / 1e6 : waited;
  }

  // Sum over pixels and channels of squared differences from the image `truth`, in display values.
  async squaredError(name = "blurred") {
    const encoder = this.device.createCommandEncoder();
    const recorded = encoder.beginComputePass();
    recorded.setPipeline(this.summing);
    recorded.setBindGroup(0, this._group(this.summing, [this.images[name], this.images.truth, this.sums]));
    recorded.dispatchWorkgroups(WEBGPU_SUMS / 64);
    recorded.end();
    this.device.queue.submit([encoder.finish()]);
    return new Float32Array(await this._fetch(this.sums, 4 * WEBGPU_SUMS)).reduce((sum, part) => sum + part, 0);
  }

  // Draw the result up to the column `edge`, from there the image `right`; colors are multiplied by
  // `gain`. If `errors` is not 0, draw so many times the difference from the image `compared` instead.
  show({ gain, edge, errors, right, compared }) {
    this.device.queue.writeBuffer(this.view, 0, new Float32Array([gain, edge, errors, this.width]));
    const images = [this.view, this.images.blurred, this.images[right], this.images[compared]];
    const encoder = this.device.createCommandEncoder();
    const view = this.context.getCurrentTexture().createView();
    const recorded = encoder.beginRenderPass({ colorAttachments: [{ view, loadOp: "clear", storeOp: "store" }] });
    recorded.setPipeline(this.showing);
    recorded.setBindGroup(0, this._group(this.showing, images));
    recorded.draw(3);
    recorded.end();
    this.device.queue.submit([encoder.finish()]);
  }

  // The result: a Float32Array of all pixels.
  async read() {
    return new Float32Array(await this._fetch(this.images.blurred, this.images.blurred.size));
  }

  _sized({ of, factor }) {
    const { width, height } = this;
    return of === "tiles" ? [Math.ceil(width / factor), Math.ceil(height / factor)] : [width, height * factor];
  }

  _buffer(size) {
    return this.device.createBuffer({ size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC });
  }

  _group(pipeline, buffers) {
    const entries = buffers.map((buffer, binding) => ({ binding, resource: { buffer } }));
    return this.device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries });
  }

  async _fetch(buffer, size) {
    const copy = this.device.createBuffer({ size, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const encoder = this.device.createCommandEncoder();
    encoder.copyBufferToBuffer(buffer, 0, copy, 0, size);
    this.device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    const content = copy.getMappedRange().slice(0);
    copy.destroy();
    return content;
  }

  // What a function makes; errors of WebGPU, which it keeps to itself, are thrown.
  async _checked(make) {
    for (const kind of ["validation", "out-of-memory"]) this.device.pushErrorScope(kind);
    const made = make();
    const [result, ...problems] = await Promise.all([made, this.device.popErrorScope(), this.device.popErrorScope()]);
    for (const problem of problems) if (problem) throw new Error(problem.message || "The graphics processor has too little memory");
    return result;
  }
}
