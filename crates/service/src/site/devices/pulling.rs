//! An owner's requests to a robot's ring.

use tokio::task::block_in_place;

use super::Devices;
use crate::crypto::Notice;
use crate::model::{RingSpan, Timestamp, TopicPattern, TopicPatterns, clean};
use crate::pipeline::{Network, Owner};
use crate::service::command::{self as ask, Ask as _, RobotCommand};
use crate::service::failure::{input, refused};
use crate::service::reply::{Reply, Result, RingPullView};
use crate::site::incidents;
use crate::store::notes::Enrolled;

const WIDEST: usize = 255;

impl Devices {
    pub async fn answer(&self, owner: &Owner, command: RobotCommand) -> Result<Reply> {
        match command {
            RobotCommand::PullRing { name, since, until, topics, incident } => {
                let incident = incident.map(|incident| {
                    block_in_place(|| incidents::view(&self.parts.plant.ledger.incidents, owner.address, &incident))
                });
                let incident = incident.transpose()?;
                let of_incident = incident.as_ref();
                let since = since.or(of_incident.map(|incident| incident.since));
                let since = since.ok_or_else(|| input("give a start: --since 10m, or --incident NAME"))?;
                let until = until.or(of_incident.and_then(|incident| incident.until));
                // A name that is no pattern matches no robot's topic.
                let of_all = of_incident.into_iter().flat_map(|incident| &incident.topics);
                let of_all = of_all.filter_map(|topic| topic.parse().ok());
                let topics = if topics.is_empty() { of_all.collect() } else { topics };
                let span = span(since, until, topics)?;
                self.pull(owner, &name, &span).await.map(ask::PullRing::told)
            }
            RobotCommand::ListRobots => self.robot_rows(owner).await.map(ask::ListRobots::told),
            RobotCommand::ShowRobot { name } => self.robot_view(owner, &name).await.map(ask::ShowRobot::told),
            RobotCommand::SetRobotPolicy { name, text } => {
                self.set_policy(owner, &name, text).await.map(ask::SetRobotPolicy::told)
            }
        }
    }

    pub async fn pull(&self, owner: &Owner, name: &str, span: &RingSpan) -> Result<RingPullView> {
        let network = self.parts.link.network().await?;
        let robot = self.robot(&network, owner, name)?;
        let RingSpan { since, until, topics } = span;
        let told = if topics.0.is_empty() { "all topics".to_owned() } else { topics.to_string() };
        let subject = clean(&format!("{}: {since} to {until}, {told}", robot.device), 400);
        let notice = Notice::Pull(span.clone());
        let asked = async { block_in_place(|| self.enrolments.send(owner, &network, &robot, &notice)) };
        self.parts.log.deed(&owner.profile, "pull ring", &subject, asked).await?;
        let topics = topics.0.iter().map(|topic| clean(topic.as_str(), WIDEST)).collect();
        Ok(RingPullView { robot: robot.name, device: robot.device, since: *since, until: *until, topics })
    }

    pub async fn check_robots(&self, owner: &Owner, names: &[String]) -> Result<()> {
        let network = self.parts.link.network().await?;
        names.iter().try_for_each(|name| self.robot(&network, owner, name).map(drop))
    }

    pub fn robot(&self, network: &Network, owner: &Owner, name: &str) -> Result<Enrolled> {
        let device = self.lent_device(network, owner, name)?;
        let known = self.enrolments.of(owner)?.into_iter().rfind(|robot| robot.device == device);
        known.ok_or_else(|| {
            refused(format!(
                "device {device} was not enrolled from this home; `authros robot devices` shows those that were"
            ))
        })
    }
}

/// A ring holds only the past.
pub fn span(since: Timestamp, until: Option<Timestamp>, topics: Vec<TopicPattern>) -> Result<RingSpan> {
    let until = until.unwrap_or_else(Timestamp::now).min(Timestamp::now());
    if since >= until {
        return Err(input(format!(
            "the span would end at {until}, before it begins; a ring holds only the past, so give an earlier --since"
        )));
    }
    if topics.len() > TopicPatterns::MOST {
        return Err(input(format!("request at most {most} topics per call", most = TopicPatterns::MOST)));
    }
    Ok(RingSpan { since, until, topics: TopicPatterns(topics) })
}
