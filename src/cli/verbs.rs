//! The plain verbs: one command each, one answer each.

use std::path::{Path, PathBuf};

use super::args::{
    ChainVerb, ConfigVerb, EpochsChoice, ExportKind, GrantArguments, GrantsVerb, IdentityVerb, KeysVerb, SharedVerb,
    TopicsVerb, UploadsVerb, Verb,
};
use super::audit::AuditVerb;
use super::connect::{Context, ProfileNeed};
use super::output::Output;
use super::quarantine::{self, QuarantineVerb};
use super::{lists, parse, parties, passphrase};
use crate::crypto::private_file;
use crate::model::{ErrorKind, Timestamp};
use crate::service::{Command, Epochs, Failure, KeyKind, Needs, Reply, SecretText};

const CHAIN: Needs = Needs { ros: false, chain: true };
const ROS: Needs = Needs { ros: true, chain: false };
const NEITHER: Needs = Needs { ros: false, chain: false };

/// A verb as the site understands it.
struct Plan {
    needs: Needs,
    profile: ProfileNeed,
    command: Command,
    out: Option<PathBuf>,
}

impl Plan {
    fn new(needs: Needs, profile: ProfileNeed, command: Command) -> Self {
        Self { needs, profile, command, out: None }
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
    let plan = plan(&context, verb, output)?;
    let connection = context.connect(plan.needs).await?;
    let answer = async {
        context.prepare(&connection.client, plan.profile, output).await?;
        connection.client.request(plan.command).await
    };
    let answer = answer.await;
    connection.close().await;
    show(answer?, plan.out.as_deref(), output)
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
        Verb::Contacts(verb) => Plan::new(CHAIN, NoProfile, parties::contacts(verb)?),
        Verb::Register => Plan::new(CHAIN, Made, Command::Register),
        Verb::Keys(verb) => keys(verb)?,
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
        Verb::Topics(TopicsVerb::Unpin { topic, caller_id }) => {
            Plan::new(NEITHER, NoProfile, Command::UnpinTopic { topic: parse::value(&topic)?, caller_id })
        }
        Verb::Quarantine(verb) => {
            let decides = !matches!(verb, QuarantineVerb::List { .. });
            let (needs, profile) = if decides { (CHAIN, Unlocked) } else { (NEITHER, NoProfile) };
            Plan::new(needs, profile, quarantine::command(verb)?)
        }
        Verb::Uploads(UploadsVerb::List(list)) => {
            Plan::new(NEITHER, NoProfile, Command::ListUploads(parse::query(&list)?))
        }
        Verb::Uploads(UploadsVerb::Show { id }) => Plan::new(CHAIN, NoProfile, Command::ShowUpload { id }),
        Verb::Uploads(UploadsVerb::Export { id, dir, addresses }) => {
            Plan { out: Some(dir), ..Plan::new(CHAIN, Unlocked, Command::ExportUpload { id, addresses }) }
        }
        Verb::Grant(arguments) => Plan::new(CHAIN, Unlocked, grant(&arguments)?),
        Verb::Revoke { address } => Plan::new(CHAIN, Unlocked, Command::Revoke { grantee: parse::value(&address)? }),
        Verb::Grants(GrantsVerb::List) => Plan::new(CHAIN, Unlocked, Command::ListGrants),
        Verb::Shared(SharedVerb::List(list)) => Plan::new(CHAIN, Unlocked, Command::ListShared(parse::query(&list)?)),
        Verb::Shared(SharedVerb::Check { id }) => Plan::new(CHAIN, Unlocked, Command::CheckShared { id }),
        Verb::Shared(SharedVerb::Open { id, out }) => {
            Plan { out, ..Plan::new(CHAIN, Unlocked, Command::OpenShared { id }) }
        }
        Verb::Chain(ChainVerb::Status) => Plan::new(CHAIN, NoProfile, Command::ChainStatus),
        Verb::Chain(ChainVerb::Adopt) => Plan::new(CHAIN, Unlocked, Command::AdoptChain),
        Verb::Devices(verb) => Plan::new(CHAIN, Unlocked, super::adopt::command(&verb)?),
        Verb::Audit(verb) => audit(&verb)?,
        Verb::Chain(ChainVerb::Deploy) => Plan::new(CHAIN, Made, Command::DeployContract),
        Verb::Chain(verb) => {
            let command = parties::act(&verb)?.ok_or_else(super::connect::unexpected)?;
            Plan::new(CHAIN, Unlocked, command)
        }
        Verb::Agent(_)
        | Verb::Config(_)
        | Verb::Capture(_)
        | Verb::Serve
        | Verb::Gateway(_)
        | Verb::Demo(_)
        | Verb::Bench(_)
        | Verb::Console(_) => {
            return Err(super::connect::unexpected());
        }
    })
}

fn audit(verb: &AuditVerb) -> Result<Plan, Failure> {
    let command = super::audit::query(verb)?;
    Ok(match verb {
        AuditVerb::List { .. } | AuditVerb::Verify { without_heads: true } => {
            Plan::new(NEITHER, ProfileNeed::None, command)
        }
        AuditVerb::Verify { .. } => Plan::new(CHAIN, ProfileNeed::Unlocked, command),
        AuditVerb::Export { dir, .. } => {
            Plan { out: Some(dir.clone()), ..Plan::new(NEITHER, ProfileNeed::Unlocked, command) }
        }
    })
}

fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|error| Failure::new(ErrorKind::Input, format!("{}: {error}", path.display())))
}

fn keys(verb: KeysVerb) -> Result<Plan, Failure> {
    let secret = |file: Option<PathBuf>| file.as_deref().map(passphrase::from_file).transpose();
    Ok(match verb {
        KeysVerb::List => Plan::new(CHAIN, ProfileNeed::Unlocked, Command::ListKeys),
        KeysVerb::Rotate => Plan::new(CHAIN, ProfileNeed::Unlocked, Command::RotateKeys),
        KeysVerb::Load { sm4, sm2, eoa, keystore_passphrase_file } => {
            let choices = [(KeyKind::Sm4, sm4), (KeyKind::Sm2, sm2), (KeyKind::Eoa, eoa)];
            let chosen = choices.into_iter().find_map(|(kind, path)| path.map(|path| (kind, path)));
            let (kind, path) =
                chosen.ok_or_else(|| Failure::new(ErrorKind::Usage, "name the key with --sm4, --sm2 or --eoa"))?;
            let command =
                Command::LoadKey { kind, path: absolute(&path)?, passphrase: secret(keystore_passphrase_file)? };
            Plan::new(CHAIN, ProfileNeed::Made, command)
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
                ..Plan::new(NEITHER, ProfileNeed::Unlocked, Command::ExportKey { kind, passphrase })
            }
        }
    })
}

fn grant(arguments: &GrantArguments) -> Result<Command, Failure> {
    let expires = match &arguments.expires {
        Some(text) => {
            let length = parse::duration(text)?;
            Some(Timestamp::from_seconds(Timestamp::now().seconds() + length.as_secs().max(1)))
        }
        None => None,
    };
    Ok(Command::Grant {
        grantee: parse::value(arguments.address.as_deref().or(arguments.to.as_deref()).unwrap_or_default())?,
        topics: parse::values(&arguments.topics)?,
        epochs: match arguments.epochs {
            EpochsChoice::Current => Epochs::Current,
            EpochsChoice::All => Epochs::All,
        },
        expires,
    })
}

fn show(reply: Reply, out: Option<&Path>, output: &Output) -> Result<u8, Failure> {
    match reply {
        Reply::Done => output.result(&serde_json::json!({ "ok": true }), || "done".to_owned()),
        Reply::Identity(view) => output.result(&view, || lists::identity(&view)),
        Reply::Keys(view) => output.result(&view, || lists::keys(&view)),
        Reply::Topics(rows) => output.result(&serde_json::json!({ "topics": rows }), || lists::topics(&rows)),
        Reply::Records(page) => output.result(&page, || lists::records(&page)),
        Reply::Provenance(view) => output.result(&view, || lists::provenance(&view)),
        Reply::Transaction(view) => output.result(&view, || view.text.clone()),
        Reply::Grants(rows) => output.result(&serde_json::json!({ "grants": rows }), || lists::grants(&rows)),
        Reply::Devices(rows) => {
            output.result(&serde_json::json!({ "devices": rows }), || super::adopt::devices(&rows));
        }
        Reply::Chain(view) => output.result(&view, || lists::chain(&view)),
        Reply::Deployed(view) => output.result(&view, || lists::deployed(&view)),
        Reply::Contacts(rows) => {
            output.result(&serde_json::json!({ "contacts": rows }), || parties::contact_table(&rows));
        }
        Reply::Compared(view) => {
            output.result(&view, || parties::comparison(&view));
            return Ok(parties::comparison_code(&view));
        }
        Reply::Audit(lines) => {
            output.result(&serde_json::json!({ "audit": lines }), || super::audit::lines(&lines));
        }
        Reply::AuditChecked(check) => {
            output.result(&check, || super::audit::check(&check));
            return Ok(super::audit::code(&check));
        }
        Reply::Pins(view) => output.result(&view, || quarantine::pins(&view)),
        Reply::Quarantine(view) => output.result(&view, || quarantine::held(&view)),
        Reply::Decided(view) => output.result(&view, || view.text.clone()),
        Reply::Check(view) => {
            output.result(&view, || format!("{}: {}", view.id, view.verdict.word()));
            return Ok(lists::verdict_code(view.verdict));
        }
        Reply::Opened(mut view) => {
            let bytes = view.picture.take().or_else(|| view.body.clone());
            view.body = None;
            if let (Some(path), Some(bytes)) = (out, bytes) {
                write_new(path, &bytes)?;
            }
            output.result(&view, || lists::opened(&view));
            return Ok(lists::verdict_code(view.verdict));
        }
        Reply::Files(files) => {
            let directory = out.unwrap_or(Path::new("."));
            std::fs::create_dir_all(directory).map_err(|error| not_written(directory, &error))?;
            for file in &files {
                let path = directory.join(&file.name);
                std::fs::write(&path, &file.bytes).map_err(|error| not_written(&path, &error))?;
            }
            let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
            let written = serde_json::json!({ "directory": directory.display().to_string(), "files": names });
            output.result(&written, || format!("{} written to {}", names.join(", "), directory.display()));
        }
        Reply::Key(secret) => {
            let path = out.ok_or_else(super::connect::unexpected)?;
            private_file::create_private(path, secret.expose())?;
            output.result(&serde_json::json!({ "file": path.display().to_string() }), || {
                format!("written to {} (0600)", path.display())
            });
        }
        Reply::Enrolled(_) | Reply::Captured(_) | Reply::Served(_) | Reply::Gateway(_) | Reply::Site(_) => {
            return Err(super::connect::unexpected());
        }
    }
    Ok(0)
}

fn not_written(path: &Path, error: &std::io::Error) -> Failure {
    Failure::new(ErrorKind::Input, format!("{} cannot be written: {error}", path.display()))
}

fn write_new(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|error| not_written(path, &error))
}
