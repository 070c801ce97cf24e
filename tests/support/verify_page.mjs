// verify.html in a headless Chromium without a network, driven through its debugging pipe:
//   node verify_page.mjs PAGE < CASES
// CASES is a list of { bundle, trust, drop, picture, paper, pdf, dark }, the files by their paths. Answers on stdout with what the page
// came to in each case, how long it took, and what else happened in it.

import { spawn, spawnSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const PROGRAMS = ["chromium", "chromium-browser", "google-chrome"];
const PATIENCE = 600_000;

/** Commands and events as JSON, each with a zero behind it, through descriptors 3 and 4. */
class Browser {
  waiting = new Map();
  events = [];
  number = 0;

  constructor(program, profile) {
    const options = [
      "--headless=new",
      "--no-sandbox",
      "--no-first-run",
      "--disable-gpu",
      "--disable-extensions",
      "--disable-sync",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-dev-shm-usage",
      "--mute-audio",
      "--remote-debugging-pipe",
      `--user-data-dir=${profile}`,
      "about:blank",
    ];
    // Without a network of any kind, where this machine can do that.
    const isCut = spawnSync("unshare", ["-rn", "true"]).status === 0;
    const command = isCut ? ["unshare", "-rn", program, ...options] : [program, ...options];
    this.process = spawn(command[0], command.slice(1), { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
    let rest = "";
    this.process.stdio[4].setEncoding("utf8").on("data", (text) => {
      const parts = (rest + text).split("\0");
      rest = parts.pop();
      parts.forEach((part) => this.hear(JSON.parse(part)));
    });
    this.ended = new Promise((resolve) => this.process.on("exit", resolve));
    this.ended.then((code) => {
      for (const { reject } of this.waiting.values()) reject(new Error(`Chromium ended with ${code}`));
    });
  }

  hear(told) {
    if (told.id === undefined) return void this.events.push(told);
    const { resolve, reject } = this.waiting.get(told.id);
    this.waiting.delete(told.id);
    if (told.error) reject(new Error(told.error.message));
    else resolve(told.result);
  }

  ask(method, params = {}) {
    const id = ++this.number;
    const asked = new Promise((resolve, reject) => this.waiting.set(id, { resolve, reject }));
    this.process.stdio[3].write(`${JSON.stringify({ id, method, params, sessionId: this.session })}\0`);
    return asked;
  }

  async open() {
    const { targetId } = await this.ask("Target.createTarget", { url: "about:blank" });
    this.session = (await this.ask("Target.attachToTarget", { targetId, flatten: true })).sessionId;
    for (const domain of ["Page", "Runtime", "Network", "Log", "DOM"]) await this.ask(`${domain}.enable`);
    const none = { offline: true, latency: 0, downloadThroughput: 0, uploadThroughput: 0 };
    await this.ask("Network.emulateNetworkConditions", none);
  }

  /** All its processes end. */
  async close() {
    this.session = undefined;
    const late = setTimeout(() => this.process.kill("SIGKILL"), 10_000);
    await this.ask("Browser.close").catch(() => {});
    await this.ended;
    clearTimeout(late);
  }

  async value(expression) {
    const { result, exceptionDetails } = await this.ask("Runtime.evaluate", { expression, returnByValue: true });
    if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
    return result.value;
  }

  async until(expression, patience = PATIENCE) {
    for (const end = Date.now() + patience; Date.now() < end; await new Promise((resolve) => setTimeout(resolve, 10))) {
      const found = await this.value(expression);
      if (found) return found;
    }
    throw new Error(`waited in vain for ${expression}`);
  }
}

/** Notes the longest time in which the page could not run, and when it first said something. */
const WATCH = `
  globalThis.watched = { begun: performance.now(), frozen: 0, first: undefined };
  (() => {
    let last = performance.now();
    setInterval(() => {
      const now = performance.now();
      watched.frozen = Math.max(watched.frozen, now - last);
      last = now;
      const text = document.getElementById("so-far").textContent + document.getElementById("sentences").textContent;
      if (text && watched.first === undefined) watched.first = now - watched.begun;
    }, 10);
  })()`;

async function choose(browser, selector, file) {
  const { root } = await browser.ask("DOM.getDocument");
  const { nodeId } = await browser.ask("DOM.querySelector", { nodeId: root.nodeId, selector });
  await browser.ask("DOM.setFileInputFiles", { nodeId, files: [file] });
}

async function drop(browser, files) {
  const data = { items: [], files, dragOperationsMask: 1 };
  for (const type of ["dragEnter", "dragOver", "drop"]) {
    await browser.ask("Input.dispatchDragEvent", { type, x: 200, y: 200, data });
  }
}

async function judge(browser, page, { bundle, trust, drop: isDropped, picture, paper, pdf, dark }) {
  browser.events.length = 0;
  const scheme = { name: "prefers-color-scheme", value: dark ? "dark" : "light" };
  await browser.ask("Emulation.setEmulatedMedia", { features: [scheme] });
  await browser.ask("Emulation.setDeviceMetricsOverride", {
    width: 1000,
    height: 1000,
    deviceScaleFactor: 1,
    mobile: false,
  });
  await browser.ask("Page.navigate", { url: `${pathToFileURL(page)}` });
  await browser.until("document.readyState === 'complete' && location.protocol === 'file:'", 30_000);
  await browser.value(WATCH);
  if (isDropped) await drop(browser, [bundle, trust].filter(Boolean));
  else {
    if (trust) await choose(browser, "#pins", trust);
    await choose(browser, "#bundle", bundle);
  }
  const told = JSON.parse(await browser.until("globalThis.verdict && JSON.stringify(verdict)"));
  await browser.value("new Promise(requestAnimationFrame)");
  const found = {
    ...told,
    milliseconds: await browser.value("Math.round(performance.now() - watched.begun)"),
    first_after: await browser.value("Math.round(watched.first ?? performance.now() - watched.begun)"),
    frozen: await browser.value("Math.round(watched.frozen)"),
    shown: await browser.value("[...document.querySelectorAll('#sentences p')].map((one) => one.textContent)"),
    scripts: await browser.value("document.scripts.length"),
    foreign: await browser.value("document.querySelectorAll('img, svg, iframe, object, a, link').length"),
    executed: await browser.value("globalThis.executed ?? null"),
    loaded: browser.events
      .filter((one) => one.method === "Network.requestWillBeSent")
      .map((one) => one.params.request.url),
    complaints: browser.events.filter((one) => one.method === "Log.entryAdded").map((one) => one.params.entry.text),
  };
  if (picture) {
    const made = await browser.ask("Page.captureScreenshot", { captureBeyondViewport: true });
    writeFileSync(picture, Buffer.from(made.data, "base64"));
  }
  if (paper) {
    await browser.ask("Emulation.setEmulatedMedia", { media: "print", features: [scheme] });
    await browser.ask("Emulation.setDeviceMetricsOverride", {
      width: 794,
      height: 1123,
      deviceScaleFactor: 1,
      mobile: false,
    });
    const made = await browser.ask("Page.captureScreenshot", { captureBeyondViewport: true });
    writeFileSync(paper, Buffer.from(made.data, "base64"));
    await browser.ask("Emulation.setEmulatedMedia", { media: "", features: [scheme] });
  }
  if (pdf) {
    const made = await browser.ask("Page.printToPDF", { preferCSSPageSize: true });
    writeFileSync(pdf, Buffer.from(made.data, "base64"));
  }
  return found;
}

function program() {
  const folders = process.env.PATH.split(":");
  const found = PROGRAMS.flatMap((name) => folders.map((folder) => join(folder, name))).find(existsSync);
  if (!found) throw new Error("there is no Chromium");
  return found;
}

const profile = mkdtempSync(join(tmpdir(), "verify-page-"));
const browser = new Browser(program(), profile);
try {
  await browser.open();
  const found = [];
  for (const one of JSON.parse(readFileSync(0, "utf8"))) found.push(await judge(browser, process.argv[2], one));
  console.log(JSON.stringify(found));
} finally {
  await browser.close();
  rmSync(profile, { recursive: true, force: true, maxRetries: 20, retryDelay: 50 });
}
