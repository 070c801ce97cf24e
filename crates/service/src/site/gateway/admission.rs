//! Who may use the gateway of this home: the keeper's choice. The home's own profiles always may, others once they are
//! admitted; an open gateway accepts everybody else too, within quotas.

use std::collections::BTreeSet;

use super::{GatewayDesk, reserved};
use crate::gateway::{Code, Received, Refusal};
use crate::model::bytes::hex;
use crate::model::{Address, ProfileName};
use crate::pipeline::Network;

/// The most owners that an open gateway accepts without admission.
const MOST_GUESTS: usize = 256;

/// Why an owner may use the gateway.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// A profile of this home, or on the list.
    Admitted,
    /// Nobody admitted it; the gateway is open.
    Guest,
}

impl GatewayDesk {
    /// Why an account may use this gateway.
    ///
    /// # Errors
    /// [`Refusal`] with `NotAuthorised`, whose detail says what the keeper may do.
    pub(super) fn standing_of(&self, network: &Network, account: &Address) -> Result<Standing, Refusal> {
        let gateway = &self.gateway;
        let own = || gateway.owners.all().iter().any(|owner| owner.address == *account);
        if self.home_accounts.contains(account) || gateway.admissions.is_on_list(account) || own() {
            return Ok(Standing::Admitted);
        }
        // The successor of a lost account takes its place.
        if gateway.admissions.listed().iter().any(|lost| network.directory.successor(*lost) == Some(*account)) {
            return Ok(Standing::Admitted);
        }
        if self.open {
            return Ok(Standing::Guest);
        }
        let detail = format!("{account} is not admitted; `authros gateway admit {account}` admits it to this gateway");
        Err(Refusal::new(Code::NotAuthorised, detail))
    }

    /// Whether an account may have one more name here.
    ///
    /// # Errors
    /// [`Refusal`] with `NameBound`, `NotAuthorised` or `Quota`.
    pub(super) fn check_name(&self, network: &Network, account: &Address, name: &ProfileName) -> Result<(), Refusal> {
        reserved::check(name, account)?;
        if self.standing_of(network, account)? == Standing::Admitted {
            return Ok(());
        }
        let bound = self.gateway.plant.ledger.bound_names().map_err(Refusal::because(Code::Internal))?;
        let own = bound.iter().filter(|(_, owner)| owner == account).count();
        let known = bound.iter().any(|(other, owner)| owner == account && other == name.as_str());
        let most = self.gateway.config.gateway.names;
        if !known && own as u64 >= most {
            return Err(self.over(account, format_args!("{most} names")));
        }
        let guests: BTreeSet<&Address> =
            bound.iter().map(|(_, owner)| owner).filter(|owner| !self.gateway.admissions.is_on_list(owner)).collect();
        if own == 0 && guests.len() >= MOST_GUESTS {
            return Err(self.over(account, format_args!("{MOST_GUESTS} owners who are not admitted")));
        }
        Ok(())
    }

    /// Whether these records of a guest fit its quotas. The caller holds off other records of guests meanwhile.
    ///
    /// # Errors
    /// [`Refusal`] with `NotAuthorised` or `Quota`.
    pub(super) fn check_quota(&self, account: &Address, records: &[Received]) -> Result<(), Refusal> {
        let (ledger, rules) = (&self.gateway.plant.ledger, &self.gateway.config.gateway);
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
        let how = "lifts its guest quota";
        Refusal::new(
            Code::Quota,
            format_args!("{account} has reached its quota of {what}; `authros gateway admit {account}` {how}"),
        )
    }
}
