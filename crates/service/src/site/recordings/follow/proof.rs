//! The proof of a recorded file: the opened bundle of the record that states its digests, beside the file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use authros_evidence::Bundle;
use authros_evidence::recorded::TAG;

use super::super::Recordings;
use super::super::import::RECORDING;
use super::super::standings::at;
use super::Follower;
use super::place::FileKey;
use crate::crypto::sm3::sm3;
use crate::model::{Digest, ErrorKind, RecordKind, RecordState, Timestamp, clean};
use crate::pipeline::Owner;
use crate::pipeline::reader::Reader;
use crate::ros::recording::BESIDE;
use crate::service::command::EvidenceWishes;
use crate::service::failure::input;
use crate::service::reply::{Failure, Result};
use crate::site::blocking;
use crate::store::RecordRow;
use crate::store::notes::{FilePlace, FileStanding};

const PROOF: &str = ".authros";

/// Written as soon as the statement's record is verified.
#[derive(Debug, Clone)]
pub(super) struct Due {
    /// In the folder, cleaned.
    pub name: String,
    path: PathBuf,
    key: FileKey,
    place: FilePlace,
    stated_at: Timestamp,
    statement: Digest,
}

#[derive(Debug, Default)]
pub(super) struct Proven {
    pub record: Option<String>,
    pub proof: Option<String>,
    pub notes: Vec<String>,
}

impl Follower<'_> {
    /// Requests the proof of a file, if it is stated.
    pub fn prove(&self, key: &FileKey, place: &FilePlace, path: &Path) {
        let (Some(stated_at), Some(statement)) = (place.stated_at, place.statement) else { return };
        let due = Due {
            name: self.name_of(path),
            path: path.to_owned(),
            key: key.clone(),
            place: place.clone(),
            stated_at,
            statement,
        };
        // Nobody writes proofs once following has ended.
        drop(self.due.send(due));
    }
}

impl Recordings {
    /// Writes the proofs that can be written; the others keep waiting.
    pub(super) async fn prove(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        waiting: &mut Vec<Due>,
        proven: &mut BTreeMap<String, Proven>,
    ) {
        let mut left = Vec::new();
        for due in std::mem::take(waiting) {
            match self.prove_one(owner, &due).await {
                Ok(None) => left.push(due),
                Ok(Some(one)) => {
                    let text = one.proof.as_ref().map(|proof| format!("{}: its proof is {proof}", due.name));
                    text.into_iter().for_each(|text| self.parts.hub.inform(&text));
                    proven.insert(due.name, one);
                }
                Err(failure) => {
                    let text = format!("its proof was not written: {}", failure.message);
                    self.parts.hub.warn(&format!("{}: {text}", due.name));
                    proven.insert(due.name, Proven { notes: vec![text], ..Proven::default() });
                }
            }
        }
        *waiting = left;
    }

    async fn prove_one(self: &Arc<Self>, owner: &Arc<Owner>, due: &Due) -> Result<Option<Proven>> {
        let (network, author, wanted) = (self.reading.network_or_kept().await?, Arc::clone(owner), due.clone());
        let row = blocking(self, move |recordings| {
            let reader = Reader { plant: &recordings.parts.plant, network: &network, reader: &author };
            statement(&reader, &wanted)
        });
        let row = row.await?.ok_or_else(|| input("the record that states its digests is gone"))?;
        match row.state {
            RecordState::Verified => {}
            RecordState::Tampered => {
                let text = format!("record {}, which states its digests, differs from what was anchored", row.id);
                return Err(Failure::new(ErrorKind::Tampered, text));
            }
            _ => return Ok(None),
        }
        let target = beside(&due.path);
        let mut one = Proven { record: Some(row.id.clone()), ..Proven::default() };
        if target.symlink_metadata().is_err() {
            let (file, records, reveal) = (target.clone(), vec![row.id.clone()], vec![row.id.clone()]);
            let wishes = EvidenceWishes { file, records, reveal, sure: true, ..EvidenceWishes::default() };
            one.notes = self.evidence.export(owner, wishes).await?.notes;
        }
        one.proof = Some(clean(&target.display().to_string(), 300));
        let due = due.clone();
        blocking(self, move |recordings| recordings.finish_proof(&due, &target, row.digest)).await?;
        Ok(Some(one))
    }

    /// Checks that the bundle is the file's, and notes that.
    fn finish_proof(&self, due: &Due, target: &Path, record: Digest) -> Result<()> {
        let is_its_own =
            Bundle::read(target, self.parts.plant.provider).is_ok_and(|bundle| bundle.records.contains_key(&record));
        if !is_its_own {
            return Err(input(format!(
                "{} is there and proves something else: another file, this one as it was before, or what another profile \
                 sealed of it; move it away and follow the folder again",
                target.display()
            )));
        }
        let done = FilePlace { standing: FileStanding::Proven, ..due.place.clone() };
        Ok(self.parts.plant.ledger.notes.write(&due.key.note, &done)?)
    }
}

pub(super) fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(PROOF);
    name.into()
}

fn statement(reader: &Reader<'_>, due: &Due) -> Result<Option<RecordRow>> {
    for found in reader.own_opened(at(BESIDE, RecordKind::Attachment, Some(due.stated_at))) {
        let (row, opened) = found?;
        let has = |key: &str, value: &str| opened.head.tags.get(key).is_some_and(|found| found == value);
        let is_it = has(RECORDING, &due.key.tag) && has(TAG.0, TAG.1);
        if is_it && Digest(sm3(&[&opened.body])) == due.statement {
            return Ok(Some(row));
        }
    }
    Ok(None)
}
