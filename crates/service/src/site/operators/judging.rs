//! Each request of a connection, judged before it is answered.

use std::sync::Arc;

use super::{Asker, Operator, Operators};
use crate::model::{OperatorName, OperatorRight, OperatorRights, ProfileName};
use crate::service::command::{Needed, Request};
use crate::service::failure::refused;
use crate::service::reply::{Failure, Reply};
use crate::site::Site;
use crate::site::audit::acting::{acting_as, by};
use crate::site::consoles::Claims;

impl Site {
    /// Answers a request of a connection if who asks may make it; an operator is named in each line of what follows.
    ///
    /// # Errors
    /// That the right is missing, or errors of the command's part.
    pub(in crate::site) async fn answer(self: &Arc<Self>, request: Request, claims: &Claims) -> Result<Reply, Failure> {
        let Asker::Operator(operator) = &claims.asker else { return self.handle(request, claims).await };
        self.operators.judge(operator, &request.profile, request.command.needs()).await?;
        acting_as(operator.name.clone(), Box::pin(self.handle(request, claims))).await
    }
}

impl Operators {
    async fn judge(
        self: &Arc<Self>,
        operator: &Operator,
        profile: &ProfileName,
        needed: Needed,
    ) -> Result<(), Failure> {
        let refusal = if self.has(profile) {
            self.why_not(operator, needed).await
        } else {
            Some(refused(format!("this site has no profile '{profile}'; choose one that it has with --profile")))
        };
        let Some(refusal) = refusal else { return Ok(()) };
        self.count_refused(operator, profile, needed);
        Err(refusal)
    }

    /// Counts a refusal; of one that only looks nothing would have changed.
    pub(super) fn count_refused(&self, operator: &Operator, profile: &ProfileName, needed: Needed) {
        if needed == Needed::Right(OperatorRight::Look) {
            return;
        }
        // The names of profiles that are not there could be many.
        let who = if self.has(profile) { by(profile, &operator.name) } else { format!("user {}", operator.name) };
        let _first = self.log.refused(&who, &format!("needs {}", needed.word()));
    }

    fn has(&self, profile: &ProfileName) -> bool {
        self.home.keyring(profile).exists()
    }

    /// Why an operator may not do this now; `None` if it may.
    pub(super) async fn why_not(self: &Arc<Self>, operator: &Operator, needed: Needed) -> Option<Failure> {
        match self.rights(operator).await {
            Ok(rights) => why_not(&operator.name, &rights, needed).map(refused),
            Err(failure) => Some(failure),
        }
    }
}

/// Why a user with these rights may not do this; `None` if the user may.
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
