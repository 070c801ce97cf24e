// A bundle of many records with half of them disclosed, and its trust file: `node many.js COUNT FOLDER`.

import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { World, trust } from "./world.js";

const [count, folder] = [Number(process.argv[2]), process.argv[3]];
const world = new World({ count, message: (at) => Buffer.alloc(200, at) });
world.disclose(Array.from({ length: count >> 1 }, (_, at) => 2 * at));
writeFileSync(join(folder, "many.authros"), world.file());
writeFileSync(join(folder, "many.toml"), trust());
