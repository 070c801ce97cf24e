//! The plain verbs: one command each, one answer each.

use std::path::PathBuf;

use super::args::{ChainVerb, ConfigVerb, GrantsVerb, IdentityVerb, SuccessionVerb, TopicsVerb, UploadsVerb, Verb};
use super::connect::{Context, ProfileNeed};
use super::plans::{audit, grant, keys};
use super::quarantine::{self, QuarantineVerb};
use super::{check, lists, parse, parties, passphrase, show};
use crate::service::{Command, Failure, Needs, Operation, Reply};
use authros_output::Output;

/// The chain alone.
pub const CHAIN: Needs = Needs { ros: false, chain: true };
/// ROS alone.
pub const ROS: Needs = Needs { ros: true, chain: false };
/// Ledger and vault are enough.
pub const NEITHER: Needs = Needs { ros: false, chain: false };

/// A verb as the site understands it.
pub struct Plan {
    /// Parts of the site it needs.
    pub needs: Needs,
    /// What the profile must be.
    pub profile: ProfileNeed,
    /// What is asked before, its answer told beside the result.
    pub first: Option<Command>,
    /// What is asked.
    pub command: Command,
    /// Where files of the answer go.
    pub out: Option<PathBuf>,
}

impl Plan {
    /// A plan that writes no file.
    pub fn new(needs: Needs, profile: ProfileNeed, command: Command) -> Self {
        Self { needs, profile, first: None, command, out: None }
    }
}

/// Runs one verb.
///
/// # Errors
/// What the site or the arguments say.
pub async fn run(context: Context, verb: Verb, output: &Output) -> Result<u8, Failure> {
    if let Verb::Config(verb) = verb {
        return Ok(config(&context, &verb, output));
    }
    if let Verb::Status = verb {
        return super::status::run(context, output).await;
    }
    let plan = plan(&context, verb, output)?;
    let connection = context.connect(plan.needs).await?;
    let forgets = matches!(plan.command, Command::ChangePassphrase { .. });
    let answer = async {
        context.prepare(&connection.client, plan.profile, output).await?;
        if let Some(first) = plan.first
            && let Reply::KeyChange(foreseen) = connection.client.request(first).await?
        {
            foreseen.lines.iter().for_each(|line| output.note(line));
        }
        connection.client.request(plan.command).await
    };
    let answer = answer.await;
    connection.close().await;
    if forgets && answer.is_ok() {
        passphrase::forget(&context.home, &context.profile, output)?;
    }
    show::show(answer?, plan.out.as_deref(), output)
}

fn config(context: &Context, verb: &ConfigVerb, output: &Output) -> u8 {
    let settings = context.config.show();
    match verb {
        ConfigVerb::Show => output.result(&serde_json::json!({ "settings": settings }), || lists::settings(&settings)),
        ConfigVerb::Check => {
            output.result(&serde_json::json!({ "ok": true }), || "the settings can be used".to_owned())
        }
    }
    0
}

fn plan(context: &Context, verb: Verb, output: &Output) -> Result<Plan, Failure> {
    use ProfileNeed::{Made, None as NoProfile, Unlocked};
    Ok(match verb {
        Verb::Identity(IdentityVerb::Create) => {
            let passphrase = passphrase::given_or_new(&context.global, &context.home, &context.profile, output)?;
            Plan::new(NEITHER, NoProfile, Command::CreateIdentity { passphrase })
        }
        Verb::Identity(IdentityVerb::Show) => Plan::new(CHAIN, NoProfile, Command::ShowIdentity),
        Verb::Identity(IdentityVerb::Compare { fingerprint, account }) => {
            let needs = if account.is_some() { CHAIN } else { NEITHER };
            let account = account.as_deref().map(parse::value).transpose()?;
            Plan::new(needs, NoProfile, Command::CompareFingerprint { fingerprint, account })
        }
        Verb::Identity(IdentityVerb::Recovery { account }) => {
            let recovery = if account == "none" { None } else { Some(parse::value(&account)?) };
            Plan::new(CHAIN, Unlocked, Command::NameRecovery { recovery })
        }
        Verb::Identity(IdentityVerb::Lock) => Plan::new(NEITHER, NoProfile, Command::Operate(Operation::Lock)),
        Verb::Gateway(verb) => Plan::new(NEITHER, NoProfile, Command::Operate(super::gateway::operation(&verb)?)),
        Verb::Contacts(verb) => Plan::new(CHAIN, NoProfile, parties::contacts(verb)?),
        Verb::Register => Plan::new(CHAIN, Made, Command::Register),
        Verb::Keys(verb) => keys(context, verb)?,
        Verb::Topics(TopicsVerb::List) => Plan::new(ROS, NoProfile, Command::ListTopics),
        Verb::Topics(TopicsVerb::Watch { topic, type_name }) => {
            let type_name = type_name.as_deref().map(parse::value).transpose()?;
            Plan::new(NEITHER, NoProfile, Command::WatchTopic { topic: parse::value(&topic)?, type_name })
        }
        Verb::Topics(TopicsVerb::Unwatch { topic }) => {
            Plan::new(NEITHER, NoProfile, Command::UnwatchTopic { topic: parse::value(&topic)? })
        }
        Verb::Topics(TopicsVerb::Pin(pin)) => Plan::new(NEITHER, NoProfile, pin.command()?),
        Verb::Topics(TopicsVerb::Pins { topic }) => {
            let topic = topic.as_deref().map(parse::value).transpose()?;
            Plan::new(NEITHER, NoProfile, Command::ListPins { topic })
        }
        Verb::Topics(TopicsVerb::Policy(policy)) => Plan::new(ROS, NoProfile, policy.command()?),
        Verb::Topics(TopicsVerb::Unpin { topic, caller_id }) => {
            Plan::new(NEITHER, NoProfile, Command::UnpinTopic { topic: parse::value(&topic)?, caller_id })
        }
        Verb::Quarantine(verb) => {
            let decides = !matches!(verb, QuarantineVerb::List { .. });
            let (needs, profile) = if decides { (CHAIN, Unlocked) } else { (NEITHER, NoProfile) };
            Plan::new(needs, profile, quarantine::command(verb)?)
        }
        Verb::Uploads(UploadsVerb::List(list)) => {
            Plan::new(NEITHER, NoProfile, check::list_uploads(context, parse::query(&list)?))
        }
        Verb::Uploads(UploadsVerb::Show { id }) => Plan::new(CHAIN, NoProfile, Command::ShowUpload { id }),
        Verb::Uploads(UploadsVerb::Export { id, dir, addresses }) => {
            Plan { out: Some(dir), ..Plan::new(CHAIN, Unlocked, Command::ExportUpload { id, addresses }) }
        }
        Verb::Grant(arguments) => Plan::new(CHAIN, Unlocked, grant(&arguments)?),
        Verb::Revoke { address } => Plan::new(CHAIN, Unlocked, Command::Revoke { grantee: parse::value(&address)? }),
        Verb::Grants(GrantsVerb::List) => Plan::new(CHAIN, Unlocked, Command::ListGrants),
        Verb::Grants(GrantsVerb::Extend { grantee, expires, .. }) => {
            let (grantee, expires) = (parse::value(&grantee)?, expires.as_deref().map(super::adopt::end).transpose()?);
            Plan::new(CHAIN, Unlocked, Command::ExtendGrant { grantee, expires })
        }
        Verb::Shared(verb) => super::viewing::plan(verb)?,
        Verb::Chain(ChainVerb::Status) => Plan::new(CHAIN, NoProfile, Command::ChainStatus),
        Verb::Chain(ChainVerb::Adopt) => Plan::new(CHAIN, Unlocked, Command::AdoptChain),
        Verb::Devices(verb) => Plan::new(CHAIN, Unlocked, super::adopt::command(&verb)?),
        Verb::Audit(arguments) => audit(context, &arguments)?,
        Verb::Chain(ChainVerb::Deploy { delay, revision }) => {
            Plan::new(CHAIN, Made, parties::deployment(delay.as_deref(), revision)?)
        }
        Verb::Chain(ChainVerb::Succession(SuccessionVerb::List)) => {
            Plan::new(CHAIN, NoProfile, Command::ListSuccessions)
        }
        Verb::Chain(verb) => {
            let command = parties::act(&verb)?.ok_or_else(super::connect::unexpected)?;
            Plan::new(CHAIN, Unlocked, command)
        }
        _ => return Err(super::connect::unexpected()),
    })
}
