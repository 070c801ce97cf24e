//! Fixed data of a small site, for tests of the console.

use crate::chain::Sealing;
use crate::model::{Address, Digest, ErrorKind, Hash, ProfileName, PublicKey, Timestamp, Token, Verdict};
use crate::pipeline::sender::{LaneState, PauseReason};
use crate::service::reply::{
    AdministrationView, AuditView, ChainView, EpochView, GrantRow, HealthLevel, IdentityView, KeysView, LifeLine,
    OpenedView, PartHealth, Provenance, RecordPage, RecordView, SiteView, TopicRow, TransactionView,
};
use crate::service::{Command, Failure, Reply, UploadQuery};

/// The frozen clock.
pub const NOW: Timestamp = Timestamp(1_700_000_000_000_000_000);
/// The address of the profile.
pub const OWN: Address = Address([0x11; 20]);
/// The address of someone else.
pub const OTHER: Address = Address([0x5a; 20]);

/// The answer of the site to a question of a screen.
pub fn reply(command: &Command, exists: bool) -> Reply {
    match command {
        Command::SiteStatus => Reply::Site(site()),
        Command::ShowIdentity => Reply::Identity(identity(exists, exists, exists)),
        Command::ListKeys => Reply::Keys(keys()),
        Command::ListTopics => Reply::Topics(topics()),
        Command::ListUploads(query) => Reply::Records(page(query, None)),
        Command::ListShared(query) => Reply::Records(page(query, Some(OTHER))),
        Command::ListGrants => Reply::Grants(grants()),
        Command::ChainStatus => Reply::Chain(chain()),
        Command::ListAudit(_) => Reply::Audit(audit()),
        _ => Reply::Done,
    }
}

/// A failure.
pub fn failure(kind: ErrorKind, message: &str) -> Failure {
    Failure::new(kind, message)
}

/// The profile.
pub fn identity(exists: bool, unlocked: bool, registered: bool) -> IdentityView {
    IdentityView {
        profile: ProfileName::default(),
        exists,
        unlocked,
        registered,
        address: exists.then_some(OWN),
        epoch: registered.then_some(2),
        signing_key: None,
        fingerprint: None,
        envelope_key: None,
    }
}

fn keys() -> KeysView {
    let epoch = |epoch| EpochView { epoch, token: Token([u8::try_from(epoch).unwrap_or(0); 32]), current: epoch == 2 };
    KeysView {
        address: OWN,
        signing_key: PublicKey([1; 64]),
        signing_fingerprint: "5a1f 09c2 77e0 41bd".to_owned(),
        envelope_key: PublicKey([2; 64]),
        envelope_fingerprint: "b04e 7712 90fd 0cc1".to_owned(),
        epochs: vec![epoch(1), epoch(2)],
    }
}

/// The whole site.
pub fn site() -> SiteView {
    let part = |part: &str, level, text: &str| PartHealth { part: part.to_owned(), level, text: text.to_owned() };
    SiteView {
        health: vec![
            part("ros", HealthLevel::Ok, "embedded master http://127.0.0.1:40117"),
            part("chain", HealthLevel::Ok, "embedded, chain id 774411223"),
            part("vault", HealthLevel::Ok, "embedded (SQLite)"),
            part("gateway", HealthLevel::Absent, "not part of this site"),
        ],
        life: LifeLine {
            captured: 12_345,
            sealed: 12_345,
            stored: 12_340,
            anchored: 12_320,
            confirmed: 12_310,
            verified: 12_300,
            ..LifeLine::default()
        },
        robots: 4,
        profiles: vec![ProfileName::default()],
    }
}

/// A topic.
pub fn topic(name: &str, hz: f64) -> TopicRow {
    let camera = name.contains("camera");
    TopicRow {
        topic: name.to_owned(),
        type_name: Some(if camera { "sensor_msgs/CompressedImage" } else { "nav_msgs/Odometry" }.to_owned()),
        publishers: vec!["/driver".to_owned()],
        watched: false,
        simulated: true,
        hz: Some(hz),
        bytes_per_second: Some(if camera { 116_000.0 } else { 14_400.0 }),
        messages: 0,
        lost_in_transport: 0,
        lost_in_recorder: 0,
        left_out: 0,
        last_message: Some(NOW),
        quarantined: 0,
        alarm: false,
    }
}

/// The topics of the graph, as a hostile one also sees to it.
pub fn topics() -> Vec<TopicRow> {
    let hostile = TopicRow { type_name: None, simulated: false, hz: None, ..topic("/evil\u{202e}\u{1b}[2J", 0.0) };
    let watched = TopicRow { watched: true, messages: 12_300, ..topic("/robot1/odom", 20.1) };
    vec![topic("/robot2/odom", 20.0), topic("/robot1/camera/compressed", 2.0), watched, hostile]
}

/// A record; the number makes it its own.
pub fn record(number: u64, state: &str) -> RecordView {
    let mut digest = [0xd1; 32];
    digest[..8].copy_from_slice(&number.to_be_bytes());
    let anchored = state == "verified";
    RecordView {
        id: format!("{number:016x}"),
        owner: None,
        owner_name: None,
        seq: number,
        topic: "/robot1/odom".to_owned(),
        type_name: "nav_msgs/Odometry".to_owned(),
        kind: "data".to_owned(),
        state: state.to_owned(),
        digest: Digest(digest),
        bytes: 728,
        captured_at: Timestamp(NOW.0 + number * 50_000_000),
        epoch: 2,
        simulated: true,
        transaction: anchored.then_some(Hash([3; 32])),
        block: anchored.then_some(118),
    }
}

/// A page of 1,000 records.
pub fn page(query: &UploadQuery, owner: Option<Address>) -> RecordPage {
    let states = ["sealed", "stored", "submitted", "mined", "confirmed"];
    let from: u64 = query.after.as_deref().map_or(1_000, |after| after.parse().unwrap_or(0));
    let limit = u64::try_from(query.limit).unwrap_or(1);
    let records = (0..limit.min(from)).map(|place| {
        let number = from - place;
        let state = usize::try_from(1_000 - number).ok().and_then(|age| states.get(age)).unwrap_or(&"verified");
        RecordView { owner, ..record(number, state) }
    });
    RecordPage {
        records: records.collect(),
        next: from.checked_sub(limit).filter(|left| *left > 0).map(|left| left.to_string()),
    }
}

/// A grant.
pub fn grant(direction: &str, account: Address, state: &str, block: u64) -> GrantRow {
    let given = direction == "given";
    GrantRow {
        direction: direction.to_owned(),
        owner: if given { OWN } else { account },
        grantee: if given { account } else { OWN },
        epoch: 1,
        expires: None,
        topics: if given { vec!["/robot1/odom".to_owned()] } else { Vec::new() },
        state: state.to_owned(),
        block,
        transaction: Hash([u8::try_from(block).unwrap_or(0); 32]),
        name: None,
        fingerprint: None,
    }
}

fn grants() -> Vec<GrantRow> {
    vec![
        grant("given", OTHER, "active", 44),
        grant("given", Address([0x77; 20]), "revoked", 40),
        grant("received", Address([0xab; 20]), "active", 39),
    ]
}

fn chain() -> ChainView {
    ChainView {
        kind: "embedded".to_owned(),
        consensus: "poa".to_owned(),
        chain_id: 774_411_223,
        genesis: Hash([9; 32]),
        block: 1_118,
        contract: Some(Address([0xcd; 20])),
        balance: "1500000000000000000".to_owned(),
        nonce: 12,
        pending: 1,
        client: "AuthROS embedded".to_owned(),
        through: None,
        administration: AdministrationView::default(),
        lanes: vec![LaneState { open: 1, paused: Some(PauseReason::Stalled), ..LaneState::idle(OWN) }],
        sealing: Sealing { period: Some(100), difficulty: None, sealers: vec![Address([0x5e; 20])] },
    }
}

fn audit() -> Vec<AuditView> {
    let line = |line, action: &str, subject: &str, outcome: &str| AuditView {
        line,
        at: Timestamp(NOW.0 - (10 - line) * 1_000_000_000),
        profile: "default".to_owned(),
        action: action.to_owned(),
        subject: subject.to_owned(),
        outcome: outcome.to_owned(),
    };
    vec![line(1, "register", &OWN.to_string(), "ok"), line(2, "grant", &OTHER.to_string(), "refused: not registered")]
}

/// The answer to a transaction.
pub fn transaction(text: &str) -> Reply {
    Reply::Transaction(TransactionView {
        transaction: Some(Hash([8; 32])),
        block: Some(120),
        epoch: 2,
        text: text.to_owned(),
    })
}

/// Where a record stands.
pub fn provenance(number: u64) -> Provenance {
    let step = |word: &str, evidence: &str| (word.to_owned(), evidence.to_owned());
    let steps = vec![
        step("captured", "2023-11-14T22:13:21Z from /driver"),
        step("sealed", "SM4-GCM under epoch 2, SM2 signature by 5a1f 09c2 77e0 41bd"),
        step("stored", "embedded vault"),
        step("submitted", &format!("transaction {}", Hash([3; 32]))),
        step("mined", "block 118"),
        step("confirmed", "12 blocks deep"),
        step("verified", "re-read from the vault, digest equal to the chain, signature valid"),
    ];
    Provenance { record: record(number, "verified"), steps }
}

/// An opened record, of odometry or of a camera.
pub fn opened(number: u64, camera: bool) -> OpenedView {
    let field = |(path, value): (&str, &str)| (path.to_owned(), value.to_owned());
    let odometry = [
        ("header.seq", "1042"),
        ("header.stamp", "1700000000.123456789"),
        ("header.frame_id", "odom"),
        ("child_frame_id", "base_link"),
        ("pose.pose.position.x", "1.25"),
        ("pose.pose.position.y", "-0.5"),
        ("pose.pose.position.z", "0"),
        ("pose.pose.orientation.x", "0"),
        ("pose.pose.orientation.y", "0"),
        ("pose.pose.orientation.z", "0.38268"),
        ("pose.pose.orientation.w", "0.92388"),
        ("pose.covariance", "float64[36]"),
        ("twist.twist.linear.x", "0.4"),
        ("twist.twist.angular.z", "0.1"),
        ("twist.covariance", "float64[36]"),
    ];
    let picture = [("header.seq", "7"), ("format", "jpeg"), ("data", "uint8[58211]")];
    let fields = if camera { picture.map(field).to_vec() } else { odometry.map(field).to_vec() };
    let topic = if camera { "/robot1/camera/compressed" } else { "/robot1/odom" };
    OpenedView {
        record: RecordView { owner: Some(OTHER), topic: topic.to_owned(), ..record(number, "verified") },
        verdict: Verdict::Verified,
        caller_id: "/driver".to_owned(),
        tags: vec![("mission".to_owned(), "crime scene".to_owned()), ("simulated".to_owned(), "yes".to_owned())],
        fields,
        message: serde_json::json!({ "header": { "seq": 1042 } }),
        body: None,
        picture: camera.then(|| vec![0xff; 58_211]),
    }
}
