//! After an unclean end: whether the ledger is consistent, and the newest records agree with the vault.

use super::Storage;
use std::sync::Arc;
use std::time::Duration;

use crate::model::ProfileName;
use crate::service::event::NoticeLevel;
use crate::service::reply::Failure;
use crate::site::blocking;

/// Records re-read from the vault; a crash can only have touched what was written last.
const NEWEST: usize = 256;

/// How long the process that started the site may take to listen.
const LISTENING: Duration = Duration::from_millis(500);

impl Storage {
    /// This home is a copy of another one.
    pub(in crate::site) async fn tell_of_copy(self: Arc<Self>) {
        let text = "this home is a copy: its ledger is not the file it was when last used. New records are numbered \
                    under a new recorder; do not run it at the same time as the original";
        if let Ok(profile) = "site".parse::<ProfileName>() {
            let written = self.log.write(&profile, "copied home", "a new recorder begins", "noticed").await;
            if let Err(failure) = written {
                self.hub.notice(NoticeLevel::Error, &failure.message);
            }
        }
        tokio::time::sleep(LISTENING).await;
        self.hub.notice(NoticeLevel::Warning, text);
    }

    /// Checks once, in the background, if the previous run did not close its files.
    pub(in crate::site) async fn check_after_crash(self: Arc<Self>) {
        if self.plant.ledger.ended_cleanly() {
            return;
        }
        match blocking(&self, contradictions).await {
            Ok(found) if found.is_empty() => {
                self.hub.notice(
                    NoticeLevel::Info,
                    "the previous run did not shut down cleanly; ledger and vault are sound",
                );
            }
            Ok(found) => found.iter().for_each(|text| self.hub.notice(NoticeLevel::Error, text)),
            Err(failure) => {
                let text = format!(
                    "after an unclean shutdown it could not be checked whether everything is there: {}",
                    failure.message
                );
                self.hub.notice(NoticeLevel::Error, &text);
            }
        }
    }
}

fn contradictions(storage: &Storage) -> Result<Vec<String>, Failure> {
    let plant = &storage.plant;
    let mut found: Vec<String> = plant
        .ledger
        .contradictions()?
        .into_iter()
        .map(|text| format!("after an unclean shutdown, in the ledger: {text}; keep a copy of the home"))
        .collect();
    for digest in plant.ledger.newest_stored(NEWEST)? {
        let blob = plant.vault.get(digest)?;
        // A vault that is only a cache is filled again from the local copies.
        if blob.is_none() && !plant.vault.durable() {
            continue;
        }
        if blob.is_none_or(|blob| plant.provider.sm3(&[&blob]) != digest.0) {
            found.push(format!("after an unclean shutdown: record {digest} is not in the vault as it was stored"));
        }
    }
    Ok(found)
}
