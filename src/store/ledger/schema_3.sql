-- Nonce lanes ask for all transactions of one nonce; the watcher keeps the blocks that it has seen.
CREATE INDEX transactions_by_nonce ON transactions (account, nonce);
CREATE TABLE trail (block INTEGER PRIMARY KEY, hash BLOB NOT NULL);
