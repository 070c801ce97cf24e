-- Version 10: records whose signer's right has ended wait for it (state 11), and what anchors them without it does not count.

-- Records that left the batch which was made with them, each with its place there: nobody sent the batch, or the block
-- that has its root does not count for them.
CREATE TABLE left_places (
    batch INTEGER NOT NULL, leaf INTEGER NOT NULL, record INTEGER NOT NULL, PRIMARY KEY (batch, leaf)
) WITHOUT ROWID;

-- Records that a block anchors in which their signer had no right; they are anchored anew, in a batch.
CREATE TABLE passed_over (record INTEGER PRIMARY KEY, tx BLOB, block INTEGER NOT NULL);
