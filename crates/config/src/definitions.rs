//! Every setting by name, variable, default and meaning.

/// What a setting is.
#[derive(Debug)]
pub struct Definition {
    /// Its name in `config.toml` and in `config show`.
    pub name: &'static str,
    /// Its environment variable.
    pub variable: &'static str,
    /// Its default; empty = embedded or chosen by the program.
    pub default: &'static str,
    /// One line for people.
    pub text: &'static str,
}

/// Every setting, in the order shown.
pub const DEFINITIONS: &[Definition] = &[
    Definition {
        name: "ros.master",
        variable: "ROS_MASTER_URI",
        default: "",
        text: "URI of a real ROS master; empty = embedded master",
    },
    Definition {
        name: "ros.host",
        variable: "ROS_HOSTNAME",
        default: "",
        text: "name or address at which other ROS nodes reach this machine; ROS_IP is honoured too",
    },
    Definition {
        name: "ros.meter",
        variable: "AUTHROS_METER",
        default: "auto",
        text: "which topic rates to measure: all, watched, or auto (all on the embedded master)",
    },
    Definition {
        name: "ros.pins",
        variable: "AUTHROS_PINS",
        default: "first",
        text: "accepted publishers of a captured topic: first = pin the first ones seen, list = only those listed, off \
               = anybody",
    },
    Definition {
        name: "ros.publishers",
        variable: "AUTHROS_PUBLISHERS",
        default: "",
        text: "pinned publishers: TOPIC=CALLER_ID@HOST:TYPE:MD5, separated by commas",
    },
    Definition {
        name: "ros.definitions",
        variable: "AMENT_PREFIX_PATH",
        default: "",
        text: "where ROS 2 is installed, separated by colons; supplies message definitions that a recording does not \
               include",
    },
    Definition {
        name: "ros.domain",
        variable: "ROS_DOMAIN_ID",
        default: "",
        text: "ROS 2 domain to capture from, 0 to 232, in addition to ROS 1; empty = no ROS 2",
    },
    Definition {
        name: "ros.ros2_program",
        variable: "AUTHROS_ROS2_PROGRAM",
        default: "",
        text: "path of authros-ros2, the program that reads ROS 2; empty = next to this program",
    },
    Definition {
        name: "ros.publisher",
        variable: "AUTHROS_PUBLISHER",
        default: "own",
        text: "what publishes shared records in a ROS 1 graph: own, or rosrust, in a process without keys",
    },
    Definition {
        name: "ros.robots_by",
        variable: "AUTHROS_ROBOTS_BY",
        default: "own",
        text: "what the simulated robots are: own nodes of this process, or rosrust, each a process without keys",
    },
    Definition {
        name: "ros.rosrust_program",
        variable: "AUTHROS_ROSRUST_PROGRAM",
        default: "",
        text: "path of authros-rosrust, the program in which rosrust runs; empty = next to this program",
    },
    Definition {
        name: "robots",
        variable: "AUTHROS_ROBOTS",
        default: "4",
        text: "simulated robots on the embedded master, 0 to 32; none by default if ros.domain is set",
    },
    Definition {
        name: "chain.url",
        variable: "AUTHROS_CHAIN",
        default: "",
        text: "node to use: http://, https://, ws://, wss:// or ipc path; empty = embedded chain",
    },
    Definition {
        name: "chain.roots",
        variable: "AUTHROS_CHAIN_ROOTS",
        default: "",
        text: "PEM file with the certificate authorities to accept for https:// and wss://; empty = those of this machine",
    },
    Definition {
        name: "chain.contract",
        variable: "AUTHROS_CONTRACT",
        default: "",
        text: "address of the AuthROS contract; empty = deploy one at the first registration",
    },
    Definition {
        name: "chain.max_fee",
        variable: "AUTHROS_MAX_FEE",
        default: "1000",
        text: "highest gas price in gwei that a transaction may offer, replacements included; empty = no cap",
    },
    Definition {
        name: "chain.min_price",
        variable: "AUTHROS_MIN_PRICE",
        default: "0",
        text: "lowest gas price in gwei that a transaction offers, whatever the node quotes; at most chain.max_fee",
    },
    Definition {
        name: "chain.consensus",
        variable: "AUTHROS_CONSENSUS",
        default: "",
        text: "embedded chain: poa[:SIGNERS:PERIOD_MS] or pow[:DIFFICULTY]; empty = as created, poa for a new chain",
    },
    Definition {
        name: "capture.memory",
        variable: "AUTHROS_CAPTURE_MEMORY",
        default: "256MiB",
        text: "memory for captured messages waiting to be stored, all topics together; messages that do not fit are \
               dropped and counted",
    },
    Definition {
        name: "vault.url",
        variable: "AUTHROS_VAULT",
        default: "",
        text: "redis://host:port, redis+unix:///path, redis+cluster://host:port,host:port or \
               redis+sentinel://host:port,host:port/master; empty = embedded vault",
    },
    Definition {
        name: "vault.backlog",
        variable: "AUTHROS_VAULT_BACKLOG",
        default: "4GiB",
        text: "disk space for records waiting while Redis is unavailable",
    },
    Definition {
        name: "vault.local",
        variable: "AUTHROS_VAULT_LOCAL",
        default: "always",
        text: "how long a verified record also stays on this disk beside Redis: always, or a time such as 0s, 12h, 30d",
    },
    Definition {
        name: "outbox.keep",
        variable: "AUTHROS_OUTBOX_KEEP",
        default: "7d",
        text: "how long a robot keeps ciphertext after its gateway has proven and signed that it is verified: always, \
               or a time such as 0s, 12h, 30d; deleted earlier, oldest first, if less than one and a half times \
               disk.reserve is free",
    },
    Definition {
        name: "ring.keep",
        variable: "AUTHROS_RING_KEEP",
        default: "",
        text: "how much a robot keeps of topics that nobody watches, sealed on its own disk, until its owner asks for it: \
               TIME, SIZE, as \"5m, 500MiB\"; empty = no ring",
    },
    Definition {
        name: "ring.topics",
        variable: "AUTHROS_RING_TOPICS",
        default: "",
        text: "topics of a robot's ring: [\"/camera/**\", \"/imu\"], or with commas between; those its enrolment covers and \
               --topic does not name",
    },
    Definition {
        name: "retention",
        variable: "AUTHROS_RETENTION",
        default: "",
        text: "how long ciphertext is kept, by topic: PATTERN=TIME, =SIZE, =TIME+SIZE or =ever, separated by commas; \
               the first match applies; * matches anything but /, ** anything; empty = keep everything; the time in a \
               [[topic]] rule takes precedence; digest and proof are kept forever",
    },
    Definition {
        name: "disk.reserve",
        variable: "AUTHROS_DISK_RESERVE",
        default: "64MiB",
        text: "disk space to leave free; below it no further record is acknowledged, so that existing ones can still \
               be processed",
    },
    Definition {
        name: "record.compression",
        variable: "AUTHROS_COMPRESSION",
        default: "auto",
        text: "auto = compress messages before sealing if it pays; off = seal them as they are",
    },
    Definition {
        name: "crypto.provider",
        variable: "AUTHROS_CRYPTO_PROVIDER",
        default: "authros",
        text: "authros (its own kernels), rustcrypto or libsm",
    },
    Definition {
        name: "crypto.sm4_kernel",
        variable: "AUTHROS_SM4_KERNEL",
        default: "",
        text: "gfni-avx512, gfni-avx2, aesni-avx2 or portable; empty = the fastest this processor supports",
    },
    Definition {
        name: "anchor.mode",
        variable: "AUTHROS_ANCHOR_MODE",
        default: "batch",
        text: "batch = Merkle roots, about one transaction a second; each = one dataUpload per record",
    },
    Definition {
        name: "anchor.lanes",
        variable: "AUTHROS_ANCHOR_LANES",
        default: "1",
        text: "accounts that anchor in parallel, including the owner's, 1 to 8",
    },
    Definition {
        name: "audit.anchor_every",
        variable: "AUTHROS_AUDIT_ANCHOR_EVERY",
        default: "60",
        text: "seconds after which the head of a changed audit log or topic is anchored, 1 to 86400",
    },
    Definition {
        name: "audit.scrub",
        variable: "AUTHROS_AUDIT_SCRUB",
        default: "1",
        text: "percentage of stored records that a running site re-hashes per hour; 0 = none, above 100 = more than \
               once",
    },
    Definition {
        name: "time.authorities",
        variable: "AUTHROS_TIME_AUTHORITIES",
        default: "",
        text: "time stamp authorities (RFC 3161) that stamp the batches of each hour: [{ name = \"NAME\", url = \
               \"http://HOST/PATH\", certificate = \"/PATH/OF.pem\" }]; empty = none",
    },
    Definition {
        name: "operators.socket",
        variable: "AUTHROS_OPERATORS_SOCKET",
        default: "",
        text: "where a running site serves operators, who are Unix users of this machine: the path of a socket outside \
               the home, in a folder that only you or root can write; empty = nowhere",
    },
    Definition {
        name: "operators.rights",
        variable: "AUTHROS_OPERATORS_RIGHTS",
        default: "",
        text: "what each operator may do: { USER = [\"look\", \"grant\"], \"@GROUP\" = [\"capture\"] }; rights of a user \
               and of groups add up",
    },
    Definition {
        name: "metrics.listen",
        variable: "AUTHROS_METRICS_LISTEN",
        default: "",
        text: "where Prometheus scrapes a running site: HOST:PORT of this machine, or the path of a socket; empty = \
               off",
    },
    Definition {
        name: "metrics.open",
        variable: "AUTHROS_METRICS_OPEN",
        default: "no",
        text: "yes = metrics.listen may be an address that other machines can reach; anyone who reaches it can read \
               the metrics",
    },
    Definition {
        name: "metrics.topics",
        variable: "AUTHROS_METRICS_TOPICS",
        default: "no",
        text: "yes = also export metrics per topic, by name, for up to 200 topics",
    },
    Definition {
        name: "alerts.webhook",
        variable: "AUTHROS_ALERTS_WEBHOOK",
        default: "",
        text: "where to send alerts: http:// or https://HOST:PORT/PATH; if this and alerts.command are empty, alerts \
               are only shown",
    },
    Definition {
        name: "alerts.form",
        variable: "AUTHROS_ALERTS_FORM",
        default: "authros",
        text: "format for the webhook: authros (signed JSON) or alertmanager (its API, version 2)",
    },
    Definition {
        name: "alerts.secret",
        variable: "AUTHROS_ALERTS_SECRET",
        default: "",
        text: "file (0600) with the secret that signs webhook requests (HMAC-SHA256); empty = unsigned",
    },
    Definition {
        name: "alerts.roots",
        variable: "AUTHROS_ALERTS_ROOTS",
        default: "",
        text: "PEM file with the certificate authorities to accept for an https webhook; empty = those of this machine",
    },
    Definition {
        name: "alerts.command",
        variable: "AUTHROS_ALERTS_COMMAND",
        default: "",
        text: "program to run for each alert instead of a webhook: [\"PROGRAM\", \"ARGUMENT\"], run without a shell, \
               JSON on its stdin; config.toml, the program and their parent directories must not be writable by others",
    },
    Definition {
        name: "alerts.every",
        variable: "AUTHROS_ALERTS_EVERY",
        default: "10",
        text: "seconds between checks, 1 to 3600",
    },
    Definition {
        name: "alerts.robot_silent",
        variable: "AUTHROS_ALERTS_ROBOT_SILENT",
        default: "10m",
        text: "alert if a robot has sent nothing for this long, for a day at most; never = no such alert",
    },
    Definition {
        name: "alerts.unanchored",
        variable: "AUTHROS_ALERTS_UNANCHORED",
        default: "10m",
        text: "alert if a record has not been in a block for this long; never = no such alert",
    },
    Definition {
        name: "alerts.disk",
        variable: "AUTHROS_ALERTS_DISK",
        default: "1GiB",
        text: "alert if the home's disk has less free space than this; 0 = no such alert",
    },
    Definition {
        name: "alerts.clock",
        variable: "AUTHROS_ALERTS_CLOCK",
        default: "5s",
        text: "alert if this machine's clock differs by more than this from the time used for grants and loans; never \
               = no such alert",
    },
    Definition {
        name: "alerts.grant_ends",
        variable: "AUTHROS_ALERTS_GRANT_ENDS",
        default: "3d",
        text: "alert if a grant, given or received from a contact, ends within this time; never = no such alert",
    },
    Definition {
        name: "alerts.audit",
        variable: "AUTHROS_ALERTS_AUDIT",
        default: "15m",
        text: "alert if a line of the audit log has not been covered by an anchored head for this long; never = no \
               such alert",
    },
    Definition {
        name: "confirmations",
        variable: "AUTHROS_CONFIRMATIONS",
        default: "1",
        text: "blocks until an anchor counts as confirmed, including its own, 1 to 1000",
    },
    Definition {
        name: "gateway.admission",
        variable: "AUTHROS_GATEWAY_ADMISSION",
        default: "closed",
        text: "who may use this home's gateway: closed = its own profiles and admitted owners; open = anyone, within \
               quotas",
    },
    Definition {
        name: "gateway.quota_bytes",
        variable: "AUTHROS_GATEWAY_QUOTA_BYTES",
        default: "10GiB",
        text: "bytes of records that an owner who is not admitted may send to an open gateway",
    },
    Definition {
        name: "gateway.quota_names",
        variable: "AUTHROS_GATEWAY_QUOTA_NAMES",
        default: "16",
        text: "names that such an owner may register there",
    },
    Definition {
        name: "gateway.quota_streams",
        variable: "AUTHROS_GATEWAY_QUOTA_STREAMS",
        default: "1024",
        text: "streams that such an owner may have there; each topic, type and signer of a recorder is one stream",
    },
    Definition {
        name: "site.address",
        variable: "AUTHROS_SITE",
        default: "",
        text: "gateway of a remote site to join, as HOST:PORT; it supplies chain and records; further addresses of the same \
               gateway follow after commas; empty = no gateway",
    },
    Definition {
        name: "site.gateway_key",
        variable: "AUTHROS_GATEWAY_KEY",
        default: "",
        text: "identity key of that gateway, 64 hex characters; confirm it with its operator",
    },
    Definition {
        name: "site.trust_first",
        variable: "AUTHROS_TRUST_FIRST",
        default: "no",
        text: "yes = trust on first use: pin the first gateway that answers",
    },
    Definition {
        name: "console.theme",
        variable: "AUTHROS_THEME",
        default: "",
        text: "theme of the console: night, day, contrast, mono or one of your own; empty = chosen by the terminal's \
               colours",
    },
    Definition {
        name: "console.ascii",
        variable: "AUTHROS_ASCII",
        default: "auto",
        text: "ASCII characters only: yes, no, or auto (if the locale has no UTF-8)",
    },
    Definition {
        name: "console.mouse",
        variable: "AUTHROS_MOUSE",
        default: "no",
        text: "whether the console uses the mouse; no = leave text selection to the terminal",
    },
    Definition {
        name: "console.bytes_per_second",
        variable: "AUTHROS_BYTES_PER_SECOND",
        default: "",
        text: "limit in bytes per second for redraws caused by new data, key presses excluded; empty = 4000 over SSH, \
               otherwise no limit",
    },
    Definition {
        name: "console.pictures",
        variable: "AUTHROS_PICTURES",
        default: "half-blocks",
        text: "how pictures are shown: half-blocks, or as pixels on a terminal that supports sixel or kitty (not \
               detected)",
    },
    Definition {
        name: "console.lock_after",
        variable: "AUTHROS_LOCK_AFTER",
        default: "15",
        text: "minutes without a key press before the console locks the keyring (capture continues); 0 = never",
    },
];
