-- Version 14: witnesses. A party countersigns what an owner of this home states (`address` is NULL where it is never
-- asked), or has its own statements countersigned here (`serves`), or both. `key` is SM3 of the party's key.
CREATE TABLE witnesses (
    owner BLOB NOT NULL, key BLOB NOT NULL, account BLOB NOT NULL, name TEXT NOT NULL, address TEXT,
    serves INTEGER NOT NULL, added_at INTEGER NOT NULL, PRIMARY KEY (owner, key)
) WITHOUT ROWID;
-- What a witness countersigned for an owner, over the roots of batches in their order, 32 bytes each; `upto` is the last
-- batch under it, `network` the domain of chain and contract.
CREATE TABLE positions (
    key INTEGER PRIMARY KEY, owner BLOB NOT NULL, witness BLOB NOT NULL, network BLOB NOT NULL, upto INTEGER NOT NULL,
    at INTEGER NOT NULL, roots BLOB NOT NULL, countersignature BLOB NOT NULL
);
CREATE INDEX positions_by_witness ON positions (owner, witness, network, key);
CREATE TABLE witnessed_roots (
    root BLOB NOT NULL, witness BLOB NOT NULL, position INTEGER NOT NULL, PRIMARY KEY (root, witness)
) WITHOUT ROWID;
-- What was countersigned here for others, and two statements of one party that cannot both be true.
CREATE TABLE countersigned (
    key INTEGER PRIMARY KEY, party BLOB NOT NULL, network BLOB NOT NULL, countersignature BLOB NOT NULL
);
CREATE INDEX countersigned_by_party ON countersigned (party, network, key);
CREATE TABLE contradictions (
    key INTEGER PRIMARY KEY, party BLOB NOT NULL, at INTEGER NOT NULL, what TEXT NOT NULL, kept BLOB NOT NULL,
    later BLOB NOT NULL UNIQUE
);
