//! Who may use the gateway of this home: the keeper's choice. The home's own profiles always may, others once they are
//! admitted; an open gateway takes everybody else too, within quotas.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError};

use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;

use super::GatewayDesk;
use crate::gateway::{Code, Received, Refusal};
use crate::model::bytes::hex;
use crate::model::{Address, Party, ProfileName, Timestamp};
use crate::pipeline::Network;
use crate::service::event::Part;
use crate::service::failure::{input, internal, refused};
use crate::service::reply::{AdmittedView, Failure};
use crate::service::site::Site;

/// Where the list lies in the ledger.
const LIST: &str = "gateway admitted";
/// The most owners on it.
const MOST: usize = 10_000;
/// The most owners whom an open gateway takes unasked.
const MOST_GUESTS: usize = 256;

/// One owner on the list.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Admitted {
    owner: Address,
    since: Timestamp,
    /// Who admitted it, or why it is here.
    by: String,
}

/// How an owner comes to use the gateway.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// A profile of this home, or on the list.
    Admitted,
    /// Nobody asked; the gateway is open.
    Guest,
}

impl Site {
    /// The list as the ledger has it. The first time, it holds everybody who has a name at this gateway already: an
    /// upgrade locks nobody out.
    fn admissions(&self) -> Result<Vec<Admitted>, Failure> {
        let ledger = &self.plant.ledger;
        if let Some(text) = block_in_place(|| ledger.setting(LIST))? {
            return serde_json::from_str(&text)
                .map_err(|_| input("the list of admitted owners in the ledger cannot be read; restore a backup"));
        }
        let bound: BTreeSet<Address> =
            block_in_place(|| ledger.bound_names())?.into_iter().map(|(_, owner)| owner).collect();
        let since = Timestamp::now();
        let by = "had a name here before owners were admitted";
        let list = bound.into_iter().map(|owner| Admitted { owner, since, by: by.to_owned() }).collect();
        self.keep_admissions(&list)?;
        Ok(list)
    }

    fn keep_admissions(&self, list: &Vec<Admitted>) -> Result<(), Failure> {
        let text = serde_json::to_string(list).map_err(|error| internal(error.to_string()))?;
        block_in_place(|| self.plant.ledger.put_setting(LIST, &text))?;
        let owners = list.iter().map(|admitted| admitted.owner).collect();
        *self.admitted.write().unwrap_or_else(PoisonError::into_inner) = Some(owners);
        self.hub.changed(Part::Health);
        Ok(())
    }

    /// Reads the list, so that [`Self::is_on_list`] can tell.
    pub(super) fn open_admissions(&self) -> Result<(), Failure> {
        let owners = self.admissions()?.iter().map(|admitted| admitted.owner).collect();
        *self.admitted.write().unwrap_or_else(PoisonError::into_inner) = Some(owners);
        Ok(())
    }

    fn listed(&self) -> BTreeSet<Address> {
        self.admitted.read().unwrap_or_else(PoisonError::into_inner).clone().unwrap_or_default()
    }

    fn is_on_list(&self, owner: &Address) -> bool {
        let listed = self.admitted.read().unwrap_or_else(PoisonError::into_inner);
        listed.as_ref().is_some_and(|owners| owners.contains(owner))
    }

    /// Lets an owner use the gateway of this home.
    pub(in crate::site) async fn admit(
        self: &Arc<Self>,
        profile: &ProfileName,
        owner: &Party,
    ) -> Result<Vec<AdmittedView>, Failure> {
        let owner = self.contacts.resolve(owner)?;
        {
            let _one_at_a_time = self.admitting.lock().await;
            let mut list = self.admissions()?;
            if !list.iter().any(|admitted| admitted.owner == owner) {
                if list.len() >= MOST {
                    return Err(refused(format!("a gateway admits at most {MOST} owners; dismiss one first")));
                }
                self.log.write(profile, "gateway admit", &owner.to_string(), "done").await?;
                list.push(Admitted { owner, since: Timestamp::now(), by: profile.to_string() });
                self.keep_admissions(&list)?;
            }
        }
        self.admitted_rows()
    }

    /// Ends it: from the next Command on the owner is refused. What it sent is kept and anchored.
    pub(in crate::site) async fn dismiss(
        self: &Arc<Self>,
        profile: &ProfileName,
        owner: &Party,
    ) -> Result<Vec<AdmittedView>, Failure> {
        let owner = self.contacts.resolve(owner)?;
        if self.home_accounts().contains(&owner) {
            return Err(refused(format!("{owner} is a profile of this home, which always may use its gateway")));
        }
        {
            let _one_at_a_time = self.admitting.lock().await;
            let mut list = self.admissions()?;
            let before = list.len();
            list.retain(|admitted| admitted.owner != owner);
            if list.len() == before {
                return Err(input(format!("{owner} is not admitted; `authros gateway admitted` lists who is")));
            }
            self.log.write(profile, "gateway dismiss", &owner.to_string(), "done").await?;
            self.keep_admissions(&list)?;
        }
        self.admitted_rows()
    }

    /// Who is admitted, with the names of the address book.
    pub(in crate::site) fn admitted_rows(&self) -> Result<Vec<AdmittedView>, Failure> {
        let (names, list) = (self.contacts.names(), self.admissions()?);
        let row = |admitted: Admitted| AdmittedView {
            owner: admitted.owner,
            name: names.get(&admitted.owner).cloned(),
            since: admitted.since,
            by: admitted.by,
        };
        Ok(list.into_iter().map(row).collect())
    }

    /// Accounts of this home's profiles, those included that are not open.
    fn home_accounts(&self) -> BTreeSet<Address> {
        let open = self.owners.all().iter().map(|owner| owner.address).collect::<BTreeSet<_>>();
        let kept = self.home.profiles().into_iter().filter_map(|profile| {
            let public = block_in_place(|| crate::crypto::read_public(&self.home.keyring(&profile)));
            // One that cannot be read is told of where it is opened.
            public.ok().map(|public| public.address)
        });
        open.into_iter().chain(kept).collect()
    }
}

impl GatewayDesk {
    /// How an account comes to use this gateway.
    ///
    /// # Errors
    /// [`Refusal`] with `NotAuthorised`, whose detail says what the keeper may do.
    pub(super) fn standing_of(&self, network: &Network, account: &Address) -> Result<Standing, Refusal> {
        let site = &self.site;
        let own = || site.owners.all().iter().any(|owner| owner.address == *account);
        if self.home_accounts.contains(account) || site.is_on_list(account) || own() {
            return Ok(Standing::Admitted);
        }
        // Whoever continues for a lost account stands where it stood.
        if site.listed().iter().any(|lost| network.directory.successor(*lost) == Some(*account)) {
            return Ok(Standing::Admitted);
        }
        if self.open {
            return Ok(Standing::Guest);
        }
        let detail = format!("{account} is not admitted; `authros gateway admit {account}` lets it use this gateway");
        Err(Refusal::new(Code::NotAuthorised, detail))
    }

    /// Whether an account may have one more name here.
    ///
    /// # Errors
    /// [`Refusal`] with `NotAuthorised` or `Quota`.
    pub(super) fn check_name(&self, network: &Network, account: &Address, name: &ProfileName) -> Result<(), Refusal> {
        if self.standing_of(network, account)? == Standing::Admitted {
            return Ok(());
        }
        let bound = self.site.plant.ledger.bound_names().map_err(Refusal::because(Code::Internal))?;
        let own = bound.iter().filter(|(_, owner)| owner == account).count();
        let known = bound.iter().any(|(other, owner)| owner == account && other == name.as_str());
        let most = self.site.config.gateway.names;
        if !known && own as u64 >= most {
            return Err(self.over(account, format_args!("{most} names")));
        }
        let guests: BTreeSet<&Address> =
            bound.iter().map(|(_, owner)| owner).filter(|owner| !self.site.is_on_list(owner)).collect();
        if own == 0 && guests.len() >= MOST_GUESTS {
            return Err(self.over(account, format_args!("{MOST_GUESTS} owners that nobody admitted")));
        }
        Ok(())
    }

    /// Whether these records of a guest fit its quotas. The caller holds off other records of guests meanwhile.
    ///
    /// # Errors
    /// [`Refusal`] with `NotAuthorised` or `Quota`.
    pub(super) fn check_quota(&self, account: &Address, records: &[Received]) -> Result<(), Refusal> {
        let (ledger, rules) = (&self.site.plant.ledger, &self.site.config.gateway);
        let internal = Refusal::because(Code::Internal);
        let usage = ledger.owner_usage(*account).map_err(&internal)?;
        let bytes: u64 = records.iter().map(|record| record.blob.len() as u64).sum();
        if usage.bytes.saturating_add(bytes) > rules.bytes {
            return Err(self.over(account, format_args!("{} bytes", rules.bytes)));
        }
        let mut fresh = BTreeSet::new();
        for record in records {
            let header = &record.header;
            let type_name = header.filters.first().map(|id| hex(&id.0)).unwrap_or_default();
            let place = (header.recorder, header.topic_id);
            let known = ledger.has_stream(*account, place, (header.kind, &type_name, header.signer));
            if !known.map_err(&internal)? {
                fresh.insert((place.0.0, place.1.0, header.kind.code(), type_name, header.signer.0));
            }
        }
        if usage.streams.saturating_add(fresh.len() as u64) > rules.streams {
            return Err(self.over(account, format_args!("{} streams", rules.streams)));
        }
        Ok(())
    }

    fn over(&self, account: &Address, what: std::fmt::Arguments<'_>) -> Refusal {
        let how = "lifts the quotas of guests";
        Refusal::new(
            Code::Quota,
            format_args!("{account} may have no more than {what}; `authros gateway admit {account}` {how}"),
        )
    }

    /// Accounts of the home's profiles when the gateway was started.
    pub(super) fn accounts_of(site: &Site) -> BTreeSet<Address> {
        site.home_accounts()
    }
}
