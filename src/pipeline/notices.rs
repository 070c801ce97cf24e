//! Notices of an owner to its robots: the keys of a new epoch, sealed for one device, signed by d_C and numbered.
//! The robot's end: subscribes at its gateway, takes what is newer than what it has, keeps it, obeys it.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use tokio::task::block_in_place;

use crate::crypto::{Anchor, Expected, IssuedKeys, Provider, SealedEnrolment, notice_topic, open, topic_id};
use crate::gateway::{Client, Entry, Fetched, GatewayError, Query, Selection};
use crate::model::{Header, RecordKind, Timestamp, clean};

use super::forwarder::{Errand, ForwardError};
use super::{Author, Observer, PipelineError};

/// Between two looks through the whole list, in case that a subscription missed something.
const LOOK: Duration = Duration::from_secs(300);
/// Entries of one page.
const PAGE: u16 = 100;

/// A robot's ear for its owner.
pub struct Notices {
    provider: &'static dyn Provider,
    observer: Arc<dyn Observer>,
    author: Arc<Author>,
    sealed: SealedEnrolment,
    /// Where the enrolment is kept with what was told since.
    kept: PathBuf,
    subscribed: bool,
    looked: Option<Instant>,
}

impl Notices {
    /// For the robot of an enrolment, whose records `author` seals.
    pub fn new(
        provider: &'static dyn Provider,
        observer: Arc<dyn Observer>,
        author: Arc<Author>,
        sealed: SealedEnrolment,
        kept: PathBuf,
    ) -> Self {
        Self { provider, observer, author, sealed, kept, subscribed: false, looked: None }
    }

    fn selection(&self) -> Selection {
        let enrolment = &self.sealed.enrolment;
        let topic = topic_id(&enrolment.index, &notice_topic(&enrolment.device_id()));
        Selection { owner: enrolment.owner, topic_id: Some(topic), kind: Some(RecordKind::Key), filters: Vec::new() }
    }

    /// Whether an entry is a notice to this device that tells more than the newest one taken.
    fn is_newer(&self, entry: &Entry) -> bool {
        let (enrolment, selection) = (&self.sealed.enrolment, self.selection());
        if (Some(entry.kind), Some(entry.topic_id)) != (selection.kind, selection.topic_id) {
            return false;
        }
        let epoch = enrolment.keys.now.epoch;
        match enrolment.noticed {
            Some((recorder, number)) if recorder == entry.recorder => entry.seq > number && entry.epoch >= epoch,
            Some(_) => entry.epoch > epoch,
            None => entry.epoch >= epoch,
        }
    }

    /// Looks through the list for the newest notice, and takes it.
    async fn look(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        let (until, selection) = (Timestamp(u64::MAX), self.selection());
        let mut query = Query { selection, from: Timestamp(0), until, cursor: 0, limit: PAGE };
        let mut newest: Option<Entry> = None;
        loop {
            let page = client.query(&query).await?;
            let newer = page.entries.into_iter().filter(|entry| self.is_newer(entry));
            newest = newer.chain(newest).max_by_key(|entry| (entry.epoch, entry.seq));
            let Some(next) = page.next else { break };
            query.cursor = next;
        }
        if let Some(entry) = newest {
            let record = client.fetch(&entry.digest).await?;
            self.hear(&entry, &record);
        }
        self.looked = Some(Instant::now());
        Ok(())
    }

    /// Takes a notice that is the owner's, for this device, and newer; anything else changes nothing.
    fn hear(&mut self, entry: &Entry, record: &Fetched) {
        if !self.is_newer(entry) {
            return;
        }
        match self.opened(record) {
            Ok((header, keys)) => {
                if let Err(error) = self.obey(&header, keys) {
                    self.observer.alert(true, format!("the owner's new keys cannot be kept: {error}"));
                }
            }
            Err(error) => {
                let text = format!("a notice that is not the owner's, or not for this robot, was passed over: {error}");
                self.observer.alert(true, clean(&text, 300));
            }
        }
    }

    fn opened(&self, record: &Fetched) -> Result<(Header, IssuedKeys), PipelineError> {
        let enrolment = &self.sealed.enrolment;
        let name = notice_topic(&enrolment.device_id());
        let expected = Expected {
            topic_id: Some(topic_id(&enrolment.index, &name)),
            topic: Some(name),
            ..Expected::any_of(enrolment.domain, enrolment.owner)
        };
        let (signature, signer, key) = (&record.signature, &enrolment.owner_key, &enrolment.notice_key);
        let opened = open(self.provider, &record.blob, signature, signer, Anchor::Unanchored, key, &expected)?;
        let body = zeroize::Zeroizing::new(opened.body);
        let keys = IssuedKeys::parse(&body)
            .map_err(|why| crate::crypto::CryptoError::Malformed { what: "owner's notice", why })?;
        let fits = opened.header.kind == RecordKind::Key && keys.now.epoch == opened.header.epoch;
        if fits { Ok((opened.header, keys)) } else { Err(PipelineError::Refused("it is no notice of keys".to_owned())) }
    }

    fn obey(&mut self, header: &Header, keys: IssuedKeys) -> Result<(), PipelineError> {
        let epoch = keys.now.epoch;
        self.sealed.enrolment.noticed = Some((header.recorder, header.seq));
        self.sealed.enrolment.keys = keys;
        // Obeyed even where it cannot be kept: a restart hears it again.
        self.author.obey(&self.sealed.enrolment);
        block_in_place(|| self.sealed.save(&self.kept))?;
        self.observer.alert(false, format!("the owner sent the keys of epoch {epoch}; records are sealed under it"));
        Ok(())
    }
}

#[async_trait]
impl Errand for Notices {
    async fn begin(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        self.subscribed = false;
        self.looked = None;
        self.run(client).await
    }

    async fn run(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        if !self.subscribed {
            client.subscribe(&self.selection()).await?;
            self.subscribed = true;
        }
        if self.looked.is_none_or(|at| at.elapsed() > LOOK) {
            self.look(client).await?;
        }
        loop {
            match client.next_event(Duration::ZERO).await {
                Ok((_, entry, record)) => self.hear(&entry, &record),
                Err(GatewayError::TimedOut) => return Ok(()),
                // The subscription ended; what it missed is in the list.
                Err(GatewayError::Refused(code)) if !code.ends_session() => {
                    self.subscribed = false;
                    self.looked = None;
                    return Ok(());
                }
                Err(error) => return Err(error.into()),
            }
        }
    }
}
