// The page of `jaxblur play`. Names that come from files reach the page as text, never as markup.

const STEPS = 1000;
const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const pixels = data.width * data.height;
const state = { values: {}, planes: {}, blurred: null, running: false, again: false };

async function unpacked({ half, data: text }) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  if (!half) return new Float32Array(buffer);
  const table = new Float32Array(65536);
  for (let code = 0; code < 65536; code++) {
    const exponent = (code >> 10) & 31, fraction = code & 1023;
    const size = exponent === 0 ? fraction * 2 ** -24 : exponent === 31 ? 65504 : (1 + fraction / 1024) * 2 ** (exponent - 15);
    table[code] = code & 32768 ? -size : size;
  }
  return Float32Array.from(new Uint16Array(buffer), (code) => table[code]);
}

const encoded = (light) => {
  const x = Math.min(Math.max(light, 0), 1);
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
};

function psnr(image, truth) {
  let sum = 0;
  for (let k = 0; k < image.length; k++) sum += (encoded(image[k]) - encoded(truth[k])) ** 2;
  return sum === 0 ? Infinity : -10 * Math.log10(sum / image.length);
}

function draw() {
  const { blurred, planes } = state;
  if (!blurred) return;
  const other = element("other").value === "truth" ? planes.truth : planes.color;
  const compared = planes.truth ?? planes.color;
  const gain = 2 ** element("exposure").value, edge = (data.width * element("split").value) / 100;
  const errors = element("error").checked;
  const image = new ImageData(data.width, data.height);
  for (let i = 0; i < pixels; i++) {
    const left = i % data.width < edge;
    for (let c = 0; c < 3; c++) {
      const k = 3 * i + c;
      let shown = encoded((left ? blurred : other)[k] * gain);
      if (errors && left) shown = Math.min(1, 4 * Math.abs(encoded(blurred[k] * gain) - encoded(compared[k] * gain)));
      image.data[4 * i + c] = 255 * shown + 0.5;
    }
    image.data[4 * i + 3] = 255;
  }
  element("canvas").getContext("2d").putImageData(image, 0, 0);
  element("divider").style.left = `${element("split").value}%`;
  element("tag-left").textContent = errors ? `4 x difference from ${planes.truth ? "truth" : "input"}` : data.plan.filter;
  element("tag-right").textContent = element("split").value < 100 ? element("other").selectedOptions[0].textContent : "";
}

// Motion of another exposure: displacements grow with it, bends with its square.
function scaled(scale) {
  const { velocity, path } = state.planes;
  const motion = { velocity: velocity.map((part) => part * scale) };
  if (path) {
    motion.path = new Float32Array(path.length);
    for (let i = 0; i < pixels; i++) {
      for (let axis = 0; axis < 2; axis++) {
        const opening = path[4 * i + axis], closing = path[4 * i + 2 + axis];
        const way = ((closing - opening) / 2) * scale, bend = ((closing + opening) / 2) * scale * scale;
        motion.path[4 * i + axis] = bend - way;
        motion.path[4 * i + 2 + axis] = bend + way;
      }
    }
  }
  return motion;
}

async function blur() {
  if (state.running) {
    state.again = true;
    return;
  }
  state.running = true;
  try {
    do {
      state.again = false;
      if (state.uploaded !== state.values.shutter) {
        const motion = scaled(state.values.shutter);
        for (const name of ["velocity", "path"]) {
          if (motion[name] && state.filter.buffers[name]) state.filter.upload(name, motion[name]);
        }
        state.uploaded = state.values.shutter;
      }
      state.blurred = await state.filter.run(state.values);
      const started = performance.now();
      const encoder = state.filter.device.createCommandEncoder();
      state.filter.encode(encoder, state.values);
      state.filter.device.queue.submit([encoder.finish()]);
      await state.filter.device.queue.onSubmittedWorkDone();
      element("time").textContent = `${(performance.now() - started).toFixed(1)} ms a frame.`;
      if (state.planes.truth) {
        state.score = psnr(state.blurred, state.planes.truth);
        element("psnr").textContent = `PSNR ${state.score.toFixed(2)} dB against the truth.`;
      }
      state.count = (state.count ?? 0) + 1;
      draw();
    } while (state.again);
  } finally {
    state.running = false;
  }
}

const inside = (slider, share) =>
  slider.log ? slider.low * (slider.high / slider.low) ** share : slider.low + share * (slider.high - slider.low);
const shareOf = (slider, value) =>
  slider.log ? Math.log(value / slider.low) / Math.log(slider.high / slider.low) : (value - slider.low) / (slider.high - slider.low);
const text = (value) => String(Number(value.toPrecision(5)));

function toml() {
  const lines = [`filter = "${data.plan.filter}"`, "", "[parameters]"];
  const options = [];
  for (const { name } of data.sliders.filter((slider) => slider.name !== "shutter")) {
    const value = text(state.values[name]);
    lines.push(`${name} = ${/[.e]/.test(value) ? value : `${value}.0`}`);
    options.push(`--param ${name}=${value}`);
  }
  const shutter = text(data.shutter * state.values.shutter);
  return [...lines, "", `# --filter ${data.plan.filter} ${[...options, `--shutter ${shutter}`].join(" ")}`, ""].join("\n");
}

function makeSlider(slider) {
  const box = document.createElement("div"), label = document.createElement("label");
  const name = document.createElement("span"), shown = document.createElement("output");
  const input = document.createElement("input"), meaning = document.createElement("p");
  box.className = "slider";
  input.type = "range";
  [input.min, input.max, input.step, input.id] = [0, STEPS, 1, `slider-${slider.name}`];
  label.htmlFor = input.id;
  name.textContent = slider.name;
  meaning.textContent = slider.unit ? `${slider.meaning} (${slider.unit})` : slider.meaning;
  label.append(name, shown);
  box.append(label, input, meaning);
  const set = (value) => {
    state.values[slider.name] = value;
    shown.textContent = text(value);
    element("toml").value = toml();
  };
  input.addEventListener("input", () => {
    set(inside(slider, input.value / STEPS));
    blur();
  });
  slider.reset = () => {
    input.value = STEPS * shareOf(slider, slider.value);
    set(slider.value);
  };
  return box;
}

async function start() {
  element("canvas").width = data.width;
  element("canvas").height = data.height;
  for (const [name, plane] of Object.entries(data.planes)) state.planes[name] = await unpacked(plane);
  for (const [value, label] of [["color", "input"], ["truth", "truth"]]) {
    if (state.planes[value]) element("other").append(new Option(label, value));
  }
  element("other").value = state.planes.truth ? "truth" : "color";
  for (const slider of data.sliders) state.values[slider.name] = slider.value;
  for (const slider of data.sliders) element("sliders").append(makeSlider(slider));
  data.sliders.forEach((slider) => slider.reset());
  for (const id of ["split", "other", "error", "exposure"]) {
    element(id).addEventListener("input", () => {
      element("stops").textContent = `${element("exposure").value} stops`;
      draw();
    });
  }
  element("reset").addEventListener("click", () => {
    data.sliders.forEach((slider) => slider.reset());
    blur();
  });
  element("copy").addEventListener("click", async () => {
    element("toml").select();
    try {
      await navigator.clipboard.writeText(element("toml").value);
      element("copy").textContent = "Copied";
    } catch {
      element("copy").textContent = "Press Ctrl-C";
    }
    setTimeout(() => (element("copy").textContent = "Copy as TOML"), 1500);
  });
  const device = await webgpuDevice();
  state.filter = await Filter.make(device, data.plan, data.code, data.width, data.height);
  for (const [name, values] of Object.entries(state.planes)) {
    if (state.filter.buffers[name]?.role === "input") state.filter.upload(name, values);
  }
  state.uploaded = 1;
  await blur();
}

start().catch((error) => {
  element("problem").textContent = `${error.message} This page needs WebGPU: a recent Chrome, Edge, Safari or Firefox.`;
  element("problem").hidden = false;
});
