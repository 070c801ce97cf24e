//! `config dump` and `config apply`: a site as a single file that a repository can hold.

#![deny(clippy::wildcard_enum_match_arm)]

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::connect::Context;
use super::verbs::NEITHER;
use crate::config::{Decisions, Difference, Here, HomeSettings, KnownAccount, SiteFile, Source, without_password};
use crate::model::{ErrorKind, Publisher, TopicName, clean};
use crate::service::command::{
    AddContact, Admit, Dismiss, ListAdmitted, ListContacts, ListPins, ListWatches, PinTopic, RemoveContact,
    UnpinPublisher, UnwatchTopic, WatchTopic,
};
use crate::service::reply::PinView;
use crate::service::{Client, Failure};
use crate::store::files::{atomic_write, private_directory};
use authros_output::Output;

/// The longest file accepted, bytes.
const LONGEST: u64 = 4 << 20;
/// Beside `config.toml`: its content before the last `apply`.
const BEFORE: &str = "toml.before";

/// `config dump`
///
/// # Errors
/// If the home or its settings cannot be read.
pub async fn dump(context: &Context, output: &Output) -> Result<u8, Failure> {
    let home = home_settings(&context.home.config())?;
    let here = here(context).await?;
    let file = SiteFile { settings: home.site.clone(), rules: home.rules.clone(), decisions: here.decisions };
    let mut head = vec![
        format!("The site of profile '{}', written by `authros config dump`.", context.profile),
        "`authros config apply FILE --check` shows what it would change.".to_owned(),
    ];
    head.extend(home.stays.iter().map(|(name, (_, why))| format!("{name} is not included: {}.", why.reason())));
    let text = file.to_text(&head);
    tell_overridden(context, output);
    if context.global.json {
        let left_out: Vec<&str> = home.stays.keys().copied().collect();
        output.result(&serde_json::json!({ "toml": text, "left_out": left_out }), String::new);
    } else {
        output.raw(&text);
    }
    Ok(0)
}

/// What flags and environment set applies only to this process.
fn tell_overridden(context: &Context, output: &Output) {
    for setting in context.config.show() {
        match context.config.source(setting.name) {
            Source::Flag | Source::Environment(_) => output.note(&format!(
                "authros: {} of the {} is not included; put settings to keep into config.toml",
                setting.name, setting.source
            )),
            Source::Default | Source::File(_) => {}
        }
    }
}

/// `config apply FILE`
///
/// # Errors
/// If the file cannot be used, or a change is refused; changes made before stay, and another `apply` continues from
/// there.
pub async fn apply(context: &Context, path: &Path, check: bool, output: &Output) -> Result<u8, Failure> {
    let file = SiteFile::read(path, &read(path)?)?;
    let home = home_settings(&context.home.config())?;
    let here = here(context).await?;
    let differences = file.differences(&home, &here);
    if differences.iter().any(|difference| matches!(difference, Difference::Pin { .. } | Difference::Unpin { .. }))
        && !context.home.keyring(&context.profile).exists()
    {
        let text = format!("publishers are pinned by a profile, and '{}' does not exist yet", context.profile);
        return Err(Failure::new(ErrorKind::Input, format!("{text}; create it with `authros identity create`")));
    }
    if context.config.site.is_some() {
        check_keys(&differences)?;
    }
    let lines: Vec<String> = differences.iter().map(|difference| clean(&difference.to_string(), 2000)).collect();
    let shown = if lines.is_empty() { "no differences".to_owned() } else { lines.join("\n") };
    let document = serde_json::json!({ "differences": &differences, "applied": !check });
    if check {
        output.result(&document, || shown);
        return Ok(if differences.is_empty() { 0 } else { ErrorKind::Incomplete.exit_code() });
    }
    // With --json there is one document, at the end; the text output appears in any case.
    if context.global.json {
        output.note(&shown)
    } else {
        output.result(&document, || shown)
    }
    if differences.iter().any(Difference::is_setting) {
        write_settings(context, &file, &home)?;
        output.note("authros: config.toml was rewritten; a running site uses it from its next start");
        if let Some(text) =
            unsigned_webhook(&home_settings(&context.home.config())?.wanted(&SiteFile::default()), &file)
        {
            output.note(text);
        }
    }
    decide(context, &differences).await?;
    if context.global.json {
        output.result(&document, String::new);
    }
    Ok(0)
}

/// A joined site accepts no contact without the fingerprint of its key: checked before one is removed to be added
/// again.
fn check_keys(differences: &[Difference]) -> Result<(), Failure> {
    for difference in differences {
        if let Difference::AddContact { name, fingerprint: None, .. } = difference {
            let text = format!(
                "the key of '{name}' is known here only from a gateway, and nothing was changed; get its fingerprint \
                 from its owner over another channel, and add it to the file as the fingerprint of that [[contact]]"
            );
            return Err(Failure::new(ErrorKind::Refused, text));
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<String, Failure> {
    let failed = |why: &dyn std::fmt::Display| {
        Failure::new(ErrorKind::Input, format!("{} cannot be read: {why}", clean(&path.display().to_string(), 200)))
    };
    let file = std::fs::File::open(path).map_err(|error| failed(&error))?;
    let mut text = String::new();
    let length = file.take(LONGEST + 1).read_to_string(&mut text).map_err(|error| failed(&error))?;
    if length as u64 > LONGEST {
        return Err(failed(&"it is longer than the limit of 4 MiB"));
    }
    Ok(text)
}

/// The content of `config.toml`; nothing if there is none.
fn home_settings(path: &Path) -> Result<HomeSettings, Failure> {
    if !path.exists() {
        return Ok(HomeSettings::default());
    }
    Ok(HomeSettings::read(path, &read(path)?)?)
}

/// The operator's decisions in this home's ledger; nothing if there is none yet, and then none is created.
async fn here(context: &Context) -> Result<Here, Failure> {
    let nothing = Decisions {
        watches: Some(BTreeMap::default()),
        publishers: Some(BTreeSet::default()),
        contacts: Some(BTreeMap::default()),
        admitted: Some(BTreeSet::default()),
    };
    if !context.home.ledger().exists() {
        return Ok(Here { decisions: nothing, ..Here::default() });
    }
    let connection = context.connect(NEITHER).await?;
    let asked = ask_all(context, &connection.client).await;
    connection.close().await;
    asked
}

async fn ask_all(context: &Context, client: &Client) -> Result<Here, Failure> {
    let watches = client.ask(ListWatches).await?.into_iter().map(|watch| (watch.topic, watch.type_name)).collect();
    let contacts = client.ask(ListContacts).await?.into_iter().map(|row| {
        let fingerprint = row.fingerprint.filter(|_| row.given);
        (row.name, KnownAccount { address: row.address, fingerprint })
    });
    let own: BTreeSet<_> = own_accounts(context);
    let admitted = client.ask(ListAdmitted).await?.into_iter().map(|row| row.owner);
    let pins = if context.home.keyring(&context.profile).exists() {
        client.ask(ListPins { topic: None }).await?.pins
    } else {
        Vec::new()
    };
    let of = |source: &str| pins.iter().filter(|pin| pin.source == source).filter_map(pinned).collect::<BTreeSet<_>>();
    let decisions = Decisions {
        watches: Some(watches),
        publishers: Some(of("operator")),
        contacts: Some(contacts.collect()),
        admitted: Some(admitted.filter(|owner| !own.contains(owner)).collect()),
    };
    Ok(Here { decisions, seen_first: of("first"), own })
}

fn pinned(pin: &PinView) -> Option<(TopicName, Publisher)> {
    Some((pin.topic.parse().ok()?, pin.publisher.clone()))
}

/// Accounts of the profiles of this home; one with an unreadable keyring is reported where it is opened.
fn own_accounts(context: &Context) -> BTreeSet<crate::model::Address> {
    let profiles = context.home.profiles().into_iter();
    let read = |profile| crate::crypto::read_public(&context.home.keyring(&profile)).ok();
    profiles.filter_map(read).map(|public| public.address).collect()
}

/// Rewrites `config.toml`, once it is known to be valid; its previous content is kept beside it.
fn write_settings(context: &Context, file: &SiteFile, home: &HomeSettings) -> Result<(), Failure> {
    // A symlink to elsewhere stays one.
    let path = context.home.config();
    let path = std::fs::canonicalize(&path).unwrap_or(path);
    let head = ["Written by `authros config apply`; the next one overwrites manual changes here."];
    let settings = SiteFile { settings: home.wanted(file), rules: file.rules.clone(), ..SiteFile::default() };
    let text = settings.to_text(&head.map(str::to_owned));
    let given = |name: &str| settings.settings.get(name).cloned();
    crate::config::Config::resolve(&given, &|_| None, None).map_err(together)?;
    if let Some(folder) = path.parent() {
        private_directory(folder)?;
    }
    if path.exists() {
        atomic_write(&before(&path), read(&path)?.as_bytes())?;
    }
    Ok(atomic_write(&path, text.as_bytes())?)
}

/// What is still to be done by hand for a webhook of the file: the secret that signs its requests is no part of it.
fn unsigned_webhook(stays: &BTreeMap<&'static str, String>, file: &SiteFile) -> Option<&'static str> {
    let is_set = |name: &str, variable: &str| {
        let value = stays.get(name).or_else(|| file.settings.get(name)).cloned();
        value.or_else(|| std::env::var(variable).ok()).is_some_and(|value| !value.is_empty())
    };
    (is_set("alerts.webhook", "AUTHROS_ALERTS_WEBHOOK") && !is_set("alerts.secret", "AUTHROS_ALERTS_SECRET")).then_some(
        "authros: alerts.webhook is set and alerts.secret is not, so requests are sent unsigned; write the secret into a \
         0600 file, and its path by hand into config.toml as alerts.secret",
    )
}

fn before(path: &Path) -> PathBuf {
    path.with_extension(BEFORE)
}

/// Each value is valid on its own, but not beside one that stays in this home.
fn together(error: crate::config::ConfigError) -> Failure {
    let text = format!("with what stays in this home's config.toml, the file cannot be used: {error}");
    Failure::new(error.kind(), without_password(&text))
}

/// Brings the ledger to the file's state, one decision after the other, each of them in the audit log.
async fn decide(context: &Context, differences: &[Difference]) -> Result<(), Failure> {
    if differences.iter().all(Difference::is_setting) {
        return Ok(());
    }
    let connection = context.connect(NEITHER).await?;
    let mut decided = Ok(());
    for difference in differences {
        decided = one(&connection.client, difference.clone()).await;
        if let Err(failure) = decided {
            let what = clean(&difference.to_string(), 300);
            let text = format!("'{what}' failed; the changes before it are done: {failure}");
            decided = Err(Failure::new(failure.kind, text));
            break;
        }
    }
    connection.close().await;
    decided
}

async fn one(client: &Client, difference: Difference) -> Result<(), Failure> {
    match difference {
        Difference::Setting { .. }
        | Difference::RuleGone { .. }
        | Difference::RuleNew { .. }
        | Difference::RulesInOrder => Ok(()),
        Difference::Watch { topic, type_name } => client.ask(WatchTopic { topic, type_name }).await,
        Difference::Unwatch { topic } => client.ask(UnwatchTopic { topic }).await,
        Difference::Pin { topic, publisher } => {
            client.ask(PinTopic { topic, publishers: vec![publisher] }).await.map(drop)
        }
        Difference::Unpin { topic, publisher } => client.ask(UnpinPublisher { topic, publisher }).await.map(drop),
        Difference::RemoveContact { name } => client.ask(RemoveContact { name }).await.map(drop),
        Difference::AddContact { name, address, fingerprint } => {
            client.ask(AddContact { name, address, fingerprint }).await.map(drop)
        }
        Difference::Dismiss { owner } => client.ask(Dismiss { owner: owner.into() }).await.map(drop),
        Difference::Admit { owner } => client.ask(Admit { owner: owner.into() }).await.map(drop),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contact_without_a_fingerprint_is_refused_at_a_joined_site_and_one_that_goes_is_not() {
        let name: crate::model::ContactName = "bob".parse().expect("a name");
        let add = |fingerprint: Option<&str>| Difference::AddContact {
            name: name.clone(),
            address: crate::model::Address([7; 20]),
            fingerprint: fingerprint.map(str::to_owned),
        };
        let gone = Difference::RemoveContact { name: name.clone() };
        assert_eq!(check_keys(&[gone.clone(), add(Some("0011"))]), Ok(()));
        let refused = check_keys(&[gone, add(None)]).expect_err("its key is not known");
        assert_eq!(refused.kind, ErrorKind::Refused);
        assert!(refused.message.contains("'bob'") && refused.message.contains("nothing was changed"));
    }
}
