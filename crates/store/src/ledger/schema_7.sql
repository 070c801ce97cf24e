-- Version 7: losses are counted durably and told in gap records; retention; what was taken in is counted by itself.

-- How many records of a stream were ever acknowledged: never moved and never lowered, so that the counts per state,
-- which are moved at every step, can be held against it.
CREATE TABLE intake (stream INTEGER PRIMARY KEY, records INTEGER NOT NULL);
INSERT INTO intake SELECT stream, sum(records) FROM counters GROUP BY stream;
CREATE TRIGGER record_taken_in AFTER INSERT ON records BEGIN
    INSERT INTO intake VALUES (NEW.stream, 1) ON CONFLICT DO UPDATE SET records = records + 1;
END;

-- Messages that became no records; `report` is the gap record that tells of them. Numbers are header.seq.
CREATE TABLE gaps (
    key INTEGER PRIMARY KEY, owner BLOB NOT NULL, topic TEXT NOT NULL, publisher TEXT NOT NULL, reason TEXT NOT NULL,
    count INTEGER NOT NULL, first_number INTEGER, last_number INTEGER, first_at INTEGER NOT NULL,
    last_at INTEGER NOT NULL, report BLOB
);
CREATE UNIQUE INDEX gaps_open ON gaps (owner, topic, publisher, reason) WHERE report IS NULL;
CREATE INDEX gaps_by_report ON gaps (report) WHERE report IS NOT NULL;

-- Records whose ciphertext retention deletes; `report` is the retention record that was anchored before, `header` the
-- public header of the stored bytes, `deleted_at` when they were deleted.
CREATE TABLE retained (
    record INTEGER PRIMARY KEY, report BLOB NOT NULL, header BLOB NOT NULL, deleted_at INTEGER
);
CREATE INDEX retained_due ON retained (record) WHERE deleted_at IS NULL;
-- The same on the record itself, for lists.
ALTER TABLE records ADD COLUMN deleted_at INTEGER;
-- What was given up of each topic so far.
CREATE TABLE retained_topics (topic INTEGER PRIMARY KEY, records INTEGER NOT NULL, bytes INTEGER NOT NULL);

-- The newest records of many topics at once, without a look at each topic.
CREATE INDEX records_by_time ON records (captured_at);
