//! Each request of a connection, judged before it is answered.

use std::sync::Arc;

use super::asker::Acting;
use super::{Asker, Operators};
use crate::crypto::{Passphrase, UnlockedKeyring};
use crate::model::{OperatorName, OperatorRight, ProfileName};
use crate::service::command::{Command, Needed, Request, SecretText};
use crate::service::failure::refused;
use crate::service::reply::{Failure, OperatorState, Reply};
use crate::site::audit::acting::{acting_as, by};
use crate::site::consoles::Claims;
use crate::site::{Site, blocking};

impl Site {
    /// Answers a request of a connection if whoever asks may make it; an operator is named in each line of its deeds.
    ///
    /// # Errors
    /// That the right is missing, or errors of the command's part.
    pub(in crate::site) async fn answer(self: &Arc<Self>, request: Request, claims: &Claims) -> Result<Reply, Failure> {
        match self.operators.judge(&request, &claims.asker).await? {
            Some(operator) => acting_as(operator, Box::pin(self.handle(request, claims))).await,
            None => self.handle(request, claims).await,
        }
    }
}

impl Operators {
    /// The operator for whom a request is answered; `None` for the owner, and for what anybody may ask.
    pub(super) async fn judge(
        self: &Arc<Self>,
        request: &Request,
        asker: &Asker,
    ) -> Result<Option<OperatorName>, Failure> {
        let (profile, needed) = (&request.profile, request.command.needs());
        if needed == Needed::Nothing {
            return Ok(None);
        }
        if let Some(acting) = asker.acting() {
            self.allow(&acting, asker, (profile, needed)).await?;
            return Ok(Some(acting.name));
        }
        if !self.config.operators_required || asker.is_owner(profile) {
            return Ok(None);
        }
        if let Command::Unlock { passphrase } = &request.command {
            self.check_passphrase(profile, passphrase).await?;
            asker.prove(profile);
            return Ok(None);
        }
        if counts(needed) {
            let _first = self.log.refused(profile.as_str(), "nobody known");
        }
        Err(refused(
            "this site answers operators, and whoever gives the profile's passphrase (operators.required = yes); pass \
             --operator FILE, or --passphrase-file or --passphrase-fd",
        ))
    }

    async fn allow(
        self: &Arc<Self>,
        acting: &Acting,
        asker: &Asker,
        (profile, needed): (&ProfileName, Needed),
    ) -> Result<(), Failure> {
        let Some(why) = self.refusal(acting, asker, (profile, needed)).await? else { return Ok(()) };
        if counts(needed) {
            let who = by(acting.profile.as_str(), &acting.name);
            let _first = self.log.refused(&who, &format!("needs {}", needed.word()));
        }
        Err(refused(why))
    }

    /// Why an operator may not do this now; `None` if it may.
    pub(super) async fn refusal(
        self: &Arc<Self>,
        acting: &Acting,
        asker: &Asker,
        (profile, needed): (&ProfileName, Needed),
    ) -> Result<Option<String>, Failure> {
        let name = &acting.name;
        if acting.profile != *profile {
            return Ok(Some(format!("'{name}' is an operator of profile '{}', not of '{profile}'", acting.profile)));
        }
        let (list, certifier) = self.stated(profile).await?;
        let Some(statement) = list.of(name).filter(|statement| statement.terms.key == acting.key) else {
            asker.end();
            return Ok(Some(format!("operator '{name}' was removed; ask the owner of profile '{profile}'")));
        };
        let state = self.state(profile, statement, &certifier)?;
        if state != OperatorState::Stands {
            asker.end();
            return Ok(Some(format!(
                "operator '{name}' may not act now ({}); ask the owner of profile '{profile}' to add it again",
                state.word()
            )));
        }
        let rights = statement.terms.rights;
        Ok(match needed {
            Needed::Nothing => None,
            Needed::Right(right) if rights.has(right) => None,
            Needed::Right(right) => Some(format!(
                "this needs the right '{}'; operator '{name}' has {rights}; ask the owner of profile '{profile}'",
                right.word()
            )),
            Needed::Owner => Some(format!(
                "only the owner of profile '{profile}' may do this, and '{name}' is an operator with {rights}"
            )),
        })
    }

    /// Opens the keyring, also where it is open: whoever asks has to know its passphrase.
    async fn check_passphrase(self: &Arc<Self>, profile: &ProfileName, secret: &SecretText) -> Result<(), Failure> {
        let passphrase = Passphrase::new(secret.expose().to_owned())?;
        let path = self.home.keyring(profile);
        let _one_at_a_time = self.proving.lock().await;
        let opened = blocking(self, move |_| Ok(UnlockedKeyring::open(&path, &passphrase).map(drop)?)).await;
        if opened.is_err() {
            let _first = self.log.refused(profile.as_str(), "passphrase");
        }
        opened
    }
}

/// Whether a refused request is counted: one that only looks changes nothing.
fn counts(needed: Needed) -> bool {
    needed != Needed::Right(OperatorRight::Look)
}
