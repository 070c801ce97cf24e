// What the reader knows from another source than the bundle: the pins of a trust file.

import { parse } from "smol-toml";
import { hex, text } from "./bytes.js";
import { Certificate } from "./certificate.js";
import { clean } from "./display.js";
import { twoThirds } from "./header.js";
import * as json from "./json.js";
import { Broken } from "./outcome.js";

export const LONGEST_TRUST = 65_536;
const MOST_AUTHORITIES = 16;
const LARGEST = 1n << 63n;

/** A trust file that cannot be used; the bundle is not checked then. */
export class TrustError extends Error {}

const below63 = (value) => {
  const number = json.whole(value);
  if (number >= LARGEST) throw new SyntaxError("too large a number");
  return number;
};
const bool = (value) => {
  if (typeof value !== "boolean") throw new SyntaxError("neither true nor false");
  return value;
};
const CHAIN = json.lines(
  {
    id: below63,
    genesis: json.hash(32),
    contract: json.account,
    code_hash: json.hash(32),
    signers: json.listOf(json.account),
    sealed_by_exporter: bool,
  },
  { quorum: below63 },
);
const PERSON = json.lines({ account: json.account, name: json.string }, { key: json.hash(32) });
const AUTHORITY = json.lines({ name: json.string, certificate: json.string });
const TRUST = json.lines({ chain: CHAIN }, { person: json.listOf(PERSON), authority: json.listOf(AUTHORITY) });

/** Tables as maps, as the forms of JSON expect them; dates and fractions stay what no form accepts. */
function mapped(value) {
  if (Array.isArray(value)) return value.map(mapped);
  const isTable = typeof value === "object" && value !== null && Object.getPrototypeOf(value) === null;
  if (isTable) return new Map(Object.entries(value).map(([name, one]) => [name, mapped(one)]));
  return value;
}

function readForm(bytes) {
  const source = bytes.length <= LONGEST_TRUST ? text(bytes) : undefined;
  if (source === undefined) throw new TrustError("it is not text, or too long");
  const plain = source.replace(/^\ufeff/, "");
  // The library would skip a second one.
  if (plain.startsWith("\ufeff")) throw new TrustError("it begins with two byte order marks");
  try {
    const told = mapped(parse(plain, { integersAsBigInt: true, maxDepth: 128 }));
    if (told.has("version")) throw new SyntaxError("it is of a later version than this page reads; use a newer page");
    return TRUST(told);
  } catch (error) {
    throw new TrustError(clean(String(error.message).split("\n")[0], 300));
  }
}

function certificateOf(authority) {
  try {
    return { name: clean(authority.name, 80), certificate: Certificate.ofPem(authority.certificate) };
  } catch (error) {
    if (!(error instanceof Broken)) throw error;
    throw new TrustError(`the certificate of the authority '${clean(authority.name, 80)}' cannot be read`);
  }
}

export class Trust {
  /** From the bytes of a trust file; throws `TrustError`. */
  constructor(bytes) {
    const { chain, person = [], authority = [] } = readForm(bytes);
    const isTwice = (ones) => new Set(ones).size !== ones.length;
    this.chain = chain;
    this.persons = person;
    this.signers = chain.signers.map(hex);
    if (isTwice(this.signers)) throw new TrustError("a signer is named twice");
    if (isTwice(person.map((one) => hex(one.account)))) throw new TrustError("an account is given to two people");
    if (authority.length > MOST_AUTHORITIES) throw new TrustError(`it names more than ${MOST_AUTHORITIES} authorities`);
    this.authorities = authority.map(certificateOf);
    const { quorum } = chain;
    if (quorum !== undefined && (quorum === 0n || quorum > this.signers.length)) {
      throw new TrustError("its quorum is zero, or more than the number of signers");
    }
  }

  /** How many signers, of whom each seals a block of its own (Clique). */
  quorum() {
    return Number(this.chain.quorum ?? Math.floor(this.signers.length / 2) + 1);
  }

  /** How many signers in one header (QBFT, IBFT 2.0). */
  commitQuorum() {
    return Number(this.chain.quorum ?? Math.max(1, twoThirds(this.signers.length)));
  }

  person(account) {
    const name = hex(account);
    return this.persons.find((one) => hex(one.account) === name);
  }
}
