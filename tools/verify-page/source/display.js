// Text from others made safe to show, and times in words, as in the program's own output.

const MOST_MARKS = 4;
const MARK = /[\u0300-\u036f\u1ab0-\u1aff\u1dc0-\u1dff\u20d0-\u20ff\ufe20-\ufe2f]/u;
const HIDDEN =
  /[\p{Cc}\u00ad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b-\u200f\u2028-\u202e\u2060-\u206f\u3164\ufe00-\ufe0f\ufeff\uffa0\ufff0-\ufffb\u{1d173}-\u{1d17a}\u{e0000}-\u{e0fff}]/u;

/** At most `width` characters; those that must not be shown are replaced. */
export function clean(text, width) {
  const out = [];
  let marks = 0;
  for (const character of text) {
    if (out.length === width) {
      out[width - 1] = "…";
      break;
    }
    marks = MARK.test(character) ? marks + 1 : 0;
    out.push(HIDDEN.test(character) || marks > MOST_MARKS ? "\ufffd" : character);
  }
  return out.join("");
}

/** Nanoseconds since 1970 as the program writes them. */
export function rfc3339(nanoseconds) {
  const seconds = nanoseconds / 1_000_000_000n;
  // The last second of the year 9999.
  if (seconds > 253_402_300_799n) return `${nanoseconds} ns`;
  const fraction = (nanoseconds % 1_000_000_000n).toString().padStart(9, "0").replace(/0+$/, "");
  const whole = new Date(Number(seconds) * 1000).toISOString().slice(0, 19);
  return `${whole}${fraction && "." + fraction}Z`;
}
