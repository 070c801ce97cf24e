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
        text: "name or address other ROS nodes reach this machine by; ROS_IP counts too",
    },
    Definition {
        name: "ros.meter",
        variable: "AUTHROS_METER",
        default: "auto",
        text: "measure rates of: all topics, watched ones, or auto (all on the embedded master)",
    },
    Definition {
        name: "ros.pins",
        variable: "AUTHROS_PINS",
        default: "first",
        text: "publishers of a captured topic: the first seen are pinned, only those on a list, or off = anybody",
    },
    Definition {
        name: "ros.publishers",
        variable: "AUTHROS_PUBLISHERS",
        default: "",
        text: "publishers that are pinned: TOPIC=CALLER_ID@HOST:TYPE:MD5, separated by commas",
    },
    Definition {
        name: "ros.definitions",
        variable: "AMENT_PREFIX_PATH",
        default: "",
        text: "where ROS 2 is installed, separated by colons: definitions of types that a recording does not describe",
    },
    Definition {
        name: "ros.domain",
        variable: "ROS_DOMAIN_ID",
        default: "",
        text: "domain of ROS 2 to capture from, 0 to 232, beside ROS 1; empty = no ROS 2",
    },
    Definition {
        name: "ros.ros2_program",
        variable: "AUTHROS_ROS2_PROGRAM",
        default: "",
        text: "path of authros-ros2, the program that reads ROS 2; empty = beside this program",
    },
    Definition {
        name: "robots",
        variable: "AUTHROS_ROBOTS",
        default: "4",
        text: "simulated robots on the embedded master, 0 to 32; with ros.domain none unless they are asked for",
    },
    Definition {
        name: "chain.url",
        variable: "AUTHROS_CHAIN",
        default: "",
        text: "node to use: http://, ws:// or ipc path; empty = embedded chain",
    },
    Definition {
        name: "chain.contract",
        variable: "AUTHROS_CONTRACT",
        default: "",
        text: "address of the AuthROS contract; empty = deploy one at first registration",
    },
    Definition {
        name: "chain.max_fee",
        variable: "AUTHROS_MAX_FEE",
        default: "1000",
        text: "most gwei per gas a transaction may offer, replacements included; empty = no cap",
    },
    Definition {
        name: "chain.consensus",
        variable: "AUTHROS_CONSENSUS",
        default: "",
        text: "embedded chain: poa[:SIGNERS:PERIOD_MS] or pow[:DIFFICULTY]; empty = as founded, new ones poa",
    },
    Definition {
        name: "capture.memory",
        variable: "AUTHROS_CAPTURE_MEMORY",
        default: "256MiB",
        text: "memory for captured messages that wait to be stored, all topics together; what does not fit is counted",
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
        text: "disk space for records that wait for a Redis that does not take them",
    },
    Definition {
        name: "vault.local",
        variable: "AUTHROS_VAULT_LOCAL",
        default: "always",
        text: "how long a verified record also stays on this disk beside Redis: always, or a time as 0s, 12h, 30d",
    },
    Definition {
        name: "outbox.keep",
        variable: "AUTHROS_OUTBOX_KEEP",
        default: "7d",
        text: "how long a robot keeps ciphertext after its gateway has proven and signed that it is verified: always, or a \
               time as 0s, 12h, 30d; below half more than disk.reserve it is given up earlier, oldest first",
    },
    Definition {
        name: "resend.after",
        variable: "AUTHROS_RESEND_AFTER",
        default: "10m",
        text: "a record that a gateway signed for and has not proven for so long goes from the robot to its next gateway \
               too: a time as 30s, 10m, 1h",
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
        text: "what ciphertext is kept of topics: PATTERN=TIME, =SIZE, =TIME+SIZE or =ever, separated by commas; the \
               first fitting counts; * is any but /, ** any; empty = everything; the time of a [[topic]] rule goes before; \
               digest and proof stay for ever",
    },
    Definition {
        name: "disk.reserve",
        variable: "AUTHROS_DISK_RESERVE",
        default: "64MiB",
        text: "disk space left free: below it no further record is acknowledged, so that those there are can go on",
    },
    Definition {
        name: "record.compression",
        variable: "AUTHROS_COMPRESSION",
        default: "auto",
        text: "auto = compress messages before they are sealed where it pays; off = seal them as they are",
    },
    Definition {
        name: "crypto.provider",
        variable: "AUTHROS_CRYPTO_PROVIDER",
        default: "authros",
        text: "authros (our own kernels), rustcrypto or libsm",
    },
    Definition {
        name: "crypto.sm4_kernel",
        variable: "AUTHROS_SM4_KERNEL",
        default: "",
        text: "gfni-avx512, gfni-avx2, aesni-avx2 or portable; empty = the fastest that this processor can run",
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
        text: "accounts that anchor side by side, the owner's included, 1 to 8",
    },
    Definition {
        name: "audit.anchor_every",
        variable: "AUTHROS_AUDIT_ANCHOR_EVERY",
        default: "60",
        text: "seconds after which heads of a changed audit log and of grown topics are anchored, 1 to 86400",
    },
    Definition {
        name: "audit.scrub",
        variable: "AUTHROS_AUDIT_SCRUB",
        default: "1",
        text: "per cent of the stored records that a running site re-hashes an hour; 0 = none, above 100 = several times",
    },
    Definition {
        name: "time.authorities",
        variable: "AUTHROS_TIME_AUTHORITIES",
        default: "",
        text: "time stamp authorities (RFC 3161) that stamp each hour's batches: [{ name = \"NAME\", url = \"http://HOST/PATH\", \
               certificate = \"/PATH/OF.pem\" }]; empty = none",
    },
    Definition {
        name: "metrics.listen",
        variable: "AUTHROS_METRICS_LISTEN",
        default: "",
        text: "where Prometheus reads figures of a running site: HOST:PORT of this machine, or the path of a socket; \
               empty = nowhere",
    },
    Definition {
        name: "metrics.open",
        variable: "AUTHROS_METRICS_OPEN",
        default: "no",
        text: "yes = metrics.listen may be an address that other machines reach; whoever reaches it reads the figures",
    },
    Definition {
        name: "metrics.topics",
        variable: "AUTHROS_METRICS_TOPICS",
        default: "no",
        text: "yes = figures of each topic by its name too, of 200 topics at most",
    },
    Definition {
        name: "alerts.webhook",
        variable: "AUTHROS_ALERTS_WEBHOOK",
        default: "",
        text: "who is told of alerts: http:// or https://HOST:PORT/PATH; empty and no alerts.command = nobody, and \
               alerts are only shown",
    },
    Definition {
        name: "alerts.form",
        variable: "AUTHROS_ALERTS_FORM",
        default: "authros",
        text: "how the webhook is spoken to: authros (signed JSON), or alertmanager (its API, version 2)",
    },
    Definition {
        name: "alerts.secret",
        variable: "AUTHROS_ALERTS_SECRET",
        default: "",
        text: "file, 0600, whose bytes sign what the webhook is sent (HMAC-SHA256); empty = unsigned",
    },
    Definition {
        name: "alerts.roots",
        variable: "AUTHROS_ALERTS_ROOTS",
        default: "",
        text: "file with the authorities, PEM, that an https webhook's certificate is of; empty = those of this machine",
    },
    Definition {
        name: "alerts.command",
        variable: "AUTHROS_ALERTS_COMMAND",
        default: "",
        text: "who is told instead of a webhook: [\"PROGRAM\", \"ARGUMENT\"], run without a shell, JSON on its stdin; nobody else may \
               write config.toml, the program, or a folder above them",
    },
    Definition {
        name: "alerts.every",
        variable: "AUTHROS_ALERTS_EVERY",
        default: "10",
        text: "seconds between two looks, 1 to 3600",
    },
    Definition {
        name: "alerts.robot_silent",
        variable: "AUTHROS_ALERTS_ROBOT_SILENT",
        default: "10m",
        text: "a robot that sent nothing for so long is an alert, for a day at most; never = no such alert",
    },
    Definition {
        name: "alerts.unanchored",
        variable: "AUTHROS_ALERTS_UNANCHORED",
        default: "10m",
        text: "a record that is in no block for so long is an alert, or never",
    },
    Definition {
        name: "alerts.disk",
        variable: "AUTHROS_ALERTS_DISK",
        default: "1GiB",
        text: "less free space on the disk of the home is an alert; 0 = no such alert",
    },
    Definition {
        name: "alerts.clock",
        variable: "AUTHROS_ALERTS_CLOCK",
        default: "5s",
        text: "a clock that differs by more from the time that rights go by is an alert, or never",
    },
    Definition {
        name: "alerts.grant_ends",
        variable: "AUTHROS_ALERTS_GRANT_ENDS",
        default: "3d",
        text: "a grant, given or received from a contact, that ends within so long is an alert, or never",
    },
    Definition {
        name: "alerts.audit",
        variable: "AUTHROS_ALERTS_AUDIT",
        default: "15m",
        text: "a line of the audit log that no anchored head covers for so long is an alert, or never",
    },
    Definition {
        name: "confirmations",
        variable: "AUTHROS_CONFIRMATIONS",
        default: "1",
        text: "blocks until an anchor counts as confirmed, its own included, 1 to 1000",
    },
    Definition {
        name: "gateway.admission",
        variable: "AUTHROS_GATEWAY_ADMISSION",
        default: "closed",
        text: "who may use this home's gateway: closed = its own profiles and admitted owners, or open = anybody, within quotas",
    },
    Definition {
        name: "gateway.quota_bytes",
        variable: "AUTHROS_GATEWAY_QUOTA_BYTES",
        default: "10GiB",
        text: "bytes of records that an owner may send to an open gateway without being admitted",
    },
    Definition {
        name: "gateway.quota_names",
        variable: "AUTHROS_GATEWAY_QUOTA_NAMES",
        default: "16",
        text: "names that such an owner may have there",
    },
    Definition {
        name: "gateway.quota_streams",
        variable: "AUTHROS_GATEWAY_QUOTA_STREAMS",
        default: "1024",
        text: "streams that such an owner may have there: each topic, type and signer of each recorder is one",
    },
    Definition {
        name: "site.address",
        variable: "AUTHROS_SITE",
        default: "",
        text: "gateway of a remote site to join, as HOST:PORT; chain and records come through it; empty = no gateway",
    },
    Definition {
        name: "site.gateway_key",
        variable: "AUTHROS_GATEWAY_KEY",
        default: "",
        text: "fingerprint of that gateway's identity key, 64 hex; compare it with its operator",
    },
    Definition {
        name: "site.trust_first",
        variable: "AUTHROS_TRUST_FIRST",
        default: "no",
        text: "yes = pin whatever gateway answers the first time",
    },
    Definition {
        name: "site.also",
        variable: "AUTHROS_SITE_ALSO",
        default: "",
        text: "further gateways of the fleet joined, in order: HOST:PORT=KEY, separated by commas; the chain comes through the \
               first that answers, records from all",
    },
    Definition {
        name: "console.theme",
        variable: "AUTHROS_THEME",
        default: "",
        text: "theme of the console: night, day, contrast, mono or one of your own; empty = by the terminal's colours",
    },
    Definition {
        name: "console.ascii",
        variable: "AUTHROS_ASCII",
        default: "auto",
        text: "ASCII characters only: yes, no, or auto (where the locale has no UTF-8)",
    },
    Definition {
        name: "console.mouse",
        variable: "AUTHROS_MOUSE",
        default: "no",
        text: "whether the console takes the mouse; no leaves selecting text to the terminal",
    },
    Definition {
        name: "console.bytes_per_second",
        variable: "AUTHROS_BYTES_PER_SECOND",
        default: "",
        text: "most bytes a second drawn because data changed, keys apart; empty = 4000 over SSH, else no limit",
    },
    Definition {
        name: "console.pictures",
        variable: "AUTHROS_PICTURES",
        default: "half-blocks",
        text: "how pictures are shown: half-blocks, or as pixels by a terminal that knows sixel or kitty; it is never asked",
    },
    Definition {
        name: "console.lock_after",
        variable: "AUTHROS_LOCK_AFTER",
        default: "15",
        text: "minutes without a key after which the console locks the keyring while capture goes on; 0 = never",
    },
];
