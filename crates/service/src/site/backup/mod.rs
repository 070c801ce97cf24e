//! Backup of a running home: the store and the chain as of one moment, then the small files, in one sealed file.

#[cfg(test)]
mod tests;

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;

use crate::chain::Chain;
use crate::command::SecretText;
use crate::crypto::sealed_stream::SealedWriter;
use crate::crypto::unfinished::{self, UnfinishedFolder};
use crate::crypto::{Passphrase, fault};
use crate::model::{ErrorKind, ProfileName, clean};
use crate::reply::{BackupView, Failure, Result, input};
use crate::site::parts::Run;
use crate::site::{Parts, Quarantine, blocking};
use crate::store::snapshot::Snapshot;
use crate::store::{StoreError, archive};

pub const LEDGER: &str = "ledger.db";
const CHAIN: &str = "chain/chain.db";
const RING: &str = "ring/";
const OPENING: Duration = Duration::from_secs(30);
/// Prefixes of files that belong to the running process or are recreated.
const LEFT_OUT: [&str; 5] = ["backup.lock", "backup.sock", "reserve", "waiting", unfinished::PREFIX];

pub struct Backup {
    pub parts: Parts,
    pub quarantine: Arc<Quarantine>,
}

impl Backup {
    /// Writes a new file, 0600; a crash leaves none.
    pub async fn back_up(self: &Arc<Self>, by: &ProfileName, file: PathBuf, secret: SecretText) -> Result<BackupView> {
        let passphrase = Passphrase::new(secret.expose().to_owned())?;
        let shown = clean(&file.display().to_string(), 200);
        if file.starts_with(self.parts.home.root())
            || self.parts.home.outside().iter().any(|(_, place)| file.starts_with(place))
        {
            return Err(input(format!(
                "{shown} is inside the home itself; write the backup elsewhere, preferably to another disk"
            )));
        }
        if fs::symlink_metadata(&file).is_ok() {
            return Err(input(format!("{shown} already exists; choose a new file, backups are never overwritten")));
        }
        let running = self.parts.runs.begin(by, &shown, "copying into", "files");
        let runtime = Handle::current();
        let written = async {
            // While an embedded chain opens, its file is locked and no connection has it.
            if self.parts.config.chain_url.is_none() {
                drop(tokio::time::timeout(OPENING, self.parts.link.settled()).await);
            }
            // Deletions commit before their notes; the snapshot must not fall between.
            let quiet = self.quarantine.quiet().await;
            let moment = blocking(self, move |backup| backup.moment(&runtime)).await?;
            drop(quiet);
            blocking(self, move |backup| backup.pack(&moment, &file, &passphrase, &running.run)).await
        };
        self.parts.log.deed(by, "back up", &shown, written).await
    }

    fn moment(&self, runtime: &Handle) -> Result<Moment> {
        let unwritten = |error| unwritten(self.parts.home.root(), &error);
        // Copies of a killed backup, which no erasure reaches.
        unfinished::sweep(self.parts.home.root()).map_err(unwritten)?;
        let folder = UnfinishedFolder::new(self.parts.home.root()).map_err(unwritten)?;
        let (chain, runtime, copy) = (self.parts.link.connected(), runtime.clone(), folder.path().join("chain.db"));
        let closed = self.parts.home.chain().join("chain.db");
        let also = move || copy_chain(chain.as_ref(), &runtime, &closed, &copy);
        let (ledger, chain) = Snapshot::of(&self.parts.plant.ledger, also)?;
        fault::point("backup-moment");
        Ok(Moment { folder, ledger, chain })
    }

    fn expected(&self, moment: &Moment) -> u64 {
        let chain = moment.chain.then(|| moment.folder.path().join("chain.db"));
        let ring = fs::read_dir(self.parts.home.ring()).into_iter().flatten().flatten().map(|entry| entry.path());
        let all = [Some(self.parts.home.ledger()), chain].into_iter().flatten().chain(ring);
        all.filter_map(|path| fs::metadata(path).ok()).map(|about| about.len()).sum()
    }

    fn pack(&self, moment: &Moment, file: &Path, passphrase: &Passphrase, run: &Run) -> Result<BackupView> {
        let directory = file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let failed = |error: io::Error| unwritten(file, &error);
        unfinished::sweep(directory).map_err(failed)?;
        let target = unfinished::new_file(directory).map_err(failed)?;
        let mut view = BackupView {
            file: clean(&file.display().to_string(), 200),
            profiles: self.parts.home.profiles().iter().map(ToString::to_string).collect(),
            ..BackupView::default()
        };
        let mut sealed = SealedWriter::new(io::BufWriter::new(target), passphrase).map_err(failed)?;
        let copy = moment.folder.path().join("copy.db");
        run.expect(self.expected(moment));
        run.step("copying into");
        moment.ledger.copy_to(&copy)?;
        fault::point("backup-copied");
        run.step("writing");
        add(&mut sealed, LEDGER, &copy, &mut view, run).map_err(failed)?;
        fs::remove_file(&copy).map_err(failed)?;
        if moment.chain {
            add(&mut sealed, CHAIN, &moment.folder.path().join("chain.db"), &mut view, run).map_err(failed)?;
        }
        // After the ledger: the keyring must have the key of every epoch that the ledger names.
        let mut small = Small { sealed: &mut sealed, view: &mut view, run };
        small.directory("", self.parts.home.root()).map_err(failed)?;
        for (name, path) in self.parts.home.outside() {
            small.outside(name, path).map_err(failed)?;
        }
        archive::end(&mut sealed).map_err(failed)?;
        let target = sealed.finish().map_err(failed)?.into_inner().map_err(|error| failed(error.into_error()))?;
        target.as_file().sync_all().map_err(failed)?;
        fault::point("backup-sealed");
        target.persist_noclobber(file).map_err(|error| failed(error.error))?;
        File::open(directory).and_then(|directory| directory.sync_all()).map_err(failed)?;
        Ok(view)
    }
}

struct Small<'a, W> {
    sealed: &'a mut W,
    view: &'a mut BackupView,
    run: &'a Run,
}

impl<W: Write> Small<'_, W> {
    fn directory(&mut self, within: &str, directory: &Path) -> io::Result<()> {
        let mut entries = fs::read_dir(directory)?.collect::<io::Result<Vec<_>>>()?;
        entries.sort_by_key(fs::DirEntry::file_name);
        for entry in entries {
            let last = entry.file_name();
            let Some(last) = last.to_str() else { continue };
            let name = if within.is_empty() { last.to_owned() } else { format!("{within}/{last}") };
            let is_database = [LEDGER, CHAIN].iter().any(|database| name.starts_with(database));
            if !is_database && !LEFT_OUT.iter().any(|begin| last.starts_with(begin)) {
                self.entry(&name, &entry.path(), entry.file_type()?)?;
            }
        }
        Ok(())
    }

    fn entry(&mut self, name: &str, path: &Path, kind: fs::FileType) -> io::Result<()> {
        if kind.is_dir() {
            self.directory(name, path)
        } else if kind.is_file() && archive::is_plain(name) {
            match add(self.sealed, name, path, self.view, self.run) {
                // It left the ring after the folder was listed.
                Err(error) if error.kind() == io::ErrorKind::NotFound && name.starts_with(RING) => Ok(()),
                added => added,
            }
        } else {
            self.view.notes.push(format!("{} is not a regular file and was left out", clean(name, 100)));
            Ok(())
        }
    }

    /// Follows links: settings often point into another folder.
    fn outside(&mut self, name: &str, path: &Path) -> io::Result<()> {
        match fs::metadata(path) {
            Ok(about) => self.entry(name, path, about.file_type()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(error),
        }
    }
}

struct Moment {
    folder: UnfinishedFolder,
    ledger: Snapshot,
    chain: bool,
}

fn copy_chain(chain: Option<&Chain>, runtime: &Handle, closed: &Path, copy: &Path) -> Result<bool, StoreError> {
    let failed = |detail: String| StoreError::Database { file: closed.to_owned(), detail };
    if let Some(chain) = chain
        && runtime.block_on(chain.copy_to(copy.to_owned())).map_err(|error| failed(error.to_string()))?
    {
        return Ok(true);
    }
    if !closed.exists() {
        return Ok(false);
    }
    Snapshot::begin(closed)?.copy_to(copy)?;
    Ok(true)
}

struct Told<'a> {
    file: File,
    run: &'a Run,
}

impl Read for Told<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.run.more(count as u64);
        Ok(count)
    }
}

fn add(sealed: &mut impl Write, name: &str, path: &Path, view: &mut BackupView, run: &Run) -> io::Result<()> {
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    // Shortage of room truncates a ring file; its next opening cuts these zeros off.
    let zeros = if name.starts_with(RING) { length } else { 0 };
    archive::put(sealed, name, length, &mut Told { file, run }.chain(io::repeat(0).take(zeros)))?;
    run.one_more();
    view.files += 1;
    view.bytes += length;
    Ok(())
}

fn unwritten(path: &Path, error: &io::Error) -> Failure {
    let path = clean(&path.display().to_string(), 200);
    Failure::new(ErrorKind::Home, format!("the backup at {path} cannot be written: {error}; nothing was left behind"))
}
