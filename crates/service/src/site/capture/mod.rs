//! Captures with an end: a count, a duration, or a command; answered when all is verified.

pub(super) mod ros;
pub(super) mod sealer_thread;
pub(super) mod second;
#[cfg(test)]
mod tests;
mod topics;
pub(super) mod watches;

use crate::site::capture::ros::RosSide;
use crate::site::capture::watches::Watches;
use crate::site::identity::Profiles;
use crate::site::parts::Parts;
use crate::site::pins::Pinning;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::model::{ProfileName, TopicName, TypeName};
use crate::pipeline::{CaptureSession, Losses, Owner, Recorder};
use crate::service::failure::{input, refused};
use crate::service::reply::{CaptureSummary, Result, TopicSummary, UnreachedView};

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
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        running.push((profile.clone(), Arc::clone(session)));
    }

    pub fn forget(&self, session: &Arc<CaptureSession>) {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        running.retain(|(_, other)| !Arc::ptr_eq(other, session));
    }

    pub fn stop(&self, profile: &ProfileName) {
        self.ros.second.settle(None);
        let captures = self.running.lock().unwrap_or_else(PoisonError::into_inner);
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
