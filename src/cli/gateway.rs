//! `authros gateway serve`: the paper's CR, alone or inside a running site.

use std::net::SocketAddr;

use super::args::GatewayVerb;
use super::connect::{Connection, Context, ProfileNeed, unexpected};
use super::parse;
use super::serve as site;
use crate::model::clean;
use crate::service::reply::{AdmittedView, GatewayStatusView, GatewayView};
use crate::service::{Command, Failure, Needs, Operation, Reply};
use authros_output::{Output, table};

/// Serves until a signal: through the running site of this home, or as a site of its own without ROS.
///
/// # Errors
/// Where the profile cannot be opened or registered, or the address is not free.
pub async fn serve(context: Context, listen: SocketAddr, open: bool, output: &Output) -> Result<u8, Failure> {
    let connection = context.connect(Needs { ros: false, chain: true }).await?;
    let (joined, events) = (connection.site.is_none(), connection.client.events());
    let end = site::asked_to_end();
    tokio::pin!(end);
    let begun = tokio::select! {
        begun = begin(&context, &connection, (listen, open), output) => begun,
        _ = &mut end => {
            connection.end().await;
            return Ok(0);
        }
    };
    let view = match begun {
        Ok(view) => view,
        Err(failure) => {
            connection.close().await;
            return Err(failure);
        }
    };
    output.result(&serde_json::json!({ "gateway": &view, "joined": joined }), || {
        format!(
            "gateway at {}, key {} (fingerprint {}), anchoring as {}; end it with Ctrl-C",
            view.address, view.gateway, view.fingerprint, view.account
        )
    });
    let ended = tokio::select! {
        () = site::follow(events, output, end) => Ok(0),
        failure = super::chain::lost(&connection.client) => Err(failure),
    };
    connection.end().await;
    ended
}

async fn begin(
    context: &Context,
    connection: &Connection,
    (address, open): (SocketAddr, bool),
    output: &Output,
) -> Result<GatewayView, Failure> {
    let client = &connection.client;
    context.prepare(client, ProfileNeed::Made, output).await?;
    client.request(Command::Register).await?;
    match client.request(Command::ServeGateway { address, open }).await? {
        Reply::Gateway(view) => Ok(view),
        _ => Err(unexpected()),
    }
}

/// What is asked of a site about its gateway.
///
/// # Errors
/// What is wrong with the arguments.
pub fn operation(verb: &GatewayVerb) -> Result<Operation, Failure> {
    Ok(match verb {
        GatewayVerb::Admit { owner } => Operation::Admit { owner: parse::value(owner)? },
        GatewayVerb::Dismiss { owner } => Operation::Dismiss { owner: parse::value(owner)? },
        GatewayVerb::Admitted => Operation::ListAdmitted,
        GatewayVerb::Status | GatewayVerb::Serve { .. } => Operation::GatewayStatus,
    })
}

/// Who may use a gateway, for people.
pub fn admitted(rows: &[AdmittedView]) -> String {
    if rows.is_empty() {
        return "nobody but this home's own profiles; `authros gateway admit OWNER` lets an owner use its gateway"
            .to_owned();
    }
    let name = |row: &AdmittedView| row.name.clone().unwrap_or_default();
    let rows: Vec<Vec<String>> = rows
        .iter()
        .map(|row| vec![row.owner.to_string(), name(row), row.since.to_string(), clean(&row.by, 60)])
        .collect();
    table(&["owner", "contact", "since", "admitted by"], &rows)
}

/// A gateway for people.
pub fn status(view: &GatewayStatusView) -> String {
    let mut lines = Vec::new();
    match (&view.served, &view.through) {
        (Some(served), _) => lines.push(format!(
            "gateway at {}, key {} (fingerprint {}), anchoring as {}; {} connections",
            served.address, served.gateway, served.fingerprint, served.account, view.connections
        )),
        (None, Some(through)) => lines.push(format!("no gateway here; this site joins another one: {through}")),
        (None, None) => lines.push("no gateway here; `authros gateway serve` starts one".to_owned()),
    }
    lines.extend(view.keys.iter().map(|key| {
        let use_of = if key.current { "in use" } else { "next" };
        format!("system key {} {use_of}, from {} to {}", key.id, key.not_before, key.not_after)
    }));
    lines.extend(view.senders.iter().map(|sender| {
        let place = sender.peer.as_deref().map_or_else(|| "not connected".to_owned(), |peer| clean(peer, 60));
        format!("{}  {}  {place}  {} frames, {} bytes", sender.name, sender.account, sender.frames, sender.bytes)
    }));
    lines.extend(view.refused.iter().map(|row| format!("refused {}: {}", row.count, row.text)));
    lines.join("\n")
}
