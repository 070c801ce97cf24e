//! Seals every message of another home anew: its records are opened with the same keys, without its chain, and keep
//! their capture times. The other home does not change.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::runtime::Handle;

use super::Run;
use super::import::at;
use super::import::{ReadOut, left_out_list};
use crate::chain::SEAL_ANEW;
use crate::crypto::OpenedRecord;
use crate::model::{Header, RecordKind, RecordState, clean};
use crate::paths::Home;
use crate::pipeline::importer::{self, FORMER_RECORD, FORMER_SIGNER, LATCHING};
use crate::pipeline::{CaptureSession, Definitions, Importer, Network, Opening, Owner, Plant, Reader, network_pin};
use crate::reply::{ImportView, ImportedTopic, Result, input, refused};
use crate::ros::recording::{Beside, Channel, Encoding, RecordedMessage};
use crate::site::{Recordings, blocking};
use crate::store::{Ciphertext, Ledger, RecordQuery, RecordRow, SiteLock};

const PAGE: usize = 500;

struct OldHome {
    plant: Plant,
    network: Network,
    _lock: SiteLock,
}

impl Recordings {
    /// Seals every message of another home that this profile's keys open.
    pub async fn import_home(self: &Arc<Self>, owner: &Arc<Owner>, home: PathBuf) -> Result<ImportView> {
        let path = home.clone();
        let old = blocking(self, move |recordings| recordings.open_home(&home)).await?;
        if owner.epochs(old.network.domain).is_empty() {
            return Err(refused(format!(
                "profile '{}' of this home does not have the keys of {}; run {SEAL_ANEW}, where NEW is empty: the import brings \
                 the keyring",
                owner.profile,
                clean(&path.display().to_string(), 200)
            )));
        }
        if owner.sealing().is_none() {
            self.profiles.register(owner).await?;
        }
        let network = self.parts.link.network().await?;
        if network.domain == old.network.domain {
            return Err(refused(
                "both homes use the same chain and contract, so old and new records could not be distinguished; set \
                 chain.contract in the new home to another contract, or leave it empty",
            ));
        }
        let author = Arc::clone(owner);
        let read = move |recordings: &Self, run: &Run, control: &CaptureSession| {
            recordings.read_home(&author, &network, &old, run, control)
        };
        self.run_import(owner, &path, "import home", read).await
    }

    fn open_home(&self, root: &Path) -> Result<OldHome> {
        let shown = clean(&root.display().to_string(), 200);
        let home = Home::at(root).map_err(|error| input(error.to_string()))?;
        if !home.ledger().exists() {
            return Err(input(format!("{shown} has no ledger, so it is not a home; give the folder of the old home")));
        }
        let same = |path: &Path| path.canonicalize().ok();
        if same(home.root()) == same(self.parts.home.root()) {
            return Err(input(format!("{shown} is this home itself; give the new one with --home")));
        }
        let Some(lock) = SiteLock::acquire(&home.site_lock())? else {
            return Err(refused(format!("{shown} is in use; stop its site or console first, then repeat the command")));
        };
        Ledger::check_version(&home.ledger())?;
        let ledger = Ledger::open(&home.ledger())?;
        let plant = Plant { ciphertext: Ciphertext::of(&ledger), ledger, ..self.parts.plant.clone() };
        let pin = network_pin(&plant.ledger.rights)?.ok_or_else(|| {
            input(format!("{shown} was never bound to a chain, so it has no records; use it with the new chain"))
        })?;
        let network = Network::kept(&plant, pin, "a home that is imported is read without its chain")?;
        Ok(OldHome { plant, network, _lock: lock })
    }

    /// Gives every message that is not sealed here yet to the sealer.
    fn read_home(
        &self,
        owner: &Owner,
        network: &Network,
        old: &OldHome,
        run: &Run,
        control: &CaptureSession,
    ) -> Result<ReadOut> {
        let goes_on = || !control.is_closed() && !self.parts.life.is_stopping();
        let of = old.plant.ledger.counts.by_state(Some(owner.address))?.captured();
        let mut moving = Moving {
            there: Reader { plant: &old.plant, network: &old.network, reader: owner },
            here: Reader { plant: &self.parts.plant, network, reader: owner },
            definitions: Definitions::default(),
        };
        let mut importer =
            Importer::new(&self.rings, Arc::clone(&owner.author), &self.parts.config.topic_rules, Vec::new());
        let (mut view, mut already) = (ImportView::default(), BTreeMap::<String, u64>::new());
        let mut left_out = BTreeMap::<(Arc<str>, &'static str), u64>::new();
        run.step("importing");
        let query = RecordQuery { owner: Some(owner.address), limit: PAGE, ..RecordQuery::default() };
        let kinds = [RecordKind::Data, RecordKind::Attachment].into_iter();
        let rows =
            kinds.flat_map(|kind| old.plant.ledger.records.all(RecordQuery { kind: Some(kind), ..query.clone() }));
        for row in rows {
            let row = row?;
            match moving.message(&row)? {
                Found::New(message, tags) => {
                    if !importer.take_again(message, tags, &goes_on) {
                        view.ended_early = true;
                        break;
                    }
                }
                Found::Here(topic) => *already.entry(topic).or_default() += 1,
                Found::Stays { why, is_wanted } => {
                    view.skipped += u64::from(is_wanted);
                    *left_out.entry((row.topic.as_str().into(), why)).or_default() += 1;
                }
            }
            view.found += 1;
            run.at(view.found.min(of), of, importer.offered());
        }
        view.file = clean(&old.plant.ledger.path().parent().unwrap_or(Path::new("")).display().to_string(), 300);
        view.left_out = left_out_list(left_out);
        let topic = |(topic, already)| ImportedTopic { topic, already, ..ImportedTopic::default() };
        view.topics = already.into_iter().map(topic).collect();
        Ok(ReadOut { view, sessions: importer.finish(), whole: Vec::new() })
    }
}

fn beside(tags: &BTreeMap<String, String>) -> Encoding {
    match importer::encoding(tags) {
        beside @ Encoding::Beside(_) => beside,
        Encoding::Ros1 | Encoding::Cdr { .. } => Encoding::Beside(Beside::Attachment),
    }
}

/// `Here` has the topic of a message sealed by an earlier import; what stays is wanted if somebody may expect it here.
enum Found {
    New(RecordedMessage, Vec<(String, String)>),
    Here(String),
    Stays { why: &'static str, is_wanted: bool },
}

struct Moving<'a> {
    there: Reader<'a>,
    here: Reader<'a>,
    definitions: Definitions,
}

impl Moving<'_> {
    fn message(&mut self, row: &RecordRow) -> Result<Found> {
        let is_own = self.there.is_own_key(row.signer);
        let stays = |why| Ok(Found::Stays { why, is_wanted: true });
        let went = |why| Ok(Found::Stays { why, is_wanted: false });
        match row.state {
            RecordState::Quarantined => return stays("quarantined in the old home"),
            RecordState::Dropped => return went("discarded in the old home"),
            RecordState::Tampered => return stays("not the bytes that were anchored"),
            // Nobody vouches for what a device signed without a right; the owner signs the owner's again.
            RecordState::RightEnded if !is_own => return stays("signed by a device that had no right to sign"),
            _ if row.deleted_at.is_some() => return went("deleted by retention, or erased"),
            _ => {}
        }
        let Some(blob) = self.there.own_bytes(row)? else { return stays("the old home does not have its ciphertext") };
        let Some(opened) = self.there.open_own(row, &blob)? else {
            let why =
                "no key of this profile opens it, its signature is not valid, or its signer wrote a false name into it";
            return stays(why);
        };
        if self.is_here(&opened)? {
            return Ok(Found::Here(opened.head.topic));
        }
        let definition = match opened.header.kind {
            RecordKind::Data => {
                let text = self.definitions.text(&self.there, row, &opened, Opening::Own);
                Handle::current().block_on(text)?.unwrap_or_default()
            }
            _ => "".into(),
        };
        let OpenedRecord { header, head, body, digest, .. } = opened;
        let channel = Channel {
            topic: head.topic.as_str().into(),
            type_name: head.type_name.as_str().into(),
            md5sum: head.md5sum.as_str().into(),
            definition,
            caller_id: head.caller_id.as_str().into(),
            latching: head.tags.contains_key(LATCHING),
            // The tags say what a message is, and what a recording says of it.
            encoding: if header.kind == RecordKind::Data { Encoding::Ros1 } else { beside(&head.tags) },
            about: BTreeMap::new(),
        };
        let mut tags: Vec<(String, String)> = head.tags.into_iter().collect();
        tags.push((FORMER_RECORD.to_owned(), digest.to_hex()));
        tags.extend((!is_own).then(|| (FORMER_SIGNER.to_owned(), row.signer.to_string())));
        let message = RecordedMessage { channel: Arc::new(channel), time: header.captured_at, sent: None, body };
        Ok(Found::New(message, tags))
    }

    /// An earlier import sealed this message if a record of the same topic and time names it.
    fn is_here(&self, opened: &OpenedRecord) -> Result<bool> {
        let Header { kind, captured_at, .. } = opened.header;
        let former = opened.digest.to_hex();
        for sealed in self.here.own_opened(at(&opened.head.topic, kind, Some(captured_at))) {
            if sealed?.1.head.tags.get(FORMER_RECORD) == Some(&former) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
