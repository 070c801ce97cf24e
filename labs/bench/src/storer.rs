//! A throw-away embedded vault, and the thread that commits everything waiting to it at once, as in the pipeline: what
//! it acknowledges is on disk.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use tokio::sync::oneshot;

use authros_model::Digest;
use authros_service::Failure;
use authros_service::failure::internal;
use authros_store::{StoreError, Vault, open_vault};

/// The most records in one commit, as in the pipeline.
const ROUND: usize = 256;

struct Item {
    digest: Digest,
    blob: Vec<u8>,
    stored: oneshot::Sender<Result<(), String>>,
}

/// The input of the vault.
pub struct Storer {
    vault: Arc<dyn Vault>,
    items: Sender<Item>,
}

impl Storer {
    /// Opens a vault in `directory`; the thread ends with the storer.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn open(directory: &Path) -> Result<Self, Failure> {
        let vault = open_vault(None, directory)?;
        let (items, inbox) = channel();
        let own = Arc::clone(&vault);
        let started = std::thread::Builder::new().name("authros-storer".into()).spawn(move || run(&*own, &inbox));
        started.map_err(|error| internal(format!("the vault's thread cannot start: {error}")))?;
        Ok(Self { vault, items })
    }

    /// Stores one record; when this returns it is on disk.
    ///
    /// # Errors
    /// Errors of the vault.
    pub async fn put(&self, digest: Digest, blob: Vec<u8>) -> Result<(), Failure> {
        let (stored, answer) = oneshot::channel();
        let gone = || internal("the vault's thread has ended");
        self.items.send(Item { digest, blob, stored }).map_err(|_| gone())?;
        answer.await.map_err(|_| gone())?.map_err(internal)
    }

    /// How many records it holds.
    ///
    /// # Errors
    /// Errors of the vault.
    pub fn entries(&self) -> Result<u64, Failure> {
        Ok(self.vault.usage()?.entries)
    }
}

fn run(vault: &dyn Vault, inbox: &Receiver<Item>) {
    while let Ok(first) = inbox.recv() {
        let items: Vec<Item> = std::iter::once(first).chain(inbox.try_iter().take(ROUND - 1)).collect();
        let entries: Vec<(Digest, &[u8])> = items.iter().map(|item| (item.digest, item.blob.as_slice())).collect();
        let done = vault.put(&entries).map_err(|error: StoreError| error.to_string());
        for item in items {
            // An uploader that was ended waits no more.
            drop(item.stored.send(done.clone()));
        }
    }
}
