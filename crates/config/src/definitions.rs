//! Every setting by name, variable, default and meaning.

#[derive(Debug)]
pub struct Definition {
    pub name: &'static str,
    pub variable: &'static str,
    /// Empty = embedded, or chosen by the program.
    pub default: &'static str,
    /// One line for people.
    pub text: &'static str,
}

/// One row each: name, variable, default, and under them the line for people.
macro_rules! definitions {
    ($($name:literal, $variable:literal, $default:literal: $text:literal;)*) => {
        &[$(Definition { name: $name, variable: $variable, default: $default, text: $text }),*]
    };
}

/// Every setting, in the order shown.
pub const DEFINITIONS: &[Definition] = definitions! {
    "ros.master", "ROS_MASTER_URI", "":
        "URI of a real ROS master; empty = embedded master";
    "ros.host", "ROS_HOSTNAME", "":
        "name or address at which other ROS nodes reach this machine; ROS_IP is honoured too";
    "ros.meter", "AUTHROS_METER", "auto":
        "which topic rates to measure: all, watched, or auto (all on the embedded master)";
    "ros.pins", "AUTHROS_PINS", "first":
        "accepted publishers of a captured topic: first = pin the first ones seen, list = only those listed, off = \
         anybody";
    "ros.publishers", "AUTHROS_PUBLISHERS", "":
        "pinned publishers: TOPIC=CALLER_ID@HOST:TYPE:MD5, separated by commas";
    "ros.definitions", "AMENT_PREFIX_PATH", "":
        "where ROS 2 is installed, separated by colons; supplies message definitions that a recording does not \
         include";
    "ros.domain", "ROS_DOMAIN_ID", "":
        "ROS 2 domain to capture from, 0 to 232, in addition to ROS 1; empty = no ROS 2";
    "ros.ros2_program", "AUTHROS_ROS2_PROGRAM", "":
        "path of authros-ros2, the program that reads ROS 2; empty = next to this program";
    "ros.publisher", "AUTHROS_PUBLISHER", "own":
        "publisher of shared records in a ROS 1 graph: own (built in), or rosrust, in a process without keys";
    "ros.robots_by", "AUTHROS_ROBOTS_BY", "own":
        "what the simulated robots are: own nodes of this process, or rosrust, each a process without keys";
    "ros.rosrust_program", "AUTHROS_ROSRUST_PROGRAM", "":
        "path of authros-rosrust, the program in which rosrust runs; empty = next to this program";
    "robots", "AUTHROS_ROBOTS", "4":
        "simulated robots on the embedded master, 0 to 32; none by default if ros.domain is set";
    "chain.url", "AUTHROS_CHAIN", "":
        "node to use: http://, https://, ws://, wss:// or ipc path; empty = embedded chain";
    "chain.roots", "AUTHROS_CHAIN_ROOTS", "":
        "PEM file with the certificate authorities to accept for https:// and wss://; empty = those of this machine";
    "chain.contract", "AUTHROS_CONTRACT", "":
        "address of the AuthROS contract; empty = deploy one at the first registration";
    "chain.max_fee", "AUTHROS_MAX_FEE", "1000":
        "highest gas price in gwei that a transaction may offer, replacements included; empty = no cap";
    "chain.min_price", "AUTHROS_MIN_PRICE", "0":
        "lowest gas price in gwei that a transaction offers, whatever the node quotes; at most chain.max_fee";
    "chain.consensus", "AUTHROS_CONSENSUS", "":
        "embedded chain: poa[:SIGNERS:PERIOD_MS] or pow[:DIFFICULTY]; empty = as created, poa for a new chain";
    "capture.memory", "AUTHROS_CAPTURE_MEMORY", "256MiB":
        "memory for captured messages waiting to be stored, all topics together; messages that do not fit are dropped \
         and counted";
    "store.url", "AUTHROS_STORE", "":
        "PostgreSQL database of a gateway's home: postgres://user:password@host/database, with commas between several \
         hosts; without a password there, PGPASSWORD or the file PGPASSFILE has it; empty = a file in the home";
    "store.roots", "AUTHROS_STORE_ROOTS", "":
        "PEM file with the certificate authorities to accept for that database; empty = those of this machine";
    "store.standbys", "AUTHROS_STORE_STANDBYS", "0":
        "how many standbys must have what is acknowledged; status and doctor report a failure if that database waits for \
         fewer";
    "cache.url", "AUTHROS_CACHE", "":
        "Redis as a cache in front of the store: redis://host:port, redis+unix:///path, \
         redis+cluster://host:port,host:port or redis+sentinel://host:port,host:port/master, with rediss for TLS; empty \
         = none";
    "cache.roots", "AUTHROS_CACHE_ROOTS", "":
        "PEM file with the certificate authorities to accept for rediss; empty = those of this machine";
    "outbox.keep", "AUTHROS_OUTBOX_KEEP", "7d":
        "how long a robot keeps ciphertext after its gateway has proven and signed that it is verified: always, or a \
         time such as 0s, 12h, 30d; deleted earlier, oldest first, if less than one and a half times disk.reserve is \
         free";
    "ring.keep", "AUTHROS_RING_KEEP", "":
        "how much unwatched data a robot keeps, sealed on its own disk, until its owner requests it: TIME, SIZE, such \
         as \"5m, 500MiB\"; empty = no ring";
    "ring.topics", "AUTHROS_RING_TOPICS", "":
        "topics of a robot's ring: [\"/camera/**\", \"/imu\"], or with commas between; those its enrolment covers and \
         --topic does not name";
    "retention", "AUTHROS_RETENTION", "":
        "how long ciphertext is kept, by topic: PATTERN=TIME, =SIZE, =TIME+SIZE or =ever, separated by commas; the \
         first match applies; * matches anything but /, ** anything; empty = keep everything; the time in a [[topic]] \
         rule takes precedence; digest and proof are kept forever";
    "disk.reserve", "AUTHROS_DISK_RESERVE", "64MiB":
        "disk space to leave free; below it no further record is acknowledged, so that existing ones can still be \
         processed";
    "record.compression", "AUTHROS_COMPRESSION", "auto":
        "auto = compress messages before sealing if it pays; off = seal them as they are";
    "crypto.provider", "AUTHROS_CRYPTO_PROVIDER", "authros":
        "authros (its own kernels), rustcrypto or libsm";
    "crypto.sm4_kernel", "AUTHROS_SM4_KERNEL", "":
        "gfni-avx512, gfni-avx2, aesni-avx2 or portable; empty = the fastest this processor supports";
    "anchor.mode", "AUTHROS_ANCHOR_MODE", "batch":
        "batch = Merkle roots, about one transaction a second; each = one dataUpload per record";
    "anchor.lanes", "AUTHROS_ANCHOR_LANES", "1":
        "accounts that anchor in parallel, including the owner's, 1 to 8";
    "audit.anchor_every", "AUTHROS_AUDIT_ANCHOR_EVERY", "60":
        "seconds after which the head of a changed audit log or topic is anchored, 1 to 86400";
    "audit.scrub", "AUTHROS_AUDIT_SCRUB", "1":
        "percentage of stored records that a running site re-hashes per hour; 0 = none, above 100 = more than once";
    "time.authorities", "AUTHROS_TIME_AUTHORITIES", "":
        "time stamp authorities (RFC 3161) that stamp the batches of each hour: [{ name = \"NAME\", url = \
         \"http://HOST/PATH\", certificate = \"/PATH/OF.pem\" }]; empty = none";
    "operators.socket", "AUTHROS_OPERATORS_SOCKET", "":
        "where a running site serves operators, who are Unix users of this machine: the path of a socket outside the \
         home, in a folder that only you or root can write; empty = nowhere";
    "operators.rights", "AUTHROS_OPERATORS_RIGHTS", "":
        "what each operator may do: { USER = [\"look\", \"grant\"], \"@GROUP\" = [\"capture\"] }; rights of a user \
         and of groups add up";
    "metrics.listen", "AUTHROS_METRICS_LISTEN", "":
        "where Prometheus scrapes a running site: HOST:PORT of this machine, or the path of a socket; empty = off";
    "metrics.open", "AUTHROS_METRICS_OPEN", "no":
        "yes = metrics.listen may be an address that other machines can reach; anyone who reaches it can read the \
         metrics";
    "metrics.topics", "AUTHROS_METRICS_TOPICS", "no":
        "yes = also export metrics per topic, by name, for up to 200 topics";
    "alerts.webhook", "AUTHROS_ALERTS_WEBHOOK", "":
        "where to send alerts: http:// or https://HOST:PORT/PATH; if this and alerts.command are empty, alerts are \
         only shown";
    "alerts.form", "AUTHROS_ALERTS_FORM", "authros":
        "format for the webhook: authros (signed JSON) or alertmanager (its API, version 2)";
    "alerts.secret", "AUTHROS_ALERTS_SECRET", "":
        "file (0600) with the secret that signs webhook requests (HMAC-SHA256); empty = unsigned";
    "alerts.roots", "AUTHROS_ALERTS_ROOTS", "":
        "PEM file with the certificate authorities to accept for an https webhook; empty = those of this machine";
    "alerts.command", "AUTHROS_ALERTS_COMMAND", "":
        "program to run for each alert instead of a webhook: [\"PROGRAM\", \"ARGUMENT\"], run without a shell, JSON \
         on its stdin; config.toml, the program and their parent directories must not be writable by others";
    "alerts.every", "AUTHROS_ALERTS_EVERY", "10":
        "seconds between checks, 1 to 3600";
    "alerts.robot_silent", "AUTHROS_ALERTS_ROBOT_SILENT", "10m":
        "alert if a robot has sent nothing for this long, for a day at most; never = no such alert";
    "alerts.unanchored", "AUTHROS_ALERTS_UNANCHORED", "10m":
        "alert if a record has not been in a block for this long; never = no such alert";
    "alerts.disk", "AUTHROS_ALERTS_DISK", "1GiB":
        "alert if the home's disk has less free space than this; 0 = no such alert";
    "alerts.clock", "AUTHROS_ALERTS_CLOCK", "5s":
        "alert if this machine's clock differs by more than this from the time used for grants and device \
         authorisations; never = no such alert";
    "alerts.grant_ends", "AUTHROS_ALERTS_GRANT_ENDS", "3d":
        "alert if a grant, given or received from a contact, ends within this time; never = no such alert";
    "alerts.audit", "AUTHROS_ALERTS_AUDIT", "15m":
        "alert if a line of the audit log has not been covered by an anchored head for this long; never = no such \
         alert";
    "confirmations", "AUTHROS_CONFIRMATIONS", "1":
        "blocks until an anchor counts as confirmed, including its own, 1 to 1000";
    "gateway.admission", "AUTHROS_GATEWAY_ADMISSION", "closed":
        "who may use this home's gateway: closed = its own profiles and allowed owners; open = anyone, within quotas";
    "gateway.addresses", "AUTHROS_GATEWAY_ADDRESSES", "":
        "addresses at which robots and owners reach this home's gateway, HOST:PORT separated by commas: those of all its \
         workers, a DNS name or a load balancer; empty = the one it listens at";
    "gateway.quota_bytes", "AUTHROS_GATEWAY_QUOTA_BYTES", "10GiB":
        "bytes of records that an owner who is not on the allow list may send to an open gateway";
    "gateway.quota_names", "AUTHROS_GATEWAY_QUOTA_NAMES", "16":
        "names that such an owner may register there";
    "gateway.quota_streams", "AUTHROS_GATEWAY_QUOTA_STREAMS", "1024":
        "streams that such an owner may have there; each topic, type and signer of a recorder is one stream";
    "site.address", "AUTHROS_SITE", "":
        "gateway of a remote site to join, as HOST:PORT; it supplies chain and records; further addresses of the same \
         gateway follow after commas; empty = no gateway";
    "site.gateway_key", "AUTHROS_GATEWAY_KEY", "":
        "identity key of that gateway, 64 hex characters; confirm it with its operator";
    "site.trust_first", "AUTHROS_TRUST_FIRST", "no":
        "yes = trust on first use: pin the first gateway that answers";
    "console.theme", "AUTHROS_THEME", "":
        "theme of the console: night, day, contrast, mono or one of your own; empty = chosen by the terminal's \
         colours";
    "console.ascii", "AUTHROS_ASCII", "auto":
        "ASCII characters only: yes, no, or auto (if the locale has no UTF-8)";
    "console.mouse", "AUTHROS_MOUSE", "no":
        "whether the console uses the mouse; no = leave text selection to the terminal";
    "console.bytes_per_second", "AUTHROS_BYTES_PER_SECOND", "":
        "limit in bytes per second for redraws caused by new data, key presses excluded; empty = 4000 over SSH, \
         otherwise no limit";
    "console.pictures", "AUTHROS_PICTURES", "half-blocks":
        "how pictures are shown: half-blocks, or as pixels on a terminal that supports sixel or kitty (not detected)";
    "console.lock_after", "AUTHROS_LOCK_AFTER", "15":
        "minutes without a key press before the console locks the keyring (capture continues); 0 = never";
};
