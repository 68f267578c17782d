// Uses the viewer as people do: node view.cjs ADDRESS SCREENSHOT_DIR [MINUTES]
// ADDRESS is what `renderflow view` or mock.cjs prints, with its token. MINUTES of random input follow the checks; SEED chooses which.
// ONLY=checks,latency,random runs a part. PAGE=FOLDER tries the page.html, page.css and page.js there on the program of ADDRESS.
"use strict";
const assert = require("node:assert/strict");
const fs = require("node:fs");
const net = require("node:net");
const path = require("node:path");
const { chromium } = require("playwright-core");

const [address, screenshots, minutes = "0"] = process.argv.slice(2);
const parts = (process.env.ONLY ?? "checks,latency,random").split(",");
const SIZES = { wide: { width: 1440, height: 900 }, phone: { width: 360, height: 740 } };
const PATIENCE = Number(process.env.PATIENCE ?? 60) * 1000;
const LATENCY = ["ibl", "deferred", "neural", "neural+rays", "denoised", "path"];
fs.mkdirSync(screenshots, { recursive: true });

// What the mock saw; null where the real program answers.
async function mock(fault) {
  const answer = await fetch(new URL(fault ? "/mock/" + fault : "/mock", address)).catch(() => null);
  if (!answer?.ok) return null;
  return fault ? true : answer.json();
}

function local(folder) {
  const read = (name) => fs.readFileSync(path.join(folder, name), "utf8");
  return read("page.html").replace("/*STYLE*/", () => read("page.css")).replace("/*SCRIPT*/", () => read("page.js"));
}

// A page that has failed in no way when `use` is done; `allowed` faults may come.
async function visit(browser, size, options, use, { url = address, allowed = null } = {}) {
  const context = await browser.newContext({ viewport: SIZES[size], hasTouch: size === "phone", deviceScaleFactor: size === "phone" ? 2 : 1, ...options });
  const page = await context.newPage();
  const faults = [], wire = { sent: [], pictures: 0, shown: 0 };
  page.on("console", (message) => { if (["error", "warning"].includes(message.type())) faults.push(message.text()); });
  page.on("pageerror", (error) => faults.push(String(error)));
  page.on("requestfailed", (request) => { if (!/\.(json|png)\?/.test(request.url())) faults.push(`${request.url()}: ${request.failure()?.errorText}`); });
  page.on("response", (response) => { if (response.status() >= 400) faults.push(`${response.status()} for ${response.url()}`); });
  page.on("websocket", (socket) => {
    socket.on("framesent", ({ payload }) => {
      const message = JSON.parse(payload);
      if (message.type === "shown") wire.shown++;
      else if (wire.sent.push(message) > 5000) wire.sent.shift();
    });
    socket.on("framereceived", ({ payload }) => { if (typeof payload !== "string") wire.pictures++; });
  });
  if (process.env.PAGE) await context.route((at) => at.pathname === "/", (route) => route.fulfill({ contentType: "text/html; charset=utf-8", body: local(process.env.PAGE) }));
  page.wire = wire;
  page.faults = faults;
  page.setDefaultTimeout(PATIENCE);
  await page.goto(url);
  await page.waitForFunction(() => viewer.connected);
  await use(page, context);
  assert.deepEqual(faults.filter((fault) => !allowed?.test(fault)), [], `faults at ${size}`);
  await context.close();
}

const shoot = (page, name, fullPage = false) => page.screenshot({ path: path.join(screenshots, name + ".png"), fullPage });
const state = (page) => page.evaluate(() => viewer.state);
const states = (page) => page.wire.sent.filter((message) => message.type === "state");

// Every visible side shows the last state at full size.
const settled = (page) => page.waitForFunction(() => {
  const { split } = viewer.state;
  return !viewer.pending && (split ? ["left", "right"] : ["right"]).every((name) => viewer.sides[name]?.state >= viewer.id && viewer.sides[name].scale === 1);
}, null, { polling: 30 });

// The picture of a side in 32x32 pixels.
const look = (page, side = "right") => page.evaluate((side) => {
  const scratch = document.createElement("canvas");
  scratch.width = scratch.height = 32;
  const context = scratch.getContext("2d", { willReadFrequently: true });
  context.drawImage(document.querySelector(`#${side}-picture`), 0, 0, 32, 32);
  return [...context.getImageData(0, 0, 32, 32).data].filter((_, i) => i % 4 < 3);
}, side);
const difference = (a, b) => a.reduce((sum, v, i) => sum + Math.abs(v - b[i]), 0) / a.length;
const mean = (a) => a.reduce((sum, v) => sum + v, 0) / a.length;

// The picture changes by more than `least` of 255 within the patience.
async function changes(page, what, act, side = "right", least = 0.4) {
  await settled(page);
  const before = await look(page, side);
  await act();
  const until = Date.now() + PATIENCE;
  for (;;) {
    await settled(page);
    const after = await look(page, side);
    if (difference(before, after) > least) return [before, after];
    assert.ok(Date.now() < until, `${what} changes the picture (by ${difference(before, after).toFixed(2)})`);
    await page.waitForTimeout(100);
  }
}

const minus = (a, b) => a.map((v, i) => v - b[i]);
const offset = ({ eye, target }) => minus(eye, target);
const distance = (camera) => Math.hypot(...offset(camera));
const elevation = (camera) => Math.asin(offset(camera)[1] / distance(camera)) * 180 / Math.PI;
const azimuth = (camera) => Math.atan2(offset(camera)[0], offset(camera)[2]) * 180 / Math.PI;
const turned = (a, b) => ((azimuth(b) - azimuth(a) + 540) % 360) - 180;
const near = (a, b, within, what) => assert.ok(Math.abs(a - b) <= within, `${what}: ${a} instead of ${b}`);
const same = (a, b, what) => a.forEach((v, i) => near(v, b[i], 1e-4 * (1 + Math.abs(b[i])), what));
// Where a point lies on the stage, in shares.
function project(camera, point, aspect) {
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
  const unit = (a) => a.map((v) => v / Math.hypot(...a));
  const back = unit(offset(camera)), right = unit(cross(camera.up, back)), up = cross(back, right);
  const p = minus(point, camera.eye), depth = -dot(p, back), h = Math.tan(camera.vertical_fov * Math.PI / 360);
  return [0.5 + dot(p, right) / depth / h / aspect / 2, 0.5 - dot(p, up) / depth / h / 2];
}

// The scene as its author left it, small, with methods that do not change by themselves.
async function prepare(page, methods = ["deferred", "ibl"]) {
  await page.locator("#home").click();
  await page.locator("#resolution").selectOption("256x256");
  const offered = await page.$$eval("#right option", (all) => all.map((option) => option.value));
  const [left, right] = methods.map((name, number) => (offered.includes(name) ? name : offered[number % offered.length]));
  await page.locator("#split").setChecked(true);
  await page.locator("#left").selectOption(left);
  await page.locator("#right").selectOption(right);
  await settled(page);
}

async function whole(page, size) {
  const [content, window, height, room] = await page.evaluate(() => {
    const root = document.documentElement;
    return [root.scrollWidth, root.clientWidth, root.scrollHeight, innerHeight];
  });
  assert.ok(content <= window, `${content} pixels wide in ${window}`);
  if (size === "wide") assert.ok(height <= room, `${height} pixels high in ${room}`);
  const nameless = await page.$$eval("select, button, input, a.button, canvas, #stage", (all) => all.filter((e) => e.checkVisibility() &&
    !(e.labels?.length || e.getAttribute("aria-label") || e.textContent.trim())).map((e) => e.outerHTML));
  assert.deepEqual(nameless, [], "every control has a name");
}

async function thumbs(page) {
  const small = await page.$$eval("select, button, .button, summary, input", (all) => all.filter((e) => e.checkVisibility()).map((e) => {
    const target = e.type === "checkbox" ? e.labels[0] : e;
    return [target.getBoundingClientRect().height, e.outerHTML.slice(0, 80)];
  }).filter(([height]) => height < 40));
  assert.deepEqual(small, [], "controls that a thumb hits");
}

async function tabOrder(page) {
  const count = await page.evaluate(() => {
    const all = [...document.querySelectorAll("#stage, a[href], button:not(:disabled), input:not(:disabled), select:not(:disabled), summary")].filter((e) => e.checkVisibility());
    all.forEach((e, number) => { e.dataset.order = number; });
    document.body.tabIndex = -1;
    document.body.focus();
    document.body.removeAttribute("tabindex");
    return all.length;
  });
  const reached = [];
  for (let i = 0; i < count; i++) {
    await page.keyboard.press("Tab");
    reached.push(await page.evaluate(() => Number(document.activeElement.dataset.order ?? -1)));
    const seen = await page.evaluate(() => getComputedStyle(document.activeElement).outlineStyle !== "none");
    assert.ok(seen, `focus on control ${i} can be seen`);
  }
  assert.deepEqual(reached, [...Array(count).keys()], "Tab reaches every control in order");
}

// --- The stage.

const stageBox = (page) => page.locator("#stage").boundingBox();
async function drag(page, from, to, { button = "left", shift = false, steps = 8 } = {}) {
  const box = await stageBox(page);
  const at = ([x, y]) => [box.x + x * box.width, box.y + y * box.height];
  if (shift) await page.keyboard.down("Shift");
  await page.mouse.move(...at(from));
  await page.mouse.down({ button });
  await page.mouse.move(...at(to), { steps });
  await page.mouse.up({ button });
  if (shift) await page.keyboard.up("Shift");
}

async function mouse(page) {
  const before = await state(page);
  const [, orbited] = await changes(page, "orbit", () => drag(page, [0.7, 0.5], [0.8, 0.55]));
  const after = await state(page);
  same(after.camera.target, before.camera.target, "orbit keeps the target");
  near(distance(after.camera), distance(before.camera), 1e-3 * distance(before.camera), "orbit keeps the distance");
  const box = await stageBox(page);
  near(turned(before.camera, after.camera), -18 * box.width / box.height, 1, "drag to the right turns the eye to the left");
  near(elevation(after.camera), Math.min(89, elevation(before.camera) + 9), 1, "drag downwards raises the eye");
  const ids = states(page).map((message) => message.id);
  assert.ok(ids.every((id, i) => i === 0 || id > ids[i - 1]), "ids increase");
  const last = states(page).at(-1);
  assert.equal(last.moving, false, "at rest after the drag");
  assert.ok(states(page).slice(-6, -1).some((message) => message.moving), "moving during the drag");
  assert.ok(orbited.length);

  for (const options of [{ button: "right" }, { button: "middle" }, { shift: true }]) {
    const from = await state(page);
    await changes(page, "pan", () => drag(page, [0.6, 0.6], [0.7, 0.5], options));
    const to = await state(page);
    same(offset(to.camera), offset(from.camera), "pan keeps the direction");
    const [x, y] = project(to.camera, from.camera.target, box.width / box.height);
    near(x, 0.6, 0.006, "the target's plane follows the pointer");
    near(y, 0.4, 0.006, "the target's plane follows the pointer");
  }
  const from = await state(page);
  await page.mouse.move(box.x + box.width * 0.7, box.y + box.height / 2);
  // A key in the middle of the wheel's turn must not keep things moving.
  await page.mouse.wheel(0, -1);
  await page.keyboard.down("ArrowLeft");
  await page.keyboard.down("ArrowLeft");
  await page.keyboard.up("ArrowLeft");
  await page.waitForTimeout(400);
  assert.equal(states(page).at(-1).moving, false, "at rest after wheel and key");
  Object.assign(from, await state(page));
  await changes(page, "the wheel", () => page.mouse.wheel(0, -200));
  await page.waitForTimeout(400);
  const to = await state(page);
  assert.ok(distance(to.camera) < 0.9 * distance(from.camera), "the wheel zooms in");
  same(to.camera.target, from.camera.target, "zoom keeps the target");
  assert.equal(states(page).at(-1).moving, false, "at rest after the wheel");
  for (let i = 0; i < 40; i++) await page.mouse.wheel(0, -1000);
  await page.waitForTimeout(400);
  assert.ok(distance((await state(page)).camera) > 0, "zoom never ends in the target");
}

// However many events come, one state leaves per animation frame.
async function frameRate(page) {
  const [frames, sent] = await page.evaluate(async () => {
    const stage = document.querySelector("#stage"), before = viewer.counts.states, start = performance.now();
    let frames = 0;
    const count = () => { frames++; requestAnimationFrame(count); };
    requestAnimationFrame(count);
    while (performance.now() - start < 1000) {
      for (let i = 0; i < 5; i++) stage.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
      await new Promise((done) => setTimeout(done, 1));
    }
    return [frames, viewer.counts.states - before];
  });
  assert.ok(sent > 3 && sent <= frames + 1, `${sent} states in ${frames} frames`);
  await settled(page);
}

async function stageKeys(page) {
  await page.locator("#home").click();
  await settled(page);
  await page.locator("#stage").focus();
  const step = async (key) => {
    const before = (await state(page)).camera;
    await page.keyboard.press(key);
    return [before, (await state(page)).camera];
  };
  for (const [key, angle] of [["ArrowRight", -5], ["ArrowLeft", 5]]) near(turned(...await step(key)), angle, 0.01, key);
  await changes(page, "ArrowUp", () => page.keyboard.press("ArrowUp"));
  for (const key of ["Shift+ArrowRight", "Shift+ArrowUp", "Shift+ArrowLeft", "Shift+ArrowDown"]) {
    const [a, b] = await step(key);
    assert.ok(Math.hypot(...minus(b.target, a.target)) > 0, key + " pans");
    same(offset(b), offset(a), key + " keeps the direction");
  }
  for (const [key, factor] of [["+", 1 / 1.1], ["-", 1.1]]) {
    const [a, b] = await step(key);
    near(distance(b) / distance(a), factor, 1e-3, key);
  }
  for (const [key, end] of [["ArrowDown", 89], ["ArrowUp", -89]]) {
    for (let i = 0; i < 40; i++) await page.keyboard.press(key);
    near(elevation((await state(page)).camera), end, 0.01, "elevation ends at");
  }
  await settled(page);
}

async function homeRestores(page, start) {
  for (const how of ["button", "key"]) {
    await page.locator("#rotation").fill(String((start.rotation + 120) % 360));
    await drag(page, [0.7, 0.5], [0.5, 0.4]);
    if (how === "button") await page.locator("#home").dblclick();
    else await page.locator("#stage").press("Home");
    await page.waitForFunction((eye) => !viewer.pending && viewer.state.camera.eye.every((v, i) => Math.abs(v - eye[i]) < 1e-4), start.camera.eye);
    const now = await state(page);
    same(now.camera.target, start.camera.target, "Home: target");
    near(now.rotation, start.rotation, 1e-3, "Home: light");
    assert.deepEqual(now.materials, start.materials, "Home: materials");
    for (const name of ["left", "right", "resolution", "rays", "split"]) assert.deepEqual(now[name], start[name], "Home leaves " + name);
    near(Number(await page.locator("#rotation").inputValue()), start.rotation, 0.6, "Home: the control");
    await settled(page);
  }
}

async function touch(page) {
  const client = await page.context().newCDPSession(page);
  await page.evaluate(() => scrollTo(0, 0));
  const box = await stageBox(page);
  const send = (type, points) => client.send("Input.dispatchTouchEvent", {
    type, touchPoints: points.map(([x, y], id) => ({ x: box.x + x * box.width, y: box.y + y * box.height, id })),
  });
  const gesture = async (path) => {
    await send("touchStart", path[0]);
    for (const points of path.slice(1)) { await send("touchMove", points); await page.waitForTimeout(20); }
    await send("touchEnd", []);
  };
  let before = (await state(page)).camera;
  await changes(page, "one finger", () => gesture([[[0.3, 0.6]], [[0.35, 0.6]], [[0.4, 0.62]], [[0.45, 0.65]]]));
  let after = (await state(page)).camera;
  same(after.target, before.target, "one finger keeps the target");
  near(distance(after), distance(before), 1e-3 * distance(before), "one finger keeps the distance");
  assert.equal(states(page).at(-1).moving, false);
  assert.equal(await page.evaluate(() => scrollY), 0, "a finger on the stage does not scroll");

  before = after;
  await changes(page, "two fingers", () => gesture([[[0.3, 0.5], [0.5, 0.5]], [[0.35, 0.5], [0.55, 0.5]], [[0.4, 0.5], [0.6, 0.5]]]));
  after = (await state(page)).camera;
  same(offset(after), offset(before), "two fingers keep the direction");
  near(project(after, before.target, box.width / box.height)[0], 0.6, 0.02, "two fingers pan");

  before = after;
  await changes(page, "a pinch", () => gesture([[[0.4, 0.5], [0.6, 0.5]], [[0.35, 0.5], [0.65, 0.5]], [[0.3, 0.5], [0.7, 0.5]]]));
  after = (await state(page)).camera;
  near(distance(after) / distance(before), 0.5, 0.05, "a pinch that doubles halves the distance");

  // A pinch whose first finger lies on the line of the split is a pinch all the same.
  before = after;
  const divide = await page.locator("#divide").inputValue();
  await changes(page, "a pinch from the split", async () => {
    await send("touchStart", [[0.5, 0.5]]);
    await send("touchStart", [[0.5, 0.5], [0.7, 0.5]]);
    for (const x of [0.68, 0.64, 0.6]) { await send("touchMove", [[0.5, 0.5], [x, 0.5]]); await page.waitForTimeout(20); }
    await send("touchEnd", []);
  });
  after = (await state(page)).camera;
  near(distance(after) / distance(before), 2, 0.2, "a pinch that halves doubles the distance");
  assert.equal(await page.locator("#divide").inputValue(), divide, "and leaves the split");

  await page.locator("#home").click();
  await settled(page);
  await page.evaluate(() => scrollTo(0, 0));
  const clip = () => page.$eval("#left-picture", (e) => getComputedStyle(e).clipPath);
  const old = await clip();
  await gesture([[[0.5, 0.9]], [[0.4, 0.9]], [[0.3, 0.9]], [[0.25, 0.9]]]);
  assert.notEqual(await clip(), old, "a finger drags the split");
  near(Number(await page.locator("#divide").inputValue()), 25, 2, "the split is where it was drawn to");

  const noted = () => page.locator("#note").textContent();
  let note = "";
  for (const spot of [[0.7, 0.6], [0.6, 0.7], [0.4, 0.5], [0.7, 0.8], [0.7, 0.4]]) {
    await page.evaluate(() => { scrollTo(0, 0); document.querySelector("#note").textContent = ""; });
    for (let i = 0; i < 2; i++) { await send("touchStart", [spot]); await send("touchEnd", []); }
    await page.waitForFunction(() => document.querySelector("#note").textContent !== "");
    note = await noted();
    if (/^material: /.test(note)) break;
  }
  assert.match(note, /^material: /, "a double tap picks");
}

// --- The panel.

async function split(page) {
  const clip = () => page.$eval("#left-picture", (e) => getComputedStyle(e).clipPath);
  const seen = [await clip()];
  const changed = async (how) => { const now = await clip(); assert.notEqual(now, seen.at(-1), how + " moves the split"); seen.push(now); };
  const camera = (await state(page)).camera;
  await drag(page, [0.5, 0.95], [0.2, 0.95]);
  await changed("the mouse");
  near(Number(await page.locator("#divide").inputValue()), 20, 1.5, "the split");
  assert.deepEqual((await state(page)).camera, camera, "the split does not orbit");
  await page.locator("#divide").focus();
  await page.keyboard.press("ArrowRight");
  await changed("an arrow key");
  await page.locator("#divide").fill("50");
  await page.locator("#split").press("Space");
  assert.equal((await state(page)).split, false);
  for (const id of ["#left-picture", "#left-label", "#grip"]) assert.ok(!await page.locator(id).isVisible(), id + " is hidden");
  assert.ok(await page.locator("#left").isDisabled());
  await settled(page);
  await page.locator("#split").press("Space");
  assert.ok(await page.locator("#left-picture").isVisible());
  await settled(page);
}

async function methods(page) {
  const offered = await page.$$eval("#right option", (all) => all.map((option) => [option.value, option.textContent]));
  const groups = await page.$$eval("#right optgroup", (all) => all.map((group) => group.label));
  assert.ok(groups.length >= 1, "methods come in groups");
  const looks = [];
  for (const [name, label] of offered) {
    await page.locator("#right").selectOption(name);
    await page.waitForFunction((name) => viewer.sides.right?.method === name && viewer.sides.right.state >= viewer.id, name);
    assert.equal(await page.locator("#right-label b").textContent(), label);
    assert.match(await page.locator("#right-label .cost").textContent(), /\d m?s/);
    looks.push(await look(page));
  }
  const alike = looks.filter((one, i) => i > 0 && difference(one, looks[i - 1]) < 0.05).length;
  assert.ok(alike <= offered.length / 3, `${alike} of ${offered.length} methods look like the one before`);
  if (offered.some(([name]) => name === "neural+rays")) {
    await page.locator("#right").selectOption("neural+rays");
    assert.ok(await page.locator("#rays").isEnabled());
    await page.locator("#rays").selectOption("4");
    assert.equal((await state(page)).rays, 4);
    await settled(page);
    await page.locator("#right").selectOption("ibl");
    assert.ok(await page.locator("#rays").isDisabled());
  }
  await page.locator("#right").selectOption("path");
  await page.waitForFunction(() => viewer.sides.right?.method === "path" && viewer.sides.right.state >= viewer.id);
  assert.match(await page.locator("#right-label .cost").textContent(), /^\d+ samples?, [\d.]+ m?s/);
  // The dB of a method comes when the reference is good enough.
  await page.locator("#right").selectOption("deferred");
  await page.waitForFunction(() => !viewer.pending && viewer.sides.right.state >= viewer.id &&
    /^[\d.]+ dB against \d+ samples$/.test(document.querySelector("#right-label .quality").textContent), null, { timeout: 5 * PATIENCE });
  assert.match(await page.locator("#timing").textContent(), /^input to picture \d+ ms, reference \d+ samples$/);
}

async function light(page) {
  const [before, after] = await changes(page, "exposure", () => page.locator("#exposure").fill("2"));
  assert.ok(mean(after) > mean(before), "two stops are brighter");
  assert.equal(await page.locator("#exposure-value").textContent(), "+2.0");
  assert.deepEqual(page.wire.sent.filter((m) => m.type === "exposure").at(-1), { type: "exposure", stops: 2 });
  await page.locator("#exposure").focus();
  await page.keyboard.press("ArrowLeft");
  assert.equal(await page.locator("#exposure-value").textContent(), "+1.9");
  await page.locator("#exposure").dblclick();
  assert.equal(await page.locator("#exposure-value").textContent(), "0.0");
  await page.waitForTimeout(300);
  const rotation = (await state(page)).rotation;
  await page.locator("#rotation").focus();
  await page.keyboard.press(rotation < 359 ? "ArrowRight" : "ArrowLeft");
  near(Math.abs((await state(page)).rotation - rotation), 1, 0.51, "an arrow key turns the light");
  await changes(page, "light rotation", () => page.locator("#rotation").fill(String((Math.round(rotation) + 150) % 360)));
  // A slider that is dragged moves; let go, it rests.
  const box = await page.locator("#rotation").boundingBox();
  await page.mouse.move(box.x + 20, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + 60, box.y + box.height / 2, { steps: 5 });
  assert.equal(states(page).at(-1).moving, true, "moving while a slider is dragged");
  await page.mouse.up();
  await page.waitForFunction(() => !viewer.pending);
  await page.waitForTimeout(100);
  assert.equal(states(page).at(-1).moving, false, "at rest after a slider");
}

async function sizes(page) {
  const offered = await page.$$eval("#resolution option", (all) => all.map((option) => option.value));
  for (const size of ["256x256", "384x384", "512x512", "768x768", "1024x1024"]) assert.ok(offered.includes(size), size);
  const own = await page.$$eval("#resolution option", (all) => all.find((option) => option.textContent.includes("scene")).value);
  for (const size of [own, "384x384", "256x256"]) {
    await page.locator("#resolution").selectOption(size);
    await settled(page);
    const [width, height] = size.split("x").map(Number);
    assert.deepEqual(await page.$eval("#right-picture", (canvas) => [canvas.width, canvas.height]), [width, height]);
    const box = await stageBox(page);
    near(box.width / box.height, width / height, 0.02, "the stage has the picture's shape");
  }
}

async function material(page) {
  await page.locator("#split").setChecked(false);
  await settled(page);
  const box = await stageBox(page);
  let note = "";
  for (const [x, y] of [[0.5, 0.55], [0.4, 0.5], [0.6, 0.6], [0.5, 0.8], [0.3, 0.5], [0.7, 0.5]]) {
    await page.evaluate(() => { document.querySelector("#note").textContent = ""; });
    await page.mouse.dblclick(box.x + x * box.width, box.y + y * box.height);
    await page.waitForFunction(() => document.querySelector("#note").textContent !== "");
    note = await page.locator("#note").textContent();
    if (/^material: /.test(note)) break;
  }
  assert.match(note, /^material: /, "a double click picks");
  const number = await page.evaluate(() => viewer.material);
  assert.equal(await page.locator("#material").inputValue(), String(number), "the picked material is open");
  assert.ok(note.includes((await page.locator("#material option:checked").textContent()).replace(" (changed)", "")));
  assert.ok(await page.locator("#reset").isDisabled());
  const color = page.locator("#parameters input[type=color]").first();
  const rough = page.locator("#parameters input[type=range]").first();
  if (await color.count()) {
    const name = (await color.getAttribute("id")).replace("parameter-", "");
    await changes(page, "a colour", () => color.fill("#ff40c0"));
    const value = (await state(page)).materials[number][name];
    [1, 0x40 / 255, 0xc0 / 255].forEach((v, i) => near(value[i], v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4, 1e-9, "linear colour"));
    assert.equal(await color.inputValue(), "#ff40c0", "the colour comes back exactly");
  }
  const output = page.locator("#parameters .row:has(input[type=range]) output").first();
  const before = await output.textContent();
  await rough.focus();
  for (let i = 0; i < 5; i++) await page.keyboard.press(Number(before) > 0.5 ? "ArrowLeft" : "ArrowRight");
  assert.notEqual(await output.textContent(), before, "an arrow key changes a parameter");
  await settled(page);
  assert.match(await page.locator("#material option:checked").textContent(), /\(changed\)$/);
  await shoot(page, "material");
  await changes(page, "reset", () => page.locator("#reset").click());
  assert.deepEqual((await state(page)).materials[number], undefined);
  const other = await page.$$eval("#material option", (all) => all.length);
  if (other > 1) {
    await page.locator("#material").selectOption({ index: (number + 1) % other });
    assert.equal(await page.evaluate(() => viewer.material), (number + 1) % other);
  }
  await page.locator("#split").setChecked(true);
  await settled(page);
}

async function frames(page) {
  if (!await page.locator("#frame-row").isVisible()) return;
  await page.locator("#frame").focus();
  await page.keyboard.press("Home");
  await page.keyboard.press("ArrowRight");
  assert.equal((await state(page)).frame, 1);
  await settled(page);
  await page.locator("#play").press("Enter");
  assert.equal(await page.locator("#play").getAttribute("aria-label"), "Pause");
  await page.waitForFunction(() => viewer.state.frame !== 1);
  await page.locator("#play").press("Enter");
  assert.equal(await page.locator("#play").getAttribute("aria-label"), "Play");
  await page.waitForTimeout(200);
  const frame = (await state(page)).frame;
  await page.waitForTimeout(300);
  assert.equal((await state(page)).frame, frame, "Pause holds");
  await settled(page);
}

async function files(page) {
  const save = async (id) => {
    const [download] = await Promise.all([page.waitForEvent("download"), page.locator("#save-" + id).click()]);
    return fs.readFileSync(await download.path());
  };
  for (const id of ["scene", "camera"]) {
    const content = JSON.parse((await save(id)).toString("utf8"));
    assert.equal(typeof content, "object", id + ".json holds an object");
  }
  const { resolution } = await state(page);
  for (const id of ["left", "right"]) {
    const png = await save(id);
    assert.deepEqual([...png.subarray(0, 8)], [137, 80, 78, 71, 13, 10, 26, 10], id + ".png is a PNG");
    assert.deepEqual([png.readUInt32BE(16), png.readUInt32BE(20)], resolution, id + ".png has the size");
  }
}

async function mathematics(page) {
  const results = await page.evaluate(() => {
    const { orbit, pan, zoom, toLinear, toSrgb, toHex, fromHex } = viewer.math;
    const down = { eye: [0, 5, 0], target: [0, 0, 0], up: [0, 0, -1], vertical_fov: 40 };
    const side = { eye: [0, 0, 2], target: [0, 0, 0], up: [0, 1, 0], vertical_fov: 90 };
    const hex = [...Array(256).keys()].map((v) => "#" + v.toString(16).padStart(2, "0").repeat(3));
    return {
      below: orbit(down, 0, 0).eye, quarter: orbit(side, Math.PI / 2, 0).eye, panned: pan(side, 0.25, 0.25), zoomed: zoom(side, 0, [0.1, 10]).eye,
      colors: hex.filter((text) => toHex(fromHex(text)) !== text), trips: [0, 1e-4, 0.003, 0.0032, 0.5, 1].map((v) => toLinear(toSrgb(v)) - v),
    };
  });
  // Seen from above with -Z upwards, the eye sinks towards +Z.
  assert.ok(results.below[2] > 0 && Math.abs(results.below[0]) < 1e-9);
  same(results.quarter, [2, 0, 0], "a quarter of a turn");
  same(results.panned.target, [-1, 1, 0], "pan by a quarter of a height of 4");
  same(results.zoomed, [0, 0, 0.1], "zoom by 0 keeps its distance");
  assert.deepEqual(results.colors, [], "colours come back exactly");
  results.trips.forEach((error) => near(error, 0, 1e-6, "sRGB there and back"));
}

// --- Connections: through a proxy that can be cut, so that the program itself is tried.

function proxy() {
  const target = new URL(address), links = new Set();
  const server = net.createServer((client) => {
    const remote = net.connect(Number(target.port || 80), target.hostname);
    for (const [a, b] of [[client, remote], [remote, client]]) {
      links.add(a);
      // The program answers to its own name only.
      const named = (bytes) => Buffer.from(bytes.toString("latin1").replaceAll(`127.0.0.1:${server.address()?.port}`, target.host), "latin1");
      a.on("data", (bytes) => b.write(a === client && bytes.includes("HTTP/1.1") ? named(bytes) : bytes));
      for (const event of ["error", "close"]) a.on(event, () => { links.delete(a); b.destroy(); });
    }
  });
  const cut = () => { for (const link of links) link.destroy(); };
  const listen = (port) => new Promise((done) => server.listen(port, "127.0.0.1", done));
  return { server, cut, listen, address: () => { const url = new URL(address); url.hostname = "127.0.0.1"; url.port = server.address().port; return url.href; } };
}

async function connections(browser) {
  const link = proxy();
  await link.listen(0);
  const url = link.address(), port = link.server.address().port;
  if (!(await fetch(url).catch(() => null))?.ok) {
    console.log("skipped: reconnection (the program answers its own address only)");
    link.server.close();
    return;
  }
  await visit(browser, "wide", {}, async (page) => {
    await prepare(page);
    await drag(page, [0.7, 0.5], [0.8, 0.5]);
    await settled(page);
    const before = await state(page);
    const count = () => page.evaluate(() => viewer.counts.connections);
    const first = await count();
    link.cut();
    await page.waitForFunction((first) => viewer.counts.connections > first, first);
    assert.deepEqual(await state(page), before, "a reconnection keeps the state");
    await settled(page);
    // Nobody answers for a while; what is changed meanwhile is not lost.
    link.cut();
    link.server.close();
    await page.waitForFunction(() => !viewer.connected);
    await page.locator("#right").selectOption("albedo").catch(() => {});
    await page.waitForFunction(() => /next try in [124]/.test(document.querySelector("#connection").textContent));
    await shoot(page, "disconnected");
    const waits = [];
    for (let i = 0; i < 4; i++) { await page.waitForTimeout(500); waits.push(await page.locator("#connection").textContent()); }
    assert.ok(new Set(waits).size > 0);
    await link.listen(port);
    await page.waitForFunction(() => viewer.connected);
    await settled(page);
    assert.equal(await page.locator("#connection").textContent(), "connected");
    assert.equal((await page.evaluate(() => viewer.sides.right.method)), (await state(page)).right);
    // Another page takes over.
    const other = await page.context().newPage();
    await other.goto(url);
    await other.waitForFunction(() => viewer.connected);
    await page.waitForFunction(() => viewer.ended);
    assert.ok(await page.locator("#curtain").isVisible());
    const counts = await page.evaluate(() => viewer.counts.connections);
    await page.waitForTimeout(2500);
    assert.equal(await page.evaluate(() => viewer.counts.connections), counts, "no reconnection after the end");
    assert.ok(await other.evaluate(() => viewer.connected), "the other page goes on");
    await shoot(page, "ended");
  }, { url, allowed: /WebSocket connection to .* failed/ });
  link.cut();
  link.server.close();
}

// What only the mock can provoke.
async function faults(browser) {
  if (!await mock()) return;
  await visit(browser, "wide", {}, async (page) => {
    await prepare(page);
    const before = await look(page);
    await mock("late");
    await page.waitForFunction(() => viewer.counts.late === 1);
    await mock("early");
    await page.waitForFunction(() => viewer.counts.late === 2);
    assert.equal(difference(before, await look(page)), 0, "late and foreign pictures are not shown");
    await mock("malformed");
    await page.waitForFunction(() => viewer.counts.bad === 6);
    assert.match(await page.locator("#note").textContent(), /cannot be read/);
    assert.ok(await page.evaluate(() => viewer.connected));
    await changes(page, "orbit after bad messages", () => drag(page, [0.7, 0.5], [0.8, 0.5]));
    await mock("note");
    await page.waitForFunction(() => document.querySelector("#note").textContent === "the reference starts again");
    await mock("end");
    await page.waitForFunction(() => viewer.ended);
    assert.match(await page.locator("#connection").textContent(), /^the program was stopped/);
  });
}

async function checks(browser) {
  for (const size of Object.keys(SIZES)) {
    await visit(browser, size, {}, async (page) => {
      await prepare(page);
      const start = await state(page);
      assert.ok(await page.title());
      await whole(page, size);
      const step = async (name, part) => { await part; console.log(`  ${size}: ${name}`); };
      if (size === "wide") {
        await step("mathematics", mathematics(page));
        await step("mouse", mouse(page));
        await step("one state per frame", frameRate(page));
        await step("keys", stageKeys(page));
        await step("home", homeRestores(page, start));
        await step("split", split(page));
        await step("material", material(page));
        await step("light", light(page));
        await step("sizes", sizes(page));
        await step("files", files(page));
        await step("frames", frames(page));
        await step("methods", methods(page));
      } else {
        await thumbs(page);
        await step("touch", touch(page));
        await step("home", homeRestores(page, start));
        await step("material by keys", (async () => {
          await page.locator("#material").focus();
          const slider = page.locator("#parameters input[type=range]").first();
          await slider.focus();
          // A material may have either end of the range already.
          await page.keyboard.press("End");
          await page.keyboard.press("ArrowLeft");
          await settled(page);
          await page.locator("#reset").click();
        })());
        await step("light", page.locator("#exposure").fill("1").then(() => page.locator("#exposure").fill("0")));
        await step("methods", page.locator("#right").selectOption("albedo").catch(() => {}));
      }
      await step("tab order", tabOrder(page));
      await whole(page, size);
      await page.waitForTimeout(200);
      const { pictures, shown } = page.wire;
      assert.ok(Math.abs(pictures - shown) <= 1, `${shown} answers to ${pictures} pictures`);
      assert.ok(await page.evaluate(() => viewer.connected && viewer.counts.bad === 0));
    });
  }
  for (const colorScheme of ["light", "dark"]) for (const size of Object.keys(SIZES)) {
    await visit(browser, size, { colorScheme, reducedMotion: "reduce" }, async (page) => {
      await prepare(page, ["deferred", "path"]);
      await page.locator("#resolution").selectOption("512x512");
      await settled(page);
      await page.evaluate(() => { scrollTo(0, 0); document.activeElement.blur(); });
      await page.waitForTimeout(1500);
      await shoot(page, `${size}-${colorScheme}`, size === "phone");
    });
  }
  await connections(browser);
  console.log("  connections");
  await faults(browser);
  const seen = await mock();
  if (seen) assert.deepEqual(seen.violations, [], "the mock saw the protocol kept");
}

// --- From input to picture.

async function latency(browser) {
  const rows = [];
  await visit(browser, "wide", {}, async (page) => {
    await prepare(page);
    await page.locator("#split").setChecked(false);
    await page.locator("#resolution").selectOption("512x512");
    const offered = await page.$$eval("#right option", (all) => all.map((option) => option.value));
    for (const method of LATENCY.filter((name) => offered.includes(name))) {
      await page.locator("#right").selectOption(method);
      await settled(page);
      await page.waitForTimeout(300);
      const box = await stageBox(page);
      const [x, y] = [box.x + box.width * 0.4, box.y + box.height * 0.5];
      await page.mouse.move(x, y);
      await page.mouse.down();
      await page.mouse.move(x + 5, y);
      const taken = [], until = Date.now() + 60000;
      let scale = 0;
      for (let i = 0; i < 30 && Date.now() < until; i++) {
        const id = await page.evaluate(() => viewer.id);
        await page.mouse.move(x + 5 + 6 * (i + 1), y + (i % 5));
        const found = await page.waitForFunction((id) => viewer.id > id && viewer.log.find((entry) => entry.id === viewer.id && entry.first), id, { polling: "raf" });
        const entry = await found.jsonValue();
        taken.push(entry.input_ms);
        scale = entry.scale;
        await page.waitForTimeout(30);
      }
      const id = await page.evaluate(() => viewer.id);
      await page.mouse.up();
      const rest = await (await page.waitForFunction((id) => viewer.log.find((entry) => entry.id > id && entry.scale === 1), id)).jsonValue();
      taken.sort((a, b) => a - b);
      const share = (p) => taken[Math.min(taken.length - 1, Math.floor(p * taken.length))];
      rows.push([method, taken.length, share(0.5).toFixed(0), share(0.95).toFixed(0), `1/${scale}`, rest.ms.toFixed(0)]);
    }
  });
  table("from input to picture at 512x512, ms", ["method", "steps", "median", "95%", "size", "full size at rest"], rows);
}

function table(title, heads, rows) {
  const all = [heads, ...rows.map((row) => row.map(String))];
  const widths = heads.map((_, i) => Math.max(...all.map((row) => row[i].length)));
  console.log("\n" + title);
  for (const row of all) console.log("  " + row.map((cell, i) => (i === 0 ? cell.padEnd(widths[i]) : cell.padStart(widths[i]))).join("  "));
}

// --- Random input for minutes.

function generator(seed) {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

// Resident memory of the browser's processes of a kind, in MB.
async function resident(session, kind) {
  const { processInfo } = await session.send("SystemInfo.getProcessInfo");
  const sizes = processInfo.filter((one) => one.type === kind).map(({ id }) => {
    try { return Number(fs.readFileSync(`/proc/${id}/status`, "utf8").match(/VmRSS:\s+(\d+)/)[1]) / 1024; } catch { return 0; }
  });
  return Math.max(0, ...sizes);
}

async function random(browser) {
  const seed = Number(process.env.SEED ?? 1), draw = generator(seed);
  const any = (list) => list[Math.floor(draw() * list.length)];
  const session = await browser.newBrowserCDPSession();
  const samples = [];
  await visit(browser, "wide", {}, async (page, context) => {
    await prepare(page);
    const client = await context.newCDPSession(page);
    await client.send("Performance.enable");
    const box = () => stageBox(page);
    const point = () => [0.1 + 0.8 * draw(), 0.15 + 0.7 * draw()];
    const slide = async (selector) => {
      const slider = page.locator(selector);
      const [low, high] = await slider.evaluate((e) => [Number(e.min), Number(e.max)]);
      for (let i = 0; i < 5; i++) await slider.fill(String(low + Math.round((high - low) * draw() * 100) / 100), { timeout: 5000 }).catch(() => {});
    };
    const deeds = {
      orbit: () => drag(page, point(), point(), { steps: 20 }), orbit_more: () => drag(page, point(), point(), { steps: 40 }),
      pan: () => drag(page, [0.3, 0.5], [0.3 + 0.05 * draw(), 0.5], { button: "right" }),
      wheel: async () => { const b = await box(); await page.mouse.move(b.x + b.width * 0.7, b.y + 90); for (let i = 0; i < 5; i++) await page.mouse.wheel(0, 200 * (draw() - 0.5)); },
      keys: async () => { await page.locator("#stage").focus(); for (let i = 0; i < 5; i++) await page.keyboard.press(any(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "+", "-", "Shift+ArrowUp"])); },
      exposure: () => slide("#exposure"), rotation: () => slide("#rotation"),
      parameter: async () => { const all = await page.$$eval("#parameters input[type=range]", (e) => e.map((one) => one.id)); if (all.length) await slide("#" + any(all)); },
      color: async () => { const c = page.locator("#parameters input[type=color]"); if (await c.count()) await c.first().fill("#" + Math.floor(draw() * 2 ** 24).toString(16).padStart(6, "0")); },
      material: async () => page.locator("#material").selectOption({ index: Math.floor(draw() * await page.locator("#material option").count()) }),
      reset: () => page.locator("#reset").click({ timeout: 500 }).catch(() => {}),
      method: async () => page.locator(any(["#left", "#right"])).selectOption({ index: Math.floor(draw() * await page.locator("#right option").count()) }, { timeout: 500 }).catch(() => {}),
      resolution: () => page.locator("#resolution").selectOption(any(["256x256", "256x256", "384x384", "512x512"])),
      grip: () => page.locator("#divide").fill(String(Math.floor(100 * draw())), { timeout: 500 }).catch(() => {}),
      split: () => page.locator("#split").setChecked(draw() < 0.7),
      rays: () => page.locator("#rays").selectOption(any(["1", "2", "4", "8"]), { timeout: 300 }).catch(() => {}),
      pick: async () => { const b = await box(), [x, y] = point(); await page.mouse.dblclick(b.x + x * b.width, b.y + y * b.height); },
      play: async () => { if (!await page.locator("#play").isVisible()) return; await page.locator("#play").click(); await page.waitForTimeout(800); await page.locator("#play").click(); },
      home: () => page.locator("#home").click(), pause: () => page.waitForTimeout(1500 * draw()),
    };
    const start = Date.now(), end = start + 60000 * Number(minutes);
    let deedsDone = 0, following = start;
    while (Date.now() < end) {
      const name = any(Object.keys(deeds));
      try { await deeds[name](); } catch (error) { throw new Error(`${name} after ${((Date.now() - start) / 1000).toFixed(0)} s`, { cause: error }); }
      deedsDone++;
      if (Date.now() < following) continue;
      following += 10000;
      await client.send("HeapProfiler.collectGarbage");
      const { metrics } = await client.send("Performance.getMetrics");
      const metric = (name) => metrics.find((one) => one.name === name).value;
      const counts = await page.evaluate(() => viewer.counts);
      samples.push({ s: (Date.now() - start) / 1000, heap: metric("JSHeapUsedSize") / 2 ** 20, nodes: metric("Nodes"), listeners: metric("JSEventListeners"),
        renderer: await resident(session, "renderer"), gpu: await resident(session, "GPU"), pictures: counts.pictures, deeds: deedsDone });
      assert.ok(await page.evaluate(() => viewer.connected && !viewer.ended), "the connection lives");
      assert.deepEqual(page.faults, [], "no faults");
    }
    await page.waitForTimeout(600);
    assert.equal(states(page).at(-1).moving, false, "at rest in the end");
    const id = await page.evaluate(() => viewer.id);
    await page.locator("#home").click();
    await page.waitForFunction((id) => !viewer.pending && viewer.sides.right.state > id, id);
    assert.equal(await page.evaluate(() => viewer.counts.connections), 1, "one connection for the whole time");
    assert.equal(await page.evaluate(() => viewer.counts.bad), 0, "no message that cannot be read");
  });
  const shown = samples.filter((_, i) => i % Math.max(1, Math.floor(samples.length / 12)) === 0 || i === samples.length - 1);
  table(`random input for ${minutes} min, seed ${seed}`, ["s", "heap MB", "nodes", "listeners", "renderer MB", "GPU MB", "pictures", "deeds"],
    shown.map((one) => [one.s.toFixed(0), one.heap.toFixed(1), one.nodes, one.listeners, one.renderer.toFixed(0), one.gpu.toFixed(0), one.pictures, one.deeds]));
  const first = samples.find((one) => one.s >= 60) ?? samples[0], last = samples.at(-1);
  assert.ok(last.heap <= 1.5 * first.heap + 20, `heap ${first.heap.toFixed(1)} -> ${last.heap.toFixed(1)} MB`);
  assert.ok(last.renderer <= 1.5 * first.renderer + 150, `renderer ${first.renderer.toFixed(0)} -> ${last.renderer.toFixed(0)} MB`);
  fs.writeFileSync(path.join(screenshots, "random.json"), JSON.stringify(samples));
}

async function main() {
  const args = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"];
  // A page that was not fetched counts as one from afar, which may not speak to this computer.
  if (process.env.PAGE) args.push("--disable-features=LocalNetworkAccessChecks");
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args });
  try {
    if (parts.includes("checks")) await checks(browser);
    if (parts.includes("latency")) await latency(browser);
    if (parts.includes("random") && Number(minutes) > 0) await random(browser);
  } finally {
    await browser.close();
  }
  console.log(`\nviewer in Chromium: ${parts.join(", ")} hold, screenshots in ${screenshots}`);
}

main().catch((error) => {
  console.error(error);
  process.exitCode = 1;
});
