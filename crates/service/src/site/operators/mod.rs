//! Operators at a site: Unix users whom the kernel names, with rights from the settings by user and by group. Their
//! standing is looked up again while they are connected, and each request is judged before anything answers it.

mod hearing;
mod judging;
mod listening;
#[cfg(test)]
mod tests;

use std::os::unix::fs::MetadataExt as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

pub(crate) use hearing::Heard;

use super::audit::Log;
use super::parts::Parts;
use super::{Site, blocking};
use crate::config::Config;
use crate::model::{ErrorKind, OperatorName, OperatorRights, ProfileName};
use crate::paths::Home;
use crate::service::accounts::{Account, AccountError};
use crate::service::command::Needed;
use crate::service::failure::refused;
use crate::service::reply::Failure;

/// How long an operator's standing counts once it was looked up.
const FRESH: Duration = Duration::from_secs(1);

/// Who asks through a connection.
#[derive(Clone, Default)]
pub(crate) enum Asker {
    /// The owner of the home.
    #[default]
    Owner,
    /// A user with rights.
    Operator(Arc<Operator>),
}

/// A user at the operators' socket.
pub(crate) struct Operator {
    uid: u32,
    name: OperatorName,
    /// What the user may do, and when that was looked up.
    standing: tokio::sync::Mutex<(Instant, OperatorRights)>,
}

/// The operators of a site.
pub(super) struct Operators {
    home: Home,
    config: Arc<Config>,
    log: Arc<Log>,
}

impl Operators {
    /// From the shared parts.
    pub fn new(parts: &Parts) -> Self {
        let Parts { home, config, log, .. } = parts.clone();
        Self { home, config, log }
    }

    /// Lets a user in who has rights here.
    async fn admit(self: &Arc<Self>, uid: u32) -> Result<Arc<Operator>, Failure> {
        let (name, rights) = self.standing(uid).await?.inspect_err(|error| self.count(&uid, error.word()))?;
        if rights.is_empty() {
            self.count(&name, "no right");
            return Err(refused(format!(
                "user '{name}' has no right at this site; ask its owner for one in [operators.rights]"
            )));
        }
        Ok(Arc::new(Operator { uid, name, standing: tokio::sync::Mutex::new((Instant::now(), rights)) }))
    }

    /// What an operator may do now.
    ///
    /// # Errors
    /// If the user has no right any more, or nobody can say who that is.
    async fn rights(self: &Arc<Self>, operator: &Operator) -> Result<OperatorRights, Failure> {
        let mut standing = operator.standing.lock().await;
        if standing.0.elapsed() >= FRESH {
            let (name, rights) = self.standing(operator.uid).await??;
            if name != operator.name {
                return Err(refused(format!("user '{}' is now '{name}'; connect again", operator.name)));
            }
            *standing = (Instant::now(), rights);
        }
        if standing.1.is_empty() {
            return Err(refused(format!("user '{}' has no right at this site any more; ask its owner", operator.name)));
        }
        Ok(standing.1.clone())
    }

    /// The name and the rights of a user; the outer error is that of a task that failed.
    async fn standing(
        self: &Arc<Self>,
        uid: u32,
    ) -> Result<Result<(OperatorName, OperatorRights), AccountError>, Failure> {
        blocking(self, move |operators| {
            let standing = Account::of(uid).and_then(|account| {
                let rights = account.rights(&operators.config.operators.rules)?;
                Ok((account.name, rights))
            });
            Ok(standing)
        })
        .await
    }

    /// Counts a refusal of a user who is nobody's operator.
    fn count(&self, user: &dyn std::fmt::Display, word: &str) {
        let _first = self.log.refused(&format!("user {user}"), word);
    }
}

impl Site {
    /// Refuses everybody but the owner of the home, root as well.
    ///
    /// # Errors
    /// If this is another user.
    pub(crate) fn check_owner(&self, uid: u32) -> Result<(), Failure> {
        let root = self.home().root();
        let owner = std::fs::metadata(root).map_err(|error| {
            Failure::new(ErrorKind::Home, format!("the owner of {} is not known: {error}", root.display()))
        })?;
        if owner.uid() == uid {
            return Ok(());
        }
        self.operators.count(&uid, "not the owner");
        Err(refused(format!(
            "{} belongs to user {}, and only that user may use its socket, not user {uid} nor root; operators connect to \
             operators.socket with --site-socket",
            root.display(),
            owner.uid()
        )))
    }

    /// Lets a user in at the operators' socket.
    ///
    /// # Errors
    /// If the user has no rights, or nobody can say who that is.
    pub(crate) async fn admit_operator(&self, uid: u32) -> Result<Arc<Operator>, Failure> {
        self.operators.admit(uid).await
    }

    /// Refuses a request that carries a passphrase, which nothing has read.
    pub(crate) fn refuse_passphrase(&self, operator: &Operator, profile: &ProfileName) -> Failure {
        self.operators.count_refused(operator, profile, Needed::Passphrase);
        refused("an operator sends no passphrase, so the site reads none here; its owner does this")
    }
}
