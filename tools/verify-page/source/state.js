// The state after a block as far as a bundle's nodes show it (Yellow Paper, appendices C and D), and the contract's storage.

import { keccak } from "./accounts.js";
import { equal, hex, isZero, numberBytes, padded, unhex } from "./bytes.js";
import { Broken, Missing } from "./outcome.js";
import { decode } from "./rlp.js";

const MOST_NODES = 1_000_000;
const LONGEST_NODE = 1024;
const EMPTY = unhex("56e81f171bcc55a6ff8345e692c0f86e5b48e01b996cadc001622fb5e363b421");

const nibblesOf = (bytes) => Array.from(bytes).flatMap((byte) => [byte >> 4, byte & 15]);

/** Nodes by the hex of their hashes; undefined if the list is not of its one form. */
export function parseNodes(bytes) {
  const items = decode(bytes)?.items;
  if (!items || items.length > MOST_NODES) return undefined;
  const nodes = new Map();
  let before = "";
  for (const item of items) {
    if (item.isList || item.bytes.length > LONGEST_NODE) return undefined;
    const hash = hex(keccak(item.bytes));
    if (hash <= before) return undefined;
    nodes.set(hash, item.bytes);
    before = hash;
  }
  return nodes;
}

/** What a node holds at a path: a value or nothing, or the node below and what is left of the path. */
function follow(node, path) {
  const items = node.items;
  let child;
  if (items?.length === 2) {
    const packed = items[0].bytes;
    if (!packed?.length || packed[0] >= 0x40) return undefined;
    const own = nibblesOf(packed).slice(packed[0] & 0x10 ? 1 : 2);
    if (own.some((nibble, at) => path[at] !== nibble)) return { value: undefined };
    path = path.slice(own.length);
    if (packed[0] & 0x20) return items[1].isList ? undefined : { value: path.length ? undefined : items[1].bytes };
    // An extension consumes at least one nibble: an empty one could form a loop.
    if (!own.length) return undefined;
    child = items[1];
  } else if (items?.length === 17) {
    if (!path.length) return { value: undefined };
    child = items[path[0]];
    path = path.slice(1);
  } else {
    return undefined;
  }
  if (child.isList) return follow(child, path);
  if (!child.bytes.length) return { value: undefined };
  return child.bytes.length === 32 ? { below: child.bytes, path } : undefined;
}

/** The value at a key, which is hashed as in every trie of a state; undefined if there is none. */
export function lookUp(nodes, root, key) {
  if (equal(root, EMPTY)) return undefined;
  let [hash, path] = [root, nibblesOf(keccak(key))];
  for (;;) {
    const bytes = nodes.get(hex(hash));
    if (!bytes) throw new Missing(`node ${hex(hash)}`);
    const node = decode(bytes);
    const step = node && follow(node, path);
    if (!step) throw new Broken(`node ${hex(hash)} is not a trie node`);
    if (!step.below) return step.value;
    [hash, path] = [step.below, step.path];
  }
}

const mapped = (key, below) => keccak(padded(key), padded(below));
const ofAccount = (account, mapping) => mapped(account, Uint8Array.of(mapping));

/** Slots of the contract (contracts/README.md). */
export const slots = {
  uploaded: (owner, digest) => mapped(digest, ofAccount(owner, 5)),
  anchor: (account, root) => mapped(root, ofAccount(account, 8)),
  loan: (owner, device) => mapped(device, ofAccount(owner, 9)),
  account: (account) => ofAccount(account, 10),
  keys: (owner, version) => mapped(numberBytes(version, 8), ofAccount(owner, 15)),
  next: (slot) => numberBytes((BigInt("0x" + hex(slot)) + 1n) % (1n << 256n), 32),
};

export class Storage {
  constructor(nodes, state, contract) {
    const account = lookUp(nodes, state, contract);
    if (!account) throw new Broken("the state has no contract at that address");
    const fields = decode(account)?.items;
    const [root, codeHash] = [fields?.[2]?.fixed(32), fields?.[3]?.fixed(32)];
    if (fields?.length !== 4 || !root || !codeHash) throw new Broken("what the state holds there is not an account");
    Object.assign(this, { nodes, root, codeHash, words: new Map() });
  }

  /** 32 bytes, zeros where nothing is stored. */
  word(slot) {
    const name = hex(slot);
    let word = this.words.get(name);
    if (!word) {
      const value = lookUp(this.nodes, this.root, slot);
      const bytes = value ? decode(value)?.bytes : new Uint8Array(0);
      if (!bytes || bytes.length > 32) throw new Broken("what the state holds there is not a word");
      word = padded(bytes);
      this.words.set(name, word);
    }
    return word;
  }

  /** Eight bytes of a word, from the low end. */
  number(slot, offset) {
    const word = this.word(slot);
    return BigInt("0x" + hex(word.subarray(24 - offset, 32 - offset)));
  }

  anchor(account, root) {
    const slot = slots.anchor(account, root);
    const [block, count, time, keys] = [0, 8, 16, 24].map((offset) => this.number(slot, offset));
    return block === 0n ? undefined : { block, count, time, keys };
  }

  uploaded(owner, digest) {
    const block = this.number(slots.uploaded(owner, digest), 0);
    return block === 0n ? undefined : block;
  }

  keys(owner, version) {
    const slot = slots.keys(owner, version);
    const identity = this.word(slot);
    return isZero(identity) ? undefined : { identity, block: this.number(slots.next(slot), 0) };
  }

  isSuspended(owner) {
    return this.word(slots.account(owner))[7] !== 0;
  }

  loan(owner, device) {
    const slot = slots.loan(owner, device);
    const [until, lent, recalled] = [1, 9, 17].map((offset) => this.number(slot, offset));
    return lent === 0n ? undefined : { until, lent, recalled };
  }
}
