-- Version 1 of the ledger: one row per record, and what moves it along its life line.

-- The one row about this file. `clean` is 0 while a process has it open.
CREATE TABLE about (one INTEGER PRIMARY KEY CHECK (one = 1), recorder INTEGER NOT NULL, clean INTEGER NOT NULL);
CREATE TABLE recorders (key INTEGER PRIMARY KEY, id BLOB NOT NULL UNIQUE);

-- Names that many records share.
CREATE TABLE topics (
    key INTEGER PRIMARY KEY, owner BLOB NOT NULL, recorder INTEGER NOT NULL, topic_id BLOB NOT NULL,
    name TEXT NOT NULL, UNIQUE (owner, topic_id, recorder)
);
CREATE TABLE streams (
    key INTEGER PRIMARY KEY, topic INTEGER NOT NULL, kind INTEGER NOT NULL, type_name TEXT NOT NULL,
    signer BLOB NOT NULL, UNIQUE (topic, kind, type_name, signer)
);

CREATE TABLE records (
    n INTEGER PRIMARY KEY, digest BLOB NOT NULL UNIQUE, topic INTEGER NOT NULL, stream INTEGER NOT NULL,
    seq INTEGER NOT NULL, epoch INTEGER NOT NULL, signature BLOB NOT NULL, bytes INTEGER NOT NULL,
    captured_at INTEGER NOT NULL, acknowledged_at INTEGER NOT NULL, simulated INTEGER NOT NULL,
    state INTEGER NOT NULL, tx BLOB, block INTEGER, block_hash BLOB, UNIQUE (topic, seq)
);
CREATE INDEX records_by_stream ON records (stream, captured_at);
CREATE INDEX records_by_state ON records (state, stream, captured_at);

-- Sealed bytes that are not in a durable vault yet.
CREATE TABLE copies (record INTEGER PRIMARY KEY, blob BLOB NOT NULL);

-- Counts per stream and state, kept in the same transaction as the records.
CREATE TABLE counters (
    stream INTEGER NOT NULL, state INTEGER NOT NULL, records INTEGER NOT NULL, bytes INTEGER NOT NULL,
    PRIMARY KEY (stream, state)
) WITHOUT ROWID;
CREATE TRIGGER record_added AFTER INSERT ON records BEGIN
    INSERT INTO counters VALUES (NEW.stream, NEW.state, 1, NEW.bytes)
        ON CONFLICT DO UPDATE SET records = records + 1, bytes = bytes + NEW.bytes;
END;
CREATE TRIGGER record_moved AFTER UPDATE OF state ON records WHEN NEW.state <> OLD.state BEGIN
    UPDATE counters SET records = records - 1, bytes = bytes - OLD.bytes
        WHERE stream = OLD.stream AND state = OLD.state;
    INSERT INTO counters VALUES (NEW.stream, NEW.state, 1, NEW.bytes)
        ON CONFLICT DO UPDATE SET records = records + 1, bytes = bytes + NEW.bytes;
END;
CREATE TABLE drops (
    owner BLOB NOT NULL, topic TEXT NOT NULL, reason TEXT NOT NULL, count INTEGER NOT NULL,
    PRIMARY KEY (owner, topic, reason)
) WITHOUT ROWID;

-- What the sender signed; `digests` are the records that it anchors, 32 bytes each.
CREATE TABLE transactions (
    key INTEGER PRIMARY KEY, hash BLOB NOT NULL UNIQUE, account BLOB NOT NULL, nonce INTEGER NOT NULL,
    raw BLOB NOT NULL, purpose TEXT NOT NULL, digests BLOB NOT NULL, signed_at INTEGER NOT NULL,
    state INTEGER NOT NULL, block INTEGER, block_hash BLOB, gas_used INTEGER, reason TEXT, replaced_by BLOB
);
CREATE INDEX transactions_open ON transactions (account, nonce) WHERE state = 0;
CREATE INDEX transactions_mined ON transactions (block) WHERE state = 1;

-- Merkle batches and each record's place and proof in one.
CREATE TABLE batches (
    key INTEGER PRIMARY KEY, root BLOB NOT NULL UNIQUE, count INTEGER NOT NULL, previous BLOB NOT NULL,
    sender BLOB NOT NULL, tx BLOB
);
CREATE TABLE leaves (
    record INTEGER PRIMARY KEY, batch INTEGER NOT NULL, leaf INTEGER NOT NULL, proof BLOB NOT NULL,
    UNIQUE (batch, leaf)
);

-- What the watcher keeps: where it stands, and events that readers ask for later.
CREATE TABLE cursors (name TEXT PRIMARY KEY, block INTEGER NOT NULL, hash BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE events (
    block INTEGER NOT NULL, position INTEGER NOT NULL, name TEXT NOT NULL, tx BLOB NOT NULL, body TEXT NOT NULL,
    PRIMARY KEY (block, position)
) WITHOUT ROWID;
CREATE INDEX events_by_name ON events (name, block, position);

CREATE TABLE settings (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;

-- The audit log: `hash` covers the line and the hash of the line before.
CREATE TABLE audit (
    line INTEGER PRIMARY KEY, at INTEGER NOT NULL, profile TEXT NOT NULL, action TEXT NOT NULL,
    subject TEXT NOT NULL, outcome TEXT NOT NULL, hash BLOB NOT NULL
);
