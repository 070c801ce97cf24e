//! The pieces of work that are timed, each on data prepared before the clock starts.

use std::hint::black_box;

use super::Algorithm;
use super::batch::Batch;
use super::reference::{seal_by_crates, seal_by_libsm};
use crate::account::head;
use authros_crypto::{
    Provider, ProviderName, SealRequest, SmKeyPair, TopicKey, provider, random_bytes, seal, sm3_many,
    verify_as_stranger,
};
use authros_model::{Address, Domain, Head, RecordKind, RecorderPrefix, Signature, Timestamp, TopicId};
use authros_service::Failure;

/// Bytes of additional data, like a short header.
const AAD: [u8; 32] = [0; 32];
const NONCE: [u8; 12] = [0; 12];
/// Messages hashed side by side.
const MANY: u32 = 16;
/// A message hashed side by side with others has at most this many bytes.
const SHORT: usize = 8192;

/// Verifies a known signer.
pub(super) const KNOWN: &str = "authros-known";

pub(super) type Done = Result<Vec<u8>, Failure>;

/// Something to time.
pub(super) struct Piece<'a> {
    pub work: &'static str,
    pub by: &'static str,
    /// How many messages it takes at once.
    pub messages: u32,
    /// Prepares what is changed in place.
    pub prepare: Box<dyn Fn() -> Vec<u8> + 'a>,
    /// The work; its result is dropped after the clock was stopped.
    pub run: Box<dyn Fn(Vec<u8>) -> Done + 'a>,
}

/// Keys and a text of one size.
pub(super) struct Subject {
    ours: &'static dyn Provider,
    crates: &'static dyn Provider,
    libsm: &'static dyn Provider,
    key: [u8; 16],
    text: Vec<u8>,
    sealed: Vec<u8>,
    signer: SmKeyPair,
    signature: Signature,
    envelope: Vec<u8>,
    head: Head,
    batches: Vec<Batch>,
}

impl Subject {
    pub fn new(ours: &'static dyn Provider, size: usize) -> Result<Self, Failure> {
        let (key, text) = (random_bytes()?, vec![0x5a; size]);
        let mut sealed = text.clone();
        ours.gcm_seal(&key, &NONCE, &AAD, &mut sealed)?;
        let signer = SmKeyPair::generate(ours)?;
        let signature = ours.sign(&signer.secret, &text)?;
        let envelope = ours.encrypt(&signer.public, text.get(..32).unwrap_or(&text))?;
        let [crates, libsm] = [ProviderName::RustCrypto, ProviderName::Libsm].map(provider);
        // libsm's table takes seconds to build, once; ours for a signer is built at the third signature.
        for provider in [crates, libsm, ours, ours, ours] {
            provider.verify(&signer.public, &text, &signature)?;
        }
        let (head, batches) = (head(size), Batch::all(ours, &signer)?);
        Ok(Self { ours, crates, libsm, key, text, sealed, signer, signature, envelope, head, batches })
    }

    /// Everything timed for an algorithm at this size.
    pub fn pieces(&self, algorithm: Algorithm) -> Vec<Piece<'_>> {
        let both = [("authros", self.ours), ("libsm", self.libsm)];
        match algorithm {
            Algorithm::Sm2 => {
                let all = [("authros", self.ours), ("crate", self.crates), ("libsm", self.libsm)];
                let mut pieces: Vec<_> = all.into_iter().flat_map(|(by, provider)| self.sm2(by, provider)).collect();
                pieces.extend(self.known_signer());
                pieces.extend(self.batches.iter().flat_map(|batch| batch.pieces(self.ours, &self.signer)));
                pieces
            }
            Algorithm::Sm3 => self.sm3(both),
            // Ours first: memory that others allocate and free would make our buffers be mapped again while we are
            // timed.
            Algorithm::Sm4 => {
                let mut pieces = Vec::from(self.sm4("authros", self.ours));
                pieces.extend([self.record(), self.digest("authros", self.ours)]);
                pieces.extend(self.sm4("libsm", self.libsm));
                pieces.extend([self.by_crates(), self.by_libsm()]);
                pieces
            }
        }
    }

    fn digest<'a>(&'a self, by: &'static str, provider: &'static dyn Provider) -> Piece<'a> {
        piece("digest", by, move || Ok(provider.sm3(&[black_box(&self.text)]).to_vec()))
    }

    fn sm3<'a>(&'a self, both: [(&'static str, &'static dyn Provider); 2]) -> Vec<Piece<'a>> {
        let mut pieces: Vec<_> = both.into_iter().map(|(by, provider)| self.digest(by, provider)).collect();
        if self.text.len() <= SHORT {
            let many = || Ok(sm3_many(&[black_box(&self.text[..]); MANY as usize]).concat());
            pieces.push(Piece { messages: MANY, ..piece("digest", "authros-many", many) });
        }
        pieces
    }

    fn sm4<'a>(&'a self, by: &'static str, provider: &'static dyn Provider) -> [Piece<'a>; 2] {
        let seal = move |mut text: Vec<u8>| {
            let tag = provider.gcm_seal_in_place(&self.key, &NONCE, &AAD, &mut text)?;
            black_box(tag);
            Ok(text)
        };
        let open = move || {
            let mut plain = provider.gcm_open(&self.key, &NONCE, &AAD, &self.sealed)?;
            Ok(std::mem::take(&mut *plain))
        };
        let prepare = Box::new(|| self.text.clone());
        [Piece { work: "seal", by, messages: 1, prepare, run: Box::new(seal) }, piece("open", by, open)]
    }

    fn by_crates(&self) -> Piece<'_> {
        let run = |mut text: Vec<u8>| {
            seal_by_crates(&self.key, &NONCE, &AAD, &mut text)?;
            Ok(text)
        };
        let prepare = Box::new(|| {
            let mut text = Vec::with_capacity(self.sealed.len());
            text.extend_from_slice(&self.text);
            text
        });
        Piece { work: "seal", by: "crates", messages: 1, prepare, run: Box::new(run) }
    }

    /// libsm unmodified, with its own GCM.
    fn by_libsm(&self) -> Piece<'_> {
        piece("seal", "libsm-gcm", || seal_by_libsm(&self.key, &[0; 16], &AAD, &self.text))
    }

    /// A whole record: keys derived, head and body sealed, digest and signature.
    fn record(&self) -> Piece<'_> {
        piece("record", "authros", || {
            let request = SealRequest {
                domain: Domain([1; 32]),
                owner: Address([2; 20]),
                signer: &self.signer,
                epoch: 1,
                topic_key: &TopicKey::new([3; 32]),
                recorder: RecorderPrefix::ledger([4; 7]),
                seq: 1,
                topic_id: TopicId([5; 16]),
                kind: RecordKind::Data,
                filters: Vec::new(),
                captured_at: Timestamp(1),
                head: &self.head,
                body: &self.text,
            };
            Ok(seal(self.ours, &request)?.blob)
        })
    }

    fn sm2<'a>(&'a self, by: &'static str, provider: &'static dyn Provider) -> [Piece<'a>; 4] {
        let (secret, public) = (&self.signer.secret, &self.signer.public);
        [
            piece("sign", by, move || Ok(provider.sign(secret, &self.text)?.0.to_vec())),
            piece("verify", by, move || {
                if self.knows_signers(provider) {
                    verify_as_stranger(public, &self.text, &self.signature)?;
                } else {
                    provider.verify(public, &self.text, &self.signature)?;
                }
                Ok(Vec::new())
            }),
            piece("encrypt", by, move || Ok(provider.encrypt(public, &self.text)?)),
            piece("decrypt", by, move || Ok(provider.decrypt(secret, &self.envelope)?.to_vec())),
        ]
    }

    /// Whether a provider keeps tables for known signers.
    fn knows_signers(&self, provider: &dyn Provider) -> bool {
        provider.name() == ProviderName::Authros.to_string()
    }

    /// Verifying a known signer's signature.
    fn known_signer(&self) -> Option<Piece<'_>> {
        let verify = || {
            self.ours.verify(&self.signer.public, &self.text, &self.signature)?;
            Ok(Vec::new())
        };
        self.knows_signers(self.ours).then(|| piece("verify", KNOWN, verify))
    }
}

/// Work that changes nothing in place.
pub(super) fn piece<'a>(work: &'static str, by: &'static str, run: impl Fn() -> Done + 'a) -> Piece<'a> {
    Piece { work, by, messages: 1, prepare: Box::new(Vec::new), run: Box::new(move |_| run()) }
}
