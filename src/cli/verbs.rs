//! The plain verbs: one request each, whose answer is printed.

#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;

use super::args::{ConfigVerb, EpochsChoice, ExportKind, GrantArguments, GrantsVerb, IdentityVerb, KeysVerb};
use super::args::{SharedVerb, TopicsVerb, UploadsVerb};
use super::audit::{self, AuditArguments, AuditVerb};
use super::connect::{Context, ProfileNeed};
use super::{
    check, coverage, follow, lists, parse, parse::usage, passphrase, playing, printed, quarantine, reading, recordings,
    robots, show::Question,
};
use crate::model::ErrorKind;
use crate::service::{Client, Command, Epochs, Failure, KeyKind, Needs, SecretText, accounts, command, is_bound};
use authros_output::Output;

pub const CHAIN: Needs = Needs { ros: false, chain: true };
pub const ROS: Needs = Needs { ros: true, chain: false };
pub const NEITHER: Needs = Needs { ros: false, chain: false };

pub struct Plan {
    pub needs: Needs,
    pub profile: ProfileNeed,
    /// Asked first; its answer goes to stderr.
    pub first: Option<command::ForeseeKeyChange>,
    pub question: Question,
    pub out: Option<PathBuf>,
}

impl Plan {
    pub fn new(needs: Needs, profile: ProfileNeed, question: impl Into<Question>) -> Self {
        Self { needs, profile, first: None, question: question.into(), out: None }
    }

    /// With the chain and an open keyring.
    pub fn unlocked(question: impl Into<Question>) -> Self {
        Self::new(CHAIN, ProfileNeed::Unlocked, question)
    }

    /// With the chain, without a keyring.
    pub fn public(question: impl Into<Question>) -> Self {
        Self::new(CHAIN, ProfileNeed::None, question)
    }

    /// With the store alone.
    pub fn kept(question: impl Into<Question>) -> Self {
        Self::new(NEITHER, ProfileNeed::None, question)
    }
}

pub async fn run(context: Context, plan: Plan, output: &Output) -> Result<u8, Failure> {
    let connection = context.connect(plan.needs).await?;
    connection.tell_read_only(output);
    let forgets = matches!(plan.question.command, Command::ChangePassphrase { .. });
    let told = async {
        let is_own = connection.site.is_some();
        let need = if is_own && plan.profile == ProfileNeed::OpenAtSite { ProfileNeed::None } else { plan.profile };
        context.prepare(&connection.client, need, output).await?;
        if let Some(first) = plan.first {
            connection.client.ask(first).await?.lines.iter().for_each(|line| output.note(line));
        }
        let long = matches!(plan.question.command, Command::AuditRecords { .. });
        let answer = plan.question.ask(&connection.client);
        Ok(if long { printed::told(&connection.client, answer, output).await } else { answer.await })
    };
    let told: Result<_, Failure> = told.await;
    connection.close().await;
    let told = told?;
    if forgets && told.reply.is_ok() {
        passphrase::forget(&context.home, &context.profile, output)?;
    }
    told.print(plan.out.as_deref(), output)
}

pub fn config(context: &Context, verb: &ConfigVerb, output: &Output) -> Result<u8, Failure> {
    let settings = context.config.show();
    match verb {
        ConfigVerb::Show => output.result(&serde_json::json!({ "settings": settings }), || lists::settings(&settings)),
        ConfigVerb::Check => {
            let unknown = accounts::unknown(&context.config.operators.rules)?;
            if !unknown.is_empty() {
                return Err(Failure::new(ErrorKind::Input, unknown.join("; ")));
            }
            output.result(&serde_json::json!({ "ok": true }), || "the settings are valid".to_owned());
        }
    }
    Ok(0)
}

/// The passphrase is written once the site is there: without its keyring it opens nothing.
pub async fn create_identity(context: Context, output: &Output) -> Result<u8, Failure> {
    let create = async |client: &Client| {
        let (passphrase, is_new) = passphrase::given_or_new(&context, output)?;
        Ok((Question::from(command::CreateIdentity { passphrase }).ask(client).await, is_new))
    };
    let (told, is_new) = context.with(NEITHER, ProfileNeed::None, output, create).await?;
    let printed = told.print(None, output);
    printed.inspect_err(|_| passphrase::forget_unused(is_new, &context))
}

pub fn identity(verb: IdentityVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        // `run` handles creation and lists.
        IdentityVerb::Create | IdentityVerb::Show | IdentityVerb::List => Plan::public(command::ShowIdentity),
        IdentityVerb::Compare { fingerprint, account } => {
            let needs = if account.is_some() { CHAIN } else { NEITHER };
            let account = parse::optional(account.as_deref())?;
            Plan::new(needs, ProfileNeed::None, command::CompareFingerprint { fingerprint, account })
        }
        IdentityVerb::Recovery { account } => {
            let recovery = if account == "none" { None } else { Some(parse::value(&account)?) };
            Plan::unlocked(command::NameRecovery { recovery })
        }
        IdentityVerb::Lock => Plan::kept(command::Lock),
    })
}

pub fn topics(verb: TopicsVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        TopicsVerb::List => Plan::new(ROS, ProfileNeed::None, command::ListTopics),
        TopicsVerb::Watch { topic, type_name } => {
            let type_name = parse::optional(type_name.as_deref())?;
            Plan::new(NEITHER, ProfileNeed::OpenAtSite, command::WatchTopic { topic: parse::value(&topic)?, type_name })
        }
        TopicsVerb::Unwatch { topic } => Plan::kept(command::UnwatchTopic { topic: parse::value(&topic)? }),
        TopicsVerb::Pin(pin) => Plan::kept(quarantine::pin(&pin)?),
        TopicsVerb::Pins { topic } => Plan::kept(command::ListPins { topic: parse::optional(topic.as_deref())? }),
        TopicsVerb::Coverage(coverage) => Plan::kept(coverage::question(&coverage)?),
        TopicsVerb::Policy(policy) => Plan::new(ROS, ProfileNeed::None, robots::policy(&policy)?),
        TopicsVerb::Unpin { topic, caller_id } => {
            Plan::kept(command::UnpinTopic { topic: parse::value(&topic)?, caller_id })
        }
    })
}

pub async fn uploads(context: Context, verb: UploadsVerb, output: &Output) -> Result<u8, Failure> {
    let plan = match verb {
        UploadsVerb::List(list) if list.follow => {
            return follow::run(context, command::ListUploads, parse::query(&list)?, output).await;
        }
        UploadsVerb::List(list) => {
            // Ids of tags derive from the profile's own key.
            let need = if list.tags.is_empty() { ProfileNeed::None } else { ProfileNeed::Unlocked };
            Plan::new(NEITHER, need, check::list_uploads(&context, parse::query(&list)?))
        }
        UploadsVerb::Import { other } => return recordings::import_home(context, &other, output).await,
        UploadsVerb::Show { id } => Plan::public(command::ShowUpload { id }),
        UploadsVerb::Export { id, dir, addresses } => {
            Plan { out: Some(dir), ..Plan::unlocked(command::ExportUpload { id, addresses }) }
        }
    };
    run(context, plan, output).await
}

pub fn grants(verb: GrantsVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        GrantsVerb::List => Plan::unlocked(command::ListGrants),
        GrantsVerb::Extend { grantee, expires, .. } => {
            let (grantee, expires) = (parse::value(&grantee)?, expires.as_deref().map(parse::end).transpose()?);
            Plan::unlocked(command::ExtendGrant { grantee, expires })
        }
    })
}

pub async fn shared(context: Context, verb: SharedVerb, output: &Output) -> Result<u8, Failure> {
    let plan = match verb {
        SharedVerb::Export(export) => return recordings::export(context, export, output).await,
        SharedVerb::Play(play) => return playing::run(context, play, output).await,
        SharedVerb::List(list) if list.follow => {
            return follow::run(context, command::ListShared, parse::query(&list)?, output).await;
        }
        SharedVerb::List(list) => Plan::unlocked(command::ListShared(parse::query(&list)?)),
        SharedVerb::Check { id } => Plan::unlocked(command::CheckShared { id }),
        SharedVerb::Open { id, out } => reading::open(id, out),
        SharedVerb::Path { id, records } => Plan::unlocked(command::ViewPath { id, records }),
    };
    run(context, plan, output).await
}

pub fn audit(context: &Context, arguments: &AuditArguments) -> Result<Plan, Failure> {
    let Some(verb) = &arguments.verb else {
        let since = arguments.since.as_deref().map(parse::past).transpose()?;
        let ask = command::AuditRecords { deep: arguments.deep, since };
        // Asks the chain only of a home that is bound to one.
        let needs = Needs { ros: false, chain: is_bound(&context.home) };
        return Ok(Plan::new(needs, ProfileNeed::None, ask));
    };
    if arguments.deep || arguments.since.is_some() {
        return Err(usage("--deep and --since apply to the audit of records; omit them here"));
    }
    Ok(match verb {
        AuditVerb::List { since, action, by, by_operator, before, limit } => {
            let query = audit::query(since.as_deref(), *limit)?;
            let (action, profile, operator, before) = (action.clone(), by.clone(), by_operator.clone(), *before);
            let query = command::AuditQuery { action, profile, operator, before, ..query };
            Plan::kept(command::ListAudit(query))
        }
        AuditVerb::Verify { without_heads: true } => Plan::kept(command::VerifyAudit { heads: false }),
        AuditVerb::Verify { .. } => Plan::unlocked(command::VerifyAudit { heads: true }),
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
        KeysVerb::List => Plan::unlocked(command::ListKeys),
        KeysVerb::Rotate { envelope: false, .. } => Plan::unlocked(command::RotateKeys),
        KeysVerb::Rotate { dry_run, .. } => {
            changes(ProfileNeed::Unlocked, command::PairKind::Envelope, dry_run, command::RotateEnvelope)
        }
        KeysVerb::Passphrase { new_passphrase_file, new_passphrase_fd } => {
            return passphrase::change(context, new_passphrase_file.as_deref(), new_passphrase_fd);
        }
        KeysVerb::Backup { out } => Plan { out: Some(out), ..Plan::kept(command::BackUpKeys) },
        KeysVerb::Load { sm4, sm2, eoa, keystore_passphrase_file, dry_run } => {
            let choices = [(KeyKind::Sm4, sm4), (KeyKind::Sm2, sm2), (KeyKind::Eoa, eoa)];
            let chosen = choices.into_iter().find_map(|(kind, path)| path.map(|path| (kind, path)));
            let (kind, path) = chosen.ok_or_else(|| usage("give the key with --sm4, --sm2 or --eoa"))?;
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
    let expires = arguments.expires.as_deref().map(parse::end).transpose()?;
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
