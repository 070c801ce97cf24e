// Compiles each contract of this folder into its artefact, or checks that the committed artefacts match the sources.
//   node compile.mjs [--check] SOLC [MORE_SOLC ...]
// SOLC is the folder of the npm module solc 0.7.6, whose output is the artefact; each further one (the newest 0.8) must
// also compile the source. No compiler may give an error or a warning (except advice against old EVM versions: private
// networks are old) or an opcode that Istanbul lacks, and each function and event needs its NatSpec.
import { createHash } from "node:crypto";
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { basename, dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const HERE = dirname(fileURLToPath(import.meta.url));
const CONTRACTS = ["AuthROS", "bench/Prototype"];
const DEPRECATED = /Support for EVM versions older than \w+ is deprecated/;
const YOUNGER_THAN_ISTANBUL = /\b(PUSH0|MCOPY|TLOAD|TSTORE|BASEFEE|BLOBHASH|BLOBBASEFEE|PREVRANDAO|CLZ)\b/;
const OUTPUTS = ["abi", "userdoc", "devdoc", "metadata", "evm.bytecode", "evm.deployedBytecode"];
const SETTINGS = {
  evmVersion: "istanbul",
  metadata: { bytecodeHash: "none" },
  optimizer: { enabled: true, runs: 200 },
};

function compile(folder, name, source) {
  const solc = createRequire(import.meta.url)(resolve(folder));
  const outputSelection = { "*": { "*": OUTPUTS } };
  const input = {
    language: "Solidity",
    sources: { [`${name}.sol`]: { content: source } },
    settings: { ...SETTINGS, outputSelection },
  };
  const output = JSON.parse(solc.compile(JSON.stringify(input)));
  const complaints = (output.errors ?? []).map((error) => error.formattedMessage).filter((text) => !DEPRECATED.test(text));
  const contract = output.contracts?.[`${name}.sol`]?.[name];
  if (contract !== undefined) complaints.push(...youngOpcodes(contract), ...undocumented(contract));
  if (complaints.length > 0) throw new Error(`solc ${solc.version()}:\n${complaints.join("\n")}`);
  return { version: solc.version(), contract };
}

function youngOpcodes({ evm }) {
  const young = YOUNGER_THAN_ISTANBUL.exec(`${evm.bytecode.opcodes} ${evm.deployedBytecode.opcodes}`);
  return young === null ? [] : [`the code has ${young[1]}, which Istanbul lacks`];
}

/** What of the ABI lacks a notice, or a parameter of a function its description. */
function undocumented({ abi, userdoc, devdoc }) {
  const lacking = [];
  for (const entry of abi) {
    const signature = `${entry.name}(${(entry.inputs ?? []).map((input) => input.type).join(",")})`;
    if (entry.type === "event" && userdoc.events?.[signature] === undefined) lacking.push(`event ${signature}: no notice`);
    if (entry.type !== "function") continue;
    if (userdoc.methods[signature] === undefined) lacking.push(`${signature}: no notice`);
    const told = devdoc.methods[signature]?.params ?? {};
    for (const { name } of entry.inputs) if (name !== "" && told[name] === undefined) lacking.push(`${signature}: no ${name}`);
  }
  return lacking;
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
