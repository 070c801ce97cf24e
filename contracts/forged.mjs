// Checks forge's results with solc 0.7.6: it tested the artefact's code, and measured the gas in gas.txt.
//   node forged.mjs [--write] OUT GAS
// OUT is forge's folder of compiled contracts, GAS its folder of gas snapshots; --write rewrites gas.txt.
import { existsSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const HERE = dirname(fileURLToPath(import.meta.url));
const TABLE = join(HERE, "gas.txt");
const NETWORKS = ["istanbul", "osaka"];
const HEAD = `Gas of each call as a transaction of its own: AuthROS.sol by solc 0.7.6, optimiser 200 runs, under the rules of
Istanbul (old private networks, the embedded chain) and Osaka (new ones). Made by test/Gas.t.sol; contracts/check
fails where it drifts, and contracts/check --update writes it anew. "Prototype" is bench/Prototype.sol, which
stores whole ciphertexts.
`;

const json = (...path) => JSON.parse(readFileSync(join(...path), "utf8"));

function sameCode(out, path, name) {
  const [committed, forged] = [json(HERE, path, `${name}.json`), json(out, `${name}.sol`, `${name}.json`)];
  return ["bytecode", "deployedBytecode"].every((part) => committed[part] === forged[part].object);
}

const row = (name, cells) => `${name.padEnd(52)}${cells.map((cell) => String(cell).padStart(10)).join("")}\n`;

/** Gas per record, and how many times less that is than an upload for each. */
function perRecord(measured) {
  const lines = NETWORKS.map((network) => ({ each: Number(measured[network].dataUpload), of: measured[network] }));
  const batches = Object.keys(lines[0].of).map((name) => /^anchor of (\d+) records?$/.exec(name)).filter(Boolean);
  batches.sort((left, right) => left[1] - right[1]);
  const share = ([name, count]) => lines.map(({ of }) => of[name] / count);
  const times = (batch) => share(batch).map((gas, index) => `${(lines[index].each / gas).toFixed(1)}x`);
  return [
    row("Per record", NETWORKS),
    row("dataUpload for each", lines.map(({ each }) => each)),
    ...batches.map((batch) => row(`anchor, batches of ${batch[1]}`, share(batch).map((gas) => gas.toFixed(1)))),
    ...batches.map((batch) => row(`  so many times less, batches of ${batch[1]}`, times(batch))),
  ];
}

function table(gas) {
  const measured = Object.fromEntries(NETWORKS.map((network) => [network, json(gas, `${network}.json`)]));
  const byNumber = new Intl.Collator("en", { numeric: true }).compare;
  const names = Object.keys(measured[NETWORKS[0]]).sort(byNumber);
  const calls = names.map((name) => row(name, NETWORKS.map((network) => measured[network][name])));
  return `${HEAD}\n${row("Per call", NETWORKS)}${calls.join("")}\n${perRecord(measured).join("")}`;
}

const words = process.argv.slice(2);
const write = words[0] === "--write";
const [out, gas] = write ? words.slice(1) : words;
if (gas === undefined) {
  console.error("usage: node forged.mjs [--write] OUT GAS");
  process.exit(2);
}
for (const [path, name] of [["", "AuthROS"], ["bench", "Prototype"]]) {
  if (sameCode(out, path, name)) continue;
  console.error(`the tests ran against another code than that of ${name}.json; run compile.mjs`);
  process.exitCode = 1;
}
const text = table(gas);
if (write) writeFileSync(TABLE, text);
const committed = existsSync(TABLE) ? readFileSync(TABLE, "utf8") : "";
if (committed !== text) {
  const old = new Set(committed.split("\n"));
  const changed = text.split("\n").filter((line) => !old.has(line));
  console.error(`gas.txt drifted; look whether that is meant, then run contracts/check --update. Now:\n${changed.join("\n")}`);
  process.exitCode = 1;
}
