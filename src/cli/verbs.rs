//! The plain verbs: one request each, whose answer is printed.

#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;

use super::args::{ConfigVerb, GrantsVerb, IdentityVerb, SharedVerb, TopicsVerb, UploadsVerb};
use super::connect::{Context, ProfileNeed};
use super::quarantine::{self, QuarantineVerb};
use super::{
    check, coverage, follow, lists, parse, passphrase, playing, printed, reading, recordings, robots, show::Question,
};
use crate::model::ErrorKind;
use crate::service::{Client, Command, Failure, Needs, accounts, command};
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
    use ProfileNeed::{None as NoProfile, Unlocked};
    Ok(match verb {
        // `run` handles creation and lists.
        IdentityVerb::Create | IdentityVerb::Show | IdentityVerb::List => {
            Plan::new(CHAIN, NoProfile, command::ShowIdentity)
        }
        IdentityVerb::Compare { fingerprint, account } => {
            let needs = if account.is_some() { CHAIN } else { NEITHER };
            let account = parse::optional(account.as_deref())?;
            Plan::new(needs, NoProfile, command::CompareFingerprint { fingerprint, account })
        }
        IdentityVerb::Recovery { account } => {
            let recovery = if account == "none" { None } else { Some(parse::value(&account)?) };
            Plan::new(CHAIN, Unlocked, command::NameRecovery { recovery })
        }
        IdentityVerb::Lock => Plan::new(NEITHER, NoProfile, command::Lock),
    })
}

pub fn topics(verb: TopicsVerb) -> Result<Plan, Failure> {
    let kept = |question: Question| Plan::new(NEITHER, ProfileNeed::None, question);
    Ok(match verb {
        TopicsVerb::List => Plan::new(ROS, ProfileNeed::None, command::ListTopics),
        TopicsVerb::Watch { topic, type_name } => {
            let type_name = parse::optional(type_name.as_deref())?;
            Plan::new(NEITHER, ProfileNeed::OpenAtSite, command::WatchTopic { topic: parse::value(&topic)?, type_name })
        }
        TopicsVerb::Unwatch { topic } => kept(command::UnwatchTopic { topic: parse::value(&topic)? }.into()),
        TopicsVerb::Pin(pin) => kept(quarantine::pin(&pin)?),
        TopicsVerb::Pins { topic } => kept(command::ListPins { topic: parse::optional(topic.as_deref())? }.into()),
        TopicsVerb::Coverage(coverage) => kept(coverage::question(&coverage)?.into()),
        TopicsVerb::Policy(policy) => Plan::new(ROS, ProfileNeed::None, robots::policy(&policy)?),
        TopicsVerb::Unpin { topic, caller_id } => {
            kept(command::UnpinTopic { topic: parse::value(&topic)?, caller_id }.into())
        }
    })
}

pub fn quarantine(verb: QuarantineVerb) -> Result<Plan, Failure> {
    let decides = !matches!(verb, QuarantineVerb::List { .. });
    let (needs, profile) = if decides { (CHAIN, ProfileNeed::Unlocked) } else { (NEITHER, ProfileNeed::None) };
    Ok(Plan::new(needs, profile, quarantine::question(verb)?))
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
        UploadsVerb::Show { id } => Plan::new(CHAIN, ProfileNeed::None, command::ShowUpload { id }),
        UploadsVerb::Export { id, dir, addresses } => {
            Plan { out: Some(dir), ..Plan::new(CHAIN, ProfileNeed::Unlocked, command::ExportUpload { id, addresses }) }
        }
    };
    run(context, plan, output).await
}

pub fn grants(verb: GrantsVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        GrantsVerb::List => Plan::new(CHAIN, ProfileNeed::Unlocked, command::ListGrants),
        GrantsVerb::Extend { grantee, expires, .. } => {
            let (grantee, expires) = (parse::value(&grantee)?, expires.as_deref().map(parse::end).transpose()?);
            Plan::new(CHAIN, ProfileNeed::Unlocked, command::ExtendGrant { grantee, expires })
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
        SharedVerb::List(list) => reading::plan(command::ListShared(parse::query(&list)?)),
        SharedVerb::Check { id } => reading::plan(command::CheckShared { id }),
        SharedVerb::Open { id, out } => reading::open(id, out),
        SharedVerb::Path { id, records } => reading::plan(command::ViewPath { id, records }),
    };
    run(context, plan, output).await
}
