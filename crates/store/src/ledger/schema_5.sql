-- Records that a gateway anchors in this ledger's place: its signed receipts, until each record is verified.
CREATE TABLE receipts (
    key INTEGER PRIMARY KEY, at INTEGER NOT NULL, digests BLOB NOT NULL, signature BLOB NOT NULL
);
CREATE TABLE receipted (record INTEGER PRIMARY KEY, receipt INTEGER NOT NULL);
CREATE INDEX receipted_by_receipt ON receipted (receipt);
