-- Version 16: what the chain proves of each anchored batch, fetched while the node still has the state of its block.

-- Nodes of the chain's tries, each once.
CREATE TABLE chain_nodes (key INTEGER PRIMARY KEY, hash BLOB NOT NULL UNIQUE, node BLOB NOT NULL);
-- The state after a block, as far as it is kept: `nodes` are keys of chain_nodes, 8 bytes each, big-endian.
CREATE TABLE chain_proofs (block INTEGER PRIMARY KEY, hash BLOB NOT NULL, nodes BLOB NOT NULL);
-- NULL = not fetched yet, 1 = kept, 2 = could not be had, 3 = anchored before proofs were kept.
ALTER TABLE batches ADD COLUMN proof INTEGER;
UPDATE batches SET proof = 3 WHERE block IS NOT NULL;
CREATE INDEX batches_unproven ON batches (block) WHERE block IS NOT NULL AND proof IS NULL;
CREATE INDEX batches_without_proof ON batches (block) WHERE proof = 2;
