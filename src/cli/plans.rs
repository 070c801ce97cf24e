//! Verbs of keys, grants and the audit log, as requests to the site.

use std::path::PathBuf;

use super::args::{EpochsChoice, ExportKind, GrantArguments, KeysVerb};
use super::audit::{AuditArguments, AuditVerb};
use super::connect::{Context, ProfileNeed};
use super::verbs::{CHAIN, NEITHER, Plan};
use super::{parse, passphrase, show::Question};
use crate::model::ErrorKind;
use crate::service::{Epochs, Failure, KeyKind, SecretText, command};

pub fn audit(context: &Context, arguments: &AuditArguments) -> Result<Plan, Failure> {
    let Some(verb) = &arguments.verb else {
        let since = arguments.since.as_deref().map(parse::past).transpose()?;
        let ask = command::AuditRecords { deep: arguments.deep, since };
        // Asks the chain only of a home that is bound to one.
        let needs = Needs { ros: false, chain: is_bound(&context.home) };
        return Ok(Plan::new(needs, ProfileNeed::None, ask));
    };
    if arguments.deep || arguments.since.is_some() {
        return Err(Failure::new(ErrorKind::Usage, "--deep and --since apply to the audit of records; omit them here"));
    }
    Ok(match verb {
        AuditVerb::List { since, action, by, by_operator, before, limit } => {
            let query = super::audit::query(since.as_deref(), *limit)?;
            let (action, profile, operator, before) = (action.clone(), by.clone(), by_operator.clone(), *before);
            let query = command::AuditQuery { action, profile, operator, before, ..query };
            Plan::new(NEITHER, ProfileNeed::None, command::ListAudit(query))
        }
        AuditVerb::Verify { without_heads: true } => {
            Plan::new(NEITHER, ProfileNeed::None, command::VerifyAudit { heads: false })
        }
        AuditVerb::Verify { .. } => Plan::new(CHAIN, ProfileNeed::Unlocked, command::VerifyAudit { heads: true }),
        AuditVerb::Export { dir, addresses } => {
            let ask = command::ExportAudit { addresses: *addresses };
            Plan { out: Some(dir.clone()), ..Plan::new(NEITHER, ProfileNeed::Unlocked, ask) }
        }
    })
}

/// Reports those affected first, or only them.
fn changes(profile: ProfileNeed, kind: command::PairKind, dry_run: bool, question: impl Into<Question>) -> Plan {
    let touched = command::ForeseeKeyChange { kind };
    if dry_run {
        return Plan::new(CHAIN, profile, touched);
    }
    Plan { first: Some(touched), ..Plan::new(CHAIN, profile, question) }
}

pub fn keys(context: &Context, verb: KeysVerb) -> Result<Plan, Failure> {
    let secret = |file: Option<PathBuf>| file.as_deref().map(passphrase::from_file).transpose();
    Ok(match verb {
        KeysVerb::List => Plan::new(CHAIN, ProfileNeed::Unlocked, command::ListKeys),
        KeysVerb::Rotate { envelope: false, .. } => Plan::new(CHAIN, ProfileNeed::Unlocked, command::RotateKeys),
        KeysVerb::Rotate { dry_run, .. } => {
            changes(ProfileNeed::Unlocked, command::PairKind::Envelope, dry_run, command::RotateEnvelope)
        }
        KeysVerb::Passphrase { new_passphrase_file, new_passphrase_fd } => {
            return super::passphrase::change(context, new_passphrase_file.as_deref(), new_passphrase_fd);
        }
        KeysVerb::Backup { out } => {
            Plan { out: Some(out), ..Plan::new(NEITHER, ProfileNeed::None, command::BackUpKeys) }
        }
        KeysVerb::Load { sm4, sm2, eoa, keystore_passphrase_file, dry_run } => {
            let choices = [(KeyKind::Sm4, sm4), (KeyKind::Sm2, sm2), (KeyKind::Eoa, eoa)];
            let chosen = choices.into_iter().find_map(|(kind, path)| path.map(|path| (kind, path)));
            let (kind, path) =
                chosen.ok_or_else(|| Failure::new(ErrorKind::Usage, "give the key with --sm4, --sm2 or --eoa"))?;
            if dry_run {
                // The report is about this key, so it must be one.
                crate::crypto::keyfile::load_sm2(&path)?;
            }
            let ask =
                command::LoadKey { kind, path: parse::absolute(&path)?, passphrase: secret(keystore_passphrase_file)? };
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
            let passphrase: Option<SecretText> = secret(keystore_passphrase_file)?;
            Plan {
                out: Some(out),
                ..Plan::new(NEITHER, ProfileNeed::Unlocked, command::ExportKey { kind, passphrase })
            }
        }
    })
}

pub fn grant(arguments: &GrantArguments) -> Result<command::Grant, Failure> {
    let expires = arguments.expires.as_deref().map(super::parse::end).transpose()?;
    Ok(command::Grant {
        grantee: parse::value(arguments.address.as_deref().or(arguments.to.as_deref()).unwrap_or_default())?,
        topics: parse::values(&arguments.topics)?,
        epochs: match arguments.epochs {
            EpochsChoice::Current => Epochs::Current,
            EpochsChoice::All => Epochs::All,
        },
        expires,
    })
}
