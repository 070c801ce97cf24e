-- Version 1 of the embedded vault: sealed records by digest, and how much there is of them.
CREATE TABLE blobs (n INTEGER PRIMARY KEY, digest BLOB NOT NULL UNIQUE, bytes BLOB NOT NULL);
CREATE TABLE used (one INTEGER PRIMARY KEY CHECK (one = 1), entries INTEGER NOT NULL, bytes INTEGER NOT NULL);
INSERT INTO used VALUES (1, 0, 0);
CREATE TRIGGER blob_added AFTER INSERT ON blobs BEGIN
    UPDATE used SET entries = entries + 1, bytes = bytes + length(NEW.bytes);
END;
CREATE TRIGGER blob_changed AFTER UPDATE OF bytes ON blobs BEGIN
    UPDATE used SET bytes = bytes + length(NEW.bytes) - length(OLD.bytes);
END;
CREATE TRIGGER blob_removed AFTER DELETE ON blobs BEGIN
    UPDATE used SET entries = entries - 1, bytes = bytes - length(OLD.bytes);
END;
