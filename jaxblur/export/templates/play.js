// The page of `jaxblur play`. Names that come from files reach the page as text, never as markup.

const STEPS = 1000;
const ERROR_GAIN = 4;
// The time that is shown is the median of so many runs; a filter that was just chosen runs a few times, unless
// that takes longer than these milliseconds.
const TIMES = 9, FIRST_TIMES = 3, PATIENCE = 500;

const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const state = { planes: {}, values: {}, shutter: 1, compiled: new Map(), times: [], count: 0, running: false, again: false };

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}

async function plane({ half, data: text }) {
  const buffer = await (await unpacked(text)).arrayBuffer();
  if (!half) return new Float32Array(buffer);
  const table = new Float32Array(65536);
  for (let code = 0; code < 65536; code++) {
    const exponent = (code >> 10) & 31, fraction = code & 1023;
    const size = exponent === 0 ? fraction * 2 ** -24 : exponent === 31 ? 65504 : (1 + fraction / 1024) * 2 ** (exponent - 15);
    table[code] = code & 32768 ? -size : size;
  }
  return Float32Array.from(new Uint16Array(buffer), (code) => table[code]);
}

function say(id, text) {
  element(id).textContent = text;
  element(id).hidden = !text;
}

// Motion of another exposure: displacements grow with it, bends with its square.
function uploadMotion(scale) {
  const { velocity, path } = state.planes;
  if (velocity) state.gpu.upload("velocity", velocity.map((part) => part * scale));
  if (!path) return;
  const scaled = new Float32Array(path.length);
  for (let i = 0; i < path.length; i += 4) {
    for (const axis of [0, 1]) {
      const opening = path[i + axis], closing = path[i + 2 + axis];
      const way = ((closing - opening) / 2) * scale, bend = ((closing + opening) / 2) * scale * scale;
      scaled[i + axis] = bend - way;
      scaled[i + 2 + axis] = bend + way;
    }
  }
  state.gpu.upload("path", scaled);
}

const textOf = (parts) => parts.map((number) => state.programs.texts[number]).join("\n\n");

async function compiledForm({ plan, wgsl, glsl }) {
  if (state.gpu.constructor === Webgpu) return await state.gpu.compile(plan, textOf(wgsl));
  return await state.gpu.compile(plan, Object.fromEntries(Object.entries(glsl).map(([name, parts]) => [name, textOf(parts)])));
}

const psnr = (squaredError) => -10 * Math.log10(squaredError / (3 * data.width * data.height));
const decibels = (value) => (value === Infinity ? "no difference" : `${value.toFixed(2)} dB`);

// Blur with what is chosen now, show and measure it.
async function blur() {
  const { gpu, filter, variant, shutter } = state;
  if (state.used !== variant) {
    say("time", `Compiling ${filter.name} of ${variant.samples} samples …`);
    // WebGL compiles at once: let the page show that first.
    await new Promise((done) => setTimeout(done, 20));
    if (!state.compiled.has(variant)) state.compiled.set(variant, await compiledForm(variant));
    await gpu.use(state.compiled.get(variant));
    [state.used, state.times] = [variant, []];
  }
  if (state.uploaded !== shutter) uploadMotion(shutter);
  state.uploaded = shutter;
  const values = { ...state.values[filter.name] };
  state.times.push(await gpu.blur(values));
  state.shown = filter;
  draw();
  if (state.planes.truth) {
    state.score = psnr(await gpu.squaredError());
    say("psnr", `PSNR ${decibels(state.score)} against the truth (the input: ${decibels(state.sharp)}).`);
  }
  const patient = () => state.times.reduce((sum, time) => sum + time) < PATIENCE;
  while (state.times.length < FIRST_TIMES && patient() && !state.again) state.times.push(await gpu.blur(values));
  state.times = state.times.slice(-TIMES);
  const median = state.times.toSorted((a, b) => a - b)[state.times.length >> 1];
  const time = median < 0.1 ? "Less than 0.1" : median.toFixed(median < 100 ? 1 : 0);
  say("time", `${time} milliseconds a frame: the filter alone, by ${gpu.constructor.label}, ${state.times.length > 1 ? `median of the last ${state.times.length}` : "measured once"}.`);
  state.count += 1;
}

// Blur again; while one is running, once more after it.
async function update() {
  element("toml").value = toml();
  state.again = true;
  if (state.running) return;
  state.running = true;
  try {
    while (state.again) {
      state.again = false;
      await blur();
    }
    say("problem", "");
  } catch (error) {
    say("problem", `${state.filter.name} of ${state.variant.samples} samples does not run here. ${error.message}.`);
    say("time", "");
  } finally {
    state.running = false;
  }
}

function draw() {
  if (!state.shown) return;
  const share = element("split").value / 100, errors = element("error").checked;
  const compared = state.planes.truth ? "truth" : "color";
  state.gpu.show({
    gain: 2 ** element("exposure").value,
    edge: data.width * share,
    errors: errors ? ERROR_GAIN : 0,
    right: element("other").value,
    compared,
  });
  element("divider").style.left = `${100 * share}%`;
  element("stops").textContent = `${element("exposure").value} stops`;
  element("tag-left").textContent = errors ? `${ERROR_GAIN} x difference from the ${compared === "truth" ? "truth" : "input"}` : state.shown.name;
  element("tag-right").textContent = element("other").selectedOptions[0].textContent;
  element("tag-left").hidden = share === 0;
  element("tag-right").hidden = element("divider").hidden = share === 1;
}

const inside = ({ log, low, high }, share) => (log ? low * (high / low) ** share : low + share * (high - low));
const shareOf = ({ log, low, high }, value) => (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));
// Of five digits, so that what is copied is what is shown.
const rounded = (value) => Number(value.toPrecision(5));

function toml() {
  const { filter, variant, values, shutter } = state;
  const line = ([name, value]) => `${name} = ${JSON.stringify(value)}`;
  return [
    `# jaxblur blur FRAME -o OUT --parameters FILE --shutter ${rounded(data.shutter * shutter)}`,
    "schema = 1",
    line(["filter", filter.name]),
    ...["", "[parameters]", ...Object.entries(values[filter.name]).map(line)],
    ...["", "[settings]", ...Object.entries(variant.settings).map(line), ""],
  ].join("\n");
}

function makeSlider({ name, meaning, unit = "", steps = STEPS }, textAt, change) {
  const box = document.createElement("div"), label = document.createElement("label");
  const title = document.createElement("span"), shown = document.createElement("output");
  const input = document.createElement("input"), about = document.createElement("p");
  box.className = "slider";
  Object.assign(input, { type: "range", min: 0, max: steps, step: 1, id: `slider-${name}` });
  label.htmlFor = input.id;
  title.textContent = name;
  about.textContent = unit ? `${meaning} (${unit})` : meaning;
  label.append(title, shown);
  box.append(label, about, input);
  const set = (position) => {
    input.value = position;
    shown.textContent = textAt(input.value / steps);
    input.setAttribute("aria-valuetext", shown.textContent);
  };
  input.addEventListener("input", () => {
    set(input.value);
    change(input.value / steps);
    update();
  });
  return { box, set };
}

// A slider whose value is a number of a record; `reset` puts it to its default.
function numberSlider(slider, record, key) {
  const valueAt = (share) => rounded(inside(slider, share));
  const made = makeSlider(slider, (share) => String(valueAt(share)), (share) => (record[key] = valueAt(share)));
  const put = (value) => {
    record[key] = value;
    made.set(STEPS * shareOf(slider, value));
    made.box.querySelector("output").textContent = String(rounded(value));
  };
  return { box: made.box, put, reset: () => put(slider.value) };
}

function samplesSlider({ variants, start }) {
  const steps = variants.length - 1;
  const chosen = (share) => variants[Math.round(share * steps)];
  const about = { name: "samples", meaning: "per pixel; more of them, less grain", steps: Math.max(steps, 1) };
  const { box, set } = makeSlider(about, (share) => String(chosen(share).samples), (share) => (state.variant = chosen(share)));
  box.querySelector("input").disabled = steps === 0;
  const put = (variant) => {
    state.variant = variant;
    set(variants.indexOf(variant));
  };
  return { box, put, reset: () => put(variants[start]) };
}

// Show the sliders of a filter. Each keeps its parameters; samples stay where the filter has as many.
function choose(filter) {
  const samples = state.variant?.samples;
  state.filter = filter;
  element("filter").value = filter.name;
  element("summary").textContent = filter.summary;
  const values = (state.values[filter.name] ??= Object.fromEntries(filter.parameters.map(({ name, value }) => [name, value])));
  const count = samplesSlider(filter), shutter = numberSlider(data.slider, state, "shutter");
  const parameters = filter.parameters.map((slider) => numberSlider(slider, values, slider.name));
  parameters.forEach(({ put }, k) => put(values[filter.parameters[k].name]));
  count.put(filter.variants.find((variant) => variant.samples === samples) ?? filter.variants[filter.start]);
  shutter.put(state.shutter);
  state.sliders = [count, shutter, ...parameters];
  element("sliders").replaceChildren(...state.sliders.map(({ box }) => box));
}

async function openGpu() {
  const reasons = [];
  for (const kind of [Webgpu, Webgl]) {
    try {
      return { gpu: await kind.open(data.width, data.height, data.channels, element("canvas")), reasons };
    } catch (error) {
      reasons.push(error.message);
    }
  }
  throw new Error([...reasons, "A recent Chrome, Edge, Safari or Firefox has one of the two"].join(". "));
}

// The filter to begin with; those without a form here are disabled.
function firstFilter(filters, reasons) {
  const { language, label } = state.gpu.constructor;
  const able = filters.filter((filter) => filter.variants[0][language]);
  for (const filter of filters) {
    const option = new Option(able.includes(filter) ? filter.name : `${filter.name} (not in ${label})`, filter.name);
    option.disabled = !able.includes(filter);
    element("filter").append(option);
  }
  const named = filters.map(({ name }) => name).join(", ");
  if (!able.length) throw new Error([...reasons, `${named}: no form for ${label}`].join(". "));
  const first = able.includes(filters[0]) ? filters[0] : (able.find(({ name }) => name === "guertin2014") ?? able[0]);
  if (first !== filters[0]) {
    say("note", `${reasons[0]}, so ${label} blurs. It cannot run ${filters[0].name}: the page begins with ${first.name}.`);
  }
  return first;
}

function listen() {
  for (const id of ["split", "other", "error", "exposure"]) element(id).addEventListener("input", draw);
  element("filter").addEventListener("input", () => {
    choose(state.programs.filters.find(({ name }) => name === element("filter").value));
    update();
  });
  const splitAt = (event) => {
    const { left, width } = element("canvas").getBoundingClientRect();
    element("split").value = (100 * (event.clientX - left)) / width;
    draw();
  };
  element("canvas").addEventListener("pointerdown", splitAt);
  element("canvas").addEventListener("pointermove", (event) => event.buttons && splitAt(event));
  element("reset").addEventListener("click", () => {
    state.sliders.forEach(({ reset }) => reset());
    update();
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
}

async function start() {
  Object.assign(element("canvas"), { width: data.width, height: data.height });
  element("stage").classList.toggle("wide", data.width > data.height);
  new ResizeObserver(([{ contentRect }]) => {
    element("canvas").classList.toggle("pixels", contentRect.width * devicePixelRatio >= data.width);
  }).observe(element("canvas"));
  state.programs = await (await unpacked(data.programs)).json();
  for (const [name, packed] of Object.entries(data.planes)) state.planes[name] = await plane(packed);
  for (const [value, label] of [["color", "input"], ["truth", "truth"]]) {
    if (state.planes[value]) element("other").append(new Option(label, value));
  }
  element("other").value = state.planes.truth ? "truth" : "color";
  const { gpu, reasons } = await openGpu();
  state.gpu = gpu;
  gpu.onLost((reason) => say("problem", `The graphics processor was lost (${reason}). Load the page again.`));
  for (const [name, values] of Object.entries(state.planes)) gpu.upload(name, values);
  state.uploaded = 1;
  if (state.planes.truth) state.sharp = psnr(await gpu.squaredError("color"));
  choose(firstFilter(state.programs.filters, reasons));
  listen();
  await update();
}

start().catch((error) => say("problem", `The page cannot blur. ${error.message}.`));
