-- The store: a row and the ciphertext of each record, and what moves it along its path.

-- The one row about this file. `clean` is 0 while a process has it open.
-- `recorder` is the prefix of the ids of its own recorders.
CREATE TABLE about (
    one INTEGER PRIMARY KEY CHECK (one = 1), recorder BLOB NOT NULL, clean INTEGER NOT NULL, head INTEGER NOT NULL
);

-- Random ids of the feed, one for each process that gave numbers, with the last number given before; a restore leaves only
-- a new one. A number beyond the one at which the next id begins was given under an id by a file that this one was once, and
-- is no more.
CREATE TABLE feeds (key INTEGER PRIMARY KEY, id BLOB NOT NULL UNIQUE, after INTEGER NOT NULL);

-- Who numbers: a ledger or ring, with the key that signs there. A number belongs to owner, signer, recorder and topic.
CREATE TABLE recorders (key INTEGER PRIMARY KEY, id BLOB NOT NULL, signer BLOB NOT NULL, UNIQUE (id, signer));

-- Names that many records share. `keeper` is the account that anchors a topic's records for its owner; NULL where the
-- owner does.
CREATE TABLE topics (
    key INTEGER PRIMARY KEY, owner BLOB NOT NULL, recorder INTEGER NOT NULL, topic_id BLOB NOT NULL,
    name TEXT NOT NULL, keeper BLOB, UNIQUE (owner, topic_id, recorder)
);
CREATE TABLE streams (
    key INTEGER PRIMARY KEY, topic INTEGER NOT NULL, kind INTEGER NOT NULL, type_name TEXT NOT NULL,
    UNIQUE (topic, kind, type_name)
);

-- `tx`, `block` and `block_hash` are of a transaction that anchors this record by itself; a record without one has those of
-- its batch. `deleted_at` is set when retention deletes the ciphertext.
CREATE TABLE records (
    n INTEGER PRIMARY KEY, digest BLOB NOT NULL UNIQUE, topic INTEGER NOT NULL, stream INTEGER NOT NULL,
    seq INTEGER NOT NULL, epoch INTEGER NOT NULL, signature BLOB NOT NULL, bytes INTEGER NOT NULL,
    captured_at INTEGER NOT NULL, acknowledged_at INTEGER NOT NULL, simulated INTEGER NOT NULL,
    state INTEGER NOT NULL, tx BLOB, block INTEGER, block_hash BLOB, deleted_at INTEGER, UNIQUE (topic, seq)
);
CREATE INDEX records_by_time ON records (captured_at);

-- What readers may be given, in the order in which it came to be so. A row comes with the commit that verifies a record, and
-- goes with the one that takes this back; the erasure of a verified record replaces its row, and so does another statement of
-- its owner about it. An owner's notice, which must not wait for the chain, also has a row as long as it waits. A record has
-- at most one row, and no number is used twice: `about.head` is the last one (AUTOINCREMENT would write whenever a trigger
-- could have fired). What is taken back uses one too, without a row: a follower who has read past the row that is gone is then
-- beyond the end of an older copy of this file, which still has the row, and reads that copy anew. `fact`: 1 stored, 2
-- verified, 3 erased.
CREATE TABLE feed (
    number INTEGER PRIMARY KEY, record INTEGER NOT NULL UNIQUE, topic INTEGER NOT NULL, fact INTEGER NOT NULL
);
CREATE TRIGGER record_verified AFTER UPDATE OF state ON records WHEN NEW.state = 6 AND OLD.state <> 6 BEGIN
    UPDATE about SET head = head + 1;
    INSERT OR REPLACE INTO feed
        SELECT head, NEW.n, NEW.topic, CASE WHEN NEW.deleted_at IS NULL THEN 2 ELSE 3 END FROM about;
END;
CREATE TRIGGER record_taken_back AFTER UPDATE OF state ON records WHEN NEW.state <> 6 AND OLD.state = 6 BEGIN
    DELETE FROM feed WHERE record = NEW.n;
    UPDATE about SET head = head + 1;
    INSERT INTO feed SELECT head, NEW.n, NEW.topic, 1 FROM about
        WHERE NEW.state < 6 AND (SELECT kind FROM streams WHERE key = NEW.stream) = 5;
END;
CREATE TRIGGER record_erased AFTER UPDATE OF deleted_at ON records
WHEN NEW.state = 6 AND NEW.deleted_at IS NOT NULL AND OLD.deleted_at IS NULL BEGIN
    UPDATE about SET head = head + 1;
    INSERT OR REPLACE INTO feed SELECT head, NEW.n, NEW.topic, 3 FROM about;
END;

-- Stored bytes of records, written in the commit of their rows. Beside the rows, not in them: lists read rows alone.
CREATE TABLE ciphertext (record INTEGER PRIMARY KEY, bytes BLOB NOT NULL);

-- Filter ids of records, as their headers have them, each id once, and the streams that ever had records with one: a
-- search skips all others.
CREATE TABLE filter_ids (key INTEGER PRIMARY KEY, id BLOB NOT NULL UNIQUE);
CREATE TABLE filters (filter INTEGER NOT NULL, record INTEGER NOT NULL, PRIMARY KEY (filter, record)) WITHOUT ROWID;
CREATE TABLE filter_streams (
    filter INTEGER NOT NULL, stream INTEGER NOT NULL, PRIMARY KEY (filter, stream)
) WITHOUT ROWID;

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

-- How many records of a stream were ever acknowledged. Never moved and never lowered, so that the counts per state,
-- which move at every step, can be compared with it.
CREATE TABLE intake (stream INTEGER PRIMARY KEY, records INTEGER NOT NULL);
CREATE TRIGGER record_taken_in AFTER INSERT ON records BEGIN
    INSERT INTO intake VALUES (NEW.stream, 1) ON CONFLICT DO UPDATE SET records = records + 1;
END;

-- What a grant of an epoch opens: the records of a stream that a reader may have, and when the first and the last were
-- captured, which is not after their arrival here, whatever the recorder's clock says. Those in quarantine (7), discarded
-- (8) and erased are not counted, but their epoch has a row all the same.
CREATE TABLE epoch_records (
    stream INTEGER NOT NULL, epoch INTEGER NOT NULL, records INTEGER NOT NULL, first_at INTEGER NOT NULL,
    last_at INTEGER NOT NULL, PRIMARY KEY (stream, epoch)
) WITHOUT ROWID;
CREATE TRIGGER record_sealed AFTER INSERT ON records BEGIN
    INSERT INTO epoch_records VALUES (
        NEW.stream, NEW.epoch, NEW.state NOT IN (7, 8) AND NEW.deleted_at IS NULL,
        min(NEW.captured_at, NEW.acknowledged_at), min(NEW.captured_at, NEW.acknowledged_at)
    ) ON CONFLICT DO UPDATE SET records = records + excluded.records, first_at = min(first_at, excluded.first_at),
        last_at = max(last_at, excluded.last_at);
END;
CREATE TRIGGER record_opens AFTER UPDATE OF state, deleted_at ON records
WHEN (NEW.state NOT IN (7, 8) AND NEW.deleted_at IS NULL) <> (OLD.state NOT IN (7, 8) AND OLD.deleted_at IS NULL) BEGIN
    UPDATE epoch_records SET records = records + iif(NEW.state NOT IN (7, 8) AND NEW.deleted_at IS NULL, 1, -1)
        WHERE stream = NEW.stream AND epoch = NEW.epoch;
END;

-- What the sender signed; `digests` are the records it anchors, 32 bytes each, `batch` the root it anchors.
CREATE TABLE transactions (
    key INTEGER PRIMARY KEY, hash BLOB NOT NULL UNIQUE, account BLOB NOT NULL, nonce INTEGER NOT NULL,
    raw BLOB NOT NULL, purpose TEXT NOT NULL, digests BLOB NOT NULL, signed_at INTEGER NOT NULL,
    state INTEGER NOT NULL, block INTEGER, block_hash BLOB, gas_used INTEGER, reason TEXT, replaced_by BLOB,
    batch BLOB
);

-- A closed batch; `account`, `tx` and `block` as the chain has them, or as the sender last tried. `proof`: NULL = not
-- fetched yet, 1 = kept, 2 = could not be had. `closed_here`: 1 where this ledger closed it, so that all of its records
-- are here; 0 where another one did, and only some may be.
CREATE TABLE batches (
    key INTEGER PRIMARY KEY, root BLOB NOT NULL UNIQUE, owner BLOB NOT NULL, count INTEGER NOT NULL,
    closed_at INTEGER NOT NULL, account BLOB, tx BLOB, block INTEGER, block_hash BLOB,
    proof INTEGER, closed_here INTEGER NOT NULL
);

-- A record's place in its batch, and what leads from there to the root: sixteen leaves beside each other are a branch, whose
-- `path` has those nodes of its lowest four levels that do not follow from others, and the steps above them (branches.rs).
CREATE TABLE leaves (
    record INTEGER PRIMARY KEY, batch INTEGER NOT NULL, leaf INTEGER NOT NULL, UNIQUE (batch, leaf)
);
CREATE TABLE branches (
    batch INTEGER NOT NULL, branch INTEGER NOT NULL, path BLOB NOT NULL, PRIMARY KEY (batch, branch)
) WITHOUT ROWID;

-- Records that left the batch they were placed in, each with its place there: nobody sent the batch, or the block that
-- has its root does not count for them.
CREATE TABLE left_places (
    batch INTEGER NOT NULL, leaf INTEGER NOT NULL, record INTEGER NOT NULL, PRIMARY KEY (batch, leaf)
) WITHOUT ROWID;

-- Records anchored by a block in which their signer had no right; they are anchored again, in another batch.
CREATE TABLE passed_over (record INTEGER PRIMARY KEY, block INTEGER NOT NULL);

-- Nodes of the chain's tries, each once, and the state after a block as far as it is kept: `nodes` are keys of
-- chain_nodes, 8 bytes each, big-endian.
CREATE TABLE chain_nodes (key INTEGER PRIMARY KEY, hash BLOB NOT NULL UNIQUE, node BLOB NOT NULL);
CREATE TABLE chain_proofs (block INTEGER PRIMARY KEY, hash BLOB NOT NULL, nodes BLOB NOT NULL);

-- The headers of those blocks, and of the blocks after them whose sealers confirm them; RLP.
CREATE TABLE chain_headers (block INTEGER PRIMARY KEY, header BLOB NOT NULL);

-- How far the watcher has read, and the blocks that it has seen.
CREATE TABLE cursor (one INTEGER PRIMARY KEY CHECK (one = 1), block INTEGER NOT NULL, hash BLOB NOT NULL);
CREATE TABLE trail (block INTEGER PRIMARY KEY, hash BLOB NOT NULL);

-- The chain and contract that this home is bound to (`pin`: JSON), with the block and the place in it of the last event
-- read.
CREATE TABLE contract (
    one INTEGER PRIMARY KEY CHECK (one = 1), domain BLOB NOT NULL, pin TEXT NOT NULL, block INTEGER NOT NULL,
    place INTEGER NOT NULL
);

-- Its events. `kind`: 1 a grant, 2 an envelope of a further epoch, 3 an extension, 4 the beginning of an epoch, with
-- the grantee where it is a revocation, 5 any other. `replaced` is the block of the event that replaced this one,
-- `revoked` the epoch that began with the revocation of its grant, in the block `revoked_at`. An event with neither stands.
CREATE TABLE rights (
    block INTEGER NOT NULL, place INTEGER NOT NULL, kind INTEGER NOT NULL, owner BLOB, grantee BLOB, epoch INTEGER,
    token BLOB, event TEXT NOT NULL, replaced INTEGER, revoked INTEGER, revoked_at INTEGER, PRIMARY KEY (block, place)
) WITHOUT ROWID;

-- The envelopes of grants and later events; read only by those who open them.
CREATE TABLE envelopes (
    block INTEGER NOT NULL, place INTEGER NOT NULL, envelope BLOB NOT NULL, PRIMARY KEY (block, place)
) WITHOUT ROWID;

-- Small values, each of one type: the list of kinds is in notes.rs. `value` is JSON, a list of one.
CREATE TABLE notes (kind TEXT, about TEXT, value TEXT NOT NULL, PRIMARY KEY (kind, about)) WITHOUT ROWID;

-- The audit log: `hash` covers the line and the hash of the line before.
CREATE TABLE audit (
    line INTEGER PRIMARY KEY, at INTEGER NOT NULL, profile TEXT NOT NULL, action TEXT NOT NULL,
    subject TEXT NOT NULL, outcome TEXT NOT NULL, hash BLOB NOT NULL
);

-- Public keys of lent devices by their ids; the chain has only the ids.
CREATE TABLE signers (id BLOB PRIMARY KEY, key BLOB NOT NULL) WITHOUT ROWID;

-- Names at this site's gateway. `sealed_key` is the transport key, sealed; `device` is SM3 of the public key of the
-- device that a name belongs to, NULL where it is its account's own; `notices` is the topic id of its owner's notices
-- to it.
CREATE TABLE bindings (
    name TEXT PRIMARY KEY, account BLOB NOT NULL, signing BLOB NOT NULL, envelope BLOB NOT NULL,
    sealed_key BLOB NOT NULL, device BLOB, notices BLOB, CHECK ((device IS NULL) = (notices IS NULL))
) WITHOUT ROWID;

-- Names behind the pseudonyms (hex) of an owner's topics and types, learned by opening one of their records.
CREATE TABLE names (
    owner BLOB NOT NULL, id TEXT NOT NULL, name TEXT NOT NULL, PRIMARY KEY (owner, id)
) WITHOUT ROWID;

-- Signed receipts of a gateway that anchors records for this ledger, kept until each record is verified.
CREATE TABLE receipts (
    key INTEGER PRIMARY KEY, at INTEGER NOT NULL, digests BLOB NOT NULL, signature BLOB NOT NULL
);
CREATE TABLE receipted (record INTEGER PRIMARY KEY, receipt INTEGER NOT NULL);
CREATE INDEX receipted_by_receipt ON receipted (receipt);

-- Statements by which a gateway says how records stand: its time, what it signed (without label and domain), the
-- signature.
CREATE TABLE standings (key INTEGER PRIMARY KEY, at INTEGER NOT NULL, statement BLOB NOT NULL, signature BLOB NOT NULL);

-- Which statement says that a forwarded record is verified, with the proof of its anchor, checked; `gone` once its
-- ciphertext was given up.
CREATE TABLE proven (
    record INTEGER PRIMARY KEY, standing INTEGER NOT NULL, proof BLOB NOT NULL, at INTEGER NOT NULL,
    gone INTEGER NOT NULL
);
CREATE INDEX proven_by_age ON proven (gone, at);

-- Pinned publishers; `source` is how one came to be pinned: first, operator. A topic that had pins once gets no
-- second first use.
CREATE TABLE pins (
    owner BLOB NOT NULL, topic TEXT NOT NULL, caller_id TEXT NOT NULL, host TEXT NOT NULL, type_name TEXT NOT NULL,
    md5sum TEXT NOT NULL, source TEXT NOT NULL, at INTEGER NOT NULL,
    PRIMARY KEY (owner, topic, caller_id, host, type_name, md5sum)
) WITHOUT ROWID;
CREATE TABLE pinned_topics (owner BLOB NOT NULL, topic TEXT NOT NULL, PRIMARY KEY (owner, topic)) WITHOUT ROWID;

-- Publishers that an alarm was raised about; `open` until the operator has decided about the topic.
CREATE TABLE alarms (
    owner BLOB NOT NULL, topic TEXT NOT NULL, publisher TEXT NOT NULL, reason TEXT NOT NULL, at INTEGER NOT NULL,
    open INTEGER NOT NULL, PRIMARY KEY (owner, topic, publisher)
) WITHOUT ROWID;

-- Every record that was ever quarantined; `report` is the quarantine record that counts it, `decision` what the
-- operator did: released, discarded.
CREATE TABLE held (
    record INTEGER PRIMARY KEY, minute INTEGER NOT NULL, reason TEXT NOT NULL, publisher TEXT NOT NULL,
    report BLOB, decision TEXT, decided_at INTEGER
);
CREATE INDEX held_unreported ON held (record) WHERE report IS NULL;
CREATE INDEX held_undecided ON held (record) WHERE decision IS NULL;

-- Messages that became no records; `report` is the gap record about them. Numbers are header.seq.
CREATE TABLE gaps (
    key INTEGER PRIMARY KEY, owner BLOB NOT NULL, topic TEXT NOT NULL, publisher TEXT NOT NULL, reason TEXT NOT NULL,
    count INTEGER NOT NULL, first_number INTEGER, last_number INTEGER, first_at INTEGER NOT NULL,
    last_at INTEGER NOT NULL, report BLOB
);
CREATE UNIQUE INDEX gaps_open ON gaps (owner, topic, publisher, reason) WHERE report IS NULL;
CREATE INDEX gaps_by_report ON gaps (report) WHERE report IS NOT NULL;

-- Records whose ciphertext retention deletes; `report` is the retention record that was anchored before, `header` the
-- public header of the stored bytes, `deleted_at` when they were deleted. And what was deleted of each topic so far.
CREATE TABLE retained (
    record INTEGER PRIMARY KEY, report BLOB NOT NULL, header BLOB NOT NULL, deleted_at INTEGER
);
CREATE TABLE retained_topics (topic INTEGER PRIMARY KEY, records INTEGER NOT NULL, bytes INTEGER NOT NULL);

-- What owners state of erased records. `account` is the signature of the owner's account, without which nobody erases
-- a copy; NULL = not signed by it. `taken`: it came from elsewhere, and accounts for bytes whose retention record need
-- not be here.
CREATE TABLE erasures (
    n INTEGER PRIMARY KEY AUTOINCREMENT, record INTEGER NOT NULL UNIQUE, statement BLOB NOT NULL, account BLOB,
    taken INTEGER NOT NULL
);
-- Who was told that a record is erased, and was given no statement that he could believe, asks again.
CREATE TRIGGER erasure_stated AFTER INSERT ON erasures
WHEN EXISTS (SELECT 1 FROM feed WHERE record = NEW.record AND fact = 3) BEGIN
    UPDATE about SET head = head + 1;
    UPDATE feed SET number = (SELECT head FROM about) WHERE record = NEW.record AND fact = 3;
END;

-- Time from outside. A stamp is over many roots of batches, in their order, 32 bytes each; `upto` is the last batch
-- under it. Each authority that stamped it gave a token; a stamp without any waits. `authority` is SHA-256 of the pinned
-- certificate, `before` the latest moment that the token allows.
CREATE TABLE stamps (key INTEGER PRIMARY KEY, made_at INTEGER NOT NULL, upto INTEGER NOT NULL, roots BLOB NOT NULL);
CREATE TABLE stamped_roots (root BLOB PRIMARY KEY, stamp INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE stamp_tokens (
    stamp INTEGER NOT NULL, authority BLOB NOT NULL, before INTEGER NOT NULL, token BLOB NOT NULL,
    PRIMARY KEY (stamp, authority)
) WITHOUT ROWID;

-- Incidents: spans of time and topics, by name or pattern, whose records retention leaves alone. `until` is NULL while
-- one goes on; one without topics is about all topics of its owner.
CREATE TABLE incidents (
    key INTEGER PRIMARY KEY, owner BLOB NOT NULL, name TEXT NOT NULL, since INTEGER NOT NULL, until INTEGER,
    opened_at INTEGER NOT NULL, closed_at INTEGER, UNIQUE (owner, name)
);
CREATE TABLE incident_topics (
    incident INTEGER NOT NULL, topic TEXT NOT NULL, PRIMARY KEY (incident, topic)
) WITHOUT ROWID;
CREATE TABLE incident_notes (
    incident INTEGER NOT NULL, number INTEGER NOT NULL, at INTEGER NOT NULL, text TEXT NOT NULL,
    PRIMARY KEY (incident, number)
) WITHOUT ROWID;
