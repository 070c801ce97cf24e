// Compiles each contract of this folder into its artefact, or checks that the committed artefacts are what the sources
// give.
//   node compile.mjs [--check] SOLC [MORE_SOLC ...]
// SOLC is the folder of the npm module solc 0.7.6, whose output is the artefact; each further one
// (the newest 0.8) must compile the source without an error or a warning, its advice against
// old EVM versions aside: private networks are old.
import { createHash } from "node:crypto";
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { basename, dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const HERE = dirname(fileURLToPath(import.meta.url));
const CONTRACTS = ["AuthROS", "bench/Prototype"];
const DEPRECATED = /Support for EVM versions older than \w+ is deprecated/;
const SETTINGS = {
  evmVersion: "istanbul",
  metadata: { bytecodeHash: "none" },
  optimizer: { enabled: true, runs: 200 },
};

function compile(folder, name, source) {
  const solc = createRequire(import.meta.url)(resolve(folder));
  const outputSelection = { "*": { "*": ["abi", "evm.bytecode.object", "evm.deployedBytecode.object", "metadata"] } };
  const input = {
    language: "Solidity",
    sources: { [`${name}.sol`]: { content: source } },
    settings: { ...SETTINGS, outputSelection },
  };
  const output = JSON.parse(solc.compile(JSON.stringify(input)));
  const complaints = (output.errors ?? []).map((error) => error.formattedMessage).filter((text) => !DEPRECATED.test(text));
  if (complaints.length > 0) throw new Error(`solc ${solc.version()}:\n${complaints.join("\n")}`);
  return { version: solc.version(), contract: output.contracts[`${name}.sol`][name] };
}

const sha256 = (bytes) => createHash("sha256").update(bytes).digest("hex");

function artefact(folder, name, source) {
  const { version, contract } = compile(folder, name, source);
  const { bytecode, deployedBytecode } = contract.evm;
  return {
    contractName: name,
    compiler: version.replace(/\.Emscripten.*$/, ""),
    settings: SETTINGS,
    source: {
      file: `${name}.sol`,
      sha256: sha256(source),
      keccak256: JSON.parse(contract.metadata).sources[`${name}.sol`].keccak256.slice(2),
    },
    bytecodeSha256: sha256(Buffer.from(bytecode.object, "hex")),
    deployedBytecodeSha256: sha256(Buffer.from(deployedBytecode.object, "hex")),
    abi: contract.abi,
    bytecode: `0x${bytecode.object}`,
    deployedBytecode: `0x${deployedBytecode.object}`,
  };
}

/** Writes or checks one artefact; returns whether it is as it should be. */
function settle(path, check, first, more) {
  const name = basename(path);
  const file = join(HERE, `${path}.json`);
  const source = readFileSync(join(HERE, `${path}.sol`), "utf8");
  const text = `${JSON.stringify(artefact(first, name, source), null, 1)}\n`;
  for (const folder of more) console.error(`${path}.sol also compiles with ${compile(folder, name, source).version}`);
  if (!check) writeFileSync(file, text);
  else if (readFileSync(file, "utf8") !== text) {
    console.error(`${path}.json is not what ${path}.sol compiles to; run compile.mjs without --check`);
    return false;
  }
  return true;
}

const words = process.argv.slice(2);
const check = words[0] === "--check";
const [first, ...more] = check ? words.slice(1) : words;
if (first === undefined) {
  console.error("usage: node compile.mjs [--check] SOLC [MORE_SOLC ...]   (folders of solc npm modules)");
  process.exit(2);
}
if (!CONTRACTS.map((path) => settle(path, check, first, more)).every(Boolean)) process.exit(1);
