// The rules of the sentences, by the examples that every verifier is given.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { sentencesOf } from "../source/verdict.js";
import { WORDING, filled, wrapped } from "../source/wording.js";

const examples = JSON.parse(
  readFileSync(new URL("../../../crates/evidence/src/verdict/examples.json", import.meta.url), "utf8"),
);

test("the lines are those of the examples", () => {
  for (const { what, facts, lists, lines } of examples) {
    assert.deepEqual(sentencesOf({ all: facts, lists }).flatMap(wrapped), lines, what);
  }
  assert.ok(examples.length > 4);
});

test("numbers are written with their words", () => {
  const said = (number) =>
    filled("{count|record|records} of {name}{none}", [{ count: number }, { name: "one", count: 9 }]);
  assert.deepEqual([0, 1, 999, 1000, 1234567n].map(said), [
    "0 records of one",
    "1 record of one",
    "999 records of one",
    "1,000 records of one",
    "1,234,567 records of one",
  ]);
});

test("every reason that the page gives has its words", () => {
  const sources = ["anchor", "check", "complete", "existed", "right"];
  const text = sources.map((name) => readFileSync(new URL(`../source/${name}.js`, import.meta.url), "utf8")).join("");
  const given = [
    ...text.matchAll(
      /(?:Refused|Unproven|refusing)\("([a-z_]+)"|level\([A-Z_]+, "([a-z_]+)"|reason: [^,]*"([a-z_]+)" : "([a-z_]+)"|ofState\("([a-z_]+)", "([a-z_]+)"/g,
    ),
  ];
  const names = new Set(given.flatMap((found) => found.slice(1).filter(Boolean)));
  assert.ok(names.size > 30, [...names].join());
  for (const name of names) assert.ok(WORDING.reasons[name], name);
});
