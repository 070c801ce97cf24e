//! `authros robot`: `enrol` runs at the owner, `run` on the robot.

use std::path::{Path, PathBuf};
use std::{future::pending, time::Duration};

use clap::Args;
use serde::Serialize;

use super::args::Global;
use super::connect::{Context, ProfileNeed};
use super::{parse, passphrase, plan::CHAIN, serve};
use crate::crypto::{Fingerprint, Passphrase, SealedEnrolment, error::shown, private_file};
use crate::model::{ByteSize, ErrorKind, counted, grouped};
use crate::service::{
    Agent, AgentEnd, AgentFigures, AgentWishes, Client, EnrolWishes, Failure, Needs, NoticeLevel, SecretText, Site,
};
use crate::{service::command::EnrolDevice, store::TopicCounts};
use authros_output::Output;

/// `robot enrol …`
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("trust").required(true)))]
pub struct EnrolArguments {
    /// The gateway; repeat it for further addresses of the same gateway: the robot uses the first that answers
    #[arg(long = "gateway", value_name = "HOST:PORT", required = true)]
    pub addresses: Vec<String>,
    /// The gateway's fingerprint (64 hex), as its operator shows it
    #[arg(long, value_name = "FINGERPRINT", group = "trust")]
    pub gateway_key: Option<String>,
    /// Pin whatever gateway answers; compare the fingerprint afterwards
    #[arg(long, group = "trust")]
    pub trust_first: bool,
    /// Name of the robot at the gateway
    #[arg(long, value_name = "NAME")]
    pub name: String,
    /// Topic the robot may record; repeatable
    #[arg(long = "topic", value_name = "TOPIC", conflicts_with = "all_topics")]
    pub topics: Vec<String>,
    /// Let it record every topic: it then holds the epoch's key and the index key, which a thief would get too
    #[arg(long)]
    pub all_topics: bool,
    /// End of the authorisation: 30d, 18:00, "tomorrow 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME")]
    pub until: Option<String>,
    /// Enrolment file to write; must not exist
    #[arg(long, value_name = "FILE", value_parser = parse::new_file())]
    pub out: PathBuf,
    /// File with the passphrase for the enrolment file [default: a random passphrase, written to FILE.passphrase]
    #[arg(long, value_name = "FILE")]
    pub robot_passphrase_file: Option<PathBuf>,
}

/// `robot run …`
#[derive(Debug, Args)]
pub struct RunArguments {
    /// The enrolment file
    #[arg(value_name = "ENROLMENT")]
    pub enrolment: PathBuf,
    /// Topic to capture; repeatable [default: those the enrolment is limited to]
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Tag for every record, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// Stop after this many messages per topic
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// Stop after capturing for this long
    #[arg(long, value_name = "S", conflicts_with = "count")]
    pub seconds: Option<u64>,
}

pub async fn enrol(mut global: Global, arguments: EnrolArguments, output: &Output) -> Result<u8, Failure> {
    // Names the robot's gateway, not the one that this home's site joined.
    global.gateway_key = None;
    let context = Context::new(global, output)?;
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
             `authros robot run`",
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
    if let Some(secret) = passphrase::of_source(global, &beside(path))? {
        return Ok(SealedEnrolment::open(path, &Passphrase::new(secret.expose().to_owned())?)?);
    }
    let file = shown(path);
    let Some(mut hidden) = passphrase::terminal::begin()? else {
        let text = format!("{file} is protected by a passphrase; pass {}", passphrase::SOURCES);
        return Err(Failure::new(ErrorKind::Refused, text));
    };
    let question = format!("Passphrase of {file}");
    let open = |passphrase: &Passphrase| SealedEnrolment::open(path, passphrase);
    passphrase::terminal::that_opens(&mut hidden, &question, open).map(|(_, sealed)| sealed)
}

#[derive(Serialize)]
struct Summary {
    #[serde(flatten)]
    figures: AgentFigures,
    ended: &'static str,
    topics: Vec<TopicCounts>,
}

pub async fn run(global: Global, arguments: RunArguments, output: &Output) -> Result<u8, Failure> {
    let wishes = AgentWishes {
        topics: parse::values(&arguments.topics)?,
        tags: parse::tags(&arguments.tags)?,
        count: arguments.count,
        length: arguments.seconds.map(Duration::from_secs),
    };
    let unlimited = wishes.count.is_none() && wishes.length.is_none();
    let sealed = open(&global, &arguments.enrolment)?;
    let context = Context::for_agent(global, &sealed.enrolment.name, output)?;
    if context.config.store_url.is_some() {
        let text = "a robot keeps its records in a file of its own home; leave store.url (AUTHROS_STORE) empty there";
        return Err(Failure::new(ErrorKind::Input, text));
    }
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
        AgentEnd::Told => "stopped on request",
    };
    let code = code(end, unlimited, &figures);
    let summary = Summary { figures, ended, topics };
    output.result(&summary, || format!("{}; ended: {ended}", text(&summary.figures)));
    Ok(code)
}

fn text(figures: &AgentFigures) -> String {
    let ring = figures.ring.map_or_else(String::new, |ring| {
        format!(
            "; ring: {}, {}, {} expired",
            counted(ring.messages, "message"),
            ByteSize(ring.bytes),
            grouped(ring.fallen)
        )
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
