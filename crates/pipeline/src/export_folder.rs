//! A folder of `records export`, read within limits and checked without a chain, for a recipient who trusts nobody.

use std::{fs::File, io::Read as _, path::Path};

use serde::{Deserialize, Serialize};

use crate::chain::merkle::{Inclusion, LONGEST_PATH, Leaf};
use crate::crypto::{Provider, keyfile, record, signature_from_der, signer_id};
use crate::model::header::{LARGEST_BODY, LARGEST_HEAD};
use crate::model::{
    Address, Digest, Domain, Hash, Header, PublicKey, RecorderId, Signature, SignerId, Timestamp, TopicId, clean,
};

/// The `format` of `proof.json`.
const FORMAT: &str = "authros-proof/1";
/// The longest of the small files, bytes.
const LONGEST_SMALL: u64 = 64 * 1024;
/// A generous limit for a record's header, bytes.
const LONGEST_HEADER: u64 = 1024;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {why}; ask the person who gave you the folder for a new `authros records export`")]
pub struct FolderError {
    pub file: String,
    /// What is wrong with it, cleaned.
    pub why: String,
}

impl FolderError {
    fn new(file: &str, why: &str) -> Self {
        Self { file: clean(file, 200), why: clean(why, 200) }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnchorWord {
    Each,
    Batch,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClaimedAnchor {
    pub mode: AnchorWord,
    pub leaf: Option<Hash>,
    pub index: Option<u64>,
    /// Leaves of the batch.
    pub count: Option<u64>,
    /// Hashes from the leaf up.
    pub path: Option<Vec<Hash>>,
    pub root: Option<Hash>,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    pub block_hash: Option<Hash>,
    /// That block's time, if the exporter's chain gave it.
    pub block_time: Option<Timestamp>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClaimedProof {
    pub format: String,
    /// SM3 of the record.
    pub digest: Digest,
    /// SM3 of the signer's key.
    pub signer: SignerId,
    pub epoch: u64,
    pub recorder: RecorderId,
    pub topic_id: TopicId,
    pub seq: u64,
    pub domain: Domain,
    pub chain_id: u64,
    pub genesis: Hash,
    pub contract: Option<Address>,
    pub anchor: ClaimedAnchor,
}

impl ClaimedProof {
    pub fn parse(text: &[u8]) -> Result<Self, FolderError> {
        let wrong = |why: &str| FolderError::new("proof.json", why);
        // Before the form, which a later version may have changed.
        if let Some(format) = authros_evidence::named_format(text).filter(|format| format != FORMAT) {
            let found = clean(&format, 40);
            return Err(wrong(&format!(
                "its format is '{found}', but this program reads {FORMAT}; use a newer authros"
            )));
        }
        let proof: Self = serde_json::from_slice(text).map_err(|error| wrong(&error.to_string()))?;
        if proof.anchor.path.as_ref().is_some_and(|path| path.len() > LONGEST_PATH) {
            return Err(wrong("its path is longer than in any batch"));
        }
        Ok(proof)
    }

    /// `None` unless the record is in a batch and the claim is complete.
    pub fn inclusion(&self) -> Option<Inclusion> {
        let anchor = &self.anchor;
        Some(Inclusion { index: anchor.index?, count: anchor.count?, path: anchor.path.clone()?, root: anchor.root? })
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct VerifyStep {
    pub name: String,
    /// The result; `None` = it could not be checked.
    pub ok: Option<bool>,
    pub text: String,
}

impl VerifyStep {
    pub fn new(name: &str, ok: bool, text: &str) -> Self {
        Self { name: name.to_owned(), ok: Some(ok), text: clean(text, 400) }
    }

    pub fn open(name: &str, text: &str) -> Self {
        Self { name: name.to_owned(), ok: None, text: clean(text, 400) }
    }
}

#[derive(Debug, Clone)]
pub struct ExportFolder {
    pub record: Vec<u8>,
    pub header: Header,
    /// The signed bytes, as found in the folder.
    pub message: Vec<u8>,
    pub signature: Signature,
    pub signer: PublicKey,
    pub proof: ClaimedProof,
}

impl ExportFolder {
    /// Reads a folder; links and anything but plain files are refused.
    pub fn read(folder: &Path) -> Result<Self, FolderError> {
        let record = read(folder, "record.bin", LARGEST_BODY + u64::from(LARGEST_HEAD) + LONGEST_HEADER)?;
        let small = |name: &str| read(folder, name, LONGEST_SMALL);
        let (message, signature) = (small("message.bin")?, small("signature.bin")?);
        Self::parse(record, message, &signature, &small("signer.pem")?, &small("proof.json")?)
    }

    pub fn parse(
        record: Vec<u8>,
        message: Vec<u8>,
        signature: &[u8],
        signer: &[u8],
        proof: &[u8],
    ) -> Result<Self, FolderError> {
        let (header, length) = Header::parse(&record)
            .map_err(|error| FolderError::new("record.bin", &format!("is not a record: {error}")))?;
        let sealed = u64::from(header.head_length).saturating_add(header.body_length);
        if u64::try_from(record.len() - length.min(record.len())).ok() != Some(sealed) {
            return Err(FolderError::new("record.bin", "does not have the length its header gives"));
        }
        let signature =
            signature_from_der(signature).map_err(|error| FolderError::new("signature.bin", &error.to_string()))?;
        let signer = std::str::from_utf8(signer).ok().and_then(|text| keyfile::sm2_public_from_pem(text).ok());
        let signer = signer.ok_or_else(|| FolderError::new("signer.pem", "contains no SM2 public key"))?;
        Ok(Self { record, header, message, signature, signer, proof: ClaimedProof::parse(proof)? })
    }

    pub fn digest(&self, provider: &dyn Provider) -> Digest {
        Digest(provider.sm3(&[&self.record]))
    }

    pub fn check(&self, provider: &dyn Provider) -> Vec<VerifyStep> {
        let digest = self.digest(provider);
        let mut steps = vec![
            VerifyStep::new("digest", digest == self.proof.digest, &format!("SM3 of record.bin is {digest}")),
            self.compare_header(),
        ];
        let signed = record::signed_bytes(&self.header.domain, &digest);
        let text = "message.bin consists of label, network and this digest";
        steps.push(VerifyStep::new("message", self.message == signed, text));
        let named = signer_id(&self.signer) == self.header.signer;
        let valid = provider.verify(&self.signer, &signed, &self.signature).is_ok();
        let text = format!("SM2 by the key in signer.pem, which is {}", self.header.signer);
        steps.push(VerifyStep::new("signature", named && valid, &text));
        steps.extend(self.check_path(digest));
        steps
    }

    fn compare_header(&self) -> VerifyStep {
        let (header, proof) = (&self.header, &self.proof);
        let fields = [
            ("signer", header.signer == proof.signer),
            ("epoch", header.epoch == proof.epoch),
            ("recorder", header.recorder == proof.recorder),
            ("topic", header.topic_id == proof.topic_id),
            ("number", header.seq == proof.seq),
            ("network", header.domain == proof.domain),
        ];
        let different = fields.iter().find(|(_, same)| !same);
        let text = match different {
            Some((field, _)) => format!("record.bin and proof.json differ in their {field}"),
            None => format!("of {}, number {}, captured {}", header.owner, header.seq, header.captured_at),
        };
        VerifyStep::new("header", different.is_none(), &text)
    }

    fn check_path(&self, digest: Digest) -> Option<VerifyStep> {
        if self.proof.anchor.mode == AnchorWord::Each {
            return None;
        }
        let Some(inclusion) = self.proof.inclusion() else {
            let text = "proof.json names a batch, but not the whole path to its root";
            return Some(VerifyStep::new("proof", false, text));
        };
        let leaf = Leaf::of(&self.header, digest);
        let named = self.proof.anchor.leaf.is_none_or(|claimed| claimed == leaf.hash());
        let text =
            format!("leaf {} of {}, root {}", inclusion.index.saturating_add(1), inclusion.count, inclusion.root);
        Some(VerifyStep::new("proof", named && inclusion.proves(&leaf), &text))
    }
}

fn read(folder: &Path, name: &str, most: u64) -> Result<Vec<u8>, FolderError> {
    let path = folder.join(name);
    let failed = |error: std::io::Error| FolderError::new(name, &format!("cannot be read: {error}"));
    // Checked before it is opened, because opening a pipe would wait for its writer.
    if !path.symlink_metadata().map_err(failed)?.is_file() {
        return Err(FolderError::new(name, "is not a regular file"));
    }
    let file = File::open(&path).map_err(failed)?;
    if file.metadata().map_err(failed)?.len() > most {
        return Err(FolderError::new(name, &format!("is longer than {most} bytes")));
    }
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_long_files_and_wrong_json_are_told_by_their_names() {
        let folder = tempfile::tempdir().expect("directory");
        let read = |name: &str| read(folder.path(), name, 10).expect_err("refused").to_string();
        assert!(read("record.bin").contains("record.bin"));
        std::os::unix::fs::symlink("/etc/hostname", folder.path().join("link")).expect("linked");
        std::fs::create_dir(folder.path().join("folder")).expect("made");
        std::fs::write(folder.path().join("long"), [0; 11]).expect("written");
        assert!(read("link").contains("not a regular file") && read("folder").contains("not a regular file"));
        assert!(read("long").contains("longer"));
        for text in ["", "{}", "[]", "{\"format\":1}", "\u{0}", &"[".repeat(100_000)] {
            assert!(ClaimedProof::parse(text.as_bytes()).is_err());
        }
    }
}
