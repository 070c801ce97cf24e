//! How far work is that takes long, on stderr while it goes on.

use std::future::Future;
use std::time::Duration;

use crate::app::progress::Progress;
use crate::model::Timestamp;
use crate::service::Client;
use crate::service::command::{Command, RecordingProgress, StoreCommand};
use authros_output::Output;

/// Between two looks.
pub const LOOK: Duration = Duration::from_secs(3);

/// Tells what is new of what runs.
#[derive(Debug, Default)]
pub struct Teller {
    progress: Progress,
    told: Vec<String>,
}

impl Teller {
    /// Asks the site, and writes the lines that are not what was written last.
    pub async fn tell(&mut self, client: &Client, output: &Output) {
        let Ok(runs) = client.ask(RecordingProgress).await else { return };
        let now = Timestamp::now();
        self.progress.set(runs, now);
        let lines = self.progress.lines(now);
        lines.iter().filter(|line| !self.told.contains(line)).for_each(|line| output.note(line));
        self.told = lines;
    }
}

/// Whether a request may take so long that it is told how far it is.
pub fn takes_long(command: &Command) -> bool {
    matches!(command, Command::OfStore(StoreCommand::AuditRecords { .. }))
}

/// Waits for `work`, and tells meanwhile how far it is.
pub async fn told<T>(client: &Client, work: impl Future<Output = T>, output: &Output) -> T {
    tokio::pin!(work);
    let mut teller = Teller::default();
    loop {
        tokio::select! {
            done = &mut work => return done,
            () = tokio::time::sleep(LOOK) => teller.tell(client, output).await,
        }
    }
}
