--
-- PostgreSQL database dump
--


-- Dumped from database version 15.18 (Debian 15.18-0+deb12u1)
-- Dumped by pg_dump version 15.18 (Debian 15.18-0+deb12u1)

SET statement_timeout = 0;
SET lock_timeout = 0;
SET idle_in_transaction_session_timeout = 0;
SET client_encoding = 'UTF8';
SET standard_conforming_strings = on;
SELECT pg_catalog.set_config('search_path', '', false);
SET check_function_bodies = false;
SET xmloption = content;
SET client_min_messages = warning;
SET row_security = off;

--
-- Name: count_added(); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.count_added() RETURNS trigger
    LANGUAGE plpgsql
    AS $$
BEGIN
    INSERT INTO pending_counters AS p SELECT stream, state, count(*), sum(bytes), count(*) FROM added GROUP BY stream, state
        ON CONFLICT (stream, state) DO UPDATE SET records = p.records + excluded.records,
        bytes = p.bytes + excluded.bytes, taken_in = p.taken_in + excluded.taken_in;
    INSERT INTO pending_epochs AS p
        SELECT stream, epoch, count(*) FILTER (WHERE state NOT IN (7, 8) AND deleted_at IS NULL),
            min(least(captured_at, acknowledged_at)), max(least(captured_at, acknowledged_at))
        FROM added GROUP BY stream, epoch
        ON CONFLICT (stream, epoch) DO UPDATE SET records = p.records + excluded.records,
        first_at = least(p.first_at, excluded.first_at), last_at = greatest(p.last_at, excluded.last_at);
    RETURN NULL;
END $$;


--
-- Name: count_moved(); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.count_moved() RETURNS trigger
    LANGUAGE plpgsql
    AS $$
DECLARE
    moved BIGINT;
    opened BIGINT;
    verified BIGINT;
    lost BIGINT;
    erased BIGINT;
    top BIGINT;
BEGIN
    SELECT count(*) FILTER (WHERE a.state <> b.state),
        count(*) FILTER (WHERE (a.state NOT IN (7, 8) AND a.deleted_at IS NULL)
            <> (b.state NOT IN (7, 8) AND b.deleted_at IS NULL)),
        count(*) FILTER (WHERE a.state = 6 AND b.state <> 6),
        count(*) FILTER (WHERE a.state <> 6 AND b.state = 6),
        count(*) FILTER (WHERE a.state = 6 AND a.deleted_at IS NOT NULL AND b.deleted_at IS NULL)
        INTO moved, opened, verified, lost, erased FROM before b JOIN after a USING (n);
    IF moved > 0 THEN
        INSERT INTO pending_counters AS p
            SELECT moves.stream, moves.state, sum(moves.records), sum(moves.bytes), 0 FROM (
                SELECT b.stream, b.state, -1 AS records, -b.bytes AS bytes FROM before b JOIN after a USING (n)
                WHERE a.state <> b.state
                UNION ALL
                SELECT a.stream, a.state, 1, a.bytes FROM before b JOIN after a USING (n) WHERE a.state <> b.state
            ) moves GROUP BY moves.stream, moves.state
            ON CONFLICT (stream, state) DO UPDATE SET records = p.records + excluded.records,
            bytes = p.bytes + excluded.bytes;
    END IF;
    IF opened > 0 THEN
        INSERT INTO pending_epochs AS p
            SELECT a.stream, a.epoch, sum(CASE WHEN a.state NOT IN (7, 8) AND a.deleted_at IS NULL THEN 1 ELSE -1 END)
            FROM before b JOIN after a USING (n)
            WHERE (a.state NOT IN (7, 8) AND a.deleted_at IS NULL) <> (b.state NOT IN (7, 8) AND b.deleted_at IS NULL)
            GROUP BY a.stream, a.epoch
            ON CONFLICT (stream, epoch) DO UPDATE SET records = p.records + excluded.records;
    END IF;

    -- The feed. The holder of the lease verifies and takes back, so it alone gives numbers; what others erase waits for it.
    IF verified > 0 THEN
        UPDATE about SET head = head + verified RETURNING head INTO top;
        INSERT INTO feed
            SELECT top - verified + row_number() OVER (ORDER BY n), n, a.topic,
                CASE WHEN a.deleted_at IS NULL THEN 2 ELSE 3 END
            FROM before b JOIN after a USING (n) WHERE a.state = 6 AND b.state <> 6
            ON CONFLICT (record) DO UPDATE SET number = excluded.number, fact = excluded.fact;
    END IF;
    IF lost > 0 THEN
        UPDATE about SET head = head + lost RETURNING head INTO top;
        DELETE FROM feed WHERE record IN (SELECT n FROM before b JOIN after a USING (n) WHERE a.state <> 6 AND b.state = 6);
        INSERT INTO feed SELECT place, n, topic, 1 FROM (
            SELECT top - lost + row_number() OVER (ORDER BY n) AS place, n, a.topic, a.state, a.stream
            FROM before b JOIN after a USING (n) WHERE a.state <> 6 AND b.state = 6
        ) back WHERE back.state < 6 AND (SELECT kind FROM streams WHERE key = back.stream) = 5;
    END IF;
    IF erased > 0 THEN
        INSERT INTO unnumbered (record) SELECT n FROM before b JOIN after a USING (n)
            WHERE a.state = 6 AND a.deleted_at IS NOT NULL AND b.deleted_at IS NULL ORDER BY n;
    END IF;
    RETURN NULL;
END $$;


--
-- Name: erasure_stated(); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.erasure_stated() RETURNS trigger
    LANGUAGE plpgsql
    AS $$
BEGIN
    IF EXISTS (SELECT 1 FROM feed WHERE record = NEW.record AND fact = 3) THEN
        INSERT INTO unnumbered (record) VALUES (NEW.record);
    END IF;
    RETURN NULL;
END $$;


--
-- Name: fold(); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.fold() RETURNS void
    LANGUAGE sql
    AS $$
    WITH gone AS (DELETE FROM counter_deltas RETURNING *)
    INSERT INTO counter_deltas SELECT stream, state, sum(records), sum(bytes), sum(taken_in) FROM gone GROUP BY stream, state;
    WITH gone AS (DELETE FROM epoch_deltas RETURNING *)
    INSERT INTO epoch_deltas SELECT stream, epoch, sum(records), min(first_at), max(last_at) FROM gone GROUP BY stream, epoch;
$$;


--
-- Name: hex(bytea); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.hex(bytea) RETURNS text
    LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
    AS $_$ SELECT upper(encode($1, 'hex')) $_$;


--
-- Name: instr(text, text); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.instr(text, text) RETURNS integer
    LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
    AS $_$ SELECT strpos($1, $2) $_$;


--
-- Name: max(bigint, bigint); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.max(bigint, bigint) RETURNS bigint
    LANGUAGE sql IMMUTABLE PARALLEL SAFE
    AS $_$ SELECT greatest($1, $2) $_$;


--
-- Name: min(bigint, bigint); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.min(bigint, bigint) RETURNS bigint
    LANGUAGE sql IMMUTABLE PARALLEL SAFE
    AS $_$ SELECT least($1, $2) $_$;


--
-- Name: now_ms(); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.now_ms() RETURNS bigint
    LANGUAGE sql
    AS $$ SELECT (extract(epoch FROM clock_timestamp()) * 1000)::BIGINT $$;


--
-- Name: number_waiting(bytea, bigint); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.number_waiting(worker bytea, lease_number bigint) RETURNS bigint
    LANGUAGE plpgsql
    AS $$
DECLARE
    given BIGINT;
BEGIN
    PERFORM 1 FROM unnumbered LIMIT 1;
    IF NOT FOUND THEN
        RETURN 0;
    END IF;
    PERFORM 1 FROM standing_lease WHERE holder = worker AND number = lease_number;
    IF NOT FOUND THEN
        RETURN 0;
    END IF;
    WITH gone AS (DELETE FROM unnumbered RETURNING key, record), waiting AS (
        SELECT n, r.topic, first, CASE WHEN state < 6 THEN 1 WHEN deleted_at IS NULL THEN 2 ELSE 3 END AS fact
        FROM (SELECT record, min(key) AS first FROM gone GROUP BY record) AS once
            JOIN records r ON n = record JOIN streams s ON s.key = r.stream
        WHERE state = 6 OR state < 6 AND kind = 5
    ), due AS (
        SELECT n, topic, fact, row_number() OVER (ORDER BY first) AS place FROM waiting
        WHERE fact = 3 OR NOT EXISTS (SELECT 1 FROM feed WHERE feed.record = n AND feed.fact = waiting.fact)
    ), total AS (SELECT count(*) AS rows FROM due), top AS (
        UPDATE about SET head = head + rows FROM total WHERE rows > 0 RETURNING head - rows AS below
    )
    INSERT INTO feed SELECT below + place, n, topic, fact FROM due, top
        ON CONFLICT (record) DO UPDATE SET number = excluded.number, fact = excluded.fact;
    GET DIAGNOSTICS given = ROW_COUNT;
    RETURN given;
END $$;


--
-- Name: settle(bytea); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.settle(home bytea) RETURNS bigint
    LANGUAGE plpgsql
    AS $$
DECLARE
    number BIGINT;
BEGIN
    INSERT INTO counter_deltas SELECT stream, state, records, bytes, taken_in FROM pending_counters
        WHERE records <> 0 OR bytes <> 0 OR taken_in <> 0;
    INSERT INTO epoch_deltas SELECT stream, epoch, records, first_at, last_at FROM pending_epochs;
    DELETE FROM pending_counters;
    DELETE FROM pending_epochs;
    INSERT INTO homes AS h VALUES (home, 1) ON CONFLICT (id) DO UPDATE SET commits = h.commits + 1
        RETURNING commits INTO number;
    RETURN number;
END $$;


--
-- Name: topic_matches(text, text); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.topic_matches(pattern text, name text) RETURNS boolean
    LANGUAGE sql IMMUTABLE PARALLEL SAFE
    AS $_$
    SELECT CASE
        WHEN pattern = name THEN TRUE
        WHEN pattern COLLATE "C" ~ '^(/|\*\*)[A-Za-z0-9_/*?]*$' THEN coalesce(name COLLATE "C" ~ (
            '^' || replace(replace(replace(replace(pattern, '**', '!'), '*', '[^/]*'), '?', '[^/]'), '!', '.*') || '$'
        ), FALSE)
        ELSE FALSE
    END
$_$;


SET default_tablespace = '';

SET default_table_access_method = heap;

--
-- Name: about; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.about (
    one bigint NOT NULL,
    recorder bytea NOT NULL,
    clean bigint NOT NULL,
    head bigint NOT NULL,
    version bigint DEFAULT 1 NOT NULL,
    CONSTRAINT about_one_check CHECK ((one = 1))
);


--
-- Name: alarms; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.alarms AS
 SELECT '\x'::bytea AS owner,
    ''::text AS topic,
    ''::text AS publisher,
    ''::text AS reason,
    (0)::bigint AS at,
    (0)::bigint AS open
  WHERE false;


--
-- Name: audit; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.audit (
    line bigint NOT NULL,
    at bigint NOT NULL,
    profile text NOT NULL COLLATE pg_catalog."C",
    action text NOT NULL COLLATE pg_catalog."C",
    subject text NOT NULL COLLATE pg_catalog."C",
    outcome text NOT NULL COLLATE pg_catalog."C",
    hash bytea NOT NULL
);


--
-- Name: batches; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.batches (
    key bigint NOT NULL,
    root bytea NOT NULL,
    owner bytea NOT NULL,
    count bigint NOT NULL,
    closed_at bigint NOT NULL,
    account bytea,
    tx bytea,
    block bigint,
    block_hash bytea,
    proof bigint,
    closed_here bigint NOT NULL
);


--
-- Name: batches_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.batches ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.batches_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: bindings; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.bindings (
    name text NOT NULL COLLATE pg_catalog."C",
    account bytea NOT NULL,
    signing bytea NOT NULL,
    envelope bytea NOT NULL,
    sealed_key bytea NOT NULL,
    device bytea,
    notices bytea,
    CONSTRAINT bindings_check CHECK (((device IS NULL) = (notices IS NULL)))
);


--
-- Name: branches; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.branches (
    batch bigint NOT NULL,
    branch bigint NOT NULL,
    path bytea NOT NULL
);


--
-- Name: chain_headers; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.chain_headers (
    block bigint NOT NULL,
    header bytea NOT NULL
);


--
-- Name: chain_nodes; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.chain_nodes (
    key bigint NOT NULL,
    hash bytea NOT NULL,
    node bytea NOT NULL
);


--
-- Name: chain_nodes_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.chain_nodes ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.chain_nodes_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: chain_proofs; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.chain_proofs (
    block bigint NOT NULL,
    hash bytea NOT NULL,
    nodes bytea NOT NULL
);


--
-- Name: ciphertext; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.ciphertext (
    record bigint NOT NULL,
    bytes bytea NOT NULL
);
ALTER TABLE ONLY public.ciphertext ALTER COLUMN bytes SET STORAGE EXTERNAL;


--
-- Name: contract; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.contract (
    one bigint NOT NULL,
    domain bytea NOT NULL,
    pin text NOT NULL COLLATE pg_catalog."C",
    block bigint NOT NULL,
    place bigint NOT NULL,
    CONSTRAINT contract_one_check CHECK ((one = 1))
);


--
-- Name: counter_deltas; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.counter_deltas (
    stream bigint NOT NULL,
    state bigint NOT NULL,
    records bigint NOT NULL,
    bytes bigint NOT NULL,
    taken_in bigint NOT NULL
);


--
-- Name: counters; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.counters AS
 SELECT counter_deltas.stream,
    counter_deltas.state,
    (sum(counter_deltas.records))::bigint AS records,
    (sum(counter_deltas.bytes))::bigint AS bytes
   FROM public.counter_deltas
  GROUP BY counter_deltas.stream, counter_deltas.state;


--
-- Name: cursor; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.cursor (
    one bigint NOT NULL,
    block bigint NOT NULL,
    hash bytea NOT NULL,
    CONSTRAINT cursor_one_check CHECK ((one = 1))
);


--
-- Name: drops; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.drops AS
 SELECT '\x'::bytea AS owner,
    ''::text AS topic,
    ''::text AS reason,
    (0)::bigint AS count
  WHERE false;


--
-- Name: envelopes; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.envelopes (
    block bigint NOT NULL,
    place bigint NOT NULL,
    envelope bytea NOT NULL
);


--
-- Name: epoch_deltas; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.epoch_deltas (
    stream bigint NOT NULL,
    epoch bigint NOT NULL,
    records bigint NOT NULL,
    first_at bigint,
    last_at bigint
);


--
-- Name: epoch_records; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.epoch_records AS
 SELECT epoch_deltas.stream,
    epoch_deltas.epoch,
    (sum(epoch_deltas.records))::bigint AS records,
    min(epoch_deltas.first_at) AS first_at,
    max(epoch_deltas.last_at) AS last_at
   FROM public.epoch_deltas
  GROUP BY epoch_deltas.stream, epoch_deltas.epoch;


--
-- Name: erasures; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.erasures (
    n bigint NOT NULL,
    record bigint NOT NULL,
    statement bytea NOT NULL,
    account bytea,
    taken bigint NOT NULL
);


--
-- Name: erasures_n_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.erasures ALTER COLUMN n ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.erasures_n_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: feed; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.feed (
    number bigint NOT NULL,
    record bigint NOT NULL,
    topic bigint NOT NULL,
    fact bigint NOT NULL
);


--
-- Name: feeds; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.feeds (
    key bigint NOT NULL,
    id bytea NOT NULL,
    after bigint NOT NULL
);


--
-- Name: feeds_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.feeds ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.feeds_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: filter_ids; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.filter_ids (
    key bigint NOT NULL,
    id bytea NOT NULL
);


--
-- Name: filter_ids_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.filter_ids ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.filter_ids_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: filter_streams; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.filter_streams (
    filter bigint NOT NULL,
    stream bigint NOT NULL
);


--
-- Name: filters; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.filters (
    filter bigint NOT NULL,
    record bigint NOT NULL
);


--
-- Name: gaps; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.gaps AS
 SELECT (0)::bigint AS key,
    '\x'::bytea AS owner,
    ''::text AS topic,
    ''::text AS publisher,
    ''::text AS reason,
    (0)::bigint AS count,
    (0)::bigint AS first_number,
    (0)::bigint AS last_number,
    (0)::bigint AS first_at,
    (0)::bigint AS last_at,
    '\x'::bytea AS report
  WHERE false;


--
-- Name: held; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.held AS
 SELECT (0)::bigint AS record,
    (0)::bigint AS minute,
    ''::text AS reason,
    ''::text AS publisher,
    '\x'::bytea AS report,
    ''::text AS decision,
    (0)::bigint AS decided_at
  WHERE false;


--
-- Name: homes; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.homes (
    id bytea NOT NULL,
    commits bigint NOT NULL
)
WITH (fillfactor='50');


--
-- Name: incident_notes; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.incident_notes AS
 SELECT (0)::bigint AS incident,
    (0)::bigint AS number,
    (0)::bigint AS at,
    ''::text AS text
  WHERE false;


--
-- Name: incident_topics; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.incident_topics AS
 SELECT (0)::bigint AS incident,
    ''::text AS topic
  WHERE false;


--
-- Name: incidents; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.incidents AS
 SELECT (0)::bigint AS key,
    '\x'::bytea AS owner,
    ''::text AS name,
    (0)::bigint AS since,
    (0)::bigint AS until,
    (0)::bigint AS opened_at,
    (0)::bigint AS closed_at
  WHERE false;


--
-- Name: intake; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.intake AS
 SELECT counter_deltas.stream,
    (sum(counter_deltas.taken_in))::bigint AS records
   FROM public.counter_deltas
  GROUP BY counter_deltas.stream
 HAVING (sum(counter_deltas.taken_in) > (0)::numeric);


--
-- Name: lease; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.lease (
    one bigint NOT NULL,
    holder bytea NOT NULL,
    number bigint NOT NULL,
    since bigint NOT NULL,
    until bigint NOT NULL,
    CONSTRAINT lease_one_check CHECK ((one = 1))
);


--
-- Name: leaves; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.leaves (
    record bigint NOT NULL,
    batch bigint NOT NULL,
    leaf bigint NOT NULL
);


--
-- Name: left_places; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.left_places (
    batch bigint NOT NULL,
    leaf bigint NOT NULL,
    record bigint NOT NULL
);


--
-- Name: names; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.names (
    owner bytea NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    name text NOT NULL COLLATE pg_catalog."C"
);


--
-- Name: notes; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.notes (
    kind text NOT NULL COLLATE pg_catalog."C",
    about text NOT NULL COLLATE pg_catalog."C",
    value text NOT NULL COLLATE pg_catalog."C"
);


--
-- Name: passed_over; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.passed_over (
    record bigint NOT NULL,
    block bigint NOT NULL
);


--
-- Name: pinned_topics; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.pinned_topics AS
 SELECT '\x'::bytea AS owner,
    ''::text AS topic
  WHERE false;


--
-- Name: pins; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.pins AS
 SELECT '\x'::bytea AS owner,
    ''::text AS topic,
    ''::text AS caller_id,
    ''::text AS host,
    ''::text AS type_name,
    ''::text AS md5sum,
    ''::text AS source,
    (0)::bigint AS at
  WHERE false;


--
-- Name: proven; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.proven AS
 SELECT (0)::bigint AS record,
    (0)::bigint AS standing,
    '\x'::bytea AS proof,
    (0)::bigint AS at,
    (0)::bigint AS gone
  WHERE false;


--
-- Name: receipted; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.receipted AS
 SELECT (0)::bigint AS record,
    (0)::bigint AS receipt
  WHERE false;


--
-- Name: receipts; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.receipts AS
 SELECT (0)::bigint AS key,
    (0)::bigint AS at,
    '\x'::bytea AS digests,
    '\x'::bytea AS signature
  WHERE false;


--
-- Name: recorders; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.recorders (
    key bigint NOT NULL,
    id bytea NOT NULL,
    signer bytea NOT NULL
);


--
-- Name: recorders_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.recorders ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.recorders_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: records; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.records (
    n bigint NOT NULL,
    digest bytea NOT NULL,
    topic bigint NOT NULL,
    stream bigint NOT NULL,
    seq bigint NOT NULL,
    epoch bigint NOT NULL,
    signature bytea NOT NULL,
    bytes bigint NOT NULL,
    captured_at bigint NOT NULL,
    acknowledged_at bigint NOT NULL,
    simulated bigint NOT NULL,
    state bigint NOT NULL,
    tx bytea,
    block bigint,
    block_hash bytea,
    deleted_at bigint
);


--
-- Name: records_n_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.records ALTER COLUMN n ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.records_n_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: retained; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.retained (
    record bigint NOT NULL,
    report bytea NOT NULL,
    header bytea NOT NULL,
    deleted_at bigint
);


--
-- Name: retained_topics; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.retained_topics (
    topic bigint NOT NULL,
    records bigint NOT NULL,
    bytes bigint NOT NULL
);


--
-- Name: rights; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.rights (
    block bigint NOT NULL,
    place bigint NOT NULL,
    kind bigint NOT NULL,
    owner bytea,
    grantee bytea,
    epoch bigint,
    token bytea,
    event text NOT NULL COLLATE pg_catalog."C",
    replaced bigint,
    revoked bigint,
    revoked_at bigint
);


--
-- Name: signers; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.signers (
    id bytea NOT NULL,
    key bytea NOT NULL
);


--
-- Name: stamp_tokens; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.stamp_tokens (
    stamp bigint NOT NULL,
    authority bytea NOT NULL,
    before bigint NOT NULL,
    token bytea NOT NULL
);


--
-- Name: stamped_roots; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.stamped_roots (
    root bytea NOT NULL,
    stamp bigint NOT NULL
);


--
-- Name: stamps; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.stamps (
    key bigint NOT NULL,
    made_at bigint NOT NULL,
    upto bigint NOT NULL,
    roots bytea NOT NULL
);


--
-- Name: stamps_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.stamps ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.stamps_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: standing_lease; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.standing_lease AS
 SELECT lease.one,
    lease.holder,
    lease.number,
    lease.since,
    lease.until
   FROM public.lease
 FOR SHARE OF lease;


--
-- Name: standings; Type: VIEW; Schema: public; Owner: -
--

CREATE VIEW public.standings AS
 SELECT (0)::bigint AS key,
    (0)::bigint AS at,
    '\x'::bytea AS statement,
    '\x'::bytea AS signature
  WHERE false;


--
-- Name: streams; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.streams (
    key bigint NOT NULL,
    topic bigint NOT NULL,
    kind bigint NOT NULL,
    type_name text NOT NULL COLLATE pg_catalog."C"
);


--
-- Name: streams_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.streams ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.streams_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: topics; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.topics (
    key bigint NOT NULL,
    owner bytea NOT NULL,
    recorder bigint NOT NULL,
    topic_id bytea NOT NULL,
    name text NOT NULL COLLATE pg_catalog."C",
    keeper bytea
);


--
-- Name: topics_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.topics ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.topics_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: trail; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.trail (
    block bigint NOT NULL,
    hash bytea NOT NULL
);


--
-- Name: transactions; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.transactions (
    key bigint NOT NULL,
    hash bytea NOT NULL,
    account bytea NOT NULL,
    nonce bigint NOT NULL,
    raw bytea NOT NULL,
    purpose text NOT NULL COLLATE pg_catalog."C",
    digests bytea NOT NULL,
    signed_at bigint NOT NULL,
    state bigint NOT NULL,
    block bigint,
    block_hash bytea,
    gas_used bigint,
    reason text COLLATE pg_catalog."C",
    replaced_by bytea,
    batch bytea
);


--
-- Name: transactions_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.transactions ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.transactions_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: unnumbered; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.unnumbered (
    key bigint NOT NULL,
    record bigint NOT NULL
);


--
-- Name: unnumbered_key_seq; Type: SEQUENCE; Schema: public; Owner: -
--

ALTER TABLE public.unnumbered ALTER COLUMN key ADD GENERATED BY DEFAULT AS IDENTITY (
    SEQUENCE NAME public.unnumbered_key_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1
);


--
-- Name: workers; Type: TABLE; Schema: public; Owner: -
--

CREATE TABLE public.workers (
    id bytea NOT NULL,
    name text NOT NULL COLLATE pg_catalog."C",
    seen bigint NOT NULL
);


--
-- Data for Name: about; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.about (one, recorder, clean, head, version) FROM stdin;
1	\\x016ba46c223626de	0	3	1
\.


--
-- Data for Name: audit; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.audit (line, at, profile, action, subject, outcome, hash) FROM stdin;
1	1767600022991423129	keeper	create identity	keys	done	\\xc4f322958a7de1bbe6356c6ca4d90ac179ad611039af9b47581e16674a27654e
2	1767600023041208858	keeper	register	0xBFF40De6B8b269afB18E503D2263bd09c82eAE15	done	\\xbc7de9e120416f96df5768bc0fc60bb8f18b5f2db7a7477e6874fcd74c8e29d7
3	1767600023180989077	keeper	gateway	127.0.0.1:48359	serving	\\xdc1e4f78978586ee35ccb8225842232a2441f6a1afd097f7c6ce6cf8ca4dc785
4	1767600023401260988	keeper	gateway allow	0x9b67978a101452742D2570D51B377343607ABCDf	begun	\\x450a0aa4c1bc21ab9a59f2b1f7f54f8723e1575d41fafd4500a70eef2abc2971
5	1767600023414008365	keeper	gateway allow	0x9b67978a101452742D2570D51B377343607ABCDf	done	\\xc601191f178f9ab48422e730f6d72dafacb0ec92fad1f58868534da0cf0a932c
6	1767600023911943605	keeper	allocate key	rover for 0x9b67978a101452742D2570D51B377343607ABCDf	begun	\\xefb2fee729d63da727f0aae6c4bd804d84ca63b4be0ac53223a0824052946731
7	1767600023923030888	keeper	allocate key	rover for 0x9b67978a101452742D2570D51B377343607ABCDf	done	\\x4ab4f0358ff8d651578d7ccacd6363f92a5c0fb07d823eacbe971c041c517eee
8	1767600024970016680	keeper	device notice	a44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d	asked by rover (0x9b67978a101452742D2570D51B377343607ABCDf)	\\x576f5309435023ef00fdb219a97cb249d9772faa27ab7fe07b3521bdae0a901a
9	1767600027314186354	127.0.0.1	refused	Signature	1 in the minute from 2026-01-05T08:00:00Z	\\x9b7e9648605bf38e063b7fb1ee062e19e33c08a568f6e41c7b3f5ee862f1cd4e
\.


--
-- Data for Name: batches; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.batches (key, root, owner, count, closed_at, account, tx, block, block_hash, proof, closed_here) FROM stdin;
2	\\x153f6afcf64897aa61e9abd5bbb9d6c986db1af08e6a08dd9346e24ebe28cfe5	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	1	1767600026280798539	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	\\x456a7e0e69834956bde3749a058fad0b6ee78795efce6e0904e1347f245fe1fa	20	\\x502f81d78d32a9a72ef78a52b024316f6ef6142f9b38c8b7600029e36b8ac698	\N	1
1	\\x36cc042cda5aee036ecf81ab9e6856d35bad9bd0ea0cf6af04ee8b6fecbc782f	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	2	1767600026069784732	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	\\xf4a5d83754512a04933b3cd416c4119f9d64ee1538731e10b4ce97209ccba63f	19	\\xe671872039e7ed5d2805f07d504752d6e8d0e1e10bd34ea4f54cbe49e85b9f90	1	1
\.


--
-- Data for Name: bindings; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.bindings (name, account, signing, envelope, sealed_key, device, notices) FROM stdin;
rover	\\x9b67978a101452742d2570d51b377343607abcdf	\\x8d54dc6e993df9e56d6f8d29f74fac513a1a61fbb524c3e4abc9e2c7ae831f364694980aade885df49bd0d6bf013a7efffeb3493829a611a3536a893ce33dbe1	\\x7860ebb418cd5d2d888f5fe37cce938c8b61702410874040cd7ed04cbc9f0d0bbc25fe1271167cdbe26a29dcbe7d5b8ab28f82cbfaaa8ab5b3ced33ad856738d	\\x23329ead6bdfab9110dd339d874c09d16be9d9b272ad269cdfaf3a514fbb20689a2171c2745171df9794350cee7af2c8f6201fafe398fd63ae8a304e	\\xa44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d	\\x412ad9bc0a29dc2f31756f71e607ee64
\.


--
-- Data for Name: branches; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.branches (batch, branch, path) FROM stdin;
1	0	\\x000000031560f750095a4ad96438ce70b67605c22fd74bc4cc7d8848f5889ebc864fe09e913305e84e89a766e616eba51bbdea75b69d524e228eeedd438375c0eecdca94
\.


--
-- Data for Name: chain_headers; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.chain_headers (block, header) FROM stdin;
19	\\xf90259a03a5b29acfae87c3f828c114e5ca68144869b224dcb2295af677490dee04e19d7a01dcc4de8dec75d7aab85b567b6ccd41ad312451b948a7413f0a142fd40d49347940000000000000000000000000000000000000000a0cc10c5f70e69d99a1e67f1052e656e411c6a657b7ee7132aca992bef0ee38279a05fa2110e5b47ff07ff024c6ab0c7ac88defcb8613b54f37fc3695c2a0166b9f3a0dbbd64cc92a9e1208a09e2f02c148145a56f3bef237450eda393bf9a13c1df0db901000000002000000000000000000000000000000000000008000000000000200000000000000000000000000000000000000000000000000000010080000000000000000000000000000000000000000000000000000000000000000000000000000400000000000000000000000000000000000000000000000000000020000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000001000000000000000800000000000000000000000000000000000000000000000000000000000000000000000000000802000000000000000000000000000000000000000000000000001000000002138401312d0082dc9484695b6f9ab86141757468524f5320636861696e2066696c652076657273696f6e203100000000a853409df5499e36e8fc7ef5f2c202feafccb4a44da6f3ae0d807becc463c167485b39d3a23b54284e8d5c8ed5bee1c923322c0033f29a9f2b6657ba0ab999e201a00000000000000000000000000000000000000000000000000000000000000000880000000000000000
\.


--
-- Data for Name: chain_nodes; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.chain_nodes (key, hash, node) FROM stdin;
1	\\x0b85a55e238df3f3447abe1d3a548beab877cef1fbe82c47fe8519cd67000538	\\xee9f328f661ddecab07b21226f337edb1ec1f1ec2b301a21781531cfc9fdfd76878d8c695b6f820000000000000002
2	\\x27c20f5cb6364ad155af523eba93da361e9b42417aeb1869cf02c3404b5711e1	\\xf8d1a04277c848bc587dda53898b6632cd24fc553d23c955ca7009680b3c53000df8a3808080a0f4c9d4bc4e4594afd6fea4990de981cc33da0658684ad49f00fad8b85b796520808080a05a84fa7b6c1766a93c1e4311cdf4f57b76b35d3045ec5dd2019872fab1914ebd80a042159ef98c2e25cd3ff10de1a0db4426ed83d4c77e0094ac73224ac8097f469f8080a092eeb4f0d36351a782fb462c1e283a200489bb9916a7ba31dcf10747f6d0181ba0ef52b560232a1bbcd36d958575c4aa2d2e669166114c73e822cbf53a53339a4d8080
3	\\x32d364c6c3ed9d1e9ee22d685abef57d7b22da66500bd841328f3d5ddf5b5f3f	\\xf843a0314309973df5ff1241e09acf6f5b091c2bf85f852f0d7a5abe137fb11fc9a902a1a0fa1b2040a86a64003fb057b34a641df6178da4a08e4a4441784cb8abd36e78c8
4	\\x39a55e4f74a46041d02a4d81098d91397b3a24ad604ff2de3b953f462889f55c	\\xf8d1a084937750202d19a9901a8d7e19b24fa659e49cc833adc3da0ddc077f3de9f6b280a040e17596546a1ae65b4bba21156c363b7b1a19b142e880d9e58de20d43d9bca2a0f94302b05588728cbe47ec8ed1993357e1d32675eff2c2c9b38ac33f63ba7c918080a0f88c27bfc11377e59a4a4cc7a71002efc8d467e40ed5caa40348a357b6d447ff80a06f4bd1fb3b8c5c6ecc1f19a985d65301497c8ab68a200eeae200da807993a699808080808080a06b31a41e5c4b1feddae13053f5517cfff5506ed382f68d53578d6af62847cb0680
5	\\x3a251b7c9fa2dcaa596539eaf1c844044cc297bc3f366f1637fa213560e9a254	\\xf90211a032d364c6c3ed9d1e9ee22d685abef57d7b22da66500bd841328f3d5ddf5b5f3fa07abd2a0d234a2023831f09a5502768f17289db3f4678853ac6edb105e69aed1da05858470568f1c0184eb5835a50601bb8acd3c016daa4c2304b401e59021e3930a0c53ed2eeb26ce53dd4ba813671fe6e3d56dd36eb11791b26070884b18eeb7c6ca027c20f5cb6364ad155af523eba93da361e9b42417aeb1869cf02c3404b5711e1a0c90a3cccc75cab495c76924ebffa98014b33476a9c33d38b8840798679f2137ba0ad15dbfd47407fdb5892f3934cae90295ac177644e89fa26c15cdd4cdbddefdfa075be1e82ab0a9a1ed1077d43ece6b3f257955ea6da7d7cc6b64a192b0f4b5cc0a0ffce26b91af4ee8184aa01586ec312ea5a3c795de89f31ce1234cd84a66defaba039a55e4f74a46041d02a4d81098d91397b3a24ad604ff2de3b953f462889f55ca002d578dfc6ba5ba8d4efebad043d4e39f4371b20dac69b086028a005d4e7c37fa0c98e5349ccc4ae54ce06874ffffba6d9fe90a33fc6535f5cd34ecffcdbd42519a0e8a74564ca01c8637b32ab4a4d4142ee283975dfb718729198ed5202416a29e5a0a197767245c489bcaea7bfe43a82e47d8f2af0a11ab0a0cd73c4d04a679b132ba04a08ffda69261ef827681ad8b5d5fba13c8751ebfc30c54aedfe8277c25b4083a0eb21e0ea15f7772a431cc457faaf33c0c185614c91b137e9c021f457c36667e780
6	\\x3d20c1aa3af3a87dd1ab08860231a312fe4ae9c9feab76de95bccfc9c686f54e	\\xf869a030e954fad8f3317f4def53b0aec9f5b1b28bd358c1b58a7772b6992d7eb36d60b846f8440180a03a251b7c9fa2dcaa596539eaf1c844044cc297bc3f366f1637fa213560e9a254a0596d096d3f6cb170208bbab3b2869620c0180ff943c0b22a66e11699f3705797
7	\\x5858470568f1c0184eb5835a50601bb8acd3c016daa4c2304b401e59021e3930	\\xf8f18080a0649e56e8463485a1f39e684435462be37f9520d3e4c4280fe50f5fc8e6e52c1d80a0f19ae4f1a6ba53643323de2f439b4f5d412763b8fb470806d0f5ab5481b2c5a280a0335408f445203ae16efc3b75e09a7138876630e4d06f504d059a6a44c783906080a0011188de536d42099f46d62d7992aec880c1125ccf972e4f8b17e516e93fea71a0c51015a234718922a1323ac66f40d83fa3620acc05a515b8cf13fee550154ce180808080a02b5548550f17ece5e6270b2058ef4f1980984e5886eb1ef527fddfcc599d4b42a07ea2fa5f557f51ea7a95b57c2b5acebee8f089868bc0a206db4d56ab62aa889b80
8	\\x5a9eadaeafa62678d1117631e8c6d9764ac577d605e1ba1753b2b123d13d5a50	\\xf4a020e5d730e0e4388643fd5d8201ecfb198ce2cb023bd9890bae380fc3f9d1086092910100000000000000000000000000000001
9	\\x6f4bd1fb3b8c5c6ecc1f19a985d65301497c8ab68a200eeae200da807993a699	\\xf83ca020f9a8d7f8fee37e384f90456f71e5491ced39a1ed04107ae857f91ab57c1c359a990100000000695b6f9a00000000000000020000000000000013
10	\\x7abd2a0d234a2023831f09a5502768f17289db3f4678853ac6edb105e69aed1d	\\xf8f180a00586297a179f04aae8184ddc0dfe720e1b7c6df2f11f0f501d84d148cf3e0db68080a0a2fcd59b0178f81269eaaa1f2ea91494e557a4d337f96cc497459306c36414eea08a23f61bc17bcb358eed79b5907e3c12b86916082699bc7a7e70ea9f9fbce926a090265eda9a0c40c9440776e672b6c2cf0e833b652fba1e2e009740f0f1e98ac78080a0d003779f6fa3332b786a773de60ae5c2755665e94f653eefe511062e96c1de86a0b8dce89ea5de9e2c8b98a4355009f4a7e503ebde5c2ad36814f537219b849430808080a0b41d98ba9dc1c91d1ee39e040eb7c09c0ab45afd00390fdef60e43649fad75c88080
11	\\x8a23f61bc17bcb358eed79b5907e3c12b86916082699bc7a7e70ea9f9fbce926	\\xeda020427ac08153cd8036f21c56eb87a82ff12998bbad273a0db4ea10f0e3ecef538b8a10000000000000000001
12	\\x92eeb4f0d36351a782fb462c1e283a200489bb9916a7ba31dcf10747f6d0181b	\\xf8518080808080a01c4e3ae0e4b1cad38d6280c7f14e27496536498e77a5d610bbb06a938bc20b1d80808080a00b85a55e238df3f3447abe1d3a548beab877cef1fbe82c47fe8519cd67000538808080808080
13	\\xc53ed2eeb26ce53dd4ba813671fe6e3d56dd36eb11791b26070884b18eeb7c6c	\\xf8918080808080808080a0e4042a9547be11ad44eb3ea3f05adfab107e33c8d5ba53b43bb97cbb33c2a5aaa01df16992dd38dc4ed50de0f3d0a4439dc942a5772ff235d7a4d54f269dc0cf44a0169c381d6966043aeda50271f1154d072576e33b3f45a202307d489bd913213b80808080a0fd1d2f80a713f541dbc4e1ef241e1c94fece318ca9e684877b6232e759c9cb2080
14	\\xc90a3cccc75cab495c76924ebffa98014b33476a9c33d38b8840798679f2137b	\\xf89180808080a03589287baa6c0fbb8e686d33b9e6ad9fb7e5f473769134efa21826a97016342280808080a0dd51c440e9728b8af03ef3c46fafd8811261dc9c804796b7b73151cffabb61a7a05a9eadaeafa62678d1117631e8c6d9764ac577d605e1ba1753b2b123d13d5a50a0b9d739f6ddc31fdc9d0644c526e756ea7e7176a9959bf68fcde9266efe98a8a38080808080
15	\\xcc10c5f70e69d99a1e67f1052e656e411c6a657b7ee7132aca992bef0ee38279	\\xf8d1808080808080a0642702df30f0e0b78e6acd9c869351ece53f366d865db0de1523b14102b0c67ca06ad4eaf37b0e8a9e9ba1034b9a762fa657e0419f21186353d045a8e0aed8e1e780a03d20c1aa3af3a87dd1ab08860231a312fe4ae9c9feab76de95bccfc9c686f54e8080a099083e85856fa7cbe04b4e96867101fa0e4edf4a523d4c88a84bd69a0d92f0f180a0c0e9b5a18b630f56a4c1c583ecfe24d447f5f60a2f8bc71f6e0f1fd9ecfc647aa09e7a1a9527260b89601b2b35bd3e0465726e7b5015e7730b1d6456df7e90bbc280
\.


--
-- Data for Name: chain_proofs; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.chain_proofs (block, hash, nodes) FROM stdin;
19	\\xe671872039e7ed5d2805f07d504752d6e8d0e1e10bd34ea4f54cbe49e85b9f90	\\x000000000000000100000000000000020000000000000003000000000000000400000000000000050000000000000006000000000000000700000000000000080000000000000009000000000000000a000000000000000b000000000000000c000000000000000d000000000000000e000000000000000f
\.


--
-- Data for Name: ciphertext; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.ciphertext (record, bytes) FROM stdin;
1	\\x8941757468524f53010102e9b422efdedbcb5a2f320b4f521fce9dce5d8d856a0c8a9b55c3857ac7a320f69b67978a101452742d2570d51b377343607abcdfa44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d00000000000000010190a235f8be2770a44ede15c68443b700000000000000016b8b38c3169169d5a6f0e1f4319d556b02ec88864bf15f5d0004623908f717c0d01887c6dbc709b8e2000000ac0000000000000159048c6c80c2928bfc0f97d9c3e218d88df46831c559d2d33dc1fcf0bebdc4391f7888d36c9538f1f063a62921f0c775ec1a7ecba64d0d901dc48860837ff2fe8530a958b39c27c09860a41f2901c3c49073035ec336394fa0cbf80a6e3e948d8937bc37e0b543008a4660af66ae60b3f5fea1206088a6f7968d712c1c0323a52f6f7c71c65a21ad491cc89f7ddbe91d4775d8822abb059edee0bc2f019c7d640be8a574e7cb49b4194728c2f825729fa291a24906f4163ddbe97830db049ad2671747f6ce97f6487cf2b650250590627d6e889e1457e8ec93dde013b8119f36e483fdf42fd32e30c1de12b2027034ea1ae16f86d0f84c094ea30840315a172dec6eceb1588d95faa922f0d96856f4bdb15a1aa14ad5a6765c71bc7ced961c497c80dea83c979073a92a673fb07228aadba0b9291b8d2cfbc3690494ff2d42db4e1a1374beec53943abcf589aa4e64bcb004d94e20a7852c6f54bd927dac5a6858bf5ff0080f6319f421b10728ebeb89506b02563f5413201ef4905178ed1ca6bf97dbae4d4e68903f1e1c2548196e7baf4de4b249c724fd9f93ce36acc27fae8dd3e5d139743667234611a3b8298fd74005fbd9d83ed19d47da3ddb43d5e7c2a03c0545887b556ea4b16db299799ab0143d8b99ec0cca2b6cde0c5e6a7925727126526b8a4d983591cb1807bae703d3b39c3f9841e3ab22b8f68a8f891aa45f2d5426d80f6f20fe3b0e6fba3c4bee30275a8e59b0ad10e4ee565dcb3f1c4df39354bffe57024182ebb34e9f29fb10765be84b6f63ee58bdda60454b29c5
2	\\x8941757468524f53010101e9b422efdedbcb5a2f320b4f521fce9dce5d8d856a0c8a9b55c3857ac7a320f69b67978a101452742d2570d51b377343607abcdfa44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d00000000000000010190a235f8be2770a44ede15c68443b700000000000000026b8b38c3169169d5a6f0e1f4319d556b02ec88864bf15f5d0004623908f717c0d01887c6dbc709b8e2000000ac00000000000000b64079d415648038a48ca0ca185bb2fadf3400651a8236b29ed88728391da6a29ac1f33ca829ae39d8e86a5d85654875db832d7c8c1ef40152bf3aa540ea32dc41cf94f5c5d67db2883e6c650e1ccdd7f96eaf3d5c2b63021537ae91ec0da0f662ee1fedaadc8fdbf7dbd82c2314f7ed4f93d9c8ff4236fbe91ef00c56374b742a97c76e181be7590345d08e78334bb787d80167f720348d706a9fa101968ad1b6b2b27e0a27fd191abd15d8b6a28a60e60f626450d0f39ff9fa7c3b9ea00c0965859553ea1727ce7519acbc7990fa12aea4045ba2966378a554a1f07f066c82132a6179947cbd6614fb5e9746077a4cb33d5a4abc4729ae32300b1056d718cbbcd30f9169850ccc18a6f6ef78efde88425d48a72eed5055f9df758b0392b2b041665a97c974287266ef20d3223db8c30979930512fa65c79b1f99b349fc527816ecc0ef766f82b0d2bf79cc05e072989dcc6b11e662efccdb377773af30e846ff4966ff86ad7741e467c048b1460b9afe5da6d9a1559fcd02635c8ba0a1c9dfd754aa0aafd0fce09443013a56193bbdd294bd74237ac6e2478396
3	\\x8941757468524f53010101e9b422efdedbcb5a2f320b4f521fce9dce5d8d856a0c8a9b55c3857ac7a320f69b67978a101452742d2570d51b377343607abcdfa44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d00000000000000010190a235f8be2770a44ede15c68443b700000000000000036b8b38c3169169d5a6f0e1f4319d556b02ec88864bf15f5d0004623908f717c0d01887c6dbca01d0b3000000ac00000000000000b613e5aedd523ec3cf88fc117b7b3d915c64807b95e00261f4fc69df95b2d46633a279481943ac5afe889edfa1d401459a1e084c463487e367952c5c1c5407a798423501bac1fdb171e62d0f7418b287bae23a7817984d92aaa46c11d85f4436cb4a0b1bade539ffc3d36d6b2cc428462435dffecb667dc9dbe4735e17e35eaa29c6f537412dfe75b1ad10aa6c922b2c6a6b0e216aff22859480cb01133ee6c95954d4eed36b1bea26569ed9e8e43e7d790059e01289006b208c4ec35a1b446fbfeb3251fd9115c4f7f85fe51697f37fe35babdf1c3403546724f429aacf48efd6b2f8b0b0ab14ec9cd1f466c87fc1015aa8091f503b80d1134bae478bba894cba9baac7083cc6913046d68f9c4b69449d11952feedab143cd1d27e3f26ee95663107cf0c76e6f5ae84e506e00b157f93ce73a39d259a889a3a6afa1caeb17b76cf2fa6b0bc021da158d63aef8c50188fb8c8dae15c7946a0d20f0a74b18a40a88a8fdc7bafff524204816e2a7deb9be1ee89ca7154df623c4c4a770bb994d2f635afaec7d7e69a6f97f1666f67802b2951f46cbd4eb84476c8d1f
\.


--
-- Data for Name: contract; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.contract (one, domain, pin, block, place) FROM stdin;
1	\\xe9b422efdedbcb5a2f320b4f521fce9dce5d8d856a0c8a9b55c3857ac7a320f6	{"chain_id":44077499089022,"genesis":"0x8ff5c4c6573ac97bcaa714fdcc94b38fe6bf9c03e4041f8e03228c054212b011","contract":"0x2A3D405239df7f45210A28D0e90436D5a2899dEF","code_hash":"0x596d096d3f6cb170208bbab3b2869620c0180ff943c0b22a66e11699f3705797","deployed_at":1}	16	0
\.


--
-- Data for Name: counter_deltas; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.counter_deltas (stream, state, records, bytes, taken_in) FROM stdin;
1	1	1	329	1
2	1	1	166	1
2	1	1	166	1
1	2	1	329	0
1	1	-1	-329	0
2	1	-1	-166	0
2	2	1	166	0
1	3	1	329	0
1	2	-1	-329	0
2	3	1	166	0
2	2	-1	-166	0
1	4	1	329	0
2	4	1	166	0
1	3	-1	-329	0
2	3	-1	-166	0
2	5	1	166	0
1	4	-1	-329	0
1	5	1	329	0
2	4	-1	-166	0
1	5	-1	-329	0
1	6	1	329	0
2	5	-1	-166	0
2	6	1	166	0
2	1	-1	-166	0
2	2	1	166	0
2	3	1	166	0
2	2	-1	-166	0
2	3	-1	-166	0
2	4	1	166	0
2	4	-1	-166	0
2	5	1	166	0
2	5	-1	-166	0
2	6	1	166	0
\.


--
-- Data for Name: cursor; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.cursor (one, block, hash) FROM stdin;
1	20	\\x502f81d78d32a9a72ef78a52b024316f6ef6142f9b38c8b7600029e36b8ac698
\.


--
-- Data for Name: envelopes; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.envelopes (block, place, envelope) FROM stdin;
2	1	\\x010000012530820121022100e3f614265958b02db6f795762c579fd23379ca68df8db40a3cde0b8975b6dedc02207524a89daed497b5cd7d0d6eb82de2a9c39dec8e818195542efd3b51fdd3ad9f04209d2d7841a271fe5d4d5a2c818f1eb86a51834df50c6248ab48e7bb644068f17f0481b73ab212f7f6cafb2f558195b1e852b0ad22530f875ebbfdf8afc22dee030b05ceaa970a51edb781edcd7c924c46d8c1015e23b42950097163b9fa340f189bc705092f7cf5c918f7cdd67d382d4228efab385f5c926ec56e94fb491da77d794bf713cbb7e28bcf1d8e3015401c3d658f9ce15d6d30efa958589a9e23101ed801ef670b872f4d5837c7ce9549189fc090d34a75ad55642805e5e46327f1a22a857164a5e89932cc3ef006b7cb6895a7f8694f0b09f130d33977de2d7a90f8c01ef91ca32545e1a546acc2931508066b2263c01ca27a0326597f50a52f0f017dfdb24c6afd8b95953d99345800ec8cb684a6941ef4ccb5fb1e
3	1	\\x01000001253082012102207d8ae7316c1fe5916dee13628cf2b01f4c87196e6054b4c04f3a7930921a4b2e022100e483a1f51cf58652e95eb3b122c2b7ce2ed640287225f3e5d7a1c32e26573bc504205587233f7a169509554ed65ba42938e452aa25d09c0e1fad378051c64e1e7a7d0481b747d9bc88f980588bee31b176b6465e85fa4c6d4938b1f15524efa3407deb1ac8f30e9aabcf9714860ed3fc4492f438cd740c42e866e054dee5df5805d12fe398d94af4694c27ae10c376ad71af01c839a02e62dae95f117785220e67e8314a7b42d23f6eadc6a6334c16c27c489f3f4d0830b23c357967453329259a78efa92cdfa19624ce197bfa549d1f4a5fa89b9641f5a0428f3f2c29d1f6ce6cb04ab9bbfd5a6e8e7494a55cbcc1e518c26ff7610dde787a2be5d673f2f0364329757c6041e6d339a10fc950e4ae530c726775718f99a2190bca8bdc9e91888f5f192c8b3553e68b0a13a6f398a0e356cbee0467eddbfc832a573f
6	0	\\x010000013630820132022100a5dac0aab2f0f898e2b0c4a8d962b3dc8a133812bb63c8395be571d8004c6741022100b9661ce52a5b4f4f74caff27a08302870863be830f51bd777203945b3964f2a40420ed64adf2fd823ea3a571b7c0187e023c7bfc1d4db9c81135facde5a8baf1c0d10481c70eea78ad08234f30e49ba6912ca279dab80d18d1836796cbc4941d331d823c5de913cdada4125fa54b8177722123b1e8160cf5932eadbb47bfe12613390405f3d9af0b64b154532bc28856a51c0b5c6d628186f6813bcf821e9874614b76837f6102a85bada3a6c5eb4ec13f6d0817912a65c53ea24b24ed5901579f3f11ff516abf3bee4d3fd585ed15007686efb78506848a0065c58397c45f14404c68a5309aa6a031ba67dcfb90fdab3adc4c7a3103dfcb26c8387dd2a0aff1ad9443f558b97f41c2d48c7c9c581d3dec520961b7594a403a214506124bc4c27357ce5261ebb213628ccc0ffc70a05ae2d12e8cd00069d7d8ba05f29bf4e7b8cd4d39c9cc73c1d0e4a3ba30
7	1	\\x01000001253082012102210084d37372f8b312d12403fd82f76ac105cbae32fb3b6b809a8197d590115e31e602202c277eb07f9221a1b229351a4915b57fce39273494953e876266bdc17a3805bd04204e7f8ccf03817b38bbbf7b395f389454053bce4404fdd55b047449336e9b8bac0481b79879fa114d1d84d5c9a5a67d50e5ac37644299b646b187121fae736030ddc2a4dbb3f900fdea701333281379c66c33bdc1d5a6d392d5a4c5b183af1ab199f66c83f9686da39a61408014743e936e6579893fbd64cbf524c2ec0c9144cc871e1a0d46050ba5ae650ab6700a3ecb2791c6406f6989d9d54b5464a64fd7046505032b0692c021b703bd7e9ef77fad400dd9fbf64da40460d93d568a41624afa83c054b4901a71095b4fac23d1374e6d202b98c5f26c711c02fe98887cf9f55bd072d43cb72c7f5a69eaca6b5359add582029ef6bffbb9f76ed4794756aef72f1c5b1602316e21861179d1fdf497695bd38e94143aed5800cc
13	1	\\x010000012530820121022027ccdb231493bad5caee395dca1c5b8a441d875c9a0ee20918c7ca52b4a67291022100bd06e84b9dc6b1959f26ac3fc5fe4054bfacc27697b96f701f8bd81cb464c1050420185929fb1f899d9a77ec5274c1dcbcd47fc8c3b63e5d115dbf61912f71f5a8450481b7e736edb510ae2784426a2086958c0467106e45c7bdc32dacd90c89a050b44285906f9626257e2193df2522bfd4fa9634b3298004f549223f47da7f756a63b92479452537de0db37f6cdfc240a29fe3195a29b626e2a118f6204e5616b3a1800b8273e0abf29a03ae8056395434e3d59ebac988363246159f63db3c450ff05505e8fccd98e50c218afd3acc5b28ee9302f69b70d6d02574db0d3cf3d5d62775c11f92bc5b3954639e1e55f0a047f9b32f2c41ac470c7cf0865b35967157e68ad27fb42b9915e2e5d89c45a6f262dd1fd362ad666eff81b572fd5312e728303be147b35cf06c17e00a46f6589ce37794019072e8fddd461f
14	0	\\x01000001343082013002200943148e53922d6e4ebd53e9bf3755dc4c83a57d5f8715e78200c5bffd544d48022050af3d785c5c8cb2ee6ff6ab96f3553c3fd69610a9352d0d66d736c3b41b642a0420830a6eef44f1cc405becf541f79bb28a48e8532de19622f4f680d38303fb4d760481c7e83dc9cc8ae9ef2175a0d2c29f5e9528300c2d1d9e22a80980e11f6954015b979b66f09d724e91068e2ed02a378b1df97e406d1b2c0e33c4e5f5714bd103559bc3b92ca181f3592efa9bf832eb332169abbb29e29ac271fb61c76d08c35f2a5893222152f61228f13f80f40b3c5839d105067f292291fd8dd1a2ec952b75fd7b8cf17c35be66647981f255decd7cebc45648fd674f14ca0dab39400cdd097ab2ccdaea650e28f38ce1d143e87ce465470566466746b810f9c7bf135aa8cf9c3a177cff2ac233d559d364e3430aa5ab9051586aecac95621fcdefcb8cd75b41760bfe3f75f0e1f7687d98a47526165e18bc25a4b33979c640be72882fe4ad2ddb49cca5838cb874
15	1	\\x010000012630820122022100b2b673e63a97654148f856e38c6bb716c41f942f14bd39ec888470e6ed3345ff0221009e3571d8c5c73c5ebeaad2ce7fa26fd9b664ec0e99af155b8df82f60545e426c0420f9ae7455cf76d813864b579d7bef0c7404155f543e0713d2624731235de01a620481b7ea521cdcc00c8a22c419b628f98354f7966f158534fd55f6307b97bdd323ca88fbe079334c3f6cc7e55e1c8743750b81cab89f557909eeaf6840859ee2551a245a8196e882139838a79fc44836c50a468ffe6a8775a404e004ab9802ea6f15b9af87f9411a672a7b86c50d8ce6776877acb7d97988b24ba9524d16d393724c845266c15fc07c77ccbc5e804c005ed74c1c119749e0962e66793f62597ee401112d8c0a7b57da4ac79dad1a7ada9d636f44c26860b5c83fc5c168528c0e2a8aa3e5290fa85c7f3cd3610b9e0d59c523e5a2e6593f6e862cfac4c74e3a9451107641099bbc8715cc9d1dedaa8ba8d61d8aa6b337bae66bbf
\.


--
-- Data for Name: epoch_deltas; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.epoch_deltas (stream, epoch, records, first_at, last_at) FROM stdin;
1	1	1	1767600026005649634	1767600026005649634
2	1	1	1767600026005649634	1767600026005649634
2	1	1	1767600026055463091	1767600026055463091
\.


--
-- Data for Name: erasures; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.erasures (n, record, statement, account, taken) FROM stdin;
\.


--
-- Data for Name: feed; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.feed (number, record, topic, fact) FROM stdin;
1	1	1	2
2	2	1	2
3	3	1	2
\.


--
-- Data for Name: feeds; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.feeds (key, id, after) FROM stdin;
1	\\xb0a29773fcc6d264fb391444e9460b3b	0
2	\\x8aa35d4d86b630a8b45d1204fa3c0844	0
\.


--
-- Data for Name: filter_ids; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.filter_ids (key, id) FROM stdin;
1	\\xec88864bf15f5d00
2	\\x04623908f717c0d0
\.


--
-- Data for Name: filter_streams; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.filter_streams (filter, stream) FROM stdin;
1	1
2	1
1	2
2	2
\.


--
-- Data for Name: filters; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.filters (filter, record) FROM stdin;
1	1
2	1
1	2
2	2
1	3
2	3
\.


--
-- Data for Name: homes; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.homes (id, commits) FROM stdin;
\\xae44acb3f358fd950d989c420e70d7d5	61
\.


--
-- Data for Name: lease; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.lease (one, holder, number, since, until) FROM stdin;
1	\\x5f669b2a26391d34ebeb86daf0975fbc	1	1767600022401	0
\.


--
-- Data for Name: leaves; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.leaves (record, batch, leaf) FROM stdin;
1	1	0
2	1	1
3	2	0
\.


--
-- Data for Name: left_places; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.left_places (batch, leaf, record) FROM stdin;
\.


--
-- Data for Name: names; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.names (owner, id, name) FROM stdin;
\.


--
-- Data for Name: notes; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.notes (kind, about, value) FROM stdin;
profile accounts		[{"keeper":["0xBFF40De6B8b269afB18E503D2263bd09c82eAE15"]}]
system keys		[{"join":1,"list":"894175746853797301e9b422efdedbcb5a2f320b4f521fce9dce5d8d856a0c8a9b55c3857ac7a320f67d3c599c5428fe13aef99b7b0e0d49a53368019202d2e60a339ece6b36dbf28800000000695b6f971887c6db1dcbf8a3188c12fb101df8a302dd8c313110c711583e78734e33802edd24fe99b057551a5facdbeea5522bc937039046ed69b5a6eb4ecb228ac8e60ed159386979086b5f3c747ece381562752e1f3859c8b4c78200052115da66e8e4b9d1ccac66c366eeb626bd132cd79e71191887c6db1dcbf8a31889eceb16f4f8a37879dde85d798e225885e7e7bd04e3712fa723c570cb3ba37e6a2d5cc5321a4c55624c5411a007f4b640e95867b1c2d326154ba4d902c9505c0be8166a1ded3127ccd4ba082fcc70ba3803f4aa2326445fa713c062462742aa4bcfacd339391d1889eceb16f4f8a3188c12fb101df8a320c94907cdb667f86587af420f555e6ceb66ae93018cd4128cce111724886c069105c76d6cdee0b6e8b5d39bb80a6b0455c80e4596fc625066b2758286e76e49","secrets":"939d61d8b32760ce72374e288314d7fe461954530f9381a0c09144ca1b9714b5a1f7159d607be8dfa0ce4e211c673a23a65057e4f4eaa9e3b19ec25623ad9cb45967a09da816a084a2ac479471d571e2584e0ab471fdc594443cd1e1706e650de69a5e7616ee40edab0a0217e3e16d8ae33c4bcdf161908e35f9151470463e0a8fab13bce6087a98245b207e92a1be6858"}]
admitted		[[{"owner":"0x9b67978a101452742D2570D51B377343607ABCDf","since":"2026-01-05T08:00:23.401206598Z","by":"keeper"}]]
\.


--
-- Data for Name: passed_over; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.passed_over (record, block) FROM stdin;
\.


--
-- Data for Name: recorders; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.recorders (key, id, signer) FROM stdin;
1	\\x0190a235f8be2770a44ede15c68443b7	\\xa44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d
\.


--
-- Data for Name: records; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.records (n, digest, topic, stream, seq, epoch, signature, bytes, captured_at, acknowledged_at, simulated, state, tx, block, block_hash, deleted_at) FROM stdin;
1	\\xf227aa4924d5b554b6f2c25da953f590bb2f59e8c6fc7d8bf4c3b0456aa9feea	1	1	1	1	\\xb638b77fbf68c35ef0b401118b6eff0474fe353008fee7099d8b05e48d61f4ab47b5d1fa3149ee80f8fe089fec23e69bff73880657693166b6907226fcf1d0eb	329	1767600026005649634	1767600026015675344	0	6	\N	\N	\N	\N
2	\\x1a3d5f06d911350faea16f06fdb88e1f5fca689b3d28d555fed3c3d1b4d6573b	1	2	2	1	\\xfc29af9af7878b41450de28b142e3c91beee5b9c14e51955b444747c2718c7f8013881a0f731d48319ad6018a12ce30e444a39146789fe2ca73b4513bc96c900	166	1767600026005649634	1767600026015675344	0	6	\N	\N	\N	\N
3	\\x08f02ef85e3a545b73aae42eaa1b8ba099e4fc469cceaf952de221e8cfcb00a7	1	2	3	1	\\x296c4a0fdc958da2eb5ae361a7fe78cb7762df5a514f4fa03401b351f3b90f7d4b57a0c606798e846212a0110fa0f9c891ff982a56bd08cf3fbdad6f7260e920	166	1767600026055463091	1767600026062572197	0	6	\N	\N	\N	\N
\.


--
-- Data for Name: retained; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.retained (record, report, header, deleted_at) FROM stdin;
\.


--
-- Data for Name: retained_topics; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.retained_topics (topic, records, bytes) FROM stdin;
\.


--
-- Data for Name: rights; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.rights (block, place, kind, owner, grantee, epoch, token, event, replaced, revoked, revoked_at) FROM stdin;
1	0	5	\N	\N	\N	\N	{"transaction":"0xf5c0ab3702c31109cc9bba12769c0eb9c38fe50c42c1e0076be8cd5a5937d231","proven":false,"event":{"AdministratorChanged":{"previous":"0x0000000000000000000000000000000000000000","administrator":"0x9b67978a101452742D2570D51B377343607ABCDf"}}}	\N	\N	\N
1	1	5	\N	\N	\N	\N	{"transaction":"0xf5c0ab3702c31109cc9bba12769c0eb9c38fe50c42c1e0076be8cd5a5937d231","proven":false,"event":{"OpenChanged":{"open":true}}}	\N	\N	\N
1	2	5	\N	\N	\N	\N	{"transaction":"0xf5c0ab3702c31109cc9bba12769c0eb9c38fe50c42c1e0076be8cd5a5937d231","proven":false,"event":{"DelayFixed":{"seconds":604800}}}	\N	\N	\N
2	0	5	\\x9b67978a101452742d2570d51b377343607abcdf	\N	1	\\x2fe8ec3fb088b37fafa093d678dbf00cf83c89979b77145579ae339dca76a74a	{"transaction":"0xdbaf37351cb72dd1a4599ae243f9521b1662a2ea66f699626d13ee733e1d6ebc","proven":true,"event":{"Registered":{"owner":"0x9b67978a101452742D2570D51B377343607ABCDf","identity":{"token":"2fe8ec3fb088b37fafa093d678dbf00cf83c89979b77145579ae339dca76a74a","signing":"8d54dc6e993df9e56d6f8d29f74fac513a1a61fbb524c3e4abc9e2c7ae831f364694980aade885df49bd0d6bf013a7efffeb3493829a611a3536a893ce33dbe1","envelope":"7860ebb418cd5d2d888f5fe37cce938c8b61702410874040cd7ed04cbc9f0d0bbc25fe1271167cdbe26a29dcbe7d5b8ab28f82cbfaaa8ab5b3ced33ad856738d","proof":"e8ac2ae78f9b56a09d80aaf7798a2d891c466920bfd39e47a3233f9da8e155e6e6c8c60677c0391ca5e20bb5a4b95f1e56faee6a6dfaefbae9d2b4bd6673088c"},"epoch":1}}}	\N	\N	\N
2	1	6	\\x9b67978a101452742d2570d51b377343607abcdf	\N	1	\N	{"transaction":"0xdbaf37351cb72dd1a4599ae243f9521b1662a2ea66f699626d13ee733e1d6ebc","proven":false,"event":{"Wrapped":{"owner":"0x9b67978a101452742D2570D51B377343607ABCDf","grantee":"0x9b67978a101452742D2570D51B377343607ABCDf","epoch":1,"envelope":[]}}}	2	\N	\N
3	0	5	\\x24f9fc84a9d90b7da5c4138d1f7afb47c91b6603	\N	1	\\xf8e7185fbcdad44e65745ce6897aae9ec0993da0ce95b5d1ad32ece1604b93b2	{"transaction":"0x2da718c9096b96ab35644f627f195e0491058fc7f11077380f862d779c406bc5","proven":true,"event":{"Registered":{"owner":"0x24f9Fc84A9d90B7Da5c4138d1F7AfB47C91b6603","identity":{"token":"f8e7185fbcdad44e65745ce6897aae9ec0993da0ce95b5d1ad32ece1604b93b2","signing":"44ef1342c940478818d492f8c4a6af98820e90727319d4bf30564c2a59ebba44d3d03e3fdc4bba5e428fc90bc2599943ac36b464e5af22a8f155560c3f5da341","envelope":"3a2571d4efe6ba166894540785071a3a2c306a8b08f680061d6fe1306e042e1d21b3dba4218d30285b079f4a4362f86a455df05782e1496a36925aab8b79f99a","proof":"c7a1a29fbc68d9532ffb3ac8b797e78c6b359349226d8d92293b18f6efcf8cf8e481959b8be594b472fe417f10f8d1727bb72d21dd33bed04eb25e59aa797fa4"},"epoch":1}}}	\N	\N	\N
3	1	6	\\x24f9fc84a9d90b7da5c4138d1f7afb47c91b6603	\N	1	\N	{"transaction":"0x2da718c9096b96ab35644f627f195e0491058fc7f11077380f862d779c406bc5","proven":false,"event":{"Wrapped":{"owner":"0x24f9Fc84A9d90B7Da5c4138d1F7AfB47C91b6603","grantee":"0x24f9Fc84A9d90B7Da5c4138d1F7AfB47C91b6603","epoch":1,"envelope":[]}}}	3	\N	\N
6	0	1	\\x9b67978a101452742d2570d51b377343607abcdf	\\x24f9fc84a9d90b7da5c4138d1f7afb47c91b6603	1	\N	{"transaction":"0xd37456956d6334498ca927623165a1a08a0a68f294a04d2026631bde3f9de480","proven":false,"event":{"Granted":{"terms":{"owner":"0x9b67978a101452742D2570D51B377343607ABCDf","grantee":"0x24f9Fc84A9d90B7Da5c4138d1F7AfB47C91b6603","epoch":1,"expiry":null,"scope":{"kind":"topics","topics":["6b8b38c3169169d5a6f0e1f4319d556b"]}},"envelope":[]}}}	\N	\N	\N
7	0	5	\\x2bb10cb67df040242a1e1d59c9c80acca07ec6ff	\N	1	\\x89ba5dad09b1d28671972fb8bdd31cbfe3dd84cb0dc91a596ad4cbaa10598f7a	{"transaction":"0x32b0930dca5bf4aeec7c0109f4e65310b0fccf3082a34479ae7af697f75f3e68","proven":true,"event":{"Registered":{"owner":"0x2bb10cb67Df040242A1E1D59C9c80acCa07ec6fF","identity":{"token":"89ba5dad09b1d28671972fb8bdd31cbfe3dd84cb0dc91a596ad4cbaa10598f7a","signing":"5e0ea01bddb13d031c2a6d915b345d9cfd60afb39e5f3e6725becad16f2bad0b2ba507d05f542f57bfc790df3f1fcd0376482ca32ed88a56d90d48288b3995c1","envelope":"729a2f31aca498c6e6cd77d38cfe9129d053689597a91905855dd06e3c188fc95b44e4ccca417b2c4da4a639eb796977f9793451941a4b97e70c2e924f893eec","proof":"cdeb785541473dab4bccfacb937110c636ab07f2cb2457985b7cbf205249f798ca3044a8d911b013b4f2d75238fe6e3931bc0e2b0b470388311be3a2ea33da29"},"epoch":1}}}	\N	\N	\N
7	1	6	\\x2bb10cb67df040242a1e1d59c9c80acca07ec6ff	\N	1	\N	{"transaction":"0x32b0930dca5bf4aeec7c0109f4e65310b0fccf3082a34479ae7af697f75f3e68","proven":false,"event":{"Wrapped":{"owner":"0x2bb10cb67Df040242A1E1D59C9c80acCa07ec6fF","grantee":"0x2bb10cb67Df040242A1E1D59C9c80acCa07ec6fF","epoch":1,"envelope":[]}}}	7	\N	\N
8	0	5	\\x9b67978a101452742d2570d51b377343607abcdf	\N	\N	\N	{"transaction":"0xa9fee0ddcb21a2c8dd3226d2c9e27da52e4506b61e1b1c8a075ffa6af2a301be","proven":false,"event":{"Lent":{"owner":"0x9b67978a101452742D2570D51B377343607ABCDf","device":"11f35531051f012f55a82d4b433243bb3d6f0b70b24ef2326c5b06c71b46ee65","until":null}}}	\N	\N	\N
13	0	5	\\xf1c51f255befa2119396eee57e6d5e7f61d2570a	\N	1	\\xf2cf41a0ab529128632c72ca2b4b81268f441b24e32340d1850443b5336f085d	{"transaction":"0x53d9ab30c2c870e832fd87794ad9f6eca66d9b59e3226cea92929d600e5a6fff","proven":true,"event":{"Registered":{"owner":"0xF1C51F255BeFA2119396eEE57E6D5E7f61D2570A","identity":{"token":"f2cf41a0ab529128632c72ca2b4b81268f441b24e32340d1850443b5336f085d","signing":"47a7bfa312938b5f2b253a2e0e67116acde3c13d3af1eefcaa09c042869433045c11ee4ee72e068f3724e8aeb44cbff6caf0bd13361df6d08e8f150d0ad1fe25","envelope":"b472a954a7d34547ccd0aae2997102dac1ecd44942920a9f6eca04f9021311fd127635dde35b27b879b52a6bc280c978dde79cafae00926b5f73f796a1a7d4d2","proof":"c949a80cd35c547bc196534c90ad4bf80fa379d69517a39d839a869002f5d22a1dac8b1a48246a89b0f7d63ad71198f684d105062ff49d241c8832563c464ec3"},"epoch":1}}}	\N	\N	\N
13	1	6	\\xf1c51f255befa2119396eee57e6d5e7f61d2570a	\N	1	\N	{"transaction":"0x53d9ab30c2c870e832fd87794ad9f6eca66d9b59e3226cea92929d600e5a6fff","proven":false,"event":{"Wrapped":{"owner":"0xF1C51F255BeFA2119396eEE57E6D5E7f61D2570A","grantee":"0xF1C51F255BeFA2119396eEE57E6D5E7f61D2570A","epoch":1,"envelope":[]}}}	13	\N	\N
14	0	1	\\x9b67978a101452742d2570d51b377343607abcdf	\\xf1c51f255befa2119396eee57e6d5e7f61d2570a	1	\N	{"transaction":"0xd4220caefefefbec7e3453584a9cb557aaa249eabdeffd1eb387f27fde6c4c3c","proven":false,"event":{"Granted":{"terms":{"owner":"0x9b67978a101452742D2570D51B377343607ABCDf","grantee":"0xF1C51F255BeFA2119396eEE57E6D5E7f61D2570A","epoch":1,"expiry":null,"scope":{"kind":"topics","topics":["6b8b38c3169169d5a6f0e1f4319d556b"]}},"envelope":[]}}}	\N	\N	\N
15	0	5	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	\N	1	\\x8c06966331ea94fb2e456f47fa16576e5f0dafd54d17232fc15ebe3e0b5d7f4a	{"transaction":"0x9371c3ab47026d40e5325c5cda4d689f2ee41477d732241511e0ac22c52f1a9e","proven":true,"event":{"Registered":{"owner":"0xBFF40De6B8b269afB18E503D2263bd09c82eAE15","identity":{"token":"8c06966331ea94fb2e456f47fa16576e5f0dafd54d17232fc15ebe3e0b5d7f4a","signing":"9fa0faf390baa61c9ab94959c682e21fedf8bfbc2f4dd38ee465ad13f91b5db4b3a0b42c68efdfe0ef2fb16a7c2b5b463cc3c2d74c1d4d81a58a0b527b512d60","envelope":"2ac940557eb3cbafbb3f36300cc63455961c62afe4a1c629f8a43b334f5f05ec206db2e02d64a07dd96d345e515ca2f33d456d25cb1cbc4efbf594bbd70eefcb","proof":"fd3c1a2893f2cb5d9b3f8a8fd38cd52f0b629a454dbfa359963b2b9e63e492c386487f045990243b4d8fed0c1246c98f4985bc5c7223fd3776dcf6ea5df3d5d1"},"epoch":1}}}	\N	\N	\N
15	1	6	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	\N	1	\N	{"transaction":"0x9371c3ab47026d40e5325c5cda4d689f2ee41477d732241511e0ac22c52f1a9e","proven":false,"event":{"Wrapped":{"owner":"0xBFF40De6B8b269afB18E503D2263bd09c82eAE15","grantee":"0xBFF40De6B8b269afB18E503D2263bd09c82eAE15","epoch":1,"envelope":[]}}}	15	\N	\N
16	0	5	\\x9b67978a101452742d2570d51b377343607abcdf	\N	\N	\N	{"transaction":"0x5c3ba705c6bf9f8fcdd07f3e8809c75b1e475f7281f09666e271247bc8060556","proven":false,"event":{"Lent":{"owner":"0x9b67978a101452742D2570D51B377343607ABCDf","device":"a44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d","until":null}}}	\N	\N	\N
\.


--
-- Data for Name: signers; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.signers (id, key) FROM stdin;
\\xa44ede15c68443b779b4ddf80629eb9acd0586fd5f6548dfb9f59eb238a1479d	\\x17d00c4040fb824bd43631deee8279c1c2077e69496861f95bd484e51f32e4adafe83b64de138da78aac5f9c59f961eedf4cd1702107b2557d022fd96fc028c9
\.


--
-- Data for Name: stamp_tokens; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.stamp_tokens (stamp, authority, before, token) FROM stdin;
\.


--
-- Data for Name: stamped_roots; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.stamped_roots (root, stamp) FROM stdin;
\.


--
-- Data for Name: stamps; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.stamps (key, made_at, upto, roots) FROM stdin;
\.


--
-- Data for Name: streams; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.streams (key, topic, kind, type_name) FROM stdin;
1	1	2	ec88864bf15f5d00
2	1	1	ec88864bf15f5d00
\.


--
-- Data for Name: topics; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.topics (key, owner, recorder, topic_id, name, keeper) FROM stdin;
1	\\x9b67978a101452742d2570d51b377343607abcdf	1	\\x6b8b38c3169169d5a6f0e1f4319d556b		\\xbff40de6b8b269afb18e503d2263bd09c82eae15
\.


--
-- Data for Name: trail; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.trail (block, hash) FROM stdin;
1	\\x354041d1bb0606d0f3827705749f6b68158498878ad045e0e9eaf6fc26c9c8a6
2	\\xbbbb17ed4386d57101fafba75831ae781fffec4bfa54dbffeb12b68462f935aa
3	\\xd6250bdc965398e5e807647c4c55efe48ee6187bb7c93dd1a4db574f08475d5c
4	\\x955f39239e72fac83bb4ee6c7c004cc9a7297b0c98924014cedb5bba2359c27d
5	\\x14032f179d067cdb84007091c01d4b692a29647584401ad0948926f77359cd75
6	\\xa3a2a50d9a6ccd1111734d87222faa3a145ecc51babea96c63e569fec82ba101
7	\\x25c20e91525375b6faaded97452491f476bd529de1ea085c7a82d192de4b733a
8	\\xbec75ccc079a40be0b4e7905017fbec761f0c627521cd9e73181c37ac0c87b48
9	\\xb4c4989c24d52405425c5936496e4561e36bf5545851777834c93be607ba0c76
10	\\xf0c02d9d4472690678750cded1237093137086fafac5e35b847c0322eab88629
11	\\xac935fceb1df329dcfca1d8b0e3af6d6fe0221dd865fd5dda29597c7a5f63239
12	\\x94566398c423941b65ac573d2d9d0b3500807ae3f98bbfd33c64a1fee04ed433
13	\\xda53673d224f7b80af0590c6aaebf31b21acc757b5763eabefeb605e02e345e5
14	\\xb7952d76f8014be64d27f9c8433301a83b617cf471fd77c376b4e626b172a680
15	\\xcdbe739d0ccc6e666398d50d85b7a961cd45b00d62cec6f60ecd6bae9e0efcaa
16	\\x6659f712082dc4626f35d78b0b401ad75480ad42eed93b94485e541694a178bd
17	\\xbc61ca29289f926f296cf3c10fe6d0b0a35c1050f31bba28c53add999933498f
18	\\x3a5b29acfae87c3f828c114e5ca68144869b224dcb2295af677490dee04e19d7
19	\\xe671872039e7ed5d2805f07d504752d6e8d0e1e10bd34ea4f54cbe49e85b9f90
20	\\x502f81d78d32a9a72ef78a52b024316f6ef6142f9b38c8b7600029e36b8ac698
\.


--
-- Data for Name: transactions; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.transactions (key, hash, account, nonce, raw, purpose, digests, signed_at, state, block, block_hash, gas_used, reason, replaced_by, batch) FROM stdin;
1	\\x9371c3ab47026d40e5325c5cda4d689f2ee41477d732241511e0ac22c52f1a9e	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	0	\\xf9034c808083079180942a3d405239df7f45210a28d0e90436d5a2899def80b902e4a3747fef0000000000000000000000000000000000000000000000000000000000000040000000000000000000000000000000000000000000000000000000000000014000000000000000000000000000000000000000000000000000000000000000e08c06966331ea94fb2e456f47fa16576e5f0dafd54d17232fc15ebe3e0b5d7f4a9fa0faf390baa61c9ab94959c682e21fedf8bfbc2f4dd38ee465ad13f91b5db4b3a0b42c68efdfe0ef2fb16a7c2b5b463cc3c2d74c1d4d81a58a0b527b512d602ac940557eb3cbafbb3f36300cc63455961c62afe4a1c629f8a43b334f5f05ec206db2e02d64a07dd96d345e515ca2f33d456d25cb1cbc4efbf594bbd70eefcbfd3c1a2893f2cb5d9b3f8a8fd38cd52f0b629a454dbfa359963b2b9e63e492c386487f045990243b4d8fed0c1246c98f4985bc5c7223fd3776dcf6ea5df3d5d1000000000000000000000000000000000000000000000000000000000000016b010000012630820122022100b2b673e63a97654148f856e38c6bb716c41f942f14bd39ec888470e6ed3345ff0221009e3571d8c5c73c5ebeaad2ce7fa26fd9b664ec0e99af155b8df82f60545e426c0420f9ae7455cf76d813864b579d7bef0c7404155f543e0713d2624731235de01a620481b7ea521cdcc00c8a22c419b628f98354f7966f158534fd55f6307b97bdd323ca88fbe079334c3f6cc7e55e1c8743750b81cab89f557909eeaf6840859ee2551a245a8196e882139838a79fc44836c50a468ffe6a8775a404e004ab9802ea6f15b9af87f9411a672a7b86c50d8ce6776877acb7d97988b24ba9524d16d393724c845266c15fc07c77ccbc5e804c005ed74c1c119749e0962e66793f62597ee401112d8c0a7b57da4ac79dad1a7ada9d636f44c26860b5c83fc5c168528c0e2a8aa3e5290fa85c7f3cd3610b9e0d59c523e5a2e6593f6e862cfac4c74e3a9451107641099bbc8715cc9d1dedaa8ba8d61d8aa6b337bae66bbf00000000000000000000000000000000000000000086502d2f5a011fa052677401e9c1650dbf4f9f5baa562df92cdbf58eb8f76c4344c270dfc3f7ecc4a052559359746b6bfdcba922bd651ff40bd1416ed13301530051693effeb37c191	register	\\x	1767600023025190084	1	15	\\xcdbe739d0ccc6e666398d50d85b7a961cd45b00d62cec6f60ecd6bae9e0efcaa	333299	\N	\N	\N
2	\\xf4a5d83754512a04933b3cd416c4119f9d64ee1538731e10b4ce97209ccba63f	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	1	\\xf8cb018083014726942a3d405239df7f45210a28d0e90436d5a2899def80b86470c127c636cc042cda5aee036ecf81ab9e6856d35bad9bd0ea0cf6af04ee8b6fecbc782f0000000000000000000000000000000000000000000000000000000000000002000000000000000000000000000000000000000000000000000000000000000086502d2f5a0120a032af0f66a422cb5ba792efa7e623a0022943c2859748393990c8add247b9ad63a06cb9c360cfa6a5febb5c1d7da0c74d2bcb8df7eb9c440e2452248d304efa174b	anchor	\\x	1767600026088755796	1	19	\\xe671872039e7ed5d2805f07d504752d6e8d0e1e10bd34ea4f54cbe49e85b9f90	56468	\N	\N	\\x36cc042cda5aee036ecf81ab9e6856d35bad9bd0ea0cf6af04ee8b6fecbc782f
3	\\x456a7e0e69834956bde3749a058fad0b6ee78795efce6e0904e1347f245fe1fa	\\xbff40de6b8b269afb18e503d2263bd09c82eae15	2	\\xf8cb028083014726942a3d405239df7f45210a28d0e90436d5a2899def80b86470c127c6153f6afcf64897aa61e9abd5bbb9d6c986db1af08e6a08dd9346e24ebe28cfe5000000000000000000000000000000000000000000000000000000000000000136cc042cda5aee036ecf81ab9e6856d35bad9bd0ea0cf6af04ee8b6fecbc782f86502d2f5a011fa069a74c72f2ba93cd23ae024835dd7174491a4ede606bd7d1ff46520e0cc9119ba03a68e9edcc431da0338b1b41082ae97553794cc91352cc98aff1c7a14560c510	anchor	\\x	1767600026298775935	1	20	\\x502f81d78d32a9a72ef78a52b024316f6ef6142f9b38c8b7600029e36b8ac698	56847	\N	\N	\\x153f6afcf64897aa61e9abd5bbb9d6c986db1af08e6a08dd9346e24ebe28cfe5
\.


--
-- Data for Name: unnumbered; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.unnumbered (key, record) FROM stdin;
\.


--
-- Data for Name: workers; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.workers (id, name, seen) FROM stdin;
\.


--
-- Name: batches_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.batches_key_seq', 2, true);


--
-- Name: chain_nodes_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.chain_nodes_key_seq', 15, true);


--
-- Name: erasures_n_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.erasures_n_seq', 1, false);


--
-- Name: feeds_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.feeds_key_seq', 2, true);


--
-- Name: filter_ids_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.filter_ids_key_seq', 2, true);


--
-- Name: recorders_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.recorders_key_seq', 1, true);


--
-- Name: records_n_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.records_n_seq', 3, true);


--
-- Name: stamps_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.stamps_key_seq', 1, false);


--
-- Name: streams_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.streams_key_seq', 2, true);


--
-- Name: topics_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.topics_key_seq', 1, true);


--
-- Name: transactions_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.transactions_key_seq', 3, true);


--
-- Name: unnumbered_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.unnumbered_key_seq', 1, false);


--
-- Name: about about_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.about
    ADD CONSTRAINT about_pkey PRIMARY KEY (one);


--
-- Name: audit audit_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.audit
    ADD CONSTRAINT audit_pkey PRIMARY KEY (line);


--
-- Name: batches batches_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.batches
    ADD CONSTRAINT batches_pkey PRIMARY KEY (key);


--
-- Name: batches batches_root_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.batches
    ADD CONSTRAINT batches_root_key UNIQUE (root);


--
-- Name: bindings bindings_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.bindings
    ADD CONSTRAINT bindings_pkey PRIMARY KEY (name);


--
-- Name: branches branches_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.branches
    ADD CONSTRAINT branches_pkey PRIMARY KEY (batch, branch);


--
-- Name: chain_headers chain_headers_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.chain_headers
    ADD CONSTRAINT chain_headers_pkey PRIMARY KEY (block);


--
-- Name: chain_nodes chain_nodes_hash_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.chain_nodes
    ADD CONSTRAINT chain_nodes_hash_key UNIQUE (hash);


--
-- Name: chain_nodes chain_nodes_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.chain_nodes
    ADD CONSTRAINT chain_nodes_pkey PRIMARY KEY (key);


--
-- Name: chain_proofs chain_proofs_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.chain_proofs
    ADD CONSTRAINT chain_proofs_pkey PRIMARY KEY (block);


--
-- Name: ciphertext ciphertext_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.ciphertext
    ADD CONSTRAINT ciphertext_pkey PRIMARY KEY (record);


--
-- Name: contract contract_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.contract
    ADD CONSTRAINT contract_pkey PRIMARY KEY (one);


--
-- Name: cursor cursor_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.cursor
    ADD CONSTRAINT cursor_pkey PRIMARY KEY (one);


--
-- Name: envelopes envelopes_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.envelopes
    ADD CONSTRAINT envelopes_pkey PRIMARY KEY (block, place);


--
-- Name: erasures erasures_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.erasures
    ADD CONSTRAINT erasures_pkey PRIMARY KEY (n);


--
-- Name: erasures erasures_record_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.erasures
    ADD CONSTRAINT erasures_record_key UNIQUE (record);


--
-- Name: feed feed_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.feed
    ADD CONSTRAINT feed_pkey PRIMARY KEY (number);


--
-- Name: feed feed_record_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.feed
    ADD CONSTRAINT feed_record_key UNIQUE (record);


--
-- Name: feeds feeds_id_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.feeds
    ADD CONSTRAINT feeds_id_key UNIQUE (id);


--
-- Name: feeds feeds_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.feeds
    ADD CONSTRAINT feeds_pkey PRIMARY KEY (key);


--
-- Name: filter_ids filter_ids_id_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.filter_ids
    ADD CONSTRAINT filter_ids_id_key UNIQUE (id);


--
-- Name: filter_ids filter_ids_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.filter_ids
    ADD CONSTRAINT filter_ids_pkey PRIMARY KEY (key);


--
-- Name: filter_streams filter_streams_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.filter_streams
    ADD CONSTRAINT filter_streams_pkey PRIMARY KEY (filter, stream);


--
-- Name: filters filters_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.filters
    ADD CONSTRAINT filters_pkey PRIMARY KEY (filter, record);


--
-- Name: homes homes_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.homes
    ADD CONSTRAINT homes_pkey PRIMARY KEY (id);


--
-- Name: lease lease_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.lease
    ADD CONSTRAINT lease_pkey PRIMARY KEY (one);


--
-- Name: leaves leaves_batch_leaf_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.leaves
    ADD CONSTRAINT leaves_batch_leaf_key UNIQUE (batch, leaf);


--
-- Name: leaves leaves_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.leaves
    ADD CONSTRAINT leaves_pkey PRIMARY KEY (record);


--
-- Name: left_places left_places_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.left_places
    ADD CONSTRAINT left_places_pkey PRIMARY KEY (batch, leaf);


--
-- Name: names names_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.names
    ADD CONSTRAINT names_pkey PRIMARY KEY (owner, id);


--
-- Name: notes notes_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.notes
    ADD CONSTRAINT notes_pkey PRIMARY KEY (kind, about);


--
-- Name: passed_over passed_over_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.passed_over
    ADD CONSTRAINT passed_over_pkey PRIMARY KEY (record);


--
-- Name: recorders recorders_id_signer_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.recorders
    ADD CONSTRAINT recorders_id_signer_key UNIQUE (id, signer);


--
-- Name: recorders recorders_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.recorders
    ADD CONSTRAINT recorders_pkey PRIMARY KEY (key);


--
-- Name: records records_digest_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.records
    ADD CONSTRAINT records_digest_key UNIQUE (digest);


--
-- Name: records records_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.records
    ADD CONSTRAINT records_pkey PRIMARY KEY (n);


--
-- Name: records records_topic_seq_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.records
    ADD CONSTRAINT records_topic_seq_key UNIQUE (topic, seq);


--
-- Name: retained retained_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.retained
    ADD CONSTRAINT retained_pkey PRIMARY KEY (record);


--
-- Name: retained_topics retained_topics_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.retained_topics
    ADD CONSTRAINT retained_topics_pkey PRIMARY KEY (topic);


--
-- Name: rights rights_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.rights
    ADD CONSTRAINT rights_pkey PRIMARY KEY (block, place);


--
-- Name: signers signers_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.signers
    ADD CONSTRAINT signers_pkey PRIMARY KEY (id);


--
-- Name: stamp_tokens stamp_tokens_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.stamp_tokens
    ADD CONSTRAINT stamp_tokens_pkey PRIMARY KEY (stamp, authority);


--
-- Name: stamped_roots stamped_roots_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.stamped_roots
    ADD CONSTRAINT stamped_roots_pkey PRIMARY KEY (root);


--
-- Name: stamps stamps_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.stamps
    ADD CONSTRAINT stamps_pkey PRIMARY KEY (key);


--
-- Name: streams streams_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.streams
    ADD CONSTRAINT streams_pkey PRIMARY KEY (key);


--
-- Name: streams streams_topic_kind_type_name_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.streams
    ADD CONSTRAINT streams_topic_kind_type_name_key UNIQUE (topic, kind, type_name);


--
-- Name: topics topics_owner_topic_id_recorder_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.topics
    ADD CONSTRAINT topics_owner_topic_id_recorder_key UNIQUE (owner, topic_id, recorder);


--
-- Name: topics topics_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.topics
    ADD CONSTRAINT topics_pkey PRIMARY KEY (key);


--
-- Name: trail trail_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.trail
    ADD CONSTRAINT trail_pkey PRIMARY KEY (block);


--
-- Name: transactions transactions_hash_key; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.transactions
    ADD CONSTRAINT transactions_hash_key UNIQUE (hash);


--
-- Name: transactions transactions_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.transactions
    ADD CONSTRAINT transactions_pkey PRIMARY KEY (key);


--
-- Name: unnumbered unnumbered_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.unnumbered
    ADD CONSTRAINT unnumbered_pkey PRIMARY KEY (key);


--
-- Name: workers workers_pkey; Type: CONSTRAINT; Schema: public; Owner: -
--

ALTER TABLE ONLY public.workers
    ADD CONSTRAINT workers_pkey PRIMARY KEY (id);


--
-- Name: batches_anchored; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX batches_anchored ON public.batches USING btree (block) WHERE (block IS NOT NULL);


--
-- Name: batches_unproven; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX batches_unproven ON public.batches USING btree (block) WHERE ((block IS NOT NULL) AND (proof IS NULL));


--
-- Name: batches_waiting; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX batches_waiting ON public.batches USING btree (owner, key) WHERE (tx IS NULL);


--
-- Name: batches_without_proof; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX batches_without_proof ON public.batches USING btree (block) WHERE (proof = 2);


--
-- Name: counter_deltas_by_stream; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX counter_deltas_by_stream ON public.counter_deltas USING btree (stream, state);


--
-- Name: epoch_deltas_by_stream; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX epoch_deltas_by_stream ON public.epoch_deltas USING btree (stream, epoch);


--
-- Name: records_by_state; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX records_by_state ON public.records USING btree (state, stream, captured_at);


--
-- Name: records_by_time; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX records_by_time ON public.records USING btree (captured_at, n);


--
-- Name: retained_due; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX retained_due ON public.retained USING btree (record) WHERE (deleted_at IS NULL);


--
-- Name: rights_given; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX rights_given ON public.rights USING btree (owner, grantee) WHERE (revoked IS NOT NULL);


--
-- Name: rights_own; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX rights_own ON public.rights USING btree (owner, epoch) WHERE (kind = 6);


--
-- Name: rights_received; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX rights_received ON public.rights USING btree (grantee) WHERE (revoked IS NOT NULL);


--
-- Name: rights_standing; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX rights_standing ON public.rights USING btree (owner, kind, grantee) WHERE ((replaced IS NULL) AND (revoked IS NULL));


--
-- Name: rights_tokens; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX rights_tokens ON public.rights USING btree (owner, epoch) WHERE (token IS NOT NULL);


--
-- Name: topics_by_keeper; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX topics_by_keeper ON public.topics USING btree (keeper) WHERE (keeper IS NOT NULL);


--
-- Name: transactions_by_nonce; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX transactions_by_nonce ON public.transactions USING btree (account, nonce);


--
-- Name: transactions_mined; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX transactions_mined ON public.transactions USING btree (block) WHERE (state = 1);


--
-- Name: transactions_open; Type: INDEX; Schema: public; Owner: -
--

CREATE INDEX transactions_open ON public.transactions USING btree (account, nonce) WHERE (state = 0);


--
-- Name: erasures erasure_stated; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER erasure_stated AFTER INSERT ON public.erasures FOR EACH ROW EXECUTE FUNCTION public.erasure_stated();


--
-- Name: records record_added; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER record_added AFTER INSERT ON public.records REFERENCING NEW TABLE AS added FOR EACH STATEMENT EXECUTE FUNCTION public.count_added();


--
-- Name: records record_moved; Type: TRIGGER; Schema: public; Owner: -
--

CREATE TRIGGER record_moved AFTER UPDATE ON public.records REFERENCING OLD TABLE AS before NEW TABLE AS after FOR EACH STATEMENT EXECUTE FUNCTION public.count_moved();


--
-- PostgreSQL database dump complete
--


