// What a check comes to: a standing, and the name of its reason in the verdict's list of sentences.

export const PROVEN = "proven";
export const OWN_CHAIN = "own_chain";
export const UNPROVEN = "unproven";
export const ABSENT = "absent";
export const REFUSED = "refused";

/** Without a reason where it follows from another level. */
export const level = (standing, reason) => ({ standing, reason });

/** Something is contradicted. */
export class Refused extends Error {
  constructor(reason) {
    super(reason);
    this.level = level(REFUSED, reason);
  }
}

/** Something that would prove it is missing. */
export class Unproven extends Error {
  constructor(reason) {
    super(reason);
    this.level = level(UNPROVEN, reason);
  }
}

/** Bytes that are not what they should be; what that means is for their reader to say. */
export class Broken extends Error {}

/** A part of the chain's state that is not in the bundle. */
export class Missing extends Error {}

/** A member of the bundle is not of its form; nothing in the bundle counts then. */
export class Malformed extends Error {
  constructor(member, why) {
    super(`${member}: ${why}`);
  }
}

/** The level that `find` returns or throws. */
export function judged(find) {
  try {
    return find();
  } catch (error) {
    if (error instanceof Refused || error instanceof Unproven) return error.level;
    throw error;
  }
}

/** What `find` reads of a state; where a part is missing that is not proven, and where it is broken that is refused. */
export function ofState(missing, broken, find) {
  try {
    return refusing(broken, find);
  } catch (error) {
    throw error instanceof Missing ? new Unproven(missing) : error;
  }
}

/** What `find` returns; where it finds broken bytes, that is refused for this reason. */
export function refusing(reason, find) {
  try {
    return find();
  } catch (error) {
    throw error instanceof Broken ? new Refused(reason) : error;
  }
}
