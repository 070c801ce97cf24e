// The thread that checks, so that the page never freezes: a file goes in, progress and a report come out.

import { LARGEST, TOO_LONG, WHOLE } from "./archive.js";
import { ascii } from "./bytes.js";
import { check } from "./check.js";
import { Malformed } from "./outcome.js";
import { refusal, shown } from "./report.js";
import { LONGEST_TRUST, Trust, TrustError } from "./trust.js";

/* global READ_ME */

/** The report on a bundle, or `{ trust: WHY }` if the trust file cannot be used. Both are files. */
export async function judge(bundle, pins, progress) {
  let trust;
  try {
    // One byte more than may be, so that a longer file is refused without being read.
    trust = pins && new Trust(new Uint8Array(await pins.slice(0, LONGEST_TRUST + 1).arrayBuffer()));
  } catch (error) {
    if (error instanceof TrustError) return { trust: error.message };
    throw error;
  }
  try {
    if (bundle.size > LARGEST) throw new Malformed(WHOLE, TOO_LONG);
    const bytes = new Uint8Array(await bundle.arrayBuffer());
    return shown(await check(bytes, trust, { readMe: ascii(READ_ME), progress }));
  } catch (error) {
    if (error instanceof Malformed) return refusal(error.message);
    throw error;
  }
}

/** Answers the page; `tell` passes what it hears. */
export async function answer({ bundle, pins }, tell) {
  const progress = (stage, done, all, known) => tell({ progress: { stage, done, all, known } });
  try {
    tell({ report: await judge(bundle, pins, progress) });
  } catch (error) {
    tell({ fault: String(error?.message ?? error) });
  }
}

if (typeof WorkerGlobalScope !== "undefined") {
  globalThis.onmessage = (event) => answer(event.data, (told) => globalThis.postMessage(told));
}
