// Poses an avatar in a real browser by examples/agents/avatar.js, and prints the errors of the page, as JSON.
// node drive_avatars.cjs CHROMIUM FILE SOURCE SINK
//   FILE is avatar.vrm, for three-vrm, or avatar.glb, for TalkingHead; pictures are written beside it.
const fs = require("fs");
const http = require("http");
const path = require("path");
const { chromium } = require("playwright-core");
const { buildSync } = require("esbuild");
const [executablePath, avatar, source, sink] = process.argv.slice(2);
const SIZE = { width: 240, height: 240 }; // so that drawing without a graphics card leaves time for the rest
const kind = path.extname(avatar);
const RECIPE = path.resolve(__dirname, "../../../examples/agents/avatar.js");

const PAGES = {
  ".vrm": `
    import { AmbientLight, PerspectiveCamera, Scene, WebGLRenderer } from "three";
    import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
    import { VRMLoaderPlugin } from "@pixiv/three-vrm";
    import { Body } from ${JSON.stringify(RECIPE)};
    const loader = new GLTFLoader();
    loader.register((parser) => new VRMLoaderPlugin(parser));
    const { vrm } = (await loader.loadAsync("avatar.vrm")).userData;
    const scene = new Scene().add(vrm.scene, new AmbientLight(0xffffff, 3));
    const camera = new PerspectiveCamera(30, 1, 0.1, 20);
    camera.position.set(0, 1.2, 3);
    const renderer = new WebGLRenderer();
    renderer.setSize(240, 240);
    renderer.setClearColor(0xdddddd);
    document.body.append(renderer.domElement);
    window.body = new Body(${JSON.stringify(source)}, ${JSON.stringify(sink)});
    window.bone = (name) => vrm.humanoid.getNormalizedBoneNode(name).quaternion.toArray();
    setInterval(() => {
      body.poseVrm(vrm);
      vrm.update(0.1);
      renderer.render(scene, camera);
    }, 100);`,
  ".glb": `
    import { TalkingHead } from "@met4citizen/talkinghead";
    import { Body } from ${JSON.stringify(RECIPE)};
    const node = document.body.appendChild(document.createElement("div"));
    node.style.cssText = "width: 240px; height: 240px";
    window.body = new Body(${JSON.stringify(source)}, ${JSON.stringify(sink)});
    const head = new TalkingHead(node, { lipsyncModules: [], modelFPS: 10, update: () => body.poseTalkingHead(head) });
    await head.showAvatar({ url: "avatar.glb" });
    window.bone = (name) => head.armature.getObjectByName(name).quaternion.toArray();`,
};

const ARMS = { ".vrm": ["leftUpperArm", "rightUpperArm"], ".glb": ["LeftArm", "RightArm"] };

(async () => {
  const entry = { contents: PAGES[kind], resolveDir: __dirname };
  const nodePaths = process.env.NODE_PATH.split(path.delimiter);
  const [{ text: script }] = buildSync({ stdin: entry, bundle: true, write: false, format: "esm", nodePaths }).outputFiles;
  const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--enable-unsafe-swiftshader"] });
  const page = await browser.newPage({ viewport: SIZE });
  const errors = [];
  let received = 0, pictures = 0;
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("websocket", (socket) => socket.on("framereceived", () => received++));
  const server = http.createServer((request, response) => {
    const name = path.basename(request.url);
    const isPage = !name, isScript = name === "main.js";
    response.setHeader("Content-Type", isPage ? "text/html" : isScript ? "text/javascript" : "model/gltf-binary");
    response.end(isPage ? '<body style="margin:0"><script type="module" src="main.js"></script>' : isScript ? script : fs.readFileSync(avatar));
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  await page.waitForFunction(() => window.bone);

  const arms = () => page.evaluate((names) => names.map(bone), ARMS[kind]);
  // Waits until the arms are, or are no longer, within about ten degrees of where they were.
  const arrive = async (before, isNear) => {
    await page.waitForFunction(([names, before, isNear]) => {
      const cosines = names.map((name, arm) => Math.abs(bone(name).reduce((sum, value, k) => sum + value * before[arm][k], 0)));
      return (Math.min(...cosines) > 0.996) === isNear;
    }, [ARMS[kind], before, isNear], { timeout: 60000 });
    await page.waitForTimeout(500);
    await page.screenshot({ path: `${avatar}.${++pictures}.png` });
    return arms();
  };
  for (const end = Date.now() + 60000; received < 3 && Date.now() < end; ) await page.waitForTimeout(100); // frames
  await page.waitForTimeout(500);
  const idle = await arms();
  await page.evaluate(() => [{ cue: "nod" }, { state: "think" }].forEach((message) => body.tell(message)));
  const thinking = await arrive(idle, false);
  await page.evaluate(() => {
    body.say(Int16Array.from({ length: 48000 }, (_, n) => 8000 * Math.sin(n / 9) * Math.sin(n / 900)));
  });
  await arrive(thinking, false);
  await page.evaluate(() => [{ clear: true }, { state: "idle" }].forEach((message) => body.tell(message)));
  await arrive(idle, true);
  await browser.close();
  server.close();
  console.log(JSON.stringify(errors));
})();
