//! An export: what this profile may read, each record verified before it is written.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tempfile::NamedTempFile;
use tokio::task::block_in_place;

use super::Run;
use crate::command::ExportWishes;
use crate::crypto::{CryptoError, OpenedRecord, private_file, unfinished};
use crate::model::{Address, ErrorKind, RecordKind, Scope, TopicPattern, Verdict, clean};
use crate::pipeline::{Definitions, Network, Opening, Owner, PipelineError, Reader, authority, importer, is_held};
use crate::reply::{ExportView, ExportedTopic, Refused, Result, input, internal};
use crate::ros::recording::{Channel, Encoding, RecordingFormat, RecordingWriter};
use crate::ros::rosbag2::{METADATA, Tally};
use crate::site::Recordings;
use crate::store::{RecordQuery, RecordRow};

const PAGE: usize = 500;

const MOST_NAMED: usize = 100;

struct Export<'a> {
    wishes: &'a ExportWishes,
    writer: RecordingWriter,
    tally: Tally,
    channels: HashMap<Channel, Arc<Channel>>,
    definitions: Definitions,
    topics: BTreeMap<(String, String), u64>,
    /// Topics whose definitions a node gave.
    given: BTreeSet<String>,
    view: ExportView,
}

impl Recordings {
    pub async fn export_recording(&self, owner: &Owner, wishes: ExportWishes) -> Result<ExportView> {
        if !wishes.format.takes(wishes.compression) {
            let (format, compression) = (wishes.format.word(), wishes.compression);
            let text = format!("{format} chunks cannot be compressed with {compression}; choose another compression");
            return Err(input(text));
        }
        let network = self.reading.network_or_kept().await?;
        let scopes = self.scopes(owner, &network, &wishes)?;
        let file = clean(&wishes.path.display().to_string(), 300);
        let running = self.begin_run(&owner.profile, &wishes.path, "exporting");
        let written = self.write_recording(owner, &network, &scopes, &wishes, &running.run);
        self.parts.log.deed(&owner.profile, "export recording", &file, written).await
    }

    /// Owners whose records are requested, with their scopes.
    fn scopes(&self, owner: &Owner, network: &Network, wishes: &ExportWishes) -> Result<HashMap<Address, Scope>> {
        let me = owner.address;
        let wanted = wishes.owner.as_ref().map(|party| self.contacts.resolve(party)).transpose()?;
        let is_wanted = |address: Address| wanted.is_none_or(|wanted| wanted == address);
        // Only the chain knows whether others still grant.
        let granted = match network.absent {
            None => authority::shared_with(&network.directory, me),
            Some(_) => Vec::new(),
        };
        let granted = granted.into_iter().map(|grant| (grant.terms.owner, grant.terms.scope));
        let mut scopes: HashMap<Address, Scope> = granted.filter(|(address, _)| is_wanted(*address)).collect();
        if is_wanted(me) {
            scopes.insert(me, Scope::All);
        }
        if let (true, Some(other)) = (scopes.is_empty(), wanted) {
            let what = "its records".to_owned();
            return Err(PipelineError::NotGranted { owner: other, reader: me, what }.into());
        }
        Ok(scopes)
    }

    async fn write_recording(
        &self,
        owner: &Owner,
        network: &Network,
        scopes: &HashMap<Address, Scope>,
        wishes: &ExportWishes,
        run: &Run,
    ) -> Result<ExportView> {
        let reader = Reader { plant: &self.parts.plant, network, reader: owner };
        for address in scopes.keys() {
            self.reading.learn_names(&reader, *address).await?;
        }
        let readable = self.reading.readable_topics(scopes)?;
        let (draft, file) = block_in_place(|| Draft::begin(&wishes.path))?;
        let mut export = Export::begin(wishes, RecordingWriter::begin(wishes.format, wishes.compression, file)?);
        let mut seen = 0;
        // Messages first: the first sets the file's profile. Patterns choose topics, and attachments have none.
        let kinds = [RecordKind::Data, RecordKind::Attachment];
        for kind in kinds.into_iter().filter(|kind| wishes.topics.is_empty() || *kind == RecordKind::Data) {
            let query = RecordQuery {
                owners: Some(scopes.keys().copied().collect()),
                topic_ids: Some(readable.clone()),
                kind: Some(kind),
                since: wishes.since,
                until: wishes.until,
                limit: PAGE,
                ..RecordQuery::default()
            };
            for row in self.parts.plant.ledger.records.all(query) {
                if self.parts.life.is_stopping() {
                    return Err(internal("the site stopped before the recording was complete; repeat the command"));
                }
                export.take(&reader, &row?).await?;
                seen += 1;
                run.at(seen, 0, export.view.messages);
            }
        }
        block_in_place(|| export.finish(draft))
    }
}

impl<'a> Export<'a> {
    fn begin(wishes: &'a ExportWishes, writer: RecordingWriter) -> Self {
        let view = ExportView {
            file: None,
            format: wishes.format,
            messages: 0,
            attachments: 0,
            bytes: 0,
            refused: Refused::default(),
            suspicious: Vec::new(),
            given: Vec::new(),
            topics: Vec::new(),
        };
        let (channels, definitions) = (HashMap::new(), Definitions::default());
        let (topics, given) = (BTreeMap::new(), BTreeSet::new());
        Self { wishes, writer, tally: Tally::default(), channels, definitions, topics, given, view }
    }

    fn is_wanted(&self, topic: &str) -> bool {
        let patterns: &[TopicPattern] = &self.wishes.topics;
        patterns.is_empty() || patterns.iter().any(|pattern| pattern.matches(topic))
    }

    /// Opens one record, and writes it if every check passes.
    async fn take(&mut self, reader: &Reader<'_>, row: &RecordRow) -> Result<()> {
        if row.is_named() && !self.is_wanted(&row.topic) {
            return Ok(());
        }
        if is_held(row) {
            self.view.refused.held += u64::from(row.owner == reader.reader.address);
            return Ok(());
        }
        let opened = match reader.open(row).await {
            Ok(opened) => opened,
            Err(error) => return self.refuse(row, error),
        };
        if !self.is_wanted(&opened.head.topic) {
            return Ok(());
        }
        let is_unconfirmed = matches!(opened.verdict, Verdict::Unanchored | Verdict::NotChecked);
        if opened.verdict != Verdict::Verified && !(self.wishes.unanchored && is_unconfirmed) {
            self.view.refused.unanchored += 1;
            return Ok(());
        }
        let encoding = importer::encoding(&opened.head.tags);
        let is_message = opened.header.kind == RecordKind::Data;
        let (format, seconds) = (self.wishes.format, opened.header.captured_at.seconds());
        let is_too_late = format == RecordingFormat::Bag && u32::try_from(seconds).is_err();
        if !is_as_its_kind(encoding, &opened) || !format.holds(encoding) || is_too_late {
            let refused = &mut self.view.refused;
            *if is_message { &mut refused.unsuitable } else { &mut refused.attachments } += 1;
            return Ok(());
        }
        let definition = if is_message {
            self.definitions.text(reader, row, &opened, Opening::Anchored).await?
        } else {
            Some("".into())
        };
        let Some(definition) = definition else {
            self.view.refused.no_definition += 1;
            return Ok(());
        };
        let head = &opened.head;
        let is_recorded = head.tags.get(importer::SOURCE.0).is_some_and(|source| source == importer::SOURCE.1);
        if matches!(encoding, Encoding::Cdr { .. }) && !is_recorded && !definition.is_empty() {
            self.given.insert(clean(&head.topic, 255));
        }
        let channel = self.channel(Channel {
            topic: head.tags.get(importer::RECORDED_TOPIC).unwrap_or(&head.topic).as_str().into(),
            type_name: head.type_name.as_str().into(),
            md5sum: head.md5sum.as_str().into(),
            definition,
            caller_id: head.caller_id.as_str().into(),
            latching: head.tags.contains_key(importer::LATCHING),
            encoding,
            about: importer::about(&head.tags),
        });
        let time = opened.header.captured_at;
        let sent = importer::sent(&head.tags, time);
        block_in_place(|| self.writer.write(&channel, time, sent, &opened.body))?;
        self.tally.count(&channel, time);
        *if is_message { &mut self.view.messages } else { &mut self.view.attachments } += 1;
        self.view.bytes += opened.body.len() as u64;
        *self.topics.entry((head.topic.clone(), head.type_name.clone())).or_default() += 1;
        Ok(())
    }

    fn channel(&mut self, channel: Channel) -> Arc<Channel> {
        let shared = Arc::new(channel.clone());
        Arc::clone(self.channels.entry(channel).or_insert(shared))
    }

    /// Counts a record that does not open; a failure that is not the record's ends the export.
    fn refuse(&mut self, row: &RecordRow, error: PipelineError) -> Result<()> {
        match (&error, error.kind()) {
            (PipelineError::Missing(_), _) => self.view.refused.missing += 1,
            (PipelineError::Crypto(CryptoError::FalseName(_)), _) => self.view.refused.false_names += 1,
            (_, ErrorKind::Tampered) => self.view.refused.tampered += 1,
            (_, ErrorKind::Refused) => {
                self.view.refused.no_key += 1;
                return Ok(());
            }
            _ => return Err(error.into()),
        }
        if self.view.suspicious.len() < MOST_NAMED {
            self.view.suspicious.push(row.id.clone());
        }
        Ok(())
    }

    fn finish(mut self, draft: Draft) -> Result<ExportView> {
        let topic = |((topic, type_name), messages): ((String, String), u64)| ExportedTopic {
            topic: clean(&topic, 255),
            type_name: clean(&type_name, 255),
            messages,
        };
        self.view.given = std::mem::take(&mut self.given).into_iter().collect();
        self.view.topics = std::mem::take(&mut self.topics).into_iter().map(topic).collect();
        if self.view.messages + self.view.attachments == 0 {
            return Ok(self.view);
        }
        self.writer.finish()?;
        match self.wishes.format {
            RecordingFormat::Bag | RecordingFormat::Mcap => draft.place()?,
            RecordingFormat::Rosbag2 => draft.place_in_folder(METADATA, |file| self.tally.describe(file))?,
        }
        self.view.file = Some(clean(&self.wishes.path.display().to_string(), 300));
        Ok(self.view)
    }
}

/// Whether the content fits the kind: an attachment as MCAP has it, or a message.
fn is_as_its_kind(encoding: Encoding, opened: &OpenedRecord) -> bool {
    let is_sound = match encoding {
        Encoding::Beside(kind) => kind.parse(&opened.body).is_some(),
        Encoding::Ros1 | Encoding::Cdr { .. } => true,
    };
    is_sound && importer::kind_of(encoding) == opened.header.kind
}

/// A file being written; removed unless it is moved to its destination.
pub(super) struct Draft {
    target: PathBuf,
    file: NamedTempFile,
}

impl Draft {
    /// A new file (0600) beside `target`, which must not exist; removes leftovers of a killed export.
    pub fn begin(target: &Path) -> Result<(Self, File)> {
        let taken = || input(format!("{} already exists; choose a new file", target.display()));
        if target.symlink_metadata().is_ok() {
            return Err(taken());
        }
        if target.file_name().is_none() {
            return Err(input(format!("{} is not a file", target.display())));
        }
        let folder = target.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let failed = |error: std::io::Error| input(format!("{} cannot be written: {error}", target.display()));
        unfinished::sweep(folder).map_err(failed)?;
        let file = unfinished::new_file(folder).map_err(failed)?;
        let open = file.as_file().try_clone().map_err(failed)?;
        Ok((Self { target: target.to_owned(), file }, open))
    }

    /// Moves the file to its destination, without replacing anything.
    pub fn place(self) -> Result<()> {
        let failed = |error: std::io::Error| input(format!("{} cannot be written: {error}", self.target.display()));
        match std::fs::hard_link(self.file.path(), &self.target) {
            Ok(()) => Ok(()),
            // Not every file system has links.
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                std::fs::rename(self.file.path(), &self.target).map_err(failed)
            }
            Err(error) => Err(failed(error)),
        }
    }

    /// Moves the file and a description, made from its name there, into a new folder that appears whole.
    pub fn place_in_folder(self, description: &str, describe: impl FnOnce(&str) -> String) -> Result<()> {
        let failed = |error: std::io::Error| input(format!("{} cannot be written: {error}", self.target.display()));
        let parent = self.target.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = unfinished::UnfinishedFolder::new(parent).map_err(failed)?;
        let name = format!("{}_0.mcap", self.target.file_name().unwrap_or_default().to_string_lossy());
        std::fs::rename(self.file.path(), folder.path().join(&name)).map_err(failed)?;
        private_file::create_private(&folder.path().join(description), describe(&name).as_bytes())?;
        if self.target.symlink_metadata().is_ok() {
            return Err(input(format!("{} already exists; choose a new folder", self.target.display())));
        }
        std::fs::rename(folder.path(), &self.target).map_err(failed)
    }
}
