-- Version 12: time from outside. A stamp is over many roots of batches, in their order, 32 bytes each; `upto` is the last
-- batch under it. Each authority that stamped it gave a token; one without any waits.
CREATE TABLE stamps (key INTEGER PRIMARY KEY, made_at INTEGER NOT NULL, upto INTEGER NOT NULL, roots BLOB NOT NULL);
CREATE TABLE stamped_roots (root BLOB PRIMARY KEY, stamp INTEGER NOT NULL) WITHOUT ROWID;
-- `authority` is SHA-256 of the certificate that is pinned, `before` the end of the time that the token says.
CREATE TABLE stamp_tokens (
    stamp INTEGER NOT NULL, authority BLOB NOT NULL, before INTEGER NOT NULL, token BLOB NOT NULL,
    PRIMARY KEY (stamp, authority)
) WITHOUT ROWID;
