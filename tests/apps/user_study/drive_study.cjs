// Takes part in a study in a real browser, as several participants, and prints what was seen, as JSON.
// node drive_study.cjs CHROMIUM FOLDER PORT
//   FOLDER has sent/, a site that sends its answers to 127.0.0.1:PORT, and saved/, the same site that does not.
const fs = require("fs");
const http = require("http");
const path = require("path");
const { chromium } = require("playwright-core");
const axe = require.resolve("axe-core/axe.min.js");
const [executablePath, folder, port] = process.argv.slice(2);
const PATIENCE = 120000;
const TYPES = { html: "text/html", js: "text/javascript", css: "text/css", json: "application/json", mp4: "video/mp4" };
const DESKTOP = { width: 1100, height: 900 }, PHONE = { width: 390, height: 844 };
const seen = { requests: [], errors: [], faults: {}, posted: [], sessions: {}, overflow: {} };
let hasFault = false; // whether the server that takes the answers is out of order

function serve(root) {
  const server = http.createServer((request, response) => {
    const name = decodeURIComponent(new URL(request.url, "http://x").pathname).slice(1) || "index.html";
    const file = path.join(root, name);
    if (!file.startsWith(root) || !fs.existsSync(file)) return response.writeHead(404).end();
    const content = fs.readFileSync(file), type = TYPES[path.extname(file).slice(1)] || "text/plain";
    response.writeHead(200, { "Content-Type": type }).end(content);
  });
  return new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(`http://127.0.0.1:${server.address().port}`)));
}

function take() {
  const server = http.createServer((request, response) => {
    const allowed = { "Access-Control-Allow-Origin": "*", "Access-Control-Allow-Headers": "Content-Type" };
    if (request.method === "OPTIONS") return response.writeHead(204, allowed).end();
    if (hasFault) return response.writeHead(503, allowed).end();
    let text = "";
    request.on("data", (part) => { text += part; });
    request.on("end", () => {
      seen.posted.push({ type: request.headers["content-type"], text });
      response.writeHead(204, allowed).end();
    });
  });
  return new Promise((resolve) => server.listen(Number(port), "127.0.0.1", resolve));
}

async function open(browser, address, options = {}) {
  const context = await browser.newContext({ viewport: DESKTOP, acceptDownloads: true, ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE);
  page.on("request", (request) => seen.requests.push(request.url()));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("console", (message) => {
    if (message.type() === "error" && !/503|ERR_FAILED/.test(message.text())) seen.errors.push(message.text());
  });
  await page.goto(address);
  await page.waitForSelector("h1");
  return page;
}

const heading = (page) => page.textContent("h1");
const status = (page) => page.textContent(".status");
const left = (page, before) => page.waitForFunction((before) => document.querySelector("h1").textContent !== before, before);
const played = (page) => page.waitForFunction(() => document.querySelector(".play").textContent === "Play again");

async function look(page, name) {
  if (name in seen.faults) return;
  await page.evaluate(fs.readFileSync(axe, "utf8")); // not as an element, which the Content-Security-Policy forbids
  const found = await page.evaluate(() => axe.run(document));
  seen.faults[name] = found.violations.map(({ id, impact, nodes }) => [impact, id, nodes.map(({ target }) => target.join(" "))]);
  for (const [size, viewport] of Object.entries({ wide: DESKTOP, narrow: PHONE })) {
    await page.setViewportSize(viewport);
    await page.screenshot({ path: path.join(folder, `${name}-${size}.png`), fullPage: true });
    seen.overflow[`${name}-${size}`] = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  }
  await page.setViewportSize(DESKTOP);
}

const kindOf = (page) => page.evaluate(() => {
  const has = (selector) => document.querySelector(selector) !== null;
  if (has("#consent")) return "consent";
  if (has("textarea")) return "comments";
  if (has("video")) return document.querySelectorAll("video").length === 2 ? `pair-${study.remaining[0].kind}` : has("#number-1") ? "attention" : "rating";
  return has(".save") ? "end" : `instructions`;
});

// Answers what is shown with the mouse; returns the kind of the page.
async function answer(page) {
  const kind = await kindOf(page), before = await heading(page);
  if (kind === "end") return kind;
  if (kind === "consent") await page.check("#consent");
  if (kind === "comments") await page.fill("textarea", "Très bien </script> \u{1F44B}");
  if (kind === "rating" || kind === "attention" || kind.startsWith("pair")) {
    await page.click(".next");
    seen.early = await status(page);
    await page.click(".play");
    if (kind.startsWith("pair")) {
      await page.waitForFunction(() => document.querySelector("video").currentTime > 0.5);
      (seen.apart ||= []).push(await page.evaluate(() => {
        const [first, second] = document.querySelectorAll("video");
        return [first.currentTime - second.currentTime, first.muted, second.muted];
      }));
    }
    await played(page);
    await page.click(".next");
    seen.unanswered = await status(page);
    const groups = await page.$$("fieldset");
    for (const [index, group] of groups.entries()) await (await group.$$("label"))[index % 3].click();
  }
  await look(page, kind);
  await page.click(".next");
  await left(page, before);
  return kind;
}

// Answers what is shown with the keyboard.
async function press(page) {
  const kind = await kindOf(page), before = await heading(page), key = (name) => page.keyboard.press(name);
  if (kind === "end") return kind;
  if (kind === "consent") {
    await key("Enter");
    seen.refused = await status(page);
    await key("Tab");
    await key("Space");
  }
  if (kind === "comments") {
    await key("Tab");
    await page.keyboard.type("By keyboard");
    await key("Tab");
  }
  if (kind === "rating" || kind === "attention" || kind.startsWith("pair")) {
    await key("Space");
    await played(page);
    for (const name of kind.startsWith("pair") ? ["ArrowLeft", "ArrowRight", "ArrowDown", "ArrowRight"] : kind === "rating" ? ["1", "5", "3"] : ["4"]) await key(name);
    if (kind === "rating") {
      await key("Space"); // plays again and changes no answer
      await page.waitForFunction(() => document.querySelector(".play").textContent === "Pause");
      await played(page);
    }
  }
  await key("Enter");
  await left(page, before);
  return kind;
}

async function through(page, act, name) {
  const pages = [];
  for (;;) {
    pages.push(await act(page));
    if (pages.at(-1) === "end") break;
  }
  seen.sessions[name] = { pages, ...(await arrangement(page)) };
}

const arrangement = (page) => page.evaluate(() => ({ order: study.order.map(({ id }) => id), sides: Object.fromEntries(study.sides) }));
const idle = (page) => page.waitForFunction(() => !document.querySelector(".status").textContent.startsWith("Sending"));

async function saved(page, act) {
  const [download] = await Promise.all([page.waitForEvent("download"), act()]);
  return { name: download.suggestedFilename(), text: fs.readFileSync(await download.path(), "utf8") };
}

async function main() {
  const [sent, kept] = await Promise.all([serve(path.join(folder, "sent")), serve(path.join(folder, "saved")), take()]);
  const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });

  // With the mouse, and with a reload after a few answers.
  const first = await open(browser, `${sent}/?participant=p1`);
  while ((await first.evaluate(() => study.state.answers.length)) < 3) await answer(first);
  const before = await heading(first);
  await first.reload();
  await first.waitForSelector("h1");
  if ((await kindOf(first)) === "instructions") await answer(first);
  seen.reloaded = [before, await heading(first)];
  await through(first, answer, "p1");
  await idle(first);
  seen.sentStatus = await status(first);
  await look(first, "end");
  await first.reload();
  await first.waitForSelector(".closing");
  seen.postsAfterReload = seen.posted.length;
  await first.click(".forget");
  seen.leftBehind = await first.evaluate(() => Object.keys(localStorage));
  await first.context().close();

  // With the keyboard, with reduced motion, and a file at the end.
  const second = await open(browser, `${kept}/?participant=p2`, { reducedMotion: "reduce" });
  seen.startsByItself = await second.evaluate(() => [...document.querySelectorAll("video")].some(({ paused }) => !paused));
  await through(second, press, "p2");
  seen.keyboard = await saved(second, async () => { await second.keyboard.press("Tab"); await second.keyboard.press("Enter"); });
  seen.keyboardStatus = await status(second);
  await second.context().close();

  // The same participants in other browsers, and one without a name.
  for (const name of ["p1", "p2", "p3", "ann"]) {
    const page = await open(browser, `${kept}/?participant=${name}`);
    seen.sessions[`${name} again`] = await arrangement(page);
    await page.context().close();
  }
  const nameless = await open(browser, kept);
  seen.left = await nameless.evaluate(async () => {
    const { arrange } = await import("./session.js");
    const { randomization } = jsPsychModule.initJsPsych();
    const content = { study: "s", lists: [["i"]], items: [{ id: "i", kind: "preference", pair: ["a", "b"] }] };
    const people = Array.from({ length: 200 }, (_, index) => `p${index}`);
    return people.filter((name) => arrange(content, name, randomization).sides.get("i")[0] === "a").length;
  });
  const anonymous = () => nameless.evaluate(() => study.participant);
  seen.anonymous = [await anonymous()];
  await nameless.reload();
  await nameless.waitForSelector("h1");
  seen.anonymous.push(await anonymous());
  // Its clips cannot be loaded at first.
  let isOff = true;
  await nameless.route("**/media/**", (route) => (isOff ? route.abort() : route.continue()));
  await nameless.reload();
  await nameless.waitForSelector("#consent");
  while (!(await kindOf(nameless)).match(/rating|pair/)) {
    if ((await kindOf(nameless)) === "consent") await nameless.check("#consent");
    const title = await heading(nameless);
    await nameless.click(".next");
    await left(nameless, title);
  }
  await nameless.waitForFunction(() => document.querySelector(".alert").textContent);
  seen.unloaded = await nameless.textContent(".alert");
  isOff = false;
  await nameless.click(".play");
  await played(nameless);
  seen.loaded = await nameless.textContent(".alert");
  await nameless.context().close();

  // A server that fails, and then does not.
  const third = await open(browser, `${sent}/?participant=p3`);
  hasFault = true;
  await third.evaluate(() => study.change({ // all but the last answer, as a session of before would have left them
    consent: true, started: new Date().toISOString(),
    answers: study.order.slice(0, -1).map(({ id, kind, stimulus, pair }) => ({
      item: id, kind, seconds: 1, plays: 1, ...(pair ? { left: pair[0], right: pair[1], choice: "equal" }
        : kind === "attention" ? { stimulus, answer: 1 } : { stimulus, ratings: { naturalness: 1, smoothness: 2, synchrony: 3 } }),
    })),
  }));
  await third.reload();
  await third.waitForSelector("h1");
  await through(third, answer, "p3");
  await idle(third);
  seen.failedStatus = await status(third);
  await look(third, "failed");
  seen.failedFile = await saved(third, () => third.click(".save"));
  hasFault = false;
  await third.reload();
  await third.waitForSelector(".closing:not([hidden])");
  seen.retriedStatus = await status(third);
  await third.context().close();

  const wrong = await open(browser, `${kept}/?participant=${encodeURIComponent("<b>x</b>")}`);
  seen.wrong = await wrong.textContent("main");
  await browser.close();
  console.log(JSON.stringify(seen));
  process.exit(0);
}

main().catch((error) => { console.error(error); process.exit(1); });
