-- Version 8: lists read the index of states, stream by stream and state by state; an index of streams alone cost each
-- new record a page of its own.
DROP INDEX records_by_stream;
