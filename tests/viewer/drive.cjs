// Opens pages in a real browser, uses them as a person would and prints what was seen, as JSON.
// node drive.cjs CHROMIUM FOLDER   with two.html, silent.html and notebook.html in the folder
const path = require("path");
const { chromium } = require("playwright-core");
const [executablePath, folder] = process.argv.slice(2);
const PATIENCE = 240000;

async function open(browser, name, seen) {
  const page = await browser.newPage({ viewport: { width: 900, height: 640 }, colorScheme: "light" });
  page.setDefaultTimeout(PATIENCE);
  page.on("request", (request) => seen.requests.push(request.url()));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("console", (message) => { if (message.type() === "error") seen.errors.push(message.text()); });
  await page.goto(`file://${path.join(folder, name)}`);
  return page;
}

const isThere = () => window.viewer && window.viewer.drawnTime !== undefined;

async function showing(page, time) {
  await page.evaluate((at) => viewer.seek(at), time);
  await page.waitForFunction((at) => Math.abs(viewer.drawnTime - at) < 1e-3, time);
  return page.evaluate(() => viewer.shown());
}

async function press(page, key) {
  await page.keyboard.press(key);
  await page.waitForFunction(() => Math.abs(viewer.drawnTime - viewer.time) < 1e-4);
  return page.evaluate(() => [viewer.time, viewer.shown().figures[0].frame]);
}

async function main() {
  const seen = { requests: [], errors: [] };
  const browser = await chromium.launch({
    executablePath, args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  const page = await open(browser, "two.html", seen);
  await page.waitForFunction(isThere);

  seen.shown = [];
  for (const time of [0, 0.5, 1.01, 1.5, 1.96]) seen.shown.push(await showing(page, time));
  // The first loud sample of the sound as the browser decodes it.
  seen.click = await page.evaluate(async () => {
    const context = new OfflineAudioContext(1, 16000, 16000);
    const samples = (await context.decodeAudioData(bytesOf(viewer.content.sound).buffer)).getChannelData(0);
    return samples.findIndex((sample) => Math.abs(sample) > 0.2) / 16000;
  });

  await showing(page, 0.5);
  const wrist = await page.evaluate(() => viewer.stage.onScreen(1, "left_wrist"));
  await page.mouse.move(wrist.x, wrist.y);
  await page.waitForFunction(() => !document.querySelector(".tip").hidden);
  seen.hovered = await page.textContent(".tip span");
  await page.screenshot({ path: path.join(folder, "light.png") });
  await page.mouse.move(2, 2);
  await page.waitForFunction(() => document.querySelector(".tip").hidden);
  await page.keyboard.press("t");
  await page.keyboard.press("b");
  await page.waitForFunction(() => viewer.stage.hasSticks && !viewer.stage.isStale);
  await page.screenshot({ path: path.join(folder, "dark.png") });
  await page.keyboard.press("b");
  await page.focus("#bones");
  await page.keyboard.press("Space");
  seen.pressedBySpace = await page.evaluate(() => [viewer.stage.hasSticks, viewer.clock.isPlaying]);
  await page.keyboard.press("Space");
  await page.evaluate(() => document.activeElement.blur());

  // How far joints are from the edges of their parts of the page, in pixels, at any time: below 0 is outside.
  seen.inside = {};
  for (const [width, height] of [[1280, 800], [390, 844]]) {
    await page.setViewportSize({ width, height });
    await page.waitForFunction(([width]) => viewer.stage.holder.clientWidth === width && !viewer.stage.isStale, [width]);
    seen.inside[width] = await page.evaluate(() => {
      const { stage, motions } = viewer, room = [];
      for (let time = 0; time <= 2; time += 0.1) {
        motions.forEach((motion, i) => stage.bodies[i].pose(motion.positionsAt(time)));
        motions.forEach((motion, i) => motion.joints.forEach((name) => {
          const { x, y } = stage.onScreen(i, name), part = stage.parts[i];
          room.push(x - part.x, part.x + part.width - x, y - part.y, part.y + part.height - y);
        }));
      }
      return Math.min(...room);
    });
    await page.screenshot({ path: path.join(folder, `${width}.png`) });
  }
  await page.setViewportSize({ width: 900, height: 640 });

  seen.keys = {};
  for (const key of [".", ",", "ArrowRight", "End", "Home"]) seen.keys[key] = await press(page, key);
  seen.keys.faster = await press(page, "ArrowUp").then(() => page.evaluate(() => viewer.clock.audio.playbackRate));
  await page.keyboard.press("ArrowDown");

  // Play, and note for each picture its time and that of the sound.
  await page.evaluate(() => {
    const draw = viewer.stage.draw.bind(viewer.stage);
    window.drawn = [];
    viewer.stage.draw = (time, isSmooth) => {
      window.drawn.push([time, viewer.clock.audio.currentTime]);
      draw(time, isSmooth);
    };
  });
  await page.keyboard.press("Space");
  await page.waitForFunction(() => viewer.time > 0.8);
  seen.wasPlaying = await page.evaluate(() => viewer.clock.isPlaying || viewer.clock.hasEnded);
  await page.waitForFunction(() => viewer.clock.hasEnded && viewer.drawnTime === viewer.time);
  seen.drawn = await page.evaluate(() => window.drawn);
  await page.close();

  const silent = await open(browser, "silent.html", seen);
  await silent.waitForFunction(isThere);
  await silent.keyboard.press("Space");
  await silent.waitForFunction(() => viewer.clock.hasEnded && viewer.drawnTime === viewer.duration);
  seen.silentEnd = await silent.evaluate(() => viewer.shown());
  seen.silentLoop = await silent.evaluate(async () => {
    viewer.pause();
    viewer.isLooping = true;
    viewer.seek(viewer.duration);
    await new Promise((done) => setTimeout(done, 300));
    return [viewer.clock.isPlaying, viewer.time];
  });
  seen.stepsAfterEnd = await silent.evaluate(() => {  // as beside a longer motion
    viewer.duration = viewer.clock.duration = 8;
    viewer.seek(7);
    return [1, -1].map((frames) => { viewer.step(frames); return viewer.time; });
  });
  await silent.close();

  const notebook = await open(browser, "notebook.html", seen);
  const frame = await (await notebook.waitForSelector("iframe")).contentFrame();
  await frame.waitForFunction(isThere);
  seen.inNotebook = await frame.evaluate(() => viewer.shown());
  await browser.close();
  console.log(JSON.stringify(seen));
}

main().catch((error) => { console.error(error); process.exit(1); });
