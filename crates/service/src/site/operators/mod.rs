//! Operators of profiles: certified by the owner's key, known by a signature over a challenge of their connection, and
//! judged by request. Each request reads what is stated of them now, so an end is heeded by connections that stand.

mod asker;
mod ends;
mod hearing;
mod judging;
#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::sync::Arc;

pub(crate) use asker::Asker;
pub(crate) use hearing::Heard;

use super::audit::Log;
use super::blocking;
use super::consoles::Claims;
use super::identity::owners::Owners;
use super::lifetime::Lifetime;
use super::parts::Parts;
use crate::config::Config;
use crate::crypto::{
    MOST_OPERATORS, OperatorList, OperatorStatement, OperatorTerms, check_operator, random_bytes, read_public,
    signer_id,
};
use crate::model::steady_clock::look;
use crate::model::{Address, Digest, OperatorName, ProfileName, PublicKey, Signature, Timestamp};
use crate::paths::Home;
use crate::pipeline::{Owner, Plant};
use crate::service::command::{self as ask, Ask as _, OperatorCommand};
use crate::service::failure::{input, refused};
use crate::service::reply::{Failure, OperatorChallenge, OperatorState, OperatorView, Reply};
use asker::Acting;
use ends::Ends;
use tokio::task::block_in_place;

/// The operators of a home's profiles.
pub(super) struct Operators {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    log: Arc<Log>,
    owners: Arc<Owners>,
    life: Arc<Lifetime>,
    ends: Ends,
    changing: tokio::sync::Mutex<()>,
    /// Told when statements change, and when a connection becomes an operator's.
    changed: tokio::sync::watch::Sender<()>,
    /// Deriving a key from a passphrase takes 128 MiB: one at a time.
    proving: tokio::sync::Mutex<()>,
}

/// Whose signature counts: P_C and the account of a profile.
type Certifier = (PublicKey, Address);

impl Operators {
    /// From the shared parts.
    pub fn new(parts: &Parts) -> Self {
        let Parts { home, config, plant, log, owners, life, .. } = parts.clone();
        Self {
            home,
            config,
            ends: Ends::new(plant.ledger.clone()),
            plant,
            log,
            owners,
            life,
            changing: tokio::sync::Mutex::default(),
            changed: tokio::sync::watch::Sender::default(),
            proving: tokio::sync::Mutex::default(),
        }
    }

    /// Answers one of the requests about operators.
    pub async fn answer(
        self: &Arc<Self>,
        profile: &ProfileName,
        command: OperatorCommand,
        claims: &Claims,
    ) -> Result<Reply, Failure> {
        match command {
            OperatorCommand::AddOperator { name, key, rights, until } => {
                let terms = OperatorTerms { name, key, rights, from: Timestamp::now(), until };
                self.add(&self.owners.unlocked(profile)?, terms).await.map(ask::AddOperator::told)
            }
            OperatorCommand::RemoveOperator { name } => {
                self.remove(profile, &name).await.map(ask::RemoveOperator::told)
            }
            OperatorCommand::ListOperators => self.rows(profile).await.map(ask::ListOperators::told),
            OperatorCommand::ChallengeOperator => {
                let challenge = random_bytes()?;
                claims.asker.challenge(challenge);
                let account = self.owners.address_of(profile)?;
                Ok(ask::ChallengeOperator::told(OperatorChallenge { challenge: Digest(challenge), account }))
            }
            OperatorCommand::ActAsOperator { name, proof } => {
                self.act(profile, name, proof, &claims.asker).await.map(ask::ActAsOperator::told)
            }
        }
    }

    fn file(&self, profile: &ProfileName) -> PathBuf {
        self.home.profile(profile).join("operators")
    }

    /// Waits for the disk.
    fn certifier(&self, profile: &ProfileName) -> Result<Certifier, Failure> {
        if let Some(owner) = self.owners.get(profile) {
            return Ok((owner.public_keys().0, owner.address));
        }
        let public = read_public(&self.home.keyring(profile))?;
        Ok((public.signing, public.address))
    }

    /// The statements of a profile, and whose signature they need.
    async fn stated(self: &Arc<Self>, profile: &ProfileName) -> Result<(OperatorList, Certifier), Failure> {
        let profile = profile.clone();
        blocking(self, move |operators| {
            Ok((OperatorList::read(&operators.file(&profile))?, operators.certifier(&profile)?))
        })
        .await
    }

    fn state(
        &self,
        profile: &ProfileName,
        statement: &OperatorStatement,
        (signing, account): &Certifier,
    ) -> Result<OperatorState, Failure> {
        let (clock, terms) = (look(), &statement.terms);
        if statement.check(self.plant.provider, signing, account).is_err() {
            return Ok(OperatorState::NotSigned);
        }
        let is_over = block_in_place(|| self.ends.is_over(profile, terms, &clock))?;
        Ok(if is_over {
            OperatorState::Expired
        } else if clock.machine < terms.from {
            OperatorState::NotYet
        } else {
            OperatorState::Stands
        })
    }

    fn view(
        &self,
        profile: &ProfileName,
        statement: &OperatorStatement,
        certifier: &Certifier,
    ) -> Result<OperatorView, Failure> {
        let state = self.state(profile, statement, certifier)?;
        let OperatorTerms { name, key, rights, from, until } = statement.terms.clone();
        Ok(OperatorView { name, key: signer_id(&key), rights, from, until, state })
    }

    async fn rows(self: &Arc<Self>, profile: &ProfileName) -> Result<Vec<OperatorView>, Failure> {
        let (list, certifier) = self.stated(profile).await?;
        list.0.iter().map(|statement| self.view(profile, statement, &certifier)).collect()
    }

    async fn write(self: &Arc<Self>, profile: &ProfileName, list: OperatorList) -> Result<(), Failure> {
        let path = self.file(profile);
        let written = blocking(self, move |_| Ok(list.write(&path)?)).await;
        self.changed.send_replace(());
        written
    }

    async fn add(self: &Arc<Self>, owner: &Arc<Owner>, terms: OperatorTerms) -> Result<Vec<OperatorView>, Failure> {
        let (profile, name) = (&owner.profile, &terms.name);
        if terms.until.is_some_and(|until| until <= terms.from) {
            return Err(input("the end of an operator's time must be later than now"));
        }
        let (signing, envelope) = owner.public_keys();
        if [signing, envelope].contains(&terms.key) {
            return Err(input("that is a key of the profile itself; an operator needs one of its own"));
        }
        let _one_at_a_time = self.changing.lock().await;
        let (mut list, certifier) = self.stated(profile).await?;
        if list.of(name).is_some() {
            return Err(refused(format!(
                "profile '{profile}' has an operator '{name}' already; end it first with `authros operators remove {name}`"
            )));
        }
        if let Some(other) = list.0.iter().find(|other| other.terms.key == terms.key) {
            return Err(refused(format!(
                "this key is that of operator '{}'; give each a key of its own",
                other.terms.name
            )));
        }
        if list.0.len() >= MOST_OPERATORS {
            return Err(refused(format!("a profile has at most {MOST_OPERATORS} operators; remove one first")));
        }
        let end = terms.until.map_or_else(String::new, |until| format!(" until {until}"));
        let subject = format!("{name}: {}{end} (key {})", terms.rights, signer_id(&terms.key));
        let statement = OperatorStatement::sign(self.plant.provider, &owner.signing(), &certifier.1, terms)?;
        self.log.begin(owner, "add operator", &subject).await?;
        list.0.push(statement);
        let written = self.write(profile, list).await;
        self.log.end(owner, "add operator", &subject, written).await?;
        self.rows(profile).await
    }

    /// Needs no keyring: an end must be possible at any time.
    async fn remove(
        self: &Arc<Self>,
        profile: &ProfileName,
        name: &OperatorName,
    ) -> Result<Vec<OperatorView>, Failure> {
        let _one_at_a_time = self.changing.lock().await;
        let (mut list, _) = self.stated(profile).await?;
        let Some(statement) = list.of(name) else {
            return Err(input(format!(
                "profile '{profile}' has no operator '{name}'; `authros operators list` shows them"
            )));
        };
        let subject = format!("{name} (key {})", signer_id(&statement.terms.key));
        list.0.retain(|other| other.terms.name != *name);
        self.log.deed(profile, "remove operator", &subject, self.write(profile, list)).await?;
        self.rows(profile).await
    }

    /// Takes a connection for that of an operator, who signed its challenge.
    async fn act(
        self: &Arc<Self>,
        profile: &ProfileName,
        name: OperatorName,
        proof: Signature,
        asker: &Asker,
    ) -> Result<OperatorView, Failure> {
        let challenge = asker.take_challenge();
        let (list, certifier) = self.stated(profile).await?;
        let view = list.of(&name).map(|statement| self.view(profile, statement, &certifier)).transpose()?;
        let standing = view.filter(|view| view.state == OperatorState::Stands);
        let proven = challenge.zip(list.of(&name).zip(standing)).filter(|(challenge, (statement, _))| {
            let asked = (challenge, &certifier.1, profile.as_str());
            check_operator(self.plant.provider, &statement.terms, asked, &proof).is_ok()
        });
        let Some((_, (statement, view))) = proven else {
            let _first = self.log.refused(profile.as_str(), "operator's proof");
            return Err(refused(format!(
                "'{name}' is no operator of profile '{profile}' now, or this is not its key, or the signature is of \
                 another connection; its owner sees who is one with `authros operators list`"
            )));
        };
        if !asker.act(Acting { profile: profile.clone(), name, key: statement.terms.key }) {
            return Err(refused("this connection acts as an operator already; open another one"));
        }
        self.changed.send_replace(());
        Ok(view)
    }
}
