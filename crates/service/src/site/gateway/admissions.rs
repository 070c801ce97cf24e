//! Owners who may use the gateway of this home, as its keeper decides; every caller is checked against the ledger's
//! list.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError, RwLock};

use tokio::task::block_in_place;

use super::{GatewayDesk, desk};
use crate::event::{NoticeLevel, Part};
use crate::failure::{input, refused};
use crate::gateway::{Code, Received, Refusal};
use crate::model::bytes::hex;
use crate::model::{Address, Party, ProfileName, Timestamp};
use crate::pipeline::Network;
use crate::reply::{AdmittedView, Result};
use crate::site::contacts::Contacts;
use crate::site::parts::Parts;
use crate::store::StoreError;
use crate::store::notes::{AdmittedOwner, AdmittedOwners};

const MOST: usize = 10_000;
/// Subject of notices about an account that asks to be allowed.
pub fn subject(account: Address) -> String {
    format!("allow {account}")
}

pub struct Admissions {
    parts: Parts,
    contacts: Arc<Contacts>,
    admitted: RwLock<BTreeSet<Address>>,
    changing: tokio::sync::Mutex<()>,
}

impl Admissions {
    pub fn new(parts: &Parts, contacts: &Arc<Contacts>) -> Self {
        let (contacts, changing) = (Arc::clone(contacts), tokio::sync::Mutex::default());
        Self { parts: parts.clone(), contacts, admitted: RwLock::default(), changing }
    }

    fn list(&self) -> Result<Vec<AdmittedOwner>> {
        Ok(self.parts.plant.ledger.notes.read(&AdmittedOwners {})?.unwrap_or_default())
    }

    /// Another process of the store may change it, too.
    fn change(&self, change: impl FnOnce(&mut Vec<AdmittedOwner>)) -> Result<()> {
        let changed = |list: &mut Vec<AdmittedOwner>| {
            change(list);
            Ok::<_, StoreError>(list.clone())
        };
        self.take_over(&self.parts.plant.ledger.notes.change(&AdmittedOwners {}, changed)?);
        self.parts.hub.changed(Part::Health);
        Ok(())
    }

    fn take_over(&self, list: &[AdmittedOwner]) {
        let owners = list.iter().map(|admitted| admitted.owner).collect();
        *self.admitted.write().unwrap_or_else(PoisonError::into_inner) = owners;
    }

    /// Reads the list for [`Self::is_on_list`].
    pub fn open(&self) -> Result<()> {
        self.take_over(&self.list()?);
        Ok(())
    }

    pub fn listed(&self) -> BTreeSet<Address> {
        self.admitted.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub fn is_on_list(&self, owner: &Address) -> bool {
        self.admitted.read().unwrap_or_else(PoisonError::into_inner).contains(owner)
    }

    pub async fn admit(&self, profile: &ProfileName, owner: &Party) -> Result<Vec<AdmittedView>> {
        let owner = self.contacts.resolve(owner)?;
        {
            let _one_at_a_time = self.changing.lock().await;
            let list = self.list()?;
            if !list.iter().any(|admitted| admitted.owner == owner) {
                if list.len() >= MOST {
                    return Err(refused(format!(
                        "a gateway can allow at most {MOST} owners; remove one with `authros \
                                                gateway deny` first"
                    )));
                }
                let row = AdmittedOwner { owner, since: Timestamp::now(), by: profile.to_string() };
                let admitted = async { self.change(|list| list.push(row)) };
                self.parts.log.deed(profile, "gateway allow", &owner.to_string(), admitted).await?;
                let text = format!("the gateway allows {owner} now");
                self.parts.hub.notice_about(&subject(owner), NoticeLevel::Info, &text);
            }
        }
        self.rows()
    }

    /// Refuses the owner from the next Command on; what it sent is kept and anchored.
    pub async fn dismiss(&self, profile: &ProfileName, owner: &Party) -> Result<Vec<AdmittedView>> {
        let owner = self.contacts.resolve(owner)?;
        if self.home_accounts().contains(&owner) {
            return Err(refused(format!("{owner} is a profile of this home and may always use its gateway")));
        }
        {
            let _one_at_a_time = self.changing.lock().await;
            if !self.list()?.iter().any(|admitted| admitted.owner == owner) {
                let advice = match self.parts.config.gateway.open {
                    true => {
                        "and an open gateway serves it as a guest; set gateway.admission = \"closed\" to shut it out"
                    }
                    false => "so it is not served; `authros gateway allowed` shows the list",
                };
                return Err(input(format!("{owner} is not on this gateway's allow list, {advice}")));
            }
            let denied = async { self.change(|list| list.retain(|admitted| admitted.owner != owner)) };
            self.parts.log.deed(profile, "gateway deny", &owner.to_string(), denied).await?;
        }
        self.rows()
    }

    pub fn rows(&self) -> Result<Vec<AdmittedView>> {
        let (names, list) = (self.contacts.names()?, self.list()?);
        let row = |admitted: AdmittedOwner| AdmittedView {
            owner: admitted.owner,
            name: names.get(&admitted.owner).cloned(),
            since: admitted.since,
            by: admitted.by,
        };
        Ok(list.into_iter().map(row).collect())
    }

    /// Including profiles that are not open.
    pub fn home_accounts(&self) -> BTreeSet<Address> {
        let open = self.parts.owners.all().iter().map(|owner| owner.address).collect::<BTreeSet<_>>();
        let kept = self.parts.home.profiles().into_iter().filter_map(|profile| {
            let public = block_in_place(|| crate::crypto::read_public(&self.parts.home.keyring(&profile)));
            // An unreadable keyring is reported where it is opened.
            public.ok().map(|public| public.address)
        });
        open.into_iter().chain(kept).collect()
    }
}

const MOST_GUESTS: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// A profile of this home, or on the list.
    Admitted,
    /// Not admitted; the gateway is open.
    Guest,
}

impl GatewayDesk {
    pub fn standing_of(&self, network: &Network, account: &Address) -> Result<Standing, Refusal> {
        let gateway = &self.gateway;
        let own = || gateway.parts.owners.all().iter().any(|owner| owner.address == *account);
        if self.place.home_accounts.contains(account) || gateway.admissions.is_on_list(account) || own() {
            return Ok(Standing::Admitted);
        }
        // The successor of a lost account replaces it.
        if gateway.admissions.listed().iter().any(|lost| network.directory.successor(*lost) == Some(*account)) {
            return Ok(Standing::Admitted);
        }
        if self.place.open {
            return Ok(Standing::Guest);
        }
        let detail = format!("{account} is not allowed at this gateway; `authros gateway allow {account}` allows it");
        Err(Refusal { account: Some(*account), ..Refusal::new(Code::NotAdmitted, detail) })
    }

    /// Whether an account may have one more name here.
    pub fn check_name(&self, network: &Network, account: &Address, name: &ProfileName) -> Result<(), Refusal> {
        desk::check(name, account)?;
        if self.standing_of(network, account)? == Standing::Admitted {
            return Ok(());
        }
        let bound = self.gateway.parts.plant.ledger.bindings.bound_names().map_err(Refusal::internal)?;
        let own = bound.iter().filter(|bound| bound.account == *account).count();
        let known = bound.iter().any(|bound| bound.account == *account && bound.name == name.as_str());
        let most = self.gateway.parts.config.gateway.names;
        if !known && own as u64 >= most {
            return Err(self.over(account, format_args!("{most} names")));
        }
        let guests: BTreeSet<&Address> = bound
            .iter()
            .map(|bound| &bound.account)
            .filter(|owner| !self.gateway.admissions.is_on_list(owner))
            .collect();
        if own == 0 && guests.len() >= MOST_GUESTS {
            return Err(self.over(account, format_args!("{MOST_GUESTS} owners who are not on the allow list")));
        }
        Ok(())
    }

    /// Whether a guest's records fit its quotas. The caller holds off other guests' records meanwhile.
    pub fn check_quota(&self, account: &Address, records: &[Received]) -> Result<(), Refusal> {
        let (ledger, rules) = (&self.gateway.parts.plant.ledger, &self.gateway.parts.config.gateway);
        let usage = ledger.counts.usage(*account).map_err(Refusal::internal)?;
        let bytes: u64 = records.iter().map(|record| record.blob.len() as u64).sum();
        if usage.bytes.saturating_add(bytes) > rules.bytes {
            return Err(self.over(account, format_args!("{} bytes", rules.bytes)));
        }
        let mut fresh = BTreeSet::new();
        for record in records {
            let header = &record.header;
            let type_name = header.filters.first().map(|id| hex(&id.0)).unwrap_or_default();
            let place = (header.recorder, header.topic_id);
            let known = ledger.counts.has_stream(*account, place, (header.kind, &type_name, header.signer));
            if !known.map_err(Refusal::internal)? {
                fresh.insert((place.0.0, place.1.0, header.kind.code(), type_name, header.signer.0));
            }
        }
        if usage.streams.saturating_add(fresh.len() as u64) > rules.streams {
            return Err(self.over(account, format_args!("{} streams", rules.streams)));
        }
        Ok(())
    }

    fn over(&self, account: &Address, what: std::fmt::Arguments<'_>) -> Refusal {
        let how = "lifts its guest quota";
        Refusal::new(
            Code::Quota,
            format_args!("{account} has reached its quota of {what}; `authros gateway allow {account}` {how}"),
        )
    }
}
