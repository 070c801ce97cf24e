//! `authros serve`: the site without a console.

use tokio::signal::unix::{SignalKind, signal};

use super::connect::{Context, ProfileNeed};
use super::output::Output;
use crate::model::ErrorKind;
use crate::service::event::NoticeLevel;
use crate::service::{Command, Event, Failure, Needs};

/// Waits for SIGINT, SIGTERM or SIGHUP.
pub async fn asked_to_end() {
    let wait = |kind| async move {
        match signal(kind) {
            Ok(mut stream) => drop(stream.recv().await),
            Err(_) => std::future::pending().await,
        }
    };
    tokio::select! {
        () = wait(SignalKind::interrupt()) => {}
        () = wait(SignalKind::terminate()) => {}
        () = wait(SignalKind::hangup()) => {}
    }
}

/// Runs the site until a signal ends it.
///
/// # Errors
/// Where another process is the site already, or the profile cannot be opened.
pub async fn run(context: Context, output: &Output) -> Result<u8, Failure> {
    let connection = context.connect(Needs { ros: true, chain: true }).await?;
    if connection.site.is_none() {
        let root = context.home.root().display();
        return Err(Failure::new(
            ErrorKind::Home,
            format!("a site of {root} runs already; commands join it by themselves"),
        ));
    }
    let prepared = async {
        context.prepare(&connection.client, ProfileNeed::Made, output).await?;
        connection.client.request(Command::Register).await
    };
    let ended = tokio::select! {
        prepared = prepared => prepared.map(drop),
        () = asked_to_end() => {
            connection.close().await;
            return Ok(0);
        }
    };
    if let Err(failure) = ended {
        connection.close().await;
        return Err(failure);
    }
    let ready = serde_json::json!({ "serving": context.home.root().display().to_string(), "profile": context.profile });
    output.result(&ready, || {
        format!("serving {} for profile '{}'; end it with Ctrl-C", context.home.root().display(), context.profile)
    });
    follow(&connection.client, output).await;
    connection.close().await;
    Ok(0)
}

/// Shows the site's warnings until a signal, or the site's end.
pub async fn follow(client: &crate::service::Client, output: &Output) {
    let mut events = client.events();
    let end = asked_to_end();
    tokio::pin!(end);
    loop {
        tokio::select! {
            () = &mut end => return,
            event = events.recv() => match event {
                Ok(Event::Notice { at, level, text }) if level >= NoticeLevel::Warning => output.note(&format!("{at} {text}")),
                Ok(_) | Err(tokio::sync::broadcast::error::RecvError::Lagged(_)) => {}
                Err(tokio::sync::broadcast::error::RecvError::Closed) => return,
            },
        }
    }
}
