// Builds verify.html: `npm run build [-- FILE]`. The same sources give the same bytes; prints their SHA-256.

import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const HERE = dirname(fileURLToPath(import.meta.url));
const TARGET = join(HERE, "../../target/verify.html");
const LICENCES = ["@noble/curves", "@noble/hashes", "smol-toml"];

const options = {
  bundle: true,
  charset: "ascii",
  format: "iife",
  legalComments: "none",
  logLevel: "warning",
  minify: true,
  target: "es2022",
  write: false,
};

async function bundled(entry, define = {}) {
  const built = await build({ ...options, define, entryPoints: [join(HERE, "source", entry)] });
  return built.outputFiles[0].text.trim();
}

const source = (name) => readFileSync(join(HERE, "source", name), "utf8");
const digest = (text) => `'sha256-${createHash("sha256").update(text).digest("base64")}'`;

function licences() {
  const texts = LICENCES.map((name) => `${name}\n${readFileSync(join(HERE, "node_modules", name, "LICENSE"), "utf8")}`);
  return `<!--\nThis page contains:\n\n${texts.join("\n").replaceAll("--", "- -")}-->\n`;
}

/** The page's bytes. */
export async function page() {
  const readMe = readFileSync(join(HERE, "../../crates/evidence/src/VERIFY.txt"), "utf8");
  const worker = await bundled("worker.js", { READ_ME: JSON.stringify(readMe) });
  // Inside a script, nothing may look like its end.
  const script = (await bundled("page.js", { WORKER: JSON.stringify(worker) })).replaceAll("</script", "<\\/script");
  const style = source("page.css").trim();
  const policy = [
    "default-src 'none'",
    `script-src ${digest(script)}`,
    `style-src ${digest(style)}`,
    "worker-src blob:",
    "base-uri 'none'",
    "form-action 'none'",
    "require-trusted-types-for 'script'",
    "trusted-types authros",
  ].join("; ");
  const parts = { POLICY: policy, STYLE: style, SCRIPT: script };
  const html = source("page.html").replace(/@([A-Z]+)@/g, (_, name) => parts[name]);
  return html.replace("</html>\n", `${licences()}</html>\n`);
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const file = resolve(process.argv[2] ?? TARGET);
  const bytes = Buffer.from(await page());
  mkdirSync(dirname(file), { recursive: true });
  writeFileSync(file, bytes);
  console.log(`${createHash("sha256").update(bytes).digest("hex")}  ${file}  ${bytes.length} bytes`);
}
