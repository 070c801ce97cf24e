//! The steps of sealing and opening a record, for measuring them.

/// The step just done. A step may be reported more than once for a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Head and header to bytes, or back, with all checks of their fields.
    Fields,
    /// The record's keys derived from the topic key, and a fresh salt drawn.
    Keys,
    /// SM4-GCM of head and body.
    Cipher,
    /// SM3 of the stored bytes.
    Digest,
    /// SM2: signing or verifying.
    Signature,
    /// The message decompressed.
    Restore,
}

impl Step {
    /// All steps.
    pub const ALL: [Self; 6] = [Self::Fields, Self::Keys, Self::Cipher, Self::Digest, Self::Signature, Self::Restore];

    /// Its name where figures are shown.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fields => "fields",
            Self::Keys => "keys",
            Self::Cipher => "SM4-GCM",
            Self::Digest => "SM3",
            Self::Signature => "SM2",
            Self::Restore => "restore",
        }
    }
}
