//! A gateway, an owner and her robots, and a thief who has a robot's enrolment with its passphrase, but nothing of
//! hers.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use authros::crypto::{Enrolment, Passphrase, ProviderName, SealedEnrolment, provider};
use authros::gateway::{Client, Context, Credentials, Endpoint, Feed, GatewayError, Trust};
use authros::model::head::Compression;
use authros::model::{Digest, Head, RecordKind};
use serde_json::Value;

use crate::support::{Authros, Home, Running, free_port, text};

/// A gateway of a home in which alice is registered.
pub struct Scene {
    pub home: Home,
    pub port: u16,
    pub site: Running,
    pub fingerprint: String,
    pub alice: Authros,
}

impl Scene {
    pub fn new() -> Self {
        Self::in_home(Home::new())
    }

    /// The gateway joins the site of this home, if one runs.
    pub fn in_home(home: Home) -> Self {
        let port = free_port();
        let authros = home.profile("keeper").with(&["--json"]);
        let mut site = authros.spawn(&["gateway", "serve", "--listen", &format!("127.0.0.1:{port}")]);
        let said = site.wait_for_text("\"gateway\"", 120);
        let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
        let document: Value = serde_json::from_str(line).expect("JSON");
        let fingerprint = text(&document["gateway"], "gateway");
        let alice = home.profile("alice");
        alice.enrol();
        admit(&home, &alice);
        Self { home, port, site, fingerprint, alice }
    }
}

/// If the gateway admits owners only through its keeper, alice is admitted.
fn admit(home: &Home, alice: &Authros) {
    let keeper = home.profile("keeper");
    if keeper.run(&["gateway", "--help"]).stdout.contains("allow") {
        let address = text(&alice.json(&["identity", "show"]), "address");
        keeper.run(&["gateway", "allow", &address]);
    }
}

/// A robot of alice.
pub struct Robot {
    pub home: Home,
    pub file: String,
    pub device: String,
}

impl Robot {
    /// Enrolled for some topics, or for all.
    pub fn enrol(scene: &Scene, name: &str, topics: &[&str]) -> Self {
        let address = format!("127.0.0.1:{}", scene.port);
        Self::enrol_at(&scene.alice, (&address, &scene.fingerprint), name, topics)
    }

    /// The same by an owner wherever she is, at the gateway with this address and fingerprint.
    pub fn enrol_at(alice: &Authros, (address, fingerprint): (&str, &str), name: &str, topics: &[&str]) -> Self {
        let home = Home::new();
        let file = home.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
        let mut arguments = vec!["robot", "enrol", "--gateway", address, "--gateway-key", fingerprint];
        arguments.extend(["--name", name, "--out", &file]);
        arguments.extend(topics.iter().flat_map(|topic| ["--topic", topic]));
        // Earlier builds cover all topics unless told otherwise.
        let asks = alice.run(&["robot", "enrol", "--help"]).stdout.contains("--all-topics");
        arguments.extend((asks && topics.is_empty()).then_some("--all-topics"));
        let view = alice.json(&arguments);
        Self { home, file, device: text(&view, "device") }
    }

    /// Starts it.
    pub fn spawn(&self, arguments: &[&str]) -> Running {
        let agent = self.home.authros().with(&["--json"]);
        agent.spawn(&[&["robot", "run", &self.file, "--robots", "1"], arguments].concat())
    }

    /// Captures this many messages, all of them verified at the gateway.
    pub fn capture(&self, count: u64) {
        let count = count.to_string();
        self.spawn(&["--topic", "/robot1/odom", "--count", &count]).wait(180).expect_code(0);
    }

    /// The content of its file, as read by the thief.
    pub fn stolen(&self) -> Enrolment {
        let passphrase = std::fs::read_to_string(format!("{}.passphrase", self.file)).expect("a passphrase");
        let passphrase = Passphrase::new(passphrase.trim_end().to_owned()).expect("long enough");
        SealedEnrolment::open(Path::new(&self.file), &passphrase).expect("opens").enrolment
    }
}

/// What a thief seals as the head of a record.
pub fn head(topic: String, type_name: &str, body: &[u8]) -> Head {
    Head {
        topic,
        type_name: type_name.to_owned(),
        md5sum: String::new(),
        definition: Digest([0; 32]),
        caller_id: String::new(),
        boot_id: [0; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: BTreeMap::new(),
    }
}

/// A session of the thief, under the robot's transport key.
///
/// # Errors
/// The gateway's refusal.
pub async fn session(enrolment: &Enrolment) -> Result<Client, GatewayError> {
    let gateway = &enrolment.gateway;
    let context = Context { provider: provider(ProviderName::RustCrypto), domain: enrolment.domain };
    let (addresses, patience) = (gateway.addresses.clone(), Duration::from_secs(10));
    let endpoint = Endpoint { addresses, context, patience, source: None };
    let mut trust = Trust::pinned(gateway.fingerprint);
    let (name, key) = (enrolment.name.clone(), gateway.transport.clone());
    Client::connect(&endpoint, &mut trust, &Credentials { name, key, token: enrolment.token }).await
}

/// The owner's notices to this robot.
pub fn notices(enrolment: &Enrolment) -> Feed {
    let (topics, kind) = (vec![enrolment.notice_id], Some(RecordKind::Key));
    Feed { topics, kind, ..Feed::of(enrolment.owner) }
}
