// The built page: the same bytes wherever it is built, and nothing in it that loads or runs anything else.

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, symlinkSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { test } from "node:test";
import { page } from "../build.js";

const ROOT = fileURLToPath(new URL("../../..", import.meta.url));
const EVIDENCE = "crates/evidence/src";
const digest = (text) => `'sha256-${createHash("sha256").update(text).digest("base64")}'`;

test("two builds in different folders are identical to the byte", async () => {
  const folder = mkdtempSync(join(tmpdir(), "page-"));
  try {
    for (const part of ["build.js", "package.json", "source"]) {
      cpSync(join(ROOT, "tools/verify-page", part), join(folder, "tools/verify-page", part), { recursive: true });
    }
    for (const part of ["VERIFY.txt", "verdict/sentences.json"])
      cpSync(join(ROOT, EVIDENCE, part), join(folder, EVIDENCE, part));
    mkdirSync(join(folder, "elsewhere"));
    symlinkSync(join(ROOT, "tools/verify-page/node_modules"), join(folder, "tools/verify-page/node_modules"));
    execFileSync("node", [join(folder, "tools/verify-page/build.js"), join(folder, "elsewhere/verify.html")]);
    assert.equal(readFileSync(join(folder, "elsewhere/verify.html"), "utf8"), await page());
  } finally {
    rmSync(folder, { recursive: true });
  }
});

test("the page's policy allows its own script and style alone", async () => {
  const html = await page();
  const [, policy] = /Content-Security-Policy" content="([^"]*)"/.exec(html);
  const [[, style], ...styles] = [...html.matchAll(/<style>([^]*?)<\/style>/g)];
  const [[, script], ...scripts] = [...html.matchAll(/<script>([^]*?)<\/script>/g)];
  assert.deepEqual([styles.length, scripts.length], [0, 0]);
  assert.equal(
    policy,
    `default-src 'none'; script-src ${digest(script)}; style-src ${digest(style)}; worker-src blob:; base-uri 'none'; ` +
      "form-action 'none'; require-trusted-types-for 'script'; trusted-types authros",
  );
  assert.ok(
    !/ (src|href|on[a-z]+|style)=/.test(html.replace(script, "")),
    "nothing is loaded, and nothing runs inline",
  );
  for (const word of [
    "innerHTML",
    "outerHTML",
    "insertAdjacentHTML",
    "document.write",
    "eval(",
    "fetch(",
    "XMLHttpRequest",
    "WebSocket",
    "importScripts",
  ]) {
    assert.ok(!script.includes(word), word);
  }
});
