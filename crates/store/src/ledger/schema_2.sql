-- Version 2: Merkle batches. The tables of version 1 were never written to.
DROP TABLE leaves;
DROP TABLE batches;

-- A closed batch; `account`, `tx` and `block` as the chain has them, or as the sender last tried.
CREATE TABLE batches (
    key INTEGER PRIMARY KEY, root BLOB NOT NULL UNIQUE, owner BLOB NOT NULL, count INTEGER NOT NULL,
    closed_at INTEGER NOT NULL, account BLOB, tx BLOB, block INTEGER, block_hash BLOB
);
CREATE INDEX batches_waiting ON batches (owner, key) WHERE tx IS NULL;
CREATE INDEX batches_anchored ON batches (block) WHERE block IS NOT NULL;

-- A record's place in its batch and its path to the root, 32 bytes a step.
CREATE TABLE leaves (
    record INTEGER PRIMARY KEY, batch INTEGER NOT NULL, leaf INTEGER NOT NULL, path BLOB NOT NULL,
    UNIQUE (batch, leaf)
);

-- The batch that a transaction anchors.
ALTER TABLE transactions ADD COLUMN batch BLOB;
