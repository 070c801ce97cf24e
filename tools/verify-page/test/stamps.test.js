// Time stamps made by openssl, of each kind of key, and each lie about them.

import assert from "node:assert/strict";
import { createHash, webcrypto } from "node:crypto";
import { test } from "node:test";
import { unhex } from "../source/bytes.js";
import { Certificate } from "../source/certificate.js";
import { check } from "../source/check.js";
import { Broken } from "../source/outcome.js";
import { checkToken } from "../source/stamp.js";
import { shown } from "../source/report.js";
import { Trust } from "../source/trust.js";
import { Authority, P256, P384, RSA, RSA_PSS } from "./authority.js";
import { sm3, u64 } from "./sealing.js";
import { World, trust } from "./world.js";

globalThis.crypto ??= webcrypto;
const IMPRINT = "5a".repeat(32);
const authority = new Authority();
const certificate = (name) => Certificate.ofPem(authority.pem(name));
const judge = (token, ...pins) => checkToken(token, unhex(IMPRINT), pins.map(certificate));
const refused = (token, why, ...pins) =>
  assert.rejects(judge(token, ...pins), (error) => error instanceof Broken && why.test(error.message), String(why));

test("stamps of each kind of key and hash are taken", async () => {
  for (const [name, key] of [
    ["rsa", RSA],
    ["p256", P256],
    ["p384", P384],
  ]) {
    authority.issue(name, key, "root", "stamps");
    for (const section of ["sha256", "sha384", "sha512"]) {
      const token = authority.token(IMPRINT, name, section);
      if (section === "sha512" && key !== RSA) await refused(token, /ECDSA with SHA-512/, "root");
      else
        assert.deepEqual(
          [(await judge(token, "root")).signer, (await judge(token, "root")).pinned],
          [name, 0],
          `${name} ${section}`,
        );
    }
  }
  authority.issue("pss", RSA_PSS, "root", "stamps");
  const content = authority.content(authority.token(IMPRINT, "rsa"));
  const way = "-cades -keyopt rsa_padding_mode:pss -keyopt rsa_pss_saltlen:";
  for (const name of ["rsa", "pss"]) {
    for (const [hash, salt] of [
      ["sha256", 32],
      ["sha384", 48],
      ["sha512", 64],
    ]) {
      assert.equal(
        (await judge(authority.signed(content, name, `-md ${hash} ${way}${salt}`), "root")).pinned,
        0,
        `${name} ${hash}`,
      );
    }
    await refused(authority.signed(content, name, `-md sha256 ${way}20`), /RSA-PSS with parameters/, "root");
  }
});

test("accuracy is rounded up", async () => {
  authority.issue("exact", P256, "root", "stamps");
  const token = authority.token(IMPRINT, "exact");
  authority.write("token", token);
  const text = authority.openssl("ts -reply -token_in -in token -text").toString();
  const at = Date.parse(/Time stamp: (.*)/.exec(text)[1]) / 1000;
  assert.equal((await judge(token, "root")).before, at + 2);
});

test("the way leads to whichever certificate of it is pinned", async () => {
  authority.root("pssroot", RSA, "another root");
  authority.issue("middle", RSA, "pssroot", "ca", "-sigopt rsa_padding_mode:pss -sigopt rsa_pss_saltlen:32");
  authority.issue("own", P256, "middle", "stamps");
  const token = authority.token(IMPRINT, "own", "sha256", "-chain middle.pem");
  for (const name of ["own", "middle", "pssroot"]) assert.equal((await judge(token, "root", name)).pinned, 1, name);
  assert.equal((await judge(token, "root")).pinned, undefined);
  authority.root("liar", RSA, "another root");
  await refused(token, /signature is invalid/, "liar");
  authority.issue("nobody", P256, "root", "plain");
  authority.issue("below", P256, "nobody", "stamps");
  await refused(authority.token(IMPRINT, "below", "sha256", "-chain nobody.pem"), /may not issue/, "root");
});

test("each lie about a stamp is refused", async () => {
  for (const name of ["plain", "loose", "both", "odd"]) authority.issue(name, P256, "root", name);
  authority.issue("good", P256, "root", "stamps");
  const token = authority.token(IMPRINT, "good");
  const content = authority.content(token);
  assert.equal((await judge(authority.signed(content, "good"), "root")).pinned, 0);
  await refused(authority.token("01".repeat(32), "good"), /stamps something else/, "root");
  for (const name of ["plain", "loose", "both"])
    await refused(authority.signed(content, name), /not restricted/, "root");
  await refused(authority.signed(content, "odd"), /unknown critical extension/, "root");
  await refused(authority.signed(content, "good", "-md sha256"), /does not name its certificate/, "root");
  const bare = authority.signed(content, "good", "-md sha256 -cades -nocerts");
  await refused(bare, /not include its signer/, "root");
  assert.equal((await judge(bare, "good")).pinned, 0);
  const late = Uint8Array.from(content);
  late[Buffer.from(content).indexOf(Buffer.from("\u0018\u000f2")) + 5] += 1;
  await refused(authority.signed(late, "good"), /was not valid then/, "root");
  await refused(authority.token("01".repeat(64), "good", "sha256", "", "sha512"), /not SHA-256/, "root");
  await refused(Uint8Array.from(Buffer.from("no token")), /malformed/, "root");
});

test("each flipped byte of a token is refused, or names nobody who is pinned", async () => {
  authority.issue("flipped", P256, "root", "stamps");
  const token = authority.token(IMPRINT, "flipped");
  for (let at = 0; at < token.length; at++) {
    const changed = Uint8Array.from(token);
    changed[at] ^= 1 << (at % 8);
    const found = await judge(changed, "root").catch((error) => {
      if (!(error instanceof Broken)) throw error;
    });
    assert.equal(found?.pinned, undefined, `byte ${at}`);
  }
});

test("(d) is proven by a pinned authority over the batch's root, and by nobody else", async () => {
  authority.issue("notary", P256, "root", "stamps");
  const world = new World();
  const leaf = sm3(Buffer.of(0), Buffer.from("AuthROS/stamp/1"), world.root);
  const imprint = createHash("sha256")
    .update(Buffer.concat([Buffer.from("AuthROS/stamp/1"), leaf, u64(1)]))
    .digest("hex");
  const stamped = (token, top = leaf) => {
    const root = { root: world.root.toString("hex"), index: 0, path: [] };
    const listed = { format: "authros-stamp/1", top: top.toString("hex"), count: 1, roots: [root] };
    world.more[`stamps/${imprint}/roots.json`] = Buffer.from(JSON.stringify(listed));
    const name = createHash("sha256").update(token).digest("hex").slice(0, 32);
    return world.file((members) => ({ ...members, [`stamps/${imprint}/${name}.der`]: Buffer.from(token) }));
  };
  const pins = (name) =>
    trust({}, `\n[[authority]]\nname = "The notary"\ncertificate = '''\n${authority.pem(name)}'''\n`);
  const token = authority.token(imprint, "notary");
  const told = async (file, from) => shown(await check(file, new Trust(from), { readMe: Buffer.alloc(0) }));
  const good = await told(stamped(token), pins("root"));
  assert.deepEqual(
    [good.outcome, good.records[0].time.standing, good.records[0].authority],
    ["holds", "proven", "The notary"],
  );
  assert.ok(
    good.verdict.some((sentence) =>
      /^1 record existed no later than .* UTC, by the clock of The notary\.$/.test(sentence),
    ),
  );
  const strange = await told(stamped(token), trust());
  assert.deepEqual(
    [strange.outcome, strange.records[0].time],
    ["holds", { standing: "unproven", reason: "unknown_authority" }],
  );
  const [{ crypto }, file, known] = [globalThis, stamped(token), pins("root")];
  Object.defineProperty(globalThis, "crypto", { value: undefined, configurable: true, writable: true });
  const unchecked = await told(file, known);
  globalThis.crypto = crypto;
  const { time } = unchecked.records[0];
  assert.deepEqual([unchecked.outcome, time], ["incomplete", { standing: "unproven", reason: "not_checked" }]);
  const other = authority.token("01".repeat(32), "notary");
  const wrong = await told(stamped(other), pins("root"));
  assert.deepEqual([wrong.outcome, wrong.records[0].time.reason], ["refused", "bad_stamp"]);
});
