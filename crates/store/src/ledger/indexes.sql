-- Of both engines, made after the tables of either; what only one needs stands with its tables.
CREATE INDEX topics_by_keeper ON topics (keeper) WHERE keeper IS NOT NULL;
CREATE INDEX records_by_state ON records (state, stream, captured_at);
CREATE INDEX transactions_open ON transactions (account, nonce) WHERE state = 0;
CREATE INDEX transactions_mined ON transactions (block) WHERE state = 1;
CREATE INDEX transactions_by_nonce ON transactions (account, nonce);
CREATE INDEX batches_waiting ON batches (owner, key) WHERE tx IS NULL;
CREATE INDEX batches_anchored ON batches (block) WHERE block IS NOT NULL;
CREATE INDEX batches_unproven ON batches (block) WHERE block IS NOT NULL AND proof IS NULL;
CREATE INDEX batches_without_proof ON batches (block) WHERE proof = 2;
CREATE INDEX rights_standing ON rights (owner, kind, grantee) WHERE replaced IS NULL AND revoked IS NULL;
CREATE INDEX rights_given ON rights (owner, grantee) WHERE revoked IS NOT NULL;
CREATE INDEX rights_received ON rights (grantee) WHERE revoked IS NOT NULL;
CREATE INDEX rights_tokens ON rights (owner, epoch) WHERE token IS NOT NULL;
CREATE INDEX rights_own ON rights (owner, epoch) WHERE kind = 6;
CREATE INDEX retained_due ON retained (record) WHERE deleted_at IS NULL;
