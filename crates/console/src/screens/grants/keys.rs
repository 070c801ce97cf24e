//! The question before a revoke, and who can read.

use crate::app::{Confirm, Errand, Feed, State, Tag};
use crate::screens::grants::state::{earlier, end, is_active, is_given, scope};
use crate::service::{Command, reply::GrantRow};

pub fn revoke(state: &State, row: &GrantRow) -> Confirm {
    let mut lines = vec![
        format!("From    {}", row.grantee),
        format!("Shared  {}, {}{}", scope(&row.topics), end(row.expires), earlier(row)),
        String::new(),
        "The next record is sealed under a new key that this account does not get.".to_owned(),
        "What was already read cannot be taken back, and records sealed before".to_owned(),
        "stay readable to anyone who has their key. A robot out of reach continues".to_owned(),
        "under the old key until it connects. To share again, make a new grant.".to_owned(),
        String::new(),
    ];
    lines.extend(readers(state, "Who can read afterwards:", Some(row)));
    let errand = Errand { command: Command::Revoke { grantee: row.grantee.into() }, tag: Tag::Revoke(row.grantee) };
    Confirm { title: format!("Revoke {}?", row.grantee.short()), lines, yes: "revoke", typed: None, errand }
}

/// One line each under a title; `without` is left out.
pub fn readers(state: &State, title: &str, without: Option<&GrantRow>) -> Vec<String> {
    let without = without.map(|row| row.grantee);
    let active = state.grants.rows.iter().filter(|row| is_given(row) && is_active(row) && Some(row.grantee) != without);
    let line = |row: &GrantRow| (row.grantee, scope(&row.topics), end(row.expires), earlier(row));
    let readers: Vec<_> = active.map(line).collect();
    let mut lines = vec![title.to_owned()];
    if state.awaits(Feed::Grants) {
        lines.push("  (the list of grants has not arrived yet)".to_owned());
    } else if readers.is_empty() {
        lines.push("  nobody but you".to_owned());
    }
    let more = readers.len().saturating_sub(5);
    lines.extend(readers.into_iter().take(5).map(|(who, what, end, too)| format!("  {who}  {what}  {end}{too}")));
    if more > 0 {
        lines.push(format!("  and {more} more"));
    }
    lines
}
