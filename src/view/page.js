(() => {
"use strict";

const find = (selector, within = document) => within.querySelector(selector);
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

// Vectors of three numbers, and the camera: world coordinates with +Y up.
const plus = (a, b) => a.map((v, i) => v + b[i]);
const minus = (a, b) => a.map((v, i) => v - b[i]);
const times = (a, s) => a.map((v) => v * s);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => times(a, 1 / Math.hypot(...a));
const STEEPEST = 89 * Math.PI / 180;

// Turns the eye about the target by angles in radians: azimuth about +Y (0 is +Z, positive towards +X), elevation within +-89 degrees.
function orbit(camera, azimuth, elevation) {
  const offset = minus(camera.eye, camera.target);
  const distance = Math.hypot(...offset);
  let around = Math.atan2(offset[0], offset[2]);
  if (Math.hypot(offset[0], offset[2]) < 1e-6 * distance) {
    // Straight from above or below only the picture's upward direction tells the azimuth.
    const turn = -Math.sign(offset[1]);
    around = Math.atan2(turn * camera.up[0], turn * camera.up[2]);
  }
  around += azimuth;
  const above = clamp(Math.asin(clamp(offset[1] / distance, -1, 1)) + elevation, -STEEPEST, STEEPEST);
  const away = [Math.sin(around) * Math.cos(above), Math.sin(above), Math.cos(around) * Math.cos(above)];
  return { ...camera, eye: plus(camera.target, times(away, distance)), up: [0, 1, 0] };
}

// Moves eye and target by shares of the picture's height (right and down): what lies in the target's plane follows the pointer.
function pan(camera, right, down) {
  const offset = minus(camera.eye, camera.target);
  const height = 2 * Math.hypot(...offset) * Math.tan(camera.vertical_fov * Math.PI / 360);
  const back = unit(offset);
  const side = unit(cross(camera.up, back));
  const upward = cross(back, side);
  const move = plus(times(side, -right * height), times(upward, down * height));
  return { ...camera, eye: plus(camera.eye, move), target: plus(camera.target, move) };
}

// Multiplies the distance to the target, kept within `range`.
function zoom(camera, factor, range) {
  const offset = minus(camera.eye, camera.target);
  const distance = Math.hypot(...offset);
  const wanted = clamp(distance * factor, ...range);
  return { ...camera, eye: plus(camera.target, times(offset, wanted / distance)) };
}

// sRGB (IEC 61966-2-1) in 0..=1 and linear light.
const toLinear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
const toSrgb = (v) => (v <= 0.0031308 ? v * 12.92 : 1.055 * v ** (1 / 2.4) - 0.055);
const toHex = (color) => "#" + color.map((v) => Math.round(255 * toSrgb(clamp(v, 0, 1))).toString(16).padStart(2, "0")).join("");
const fromHex = (text) => [1, 3, 5].map((at) => toLinear(parseInt(text.slice(at, at + 2), 16) / 255));

const stage = find("#stage"), panel = find("#panel"), curtain = find("#curtain");
const sides = Object.fromEntries(["left", "right"].map((name) => [name, {
  name, canvas: find(`#${name}-picture`), label: find(`#${name}-label`), select: find("#" + name), save: find("#save-" + name), picture: null,
}]));
for (const side of Object.values(sides)) side.context = side.canvas.getContext("2d");
const key = new URLSearchParams(location.search).get("token") ?? "";
const withToken = (name) => name + "?token=" + encodeURIComponent(key);

let hello = null;       // what the program told about the scene
let state = null;       // all that the controls say, without `id` and `moving`
let lastId = 0;         // of the last state sent or adopted
let exposure = 0;       // stops
let distances = [0, Infinity];
let picked = 0;         // the material in the panel

// What tests and the curious may read; nothing here is written back.
//   last    the last picture drawn: id (of its state), side, method, ms (from sending that state until drawn), input_ms (from the event that
//           caused the state), first (no picture with that id was drawn before), size, scale, samples, seconds, at (performance.now())
//   log     the last 256 of those
//   counts  pictures drawn, late ones dropped, states sent, bad messages, connections
//   pending (a state waits to be sent, or Home to be answered), id, state, exposure, material, sides, connected, ended; math: the functions above
const viewer = {
  last: null, log: [], counts: { pictures: 0, late: 0, states: 0, bad: 0, connections: 0 },
  get pending() { return dirty || asked; },
  get id() { return lastId; },
  get state() { return structuredClone(state); },
  get exposure() { return exposure; },
  get material() { return picked; },
  get sides() { return { left: sides.left.picture, right: sides.right.picture }; },
  get connected() { return connected; },
  get ended() { return ended; },
  math: { orbit, pan, zoom, toLinear, toSrgb, toHex, fromHex },
};
window.viewer = viewer;

// --- The connection.

let socket = null, connected = false, ended = false, wait = 0, retry = 0;

function send(message) {
  if (connected && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function connect() {
  clearTimeout(retry);
  const address = new URL(withToken("live"), location.href);
  address.protocol = address.protocol.replace("http", "ws");
  const mine = socket = new WebSocket(address);
  mine.binaryType = "arraybuffer";
  // Pictures are decoded one after another, and each is answered on the connection it came from.
  let queue = Promise.resolve();
  mine.addEventListener("message", ({ data }) => {
    if (mine !== socket) return;
    if (typeof data === "string") return receive(data);
    queue = queue.then(() => show(data)).then(() => {
      if (mine.readyState === WebSocket.OPEN) mine.send('{"type":"shown"}');
    });
  });
  mine.addEventListener("close", () => {
    if (mine !== socket) return;
    connected = false;
    if (ended) return;
    wait = clamp(2 * wait, 500, 8000);
    retry = setTimeout(connect, wait);
    showConnection(`disconnected; next try in ${wait / 1000} s`);
  });
}

function showConnection(text) {
  const off = text !== "connected";
  find("#connection").textContent = text;
  find("#connection").classList.toggle("off", off);
  curtain.hidden = !off;
  curtain.textContent = text;
}

// Somebody who comes back to the page, or the network that does, need not wait.
function again() {
  if (!ended && !connected && socket.readyState === WebSocket.CLOSED) connect();
}
addEventListener("online", again);
document.addEventListener("visibilitychange", () => { if (!document.hidden) again(); });

const note = (text) => { find("#note").textContent = text; };

function bad(error) {
  viewer.counts.bad++;
  note(`a message that cannot be read (${error.message})`);
}

function receive(text) {
  try {
    const message = JSON.parse(text);
    const take = { hello: begin, psnr: takePsnr, pick: takePick, state: takeState, note: (m) => note(String(m.text)), end: finish }[message?.type];
    if (!take) throw new Error(`type ${JSON.stringify(message?.type)}`);
    take(message);
  } catch (error) {
    bad(error);
  }
}

function finish(message) {
  ended = true;
  connected = false;
  setPlaying(false);
  panel.inert = true;
  showConnection(`${message.text}. Reload the page to continue here.`);
  socket.close();
}

// --- The state.

const numbers = (value, count) => Array.isArray(value) && value.length === count && value.every(Number.isFinite);

// The program's state over ours; what is missing or of another kind leaves ours as it is.
function merged(ours, theirs) {
  const result = { left: "", right: "", split: true, frame: 0, rotation: 0, rays: 1, resolution: [512, 512], materials: {}, ...ours };
  for (const name of ["left", "right"]) if (typeof theirs[name] === "string") result[name] = theirs[name];
  if (typeof theirs.split === "boolean") result.split = theirs.split;
  for (const name of ["frame", "rotation", "rays"]) if (Number.isFinite(theirs[name])) result[name] = theirs[name];
  if (numbers(theirs.resolution, 2)) result.resolution = [...theirs.resolution];
  const camera = theirs.camera;
  if (camera && numbers(camera.eye, 3) && numbers(camera.target, 3) && numbers(camera.up, 3) && Number.isFinite(camera.vertical_fov)) {
    const { eye, target, up, vertical_fov } = camera;
    result.camera = { eye, target, up, vertical_fov };
  }
  if (theirs.materials && typeof theirs.materials === "object") result.materials = structuredClone(theirs.materials);
  if (!result.camera) throw new Error("a state without a camera");
  return result;
}

function begin(message) {
  if (!Array.isArray(message.methods) || !Array.isArray(message.materials) || !message.state) throw new Error("hello without methods, materials or state");
  const same = hello && hello.name === message.name && hello.materials.length === message.materials.length;
  const opened = merged(null, message.state);
  if (!same) for (const side of Object.values(sides)) side.picture = null;
  hello = message;
  if (!same) state = opened;
  lastId = Math.max(lastId, message.state.id ?? 0);
  const distance = Math.hypot(...minus(opened.camera.eye, opened.camera.target));
  distances = [1e-3 * distance, 1e3 * distance];
  connected = true;
  wait = 0;
  viewer.counts.connections++;
  fill();
  panel.inert = false;
  showConnection("connected");
  // The program may have forgotten what this page asked for, or remember what another one did.
  send({ type: "exposure", stops: exposure });
  changed();
  if (asked) home();
}

// At most one state leaves per animation frame.
let framed = false, dirty = false, lastMoving = false, inputTime = null, asked = false;
const sent = new Map();  // id -> times, until a picture with that id or a newer one was drawn
const movers = new Set();
const timers = new Map();  // of movers without an end of their own

function changed(event) {
  inputTime ??= event?.timeStamp ?? performance.now();
  dirty = true;
  if (framed) return;
  framed = true;
  requestAnimationFrame(() => { framed = false; flush(); });
}

function flush() {
  if (!dirty || !connected) return;
  dirty = false;
  lastMoving = movers.size > 0;
  lastId++;
  sent.set(lastId, { sent: performance.now(), input: inputTime, first: true });
  if (sent.size > 512) sent.delete(sent.keys().next().value);
  inputTime = null;
  viewer.counts.states++;
  send({ type: "state", id: lastId, moving: lastMoving, ...state });
}

// A gesture moves things until it ends; then the state goes out once more, at rest.
function rest(mover, event) {
  movers.delete(mover);
  if (movers.size === 0 && lastMoving) changed(event);
}
// For what has no end of its own, as the wheel.
function restSoon(mover) {
  movers.add(mover);
  clearTimeout(timers.get(mover));
  timers.set(mover, setTimeout(() => rest(mover), 200));
}

function setCamera(camera, event) {
  if (![...camera.eye, ...camera.target].every(Number.isFinite)) return;
  state.camera = camera;
  changed(event);
}

// Home keeps an id free, for a program that goes back by itself and gives its state the next one. A state without a newer id is sent back.
function home() {
  if (!connected) return;
  flush();
  asked = true;
  lastId++;
  sent.set(lastId, { sent: performance.now(), input: performance.now(), first: true });
  send({ type: "home" });
}

function takeState(message) {
  const theirs = message.state ?? {};
  const id = Number.isFinite(theirs.id) ? theirs.id : 0;
  if (id >= lastId) {
    state = merged(state, theirs);
  } else {
    // Home is about the scene: methods, resolution and the like stay as they were chosen.
    const { camera, materials, rotation, frame } = theirs;
    state = merged(state, { camera, materials, rotation, frame });
  }
  const again = id < lastId;
  lastId = Math.max(lastId, id);
  asked = false;
  showControls();
  if (again) changed();
}

// --- Pictures.

async function show(buffer) {
  try {
    const length = buffer.byteLength < 4 ? Infinity : new DataView(buffer).getUint32(0, true);
    if (4 + length > buffer.byteLength) throw new Error("a picture without a header");
    const header = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(new Uint8Array(buffer, 4, length)));
    const side = sides[header.side];
    if (!side || !Number.isFinite(header.state)) throw new Error("a picture of no side or state");
    // Older than what is shown, or of a state that another page has sent before this one came.
    if (side.picture && header.state < side.picture.state || header.state > lastId) {
      viewer.counts.late++;
      return;
    }
    const bytes = new Uint8Array(buffer, 4 + length);
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/png" }), { colorSpaceConversion: "none" })
      .catch(() => { throw new Error("a picture that is no PNG"); });
    draw(side, bitmap, header);
  } catch (error) {
    bad(error);
  }
}

function draw(side, bitmap, header) {
  const { canvas, context } = side;
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    canvas.width = bitmap.width;
    canvas.height = bitmap.height;
  }
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  // Whole pixels are shown as such where they are much enlarged; a smaller picture of a moving scene is smoothed.
  const enlarged = canvas.clientWidth * devicePixelRatio / canvas.width;
  canvas.classList.toggle("pixels", header.scale === 1 && enlarged >= 2);
  side.picture = header;
  record(header);
  showLabel(side);
  showTiming(header);
  advance();
}

function record(header) {
  const now = performance.now();
  const times = sent.get(header.state);
  const entry = {
    id: header.state, side: header.side, method: header.method, size: header.size, scale: header.scale, samples: header.samples,
    seconds: header.seconds, ms: times ? now - times.sent : null, input_ms: times ? now - times.input : null, first: times?.first ?? false, at: now,
  };
  if (times?.first) {
    times.first = false;
    viewer.latency = entry.ms;
  }
  for (const id of sent.keys()) if (id < header.state) sent.delete(id); else break;
  viewer.counts.pictures++;
  viewer.last = entry;
  viewer.log.push(entry);
  if (viewer.log.length > 256) viewer.log.shift();
}

const methodLabel = (name) => hello?.methods.find((method) => method.name === name)?.label ?? name;

function showLabel(side) {
  const { picture, label, canvas } = side;
  if (!picture) return;
  const name = methodLabel(picture.method);
  const cost = [];
  if (picture.samples > 0) cost.push(`${picture.samples} ${picture.samples === 1 ? "sample" : "samples"}`);
  if (Number.isFinite(picture.seconds)) cost.push(duration(1000 * picture.seconds));
  if (picture.scale > 1) cost.push(`1/${picture.scale} size`);
  const dB = Number.isFinite(picture.psnr);
  set(find("b", label), name);
  set(find(".cost", label), cost.join(", "));
  set(find(".dB", label), dB ? `${picture.psnr.toFixed(1)} dB` : "");
  set(find(".against", label), dB ? ` against ${picture.reference} samples` : "");
  const title = `${side.name} picture: ${name}`;
  if (canvas.getAttribute("aria-label") !== title) canvas.setAttribute("aria-label", title);
}

const set = (element, text) => { if (element.textContent !== text) element.textContent = text; };
const duration = (ms) => (ms < 10 ? ms.toFixed(1) + " ms" : ms < 10000 ? ms.toFixed(0) + " ms" : (ms / 1000).toFixed(1) + " s");

let reference = null;
function showTiming(header) {
  if (header && Number.isFinite(header.reference)) reference = header.reference;
  const parts = [];
  if (viewer.latency !== undefined) parts.push(`input to picture ${viewer.latency.toFixed(0)} ms`);
  if (reference !== null) parts.push(`reference ${reference} samples`);
  set(find("#timing"), parts.join(", "));
}

function takePsnr(message) {
  for (const side of Object.values(sides)) {
    if (side.picture?.state !== message.state) continue;
    side.picture.psnr = message[side.name] ?? null;
    side.picture.reference = message.reference ?? null;
    showLabel(side);
  }
  showTiming(message);
}

// --- Controls.

const option = (value, text) => Object.assign(document.createElement("option"), { value, textContent: text });
const controls = Object.fromEntries(["rays", "split", "divide", "resolution", "exposure", "rotation", "frame", "play", "material", "reset"].map((id) => [id, find("#" + id)]));
const sizeName = (size) => size.join("x");

function fill() {
  find("#name").textContent = hello.name;
  document.title = `${hello.name} - RenderFlow view`;
  const groups = new Map();
  for (const method of hello.methods) {
    const name = method.group ?? "method";
    if (!groups.has(name)) groups.set(name, []);
    groups.get(name).push(method);
  }
  for (const side of Object.values(sides)) {
    side.select.replaceChildren(...[...groups].map(([name, methods]) => {
      const group = document.createElement("optgroup");
      group.label = name;
      group.append(...methods.map((method) => option(method.name, method.label)));
      return group;
    }));
  }
  const own = numbers(hello.resolution, 2) ? hello.resolution : [512, 512];
  const sizes = [256, 384, 512, 768, 1024].map((edge) => [edge, edge]);
  for (const size of [own, state.resolution]) if (!sizes.some((other) => sizeName(other) === sizeName(size))) sizes.push(size);
  controls.resolution.replaceChildren(...sizes.map((size) => {
    const text = size.join(" \u00d7 ");
    return option(sizeName(size), sizeName(size) === sizeName(own) ? text + " (scene)" : text);
  }));
  controls.frame.max = Math.max(0, (hello.frames ?? 1) - 1);
  find("#frame-row").hidden = !(hello.frames > 1);
  controls.material.replaceChildren(...hello.materials.map((material, number) => option(String(number), material.name)));
  find("#material-section").hidden = hello.materials.length === 0;
  picked = clamp(picked, 0, Math.max(0, hello.materials.length - 1));
  fillParameters();
  showControls();
}

// One row per parameter of the material in the panel.
const parameterRows = new Map();
function fillParameters() {
  parameterRows.clear();
  const material = hello.materials[picked];
  const rows = (hello.parameters ?? []).filter((parameter) => material && parameter.name in material.values).map((parameter) => {
    const row = document.createElement("div");
    const input = document.createElement("input");
    const label = document.createElement("label");
    const output = document.createElement("output");
    const color = parameter.type === "color";
    const [low, high] = numbers(parameter.range, 2) ? parameter.range : [0, 1];
    row.className = color ? "row color" : "row";
    input.id = "parameter-" + parameter.name;
    label.htmlFor = input.id;
    label.textContent = parameter.label ?? parameter.name;
    output.htmlFor = input.id;
    if (color) {
      input.type = "color";
    } else {
      Object.assign(input, { type: "range", min: low, max: high, step: 10 ** Math.floor(Math.log10((high - low) / 100) + 1e-9) });
    }
    input.addEventListener("input", (event) => {
      const own = state.materials[picked] ??= {};
      own[parameter.name] = color ? fromHex(input.value) : Number(input.value);
      showParameters();
      changed(event);
    });
    row.append(label, input, output);
    parameterRows.set(parameter.name, { row, input, output, color });
    return row;
  });
  find("#parameters").replaceChildren(...rows);
}

function showParameters() {
  const material = hello.materials[picked];
  const own = state.materials[picked] ?? {};
  for (const [name, { row, input, output, color }] of parameterRows) {
    const value = own[name] ?? material.values[name];
    row.classList.toggle("changed", name in own);
    if (color) {
      const hex = toHex(value);
      if (input.value !== hex) input.value = hex;
      output.textContent = value.map((v) => v.toFixed(2)).join(" ");
      output.title = "linear red, green and blue";
    } else {
      input.value = value;
      output.textContent = value.toFixed(2);
    }
  }
  const touched = (number) => Object.keys(state.materials[number] ?? {}).length > 0;
  controls.reset.disabled = !touched(picked);
  for (const entry of controls.material.options) {
    const number = Number(entry.value);
    set(entry, hello.materials[number].name + (touched(number) ? " (changed)" : ""));
  }
  set(find("#material-note"), material?.textured ? "textured: the values are factors" : "");
}

function showControls() {
  for (const side of Object.values(sides)) {
    side.select.value = state[side.name];
    side.save.href = withToken(side.name + ".png");
  }
  find("#save-scene").href = withToken("scene.json");
  find("#save-camera").href = withToken("camera.json");
  controls.split.checked = state.split;
  stage.classList.toggle("single", !state.split);
  sides.left.select.disabled = !state.split;
  controls.divide.disabled = !state.split;
  if (state.split) sides.left.save.removeAttribute("aria-disabled");
  else {
    sides.left.save.removeAttribute("href");
    sides.left.save.setAttribute("aria-disabled", "true");
  }
  controls.rays.value = String(state.rays);
  controls.rays.disabled = ![state.right, state.split && state.left].includes("neural+rays");
  controls.resolution.value = sizeName(state.resolution);
  stage.style.setProperty("--aspect", String(state.resolution[0] / state.resolution[1]));
  controls.exposure.value = exposure;
  showValue("exposure", `${exposure > 0 ? "+" : ""}${exposure.toFixed(1)}`);
  controls.rotation.value = state.rotation;
  showValue("rotation", `${Number(state.rotation.toFixed(1))}\u00b0`);
  controls.frame.value = state.frame;
  showValue("frame", `${state.frame}`);
  controls.material.value = String(picked);
  if (hello.materials.length) showParameters();
}

function showValue(name, text) {
  set(find(`#${name}-value`), text);
  if (controls[name].getAttribute("aria-valuetext") !== text) controls[name].setAttribute("aria-valuetext", text);
}

function on(control, kind, change) {
  control.addEventListener(kind, (event) => {
    change(control.value);
    showControls();
    changed(event);
  });
}
for (const side of Object.values(sides)) on(side.select, "change", (value) => { state[side.name] = value; });
on(controls.rays, "change", (value) => { state.rays = Number(value); });
on(controls.split, "change", () => { state.split = controls.split.checked; });
on(controls.resolution, "change", (value) => { state.resolution = value.split("x").map(Number); });
on(controls.rotation, "input", (value) => { state.rotation = Number(value); });
on(controls.rotation, "dblclick", () => { state.rotation = 0; });
on(controls.frame, "input", (value) => { state.frame = Number(value); });

// Exposure has no id: it is sent as it changes, once per animation frame.
let exposed = false;
function setExposure(stops) {
  exposure = stops;
  showControls();
  if (exposed) return;
  exposed = true;
  requestAnimationFrame(() => {
    exposed = false;
    send({ type: "exposure", stops: exposure });
  });
}
controls.exposure.addEventListener("input", () => setExposure(Number(controls.exposure.value)));
controls.exposure.addEventListener("dblclick", () => setExposure(0));

controls.material.addEventListener("change", () => openMaterial(Number(controls.material.value)));
controls.reset.addEventListener("click", (event) => {
  delete state.materials[picked];
  showControls();
  changed(event);
});
find("#home").addEventListener("click", home);

function openMaterial(number) {
  picked = number;
  fillParameters();
  showControls();
}

function takePick(message) {
  const number = message.material;
  if (number === null) return note("no material there: the background");
  if (!hello.materials[number]) throw new Error(`material ${number}`);
  openMaterial(number);
  note(`material: ${hello.materials[number].name}`);
  const section = find("#material-section");
  section.classList.remove("picked");
  section.scrollIntoView({ block: "nearest" });
  requestAnimationFrame(() => section.classList.add("picked"));
}

// A slider that is dragged moves things until it is let go.
panel.addEventListener("pointerdown", (event) => {
  if (event.target.type === "range" && ![controls.divide, controls.exposure].includes(event.target)) movers.add("slider");
});
for (const end of ["pointerup", "pointercancel"]) addEventListener(end, (event) => { if (movers.has("slider")) rest("slider", event); });
panel.addEventListener("change", (event) => { if (movers.has("slider")) rest("slider", event); });

// Playing goes to the next frame when each side has shown this one.
let playing = false, step = 0;
function setPlaying(on) {
  playing = on;
  clearTimeout(step);
  step = 0;
  controls.play.textContent = on ? "\u23f8\ufe0e" : "\u25b6\ufe0e";
  controls.play.setAttribute("aria-label", on ? "Pause" : "Play");
  if (on) advance();
}
function advance() {
  if (!playing || step || !connected) return;
  const visible = state.split ? [sides.left, sides.right] : [sides.right];
  if (!visible.every((side) => side.picture?.state >= lastId)) return;
  step = setTimeout(() => {
    step = 0;
    if (!playing) return;
    state.frame = (state.frame + 1) % hello.frames;
    showControls();
    changed();
  }, 80);
}
controls.play.addEventListener("click", () => setPlaying(!playing));

// --- The split.

function setDivide(share) {
  const percent = clamp(100 * share, 0, 100);
  controls.divide.value = percent;
  find("#divide-value").textContent = `${Math.round(percent)}%`;
  stage.style.setProperty("--divide", percent + "%");
}
const place = (event) => {
  const box = stage.getBoundingClientRect();
  return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
};
controls.divide.addEventListener("input", () => setDivide(Number(controls.divide.value) / 100));
const grip = find("#grip");
let gripped = null, grippedAt = null;
grip.addEventListener("pointerdown", (event) => {
  // A further finger belongs to the gesture of the first one.
  if (event.button !== 0 || pointers.size > 0 || gripped !== null) return;
  event.stopPropagation();
  event.preventDefault();
  gripped = event.pointerId;
  grippedAt = [event.clientX, event.clientY];
  grip.setPointerCapture(gripped);
});
grip.addEventListener("pointermove", (event) => {
  if (event.pointerId !== gripped) return;
  grippedAt = [event.clientX, event.clientY];
  setDivide(place(event)[0]);
});
for (const end of ["pointerup", "pointercancel"]) grip.addEventListener(end, (event) => { if (event.pointerId === gripped) gripped = null; });

// --- The stage.

const pointers = new Map();  // id -> [x, y] in pixels of the window
let panning = false, moved = false, fingers = 0, tap = null;

// Centre and spread of the pointers that are down.
function grasp() {
  const points = [...pointers.values()].slice(0, 2);
  const [a, b = a] = points;
  return { x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, spread: Math.hypot(a[0] - b[0], a[1] - b[1]) };
}

stage.addEventListener("pointerdown", (event) => {
  if (!connected) return;
  event.preventDefault();
  stage.focus({ preventScroll: true });
  stage.setPointerCapture(event.pointerId);
  if (pointers.size === 0) {
    moved = false;
    fingers = 0;
    panning = event.button !== 0 || event.shiftKey;
    if (gripped !== null) {
      // With a second finger the one on the handle pans and pinches as well.
      pointers.set(gripped, grippedAt);
      stage.setPointerCapture(gripped);
      gripped = null;
    }
  }
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
  fingers = Math.max(fingers, pointers.size);
});

stage.addEventListener("pointermove", (event) => {
  if (!pointers.has(event.pointerId) || !connected) return;
  const from = pointers.get(event.pointerId);
  const before = grasp();
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
  const after = grasp();
  // A tap trembles a little.
  moved ||= Math.hypot(event.clientX - from[0], event.clientY - from[1]) >= 4;
  if (!moved) {
    pointers.set(event.pointerId, from);
    return;
  }
  const height = stage.clientHeight;
  const [right, down] = [(after.x - before.x) / height, (after.y - before.y) / height];
  let camera = state.camera;
  if (pointers.size > 1) {
    camera = pan(camera, right, down);
    if (before.spread > 10 && after.spread > 10) camera = zoom(camera, before.spread / after.spread, distances);
  } else if (panning) {
    camera = pan(camera, right, down);
  } else {
    // The height of the stage is half a turn.
    camera = orbit(camera, -right * Math.PI, down * Math.PI);
  }
  stage.classList.add("dragging");
  movers.add("stage");
  setCamera(camera, event);
});

function release(event) {
  // The handle's own capture ends where a pinch takes its finger over.
  if (event.type === "lostpointercapture" && event.target !== stage) return;
  if (!pointers.delete(event.pointerId) || pointers.size > 0) return;
  stage.classList.remove("dragging");
  if (movers.has("stage")) rest("stage", event);
  const tapped = event.type === "pointerup" && !moved && fingers === 1 && !panning;
  if (!tapped) {
    tap = null;
  } else if (tap && event.timeStamp - tap.time < 400 && Math.hypot(event.clientX - tap.x, event.clientY - tap.y) < 24) {
    const [x, y] = place(event);
    send({ type: "pick", x, y });
    tap = null;
  } else {
    tap = { time: event.timeStamp, x: event.clientX, y: event.clientY };
  }
}
for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) stage.addEventListener(end, release);
stage.addEventListener("contextmenu", (event) => event.preventDefault());

stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  if (!connected) return;
  const lines = event.deltaY * [1, 20, 400][event.deltaMode];
  // A pinch on a touchpad comes as small steps of the wheel with Ctrl.
  const factor = Math.exp(clamp(lines * (event.ctrlKey ? 0.01 : 0.0015), -1, 1));
  restSoon("wheel");
  setCamera(zoom(state.camera, factor, distances), event);
}, { passive: false });

stage.addEventListener("keydown", (event) => {
  if (!connected || event.ctrlKey || event.altKey || event.metaKey) return;
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  const factor = { "+": 1 / 1.1, "=": 1 / 1.1, "-": 1.1, "_": 1.1 }[event.key];
  if (!step && !factor && event.key !== "Home") return;
  event.preventDefault();
  if (event.key === "Home") return home();
  // A key that is held moves things; a single press is one step at rest.
  if (event.repeat) restSoon("key");
  if (factor) setCamera(zoom(state.camera, factor, distances), event);
  else if (event.shiftKey) setCamera(pan(state.camera, 0.03 * step[0], 0.03 * step[1]), event);
  else setCamera(orbit(state.camera, -step[0] * Math.PI / 36, step[1] * Math.PI / 36), event);
});
stage.addEventListener("keyup", (event) => { if (movers.has("key")) rest("key", event); });

setDivide(0.5);
showConnection("connecting");
connect();
})();
