//! `authros keys`.

#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};

use super::connect::{Context, ProfileNeed};
use super::plan::{CHAIN, NEITHER, Plan};
use super::{parse, parse::usage, passphrase, show::Question};
use crate::crypto::keyfile::is_keystore_file;
use crate::service::{Failure, KeyKind, SecretText, command, reply};
use authros_output::{pairs, table};

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
        /// File with the V3 keystore's passphrase [default: asked at the terminal]
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
    /// Change the keyring's passphrase; the current one is given as for every command, or asked at the terminal
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
        #[arg(long, value_name = "FILE", value_parser = parse::new_file())]
        out: PathBuf,
    },
    /// Bring a saved keyring into a profile that has none
    Restore {
        /// What `keys backup` wrote; it opens with the passphrase that the keyring had then
        file: PathBuf,
    },
    /// Wipe the keys for reading, granting and revoking from the running site's memory; capture continues
    Lock,
    /// Write one key to a new 0600 file
    Export {
        /// Which key
        #[arg(value_enum)]
        kind: ExportKind,
        /// File to write; must not exist
        #[arg(long, value_name = "FILE", value_parser = parse::new_file())]
        out: PathBuf,
        /// File with the passphrase for the V3 keystore (EOA) [default: asked at the terminal]
        #[arg(long, value_name = "FILE")]
        keystore_passphrase_file: Option<PathBuf>,
    },
}

pub fn plan(context: &Context, verb: KeysVerb) -> Result<Plan, Failure> {
    let secret = |file: Option<PathBuf>| file.as_deref().map(passphrase::from_file).transpose();
    Ok(match verb {
        KeysVerb::List => Plan::unlocked(command::ListKeys),
        KeysVerb::Rotate { envelope: false, .. } => Plan::unlocked(command::RotateKeys),
        KeysVerb::Rotate { dry_run, .. } => {
            changes(ProfileNeed::Unlocked, command::PairKind::Envelope, dry_run, command::RotateEnvelope)
        }
        KeysVerb::Passphrase { new_passphrase_file, new_passphrase_fd } => {
            return passphrase::change(context, new_passphrase_file.as_deref(), new_passphrase_fd);
        }
        KeysVerb::Lock => Plan::kept(command::Lock),
        KeysVerb::Backup { out } => Plan { out: Some(out), ..Plan::kept(command::BackUpKeys) },
        KeysVerb::Restore { file } => {
            let given = passphrase::given(&context.global, &context.home, &context.profile)?;
            let typed = || passphrase::terminal::once("Passphrase of the saved keyring");
            let secret = given.map_or_else(typed, |given| Ok(Some(given)))?;
            let secret = secret.ok_or_else(|| {
                usage(format!("the saved keyring opens with its passphrase alone; pass {}", passphrase::SOURCES))
            })?;
            Plan::kept(command::RestoreKeys { path: parse::absolute(&file)?, passphrase: secret })
        }
        KeysVerb::Load { sm4, sm2, eoa, keystore_passphrase_file, dry_run } => {
            let choices = [(KeyKind::Sm4, sm4), (KeyKind::Sm2, sm2), (KeyKind::Eoa, eoa)];
            let chosen = choices.into_iter().find_map(|(kind, path)| path.map(|path| (kind, path)));
            let (kind, path) = chosen.ok_or_else(|| usage("give the key with --sm4, --sm2 or --eoa"))?;
            if dry_run {
                // The report is about this key, so it must be one.
                crate::crypto::keyfile::load_sm2(&path)?;
            }
            let mut passphrase = secret(keystore_passphrase_file)?;
            if kind == KeyKind::Eoa && passphrase.is_none() && is_keystore_file(&path)? {
                passphrase = passphrase::terminal::once("Passphrase of the keystore")?;
            }
            let ask = command::LoadKey { kind, path: parse::absolute(&path)?, passphrase };
            match kind {
                KeyKind::Sm2 => changes(ProfileNeed::Made, command::PairKind::Signing, dry_run, ask),
                KeyKind::Sm4 | KeyKind::Eoa => Plan::new(CHAIN, ProfileNeed::Made, ask),
            }
        }
        KeysVerb::Export { kind, out, keystore_passphrase_file } => {
            let kind = match kind {
                ExportKind::Sm4 => KeyKind::Sm4,
                ExportKind::Sm2 => KeyKind::Sm2,
                ExportKind::Eoa => KeyKind::Eoa,
            };
            let mut passphrase: Option<SecretText> = secret(keystore_passphrase_file)?;
            if kind == KeyKind::Eoa && passphrase.is_none() {
                passphrase = passphrase::terminal::new_one("New passphrase of the keystore")?;
            }
            Plan {
                out: Some(out),
                ..Plan::new(NEITHER, ProfileNeed::Unlocked, command::ExportKey { kind, passphrase })
            }
        }
    })
}

pub fn list(view: &reply::KeysView) -> String {
    let head = pairs(&[
        ("EOA", view.address.to_string()),
        ("SM2 signing", view.signing_fingerprint.clone()),
        ("SM2 envelope", view.envelope_fingerprint.clone()),
    ]);
    let rows = view.epochs.iter().map(|epoch| {
        let state = if epoch.current { "current" } else { "past" };
        [epoch.epoch.to_string(), state.to_owned(), epoch.token.to_string()]
    });
    format!("{head}\n\n{}", table(&["epoch", "state", "token"], rows))
}

/// Reports those affected first, or only them.
fn changes(profile: ProfileNeed, kind: command::PairKind, dry_run: bool, question: impl Into<Question>) -> Plan {
    let touched = command::ForeseeKeyChange { kind };
    if dry_run {
        return Plan::new(CHAIN, profile, touched);
    }
    Plan { first: Some(touched), ..Plan::new(CHAIN, profile, question) }
}
