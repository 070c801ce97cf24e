//! The cost of silent connections.

use serde::Serialize;

use super::Stage;
use super::sender::Sender;
use crate::network::Directory;
use crate::progress::Progress;
use crate::usage;
use authros_service::Failure;
use authros_service::reply::internal;

/// Descriptors that the process needs besides.
const OTHER_FILES: usize = 100;

/// Memory of idle connections, both ends of them in this process.
#[derive(Debug, Clone, Serialize)]
pub struct Idle {
    /// Wanted.
    pub asked: usize,
    /// Open and authenticated at once.
    pub connections: usize,
    /// The resident memory they added, bytes.
    pub resident: u64,
    /// That, per connection.
    pub bytes_each: u64,
    /// Why there are fewer than requested.
    pub limited_by: Option<String>,
}

impl Idle {
    /// In one line.
    pub fn line(&self) -> String {
        let limit = self.limited_by.as_ref().map_or(String::new(), |limit| format!(" ({limit})"));
        format!(
            "idle: {} of {} connections, {:.1} MiB resident, {} bytes each, both ends{limit}",
            self.connections,
            self.asked,
            super::number(self.resident >> 10) / 1024.0,
            self.bytes_each
        )
    }
}

/// Opens this many connections, as far as file limits allow, and measures the memory.
pub(super) async fn measure(sender: &Sender, asked: usize) -> Result<Idle, Failure> {
    let files = usage::most_files().unwrap_or(usize::MAX);
    let count = asked.min(files.saturating_sub(OTHER_FILES) / 2);
    let limited_by = (count < asked).then(|| {
        format!(
            "open files are limited to {files}: `ulimit -n {}` allows all of \
                          them",
            2 * asked + OTHER_FILES
        )
    });
    let directory = Directory::new()?;
    let stage = Stage::open(sender, directory.path(), count).await?;
    let mut progress = Progress::new("idle connections");
    let (mut clients, before) = (Vec::with_capacity(count), resident()?);
    for done in 0..count {
        clients.push(stage.connect().await?);
        progress.at(done, count);
    }
    let resident = resident()?.saturating_sub(before);
    let connections = stage.server.watch().connections();
    drop(progress);
    if let Some(client) = clients.last_mut() {
        // The last of many is served like the first.
        client.upload(sender.seal_all(1, 1024)?).await.map_err(super::of_gateway)?;
    }
    drop(clients);
    stage.close().await;
    let bytes_each = resident.checked_div(connections as u64).unwrap_or(0);
    Ok(Idle { asked, connections, resident, bytes_each, limited_by })
}

/// Resident memory of this process, bytes.
fn resident() -> Result<u64, Failure> {
    usage::resident().ok_or_else(|| internal("/proc/self/status does not show the memory in use"))
}
