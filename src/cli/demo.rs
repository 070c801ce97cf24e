//! `authros demo`: the paper's crime-scene mission, told with figures. Four robots, of ROS 1 or ROS 2, take odometry
//! and pictures; CURA A shares them with CURA B, a stranger and a forger are refused, B is
//! revoked. Every figure is counted, none is assumed; `ok` says that all of them are right.

mod mission;

use std::collections::HashSet;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use authros_output::Output;
use serde::Serialize;

use self::mission::Mission;
use super::args::DemoArguments;
use super::connect::Context;
use crate::config::Config;
use crate::crypto::sm3::sm3;
use crate::crypto::{
    Anchor, CryptoError, Expected, Names, OpenedRecord, Provider, SealRequest, SmKeyPair, TopicKey, open, record, seal,
};
use crate::model::head::Compression;
use crate::model::{Digest, ErrorKind, Head, Signature};
use crate::paths::Home;
use crate::pipeline::reader::Reader;
use crate::pipeline::{Network, Owner, Plant};
use crate::ros::ros2::Ros2Capture;
use crate::ros::{Capture, CaptureNotice, CaptureOptions, Message, MessageSink};
use crate::service::Failure;
use crate::store::RecordRow;

/// Robots of ROS 2, unless `--robots` says otherwise.
const USUAL_ROBOTS: u16 = 4;

/// Transactions and gas of the mission, including deployment and registration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Work {
    /// Transactions in blocks.
    pub transactions: u64,
    /// Gas they used.
    pub gas: u64,
}

/// The demo's output.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Story {
    /// Messages captured by CURA A.
    pub captured: u64,
    /// Of these in a block.
    pub anchored: u64,
    /// Of these re-read and checked against the chain.
    pub verified: u64,
    /// Records that CURA B opened while granted.
    pub opened_by_grantee: u64,
    /// Whether the stranger got nothing.
    pub refused_stranger: bool,
    /// Whether the flipped bit and every other forgery was refused, each by its own check.
    pub refused_tampered: bool,
    /// Records sealed after the revocation that CURA B opened with every key it kept.
    pub opened_after_revoke: u64,
    /// Pictures that CURA B restored byte-identical to what the robot sent.
    pub restored_images: u64,
    /// Messages lost in transport or in the recorder.
    pub lost: u64,
    /// The chain's work.
    pub chain: Work,
    /// Whether everything is as it must be.
    pub ok: bool,
}

/// Runs the demo; exit 0 with `ok: true`, otherwise 1.
pub async fn run(mut context: Context, arguments: DemoArguments, output: &Output) -> Result<u8, Failure> {
    if context.config.robots == 0 && context.global.ros2.is_none() {
        let text = "the demo needs robots; use --robots 1 to 32 and no real ROS master";
        return Err(Failure::new(ErrorKind::Usage, text));
    }
    let temporary = match context.global.home {
        Some(_) => None,
        None => Some(temporary_home(&mut context, "authros-demo-")?),
    };
    let robots = if context.global.ros2.is_some() { in_domain(&mut context) } else { Robots::of_one(&context.config) };
    let mission = Mission::start(&context, robots, arguments.seconds, *output).await?;
    let told = mission.run().await;
    drop(temporary);
    let story = told?;
    output.result(&story, || text(&story));
    Ok(if story.ok { 0 } else { ErrorKind::Internal.exit_code() })
}

/// The robots of a mission.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Robots {
    /// Their number.
    pub number: u16,
    /// The ROS 2 domain in which they publish; `None` for the embedded master of ROS 1.
    pub domain: Option<u16>,
}

impl Robots {
    /// As the settings say, at the embedded master.
    pub fn of_one(config: &Config) -> Self {
        Self { number: config.robots, domain: None }
    }
}

/// The robots are in the domain that the site captures, and none at its master: one name is captured from one graph.
fn in_domain(context: &mut Context) -> Robots {
    let number = std::mem::take(&mut context.config.robots);
    let number = if number == 0 { USUAL_ROBOTS } else { number };
    Robots { number, domain: context.config.ros_domain }
}

/// Gives a context a home of its own, which is removed with the value, and default settings.
pub(super) fn temporary_home(context: &mut Context, prefix: &str) -> Result<tempfile::TempDir, Failure> {
    let uncreated = |error: std::io::Error| {
        Failure::new(ErrorKind::Home, format!("no temporary directory can be created: {error}"))
    };
    let directory = tempfile::Builder::new().prefix(prefix).tempdir().map_err(uncreated)?;
    context.home = Home::new(directory.path().to_owned());
    context.operator = None;
    context.global.site_socket = None;
    // The settings of the standard home do not apply to this one.
    let global = context.global.clone();
    context.config = Config::resolve(&|name| global.setting(name), &|name| std::env::var(name).ok(), None)?;
    // What the mission alters lies on the disk, and is to be noticed there.
    context.config.cache_url = None;
    Ok(directory)
}

fn yes(value: bool) -> &'static str {
    if value { "yes" } else { "NO" }
}

fn text(story: &Story) -> String {
    [
        String::new(),
        format!("  captured             {:>8}", story.captured),
        format!("  anchored             {:>8}", story.anchored),
        format!("  verified             {:>8}", story.verified),
        format!("  lost                 {:>8}", story.lost),
        format!("  opened by grantee    {:>8}", story.opened_by_grantee),
        format!("  pictures restored    {:>8}  byte-identical", story.restored_images),
        format!("  stranger refused     {:>8}", yes(story.refused_stranger)),
        format!("  tampering refused    {:>8}", yes(story.refused_tampered)),
        format!("  opened after revoke  {:>8}", story.opened_after_revoke),
        format!("  chain                {:>8}  transactions, {} gas", story.chain.transactions, story.chain.gas),
        format!("  {}", if story.ok { "everything as expected" } else { "NOT as expected" }),
    ]
    .join("\n")
}

/// How long the listener may take to receive from a robot, or lag behind the product.
const PATIENCE: Duration = Duration::from_secs(60);

#[derive(Default)]
struct Hashes {
    seen: Mutex<HashSet<[u8; 32]>>,
    heard: Mutex<HashSet<Arc<str>>>,
    more: Condvar,
}

impl MessageSink for Hashes {
    fn accept(&self, message: Message) {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner).insert(Arc::clone(&message.topic));
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).insert(sm3(&[&message.body]));
        self.more.notify_all();
    }

    fn notice(&self, _: CaptureNotice) {}
}

/// Keeps listening until it is dropped.
enum Ear {
    One(#[expect(dead_code, reason = "ends with it")] Capture),
    Two(#[expect(dead_code, reason = "ends with it")] Ros2Capture),
}

/// Watches picture topics beside the product.
pub struct Listener {
    hashes: Arc<Hashes>,
    topics: Vec<String>,
    _ear: Ear,
}

impl Listener {
    /// Begins to watch `topics`.
    pub fn start(master_uri: &str, topics: &[String]) -> Result<Self, Failure> {
        let hashes = Arc::new(Hashes::default());
        let (master_uri, node_name) = (master_uri.to_owned(), "/authros_listener".to_owned());
        let options = CaptureOptions { master_uri, own_host: None, node_name };
        let capture = Capture::start(options, hashes.clone())?;
        for topic in topics.iter().filter_map(|topic| topic.parse().ok()) {
            capture.watch(topic, None);
        }
        Ok(Self { hashes, topics: topics.to_vec(), _ear: Ear::One(capture) })
    }

    /// The same in a ROS 2 domain, by a program of its own.
    pub fn start_in(domain: u16, program: Option<&Path>, topics: &[String]) -> Result<Self, Failure> {
        let hashes = Arc::new(Hashes::default());
        let capture = Ros2Capture::start(domain, program, hashes.clone())?;
        for topic in topics.iter().filter_map(|topic| topic.parse().ok()) {
            capture.watch(&topic);
        }
        Ok(Self { hashes, topics: topics.to_vec(), _ear: Ear::Two(capture) })
    }

    /// Waits until something was received on every topic, so that nothing captured from now on is missed.
    pub fn listen(&self) {
        let end = Instant::now() + PATIENCE;
        let heard = || self.hashes.heard.lock().unwrap_or_else(PoisonError::into_inner);
        while !self.topics.iter().all(|topic| heard().contains(topic.as_str())) && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Whether a robot sent exactly this message; one not received yet is waited for.
    pub fn saw(&self, body: &[u8]) -> bool {
        let (digest, end) = (sm3(&[body]), Instant::now() + PATIENCE);
        let mut seen = self.hashes.seen.lock().unwrap_or_else(PoisonError::into_inner);
        while !seen.contains(&digest) {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            seen = self.hashes.more.wait_timeout(seen, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}

/// A genuine record with everything that opens it.
pub struct Genuine {
    row: RecordRow,
    blob: Vec<u8>,
    key: TopicKey,
    pair: SmKeyPair,
    expected: Expected,
}

impl Genuine {
    /// Takes a record of `owner` from the store.
    pub fn take(plant: &Plant, network: &Network, owner: &Owner, row: RecordRow) -> Result<Self, Failure> {
        let missing = || crate::pipeline::PipelineError::Missing(row.id.clone());
        let blob = plant.ciphertext.get(row.digest)?.ok_or_else(missing)?;
        let key = Reader { plant, network, reader: owner }.topic_key(&row)?;
        let expected = Expected::any_of(network.domain, owner.address, Names::Derived(owner.index()));
        Ok(Self { blob, key, pair: owner.signing(), expected, row })
    }

    /// Opens bytes in its place, as if they were its own.
    fn open(
        &self,
        provider: &dyn Provider,
        (blob, signature): (&[u8], &Signature),
        anchor: Anchor,
        key: &TopicKey,
    ) -> Result<OpenedRecord, CryptoError> {
        open(provider, blob, signature, &self.pair.public, anchor, key, &self.expected)
    }

    /// A bit of the body flipped, then signed again by the owner and anchored: only the tag can tell.
    fn resigned(&self, provider: &dyn Provider) -> Result<(Vec<u8>, Signature, Digest), Failure> {
        let mut blob = self.blob.clone();
        if let Some(byte) = blob.last_mut() {
            *byte ^= 1;
        }
        let digest = Digest(provider.sm3(&[&blob]));
        let signature = provider.sign(&self.pair.secret, &record::signed_bytes(&self.expected.domain, &digest))?;
        Ok((blob, signature, digest))
    }
}

/// Names of the checks that let their forgery pass; empty = all checks work.
pub fn broken(provider: &dyn Provider, one: &Genuine, other: &Genuine) -> Result<Vec<&'static str>, Failure> {
    let (own, anchor, key) = (&one.row.signature, Anchor::Chain(one.row.digest), &one.key);
    let stranger = SmKeyPair::generate(provider)?;
    let forged = provider.sign(&stranger.secret, &record::signed_bytes(&one.expected.domain, &one.row.digest))?;
    let (resigned, signature, digest) = one.resigned(provider)?;
    let wrong_key = one.open(provider, (&one.blob, own), anchor, &TopicKey::generate()?);
    let passed = [
        // Another genuine record in its place: only the comparison with the chain can tell.
        ("digest", one.open(provider, (&other.blob, &other.row.signature), anchor, key).is_ok()),
        ("signature", one.open(provider, (&one.blob, &forged), anchor, key).is_ok()),
        ("commit", !matches!(wrong_key, Err(CryptoError::WrongKey))),
        ("tag", one.open(provider, (&resigned, &signature), Anchor::Chain(digest), key).is_ok()),
    ];
    Ok(passed.into_iter().filter(|(_, passed)| *passed).map(|(check, _)| check).collect())
}

/// A record sealed and signed by the owner that was never anchored, as a row that claims it was.
pub fn never_anchored(plant: &Plant, one: &Genuine) -> Result<(RecordRow, Vec<u8>), Failure> {
    let opened = one.open(plant.provider, (&one.blob, &one.row.signature), Anchor::Unanchored, &one.key)?;
    let OpenedRecord { header, head, body, .. } = opened;
    let head = Head { compression: Compression::None, ..head };
    let request = SealRequest {
        domain: header.domain,
        owner: header.owner,
        signer: &one.pair,
        epoch: header.epoch,
        topic_key: &one.key,
        recorder: header.recorder.prefix(),
        seq: header.seq,
        topic_id: header.topic_id,
        kind: header.kind,
        filters: header.filters,
        captured_at: header.captured_at,
        head: &head,
        body: &body,
    };
    let sealed = seal(plant.provider, &request)?;
    let row = RecordRow { digest: sealed.digest, signature: sealed.signature, ..one.row.clone() };
    Ok((row, sealed.blob))
}

#[cfg(test)]
mod secrets;

#[cfg(test)]
mod tests;
