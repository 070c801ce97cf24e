//! The audit log: append-only, each line durable and chained to the one before. Only a head anchored on the chain
//! shows that lines are missing at its end.

use serde::{Deserialize, Serialize};
use sm3::{Digest as _, Sm3};

use super::StoreError;
use crate::database::{capped, whole};
use crate::ledger::{AuditLog, time, unsigned};
use crate::model::{Digest, Timestamp, counted};
use crate::sql::{self, Connection, Row, params};

const LABEL: &[u8] = b"AuthROS/audit/1";
const COLUMNS: &str = "line, at, profile, action, subject, outcome, hash";

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditEntry {
    pub at: Timestamp,
    /// Who did it: a profile, or `profile/operator`, which no profile's name can be; for refusals, a peer.
    pub profile: String,
    pub action: String,
    pub subject: String,
    pub outcome: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditLine {
    pub line: u64,
    #[serde(flatten)]
    pub entry: AuditEntry,
    /// SM3 over the label, the hash of the line before, and the entry.
    pub hash: Digest,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditQuery {
    pub since: Option<Timestamp>,
    /// `grant`, `decrypt`, ….
    pub action: Option<String>,
    /// This profile with its operators, or `profile/operator` (for refusals: a peer).
    pub profile: Option<String>,
    /// An operator's name, in any profile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    pub before: Option<u64>,
    /// The newest.
    pub limit: usize,
}

/// Where the log was altered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line} of the audit log: {what}; keep a copy of the ledger and find out who had write access")]
pub struct AuditFault {
    pub line: u64,
    pub what: String,
}

impl AuditLog {
    /// Durable on return. No grant and no decryption may proceed without it.
    pub fn append(&self, entry: AuditEntry) -> Result<(), StoreError> {
        self.0.write(move |session| {
            let (count, head) = head(session.connection)?;
            let hash = chain(head, &entry).0;
            let sql = "INSERT INTO audit VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)";
            let (line, at) = (whole("line", count + 1)?, whole("time", entry.at.0)?);
            let AuditEntry { profile, action, subject, outcome, .. } = &entry;
            session.connection.run(sql, (line, at, profile, action, subject, outcome, hash))
        })
    }

    /// Number of lines, and hash of the last (zeros for an empty log): the head that is anchored.
    pub fn head(&self) -> Result<(u64, Digest), StoreError> {
        self.0.read(head)
    }

    pub fn hash_of(&self, line: u64) -> Result<Option<Digest>, StoreError> {
        let line = whole("line", line)?;
        self.0.find("SELECT hash FROM audit WHERE line = ?1", [line], |row| row.get(0).map(Digest))
    }

    /// Recomputes the whole chain; returns the number of lines, or the first wrong one.
    pub fn verify(&self) -> Result<u64, AuditFault> {
        let walked = self.0.read(|connection| Ok(walk(connection)));
        walked.unwrap_or_else(|error| Err(AuditFault { line: 0, what: error.to_string() }))
    }

    /// Compares anchored heads, in any order; returns how many lines the newest covers. A fault names the line after
    /// the newest head that agrees.
    pub fn compare(&self, heads: &[(u64, Digest)]) -> Result<u64, AuditFault> {
        let mut heads = heads.to_vec();
        heads.sort_by_key(|(line, _)| *line);
        let mut agreed = 0;
        for (line, hash) in heads {
            let found = self.hash_of(line).map_err(|error| AuditFault { line, what: error.to_string() })?;
            if found == Some(hash) {
                agreed = line;
                continue;
            }
            let written = self.head().map_or(0, |(count, _)| count);
            let (first, what) = match found {
                None => (written + 1, format!("is missing: a head over {} was anchored", counted(line, "line"))),
                Some(_) => {
                    (agreed + 1, format!("or a later one up to {line} was rewritten: another head was anchored"))
                }
            };
            return Err(AuditFault { line: first, what });
        }
        Ok(agreed)
    }

    pub fn written_after(&self, line: u64) -> Result<Option<Timestamp>, StoreError> {
        let next = whole("line", line.saturating_add(1))?;
        self.0.find("SELECT at FROM audit WHERE line = ?1", [next], |row| time(row, 0))
    }

    /// The newest matches, oldest first.
    pub fn list(&self, query: &AuditQuery) -> Result<Vec<AuditLine>, StoreError> {
        let before = query.before.map_or(Ok(i64::MAX), |line| whole("line", line))?;
        let since = query.since.map_or(Ok(0), |since| whole("time", since.0))?;
        self.0.read(|connection| {
            let sql = format!(
                "SELECT {COLUMNS} FROM audit WHERE line < ?1 AND at >= ?2 AND (action = ?3 OR ?3 IS NULL) \
                 AND (profile = ?4 OR substr(profile, 1, length(?4) + 1) = ?4 || '/' OR ?4 IS NULL) \
                 AND ((instr(profile, '/') > 0 AND substr(profile, instr(profile, '/') + 1) = ?6) OR ?6 IS NULL) \
                 ORDER BY line DESC LIMIT ?5"
            );
            let values = params![before, since, query.action, query.profile, capped(query.limit), query.operator];
            let mut lines: Vec<_> = connection.list(&sql, values, line_of)?;
            lines.reverse();
            Ok(lines)
        })
    }
}

fn head(connection: &Connection) -> Result<(u64, Digest), StoreError> {
    let sql = "SELECT line, hash FROM audit ORDER BY line DESC LIMIT 1";
    let found = connection.find(sql, [], |row| Ok((unsigned(row, 0)?, Digest(row.get(1)?))))?;
    Ok(found.unwrap_or((0, Digest([0; Digest::LENGTH]))))
}

fn line_of(row: &Row<'_>) -> sql::Result<AuditLine> {
    let (profile, action, subject, outcome) = (row.get(2)?, row.get(3)?, row.get(4)?, row.get(5)?);
    let entry = AuditEntry { at: time(row, 1)?, profile, action, subject, outcome };
    Ok(AuditLine { line: unsigned(row, 0)?, entry, hash: Digest(row.get(6)?) })
}

/// SM3 over label, previous hash, and each field behind its length (4 bytes, big endian).
fn chain(previous: Digest, entry: &AuditEntry) -> Digest {
    let mut hash = Sm3::new();
    hash.update(LABEL);
    hash.update(previous.as_bytes());
    let at = entry.at.0.to_be_bytes();
    let texts = [&entry.profile, &entry.action, &entry.subject, &entry.outcome].map(|text| text.as_bytes());
    for field in std::iter::once(&at[..]).chain(texts) {
        hash.update(u32::try_from(field.len()).unwrap_or(u32::MAX).to_be_bytes());
        hash.update(field);
    }
    Digest(hash.finalize().into())
}

fn walk(connection: &Connection) -> Result<u64, AuditFault> {
    let sql = format!("SELECT {COLUMNS} FROM audit ORDER BY line");
    let (mut count, mut previous) = (0, Digest([0; Digest::LENGTH]));
    let mut fault = None;
    let walked = connection.prepared(&sql).and_then(|mut lines| {
        lines.each_while([], |row| {
            let found = line_of(row)?;
            count += 1;
            fault = match chain(previous, &found.entry) {
                _ if found.line != count => Some("is missing"),
                hash if hash != found.hash => Some("is not what was originally written"),
                _ => None,
            };
            previous = found.hash;
            Ok::<_, sql::Error>(fault.is_none())
        })
    });
    match (walked, fault) {
        (Err(error), _) => Err(AuditFault { line: count + 1, what: error.to_string() }),
        (Ok(()), Some(what)) => Err(AuditFault { line: count, what: what.to_owned() }),
        (Ok(()), None) => Ok(count),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log_of(lines: u64) -> (tempfile::TempDir, AuditLog) {
        let (home, ledger) = crate::ledger::tests::open();
        let log = ledger.audit.clone();
        for number in 1..=lines {
            log.append(entry(number)).expect("appended");
        }
        (home, log)
    }

    fn entry(number: u64) -> AuditEntry {
        AuditEntry {
            at: Timestamp(number),
            profile: "a".to_owned(),
            action: "grant".to_owned(),
            subject: format!("0x{number}"),
            outcome: "ok".to_owned(),
        }
    }

    /// Edits the table behind the log's back.
    fn forge(log: &AuditLog, sql: &str) -> Result<u64, AuditFault> {
        let sql = sql.to_owned();
        log.0.write(move |session| Ok(session.connection.script(&sql)?)).expect("forged");
        log.verify()
    }

    #[test]
    fn lines_are_numbered_chained_and_paged() {
        let (_home, log) = log_of(7);
        assert_eq!(log.verify(), Ok(7));
        let (count, head) = log.head().expect("head");
        assert_eq!((count, Some(head)), (7, log.hash_of(7).expect("line")));
        let tail = log.list(&AuditQuery { limit: 3, ..AuditQuery::default() }).expect("tail");
        assert_eq!(tail.iter().map(|line| line.line).collect::<Vec<_>>(), [5, 6, 7]);
        assert_eq!(tail[0].entry, entry(5));
        let numbers = |query: AuditQuery| {
            let lines = log.list(&AuditQuery { limit: 100, ..query }).expect("page");
            lines.iter().map(|line| line.line).collect::<Vec<_>>()
        };
        assert_eq!(numbers(AuditQuery { before: Some(5), ..AuditQuery::default() }), [1, 2, 3, 4]);
        assert_eq!(numbers(AuditQuery { since: Some(Timestamp(6)), ..AuditQuery::default() }), [6, 7]);
        assert_eq!(numbers(AuditQuery { action: Some("open".to_owned()), ..AuditQuery::default() }), [0; 0]);
        let of_a = AuditQuery { action: Some("grant".to_owned()), profile: Some("a".to_owned()), ..Default::default() };
        assert_eq!(numbers(of_a).len(), 7);
        assert_eq!((log.written_after(0), log.written_after(7)), (Ok(Some(Timestamp(1))), Ok(None)));
    }

    #[test]
    fn lines_of_operators_are_found_by_profile_and_by_operator() {
        let (_home, log) = log_of(1);
        for who in ["a/bob", "ab/bob", "a/bobby", "a"] {
            log.append(AuditEntry { profile: who.to_owned(), ..entry(9) }).expect("appended");
        }
        assert_eq!(log.verify(), Ok(5));
        let numbers = |profile: Option<&str>, operator: Option<&str>| {
            let (profile, operator) = (profile.map(str::to_owned), operator.map(str::to_owned));
            let lines = log.list(&AuditQuery { profile, operator, limit: 100, ..AuditQuery::default() });
            lines.expect("page").iter().map(|line| line.line).collect::<Vec<_>>()
        };
        assert_eq!(numbers(Some("a"), None), [1, 2, 4, 5]);
        assert_eq!(numbers(Some("a/bob"), None), [2]);
        assert_eq!(numbers(None, Some("bob")), [2, 3]);
        assert_eq!(numbers(Some("a"), Some("bob")), [2]);
        assert_eq!(numbers(None, Some("a")), [0; 0], "a profile is no operator");
    }

    #[test]
    fn every_edit_of_every_line_is_found() {
        for line in 1..=5u64 {
            for column in ["at", "profile", "action", "subject", "outcome", "hash"] {
                let (_home, log) = log_of(5);
                let value = if column == "at" { "99" } else { "CAST(zeroblob(32) AS BLOB)" };
                let edited = forge(&log, &format!("UPDATE audit SET {column} = {value} WHERE line = {line}"));
                assert_eq!(edited.expect_err(column).line, line);
            }
        }
    }

    #[test]
    fn deleting_swapping_and_inserting_are_found() {
        for line in 1..5u64 {
            let (_home, log) = log_of(5);
            assert_eq!(forge(&log, &format!("DELETE FROM audit WHERE line = {line}")).expect_err("gone").line, line);
            let closed = format!("UPDATE audit SET line = line - 1 WHERE line > {line}");
            assert_eq!(forge(&log, &closed).expect_err("closed up").line, line);
            let (_home, log) = log_of(5);
            let swapped = format!(
                "UPDATE audit SET line = 99 WHERE line = {line}; UPDATE audit SET line = {line} WHERE line = {line} + 1;
                 UPDATE audit SET line = {line} + 1 WHERE line = 99"
            );
            assert_eq!(forge(&log, &swapped).expect_err("swapped").line, line);
        }
        let (_home, log) = log_of(2);
        let copied =
            "INSERT INTO audit SELECT 3, at, profile, action, subject, outcome, hash FROM audit WHERE line = 2";
        assert_eq!(forge(&log, copied).expect_err("copied").line, 3);
    }

    #[test]
    fn a_cut_tail_is_found_against_an_anchored_head_only() {
        let (_home, log) = log_of(5);
        let heads: Vec<_> = [5, 2].map(|line| (line, log.hash_of(line).expect("read").expect("there"))).to_vec();
        assert_eq!((log.compare(&heads), log.compare(&[])), (Ok(5), Ok(0)));
        assert_eq!(forge(&log, "DELETE FROM audit WHERE line > 3"), Ok(3));
        let fault = log.compare(&heads).expect_err("cut");
        assert!(fault.line == 4 && fault.what.contains("missing"), "{fault}");
        // An attacker who knows how the lines are chained replaces some of them.
        log.append(entry(44)).expect("appended");
        log.append(entry(55)).expect("appended");
        assert_eq!(log.verify(), Ok(5));
        let fault = log.compare(&heads).expect_err("rewritten");
        assert!(fault.line == 3 && fault.what.contains("rewritten"), "{fault}");
    }

    #[test]
    fn fields_cannot_run_into_each_other() {
        let mut one = entry(1);
        let mut two = entry(1);
        (one.profile, one.action) = ("ab".to_owned(), "c".to_owned());
        (two.profile, two.action) = ("a".to_owned(), "bc".to_owned());
        let zero = Digest([0; 32]);
        assert_ne!(chain(zero, &one), chain(zero, &two));
        assert_ne!(chain(zero, &one), chain(Digest([1; 32]), &one));
    }

    crate::ledger::tests::server::on_a_server! {
        lines_are_numbered_chained_and_paged, lines_of_operators_are_found_by_profile_and_by_operator,
        a_cut_tail_is_found_against_an_anchored_head_only,
    }
}
