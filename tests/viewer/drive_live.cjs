// Opens the live page in a real browser, uses it as a person would and prints what was seen, as JSON.
// node drive_live.cjs CHROMIUM FOLDER ADDRESSES
//   FOLDER has speech.wav, with a loud tone once; ADDRESSES are JSON: main, token, short, frames and secret.
const fs = require("fs");
const path = require("path");
const { chromium } = require("playwright-core");
const [executablePath, folder, addresses] = process.argv.slice(2);
const at = JSON.parse(addresses), speech = path.join(folder, "speech.wav");
const PATIENCE = 240000;
const SMALL = { width: 360, height: 480 }; // so that drawing without a graphics card leaves time for the rest
const WICKED = "<img src=x onerror=alert(1)>.wav";

async function open(browser, address, seen, options = {}) {
  const context = await browser.newContext({ viewport: SMALL, colorScheme: "light", ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE);
  page.on("request", (request) => seen.requests.push(request.url()));
  page.on("websocket", (socket) => {
    seen.requests.push(socket.url());
    socket.on("framesent", ({ payload }) => { if (typeof payload === "string") seen.texts.push(payload); });
  });
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("console", (message) => { if (/Content.Security/i.test(message.text())) seen.errors.push(message.text()); });
  await page.goto(address);
  await page.waitForFunction(() => window.live);
  return page;
}

const says = async (page, text) => {
  await page.waitForFunction((text) => document.querySelector("#status").textContent.includes(text), text);
  return page.textContent("#status");
};

// Notes for each image the time of the sound that leaves the loudspeaker, the delay and the frame in the image; for the
// frames that arrive and the sound that is sent, its end and the time. Notes also where the tone is in what is played.
function observe() {
  const { sound } = live.run, { context } = sound;
  const seen = window.seen = { drawn: [], arrived: [], sent: [], tone: null, rate: sound.rate };
  const wrap = (object, name, before, after) => {
    const call = object[name].bind(object);
    object[name] = (...given) => { const noted = before(...given), result = call(...given); after(noted); return result; };
  };
  wrap(live.stage, "draw", () => [sound.outputTime - sound.start, sound.delay], (noted) => {
    if (live.motion.shown !== null) seen.drawn.push([...noted, live.motion.shown]);
  });
  wrap(live, "take", (first, rows) => seen.arrived.push([first + rows.length - 1, context.currentTime - sound.start]), () => {});
  let samples = 0;
  wrap(live, "give", (pcm) => {
    if (pcm) seen.sent.push([(samples += pcm.byteLength / 2) / sound.rate, context.currentTime - sound.start]);
  }, () => {});
  const analyser = new AnalyserNode(context, { fftSize: 32768 }), values = new Float32Array(32768);
  sound.volume.connect(analyser);
  setInterval(() => {
    const now = context.currentTime;
    analyser.getFloatTimeDomainData(values);
    const place = values.findIndex((value) => Math.abs(value) > 0.6);
    if (place >= 0 && !seen.tone) seen.tone = now - (values.length - place) / sound.rate - sound.start;
  }, 100);
}

const running = () => live.run && live.run.conversation && live.motion.shown !== null;

async function refusals(browser, seen) {
  const full = await open(browser, at.main, seen, { permissions: ["microphone"] });
  await full.click("#microphone");
  seen.full = await says(full, "503");
  await full.context().close();

  const denied = await open(browser, at.token, seen);
  await denied.click("#microphone");
  seen.denied = await says(denied, "may not be used");
  await denied.fill("#token", "another token of some letters");
  await denied.setInputFiles("#picker", speech);
  seen.wrongToken = await says(denied, "401");
  await denied.fill("#token", at.secret);
  await denied.setInputFiles("#picker", { name: WICKED, mimeType: "audio/wav", buffer: fs.readFileSync(speech) });
  await denied.waitForFunction(running);
  seen.pictures = await denied.evaluate(() => document.querySelectorAll("img").length);
  await act(denied, seen);
  await denied.focus("#energy");
  await denied.keyboard.press("Escape");
  seen.stopped = await says(denied, "Stopped");
  await denied.setInputFiles("#picker", { name: "a.txt", mimeType: "text/plain", buffer: Buffer.from("no sound") });
  seen.noSound = await says(denied, "no sound");
  await denied.context().close();

  const short = await open(browser, at.short, seen, { permissions: ["microphone"] });
  await short.focus("#microphone");
  await short.keyboard.press("Enter");
  seen.ended = await says(short, "has ended");
  seen.buttons = await short.isVisible("#file") && !(await short.isVisible("#stop"));
  await short.context().close();
}

// States, whose voice it is, cues and an interruption, with keys alone; frames go on to come.
async function act(page, seen) {
  await page.focus("#energy");
  for (const name of ["Think", "Wave"]) {
    for (let i = 0; i < 40 && (await page.evaluate(() => document.activeElement.textContent)) !== name; i++) await page.keyboard.press("Tab");
    await page.keyboard.press("Enter");
  }
  for (const key of "li") await page.keyboard.press(key);
  const last = await page.evaluate(() => live.motion.last);
  await page.waitForFunction((last) => live.motion.last > last + 10, last);
  seen.pressed = await page.evaluate(() => [...document.querySelectorAll("#acting [aria-pressed=true]")].map((button) => button.textContent));
  seen.named = await page.textContent("#status");
}

async function watch(browser, seen) {
  const page = await open(browser, at.frames, seen);
  seen.bonesBefore = await page.evaluate(() => {
    if (!live.stage) document.querySelector("#bones").click();
    return document.querySelector("#bones").getAttribute("aria-pressed");
  });
  await page.waitForFunction(() => live.motion && live.motion.shown > 20);
  seen.watched = await page.evaluate(() => new Promise((resolve) => {
    const draw = live.stage.draw.bind(live.stage), watched = [];
    live.stage.draw = (number) => {
      const wasEasing = live.motion.isEasing; // a drawing may take longer than the ease
      draw(number, true);
      if (wasEasing) return;
      const joints = Object.fromEntries(live.motion.joints.map((name) => [name, live.stage.bodies[0].joint(name).toArray()]));
      watched.push({ shown: live.motion.shown, joints });
      if (watched.length === 10) resolve(watched);
    };
  }));
  seen.watchButtons = await page.isVisible("#microphone");
  await page.context().close();
}

async function main() {
  const seen = { requests: [], errors: [], texts: [] };
  const browser = await chromium.launch({
    executablePath,
    args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--use-fake-device-for-media-stream",
      `--use-file-for-fake-audio-capture=${speech}`, "--autoplay-policy=no-user-gesture-required"],
  });
  const file = await open(browser, at.main, seen), microphone = await open(browser, at.main, seen, { permissions: ["microphone"] });
  await file.setInputFiles("#picker", speech);
  await microphone.click("#microphone");
  for (const page of [file, microphone]) {
    await page.waitForFunction(running);
    await page.evaluate(observe);
  }
  await refusals(browser, seen);
  await watch(browser, seen);
  await says(file, "The sound has ended");
  await microphone.waitForFunction(() => !live.run || live.motion.last > 65 * live.motion.fps);
  seen.listening = await microphone.textContent("#status");
  seen.file = await file.evaluate(() => window.seen);
  seen.microphone = await microphone.evaluate(() => window.seen);
  for (const [name, width, height, colorScheme] of [["wide", 1100, 700, "light"], ["phone", 390, 780, "dark"]]) {
    await microphone.emulateMedia({ colorScheme });
    await microphone.setViewportSize({ width, height });
    await microphone.waitForTimeout(500);
    await microphone.screenshot({ path: path.join(folder, `${name}.png`) });
    seen[name] = await microphone.evaluate(() => {
      const parts = [...document.querySelectorAll("#bar > :not([hidden])")].map((part) => part.getBoundingClientRect());
      return [document.documentElement.scrollWidth, innerWidth, innerHeight - Math.max(...parts.map((part) => part.bottom))];
    });
  }
  await browser.close();
  console.log(JSON.stringify(seen));
}

main().catch((error) => { console.error(error); process.exit(1); });
