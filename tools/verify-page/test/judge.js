// What the page's thread says of bundles, without a browser: `node judge.js < CASES`, a list of { bundle, trust } by their
// paths; answers with a list of reports, or of what is wrong with the trust files.

import { readFileSync } from "node:fs";
import { webcrypto } from "node:crypto";
import { fileURLToPath } from "node:url";

globalThis.crypto ??= webcrypto;
const readMe = new URL("../../../crates/evidence/src/VERIFY.txt", import.meta.url);
globalThis.READ_ME = readFileSync(fileURLToPath(readMe), "utf8");
const { judge } = await import("../source/worker.js");

const file = (path) => new Blob([readFileSync(path)]);
const found = [];
for (const { bundle, trust } of JSON.parse(readFileSync(0, "utf8"))) {
  found.push(await judge(file(bundle), trust && file(trust), () => {}));
}
console.log(JSON.stringify(found));
