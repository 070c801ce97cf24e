//! What an acknowledgement is worth on a gateway's database server, in words.

use crate::model::{clean, counted};
use crate::reply::HealthLevel;
use crate::store::Durability;

/// `Failed` where what is acknowledged may be lost, or nothing can be. `least`: standbys that must have it.
pub fn worth(found: &Durability, least: u64) -> (HealthLevel, String) {
    let Durability { version, standbys, fsync, is_standby, connected, .. } = found;
    let server = format!("PostgreSQL {}", clean(version, 40));
    let names = clean(standbys, 120);
    let needed = needed(standbys);
    if *is_standby {
        return failed(format!("{server} is a standby and takes no writes; name the primary in store.url"));
    }
    if let Some(apart) = found.clocks_apart() {
        return failed(format!("the clock of {server} is {apart} this machine's; correct the wrong one"));
    }
    if !fsync {
        return failed(format!(
            "{server} has fsync off: what it acknowledges is lost if its machine fails; set fsync = on"
        ));
    }
    if needed < least {
        return failed(format!(
            "{server} waits for {} where store.standbys asks for {least}: what it acknowledges is lost with its disk; set \
             synchronous_standby_names",
            counted(needed, "standby")
        ));
    }
    if needed == 0 {
        return (
            HealthLevel::Ok,
            format!("{server}, primary: acknowledged = on its disk, on no standby's{}", overruled(found)),
        );
    }
    if connected.is_some_and(|connected| connected < needed) {
        let there = connected.unwrap_or_default();
        return failed(format!(
            "{server} waits for {} (synchronous_standby_names {names}), of which {there} are connected: nothing is acknowledged; \
             start a standby",
            counted(needed, "standby")
        ));
    }
    let seen = match connected {
        Some(there) => format!("{there} connected"),
        None => "grant pg_monitor to see which are connected".to_owned(),
    };
    let text = format!(
        "{server}, primary: acknowledged = on its disk and on that of {} (synchronous_standby_names {names}; {seen})",
        counted(needed, "standby")
    );
    (HealthLevel::Ok, text + &overruled(found))
}

fn failed(text: String) -> (HealthLevel, String) {
    (HealthLevel::Failed, text)
}

/// The program commits with a setting of its own.
fn overruled(found: &Durability) -> String {
    if found.commits == "on" {
        return String::new();
    }
    format!("; synchronous_commit = {} is overruled by on", clean(&found.commits, 20))
}

/// How many standbys a commit waits for: `s1, s2`, `2 (s1, s2, s3)`, `FIRST 2 (…)`, `ANY 2 (…)`.
fn needed(standbys: &str) -> u64 {
    let text = standbys.trim();
    if text.is_empty() {
        return 0;
    }
    let Some((before, _)) = text.split_once('(') else { return 1 };
    before.split_whitespace().last().and_then(|number| number.parse().ok()).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(standbys: &str, connected: Option<u64>) -> Durability {
        Durability {
            version: "15.6".to_owned(),
            commits: "on".to_owned(),
            standbys: standbys.to_owned(),
            fsync: true,
            is_standby: false,
            connected,
            ahead: 0,
        }
    }

    #[test]
    fn a_commit_waits_for_as_many_standbys_as_the_setting_says() {
        // The forms of PostgreSQL's manual, synchronous_standby_names.
        for (setting, number) in [
            ("", 0),
            ("s1", 1),
            ("s1, s2", 1),
            ("*", 1),
            ("2 (s1, s2, s3)", 2),
            ("FIRST 3 (s1, s2, s3, s4)", 3),
            ("any 2(s1,s2)", 2),
            ("ANY 1 (\"a b\", c)", 1),
        ] {
            assert_eq!(needed(setting), number, "{setting}");
        }
    }

    #[test]
    fn an_acknowledgement_is_worth_what_the_server_waits_for() {
        let told = |found: &Durability| worth(found, 0);
        let (level, text) = told(&found("", Some(0)));
        assert!(level == HealthLevel::Ok && text.contains("on no standby's"), "{text}");
        let (level, text) = told(&found("ANY 2 (a, b, c)", Some(3)));
        assert!(
            level == HealthLevel::Ok
                && text.contains("2 standbys (synchronous_standby_names ANY 2 (a, b, c); 3 connected)"),
            "{text}"
        );
        let (level, text) = told(&found("ANY 2 (a, b, c)", None));
        assert!(level == HealthLevel::Ok && text.contains("pg_monitor"), "{text}");
        let (level, text) = told(&Durability { commits: "off".to_owned(), ..found("", None) });
        assert!(level == HealthLevel::Ok && text.contains("synchronous_commit = off is overruled"), "{text}");
        for (bad, words) in [
            (found("ANY 2 (a, b, c)", Some(1)), "nothing is acknowledged; start a standby"),
            (Durability { fsync: false, ..found("a", Some(1)) }, "set fsync = on"),
            (Durability { is_standby: true, ..found("", None) }, "name the primary"),
            (Durability { ahead: 3_600_000, ..found("", None) }, "60 min ahead of this machine's"),
            (Durability { ahead: -7_200_000, ..found("", None) }, "2 h behind this machine's"),
        ] {
            let (level, text) = told(&bad);
            assert!(level == HealthLevel::Failed && text.contains(words) && text.contains("15.6"), "{text}");
        }
        for (standbys, least, level) in [
            ("", 1, HealthLevel::Failed),
            ("ANY 1 (a, b)", 1, HealthLevel::Ok),
            ("ANY 1 (a, b)", 2, HealthLevel::Failed),
            ("ANY 2 (a, b)", 1, HealthLevel::Ok),
        ] {
            let (found, text) = worth(&found(standbys, Some(2)), least);
            assert!(found == level && text.contains("store.standbys") == (level == HealthLevel::Failed), "{text}");
        }
    }
}
