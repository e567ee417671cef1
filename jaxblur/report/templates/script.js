"use strict";
// Names that may come from files reach the page as text, never as markup.

const COLORS = ["#3b82f6", "#ef7d22", "#2fa84f", "#d9404a", "#9b6bd3", "#a0705c", "#dd6fb8", "#8c8c8c"];
const MAGMA = [
  [0, 0, 4], [28, 16, 68], [79, 18, 123], [129, 37, 129], [181, 54, 122],
  [229, 80, 100], [251, 135, 97], [254, 194, 135], [252, 253, 191],
];
const SVG = "http://www.w3.org/2000/svg";
const LEVELS = 16384;
const MOST_LABELS = 12;
const shots = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const view = { shot: 0, picture: 0, reference: 0, flip: false, slide: 100, exposure: 0, scale: 1, x: 0, y: 0, probe: null };

// The sRGB curve, as a table over [0, 1].
const encoded = new Uint8ClampedArray(LEVELS + 1);
for (let level = 0; level <= LEVELS; level += 1) {
  const light = level / LEVELS;
  encoded[level] = 255 * (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);
}

const current = () => shots[view.shot];
const pictureAt = (index) => current().pictures[index];
const drawable = (picture) => Boolean(picture.mantissa || picture.high);
const truthIndex = () => current().pictures.findIndex((picture) => picture.truth);
const hasErrors = () => current().pictures.some((picture) => picture.flip);
const showsError = (picture) => view.flip && Boolean(picture.flip);

// Pixels of pictures: decoded once and kept while the page is open.

async function pixelsOf(uri, width, height) {
  const image = new Image();
  image.src = uri;
  await image.decode();
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, width, height).data;
}

function decode(shot, picture) {
  picture.decoded ??= (async () => {
    const { width, height } = shot;
    const parts = [picture.mantissa, picture.exponent, picture.flip, picture.high, picture.low];
    const [mantissa, exponent, flip, high, low] = await Promise.all(
      parts.map((uri) => uri && pixelsOf(uri, width, height)),
    );
    if (high) {
      picture.vectors = Float32Array.from({ length: 2 * width * height }, (_, k) => {
        const place = 4 * (k >> 1) + (k & 1);
        return (256 * high[place] + low[place] - 32768) * picture.step;
      });
      picture.fastest = 0;
      for (let k = 0; k < picture.vectors.length; k += 2) {
        picture.fastest = Math.max(picture.fastest, Math.hypot(picture.vectors[k], picture.vectors[k + 1]));
      }
      return picture;
    }
    const light = new Float32Array(3 * width * height);
    for (let pixel = 0; pixel < width * height; pixel += 1) {
      const factor = 2 ** (exponent[4 * pixel] - 136);
      for (let channel = 0; channel < 3; channel += 1) {
        light[3 * pixel + channel] = mantissa[4 * pixel + channel] * factor;
      }
    }
    picture.light = light;
    picture.error = flip && Float32Array.from({ length: width * height }, (_, k) => flip[4 * k] / 255);
    return picture;
  })();
  return picture.decoded;
}

function magma(error) {
  const place = Math.min(error, 1) * (MAGMA.length - 1);
  const below = Math.min(Math.floor(place), MAGMA.length - 2);
  return MAGMA[below].map((low, channel) => low + (place - below) * (MAGMA[below + 1][channel] - low));
}

// The colors of `jaxblur.show`: hue is the direction, saturation the speed up to 1.
function wheel(x, y) {
  const hue = (6 + (3 * Math.atan2(y, x)) / Math.PI) % 6;
  const speed = Math.min(Math.hypot(x, y), 1);
  return [0, 4, 2].map((shift) => {
    const pure = Math.min(Math.max(Math.abs(((hue + shift) % 6) - 3) - 1, 0), 1);
    return 255 * (1 - speed * (1 - pure));
  });
}

function paintLight(pixels, { light }) {
  const gain = LEVELS * 2 ** view.exposure;
  for (let pixel = 0; pixel < light.length / 3; pixel += 1) {
    for (let channel = 0; channel < 3; channel += 1) {
      pixels[4 * pixel + channel] = encoded[Math.min(LEVELS, (light[3 * pixel + channel] * gain + 0.5) | 0)];
    }
  }
}

function paintError(pixels, { error }) {
  error.forEach((value, pixel) => pixels.set(magma(value), 4 * pixel));
}

function paintVectors(pixels, { vectors, fastest }) {
  const scale = 2 ** view.exposure / (fastest || 1);
  for (let pixel = 0; pixel < vectors.length / 2; pixel += 1) {
    pixels.set(wheel(scale * vectors[2 * pixel], scale * vectors[2 * pixel + 1]), 4 * pixel);
  }
}

function shown(shot, picture) {
  const key = showsError(picture) ? "flip" : view.exposure;
  if (picture.shownKey === key) return picture.shown;
  const data = new ImageData(shot.width, shot.height);
  data.data.fill(255);
  const paint = showsError(picture) ? paintError : picture.vectors ? paintVectors : paintLight;
  paint(data.data, picture);
  picture.shown = new OffscreenCanvas(shot.width, shot.height);
  picture.shown.getContext("2d").putImageData(data, 0, 0);
  picture.shownKey = key;
  return picture.shown;
}

// The picture on screen: both sides share one transform, so that they stay aligned.

const canvas = element("canvas");
let drawing = 0;

async function draw() {
  drawing += 1;
  const turn = drawing;
  const shot = current();
  const sides = [pictureAt(view.picture), pictureAt(view.reference)];
  canvas.dataset.drawn = "";
  await Promise.all(sides.filter(drawable).map((picture) => decode(shot, picture)));
  if (turn !== drawing) return;
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  const context = canvas.getContext("2d");
  context.imageSmoothingEnabled = view.scale < 1;
  const split = Math.round((canvas.width * view.slide) / 100);
  for (const [picture, from, to] of [[sides[0], 0, split], [sides[1], split, canvas.width]]) {
    if (!drawable(picture) || from >= to) continue;
    context.save();
    context.beginPath();
    context.rect(from, 0, to - from, canvas.height);
    context.clip();
    const factor = ratio * view.scale;
    context.setTransform(factor, 0, 0, factor, ratio * view.x, ratio * view.y);
    context.drawImage(shown(shot, picture), 0, 0);
    context.restore();
  }
  drawProbe(context, ratio);
  Object.assign(canvas.dataset, { scale: view.scale, x: view.x, y: view.y, drawn: "yes" });
  read();
}

function drawProbe(context, ratio) {
  if (!view.probe || document.activeElement !== canvas) return;
  const size = Math.max(view.scale, 4) * ratio;
  context.lineWidth = 2;
  for (const [color, grow] of [["#000", 2], ["#fff", 0]]) {
    context.strokeStyle = color;
    context.strokeRect(
      ratio * (view.x + view.probe.column * view.scale) - grow,
      ratio * (view.y + view.probe.row * view.scale) - grow,
      size + 2 * grow,
      size + 2 * grow,
    );
  }
}

function sizeStage() {
  const shot = current();
  const height = Math.min((canvas.clientWidth * shot.height) / shot.width, 0.75 * window.innerHeight);
  canvas.style.height = `${Math.round(height)}px`;
}

function fit() {
  const shot = current();
  view.scale = Math.min(canvas.clientWidth / shot.width, canvas.clientHeight / shot.height);
  view.x = (canvas.clientWidth - shot.width * view.scale) / 2;
  view.y = (canvas.clientHeight - shot.height * view.scale) / 2;
  update();
}

function zoom(factor, x = canvas.clientWidth / 2, y = canvas.clientHeight / 2) {
  const scale = Math.min(64, Math.max(0.1, view.scale * factor));
  view.x = x - ((x - view.x) * scale) / view.scale;
  view.y = y - ((y - view.y) * scale) / view.scale;
  view.scale = scale;
  update();
}

// Readout and state of the controls.

function read() {
  const { probe } = view;
  const shot = current();
  if (!probe) return;
  const lines = [`row ${probe.row + shot.top}, column ${probe.column + shot.left}`];
  for (const index of new Set([view.picture, view.reference])) {
    const picture = pictureAt(index);
    const pixel = probe.row * shot.width + probe.column;
    if (picture.vectors) {
      const [x, y] = [0, 1].map((axis) => picture.vectors[2 * pixel + axis].toFixed(2));
      lines.push(`${picture.method}: x ${x} y ${y} px (half-spread)`);
    }
    if (!picture.light) continue;
    const values = Array.from(picture.light.slice(3 * pixel, 3 * pixel + 3), (v) => v.toPrecision(4));
    const error = picture.error ? `  FLIP ${picture.error[pixel].toFixed(3)}` : "";
    lines.push(`${picture.method}: R ${values[0]} G ${values[1]} B ${values[2]}${error}`);
  }
  element("readout").textContent = lines.join("\n");
}

function update() {
  const shot = current();
  const [picture, reference] = [pictureAt(view.picture), pictureAt(view.reference)];
  for (const [index, button] of [...element("methods").children].entries()) {
    button.setAttribute("aria-checked", String(index === view.picture));
    button.tabIndex = index === view.picture ? 0 : -1;
  }
  element("shot").value = String(view.shot);
  element("reference").value = String(view.reference);
  element("flip").setAttribute("aria-pressed", String(view.flip));
  element("slide").value = String(view.slide);
  element("slide").setAttribute(
    "aria-valuetext",
    view.slide === 100 ? "only the picture" : `${view.slide} % ${picture.method}, then ${reference.method}`,
  );
  element("exposure").value = String(view.exposure);
  element("stops").textContent = `${view.exposure > 0 ? "+" : ""}${view.exposure} stops`;
  element("zoom").textContent = `${Math.round(100 * view.scale)} %`;
  element("tag-left").textContent = view.slide > 0 ? picture.method : "";
  element("tag-right").textContent = view.slide < 100 ? reference.method : "";
  element("divider").hidden = view.slide === 0 || view.slide === 100;
  element("divider").style.left = `calc(${view.slide}% - 1px)`;
  canvas.setAttribute("aria-label", `${showsError(picture) ? "FLIP map" : "Picture"} of ${shot.name} by ${picture.method}`);
  for (const row of document.querySelectorAll("tr[data-method]")) {
    const chosen = row.dataset.shot === shot.name && row.dataset.method === picture.method;
    row.classList.toggle("chosen", chosen);
  }
  for (const point of document.querySelectorAll("#plot .point")) {
    const chosen = Number(point.dataset.picture) === view.picture;
    point.classList.toggle("chosen", chosen);
    point.setAttribute("aria-pressed", String(chosen));
  }
  draw();
}

function announce(text) {
  element("status").textContent = text;
}

function choose(index) {
  if (index < 0 || index >= current().pictures.length) return;
  view.picture = index;
  const picture = pictureAt(index);
  announce(drawable(picture) ? `${picture.method} of ${current().name}` : `${picture.method} has scores only`);
  update();
}

function chooseShot(index) {
  view.shot = index;
  view.picture = Math.min(view.picture, current().pictures.length - 1);
  view.reference = Math.max(truthIndex(), 0);
  view.probe = null;
  element("flip").hidden = !hasErrors();
  fillMethods();
  sizeStage();
  drawPlot();
  fit();
}

function fillMethods() {
  const buttons = current().pictures.map((picture, index) => {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", role: "radio", textContent: picture.method });
    button.setAttribute("role", "radio");
    if (index < 9) {
      const key = document.createElement("kbd");
      key.textContent = String(index + 1);
      key.setAttribute("aria-hidden", "true");
      button.prepend(key);
      button.setAttribute("aria-keyshortcuts", String(index + 1));
    }
    button.addEventListener("click", () => choose(index));
    return button;
  });
  element("methods").replaceChildren(...buttons);
  fillOptions(element("reference"), current().pictures.map((picture) => picture.method));
}

function fillOptions(select, names) {
  select.replaceChildren(
    ...names.map((name, index) => new Option(name, String(index))),
  );
}

// Speed against error.

function svg(name, attributes, text) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
}

function star(x, y, radius) {
  return Array.from({ length: 10 }, (_, k) => {
    const reach = k % 2 ? radius * 0.45 : radius;
    const angle = (Math.PI * k) / 5 - Math.PI / 2;
    return `${(x + reach * Math.cos(angle)).toFixed(1)},${(y + reach * Math.sin(angle)).toFixed(1)}`;
  }).join(" ");
}

// Larger is better for PSNR and SSIM; all other scores are errors.
const largerIsBetter = (name) => /psnr|ssim/i.test(name);

function scaleOf(values, logarithmic, from, to) {
  const map = logarithmic ? Math.log : (value) => value;
  const ends = [Math.min(...values), Math.max(...values)].map(map);
  const margin = (ends[1] - ends[0] || 1) * 0.08;
  const [low, high] = [ends[0] - margin, ends[1] + margin];
  const place = (value) => from + ((map(value) - low) / (high - low)) * (to - from);
  const inverse = (share) => (logarithmic ? Math.exp(low + share * (high - low)) : low + share * (high - low));
  return { place, ticks: [0.1, 0.37, 0.63, 0.9].map(inverse) };
}

function front(points, better) {
  const kept = [];
  for (const point of [...points].sort((a, b) => a.time - b.time || (better(a, b) ? -1 : 1))) {
    if (!kept.length || better(point, kept.at(-1))) kept.push(point);
  }
  return kept;
}

function drawPlot() {
  const plot = element("plot");
  if (!plot) return;
  const name = element("axis").value;
  const points = current().pictures
    .map((picture, index) => ({ picture, index, time: picture.milliseconds, error: picture.scores[name] }))
    .filter((point) => point.time > 0 && Number.isFinite(point.error));
  const [width, height, left, bottom] = [420, 320, 58, 40];
  plot.setAttribute("viewBox", `0 0 ${width} ${height}`);
  plot.replaceChildren();
  if (!points.length) {
    plot.append(svg("text", { x: 10, y: 30 }, "No times or scores for this shot."));
    return;
  }
  const positive = points.every((point) => point.error > 0);
  const across = scaleOf(points.map((p) => p.time), true, left, width - 12);
  const up = scaleOf(points.map((p) => p.error), positive && !largerIsBetter(name), height - bottom, 12);
  for (const tick of across.ticks) {
    const x = across.place(tick);
    plot.append(svg("line", { class: "grid", x1: x, x2: x, y1: 12, y2: height - bottom }));
    plot.append(svg("text", { x, y: height - bottom + 15, "text-anchor": "middle" }, tick.toPrecision(2)));
  }
  for (const tick of up.ticks) {
    const y = up.place(tick);
    plot.append(svg("line", { class: "grid", x1: left, x2: width - 12, y1: y, y2: y }));
    plot.append(svg("text", { x: left - 6, y: y + 4, "text-anchor": "end" }, tick.toPrecision(3)));
  }
  plot.append(svg("text", { x: (left + width) / 2, y: height - 6, "text-anchor": "middle" }, "milliseconds"));
  plot.append(svg("text", { x: 12, y: (height - bottom) / 2, transform: `rotate(-90 12 ${(height - bottom) / 2})`, "text-anchor": "middle" }, name));
  const sign = largerIsBetter(name) ? -1 : 1;
  const line = front(points, (a, b) => sign * a.error < sign * b.error);
  const path = line.map((p, k) => `${k ? `H${across.place(p.time)} V` : `M${across.place(p.time)} `}${up.place(p.error)}`);
  plot.append(svg("path", { class: "front", d: path.join(" ") }));
  const groups = [...new Set(points.map((point) => point.picture.group || point.picture.method))];
  for (const point of points) {
    plot.append(mark(point, across, up, groups, name));
    if (points.length <= MOST_LABELS) plot.append(label(point, across, up, width));
  }
}

function label(point, across, up, width) {
  const [x, y] = [across.place(point.time), up.place(point.error)];
  const leftward = x > 0.6 * width;
  return svg(
    "text",
    { x: x + (leftward ? -10 : 10), y: y - 8, "text-anchor": leftward ? "end" : "start", "aria-hidden": "true" },
    point.picture.method,
  );
}

function mark(point, across, up, groups, name) {
  const { picture } = point;
  const [x, y] = [across.place(point.time), up.place(point.error)];
  const color = COLORS[groups.indexOf(picture.group || picture.method) % COLORS.length];
  const text = `${picture.method}: ${point.time.toPrecision(3)} ms, ${name} ${point.error.toPrecision(4)}`;
  const common = { class: "point", fill: color, tabindex: 0, role: "button", "aria-label": text, "data-picture": point.index };
  const node = picture.published
    ? svg("polygon", { ...common, points: star(x, y, 11) })
    : svg("circle", { ...common, cx: x, cy: y, r: 6 });
  node.append(svg("title", {}, text));
  const act = () => {
    choose(point.index);
    element("stage").scrollIntoView({ block: "nearest" });
  };
  node.addEventListener("click", act);
  node.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    act();
  });
  return node;
}

// Tables.

function sortBy(table, column) {
  const heads = [...table.tHead.rows[0].cells];
  const falling = heads[column].getAttribute("aria-sort") === "ascending";
  const key = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
  const numeric = heads[column].classList.contains("number");
  const rows = [...table.tBodies[0].rows].sort((a, b) => {
    const [first, second] = [key(a), key(b)];
    // Unknown values stay at the end in both orders.
    if (first === "" || second === "") return (first === "") - (second === "");
    const order = numeric ? number(first) - number(second) : first.localeCompare(second, undefined, { numeric: true });
    return falling ? -order : order;
  });
  table.tBodies[0].append(...rows);
  heads.forEach((head, index) => {
    if (index === column) head.setAttribute("aria-sort", falling ? "descending" : "ascending");
    else head.removeAttribute("aria-sort");
  });
}

const number = (text) => (text === "inf" ? Infinity : text === "-inf" ? -Infinity : Number(text));

// Events.

function pixelUnder(event) {
  const box = canvas.getBoundingClientRect();
  const shot = current();
  const column = Math.floor((event.clientX - box.left - view.x) / view.scale);
  const row = Math.floor((event.clientY - box.top - view.y) / view.scale);
  return column >= 0 && row >= 0 && column < shot.width && row < shot.height ? { row, column } : null;
}

function moveProbe(rows, columns) {
  const shot = current();
  const probe = view.probe ?? { row: shot.height >> 1, column: shot.width >> 1 };
  view.probe = {
    row: Math.min(shot.height - 1, Math.max(0, probe.row + rows)),
    column: Math.min(shot.width - 1, Math.max(0, probe.column + columns)),
  };
  update();
  announce(element("readout").textContent);
}

function swap() {
  [view.picture, view.reference] = [view.reference, view.picture];
  announce(`${pictureAt(view.picture).method} of ${current().name}`);
  update();
}

function expose(stops) {
  view.exposure = Math.min(6, Math.max(-6, stops));
  update();
}

function toggleFlip() {
  if (!hasErrors()) return;
  view.flip = !view.flip;
  announce(view.flip ? "FLIP map" : "Picture");
  update();
}

const KEYS = {
  t: () => choose(truthIndex()),
  x: swap,
  f: toggleFlip,
  "[": () => expose(view.exposure - 0.5),
  "]": () => expose(view.exposure + 0.5),
  "+": () => zoom(1.25),
  "=": () => zoom(1.25),
  "-": () => zoom(0.8),
  z: fit,
};
const ARROWS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
  const { key } = event;
  if (/^[1-9]$/.test(key)) choose(Number(key) - 1);
  else if (KEYS[key.toLowerCase()]) KEYS[key.toLowerCase()]();
  else if (ARROWS[key] && event.target === canvas) {
    const [rows, columns] = ARROWS[key];
    if (event.shiftKey) {
      view.x -= 40 * columns;
      view.y -= 40 * rows;
      update();
    } else moveProbe(rows, columns);
  } else if (ARROWS[key] && event.target.parentElement === element("methods")) {
    const count = current().pictures.length;
    const step = key === "ArrowUp" || key === "ArrowLeft" ? count - 1 : 1;
    choose((view.picture + step) % count);
    element("methods").children[view.picture].focus();
  } else return;
  event.preventDefault();
}

function listen() {
  document.addEventListener("keydown", onKey);
  element("shot").addEventListener("change", (event) => chooseShot(Number(event.target.value)));
  element("reference").addEventListener("change", (event) => {
    view.reference = Number(event.target.value);
    update();
  });
  element("slide").addEventListener("input", (event) => {
    view.slide = Number(event.target.value);
    update();
  });
  element("exposure").addEventListener("input", (event) => expose(Number(event.target.value)));
  element("axis")?.addEventListener("change", () => {
    drawPlot();
    update();
  });
  for (const [id, act] of [["flip", toggleFlip], ["swap", swap], ["fit", fit], ["zoom-in", () => zoom(1.25)], ["zoom-out", () => zoom(0.8)]]) {
    element(id).addEventListener("click", act);
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    zoom(event.deltaY < 0 ? 1.25 : 0.8, event.clientX - box.left, event.clientY - box.top);
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons & 1) {
      view.x += event.movementX;
      view.y += event.movementY;
      update();
      return;
    }
    const pixel = pixelUnder(event);
    if (!pixel) return;
    view.probe = pixel;
    read();
  });
  canvas.addEventListener("focus", () => draw());
  canvas.addEventListener("blur", () => draw());
  for (const table of document.querySelectorAll("table.sortable")) {
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => sortBy(table, column));
    });
  }
  for (const row of document.querySelectorAll("tr[data-method]")) row.addEventListener("click", () => showRow(row));
  new ResizeObserver(() => {
    sizeStage();
    fit();
  }).observe(element("stage"));
}

function showRow(row) {
  const index = shots.findIndex((shot) => shot.name === row.dataset.shot);
  if (index !== view.shot) chooseShot(index);
  choose(current().pictures.findIndex((picture) => picture.method === row.dataset.method));
}

fillOptions(element("shot"), shots.map((shot) => shot.name));
listen();
// Without a truth, pictures are compared with the first one.
if (truthIndex() < 0 && current().pictures.length > 1) view.picture = 1;
chooseShot(0);
