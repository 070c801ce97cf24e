-- Version 13: incidents: spans of time and topics whose records retention leaves alone.

-- `until` is NULL while the incident goes on; one without topics is about all topics of its owner.
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
