//! `identity …` and `keys …`: the words of their verbs.

use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};

/// `identity …`
#[derive(Debug, Subcommand)]
pub enum IdentityVerb {
    /// Make keys: EOA, SM2, SM4
    Create,
    /// Show the public identity
    Show,
    /// The identities of this home: profile, account, fingerprint of the signing key; asks nobody
    List,
    /// Wipe the keys that decrypt, grant and revoke from the running site's memory; capture goes on
    Lock,
    /// Whether a fingerprint is that of this profile's key, or of an account's
    Compare {
        /// Eight groups of four hex characters, in quotes or without spaces
        fingerprint: String,
        /// Account, or its name [default: this profile]
        #[arg(long, value_name = "ADDRESS_OR_NAME")]
        account: Option<String>,
    },
    /// Name who may stop a succession of this profile's account, should the administrator propose one wrongly
    Recovery {
        /// Account, or its name, or `none`; it takes effect after the contract's delay
        #[arg(value_name = "ADDRESS_OR_NAME")]
        account: String,
    },
}

/// Which key to export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportKind {
    /// The SM4 key, hex
    Sm4,
    /// The SM2 signing key, PKCS#8 PEM
    Sm2,
    /// The EOA, Ethereum V3 keystore
    Eoa,
}

/// `keys …`
#[derive(Debug, Subcommand)]
pub enum KeysVerb {
    /// Fingerprints and epochs
    List,
    /// Load a key from a 0600 file
    #[command(group(clap::ArgGroup::new("key").required(true)))]
    Load {
        /// SM4 key: 16 bytes, or 32 hex
        #[arg(long, value_name = "FILE", group = "key")]
        sm4: Option<PathBuf>,
        /// SM2 signing key: PKCS#8 PEM, or 64 hex
        #[arg(long, value_name = "FILE", group = "key")]
        sm2: Option<PathBuf>,
        /// EOA: 64 hex, or V3 keystore
        #[arg(long, value_name = "FILE", group = "key")]
        eoa: Option<PathBuf>,
        /// File with the V3 keystore's passphrase
        #[arg(long, value_name = "FILE")]
        keystore_passphrase_file: Option<PathBuf>,
        /// Only say whom a new SM2 key touches; change nothing
        #[arg(long, requires = "sm2")]
        dry_run: bool,
    },
    /// Begin a new epoch: readers keep what they have, new records need a new key
    Rotate {
        /// A new SM2 envelope key instead: what others share with you is sealed to it from then on
        #[arg(long)]
        envelope: bool,
        /// Only say whom a new envelope key touches; change nothing
        #[arg(long, requires = "envelope")]
        dry_run: bool,
    },
    /// Change the keyring's passphrase; the present one comes from --passphrase-file, --passphrase-fd or the terminal
    Passphrase {
        /// File with the new passphrase (first line) [default: asked at the terminal]
        #[arg(long, value_name = "FILE", conflicts_with = "new_passphrase_fd")]
        new_passphrase_file: Option<PathBuf>,
        /// Descriptor to read the new passphrase from
        #[arg(long, value_name = "NUMBER")]
        new_passphrase_fd: Option<u32>,
    },
    /// Save the keyring, under its passphrase, to a new 0600 file
    Backup {
        /// File to write; must not exist
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Write one key to a new 0600 file
    Export {
        /// Which key
        #[arg(value_enum)]
        kind: ExportKind,
        /// File to write; must not exist
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// File with the passphrase for the V3 keystore (EOA)
        #[arg(long, value_name = "FILE")]
        keystore_passphrase_file: Option<PathBuf>,
    },
}
