-- Version 15: which gateways signed for a record. A robot of several gateways passes on what stays without a proof.

CREATE TABLE gateways (key INTEGER PRIMARY KEY, id BLOB NOT NULL UNIQUE);
-- Records that are not verified yet; `at` is when the newest receipt of that gateway was taken here.
CREATE TABLE placed (
    record INTEGER NOT NULL, gateway INTEGER NOT NULL, at INTEGER NOT NULL, PRIMARY KEY (record, gateway)
) WITHOUT ROWID;
CREATE INDEX placed_by_gateway ON placed (gateway, record);
