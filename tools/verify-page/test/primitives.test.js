// The primitives against vectors of their standards, and against openssl.

import assert from "node:assert/strict";
import { createCipheriv, createHash, createHmac, randomBytes } from "node:crypto";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { deflateSync } from "node:zlib";
import { test } from "node:test";
import { address, addressBytes, keccak, recovered } from "../source/accounts.js";
import { hex, unhex } from "../source/bytes.js";
import { clean, rfc3339 } from "../source/display.js";
import { leadsTo } from "../source/merkle.js";
import { decode, encodeBytes, encodeList } from "../source/rlp.js";
import { PublicKey, keyOfPem, signatureOfDer } from "../source/sm2.js";
import { expand, hmacSm3, sm3 } from "../source/sm3.js";
import { gcmOpen } from "../source/sm4.js";
import { unpackLz4, unpackMatrix } from "../source/unpack.js";
import * as json from "../source/json.js";
import { Key, expand as expandByNode, gcmSeal } from "./sealing.js";
import { tree } from "./world.js";

const bytes = (text) => new Uint8Array(Buffer.from(text));

test("SM3 is that of GB/T 32905 and of OpenSSL, whatever the length and the parts", () => {
  assert.equal(hex(sm3(bytes("abc"))), "66c7f0f462eeedd9d1f2d46bdc10e4e24167c4875cf2f7a2297da02b8f4ba8e0");
  assert.equal(hex(sm3(bytes("abcd".repeat(16)))), "debe9ff92275b8a138604889c18e5a4d6fdb70e5387e5765293dcba39c0c5732");
  for (let length = 0; length < 300; length++) {
    const data = randomBytes(length);
    const expected = createHash("sm3").update(data).digest("hex");
    assert.equal(hex(sm3(data)), expected);
    const at = Math.floor(length / 3);
    assert.equal(hex(sm3(data.subarray(0, at), data.subarray(at))), expected);
  }
});

test("HMAC and HKDF over SM3 are those of OpenSSL", () => {
  for (const length of [0, 1, 32, 64, 65, 100]) {
    const [key, data] = [randomBytes(length), randomBytes(length * 2)];
    assert.equal(hex(hmacSm3(key, data)), createHmac("sm3", key).update(data).digest("hex"));
    assert.equal(hex(expand(key, data, 88)), expandByNode(key, data, 88).toString("hex"));
  }
});

test("SM4-GCM is that of RFC 8998, and a changed bit opens nothing", () => {
  const [key, nonce] = [unhex("0123456789abcdeffedcba9876543210"), unhex("00001234567800000000abcd")];
  const aad = unhex("feedfacedeadbeeffeedfacedeadbeefabaddad2");
  const plain =
    "aaaaaaaaaaaaaaaabbbbbbbbbbbbbbbbccccccccccccccccddddddddddddddddeeeeeeeeeeeeeeeeffffffffffffffffeeeeeeeeeeeeeeeeaaaaaaaaaaaaaaaa";
  const sealed = unhex(
    "17f399f08c67d5ee19d0dc9969c4bb7d5fd46fd3756489069157b282bb200735d82710ca5c22f0ccfa7cbf93d496ac15a56834cbcf98c397b4024a2691233b8d83de3541e4c2b58177e065a9bf7b62ec",
  );
  assert.equal(hex(gcmOpen(key, nonce, aad, sealed)), plain);
  for (const at of [0, 63, 64, 79]) {
    const changed = Uint8Array.from(sealed);
    changed[at] ^= 1;
    assert.equal(gcmOpen(key, nonce, aad, changed), undefined);
  }
  assert.equal(gcmOpen(key, nonce, aad.subarray(1), sealed), undefined);
  assert.equal(gcmOpen(key, nonce, aad, sealed.subarray(0, 15)), undefined);
});

test("SM4-GCM opens what OpenSSL's SM4 sealed, whatever the lengths", () => {
  for (let length = 0; length < 80; length++) {
    const [key, nonce, aad, plain] = [16, 12, length * 3, length].map((size) => randomBytes(size));
    assert.equal(hex(gcmOpen(key, nonce, aad, gcmSeal(key, nonce, aad, plain))), plain.toString("hex"));
  }
});

test("the counter of SM4-GCM goes on past a byte", () => {
  const [key, nonce, plain] = [randomBytes(16), randomBytes(12), randomBytes(16 * 70_000)];
  const first = Buffer.concat([nonce, Buffer.of(0, 0, 0, 2)]);
  const stream = createCipheriv("sm4-ctr", key, first).update(plain);
  const opened = gcmOpen(
    key,
    nonce,
    Buffer.alloc(0),
    gcmSeal(key, nonce, Buffer.alloc(0), plain.subarray(0, 16 * 300)),
  );
  assert.deepEqual(Buffer.from(opened), plain.subarray(0, 16 * 300));
  assert.equal(stream.length, plain.length);
});

test("SM2 verifies the example of GB/T 32918.5, and nothing near it", () => {
  const key = PublicKey.of(
    unhex(
      "09f9df311e5421a150dd7d161e4bc5c672179fad1833fc076bb08ff356f35020ccea490ce26775a52dc6ea718cc1aa600aed05fbf35e084a6632f6072da9ad13",
    ),
  );
  const signature = unhex(
    "f5a03b0648d2c4630eeac513e1bb81a15944da3827d5b74143ac7eaceee720b3b1b6aa29df212fd8763182bc0d421ca1bb9038fd1f7f42d4840b69c485bbc1aa",
  );
  assert.ok(key.verify(bytes("message digest"), signature));
  assert.ok(!key.verify(bytes("message digesT"), signature));
  for (const at of [0, 31, 32, 63]) {
    const changed = Uint8Array.from(signature);
    changed[at] ^= 1;
    assert.ok(!key.verify(bytes("message digest"), changed));
  }
  assert.ok(!key.verify(bytes("message digest"), new Uint8Array(64)));
  assert.equal(PublicKey.of(new Uint8Array(64)), undefined);
});

test("a key that signs often verifies as it did before its table", () => {
  const key = new Key(7n);
  const known = PublicKey.of(key.public);
  for (let number = 0; number < 40; number++) {
    const [message, signature] = [bytes(`message ${number}`), key.sign(`message ${number}`)];
    assert.ok(known.verify(message, signature), `${number}`);
    assert.ok(!known.verify(bytes("another"), signature), `${number}`);
  }
});

test("openssl's keys and signatures of SM2 are read", () => {
  const folder = mkdtempSync(join(tmpdir(), "sm2-"));
  const openssl = (line) => execFileSync("openssl", line.split(" "), { cwd: folder, stdio: "pipe" });
  openssl("genpkey -algorithm SM2 -out key.pem");
  openssl("pkey -in key.pem -pubout -out public.pem");
  writeFileSync(join(folder, "message"), "what is signed");
  openssl(
    "pkeyutl -sign -inkey key.pem -rawin -digest sm3 -pkeyopt distid:1234567812345678 -in message -out signature",
  );
  const key = keyOfPem(readFileSync(join(folder, "public.pem"), "utf8"));
  const signature = signatureOfDer(readFileSync(join(folder, "signature")));
  assert.ok(key.verify(bytes("what is signed"), signature));
  assert.ok(!key.verify(bytes("what is signeD"), signature));
});

test("a key has one form of PEM", () => {
  const pem = new Key(9n).pem().toString();
  assert.ok(keyOfPem(pem));
  for (const other of [
    pem.slice(1),
    ` ${pem}`,
    pem + "\n",
    pem.replaceAll("\n", "\r\n"),
    pem.replace("PUBLIC", "public"),
    "",
  ]) {
    assert.equal(keyOfPem(other), undefined);
  }
});

test("signatures in DER have one form", () => {
  const read = (digits) => hex(signatureOfDer(unhex(digits)));
  assert.equal(read("3006020105020106"), "05".padStart(64, "0") + "06".padStart(64, "0"));
  for (const bad of [
    "",
    "3006020105020106ff",
    "308106020105020106",
    "30060201050201",
    "300702020005020106",
    "3006020185020106",
    "3106020105020106",
  ]) {
    assert.throws(() => read(bad), undefined, bad);
  }
});

test("the account of a signature is that of EIP-155's example, and of no high s", () => {
  const hash = unhex("daf5a779ae972f972197303d7b574746c7ef83eadac0f2791ad23db92e4c8e53");
  const signature =
    "28ef61340bd939bc2195fe537567866003e1a15d3c71ff63e1590620aa63627667cbe9d8997f761aecb703304b3800ccf555c9f3dc64214b297fb1966a3b6d83";
  assert.equal(address(recovered(hash, unhex(signature + "00"))), "0x9d8A62f656a8d1615C1294fd71e9CFb3E4855A4F");
  assert.notEqual(address(recovered(hash, unhex(signature + "01"))), "0x9d8A62f656a8d1615C1294fd71e9CFb3E4855A4F");
  const order = 0xfffffffffffffffffffffffffffffffebaaedce6af48a03bbfd25e8cd0364141n;
  const high = (order - BigInt("0x" + signature.slice(64))).toString(16);
  assert.equal(recovered(hash, unhex(signature.slice(0, 64) + high + "01")), undefined);
  for (const bad of [signature + "02", signature + "1b", "0".repeat(128) + "00"])
    assert.equal(recovered(hash, unhex(bad)), undefined);
});

test("addresses have the checksum of EIP-55 or none", () => {
  for (const good of ["0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed", "0xfB6916095ca1df60bB79Ce92cE3Ea74c37c5d359"]) {
    assert.equal(address(addressBytes(good)), good);
    assert.ok(addressBytes(good.toLowerCase()) && addressBytes("0x" + good.slice(2).toUpperCase()));
    assert.equal(addressBytes(good.replace("B", "b")), undefined);
    assert.equal(addressBytes(good.slice(2)), undefined);
  }
  assert.equal(hex(keccak(new Uint8Array(0))), "c5d2460186f7233c927e7db2dcc703c0e500b653ca82273b7bfad8045d85a470");
});

test("RLP has one form", () => {
  const item = (digits) => decode(unhex(digits));
  assert.equal(hex(encodeBytes(bytes("dog"))), "83646f67");
  assert.equal(hex(encodeList([encodeBytes(bytes("cat")), encodeBytes(bytes("dog"))])), "c88363617483646f67");
  const long = encodeBytes(new Uint8Array(300));
  assert.equal(decode(long).bytes.length, 300);
  assert.equal(item("c88363617483646f67").items.length, 2);
  for (const bad of [
    "",
    "817f",
    "81",
    "8000",
    "c28105",
    "c1",
    "b90038" + "01".repeat(56),
    "b837" + "01".repeat(55),
    "bfffffffffffffffff",
    "f8",
  ]) {
    assert.equal(item(bad), undefined, bad);
  }
  const nested = (levels) => Array.from({ length: levels }).reduce((inner) => encodeList([inner]), encodeList([]));
  assert.ok(decode(nested(32)) && !decode(nested(33)));
  assert.deepEqual([item("80").number(), item("05").number(), item("820100").number()], [0n, 5n, 256n]);
  assert.deepEqual(
    [item("820005"), item("00"), item("89" + "01".repeat(9))].map((one) => one.number()),
    [undefined, undefined, undefined],
  );
});

test("paths lead to roots of trees of every size, and from no other place", () => {
  for (let count = 1; count < 40; count++) {
    const leaves = Array.from({ length: count }, (_, at) => Buffer.alloc(32, at));
    const { root, paths } = tree(leaves);
    paths.forEach((path, index) => {
      const leads = (at, of, steps = path) => leadsTo(root, leaves[index], BigInt(at), BigInt(of), steps);
      assert.ok(leads(index, count), `${index} of ${count}`);
      assert.ok(!leads(index, count, [...path, root]) && !leads(count, count));
      if (path.length) assert.ok(!leads(index, count, path.slice(1)) && !leads((index + 1) % count, count));
    });
  }
});

test("JSON has one spelling", () => {
  const form = json.lines({ number: json.whole, word: json.string });
  const read = (text) => form(json.parse(bytes(text)));
  assert.deepEqual(read(' {"number": 18446744073709551615, "w\\u006frd": "\\ud83d\\ude00\\n"}\r\n'), {
    number: 18446744073709551615n,
    word: "\u{1f600}\n",
  });
  const bad = [
    '[1, "a"]',
    '{"number": 1}',
    '{"number": 1, "word": "a", "more": 1}',
    '{"number": 1, "number": 1, "word": "a"}',
    '{"number": 18446744073709551616, "word": "a"}',
    '{"number": -0, "word": "a"}',
    '{"number": 1.0, "word": "a"}',
    '{"number": 01, "word": "a"}',
    '{"number": 1, "word": "\\ud800"}',
    '{"number": 1, "word": "a"},',
    "\ufeff{}",
    "",
    '{"number": 1, "word": "a\u0001"}',
    '{"number": true, "word": "a"}',
    '{"number": 1, "word": null}',
    "[".repeat(200),
  ];
  for (const text of bad) assert.throws(() => read(text), SyntaxError, text);
  assert.throws(() => json.parse(Uint8Array.of(0xff)), SyntaxError);
});

test("LZ4 is unpacked within its bounds", () => {
  const read = (packed, length) => Buffer.from(unpackLz4(Uint8Array.from(packed), length)).toString();
  assert.equal(read([0x30, 97, 98, 99], 3), "abc");
  assert.equal(read([0x11, 97, 1, 0, 0x10, 98], 7), "aaaaaab");
  assert.equal(read([0xf0, 1, ...Buffer.from("a".repeat(16))], 16), "a".repeat(16));
  for (const [packed, length] of [
    [[0x30, 97, 98, 99], 4],
    [[0x30, 97, 98], 3],
    [[0x11, 97, 2, 0, 0x10, 98], 7],
    [[0x11, 97, 0, 0, 0x10, 98], 7],
    [[0xff], 9],
    [[], 0],
  ]) {
    assert.throws(() => read(packed, length));
  }
  assert.throws(() => unpackLz4(Uint8Array.of(0x10, 97), 64 * 2 ** 20), "a claim that no such block can keep");
});

test("matrices are restored from each filter, within their bounds", async () => {
  const matrix = (
    { start = 0, rows, columns, channels = 1, sample = 1, apart = 1, flags = 0 },
    packed,
    around = Buffer.alloc(0),
  ) => {
    const head = Buffer.alloc(15);
    [start, rows, columns].forEach((number, at) => head.writeUInt32BE(number, 4 * at));
    head.set([channels, sample | flags, apart], 12);
    return Buffer.concat([head, around, deflateSync(packed)]);
  };
  const row = Array.from({ length: 16 }, (_, at) => at + 1);
  const rows = [
    [0, ...row],
    [1, ...row.map(() => 1)],
    [2, ...row.map(() => 0)],
    [3, ...row.map(() => 0)],
    [4, ...row.map(() => 0)],
  ];
  const found = Buffer.from(await unpackMatrix(matrix({ rows: 5, columns: 16 }, Buffer.from(rows.flat())), 80));
  assert.deepEqual([...found.subarray(0, 48)], [...row, ...row, ...row]);
  // Average of 0 and 1 is 0, of 0 and 2 is 1, of 1 and 3 is 2; Paeth's first is what is above.
  assert.deepEqual([...found.subarray(48, 52)], [0, 1, 2, 3]);
  assert.deepEqual([...found.subarray(64, 68)], [...found.subarray(48, 52)]);
  // Numbers of two bytes, big endian, as planes of folded differences: 1, 2, 3 .. from the left.
  const planes = Buffer.from([1, ...Array(8).fill(2), ...Array(8).fill(0)]);
  const numbers = Buffer.from(await unpackMatrix(matrix({ rows: 1, columns: 8, sample: 2, flags: 0x80 }, planes), 16));
  assert.deepEqual(
    Array.from({ length: 8 }, (_, at) => numbers.readUInt16BE(2 * at)),
    [1, 2, 3, 4, 5, 6, 7, 8],
  );
  // Green is added to the other colours; bytes before and behind stay.
  const colours = Buffer.from([0, ...Array(6).fill([1, 10, 2]).flat()]);
  const around = Buffer.from("ab");
  const picture = Buffer.from(
    await unpackMatrix(matrix({ start: 1, rows: 1, columns: 6, channels: 3, flags: 0x40 }, colours, around), 20),
  );
  assert.deepEqual([...picture.subarray(0, 7), picture[19]], [97, 11, 10, 12, 11, 10, 12, 98]);
  const good = { rows: 1, columns: 16 };
  for (const [what, packed, length] of [
    ["a row less", matrix({ ...good, rows: 2 }, Buffer.from(rows[0])), 32],
    ["a row more", matrix(good, Buffer.from([...rows[0], ...rows[0]])), 16],
    ["an unknown filter", matrix(good, Buffer.from([5, ...row])), 16],
    ["a short row", matrix({ rows: 1, columns: 15 }, Buffer.from([0, ...row.slice(1)])), 15],
    ["more than the message", matrix(good, Buffer.from(rows[0])), 15],
    [
      "ten gigabytes",
      matrix({ rows: 2 ** 32 - 1, columns: 2 ** 32 - 1, channels: 64, sample: 4 }, Buffer.alloc(9)),
      64 * 2 ** 20,
    ],
  ]) {
    await assert.rejects(unpackMatrix(packed, length), undefined, what);
  }
});

test("text of others is safe to show, and times are as the program writes them", () => {
  assert.equal(clean("a\u202eb\u0000c\u200d", 10), "a\ufffdb\ufffdc\ufffd");
  assert.equal(clean("abcdef", 3), "ab…");
  assert.equal(clean("e" + "\u0301".repeat(6), 10), "e\u0301\u0301\u0301\u0301\ufffd\ufffd");
  assert.equal(rfc3339(1_700_000_100_500_000_000n), "2023-11-14T22:15:00.5Z");
  assert.equal(rfc3339(1_700_000_100_000_000_000n), "2023-11-14T22:15:00Z");
});
