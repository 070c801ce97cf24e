//! Who acts where a request is answered: its operator is known to everything that runs in the request's own task, so that
//! each line of the log names it. What the site does by itself, later and elsewhere, has no operator.

use std::fmt::Display;

use crate::model::OperatorName;

tokio::task_local! {
    static OPERATOR: OperatorName;
}

/// Does the work of an operator's request.
pub(in crate::site) async fn acting_as<Work: Future>(operator: OperatorName, work: Work) -> Work::Output {
    OPERATOR.scope(operator, work).await
}

/// Whether an operator's request is answered in this task.
pub(in crate::site) fn is_operator() -> bool {
    OPERATOR.try_with(|_| ()).is_ok()
}

/// Who does what is done for a profile in this task, as the log has it: the profile, or `profile/operator`.
pub(super) fn doer(profile: &str) -> String {
    OPERATOR.try_with(|operator| by(profile, operator)).unwrap_or_else(|_| profile.to_owned())
}

/// An operator of a profile, as the log has it.
pub(in crate::site) fn by(profile: impl Display, operator: &OperatorName) -> String {
    format!("{profile}/{operator}")
}
