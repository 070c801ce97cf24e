//! Captures with an end: a count, a duration, or a command; answered when all is verified.

pub(super) mod ros;
#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use self::ros::GraphOf;
use crate::model::{
    ProfileName, Sampling, Timestamp, TopicName, TopicPattern, TopicRule, TypeName, WatchRule, WatchRules, clean,
    counted, locked, natural, pinned_name,
};
use crate::pipeline::disk_ring::SharedRing;
use crate::pipeline::sealer::Sealer;
use crate::pipeline::{CaptureSession, CapturedMessage, Losses, Owner, Recorder, Rings};
use crate::reply::{
    CaptureSummary, HeldUp, PolicyRow, PolicyView, Result, TopicRow, TopicSummary, UnreachedView, input, refused,
};
use crate::site::{Parts, Pinning, Profiles, RosSide};
use crate::store::TopicCounts;
use crate::store::notes::Watched;

const TICK: Duration = Duration::from_millis(50);

pub(in crate::site) struct Capture {
    parts: Parts,
    recorder: Arc<Recorder>,
    losses: Arc<Losses>,
    ros: Arc<RosSide>,
    watches: Arc<Watches>,
    profiles: Arc<Profiles>,
    pins: Arc<Pinning>,
    running: Mutex<Vec<(ProfileName, Arc<CaptureSession>)>>,
}

impl Capture {
    pub fn new(
        parts: &Parts,
        recorder: &Arc<Recorder>,
        losses: &Arc<Losses>,
        ros: &Arc<RosSide>,
        watches: &Arc<Watches>,
        profiles: &Arc<Profiles>,
        pins: &Arc<Pinning>,
    ) -> Self {
        let (recorder, losses, ros) = (Arc::clone(recorder), Arc::clone(losses), Arc::clone(ros));
        let (watches, profiles, pins) = (Arc::clone(watches), Arc::clone(profiles), Arc::clone(pins));
        Self { parts: parts.clone(), recorder, losses, ros, watches, profiles, pins, running: Mutex::default() }
    }

    pub async fn capture(
        &self,
        owner: &Arc<Owner>,
        topics: &[TopicName],
        type_name: Option<TypeName>,
        count: Option<u64>,
        milliseconds: Option<u64>,
        tags: Vec<(String, String)>,
    ) -> Result<CaptureSummary> {
        if topics.is_empty() {
            return Err(input("a capture needs at least one topic; name it with --topic"));
        }
        if self.parts.config.site.is_some() {
            return Err(refused(
                "this home joined a gateway with --site and captures nothing; capture at the gateway's home, or enrol a robot \
                 there and run its agent here (`authros robot enrol`)",
            ));
        }
        self.ros.any_now().await?;
        if owner.sealing().is_none() {
            self.profiles.register(owner).await?;
        } else {
            // Verified records need a chain: fail now.
            self.parts.link.network().await?;
        }
        let names: Vec<String> = topics.iter().map(ToString::to_string).collect();
        let listed = names.join(" ");
        let session = Arc::new(CaptureSession::new(&names, count, tags));
        let started = async {
            names.iter().for_each(|topic| self.recorder.join(topic, &owner.author, type_name.clone(), &session));
            self.note(&owner.profile, &session);
            self.ros.wishes_changed();
            Ok(())
        };
        self.parts.log.deed(&owner.profile, "capture start", &listed, started).await?;
        let length = milliseconds.map_or(Duration::MAX, Duration::from_millis);
        tokio::select! {
            () = session.closed() => {}
            () = self.last(length, topics, &session) => {}
            () = self.parts.life.stopped() => {}
        }
        names.iter().for_each(|topic| self.ros.second.settle(Some(topic)));
        session.close();
        let unreached = self.ros.unreached();
        names.iter().for_each(|topic| self.recorder.leave(topic, &owner.author, &session));
        self.forget(&session);
        self.ros.wishes_changed();
        let captured: u64 = session.figures().iter().map(|topic| topic.captured).sum();
        let ended =
            self.parts.log.write(&owner.profile, "capture stop", &listed, &format!("{captured} captured")).await;
        session.settled().await;
        if let Err(failure) = ended {
            self.parts.hub.alarm(&failure.message);
        }
        Ok(summary(&session, unreached))
    }

    /// Waits longer for the first message of a latched ROS 2 topic.
    async fn last(&self, asked: Duration, topics: &[TopicName], session: &CaptureSession) {
        let begun = Instant::now();
        tokio::time::sleep(asked).await;
        let least = self.ros.second.least(topics);
        while begun.elapsed() < least && session.figures().iter().all(|topic| topic.captured == 0) {
            tokio::time::sleep(TICK).await;
        }
    }

    pub fn note(&self, profile: &ProfileName, session: &Arc<CaptureSession>) {
        let mut running = locked(&self.running);
        running.push((profile.clone(), Arc::clone(session)));
    }

    pub fn forget(&self, session: &Arc<CaptureSession>) {
        let mut running = locked(&self.running);
        running.retain(|(_, other)| !Arc::ptr_eq(other, session));
    }

    pub fn stop(&self, profile: &ProfileName) {
        self.ros.second.settle(None);
        let captures = locked(&self.running);
        captures.iter().filter(|(owner, _)| owner == profile).for_each(|(_, session)| session.close());
    }
}

fn summary(session: &CaptureSession, mut unreached: HashMap<String, Vec<UnreachedView>>) -> CaptureSummary {
    let figures = session.figures();
    let skipped = figures.iter().map(|topic| topic.skipped).sum();
    let topics: Vec<TopicSummary> = figures
        .into_iter()
        .map(|figures| TopicSummary {
            unreached: unreached.remove(&figures.topic).unwrap_or_default(),
            topic: figures.topic,
            type_name: figures.type_name.map(|name| crate::model::clean(&name, 255)),
            captured: figures.captured,
            verified: figures.verified,
            quarantined: figures.quarantined,
            lost: figures.lost,
        })
        .collect();
    let sum = |each: fn(&TopicSummary) -> u64| topics.iter().map(each).sum();
    CaptureSummary {
        captured: sum(|topic| topic.captured),
        verified: sum(|topic| topic.verified),
        quarantined: sum(|topic| topic.quarantined),
        lost: sum(|topic| topic.lost),
        skipped,
        topics,
    }
}

pub(in crate::site) struct SealerThread {
    parts: Parts,
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    ring: Arc<OnceLock<SharedRing>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl SealerThread {
    pub fn new(parts: &Parts, rings: &Arc<Rings<CapturedMessage>>, losses: &Arc<Losses>) -> Self {
        let (parts, rings, losses) = (parts.clone(), Arc::clone(rings), Arc::clone(losses));
        Self { parts, rings, losses, ring: Arc::default(), thread: Mutex::default() }
    }

    pub fn fill(&self, ring: &SharedRing) {
        drop(self.ring.set(Arc::clone(ring)));
    }

    /// A run that captures nothing may still import.
    pub fn begin(&self) -> Result<()> {
        let mut thread = locked(&self.thread);
        if thread.is_some() || self.rings.is_closed() {
            return Ok(());
        }
        self.take_over();
        let (plant, hub, losses) = (self.parts.plant.clone(), Arc::clone(&self.parts.hub), Arc::clone(&self.losses));
        let (rings, ring, compression) =
            (Arc::clone(&self.rings), Arc::clone(&self.ring), self.parts.config.compression);
        *thread = Some(self.parts.supervisor.keep_thread("sealer", move || {
            let sealer = Sealer::new(plant.clone(), Arc::clone(&hub.sessions), Arc::clone(&losses));
            let sealer = sealer.with_ring(Arc::clone(&ring));
            let mut sealer = if compression { sealer } else { sealer.without_compression() };
            sealer.run(&rings, &|| hub.stored.notify_waiters());
        })?);
        Ok(())
    }

    /// Counts messages that died in memory with the previous process, while its disk was full.
    fn take_over(&self) {
        let text = match self.losses.keep_in(&self.parts.home.waiting(), &self.parts.plant) {
            Ok(0) => return,
            Ok(count) => format!(
                "{} waited in memory for a full disk when this site last ended: lost, as gap records report",
                counted(count, "message")
            ),
            Err(error) => format!("what waits in memory for a full disk will not be counted after a crash: {error}"),
        };
        self.parts.hub.warn(&text);
    }

    pub async fn finish(&self, patience: Duration) -> bool {
        self.rings.close();
        let thread = locked(&self.thread).take();
        let Some(thread) = thread else { return true };
        let joined = tokio::task::spawn_blocking(move || thread.join());
        tokio::time::timeout(patience, joined).await.is_ok()
    }
}

pub(in crate::site) struct Watches {
    parts: Parts,
    recorder: Arc<Recorder>,
    ros: Arc<RosSide>,
    /// Profiles whose capture is paused.
    held: Mutex<HashSet<ProfileName>>,
}

impl Watches {
    pub fn new(parts: &Parts, recorder: &Arc<Recorder>, ros: &Arc<RosSide>) -> Self {
        let (recorder, ros) = (Arc::clone(recorder), Arc::clone(ros));
        Self { parts: parts.clone(), recorder, ros, held: Mutex::default() }
    }

    pub fn of(&self, profile: &ProfileName) -> Result<WatchRules> {
        Ok(self.parts.plant.ledger.notes.read(&Watched { profile: profile.clone() })?.unwrap_or_default())
    }

    pub fn change(&self, profile: &ProfileName, change: impl FnOnce(&mut WatchRules)) -> Result<()> {
        self.parts.plant.ledger.notes.change(&Watched { profile: profile.clone() }, |rules: &mut WatchRules| {
            change(rules);
            Ok(())
        })
    }

    pub fn hold(&self, owner: &Owner) {
        locked(&self.held).insert(owner.profile.clone());
        self.recorder.set_watches(&owner.author, WatchRules::default());
        self.ros.wishes_changed();
    }

    pub fn restore(&self, owner: &Owner) -> Result<()> {
        locked(&self.held).remove(&owner.profile);
        self.apply(owner)
    }

    /// Captures what the profile's list says now, unless its capture is paused.
    pub fn apply(&self, owner: &Owner) -> Result<()> {
        if !locked(&self.held).contains(&owner.profile) {
            let rules = block_in_place(|| self.of(&owner.profile))?;
            self.recorder.set_watches(&owner.author, rules);
        }
        self.ros.wishes_changed();
        Ok(())
    }
}

impl Capture {
    pub async fn topics(&self, profile: &ProfileName) -> Result<Vec<TopicRow>> {
        let link = self.ros.any().await?;
        let watches = block_in_place(|| self.watches.of(profile))?;
        let now = Timestamp::now();
        let of_two = self.ros.second.topics();
        let in_two = |name: &str| of_two.iter().any(|topic| topic.name == name);
        let mut rows: Vec<TopicRow> = link
            .iter()
            .flat_map(|link| link.topics())
            .filter(|info| !(in_two(&info.name) && self.ros.second.graph_of(info) == GraphOf::Two))
            .map(|info| {
                let simulated = info.publishers.iter().any(|publisher| self.recorder.is_simulated(publisher));
                self.topic_row(&info.name, info.type_name.as_deref(), &info.publishers, simulated, now)
            })
            .collect();
        for topic in &of_two {
            if !rows.iter().any(|row| row.topic == topic.name) {
                let row = self.topic_row(&topic.name, Some(&topic.type_name), &topic.publishers, false, now);
                let type_hash = topic.type_hash.as_deref().map(|hash| clean(hash, 80));
                rows.push(TopicRow { ros: 2, type_hash, qos: Some(topic.quality_text()), ..row });
            }
        }
        let published: HashSet<String> = rows.iter().map(|row| row.topic.clone()).collect();
        for WatchRule { pattern, type_name, .. } in watches.named() {
            if !published.contains(pattern.as_str()) {
                let type_name = type_name.as_ref().map(TypeName::as_str);
                rows.push(self.topic_row(pattern.as_str(), type_name, &[], false, now));
            }
        }
        let captured = self.captured_by_topic(profile)?;
        let alarms = self.pins.alarmed_topics(profile)?;
        let pins = self.pins.pinned_names(profile)?;
        let sealing = self.parts.owners.get(profile).filter(|owner| owner.sealing().is_some());
        let full = self.parts.plant.ledger.records.takes_records().is_err();
        let mut unreached = self.ros.unreached();
        for row in &mut rows {
            row.unreached = unreached.remove(&row.topic).filter(|_| row.ros == 1).unwrap_or_default();
            if let Some(pinned) = pins.get(&row.topic) {
                row.pins = pinned.len() as u64;
                row.unpinned =
                    row.publishers.iter().filter(|name| !pinned.contains(&*pinned_name(name))).cloned().collect();
            }
            if let Some(counts) = captured.get(&row.topic) {
                (row.messages, row.quarantined) = (counts.captured, counts.quarantined);
                (row.lost_in_transport, row.lost_in_recorder) = (counts.missed, counts.lost);
            }
            row.alarm = alarms.contains(&row.topic);
            let rule = watches.of(&row.topic);
            row.watched = rule.is_some();
            row.watched_type = rule.and_then(|rule| rule.type_name.clone());
            let of_settings = self.parts.config.topic_rules.of(&row.topic).map(|rule| rule.sampling());
            row.sampling = rule.and_then(|rule| rule.sampling).or(of_settings).unwrap_or_default();
            row.watched_by = rule.filter(|rule| !rule.pattern.is_plain()).map(|rule| rule.pattern.to_string());
            row.held_up = match &sealing {
                _ if !row.watched => None,
                Some(owner) => (full || !self.recorder.is_watched(&row.topic, owner.address)).then_some(HeldUp::Paused),
                None => Some(HeldUp::WaitsForKey),
            };
        }
        rows.sort_by(|one, other| natural(&one.topic, &other.topic));
        Ok(rows)
    }

    fn topic_row(
        &self,
        topic: &str,
        type_name: Option<&str>,
        publishers: &[String],
        simulated: bool,
        now: Timestamp,
    ) -> TopicRow {
        let rate = self.recorder.meter().rate(topic, now);
        TopicRow {
            topic: clean(topic, 255),
            ros: 1,
            type_name: type_name.map(|name| clean(name, 255)),
            publishers: publishers.iter().map(|publisher| clean(publisher, 255)).collect(),
            simulated,
            hz: rate.map(|rate| rate.hz),
            bytes_per_second: rate.map(|rate| rate.bytes_per_second),
            left_out: self.recorder.left_out(topic),
            last_message: rate.and_then(|rate| rate.last),
            ..TopicRow::default()
        }
    }

    fn captured_by_topic(&self, profile: &ProfileName) -> Result<HashMap<String, TopicCounts>> {
        let Ok(owner) = self.parts.owners.address_of(profile) else { return Ok(HashMap::new()) };
        let counts = block_in_place(|| self.losses.counts(&self.parts.plant, owner))?;
        Ok(counts.topics.into_iter().map(|topic| (topic.topic.clone(), topic)).collect())
    }

    pub async fn watch(
        &self,
        profile: &ProfileName,
        topic: TopicPattern,
        type_name: Option<TypeName>,
        sampling: Option<Sampling>,
    ) -> Result<()> {
        let listed = async { self.watches.change(profile, |rules| rules.watch(topic.clone(), type_name, sampling)) };
        let subject = sampling.map_or_else(|| topic.to_string(), |sampling| format!("{topic}: {sampling}"));
        self.parts.log.deed(profile, "watch", &subject, listed).await?;
        if let Some(owner) = self.parts.owners.get(profile) {
            if self.ros.is_wanted() && owner.sealing().is_none() {
                self.profiles.register(&owner).await?;
            }
            self.watches.apply(&owner)?;
        }
        Ok(())
    }

    pub async fn unwatch(&self, profile: &ProfileName, topic: &TopicPattern) -> Result<()> {
        let removed = async {
            let mut found = false;
            self.watches.change(profile, |rules| found = rules.unwatch(topic))?;
            if found || topic.is_plain() {
                return Ok(());
            }
            Err(input(format!("nothing that is watched matches {topic}; `authros topics list` shows what is")))
        };
        self.parts.log.deed(profile, "unwatch", topic.as_str(), removed).await?;
        if let Some(owner) = self.parts.owners.get(profile) {
            let wanted = self.recorder.wanted();
            let ended = wanted.iter().filter(|name| topic.matches(name));
            ended.for_each(|name| self.ros.second.settle(Some(name)));
            self.watches.apply(&owner)?;
        }
        Ok(())
    }

    /// Topics of the graphs and those watched by name, and those with own records if `recorded`.
    pub async fn known(&self, profile: &ProfileName, recorded: bool) -> Result<BTreeSet<TopicName>> {
        let watches = block_in_place(|| self.watches.of(profile))?;
        let mut known: BTreeSet<TopicName> = watches.named().filter_map(|rule| rule.pattern.name()).collect();
        if self.ros.is_wanted() {
            self.ros.any().await?;
            known.extend(self.ros.names());
        }
        let kept = if recorded { self.captured_by_topic(profile)? } else { HashMap::new() };
        known.extend(kept.keys().filter_map(|name| name.parse().ok()));
        Ok(known)
    }

    /// Names as they are, and what matches the patterns: see [`Self::known`].
    pub async fn named(&self, profile: &ProfileName, topics: &[TopicPattern], kept: bool) -> Result<Vec<TopicName>> {
        let known = match topics.iter().all(TopicPattern::is_plain) {
            true => BTreeSet::new(),
            false => self.known(profile, kept).await?,
        };
        let mut names = Vec::new();
        for topic in topics {
            let before = names.len();
            match topic.name() {
                Some(name) => names.push(name),
                None => names.extend(known.iter().filter(|name| topic.matches(name.as_str())).cloned()),
            }
            if names.len() == before {
                return Err(input(format!(
                    "no topic matches {topic} now; `authros topics list` shows those of the graph"
                )));
            }
        }
        let mut once = HashSet::new();
        names.retain(|name| once.insert(name.clone()));
        Ok(names)
    }

    pub fn hold(&self, profile: &ProfileName, hold: bool) -> Result<()> {
        let Some(owner) = self.parts.owners.get(profile) else { return Ok(()) };
        if !hold {
            return self.watches.restore(&owner);
        }
        self.ros.second.settle(None);
        self.watches.hold(&owner);
        Ok(())
    }

    pub async fn policy_view(&self, profile: &ProfileName) -> Result<PolicyView> {
        let rules = &self.parts.config.topic_rules;
        let row = |row: TopicRow| PolicyRow {
            sampling: row.sampling,
            rule: rules.of(&row.topic).map(|rule| TopicRule::clone(rule)),
            left_out: row.left_out,
            hz: row.hz,
            bytes_per_second: row.bytes_per_second,
            watched: row.watched,
            type_name: row.type_name,
            topic: row.topic,
        };
        let topics: Vec<PolicyRow> = self.topics(profile).await?.into_iter().map(row).collect();
        let followed = |rule: &TopicRule| topics.iter().any(|row| row.rule.as_ref() == Some(rule));
        let idle = rules.0.iter().filter(|rule| !followed(rule)).map(|rule| TopicRule::clone(rule)).collect();
        Ok(PolicyView { topics, idle })
    }
}
