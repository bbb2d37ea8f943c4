// Opens the site in a real browser, uses it as a person would and prints what was seen, as JSON.
// node drive_site.cjs CHROMIUM FOLDER
//   FOLDER has site/, newer/ (the site with another title), speech.wav, speech.mp3, stopped.wav, wicked.vrm, avatar.glb (the same), cut.onnx (half of
//   a model) and bad/ with files that cannot be used.
const fs = require("fs");
const http = require("http");
const path = require("path");
const { chromium } = require("playwright-core");
const axe = require.resolve("axe-core/axe.min.js");
const [executablePath, folder] = process.argv.slice(2);
const PATIENCE = 120000;
const DESKTOP = { width: 1280, height: 800 }, PHONE = { width: 390, height: 844 };
const SMALL = { width: 480, height: 640 }; // so that drawing without a graphics card leaves time for the rest
const TYPES = { html: "text/html", js: "text/javascript", css: "text/css", svg: "image/svg+xml", json: "application/json" };
const at = (...names) => path.join(folder, ...names);

// A static host that serves a folder below a path; the folder may be replaced by another one, or by none.
class Host {
  async start() {
    this.server = http.createServer((request, response) => this.answer(request, response));
    await new Promise((resolve) => this.server.listen(0, "127.0.0.1", resolve));
    this.origin = `http://127.0.0.1:${this.server.address().port}`;
    this.page = `${this.origin}/some/path/`;
    this.root = at("site");
  }
  answer(request, response) {
    if (!this.root) return request.socket.destroy();
    const name = decodeURIComponent(new URL(request.url, this.origin).pathname).replace(/^\/some\/path\//, "");
    let file = path.join(this.root, name || "index.html");
    if (this.instead?.[name]) file = this.instead[name];
    if (!fs.existsSync(file)) return response.writeHead(404).end();
    const type = TYPES[path.extname(file).slice(1)] || "application/octet-stream";
    const content = fs.readFileSync(file);
    if (this.delay && name === "hello.wav") return void setTimeout(() => response.writeHead(200, { "Content-Type": type }).end(content), this.delay);
    response.writeHead(200, { "Content-Type": type, "Content-Length": content.length }).end(content);
  }
}

const seen = { requests: [], errors: [], faults: {}, bad: {} };
const host = new Host();

async function open(browser, options = {}) {
  const context = await browser.newContext({ viewport: SMALL, colorScheme: "light", acceptDownloads: true, ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE);
  context.on("request", (request) => seen.requests.push(request.url()));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("console", (message) => { if (/Content.Security/i.test(message.text())) seen.errors.push(message.text()); });
  page.on("dialog", (dialog) => { seen.errors.push(`dialog ${dialog.message()}`); void dialog.dismiss(); });
  await page.goto(host.page);
  return page;
}

const status = (page) => page.textContent("#status");
const loaded = (page) => page.waitForFunction(() => window.site?.model.gesturer && !site.isBusy);
const idle = (page) => page.waitForFunction(() => window.site && !site.isBusy);
const says = async (page, text) => {
  const isSaid = (text) => document.querySelector("#status").textContent.includes(text);
  await page.waitForFunction(isSaid, text).catch(async () => { throw new Error(`not "${text}" but "${await status(page)}"`); });
  return status(page);
};
const wait = (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds));

async function faultsOf(page, name) {
  await page.evaluate(fs.readFileSync(axe, "utf8")); // not as an element, which the Content-Security-Policy forbids
  const found = await page.evaluate(() => axe.run(document));
  seen.faults[name] = found.violations.map(({ id, impact, nodes }) => [impact, id, nodes.map(({ target }) => target.join(" "))]);
}

async function picture(page, name, viewport, colorScheme = "light") {
  await page.setViewportSize(viewport);
  await page.emulateMedia({ colorScheme });
  await wait(0.7);
  await page.screenshot({ path: at(`${name}.png`) });
  (seen.overflow ||= {})[name] = await page.evaluate(() => {
    const parts = [...document.querySelectorAll("header *, footer *, #panel *")].map((part) => part.getBoundingClientRect());
    return [Math.max(...parts.map(({ right }) => right)) - innerWidth, Math.max(...parts.map(({ bottom }) => bottom)) - innerHeight];
  });
  await page.setViewportSize(SMALL);
  await page.emulateMedia({ colorScheme: "light" });
}

// The directions of the motion that is shown, as base64 of float32.
const directions = (page) => page.evaluate(() => {
  const { directions } = site.motion;
  const bytes = new Uint8Array(directions.buffer, directions.byteOffset, directions.byteLength);
  let text = "";
  for (let i = 0; i < bytes.length; i += 4096) text += String.fromCharCode(...bytes.subarray(i, i + 4096));
  return btoa(text);
});

// Drops a file on the page, by script.
async function drop(page, file) {
  const content = fs.readFileSync(file).toString("base64");
  await page.evaluate(([content, name]) => {
    const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0)), dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File([bytes], name));
    document.querySelector("#stage").dispatchEvent(new DragEvent("drop", { bubbles: true, cancelable: true, dataTransfer }));
  }, [content, path.basename(file)]);
}

async function download(page, action) {
  const [got] = await Promise.all([page.waitForEvent("download"), action()]);
  await got.saveAs(at("saved", got.suggestedFilename()));
  return got.suggestedFilename();
}

async function files(browser) {
  const page = await open(browser);
  const begin = Date.now();
  await loaded(page);
  seen.loadSeconds = (Date.now() - begin) / 1000;
  seen.hello = await status(page);
  await faultsOf(page, "idle");
  await picture(page, "idle-desktop", DESKTOP);
  await picture(page, "idle-phone", PHONE);
  await drop(page, at("speech.wav"));
  await page.waitForFunction(() => site.motion && !site.isBusy);
  seen.spoken = await status(page);
  seen.first = await directions(page);
  // What is in the image at a time of the sound.
  await page.waitForFunction(() => site.player.isPlaying && site.time > 1);
  seen.shown = await page.evaluate(() => new Promise((resolve) => {
    const { player, model: { figure } } = site, shown = [], around = figure.around.bind(figure);
    figure.around = (number) => {
      shown.push([player.time * figure.fps, number]);
      if (shown.length === 10) { delete figure.around; resolve(shown); }
      return around(number);
    };
  }));
  await faultsOf(page, "ready");
  await picture(page, "ready-desktop", DESKTOP);
  await picture(page, "ready-phone", PHONE);
  await page.click("#save summary");
  await picture(page, "ready-desktop-dark", DESKTOP, "dark");
  await picture(page, "ready-phone-dark", PHONE, "dark");
  await page.emulateMedia({ colorScheme: "dark" });
  await faultsOf(page, "dark");
  await page.emulateMedia({ colorScheme: "light" });
  await page.keyboard.press("Escape");
  await page.selectOption("#speaker", "speaker-01");
  await page.selectOption("#second", "speaker-03");
  await page.evaluate(() => { const share = document.querySelector("#share"); share.value = "25"; share.dispatchEvent(new Event("input")); });
  await page.fill("#seed", "7");
  await wait(0.5);
  await page.waitForFunction(() => !site.isBusy && site.take.motion.meta.style.kind === "mixture" && site.take.motion.meta.seed === 7);
  await page.evaluate(() => { const energy = document.querySelector("#energy"); energy.value = "1.4"; energy.dispatchEvent(new Event("input")); });
  await page.waitForFunction(() => site.motion.meta.controls?.energy === 1.4 && site.motion.meta.seed === 7);
  seen.second = await directions(page);
  await page.fill("#seed", "150");
  await page.press("#seed", "Tab");
  seen.lastTake = await page.inputValue("#seed");
  await page.fill("#seed", "7");
  await page.waitForFunction(() => site.take.motion.meta.seed === 7 && !site.isBusy && site.motion.meta.controls?.energy === 1.4);
  seen.saved = [];
  for (const format of ["npz", "bvh", "glb", "webm"]) {
    await page.click("#save summary");
    seen.saved.push(await download(page, () => page.click(`[data-format=${format}]`)));
  }
  await page.evaluate(() => { // a file that takes longer to read than a change of the style waits
    const { arrayBuffer } = Blob.prototype;
    Blob.prototype.arrayBuffer = async function () {
      await new Promise((resolve) => setTimeout(resolve, 1000));
      return arrayBuffer.call(this);
    };
  });
  await page.setInputFiles("#picker", at("speech.mp3"));
  await page.fill("#seed", "9");
  seen.compressed = await says(page, "speech.mp3: ");
  await page.waitForFunction(() => !site.isBusy && site.take.sound.name === "speech.mp3" && site.take.motion.meta.seed === 9);
  await page.context().close();
}

async function avatars(browser) {
  const page = await open(browser, { serviceWorkers: "block" });
  await loaded(page);
  await page.click("#example");
  await page.waitForFunction(() => site.motion && !site.isBusy);
  seen.example = await status(page);
  host.delay = 2000;
  await page.click("#example");
  await says(page, "Loading the example");
  await drop(page, at("speech.wav"));
  await wait(3);
  await page.waitForFunction(() => !site.isBusy);
  seen.lastAsked = await page.evaluate(() => site.take.sound.name);
  host.delay = 0;
  await drop(page, at("wicked.vrm"));
  seen.avatar = await says(page, "Avatar: ");
  seen.images = await page.evaluate(() => document.querySelectorAll("img, script:not([src])").length);
  await wait(1);
  await picture(page, "avatar-desktop", DESKTOP);
  await faultsOf(page, "avatar");
  await page.click("#save summary");
  await page.click("[data-format=webm]");
  await page.waitForFunction(() => site.video);
  await page.keyboard.press("v");
  seen.avatarKept = await says(page, "when the video is saved");
  await page.evaluate(() => {
    Object.defineProperty(document, "hidden", { value: true, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
    delete document.hidden;
  });
  seen.hiddenVideo = await says(page, "No video");
  await page.setInputFiles("#avatars", at("avatar.glb"));
  seen.avatarByAnyName = await says(page, "Avatar: ");
  seen.avatarDrawn = await page.isVisible("#avatar");
  await page.click("#wear");
  seen.figureDrawn = await page.isVisible("#figure");
  await page.context().close();
}

async function hostile(browser) {
  const page = await open(browser);
  await loaded(page);
  fs.truncateSync(at("bad", "huge.wav"), 2 ** 31);
  for (const name of fs.readdirSync(at("bad")).sort()) {
    await page.evaluate(() => document.querySelector("#status").className = "");
    await page.setInputFiles("#picker", at("bad", name));
    await page.waitForFunction(() => document.querySelector("#status.trouble") && !site.isBusy);
    seen.bad[name] = await status(page);
  }
  seen.imagesOfBad = await page.evaluate(() => document.querySelectorAll("img").length);
  await drop(page, at("speech.wav"));
  await page.waitForFunction(() => site.motion && !site.isBusy);
  seen.goesOn = await status(page);
  await page.setInputFiles("#picker", at("stopped.wav"));
  seen.stopped = await says(page, "stopped.wav: ");
  await page.context().close();

  host.instead = { "model/model.onnx": at("cut.onnx") };
  const cut = await open(browser, { serviceWorkers: "block" });
  await cut.waitForSelector("#status.trouble");
  seen.cutModel = await status(cut);
  host.instead = null;
  await cut.click("#example");
  await cut.waitForFunction(() => site.motion && !site.isBusy);
  seen.afterCutModel = await status(cut);
  await cut.context().close();
}

// A microphone that ends, during a recording.
async function unplugged(browser) {
  const page = await open(browser);
  await loaded(page);
  await page.evaluate(() => {
    const source = { time: 0, close() {}, begin(take, onend) { Object.assign(this, { take, onend }); } };
    window.source = source;
    return site.listen(async () => source);
  });
  await page.evaluate(async () => {
    site.record();
    for (let piece = 0; piece < 30; piece++) {
      source.take(Float32Array.from({ length: 1600 }, (_, k) => 0.3 * Math.sin(k * 0.05) * Math.sin(piece)));
      source.time = 0.1 * piece;
      await site.run.work;
    }
    source.onend("The microphone is gone");
  });
  await page.waitForFunction(() => site.motion && !site.isBusy);
  seen.unplugged = await page.evaluate(() => [site.motion.numFrames, site.take.sound.samples.length / 16000]);
  seen.unpluggedStatus = await status(page);
  await page.context().close();
}

async function live(browser) {
  const page = await open(browser, { permissions: ["microphone"] });
  await loaded(page);
  await page.click("#microphone");
  await page.waitForFunction(() => site.run && site.run.number > 15);
  seen.listening = await status(page);
  await faultsOf(page, "live");
  await page.click("#record");
  for (const name of ["Other's voice", "Interrupt", "Count 3", "Think"]) await page.click(`#acting >> text="${name}"`);
  seen.state = await page.evaluate(() => site.run.stream.state);
  await wait(3);
  await picture(page, "live-phone", PHONE);
  seen.small = {};
  for (const [width, height] of [[320, 568], [375, 553], [667, 331], [844, 340]]) {
    await page.setViewportSize({ width, height });
    await wait(0.5);
    await page.screenshot({ path: at(`live-${width}.png`) });
    seen.small[width] = await page.evaluate(() => {
      const reaches = (part) => { part.scrollIntoView(); const { top, bottom } = part.getBoundingClientRect(); return top < innerHeight && bottom > 0; };
      const parts = [...document.querySelectorAll("#panel button")].filter((part) => part.offsetParent);
      return [document.querySelector("#stage").clientHeight, parts.every(reaches), document.documentElement.scrollWidth - innerWidth];
    });
  }
  await page.setViewportSize(SMALL);
  seen.facts = await page.textContent("#facts");
  await page.focus("#energy");
  await page.keyboard.press("Escape");
  await page.waitForFunction(() => site.motion && !site.isBusy);
  await page.click("#another");
  seen.anotherOfARecording = await says(page, "stays");
  seen.recorded = await page.evaluate(() => [site.motion.numFrames, site.take.sound.samples.length / 16000]);
  seen.recordedStatus = await status(page);
  await page.context().close();

  await unplugged(browser);
  const denied = await open(browser);
  await loaded(denied);
  await denied.click("#microphone");
  seen.denied = await says(denied, "may not be used");
  await denied.context().close();
}

// Keys alone: Tab, Enter, space, arrows; each focus must be seen.
async function keyboard(browser) {
  const page = await open(browser, { reducedMotion: "reduce" });
  await loaded(page);
  const focused = () => page.evaluate(() => {
    const { activeElement: element } = document, { outlineStyle, outlineWidth } = getComputedStyle(element);
    return [element.id || element.dataset.format || element.tagName, outlineStyle !== "none" && parseFloat(outlineWidth) > 0];
  });
  const tabTo = async (name) => {
    for (let i = 0; i < 40; i++) {
      await page.keyboard.press("Tab");
      const [id, isVisible] = await focused();
      seen.focused.push([id, isVisible]);
      if (id === name) return;
    }
    throw new Error(`Tab does not reach ${name}`);
  };
  seen.focused = [];
  await tabTo("example");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => site.motion && !site.isBusy);
  seen.startsStill = await page.evaluate(() => !site.player.isPlaying); // who asks for less motion starts it
  await tabTo("figure");
  await page.keyboard.press(" ");
  await page.waitForFunction(() => site.player.isPlaying);
  await page.keyboard.press(" ");
  await page.waitForFunction(() => !site.player.isPlaying);
  const before = await page.evaluate(() => site.time);
  await page.keyboard.press("ArrowRight");
  await page.waitForFunction((before) => site.time > before + 0.9, before);
  await tabTo("SUMMARY");
  await page.keyboard.press("Enter");
  await tabTo("bvh");
  seen.byKeys = await download(page, () => page.keyboard.press("Enter"));
  await page.context().close();
}

async function offline(browser) {
  const page = await open(browser);
  await loaded(page);
  await page.evaluate(() => navigator.serviceWorker.ready);
  host.root = null; // nobody answers
  await page.reload();
  await loaded(page);
  await page.click("#example");
  await page.waitForFunction(() => site.motion && !site.isBusy);
  seen.offline = await status(page);
  host.root = at("newer");
  await page.evaluate(async () => (await navigator.serviceWorker.getRegistration()).update()); // browsers do so after a start
  await says(page, "A new version");
  seen.oldTitle = await page.title();
  await page.reload();
  await page.waitForFunction(() => document.title === "Newer");
  await loaded(page);
  seen.kept = await page.evaluate(async () => {
    const [name, ...others] = await caches.keys();
    return [(await (await caches.open(name)).keys()).length, others.length];
  });
  host.root = at("site");
  await page.context().close();
}

// Minutes of sound through the stream of the page, as fast as it is computed, and the memory of the process after some.
async function memory(browser, minutes) {
  const page = await open(browser, { viewport: PHONE, serviceWorkers: "block" });
  await loaded(page);
  const client = await page.context().newCDPSession(page);
  const session = await browser.newBrowserCDPSession();
  const { processInfo } = await session.send("SystemInfo.getProcessInfo");
  const renderer = processInfo.filter(({ type }) => type === "renderer").sort((a, b) => b.cpuTime - a.cpuTime)[0].id;
  const measure = async () => {
    await client.send("HeapProfiler.collectGarbage");
    const heap = await page.evaluate(() => performance.memory.usedJSHeapSize);
    const resident = /VmRSS:\s+(\d+)/.exec(fs.readFileSync(`/proc/${renderer}/status`, "utf8"))[1];
    return [heap / 2 ** 20, resident / 1024];
  };
  await page.evaluate(() => {
    window.fed = 0;
    const source = { time: 0, close() {}, begin(take) { this.take = take; } };
    window.feed = async (seconds) => {
      for (let i = 0; i < 10 * seconds; i++) {
        source.take(Float32Array.from({ length: 1600 }, (_, k) => 0.2 * Math.sin(k * 0.05 * (1 + Math.sin(fed))) * Math.sin(fed + k / 9000)));
        await site.run.work;
        fed += 0.1;
        source.time = fed;
      }
    };
    return site.listen(async () => source);
  });
  const begin = Date.now();
  seen.memory = [];
  for (let minute = 1; minute <= minutes; minute++) {
    await page.evaluate(() => feed(60));
    seen.memory.push(await measure());
  }
  seen.liveFactor = (60000 * minutes) / (Date.now() - begin);
  seen.liveFrames = await page.evaluate(() => site.model.figure.last + 1);
  await page.context().close();
}

async function main() {
  await host.start();
  fs.mkdirSync(at("saved"), { recursive: true });
  const browser = await chromium.launch({
    executablePath,
    args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--use-fake-device-for-media-stream",
      `--use-file-for-fake-audio-capture=${at("speech.wav")}`, "--autoplay-policy=no-user-gesture-required",
      "--enable-precise-memory-info"],
  });
  const scenes = { files, avatars, hostile, live, keyboard, offline, memory: (browser) => memory(browser, 10) };
  for (const name of (process.env.HA2G_SCENES || Object.keys(scenes).join()).split(",")) await scenes[name](browser);
  await browser.close();
  host.server.close();
  seen.origin = host.origin;
  console.log(JSON.stringify(seen));
}

main().catch((error) => { console.error(error); process.exit(1); });
