#!/usr/bin/env node
// Makes an npm module of solc look like the native solc that forge and slither require.
//   AUTHROS_FORGE_SOLC=FOLDER solc.mjs --version | --standard-json
// FOLDER is the module's. Sources come in the JSON; nothing is read from disk.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";

const folder = process.env.AUTHROS_FORGE_SOLC;
if (folder === undefined) {
  console.error("solc.mjs: AUTHROS_FORGE_SOLC names no folder of the npm module solc");
  process.exit(2);
}
const solc = createRequire(import.meta.url)(resolve(folder));
if (process.argv.includes("--version")) {
  console.log("solc, the solidity compiler commandline interface");
  console.log(`Version: ${solc.version()}`);
} else if (process.argv.includes("--standard-json")) {
  process.stdout.write(solc.compile(readFileSync(0, "utf8")));
} else {
  console.error("solc.mjs: only --version and --standard-json are known");
  process.exit(2);
}
