// Runs printed fragment shaders with WebGL 2, for tests.
function runWebgl(plan, shaders, width, height, inputs, parameters) {
  const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
  if (!gl) throw new Error("no WebGL 2");
  if (!gl.getExtension("EXT_color_buffer_float")) throw new Error("no float textures");
  const sized = (size) => sizeOf(size, width, height);
  const textures = {};
  for (const buffer of plan.buffers) {
    const [columns, rows] = sized(buffer.size);
    const count = Math.ceil(buffer.channels / 4);
    textures[buffer.name] = [];
    for (let k = 0; k < count; k++) {
      const name = count === 1 ? buffer.name : `${buffer.name}_${k}`;
      let data = null;
      if (buffer.role === "input") {
        data = new Float32Array(4 * columns * rows);
        for (let i = 0; i < columns * rows; i++)
          for (let c = 4 * k; c < Math.min(4 * k + 4, buffer.channels); c++)
            data[4 * i + c - 4 * k] = inputs[buffer.name][i * buffer.channels + c];
      }
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, columns, rows, 0, gl.RGBA, gl.FLOAT, data);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      textures[buffer.name].push({ name, texture });
    }
  }
  const compile = (type, text) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const corners = "#version 300 es\nvoid main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }";
  for (const pass of plan.passes) {
    const program = gl.createProgram();
    gl.attachShader(program, compile(gl.VERTEX_SHADER, corners));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER, shaders[pass.name]));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    for (const uniform of plan.uniforms) {
      if (uniform.type === "int32") gl.uniform1i(gl.getUniformLocation(program, uniform.name), uniform.name === "width" ? width : height);
      else gl.uniform1f(gl.getUniformLocation(program, `parameter_${uniform.name}`), parameters[uniform.name] ?? uniform.value);
    }
    let unit = 0;
    for (const name of pass.reads)
      for (const entry of textures[name]) {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, entry.texture);
        gl.uniform1i(gl.getUniformLocation(program, entry.name), unit++);
      }
    gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
    const outputs = textures[pass.writes];
    outputs.forEach((entry, k) =>
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, entry.texture, 0));
    gl.drawBuffers(outputs.map((_, k) => gl.COLOR_ATTACHMENT0 + k));
    const [columns, rows] = sized(pass.grid);
    gl.viewport(0, 0, columns, rows);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  const result = new Float32Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, result);
  if (gl.getError()) throw new Error("a WebGL error");
  const channels = plan.channels;
  const blurred = new Float32Array(channels * width * height);
  for (let i = 0; i < width * height; i++)
    for (let c = 0; c < channels; c++) blurred[channels * i + c] = result[4 * i + c];
  return blurred;
}
