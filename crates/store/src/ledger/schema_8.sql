-- Version 8: lists read the index of states, stream by stream and state by state; an index of streams alone cost each
-- new record a page of its own.
DROP INDEX records_by_stream;

-- Which streams ever had records with a filter id: a search passes over all others.
CREATE TABLE filter_streams (
    filter BLOB NOT NULL, stream INTEGER NOT NULL, PRIMARY KEY (filter, stream)
) WITHOUT ROWID;
INSERT INTO filter_streams SELECT DISTINCT filter, stream FROM filters JOIN records ON n = record;
