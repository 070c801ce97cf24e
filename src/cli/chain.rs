//! `authros chain serve` and `authros chain genesis`; status and deploy are plain verbs.

use std::fs::{DirBuilder, OpenOptions};
use std::io::{ErrorKind as IoKind, Write as _};
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use super::args::GenesisArguments;
use super::connect::{Context, unexpected};
use super::{parse, serve as site};
use crate::chain::{GUIDE, Genesis, GenesisKind};
use crate::model::ErrorKind;
use crate::service::reply::ServedView;
use crate::service::{Client, Command, Failure, Needs, Reply};
use authros_output::Output;

/// Serves the embedded chain's JSON-RPC until a signal: through the running site of this home, or as
/// the site itself.
///
/// # Errors
/// Where the address is not loopback or not free, or the chain is a node.
pub async fn serve(context: Context, listen: SocketAddr, output: &Output) -> Result<u8, Failure> {
    if !listen.ip().is_loopback() {
        // Said before a site is started for it.
        drop(crate::chain::serve::listen(listen).await?);
    }
    let connection = context.connect(Needs { ros: true, chain: true }).await?;
    let (joined, events) = (connection.site.is_none(), connection.client.events());
    let end = site::asked_to_end();
    tokio::pin!(end);
    let served = tokio::select! {
        served = start(&connection.client, listen) => served,
        _ = &mut end => {
            connection.end().await;
            return Ok(0);
        }
    };
    let served = match served {
        Ok(served) => served,
        Err(failure) => {
            connection.close().await;
            return Err(failure);
        }
    };
    let place = if joined { "the running site" } else { "this process, the site" };
    output.result(&serde_json::json!({ "serving": &served, "joined": joined }), || {
        format!("chain {} at {}, by {place}; end it with Ctrl-C", served.chain_id, served.url)
    });
    let ended = tokio::select! {
        () = site::follow(events, output, end) => Ok(0),
        failure = lost(&connection.client) => Err(failure),
    };
    connection.end().await;
    ended
}

/// Waits until the site is gone: a joined one may end at any time, and the server with it.
pub(super) async fn lost(client: &Client) -> Failure {
    loop {
        tokio::time::sleep(Duration::from_secs(2)).await;
        if let Err(failure) = client.request(Command::SiteStatus).await
            && failure.kind == ErrorKind::Unreachable
        {
            return failure;
        }
    }
}

async fn start(client: &Client, address: SocketAddr) -> Result<ServedView, Failure> {
    match client.request(Command::ServeChain { address }).await? {
        Reply::Served(served) => Ok(served),
        _ => Err(unexpected()),
    }
}

/// Makes a genesis file, or prints the guide.
///
/// # Errors
/// Where the arguments do not fit, or a file is there already.
pub fn genesis(arguments: &GenesisArguments, output: &Output) -> Result<u8, Failure> {
    let Some(consensus) = &arguments.consensus else {
        output.result(&serde_json::json!({ "guide": GUIDE }), || GUIDE.to_owned());
        return Ok(0);
    };
    let kind: GenesisKind = parse::value(consensus)?;
    let genesis = Genesis {
        kind,
        chain_id: arguments.chain_id,
        signers: parse::values(&arguments.signers)?,
        period: arguments.period,
        allocations: parse::values(&arguments.allocations)?,
    };
    let file = genesis.file()?;
    let text = serde_json::to_string_pretty(&file).unwrap_or_default();
    let Some(directory) = &arguments.out else {
        output.result(&serde_json::json!({ "consensus": kind.to_string(), "genesis": file }), || text);
        return Ok(0);
    };
    DirBuilder::new().recursive(true).create(directory).map_err(|error| not_written(directory, &error))?;
    for (name, text) in [("genesis.json", text.as_str()), ("README.md", GUIDE)] {
        write_new(&directory.join(name), text)?;
    }
    let id = &file["config"]["chainId"];
    let written = serde_json::json!({
        "consensus": kind.to_string(), "chain_id": id, "directory": directory.display().to_string(),
        "files": ["genesis.json", "README.md"],
    });
    output.result(&written, || {
        format!("genesis.json ({kind}, chain id {id}) and README.md written to {}", directory.display())
    });
    Ok(0)
}

/// A genesis file that a network was founded with must not be lost by a slip.
fn write_new(path: &Path, text: &str) -> Result<(), Failure> {
    let mut file = match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == IoKind::AlreadyExists => {
            let what = format!("{} is there already; name another directory with --out", path.display());
            return Err(Failure::new(ErrorKind::Input, what));
        }
        Err(error) => return Err(not_written(path, &error)),
    };
    writeln!(file, "{}", text.trim_end()).map_err(|error| not_written(path, &error))
}

fn not_written(path: &Path, error: &std::io::Error) -> Failure {
    Failure::new(ErrorKind::Input, format!("{} cannot be written: {error}", path.display()))
}
