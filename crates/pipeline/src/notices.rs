//! A robot's side of its owner's notices, which are sealed for one device, signed by d_C and numbered: it follows the
//! feed, takes notices newer than those it has, saves them and applies them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{path::PathBuf, sync::Arc};

use async_trait::async_trait;
use tokio::{sync::watch, task::block_in_place};

use crate::crypto::{
    Anchor, Enrolment, Expected, Fingerprint, GatewayAccess, IssuedKeys, LastNotice, Names, Notice, Provider,
    SealedEnrolment, SignedPolicy, notice_topic, open,
};
use crate::forwarder::{Errand, ForwardError};
use crate::gateway::{Client, Code, Feed, FeedEntry, Fetched, GatewayError};
use crate::model::{Header, RecordKind, RecorderId, RingSpan, Signature, Timestamp, clean};
use crate::{Author, Observer, PipelineError, Result, disk_ring, store::Notes};

/// How long to wait after a gateway could not tell who may read, or a notice could not be stored.
const AGAIN: Duration = Duration::from_secs(2);
/// The shortest time between two looks: records that are uploaded need not wait for more.
const LOOK: Duration = Duration::from_secs(1);
/// Pages read in one look.
const MOST_PAGES: usize = 32;
/// The most notices remembered before they are taken.
const MOST_NEWER: usize = 1024;

/// Takes policies whose signer was checked with the record.
pub trait PolicyTaker: Send + Sync {
    /// Keeps a policy, or why it is refused; what was done, in words.
    fn take(&self, policy: &SignedPolicy) -> Result<String>;
}

pub struct Notices {
    provider: &'static dyn Provider,
    observer: Arc<dyn Observer>,
    author: Arc<Author>,
    sealed: SealedEnrolment,
    /// Where the enrolment is stored with later changes.
    kept: PathBuf,
    /// Changes when the owner has named other addresses of the gateway.
    gateway: watch::Sender<GatewayAccess>,
    /// Records requests to the ring, where this robot has one.
    ring: Option<Notes>,
    has_ring: Arc<AtomicBool>,
    policies: Arc<dyn PolicyTaker>,
    /// Where it is in the gateway's feed; it begins anew with each start.
    follow: Feed,
    /// Announced and not taken yet.
    newer: Vec<FeedEntry>,
    /// No requests before this.
    rests_until: Option<Instant>,
}

impl Notices {
    pub fn new(
        provider: &'static dyn Provider,
        observer: Arc<dyn Observer>,
        author: Arc<Author>,
        sealed: SealedEnrolment,
        kept: PathBuf,
        policies: Arc<dyn PolicyTaker>,
    ) -> Self {
        let gateway = watch::channel(sealed.enrolment.gateway.clone()).0;
        let (kind, topics) = (Some(RecordKind::Key), vec![sealed.enrolment.notice_id]);
        let follow = Feed { kind, topics, ..Feed::of(sealed.enrolment.owner) };
        Self {
            provider,
            observer,
            author,
            sealed,
            kept,
            gateway,
            ring: None,
            has_ring: Arc::new(AtomicBool::new(true)),
            policies,
            follow,
            newer: Vec::new(),
            rests_until: None,
        }
    }

    pub fn gateway(&self) -> watch::Receiver<GatewayAccess> {
        self.gateway.subscribe()
    }

    pub fn with_ring(self, notes: Notes) -> Self {
        Self { ring: Some(notes), ..self }
    }

    /// For a robot whose ring comes and goes with its policy.
    pub fn with_ring_while(self, notes: Notes, has_ring: &Arc<AtomicBool>) -> Self {
        Self { has_ring: Arc::clone(has_ring), ..self.with_ring(notes) }
    }

    fn may_be_newer(&self, entry: &FeedEntry) -> bool {
        let is_notice = (entry.kind, entry.topic_id) == (RecordKind::Key, self.sealed.enrolment.notice_id);
        is_notice && self.is_newer((entry.recorder, entry.seq, entry.epoch), entry.captured_at)
    }

    /// A restored home is another recorder and numbers from 1: then the owner's signed time decides, so that nothing
    /// old is new.
    fn is_newer(&self, (recorder, seq, epoch): (RecorderId, u64, u64), at: Timestamp) -> bool {
        let enrolment = &self.sealed.enrolment;
        let known = enrolment.keys.now.epoch;
        match enrolment.last_notice {
            Some(last) if last.recorder == recorder => seq > last.number && epoch >= known,
            Some(last) => epoch > known || epoch == known && at > last.at,
            None => epoch >= known,
        }
    }

    /// At the feed's end takes newer notices in order: they may be of several kinds. What could not be taken is only
    /// tried again.
    async fn look(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        self.rest(LOOK);
        for _ in 0..MOST_PAGES {
            let page = client.feed(&self.follow).await?;
            if self.follow.after(&page) {
                self.newer.clear();
            }
            let newer: Vec<FeedEntry> = page.entries.into_iter().filter(|entry| self.may_be_newer(entry)).collect();
            self.newer.extend(newer);
            if page.upto == page.head || self.newer.len() >= MOST_NEWER {
                return self.take_newer(client).await;
            }
        }
        self.rests_until = None;
        Ok(())
    }

    async fn take_newer(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        let last = self.sealed.enrolment.last_notice.map(|last| last.recorder);
        self.newer.sort_unstable_by_key(|entry| {
            let is_other = last.is_some_and(|last| last != entry.recorder);
            std::cmp::Reverse((entry.epoch, is_other, if is_other { entry.captured_at.0 } else { 0 }, entry.seq))
        });
        while let Some(entry) = self.newer.last().cloned() {
            let is_done = match client.records(&[entry.digest]).await?.pop() {
                Some(Ok(record)) => self.hear(&entry, &record),
                // Its bytes are gone there, and with them what it says; its owner sends another one.
                Some(Err(GatewayError::Refused(Code::NotFound))) => true,
                // Altered on the way, or there: that must not stop what is uploaded.
                Some(Err(_)) | None => false,
            };
            if !is_done {
                // Those behind it would count as newer, and it would never be taken.
                self.rest(AGAIN);
                return Ok(());
            }
            self.newer.pop();
        }
        Ok(())
    }

    fn rest(&mut self, pause: Duration) {
        self.rests_until = Some(Instant::now() + pause);
    }

    /// Takes a notice if it is the owner's, for this device, and newer. Returns whether it is dealt with: one that
    /// could not be stored has to be heard again before those behind it.
    pub(super) fn hear(&mut self, entry: &FeedEntry, record: &Fetched) -> bool {
        if !self.may_be_newer(entry) {
            return true;
        }
        match self.opened(record) {
            Ok((header, notice)) => {
                let before = self.sealed.enrolment.clone();
                let Err(error) = self.obey(&header, notice) else { return true };
                self.sealed.enrolment = before;
                // What this robot will not do is not better the next time.
                if matches!(error, PipelineError::Refused(_)) {
                    return self.ignore(&error);
                }
                self.observer.alert(true, format!("the owner's notice cannot be stored: {error}"));
                false
            }
            Err(error) => self.ignore(&error),
        }
    }

    fn ignore(&self, error: &PipelineError) -> bool {
        let text = format!("ignored a notice that is not from the owner or not for this robot: {error}");
        self.observer.alert(true, clean(&text, 300));
        true
    }

    fn opened(&self, record: &Fetched) -> Result<(Header, Notice)> {
        let (header, notice) = open_notice(self.provider, &self.sealed.enrolment, &record.blob, &record.signature)?;
        // The entry is the gateway's word; only the signed header's number tells an old notice from a new one.
        if !self.is_newer((header.recorder, header.seq, header.epoch), header.captured_at) {
            return Err(PipelineError::Refused("it is an old notice that the gateway presents as new".to_owned()));
        }
        Ok((header, notice))
    }

    fn obey(&mut self, header: &Header, notice: Notice) -> Result<()> {
        let enrolment = &mut self.sealed.enrolment;
        let told = match notice {
            Notice::Keys(keys) => {
                let told = told(&enrolment.keys, &keys);
                enrolment.keys = keys;
                // Applied even if it cannot be saved: after a restart it is received again.
                self.author.obey(enrolment);
                told
            }
            Notice::OwnerKey(change) => {
                enrolment.owner_key = change.new;
                let fingerprint = Fingerprint::of(&change.new);
                format!("the owner's SM2 key is now {fingerprint}; the old key and the account signed the change")
            }
            Notice::Addresses(list) => {
                if list.gateway != enrolment.gateway.fingerprint {
                    return Err(PipelineError::Refused("it is about another gateway than this robot's".to_owned()));
                }
                let told = format!("the gateway's addresses are now {}", clean(&list.addresses.join(", "), 300));
                enrolment.gateway.addresses = list.addresses;
                told
            }
            Notice::Pull(span) => {
                let ring = self.ring.as_ref().filter(|_| self.has_ring.load(Ordering::Acquire));
                asked(ring, header.seq, &span)?
            }
            Notice::Policy(policy) => block_in_place(|| self.policies.take(&policy))?,
            Notice::Unknown(kind) => {
                let text = format!("the owner sent a notice of unknown kind {kind}; update this program");
                self.observer.alert(true, text);
                // Not counted as taken: a later version is to take it.
                return Ok(());
            }
        };
        let Header { recorder, seq: number, captured_at: at, .. } = *header;
        enrolment.last_notice = Some(LastNotice { recorder, number, at });
        block_in_place(|| self.sealed.save(&self.kept))?;
        self.observer.alert(false, told);
        let gateway = &self.sealed.enrolment.gateway;
        self.gateway.send_if_modified(|known| {
            let changed = known != gateway;
            known.clone_from(gateway);
            changed
        });
        Ok(())
    }
}

/// Fails if the record is not the owner's, not for this device, or no notice.
pub fn open_notice(
    provider: &dyn Provider,
    enrolment: &Enrolment,
    blob: &[u8],
    signature: &Signature,
) -> Result<(Header, Notice)> {
    let names = Names::Given(notice_topic(&enrolment.device_id()));
    let expected =
        Expected { topic_id: Some(enrolment.notice_id), ..Expected::any_of(enrolment.domain, enrolment.owner, names) };
    let (signer, key) = (&enrolment.owner_key, &enrolment.notice_key);
    let opened = open(provider, blob, signature, signer, Anchor::Unanchored, key, &expected)?;
    let body = zeroize::Zeroizing::new(opened.body);
    let notice =
        Notice::parse(&body).map_err(|why| crate::crypto::CryptoError::Malformed { what: "owner's notice", why })?;
    let fits = match &notice {
        Notice::Keys(keys) => keys.now.epoch == opened.header.epoch,
        Notice::OwnerKey(change) => {
            change.check(provider, &enrolment.domain, &enrolment.owner, &enrolment.owner_key)?;
            true
        }
        Notice::Addresses(list) => {
            list.check(&enrolment.domain, &enrolment.owner, &enrolment.device_id())?;
            true
        }
        // The taker checks a policy: its refusal is to reach the owner.
        Notice::Pull(_) | Notice::Policy(_) | Notice::Unknown(_) => true,
    };
    if fits && opened.header.kind == RecordKind::Key {
        return Ok((opened.header, notice));
    }
    Err(PipelineError::Refused("it is not a notice to a robot".to_owned()))
}

/// Notes the request before the notice counts as taken.
fn asked(ring: Option<&Notes>, number: u64, span: &RingSpan) -> Result<String> {
    let RingSpan { since, until, .. } = span;
    let Some(notes) = ring else {
        return Ok(format!(
            "the owner requests unwatched data from {since} to {until}, but this robot keeps no ring; set ring.keep \
             and ring.topics to keep one"
        ));
    };
    block_in_place(|| disk_ring::ask(notes, number, span))?;
    Ok(format!("the owner requests what the ring has from {since} to {until}; it is moved to the outbox"))
}

fn told(before: &IssuedKeys, after: &IssuedKeys) -> String {
    let (epoch, known) = (after.now.epoch, before.now.key.topics().unwrap_or_default());
    let new: Vec<String> = after.now.key.topics().unwrap_or_default();
    let new: Vec<&str> = new.iter().filter(|topic| !known.contains(topic)).map(String::as_str).collect();
    if new.is_empty() {
        return format!("the owner sent the keys of epoch {epoch}; new records are sealed with them");
    }
    let topics = clean(&new.join(", "), 200);
    format!("the owner sent the keys of epoch {epoch}, including those of {topics}, which is now captured")
}

#[async_trait]
impl Errand for Notices {
    async fn begin(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        self.rests_until = None;
        self.run(client).await
    }

    async fn run(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        if self.rests_until.is_some_and(|until| Instant::now() < until) {
            return Ok(());
        }
        match self.look(client).await {
            // Such a gateway does not know its chain now and answers nobody, but still takes records.
            Err(ForwardError::Gateway(GatewayError::Refused(Code::Stale))) => {
                self.rest(AGAIN);
                Ok(())
            }
            done => done,
        }
    }
}
