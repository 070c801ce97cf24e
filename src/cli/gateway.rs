//! `authros gateway`: the paper's CR, served alone or inside a running site, and who may use it.

#![deny(clippy::wildcard_enum_match_arm)]

use std::net::SocketAddr;

use clap::Subcommand;

use super::connect::{Context, ProfileNeed};
use super::plan::Plan;
use super::{parse, show::Question};
use crate::model::{clean, counted};
use crate::service::command::{Admit, Dismiss, GatewayStatus, ListAdmitted, Register, ServeGateway};
use crate::service::reply::{AdmittedView, GatewayStatusView, GatewayView, LeaseView, WorkerView};
use crate::service::{Client, Failure, Needs};
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
    /// Allow an owner to use this home's gateway: to register names, send records and read what is granted to it
    Allow {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// Deny an owner the use of this home's gateway; what it sent is kept
    Deny {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// List who may use the gateway besides this home's own profiles
    Allowed,
}

pub async fn run(context: Context, verb: GatewayVerb, output: &Output) -> Result<u8, Failure> {
    let question: Question = match verb {
        GatewayVerb::Serve { listen, open } => return serve(context, listen, open, output).await,
        GatewayVerb::Allow { owner } => Admit { owner: parse::value(&owner)? }.into(),
        GatewayVerb::Deny { owner } => Dismiss { owner: parse::value(&owner)? }.into(),
        GatewayVerb::Allowed => ListAdmitted.into(),
        GatewayVerb::Status => GatewayStatus.into(),
    };
    super::plan::run(context, Plan::kept(question), output).await
}

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
                "gateway at {}, key {} (fingerprint {}), anchoring as {}; stop it with Ctrl-C",
                view.address, view.gateway, view.fingerprint, view.account
            )
        });
    })
    .await
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
            "gateway at {}, key {} (fingerprint {}), anchoring as {}; {}",
            served.address,
            served.gateway,
            served.fingerprint,
            served.account,
            counted(view.connections, "connection")
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
        let place = sender.peer.as_deref().map_or_else(|| "not connected".to_owned(), |peer| clean(peer, 60));
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
    std::iter::once(first).chain(view.workers.iter().map(worker)).collect()
}
