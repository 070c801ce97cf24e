//! `authros`: the console on this home's site, embedded or joined; and the tour, on a home of its own.

use std::sync::{Arc, OnceLock};

use tokio::runtime::Runtime;
use tokio::sync::{broadcast, mpsc};

use super::args::{ConsoleArguments, TourArguments};
use super::connect::{Connection, Context};
use super::{backups::Successor, demo, parse::usage, passphrase, printed};
use crate::model::{ContactName, ProfileName, Timestamp};
use crate::service::command::{AddContact, CreateIdentity, Register, SecretText, Unlock};
use crate::service::{Call, Client, Event, Failure, Needs, NoticeLevel, Site, client::site_gone};
use crate::term::{self, ExitReason};
use crate::{app::tour::Cast, crypto::Passphrase};

pub fn run(runtime: &Runtime, context: Context, console: ConsoleArguments, tour: Option<Cast>) -> Result<u8, Failure> {
    if !term::is_interactive() {
        let advice = "without one, use `authros tour --plain`, `authros capture` or `authros serve`";
        return Err(usage(format!("the console needs a terminal; {advice}")));
    }
    let leaves_site = tour.is_none() && context.operator.is_none();
    let mut options = printed::options(&context, console)?;
    let reader = tour.as_ref().map(|cast| cast.reader.clone());
    (options.settings.tour, options.settings.leaves_site) = (tour, leaves_site);
    let successor = Successor::of(&context);
    let (events, _) = broadcast::channel(1024);
    let (calls, waiting) = mpsc::unbounded_channel();
    let client = Client::new(context.profile.clone(), calls, events.clone());
    let site = Arc::new(OnceLock::new());
    // The first frame does not wait for the site: calls queue until it is there.
    runtime.spawn(serve(context, reader, Arc::clone(&site), waiting, events));
    let (ended, secret) = loop {
        let ended = term::run(client.clone(), runtime.handle(), &options);
        if !matches!(ended, Ok(ExitReason::LeaveSite)) {
            break (ended, None);
        }
        // The site captures until the passphrase proves right; without one the console goes on.
        match successor.passphrase() {
            Ok(secret) => break (ended, Some(secret)),
            Err(failure) => options.warning = Some(format!("the site continues in this console: {}", failure.message)),
        }
    };
    drop(client);
    if let Some(site) = site.get() {
        runtime.block_on(Arc::clone(site).stop());
    }
    if let Some(secret) = secret {
        return Err(successor.become_it(&secret));
    }
    match ended.map_err(|error| Failure::new(error.kind(), error.to_string()))? {
        ExitReason::Refused(failure) => Err(failure),
        reason => Ok(reason.exit_code()),
    }
}

type Calls = mpsc::UnboundedReceiver<Call>;

async fn serve(
    context: Context,
    reader: Option<ProfileName>,
    site: Arc<OnceLock<Arc<Site>>>,
    waiting: Calls,
    events: broadcast::Sender<Event>,
) {
    match context.connect(Needs { ros: true, chain: true }).await {
        Ok(Connection { client, site: own }) => {
            if let Some(own) = own {
                own.oversee();
                // Set only here.
                drop(site.set(own));
            }
            tokio::spawn(unlock(context, client.clone()));
            if let Some(reader) = reader {
                tokio::spawn(prepare(client.clone(), reader, events.clone()));
            }
            relay(client, waiting, events).await;
        }
        Err(failure) => refuse(waiting, &failure).await,
    }
}

async fn prepare(client: Client, reader: ProfileName, events: broadcast::Sender<Event>) {
    if let Err(failure) = prepare_tour(&client, reader).await {
        let text = format!("the tour has no one to share with: {}", failure.message);
        drop(events.send(Event::Notice { at: Timestamp::now(), level: NoticeLevel::Error, text, about: None }));
    }
}

async fn refuse(mut waiting: Calls, failure: &Failure) {
    while let Some(Call { answer, .. }) = waiting.recv().await {
        // The console may have stopped waiting.
        drop(answer.send(Err(failure.clone())));
    }
}

async fn relay(site: Client, mut calls: Calls, events: broadcast::Sender<Event>) {
    let mut heard = site.events();
    loop {
        tokio::select! {
            call = calls.recv() => {
                let Some(Call { request, answer }) = call else { return };
                let site = site.for_profile(request.profile);
                tokio::spawn(async move {
                    // The console may have stopped waiting.
                    drop(answer.send(site.send(request.command).await.unwrap_or_else(|_| Err(site_gone()))));
                });
            }
            event = heard.recv() => match event {
                Ok(event) => drop(events.send(event)),
                Err(broadcast::error::RecvError::Lagged(_)) => {}
                Err(broadcast::error::RecvError::Closed) => {
                    let text = site_gone().message;
                    drop(events.send(Event::Notice { at: Timestamp::now(), level: NoticeLevel::Error, text, about: None }));
                    return;
                }
            },
        }
    }
}

async fn unlock(context: Context, client: Client) {
    if context.operator.is_some() || !context.home.keyring(&context.profile).exists() {
        return;
    }
    // A program that prints it may take its time.
    let given = tokio::task::block_in_place(|| passphrase::given(&context.global, &context.home, &context.profile));
    if let Ok(Some(passphrase)) = given {
        // A failure shows as a locked keyring, and the console asks.
        drop(client.ask(Unlock { passphrase }).await);
    }
}

/// The robots' owner in the paper.
const OWNER: &str = "cura-a";
const READER: &str = "cura-b";

pub fn run_tour(runtime: &Runtime, mut context: Context, arguments: TourArguments) -> Result<u8, Failure> {
    if context.global.home.is_some() {
        return Err(usage("the tour uses its own home, which is removed afterwards; omit --home and AUTHROS_HOME"));
    }
    if context.config.robots == 0 {
        return Err(usage("the tour needs robots; use --robots 1 to 32 and no real ROS master"));
    }
    let temporary = demo::temporary_home(&mut context, "authros-tour-")?;
    context.profile = super::parse::value(OWNER)?;
    let cast = Cast { owner: context.profile.clone(), reader: super::parse::value(READER)? };
    let TourArguments { theme, ascii, .. } = arguments;
    let console = ConsoleArguments { theme, ascii, ..ConsoleArguments::default() };
    let ended = run(runtime, context, console, Some(cast));
    drop(temporary);
    ended
}

pub async fn prepare_tour(client: &Client, reader: ProfileName) -> Result<(), Failure> {
    let name: ContactName = super::parse::value(reader.as_str())?;
    let of_reader = client.for_profile(reader);
    let passphrase = SecretText::new(Passphrase::random()?.expose().to_owned());
    let made = of_reader.ask(CreateIdentity { passphrase }).await?;
    of_reader.ask(Register).await?;
    if let Some(address) = made.address {
        client.ask(AddContact { name, address, fingerprint: None }).await?;
    }
    Ok(())
}
