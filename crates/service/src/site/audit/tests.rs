//! The log of deeds: written before the deed, bounded against floods, and handed out without addresses.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use crate::command::UploadQuery;
use crate::model::{Address, Timestamp};
use crate::reply::{Result, refused};
use crate::site::testing::{Ground, profile};
use crate::store::AuditQuery;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deed_is_announced_and_its_end_is_told_also_where_it_failed() {
    let ground = Ground::with(&[]);
    let (log, owner) = (&ground.parts.log, ground.owner("alice"));
    log.write(&owner.profile, "grant", "bob", "begun").await.expect("announced");
    let done: Result<u8> = log.ended(&owner.profile, "grant", "bob", Ok(7)).await;
    assert_eq!(done.expect("the deed's own outcome"), 7);
    let failed: Result<u8> = log.ended(&owner.profile, "grant", "bob", Err(refused("no"))).await;
    assert_eq!(failed.expect_err("the deed's own failure").message, "no");
    let outcomes: Vec<_> = ground.audited("grant").into_iter().map(|(_, outcome)| outcome).collect();
    assert_eq!(outcomes, ["begun", "done", "failed: no"]);
    assert_eq!(log.lines().verify().expect("an unbroken log"), 3);
    let deed = async { Err::<u8, _>(refused("the disk is full")) };
    log.deed(&owner.profile, "decrypt", "ab", deed).await.expect_err("the deed's own failure");
    let done: u8 = log.deed(&owner.profile, "decrypt", "cd", async { Ok(7) }).await.expect("done");
    assert_eq!((done, ground.audited("decrypt").len()), (7, 4));
    let outcome = |line: usize| ground.audited("decrypt").swap_remove(line);
    assert_eq!(outcome(1), ("ab".to_owned(), "failed: the disk is full".to_owned()));
    assert_eq!(outcome(3), ("cd".to_owned(), "done".to_owned()));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_same_question_and_the_same_refusal_are_counted_and_not_a_line_each() {
    let ground = Ground::with(&[]);
    let (log, owner) = (&ground.parts.log, ground.owner("alice"));
    let query = UploadQuery { limit: 10, ..UploadQuery::default() };
    for _ in 0..5 {
        log.asked(&owner, "list shared", &query).await.expect("asked");
    }
    assert!(log.refused("10.0.0.1", "not_granted") && !log.refused("10.0.0.1", "not_granted"));
    assert_eq!(ground.audited("list shared").len(), 1);
    assert!(ground.audited("refused").is_empty(), "its minute runs");
    // The end of the site does not wait for the minute.
    log.write_counted(None).await;
    let asked: Vec<_> = ground.audited("list shared").into_iter().map(|(_, outcome)| outcome).collect();
    assert_eq!(asked, ["done", "4 times again"]);
    let refused = ground.audited("refused");
    assert!(
        matches!(refused.as_slice(), [(code, text)] if code == "not_granted" && text.starts_with("2 in the minute"))
    );
    log.write_counted(None).await;
    assert_eq!(ground.audited("refused").len(), 1, "told once");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn lists_begin_with_the_newest_line_and_what_is_handed_out_names_no_account() {
    let ground = Ground::with(&[]);
    let (log, owner) = (&ground.parts.log, ground.owner("alice"));
    let account = Address([0xab; 20]);
    for subject in ["first", account.to_string().as_str(), "last"] {
        log.write(&profile("alice"), "deed", subject, "done").await.expect("written");
    }
    let listed = log.list(AuditQuery { limit: 2, ..AuditQuery::default() }).await.expect("lines");
    let subjects: Vec<_> = listed.iter().map(|line| line.subject.clone()).collect();
    assert_eq!(subjects, ["last".to_owned(), account.to_string()]);
    assert!(listed.iter().all(|line| line.at <= Timestamp::now()));

    let text = |files: Vec<crate::reply::ExportedFile>| {
        files.into_iter().map(|file| String::from_utf8(file.bytes).expect("text")).collect::<String>()
    };
    let redacted = text(log.export(&owner, false).await.expect("a file"));
    assert!(!redacted.contains(&account.to_string()) && redacted.contains("first"), "{redacted}");
    let full = text(log.export(&owner, true).await.expect("a file"));
    assert!(full.contains(&account.to_string()), "{full}");
    let lines: Vec<serde_json::Value> =
        redacted.lines().map(|line| serde_json::from_str(line).expect("one document a line")).collect();
    assert_eq!(lines.len(), 4, "with the line that announced the export");
}
