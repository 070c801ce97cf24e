// The page: takes the files, starts the thread that checks, and shows what it says. All text from a bundle becomes text nodes.

import { WORDING, filled } from "./wording.js";

/* global WORKER */
const ROWS = 100;
const LEVELS = ["bytes", "key", "anchor", "time", "opened"];
const STAGES = { members: "Comparing the file's parts with its list", records: "Checking records" };
const place = (id) => document.getElementById(id);

const chosen = { bundle: undefined, pins: undefined };
let worker;
let report;
let inTime = [];
let rows = 0;

// Chromium takes a script for a thread only from such a policy; other browsers have none.
const policy = globalThis.trustedTypes?.createPolicy("authros", { createScriptURL: (url) => url });

function newWorker() {
  const url = URL.createObjectURL(new Blob([WORKER], { type: "text/javascript" }));
  return new Worker(policy ? policy.createScriptURL(url) : url);
}

function element(name, text, className) {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** A file for either place; a trust file is known by its name. */
function take(file, kind = file.name.endsWith(".toml") ? "pins" : "bundle") {
  chosen[kind] = file;
  place(`${kind}-name`).textContent = `${file.name}, ${count(file.size)} bytes`;
}

function start() {
  worker?.terminate();
  for (const id of ["verdict", "details"]) place(id).hidden = true;
  globalThis.verdict = report = undefined;
  if (!chosen.bundle) return;
  place("working").hidden = false;
  place("so-far").textContent = "";
  progress({ stage: "members", done: 0, all: 1 });
  worker = newWorker();
  worker.onmessage = ({ data }) => hear(data);
  worker.onerror = () =>
    fail("The check stopped: this browser could not run it. Use a current one, or authros evidence verify.");
  worker.postMessage(chosen);
}

function hear(told) {
  if (told.progress) progress(told.progress);
  else if (told.fault) fail(`The check stopped: ${told.fault}. This is a fault of the page; use authros evidence verify.`);
  else if (told.report.trust) fail(`Not checked: the trust file cannot be used: ${told.report.trust}.`);
  else show(told.report);
  if (!told.progress) globalThis.verdict = told;
}

const count = (number) => number.toLocaleString("en");

function progress({ stage, done, all, known }) {
  place("bar").max = all;
  place("bar").value = done;
  place("stage").textContent = `${STAGES[stage]}: ${Math.floor((100 * done) / all)} %`;
  if (known?.exporter) {
    place("so-far").textContent =
      `It claims to have ${count(known.records)} records, and that ${known.exporter} put it together.`;
  } else if (known) {
    place("so-far").textContent =
      `So far ${count(done)} of ${count(all)} records are checked, of which ${count(known.refused)} are refused.`;
  }
}

function fail(text) {
  worker?.terminate();
  place("bar").removeAttribute("value");
  place("working").hidden = true;
  place("of").textContent = chosen.bundle.name;
  place("sentences").className = "refused";
  place("sentences").replaceChildren(element("p", text));
  place("verdict").hidden = false;
}

function show(found) {
  worker.terminate();
  report = found;
  inTime = [...found.records].sort(byTime);
  place("working").hidden = true;
  place("of").textContent = chosen.bundle.name;
  place("sentences").className = found.outcome;
  place("sentences").replaceChildren(...found.verdict.map((sentence) => element("p", sentence)));
  place("verdict").hidden = false;
  place("records").replaceChildren();
  rows = 0;
  moreRows();
  place("topics").replaceChildren(...found.complete.map(topicRow));
  place("details").hidden = found.records.length === 0;
}

function byTime(one, other) {
  const parts = (record) => [record.captured_at ?? "", record.topic_id ?? "", record.seq ?? 0, record.digest];
  const [mine, theirs] = [parts(one), parts(other)];
  const at = mine.findIndex((part, place) => part !== theirs[place]);
  return at < 0 ? 0 : mine[at] < theirs[at] ? -1 : 1;
}

function moreRows() {
  const next = inTime.slice(rows, rows + ROWS);
  rows += next.length;
  place("records").append(...next.map(recordRow));
  place("more").hidden = rows >= inTime.length;
}

function row(cells) {
  const made = document.createElement("tr");
  made.append(...cells);
  return made;
}

function levelCell({ standing, reason }) {
  const cell = element("td", WORDING.standings[standing], `level ${standing}`);
  if (reason) cell.append(element("div", WORDING.reasons[reason]));
  return cell;
}

const sealedName = (id) => (id === null ? "" : filled(WORDING.labels.sealed, [{ id: id.slice(0, 8) }]));

function recordRow(record) {
  const { disclosed } = record;
  const topic = disclosed ? `${disclosed.topic} (${disclosed.type})` : sealedName(record.topic_id);
  const cells = [
    element("td", record.seq ?? ""),
    element("td", record.captured_at ?? "", "time"),
    element("td", topic),
  ];
  cells.push(...LEVELS.map((name) => levelCell(record[name])), element("td", record.block ?? ""));
  const made = row(cells);
  made.title = record.digest;
  return made;
}

function topicRow(stretch) {
  const { topic_id: topic, first, last, missing, heads } = stretch;
  return row([
    element("td", sealedName(topic)),
    levelCell(stretch),
    ...[first, last, missing, heads?.number].map((text) => element("td", text ?? "")),
  ]);
}

function save() {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(report, null, 1)], { type: "application/json" }));
  link.download = `${chosen.bundle.name}.verdict.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

for (const kind of ["bundle", "pins"]) {
  place(kind).addEventListener("change", ({ target }) => {
    if (target.files[0]) take(target.files[0], kind);
    start();
  });
}
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    for (const one of document.querySelectorAll(".file")) one.classList.toggle("over", name === "dragover");
  });
}
document.addEventListener("drop", (event) => {
  for (const file of event.dataTransfer.files) take(file);
  start();
});
place("files").addEventListener("submit", (event) => event.preventDefault());
place("print").addEventListener("click", () => globalThis.print());
place("save").addEventListener("click", save);
place("more").addEventListener("click", moreRows);
