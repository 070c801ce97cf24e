//! `authros tour --plain`: the paper's crime-scene mission in counted figures. Robots take odometry and pictures, CURA A shares
//! them with CURA B, a stranger and a forger are refused, B is revoked.

mod mission;

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{collections::HashSet, path::Path};

use authros_output::Output;
use serde::Serialize;

use self::mission::Mission;
use super::connect::{Context, environment};
use super::parse::usage;
use crate::crypto::{
    Anchor, CryptoError, Expected, Names, OpenedRecord, Provider, SealRequest, SmKeyPair, TopicKey, open, record, seal,
};
use crate::model::{Digest, ErrorKind, Head, Signature, head::Compression};
use crate::pipeline::{Network, Owner, Plant, reader::Reader};
use crate::ros::{Capture, CaptureNotice, CaptureOptions, Message, MessageSink, ros2::Ros2Capture};
use crate::{config::Config, crypto::sm3::sm3, paths::Home, service::Failure, store::RecordRow};

/// Robots of ROS 2 without `--robots`.
const USUAL_ROBOTS: u16 = 4;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Work {
    pub transactions: u64,
    pub gas: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Story {
    pub captured: u64,
    pub anchored: u64,
    /// Re-read and checked against the chain.
    pub verified: u64,
    pub opened_by_grantee: u64,
    pub refused_stranger: bool,
    /// The flipped bit and every forgery, each by its own check.
    pub refused_tampered: bool,
    /// With any key that CURA B kept.
    pub opened_after_revoke: u64,
    /// Byte-identical to what the robot sent.
    pub restored_images: u64,
    /// In transport or in the recorder.
    pub lost: u64,
    pub chain: Work,
    pub ok: bool,
}

pub async fn run(mut context: Context, seconds: u64, output: &Output) -> Result<u8, Failure> {
    if context.config.robots == 0 && context.global.ros2.is_none() {
        return Err(usage("the mission needs robots; use --robots 1 to 32 and no real ROS master"));
    }
    let temporary = match context.global.home {
        Some(_) => None,
        None => Some(temporary_home(&mut context, "authros-demo-")?),
    };
    // Nobody is to type the passphrases of the people in it.
    context.global.store_passphrase = true;
    let robots = robots_of(&mut context);
    let mission = Mission::start(&context, robots, seconds, *output).await?;
    let told = mission.run().await;
    drop(temporary);
    let story = told?;
    output.result(&story, || text(&story));
    Ok(if story.ok { 0 } else { ErrorKind::Internal.exit_code() })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Robots {
    pub number: u16,
    /// `None`: the embedded master of ROS 1.
    pub domain: Option<u16>,
}

/// In a ROS 2 domain, the site's master gets no robots: one name is captured from one graph.
fn robots_of(context: &mut Context) -> Robots {
    if context.global.ros2.is_none() {
        return Robots { number: context.config.robots, domain: None };
    }
    let number = std::mem::take(&mut context.config.robots);
    let number = if number == 0 { USUAL_ROBOTS } else { number };
    Robots { number, domain: context.config.ros_domain }
}

/// Gives a context default settings and a home that is removed with the value.
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
    context.config = Config::resolve(&|name| global.setting(name), &environment, None)?;
    // Forgeries are written to the disk and must be noticed there.
    (context.config.cache_url, context.config.store_url) = (None, None);
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

/// Time for the listener to receive a message.
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

/// Listens until dropped.
enum Ear {
    One(#[expect(dead_code, reason = "ends with it")] Capture),
    Two(#[expect(dead_code, reason = "ends with it")] Ros2Capture),
}

pub struct Listener {
    hashes: Arc<Hashes>,
    topics: Vec<String>,
    _ear: Ear,
}

impl Listener {
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

    pub fn start_in(domain: u16, program: Option<&Path>, topics: &[String]) -> Result<Self, Failure> {
        let hashes = Arc::new(Hashes::default());
        let capture = Ros2Capture::start(domain, program, hashes.clone())?;
        for topic in topics.iter().filter_map(|topic| topic.parse().ok()) {
            capture.watch(&topic);
        }
        Ok(Self { hashes, topics: topics.to_vec(), _ear: Ear::Two(capture) })
    }

    /// Waits for a message on every topic, so that nothing captured from now on is missed.
    pub fn listen(&self) {
        let end = Instant::now() + PATIENCE;
        let heard = || self.hashes.heard.lock().unwrap_or_else(PoisonError::into_inner);
        while !self.topics.iter().all(|topic| heard().contains(topic.as_str())) && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits for a message that is not received yet.
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

pub struct Genuine {
    row: RecordRow,
    blob: Vec<u8>,
    key: TopicKey,
    pair: SmKeyPair,
    expected: Expected,
}

impl Genuine {
    pub fn take(plant: &Plant, network: &Network, owner: &Owner, row: RecordRow) -> Result<Self, Failure> {
        let missing = || crate::pipeline::PipelineError::Missing(row.id.clone());
        let blob = plant.ciphertext.get(row.digest)?.ok_or_else(missing)?;
        let key = Reader { plant, network, reader: owner }.topic_key(&row)?;
        let expected = Expected::any_of(network.domain, owner.address, Names::Derived(owner.index()));
        Ok(Self { blob, key, pair: owner.signing(), expected, row })
    }

    /// Opens other bytes as if they were its own.
    fn open(
        &self,
        provider: &dyn Provider,
        (blob, signature): (&[u8], &Signature),
        anchor: Anchor,
        key: &TopicKey,
    ) -> Result<OpenedRecord, CryptoError> {
        open(provider, blob, signature, &self.pair.public, anchor, key, &self.expected)
    }

    /// Flips a bit, signs again and anchors: only the tag can detect it.
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

/// The checks that let their forgery pass.
pub fn broken(provider: &dyn Provider, one: &Genuine, other: &Genuine) -> Result<Vec<&'static str>, Failure> {
    let (own, anchor, key) = (&one.row.signature, Anchor::Chain(one.row.digest), &one.key);
    let stranger = SmKeyPair::generate(provider)?;
    let forged = provider.sign(&stranger.secret, &record::signed_bytes(&one.expected.domain, &one.row.digest))?;
    let (resigned, signature, digest) = one.resigned(provider)?;
    let wrong_key = one.open(provider, (&one.blob, own), anchor, &TopicKey::generate()?);
    let passed = [
        // Another genuine record: only the comparison with the chain can detect it.
        ("digest", one.open(provider, (&other.blob, &other.row.signature), anchor, key).is_ok()),
        ("signature", one.open(provider, (&one.blob, &forged), anchor, key).is_ok()),
        ("commit", !matches!(wrong_key, Err(CryptoError::WrongKey))),
        ("tag", one.open(provider, (&resigned, &signature), Anchor::Chain(digest), key).is_ok()),
    ];
    Ok(passed.into_iter().filter(|(_, passed)| *passed).map(|(check, _)| check).collect())
}

/// A sealed and signed record that was never anchored; its row claims it was.
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
