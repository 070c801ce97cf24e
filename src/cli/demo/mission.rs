//! The mission step by step, through the public commands; only the attacker's steps bypass them.

use std::sync::Arc;

use tokio::task::block_in_place;

use super::{Genuine, Listener, Robots, Story, Work};
use crate::cli::connect::{Context, ProfileNeed};
use crate::crypto::{Anchor, EpochKey, Expected, GrantedKeys, Names, open, topic_key};
use crate::model::{
    Address, ErrorKind, ProfileName, RecordKind, Timestamp, TopicName, Verdict, counted, grouped, head::SIMULATED,
};
use crate::pipeline::{Network, Owner, authority, chain_proofs, reader::Reader};
use crate::ros::{DomainFleet, FleetOptions};
use crate::service::command::{Capture, CheckShared, Grant, ListShared, OpenShared, Register, Revoke};
use crate::service::reply::{CaptureSummary, OpenedView, RecordView};
use crate::service::{Client, Failure, GrantFrom, Needs, Site, UploadQuery, reply::internal};
use crate::{cli::demo, store::RecordQuery};
use authros_output::Output;

/// Bound on repeated captures.
const MOST_FURTHER_CAPTURES: u32 = 30;

pub(super) struct Person {
    client: Client,
    pub(super) address: Address,
    pub(super) owner: Arc<Owner>,
}

pub struct Mission {
    pub(super) site: Arc<Site>,
    pub(super) network: Network,
    first_block: u64,
    pub(super) cura_a: Person,
    pub(super) cura_b: Person,
    pub(super) stranger: Person,
    pub(super) topics: Vec<TopicName>,
    pictures: usize,
    listener: Listener,
    /// Robots of ROS 2; the site runs those of ROS 1.
    _fleet: Option<DomainFleet>,
    tags: Vec<(String, String)>,
    milliseconds: u64,
    output: Output,
}

impl Mission {
    pub async fn start(context: &Context, robots: Robots, seconds: u64, output: Output) -> Result<Self, Failure> {
        let root = context.home.root().display();
        let in_use = format!("a site of {root} is already running; stop it, or give the demo another --home");
        let lock = context.lock()?.ok_or_else(|| Failure::new(ErrorKind::Home, in_use))?;
        let program = context.config.ros2_program.clone();
        let fleet = |domain| DomainFleet::start(domain, program.as_deref(), robots.number, FleetOptions::default());
        let fleet = robots.domain.map(|domain| block_in_place(|| fleet(domain))).transpose()?;
        let site = Site::start(context.home.clone(), context.config.clone(), lock, Needs { ros: true, chain: true })?;
        let first_block = site.chain().await?.head().await?.number + 1;
        let cura_a = person(context, &site, "cura-a", output).await?;
        let cura_b = person(context, &site, "cura-b", output).await?;
        let stranger = person(context, &site, "stranger", output).await?;
        let number = robots.number;
        let names =
            (1..=number).flat_map(|robot| [format!("/robot{robot}/odom"), format!("/robot{robot}/camera/compressed")]);
        let topics: Vec<TopicName> = crate::cli::parse::values(&names.collect::<Vec<_>>())?;
        let watched: Vec<String> =
            topics.iter().map(ToString::to_string).filter(|topic| topic.contains("camera")).collect();
        let listener = match robots.domain {
            Some(domain) => block_in_place(|| Listener::start_in(domain, program.as_deref(), &watched))?,
            None => {
                let uri = site.ros_uri().await?;
                block_in_place(|| Listener::start(&uri, &watched))?
            }
        };
        block_in_place(|| listener.listen());
        let network = site.network().await?;
        let place = robots.domain.map(|domain| format!(" in ROS 2 domain {domain}")).unwrap_or_default();
        let simulated = counted(number.into(), "SIMULATED robot");
        output.note(&format!("{simulated}{place}; CURA A {}, CURA B {}", cura_a.address, cura_b.address));
        let milliseconds = seconds * 1000;
        let mut tags = vec![("mission".to_owned(), "crime-scene".to_owned())];
        // The site does not know the robots of a ROS 2 domain as simulated.
        tags.extend(robots.domain.map(|_| (SIMULATED.0.to_owned(), SIMULATED.1.to_owned())));
        Ok(Self {
            site,
            network,
            first_block,
            cura_a,
            cura_b,
            stranger,
            topics,
            pictures: 0,
            listener,
            _fleet: fleet,
            tags,
            milliseconds,
            output,
        })
    }

    pub async fn run(mut self) -> Result<Story, Failure> {
        let played = self.play().await;
        let site = Arc::clone(&self.site);
        drop(self);
        site.stop().await;
        played
    }

    /// Leaves the site running.
    pub(super) async fn play(&mut self) -> Result<Story, Failure> {
        let first = self.capture(self.milliseconds * 6 / 10, has_what_is_shown).await?;
        self.output.note(&format!(
            "A captured and anchored {}, {} of them verified",
            counted(first.captured, "message"),
            grouped(first.verified)
        ));
        self.grant().await?;
        let records = self.shared_records().await?;
        let mut story =
            Story { captured: first.captured, verified: first.verified, lost: first.lost, ..Story::default() };
        self.open_all(&records, &mut story).await?;
        self.output.note(&format!(
            "A granted B; B checked and opened {}, restored {}",
            counted(story.opened_by_grantee, "record"),
            counted(story.restored_images, "picture")
        ));
        story.refused_stranger = self.stranger_is_refused(&records).await?;
        story.refused_tampered = self.tampering_is_refused(&records).await?;
        let kept = self.kept_keys()?;
        self.cura_a.client.ask(Revoke { grantee: self.cura_b.address.into() }).await?;
        let revoked_at = Timestamp::now();
        let second = self.capture(self.milliseconds - self.milliseconds * 6 / 10, |seen| seen.captured > 0).await?;
        story.captured += second.captured;
        story.verified += second.verified;
        story.lost += second.lost;
        story.opened_after_revoke = self.open_after_revoke(revoked_at, &kept).await?;
        self.output.note(&format!(
            "A revoked B; of {} B opened {}",
            counted(second.captured, "later record"),
            story.opened_after_revoke
        ));
        story.anchored = self.anchored().await?;
        story.chain = self.work().await?;
        let all = u64::try_from(records.len()).unwrap_or(0);
        story.ok = first.captured > 0
            && second.captured > 0
            && story.lost == 0
            && story.verified == story.captured
            && story.anchored >= story.captured
            && all == first.captured
            && story.opened_by_grantee == all
            && story.restored_images > 0
            && story.restored_images == u64::try_from(self.pictures).unwrap_or(0)
            && story.refused_stranger
            && story.refused_tampered
            && story.opened_after_revoke == 0;
        Ok(story)
    }

    /// Repeats the capture while the robots of a busy machine have not published enough.
    async fn capture(&self, milliseconds: u64, enough: fn(&CaptureSummary) -> bool) -> Result<CaptureSummary, Failure> {
        let mut all = self.capture_once(milliseconds).await?;
        for _ in 0..MOST_FURTHER_CAPTURES {
            if enough(&all) {
                break;
            }
            let more = self.capture_once(milliseconds).await?;
            all.captured += more.captured;
            all.verified += more.verified;
            all.lost += more.lost;
            all.topics.extend(more.topics);
        }
        Ok(all)
    }

    async fn capture_once(&self, milliseconds: u64) -> Result<CaptureSummary, Failure> {
        let topics = self.topics.iter().cloned().map(Into::into).collect();
        let (tags, milliseconds) = (self.tags.clone(), Some(milliseconds));
        self.cura_a.client.ask(Capture { topics, type_name: None, count: None, milliseconds, tags }).await
    }

    async fn grant(&self) -> Result<(), Failure> {
        let grantee = self.cura_b.address;
        let ask = Grant {
            grantee: grantee.into(),
            topics: Vec::new(),
            robots: Vec::new(),
            from: GrantFrom::Current,
            expires: None,
        };
        self.cura_a.client.ask(ask).await.map(drop)
    }

    async fn shared_records(&self) -> Result<Vec<RecordView>, Failure> {
        let mut records: Vec<RecordView> = Vec::new();
        let mut after = None;
        loop {
            let query =
                UploadQuery { owner: Some(self.cura_a.address.into()), limit: 1000, after, ..UploadQuery::default() };
            let page = self.cura_b.client.ask(ListShared(query)).await?;
            // A kept home may hold records of an earlier mission under earlier epochs.
            records.extend(page.records.into_iter().filter(|record| record.epoch >= self.epoch()));
            after = page.next;
            if after.is_none() {
                return Ok(records);
            }
        }
    }

    fn epoch(&self) -> u64 {
        self.cura_a.owner.sealing().map_or(0, |keys| keys.epoch)
    }

    async fn open_all(&mut self, records: &[RecordView], story: &mut Story) -> Result<(), Failure> {
        for record in records {
            if ["sensor_msgs/CompressedImage", "sensor_msgs/msg/CompressedImage"].contains(&record.type_name.as_str()) {
                self.pictures += 1;
            }
            let checked = self.cura_b.client.ask(CheckShared { id: record.id.clone() }).await?;
            let Ok(opened) = self.cura_b.client.ask(OpenShared { id: record.id.clone() }).await else { continue };
            if checked.verdict == Verdict::Verified && opened.verdict == Verdict::Verified {
                story.opened_by_grantee += 1;
                story.restored_images += u64::from(block_in_place(|| self.is_restored(&opened)));
            }
        }
        Ok(())
    }

    fn is_restored(&self, opened: &OpenedView) -> bool {
        let is_jpeg = |bytes: &Vec<u8>| bytes.starts_with(&[0xff, 0xd8]) && bytes.ends_with(&[0xff, 0xd9]);
        // Waits for pictures only.
        opened.picture.as_ref().is_some_and(is_jpeg) && opened.body.as_ref().is_some_and(|body| self.listener.saw(body))
    }

    async fn stranger_is_refused(&self, records: &[RecordView]) -> Result<bool, Failure> {
        let query = UploadQuery { limit: 1000, ..UploadQuery::default() };
        let page = self.stranger.client.ask(ListShared(query)).await?;
        let mut refused = page.records.is_empty();
        for record in records.iter().take(20) {
            let checked = self.stranger.client.ask(CheckShared { id: record.id.clone() }).await.map(drop);
            let opened = self.stranger.client.ask(OpenShared { id: record.id.clone() }).await.map(drop);
            for answer in [checked, opened] {
                refused &= answer.is_err_and(|failure| failure.kind == ErrorKind::Refused);
            }
        }
        self.output.note(if refused { "a stranger was refused" } else { "A STRANGER WAS NOT REFUSED" });
        Ok(refused)
    }

    async fn tampering_is_refused(&self, records: &[RecordView]) -> Result<bool, Failure> {
        let [one, other, ..] = records else { return Ok(false) };
        let flipped = self.flipped_bit_is_refused(one).await?;
        let plant = &self.site.plant;
        let take = |record: &RecordView| -> Result<Genuine, Failure> {
            let row = plant.ledger.records.find(record.digest)?.ok_or_else(gone)?;
            Genuine::take(plant, &self.network, &self.cura_a.owner, row)
        };
        // Same topic and epoch, so that one key opens both and only the named check can refuse.
        let other = records.iter().find(|record| record.topic == one.topic && record.id != one.id).unwrap_or(other);
        let (one, other) = (take(one)?, take(other)?);
        let broken = demo::broken(plant.provider, &one, &other)?;
        let unanchored = self.never_anchored_is_told(&one).await?;
        let unproven = self.path_of_another_is_refused(&one, &other)?;
        if !broken.is_empty() {
            self.output.note(&format!("FORGERIES PASSED THE CHECK OF {}", broken.join(", ")));
        }
        let refused = flipped && broken.is_empty() && unanchored && unproven;
        self.output.note(if refused {
            "a flipped bit and six forgeries were refused, each by its own check"
        } else {
            "TAMPERING WAS NOT REFUSED"
        });
        Ok(refused)
    }

    async fn flipped_bit_is_refused(&self, record: &RecordView) -> Result<bool, Failure> {
        let store = &self.site.plant.ciphertext;
        let genuine = block_in_place(|| store.get(record.digest))?.ok_or_else(gone)?;
        let mut forged = genuine.clone();
        if let Some(byte) = forged.last_mut() {
            *byte ^= 1;
        }
        block_in_place(|| store.replace(record.digest, &forged))?;
        let checked = self.cura_b.client.ask(CheckShared { id: record.id.clone() }).await;
        let opened = self.cura_b.client.ask(OpenShared { id: record.id.clone() }).await;
        block_in_place(|| store.replace(record.digest, &genuine))?;
        let told = checked.is_ok_and(|view| view.verdict == Verdict::Tampered);
        Ok(told && opened.is_err_and(|failure| failure.kind == ErrorKind::Tampered))
    }

    async fn never_anchored_is_told(&self, genuine: &Genuine) -> Result<bool, Failure> {
        let plant = &self.site.plant;
        let (row, blob) = demo::never_anchored(plant, genuine)?;
        let reader = Reader { plant, network: &self.network, reader: &self.cura_b.owner };
        let verdict = reader.open_bytes(&row, &blob).await.map(|opened| opened.verdict);
        Ok(verdict.is_ok_and(|verdict| verdict == Verdict::Unanchored))
    }

    /// Claims another record's place in its batch; digests that are anchored one by one have none.
    fn path_of_another_is_refused(&self, one: &Genuine, other: &Genuine) -> Result<bool, Failure> {
        let placed = self.site.plant.ledger.records.placed(one.row.digest)?;
        let place = placed.and_then(|placed| placed.place);
        Ok(place.is_none_or(|place| !chain_proofs::is_included(&place, &other.row)))
    }

    /// Every epoch key that B ever received.
    fn kept_keys(&self) -> Result<Vec<(u64, EpochKey)>, Failure> {
        let reader = Reader { plant: &self.site.plant, network: &self.network, reader: &self.cura_b.owner };
        let (directory, mut kept) = (&self.network.directory, Vec::new());
        let Some(grant) = authority::standing_grant(directory, self.cura_a.address, reader.reader.address) else {
            return Ok(kept);
        };
        for envelope in block_in_place(|| reader.envelopes(&grant))? {
            if let GrantedKeys::All { epochs, .. } = &envelope.keys {
                kept.extend(epochs.iter().cloned());
            }
        }
        Ok(kept)
    }

    async fn open_after_revoke(&self, revoked_at: Timestamp, kept: &[(u64, EpochKey)]) -> Result<u64, Failure> {
        let (owner, since) = (Some(self.cura_a.address), Some(revoked_at));
        let query = RecordQuery { owner, since, limit: 10_000, ..RecordQuery::default() };
        let rows = self.site.plant.ledger.records.list(&query)?.rows;
        let provider = self.site.plant.provider;
        let mut opened = 0;
        let signer = self.cura_a.owner.signing();
        for row in rows {
            let asked = self.cura_b.client.ask(OpenShared { id: row.id.clone() }).await.is_ok();
            let blob = block_in_place(|| self.site.plant.ciphertext.get(row.digest))?.ok_or_else(gone)?;
            let names = Names::Derived(self.cura_a.owner.index());
            let wanted = Expected::any_of(self.network.domain, self.cura_a.address, names);
            let by_key = kept.iter().any(|(_, key)| {
                let key = topic_key(key, &row.topic_id);
                open(provider, &blob, &row.signature, &signer.public, Anchor::Chain(row.digest), &key, &wanted).is_ok()
            });
            opened += u64::from(asked || by_key);
        }
        Ok(opened)
    }

    async fn anchored(&self) -> Result<u64, Failure> {
        let (owner, kind) = (Some(self.cura_a.address), Some(RecordKind::Data));
        let mut query = RecordQuery { owner, kind, limit: 10_000, newest_first: true, ..RecordQuery::default() };
        let mut anchored = 0;
        loop {
            let page = self.site.plant.ledger.records.list(&query)?;
            for row in &page.rows {
                let in_this_mission = row.block.is_some_and(|block| block >= self.first_block);
                if in_this_mission && chain_proofs::is_anchored(&self.site.plant, &self.network, row).await? {
                    anchored += 1;
                }
            }
            query.after = page.next;
            if query.after.is_none() {
                return Ok(anchored);
            }
        }
    }

    async fn work(&self) -> Result<Work, Failure> {
        let head = self.network.chain.head().await?.number;
        let (transactions, gas) = self.network.chain.work(self.first_block, head).await?;
        Ok(Work { transactions, gas })
    }
}

/// A picture to restore, and two records of one topic to forge with.
fn has_what_is_shown(seen: &CaptureSummary) -> bool {
    let picture = seen.topics.iter().any(|topic| topic.topic.contains("camera") && topic.captured > 0);
    picture && seen.topics.iter().any(|topic| topic.captured > 1)
}

fn gone() -> Failure {
    internal("a record of the demo is missing from its store; run the demo again in its own home")
}

async fn person(context: &Context, site: &Arc<Site>, name: &str, output: Output) -> Result<Person, Failure> {
    let profile: ProfileName = crate::cli::parse::value(name)?;
    let client = site.client(profile.clone());
    let (global, home, config) = (context.global.clone(), context.home.clone(), context.config.clone());
    let own = Context { global, home, profile: profile.clone(), config, operator: None };
    own.prepare(&client, ProfileNeed::Made, &output).await?;
    client.ask(Register).await?;
    let owner = site.unlocked(&profile)?;
    Ok(Person { client, address: owner.address, owner })
}
