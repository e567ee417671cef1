// Runs a printed filter with WebGPU: makes its buffers and pipelines, and blurs frames.

async function webgpuDevice() {
  if (!navigator.gpu) throw new Error("This browser has no WebGPU.");
  const adapter = await navigator.gpu.requestAdapter();
  if (!adapter) throw new Error("WebGPU has no adapter here.");
  const wanted = {};
  for (const name of ["maxStorageBufferBindingSize", "maxBufferSize"]) wanted[name] = adapter.limits[name];
  return await adapter.requestDevice({ requiredLimits: wanted });
}

function sizeOf(size, width, height) {
  if (size.of === "tiles") {
    return [Math.ceil(width / size.factor), Math.ceil(height / size.factor)];
  }
  return [width, height * size.factor];
}

class Filter {
  // plan: of the export; code: WGSL.
  static async make(device, plan, code, width, height) {
    const filter = new Filter();
    Object.assign(filter, { device, plan, width, height, buffers: {}, passes: [] });
    device.pushErrorScope("validation");
    const module = device.createShaderModule({ code });
    const messages = (await module.getCompilationInfo()).messages.filter((m) => m.type === "error");
    if (messages.length) throw new Error(`line ${messages[0].lineNum}: ${messages[0].message}`);
    const usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC;
    for (const buffer of plan.buffers) {
      const [columns, rows] = sizeOf(buffer.size, width, height);
      const size = 4 * columns * rows * buffer.channels;
      filter.buffers[buffer.name] = { ...buffer, bytes: size, gpu: device.createBuffer({ size, usage }) };
    }
    filter.uniforms = device.createBuffer({
      size: 16 * Math.ceil(plan.uniforms.length / 4),
      usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST,
    });
    for (const pass of plan.passes) {
      const used = [...pass.reads.map((name) => [name, "read-only-storage"]), [pass.writes, "storage"]];
      const visibility = GPUShaderStage.COMPUTE;
      const entries = [{ binding: 0, visibility, buffer: { type: "uniform" } }];
      const bound = [{ binding: 0, resource: { buffer: filter.uniforms } }];
      for (const [name, type] of used) {
        const { binding, gpu } = filter.buffers[name];
        entries.push({ binding, visibility, buffer: { type } });
        bound.push({ binding, resource: { buffer: gpu } });
      }
      const layout = device.createBindGroupLayout({ entries });
      filter.passes.push({
        pipeline: await device.createComputePipelineAsync({
          layout: device.createPipelineLayout({ bindGroupLayouts: [layout] }),
          compute: { module, entryPoint: `pass_${pass.name}` },
        }),
        group: device.createBindGroup({ layout, entries: bound }),
        grid: sizeOf(pass.grid, width, height),
        clears: filter.buffers[pass.writes].clear ? filter.buffers[pass.writes].gpu : null,
      });
    }
    const error = await device.popErrorScope();
    if (error) throw new Error(error.message);
    return filter;
  }

  // Fill an input; values are a Float32Array.
  upload(name, values) {
    this.device.queue.writeBuffer(this.buffers[name].gpu, 0, values);
  }

  // Record all passes; parameters by name.
  encode(encoder, parameters) {
    const data = new DataView(new ArrayBuffer(16 * Math.ceil(this.plan.uniforms.length / 4)));
    this.plan.uniforms.forEach((uniform, k) => {
      if (uniform.type === "int32") data.setInt32(4 * k, this[uniform.name], true);
      else data.setFloat32(4 * k, parameters[uniform.name] ?? uniform.value, true);
    });
    this.device.queue.writeBuffer(this.uniforms, 0, data.buffer);
    for (const pass of this.passes) {
      if (pass.clears) encoder.clearBuffer(pass.clears);
      const recorded = encoder.beginComputePass();
      recorded.setPipeline(pass.pipeline);
      recorded.setBindGroup(0, pass.group);
      const [columns, rows] = pass.grid;
      const side = this.plan.group;
      recorded.dispatchWorkgroups(Math.ceil(columns / side), Math.ceil(rows / side));
      recorded.end();
    }
  }

  // Blur, and read the result back.
  async run(parameters = {}) {
    const { gpu, bytes } = this.buffers.blurred;
    const usage = GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ;
    const copy = this.device.createBuffer({ size: bytes, usage });
    const encoder = this.device.createCommandEncoder();
    this.encode(encoder, parameters);
    encoder.copyBufferToBuffer(gpu, 0, copy, 0, bytes);
    this.device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    const values = new Float32Array(copy.getMappedRange().slice(0));
    copy.destroy();
    return values;
  }
}
