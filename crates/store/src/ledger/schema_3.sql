-- Nonce lanes ask for all transactions of one nonce; the watcher keeps the blocks that it has seen.
CREATE INDEX transactions_by_nonce ON transactions (account, nonce);
CREATE TABLE trail (block INTEGER PRIMARY KEY, hash BLOB NOT NULL);

-- Where verified records were anchored on a chain that the operator gave up for another one.
CREATE TABLE earlier_anchors (
    record INTEGER PRIMARY KEY, domain BLOB NOT NULL, tx BLOB, block INTEGER NOT NULL, block_hash BLOB
);
