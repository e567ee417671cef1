// Runs printed filters on one frame with WebGL 2, and shows and measures what they give.
// webgpu.js has the same methods.

const WEBGL_SUMS_SIDE = 64;

const WEBGL_CORNERS = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }
`;

// Of the points of a pass that leaves marks.
const WEBGL_POINTS = `#version 300 es
precision highp int;
flat in int kept;
layout(location = 0) out ivec4 write_marks;
void main() { write_marks = ivec4(kept, 0, 0, 0); }
`;

const WEBGL_DISPLAY = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
vec3 display(vec3 light) {
  vec3 x = clamp(light, 0.0, 1.0);
  return mix(1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, 12.92 * x, vec3(lessThanEqual(x, vec3(0.0031308))));
}
`;

// Squared differences of display values, summed over every so many pixels.
const WEBGL_ERRORS = `${WEBGL_DISPLAY}
uniform sampler2D image;
uniform sampler2D truth;
out vec4 sum;
void main() {
  ivec2 size = textureSize(image, 0);
  int first = int(gl_FragCoord.y) * ${WEBGL_SUMS_SIDE} + int(gl_FragCoord.x);
  sum = vec4(0.0);
  for (int k = first; k < size.x * size.y; k += ${WEBGL_SUMS_SIDE ** 2}) {
    ivec2 at = ivec2(k % size.x, k / size.x);
    vec3 difference = display(texelFetch(image, at, 0).rgb) - display(texelFetch(truth, at, 0).rgb);
    sum.x += dot(difference, difference);
  }
}
`;

const WEBGL_SHOW = `${WEBGL_DISPLAY}
uniform sampler2D blurred;
uniform sampler2D right;
uniform sampler2D compared;
uniform float gain;
uniform float edge;
uniform float errors;
out vec4 shade;
void main() {
  // A canvas has its first row below, the images above.
  ivec2 at = ivec2(gl_FragCoord.x, textureSize(blurred, 0).y - 1 - int(gl_FragCoord.y));
  vec3 shown = display(gain * texelFetch(blurred, at, 0).rgb);
  if (errors != 0.0) {
    shown = min(vec3(1.0), errors * abs(shown - display(gain * texelFetch(compared, at, 0).rgb)));
  }
  shade = vec4(gl_FragCoord.x < edge ? shown : display(gain * texelFetch(right, at, 0).rgb), 1.0);
}
`;

class Webgl {
  static language = "glsl";
  static label = "WebGL 2";

  // channels: of color. canvas: what `show` draws to, of the size of the frame; null for none.
  static async open(width, height, channels, canvas = null) {
    const gl = (canvas ?? new OffscreenCanvas(1, 1)).getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL 2");
    if (!gl.getExtension("EXT_color_buffer_float")) throw new Error("WebGL 2 cannot draw to float textures here");
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (Math.max(width, height) > most) throw new Error(`WebGL 2 has textures of ${most} pixels at most here`);
    const gpu = Object.assign(new Webgl(), { gl, most, width, height, channels, canvas: gl.canvas, images: {}, work: {}, marks: {}, passes: [] });
    gpu.images.blurred = gpu._textures("blurred", width, height, channels);
    gpu.sums = gpu._textures("sums", WEBGL_SUMS_SIDE, WEBGL_SUMS_SIDE, 1);
    gpu.summing = gpu._program(WEBGL_ERRORS);
    if (canvas) gpu.showing = gpu._program(WEBGL_SHOW);
    gpu._check();
    return gpu;
  }

  // Calls back with the reason if the graphics processor is lost.
  onLost(call) {
    this.canvas.addEventListener("webglcontextlost", () => call("the WebGL context is lost"));
  }

  // Fill an image of the frame: a Float32Array of all its pixels.
  upload(name, values) {
    const { gl, width, height } = this;
    const pixels = width * height, channels = values.length / pixels;
    this.images[name] ??= this._textures(name, width, height, channels);
    this.images[name].forEach(({ texture }, part) => {
      const texels = new Float32Array(4 * pixels);
      for (let i = 0; i < pixels; i++) {
        for (let c = 4 * part; c < Math.min(4 * part + 4, channels); c++) texels[4 * i + c - 4 * part] = values[i * channels + c];
      }
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, gl.RGBA, gl.FLOAT, texels);
    });
  }

  // plan: of the export; code: its GLSL by name of the pass. The result is for `use`.
  async compile(plan, code) {
    const compiled = (pass) => {
      const text = code[pass.name];
      return { ...pass, program: pass.marks ? this._program(WEBGL_POINTS, text) : this._program(text) };
    };
    return { plan, passes: plan.passes.map(compiled) };
  }

  // Make a compiled filter the one that blurs. The textures between its passes replace those of the one before.
  async use({ plan, passes }) {
    const { gl } = this;
    for (const { name, role } of plan.buffers) {
      if (role === "input" && !this.images[name]) throw new Error(`The filter reads ${name}, which was not uploaded`);
    }
    for (const { texture } of Object.values(this.work).flat()) gl.deleteTexture(texture);
    for (const { depth, target } of Object.values(this.marks)) {
      gl.deleteRenderbuffer(depth);
      gl.deleteFramebuffer(target);
    }
    [this.plan, this.work, this.marks] = [plan, {}, {}];
    for (const { name, role, type, size, channels, clear } of plan.buffers) {
      if (role !== "work") continue;
      const [columns, rows] = this._sized(size);
      if (Math.max(columns, rows) > this.most) throw new Error(`The filter needs a texture of ${columns} x ${rows}, and WebGL 2 has ${this.most} at most here`);
      this.work[name] = this._textures(name, columns, rows, channels, type);
      if (clear) this.marks[name] = this._forMarks(name, columns, rows);
    }
    this.passes = passes;
    this._check();
  }

  // Blur the frame with parameters by name; resolves to the milliseconds that the passes took.
  async blur(parameters = {}) {
    const { gl } = this;
    const started = performance.now();
    for (const { program, reads, writes, grid, marks } of this.passes) {
      gl.useProgram(program);
      for (const { name, type, value } of this.plan.uniforms) {
        if (type === "int32") gl.uniform1i(gl.getUniformLocation(program, name), this[name]);
        else gl.uniform1f(gl.getUniformLocation(program, `parameter_${name}`), parameters[name] ?? value);
      }
      const of = (name) => this.work[name] ?? this.images[name];
      if (marks) this._drawMarks(program, reads.flatMap(of), writes, marks);
      else this._draw(program, reads.flatMap(of), of(writes), ...this._sized(grid));
    }
    // Waits for the last pass.
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, new Float32Array(4));
    return performance.now() - started;
  }

  // Sum over pixels and channels of squared differences from the image `truth`, in display values.
  async squaredError(name = "blurred") {
    const side = WEBGL_SUMS_SIDE;
    const images = [{ ...this.images[name][0], name: "image" }, this.images.truth[0]];
    this._draw(this.summing, images, this.sums, side, side);
    return this._pixels(side, side).reduce((sum, part) => sum + part, 0);
  }

  // Draw the result up to the column `edge`, from there the image `right`; colors are multiplied by
  // `gain`. If `errors` is not 0, draw so many times the difference from the image `compared` instead.
  show({ gain, edge, errors, right, compared }) {
    const { gl } = this;
    gl.useProgram(this.showing);
    for (const [name, value] of Object.entries({ gain, edge, errors })) gl.uniform1f(gl.getUniformLocation(this.showing, name), value);
    const images = [this.images.blurred[0], { ...this.images[right][0], name: "right" }, { ...this.images[compared][0], name: "compared" }];
    this._draw(this.showing, images, null, this.width, this.height);
  }

  // The result: a Float32Array of all pixels.
  async read() {
    const { gl, width, height, channels } = this;
    const values = new Float32Array(width * height * channels);
    this.images.blurred.forEach((_, part) => {
      this._target([this.images.blurred[part]]);
      const texels = this._pixels(width, height);
      for (let i = 0; i < width * height; i++) {
        for (let c = 4 * part; c < Math.min(4 * part + 4, channels); c++) values[i * channels + c] = texels[4 * i + c - 4 * part];
      }
    });
    if (gl.getError()) throw new Error("WebGL reports an error");
    return values;
  }

  // Columns and rows. Shaders find the elements of a stack row by row in a texture of any width.
  _sized({ of, factor }) {
    const { width, height, most } = this;
    if (of === "tiles") return [Math.ceil(width / factor), Math.ceil(height / factor)];
    const columns = factor === 1 ? width : Math.min(most, width * Math.ceil(Math.sqrt(factor)));
    return [columns, Math.ceil((width * height * factor) / columns)];
  }

  // The textures of a buffer, four channels each, under the names that the shaders have for them.
  _textures(name, columns, rows, channels, type = "float32") {
    const { gl } = this;
    const count = Math.ceil(channels / 4);
    const format = type === "float32" ? gl.RGBA32F : channels === 1 ? gl.R32I : gl.RGBA32I;
    return Array.from({ length: count }, (_, part) => {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, format, columns, rows);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
      return { name: count === 1 ? name : `${name}_${part}`, texture };
    });
  }

  // What finds the largest marks: a texture of their high bits, and a depth buffer.
  _forMarks(name, columns, rows) {
    const { gl } = this;
    const [high] = (this.work[`high bits of ${name}`] = this._textures("high_bits", columns, rows, 1, "int32"));
    const depth = gl.createRenderbuffer(), target = gl.createFramebuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, columns, rows);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
    return { high, depth, target, columns, rows };
  }

  _program(fragments, corners = WEBGL_CORNERS) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, corners], [gl.FRAGMENT_SHADER, fragments]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  // Draw to textures; to the canvas if there are none.
  _target(outputs) {
    const { gl } = this;
    this.target ??= gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, outputs && this.target);
    if (!outputs) return;
    // What an earlier pass wrote beside them must not stay attached: a pass may not read it then.
    for (let k = 0; k < Math.max(outputs.length, this.attached ?? 0); k++) {
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, outputs[k]?.texture ?? null, 0);
    }
    this.attached = outputs.length;
    gl.drawBuffers(outputs.map((_, k) => gl.COLOR_ATTACHMENT0 + k));
  }

  _bind(program, images) {
    const { gl } = this;
    gl.useProgram(program);
    images.forEach(({ name, texture }, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(gl.getUniformLocation(program, name), unit);
    });
  }

  _draw(program, images, outputs, columns, rows) {
    const { gl } = this;
    this._bind(program, images);
    this._target(outputs);
    gl.viewport(0, 0, columns, rows);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // The largest of the marks at each place. A depth buffer holds 16 bits exactly, marks have 31: the
  // high bits compete first, then the low bits of the marks that have the largest.
  _drawMarks(program, images, name, marks) {
    const { gl } = this;
    const [output] = this.work[name];
    const { high, target, columns, rows } = this.marks[name];
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, columns, rows);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.GEQUAL);
    // In the first round `high_bits` is not looked at, but may not be what is drawn to.
    for (const [round, drawn, read] of [[0, high, output], [1, output, high]]) {
      this._bind(program, [...images, { ...read, name: "high_bits" }]);
      gl.uniform1i(gl.getUniformLocation(program, "low_bits"), round);
      gl.uniform2i(gl.getUniformLocation(program, "table_size"), columns, rows);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, drawn.texture, 0);
      gl.clearBufferiv(gl.COLOR, 0, [0, 0, 0, 0]);
      gl.clearBufferfv(gl.DEPTH, 0, [0]);
      gl.drawArraysInstanced(gl.POINTS, 0, this.width * this.height, marks);
    }
    gl.disable(gl.DEPTH_TEST);
  }

  // The texels of the first texture that is drawn to.
  _pixels(columns, rows) {
    const texels = new Float32Array(4 * columns * rows);
    this.gl.readPixels(0, 0, columns, rows, this.gl.RGBA, this.gl.FLOAT, texels);
    return texels;
  }

  _check() {
    const { gl } = this;
    const code = gl.getError();
    if (code === gl.OUT_OF_MEMORY) throw new Error("The graphics processor has too little memory");
    if (code) throw new Error(`WebGL reports error ${code}`);
  }
}
