//! `authros gateway`: the paper's CR, served alone or inside a running site, and who may use it.

#![deny(clippy::wildcard_enum_match_arm)]

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::Subcommand;

use super::connect::{Context, ProfileNeed};
use super::plan::{NEITHER, Plan};
use super::{parse, parse::usage, passphrase, show::Question};
use crate::crypto::private_file::create_private;
use crate::crypto::{CryptoError, Passphrase};
use crate::model::{clean, counted};
use crate::service::command::{Admit, Dismiss, GatewayStatus, ListAdmitted, MakeJoinFile, Register, ServeGateway};
use crate::service::reply::{
    AdmittedView, GatewayStatusView, GatewayView, JoinStanding, JoinedView, LeaseView, WorkerView,
};
use crate::service::{Client, Failure, Needs, SecretText, restoring};
use authros_output::{Output, table};

/// `gateway …`
#[derive(Debug, Subcommand)]
pub enum GatewayVerb {
    /// Show this home's gateway: connections, system keys, refusals
    Status,
    /// Accept sealed records from robots, anchor them with this profile's account, answer operators' queries
    Serve {
        /// Address and port; port 0 = any free port
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7420")]
        listen: SocketAddr,
        /// Also accept owners who are not on the allow list, each within the quotas in the settings
        #[arg(long)]
        open: bool,
    },
    /// Write the file that makes another machine a worker of this gateway, which keeps its records in PostgreSQL
    JoinFile {
        /// File to write; must not exist. Type its own passphrase, or pass it as for a keyring
        #[arg(long, value_name = "FILE", value_parser = parse::new_file())]
        out: PathBuf,
        /// Make a new join key: earlier files make no workers, and workers without this one end
        #[arg(long)]
        renew: bool,
        /// Seal it under a random passphrase, which is shown once
        #[arg(long)]
        random: bool,
    },
    /// Make an empty home a worker of a gateway, or bring a worker a newer join key
    Join {
        /// What `gateway join-file` wrote; type its own passphrase, or pass it as for a keyring
        file: PathBuf,
    },
    /// Allow an owner to use this home's gateway: to register names, send records and read what is granted to it
    Allow {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// Take an owner off the allow list; what it sent is kept. An open gateway still serves it within the quotas
    Deny {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// List who may use the gateway besides this home's own profiles
    Allowed,
}

pub async fn run(context: Context, verb: GatewayVerb, output: &Output) -> Result<u8, Failure> {
    let is_about_owners = matches!(verb, GatewayVerb::Deny { .. } | GatewayVerb::Allowed);
    let question: Question = match verb {
        GatewayVerb::Serve { listen, open } => return serve(context, listen, open, output).await,
        GatewayVerb::JoinFile { out, renew, random } => return join_file(&context, &out, renew, random, output).await,
        GatewayVerb::Join { file } => return join(&context, &file, output),
        GatewayVerb::Allow { owner } => Admit { owner: parse::value(&owner)? }.into(),
        GatewayVerb::Deny { owner } => Dismiss { owner: parse::value(&owner)? }.into(),
        GatewayVerb::Allowed => ListAdmitted.into(),
        GatewayVerb::Status => GatewayStatus.into(),
    };
    let is_open = context.config.gateway.open;
    let code = super::plan::run(context, Plan::kept(question), output).await?;
    if is_open && is_about_owners {
        output.note(OPEN);
    }
    Ok(code)
}

const OPEN: &str = "this gateway is open: owners who are not on the list use it within gateway.quota_bytes, _names and _streams; \
                    to shut them out, set gateway.admission = \"closed\" and start it again";

async fn serve(context: Context, listen: SocketAddr, open: bool, output: &Output) -> Result<u8, Failure> {
    let needs = Needs { ros: false, chain: true };
    let connection = match context.operator {
        Some(_) => context.connect(needs).await?,
        None => context.stay(needs, output, "`authros gateway serve`").await?,
    };
    connection.oversee();
    let begin = async |client: &Client| {
        context.prepare(client, ProfileNeed::Made, output).await?;
        client.ask(Register).await?;
        client.ask(ServeGateway { address: listen, open }).await
    };
    super::serve::until_signal(connection, output, begin, |view: GatewayView, joined| {
        output.result(&serde_json::json!({ "gateway": &view, "joined": joined }), || {
            format!(
                "gateway at {}, key {} (fingerprint {}), anchoring as {}; stop it with Ctrl-C{}",
                view.address,
                view.gateway,
                view.fingerprint,
                view.account,
                reached_at(&view.addresses)
            )
        });
    })
    .await
}

/// A line more, if the settings say it.
fn reached_at(addresses: &[String]) -> String {
    if addresses.is_empty() {
        return String::new();
    }
    format!("\nrobots and owners reach it at {}", clean(&addresses.join(","), 300))
}

const JOIN_FILE: &str = "join file";

async fn join_file(context: &Context, out: &Path, renew: bool, random: bool, output: &Output) -> Result<u8, Failure> {
    if out.symlink_metadata().is_ok() {
        return Err(CryptoError::Exists(clean(&out.display().to_string(), 200)).into());
    }
    if random && passphrase::is_passed(&context.global) {
        return Err(usage("--random makes a passphrase; omit it, or the option that passes one"));
    }
    let secret = if random {
        SecretText::new(Passphrase::random()?.expose().to_owned())
    } else {
        passphrase::of_its_own(&context.global, JOIN_FILE, true)?
    };
    let ask = MakeJoinFile { passphrase: secret.clone(), renew };
    let make = async |client: &Client| client.ask(ask).await;
    let made = context.with(NEITHER, ProfileNeed::None, output, make).await?;
    create_private(out, made.expose())?;
    let shown = random.then(|| secret.expose());
    output.result(&serde_json::json!({ "file": out.display().to_string(), "passphrase": shown }), || {
        let mut lines = vec![format!(
            "written to {} (0600); on the other machine: `authros gateway join FILE`, with PGPASSWORD or PGPASSFILE for the \
             database",
            out.display()
        )];
        lines.extend(shown.map(|shown| format!("its passphrase, shown this once: {shown}")));
        lines.extend(renew.then(|| "other workers accept nobody until they join again with this file".to_owned()));
        lines.join("\n")
    });
    Ok(0)
}

fn join(context: &Context, file: &Path, output: &Output) -> Result<u8, Failure> {
    let secret = passphrase::of_its_own(&context.global, JOIN_FILE, false)?;
    let opened = restoring::open(file, &secret)?;
    // A worker has settings of its own.
    let own = context.home.config().exists().then(|| context.config.clone());
    let config = own.map_or_else(|| context.beginning_with(&opened.settings), Ok)?;
    let view = restoring::join(&opened, &context.home, &config)?;
    output.result(&view, || joined(&view, context.home.root()));
    Ok(0)
}

fn joined(view: &JoinedView, home: &Path) -> String {
    let JoinedView { profile, account, store, .. } = view;
    let home = home.display();
    let first = match view.standing {
        JoinStanding::Joined => format!("{home} is a worker of the gateway of {account} on {store}"),
        JoinStanding::Renewed => format!("{home} has the newer join key of the gateway of {account} on {store}"),
        JoinStanding::Unchanged => format!("{home} has this join key already"),
    };
    let next = format!(
        "next: `authros --home {home} --profile {profile} gateway serve --listen ADDRESS:PORT`, with the passphrase of the \
         gateway's keyring{}",
        reached_at(&view.addresses)
    );
    let mut lines = vec![first];
    lines.extend(view.notes.iter().cloned());
    lines.extend((view.standing == JoinStanding::Joined).then_some(next));
    lines.join("\n")
}

pub fn allowed(rows: &[AdmittedView]) -> String {
    if rows.is_empty() {
        return "only this home's own profiles; `authros gateway allow OWNER` allows others".to_owned();
    }
    let row = |row: &AdmittedView| {
        [row.owner.to_string(), row.name.clone().unwrap_or_default(), row.since.in_milliseconds(), clean(&row.by, 60)]
    };
    table(&["owner", "contact", "since", "allowed by"], rows.iter().map(row))
}

pub fn status(view: &GatewayStatusView) -> String {
    let mut lines = Vec::new();
    match (&view.served, &view.through) {
        (Some(served), _) => lines.push(format!(
            "gateway at {}, key {} (fingerprint {}), anchoring as {}; {}{}",
            served.address,
            served.gateway,
            served.fingerprint,
            served.account,
            counted(view.connections, "connection"),
            reached_at(&served.addresses)
        )),
        (None, Some(through)) => lines.push(format!("no gateway here; this site has joined another one: {through}")),
        (None, None) => lines.push("no gateway here; `authros gateway serve` starts one".to_owned()),
    }
    lines.extend(view.keys.iter().map(|key| {
        let use_of = if key.current { "in use" } else { "next" };
        format!(
            "system key {} {use_of}, from {} to {}",
            key.id,
            key.not_before.in_milliseconds(),
            key.not_after.in_milliseconds()
        )
    }));
    lines.extend(view.lease.iter().flat_map(lease));
    lines.extend(view.senders.iter().map(|sender| {
        let place = match &sender.peer {
            Some(peer) => clean(peer, 60),
            None if sender.revoked => "revoked".to_owned(),
            None => "not connected".to_owned(),
        };
        let (frames, bytes) = (counted(sender.frames, "frame"), counted(sender.bytes, "byte"));
        format!("{}  {}  {place}  {frames}, {bytes}", sender.name, sender.account)
    }));
    lines.extend(view.refused.iter().map(|row| format!("refused {}: {}", row.count, row.text)));
    lines.join("\n")
}

fn lease(view: &LeaseView) -> Vec<String> {
    let since = view.since.map(|since| format!(" since {}", since.in_milliseconds())).unwrap_or_default();
    let number = view.number;
    let first = match &view.holder {
        Some(holder) if holder.is_own => format!("lease {number}, held here{since}"),
        Some(holder) => format!("lease {number}, held by {}{since}", clean(&holder.name, 120)),
        None => "no worker holds the lease, so nothing is anchored or verified; one takes it within 10 s".to_owned(),
    };
    let worker = |worker: &WorkerView| {
        let here = if worker.is_own { ", here" } else { "" };
        format!("worker {}{here}, seen {} s ago", clean(&worker.name, 120), worker.silent)
    };
    let unlike = (!view.unlike.is_empty()).then(|| {
        format!(
            "settings here that differ from the holder's: {}; set them alike at all workers",
            view.unlike.join(", ")
        )
    });
    std::iter::once(first).chain(view.workers.iter().map(worker)).chain(unlike).collect()
}
