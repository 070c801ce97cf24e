// Files that want to exhaust a reader or to run in the page: `node hostile.js FOLDER`.

import { closeSync, openSync, truncateSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { World, pack, signed, trust } from "./world.js";

const write = (name, bytes) => writeFileSync(join(process.argv[2], name), bytes);

// Scripts where names belong: it holds, and shows them as text.
const evil = `/<img src=x onerror="globalThis.executed=1"><script>globalThis.executed=2</script>`;
const named = new World({ count: 2, options: () => ({ topic: evil, type: evil, tags: { robot: evil } }) });
named.disclose([0, 1]);
write("names.authros", named.file());
write("names.toml", trust({}, `\n[[person]]\naccount = "0x${"0e".repeat(20)}"\nname = '''${evil}'''\n`));
write("member.authros", pack({ mimetype: Buffer.from("x"), [evil]: Buffer.from("x") }));

const local = (name, length = 0) => {
  const header = Buffer.alloc(30);
  header.write("PK\u0003\u0004", "latin1");
  header.writeUInt16LE(10, 4);
  header.writeUInt16LE(0x21, 12);
  header.writeUInt32LE(length, 18);
  header.writeUInt32LE(length, 22);
  header.writeUInt16LE(name.length, 26);
  return Buffer.concat([header, Buffer.from(name)]);
};
write("members.authros", Buffer.concat(Array.from({ length: 1_000_000 }, (_, at) => local(`a${at}`))));
write("claim.authros", Buffer.concat([local("mimetype", 0xffffffff), Buffer.alloc(100)]));

// Ten gigabytes of nothing, which take no room on the disk.
const long = join(process.argv[2], "long.authros");
closeSync(openSync(long, "w"));
truncateSync(long, 10 * 2 ** 30);

// Messages that say they are far longer than they are: LZ4 and a matrix.
const greedy = new World({
  count: 2,
  message: (at) => (at ? Buffer.alloc(40, 0xff) : Buffer.from([0x1f, 97, 1, 0, ...Array(30).fill(0xff), 0])),
  options: (at) => ({ compression: at + 1, plainLength: 64 * 2 ** 20 }),
});
greedy.disclose([0, 1]);
write("messages.authros", greedy.file());

// Lists within lists, and a list of a million items.
const deep = new World();
write("deep.authros", pack(signed({ ...deep.members(), "heights.json": Buffer.from("[".repeat(1_000_000)) }, deep)));
const wide = new World();
write("wide.authros", pack(signed({ ...wide.members(), "chain/nodes.rlp": Buffer.alloc(4_000_000, 0x80) }, wide)));
