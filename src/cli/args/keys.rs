//! `identity …` and `keys …`: the words of their verbs.

use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};

/// `identity …`
#[derive(Debug, Subcommand)]
pub enum IdentityVerb {
    /// Create an identity: EOA, SM2 and SM4 keys
    Create,
    /// Show the public identity
    Show,
    /// List this home's identities: profile, account, fingerprint of the signing key; works offline
    List,
    /// Lock: wipe the keys for reading, granting and revoking from the running site's memory; capture continues
    Lock,
    /// Check a fingerprint against this profile's key, or an account's
    Compare {
        /// Fingerprint: eight groups of four hex digits, quoted or without spaces
        fingerprint: String,
        /// Account, or its name [default: this profile]
        #[arg(long, value_name = "ADDRESS_OR_NAME")]
        account: Option<String>,
    },
    /// Set the recovery account, which can stop a wrongly proposed succession of this account
    Recovery {
        /// Account, its name, or `none`; takes effect after the contract's delay
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
    /// Show fingerprints and epochs
    List,
    /// Load a key from a 0600 file
    #[command(group(clap::ArgGroup::new("key").required(true)))]
    Load {
        /// SM4 key: 16 bytes, or 32 hex digits
        #[arg(long, value_name = "FILE", group = "key")]
        sm4: Option<PathBuf>,
        /// SM2 signing key: PEM (PKCS#8 or SEC1), or 64 hex digits
        #[arg(long, value_name = "FILE", group = "key")]
        sm2: Option<PathBuf>,
        /// EOA: 64 hex digits, or a V3 keystore
        #[arg(long, value_name = "FILE", group = "key")]
        eoa: Option<PathBuf>,
        /// File with the V3 keystore's passphrase
        #[arg(long, value_name = "FILE")]
        keystore_passphrase_file: Option<PathBuf>,
        /// Only report who is affected by a new SM2 key; change nothing
        #[arg(long, requires = "sm2")]
        dry_run: bool,
    },
    /// Start a new epoch: current readers keep access, new records are sealed under a new key
    Rotate {
        /// Replace the SM2 envelope key instead: others' future grants to you are sealed to it
        #[arg(long)]
        envelope: bool,
        /// Only report who is affected by a new envelope key; change nothing
        #[arg(long, requires = "envelope")]
        dry_run: bool,
    },
    /// Change the keyring's passphrase; the current one comes from --passphrase-file, --passphrase-fd or the terminal
    Passphrase {
        /// File with the new passphrase (first line) [default: asked at the terminal]
        #[arg(long, value_name = "FILE", conflicts_with = "new_passphrase_fd")]
        new_passphrase_file: Option<PathBuf>,
        /// File descriptor to read the new passphrase from
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
