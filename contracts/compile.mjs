// Compiles AuthROS.sol into AuthROS.json, or checks that the committed file is what the source gives.
//   node compile.mjs [--check] SOLC [MORE_SOLC ...]
// SOLC is the folder of the npm module solc 0.7.6, whose output is the artefact; each further one
// (the newest 0.8) must compile the source without an error or a warning, its advice against
// old EVM versions aside: private networks are old.
import { createHash } from "node:crypto";
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const NAME = "AuthROS";
const HERE = dirname(fileURLToPath(import.meta.url));
const ARTEFACT = join(HERE, `${NAME}.json`);
const DEPRECATED = /Support for EVM versions older than \w+ is deprecated/;
const SETTINGS = {
  evmVersion: "istanbul",
  metadata: { bytecodeHash: "none" },
  optimizer: { enabled: true, runs: 200 },
};

function compile(folder, source) {
  const solc = createRequire(import.meta.url)(resolve(folder));
  const outputSelection = { "*": { "*": ["abi", "evm.bytecode.object", "evm.deployedBytecode.object", "metadata"] } };
  const input = {
    language: "Solidity",
    sources: { [`${NAME}.sol`]: { content: source } },
    settings: { ...SETTINGS, outputSelection },
  };
  const output = JSON.parse(solc.compile(JSON.stringify(input)));
  const complaints = (output.errors ?? []).map((error) => error.formattedMessage).filter((text) => !DEPRECATED.test(text));
  if (complaints.length > 0) throw new Error(`solc ${solc.version()}:\n${complaints.join("\n")}`);
  return { version: solc.version(), contract: output.contracts[`${NAME}.sol`][NAME] };
}

const sha256 = (bytes) => createHash("sha256").update(bytes).digest("hex");

function artefact(folder, source) {
  const { version, contract } = compile(folder, source);
  const { bytecode, deployedBytecode } = contract.evm;
  return {
    contractName: NAME,
    compiler: version.replace(/\.Emscripten.*$/, ""),
    settings: SETTINGS,
    source: {
      file: `${NAME}.sol`,
      sha256: sha256(source),
      keccak256: JSON.parse(contract.metadata).sources[`${NAME}.sol`].keccak256.slice(2),
    },
    bytecodeSha256: sha256(Buffer.from(bytecode.object, "hex")),
    deployedBytecodeSha256: sha256(Buffer.from(deployedBytecode.object, "hex")),
    abi: contract.abi,
    bytecode: `0x${bytecode.object}`,
    deployedBytecode: `0x${deployedBytecode.object}`,
  };
}

const words = process.argv.slice(2);
const check = words[0] === "--check";
const [first, ...more] = check ? words.slice(1) : words;
if (first === undefined) {
  console.error("usage: node compile.mjs [--check] SOLC [MORE_SOLC ...]   (folders of solc npm modules)");
  process.exit(2);
}
const source = readFileSync(join(HERE, `${NAME}.sol`), "utf8");
const text = `${JSON.stringify(artefact(first, source), null, 1)}\n`;
for (const folder of more) console.error(`also compiles with ${compile(folder, source).version}`);
if (!check) {
  writeFileSync(ARTEFACT, text);
} else if (readFileSync(ARTEFACT, "utf8") !== text) {
  console.error(`${NAME}.json is not what ${NAME}.sol compiles to; run compile.mjs without --check`);
  process.exit(1);
}
