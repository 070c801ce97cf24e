//! Witnesses: parties that countersign what this home states about its chain. A running site asks each once an hour; one
//! that does not answer is asked again, at growing intervals, and nothing waits for it.

mod asking;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::crypto::signer_id;
use crate::model::bytes::hex;
use crate::model::{Address, ProfileName, SignerId, Timestamp, clean};
use crate::pipeline::{Owner, Plant};
use crate::service::command::{self as ask, Ask, WitnessCommand};
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::input;
use crate::service::hub::Hub;
use crate::service::reply::{ContradictionView, Failure, HealthLevel, PartHealth, Reply, WitnessView, WitnessesView};
use crate::site::audit::Log;
use crate::site::blocking;
use crate::site::chain::link::Link;
use crate::site::identity::owners::Owners;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;
use crate::store::{KeptContradiction, WitnessRow};

/// The most parties of a profile.
const MOST: usize = 16;
/// The longest name, characters.
const LONGEST_NAME: usize = 80;
/// How often a witness is asked.
const PERIOD: Duration = Duration::from_secs(3600);
/// How often to check whether it is time.
const LOOK: Duration = Duration::from_secs(60);
/// The subject of notices.
const ABOUT: &str = "witnesses";

/// A witness of one of this home's owners.
type Asked = (Address, SignerId);

/// What came of asking a witness.
#[derive(Debug, Default, Clone)]
struct Last {
    /// What went wrong, and since when.
    trouble: Option<(Timestamp, String)>,
    /// It is not asked again before this.
    again: Option<Instant>,
    pause: Duration,
    failures: u64,
}

/// The witnesses of a site.
pub(in crate::site) struct Witnesses {
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    life: Arc<Lifetime>,
    last: Mutex<BTreeMap<Asked, Last>>,
    /// One round at a time.
    turn: tokio::sync::Mutex<()>,
}

impl Witnesses {
    /// From the shared parts.
    pub fn new(parts: &Parts) -> Self {
        let Parts { plant, hub, log, owners, link, life, .. } = parts.clone();
        Self { plant, hub, log, owners, link, life, last: Mutex::default(), turn: tokio::sync::Mutex::new(()) }
    }

    /// Answers one request.
    pub async fn answer(self: &Arc<Self>, profile: &ProfileName, command: WitnessCommand) -> Result<Reply, Failure> {
        let owner = self.owners.address_of(profile)?;
        match command {
            WitnessCommand::AddWitness { name, account, key, gateway, serves } => {
                let (name, added_at) = (checked_name(&name)?, Timestamp::now());
                let address = gateway.as_deref().map(checked_address).transpose()?;
                let row = WitnessRow { owner, key, account, name, address, serves, added_at };
                self.add(profile, row).await.map(ask::AddWitness::told)
            }
            WitnessCommand::RemoveWitness { name } => {
                self.remove(profile, owner, &name).await.map(ask::RemoveWitness::told)
            }
            WitnessCommand::ListWitnesses => self.rows(owner).await.map(ask::ListWitnesses::told),
            WitnessCommand::WitnessStatus => self.status(profile, owner).await.map(ask::WitnessStatus::told),
            WitnessCommand::AskWitnesses => {
                self.ask_now(&self.owners.unlocked(profile)?).await.map(ask::AskWitnesses::told)
            }
        }
    }

    async fn add(self: &Arc<Self>, profile: &ProfileName, row: WitnessRow) -> Result<Vec<WitnessView>, Failure> {
        let own = self.owners.get(profile).map(|owner| own_key(&owner));
        if row.account == row.owner || own == Some(row.key) {
            return Err(input("that is this profile; a witness must be somebody else"));
        }
        if row.address.is_none() && !row.serves {
            return Err(input("give its gateway so that it is asked, --serve so that it may ask here, or both"));
        }
        let known = self.of(row.owner).await?;
        if known.iter().any(|other| other.name == row.name && other.key != row.key) {
            return Err(input(format!("the name '{}' is taken by another witness; choose another --name", row.name)));
        }
        if known.len() >= MOST && known.iter().all(|other| other.key != row.key) {
            return Err(input(format!("there are {MOST} witnesses, the limit per profile")));
        }
        let (owner, subject) = (row.owner, format!("{} ({}, key {})", row.name, row.account, row.key));
        self.with(|last| last.remove(&(row.owner, row.key)));
        let added = blocking(self, move |witnesses| Ok(witnesses.plant.ledger.put_witness(row)?));
        self.log.deed(profile, "add witness", &subject, added).await?;
        self.hub.changed(Part::Health);
        self.rows(owner).await
    }

    async fn remove(
        self: &Arc<Self>,
        profile: &ProfileName,
        owner: Address,
        name: &str,
    ) -> Result<Vec<WitnessView>, Failure> {
        let known = self.of(owner).await?;
        let found = known.into_iter().find(|row| row.name == name);
        let row = found.ok_or_else(|| {
            input(format!("no witness is named '{}'; `authros witness list` shows them", clean(name, LONGEST_NAME)))
        })?;
        let subject = format!("{} (key {})", row.name, row.key);
        self.with(|last| last.remove(&(owner, row.key)));
        let removed = blocking(self, move |witnesses| Ok(witnesses.plant.ledger.remove_witness(owner, row.key)?));
        self.log.deed(profile, "remove witness", &subject, removed).await?;
        self.hub.changed(Part::Health);
        self.rows(owner).await
    }

    /// An owner's parties.
    async fn of(self: &Arc<Self>, owner: Address) -> Result<Vec<WitnessRow>, Failure> {
        let all = blocking(self, |witnesses| Ok(witnesses.plant.ledger.witnesses()?)).await?;
        Ok(all.into_iter().filter(|row| row.owner == owner).collect())
    }

    async fn rows(self: &Arc<Self>, owner: Address) -> Result<Vec<WitnessView>, Failure> {
        let rows = self.of(owner).await?;
        blocking(self, move |witnesses| rows.into_iter().map(|row| witnesses.view(row)).collect()).await
    }

    fn view(&self, row: WitnessRow) -> Result<WitnessView, Failure> {
        let ledger = &self.plant.ledger;
        let counts = ledger.position_counts(row.owner, row.key)?;
        let (served, chains) = if row.serves { ledger.countersigned_count(row.key)? } else { (0, 0) };
        let last = self.with(|last| last.get(&(row.owner, row.key)).cloned()).unwrap_or_default();
        let WitnessRow { key, account, name, address: gateway, serves, added_at, .. } = row;
        let problem = last.trouble.map(|(_, why)| clean(&why, 300));
        let (given, newest, failures) = (counts.positions, counts.newest, last.failures);
        Ok(WitnessView {
            name,
            account,
            key,
            gateway,
            serves,
            added_at,
            given,
            newest,
            served,
            chains,
            failures,
            problem,
        })
    }

    async fn status(self: &Arc<Self>, profile: &ProfileName, account: Address) -> Result<WitnessesView, Failure> {
        let witnesses = self.rows(account).await?;
        let key = self.owners.get(profile).map(|owner| own_key(&owner));
        let contradictions = blocking(self, |witnesses| {
            let ledger = &witnesses.plant.ledger;
            let (found, rows) = (ledger.two_histories()?, ledger.witnesses()?);
            Ok(found.into_iter().map(|one| contradiction(one, &rows)).collect())
        });
        Ok(WitnessesView { account, key, witnesses, contradictions: contradictions.await? })
    }

    /// The state of the witnesses, if there are any.
    pub fn health(&self) -> Result<Option<PartHealth>, Failure> {
        let rows = self.plant.ledger.witnesses()?;
        if rows.is_empty() {
            return Ok(None);
        }
        let part = |level, since, text: &str| {
            Some(PartHealth { part: ABOUT.to_owned(), level, text: clean(text, 300), since, retry: None })
        };
        let contradictions = self.plant.ledger.two_histories()?;
        let exposed = contradictions.iter().find_map(|found| {
            let row = rows.iter().find(|row| row.key == found.party && row.serves)?;
            Some((found.at, format!("{} stated two histories of its chain ({})", row.name, found.what)))
        });
        if let Some((at, text)) = exposed {
            let text = format!("{text}; `authros witness status` shows both statements");
            return Ok(part(HealthLevel::Failed, Some(at), &text));
        }
        let asked = rows.iter().filter(|row| row.address.is_some()).count();
        let mut newest = None;
        for row in &rows {
            newest = newest.max(self.plant.ledger.position_counts(row.owner, row.key)?.newest);
        }
        let newest = newest.map_or_else(|| "none yet".to_owned(), |at| format!("the newest at {at}"));
        let served = rows.iter().filter(|row| row.serves).count();
        let told = format!("{asked} asked, {newest}; {served} served");
        let troubles =
            self.with(|last| last.values().filter(|last| last.trouble.is_some()).cloned().collect::<Vec<_>>());
        let failures: u64 = troubles.iter().map(|last| last.failures).sum();
        Ok(match troubles.into_iter().find_map(|last| last.trouble) {
            Some((since, why)) => {
                let text = format!("{told}; {failures} attempts failed: {why}");
                part(HealthLevel::Waiting, Some(since), &text)
            }
            None => part(HealthLevel::Ok, None, &told),
        })
    }

    fn with<Told>(&self, work: impl FnOnce(&mut BTreeMap<Asked, Last>) -> Told) -> Told {
        work(&mut self.last.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn failed(&self, row: &WitnessRow, failure: &Failure) {
        let is_new = self.with(|last| {
            let last = last.entry((row.owner, row.key)).or_default();
            let is_new = last.trouble.is_none();
            let since = last.trouble.as_ref().map_or_else(Timestamp::now, |(since, _)| *since);
            last.failures += 1;
            last.trouble = Some((since, failure.message.clone()));
            last.pause = (last.pause * 2).clamp(LOOK, PERIOD);
            last.again = Some(Instant::now() + last.pause);
            is_new
        });
        if is_new {
            let text = format!("a statement waits for its witness and will be retried: {}", failure.message);
            self.hub.notice_about(ABOUT, NoticeLevel::Warning, &text);
        }
    }

    fn succeeded(&self, row: &WitnessRow) {
        let was_troubled = self.with(|last| {
            let last = last.entry((row.owner, row.key)).or_default();
            (last.again, last.pause) = (Some(Instant::now() + PERIOD), Duration::ZERO);
            last.trouble.take().is_some()
        });
        if was_troubled {
            let text = format!("the witness '{}' answers again", row.name);
            self.hub.notice_about(ABOUT, NoticeLevel::Info, &text);
        }
    }
}

/// SM3 of the key by which an owner states and countersigns.
fn own_key(owner: &Owner) -> SignerId {
    signer_id(&owner.gateway_identity().public)
}

fn contradiction(found: KeptContradiction, rows: &[WitnessRow]) -> ContradictionView {
    let KeptContradiction { party, at, what, kept, later } = found;
    let name = rows.iter().find(|row| row.key == party).map(|row| row.name.clone());
    let (account, chain_id) = (later.position.owner, later.position.chain_id);
    let (kept_at, kept, later) = (kept.at, hex(&kept.encode()), hex(&later.encode()));
    ContradictionView { name, key: party, account, chain_id, what, kept_at, at, kept, later }
}

fn checked_name(name: &str) -> Result<String, Failure> {
    if name.trim() != name
        || name.is_empty()
        || name.chars().count() > LONGEST_NAME
        || clean(name, LONGEST_NAME) != name
    {
        return Err(input(format!("a witness's name must have 1 to {LONGEST_NAME} printable characters")));
    }
    Ok(name.to_owned())
}

fn checked_address(address: &str) -> Result<String, Failure> {
    let parts = address.rsplit_once(':').filter(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    let plain = address.len() <= 255 && address.bytes().all(|byte| byte.is_ascii_graphic());
    match parts.filter(|_| plain) {
        Some(_) => Ok(address.to_owned()),
        None => Err(input(format!("'{}' is not the address of a gateway; use HOST:PORT", clean(address, 100)))),
    }
}
