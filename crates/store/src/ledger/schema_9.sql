-- Version 9: whose a name is at this site's gateway, and what a robot holds before it gives its only copy away.

-- `device` is SM3 of the public key of the device that a name belongs to, nothing where it is its account's own;
-- `notices` is the topic id of its owner's notices to it, where that was told.
ALTER TABLE bindings ADD COLUMN device BLOB;
ALTER TABLE bindings ADD COLUMN notices BLOB;

-- How records stand by a gateway's signature: its time, what it signed (without label and domain), the signature.
CREATE TABLE standings (key INTEGER PRIMARY KEY, at INTEGER NOT NULL, statement BLOB NOT NULL, signature BLOB NOT NULL);
-- Which statement says that a forwarded record is verified, with the proof of its anchor, checked; `gone` once its
-- ciphertext was given up.
CREATE TABLE proven (
    record INTEGER PRIMARY KEY, standing INTEGER NOT NULL, proof BLOB NOT NULL, at INTEGER NOT NULL,
    gone INTEGER NOT NULL
);
CREATE INDEX proven_by_age ON proven (gone, at);
-- Robots gave ciphertext up by a gateway's word so far: what was verified so, without transaction, block or batch here, is
-- gone already (7 = verified).
INSERT INTO proven SELECT n, 0, x'', 0, 1 FROM records
WHERE state = 7 AND tx IS NULL AND block IS NULL AND NOT EXISTS (SELECT 1 FROM leaves WHERE record = n);
