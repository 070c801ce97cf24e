//! Operators: Unix users named by the kernel, with rights from the settings. Their standing is refreshed while they are
//! connected, and every request is judged before it is answered.

use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::net::UnixListener;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::block_in_place;

use super::audit::{acting_as, by};
use crate::accounts::{self, Account, AccountError};
use crate::command::{Needed, Request};
use crate::crypto::hands::{self, Fault};
use crate::model::{ErrorKind, OperatorName, OperatorRight, OperatorRights, ProfileName};
use crate::paths::Home;
use crate::reply::{Event, Failure, Reply, Result, refused};
use crate::site::{Claims, Parts, Site, blocking};
use crate::socket;

/// How long a looked-up standing counts.
const FRESH: Duration = Duration::from_secs(1);

const LOOK: Duration = Duration::from_secs(1);
const AGAIN: Duration = Duration::from_secs(5);
/// The group may connect; the settings say what each user may do.
const MODE: u32 = 0o660;

#[derive(Clone, Default)]
pub(crate) enum Asker {
    #[default]
    Owner,
    Operator(Arc<Operator>),
}

pub(crate) struct Operator {
    uid: u32,
    name: OperatorName,
    /// Rights, and when they were looked up.
    standing: tokio::sync::Mutex<(Instant, OperatorRights)>,
}

pub(super) struct Operators {
    pub parts: Parts,
}

impl Operators {
    async fn admit(self: &Arc<Self>, uid: u32) -> Result<Arc<Operator>> {
        let (name, rights) = self.standing(uid).await?.inspect_err(|error| self.count(&uid, error.word()))?;
        if rights.is_empty() {
            self.count(&name, "no right");
            let text = format!("user '{name}' has no right at this site; ask its owner for one in [operators.rights]");
            return Err(refused(text));
        }
        Ok(Arc::new(Operator { uid, name, standing: tokio::sync::Mutex::new((Instant::now(), rights)) }))
    }

    /// Current rights of an operator; an error if there are none left or the user is unknown.
    async fn rights(self: &Arc<Self>, operator: &Operator) -> Result<OperatorRights> {
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

    /// Name and rights of a user; the outer error is that of a failed task.
    async fn standing(self: &Arc<Self>, uid: u32) -> Result<Result<(OperatorName, OperatorRights), AccountError>> {
        let of = move |operators: &Self| -> Result<_, AccountError> {
            let account = Account::of(uid)?;
            let rights = account.rights(&operators.parts.config.operators.rules)?;
            Ok((account.name, rights))
        };
        blocking(self, move |operators| Ok(of(operators))).await
    }

    /// Counts a refusal of somebody who is no operator.
    fn count(&self, user: &dyn std::fmt::Display, word: &str) {
        let _first = self.parts.log.refused(&format!("user {user}"), word);
    }

    async fn judge(self: &Arc<Self>, operator: &Operator, profile: &ProfileName, needed: Needed) -> Result<()> {
        let refusal = if self.has(profile) {
            self.why_not(operator, needed).await
        } else {
            Some(refused(format!("this site has no profile '{profile}'; choose one that it has with --profile")))
        };
        let Some(refusal) = refusal else { return Ok(()) };
        self.count_refused(operator, profile, needed);
        Err(refusal)
    }

    /// Counts a refusal, except of mere looking.
    fn count_refused(&self, operator: &Operator, profile: &ProfileName, needed: Needed) {
        if needed == Needed::Right(OperatorRight::Look) {
            return;
        }
        // Names of missing profiles could be endless.
        let who = if self.has(profile) { by(profile, &operator.name) } else { format!("user {}", operator.name) };
        let _first = self.parts.log.refused(&who, &format!("needs {}", needed.word()));
    }

    fn has(&self, profile: &ProfileName) -> bool {
        self.parts.home.keyring(profile).exists()
    }

    async fn why_not(self: &Arc<Self>, operator: &Operator, needed: Needed) -> Option<Failure> {
        match self.rights(operator).await {
            Ok(rights) => why_not(&operator.name, &rights, needed).map(refused),
            Err(failure) => Some(failure),
        }
    }
}

impl Site {
    /// Refuses everybody but the home's owner, even root.
    pub(crate) fn check_owner(&self, uid: u32) -> Result<()> {
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

    pub(crate) async fn admit_operator(&self, uid: u32) -> Result<Arc<Operator>> {
        self.operators.admit(uid).await
    }

    /// Refuses a request that carries a passphrase, which nothing has read.
    pub(crate) fn refuse_passphrase(&self, operator: &Operator, profile: &ProfileName) -> Failure {
        self.operators.count_refused(operator, profile, Needed::Passphrase);
        refused("an operator sends no passphrase, so the site reads none here; its owner does this")
    }

    /// Sends events until `tell` says that nobody listens, or the operator may not hear them.
    pub(crate) async fn tell_events(self: Arc<Self>, claims: Claims, tell: impl Fn(Heard) -> bool + Send) {
        let mut events = self.events();
        loop {
            let event = tokio::select! {
                goes_on = self.parts.life.beat(LOOK), if matches!(claims.asker, Asker::Operator(_)) => {
                    if goes_on { None } else { return }
                }
                event = events.recv() => match event {
                    Ok(event) => Some(event),
                    Err(RecvError::Lagged(_)) => continue,
                    Err(RecvError::Closed) => return,
                },
            };
            if let Asker::Operator(operator) = &claims.asker
                && let Some(refusal) = self.operators.why_not(operator, Needed::Right(OperatorRight::Look)).await
            {
                tell(Heard::Ended(refusal));
                return;
            }
            if let Some(event) = event
                && !tell(Heard::Event(event))
            {
                return;
            }
        }
    }

    /// Answers an allowed request; an operator is named in each resulting audit line.
    pub(in crate::site) async fn answer(self: &Arc<Self>, request: Request, claims: &Claims) -> Result<Reply> {
        let Asker::Operator(operator) = &claims.asker else { return self.handle(request, claims).await };
        self.operators.judge(operator, &request.profile, request.command.needs()).await?;
        acting_as(operator.name.clone(), Box::pin(self.handle(request, claims))).await
    }

    pub(in crate::site) async fn serve_operators(self: Arc<Self>) {
        let settings = &self.config().operators;
        let Some(path) = &settings.socket else { return };
        for line in block_in_place(|| accounts::unknown(&settings.rules)).unwrap_or_default() {
            self.parts.hub.warn(&line);
        }
        let mut told = None;
        while !self.parts.life.is_stopping() {
            match block_in_place(|| listen(self.home(), path)) {
                Ok(listener) => return socket::accept_operators(&self, &listener).await,
                Err(why) => {
                    if told.as_ref() != Some(&why) {
                        self.parts.hub.alarm(&format!("operators cannot connect to {}: {why}", path.display()));
                        told = Some(why);
                    }
                }
            }
            self.parts.life.rest(AGAIN).await;
        }
    }
}

pub(crate) enum Heard {
    Event(Event),
    /// Nothing more is sent, and why.
    Ended(Failure),
}

/// Why these rights do not allow this; `None` if they do.
fn why_not(name: &OperatorName, rights: &OperatorRights, needed: Needed) -> Option<String> {
    match needed {
        Needed::Right(right) if rights.has(right) => None,
        Needed::Right(right) => Some(format!(
            "this needs the right '{}', and user '{name}' has {rights}; ask the owner of this site",
            right.word()
        )),
        Needed::Owner | Needed::Passphrase => {
            Some(format!("only the owner of this site may do this, and user '{name}' is an operator with {rights}"))
        }
    }
}

fn listen(home: &Home, path: &Path) -> Result<UnixListener, String> {
    let unusable = |error: std::io::Error| format!("{error}; make its folder, or choose another operators.socket");
    let folder = path.parent().unwrap_or(path).canonicalize().map_err(unusable)?;
    if home.root().canonicalize().is_ok_and(|home| folder.starts_with(home)) {
        return Err("it is in the home, which only its owner may enter; choose another operators.socket".to_owned());
    }
    match hands::fault(&folder, rustix::process::geteuid().as_raw()).map_err(unusable)? {
        None => socket::bind(path, MODE).map_err(unusable),
        Some(Fault::Foreign(folder)) => {
            Err(format!("{} belongs to another user; choose a folder of the site's user", folder.display()))
        }
        Some(Fault::Open(folder)) => Err(format!(
            "others can write to {} and could put another socket there; run chmod go-w on it",
            folder.display()
        )),
    }
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod listening_tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use std::fs::{Permissions, set_permissions};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[tokio::test]
    async fn a_socket_is_made_where_nobody_else_can_replace_it_and_outside_the_home() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = Home::new(folder.path().join("home"));
        std::fs::create_dir(home.root()).expect("a home");
        let place = folder.path().join("run");
        std::fs::create_dir(&place).expect("a folder");
        let path = place.join("operators.sock");
        let listener = listen(&home, &path).expect("listens");
        let mode = std::fs::metadata(&path).expect("a socket").permissions().mode() & 0o777;
        assert_eq!(mode, MODE);
        assert!(listen(&home, &path).expect_err("somebody answers there").contains("in use"));
        drop(listener);
        drop(listen(&home, &path).expect("one that nobody answers is replaced"));
        for mode in [0o770, 0o702, 0o1777] {
            set_permissions(&place, Permissions::from_mode(mode)).expect("its mode");
            assert!(listen(&home, &path).expect_err("others write it").contains("chmod go-w"), "{mode:o}");
        }
        let inside = home.root().join("operators.sock");
        assert!(listen(&home, &inside).expect_err("in the home").contains("in the home"));
        assert!(listen(&home, &folder.path().join("missing/operators.sock")).is_err());
    }
}
