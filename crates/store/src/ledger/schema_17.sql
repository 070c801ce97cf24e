-- Version 17: what owners state of erased records, in the order in which the other gateways of a fleet are told of it.

-- `account` is the signature of the owner's account, without which nobody erases a copy; NULL = not signed by it. `taken`: it
-- came from elsewhere, and accounts for bytes whose retention record need not be here. A number is given anew when the bytes
-- are gone, or the statement is another one: whoever has read past the earlier number reads it again.
CREATE TABLE erasures (
    n INTEGER PRIMARY KEY AUTOINCREMENT, record INTEGER NOT NULL UNIQUE, statement BLOB NOT NULL, account BLOB,
    taken INTEGER NOT NULL
);
INSERT INTO erasures (record, statement, taken)
    SELECT one.n, unhex(value), NOT EXISTS (SELECT 1 FROM settings own WHERE own.key = 'erased:' || lower(hex(report)))
    FROM settings JOIN records one ON one.digest = unhex(substr(settings.key, 12))
    LEFT JOIN retained ON retained.record = one.n
    WHERE settings.key >= 'erasure of:' AND settings.key < 'erasure of;' AND unhex(value) IS NOT NULL;
DELETE FROM settings WHERE key >= 'erasure of:' AND key < 'erasure of;';
