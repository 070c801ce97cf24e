-- Version 4: records of others that this site keeps and anchors for them, and ids to find records by.

-- The account that anchors a topic's records in its owner's place; nothing where the owner does.
ALTER TABLE topics ADD COLUMN keeper BLOB;
CREATE INDEX topics_by_keeper ON topics (keeper) WHERE keeper IS NOT NULL;

-- Filter ids of records, as their headers have them.
CREATE TABLE filters (filter BLOB NOT NULL, record INTEGER NOT NULL, PRIMARY KEY (filter, record)) WITHOUT ROWID;

-- Public keys of lent devices by their ids; the chain has only the ids.
CREATE TABLE signers (id BLOB PRIMARY KEY, key BLOB NOT NULL) WITHOUT ROWID;

-- What a name stands for at this site's gateway; `sealed_key` is its transport key, sealed.
CREATE TABLE bindings (
    name TEXT PRIMARY KEY, account BLOB NOT NULL, signing BLOB NOT NULL, envelope BLOB NOT NULL,
    sealed_key BLOB NOT NULL
) WITHOUT ROWID;

-- What pseudonyms (hex) of an owner's topics and types stand for, learned by opening one of their records.
CREATE TABLE names (
    owner BLOB NOT NULL, id TEXT NOT NULL, name TEXT NOT NULL, PRIMARY KEY (owner, id)
) WITHOUT ROWID;
