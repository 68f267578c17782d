// Uses a report as people do: node report.cjs REPORT_DIR SCREENSHOT_DIR
"use strict";
const assert = require("node:assert/strict");
const fs = require("node:fs");
const path = require("node:path");
const { pathToFileURL } = require("node:url");
const { chromium } = require("playwright-core");

const [report, screenshots] = process.argv.slice(2);
const page_names = fs.readdirSync(report).filter((name) => name.endsWith(".html") && name !== "index.html").sort();
const SEQUENCE = page_names.find((name) => name.startsWith("synthetic-")) ?? page_names[0];
const SIZES = { wide: { width: 1280, height: 800 }, phone: { width: 360, height: 740 } };

// A page that has failed in no way when `use` is done.
async function visit(browser, name, size, options, use) {
  const context = await browser.newContext({ viewport: SIZES[size], hasTouch: size === "phone", ...options });
  const page = await context.newPage();
  const faults = [];
  page.on("console", (message) => { if (["error", "warning"].includes(message.type())) faults.push(message.text()); });
  page.on("pageerror", (error) => faults.push(String(error)));
  page.on("request", (request) => { if (!/^(file|data|blob):/.test(request.url())) faults.push("asks for " + request.url()); });
  await page.goto(pathToFileURL(path.join(report, name)).href);
  await use(page, context);
  await whole(page, name);
  assert.deepEqual(faults, [], `${name} at ${size}`);
  await context.close();
}

// What holds on every page at any time.
async function whole(page, name) {
  await page.waitForFunction(() => [...document.images].every((image) => image.complete));
  const broken = await page.$$eval("img", (images) => images.filter((i) => i.checkVisibility({ visibilityProperty: true }) && i.naturalWidth === 0).length);
  assert.equal(broken, 0, `${name}: pictures that do not load`);
  const [content, window] = await page.evaluate(() => [document.documentElement.scrollWidth, document.documentElement.clientWidth]);
  assert.ok(content <= window, `${name}: ${content} pixels wide in ${window}`);
}

const shoot = (page, name) => page.screenshot({ path: path.join(screenshots, name + ".png"), fullPage: true });

// Controls by Tab alone, in the order of the page.
async function tabOrder(page) {
  const focusable = "a[href], button:not([disabled]), input, select, summary, [tabindex='0']";
  const visible = await page.$$eval(focusable, (all) => {
    const shown = all.filter((e) => e.checkVisibility());
    shown.forEach((e, number) => { e.dataset.order = number; });
    return shown.length;
  });
  // From the top: to blur alone leaves the place where Tab goes on.
  await page.evaluate(() => { document.body.tabIndex = -1; document.body.focus(); document.body.removeAttribute("tabindex"); });
  const reached = [];
  for (let i = 0; i < visible; i++) {
    await page.keyboard.press("Tab");
    reached.push(await page.evaluate(() => Number(document.activeElement.dataset.order ?? -1)));
  }
  assert.deepEqual(reached, [...Array(visible).keys()], "Tab reaches every control in order");
  const outlined = await page.evaluate(() => getComputedStyle(document.activeElement).outlineStyle !== "none");
  assert.ok(outlined, "focus can be seen");
}

async function index(page) {
  const table = page.locator("table").first();
  const column = () => table.locator("tbody tr td:nth-child(2)").evaluateAll((cells) => cells.map((cell) => Number(cell.dataset.value)));
  const head = table.locator("thead th:nth-child(2)");
  const sorted = (values, turn) => [...values].sort((a, b) => turn * (a - b));
  // The best PSNR comes first.
  await head.locator("button").click();
  assert.deepEqual(await column(), sorted(await column(), -1));
  assert.equal(await head.getAttribute("aria-sort"), "descending");
  await head.locator("button").press("Enter");
  assert.deepEqual(await column(), sorted(await column(), 1));
  assert.equal(await head.getAttribute("aria-sort"), "ascending");
  await table.locator("thead th:first-child button").click();
  const names = await table.locator("tbody th").allTextContents();
  assert.deepEqual(names.map((n) => n.trim()), names.map((n) => n.trim()).sort((a, b) => a.localeCompare(b)));

  for (const box of await page.locator(".choices:has(> label)").all()) {
    const select = box.locator("> label select");
    const options = await select.locator("option").allTextContents();
    const shown = () => box.locator("> .choice").evaluateAll((all) => all.map((e) => e.checkVisibility()));
    assert.deepEqual(await shown(), options.map((_, number) => number === 0));
    await select.selectOption({ index: options.length - 1 });
    assert.deepEqual(await shown(), options.map((_, number) => number === options.length - 1));
    await select.selectOption({ index: 0 });
  }
  // No label of a plot lies on another or outside of it.
  const labels = await page.$$eval("svg", (all) => all.filter((svg) => svg.checkVisibility()).map((svg) => {
    const frame = svg.getBoundingClientRect();
    const boxes = [...svg.querySelectorAll("text.label")].map((text) => [text.textContent, text.getBoundingClientRect()]);
    const outside = boxes.filter(([, b]) => b.left < frame.left - 1 || b.right > frame.right + 1 || b.top < frame.top - 1 || b.bottom > frame.bottom + 1);
    const over = boxes.filter(([, a], i) => boxes.some(([, b], j) => j < i && Math.min(a.right, b.right) - Math.max(a.left, b.left) > 3 &&
      Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 4));
    return [svg.getAttribute("aria-label"), [...outside, ...over].map(([text]) => text)];
  }));
  for (const [plot, bad] of labels) assert.deepEqual(bad, [], `labels of "${plot}" that cannot be read`);
}

const divide = (page) => page.$eval("#left-half", (half) => getComputedStyle(half).clipPath);
// Pixels of the stage as they are on the screen.
const pixels = async (page) => (await page.locator("#stage").screenshot({ animations: "disabled" })).toString("base64");

async function slider(page, size) {
  await page.locator("#stage").scrollIntoViewIfNeeded();
  const seen = [await divide(page)];
  const changed = async (how) => {
    const now = await divide(page);
    assert.notEqual(now, seen.at(-1), how + " moves the divide");
    seen.push(now);
  };
  const before = await pixels(page);
  const box = await page.locator("#stage").boundingBox();
  const at = (x, y) => [box.x + x * box.width, box.y + y * box.height];
  if (size === "wide") {
    await page.mouse.move(...at(0.5, 0.5));
    await page.mouse.down();
    await page.mouse.move(...at(0.2, 0.5), { steps: 4 });
    await page.mouse.up();
    await changed("the mouse");
    assert.match(seen.at(-1), /80%|8[01]\.?\d*%|calc|px/);
    assert.match(await page.locator("#readout").textContent(), /^pixel \d+, \d+: .*\d+, \d+, \d+ \| /);
  } else {
    const client = await page.context().newCDPSession(page);
    const touch = (type, x) => client.send("Input.dispatchTouchEvent", {
      type, touchPoints: type === "touchEnd" ? [] : [{ x: at(x, 0.5)[0], y: at(x, 0.5)[1] }],
    });
    await touch("touchStart", 0.5);
    for (const x of [0.45, 0.35, 0.25, 0.2]) await touch("touchMove", x);
    await touch("touchEnd", 0.2);
    await changed("a finger");
  }
  assert.ok(Math.abs(Number(await page.locator("#divide").inputValue()) - 20) <= 2, "the divide is where it was drawn to");
  assert.notEqual(await pixels(page), before, "the picture changes");
  await page.locator("#divide").focus();
  await page.keyboard.press("ArrowRight");
  await changed("an arrow key");
  await page.keyboard.press("Home");
  await changed("Home");
}

async function frames(page) {
  const source = () => page.$eval("#right-picture", (picture) => picture.src);
  const now = () => page.$eval("#curves .choice:not([hidden]) .now", (line) => Number(line.getAttribute("x1")));
  const number = () => page.locator("#frame-number").textContent();
  const before = [await source(), await now(), await number()];
  await page.locator("#frame").focus();
  await page.keyboard.press("ArrowRight");
  const after = [await source(), await now(), await number()];
  before.forEach((value, i) => assert.notEqual(after[i], value, "an arrow key goes to the next frame"));
  assert.ok(after[1] > before[1]);
  await page.keyboard.press("End");
  const end = await number();
  await page.locator("#play").press("Enter");
  await page.waitForFunction((end) => document.querySelector("#frame-number").textContent !== end, end);
  await page.locator("#play").press("Enter");
  assert.equal(await page.locator("#play").textContent(), "Play");
  // A click on the curve goes to the frame there.
  const svg = page.locator("#curves .choice:not([hidden]) svg").locator("visible=true");
  await svg.scrollIntoViewIfNeeded();
  await svg.evaluate((e) => {
    const [left] = e.dataset.x.split(" ").map(Number);
    const box = e.getBoundingClientRect();
    e.dispatchEvent(new MouseEvent("click", { clientX: box.left + left * box.width / e.viewBox.baseVal.width, clientY: box.top + 30 }));
  });
  assert.equal(await page.locator("#frame").inputValue(), "0");
}

async function errors(page) {
  const canvas = () => page.$eval("#right-error", (canvas) => {
    if (canvas.hidden) return null;
    const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    return data.filter((v, i) => i % 4 === 0).reduce((a, b) => a + b, 0) / (canvas.width * canvas.height);
  });
  const drawn = (wanted) => page.waitForFunction((wanted) => document.querySelector("#right-error").hidden !== wanted, wanted);
  await page.locator("#divide").fill("10");
  await page.locator("#error").press("Space");
  await drawn(true);
  const red = await canvas();
  assert.ok(red > 0, "the error map shows something");
  const left = await page.$eval("#left-error", (c) => c.getContext("2d").getImageData(0, 0, c.width, c.height).data.reduce((most, v, i) => (i % 4 < 3 ? Math.max(most, v) : most), 0));
  assert.equal(left, 0, "the truth has no error");
  await page.locator("#gain").selectOption("16");
  await page.waitForFunction((red) => {
    const canvas = document.querySelector("#right-error");
    const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    return data.filter((v, i) => i % 4 === 0).reduce((a, b) => a + b, 0) / (canvas.width * canvas.height) > red;
  }, red);
  return async () => {
    await page.locator("#error").press("Space");
    await drawn(false);
    assert.equal(await canvas(), null);
  };
}

async function choices(page) {
  const button = page.locator(".strip button").last();
  const method = await button.getAttribute("data-method");
  await button.press("Enter");
  assert.equal(await page.locator("#right").inputValue(), method);
  assert.equal(await button.getAttribute("data-side"), "right");
  await button.click({ modifiers: ["Shift"] });
  assert.equal(await page.locator("#left").inputValue(), method);
  await page.locator("#left").selectOption("truth");
  const width = () => page.$eval("#stage", (stage) => stage.clientWidth);
  const own = await page.$eval("#stage", (stage) => Number(stage.dataset.width));
  for (const factor of [1, 2, 4]) {
    await page.locator("#zoom").selectOption(String(factor));
    assert.equal(await width(), factor * own);
    await whole(page, `zoom ${factor}`);
  }
  assert.equal(await page.$eval("#right-picture", (p) => getComputedStyle(p).imageRendering), "pixelated");
  await page.locator("#zoom").selectOption("0");
}

// Controls that a thumb hits.
async function thumbs(page) {
  const small = await page.$$eval("select, .controls button, .controls label, .strip button, input[type=range]", (all) =>
    all.filter((e) => e.checkVisibility() && e.getBoundingClientRect().height < 40).map((e) => e.outerHTML.slice(0, 80)));
  assert.deepEqual(small, []);
}

async function main() {
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM, args: ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"] });
  try {
    for (const size of Object.keys(SIZES)) {
      await visit(browser, "index.html", size, {}, async (page) => {
        await shoot(page, `index-${size}`);
        await index(page);
        await tabOrder(page);
        await thumbs(page);
      });
      await visit(browser, SEQUENCE, size, {}, async (page) => {
        await page.waitForFunction(() => document.querySelector("#right-picture").naturalWidth > 0);
        await shoot(page, `sequence-${size}`);
        await slider(page, size);
        await frames(page);
        const done = await errors(page);
        await shoot(page, `error-${size}`);
        await done();
        await choices(page);
        await tabOrder(page);
        await thumbs(page);
      });
    }
    for (const [name, page_name] of [["index", "index.html"], ["sequence", SEQUENCE]]) {
      await visit(browser, page_name, "wide", { colorScheme: "dark" }, (page) => shoot(page, name + "-dark"));
    }
    for (const name of page_names) await visit(browser, name, "phone", {}, async () => {});
  } finally {
    await browser.close();
  }
  console.log(`report in Chromium: ${page_names.length + 1} pages hold, screenshots in ${screenshots}`);
}

main().catch((error) => {
  console.error(error);
  process.exitCode = 1;
});
