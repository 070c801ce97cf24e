//! `verify --recording`: a recorded file beside the bundle that states its digests.

use std::{fs::File, path::Path};

use serde::Serialize;

use crate::model::{Digest, ErrorKind, clean};
use crate::ros::recording::{BESIDE, Beside};
use crate::service::Failure;
use authros_evidence::recorded::{RecordedFile, TAG};
use authros_evidence::{Report, Standing};

const MOST_NAMED: usize = 100;

#[derive(Debug, Serialize)]
pub struct Recording {
    /// `refused` if the file differs, `absent` if the bundle states nothing of a file.
    pub standing: Standing,
    pub record: Option<Digest>,
    pub name: Option<String>,
    pub bytes: u64,
    pub chunks: u64,
    /// Offsets of the chunks that differ; the first 100.
    pub differing: Vec<u64>,
    pub text: String,
}

impl Recording {
    pub fn compare(report: &Report, path: &Path) -> Result<Self, Failure> {
        let failed = |error: std::io::Error| Failure::new(ErrorKind::Input, format!("{}: {error}", path.display()));
        let mut worst = None;
        for (digest, stated) in statements(report) {
            let compared = stated.compare(File::open(path).map_err(failed)?).map_err(failed)?;
            let one = Self::of(digest, &stated, compared);
            if one.standing == Standing::Proven {
                return Ok(one);
            }
            worst = worst.or(Some(one));
        }
        let bytes = std::fs::metadata(path).map_err(failed)?.len();
        let text = "the bundle states nothing of a recorded file that could be compared".to_owned();
        let (standing, differing) = (Standing::Absent, Vec::new());
        let none = Self { standing, record: None, name: None, bytes, chunks: 0, differing, text };
        Ok(worst.unwrap_or(none))
    }

    fn of(record: Digest, stated: &RecordedFile, compared: authros_evidence::recorded::Compared) -> Self {
        let (name, chunks, differing) = (clean(&stated.name, 300), compared.chunks, compared.differing.len());
        let text = match (compared.is_whole, compared.differing.first()) {
            (true, _) => format!("the recording is '{name}' as record {record} states it: all {} bytes", stated.length),
            (false, Some(first)) => format!(
                "the recording DIFFERS from '{name}' as record {record} states it: {differing} of {chunks} chunks, the \
                 first at byte {first}; the proof holds for the file as it was, of which there may be a copy"
            ),
            (false, None) => format!(
                "the recording DIFFERS from '{name}' as record {record} states it, though its {chunks} chunks do not: it \
                 has {} bytes, and had {}; the proof holds for the file as it was, of which there may be a copy",
                compared.length, stated.length
            ),
        };
        Self {
            standing: if compared.is_whole { Standing::Proven } else { Standing::Refused },
            record: Some(record),
            name: Some(name),
            bytes: compared.length,
            chunks,
            differing: compared.differing.into_iter().take(MOST_NAMED).collect(),
            text,
        }
    }
}

/// Statements about files in records that are opened and signed.
fn statements(report: &Report) -> impl Iterator<Item = (Digest, RecordedFile)> {
    let opened = report.records.iter().filter(|record| {
        let is_open = matches!(record.opened.standing, Standing::Proven | Standing::OwnChain | Standing::Unproven);
        let is_statement = record.disclosed.as_ref().is_some_and(|told| {
            let is_tagged = told.tags.get(TAG.0).is_some_and(|value| value == TAG.1);
            is_tagged && told.topic == BESIDE && told.type_name == Beside::Metadata.type_name()
        });
        is_open && is_statement && record.bytes.standing == Standing::Proven
    });
    opened.filter_map(|record| {
        let revealed = report.messages.get(&record.digest)?;
        RecordedFile::parse(&revealed.body).map(|stated| (record.digest, stated))
    })
}
