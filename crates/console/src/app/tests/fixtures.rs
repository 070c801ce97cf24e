//! Fixed data of a small site, for tests of the console.

use crate::model::{
    Address, Digest, Domain, ErrorKind, Hash, PinMode, ProfileName, PublicKey, Publisher, RecordKind, RecordState,
    Sampling, SignerId, Timestamp, Token, Verdict,
};
use crate::pipeline::sender::{LaneState, PauseReason};
use crate::service::command::IncidentCommand;
use crate::service::reply::{
    AdministrationView, AlarmView, AlertView, AuditView, ChainView, ContactRow, Direction, EpochView, GasView,
    GatewayStatusView, GatewayView, GrantForesight, GrantRow, GrantState, HealthLevel, IdentityView, IncidentNoteView,
    IncidentView, KeysView, LifeLine, OpenedView, Opens, PartHealth, PinView, PinsView, PricesView, Provenance,
    QueueView, RecordPage, RecordView, RefusedView, SenderView, Severity, ShownState, SiteView, SpanCoverageView,
    SystemKeyView, TopicRow, TransactionView,
};
use crate::service::{Command, Failure, GrantFrom, Reply, UploadQuery};
use authros_chain::Sealing;
use authros_gateway::Code;

pub mod robots;

pub const NOW: Timestamp = Timestamp(1_700_000_000_000_000_000);
/// What a grant of the current epoch opens.
pub const OPENS: Opens = Opens { records: 8_505, since: Some(Timestamp(NOW.0 - 407_000_000_000)), of_robots: false };
/// What a grant of all epochs opens.
const ALL_RECORDS: Opens =
    Opens { records: 581_165, since: Some(Timestamp(NOW.0 - 4 * 86_400_000_000_000)), of_robots: false };
/// The address of the profile.
pub const OWN: Address = Address([0x11; 20]);
/// The address of someone else.
pub const OTHER: Address = Address([0x5a; 20]);

/// The site's answer to a screen's request.
pub fn reply(command: &Command, exists: bool) -> Reply {
    match command {
        Command::SiteStatus => Reply::Site(site()),
        Command::ShowIdentity => Reply::Identity(identity(exists, exists, exists)),
        Command::ListKeys => Reply::Keys(keys()),
        Command::ListTopics => Reply::Topics(topics()),
        Command::ListUploads(query) => Reply::Records(page(query, None)),
        Command::ListShared(query) => Reply::Records(page(query, Some(OTHER))),
        Command::ListGrants => Reply::Grants(grants()),
        Command::ForeseeGrant { from, .. } => Reply::GrantForeseen(foresight(*from)),
        Command::ChainStatus => Reply::Chain(Box::new(chain())),
        Command::ListContacts => Reply::Contacts(vec![contact("harbour-office"), contact("harbour-master")]),
        Command::ListAudit(_) => Reply::Audit(audit()),
        Command::RecordingProgress => Reply::Progress(Vec::new()),
        Command::OfIncident(IncidentCommand::ListIncidents) => {
            Reply::Incidents(vec![incident("crash-1114", true), incident("bump", false)])
        }
        Command::OfRobot(_) => robots::reply(command),
        Command::GatewayStatus => Reply::GatewayStatus(gateway()),
        Command::Lock => Reply::Identity(identity(exists, false, exists)),
        _ => Reply::Done,
    }
}

pub fn failure(kind: ErrorKind, message: &str) -> Failure {
    Failure::new(kind, message)
}

pub fn identity(exists: bool, unlocked: bool, registered: bool) -> IdentityView {
    IdentityView {
        profile: ProfileName::default(),
        exists,
        unlocked,
        registered,
        address: exists.then_some(OWN),
        passphrase_file: None,
        epoch: registered.then_some(2),
        epoch_records: registered.then_some(OPENS),
        all_records: registered.then_some(ALL_RECORDS),
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

pub fn site() -> SiteView {
    let part = PartHealth::new;
    SiteView {
        health: vec![
            part("ros", HealthLevel::Ok, "embedded master http://127.0.0.1:40117"),
            part("chain", HealthLevel::Ok, "embedded, chain id 774411223"),
            part("store", HealthLevel::Ok, "rows and ciphertext in one file"),
            part("gateway", HealthLevel::Absent, "not part of this site"),
        ],
        life: LifeLine {
            captured: 12_345,
            stored: 12_345,
            anchored: 12_345,
            confirmed: 12_345,
            verified: 12_345,
            conserved: true,
            ..LifeLine::default()
        },
        robots: 4,
        profiles: vec![ProfileName::default()],
        process: 0,
        tasks: Vec::new(),
        queue: QueueView { messages: 3, bytes: 2_184, capacity: 201_326_592 },
        cache: None,
        verified_after: Vec::new(),
        alerts: Vec::new(),
        alerts_over: Vec::new(),
    }
}

/// An alert found by the site itself.
pub fn site_alert() -> AlertView {
    AlertView {
        key: "robot_silent/1f2e3d4c".to_owned(),
        severity: Severity::Warning,
        text: "Nothing received from robot 1f2e3d4c for 11 min; check its agent, its network and its clock.".to_owned(),
        site: "0a0b0c0d".to_owned(),
        begun: Timestamp::from_seconds(NOW.seconds() - 60),
    }
}

pub fn topic(name: &str, hz: f64) -> TopicRow {
    let camera = name.contains("camera");
    TopicRow {
        topic: name.to_owned(),
        type_name: Some(if camera { "sensor_msgs/CompressedImage" } else { "nav_msgs/Odometry" }.to_owned()),
        ros: 1,
        type_hash: None,
        qos: None,
        publishers: vec!["/driver".to_owned()],
        unreached: Vec::new(),
        watched: false,
        watched_by: None,
        watched_type: None,
        sampling: Sampling::default(),
        held_up: None,
        simulated: true,
        hz: Some(hz),
        bytes_per_second: Some(if camera { 116_000.0 } else { 14_400.0 }),
        messages: 0,
        lost_in_transport: 0,
        lost_in_recorder: 0,
        left_out: 0,
        last_message: Some(NOW),
        pins: u64::from(!camera),
        unpinned: Vec::new(),
        quarantined: 0,
        alarm: false,
    }
}

/// The topics of the graph.
pub fn topics() -> Vec<TopicRow> {
    let silent = TopicRow { type_name: None, simulated: false, hz: None, bytes_per_second: None, ..topic("/map", 0.0) };
    let watched = TopicRow { watched: true, messages: 12_300, ..topic("/robot1/odom", 20.1) };
    vec![topic("/robot2/odom", 20.0), topic("/robot1/camera/compressed", 2.0), watched, silent]
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
        kind: RecordKind::Data,
        state: ShownState::from_word(state).unwrap_or(ShownState::Kept(RecordState::Captured)),
        digest: Digest(digest),
        bytes: 728,
        captured_at: Timestamp(NOW.0 + number * 50_000_000),
        epoch: 2,
        simulated: true,
        transaction: anchored.then_some(Hash([3; 32])),
        block: anchored.then_some(118),
        compared: crate::pipeline::columns::Compared::Head,
        differs: None,
        erased: None,
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
        arriving: None,
    }
}

/// A contact without a grant yet.
pub fn contact(name: &str) -> ContactRow {
    ContactRow {
        name: name.parse().expect("a name"),
        address: Address([0x42; 20]),
        fingerprint: None,
        given: false,
        registered: None,
        state: "not noted".to_owned(),
    }
}

/// An incident of the ten minutes before, with one topic that has records and one of which nothing is there.
pub fn incident(name: &str, open: bool) -> IncidentView {
    let since = Timestamp::from_seconds(NOW.seconds() - 600);
    let some = SpanCoverageView {
        topic: "/robot1/odom".to_owned(),
        records: 1_234,
        bytes: 898_352,
        first: Some(since),
        last: Some(Timestamp::from_seconds(NOW.seconds() - 1)),
        deleted: 4,
        quarantined: 2,
        lost: 3,
    };
    let none = SpanCoverageView {
        topic: "/robot1/odm".to_owned(),
        records: 0,
        bytes: 0,
        first: None,
        last: None,
        deleted: 0,
        quarantined: 0,
        lost: 0,
    };
    IncidentView {
        name: name.parse().expect("a name"),
        open,
        since,
        until: (!open).then_some(NOW),
        opened_at: NOW,
        closed_at: (!open).then_some(NOW),
        topics: vec![some.topic.clone(), none.topic.clone()],
        notes: vec![IncidentNoteView { at: NOW, text: "hit the wall at bay 3".to_owned() }],
        records: some.records,
        bytes: some.bytes,
        coverage: vec![none, some],
    }
}

pub fn grant(direction: &str, account: Address, state: &str, block: u64) -> GrantRow {
    let given = direction == "given";
    GrantRow {
        direction: if given { Direction::Given } else { Direction::Received },
        owner: if given { OWN } else { account },
        grantee: if given { account } else { OWN },
        epoch: 1,
        from: given.then_some(1),
        opens: (state == "active").then_some(OPENS),
        expires: None,
        topics: if given { vec!["/robot1/odom".to_owned()] } else { Vec::new() },
        state: if state == "active" { GrantState::Active } else { GrantState::Revoked },
        block,
        transaction: Hash([u8::try_from(block).unwrap_or(0); 32]),
        name: None,
        fingerprint: None,
    }
}

/// A transaction that was mined.
pub fn transaction(text: &str) -> Reply {
    let view = TransactionView::mined(Hash([4; 32]), 120, 3, text.to_owned());
    Reply::Transaction(view)
}

/// With one other reader and one robot.
fn foresight(from: GrantFrom) -> GrantForesight {
    match from {
        GrantFrom::Now => GrantForesight {
            epoch: 3,
            topics: Vec::new(),
            epochs: 1,
            nothing_older: true,
            opens: Opens::default(),
            readers: 1,
            robots: vec!["scout-1".parse().expect("a name")],
            transactions: 3,
        },
        _ => GrantForesight { epoch: 2, opens: OPENS, transactions: 1, ..GrantForesight::default() },
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
        administration: AdministrationView { administrator: Some(OWN), open: true, ..AdministrationView::default() },
        gas: GasView { transactions: 100, gas: 5_214_000, records: 2_560 },
        waiting: Vec::new(),
        lacks: None,
        prices: PricesView::default(),
        lanes: vec![LaneState { open: 1, paused: Some(PauseReason::Stalled), ..LaneState::idle(OWN) }],
        sealing: Sealing { period: Some(100), difficulty: None, sealers: vec![Address([0x5e; 20])] },
    }
}

/// Publishers of a topic: one pinned, one suspect.
pub fn pins(topic: &str) -> PinsView {
    let publisher = Publisher {
        caller_id: "/driver".to_owned(),
        host: "192.0.2.17".to_owned(),
        type_name: "nav_msgs/Odometry".to_owned(),
        md5sum: "cd5e73d190d741a2f92e81eda573aca7".to_owned(),
    };
    let alarm = AlarmView {
        topic: topic.to_owned(),
        publisher: "/driver@198.51.100.9:nav_msgs/Odometry:cd5e73d190d741a2f92e81eda573aca7".to_owned(),
        reason: "host".to_owned(),
        at: NOW,
        open: true,
    };
    let pin = PinView { topic: topic.to_owned(), publisher, source: "first".to_owned(), at: Some(NOW) };
    PinsView { mode: PinMode::default(), pins: vec![pin], alarms: vec![alarm] }
}

/// A gateway with one robot connected and one away.
fn gateway() -> GatewayStatusView {
    let day = |day: u64| Timestamp(NOW.0 + day * 86_400_000_000_000);
    let sender = |name: &str, sessions: u64| SenderView {
        name: name.parse().expect("a name"),
        account: OWN,
        revoked: false,
        sessions,
        peer: (sessions > 0).then(|| "192.0.2.17:40112".to_owned()),
        since: (sessions > 0).then_some(NOW),
        last: (sessions > 0).then_some(NOW),
        frames: sessions * 12_044,
        bytes: sessions * 9_120_331,
    };
    let key = |id: u8, from: u64, current| SystemKeyView {
        id: SignerId([id; 32]),
        not_before: day(from),
        not_after: day(from + 7),
        current,
    };
    GatewayStatusView {
        served: Some(GatewayView {
            address: "192.0.2.1:7420".to_owned(),
            gateway: SignerId([0x6a; 32]),
            fingerprint: "5a1f 09c2 77e0 41bd 5a1f 09c2 77e0 41bd".to_owned(),
            account: OWN,
            domain: Domain([4; 32]),
            addresses: Vec::new(),
        }),
        through: None,
        connections: 2,
        senders: vec![sender("robot1", 1), sender("robot2", 0)],
        keys: vec![key(0x31, 0, true), key(0x32, 7, false)],
        list_version: 1_700_000_000,
        list_expires: Some(day(14)),
        refused: vec![
            RefusedView { code: 4, text: Code::Tag.text().to_owned(), count: 1_204 },
            RefusedView { code: 15, text: Code::NotAuthorised.text().to_owned(), count: 3 },
        ],
        lease: None,
    }
}

fn audit() -> Vec<AuditView> {
    let line = |line, action: &str, subject: &str, outcome: &str| AuditView {
        line,
        at: Timestamp(NOW.0 - (10 - line) * 1_000_000_000),
        profile: "default".to_owned(),
        operator: None,
        action: action.to_owned(),
        subject: subject.to_owned(),
        outcome: outcome.to_owned(),
    };
    vec![line(1, "register", &OWN.to_string(), "ok"), line(2, "grant", &OTHER.to_string(), "refused: not registered")]
}

/// Bytes without a pattern, as digests have them.
fn scattered(seed: u32) -> [u8; 32] {
    let mut state = seed.wrapping_mul(2_654_435_769);
    [0; 32].map(|_: u8| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state.to_be_bytes()[0]
    })
}

/// A record's provenance and state.
pub fn provenance(number: u64) -> Provenance {
    let step = |word: &str, evidence: &str| (word.to_owned(), evidence.to_owned());
    let steps = vec![
        step("message", "728 bytes of /robot1/odom, captured 2023-11-14T22:13:21Z"),
        step("record", "sealed under epoch 2, seq 1000, on disk 2023-11-14T22:13:21Z"),
        step("digest", &format!("SM3 {}", Digest(scattered(1)))),
        step("signature", &format!("SM2 by signer {}", SignerId(scattered(2)))),
        step("store", "ciphertext stored with its row"),
        step("batch", &format!("root {}, closed 2023-11-14T22:13:22Z", Hash(scattered(3)))),
        step("proof", "leaf 12 of 25, 5 hashes to the root"),
        step("transaction", &Hash(scattered(4)).to_string()),
        step("block", &format!("118 {}", Hash(scattered(5)))),
        step("confirmations", "12 of 3 wanted"),
        step("verified", "read back from the store: digest matches the chain, signature valid"),
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
        reason: None,
        caller_id: "/driver".to_owned(),
        tags: vec![("mission".to_owned(), "crime scene".to_owned()), ("simulated".to_owned(), "yes".to_owned())],
        compression: "lz4".to_owned(),
        stored: 312,
        note: None,
        readable: None,
        beginning: (0..=255).collect(),
        file: None,
        fields,
        message: serde_json::json!({ "header": { "seq": 1042 } }),
        body: None,
        picture: camera.then(|| vec![0xff; 58_211]),
    }
}
