-- Version 11: who is registered and who may read what, event by event: what an event changes is written, and no more.

-- The contracts whose events were read, each with the block and the place in it of the last one.
CREATE TABLE contracts (
    key INTEGER PRIMARY KEY, domain BLOB NOT NULL UNIQUE, block INTEGER NOT NULL, place INTEGER NOT NULL
);
-- Their events. `kind`: 1 a grant, 2 an envelope of a further epoch, 3 an extension, 4 the beginning of an epoch, with
-- the grantee where it is a revocation, 5 any other. `replaced` is the block of the event that took its place, `revoked`
-- the epoch that began with the revocation of its grant, in the block `revoked_at`. What is neither stands.
CREATE TABLE rights (
    contract INTEGER NOT NULL, block INTEGER NOT NULL, place INTEGER NOT NULL, kind INTEGER NOT NULL, owner BLOB,
    grantee BLOB, epoch INTEGER, token BLOB, event TEXT NOT NULL, replaced INTEGER, revoked INTEGER,
    revoked_at INTEGER, PRIMARY KEY (contract, block, place)
) WITHOUT ROWID;
CREATE INDEX rights_standing ON rights (contract, owner, kind, grantee) WHERE replaced IS NULL AND revoked IS NULL;
CREATE INDEX rights_given ON rights (contract, owner, grantee) WHERE revoked IS NOT NULL;
CREATE INDEX rights_received ON rights (contract, grantee) WHERE revoked IS NOT NULL;
CREATE INDEX rights_tokens ON rights (contract, owner, epoch) WHERE token IS NOT NULL;
-- The envelopes that grants and later events brought; read only by those who open them.
CREATE TABLE envelopes (
    contract INTEGER NOT NULL, block INTEGER NOT NULL, place INTEGER NOT NULL, envelope BLOB NOT NULL,
    PRIMARY KEY (contract, block, place)
) WITHOUT ROWID;
-- Before, all of it was one text, written anew with every event; the chain still tells it.
DELETE FROM settings WHERE key = 'directory' OR key LIKE 'directory:%';
