"use strict";
(() => {
  const study = JSON.parse(document.getElementById("data").textContent);
  const at = (id) => document.getElementById(id);
  const COLUMNS = ["study", "observer", "group", "started", "seed", "trial", "scene", "first", "second", "chosen", "catch", "seconds", "views"];
  const GAP = 400;

  // Random numbers from a seed that the file of answers names (mulberry32).
  const seed = crypto.getRandomValues(new Uint32Array(1))[0];
  let state = seed;
  function random() {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  }
  function shuffled(items) {
    const copy = [...items];
    for (let last = copy.length - 1; last > 0; last--) {
      const other = Math.floor(random() * (last + 1));
      [copy[last], copy[other]] = [copy[other], copy[last]];
    }
    return copy;
  }

  // A side of a trial: a stimulus, or a coarse copy of it.
  function makeTrials() {
    const pairs = [];
    study.scenes.forEach((_, scene) => {
      for (let repeat = 0; repeat < study.repeats; repeat++) {
        for (let a = 0; a < study.stimuli.length; a++) {
          for (let b = a + 1; b < study.stimuli.length; b++) {
            pairs.push({ scene, sides: [{ stimulus: a }, { stimulus: b }], right: null });
          }
        }
      }
    });
    for (let index = 0; index < study.catch; index++) {
      const stimulus = Math.floor(random() * study.stimuli.length);
      const scene = Math.floor(random() * study.scenes.length);
      pairs.push({ scene, sides: [{ stimulus }, { stimulus, coarse: true }], right: stimulus });
    }
    return shuffled(pairs).map((trial) => ({ ...trial, sides: shuffled(trial.sides) }));
  }
  const trials = makeTrials();
  const rows = [];
  let current = -1;
  let started = "";
  let since = 0;
  let views = 0;
  // Counts what is shown, so that a show that was left stops.
  let turn = 0;

  const nameOf = (side) => study.stimuli[side.stimulus] + (side.coarse ? " (coarse copy)" : "");
  const wait = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

  const pictures = new Map();
  async function load(scene, side) {
    const key = `${scene} ${side.stimulus}`;
    if (!pictures.has(key)) {
      pictures.set(key, Promise.all(study.scenes[scene].frames[side.stimulus].map(async (source) => {
        const image = new Image();
        image.src = source;
        await image.decode();
        return image;
      })));
    }
    return pictures.get(key);
  }

  function draw(canvas, image, side) {
    const [width, height] = [image.naturalWidth, image.naturalHeight];
    if (canvas.width !== width || canvas.height !== height) {
      [canvas.width, canvas.height] = [width, height];
    }
    const context = canvas.getContext("2d");
    if (!side.coarse) {
      context.drawImage(image, 0, 0);
      return;
    }
    const small = document.createElement("canvas");
    [small.width, small.height] = [Math.max(1, width >> 3), Math.max(1, height >> 3)];
    small.getContext("2d").drawImage(image, 0, 0, small.width, small.height);
    context.imageSmoothingEnabled = false;
    context.drawImage(small, 0, 0, width, height);
  }

  // Shows a still for its time, or an animation once; false if the observer went on.
  async function show(canvas, scene, side, mine, forever) {
    const frames = await load(scene, side);
    if (mine !== turn) return false;
    do {
      for (const frame of frames) {
        draw(canvas, frame, side);
        if (forever && frames.length === 1) return true;
        await wait(frames.length > 1 ? 1000 / study.fps : 1000 * study.seconds);
        if (mine !== turn) return false;
      }
    } while (forever);
    return true;
  }

  function blank(canvas) {
    canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
  }

  function choosing(may) {
    document.body.dataset.state = may ? "choosing" : "showing";
    at("one").disabled = at("two").disabled = !may;
  }

  async function present() {
    const mine = ++turn;
    const { scene, sides } = trials[current];
    views++;
    if (study.beside) {
      at("which").textContent = "Left";
      sides.forEach((side, index) => show(at(index ? "right" : "left"), scene, side, mine, true));
      await Promise.all(sides.map((side) => load(scene, side)));
      if (mine === turn) choosing(true);
      return;
    }
    for (const [index, side] of sides.entries()) {
      at("which").textContent = index ? "Second" : "First";
      if (!(await show(at("left"), scene, side, mine, false))) return;
      blank(at("left"));
      at("which").textContent = "\u00a0";
      await wait(Math.min(GAP, 500 * study.seconds));
      if (mine !== turn) return;
    }
    choosing(true);
  }

  function next() {
    current++;
    views = 0;
    if (current === trials.length) return finish();
    const { sides } = trials[current];
    at("stage").dataset.first = nameOf(sides[0]);
    at("stage").dataset.second = nameOf(sides[1]);
    at("stage").dataset.scene = study.scenes[trials[current].scene].name;
    at("progress").textContent = `Pair ${current + 1} of ${trials.length}`;
    at("status").textContent = at("progress").textContent;
    since = performance.now();
    choosing(false);
    present();
  }

  function choose(index) {
    if (document.body.dataset.state !== "choosing") return;
    const { scene, sides, right } = trials[current];
    rows.push([
      study.key, at("observer").value, at("group").value, started, seed, current + 1,
      study.scenes[scene].name, nameOf(sides[0]), nameOf(sides[1]), nameOf(sides[index]),
      right === null ? "" : study.stimuli[right],
      ((performance.now() - since) / 1000).toFixed(2), views,
    ]);
    next();
  }

  // Fields in quotes; a leading character that a spreadsheet takes for a formula is put off.
  const field = (value) => `"${String(value).replace(/^[=+\-@\t\r]/, "'$&").replace(/"/g, '""')}"`;
  const text = () => [COLUMNS, ...rows].map((row) => row.map(field).join(",")).join("\r\n") + "\r\n";

  function finish() {
    turn++;
    document.body.dataset.state = "end";
    at("trial").hidden = true;
    at("end").hidden = false;
    at("csv").value = text();
    at("save").focus();
  }

  function save() {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text()], { type: "text/csv" }));
    link.download = `votes_${at("observer").value.replace(/[^\w-]+/g, "_")}_${seed}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    saved = rows.length;
  }
  let saved = 0;

  function begin() {
    if (!at("observer").value.trim()) {
      at("missing").textContent = "Please give a name or initials, so that your answers stay together.";
      at("observer").focus();
      return;
    }
    started = new Date().toISOString();
    at("start").hidden = true;
    at("trial").hidden = false;
    next();
  }

  at("begin").addEventListener("click", begin);
  at("one").addEventListener("click", () => choose(0));
  at("two").addEventListener("click", () => choose(1));
  at("again")?.addEventListener("click", present);
  at("early").addEventListener("click", finish);
  at("save").addEventListener("click", save);
  addEventListener("keydown", (event) => {
    if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
    const state = document.body.dataset.state;
    if (state === "start") {
      if (event.key === "Enter") begin();
      return;
    }
    if (state === "end") return;
    if (event.key === "1" || event.key === "ArrowLeft") choose(0);
    else if (event.key === "2" || event.key === "ArrowRight") choose(1);
    else if (event.key === " " && !study.beside) present();
    else return;
    event.preventDefault();
  });
  addEventListener("beforeunload", (event) => {
    if (rows.length > saved) event.preventDefault();
  });
})();
