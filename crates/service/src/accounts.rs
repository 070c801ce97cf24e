//! The machine's user database: names and groups behind the user numbers that the kernel gives.

use std::ffi::CString;

use nix::errno::Errno;
use nix::unistd::{Gid, Group, Uid, User, getgrouplist};

use crate::config::{OperatorRule, Whom};
use crate::model::{OperatorName, OperatorRights};
use crate::reply::{Failure, refused};

/// Number that the kernel shows for users of another user namespace.
const OVERFLOW: &str = "/proc/sys/kernel/overflowuid";
const USUAL_OVERFLOW: u32 = 65_534;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AccountError {
    #[error(
        "user {0} belongs to another user namespace and cannot be identified; site and operators must run in one \
         namespace (PrivateUsers=no in the site's unit)"
    )]
    OtherNamespace(u32),
    #[error("the user database has no name for user {0}; give the account a name, or connect as another user")]
    Nameless(u32),
    #[error("user {0} cannot be an operator: {1}")]
    Name(u32, String),
    #[error("the user database does not answer ({0}); try again, or check /etc/nsswitch.conf")]
    Silent(Errno),
}

impl AccountError {
    /// A constant word, for counting refusals.
    pub fn word(&self) -> &'static str {
        match self {
            Self::OtherNamespace(_) => "other user namespace",
            Self::Nameless(_) => "no user name",
            Self::Name(..) => "unusable user name",
            Self::Silent(_) => "user database",
        }
    }
}

impl From<AccountError> for Failure {
    fn from(error: AccountError) -> Self {
        refused(error.to_string())
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Account {
    pub name: OperatorName,
    groups: Vec<Gid>,
}

impl Account {
    pub fn of(uid: u32) -> Result<Self, AccountError> {
        if uid == overflow() {
            return Err(AccountError::OtherNamespace(uid));
        }
        let user = found(User::from_uid(Uid::from_raw(uid)))?.ok_or(AccountError::Nameless(uid))?;
        let name = user.name.parse().map_err(|error| AccountError::Name(uid, format!("{error}")))?;
        let text = CString::new(user.name).map_err(|_| AccountError::Nameless(uid))?;
        let groups = getgrouplist(&text, user.gid).map_err(AccountError::Silent)?;
        Ok(Self { name, groups })
    }

    pub fn own() -> Result<Self, AccountError> {
        Self::of(rustix::process::geteuid().as_raw())
    }

    /// Rights that the rules give this user, by name and by group.
    pub fn rights(&self, rules: &[OperatorRule]) -> Result<OperatorRights, AccountError> {
        let mut rights = OperatorRights::default();
        for rule in rules {
            let applies = match &rule.whom {
                Whom::User(name) => *name == self.name,
                Whom::Group(name) => group(name)?.is_some_and(|group| self.groups.contains(&group)),
            };
            if applies {
                rights.add(&rule.rights);
            }
        }
        Ok(rights)
    }
}

/// Rules for users and groups that this machine does not have, each as a sentence with its place in the settings.
pub fn unknown(rules: &[OperatorRule]) -> Result<Vec<String>, AccountError> {
    let mut lines = Vec::new();
    for OperatorRule { whom, place, .. } in rules {
        let (is_known, what, thing, name) = match whom {
            Whom::User(name) => (found(User::from_name(name.as_str()))?.is_some(), "user", "account", name),
            Whom::Group(name) => (group(name)?.is_some(), "group", "group", name),
        };
        if !is_known {
            lines
                .push(format!("{place}: this machine has no {what} '{name}'; correct the name, or create the {thing}"));
        }
    }
    Ok(lines)
}

fn group(name: &OperatorName) -> Result<Option<Gid>, AccountError> {
    Ok(found(Group::from_name(name.as_str()))?.map(|group| group.gid))
}

/// Some databases report a missing entry as an error number (getpwnam(3)).
fn found<Entry>(entry: nix::Result<Option<Entry>>) -> Result<Option<Entry>, AccountError> {
    match entry {
        Err(Errno::ENOENT | Errno::ESRCH | Errno::EBADF | Errno::EPERM) => Ok(None),
        entry => entry.map_err(AccountError::Silent),
    }
}

/// Stands for every user whom this namespace does not know.
fn overflow() -> u32 {
    let text = std::fs::read_to_string(OVERFLOW).ok();
    text.and_then(|text| text.trim().parse().ok()).unwrap_or(USUAL_OVERFLOW)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;
    use crate::model::OperatorRight;

    fn rule(whom: Whom, right: OperatorRight) -> OperatorRule {
        OperatorRule { whom, rights: [right].into_iter().collect(), place: "config.toml line 7".to_owned() }
    }

    fn user(name: &str) -> Whom {
        Whom::User(name.parse().expect("a name"))
    }

    fn group(name: &str) -> Whom {
        Whom::Group(name.parse().expect("a name"))
    }

    #[test]
    fn a_number_without_a_name_and_one_of_another_namespace_are_nobody() {
        assert_eq!(Account::of(4_000_000_000), Err(AccountError::Nameless(4_000_000_000)));
        assert_eq!(Account::of(overflow()), Err(AccountError::OtherNamespace(overflow())), "whatever its name is");
        assert_eq!(Account::of(0).expect("every machine has one").name.as_str(), "root");
    }

    #[test]
    fn rights_of_a_user_and_of_its_groups_add_up() {
        let root = Account::of(0).expect("every machine has one");
        let (look, grant) = (OperatorRight::Look, OperatorRight::Grant);
        let rights = |rules: &[OperatorRule]| root.rights(rules).expect("the database answers").to_string();
        assert_eq!(rights(&[rule(user("root"), look), rule(group("root"), grant)]), "look,grant");
        assert_eq!(rights(&[rule(user("daemon"), look), rule(group("nobody-is-here"), grant)]), "");
    }

    #[test]
    fn what_the_machine_does_not_have_is_named_with_its_place() {
        let rules = [user("root"), user("nobody-is-here"), group("root"), group("nobody-is-here")];
        let rules = rules.map(|whom| rule(whom, OperatorRight::Look));
        let lines = unknown(&rules).expect("the database answers");
        assert_eq!(lines.len(), 2, "{lines:?}");
        assert!(lines.iter().all(|line| line.starts_with("config.toml line 7") && line.contains("nobody-is-here")));
    }
}
