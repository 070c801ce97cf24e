// Bundles made from docs/format.md, and each lie about them.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { test } from "node:test";
import { check } from "../source/check.js";
import { Malformed } from "../source/outcome.js";
import { shown } from "../source/report.js";
import { Trust, TrustError } from "../source/trust.js";
import { WORDING, wrapped } from "../source/wording.js";
import { Key } from "./sealing.js";
import { BLOCK, TIME, World, account, pack, sealRecord, signed, slot, trust, withManifest, word } from "./world.js";

const READ_ME = readFileSync(fileURLToPath(new URL("../../../crates/evidence/src/VERIFY.txt", import.meta.url)));

async function judge(file, pins = trust()) {
  return shown(await check(file, pins && new Trust(pins), { readMe: READ_ME }));
}

/** Outcome, standings of (a) to (e) of the first record, and the reasons of those that have one. */
async function told(world, pins) {
  const report = await judge(world.file(), pins);
  const [record] = report.records;
  const levels = ["bytes", "key", "anchor", "time", "opened"].map((name) => record[name]);
  return [
    report.outcome,
    levels.map((one) => one.standing).join(" "),
    levels
      .map((one) => one.reason)
      .filter(Boolean)
      .join(" "),
  ];
}

const PROVEN = "proven proven proven absent absent";

test("a bundle holds, and the verdict says what, by whom and when", async () => {
  const world = new World({ count: 3 });
  world.disclose([0, 2]);
  const report = await judge(world.file());
  assert.equal(report.outcome, "holds");
  const text = report.verdict.join("\n");
  assert.match(text, /^HOLDS: what such a file has to prove is proven by what you pinned\.\nThe file has 3 records\./);
  assert.match(text, /3 records existed no later than 2023-11-14 22:15:00 UTC, by the clock of the block signers/);
  assert.match(text, /Readable: 2 records of \/robot1\/odom, 2023-11-14 22:14:53 UTC\./);
  assert.match(text, /Levels: \(a\) bytes: proven; .*\(e\) disclosure: 2 proven, 1 absent; \(f\) numbers: proven\.$/);
  const open = report.records.filter((record) => record.disclosed);
  assert.deepEqual(
    open.map(({ disclosed }) => [disclosed.topic, disclosed.type, disclosed.length]),
    [
      ["/robot1/odom", "std_msgs/String", 9],
      ["/robot1/odom", "std_msgs/String", 9],
    ],
  );
  assert.ok(report.verdict.flatMap(wrapped).length <= WORDING.lines);
});

test("without pins nothing about the chain is proven", async () => {
  assert.deepEqual(await told(new World(), null), ["incomplete", "proven unproven unproven absent absent", "no_trust"]);
});

test("every lie about the chain is refused, or not proven, for its reason", async () => {
  const cases = {
    "another place in its batch": [(world) => (world.claims[0].anchor.index = 3), "refused wrong_path"],
    "another number of leaves": [
      (world) => world.put(slot.anchor(world.owner, world.root), word(BLOCK, 6, TIME, 1)),
      "refused other_anchor",
    ],
    "another block": [
      (world) => world.put(slot.anchor(world.owner, world.root), word(BLOCK - 1, 5, TIME, 1)),
      "refused other_anchor",
    ],
    "an anchor later than its block": [
      (world) => world.put(slot.anchor(world.owner, world.root), word(BLOCK, 5, TIME + 1, 1)),
      "refused other_anchor",
    ],
    "no anchor": [
      (world) => world.put(slot.anchor(world.owner, world.root), word(0, 0, 0, 0)),
      "refused anchor_missing",
    ],
    "unpinned signers": [(world) => (world.sealers = [9, 8]), "refused other_signer"],
    "1 of 3 seals": [(world) => (world.sealers = [1]), "incomplete few_signers"],
    "one signer twice": [(world) => (world.sealers = [1, 1]), "incomplete few_signers"],
    "a stranger builds on it": [(world) => (world.sealers = [1, 9]), "incomplete few_signers"],
    "no seal": [(world) => (world.sealers = [0]), "incomplete no_seal"],
    "a suspended account": [
      (world) =>
        world.put(slot.account(world.owner), Buffer.concat([Buffer.alloc(7), Buffer.of(1), word(1, 0, 1).subarray(8)])),
      "refused suspended",
    ],
    "keys that were replaced": [replaced, "incomplete keys_replaced"],
  };
  for (const [what, [lie, expected]] of Object.entries(cases)) {
    const world = new World();
    lie(world);
    const [outcome, , reasons] = await told(world);
    assert.equal(`${outcome} ${reasons}`, expected, what);
  }
});

function replaced(world) {
  world.put(slot.keys(world.owner, 2), Buffer.alloc(32, 3));
  world.put(slot.next(slot.keys(world.owner, 2)), word(BLOCK, TIME));
}

test("pins decide which chain, contract and code count", async () => {
  assert.equal((await told(new World(), trust({ code_hash: `"${"01".repeat(32)}"` })))[2], "other_code");
  assert.equal((await told(new World(), trust({ genesis: `"${"01".repeat(32)}"` })))[2], "other_chain");
  assert.deepEqual((await told(new World(), trust({ signers: "[]" }))).slice(0, 3), [
    "incomplete",
    "proven unproven unproven absent absent",
    "no_signers",
  ]);
  const own = await judge(new World().file(), trust({ sealed_by_exporter: true }));
  assert.match(own.verdict[0], /only the exporter's own chain supports the file/);
  const vanity = new World();
  vanity.vanity = Buffer.concat([Buffer.from("AuthROS chain file version 1"), Buffer.alloc(4)]);
  const denied = await judge(vanity.file());
  assert.ok(
    denied.verdict.includes("Your trust file says that others seal this chain; its blocks say that one program does."),
  );
});

test("quorums of QBFT and IBFT 2.0 are those of one header", async () => {
  const named = [1, 2, 3, 4];
  const pins = trust({ signers: `[${named.map((one) => `"0x${account(one).toString("hex")}"`).join(", ")}]` });
  const cases = [
    [{ named, sealers: [1, 2, 3] }, "holds "],
    [{ named, sealers: [1, 2, 3], round: 3 }, "holds "],
    [{ named: [], sealers: [1, 2, 3] }, "holds "],
    [{ named, sealers: [1, 2] }, "refused broken_seals"],
    [{ named, sealers: [1, 2, 2, 3] }, "refused broken_seals"],
    [{ named, sealers: [1, 2, 3], said: 1 }, "refused broken_seals"],
    [{ named: [], sealers: [1, 2, 3], said: 1 }, "refused broken_seals"],
    [{ named: [1, 2, 9], sealers: [1, 2, 8] }, "refused broken_seals"],
    [{ named: [7, 8, 9], sealers: [7, 8] }, "refused other_signer"],
    [{ named: [1, 8, 9], sealers: [1, 8] }, "incomplete few_signers"],
  ];
  for (const [commit, expected] of cases) {
    for (const isIbft of [false, true]) {
      const world = new World();
      Object.assign(world, { commit: { ...commit, isIbft }, sealers: [0] });
      const [outcome, , reasons] = await told(world, pins);
      assert.equal(`${outcome} ${reasons}`, expected, JSON.stringify(commit));
    }
  }
});

test("a device signs for its owner while it is authorised", async () => {
  for (const [until, lent, recalled, expected] of [
    [0, 12, 0, `holds ${PROVEN} `],
    [TIME + 1, 12, 0, `holds ${PROVEN} `],
    [TIME, 12, 0, "refused proven refused proven absent absent no_right"],
    [0, 12, BLOCK, "refused proven refused proven absent absent no_right"],
    [0, 41, 0, "refused proven refused proven absent absent no_right"],
    [0, 0, 0, "refused proven refused proven absent absent no_right"],
  ]) {
    const world = new World({ signer: new Key() });
    const loan = Buffer.concat([
      Buffer.alloc(7),
      ...[recalled, lent, until].map((one) => word(one).subarray(24)),
      Buffer.of(1),
    ]);
    world.put(slot.loan(world.owner, world.signer.id), loan);
    assert.equal((await told(world)).join(" "), expected, `${until} ${lent} ${recalled}`);
  }
});

test("what is disclosed is opened by its owner's word alone", async () => {
  const open = new World();
  open.disclose([0]);
  assert.equal((await told(open)).join(" "), "holds proven proven proven absent proven ");
  const strange = new World();
  strange.disclose([0], new Key());
  assert.deepEqual((await told(strange))[2], "foreign_disclosure");
  const wrong = new World({ count: 2 });
  wrong.records[0].secret = wrong.records[1].secret;
  wrong.disclose([0, 1]);
  const report = await judge(wrong.file());
  assert.deepEqual(report.records.map((record) => record.opened.reason).filter(Boolean), ["bad_disclosure"]);
  assert.equal(report.outcome, "refused");
});

test("two records with one number are two histories", async () => {
  const world = new World();
  const other = sealRecord(world.owner, world.keys, 3, Buffer.from("another"));
  const report = await judge(
    world.file((members) => ({
      ...members,
      [`records/${other.digest.toString("hex")}/record.bin`]: other.bytes,
      [`records/${other.digest.toString("hex")}/signature.der`]: other.signature,
    })),
  );
  assert.deepEqual(
    [report.outcome, report.complete[0].reason, report.complete[0].twice],
    ["refused", "two_histories", [3]],
  );
});

test("who put a bundle together is its owner, or pinned, or not proven", async () => {
  const world = new World();
  const stranger = new Key();
  const packed = (owner) =>
    pack(
      signed(
        { ...world.members(), [`keys/${stranger.id.toString("hex")}.pem`]: stranger.pem() },
        { owner, keys: stranger },
      ),
    );
  const other = Buffer.alloc(20, 0x6a);
  assert.equal((await judge(packed(world.owner))).exporter.standing, "unproven");
  assert.equal((await judge(packed(other))).outcome, "incomplete");
  const person = `\n[[person]]\naccount = "0x${other.toString("hex")}"\nname = "The gateway"\nkey = "${stranger.id.toString("hex")}"\n`;
  const pinned = await judge(packed(other), trust({}, person));
  assert.equal(pinned.outcome, "holds");
  assert.ok(pinned.verdict.some((sentence) => sentence.startsWith("Put together by The gateway (0x")));
});

test("a bundle of another form is refused, with the part that is wrong", async () => {
  const world = new World();
  world.disclose([0]);
  const members = signed(world.members(), world);
  const file = pack(members);
  const digest = world.records[0].digest.toString("hex");
  const again = (change) => pack(signed(change({ ...world.members() }), world));
  const manifest = (change) =>
    pack(withManifest(members, Buffer.from(change(members["manifest.json"].toString())), world.keys));
  const without = (name) => again((all) => (delete all[name], all));
  const cases = {
    "an empty file": [Buffer.alloc(0), /not an evidence bundle/],
    "half a file": [file.subarray(0, file.length / 2), /middle of a member/],
    "bytes behind its end": [Buffer.concat([file, Buffer.of(0)]), /exact form/],
    "a member altered, and not signed for": [
      pack({ ...members, "chain/40.rlp": Buffer.alloc(5) }),
      /chain\/40\.rlp: does not match/,
    ],
    "a member taken out": [
      pack(Object.fromEntries(Object.entries(members).filter(([name]) => name !== "chain/41.rlp"))),
      /missing/,
    ],
    "a member put in": [pack({ ...members, "chain/99.rlp": Buffer.alloc(5) }), /not named/],
    "another suite": [manifest((text) => text.replace("SM/1", "SM/2")), /suite/],
    "another digest": [manifest((text) => text.replace('"SM3"', '"SHA-256"')), /suite/],
    "no suite": [manifest((text) => text.replace('"suite"', '"sweet"')), /manifest\.json/],
    "another format": [manifest((text) => text.replace("evidence/1", "evidence/2")), /format/],
    "a digest in capital letters": [
      again((all) => ({ ...all, [`records/${digest.toUpperCase()}/record.bin`]: Buffer.alloc(4) })),
      /not a digest/,
    ],
    "a record without its bytes": [without(`records/${digest}/record.bin`), /missing/],
    "a record without its signature": [without(`records/${digest}/signature.der`), /missing/],
    "a list without its signature": [without("disclosed.der"), /missing/],
    "a signature without its list": [without("disclosed.bin"), /missing/],
    "a list that is too short": [again((all) => ({ ...all, "disclosed.bin": Buffer.alloc(63) })), /list/],
    "a foreign folder": [again((all) => ({ ...all, "witnesses/a/b": Buffer.alloc(1) })), /does not belong/],
    "a foreign file": [again((all) => ({ ...all, "more.txt": Buffer.alloc(1) })), /does not belong/],
    "a header that is none": [again((all) => ({ ...all, "chain/99.rlp": Buffer.alloc(5) })), /not a block header/],
    "a header under another number": [
      again((all) => ({ ...all, "chain/43.rlp": all["chain/40.rlp"] })),
      /another block/,
    ],
  };
  for (const [what, [bytes, why]] of Object.entries(cases)) {
    await assert.rejects(judge(bytes), (error) => error instanceof Malformed && why.test(error.message), what);
  }
  const other = { ...members, "manifest.der": signed(new World().members(), new World())["manifest.der"] };
  assert.equal((await judge(pack(other))).exporter.standing, "refused");
});

test("each flipped byte of a file is refused", async () => {
  const world = new World();
  world.disclose([0]);
  const file = world.file();
  const pins = new Trust(trust());
  for (let at = 3; at < file.length; at += 61) {
    const changed = Buffer.from(file);
    changed[at] ^= 1 << (at % 8);
    const outcome = await check(changed, pins, { readMe: READ_ME }).then(
      (report) => report.outcome,
      (error) => (error instanceof Malformed ? "refused" : String(error)),
    );
    assert.equal(outcome, "refused", `byte ${at}`);
  }
});

test("a trust file that cannot be meant is refused", () => {
  const good = trust().toString();
  assert.ok(new Trust(trust()) && new Trust(Buffer.from(`\ufeff${good}`)) && new Trust(trust({ id: "0x7" })));
  const bad = {
    "an unknown table": `${good}\n[[witness]]\nname = "one"\n`,
    "two byte order marks": `\ufeff\ufeff${good}`,
    "no word on who seals": trust({ sealed_by_exporter: undefined }),
    "a negative id": trust({ id: -1 }),
    "a fraction": trust({ id: "7.0" }),
    "a quorum of none": trust({ quorum: 0 }),
    "a quorum beyond all": trust({ quorum: 4 }),
    "a line twice": good.replace("[chain]", "[chain]\nid = 7"),
    "a prototype": good.replace("[chain]", "[chain]\n__proto__ = 7"),
    "a list for the chain": "chain = [7]",
    "an authority that is none": `${good}\n[[authority]]\nname = "root"\ncertificate = "none"\n`,
    "too long": good + "#".repeat(65_536),
    nothing: "",
  };
  for (const [what, text] of Object.entries(bad)) assert.throws(() => new Trust(Buffer.from(text)), TrustError, what);
});

test("heads say how far a topic goes", async () => {
  const { verdict, outcome } = await judge(
    new World({ count: 3, options: (at) => (at === 1 ? { topicId: Buffer.alloc(16, 9) } : {}) }).file(),
  );
  assert.equal(outcome, "holds");
  assert.ok(
    verdict.some((sentence) =>
      /^Missing: 1 number of a topic with a sealed name \(08080808\), between 3 and 5\.$/.test(sentence),
    ),
  );
});
