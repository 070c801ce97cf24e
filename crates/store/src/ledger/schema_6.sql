-- Version 6: node forging. Who may publish a topic, who else tried, and which records are held back.

-- Pinned publishers; `source` is how one came to be pinned: first, operator.
CREATE TABLE pins (
    owner BLOB NOT NULL, topic TEXT NOT NULL, caller_id TEXT NOT NULL, host TEXT NOT NULL, type_name TEXT NOT NULL,
    md5sum TEXT NOT NULL, source TEXT NOT NULL, at INTEGER NOT NULL,
    PRIMARY KEY (owner, topic, caller_id, host, type_name, md5sum)
) WITHOUT ROWID;
-- Topics that had pins once: there is no second first use.
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
