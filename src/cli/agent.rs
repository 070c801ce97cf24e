//! `authros agent`: `enrol` runs at the owner, `run` on the robot.

use std::path::{Path, PathBuf};
use std::{future::pending, time::Duration};

use serde::Serialize;

use super::args::{AgentVerb, EnrolArguments, Global, RunArguments};
use super::connect::{Context, ProfileNeed};
use super::{parse, passphrase, plan::CHAIN, serve};
use crate::crypto::{Fingerprint, Passphrase, SealedEnrolment, private_file};
use crate::model::{ByteSize, ErrorKind};
use crate::service::{
    Agent, AgentEnd, AgentFigures, AgentWishes, Client, EnrolWishes, Failure, Needs, NoticeLevel, SecretText, Site,
};
use crate::{service::command::EnrolDevice, store::TopicCounts};
use authros_output::Output;

pub async fn run(mut global: Global, verb: AgentVerb, output: &Output) -> Result<u8, Failure> {
    match verb {
        AgentVerb::Enrol(arguments) => {
            // Names the robot's gateway, not the one that this home's site joined.
            global.gateway_key = None;
            enrol(Context::new(global, output)?, arguments, output).await
        }
        AgentVerb::Run(arguments) => capture(global, arguments, output).await,
    }
}

async fn enrol(context: Context, arguments: EnrolArguments, output: &Output) -> Result<u8, Failure> {
    let out = arguments.out;
    if out.exists() {
        let advice = "choose another --out, enrolments are never overwritten";
        return Err(Failure::new(ErrorKind::Input, format!("{} exists; {advice}", out.display())));
    }
    let passphrase = match &arguments.robot_passphrase_file {
        Some(file) => passphrase::from_file(file)?,
        None => SecretText::new(Passphrase::random()?.expose().to_owned()),
    };
    let wishes = EnrolWishes {
        addresses: arguments.addresses,
        fingerprint: arguments.gateway_key.as_deref().map(parse::fingerprint).transpose()?,
        name: parse::value(&arguments.name)?,
        topics: parse::values(&arguments.topics)?,
        all_topics: arguments.all_topics,
        until: parse::Times::now(output).end(arguments.until.as_deref())?,
        passphrase: passphrase.clone(),
    };
    let enrol = async |client: &Client| client.ask(EnrolDevice(wishes)).await;
    let view = context.with(CHAIN, ProfileNeed::Unlocked, output, enrol).await?;
    private_file::create_private(&out, view.file.expose())?;
    if arguments.robot_passphrase_file.is_none() {
        let beside = beside(&out);
        private_file::create_private(&beside, format!("{}\n", passphrase.expose()).as_bytes())?;
        output.note(&format!("its passphrase was written to {}; bring it to the robot separately", beside.display()));
    }
    let document = serde_json::json!({
        "name": view.name, "device": view.device, "gateway": view.gateway, "file": out.display().to_string(),
    });
    output.result(&document, || {
        format!(
            "robot '{}' enrolled: device {}, gateway {} with fingerprint {}\nits enrolment file is {}; start it with \
             `authros agent run`",
            view.name,
            view.device,
            view.gateway.addresses.join(", "),
            Fingerprint::of_signer(&view.gateway.key),
            out.display()
        )
    });
    Ok(0)
}

fn beside(enrolment: &Path) -> PathBuf {
    let mut name = enrolment.as_os_str().to_owned();
    name.push(".passphrase");
    name.into()
}

fn open(global: &Global, path: &Path) -> Result<SealedEnrolment, Failure> {
    let secret = passphrase::of_file(global, &beside(path))?.ok_or_else(|| {
        let advice = "pass --passphrase-file or --passphrase-fd";
        Failure::new(ErrorKind::Refused, format!("{} is protected by a passphrase; {advice}", path.display()))
    })?;
    Ok(SealedEnrolment::open(path, &Passphrase::new(secret.expose().to_owned())?)?)
}

#[derive(Serialize)]
struct Summary {
    #[serde(flatten)]
    figures: AgentFigures,
    ended: &'static str,
    topics: Vec<TopicCounts>,
}

async fn capture(global: Global, arguments: RunArguments, output: &Output) -> Result<u8, Failure> {
    let wishes = AgentWishes {
        topics: parse::values(&arguments.topics)?,
        tags: parse::tags(&arguments.tags)?,
        count: arguments.count,
        length: arguments.seconds.map(Duration::from_secs),
    };
    let unlimited = wishes.count.is_none() && wishes.length.is_none();
    let sealed = open(&global, &arguments.enrolment)?;
    let context = Context::for_agent(global, &sealed.enrolment.name, output)?;
    let root = context.home.root().display().to_string();
    let lock = context.lock()?;
    let lock = lock.ok_or_else(|| Failure::new(ErrorKind::Home, format!("{root} is in use by another process")))?;
    let site = Site::start(context.home, context.config, lock, Needs { ros: true, chain: false })?;
    site.oversee();
    let (mut events, beside) = (site.events(), *output);
    // Notices of the site go to stderr.
    let notes = tokio::spawn(async move { serve::follow(&mut events, NoticeLevel::Info, &beside, pending()).await });
    let mut agent = match Agent::start(&site, sealed, wishes).await {
        Ok(agent) => agent,
        Err(failure) => {
            site.stop().await;
            return Err(failure);
        }
    };
    let ready = serve::ready();
    let progress = |figures: &AgentFigures| output.result(figures, || text(figures));
    let end = agent.run(serve::asked_to_end(), progress).await;
    drop(ready);
    agent.stop().await;
    notes.abort();
    let (end, figures, topics) = (end?, agent.figures()?, agent.topics()?);
    let ended = match end {
        AgentEnd::Done => "done",
        AgentEnd::Refused => "refused",
        AgentEnd::Told => "told",
    };
    let code = code(end, unlimited, &figures);
    let summary = Summary { figures, ended, topics };
    output.result(&summary, || format!("{}; ended: {ended}", text(&summary.figures)));
    Ok(code)
}

fn text(figures: &AgentFigures) -> String {
    let ring = figures.ring.map_or_else(String::new, |ring| {
        format!("; ring: {} messages, {}, {} fell out", ring.messages, ByteSize(ring.bytes), ring.fallen)
    });
    let AgentFigures { name, captured, accepted, verified, pending, lost, gateway, .. } = figures;
    let sum = format!("captured {captured}, accepted {accepted}, verified {verified}, pending {pending}, lost {lost}");
    format!("{name}: {sum}{ring}; gateway: {gateway}")
}

/// An unlimited agent that is told to stop succeeds: its outbox continues later.
fn code(end: AgentEnd, unlimited: bool, figures: &AgentFigures) -> u8 {
    let kind = match end {
        _ if figures.tampered > 0 => Some(ErrorKind::Tampered),
        AgentEnd::Refused => Some(ErrorKind::Refused),
        AgentEnd::Told if unlimited => None,
        _ => (figures.pending > 0 || figures.lost > 0).then_some(ErrorKind::Incomplete),
    };
    kind.map_or(0, ErrorKind::exit_code)
}
