//! The address book of this home, never on the chain: names for accounts, and their known fingerprints.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use tokio::task::block_in_place;

use crate::crypto::Fingerprint;
use crate::model::{Address, ContactName, Party, ProfileName, natural};
use crate::pipeline::Network;
use crate::reply::{CompareView, ContactRow, Part, Result, input, refused};
use crate::site::Parts;
use crate::store::notes::{AddressBook, Contact, WrappedFor};

const MOST_CONTACTS: usize = 1_000;

fn read(text: &str) -> Result<Fingerprint> {
    text.parse().map_err(|error| input(format!("{error}")))
}

pub struct Contacts {
    parts: Parts,
    changing: tokio::sync::Mutex<()>,
}

impl Contacts {
    pub fn new(parts: &Parts) -> Self {
        Self { parts: parts.clone(), changing: tokio::sync::Mutex::default() }
    }

    fn book(&self) -> Result<Vec<Contact>> {
        Ok(self.parts.plant.ledger.notes.read(&AddressBook {})?.unwrap_or_default())
    }

    fn write_book(&self, book: &Vec<Contact>) -> Result<()> {
        self.parts.plant.ledger.notes.write(&AddressBook {}, book)?;
        self.parts.hub.changed(Part::Grants);
        Ok(())
    }

    pub(crate) fn resolve(&self, party: &Party) -> Result<Address> {
        match party {
            Party::Address(address) => Ok(*address),
            Party::Contact(name) => match self.contact(name) {
                Ok(contact) => Ok(contact.address),
                Err(unknown) => self.of_profile(name).ok_or(unknown),
            },
        }
    }

    /// A profile of this home goes by its own name, unless the address book has that.
    fn of_profile(&self, name: &ContactName) -> Option<Address> {
        let profile: ProfileName = name.to_string().parse().ok()?;
        self.parts.owners.address_of(&profile).ok()
    }

    fn contact(&self, name: &ContactName) -> Result<Contact> {
        let found = self.book()?.into_iter().find(|contact| contact.name == *name);
        found.ok_or_else(|| {
            input(format!(
                "'{name}' is not in the address book; `authros contacts list` shows it, `authros contacts add {name} \
                 ADDRESS` adds"
            ))
        })
    }

    pub(crate) fn names(&self) -> Result<BTreeMap<Address, String>> {
        let book = self.book()?;
        Ok(book.into_iter().map(|contact| (contact.address, contact.name.to_string())).collect())
    }

    pub fn registered_fingerprint(network: &Network, account: Address) -> Option<String> {
        network.directory.identity(account).ok().map(|identity| Fingerprint::of(&identity.signing).to_string())
    }

    /// Notes the registered fingerprint unless one is given.
    pub async fn add(
        &self,
        profile: &ProfileName,
        name: ContactName,
        address: Address,
        fingerprint: Option<String>,
    ) -> Result<Vec<ContactRow>> {
        let given = fingerprint.is_some();
        if !given && self.parts.is_joined() {
            return Err(refused(format!(
                "the key of {address} is known here only from a gateway; get its fingerprint from its owner over \
                 another channel, then run `authros contacts add {name} {address} --fingerprint FINGERPRINT`"
            )));
        }
        let fingerprint = fingerprint.map(|text| read(&text)).transpose()?.map(|found| found.to_string());
        let network = self.parts.link.network().await.ok();
        let registered = network.as_ref().and_then(|network| Self::registered_fingerprint(network, address));
        // A given fingerprint outranks a gateway's word; `list` shows the difference.
        if let (Some(given), Some(registered)) = (&fingerprint, &registered)
            && given != registered
            && !self.parts.is_joined()
        {
            return Err(refused(format!(
                "{address} has registered {registered}, not {given}, so '{name}' was not added; ask '{name}' over another \
                 channel which one is right"
            )));
        }
        let changing = self.changing.lock().await;
        let mut book = self.book()?;
        let is_same = |known: &Contact| {
            let same_key = !given || known.given && known.fingerprint == fingerprint;
            known.name == name && known.address == address && same_key
        };
        // A repeated script changes nothing.
        if book.iter().any(is_same) {
            return self.rows().await;
        }
        if let Some(known) = book.iter().find(|contact| contact.name == name || contact.address == address) {
            let (name, address) = (&known.name, known.address);
            return Err(refused(format!(
                "the address book already has '{name}' for {address}; `authros contacts remove {name}` removes it"
            )));
        }
        if book.len() >= MOST_CONTACTS {
            return Err(refused(format!("the address book holds at most {MOST_CONTACTS} contacts; remove one first")));
        }
        let subject = format!("{name} {address}");
        book.push(Contact { name, address, fingerprint: fingerprint.or(registered), given });
        book.sort_by(|one, other| natural(one.name.as_str(), other.name.as_str()));
        self.parts.log.deed(profile, "contact add", &subject, async { self.write_book(&book) }).await?;
        drop(changing);
        self.rows().await
    }

    pub async fn remove(&self, profile: &ProfileName, name: &ContactName) -> Result<Vec<ContactRow>> {
        let changing = self.changing.lock().await;
        let contact = self.contact(name)?;
        let mut book = self.book()?;
        book.retain(|other| *other != contact);
        let subject = format!("{name} {}", contact.address);
        self.parts.log.deed(profile, "contact remove", &subject, async { self.write_book(&book) }).await?;
        drop(changing);
        self.rows().await
    }

    /// Trusts the registered key; with a fingerprint, only that one.
    pub async fn confirm(
        &self,
        profile: &ProfileName,
        name: &ContactName,
        fingerprint: Option<String>,
    ) -> Result<Vec<ContactRow>> {
        let network = self.parts.link.network().await?;
        let changing = self.changing.lock().await;
        let contact = self.contact(name)?;
        if fingerprint.is_none() && self.parts.is_joined() {
            return Err(refused(format!(
                "the key of '{name}' is known here only from a gateway; get its fingerprint from its owner over \
                 another channel, then run `authros contacts confirm {name} --fingerprint FINGERPRINT`"
            )));
        }
        let identity = network.directory.identity(contact.address)?;
        let registered = Fingerprint::of(&identity.signing);
        if let Some(given) = fingerprint.map(|text| read(&text)).transpose()?
            && given != registered
        {
            let address = contact.address;
            return Err(refused(format!(
                "{address} has registered {registered}, not {given}; ask '{name}' over another channel which one is right"
            )));
        }
        let mut book = self.book()?;
        for other in book.iter_mut().filter(|other| other.name == *name) {
            (other.fingerprint, other.given) = (Some(registered.to_string()), true);
        }
        let subject = format!("{name} {registered}");
        self.parts.log.deed(profile, "contact confirm", &subject, async { self.write_book(&book) }).await?;
        drop(changing);
        self.rows().await
    }

    pub async fn rows(&self) -> Result<Vec<ContactRow>> {
        let network = self.parts.link.network().await.ok();
        let row = |contact: Contact| {
            let registered =
                network.as_ref().and_then(|network| Self::registered_fingerprint(network, contact.address));
            let state = match (&contact.fingerprint, &registered) {
                (_, None) => "not registered",
                (None, Some(_)) => "not noted",
                (Some(noted), Some(found)) if noted == found => "same",
                (Some(_), Some(_)) => "differs",
            };
            let Contact { name, address, fingerprint, given } = contact;
            ContactRow { name, address, fingerprint, given, registered, state: state.to_owned() }
        };
        Ok(self.book()?.into_iter().map(row).collect())
    }

    pub fn changed_contacts(&self, network: &Network) -> Result<Vec<String>> {
        let changed = |contact: &Contact| {
            let (noted, found) =
                (contact.fingerprint.as_ref()?, Self::registered_fingerprint(network, contact.address)?);
            (*noted != found).then(|| changed_text(contact, &found))
        };
        Ok(self.book()?.iter().filter_map(changed).collect())
    }

    /// Allows wrapping keys only for the noted key; notes one that was missing.
    pub async fn check_contact(&self, network: &Network, account: Address) -> Result<()> {
        let _one_at_a_time = self.changing.lock().await;
        let mut book = self.book()?;
        let contact = book.iter_mut().find(|contact| contact.address == account);
        if self.parts.is_joined() && contact.as_ref().is_none_or(|contact| !contact.given) {
            let how = match contact {
                Some(Contact { name, .. }) => format!("authros contacts confirm {name} --fingerprint FINGERPRINT"),
                None => format!("authros contacts add NAME {account} --fingerprint FINGERPRINT"),
            };
            return Err(refused(format!(
                "the key of {account} is known here only from a gateway, which could substitute its own: get its \
                 fingerprint from its owner over another channel, then run `{how}` before granting"
            )));
        }
        let Some(contact) = contact else { return Ok(()) };
        let Some(found) = Self::registered_fingerprint(network, account) else { return Ok(()) };
        match &contact.fingerprint {
            Some(noted) if *noted == found => Ok(()),
            Some(_) => Err(refused(changed_text(contact, &found))),
            None => {
                contact.fingerprint = Some(found);
                self.write_book(&book)
            }
        }
    }

    /// On a gateway's word alone, a key that changed since the last epoch must be compared first.
    pub async fn check_reader(&self, network: &Network, owner: Address, reader: Address) -> Result<()> {
        let Some(found) = Self::registered_fingerprint(network, reader).filter(|_| self.parts.is_joined()) else {
            return Ok(());
        };
        let note = WrappedFor { owner, reader };
        match self.parts.plant.ledger.notes.read(&note)? {
            Some(noted) if noted == found => return Ok(()),
            Some(_) => self.check_contact(network, reader).await?,
            None => {}
        }
        Ok(self.parts.plant.ledger.notes.write(&note, &found)?)
    }

    pub async fn compare(&self, profile: &ProfileName, given: &str, account: Option<Party>) -> Result<CompareView> {
        let given = read(given)?;
        let (account, fingerprint) = match account {
            Some(party) => {
                let account = self.resolve(&party)?;
                let identity = self.parts.link.network().await?.directory.identity(account)?;
                (account, Fingerprint::of(&identity.signing))
            }
            None => {
                let path = self.parts.home.keyring(profile);
                if !path.exists() {
                    self.parts.owners.unlocked(profile)?;
                }
                let public = block_in_place(|| crate::crypto::read_public(&path))?;
                (public.address, Fingerprint::of(&public.signing))
            }
        };
        Ok(CompareView {
            account,
            name: self.names()?.remove(&account),
            fingerprint: fingerprint.to_string(),
            given: given.to_string(),
            equal: fingerprint == given,
        })
    }
}

fn changed_text(contact: &Contact, found: &str) -> String {
    let Contact { name, address, .. } = contact;
    let noted = contact.fingerprint.as_deref().unwrap_or_default();
    format!(
        "'{name}' ({address}) has registered the key {found}, not {noted} as noted here; compare the fingerprint with \
         '{name}' over another channel, then run `authros contacts confirm {name}` before granting"
    )
}
