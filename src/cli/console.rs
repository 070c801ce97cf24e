//! `authros`: the console on this home's site, embedded or joined.

use std::sync::Arc;

use tokio::sync::{broadcast, mpsc};

use super::args::ConsoleArguments;
use super::connect::{Connection, Context};
use super::passphrase;
use crate::model::{ErrorKind, Timestamp};
use crate::service::client::site_gone;
use crate::service::event::NoticeLevel;
use crate::service::{Call, Client, Command, Event, Failure, Needs};
use crate::term::{self, ConsoleOptions};

/// Runs the console until it is left; the exit code is the terminal's.
///
/// # Errors
/// Without a terminal, or where the profile's console is open already.
pub fn run(runtime: &tokio::runtime::Runtime, context: Context, arguments: ConsoleArguments) -> Result<u8, Failure> {
    if !term::is_interactive() {
        return Err(Failure::new(
            ErrorKind::Usage,
            "the console needs a terminal, and this is none; without one use `authros demo`, `authros capture` or `authros serve`",
        ));
    }
    let _guard = runtime.enter();
    let (events, _) = broadcast::channel(1024);
    let (calls, waiting) = mpsc::unbounded_channel();
    let client = Client::new(context.profile.clone(), calls, events.clone());
    // The home is claimed before the first frame, so that a refusal is a plain line on stderr.
    let connection = runtime.block_on(connect(&context))?;
    let site = connection.site.clone();
    runtime.spawn(relay(connection.client.clone(), waiting, events));
    runtime.spawn(unlock(context, connection.client));
    let options = ConsoleOptions { theme: arguments.theme, ascii: arguments.ascii, read_only: arguments.read_only, ..ConsoleOptions::default() };
    let ended = term::run(client, options);
    if let Some(site) = site {
        runtime.block_on(site.stop());
    }
    let reason = ended.map_err(|error| Failure::new(error.kind(), error.to_string()))?;
    Ok(reason.exit_code())
}

async fn connect(context: &Context) -> Result<Connection, Failure> {
    let connection = context.connect(Needs { ros: true, chain: true }).await?;
    match connection.client.request(Command::OpenConsole).await {
        Ok(_) => Ok(connection),
        Err(failure) => {
            connection.close().await;
            Err(failure)
        }
    }
}

async fn relay(site: Client, mut calls: mpsc::UnboundedReceiver<Call>, events: broadcast::Sender<Event>) {
    let mut heard = site.events();
    loop {
        tokio::select! {
            call = calls.recv() => {
                let Some(Call { request, answer }) = call else { return };
                let site = site.for_profile(request.profile);
                tokio::spawn(async move {
                    // A console that no longer waits is no fault.
                    drop(answer.send(site.send(request.command).await.unwrap_or_else(|_| Err(site_gone()))));
                });
            }
            event = heard.recv() => match event {
                Ok(event) => drop(events.send(event)),
                Err(broadcast::error::RecvError::Lagged(_)) => {}
                Err(broadcast::error::RecvError::Closed) => {
                    let text = site_gone().message;
                    drop(events.send(Event::Notice { at: Timestamp::now(), level: NoticeLevel::Error, text }));
                    return;
                }
            },
        }
    }
}

/// Opens the keyring by itself where its passphrase was given or lies beside it.
async fn unlock(context: Context, client: Client) {
    let context = Arc::new(context);
    if !context.home.keyring(&context.profile).exists() {
        return;
    }
    if let Ok(Some(passphrase)) = passphrase::given(&context.global, &context.home, &context.profile) {
        // A failure shows as a locked keyring, and the console asks.
        drop(client.request(Command::Unlock { passphrase }).await);
    }
}
