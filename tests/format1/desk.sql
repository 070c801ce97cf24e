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

    -- The feed. Who gives numbers holds the row of `about` until the end, so they become visible in order.
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
        UPDATE about SET head = head + erased RETURNING head INTO top;
        INSERT INTO feed SELECT top - erased + row_number() OVER (ORDER BY n), n, a.topic, 3
            FROM before b JOIN after a USING (n) WHERE a.state = 6 AND a.deleted_at IS NOT NULL AND b.deleted_at IS NULL
            ON CONFLICT (record) DO UPDATE SET number = excluded.number, fact = excluded.fact;
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
        UPDATE about SET head = head + 1;
        UPDATE feed SET number = (SELECT head FROM about) WHERE record = NEW.record AND fact = 3;
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
-- Name: settle(); Type: FUNCTION; Schema: public; Owner: -
--

CREATE FUNCTION public.settle() RETURNS void
    LANGUAGE plpgsql
    AS $$
BEGIN
    INSERT INTO counter_deltas SELECT stream, state, records, bytes, taken_in FROM pending_counters
        WHERE records <> 0 OR bytes <> 0 OR taken_in <> 0;
    INSERT INTO epoch_deltas SELECT stream, epoch, records, first_at, last_at FROM pending_epochs;
    DELETE FROM pending_counters;
    DELETE FROM pending_epochs;
    PERFORM pg_logical_emit_message(TRUE, 'authros', '');
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
-- Data for Name: about; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.about (one, recorder, clean, head, version) FROM stdin;
1	\\x019cd0b7a5aa3d01	1	3	1
\.


--
-- Data for Name: audit; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.audit (line, at, profile, action, subject, outcome, hash) FROM stdin;
1	1767600064117944468	keeper	create identity	keys	done	\\xeb4b83e903e7ac5965b1da8dde3d0772020943acd1111675b9d0f587cbb3d514
2	1767600064327831767	keeper	register	0xAf6FE6B864E1bd6Cc27396a069DccEa44a67C4c4	done	\\x2295092fdd0ea92c00fe1eb9a141d7611c3975639349683052f8a371c0c70747
3	1767600064580753027	keeper	gateway	127.0.0.1:40061	serving	\\x07c6e5d55feca6f2ef591036317513a21593d59df3677e41b75cf616c0ff1313
4	1767600064752074159	keeper	gateway allow	0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6	begun	\\x885f2b0a2ba501dc6ea4f3f7e3c24badff1d2185329b6326d883d74b9ce31133
5	1767600064799809980	keeper	gateway allow	0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6	done	\\xf2c138498779657bd2e6c23fdfabfa1654fc0dfb52f26dc88d39e5d76a31310e
6	1767600068367320391	keeper	allocate key	rover for 0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6	begun	\\xf1ad1f57bd7ed980e8825f73410e9de6c6dfa5248f68fea357e5683fc970710b
7	1767600068394104663	keeper	allocate key	rover for 0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6	done	\\xe4d2a989bfc8db3bcd6e2a701af8d2992036a9e46fefa987742e3401f68ec372
8	1767600069495319318	keeper	device notice	30d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6	asked by rover (0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6)	\\xd448972248d914191592543b146a2fb77cb335b647bbe00bbf638d218ade8037
9	1767600077297630300	127.0.0.1	refused	Signature	1 in the minute from 2026-01-05T08:01:00Z	\\x69b44dc55480fbe6e08df4d56904512765b6bef3315f018b78a09820ef5df34d
\.


--
-- Data for Name: batches; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.batches (key, root, owner, count, closed_at, account, tx, block, block_hash, proof, closed_here) FROM stdin;
1	\\xe0b50bae1a1f8bf49bfa2c357f99878d9d5fbc5542a7620802e85fd8bb10c2ec	\\xaf6fe6b864e1bd6cc27396a069dccea44a67c4c4	3	1767600076032679491	\\xaf6fe6b864e1bd6cc27396a069dccea44a67c4c4	\\xe1649e89ab7635d1ce871d759858a7ff00ed74270a471a5e0be9874aa1cae713	22	\\xe656fe87121e51f8b67e39f8cdbf8a35348acb567c44cbae342b69fd25cefe8c	1	1
\.


--
-- Data for Name: bindings; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.bindings (name, account, signing, envelope, sealed_key, device, notices) FROM stdin;
rover	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	\\xe151e4972e5d63de6c8efd79c9223eb5027f784ad0ad13e6203e3478f981c37202aff24cc86c2e893d929767123165a8a380537c1aa162cfd3992abefc2aab87	\\x2e2d999500b18d06b9d60bad371f670f0286263216fdcef3b9e7753eeddb517844ccb3e5051cae3d5015f709d0fe73bbbe40b2b054f927f89b1c986ce603cc83	\\xb653272bdbea99259a8059ac33fefca42596975aff7006d8276edfe7171a43d9b9345e39145624f0abd112e0ddf4298f2443ae377f3444f8d7b32cbe	\\x30d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6	\\x7d4475ce1733e0e2626f005a7623f3d7
\.


--
-- Data for Name: branches; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.branches (batch, branch, path) FROM stdin;
1	0	\\x000000130add4be4345c745a39e2068b7ec1bac56b3da5df5d8bd6d2fd492f18ce3548029e75e86db3c84273642ecf3f2d15c6c61057f9de5c2dd9a059905f7894e5d1791cf9b5bfdf204fd69ce99ae3f9e4300230625b528ca0b27ca25ea7cd69a16c4b
\.


--
-- Data for Name: chain_headers; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.chain_headers (block, header) FROM stdin;
22	\\xf90259a07952b17dd6ea0818784e9316467b4900be0967570c1e29a56cfd1badfac5e762a01dcc4de8dec75d7aab85b567b6ccd41ad312451b948a7413f0a142fd40d49347940000000000000000000000000000000000000000a0cf87626ccaa7ef7da1f1af7e52447155d728f6282c34e78695680b5fa7cc13a8a0e28cf8d3b0d21ada00918eaf42241c2dac75bba373709e206ac31fbfb700820da0ba785f236a2059dd041747678e032a10cfdc274a3a82dea0e0530ce928c0dd52b901000000000000000000000000000000000000000400000000000000000000200000000000000000000000000000000000000000000000000000000080000000000000000000000000000000000000100000000004000000000000000000000000000000000000000000001000000000000000000000000000000000000040000000000000000000000000002000000000000000000000000000000000000000000000000000000000000000000000000000200000000000000000000802000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000080000000000000000000000000000000000002168401312d0082dc9484695b6fccb86141757468524f5320636861696e2066696c652076657273696f6e20310000000083b17bc939c8bef04b34028c67913d206cf5ee35db5cc2afeeaf88d4b6c945da20123473da77e6bb51e018c432d15ac42bc161977feb0da97cae889b9921285f01a00000000000000000000000000000000000000000000000000000000000000000880000000000000000
\.


--
-- Data for Name: chain_nodes; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.chain_nodes (key, hash, node) FROM stdin;
1	\\x08dccb3df6e1eaeb3289fc487831d855610e177b29d9dbc153c890523a196b78	\\xf83ca0203521f2d5827302d6d8911c855859f50d175d774d5dfe0fa0bfd30cae38b4e89a990100000000695b6fcc00000000000000030000000000000016
2	\\x6182f35a6e2cb27ae2651b6645dd5fa7b4cec76e5c88bef6673938d50dda0ec4	\\xf85180808080a0e28959bf0a37bbd7e6d8ab79c2348dfb05f4ae034c0baf8f11aa8c0c424457d28080808080a0b7d134716c3e68bb51c9a021b65f1e9b31d5128106b07484353286fcd54b9833808080808080
3	\\x93f933241f96672bd433b9d8a99c92ca91fad63e4614de7b0b5060d7126b3150	\\xeda020179b38eaad68451b6ccfe0138466e04d44fb220009068b6c420b857de2ddfb8b8a14000000000000000001
4	\\xa738b7541de157038567fb46d53325e0b5f38521d1976e0b6a9c2691b1cc8294	\\xf4a020e032484bce265ee9cd4528ae7d2fd1c92a79aacc31d9cfc32382d551ea7d6792910100000000000000000000000000000001
5	\\xb7d134716c3e68bb51c9a021b65f1e9b31d5128106b07484353286fcd54b9833	\\xee9f318a448de14cde0ee896a6fca0b270424fdbf8c1e90bb07c927fb7ff28809f8d8c695b6f830000000000000002
6	\\xc3fc8e12c801774ef0ca254e693af5bb8be1dc5633d438ea2c99513871736dfe	\\xf90211a0dc05984472cfae90d7b6494b9d7acb3facffc34f0abb9d11d55b5a5cbbebdb84a0e603e7df4e64c1e80a62f6776ae78844574470fef6e8d7c195432501050fb677a0d8e235c2453fe41e46e4c9c79b550665f633d8df8daa1824b5ee46a47fad07afa0f8b2e80481c39214cc2994d4c968205da4de38600c7f0d35adaea1cdadcb0f3ba024895784b2f893f66ab8a125e98800826ab4aff33bfd38e5f2cf74865f2a25c8a09ebafffe19000d68abb34879ba9ff77f24a54fe1ddf3538872ef61c81d9533e7a07d9c90701951fa7d803a56fac8f027399358cdb664dc0726894a2cccb3463c5aa0f66630d3c8447e812409b2b97d6e951148c9e3ed16d8af52a5b5ab5901287a6ea0f57d9cdcaac375eb29c3ec9c4b497e5a8bad80dad186f741146d44e954e87b38a0b5537b46ba8f429a1042a8c0c3a7edf74f9402155101e4d9f81afa09098c84b8a0c7a891bbdd4310791ed666319f2e32df86d5e3480ca883b67552268a2cc7ce2ca0e1faab0d7ebbe92fcf625fbd37c7216a0f9986725b871b96b657e303ad276e88a066a3280e3c54b214822af6f618195d542f817e617c1574ea8c65dd1c3737f8bba0daa581d7277492b6ccb0d4c758bc25d64252cfc64e50061ff12bbc485e5e860da0483fd578172a548677439979318d24a8e13068ef64b56180ae2fb4a2390e7ddba018d56c9bc1cc49edd9ca84c1eead09d75467daf6649c600dc34246f36b4c6c8e80
7	\\xcf87626ccaa7ef7da1f1af7e52447155d728f6282c34e78695680b5fa7cc13a8	\\xf8d180a0b5dfca8f7ce95923c5131e8a876bc0c8c1dc41011a9772163098fc34b21e81c28080a0f76908d8c737256bf5c78a4b62064372f47a236146dc0c3369bffcbfccfee9308080a0893beef1ca1a70dd93012e8b142168a9637cd13d2215d167bfd98fc530654417a0dbceb571c0300f57b6b89a18d93674f1138cfa5715a3ed0abfbb3085092388788080a01d0bb4a6924a860b6ff69047c38dff41de0901a50e4bfe7794c641fd401bbb37a0dc12b6d4a763d151935ee90921bf9921b55855da45763287ff2e2792fb6ab31580808080
8	\\xdaa581d7277492b6ccb0d4c758bc25d64252cfc64e50061ff12bbc485e5e860d	\\xf8d18080808080a0a738b7541de157038567fb46d53325e0b5f38521d1976e0b6a9c2691b1cc8294a0ac53df71a497718fb44ed84232469f6da1241082331bb117d284eba554ffbf68a0a124d845d2832cd6f965e81d51b948c5d14aacd98299b46b96673d8ba8cfb1eda0e970958b249b27aa120a8c1051c587feee5e26ee9b0bcb0b6b259f3a7facff6680a0b16ef519e67ff8743617f4b76d1d6ef6ca1d711c15ea2366341f4e6f16cbf9a5808080a0ae351376b7c5eff313f51d0a17a87649c1eed757688647ab6e23445f16cf819c8080
9	\\xdc05984472cfae90d7b6494b9d7acb3facffc34f0abb9d11d55b5a5cbbebdb84	\\xf8d1a0f73e6c3f76d4c14a45f1665b969c7ec69388d911a2d249c6710511223b1e92c080808080a0f85e126382e6f89f2554f4e193d0aa77bd896cedde32f33a86ff5fe137e8c70b8080a093f933241f96672bd433b9d8a99c92ca91fad63e4614de7b0b5060d7126b315080a03bf032aa74ec5a249d3d5491a8b0f8414724ee8fcc02f3396d9d854c99dada44a0bc45d651c4c6e737c7d80a7ac7ee49cc4324ccafbc3a924922108563211c8baa8080a0965184652503bd8c7618c19a999ccfc6815ee983d937c0f031408832f60c6fb28080
10	\\xdc12b6d4a763d151935ee90921bf9921b55855da45763287ff2e2792fb6ab315	\\xf869a0356a227dc594f915a5091fcab6a89c15403d1775617434a959941f75cbbf3377b846f8440180a0c3fc8e12c801774ef0ca254e693af5bb8be1dc5633d438ea2c99513871736dfea0596d096d3f6cb170208bbab3b2869620c0180ff943c0b22a66e11699f3705797
11	\\xe1faab0d7ebbe92fcf625fbd37c7216a0f9986725b871b96b657e303ad276e88	\\xf90111a00a8b6854733ae71c2ec5ff01e18739b2f59b2d6734a70e541b9bc4e7d5605a94a04fdc7be9989019f134d6b5c0eedc35c93c8cba399b7fa22b2b75a8f6a4f8b7018080a07a7f52f9a7f2835fabcc3b6015f9253561a4d2483ba498ad9698b90274bd1e6580a0f5cf2c07b63698ceee333de98a8edcb7412154016ea7f62f9fe2c2a30f1c8723a05f9642729bb2194499accf8c0d3b1ef526082ad23dbbcf0c421ae2a5ee1f8591a0be66c131ba10eb0e041d201ed6805ba852be5371ef97a53382c12afda0d09b6ca06182f35a6e2cb27ae2651b6645dd5fa7b4cec76e5c88bef6673938d50dda0ec4808080a0a5599a08bb1a83f734d5da17d44a47a5a3ee52cfd639ee05fad68f187d5772f1808080
12	\\xf5cf2c07b63698ceee333de98a8edcb7412154016ea7f62f9fe2c2a30f1c8723	\\xf843a020a6a63a50ebb7fc90d729e53247d6560c4f1b07b1b5564612d19cf5362ca74aa1a038cd1a08368dfddae90f8f4525797e0d41998e8b20403dfcbeaa2fe9304b723c
13	\\xf66630d3c8447e812409b2b97d6e951148c9e3ed16d8af52a5b5ab5901287a6e	\\xf85180808080808080a008dccb3df6e1eaeb3289fc487831d855610e177b29d9dbc153c890523a196b7880808080a0fcb2e6f5b76fd52b47c9085579bf17d9dc6df2139c0fab737860cae7b5fde41480808080
\.


--
-- Data for Name: chain_proofs; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.chain_proofs (block, hash, nodes) FROM stdin;
22	\\xe656fe87121e51f8b67e39f8cdbf8a35348acb567c44cbae342b69fd25cefe8c	\\x000000000000000100000000000000020000000000000003000000000000000400000000000000050000000000000006000000000000000700000000000000080000000000000009000000000000000a000000000000000b000000000000000c000000000000000d
\.


--
-- Data for Name: ciphertext; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.ciphertext (record, bytes) FROM stdin;
1	\\x8941757468524f530101028223ff17f1ce761a7846b4488309bd5da089b0b877ab0887a0aba337a24b709eb20d8f6a91b503b0db2cc47c50419cce056651f630d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6000000000000000101cf593a4f8ec76030d8560bdeeea1ce000000000000000196edce93ecb2dbd6f1d0de49dd64b8ee021b590ecbb6717680f154c607bb3fe6fc1887c6e75b4916ae000000ac0000000000000159d6e1de2a9be18f6ca4998e49a136273ae86c94c9fc31ee1c8fbc6256ba4174664b1c14bf18a6b293e86e815900dc9057139fa5fbb8529d219e53157d3ef29b48aa66281f9d034e9ad893f063a2e7fdfb6bfe7a7d6bb45e5dfd373dd8e207b27ebf2dc9989ab400a8b14383b3b36e7e82357485c7210eebc11659350d6fa41275027d0e04141c58d62f203c0868ad8802ceeb4f4cd259da5ee6dc8e0c8ebf136dd55b1a423165a34eedd2903b6d4836f61f7e202dd4ee74fcf9cce5ccb29ee150c2ec7e4d7a9adb16bf3a220d51ae9c24916149d9c9e7bd97f9c13a51bccfe8e64fee2d55062c3c5234ac491f76ab735dfe7dfffba9e28d3e2cea71efdfea1c98ba20d421e71c63a5a31bd57307a5b5e8b2ac5ee0c13986b7ade76eca10f42a5cf6800d865063243fccc610104ea8e6fc74802079ac6773be9152b8a1ff140e581ca0610150bd82a69cd96d9abff1cfce544f9aa1ba5e51dd67afe480bb583914f8fd07559f6c2e3f029a2bce6889a548e79274f9cc8c4bf26350c308bb131a18f791173cf2e18688bb56bad064abfb455a5f798d57c691543b73ce1a6b1329eb3f88e212a7bbc2907028c77c40e75e78499674e0b0f6ce250630be52502e4bd39eeb7581d61ace58696888f338ddf8de97c325abc235d7607a259b7cd372fe89d0ac5d56162aedb110384212f0e4ccde414da75fb366193d5616354bb5c74c87716e6a724afe2b229ad8fc3b94082d34ce4eb71e9182447477639b46905104eaff1237977dc384a5db1678f1f66f95b5e1528e0d803e6e4c1ef70dbdeb
2	\\x8941757468524f530101018223ff17f1ce761a7846b4488309bd5da089b0b877ab0887a0aba337a24b709eb20d8f6a91b503b0db2cc47c50419cce056651f630d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6000000000000000101cf593a4f8ec76030d8560bdeeea1ce000000000000000296edce93ecb2dbd6f1d0de49dd64b8ee021b590ecbb6717680f154c607bb3fe6fc1887c6e75b4916ae000000ac00000000000000b66f99630a0617be44be98b3cdf5d24198023ae7b765bb40f52095a240448de24ee71ada5d5e928f2e515a8573bab9fbd72a05686a32c1803914ed76d1d0f6d403c03b23b47be908973a4908499f9bd49f6a54758cdaebd3f4118c51f0adf5dd59bb627413395e39084b0908c46d69367867429a30213132997b5fa398752a2426c5fe7c6c69dd0944726a6b0028969f2eab52fe6ad853bfe9f5ef6a1a44403bd23b307cdaa84a683edfbf757090445df9fff62ee9b6a1389e073c0a6886ec83becb4a2d8c26f91e4a1ebc2a067c30b44505a815e11ef1dc921542be7546ee11066e65aa23fd646edd2d7fd89f67f8f56dd56428d5de70296e3be311d77a7df74d87aff7d3d770e57e8999d942fee400f8118debe06a1df562d229a173d729e701baacbd6bc878d569112ab413bdaeb278d9b9fdf9385d8780080c4c0ceae8650bec115dbb3daca4542bdd83752b04fa329f4c7211b9f449f94fb5c064d3396d27cb0ea20ebe78c3d0f76756aab0ba7215323965297d9254c1f3a443e16527b909e60bc955a39782d1f0e4676d534aa1ccf39013fecc6f0c31824a
3	\\x8941757468524f530101018223ff17f1ce761a7846b4488309bd5da089b0b877ab0887a0aba337a24b709eb20d8f6a91b503b0db2cc47c50419cce056651f630d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6000000000000000101cf593a4f8ec76030d8560bdeeea1ce000000000000000396edce93ecb2dbd6f1d0de49dd64b8ee021b590ecbb6717680f154c607bb3fe6fc1887c6e75dc6c83a000000ac00000000000000b62153175a11d180037b8e38afae758f88e684d58e76501408cd552483cd4a0bd5fc913fad07e2dfe501b8c782b83bbd06a7c94ceeba5edbc87fa4dda92e75c23070c600c0259951452683e4c5d1d05c6591c0a2a133c65b6cf3690fe6629d4719d5a8260c391f7aeb5e4a137640054fb50072ea30235c4ee7b3053daaf29853fc59be263e781fcbc3fd3ec1a0f2b05cf01ec9cac81d385eb5ed59094f53b20c1e9ac4557bc3079bb1d446d1e374543395d8e2deeff79634e027dc4cae37fb5eb08991912cffb3bf1441e7ff153c802f5010c844165f0539d68dd9e9068360a163efcba500dec4a330bd896bbf17fdf6fa763ff545e06ebd8d0fef5a4a3e1394f49e8a6ea3e87b2dbb3a34ab01e6579344c05f06a8d4fd4ff54eed05469532ec286d7127fab90d8ce0d7f6098a30d7f10532b77503e13b850c6f1c5ab8030f7ef193c50f32b1563ec948a21a53fab45cde521ab59e5a84d8f37c0643a3822ec490a5ddad042464da658fe905b06674409df4ac80c59715a68f2129acffb795b69cf95096beae0a49e2455955f06017279b412799f42174abceaaf6
\.


--
-- Data for Name: contract; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.contract (one, domain, pin, block, place) FROM stdin;
1	\\x8223ff17f1ce761a7846b4488309bd5da089b0b877ab0887a0aba337a24b709e	{"chain_id":126303660326596,"genesis":"0x36b5310979bc119496cfdd62209411924666442f2b852d438cec929b60b52d8d","contract":"0x817f693f42c3706C35B74BBe51be2CA73283CACc","code_hash":"0x596d096d3f6cb170208bbab3b2869620c0180ff943c0b22a66e11699f3705797","deployed_at":1}	20	0
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
2	1	-2	-332	0
2	2	2	332	0
1	3	1	329	0
1	2	-1	-329	0
2	3	2	332	0
2	2	-2	-332	0
1	4	1	329	0
2	4	2	332	0
1	3	-1	-329	0
2	3	-2	-332	0
2	5	2	332	0
1	4	-1	-329	0
1	5	1	329	0
2	4	-2	-332	0
1	5	-1	-329	0
1	6	1	329	0
2	5	-2	-332	0
2	6	2	332	0
\.


--
-- Data for Name: cursor; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.cursor (one, block, hash) FROM stdin;
1	22	\\xe656fe87121e51f8b67e39f8cdbf8a35348acb567c44cbae342b69fd25cefe8c
\.


--
-- Data for Name: envelopes; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.envelopes (block, place, envelope) FROM stdin;
2	1	\\x0100000125308201210220619c706a26dbe02403ee1c79eadef7d74d2fccd96a7080a46b039f64958211b00221008243982556245e28918f8090d5bb7b0f094f9e75614c67ce9db7b3f2a4b7fe3404205ab5246d75fd9a1827d94394c6979ee847fcc423030c3d05a0c0d7caebd526c80481b71fc912221d6949d3554e5c2b5f1bd8ad4dfb6c91807bacc14fe483f416ffb197bd64c728378e47889f86bb10340416cb60579c97790c990379cb1db66a86a940da42a0bb0f4ec2a6dc697eba1eb5aab69cdf0cd83c5a42b71c9683651416a2a4dc9d3c798d7236544dacda6b95faacc61ccb3c0c377b29c2670674f51672abc46dfc222324ec14aa9ee72324ab2d61293856b940186fc7f8af38ce3f4580d37bc1d912e833110a2a28d69e0ce4a06a0aa7b79746433ea1d1d177da4725d1c30b52fa9498a64012bf1dff4b56172f7d0db2325449573dcbd7b1d937171fd216101dcbcede2de2b40554d8acbfb0e97116929f8df1758651
3	1	\\x010000012430820120022031325b1a2c6ff3893342b70c4116d26a7a76b6671bf659254357183ec4c13697022011cc995852431243a0d58c05c270c5141430d5a76881fe2ae4f1a881a4d6ffa604209a88ad2605cbac384a309924260b28db72ecfacb18c95c59d9f906527a8acccb0481b7f0d72b481deb79df0403b254187fbf183d04b2e12450d8617936aad2bb29465b86d577ba14531344aa070441ce866370c360abcfe0c9a3c626475b43183411d29d3846a40026f2e95895d6d7510f4a0e1aa2c0e43ac770370b12e5d2084cdb6a3e69314cb14e455cfa1a6e5069f2b3e50afa01b76c236b19ff0d955749dfd33e174de74e1aaf43f3a56f2bed563c7fe2edc75aae5b20fb348a00230d89454448efc34ef231de531d4b7689a883450a335a5f31bdbb1132a676798bf4d8fad4810ed9134ea3763351fdafb56ab3b3bc414ac2d14c67ac5ab02a65d9fa91262336cee67324e6364a1adf83f4eddce67187ca76d59a9b0ce7
6	0	\\x010000013630820132022100df5562494b9600d8c6b5fc9982d94c8a13ff3989903c79088997054c4d369a24022100db3c44c33a77b7db2924680abbe363731aaf8eed91170a755931f02280fc0ce50420d8dfca25a8a824d370f38089186cb12afd3e533101da93d6cc86e2e90568ccbb0481c76fd88f153b51f9205e65c67601c39c230ef82f59b3f83124c2140715ebf52d424ae3c9bdfdcac3829f81653d4a9b2d4e0ae0b117a7e79c966431c99c6960d608f31403b875a5f21c40074b56bcd52135b8c0b47c1dce1f2c541a075d12ef0b862c7fcabc3cb2fa251e31da82656acd84ca2b68f787770abbd2daed1d954aaa7ba7d28b5f0f43a444dfc88a6c97b6d130e83b88d1b13961319ae943469554fdd7054450cd41fdaf818151f011fe5e0c2e265c9cf0617af790b14d51bbc0f4616aa7fb5b1ceb2dce8059b52a38ca0b9a3bb1d49b1dc684a611b4b63dcd4700454b2f77f6869d6f3c5b6df080f677de4d89b391893030dca50bf020461478b266cc898dafbe3cb8ff
7	1	\\x0100000125308201210220629a38a2293e8980a75970b382f499400e078afe3ed1b1937ee694abcdbdb6530221009c9dc84b04cf137e1fbe68aeb18383804ea8757ff9c342b309f562855a7f0d240420b9793ba958a65d182dcf7024100c400573311d154c78fdfae0e981012623f98c0481b7c867ed4fcdb96657446afb8aed2f2d56c510ca0186184be6db01a7655edbfeb0a1357205c81cea10091d29ba0bed48df5a9200b1dbfcd9420f73db87fe27d123c914b28fcb36c2189ecd81c676ef387124d30449c1e7792c7e5aa5981cf96807992440bcadb88b18bd93c0c8eea5694042fb46672d9f776f8e2066ecbdb7f3276025a602c2c5d66affc65b369f1afcc3f32c41c12c992496fcf8586c5bdf4221b437a7c3d40fcea6abc492c96e92d868a9d7b9f0dec51d89a4df497231217985736ca318470e2e4831a96c4f52fc4da0799181a2f22781ce7457a6b249a6fa4b85491ff646a4212bc0d50788b305ba92405081d3f61e4f
13	1	\\x01000001243082012002201ec876bdab4be81c4b7f3c52a06382eec468980cbf88695bc1d6e2506631750c0220187983dc48205b3c3d923d82e34ed145503d8a58b2f8bc17f95ec2035622d4d50420d4414328be17567367a1303e41a005c0050a43aa0622f28573c5086af869fc310481b79e40427e2890120ee70a1d2b1f2d16e9043cbcf59c70b7aa6afda3fc65b6859526dd100953358f9fadd421cfaf6a7125eaf0a3e57a2a73915f2cfdaa947dae59a3b1e0a137f289916ec6537c6524de1024a911c31680463f9f958f83d2335ca414d82f32f0a6e00a7eaaea2ac132a1d51cfc06c42a5365b679e508d07996f0de8c861001d3ff12a239ea061c108d5f3f27aecaed17e428f914596efc57db4a4fcf6c2bfc8701bd6289eb42f55b947db202441bc858003e7de5d8620741e20236034acd7893cd2f4b750905b5bf28e14d6b5e79b1f96166f745685f84bddcfc8f06a91b73c88c42d6678f409f3770ffc6a5bbf28b3f3f91
14	0	\\x010000013530820131022100d0871587a982a72bac6a5d4dc11af04a1909a6eaef1453e7f3a293fbcd229b1e0220414381aaa87e6451a4f939c7e1d26280071e8adb5b33a63800f88cb93ade0b9e042011fdeaf308a8947b68db248adfaa11a32c1aa12fdbac0b08a036831a6ad897a30481c7d74214526be8642a761f116be6ef2828e63f68e6dba091f1756d7cdb483839b6cf1da2662cac62237e69b409587e91ee5ad249566bf6b92fbc0418b030f6ca26b0ca271c4fcfce1d60a98a6bfad84cbfd9433d840a63497f59759cbef28c3bbf41f782c038ad6c38f8300db00a53e99fe22ce00719e5e529277e8f29e841e4b9ca7accb1870d8884a05a29f520722da05f522f4230889f9dd791b308c62c8ebeadd9b0cdd419d8607d185b6ea240825587616b87a1d6769e7e2307a2531b76d1d91567d5013b8899c81bb7655f7c764df296869b8786bc956d4005062ee90a7198c7a75fe4e9c8a1fe73decaafc6d9be831fea93debff4ab06c4c1a661b02d61826af3f657fb7e
19	1	\\x010000012630820122022100ec49eb0ea7f25f20640efa81d6d52b2b1dce3e07021364ec333da53c0c7ed83f022100a81e33be4dd82ca9b41c8005a55f4e7d097f9b89471da50b2d932c9ab5cda0ed0420060591adf244fb8ebc399eb174056553173650c855317735a2c65aa45f908baa0481b7557ae14fc8bc193b1f634667d06841157839c114b2bba4e0a8b08308fa717c4885b817eed00dd760ce90f45a1dd489d7ce0539699e6c4a14cc1025aeec50aa76e9a4b28cdf4569bf6043191b36b2d02783d57daaa4200a3008cbbcbd181ac523216a627fe6c3a2afdaf81d1435e043e58a9127a23dbf24a8fb1ba6280165c4b066a0eea28342b87f8317867ab5a44042a3d6c43e7bfbadbf70efd27c68e67523dcf24aec13e2d16800bf77158e3c10cfcb0e7dc7f185154464ceafaa852c4041a6a3cec0b4c29681b189faddc230eb8e6fcca53322c0689e78a6ac3c885d30ba7519eae587f64c69fe0d77f2bd4a24ec0721f410f14ea3
\.


--
-- Data for Name: epoch_deltas; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.epoch_deltas (stream, epoch, records, first_at, last_at) FROM stdin;
1	1	1	1767600075737470638	1767600075737470638
2	1	1	1767600075737470638	1767600075737470638
2	1	1	1767600075779262522	1767600075779262522
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
1	\\x6fa1d38313c3c60b025e663d9df95851	0
2	\\x55ed95a40ea2df06f611b229b9babe1c	0
\.


--
-- Data for Name: filter_ids; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.filter_ids (key, id) FROM stdin;
1	\\x1b590ecbb6717680
2	\\xf154c607bb3fe6fc
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
-- Data for Name: leaves; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.leaves (record, batch, leaf) FROM stdin;
1	1	0
2	1	1
3	1	2
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
profile accounts		[{"keeper":["0xAf6FE6B864E1bd6Cc27396a069DccEa44a67C4c4"]}]
admitted		[[{"owner":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","since":"2026-01-05T08:01:04.752007834Z","by":"keeper"}]]
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
1	\\x01cf593a4f8ec76030d8560bdeeea1ce	\\x30d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6
\.


--
-- Data for Name: records; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.records (n, digest, topic, stream, seq, epoch, signature, bytes, captured_at, acknowledged_at, simulated, state, tx, block, block_hash, deleted_at) FROM stdin;
1	\\x8911f404dad06ebceed774d2255fae20fcd9afced97a65c196832d19a4f5b1b1	1	1	1	1	\\x807f9f12e5c95bd7c075a1099da58e9a791c1be37513779fac5199a52639a88404e1a60573734b6d6f5ec63c7f98669febcc2a1d7ccb9f1ea74c3fffe5b88226	329	1767600075737470638	1767600075766239795	0	6	\N	\N	\N	\N
2	\\x38180163982ba6be3c2710863e05f69df5c6d93409bd1e4eee955c19624a7589	1	2	2	1	\\x0efbbeb3afff83c7048e45ad6eb0e14a90a4388c4d51a4711f3a1a039e09c57674e902fe0988635e6afcbf87c99c0e6a5ddcba4492e3ea00be2522fdc9b5c87b	166	1767600075737470638	1767600075766239795	0	6	\N	\N	\N	\N
3	\\x1f84e2935e5fa3a3ef18f9f657da1968c55314a63f76100a0729fc472f393223	1	2	3	1	\\xba77e440138dec53df73be31c946f979d0e1ae5a7dae70df2c41ac6766561ecbbde94cf603191aadf26a26388cf3975039f26552b661c23f63747fcea6180bb7	166	1767600075779262522	1767600075901519585	0	6	\N	\N	\N	\N
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
1	0	5	\N	\N	\N	\N	{"transaction":"0xc4e114029faf178c83869414253f8341254de8f8f37c6188a6cd8ac185ce3cda","proven":false,"event":{"AdministratorChanged":{"previous":"0x0000000000000000000000000000000000000000","administrator":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6"}}}	\N	\N	\N
1	1	5	\N	\N	\N	\N	{"transaction":"0xc4e114029faf178c83869414253f8341254de8f8f37c6188a6cd8ac185ce3cda","proven":false,"event":{"OpenChanged":{"open":true}}}	\N	\N	\N
1	2	5	\N	\N	\N	\N	{"transaction":"0xc4e114029faf178c83869414253f8341254de8f8f37c6188a6cd8ac185ce3cda","proven":false,"event":{"DelayFixed":{"seconds":604800}}}	\N	\N	\N
2	0	5	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	\N	1	\\x10d721f65214908e067159b7297d87450d1c1c945ee950593bf2f1244109096c	{"transaction":"0xc86a97c3d307285f51781b9549052a6d95de223a622931705b8439180762b564","proven":true,"event":{"Registered":{"owner":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","identity":{"token":"10d721f65214908e067159b7297d87450d1c1c945ee950593bf2f1244109096c","signing":"e151e4972e5d63de6c8efd79c9223eb5027f784ad0ad13e6203e3478f981c37202aff24cc86c2e893d929767123165a8a380537c1aa162cfd3992abefc2aab87","envelope":"2e2d999500b18d06b9d60bad371f670f0286263216fdcef3b9e7753eeddb517844ccb3e5051cae3d5015f709d0fe73bbbe40b2b054f927f89b1c986ce603cc83","proof":"faca21c3ae4740ac1b17674c520e19e4de97c4e7a86a0c32a78a48ab2367c90e58391219f64f5ff3bff07dc4858ec452e4ddac4488e2f0fd2d033430439495a3"},"epoch":1}}}	\N	\N	\N
2	1	6	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	\N	1	\N	{"transaction":"0xc86a97c3d307285f51781b9549052a6d95de223a622931705b8439180762b564","proven":false,"event":{"Wrapped":{"owner":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","grantee":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","epoch":1,"envelope":[]}}}	2	\N	\N
3	0	5	\\x0bf83f50680034b35495f96d71fa11c044eb408a	\N	1	\\xd162f9fe2d7b4a55df464c814c5fe13872c7d3c6c52f58a950aa3c82b556d4c8	{"transaction":"0x16baede2c8a42e22f82c884fffd6616e1963218a08b20bb8aa227f56b4060466","proven":true,"event":{"Registered":{"owner":"0x0BF83f50680034b35495F96D71fa11c044EB408a","identity":{"token":"d162f9fe2d7b4a55df464c814c5fe13872c7d3c6c52f58a950aa3c82b556d4c8","signing":"af24f9a71f9e0c714dc591673bd97e7d9adc6d12cca1447818aff8f057292d03ccca2701785880106e35988da7dceebc4885c5db55fe6128b55b347278756acf","envelope":"e0fe9ca19c71270a65aeec30272010871337a25b1064d12867f5576eddbc8c076d762a42dde62732e1cb42acd53d299de5287c1d02c0011a91deba60db6d1765","proof":"1919832e4d7ecc8062f2f95f08772878a31c3ab25eaa74df333ea5b57b10d007f3355e33f00eb2d81521a8ebe78807ee47f92b7d40382470ca5576bca5bdd8e2"},"epoch":1}}}	\N	\N	\N
3	1	6	\\x0bf83f50680034b35495f96d71fa11c044eb408a	\N	1	\N	{"transaction":"0x16baede2c8a42e22f82c884fffd6616e1963218a08b20bb8aa227f56b4060466","proven":false,"event":{"Wrapped":{"owner":"0x0BF83f50680034b35495F96D71fa11c044EB408a","grantee":"0x0BF83f50680034b35495F96D71fa11c044EB408a","epoch":1,"envelope":[]}}}	3	\N	\N
6	0	1	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	\\x0bf83f50680034b35495f96d71fa11c044eb408a	1	\N	{"transaction":"0xbcbd2a3a071988fa4952980980ab844319a7037c682acf4b0dc15c384ac5db23","proven":false,"event":{"Granted":{"terms":{"owner":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","grantee":"0x0BF83f50680034b35495F96D71fa11c044EB408a","epoch":1,"expiry":null,"scope":{"kind":"topics","topics":["96edce93ecb2dbd6f1d0de49dd64b8ee"]}},"envelope":[]}}}	\N	\N	\N
7	0	5	\\xcea7dd8a9883cbdf6ad5114bb01673a6fd697637	\N	1	\\xd194ecf67a1533e7782181eef98b1c5dc0e7899efaece01437c8bbd8fbb2f1ad	{"transaction":"0x39b908d08e020bb3af2acc330a7f7346dc43cda001afa8f98d8236d9b26827f6","proven":true,"event":{"Registered":{"owner":"0xCEA7DD8a9883CBDF6aD5114bb01673a6FD697637","identity":{"token":"d194ecf67a1533e7782181eef98b1c5dc0e7899efaece01437c8bbd8fbb2f1ad","signing":"c4e340966e31bd9a8f8cf12f2e381d414966dc701576cfb81346695a91a7c42700a1c13bf8d68a866e88596fdbdf5b5e3d633924cb9d1545102f83c8e8190716","envelope":"2f51b30b419bc0b5450227e026443c762cb90940b84e71401b4582cbb438428f1400d02a4c39261070034d42ff9ac0ad4b01c1f5fab5aab27bd93a92442fa064","proof":"9cc34444802826fe0bd3295a0cf26c2960b5caaf60d719bec88bc76f87e9752f902e1840c554fd72f373581a62324c3fdd0f33a300049640c793e84f76d65e8e"},"epoch":1}}}	\N	\N	\N
7	1	6	\\xcea7dd8a9883cbdf6ad5114bb01673a6fd697637	\N	1	\N	{"transaction":"0x39b908d08e020bb3af2acc330a7f7346dc43cda001afa8f98d8236d9b26827f6","proven":false,"event":{"Wrapped":{"owner":"0xCEA7DD8a9883CBDF6aD5114bb01673a6FD697637","grantee":"0xCEA7DD8a9883CBDF6aD5114bb01673a6FD697637","epoch":1,"envelope":[]}}}	7	\N	\N
8	0	5	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	\N	\N	\N	{"transaction":"0x1d6b1bf00ae77184cd28cf81f8699c05bd6ebe5b6498d8782d4e6781b7c3688b","proven":false,"event":{"Lent":{"owner":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","device":"2d9ce853a22ce75bdc3c2d9b1c0480193d6f321dbed121aaf682ac7f8f625110","until":null}}}	\N	\N	\N
13	0	5	\\xa38954cc5f6c017415044712d8f091669a54fc8c	\N	1	\\xd934c26f24eea52d6f08aeca3c8e123566cf98db13a7c866483d06ed575310cd	{"transaction":"0x46ba37cd0f937422afff3b71d357da21f0db363f90c402dc32d353082821bb86","proven":true,"event":{"Registered":{"owner":"0xA38954cc5F6c017415044712D8f091669A54Fc8C","identity":{"token":"d934c26f24eea52d6f08aeca3c8e123566cf98db13a7c866483d06ed575310cd","signing":"b7d1a378feb80d7c2d4966c2e12266e9dc7c5c9aa52e8f7890487613535380327c6d4dfc119891f0ca26c5e90d7a4986ee94207d59660057f868cd880bd3dfb5","envelope":"7ed8a8a3c663d8f66803a6d3a82b8bde488187e344a252666b3ec5348b5e918dbe1dedbaa3cc4bf99ddefe90e080ef0bb5d969ea3a3060cb436ce164e735d10d","proof":"bf4999c75f9f5fd51fb5fb41639671329ed010721df162b59dc53d406cd1bf2d36195ccbcfbe4d5ac4a781b3a267b42131cc50aab63199ab4001548696fa0cb4"},"epoch":1}}}	\N	\N	\N
13	1	6	\\xa38954cc5f6c017415044712d8f091669a54fc8c	\N	1	\N	{"transaction":"0x46ba37cd0f937422afff3b71d357da21f0db363f90c402dc32d353082821bb86","proven":false,"event":{"Wrapped":{"owner":"0xA38954cc5F6c017415044712D8f091669A54Fc8C","grantee":"0xA38954cc5F6c017415044712D8f091669A54Fc8C","epoch":1,"envelope":[]}}}	13	\N	\N
14	0	1	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	\\xa38954cc5f6c017415044712d8f091669a54fc8c	1	\N	{"transaction":"0xad93bc0cc0c58bc19fc0838d033f94dc935bcd31d791bd50a443387f5973a761","proven":false,"event":{"Granted":{"terms":{"owner":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","grantee":"0xA38954cc5F6c017415044712D8f091669A54Fc8C","epoch":1,"expiry":null,"scope":{"kind":"topics","topics":["96edce93ecb2dbd6f1d0de49dd64b8ee"]}},"envelope":[]}}}	\N	\N	\N
19	0	5	\\xaf6fe6b864e1bd6cc27396a069dccea44a67c4c4	\N	1	\\xd3df3b56958afbd9ff4f710617e5fc3111726c16c81ce059f84243fe94c97921	{"transaction":"0xf2787b843737c22bdd36257d3e0672e52a22a9197b8ac749f2173fa14744049f","proven":true,"event":{"Registered":{"owner":"0xAf6FE6B864E1bd6Cc27396a069DccEa44a67C4c4","identity":{"token":"d3df3b56958afbd9ff4f710617e5fc3111726c16c81ce059f84243fe94c97921","signing":"995bebbe56b32945de2b38246929be6f620b65e6db1f28cb28bd3328f3b6d5db4d558cc830d8f472e0e0caec88a776b59de2a58ae3ea9620114865ce14a32a0d","envelope":"45bc32f376087a1e8b48d57a5132bea8492be8aa4f84fd3ded35cf7fc9fbd7193ccdbe744ea6b0287ba65713c4a2bbcddcf4313ca47a6d367896d5195d9f6671","proof":"87e7ed1a24800d3820fb1aa635629473a0d77b06b32e579749848a1e4d8c6bd1232b142fc94cbc4653fabab11a65d777b5ebc0b9aa2f7103f38b5f5aca9dd880"},"epoch":1}}}	\N	\N	\N
19	1	6	\\xaf6fe6b864e1bd6cc27396a069dccea44a67c4c4	\N	1	\N	{"transaction":"0xf2787b843737c22bdd36257d3e0672e52a22a9197b8ac749f2173fa14744049f","proven":false,"event":{"Wrapped":{"owner":"0xAf6FE6B864E1bd6Cc27396a069DccEa44a67C4c4","grantee":"0xAf6FE6B864E1bd6Cc27396a069DccEa44a67C4c4","epoch":1,"envelope":[]}}}	19	\N	\N
20	0	5	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	\N	\N	\N	{"transaction":"0xfd64b7d124c7d7eb2ec672377ceee02962c337b5e91ba4f807767b4a07082ba5","proven":false,"event":{"Lent":{"owner":"0xB20d8f6A91B503B0dB2CC47C50419CCe056651f6","device":"30d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6","until":null}}}	\N	\N	\N
\.


--
-- Data for Name: signers; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.signers (id, key) FROM stdin;
\\x30d8560bdeeea1ce1f2b66727a3b038c2cc8486a54ec5ac098eab0fcf9ff83e6	\\x1d1caa0fc3cf6c92391f1b02851d9b2e67bdcb822cbc4f516c09cf32b700abfbb2d1ecb31a823c9adf0e70c642d871cd3b978eaea0685e8c73ba0b53df62b381
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
1	1	2	1b590ecbb6717680
2	1	1	1b590ecbb6717680
\.


--
-- Data for Name: topics; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.topics (key, owner, recorder, topic_id, name, keeper) FROM stdin;
1	\\xb20d8f6a91b503b0db2cc47c50419cce056651f6	1	\\x96edce93ecb2dbd6f1d0de49dd64b8ee		\\xaf6fe6b864e1bd6cc27396a069dccea44a67c4c4
\.


--
-- Data for Name: trail; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.trail (block, hash) FROM stdin;
1	\\xe78f198e985f038c1cc4a777b801cf602987936d05b7b1bbf58578c54ce901be
2	\\xa432a4e1db87aec91c655c4db8c5efdde44378a8352d29fe2114bc17cb513db2
3	\\xcf4f05a6ae7439238a964ab4b9daa8b9d3ff60c23242d6a1995bca2f602e037d
4	\\x95d6bb3d618b28704fbdef15bacdb7028de6918b379443fd35900e6001beb510
5	\\x2ff1f20b24232dcd1f162e11b7c01bf43cbf6ca5cb5173a151704654a3d85ea4
6	\\xa549c6abe45cbe546cdaf9bd2a60868bbf29cfc669a863768928bc7602ef706b
7	\\x24e9d3dfcf2e3c7236de8fa1912d4e9f7f8c50d5bdd69f72b6429fcd68383e71
8	\\x40e8e176cc6e2e40b0f33984d3aadd5917d4313331717b7c96230999904f58c1
9	\\xae4bfa551b4f943e908164c5eb55ec4b2740d2139b7cda3cd24e72ca9efffaf6
10	\\xc3a5b8014b3794688629e0f227c662a82f73d158b9a9368ee39111748eb5fcfe
11	\\x75cc65d0f107632cfed4140bd49175cb3e4758fcc9de74d247146f1328035fa2
12	\\x54a36e2a01d821b156d6894386b23cf3adb2f96ba64b8b5308b892a37cb390a9
13	\\xfd47a240c9f1a46598293b5612dd94e39c95083ab97b0ce7a578a7281a5ebe73
14	\\x549abeb449ede246c69f0ec7ffda57794e5a75bc24b60e5850ccb56131a64dc6
15	\\xbd5cdfbbe096957c3d39e27f2056e4b34aaede52502cea41a93fcfc9b3b1d57e
16	\\xb70b3533dc9798e6dba33be78460d2d1d58464ef4631a049d7c5f45f71e6acc6
17	\\xd5fbd3d66ff300796e6a747db5bebf4985f98c4952dcea47832ed43731f247eb
18	\\x13776e21797e773333d8867d8dd7ad3d5a1185d3f047b3cd7b030005b62a484b
19	\\x5a27d78341b2c1f74c297533f945ffb8f799ce2b04b5ec43f33a4d56cdf14ec9
20	\\xc54e3e25630f1e5108d7d5c37e866e62895bd68850176f8a476fd42aeb861869
21	\\x7952b17dd6ea0818784e9316467b4900be0967570c1e29a56cfd1badfac5e762
22	\\xe656fe87121e51f8b67e39f8cdbf8a35348acb567c44cbae342b69fd25cefe8c
\.


--
-- Data for Name: transactions; Type: TABLE DATA; Schema: public; Owner: -
--

COPY public.transactions (key, hash, account, nonce, raw, purpose, digests, signed_at, state, block, block_hash, gas_used, reason, replaced_by, batch) FROM stdin;
1	\\xf2787b843737c22bdd36257d3e0672e52a22a9197b8ac749f2173fa14744049f	\\xaf6fe6b864e1bd6cc27396a069dccea44a67c4c4	0	\\xf9034c80808307918094817f693f42c3706c35b74bbe51be2ca73283cacc80b902e4a3747fef0000000000000000000000000000000000000000000000000000000000000040000000000000000000000000000000000000000000000000000000000000014000000000000000000000000000000000000000000000000000000000000000e0d3df3b56958afbd9ff4f710617e5fc3111726c16c81ce059f84243fe94c97921995bebbe56b32945de2b38246929be6f620b65e6db1f28cb28bd3328f3b6d5db4d558cc830d8f472e0e0caec88a776b59de2a58ae3ea9620114865ce14a32a0d45bc32f376087a1e8b48d57a5132bea8492be8aa4f84fd3ded35cf7fc9fbd7193ccdbe744ea6b0287ba65713c4a2bbcddcf4313ca47a6d367896d5195d9f667187e7ed1a24800d3820fb1aa635629473a0d77b06b32e579749848a1e4d8c6bd1232b142fc94cbc4653fabab11a65d777b5ebc0b9aa2f7103f38b5f5aca9dd880000000000000000000000000000000000000000000000000000000000000016b010000012630820122022100ec49eb0ea7f25f20640efa81d6d52b2b1dce3e07021364ec333da53c0c7ed83f022100a81e33be4dd82ca9b41c8005a55f4e7d097f9b89471da50b2d932c9ab5cda0ed0420060591adf244fb8ebc399eb174056553173650c855317735a2c65aa45f908baa0481b7557ae14fc8bc193b1f634667d06841157839c114b2bba4e0a8b08308fa717c4885b817eed00dd760ce90f45a1dd489d7ce0539699e6c4a14cc1025aeec50aa76e9a4b28cdf4569bf6043191b36b2d02783d57daaa4200a3008cbbcbd181ac523216a627fe6c3a2afdaf81d1435e043e58a9127a23dbf24a8fb1ba6280165c4b066a0eea28342b87f8317867ab5a44042a3d6c43e7bfbadbf70efd27c68e67523dcf24aec13e2d16800bf77158e3c10cfcb0e7dc7f185154464ceafaa852c4041a6a3cec0b4c29681b189faddc230eb8e6fcca53322c0689e78a6ac3c885d30ba7519eae587f64c69fe0d77f2bd4a24ec0721f410f14ea300000000000000000000000000000000000000000086e5beb99d7daca0c6a3b8944cb01e5c475f3bc246e273ae93dd918bc2aab197973f1daa84e19297a06d95198779aac6d1df0cfe8a94d02ef02869230785b3dde5e7dd4fa12fcc8ae2	register	\\x	1767600064234428642	1	19	\\x5a27d78341b2c1f74c297533f945ffb8f799ce2b04b5ec43f33a4d56cdf14ec9	333299	\N	\N	\N
2	\\xe1649e89ab7635d1ce871d759858a7ff00ed74270a471a5e0be9874aa1cae713	\\xaf6fe6b864e1bd6cc27396a069dccea44a67c4c4	1	\\xf8cb01808301472694817f693f42c3706c35b74bbe51be2ca73283cacc80b86470c127c6e0b50bae1a1f8bf49bfa2c357f99878d9d5fbc5542a7620802e85fd8bb10c2ec0000000000000000000000000000000000000000000000000000000000000003000000000000000000000000000000000000000000000000000000000000000086e5beb99d7daba0d69a2ac7684a30a9a2013b1ac2ec3a668da5c5e5b06c872c26c9a612af390673a04b7fd974094b38dd3cef79c2d800ecd9d9ca1f99fa49786b16a546423fe8ec38	anchor	\\x	1767600076122466523	1	22	\\xe656fe87121e51f8b67e39f8cdbf8a35348acb567c44cbae342b69fd25cefe8c	56468	\N	\N	\\xe0b50bae1a1f8bf49bfa2c357f99878d9d5fbc5542a7620802e85fd8bb10c2ec
\.


--
-- Name: batches_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.batches_key_seq', 1, true);


--
-- Name: chain_nodes_key_seq; Type: SEQUENCE SET; Schema: public; Owner: -
--

SELECT pg_catalog.setval('public.chain_nodes_key_seq', 13, true);


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

SELECT pg_catalog.setval('public.transactions_key_seq', 2, true);


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


