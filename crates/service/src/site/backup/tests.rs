//! A backup: complete, sealed, never overwriting another file, and of one moment.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::os::unix::fs::PermissionsExt as _;

use super::*;
use crate::site::contacts::Contacts;
use crate::site::reading::Reading;
use crate::site::testing::{Ground, PASSPHRASE, profile};

fn backup(ground: &Ground) -> (Arc<Backup>, Arc<Quarantine>) {
    let contacts = Arc::new(Contacts::new(&ground.parts));
    let reading = Arc::new(Reading::new(&ground.parts, &contacts));
    let quarantine = Arc::new(Quarantine::new(&ground.parts, &reading));
    (Arc::new(Backup::new(&ground.parts, &quarantine)), quarantine)
}

fn secret() -> SecretText {
    SecretText::new(PASSPHRASE.to_owned())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_back_up_is_written_once_for_its_owner_alone_and_not_into_the_home() {
    let ground = Ground::with(&[]);
    ground.owner("alice");
    let (backup, _) = backup(&ground);
    let (alice, file) = (profile("alice"), ground.folder.path().join("home.backup"));
    let inside = ground.parts.home.root().join("home.backup");
    let refused = backup.back_up(&alice, inside, secret()).await.expect_err("in the home");
    assert!(refused.message.contains("is inside the home itself"), "{}", refused.message);
    assert!(ground.audited("back up").is_empty());

    let view = backup.back_up(&alice, file.clone(), secret()).await.expect("written");
    assert_eq!(view.profiles, ["alice"]);
    let about = std::fs::metadata(&file).expect("there");
    assert_eq!(about.permissions().mode() & 0o777, 0o600);
    let bytes = std::fs::read(&file).expect("readable");
    assert!(!bytes.windows(5).any(|window| window == b"alice"), "sealed");
    let twice = backup.back_up(&alice, file.clone(), secret()).await.expect_err("never over another");
    assert!(twice.message.contains("exists"), "{}", twice.message);
    assert_eq!(std::fs::read(&file).expect("as before"), bytes);
    let outcomes: Vec<_> = ground.audited("back up").into_iter().map(|(_, outcome)| outcome).collect();
    assert_eq!(outcomes, ["begun", "done"]);
    let left: Vec<_> = std::fs::read_dir(ground.parts.home.root())
        .expect("the home")
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(".back-up-"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_moment_waits_for_what_deletes_ciphertext() {
    let ground = Ground::with(&[]);
    ground.owner("alice");
    let (backup, quarantine) = backup(&ground);
    let file = ground.folder.path().join("home.backup");
    let quiet = quarantine.quiet().await;
    let mut running = Box::pin({
        let (backup, file) = (Arc::clone(&backup), file.clone());
        async move { backup.back_up(&profile("alice"), file, secret()).await }
    });
    // Until it is announced, which happens right before the moment.
    loop {
        tokio::select! {
            done = &mut running => panic!("ended while records were being deleted: {done:?}"),
            () = tokio::time::sleep(std::time::Duration::from_millis(20)) => {}
        }
        if !ground.audited("back up").is_empty() {
            break;
        }
    }
    let told = ground.parts.runs.of(&profile("alice"));
    assert_eq!((told.len(), told[0].step.as_str(), told[0].messages), (1, "copying into", 0));
    assert!(!file.exists());
    drop(quiet);
    running.await.expect("written now");
    assert!(ground.parts.runs.of(&profile("alice")).is_empty(), "it ended");
    assert!(file.exists());
}
