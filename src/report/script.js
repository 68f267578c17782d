(() => {
"use strict";

const find = (selector, within = document) => within.querySelector(selector);
const all = (selector, within = document) => [...within.querySelectorAll(selector)];

// Tables: a click on a head sorts by its column, the best first; another one turns the order. Rows without a value stay last.
function sortable(table) {
  const body = table.tBodies[0];
  const heads = all("thead th", table);
  const key = (row, column) => {
    const cell = row.cells[column];
    return "value" in cell.dataset ? Number(cell.dataset.value) : cell.textContent.trim();
  };
  function compare(a, b) {
    if (typeof a === "number" && typeof b === "number") return a - b;
    if (typeof a === "string" && typeof b === "string") return a.localeCompare(b);
    return null;
  }
  heads.forEach((head, column) => find("button", head).addEventListener("click", () => {
    const now = head.getAttribute("aria-sort");
    const order = now === null ? head.dataset.first ?? "ascending" : now === "ascending" ? "descending" : "ascending";
    const turn = order === "ascending" ? 1 : -1;
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", order);
    const rows = [...body.rows].map((row) => [key(row, column), row]);
    rows.sort(([a], [b]) => {
      const difference = compare(a, b);
      return difference === null ? (typeof a === "number" ? -1 : 1) : turn * difference;
    });
    body.append(...rows.map(([, row]) => row));
  }));
}

// Choosers: a list that shows one of the contents after it.
function choosable(box) {
  const select = find(":scope > label select", box);
  const contents = all(":scope > .choice", box);
  const show = () => contents.forEach((content, number) => { content.hidden = number !== select.selectedIndex; });
  if (!select) return;
  select.addEventListener("change", show);
  // A browser may keep the choice when the page is opened again.
  show();
}

// Pictures of the sequence, decoded when asked for.
function album(data) {
  const decoded = new Map();
  const address = (frame, method) => {
    const text = data.pictures[frame]?.[method];
    return text ? "data:image/png;base64," + text : null;
  };
  async function decode(frame, method) {
    const source = address(frame, method);
    if (!source) return null;
    const picture = new Image();
    picture.src = source;
    await picture.decode();
    const canvas = document.createElement("canvas");
    canvas.width = picture.naturalWidth;
    canvas.height = picture.naturalHeight;
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(picture, 0, 0);
    return context.getImageData(0, 0, canvas.width, canvas.height);
  }
  function pixels(frame, method) {
    const key = frame + " " + method;
    if (!decoded.has(key)) {
      // A few frames of a handful of methods; more would cost a phone its memory.
      if (decoded.size > 40) decoded.delete(decoded.keys().next().value);
      decoded.set(key, decode(frame, method));
    }
    return decoded.get(key);
  }
  return { address, pixels };
}

// Mean absolute difference over the channels times `gain`, black over red and yellow to white.
function drawError(canvas, picture, truth, gain) {
  canvas.width = truth.width;
  canvas.height = truth.height;
  const map = new ImageData(truth.width, truth.height);
  const [a, b] = [picture.data, truth.data];
  for (let i = 0; i < map.data.length; i += 4) {
    const sum = Math.abs(a[i] - b[i]) + Math.abs(a[i + 1] - b[i + 1]) + Math.abs(a[i + 2] - b[i + 2]);
    for (let c = 0; c < 3; c++) map.data[i + c] = 255 * (sum * gain / 255 - c);
    map.data[i + 3] = 255;
  }
  // Kept where the processor reaches it: it is written pixel by pixel.
  canvas.getContext("2d", { willReadFrequently: true }).putImageData(map, 0, 0);
}

function comparison(data) {
  const { address, pixels } = album(data);
  const stage = find("#stage"), viewport = find(".viewport"), grip = find("#grip");
  const divide = find("#divide"), slider = find("#frame"), play = find("#play");
  const zoom = find("#zoom"), error = find("#error"), gain = find("#gain"), readout = find("#readout");
  const labels = new Map(data.methods);
  const sides = ["left", "right"].map((name) => ({
    name, select: find("#" + name), picture: find(`#${name}-picture`), canvas: find(`#${name}-error`),
  }));
  const frame = () => data.frames[Number(slider.value)];
  let shown = 0;

  function setDivide(share) {
    divide.value = Math.round(100 * Math.min(1, Math.max(0, share)));
    stage.style.setProperty("--divide", divide.value + "%");
  }

  // Without a picture of this frame the side stays empty rather than showing another's.
  function setPicture(image, source, text) {
    image.style.visibility = source ? "" : "hidden";
    if (source) image.src = source; else image.removeAttribute("src");
    image.alt = text;
  }

  async function showErrors() {
    const turn = ++shown;
    const truth = error.checked ? await pixels(frame(), "truth") : null;
    for (const side of sides) {
      const picture = truth ? await pixels(frame(), side.select.value) : null;
      if (turn !== shown) return;
      const fits = picture && picture.width === truth.width && picture.height === truth.height;
      // The truth has no error to show: it stays a picture.
      side.canvas.hidden = !fits || side.select.value === "truth";
      if (fits) drawError(side.canvas, picture, truth, Number(gain.value));
    }
  }

  function showStrip() {
    for (const button of all(".strip button")) {
      const method = button.dataset.method;
      setPicture(find("img", button), address(frame(), method), "");
      find("small", button).textContent = data.psnr[frame()]?.[method] ?? "";
      const names = sides.filter((side) => side.select.value === method).map((side) => side.name);
      if (names.length) button.dataset.side = names.join(", "); else delete button.dataset.side;
      button.setAttribute("aria-pressed", String(names.includes("right")));
    }
  }

  function showCurves() {
    const chosen = sides.map((side) => side.select.value);
    for (const svg of all("#curves svg")) {
      const lines = all("[data-method]", svg.parentElement);
      const some = lines.some((line) => chosen.includes(line.dataset.method));
      lines.forEach((line) => line.classList.toggle("dim", some && !chosen.includes(line.dataset.method)));
      const [left, right, low, high] = svg.dataset.x.split(" ").map(Number);
      const x = left + (right - left) * (frame() - low) / (high - low);
      const now = find(".now", svg) ?? svg.appendChild(document.createElementNS(svg.namespaceURI, "line"));
      now.setAttribute("class", "now");
      for (const [name, value] of [["x1", x], ["x2", x], ["y1", 14], ["y2", svg.viewBox.baseVal.height - 48]]) now.setAttribute(name, value);
    }
  }

  function show() {
    for (const side of sides) {
      const method = side.select.value;
      setPicture(side.picture, address(frame(), method), `${labels.get(method)}, frame ${frame()}`);
      find(`#${side.name}-name`).textContent = labels.get(method);
    }
    const name = frame() + (data.keyframes.includes(frame()) ? " (key)" : "");
    find("#frame-number").textContent = name;
    slider.setAttribute("aria-valuetext", "frame " + name);
    showStrip();
    showCurves();
    showErrors();
  }

  function resize() {
    const factor = Number(zoom.value);
    const room = viewport.parentElement.clientWidth;
    const width = factor ? factor * data.width : Math.min(room, 1200, Math.max(data.width, 0.8 * innerHeight * data.width / data.height));
    stage.style.width = width + "px";
    stage.style.height = width * data.height / data.width + "px";
    stage.classList.toggle("zoomed", factor > 0 && width > room);
  }

  const share = (event) => {
    const box = stage.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };

  async function read(event) {
    const [x, y] = share(event).map((v, axis) => Math.floor(v * [data.width, data.height][axis]));
    if (x < 0 || y < 0 || x >= data.width || y >= data.height) return;
    const texts = [];
    for (const side of sides) {
      const picture = await pixels(frame(), side.select.value);
      if (!picture || picture.width !== data.width) continue;
      const at = 4 * (y * data.width + x);
      texts.push(`${labels.get(side.select.value)} ${[...picture.data.slice(at, at + 3)].join(", ")}`);
    }
    readout.textContent = `pixel ${x}, ${y}: ${texts.join(" | ")}`;
  }

  // Touch drags the divide too, but a zoomed picture scrolls under the finger unless the grip is taken.
  let dragging = false;
  stage.addEventListener("pointerdown", (event) => {
    dragging = event.pointerType === "mouse" || event.target === grip || !stage.classList.contains("zoomed");
    if (!dragging) return;
    stage.setPointerCapture(event.pointerId);
    setDivide(share(event)[0]);
  });
  stage.addEventListener("pointermove", (event) => {
    if (dragging) setDivide(share(event)[0]);
    read(event);
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, () => { dragging = false; });

  function step(by) {
    slider.value = (Number(slider.value) + by + data.frames.length) % data.frames.length;
    show();
  }
  let timer = 0;
  play.addEventListener("click", () => {
    if (timer) clearInterval(timer);
    timer = timer ? 0 : setInterval(() => step(1), 250);
    play.textContent = timer ? "Pause" : "Play";
    play.setAttribute("aria-pressed", String(timer !== 0));
  });
  play.disabled = data.frames.length < 2;

  for (const button of all(".strip button")) {
    button.addEventListener("click", (event) => {
      sides[event.shiftKey ? 0 : 1].select.value = button.dataset.method;
      show();
    });
  }
  for (const svg of all("#curves svg")) {
    svg.addEventListener("click", (event) => {
      const [left, right, low, high] = svg.dataset.x.split(" ").map(Number);
      const box = svg.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width * svg.viewBox.baseVal.width;
      const wanted = low + (high - low) * (x - left) / (right - left);
      const far = data.frames.map((number) => Math.abs(number - wanted));
      slider.value = far.indexOf(Math.min(...far));
      show();
    });
  }
  divide.addEventListener("input", () => setDivide(Number(divide.value) / 100));
  slider.addEventListener("input", show);
  // Where the strip scrolls, what was chosen elsewhere must not stay out of sight.
  function reveal() {
    const chosen = all(".strip button").find((button) => button.dataset.method === sides[1].select.value);
    const strip = find(".strip");
    if (chosen) strip.scrollLeft = chosen.parentElement.offsetLeft - strip.offsetLeft - chosen.offsetWidth;
  }
  sides.forEach((side) => side.select.addEventListener("change", () => { show(); reveal(); }));
  [error, gain].forEach((control) => control.addEventListener("change", showErrors));
  zoom.addEventListener("change", resize);
  addEventListener("resize", resize);
  setDivide(Number(divide.value) / 100);
  resize();
  show();
  reveal();
}

all("table").forEach(sortable);
all(".choices").forEach(choosable);
const data = find("#data");
if (data && find("#stage")) comparison(JSON.parse(data.textContent));
})();
